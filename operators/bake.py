"""Bake a garment's database without touching the scene or blocking the window."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender import playback
from ..wrinkle_addon.blender.bake_process import BakeProcess
from ..wrinkle_addon.blender.file_process import FileProcess
from ..wrinkle_addon.blender.properties import active_garment
from .behind_window import BehindWindow, take_down, work_through
from .polls import has_garment, is_idle


class WRINKLE_OT_bake(BehindWindow, bpy.types.Operator):
    """Bake the samples of all chosen joints, or go on where the last bake stopped"""

    bl_idname = "wrinkle.bake"
    bl_label = "Bake Wrinkles"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    stopping = "Baking stopped; finished samples are kept for the next bake."

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_garment(cls, context) and is_idle(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """To the end, with a line for every sample."""
        garment = active_garment(context)
        assert garment is not None
        try:
            with BakeProcess(garment) as process:
                work_through(process)
                return self.done(context, garment, process)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        try:
            process = BakeProcess(garment)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        # What is said of a database that is not finished is another sentence now.
        playback.doubt(garment)
        garment.update_tag()
        return self.start(context, garment, process)

    def done(self, context: bpy.types.Context, garment: bpy.types.Object, process: FileProcess) -> set[str]:
        playback.forget(garment)
        garment.wrinkles.enabled = True
        return {"FINISHED"}

    def dropped(self, context: bpy.types.Context) -> None:
        # What is said of a database is as of before: it has come, gone or changed.
        garment = next((ob for ob in bpy.data.objects if ob.session_uid == self._garment), None)
        if garment is not None:
            playback.forget(garment)
            garment.update_tag()


classes = (WRINKLE_OT_bake,)


def register() -> None:
    """Nothing runs yet."""


def unregister() -> None:
    """Take down what runs with the add-on."""
    take_down()
