"""Step three: how many samples, of what cloth, at what price."""

from __future__ import annotations

import json

import bpy

from ...folder_verbs import choose_device
from ..inspection import found_on
from ..plan_preview import preview_plan
from ..preferences import device_name
from ..presets import WRINKLE_PT_fabric_presets, WRINKLE_PT_plan_presets
from ..properties import OWN_FABRIC
from ..shape_marks import same_shapes
from .layout import GarmentPanel, draw_settings, garment_of, say, say_numbers, settings_column, translated


class WRINKLE_PT_plan(GarmentPanel, bpy.types.Panel):
    """The samples that a bake makes, and what they cost"""

    bl_label = "Plan"
    bl_options = set()  # noqa: RUF012 - Blender wants a plain set

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        WRINKLE_PT_plan_presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, settings) = self.layout, garment_of(context)
        column = settings_column(layout)
        column.prop(settings, "plan")
        if settings.plan == "BUDGET":
            column.prop(settings, "budget")
        column.prop(settings, "use_symmetry")
        found = found_on(garment)
        preview = preview_plan(garment, found and found.plan)
        if preview is None:
            say(context, layout, "Nothing to sample: switch a joint on in the list of joints.", icon="ERROR")
            return
        numbers = {"To Simulate": translated("{count} and the rest pose").format(count=preview.simulated - 1)}
        if preview.mirrored:
            numbers["Mirrored"] = str(preview.mirrored)
        numbers["Size"] = translated("about {size:.1f} MB").format(size=max(preview.megabytes, 0.1))
        numbers["On One Core"] = translated("about {time}").format(time=preview.duration)
        try:
            numbers["Device"] = choose_device(device_name())
        except ValueError as error:
            say(context, layout, str(error), icon="ERROR")
        say_numbers(layout, numbers)
        if preview.left_out:
            say(context, layout, preview.left_out, icon="INFO")
        if settings.use_symmetry and not same_shapes(json.loads(settings.symmetry_marks or "[]"), garment):
            say(context, layout, "The character's shape has changed: Check looks anew which side mirrors which.")
        elif settings.use_symmetry and not settings.mirror_signs:
            say(context, layout, "Both sides are simulated.", icon="INFO")
            say(context, layout, settings.asymmetry or "Set the garment up again to see why.")


class WRINKLE_PT_fabric(GarmentPanel, bpy.types.Panel):
    """What the garment is made of, and how it is worn"""

    bl_label = "Fabric"
    bl_parent_id = "WRINKLE_PT_plan"

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        WRINKLE_PT_fabric_presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        garment, settings = garment_of(context)
        column = settings_column(self.layout)
        own = ("stretch", "bending", "density", "friction") if settings.fabric == OWN_FABRIC else ()
        draw_settings(column, settings, "fabric", *own, "ease_girth", "ease_length")
        column.prop_search(settings, "pin_group", garment, "vertex_groups")


classes = (WRINKLE_PT_plan, WRINKLE_PT_fabric)
