"""How the samples came out, as pictures in the Image Editor."""

from __future__ import annotations

import bpy
import numpy as np

from ..wrinkle_addon.blender.charts import Chart, draw_charts
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.samples import open_database
from ..wrinkle_addon.database import WrinkleDatabase
from ..wrinkle_addon.surface import SurfaceMeasures
from .polls import has_database


class WRINKLE_OT_plot_samples(bpy.types.Operator):
    """Draw the residual and the curvature of every sample as images for the Image Editor"""

    bl_idname = "wrinkle.plot_samples"
    bl_label = "Plot Samples"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_database(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        try:
            charts = _charts(open_database(garment))
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        images = list(draw_charts(context, garment.name, charts))
        self.report({"INFO"}, f"{', '.join(images)}: open them in the Image Editor.")
        return {"FINISHED"}


def _charts(database: WrinkleDatabase) -> dict[str, Chart]:
    samples = list(database.samples())
    residuals = np.array([stored.report.get("residual", 0.0) for _, stored in samples], np.float64)
    restless = np.array([not stored.report.get("converged", True) for _, stored in samples])
    names = [sample.joint for sample, _ in samples]
    groups = [(number, name) for number, name in enumerate(names) if number == 0 or names[number - 1] != name]
    measures = SurfaceMeasures(database.header.garment.faces, database.header.garment.vertex_count)

    def curvature(positions: np.ndarray) -> float:
        return float(measures.mean_curvature(positions).sum(dtype=np.float64))

    at_rest = curvature(database.rest)
    bent = np.array([curvature(database.positions(sample)) for sample, _ in samples])
    return {
        "residual": Chart("Force left on a vertex, in nodal weights; orange: not at rest", residuals, restless, groups),
        "curvature": Chart(
            f"Sum of mean curvature, 1/m; the rest pose has {at_rest:.3g}; orange: less than that",
            bent,
            bent < at_rest,
            groups,
        ),
    }


classes = (WRINKLE_OT_plot_samples,)
