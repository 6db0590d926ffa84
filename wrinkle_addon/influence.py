"""How much each joint changes a garment's wrinkles, measured on its samples (Wang et al. 2010, section 3.3.1, fig 6).

For every pair of a joint's samples, the rest pose among them, take how each vertex moves from one to the other, apply a
Laplacian over the mesh so that cloth that is only dragged along counts nothing, and sum up the lengths (W70). The
Laplacian is linear, so it is applied to every sample once and not to every pair; lengths in space have no shorter sum
than the one over pairs, which a vertex does by itself.

Where this departs from the page:

- Samples are compared un-posed: as offsets over skinning, in the frame that the skin turned with it. In the pose
  itself a bent forearm's own turning passes the Laplacian, since a sleeve is round: the elbow would seem to wrinkle
  the cuff.
- The mean over the pairs is taken and not their sum: a shoulder of 125 samples is comparable with an elbow of nine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.influence import laplacian_of_samples, mean_distance_of_pairs
from .database import DatabaseHeader, SampleOffsets
from .detail_transfer import SMOOTHING_STEP, cotangent_weights
from .garment import Regions
from .method import SplitLaunch
from .plan import Sample
from .rig import FloatArray, Joint, Rig
from .topology import IntArray

BLUR = 0.03
"""How wide influence is smoothed before it becomes weights [m]: about a wrinkle, or weights would have wrinkles too."""

BEND_REACH = 0.1
"""Distance from a hinge within which the inside and the outside of its bend are compared [m]."""

_RAMP = np.array([[0.05, 0.05, 0.25], [0.0, 0.45, 0.7], [0.95, 0.85, 0.25], [0.75, 0.05, 0.05]])
"""Colours of no to full influence."""


def measure_influence(
    header: DatabaseHeader, rest: FloatArray, samples: Mapping[Sample, SampleOffsets], device: str = "cpu"
) -> dict[str, FloatArray]:
    """Influence of every joint on every vertex [m], shape [vertex_count]; 0 for a joint that has no sample but rest.

    Args:
        header: The character.
        rest: The settled rest garment [m], shape [vertex_count, 3].
        samples: All samples of the database.
        device: Warp device.
    """
    target = wp.get_device(device)
    operator = [wp.array(rows, device=target) for rows in cotangent_weights(rest, header.garment.faces)]
    launch = SplitLaunch(len(rest), target)
    found = {}
    for grid in header.plan.grids:
        stored = [samples[Sample(grid.joint.name, index)] for index in grid.nodes()]
        # The first sample is the rest pose, whose offsets are all zero.
        offsets = np.zeros((len(rest), len(stored) + 1, 3), np.float32)
        for number, sample in enumerate(stored, 1):
            offsets[sample.vertices, number] = sample.offsets
        values = wp.zeros(len(rest), dtype=wp.float32, device=target)
        if stored:
            given = wp.array(offsets, dtype=wp.vec3, device=target)
            details = wp.zeros_like(given)
            launch(laplacian_of_samples, [*operator, given], [details])
            launch(mean_distance_of_pairs, [details], [values])
        found[grid.joint.name] = values.numpy().astype(np.float64)
    return found


def smoothed_influence(
    influence: Mapping[str, FloatArray], rest: FloatArray, faces: IntArray, width: float = BLUR
) -> dict[str, FloatArray]:
    """Influence blurred over the garment by ``width`` [m], shape [vertex_count] each; an even map stays as it is."""
    start, neighbours, weights = cotangent_weights(rest, faces)
    edge = np.linalg.norm(rest[faces[:, 0]] - rest[faces[:, 1]], axis=1).mean()
    # An iteration adds half the step's share of an edge squared to the variance along each axis.
    iterations = round(width**2 / (0.5 * SMOOTHING_STEP * edge**2))
    values = np.stack(list(influence.values()), 1)
    for _ in range(iterations):
        around = np.add.reduceat(weights[:, None] * values[neighbours], start[:-1], axis=0)
        values = (1.0 - SMOOTHING_STEP) * values + SMOOTHING_STEP * around
    return dict(zip(influence, values.T, strict=True))


def influence_shares(influence: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Each joint's part of all influence on a vertex: like eq 4's weights they add up to 1, or to 0 where none acts."""
    total = np.sum(list(influence.values()), axis=0)
    return {name: values / np.where(total > 0.0, total, 1.0) for name, values in influence.items()}


def influence_windows(influence: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """How far each joint's offsets count where the joint that acts most on a vertex has 1.

    The root of its influence next to that joint's: one of a quarter of the influence still counts by half.
    """
    strongest = np.max(list(influence.values()), axis=0)
    return {name: np.sqrt(values / np.where(strongest > 0.0, strongest, 1.0)) for name, values in influence.items()}


# --- what the maps say --------------------------------------------------------------------------------------------


def influence_by_region(influence: FloatArray, regions: Regions) -> dict[str, float]:
    """Mean influence of a joint over each region of the garment [mm] (W72)."""
    members = {name: regions.vertex_segment == number for number, name in enumerate(regions.segments)}
    return {name: float(influence[inside].mean() * 1e3) for name, inside in members.items() if inside.any()}


def inside_of_bend(influence: FloatArray, joint: Joint, rig: Rig, rest: FloatArray) -> float | None:
    """Mean influence of a hinge on the inside of its bend over that on the outside (W73).

    The inside is where the limb goes when the joint's angle grows. None for a ball, and where there is no cloth or no
    influence outside.
    """
    if not joint.is_hinge:
        return None
    pivot = joint.pivot(rig)
    inward = np.cross(joint.axes[0], rig.tails[rig.index[joint.far]] - pivot)
    near = np.linalg.norm(rest - pivot, axis=1) < BEND_REACH
    inside = (rest - pivot) @ inward > 0.0
    if not (near & inside).any() or not (near & ~inside).any():
        return None
    outer = float(influence[near & ~inside].mean())
    return float(influence[near & inside].mean()) / outer if outer > 0.0 else None


def scaled_influence(influence: FloatArray) -> FloatArray:
    """Influence from 0 to 1, where 1 is what one vertex in a hundred exceeds, shape [vertex_count]."""
    largest = float(np.quantile(influence, 0.99))
    return np.clip(influence / largest, 0.0, 1.0) if largest > 0.0 else np.zeros_like(influence)


def influence_colours(values: FloatArray) -> NDArray[np.float32]:
    """Colours (red, green, blue, 1) of values from 0, dark blue, to 1, red, shape [vertex_count, 4]."""
    places = np.linspace(0.0, 1.0, len(_RAMP))
    channels = [np.interp(values, places, _RAMP[:, k]) for k in range(3)]
    return np.stack([*channels, np.ones(len(values))], 1).astype(np.float32)


def joint_names(header: DatabaseHeader, wanted: Sequence[str] = ()) -> list[str]:
    """The sampled joints of these names, or all of them.

    Raises:
        ValueError: If one was not sampled; one sentence that lists those that were.
    """
    names = [grid.joint.name for grid in header.plan.grids]
    for name in wanted:
        if name not in names:
            raise ValueError(f"The database has no samples of a joint '{name}'; it has {', '.join(names)}.")
    return list(wanted) or names
