"""Bake the coarse simulation of a character over the scene's frames."""

from __future__ import annotations

from contextlib import ExitStack

import bpy

from ..wrinkle_addon.blender import playback
from ..wrinkle_addon.blender.coarse_scene import SIMULATION
from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.preferences import device_name
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.simulate_coarse import CoarseBake, bake_coarse
from ..wrinkle_addon.folder_verbs import choose_device
from .polls import has_garment


class WRINKLE_OT_simulate_coarse(bpy.types.Operator):
    """Simulate the coarse layers of this character over the scene's frames; frames that still fit are kept"""

    bl_idname = "wrinkle.simulate_coarse"
    bl_label = "Simulate"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not has_garment(cls, context):
            return False
        garment = active_garment(context)
        assert garment is not None
        if garment.wrinkles.coarse_layer != SIMULATION:
            cls.poll_message_set("Let the garment follow a simulation first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """To the end."""
        try:
            with suspended():
                bake = self._prepare(context)
                kept = sum(step.kept for step in bake.frames)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self._finish(context, bake, kept)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Frame by frame in the window, until it is done or Esc is pressed; the next run goes on from there."""
        self._open = ExitStack()
        self._open.enter_context(suspended())
        try:
            self._bake, self._kept = self._prepare(context), 0
        except ValueError as error:
            self._open.close()
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._open.callback(self._bake.frames.close)
        self._timer = context.window_manager.event_timer_add(0.0, window=context.window)
        self._open.callback(context.window_manager.event_timer_remove, self._timer)
        self._open.callback(context.workspace.status_text_set, None)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC":
            self.cancel(context)
            self.report({"INFO"}, "Simulating stopped; finished frames are kept for the next run.")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"}
        try:
            step = next(self._bake.frames, None)
        except ValueError as error:
            self.cancel(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if step is None:
            self.cancel(context)
            return self._finish(context, self._bake, self._kept)
        self._kept += step.kept
        context.workspace.status_text_set(f"Simulating frame {step.frame} of {self._bake.last}. Esc stops.")
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Leave nothing running; also called when another file is opened."""
        self._open.close()

    def _prepare(self, context: bpy.types.Context) -> CoarseBake:
        garment, scene = active_garment(context), context.scene
        assert garment is not None
        bake = bake_coarse(garment, scene.frame_start, scene.frame_end, choose_device(device_name()))
        if bake.reason:
            self.report({"INFO"}, bake.reason)
        return bake

    def _finish(self, context: bpy.types.Context, bake: CoarseBake, kept: int) -> set[str]:
        self.report({"INFO"}, f"{bake.last - bake.first + 1 - kept} frames simulated, {kept} kept")
        for name in bake.garments:
            playback.forget(bpy.data.objects[name])
        context.scene.frame_set(context.scene.frame_current)
        return {"FINISHED"}


classes = (WRINKLE_OT_simulate_coarse,)
