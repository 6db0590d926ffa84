"""Stop what runs behind the window."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.file_process import running
from .polls import is_busy


class WRINKLE_OT_stop_process(bpy.types.Operator):
    """Stop what runs behind the window; finished samples and simulated frames are kept for the next run"""

    bl_idname = "wrinkle.stop_process"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return is_busy(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        # The running operator notices when they have ended.
        for process in running.values():
            process.stop()
        return {"FINISHED"}


classes = (WRINKLE_OT_stop_process,)
