"""Step one: who wears what, and whether it can be baked."""

from __future__ import annotations

import bpy

from ..guess import guess_character
from ..inspection import Finding, findings_of
from ..properties import active_garment
from .layout import GarmentPanel, WrinklePanel, garment_of, say, settings_column, translated


class WRINKLE_PT_character(WrinklePanel, bpy.types.Panel):
    """Garment, body and armature"""

    bl_label = "Character"

    def draw(self, context: bpy.types.Context) -> None:
        layout, garment = self.layout, active_garment(context)
        if garment is None:
            _draw_guess(context, layout)
            return
        settings = garment.wrinkles
        column = layout.column(align=True)
        _role(column, "Garment", garment, "MATCLOTH")
        settings_of_roles = settings_column(column)
        for name, icon in (("body", "MESH_DATA"), ("armature", "ARMATURE_DATA")):
            row = settings_of_roles.row()
            row.alert = getattr(settings, name) is None
            row.prop(settings, name, icon=icon)
        row = layout.row(align=True)
        row.operator("wrinkle.setup_garment", text="Set Up Again", icon="MATCLOTH")
        row.operator("wrinkle.remove_wrinkles", text="", icon="X")
        if garment.library is not None or garment.data.library is not None:
            say(
                context,
                layout,
                "Linked from another file: wrinkles need a mesh of their own here.",
                icon="LIBRARY_DATA_DIRECT",
            )
            layout.operator("wrinkle.make_local_mesh", icon="LIBRARY_DATA_OVERRIDE")


def _draw_guess(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    guess = guess_character(context)
    column = layout.column(align=True)
    _role(column, "Garment", guess.garment, "MATCLOTH")
    _role(column, "Body", guess.body, "MESH_DATA")
    _role(column, "Armature", guess.armature, "ARMATURE_DATA")
    if guess.missing:
        say(context, layout, guess.missing, icon="INFO")
    layout.operator("wrinkle.setup_garment", icon="MATCLOTH")


def _role(layout: bpy.types.UILayout, role: str, ob: bpy.types.Object | None, icon: str) -> None:
    split = layout.split(factor=0.4)
    names = split.row()
    names.alignment = "RIGHT"
    names.label(text=role)
    if ob is None:
        split.label(text="None", icon="QUESTION")
    else:
        split.label(text=ob.name, icon=icon, translate=False)


class WRINKLE_PT_problems(GarmentPanel, bpy.types.Panel):
    """What would stop a bake or playing, and where it is"""

    bl_label = "Check"
    bl_parent_id = "WRINKLE_PT_character"

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        garment, _ = garment_of(context)
        if any(finding.stops for finding in findings_of(garment) or ()):
            self.layout.label(text="", icon="ERROR")

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, _) = self.layout, garment_of(context)
        layout.operator("wrinkle.check_garment", icon="VIEWZOOM")
        findings = findings_of(garment)
        if findings is None:
            say(context, layout, "Not checked as it is now.", icon="INFO")
            return
        if not any(finding.stops for finding in findings):
            layout.label(text="Ready to bake", icon="CHECKMARK")
        for index, finding in enumerate(findings):
            _draw_finding(context, layout, garment, index, finding)


def _draw_finding(
    context: bpy.types.Context, layout: bpy.types.UILayout, garment: bpy.types.Object, index: int, finding: Finding
) -> None:
    box = layout.box()
    say(context, box, finding.text, icon="ERROR" if finding.stops else "INFO")
    if finding.place is not None:
        place = finding.place
        what = ", ".join(place.names) or (
            translated("{count} vertices").format(count=len(place.vertices)) if place.vertices else place.part.value
        )
        shown = box.operator(
            "wrinkle.show_problem", text=translated("Select {what}").format(what=what), icon="RESTRICT_SELECT_OFF"
        )
        shown.garment, shown.index = garment.name, index


classes = (WRINKLE_PT_character, WRINKLE_PT_problems)
