"""The kept evaluation, as pictures in the Image Editor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy
import numpy as np

from ..wrinkle_addon.blender.charts import Chart, show_charts
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.samples import open_database
from ..wrinkle_addon.evaluation_record import read_evaluation
from .polls import has_database

METHODS = ("ours", "skinning")
"""Whose figures are drawn, side by side."""


class WRINKLE_OT_plot_evaluation(bpy.types.Operator):
    """Draw error and curvature over the evaluated frames as images for the Image Editor"""

    bl_idname = "wrinkle.plot_evaluation"
    bl_label = "Plot Evaluation"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_database(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        try:
            database = open_database(garment)
            result = read_evaluation(database.folder, database.header.key)
            if result is None:
                raise ValueError("There is no evaluation yet: run wrinkle evaluate with --keep on the command line.")
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        images = show_charts(context, garment.name, _charts(result["frames"]))
        self.report({"INFO"}, f"{', '.join(images)}: open them in the Image Editor.")
        return {"FINISHED"}


def _charts(frames: list[Mapping[str, Any]]) -> dict[str, Chart]:
    groups = [(len(METHODS) * number, f"{frame['frame']:g}") for number, frame in enumerate(frames)]
    errors = np.array([frame["rmse_mm"][name] for frame in frames for name in METHODS])
    bent = np.array([frame["curvature"][name] for frame in frames for name in ("ours", "reference")])
    second = np.tile([False, True], len(frames))
    return {
        "error": Chart("RMS error by frame, mm: blue with wrinkles, orange skinning alone", errors, second, groups),
        "wrinkles": Chart("Sum of mean curvature by frame, 1/m: blue ours, orange the reference", bent, second, groups),
    }


classes = (WRINKLE_OT_plot_evaluation,)
