"""Principal components of residuals (F04) by a randomised SVD that reads them in stretches and holds none.

With A of shape [frame_count, 3 * vertex_count] and its mean taken off, a few random mixtures of frames are driven
through A A^T, which singles out the strongest temporal shapes (Halko, Martinsson, Tropp 2011, algorithm 4.4); in their
span the SVD is small. A clip of few frames needs no mixing: then it is exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .flow_residuals import Residuals
from .rig import FloatArray
from .steps import Progress

OVERSAMPLING = 10
"""Mixtures beyond the components asked for."""

POWER_PASSES = 2

EXACT_FRAMES = 400
"""Clips up to this long are taken apart exactly."""

SEED = 20100612

FIRST_WIDTH = 128
"""Mixtures of a long clip to begin with; twice as many if they turn out too few."""


@dataclass(frozen=True, eq=False)
class Components:
    """What the residuals are made of, but for a remainder.

    Attributes:
        mean: Mean residual [m], shape [vertex_count, 3].
        shapes: Components [m] by coefficients of mean square 1, strongest first, orthogonal, shape [component_count,
            vertex_count, 3].
        energies: Mean square displacement by each component [m^2], shape [component_count].
        total: Mean square residual about the mean [m^2]; what the components leave of it is lost.
        frame_squares: Mean square residual of every frame [m^2], shape [frame_count].
    """

    mean: NDArray[np.float32]
    shapes: NDArray[np.float32]
    energies: FloatArray
    total: float
    frame_squares: FloatArray

    @property
    def count(self) -> int:
        return len(self.energies)

    @property
    def reach(self) -> float:
        """Root mean square residual of the frame in which it is greatest [m]."""
        return float(np.sqrt(self.frame_squares.max()))

    def lost(self, count: int) -> float:
        """Mean square error [m^2] of this many components."""
        return max(self.total - float(self.energies[:count].sum()), 0.0)


def find_components(
    residuals: Residuals, most: int, loss: float = 0.0, progress: Progress = lambda fraction, text: None
) -> Components:
    """The fewest strongest components that lose no more than asked.

    Args:
        residuals: The residuals.
        most: Components to find at most; fewer come out of a clip that has fewer.
        loss: Mean square error [m^2] that they may leave.
        progress: Told what share is done, and what is being done.

    Raises:
        ValueError: If there is but one frame, or positions are not numbers.
    """
    frames = residuals.frame_count
    if frames < 2:
        raise ValueError(f"The recording '{residuals.recording.name}' has one frame; a flow needs at least two.")
    most = min(most, frames - 1)
    width = frames if frames <= EXACT_FRAMES else min(FIRST_WIDTH, most + OVERSAMPLING)
    while True:
        span = _strongest_times(residuals, width, progress)
        progress(0.6, "principal components")
        sums = _reduced_sums(residuals, span)
        energies, turn = np.linalg.eigh(sums.gram)
        energies, turn = np.maximum(energies[::-1], 0.0), turn[:, ::-1]
        lost = (sums.total - np.cumsum(energies)) / (frames * residuals.vertex_count)
        enough = np.flatnonzero(lost <= max(loss, 1e-12 * sums.total / (frames * residuals.vertex_count)))
        count = min(int(enough[0]) + 1 if len(enough) else len(energies), most)
        if len(enough) or count + OVERSAMPLING <= width or width == frames:
            break
        width = min(2 * width, frames if most + OVERSAMPLING > frames // 2 else most + OVERSAMPLING)
    if sums.total == 0.0:
        count = 0
    times = span @ turn[:, :count]
    progress(0.8, "shapes")
    spread = (times.T / np.sqrt(float(frames))).astype(np.float32)
    shapes = np.zeros((count, residuals.vertex_count, 3), np.float32)
    for part, block, _ in _centred(residuals):
        shapes[:, part] = (spread @ block).reshape(count, -1, 3)
    scale = 1.0 / (frames * residuals.vertex_count)
    return Components(sums.mean, shapes, scale * energies[:count], scale * sums.total, sums.frame_squares)


def _strongest_times(residuals: Residuals, width: int, progress: Progress) -> NDArray[np.float32]:
    """Orthonormal temporal shapes that hold the strongest ones, shape [frame_count, width]."""
    frames = residuals.frame_count
    if width == frames:
        return np.eye(frames, dtype=np.float32)
    span = np.random.default_rng(SEED).standard_normal((frames, width)).astype(np.float32)
    for number in range(POWER_PASSES):
        progress(0.3 * number, f"{width} components, pass {number + 1}")
        driven = np.zeros((frames, width))
        for _, block, _ in _centred(residuals):
            driven += block @ (block.T @ span)
        span = np.linalg.qr(driven)[0].astype(np.float32)
    return span


@dataclass(frozen=True, eq=False)
class _Sums:
    """What one reading of the residuals gives.

    Attributes:
        mean: Mean residual [m], shape [vertex_count, 3].
        gram: Products of the temporal shapes' rows, shape [width, width].
        total: Sum of squares about the mean [m^2].
        frame_squares: Mean square residual of every frame [m^2], shape [frame_count].
    """

    mean: NDArray[np.float32]
    gram: FloatArray
    total: float
    frame_squares: FloatArray


def _reduced_sums(residuals: Residuals, span: NDArray[np.float32]) -> _Sums:
    frames, width = span.shape
    mean = np.zeros((residuals.vertex_count, 3), np.float32)
    gram, total, squares = np.zeros((width, width)), 0.0, np.zeros(frames)
    for part, block, centre in _centred(residuals):
        mean[part] = centre
        total += float(np.einsum("fv,fv->", block, block, dtype=np.float64))
        squares += np.square(block.reshape(frames, -1, 3) + centre).sum((1, 2), dtype=np.float64)
        # In double precision: a garment that is thrown off must not drown its wrinkles.
        reduced = (block if width == frames else span.T @ block).astype(np.float64)
        gram += reduced @ reduced.T
    return _Sums(mean, gram, total, squares / residuals.vertex_count)


def project(residuals: Residuals, mean: NDArray[np.float32], shapes: NDArray[np.float32]) -> FloatArray:
    """Coefficients that bring the shapes nearest to the residuals, shape [frame_count, component_count].

    After quantisation, the shapes are neither orthogonal nor quite where they were; this makes up for what it can.
    """
    flat = shapes.reshape(len(shapes), -1)
    overlap = np.zeros((residuals.frame_count, len(shapes)))
    gram = np.zeros((len(shapes), len(shapes)))
    for part, block in residuals.stretches():
        columns = flat[:, 3 * part.start : 3 * part.stop]
        overlap += (block - mean[part]).reshape(len(block), -1) @ columns.T
        gram += columns @ columns.T
    # Shapes that were rounded to nothing get no coefficient.
    ridge = 1e-9 * float(np.trace(gram)) / max(len(gram), 1) + 1e-30
    return np.linalg.solve(gram + ridge * np.eye(len(gram)), overlap.T).T


def _centred(residuals: Residuals) -> Iterator[tuple[slice, NDArray[np.float32], NDArray[np.float32]]]:
    """Vertices, their residuals about the mean, shape [frame_count, 3 * count], and the mean, shape [count, 3]."""
    for part, block in residuals.stretches():
        centre = block.mean(0, dtype=np.float64).astype(np.float32)
        yield part, (block - centre).reshape(len(block), -1), centre
