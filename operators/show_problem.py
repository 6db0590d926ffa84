"""Take the artist to where something is wrong."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.inspection import findings_of, show_place
from ..wrinkle_addon.blender.properties import active_garment


class WRINKLE_OT_show_problem(bpy.types.Operator):
    """Select the vertices, the bones or the object where this is wrong"""

    bl_idname = "wrinkle.show_problem"
    bl_label = "Select the Place"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    garment: bpy.props.StringProperty(options={"HIDDEN"}, description="Left out, the active one")
    index: bpy.props.IntProperty(name="Problem", min=0, options={"HIDDEN"}, description="Its place in the list")

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = bpy.data.objects.get(self.garment) or active_garment(context)
        findings = (None if garment is None else findings_of(garment)) or []
        if garment is None or self.index >= len(findings) or findings[self.index].place is None:
            self.report({"ERROR"}, "The list is out of date; check the garment again.")
            return {"CANCELLED"}
        try:
            show_place(context, garment, findings[self.index].place)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


classes = (WRINKLE_OT_show_problem,)
