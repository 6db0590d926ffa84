"""A corrected sample as it was baked."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.samples import restore_sample
from .polls import has_database


class WRINKLE_OT_restore_sample(bpy.types.Operator):
    """Let the sample count as it was baked; its corrections stay in the database's folder"""

    bl_idname = "wrinkle.restore_sample"
    bl_label = "Restore Baked Sample"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_database(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        try:
            sample = restore_sample(garment)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{sample.name} is as it was baked.")
        return {"FINISHED"}


classes = (WRINKLE_OT_restore_sample,)
