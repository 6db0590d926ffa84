"""How close synthesis comes to a reference: errors in millimetres, curvature, penetration, popping."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .database import WrinkleDatabase
from .joint_wrinkles import BlendWeights, Formulation, JointEvaluator, JointWrinkles
from .penetration import PushOut
from .rig import FloatArray, Pose
from .surface import BodyVolume, SurfaceMeasures

OURS = "ours"
CANDIDATES = ("skinning", "nearest", "paper", OURS)
"""What is measured: the settled rest garment skinned, nearest samples, the paper's form, and the default.

Of these the default alone follows a coarse layer.
"""


@dataclass(frozen=True, eq=False)
class EvaluatedFrame:
    """One frame of a comparison.

    Attributes:
        frame: Scene frame.
        pose: The rig's pose.
        reference: The garment as the reference has it, in rig space [m], shape [vertex_count, 3].
        body: The body in rig space [m], shape [body_vertex_count, 3], or None if it is not known.
        report: What the reference said of itself.
        over_coarse: Ours in line with the garment's coarse layer, in rig space [m], shape [vertex_count, 3]; None if it
            has none.
    """

    frame: float
    pose: Pose
    reference: FloatArray
    body: FloatArray | None = None
    report: Mapping[str, Any] = field(default_factory=dict)
    over_coarse: NDArray[np.float32] | None = None


class Candidates:
    """Everything that a reference is compared with, bound once."""

    def __init__(self, database: WrinkleDatabase, device: str = "cpu", weights: BlendWeights = BlendWeights.DISTANCE):
        bound = {kind: JointWrinkles(database, kind, weights).bind(device) for kind in Formulation}
        ours = bound[Formulation.OFFSETS]
        self._evaluators: dict[str, tuple[JointEvaluator, float]] = {
            "skinning": (ours, 0.0),
            "nearest": (bound[Formulation.NEAREST], 1.0),
            "paper": (bound[Formulation.PAPER], 1.0),
            OURS: (ours, 1.0),
        }

    def positions(self, pose: Pose) -> dict[str, NDArray[np.float32]]:
        """The garment by each candidate in rig space [m], shape [vertex_count, 3]."""
        return {name: evaluator.positions(pose, strength) for name, (evaluator, strength) in self._evaluators.items()}


def evaluate(
    database: WrinkleDatabase,
    frames: Iterable[EvaluatedFrame],
    body_faces: NDArray[np.int32] | None,
    device: str = "cpu",
    weights: BlendWeights = BlendWeights.DISTANCE,
    push: PushOut | None = None,
) -> dict[str, Any]:
    """Compare every candidate with a reference over a clip.

    Args:
        database: The baked garment.
        frames: The reference, in order.
        body_faces: Triangles of the body in ``frames``; None leaves penetration out.
        device: Warp device.
        weights: Where the weights come from by which joints meet, in every candidate.
        push: What keeps ours out of that body; None leaves it where it is synthesised.

    Returns:
        ``rmse_mm``, ``max_mm``: root mean square and largest vertex error of each candidate over the clip;
        ``frames``: the same for each frame; ``regions``: the same for each region of the garment;
        ``curvature_ratio``, ``curvature_correlation``: of the vertex sums of mean curvature, ours to the reference's
        (W100, W101); ``inside_share``, ``deepest_mm``: vertices of ours inside the body by more than 1 mm;
        ``inside_overlap_share``: those of them where the body cuts into itself, so that no place is free;
        ``acceleration_ratio``: of the mean vertex acceleration, ours to the reference's, None for frames with gaps;
        ``reference``: what the reference said of itself.

    Raises:
        ValueError: If there is no frame, or a reference has another number of vertices.
    """
    candidates = Candidates(database, device, weights)
    regions = database.header.regions
    surface = SurfaceMeasures(database.header.garment.faces, database.header.garment.vertex_count)
    numbers: list[float] = []
    squared: dict[str, list[FloatArray]] = {name: [] for name in CANDIDATES}
    curvature: dict[str, list[float]] = {name: [] for name in (*CANDIDATES, "reference")}
    inside: list[float] = []
    overlap: list[float] = []
    deepest: list[float] = []
    tracks: dict[str, list[NDArray[np.float32]]] = {OURS: [], "reference": []}
    reports: list[Mapping[str, Any]] = []
    for frame in frames:
        if len(frame.reference) != database.header.garment.vertex_count:
            raise ValueError(
                f"The reference has {len(frame.reference)} vertices, the garment "
                f"{database.header.garment.vertex_count}; record the garment object itself."
            )
        found = candidates.positions(frame.pose)
        if frame.over_coarse is not None:
            found[OURS] = frame.over_coarse
        if push is not None and frame.body is not None:
            ours = wp.array(found[OURS], dtype=wp.vec3, device=push.device)
            push.clear(frame.body, ours)
            found[OURS] = ours.numpy()
        for name, positions in found.items():
            squared[name].append(((positions - frame.reference) ** 2).sum(1))
            curvature[name].append(float(surface.mean_curvature(positions.astype(np.float64)).sum(dtype=np.float64)))
        curvature["reference"].append(float(surface.mean_curvature(frame.reference).sum(dtype=np.float64)))
        if frame.body is not None and body_faces is not None:
            depth, covered = BodyVolume(frame.body, body_faces).depth(found[OURS].astype(np.float64))
            inside.append(float((depth > 0.001).mean()))
            overlap.append(float(((depth > 0.001) & covered).mean()))
            deepest.append(float(depth.max()))
        # Accelerations are those of the garment on the body, so the character's own travel is taken off.
        _, root = frame.pose.with_root_at_rest(database.header.rig)
        for name, positions in ((OURS, found[OURS]), ("reference", frame.reference)):
            tracks[name].append(((positions - root[:3, 3]) @ root[:3, :3]).astype(np.float32))
        numbers.append(frame.frame)
        reports.append(frame.report)
    if not numbers:
        raise ValueError("There is no frame to evaluate.")
    errors = {name: np.stack(values) for name, values in squared.items()}
    return {
        "frame_count": len(numbers),
        "rmse_mm": {name: _rms_mm(values) for name, values in errors.items()},
        "max_mm": {name: _max_mm(values) for name, values in errors.items()},
        "frames": [
            {
                "frame": number,
                "rmse_mm": {name: _rms_mm(values[i]) for name, values in errors.items()},
                "max_mm": {name: _max_mm(values[i]) for name, values in errors.items()},
                "curvature": {name: values[i] for name, values in curvature.items()},
                "inside_share": inside[i] if inside else None,
                "reference": dict(reports[i]),
            }
            for i, number in enumerate(numbers)
        ],
        "regions": {
            segment: {
                "rmse_mm": {name: _rms_mm(values[:, members]) for name, values in errors.items()},
                "max_mm": {name: _max_mm(values[:, members]) for name, values in errors.items()},
            }
            for k, segment in enumerate(regions.segments)
            if (members := regions.vertex_segment == k).any()
        },
        "curvature_ratio": float(np.sum(curvature[OURS]) / np.sum(curvature["reference"])),
        "curvature_correlation": correlation(curvature[OURS], curvature["reference"]),
        "inside_share": float(np.mean(inside)) if inside else None,
        "inside_overlap_share": float(np.mean(overlap)) if overlap else None,
        "deepest_mm": float(np.max(deepest) * 1e3) if deepest else None,
        "acceleration_ratio": _acceleration_ratio(numbers, tracks),
        "reference": worst_of(reports),
    }


def _rms_mm(squared: FloatArray) -> float:
    return float(np.sqrt(squared.mean()) * 1e3)


def _max_mm(squared: FloatArray) -> float:
    return float(np.sqrt(squared.max()) * 1e3)


def correlation(a: Sequence[float], b: Sequence[float]) -> float | None:
    """Pearson's correlation, None where one of the two does not vary."""
    if len(a) < 3 or np.std(a) == 0.0 or np.std(b) == 0.0:
        return None
    return float(np.corrcoef(a, b)[0, 1])


def _acceleration_ratio(numbers: Sequence[float], tracks: Mapping[str, Sequence[NDArray[np.float32]]]) -> float | None:
    """Mean length of second differences, ours to the reference's; only for evenly spaced neighbouring frames."""
    if len(numbers) < 3 or not np.allclose(np.diff(numbers), 1.0):
        return None
    means = {name: np.mean([np.linalg.norm(a - 2 * b + c, axis=1).mean() for a, b, c in _triples(track)])
             for name, track in tracks.items()}  # fmt: skip
    return float(means[OURS] / means["reference"]) if means["reference"] > 0.0 else None


def _triples(track: Sequence[NDArray[np.float32]]):
    return zip(track[:-2], track[1:-1], track[2:], strict=True)


def worst_of(reports: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Worst residual, penetration and self-intersection that a reference reported."""
    keys = ("residual", "whole_residual", "inside", "inside_overlap", "deepest_mm")
    keys += ("self_intersections", "self_intersections_overlap")
    worst = {key: max(report[key] for report in reports) for key in keys if all(key in report for report in reports)}
    if all("converged" in report for report in reports):
        worst["converged_frames"] = sum(bool(report["converged"]) for report in reports)
    return worst
