"""Look for whatever would stop a bake or playing."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.inspection import Checked, CheckOrder, conclude_check
from ..wrinkle_addon.blender.properties import active_garment
from .polls import has_garment
from .thread_behind_window import ThreadBehindWindow


class WRINKLE_OT_check_garment(ThreadBehindWindow, bpy.types.Operator):
    """Look for everything that would stop a bake or playing, and list it with where it is"""

    bl_idname = "wrinkle.check_garment"
    bl_label = "Check Garment"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    doing = "Checking the garment"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_garment(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """At once."""
        garment = active_garment(context)
        assert garment is not None
        try:
            return self.made(garment, self._order(garment).make())
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Behind the window, for as long as it takes."""
        garment = active_garment(context)
        assert garment is not None
        return self.start(context, garment, self._order(garment).make)

    def _order(self, garment: bpy.types.Object) -> CheckOrder:
        with suspended():
            return CheckOrder.of(garment)

    def made(self, garment: bpy.types.Object, made: Checked) -> set[str]:
        with suspended():
            findings = conclude_check(garment, made)
        problems = [finding for finding in findings if finding.stops]
        if problems:
            self.report(
                {"WARNING"}, problems[0].text if len(problems) == 1 else f"{len(problems)} problems were found."
            )
        else:
            self.report({"INFO"}, "Nothing stands in the way of a bake.")
        return {"FINISHED"}


classes = (WRINKLE_OT_check_garment,)
