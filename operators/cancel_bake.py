"""Stop a bake that runs behind the window."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.bake_process import running
from .polls import bakes


class WRINKLE_OT_cancel_bake(bpy.types.Operator):
    """Stop baking; finished samples are kept for the next bake"""

    bl_idname = "wrinkle.cancel_bake"
    bl_label = "Stop Baking"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bakes(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        # The running operator notices at its next tick.
        running.clear()
        return {"FINISHED"}


classes = (WRINKLE_OT_cancel_bake,)
