"""A garment's kept evaluation as pictures for the Image Editor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import bpy
import numpy as np

from ..evaluation_record import read_evaluation
from .charts import Chart, draw_charts
from .samples import open_database

METHODS = ("ours", "skinning")
"""Whose figures are drawn, side by side."""


def draw_evaluation(context: bpy.types.Context, garment: bpy.types.Object) -> Iterator[str]:
    """Draw error and curvature over the evaluated frames, a chart a step; yields the images' names.

    Raises:
        ValueError: If there is no evaluation; one sentence that says what to do.
    """
    database = open_database(garment)
    result = read_evaluation(database.folder, database.header.key)
    if result is None:
        raise ValueError("There is no evaluation yet; evaluate the garment first.")
    yield from draw_charts(context, garment.name, _charts(result["frames"]))


def _charts(frames: list[Mapping[str, Any]]) -> dict[str, Chart]:
    groups = [(len(METHODS) * number, f"{frame['frame']:g}") for number, frame in enumerate(frames)]
    errors = np.array([frame["rmse_mm"][name] for frame in frames for name in METHODS])
    bent = np.array([frame["curvature"][name] for frame in frames for name in ("ours", "reference")])
    second = np.tile([False, True], len(frames))
    return {
        "error": Chart("RMS error by frame, mm: blue with wrinkles, orange skinning alone", errors, second, groups),
        "wrinkles": Chart("Sum of mean curvature by frame, 1/m: blue ours, orange the reference", bent, second, groups),
    }
