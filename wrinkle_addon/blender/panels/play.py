"""Step five: the garment wrinkles with every pose."""

from __future__ import annotations

import bpy
import numpy as np

from .. import playback
from ..file_process import BAKE, process_of
from .layout import GarmentPanel, draw_settings, garment_of, say, settings_column, translated

LEAST_SAID = 0.5
"""A joint that goes less than this beyond its samples is not worth a word [degrees]."""


class WRINKLE_PT_play(GarmentPanel, bpy.types.Panel):
    """Wrinkles with every pose"""

    bl_label = "Play"
    bl_options = set()  # noqa: RUF012 - Blender wants a plain set

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(garment_of(context)[1], "enabled", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, settings) = self.layout, garment_of(context)
        column = settings_column(layout, animated=True)
        column.active = settings.enabled
        column.prop(settings, "formulation")
        column.prop(settings, "strength")
        if 0 <= settings.active_joint < len(settings.joints):
            joint = settings.joints[settings.active_joint]
            column.prop(joint, "strength", text=joint.name, translate=False)
        column.prop_search(settings, "mask", garment, "vertex_groups")
        column.prop(settings, "weights")
        column.prop(settings, "clear_of_body")
        clearance = column.column()
        clearance.active = settings.clear_of_body
        draw_settings(clearance, settings, "clearance")
        column.prop(settings, "worn_over")
        column.prop(settings, "viewport_detail")
        column.prop(settings, "render_detail")
        if settings.enabled:
            _draw_status(context, layout, garment)
        elif not settings.database:
            say(context, layout, "Bake the garment first, or choose the folder of its database.", icon="INFO")


def _draw_status(context: bpy.types.Context, layout: bpy.types.UILayout, garment: bpy.types.Object) -> None:
    status = playback.status(garment)
    if status.error and process_of(garment, BAKE) is None:
        box = layout.box()
        box.alert = True
        say(context, box, status.error, icon="ERROR")
        return
    if status.waits:
        layout.label(text="Getting ready; skinned until then", icon="TIME")
        return
    if status.player is None or garment.wrinkles.flow.replays:
        return
    for name, beyond in status.player.clamped.items():
        angle = float(np.degrees(np.abs(beyond).max()))
        if angle < LEAST_SAID:
            continue
        text = translated("{name} is {angle:.0f}° beyond its samples").format(name=name, angle=angle)
        layout.label(text=text, icon="INFO")
    for note in (status.player.coarse.note, status.player.note):
        if note:
            say(context, layout, note, icon="INFO")
    layout.label(text=status.player.summary)


classes = (WRINKLE_PT_play,)
