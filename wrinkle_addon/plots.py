"""Plots of an evaluation and of the joints' influence. Needs Matplotlib."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .influence import influence_colours
from .rig import FloatArray
from .storage import make_folder
from .topology import IntArray

COLOURS = {"skinning": "#999999", "nearest": "#c9a227", "paper": "#3b7dd8", "ours": "#c0392b", "reference": "#222222"}


def check_plots(folder: Path) -> None:
    """See before any work that plots can be drawn and written to a folder.

    Raises:
        ValueError: If Matplotlib is missing, or the folder cannot be written to; one sentence.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise ValueError("Plots need Matplotlib, which is not installed here; leave --plots out, or install it.")
    make_folder(folder)


def plot_evaluation(result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw the result of :func:`.evaluate.evaluate` into PNG files; returns their paths."""
    pyplot = _pyplot()
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


def plot_influence(
    positions: FloatArray, faces: IntArray, axes: FloatArray, maps: Mapping[str, FloatArray], title: str, path: Path
) -> Path:
    """Draw maps over a garment from the front and from the back, a row each, as figure 6; returns the path.

    Args:
        positions, faces: The garment [m], shape [vertex_count, 3], and its triangles.
        axes: Columns left, up and forward of the body, shape [3, 3].
        maps: Values from 0 to 1 by the row's title, shape [vertex_count].
        title: Of the whole figure.
        path: The PNG file.
    """
    from matplotlib.collections import PolyCollection

    pyplot = _pyplot()
    triangles = (positions @ axes)[faces]
    figure, grid = pyplot.subplots(len(maps), 2, figsize=(9, 3.2 * len(maps)), squeeze=False)
    for row, (name, values) in zip(grid, maps.items(), strict=True):
        colours = influence_colours(values[faces].mean(1))
        for side, view, place in ((1.0, "front", row[0]), (-1.0, "back", row[1])):
            # The character's left is at the right of who looks at it; near triangles are drawn over far ones.
            order = np.argsort(side * triangles[:, :, 2].mean(1))
            outline = triangles[order, :, :2] * [side, 1.0]
            place.add_collection(
                PolyCollection(list(outline), facecolors=colours[order], edgecolors="face", linewidths=0.1)
            )
            place.set(xlabel=f"{name}, {view}", xticks=[], yticks=[], aspect="equal")
            place.autoscale()
    figure.suptitle(title)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
    return path


def plot_flow(points: Sequence[tuple[int, float]], frame_mm: FloatArray, start: float, folder: Path) -> Path:
    """Draw what a flow's error costs, and its error over the clip; returns the path.

    Args:
        points: Bytes and root mean square error [mm] of estimated flows, and last of the one that was made.
        frame_mm: Its error in every frame [mm], shape [frame_count].
        start: Scene frame of the first.
        folder: For the PNG file.
    """
    pyplot = _pyplot()
    folder.mkdir(parents=True, exist_ok=True)
    figure, (curve, clip) = pyplot.subplots(1, 2, figsize=(10, 4))
    sizes, errors = np.array(points[:-1]).reshape(-1, 2).T
    curve.loglog(sizes / 1e6, errors, "o-", color=COLOURS["skinning"], label="estimated")
    curve.loglog(points[-1][0] / 1e6, points[-1][1], "o", color=COLOURS["ours"], label="this file")
    curve.set(xlabel="size (MB)", ylabel="RMS error (mm)", title="What an error costs")
    curve.legend()
    curve.grid(alpha=0.3, which="both")
    clip.plot(start + np.arange(len(frame_mm)), frame_mm, label="this file", color=COLOURS["ours"])
    clip.set(xlabel="frame", ylabel="RMS error (mm)", title="Error over the clip", ylim=(0, None))
    return _finish(figure, clip, folder / "flow.png")


def _pyplot() -> Any:
    """Matplotlib, drawing into files."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def _finish(figure: Any, axes: Any, path: Path) -> Path:
    axes.legend()
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    _pyplot().close(figure)
    return path
