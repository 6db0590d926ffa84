"""Colours that show what a joint does to the garment."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..wrinkle_addon.blender.files import database_folder
from ..wrinkle_addon.blender.influence_colours import paint_influence
from ..wrinkle_addon.blender.matching import check_database
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.write import make_writable
from ..wrinkle_addon.database import WrinkleDatabase
from ..wrinkle_addon.influence import joint_names, measure_influence
from .polls import has_database


class WRINKLE_OT_show_influence(bpy.types.Operator):
    """Colour the garment by how much the chosen joint's samples change its wrinkles"""

    bl_idname = "wrinkle.show_influence"
    bl_label = "Show Influence"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_database(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        settings = garment.wrinkles
        try:
            if garment.data.is_editmode:
                raise ValueError("Leave edit mode first: colours are written to the mesh.")
            database = WrinkleDatabase.open(Path(database_folder(garment)))
            check_database(garment, database.header)
            if not settings.joints:
                raise ValueError("The garment has no joints; set it up again.")
            shown = settings.joints[min(settings.active_joint, len(settings.joints) - 1)].name
            joint_names(database.header, [shown])
            make_writable(garment)
            samples = dict(database.samples())
            paint_influence(garment, measure_influence(database.header, database.rest, samples), shown)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if context.space_data is not None and context.space_data.type == "VIEW_3D":
            context.space_data.shading.color_type = "VERTEX"
        return {"FINISHED"}


classes = (WRINKLE_OT_show_influence,)
