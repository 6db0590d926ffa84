"""Steps seven and eight: the clip as a cache that plays without the add-on, and as a file for others."""

from __future__ import annotations

import bpy

from ..clip_synthesis import CACHE
from ..file_process import SYNTHESIZE, process_of
from .layout import GarmentPanel, draw_process, garment_of, say


class WRINKLE_PT_cache(GarmentPanel, bpy.types.Panel):
    """Write the clip into a point cache that Blender's own Mesh Cache modifier plays"""

    bl_label = "Cache"

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, _) = self.layout, garment_of(context)
        if (process := process_of(garment, SYNTHESIZE)) is not None:
            draw_process(layout, process)
            return
        written = layout.operator("wrinkle.write_clip", text="Write Point Cache", icon="FILE_CACHE")
        written.play = True
        cache = next((modifier for modifier in garment.modifiers if modifier.type == "MESH_CACHE"), None)
        if cache is None:
            say(context, layout, "A farm renders the cache without the add-on.", icon="INFO")
            return
        row = layout.row(align=True)
        row.prop(cache, "filepath", text="")
        row.prop(cache, "show_viewport", text="")
        row.prop(cache, "show_render", text="")


class WRINKLE_PT_export(GarmentPanel, bpy.types.Panel):
    """Write the wrinkled garment for other programs"""

    bl_label = "Export"

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        for suffix, name in ((".abc", "Alembic"), (".usdc", "USD"), (CACHE, "Point Cache")):
            column.operator("wrinkle.write_clip", text=name, icon="EXPORT").suffix = suffix


classes = (WRINKLE_PT_cache, WRINKLE_PT_export)
