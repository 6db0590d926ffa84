"""Let a bake that runs behind the window wait, and go on."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.file_process import BAKE, running
from .polls import bakes


class WRINKLE_OT_pause_bake(bpy.types.Operator):
    """Wait when the sample in work is finished, or go on with the next one"""

    bl_idname = "wrinkle.pause_bake"
    bl_label = "Pause Baking"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bakes(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        for process in running.values():
            if process.verb == BAKE:
                (process.go_on if process.paused else process.pause)()
        return {"FINISHED"}


classes = (WRINKLE_OT_pause_bake,)
