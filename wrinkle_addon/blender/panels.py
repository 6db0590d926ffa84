"""The sidebar of the 3D view: set up, joints, bake, play."""

from __future__ import annotations

import json
import textwrap

import bpy
import numpy as np

from . import playback
from .bake_process import running
from .coarse_layer import NONE
from .coarse_scene import SIMULATION
from .properties import OWN_FABRIC, GarmentSettings, JointSettings, active_garment


class WrinklePanel:
    """Where all our panels are."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Wrinkles"


class WRINKLE_PT_play(WrinklePanel, bpy.types.Panel):
    """Wrinkles of one garment"""

    bl_label = "Wrinkles"

    def draw(self, context: bpy.types.Context) -> None:
        layout, garment = self.layout, active_garment(context)
        layout.operator("wrinkle.setup_garment", icon="MATCLOTH")
        if garment is None:
            _say(context, layout, "Select a garment that was set up, or its armature.")
            return
        settings = garment.wrinkles
        row = layout.row()
        row.prop(settings, "enabled", text=garment.name)
        layout.prop(settings, "database", text="")
        column = layout.column()
        column.use_property_split = True
        column.active = settings.enabled
        column.prop(settings, "strength")
        column.prop_search(settings, "mask", garment, "vertex_groups")
        column.prop(settings, "formulation")
        column.prop(settings, "weights")
        row = column.row(heading="Clear of Body")
        row.prop(settings, "clear_of_body", text="")
        clearance = row.row()
        clearance.active = settings.clear_of_body
        clearance.prop(settings, "clearance", text="")
        layout.operator("wrinkle.write_clip", icon="EXPORT")
        if settings.enabled:
            _draw_status(context, layout, garment)


def _draw_status(context: bpy.types.Context, layout: bpy.types.UILayout, garment: bpy.types.Object) -> None:
    status = playback.status(garment)
    if status.error:
        box = layout.box()
        box.alert = True
        _say(context, box, status.error, icon="ERROR")
        return
    if status.player is None or garment.wrinkles.flow.replays:
        return
    for name, beyond in status.player.clamped.items():
        angle = float(np.degrees(np.abs(beyond).max()))
        layout.label(text=f"{name} is {angle:.0f}° beyond its samples", icon="INFO")
    for note in (status.player.coarse.note, status.player.note):
        if note:
            _say(context, layout, note, icon="INFO")
    layout.label(text=status.player.summary)


class WRINKLE_UL_joints(bpy.types.UIList):
    """Joints of a garment."""

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
        row.label(text=item.name)
        row.prop(item, "strength", text="", emboss=False)


class WRINKLE_PT_joints(WrinklePanel, bpy.types.Panel):
    """Joints that wrinkle the garment"""

    bl_label = "Joints"
    bl_parent_id = "WRINKLE_PT_play"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_garment(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, garment = self.layout, active_garment(context)
        assert garment is not None
        settings = garment.wrinkles
        layout.template_list("WRINKLE_UL_joints", "", settings, "joints", settings, "active_joint", rows=5)
        if 0 <= settings.active_joint < len(settings.joints):
            _draw_joint(context, layout, settings.joints[settings.active_joint])
        layout.operator("wrinkle.take_ranges", icon="ACTION")
        layout.operator("wrinkle.show_influence", icon="COLOR")
        for note in settings.notes.splitlines():
            _say(context, layout, note, icon="INFO")


def _draw_joint(context: bpy.types.Context, layout: bpy.types.UILayout, joint: JointSettings) -> None:
    definition = json.loads(joint.definition)
    _say(context, layout, f"Bones: {', '.join(definition['bones'])}")
    axes = ("Bend",) if definition["dof"] == 1 else ("Twist", "Swing 1", "Swing 2")
    for axis, name in enumerate(axes):
        row = layout.row(align=True)
        row.label(text=name)
        row.prop(joint, "low", index=axis, text="")
        row.prop(joint, "high", index=axis, text="")


class WRINKLE_PT_coarse(WrinklePanel, bpy.types.Panel):
    """What the garment follows where it moves as a whole"""

    bl_label = "Coarse Layer"
    bl_parent_id = "WRINKLE_PT_play"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_garment(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, garment = self.layout, active_garment(context)
        assert garment is not None
        settings = garment.wrinkles
        layout.operator("wrinkle.make_coarse_mesh", icon="MOD_DECIM")
        column = layout.column()
        column.use_property_split = True
        column.prop(settings, "coarse_layer", text="Follow")
        if settings.coarse_layer != NONE:
            column.prop(settings, "coarse")
            column.prop(settings, "follow", text="How Far")
        if settings.coarse_layer == SIMULATION:
            column.separator()
            for name in ("coarse_cache", "coarse_order", "coarse_steps", "coarse_buffer", "coarse_damping"):
                column.prop(settings, name)
            for name in ("coarse_pre_roll", "coarse_proxy"):
                column.prop(settings, name)
            layout.operator("wrinkle.simulate_coarse", icon="PHYSICS")


class WRINKLE_PT_bake(WrinklePanel, bpy.types.Panel):
    """The bake, and what it samples"""

    bl_label = "Bake"
    bl_parent_id = "WRINKLE_PT_play"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_garment(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, garment = self.layout, active_garment(context)
        assert garment is not None
        process = running.get(garment.session_uid)
        if process is None:
            layout.operator("wrinkle.bake", icon="RENDER_ANIMATION")
        else:
            progress = process.progress
            row = layout.row(align=True)
            row.progress(factor=progress.done / max(progress.total, 1), text=progress.text)
            row.operator("wrinkle.cancel_bake", text="", icon="CANCEL")
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(garment.wrinkles, "plan")
        if garment.wrinkles.plan == "BUDGET":
            column.prop(garment.wrinkles, "budget")
        column.prop(garment.wrinkles, "use_symmetry")


class WRINKLE_PT_fabric(WrinklePanel, bpy.types.Panel):
    """What the garment is made of, and how it is worn"""

    bl_label = "Fabric"
    bl_parent_id = "WRINKLE_PT_bake"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender wants a plain set

    def draw(self, context: bpy.types.Context) -> None:
        garment = active_garment(context)
        assert garment is not None
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        own = ("stretch", "bending", "density", "friction") if garment.wrinkles.fabric == OWN_FABRIC else ()
        for name in ("ease_girth", "ease_length", "fabric", *own):
            column.prop(garment.wrinkles, name)
        column.prop_search(garment.wrinkles, "pin_group", garment, "vertex_groups")


def _say(context: bpy.types.Context, layout: bpy.types.UILayout, text: str, icon: str = "NONE") -> None:
    """A sentence over as many lines as the sidebar's width asks for."""
    scale = context.preferences.system.ui_scale
    characters = max(20, int(context.region.width / (7.0 * scale)) - 4)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(textwrap.wrap(text, characters)):
        column.label(text=line, icon=icon if number == 0 else "NONE")


classes = (
    WRINKLE_UL_joints,
    WRINKLE_PT_play,
    WRINKLE_PT_joints,
    WRINKLE_PT_coarse,
    WRINKLE_PT_bake,
    WRINKLE_PT_fabric,
)
