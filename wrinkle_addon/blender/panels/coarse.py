"""Step six: what the garment follows where it moves as a whole."""

from __future__ import annotations

import bpy

from ..coarse_layer import NONE
from ..coarse_scene import SIMULATION
from ..file_process import SIMULATE, process_of
from .layout import GarmentPanel, draw_process, draw_settings, garment_of, settings_column


class WRINKLE_PT_coarse(GarmentPanel, bpy.types.Panel):
    """What the garment follows where it moves as a whole"""

    bl_label = "Coarse Layer"

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, settings) = self.layout, garment_of(context)
        layout.operator("wrinkle.make_coarse_mesh", icon="MOD_DECIM")
        column = settings_column(layout, animated=True)
        column.prop(settings, "coarse_layer", text="Follow")
        if settings.coarse_layer != NONE:
            column.prop(settings, "coarse")
            column.prop(settings, "follow", text="How Far")
        if settings.coarse_layer == SIMULATION:
            column.separator()
            simulated = "coarse_buffer", "coarse_damping", "coarse_pre_roll", "coarse_proxy"
            draw_settings(column, settings, "coarse_cache", "coarse_order", "coarse_steps", *simulated)
            process = process_of(garment, SIMULATE)
            if process is None:
                layout.operator("wrinkle.simulate_coarse", icon="PHYSICS")
            else:
                draw_process(layout, process)


classes = (WRINKLE_PT_coarse,)
