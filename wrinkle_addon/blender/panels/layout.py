"""What all steps of the sidebar share: where they are, and sentences that fit into its width."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence

import bpy

from ..file_process import BAKE, FileProcess
from ..properties import GarmentSettings, JointSettings, active_garment

translated = bpy.app.translations.pgettext_iface
"""Labels that hold numbers are translated before they are filled in."""

UNITS = ("m", "mm", "s", "1/s", "N/m", "N m", "kg/m²")
"""Named last in a tooltip; what Blender scales by the scene's own units would no longer be what is simulated."""


class WrinklePanel:
    """Where all our panels are."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Wrinkle"


class GarmentPanel(WrinklePanel):
    """A step that there is a garment for."""

    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_garment(context) is not None


def garment_of(context: bpy.types.Context) -> tuple[bpy.types.Object, GarmentSettings]:
    """The garment that a panel is about, and its settings."""
    garment = active_garment(context)
    assert garment is not None
    return garment, garment.wrinkles


def axis_names(joint: JointSettings) -> Sequence[str]:
    """What the joint's degrees of freedom are called."""
    return ("Bend",) if json.loads(joint.definition)["dof"] == 1 else ("Twist", "Swing 1", "Swing 2")


def settings_column(layout: bpy.types.UILayout, *, animated: bool = False) -> bpy.types.UILayout:
    """A column of named settings, as Blender's own panels have them."""
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, animated
    return column


def draw_settings(column: bpy.types.UILayout, settings: bpy.types.PropertyGroup, *names: str) -> None:
    """Settings one below the other, each with the unit that its tooltip ends with."""
    for name in names:
        described = settings.bl_rna.properties[name]
        unit = described.description.rpartition(", ")[2]
        if unit in UNITS:
            column.prop(settings, name, text=f"{translated(described.name)} ({unit})", translate=False)
        else:
            column.prop(settings, name)


def say(
    context: bpy.types.Context, layout: bpy.types.UILayout, text: str, icon: str = "NONE", *, translate: bool = True
) -> None:
    """A sentence over as many lines as the sidebar's width asks for."""
    scale = context.preferences.system.ui_scale
    characters = max(20, int(context.region.width / (7.0 * scale)) - 4)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(textwrap.wrap(translated(text) if translate else text, characters)):
        column.label(text=line, icon=icon if number == 0 else "NONE", translate=False)


def say_numbers(layout: bpy.types.UILayout, numbers: dict[str, str]) -> None:
    """Names and values in two columns."""
    split = layout.split(factor=0.4)
    names, values = split.column(align=True), split.column(align=True)
    names.alignment = "RIGHT"
    for name, value in numbers.items():
        names.label(text=name)
        values.label(text=value, translate=False)


def draw_process(layout: bpy.types.UILayout, process: FileProcess) -> None:
    """How far a process is that works behind the window, and a button that stops it."""
    progress = process.progress
    layout.progress(factor=progress.share, text=translated("Stopping") if process.stopped else progress.text)
    row = layout.row(align=True)
    if process.verb == BAKE:
        row.operator(
            "wrinkle.pause_bake",
            text="Go On" if process.paused else "Pause",
            icon="PLAY" if process.paused else "PAUSE",
        )
    row.operator("wrinkle.stop_process", icon="CANCEL")
    # Its row is there from the start, so that nothing below it is moved.
    layout.label(text=progress.last, icon="CHECKMARK" if progress.last else "NONE", translate=False)
