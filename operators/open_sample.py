"""A sample as a mesh, for any of Blender's tools."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.samples import chosen_sample, open_sample
from .polls import has_database


class WRINKLE_OT_open_sample(bpy.types.Operator):
    """Open the sample as a mesh, to be sculpted or changed with any tool that moves vertices"""

    bl_idname = "wrinkle.open_sample"
    bl_label = "Open Sample as Mesh"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_database(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        try:
            if garment.data.is_editmode:
                raise ValueError("Leave edit mode first.")
            with suspended():
                opened = open_sample(garment, *chosen_sample(garment))
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for ob in context.selected_objects:
            ob.select_set(False)
        garment.hide_set(True)
        opened.select_set(True)
        context.view_layer.objects.active = opened
        return {"FINISHED"}


classes = (WRINKLE_OT_open_sample,)
