"""What takes a moment is made of arrays in a thread behind the window, which goes on without it meanwhile.

Only what a window shows may lack something. Renders and background processes wait: their frames must be right.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import bpy

from ..threads import at_work

Made = TypeVar("Made")

TICK = 0.05
"""Time between two looks at what is being made [s]."""

_maker = ThreadPoolExecutor(1, thread_name_prefix="wrinkle")
_making: list[Future] = []


class NotReady(Exception):
    """What is to be shown is still being made."""


def begin(make: Callable[[], Made], depsgraph: bpy.types.Depsgraph) -> Future[Made]:
    """Make something, behind the window if that may go without; ``make`` must not touch Blender's data."""
    if _waits(depsgraph):
        made: Future[Made] = Future()
        try:
            made.set_result(make())
        except Exception as error:
            made.set_exception(error)
        return made
    made = submit(make)
    _making.append(made)
    if not bpy.app.timers.is_registered(look):
        bpy.app.timers.register(look, first_interval=TICK)
    return made


def submit(make: Callable[[], Made]) -> Future[Made]:
    """Make something behind the window; ``make`` must not touch Blender's data. One after the other."""

    def work() -> Made:
        with at_work():
            return make()

    return _maker.submit(work)


def take(made: Future[Made], depsgraph: bpy.types.Depsgraph) -> Made:
    """What was begun.

    Raises:
        NotReady: If it is still being made, and a window may go without; garments are played again when it is done.
        Exception: What kept it from being made.
    """
    if not made.done() and not _waits(depsgraph):
        raise NotReady
    return made.result()


def _waits(depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether there is nobody who could see a later frame."""
    return bpy.app.background or depsgraph.mode == "RENDER"


def look() -> float | None:
    """Let garments be played again whenever something was made."""
    done = [made for made in _making if made.done()]
    if done:
        for made in done:
            _making.remove(made)
        tag_garments()
    return TICK if _making else None


def tag_garments() -> None:
    """Let every garment that is switched on be played again in the frame that stands."""
    for ob in bpy.data.objects:
        if ob.type == "MESH" and ob.wrinkles.enabled:
            ob.update_tag()
