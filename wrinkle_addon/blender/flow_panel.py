"""The sidebar's section on recordings: compress one, replay it, and what it cannot do."""

from __future__ import annotations

import bpy

from . import playback
from .file_process import COMPRESS, process_of
from .flow_playback import FlowPlayer
from .panels import WrinklePanel
from .panels.layout import draw_process
from .properties import active_garment


class WRINKLE_PT_flow(WrinklePanel, bpy.types.Panel):
    """A recorded animation of the garment, compressed and replayed"""

    bl_label = "Recording"
    bl_parent_id = "WRINKLE_PT_play"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_garment(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, garment = self.layout, active_garment(context)
        assert garment is not None
        settings = garment.wrinkles.flow
        process = process_of(garment, COMPRESS)
        if process is None:
            layout.operator("wrinkle.compress_flow", icon="FILE_CACHE")
        else:
            draw_process(layout, process)
        layout.prop(settings, "path", text="")
        layout.prop(settings, "replays")
        column = layout.column()
        column.use_property_split = True
        column.active = settings.replays
        for name in ("offset", "speed", "ends", "clear_of_body"):
            column.prop(settings, name)
        column.label(text="Replays what was recorded;", icon="INFO")
        column.label(text="does not react to other motion.", icon="BLANK1")
        player = playback.status(garment).player
        if settings.replays and isinstance(player, FlowPlayer):
            if player.note:
                layout.label(text=player.note, icon="INFO")
            layout.label(text=player.summary)
            _draw_curve(layout, player)


def _draw_curve(layout: bpy.types.UILayout, player: FlowPlayer) -> None:
    """What other errors would cost, as bars."""
    curve = player.flow.header.curve
    if not curve:
        return
    column = layout.column(align=True)
    column.label(text="Size at other errors, about:")
    largest = max(size for size, _ in curve)
    for size, error in curve:
        column.progress(factor=size / max(largest, 1), text=f"{error:.2g} mm: {size / 1e6:.2g} MB")


classes = (WRINKLE_PT_flow,)
