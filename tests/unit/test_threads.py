"""Acts beside each other: all are done, nobody waits for what cannot begin, and what fails is told."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from wrinkle_synthesis.wrinkle_addon import threads
from wrinkle_synthesis.wrinkle_addon.threads import Ahead, run_side_by_side


@pytest.fixture(params=[1, 3], ids=["one other thread", "three other threads"])
def others(request, monkeypatch):
    """The other threads of another machine."""
    pool = ThreadPoolExecutor(request.param)
    monkeypatch.setattr(threads, "THREADS", request.param + 1)
    monkeypatch.setattr(threads, "_others", pool)
    yield pool
    pool.shutdown()


@pytest.mark.usefixtures("others")
@pytest.mark.parametrize("count", [0, 1, 2, 50])
def test_every_act_is_done_once(count):
    done = []
    run_side_by_side([lambda k=k: done.append(k) for k in range(count)], 4)
    assert sorted(done) == list(range(count))


def test_acts_run_at_the_same_time(others):
    # Each waits for the other: one thread alone would never come to an end.
    met = threading.Barrier(2, timeout=30.0)
    run_side_by_side([met.wait, met.wait], 2)


@pytest.mark.usefixtures("others")
def test_acts_may_use_other_threads_in_their_turn():
    done = []

    def halves():
        run_side_by_side([lambda: done.append(0), lambda: done.append(1)], 4)

    begun = [Ahead(halves) for _ in range(8)]
    run_side_by_side([halves] * 8, 4)
    for one in begun:
        one.finish()
    assert sorted(done) == [0] * 16 + [1] * 16


def test_what_could_not_begin_is_done_by_whom_needs_it(others):
    go_on = threading.Event()
    busy = [others.submit(go_on.wait) for _ in range(threads.THREADS - 1)]
    doer = []
    act = Ahead(lambda: doer.append(threading.current_thread()))
    run_side_by_side([lambda: doer.append(threading.current_thread())] * 2, 2)
    act.finish()
    assert doer == [threading.current_thread()] * 3
    go_on.set()
    assert all(one.result() for one in busy)


def fail():
    raise ValueError("This one fails.")


@pytest.mark.usefixtures("others")
@pytest.mark.parametrize("place", [0, 1, 2])
def test_an_act_that_fails_is_told_on_whichever_thread_it_ran(place):
    with pytest.raises(ValueError, match="This one fails"):
        run_side_by_side([fail if k == place else int for k in range(3)], 4)


def test_what_was_begun_and_failed_is_told_where_it_is_needed(others):
    begun = Ahead(fail)
    others.submit(int).result()
    with pytest.raises(ValueError, match="This one fails"):
        begun.finish()


def test_without_other_threads_acts_are_done_where_they_are_needed(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 1)
    done = []
    begun = Ahead(lambda: done.append(threading.current_thread()))
    assert done == []
    begun.finish()
    assert done == [threading.current_thread()]
