"""Launches recorded once and replayed, and what keeps other threads out of a recording."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest
import warp as wp
from wrinkle_synthesis.kernels import spreading
from wrinkle_synthesis.wrinkle_addon.launch_graph import LaunchGraph
from wrinkle_synthesis.wrinkle_addon.threads import alone, at_work

CPU = wp.get_device("cpu")


@contextmanager
def another_thread_at_work():
    """Until the end."""
    begun, go_on = threading.Event(), threading.Event()

    def work():
        with at_work():
            begun.set()
            go_on.wait(30.0)

    thread = threading.Thread(target=work)
    thread.start()
    begun.wait(30.0)
    try:
        yield
    finally:
        go_on.set()
        thread.join()


class Chain:
    """A value copied on and on through arrays, and how often Python had to launch that."""

    def __init__(self):
        self.arrays = [wp.zeros(4, dtype=wp.float32, device=CPU) for _ in range(3)]
        self.runs = 0
        self.graph = LaunchGraph(self.launch, (spreading,), CPU)

    def launch(self):
        self.runs += 1
        for source, target in zip(self.arrays, self.arrays[1:], strict=False):
            wp.copy(target, source)

    def through(self, value):
        self.arrays[0].fill_(value)
        self.graph()
        return self.arrays[-1].numpy().copy()


def test_an_act_is_launched_once_and_replayed_with_what_its_arrays_hold():
    chain = Chain()
    found = [chain.through(value) for value in (1.0, 2.0, 3.0)]
    assert np.array_equal(found, np.repeat([[1.0], [2.0], [3.0]], 4, 1)) and chain.runs == 1


def test_nothing_is_recorded_while_another_thread_is_at_work():
    chain = Chain()
    with another_thread_at_work():
        assert [chain.through(value)[0] for value in (1.0, 2.0)] == [1.0, 2.0] and chain.runs == 2
    assert [chain.through(value)[0] for value in (3.0, 4.0)] == [3.0, 4.0] and chain.runs == 3


def test_what_was_prepared_is_replayed_while_another_thread_is_at_work():
    chain = Chain()
    chain.arrays[0].fill_(7.0)
    chain.graph.prepare()
    assert chain.runs == 1 and not chain.arrays[-1].numpy().any()
    with another_thread_at_work():
        assert chain.through(8.0)[0] == 8.0 and chain.runs == 1


def test_nobody_begins_to_work_while_one_is_alone():
    begun = threading.Event()

    def work():
        with at_work():
            begun.set()

    thread = threading.Thread(target=work)
    with alone() as free:
        assert free
        thread.start()
        assert not begun.wait(0.2)
    thread.join(30.0)
    assert begun.is_set()


def test_another_thread_than_the_main_one_is_never_alone():
    found = []

    def look():
        with alone() as free:
            found.append(free)

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert found == [False]


def test_an_act_that_fails_while_it_is_recorded_lets_others_go_on():
    def fail():
        raise ValueError("This one fails.")

    with pytest.raises(ValueError, match="This one fails"):
        LaunchGraph(fail, (), CPU)()
    assert Chain().through(5.0)[0] == 5.0
