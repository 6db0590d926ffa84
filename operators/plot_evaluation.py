"""The kept evaluation, as pictures in the Image Editor."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.evaluation_charts import draw_evaluation
from ..wrinkle_addon.blender.properties import active_garment
from .polls import has_samples


class WRINKLE_OT_plot_evaluation(bpy.types.Operator):
    """Draw error and curvature over the evaluated frames as images for the Image Editor"""

    bl_idname = "wrinkle.plot_evaluation"
    bl_label = "Plot Evaluation"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_samples(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        try:
            images = list(draw_evaluation(context, garment))
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{', '.join(images)}: open them in the Image Editor.")
        return {"FINISHED"}


classes = (WRINKLE_OT_plot_evaluation,)
