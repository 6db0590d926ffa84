"""The processor's other cores: acts on arrays that run beside the calling thread.

Warp runs a launch on one thread of a CPU but releases Python's lock meanwhile, so acts that launch run side by side.
All share as many threads as there are other cores. Nobody ever waits for an act that has not begun: whoever needs it
does it himself, so acts may make use of other threads in their turn. What acts write must not overlap; then results are
the same whatever the number of threads. Nothing here may touch Blender's data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from os import cpu_count
from threading import Lock, current_thread, main_thread

THREADS = cpu_count() or 1
"""Threads that work at a time, the calling one among them."""

_others = ThreadPoolExecutor(max(THREADS - 1, 1), "wrinkle")
_busy: list[None] = []
"""An entry for each thread but the main one that is at work."""
_beginning = Lock()


@contextmanager
def at_work() -> Iterator[None]:
    """Whatever another thread than the main one launches, it launches within this."""
    with _beginning:
        _busy.append(None)
    try:
        yield
    finally:
        _busy.pop()


@contextmanager
def alone() -> Iterator[bool]:
    """Whether this is the main thread and no other is at work; none begins to until the end."""
    with _beginning:
        yield not _busy and current_thread() is main_thread()


def help_is_free() -> bool:
    """Whether another thread is idle."""
    return len(_busy) < THREADS - 1


def _on_another(act: Callable[[], object]) -> Future:
    def work() -> object:
        with at_work():
            return act()

    return _others.submit(work)


def run_side_by_side(acts: Sequence[Callable[[], object]], threads: int = THREADS) -> None:
    """Run acts in any order, each on whichever thread is free for it, this one among them; back when all are done.

    Args:
        acts: What none of them writes, another may read.
        threads: How many of them to run at a time, at most.

    Raises:
        Exception: Whatever an act raised.
    """
    waiting = iter(acts)

    def work() -> None:
        for act in waiting:
            act()

    # To ask a busy thread for help, and then do without, takes longer than many an act.
    asked = min(threads, len(acts)) - 1 if help_is_free() else 0
    helpers = [_on_another(work) for _ in range(asked)]
    try:
        work()
    finally:
        for helper in helpers:
            if not helper.cancel():
                helper.result()


class Ahead:
    """An act that may begin on another thread now, unless it is kept for this one, and is needed later."""

    def __init__(self, act: Callable[[], object], *, kept: bool = False):
        self._act = act
        self._future: Future | None = _on_another(act) if THREADS > 1 and not kept else None

    def finish(self) -> None:
        """Come back when the act is done; once.

        Raises:
            Exception: Whatever it raised.
        """
        if self._future is None or self._future.cancel():
            self._act()
        else:
            self._future.result()
