"""Store and apply presets of fabric and plan."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase

from ..wrinkle_addon.blender.presets import FABRIC, PLAN


def _is_garment_active(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Presets name the active object, which must be the garment itself."""
    if context.object is None or context.object.wrinkles.armature is None:
        operator.poll_message_set("Make the garment itself the active object")
        return False
    return True


class GarmentPreset(AddPresetBase):
    """A preset of the active garment's settings; its file names them as ``wrinkles.NAME``."""

    bl_options = {"REGISTER"}  # noqa: RUF012 - Blender wants a plain set
    preset_defines = ["wrinkles = bpy.context.object.wrinkles"]  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _is_garment_active(cls, context)


class WRINKLE_OT_add_fabric_preset(GarmentPreset, bpy.types.Operator):
    """Store the fabric of the garment as a preset, or remove one"""

    bl_idname = "wrinkle.add_fabric_preset"
    bl_label = "Add Fabric Preset"
    preset_menu = "WRINKLE_PT_fabric_presets"
    preset_subdir = FABRIC
    preset_values = [  # noqa: RUF012
        f"wrinkles.{name}"
        for name in ("fabric", "stretch", "bending", "density", "friction", "ease_girth", "ease_length")
    ]


class WRINKLE_OT_add_plan_preset(GarmentPreset, bpy.types.Operator):
    """Store the plan of the garment as a preset, or remove one"""

    bl_idname = "wrinkle.add_plan_preset"
    bl_label = "Add Plan Preset"
    preset_menu = "WRINKLE_PT_plan_presets"
    preset_subdir = PLAN
    preset_values = [f"wrinkles.{name}" for name in ("plan", "budget", "use_symmetry")]  # noqa: RUF012


class WRINKLE_OT_apply_preset(bpy.types.Operator):
    """Apply a preset to the active garment"""

    bl_idname = "wrinkle.apply_preset"
    bl_label = "Apply Preset"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    filepath: bpy.props.StringProperty(
        subtype="FILE_PATH", options={"SKIP_SAVE", "HIDDEN"}, description="The preset's file"
    )
    menu_idname: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"}, description="The menu that shows its name")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _is_garment_active(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return bpy.ops.script.execute_preset(filepath=self.filepath, menu_idname=self.menu_idname)


classes = (WRINKLE_OT_add_fabric_preset, WRINKLE_OT_add_plan_preset, WRINKLE_OT_apply_preset)
