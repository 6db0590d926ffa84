"""Bake a garment's database without touching the scene or blocking the window."""

from __future__ import annotations

import sys

import bpy

from ..wrinkle_addon.blender import playback
from ..wrinkle_addon.blender.bake_process import BakeProcess, running
from ..wrinkle_addon.blender.properties import active_garment
from .polls import has_garment, is_idle

TICK = 0.25
"""Time between two looks at the process [s]."""


class WRINKLE_OT_bake(bpy.types.Operator):
    """Bake the samples of all chosen joints, or go on where the last bake stopped"""

    bl_idname = "wrinkle.bake"
    bl_label = "Bake Wrinkles"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_garment(cls, context) and is_idle(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """To the end, with a line for every sample."""
        garment = active_garment(context)
        assert garment is not None
        try:
            with BakeProcess(garment) as process:
                shown = process.progress
                while process.poll(TICK):
                    if process.progress != shown:
                        shown = process.progress
                        print(f"{shown.name}: {shown.text}", file=sys.stderr, flush=True)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return _finish(garment)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """In the background, with progress in the panel and in the status bar."""
        garment = active_garment(context)
        assert garment is not None
        try:
            self._process = BakeProcess(garment)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._garment = garment.session_uid
        running[self._garment] = self._process
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" or self._garment not in running:
            self.cancel(context)
            self.report({"INFO"}, "Baking stopped; finished samples are kept for the next bake.")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            goes_on = self._process.poll()
        except ValueError as error:
            self.cancel(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if goes_on:
            context.workspace.status_text_set(_status(self._process))
            _redraw(context)
            return {"PASS_THROUGH"}
        self.cancel(context)
        garment = next((ob for ob in bpy.data.objects if ob.session_uid == self._garment), None)
        return {"FINISHED"} if garment is None else _finish(garment)

    def cancel(self, context: bpy.types.Context) -> None:
        """Leave nothing running and nothing behind; also called when another file is opened."""
        self._process.close()
        running.pop(self._garment, None)
        context.window_manager.event_timer_remove(self._timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        _redraw(context)


def _finish(garment: bpy.types.Object) -> set[str]:
    """Show what was baked."""
    playback.forget(garment)
    garment.wrinkles.enabled = True
    return {"FINISHED"}


def _status(process: BakeProcess) -> str:
    """For the status bar."""
    progress = process.progress
    doing = "Paused" if process.paused else "Baking wrinkles"
    last = f"; {progress.last_sample}" if progress.name else ""
    return f"{doing}: {progress.text}{last}. Esc stops."


def _redraw(context: bpy.types.Context) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


classes = (WRINKLE_OT_bake,)


def register() -> None:
    """Nothing runs yet."""


def unregister() -> None:
    """Take running bakes down with the add-on."""
    for process in running.values():
        process.close()
    running.clear()
