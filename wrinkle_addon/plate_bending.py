"""The matrix of the quadratic bending energy of :mod:`..kernels.cloth.bending`, from the rest shape alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .topology import IntArray, inner_edges

FloatArray = NDArray[np.float64]

# Curvatures that the hinges of a poorly shaped triangle tell this much worse than others are left out: they would
# make it stiffer than all its neighbours together.
LEAST_TOLD = 0.02


def bending_matrix(
    positions: FloatArray, faces: IntArray, warp: FloatArray, plate: tuple[float, float, float, float]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Q as triplets (row, column, value) [N/m], sorted by row and column, none twice.

    Args:
        positions: Rest surface [m], shape [vertex_count, 3].
        faces: Triangles, shape [triangle_count, 3].
        warp: Direction of the warp in each triangle's plane, unit vectors, shape [triangle_count, 3].
        plate: (D11, D12, D22, D33) of the plate in warp and weft [N m]; see :attr:`~.fabrics.Fabric.plate`.
    """
    edges, sides = inner_edges(faces)
    turn, moment = _hinges(positions, edges)
    hinges = np.full(3 * len(faces), -1)
    hinges[sides] = np.arange(len(edges))[:, None]
    hinges = hinges.reshape(-1, 3)
    weights = _hinge_weights(positions, faces, hinges, moment, warp, plate)
    keys, values = [], []
    for i, j in np.ndindex(3, 3):
        both = (hinges[:, i] >= 0) & (hinges[:, j] >= 0)
        first, second = hinges[both, i], hinges[both, j]
        keys.append(edges[first][:, :, None].astype(np.int64) * len(positions) + edges[second][:, None, :])
        values.append(weights[both, i, j][:, None, None] * turn[first][:, :, None] * turn[second][:, None, :])
    unique, entry = np.unique(np.concatenate(keys).ravel(), return_inverse=True)
    summed = np.bincount(entry.ravel(), np.concatenate(values).ravel(), len(unique)).astype(np.float64)
    return (unique // len(positions)).astype(np.int32), (unique % len(positions)).astype(np.int32), summed


def _hinges(positions: FloatArray, edges: IntArray) -> tuple[FloatArray, FloatArray]:
    """For each inner edge: k, shape [edge_count, 4], and its second moment, shape [edge_count, 2, 2] [m^2].

    The moment is sum k s s^T with the four vertices s unfolded into a plane, along the edge and to its left: half its
    product with a curvature is what the hinge turns by.
    """
    x0, x1, x2, x3 = (positions[edges[:, k]] for k in range(4))
    e = x1 - x0
    # Angles at the edge's ends: 01 and 03 at x0 and x1 in the first triangle, 02 and 04 in the second.
    c01, c02 = _cotangent(e, x2 - x0), _cotangent(e, x3 - x0)
    c03, c04 = _cotangent(-e, x2 - x1), _cotangent(-e, x3 - x1)
    turn = np.stack([c03 + c04, c01 + c02, -c01 - c03, -c02 - c04], 1)
    length = np.linalg.norm(e, axis=1)
    left, right = length / (c01 + c03), -length / (c02 + c04)
    flat = np.zeros((len(edges), 4, 2))
    flat[:, 1, 0] = length
    flat[:, 2] = np.stack([left * c01, left], 1)
    flat[:, 3] = np.stack([-right * c02, right], 1)
    return turn, np.einsum("hk,hka,hkb->hab", turn, flat, flat)


def _hinge_weights(
    positions: FloatArray,
    faces: IntArray,
    hinges: NDArray[np.intp],
    moment: FloatArray,
    warp: FloatArray,
    plate: tuple[float, float, float, float],
) -> FloatArray:
    """Each triangle's energy as a quadratic form of the turns of its three edges, shape [triangle_count, 3, 3]."""
    corners = positions[faces]
    along = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(along[:, 0], along[:, 1])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    normal /= 2.0 * area[:, None]
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    # From each edge's axes to warp and weft; half a turn, as on the edge's second side, changes no square.
    cosine = (along * warp[:, None]).sum(2)
    sine = (np.cross(warp[:, None], along) * normal[:, None]).sum(2)
    turned = np.stack([np.stack([cosine, -sine], 2), np.stack([sine, cosine], 2)], 2)
    local = turned @ moment[hinges] @ turned.transpose(0, 1, 3, 2)
    # Turn of each hinge by the curvatures of warp, weft and twist; a border turns by nothing.
    told = np.stack([0.5 * local[..., 0, 0], 0.5 * local[..., 1, 1], local[..., 0, 1]], 2)
    curvature = np.linalg.pinv(np.where((hinges >= 0)[:, :, None], told, 0.0), rcond=LEAST_TOLD)
    d11, d12, d22, d33 = plate
    rigidity = np.array([[d11, d12, 0.0], [d12, d22, 0.0], [0.0, 0.0, 2.0 * d33]])
    return np.einsum("t,tai,ab,tbj->tij", area, curvature, rigidity, curvature)


def _cotangent(a: FloatArray, b: FloatArray) -> FloatArray:
    return (a * b).sum(1) / np.linalg.norm(np.cross(a, b), axis=1)
