"""What carries a recorded garment: weights of the nearest body vertex (F02), or those that explain it best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .garment import INFLUENCES, Body, SkinWeights
from .recordings import Recording
from .rig import FloatArray, IntArray, Pose, Rig

NEAREST_BLOCK = 512
"""Garment vertices that are compared with all body vertices at a time."""

FIT_FRAMES = 200
"""Frames that a fit looks at, evenly spread, at most."""

FIT_BLOCK = 256
"""Garment vertices that are fitted at a time."""

FIT_ROUNDS = 300
"""Steps of the accelerated gradient."""

FIDELITY = 1.0e-3
"""How much the weights that a fit starts from count, beside what the recording says of a weight."""


def nearest_weights(rest: FloatArray, body: Body) -> SkinWeights:
    """Weights of the body vertex nearest to each garment vertex, both at rest (F02).

    Args:
        rest: The garment in rig space [m], shape [vertex_count, 3].

    Raises:
        ValueError: If no bone carries a body vertex that is nearest to one of the garment.
    """
    nearest = np.zeros(len(rest), np.int64)
    lengths = np.square(body.positions).sum(1)
    for first in range(0, len(rest), NEAREST_BLOCK):
        part = rest[first : first + NEAREST_BLOCK]
        nearest[first : first + NEAREST_BLOCK] = (lengths - 2.0 * part @ body.positions.T).argmin(1)
    dense = body.weights[nearest]
    lost = int((dense.sum(1) <= 0.0).sum())
    if lost:
        raise ValueError(
            f"{lost} vertices of the garment lie over parts of the body that no deforming bone moves; "
            "give the body weights there."
        )
    return SkinWeights.from_dense(dense)


def fit_weights(
    start: SkinWeights, rest: FloatArray, recording: Recording, rig: Rig, poses: Sequence[Pose], to_rig: FloatArray
) -> SkinWeights:
    """Weights under which linear blend skinning comes nearest to a recording, by least squares.

    None is negative, they add up to 1, and at most as many bones carry a vertex as always: the heaviest of a first fit
    are fitted anew. A little of the weights that it starts from is asked for, too: bones that move alike tell nothing.

    Args:
        start: Weights to start from.
        rest: The garment at rest [m], shape [vertex_count, 3].
        recording, rig, poses, to_rig: See :class:`.flow_compress.FlowSource`.
    """
    frames = np.unique(np.linspace(0, recording.frame_count - 1, FIT_FRAMES).astype(int))
    dense = start.to_dense(rig.bone_count)
    bones = np.flatnonzero(dense.any(0))
    deformations = np.stack([poses[frame].deformations(rig)[bones, :3] for frame in frames])
    matrices = (to_rig @ recording.to_object)[frames]
    fitted = np.zeros_like(dense)
    for first in range(0, len(rest), FIT_BLOCK):
        part = slice(first, first + FIT_BLOCK)
        given = np.asarray(recording.frames[frames, part], np.float64)
        wanted = np.einsum("fij,fvj->fvi", matrices[:, :3, :3], given) + matrices[:, None, :3, 3]
        points = np.concatenate([rest[part], np.ones((len(rest[part]), 1))], 1)
        # About the wanted place, so that weights which add up to 1 need not explain where in the world it is.
        carried = np.einsum("fbij,vj->vbfi", deformations, points) - wanted.transpose(1, 0, 2)[:, None]
        flat = carried.reshape(len(points), len(bones), -1)
        gram = flat @ flat.transpose(0, 2, 1) / len(frames)
        fitted[part, bones] = _fit_block(gram, dense[part, bones])
    return SkinWeights.from_dense(fitted)


def _fit_block(gram: FloatArray, start: FloatArray) -> FloatArray:
    """Weights w on the simplex that make w^T gram w + FIDELITY trace |w - start|^2 least, few of them not 0.

    Args:
        gram: Products of what bones leave of the wanted place [m^2], shape [count, bone_count, bone_count].
        start: Shape [count, bone_count].
    """
    bone_count = gram.shape[1]
    pull = FIDELITY * np.trace(gram, axis1=1, axis2=2) / bone_count + 1e-12
    allowed = np.ones(start.shape, bool)
    weights = start
    for _ in range(2):
        weights = _minimise(gram, pull, start, allowed)
        order: IntArray = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
        allowed = np.zeros(start.shape, bool)
        np.put_along_axis(allowed, order, True, 1)
    return weights


def _minimise(gram: FloatArray, pull: FloatArray, start: FloatArray, allowed: np.ndarray) -> FloatArray:
    """Nesterov's accelerated projected gradient, of all vertices at once."""
    slope = 2.0 * (np.abs(gram).sum(2).max(1) + pull)[:, None]
    weights = ahead = _onto_simplex(np.where(allowed, start, -np.inf))
    for number in range(FIT_ROUNDS):
        gradient = 2.0 * ((gram @ ahead[:, :, None])[:, :, 0] + pull[:, None] * (ahead - start))
        moved = _onto_simplex(np.where(allowed, ahead - gradient / slope, -np.inf))
        ahead = moved + number / (number + 3.0) * (moved - weights)
        weights = moved
    return weights


def _onto_simplex(values: FloatArray) -> FloatArray:
    """The nearest weights that are not negative and add up to 1, rows of shape [count, bone_count]."""
    ordered = -np.sort(-values, axis=1)
    with np.errstate(invalid="ignore"):
        excess = (np.cumsum(ordered, axis=1) - 1.0) / np.arange(1, values.shape[1] + 1)
    count = (ordered > excess).sum(1) - 1
    return np.maximum(values - np.take_along_axis(excess, count[:, None], 1), 0.0)
