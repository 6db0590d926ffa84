"""Step nine: how good it is."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy

from ...evaluation_record import evaluation_path, read_evaluation
from .. import playback
from ..file_process import EVALUATE, process_of
from ..flow_playback import FlowPlayer
from ..player import Player
from .layout import GarmentPanel, draw_process, garment_of, say, say_numbers, translated


class WRINKLE_PT_report(GarmentPanel, bpy.types.Panel):
    """How the samples came out, and how far the played garment is from a simulated one"""

    bl_label = "Report"

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, _) = self.layout, garment_of(context)
        player = playback.status(garment).player
        if player is not None and not isinstance(player, FlowPlayer):
            _draw_samples(layout, player)
            _draw_fidelity(context, layout, player)
        else:
            say(context, layout, "Play the garment first: its samples are read then.", icon="INFO")
        process = process_of(garment, EVALUATE)
        if process is None:
            layout.operator("wrinkle.evaluate", icon="VIEWZOOM")
        else:
            draw_process(layout, process)


def _draw_samples(layout: bpy.types.UILayout, player: Player) -> None:
    layout.label(text=player.summary, icon="MATCLOTH", translate=False)
    residuals = [report["residual"] for report in player.reports.values() if "residual" in report]
    restless = {name: report for name, report in player.reports.items() if not report.get("converged", True)}
    left_out = sum("stand_in" in report for report in player.reports.values())
    if residuals:
        numbers = {"Worst Residual": f"{max(residuals):.2g}", "Not at Rest": str(len(restless))}
        say_numbers(layout, numbers | ({"Left Out": str(left_out)} if left_out else {}))
    for name, report in list(restless.items())[:12]:
        place = report.get("restless", "")
        layout.label(text=f"{name}  {place}", icon="DOT", translate=False)
    if len(restless) > 12:
        layout.label(text=translated("and {count} more").format(count=len(restless) - 12))
    layout.operator("wrinkle.plot_samples", icon="IMAGE_DATA")


def _draw_fidelity(context: bpy.types.Context, layout: bpy.types.UILayout, player: Player) -> None:
    database = player.database
    try:
        result = _evaluation(database.folder, database.header.key)
    except ValueError as error:
        say(context, layout, str(error), icon="ERROR")
        return
    if result is None:
        say(context, layout, "Not compared with a simulated garment yet.", icon="INFO")
        return
    names = {"ours": "With Wrinkles", "skinning": "Skinning Alone"}
    numbers = {text: f"{result['rmse_mm'][name]:.2f} mm RMS" for name, text in names.items()}
    numbers["Frames"] = str(len(result["frames"]))
    say_numbers(layout, numbers)
    layout.operator("wrinkle.plot_evaluation", icon="IMAGE_DATA")


def _evaluation(folder: Path, key: str) -> Mapping[str, Any] | None:
    """Read anew only when it was made anew, as this is drawn over and over."""
    path = evaluation_path(folder, key)
    try:
        written = path.stat().st_mtime_ns
    except OSError:
        return None
    return _read(folder, key, written)


@lru_cache(maxsize=8)
def _read(folder: Path, key: str, written: int) -> Mapping[str, Any] | None:
    return read_evaluation(folder, key)


classes = (WRINKLE_PT_report,)
