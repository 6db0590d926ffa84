"""Presets of fabric and plan, stored and shared as all of Blender's presets are."""

from __future__ import annotations

from pathlib import Path

import bpy
from bl_ui.utils import PresetPanel

FOLDER = Path(__file__).resolve().parents[2] / "presets"
"""Presets that come with the add-on."""
FABRIC, PLAN = "wrinkle_synthesis/fabric", "wrinkle_synthesis/plan"


class WRINKLE_PT_fabric_presets(PresetPanel, bpy.types.Panel):
    """Fabrics that were stored"""

    bl_label = "Fabric Presets"
    preset_subdir = FABRIC
    preset_operator = "wrinkle.apply_preset"
    preset_add_operator = "wrinkle.add_fabric_preset"


class WRINKLE_PT_plan_presets(PresetPanel, bpy.types.Panel):
    """Plans that were stored"""

    bl_label = "Plan Presets"
    preset_subdir = PLAN
    preset_operator = "wrinkle.apply_preset"
    preset_add_operator = "wrinkle.add_plan_preset"


classes = (WRINKLE_PT_fabric_presets, WRINKLE_PT_plan_presets)


def register() -> None:
    bpy.utils.register_preset_path(str(FOLDER.parent))


def unregister() -> None:
    bpy.utils.unregister_preset_path(str(FOLDER.parent))
