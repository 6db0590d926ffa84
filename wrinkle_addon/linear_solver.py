"""Host side of the preconditioned conjugate gradients in :mod:`..kernels.cloth.linear`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from ..kernels.cloth import assembly, linear
from .cloth_model import ClothModel

PARTS = 64
RECORDED_ITERATIONS = 10


class BlockSystem:
    """The linear system of one Newton step for every world: blocks, their preconditioner, and a solver for them.

    Attributes:
        blocks: One-ring Hessian blocks [N/m], shape [world_count, block_count].
        slot_stiffness: Stiffness of each self-contact [N/m], shape [world_count, vertex_count * SLOTS].
        solution: Step found by :meth:`solve` [m], shape [world_count, vertex_count].
    """

    def __init__(self, model: ClothModel, garment: assembly.Garment, contact: assembly.Contact, world_count: int):
        device = contact.face.device
        vertex_count = model.vertex_count
        self.shape = (world_count, vertex_count)
        self._garment = garment
        self._contact = contact
        self._device = device

        def upload(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        self._row_start = upload(model.row_start, wp.int32)
        self._columns = upload(model.columns, wp.int32)
        self._diagonal_entry = upload(model.diagonal_entry, wp.int32)
        self._contribution_start = upload(model.contribution_start, wp.int32)
        self._contributions = upload(model.contributions, wp.int32)
        self._block_bending = upload(model.block_bending, wp.float64)
        self._far_start = upload(model.far_start, wp.int32)
        self._far_columns = upload(model.far_columns, wp.int32)
        self._far_coefficients = upload(model.far_coefficients, wp.float32)

        def vectors() -> wp.array:
            return wp.zeros(self.shape, dtype=wp.vec3, device=device)

        def scalars(dtype: type) -> wp.array:
            return wp.zeros(world_count, dtype=dtype, device=device)

        self.blocks = wp.zeros((world_count, len(model.columns)), dtype=wp.mat33, device=device)
        self._inverse = wp.zeros(self.shape, dtype=wp.mat33, device=device)
        self.slot_stiffness = wp.zeros(contact.slot_triangle.shape, dtype=wp.float32, device=device)
        self._slot_force = wp.zeros(contact.slot_triangle.shape, dtype=wp.vec3, device=device)
        self.solution, self._residual, self._direction = vectors(), vectors(), vectors()
        self._preconditioned, self._product = vectors(), vectors()
        self._partial = wp.zeros((world_count, PARTS), dtype=wp.float64, device=device)
        self._energy, self._first_energy = scalars(wp.float64), scalars(wp.float64)
        self._alpha, self._beta = scalars(wp.float32), scalars(wp.float32)
        self._active, self._iterations = scalars(wp.int32), scalars(wp.int32)
        self._recorded: dict[float, wp.Graph] = {}

    def assemble(
        self,
        positions: wp.array,
        deformation: wp.array,
        stress: wp.array,
        inverse_dt2: wp.array,
        *,
        exact: bool = False,
    ) -> None:
        """Fill the blocks at ``positions`` (float64 [m]) for the contact planes as they stand."""
        wp.launch(
            assembly.assemble_blocks,
            dim=self.blocks.shape,
            inputs=[
                self._garment,
                deformation,
                stress,
                exact,
                self._contribution_start,
                self._contributions,
                self._block_bending,
            ],
            outputs=[self.blocks],
            device=self._device,
        )
        wp.launch(
            assembly.assemble_diagonal,
            dim=self.shape,
            inputs=[positions, self._garment, self._contact, inverse_dt2, self._diagonal_entry, self.blocks],
            outputs=[self.slot_stiffness],
            device=self._device,
        )
        wp.launch(
            assembly.precondition_diagonal,
            dim=self.shape,
            inputs=[self._contact, self.slot_stiffness, self._diagonal_entry, self.blocks],
            outputs=[self._inverse],
            device=self._device,
        )

    def solve(self, gradient: wp.array, tolerance: float, max_iterations: int) -> int:
        """Solve H step = -gradient from zero; returns the largest number of iterations that a world took.

        Args:
            gradient: Gradient [N], float64, shape [world_count, vertex_count].
            tolerance: Share of the first preconditioned residual norm at which a world stops.
            max_iterations: Bound on the iterations, rounded up to the recorded chunk.
        """
        wp.launch(
            linear.start,
            dim=self.shape,
            inputs=[gradient, self._inverse],
            outputs=[self.solution, self._residual, self._preconditioned, self._direction],
            device=self._device,
        )
        self._dot(self._residual, self._preconditioned)
        wp.launch(
            linear.start_scalars,
            dim=self.shape[0],
            inputs=[self._partial],
            outputs=[self._energy, self._first_energy, self._active],
            device=self._device,
        )
        self._iterations.zero_()
        graph = self._recording(tolerance)
        for _ in range(0, max_iterations, RECORDED_ITERATIONS):
            wp.capture_launch(graph)
            if not self._active.numpy().any():
                break
        return int(self._iterations.numpy().max())

    def multiply(self, direction: wp.array, product: wp.array) -> None:
        """``product`` = H ``direction``."""
        launch = _launcher(self._device)
        launch(
            linear.slot_products,
            self.shape,
            [direction, self._garment.faces, self._contact, self.slot_stiffness],
            [self._slot_force],
        )
        launch(
            linear.multiply,
            self.shape,
            [
                direction,
                self._row_start,
                self._columns,
                self.blocks,
                self._far_start,
                self._far_columns,
                self._far_coefficients,
                self._contact,
                self._slot_force,
            ],
            [product],
        )

    def _dot(self, a: wp.array, b: wp.array) -> None:
        wp.launch(linear.partial_dot, dim=(self.shape[0], PARTS), inputs=[a, b], outputs=[self._partial], device=self._device)

    def _recording(self, tolerance: float) -> wp.Graph:
        """A chunk of iterations, recorded once a tolerance: replaying costs a fraction of launching."""
        if tolerance not in self._recorded:
            wp.load_module(linear, device=self._device)  # Nothing may compile while recording.
            with wp.ScopedCapture(device=self._device, force_module_load=False) as capture:
                for _ in range(RECORDED_ITERATIONS):
                    self._iterate(tolerance)
            self._recorded[tolerance] = capture.graph
        return self._recorded[tolerance]

    def _iterate(self, tolerance: float) -> None:
        launch = _launcher(self._device)
        worlds = self.shape[0]
        self.multiply(self._direction, self._product)
        self._dot(self._direction, self._product)
        launch(linear.step_length, worlds, [self._partial, self._energy, self._active], [self._alpha])
        launch(
            linear.advance,
            self.shape,
            [self._alpha, self._direction, self._product, self._inverse, self.solution, self._residual],
            [self._preconditioned],
        )
        self._dot(self._residual, self._preconditioned)
        launch(
            linear.next_scalars,
            worlds,
            [
                self._partial,
                self._first_energy,
                wp.float64(tolerance * tolerance),
                self._energy,
                self._active,
                self._iterations,
            ],
            [self._beta],
        )
        launch(linear.turn_direction, self.shape, [self._beta, self._preconditioned, self._direction], [])


def _launcher(device: wp.Device) -> Callable[[wp.Kernel, object, list, list], None]:
    def launch(kernel: wp.Kernel, dim: object, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device)

    return launch
