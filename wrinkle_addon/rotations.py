"""Unit quaternions (w, x, y, z) over the last axis of NumPy arrays: the small algebra that poses need."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def multiply(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Product a b: first b turns, then a. Shapes [..., 4]."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    # Written out: many products are of single quaternions, where NumPy's cross costs more than all of this.
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by + ay * bw + az * bx - ax * bz,
            aw * bz + az * bw + ax * by - ay * bx,
        ],
        axis=-1,
    )


def conjugate(q: ArrayLike) -> FloatArray:
    """Inverse of a unit quaternion, shape [..., 4]."""
    return np.asarray(q, np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: ArrayLike, vectors: ArrayLike) -> FloatArray:
    """Vectors turned by q, shapes [..., 4] and [..., 3]."""
    q, vectors = np.asarray(q, np.float64), np.asarray(vectors, np.float64)
    twice = 2.0 * np.cross(q[..., 1:], vectors)
    return vectors + q[..., :1] * twice + np.cross(q[..., 1:], twice)


def from_rotvec(rotvec: ArrayLike) -> FloatArray:
    """Quaternion of a rotation vector [rad], shape [..., 3] to [..., 4]."""
    rotvec = np.asarray(rotvec, np.float64)
    half = 0.5 * np.linalg.norm(rotvec, axis=-1, keepdims=True)
    # sinc keeps the limit at zero angle exact.
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * rotvec], axis=-1)


def to_rotvec(q: ArrayLike) -> FloatArray:
    """Rotation vector of the shortest arc [rad], shape [..., 4] to [..., 3]."""
    q = np.asarray(q, np.float64)
    q = q * np.where(q[..., :1] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)


def twist_angle(q: ArrayLike, axis: ArrayLike) -> NDArray[np.float64]:
    """Angle of the twist about a unit axis in the split q = swing * twist [rad], in (-pi, pi], shape [...].

    A half turn of pure swing leaves the twist undefined; 0 is returned there.
    """
    q = np.asarray(q, np.float64)
    along = (q[..., 1:] * np.asarray(axis, np.float64)).sum(-1)
    w = np.where(np.hypot(q[..., 0], along) < 1e-9, 1.0, q[..., 0])
    angle = 2.0 * np.arctan2(along, w)
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def slerp(a: ArrayLike, b: ArrayLike, t: float) -> FloatArray:
    """Shortest-arc interpolation from a to b, shapes [..., 4]."""
    a = np.asarray(a, np.float64)
    return multiply(a, from_rotvec(t * to_rotvec(multiply(conjugate(a), b))))


def between(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Shortest rotation that takes direction ``start`` to direction ``end``, shapes [3] to [4].

    For opposite directions, where the axis is free, a half turn about any axis orthogonal to ``start``.
    """
    start, end = (np.asarray(v, np.float64) / np.linalg.norm(v) for v in (start, end))
    w = 1.0 + start @ end
    if w < 1e-9:
        axis = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
        return np.concatenate([[0.0], axis / np.linalg.norm(axis)])
    q = np.concatenate([[w], np.cross(start, end)])
    return q / np.linalg.norm(q)


def to_matrices(q: ArrayLike) -> FloatArray:
    """Rotation matrices, shape [..., 4] to [..., 3, 3]."""
    q = np.asarray(q, np.float64)
    return np.moveaxis(np.stack([rotate(q, np.broadcast_to(e, (*q.shape[:-1], 3))) for e in np.eye(3)]), 0, -1)


def from_matrices(matrices: ArrayLike) -> FloatArray:
    """Quaternions of the rotations nearest to 3x3 matrices (scale and shear are taken off), [..., 3, 3] to [..., 4]."""
    m = np.asarray(matrices, np.float64)
    u, _, vt = np.linalg.svd(m)
    sign = np.linalg.det(u @ vt)
    u[..., :, 2] *= sign[..., None]
    r = u @ vt
    # Of the four equivalent formulas, use for each matrix the one whose divisor is largest.
    trace = np.trace(r, axis1=-2, axis2=-1)
    d = np.stack([trace, r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]], axis=-1)
    best = np.argmax(d, axis=-1)
    x, y, z = (r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1])
    xy, yz, zx = (r[..., 0, 1] + r[..., 1, 0], r[..., 1, 2] + r[..., 2, 1], r[..., 2, 0] + r[..., 0, 2])
    one = 1.0 - trace
    candidates = np.stack(
        [
            np.stack([1.0 + trace, x, y, z], -1),
            np.stack([x, one + 2.0 * r[..., 0, 0], xy, zx], -1),
            np.stack([y, xy, one + 2.0 * r[..., 1, 1], yz], -1),
            np.stack([z, zx, yz, one + 2.0 * r[..., 2, 2]], -1),
        ],
        axis=-2,
    )
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0.0, -q, q)
