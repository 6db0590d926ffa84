"""Step two: the joints that wrinkle the garment."""

from __future__ import annotations

import json

import bpy

from ..plan_preview import preview_plan
from ..properties import GarmentSettings, JointSettings
from .layout import GarmentPanel, axis_names, garment_of, say, settings_column, translated


class WRINKLE_UL_joints(bpy.types.UIList):
    """Joints of a garment"""

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: GarmentSettings,
        item: JointSettings,
        icon: int,
        active_data: GarmentSettings,
        active_property: str,
    ) -> None:
        row = layout.row(align=True)
        row.prop(item, "enabled", text="")
        row.label(text=item.name, translate=False)
        side = row.row(align=True)
        side.active = item.enabled
        side.alignment = "RIGHT"
        side.label(text="Hinge" if json.loads(item.definition)["dof"] == 1 else "Ball")
        side.prop(item, "strength", text="", emboss=False)


class WRINKLE_PT_joints(GarmentPanel, bpy.types.Panel):
    """Joints that wrinkle the garment"""

    bl_label = "Joints"
    bl_options = set()  # noqa: RUF012 - Blender wants a plain set

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, settings) = self.layout, garment_of(context)
        if not settings.joints:
            say(context, layout, "No joint that was found moves this garment.", icon="ERROR")
        layout.template_list("WRINKLE_UL_joints", "", settings, "joints", settings, "active_joint", rows=5)
        if 0 <= settings.active_joint < len(settings.joints):
            _draw_joint(context, layout, garment, settings.joints[settings.active_joint])
        column = layout.column(align=True)
        column.operator("wrinkle.mirror_joint", icon="MOD_MIRROR")
        column.operator("wrinkle.take_ranges", icon="ACTION")
        column.operator("wrinkle.show_influence", icon="COLOR")
        for note in settings.notes.splitlines():
            say(context, layout, note, icon="INFO")


def _draw_joint(
    context: bpy.types.Context, layout: bpy.types.UILayout, garment: bpy.types.Object, joint: JointSettings
) -> None:
    definition = json.loads(joint.definition)
    say(context, layout, ", ".join(definition["bones"]), icon="BONE_DATA", translate=False)
    preview = preview_plan(garment)
    counts = preview.grids.get(joint.name) if preview else None
    for axis, name in enumerate(axis_names(joint)):
        row = layout.row(align=True)
        row.label(text=name)
        row.prop(joint, "low", index=axis, text="")
        row.prop(joint, "high", index=axis, text="")
        row.label(text="" if counts is None else f"\N{MULTIPLICATION SIGN} {counts[axis]}", translate=False)
    if garment.wrinkles.plan == "PAPER":
        settings_column(layout).prop(joint, "step")
    if counts is None:
        layout.label(text=translated("Not sampled: switched off in the list"), icon="INFO")


classes = (WRINKLE_UL_joints, WRINKLE_PT_joints)
