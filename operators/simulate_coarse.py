"""Bake the coarse simulation of a character over the scene's frames."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..wrinkle_addon.blender import playback
from ..wrinkle_addon.blender.coarse_playing import played_cache
from ..wrinkle_addon.blender.coarse_scene import SIMULATION, cache_folder
from ..wrinkle_addon.blender.file_process import SIMULATE, FileProcess
from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.preferences import device_name
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.simulate_coarse import bake_coarse
from ..wrinkle_addon.folder_verbs import choose_device
from .behind_window import BehindWindow
from .polls import has_garment, is_idle


class WRINKLE_OT_simulate_coarse(BehindWindow, bpy.types.Operator):
    """Simulate the coarse layers of this character over the scene's frames; frames that still fit are kept"""

    bl_idname = "wrinkle.simulate_coarse"
    bl_label = "Simulate"

    stopping = "Simulating stopped; finished frames are kept for the next run."

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not has_garment(cls, context) or not is_idle(cls):
            return False
        garment = active_garment(context)
        assert garment is not None
        if garment.wrinkles.coarse_layer != SIMULATION:
            cls.poll_message_set("Let the garment follow a simulation first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """To the end."""
        garment, scene = active_garment(context), context.scene
        assert garment is not None
        try:
            with suspended():
                bake = bake_coarse(garment, scene.frame_start, scene.frame_end, choose_device(device_name()))
                kept = sum(step.kept for step in bake.frames)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self._show(context, bake.reason, bake.garments, bake.last - bake.first + 1 - kept, kept)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Behind the window; when it is stopped, the next run goes on from there."""
        garment, scene = active_garment(context), context.scene
        assert garment is not None
        arguments = ["--device", device_name(), f"--frames={scene.frame_start}:{scene.frame_end}"]
        try:
            # A folder that cannot be is said at once.
            cache_folder(garment)
            process = FileProcess(garment, SIMULATE, arguments, doing="Simulating the coarse layer")
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self.start(context, garment, process)

    def done(self, context: bpy.types.Context, garment: bpy.types.Object, process: FileProcess) -> set[str]:
        told = process.result
        return self._show(context, told["replaced"], told["garments"], told["simulated"], told["kept"])

    def _show(
        self, context: bpy.types.Context, reason: str, garments: Iterable[str], simulated: int, kept: int
    ) -> set[str]:
        if reason:
            self.report({"INFO"}, reason)
        self.report({"INFO"}, f"{simulated} frames simulated, {kept} kept")
        for garment in filter(None, map(bpy.data.objects.get, garments)):
            # What it is bound to is as it was; only the frames are other ones.
            played_cache(cache_folder(garment)).renew()
            playback.doubt(garment)
        context.scene.frame_set(context.scene.frame_current)
        return {"FINISHED"}


classes = (WRINKLE_OT_simulate_coarse,)
