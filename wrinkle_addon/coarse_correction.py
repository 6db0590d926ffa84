"""Host side of the coarse correction in :mod:`..kernels.cloth.coarse`."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ..kernels.cloth import coarse
from .cloth_model import ClothModel, FloatArray
from .coarse_space import CoarseLevel, coarse_levels
from .topology import IntArray, rows_of

DIRECT_SIZE = 96


class CoarseCorrection:
    """The long waves of a linear system's preconditioner, for every world.

    Args:
        model: The garment.
        device: Warp device.
        world_count: Copies of the garment.
    """

    def __init__(self, model: ClothModel, device: wp.Device, world_count: int):
        self._device = device
        self._worlds, self._vertex_count = world_count, model.vertex_count
        first, second = coarse_levels(model)
        self._first, self._second = self._upload(first), self._upload(second)
        self._counts = first.count, second.count
        self._entries = len(first.columns), len(second.columns)

        def upload(values: IntArray) -> wp.array:
            return wp.array(values, dtype=wp.int32, device=self._device)

        self._near = [upload(rows_of(model.row_start)), upload(model.columns)]
        far_coefficients = wp.array(model.far_coefficients, dtype=wp.float32, device=device)
        self._far = [upload(rows_of(model.far_start)), upload(model.far_columns), far_coefficients]

        def vectors(count: int) -> wp.array:
            return wp.zeros((world_count, count), dtype=coarse.vec6d, device=self._device)

        self._force, self._motion, self._left, self._smoothed = (vectors(first.count) for _ in range(4))
        self._coarse_force, self._coarse_motion = vectors(second.count), vectors(second.count)
        self._matrix = wp.zeros((world_count, self._entries[0]), dtype=coarse.mat66d, device=self._device)
        self._smoother = wp.zeros((world_count, first.count), dtype=coarse.mat66d, device=self._device)
        side = 6 * second.count
        self._dense = wp.zeros((world_count, side, side), dtype=wp.float64, device=self._device)
        self._inverse = wp.zeros_like(self._dense)
        self._positions = wp.zeros((world_count, model.vertex_count), dtype=wp.vec3d, device=self._device)

    def assemble(self, positions: wp.array, blocks: wp.array, diagonal: wp.array) -> None:
        """Build the coarse matrices.

        Args:
            positions: Vertices [m], float64, shape [world_count, vertex_count].
            blocks: One-ring Hessian blocks [N/m], positive semi-definite, shape [world_count, block_count].
            diagonal: What stands for their diagonal, self-contact included, shape [world_count, vertex_count].
        """
        # Conjugate gradients are recorded, and read these positions long after the garment has moved on.
        wp.copy(self._positions, positions)
        first, second = self._counts
        self._launch(coarse.place_nodes, first, [self._positions], [self._first])
        self._launch(coarse.place_nodes, second, [self._first.centre], [self._second])
        self._launch(
            coarse.gather_vertices,
            self._entries[0],
            [self._positions, *self._near, blocks, diagonal, *self._far, self._first],
            [self._matrix],
        )
        self._launch(coarse.invert_diagonal, first, [self._first, self._matrix], [self._smoother])
        self._launch(coarse.gather_nodes, self._entries[1], [self._first, self._matrix, self._second], [self._dense])
        self._inverse.assign(_positive_inverse(self._dense.numpy()))

    def add(self, residual: wp.array, preconditioned: wp.array) -> None:
        """Add the correction of a residual [N] to a preconditioned one [m]; may be recorded."""
        first, second = self._counts
        matrix = [self._first, self._matrix]
        self._launch(
            coarse.restrict_vertices,
            first,
            [self._positions, residual, self._first, self._smoother],
            [self._force, self._motion],
        )
        self._launch(coarse.find_left, first, [*matrix, self._force, self._motion], [self._left])
        self._launch(coarse.restrict_nodes, second, [self._first, self._left, self._second], [self._coarse_force])
        self._launch(coarse.solve_coarsest, second, [self._inverse, self._coarse_force], [self._coarse_motion])
        self._launch(coarse.prolong_nodes, first, [self._first, self._second, self._coarse_motion], [self._motion])
        self._launch(coarse.smooth_nodes, first, [*matrix, self._smoother, self._force, self._motion], [self._smoothed])
        self._launch(
            coarse.prolong_vertices,
            self._vertex_count,
            [self._positions, self._first, self._smoothed],
            [preconditioned],
        )

    def _upload(self, level: CoarseLevel) -> coarse.Level:
        uploaded = coarse.Level()
        for name in (
            "node",
            "member_start",
            "members",
            "row_start",
            "columns",
            "rows",
            "diagonal_entry",
            "contribution_start",
            "contributions",
        ):
            setattr(uploaded, name, wp.array(getattr(level, name), dtype=wp.int32, device=self._device))
        uploaded.centre = wp.zeros((self._worlds, level.count), dtype=wp.vec3d, device=self._device)
        return uploaded

    def _launch(self, kernel: Any, count: int, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=(self._worlds, count), inputs=inputs, outputs=outputs, device=self._device)


def _positive_inverse(matrices: FloatArray) -> FloatArray:
    """Inverses of symmetric positive matrices, shape [..., n, n].

    By halves, which positive matrices allow: a third of the time that a general inverse takes.
    """
    size = matrices.shape[-1]
    if size <= DIRECT_SIZE:
        return np.linalg.inv(matrices)
    half = size // 2
    first = _positive_inverse(matrices[..., :half, :half])
    across = matrices[..., :half, half:]
    carried = first @ across
    second = _positive_inverse(matrices[..., half:, half:] - np.swapaxes(across, -1, -2) @ carried)
    corner = carried @ second
    whole = np.empty_like(matrices)
    whole[..., :half, :half] = first + corner @ np.swapaxes(carried, -1, -2)
    whole[..., :half, half:] = -corner
    whole[..., half:, :half] = -np.swapaxes(corner, -1, -2)
    whole[..., half:, half:] = second
    return whole
