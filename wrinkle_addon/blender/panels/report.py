"""Step nine: how good it is."""

from __future__ import annotations

import bpy

from .. import playback
from .layout import GarmentPanel, garment_of, say, say_numbers, translated


class WRINKLE_PT_report(GarmentPanel, bpy.types.Panel):
    """How the samples came out, and how far the played garment is from a simulated one"""

    bl_label = "Report"

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, _) = self.layout, garment_of(context)
        player = playback.status(garment).player
        reports = None if player is None else getattr(player, "reports", None)
        if player is None or reports is None:
            say(context, layout, "Play the garment first: its samples are read then.", icon="INFO")
            return
        layout.label(text=player.summary, icon="MATCLOTH", translate=False)
        residuals = [report["residual"] for report in reports.values() if "residual" in report]
        restless = {name: report for name, report in reports.items() if not report.get("converged", True)}
        if residuals:
            say_numbers(layout, {"Worst Residual": f"{max(residuals):.2g}", "Not at Rest": str(len(restless))})
        for name, report in list(restless.items())[:12]:
            place = report.get("restless", "")
            layout.label(text=f"{name}  {place}", icon="DOT", translate=False)
        if len(restless) > 12:
            layout.label(text=translated("and {count} more").format(count=len(restless) - 12))
        layout.operator("wrinkle.plot_samples", icon="IMAGE_DATA")


classes = (WRINKLE_PT_report,)
