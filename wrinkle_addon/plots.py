"""Plots of an evaluation: error over the clip, error by region, curvature over the clip. Needs Matplotlib."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

COLOURS = {"skinning": "#999999", "nearest": "#c9a227", "paper": "#3b7dd8", "ours": "#c0392b", "reference": "#222222"}


def plot_evaluation(result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw the result of :func:`.evaluate.evaluate` into PNG files; returns their paths."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    folder.mkdir(parents=True, exist_ok=True)
    frames = [entry["frame"] for entry in result["frames"]]
    paths = []

    figure, axes = pyplot.subplots(figsize=(8, 4))
    for name in result["rmse_mm"]:
        axes.plot(frames, [entry["rmse_mm"][name] for entry in result["frames"]], label=name, color=COLOURS[name])
    axes.set(xlabel="frame", ylabel="RMS error (mm)", title="Distance from the reference", ylim=(0, None))
    paths.append(_finish(figure, axes, folder / "error.png"))

    figure, axes = pyplot.subplots(figsize=(8, 4))
    for name in ("reference", "ours", "paper", "skinning"):
        axes.plot(frames, [entry["curvature"][name] for entry in result["frames"]], label=name, color=COLOURS[name])
    axes.set(xlabel="frame", ylabel="sum of mean curvature (1/m)", title="Wrinkles over the clip (as figure 9)")
    paths.append(_finish(figure, axes, folder / "curvature.png"))

    figure, axes = pyplot.subplots(figsize=(8, 4))
    places = np.arange(len(result["regions"]))
    names = list(result["rmse_mm"])
    for k, name in enumerate(names):
        values = [region["rmse_mm"][name] for region in result["regions"].values()]
        axes.bar(places + 0.8 * (k / len(names) - 0.5), values, 0.8 / len(names), label=name, color=COLOURS[name])
    axes.set_xticks(places, list(result["regions"]))
    axes.set(ylabel="RMS error (mm)", title="By region")
    paths.append(_finish(figure, axes, folder / "regions.png"))
    return paths


def _finish(figure: Any, axes: Any, path: Path) -> Path:
    from matplotlib import pyplot

    axes.legend()
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
    return path
