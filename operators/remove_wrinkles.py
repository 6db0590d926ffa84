"""Take wrinkles off a garment."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.removal import remove_wrinkles
from .polls import has_garment, is_idle


class WRINKLE_OT_remove_wrinkles(bpy.types.Operator):
    """Give the garment back as it was before it was set up; the database stays on disk"""

    bl_idname = "wrinkle.remove_wrinkles"
    bl_label = "Remove Wrinkles"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_garment(cls, context) and is_idle(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        was_active = context.view_layer.objects.active == garment
        try:
            with suspended():
                garment = remove_wrinkles(garment)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if was_active and garment.name in context.view_layer.objects:
            context.view_layer.objects.active = garment
        return {"FINISHED"}


classes = (WRINKLE_OT_remove_wrinkles,)
