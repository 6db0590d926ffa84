"""One frame of a recording four times, as the paper's figure 1: recorded, skinned, with its whole residual, ours."""

# pyright: reportMissingImports=false
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from wrinkle_synthesis.wrinkle_addon.flow import FlowMethod
from wrinkle_synthesis.wrinkle_addon.flow_compress import Compressed, FlowSource
from wrinkle_synthesis.wrinkle_addon.garment import vertex_normals
from wrinkle_synthesis.wrinkle_addon.rig import FloatArray, IntArray, Pose

LIGHT = np.array([0.4, 0.5, 0.77])
"""Direction towards the light in the picture's axes: right, up, towards the viewer."""


def draw_shapes(source: FlowSource, made: Compressed, faces: IntArray, path: Path) -> int:
    """Draw the frame in which skinning is farthest off, from the front; returns its place in the recording.

    Args:
        source: The recording.
        made: Its flow.
        faces: Triangles of the garment, shape [triangle_count, 3].
        path: The picture.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    evaluator = FlowMethod(made.flow).bind("cpu")
    rows = np.array([source.rig.index[name] for name in made.flow.rig.names])

    def replayed(frame: int, strength: float) -> FloatArray:
        pose = Pose(source.poses[frame].matrices[rows])
        return evaluator.positions(pose, strength, frame=source.recording.start + frame).astype(np.float64)

    def recorded(frame: int) -> FloatArray:
        matrix = source.to_rig[frame] @ source.recording.to_object
        return np.asarray(source.recording.frames[frame], np.float64) @ matrix[:3, :3].T + matrix[:3, 3]

    off = [float(np.square(replayed(k, 0.0) - recorded(k)).sum(1).mean()) for k in range(len(source.poses))]
    frame = int(np.argmax(off))
    truth, skinned, ours = recorded(frame), replayed(frame, 0.0), replayed(frame, 1.0)
    # What is left of the residual before it is compressed: all of it.
    whole = skinned + (truth - skinned)
    shapes = {
        "(a) recorded": truth,
        "(b) skinned": skinned,
        "(c) whole residual": whole,
        f"(d) {made.flow.component_count} components, {made.rms_mm:.2g} mm": ours,
    }
    up = -source.rig.gravity
    right = np.array([1.0, 0.0, 0.0]) - up[0] * up
    axes = np.stack([right / np.linalg.norm(right), up, np.cross(right / np.linalg.norm(right), up)], 1)
    figure, places = pyplot.subplots(1, 4, figsize=(13, 4.6), sharex=True, sharey=True)
    for place, (name, positions) in zip(places, shapes.items(), strict=True):
        _shade(place, positions @ axes, faces)
        place.set_title(name, fontsize=10)
        place.set_aspect("equal")
        place.axis("off")
        place.autoscale()
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return frame


def _shade(place: Any, positions: FloatArray, faces: IntArray) -> None:
    """The garment in matt grey, far triangles first."""
    from matplotlib.collections import PolyCollection

    normals = vertex_normals(positions, faces)[faces].mean(1)
    normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0)
    bright = np.clip(0.15 + 0.8 * normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    order = np.argsort(positions[faces].mean(1)[:, 2])
    colours = np.repeat(bright[order, None], 3, axis=1)
    place.add_collection(
        PolyCollection(list(positions[faces[order]][:, :, :2]), facecolors=colours, edgecolors="face", linewidths=0.2)
    )
