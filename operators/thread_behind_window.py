"""Operators whose work a thread does behind the window: on arrays alone, and done in a second or two."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import bpy

from ..wrinkle_addon.blender.made_behind import submit

TICK = 0.1
"""Time between two looks at what is being made [s]."""


class ThreadBehindWindow:
    """A modal operator that waits for what a thread makes of a garment, and goes on with it in the window.

    Attributes:
        doing: What it does, for the status bar.
    """

    doing: str

    if TYPE_CHECKING:
        report: Callable[[set[str], str], None]

    def start(self, context: bpy.types.Context, garment: bpy.types.Object, make: Callable[[], Any]) -> set[str]:
        """Go on in the window meanwhile; ``make`` must not touch Blender's data."""
        self._garment, self._made = garment.session_uid, submit(make)
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f"{self.doing}. Esc stops.")
        return {"RUNNING_MODAL"}

    def made(self, garment: bpy.types.Object, made: Any) -> set[str]:
        """Put what was made where it belongs.

        Raises:
            ValueError: One sentence.
        """
        raise NotImplementedError

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        garment = next((ob for ob in bpy.data.objects if ob.session_uid == self._garment), None)
        if event.type == "ESC" or garment is None:
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "TIMER" or not self._made.done():
            return {"PASS_THROUGH"}
        self.cancel(context)
        try:
            return self.made(garment, self._made.result())
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Leave no timer behind; also called when another file is opened."""
        context.window_manager.event_timer_remove(self._timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)
