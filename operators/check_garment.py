"""Look for whatever would stop a bake or playing."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.inspection import inspect_garment, remember_findings
from ..wrinkle_addon.blender.properties import active_garment
from .polls import has_garment


class WRINKLE_OT_check_garment(bpy.types.Operator):
    """Look for everything that would stop a bake or playing, and list it with where it is"""

    bl_idname = "wrinkle.check_garment"
    bl_label = "Check Garment"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_garment(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        with suspended():
            findings = inspect_garment(garment)
        remember_findings(garment, findings)
        problems = [finding for finding in findings if finding.stops]
        if problems:
            self.report(
                {"WARNING"}, problems[0].text if len(problems) == 1 else f"{len(problems)} problems were found."
            )
        else:
            self.report({"INFO"}, "Nothing stands in the way of a bake.")
        return {"FINISHED"}


classes = (WRINKLE_OT_check_garment,)
