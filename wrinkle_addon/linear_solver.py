"""Host side of the preconditioned conjugate gradients in :mod:`..kernels.cloth.linear`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from ..kernels.cloth import assembly, coarse, linear
from .cloth_model import ClothModel
from .coarse_correction import CoarseCorrection
from .elasticity import Elasticity
from .launch_graph import LaunchGraph
from .topology import IntArray, by_fours, rows_of

if TYPE_CHECKING:
    from scipy import sparse

PARTS = 64
# Iterations that are recorded and replayed: a look at what is done costs a GPU as much as some of them, a CPU nothing.
RECORDED_ITERATIONS = {"cuda": 10, "cpu": 1}


class BlockSystem:
    """The linear system of one Newton step for every world: blocks, their preconditioner, and a solver for them.

    Args:
        corrected: Whether a coarse space is added to the preconditioner; for many linear systems a step.
        layers: Vertices of garments worn over each other, from the innermost outwards, if those are what pairs hold
            apart. Their preconditioner goes through them one after the other, outwards and back (symmetric block
            Gauss-Seidel): pairs are the stiffest of all that is in the system. One world.

    Attributes:
        blocks: One-ring Hessian blocks [N/m], shape [world_count, block_count].
        pair_stiffness: Stiffness of each self-contact pair [N/m], in the order of the contact's list.
        solution: Step found by :meth:`solve` [m], shape [world_count, vertex_count].
        first_energy: Gradient times its preconditioned self at the start of :meth:`solve` [J], shape [world_count].
    """

    def __init__(
        self,
        model: ClothModel,
        garment: assembly.Garment,
        elasticity: Elasticity,
        contact: assembly.Contact,
        world_count: int,
        *,
        corrected: bool = True,
        layers: Sequence[slice] = (),
    ):
        device = contact.face.device
        vertex_count = model.vertex_count
        self.shape = (world_count, vertex_count)
        self._model = model
        self._garment = garment
        self._elasticity = elasticity
        self._contact = contact
        self._device = device
        self._layers = layers
        self._chunk_size = RECORDED_ITERATIONS["cuda" if device.is_cuda else "cpu"]

        def upload(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        self._row_start = upload(model.row_start, wp.int32)
        self._columns = upload(model.columns, wp.int32)
        self._diagonal_entry = upload(model.diagonal_entry, wp.int32)
        self._contribution_start = upload(model.contribution_start, wp.int32)
        triangle, pair = np.divmod(model.contributions, 9)
        self._contributions = upload(triangle << 4 | (pair // 3) << 2 | pair % 3, wp.int32)
        self._block_bending = upload(model.block_bending, wp.float64)
        own_bending = np.bincount(rows_of(model.row_start), model.block_bending, vertex_count)
        self._own_bending = upload(own_bending, wp.float64)
        self._mirrored = upload(_mirrored(model), wp.vec2i)
        far = by_fours(model.far_start, model.far_columns, model.far_coefficients.astype(np.float32))
        kinds = wp.int32, wp.vec4i, wp.vec4
        self._far = [upload(values, kind) for values, kind in zip(far, kinds, strict=True)]

        def vectors() -> wp.array:
            return wp.zeros(self.shape, dtype=wp.vec3, device=device)

        def scalars(dtype: type) -> wp.array:
            return wp.zeros(world_count, dtype=dtype, device=device)

        self.blocks = wp.zeros((world_count, len(model.columns)), dtype=wp.mat33, device=device)
        self._diagonal = wp.zeros(self.shape, dtype=wp.mat33, device=device)
        self._inverse = wp.zeros(self.shape, dtype=wp.mat33, device=device)
        self._correction = CoarseCorrection(model, device, world_count) if corrected else None
        self._hold_pairs()
        self.solution, self._residual, self._direction = vectors(), vectors(), vectors()
        self._preconditioned, self._product = vectors(), vectors()
        self._partial = wp.zeros((world_count, PARTS), dtype=wp.float64, device=device)
        self._energy, self.first_energy = scalars(wp.float64), scalars(wp.float64)
        self._alpha, self._beta = scalars(wp.float32), scalars(wp.float32)
        self._active, self._iterations = scalars(wp.int32), scalars(wp.int32)
        self._active.fill_(1)

    def assemble(self, positions: wp.array, inverse_dt2: wp.array, kept: wp.array) -> None:
        """Fill the blocks at ``positions`` (float64 [m]) for the elasticity and the contact planes as they stand.

        ``kept`` is the share of its compressive stress that each world takes into account, shape [world_count]: 1 for
        the exact Hessian, which may be indefinite, 0 for a positive definite one.
        """
        elasticity = self._elasticity
        elasticity.linearise(kept)
        wp.launch(
            assembly.assemble_blocks,
            dim=(self.shape[0], len(self._mirrored)),
            inputs=[
                self._garment,
                elasticity.deformation,
                elasticity.tangent,
                elasticity.held,
                self._contribution_start,
                self._contributions,
                self._block_bending,
                self._mirrored,
            ],
            outputs=[self.blocks],
            device=self._device,
        )
        wp.launch(
            assembly.assemble_own_blocks,
            dim=self.shape,
            inputs=[self._row_start, self._diagonal_entry, self._own_bending],
            outputs=[self.blocks],
            device=self._device,
        )
        for elements in elasticity.elements:
            elements.add_blocks(positions, kept, self.blocks)
        if len(self._contact.pair_strength) != len(self.pair_stiffness):
            self._hold_pairs()
        wp.launch(
            assembly.assemble_diagonal,
            dim=self.shape,
            inputs=[positions, self._garment, self._contact, inverse_dt2, self._diagonal_entry, self.blocks],
            device=self._device,
        )
        wp.launch(
            assembly.pair_stiffnesses,
            dim=len(self.pair_stiffness),
            inputs=[positions.flatten(), self._contact],
            outputs=[self.pair_stiffness],
            device=self._device,
        )

    def precondition(self, positions: wp.array, *, coarse_levels: bool = True) -> None:
        """Make the preconditioner from the blocks as they stand, which must be positive definite for the coarse levels.

        It goes on to serve for blocks with compressive stress, which are softer. Left as they were, the coarse levels
        serve for a while, too: contact comes and goes in each vertex's own block, long waves stay.
        """
        wp.launch(
            assembly.precondition_diagonal,
            dim=self.shape,
            inputs=[self._contact, self.pair_stiffness, self._diagonal_entry, self.blocks],
            outputs=[self._diagonal, self._inverse],
            device=self._device,
        )
        if coarse_levels and self._correction is not None:
            self._correction.assemble(positions, self.blocks, self._diagonal)

    def solve(self, gradient: wp.array, moving: wp.array, tolerance: float, max_iterations: int) -> IntArray:
        """Solve H step = -gradient from zero; returns the iterations that each world took, shape [world_count].

        A world whose matrix turns out not to be positive definite keeps the step that it has until then.

        Args:
            gradient: Gradient [N], float64, shape [world_count, vertex_count].
            moving: Worlds with 0 keep still: their step is zero. Shape [world_count].
            tolerance: Share of the first preconditioned residual norm at which a world stops.
            max_iterations: Bound on the iterations.
        """
        outputs = [self.solution, self._residual, self._preconditioned]
        _launcher(self._device)(linear.start, self.shape, [gradient, self._inverse], outputs)
        self._begin(moving)
        chunk = self._chunk(tolerance, max_iterations)
        for _ in range(0, max_iterations, self._chunk_size):
            chunk()
            if not self._active.numpy().any():
                break
        return self._iterations.numpy().copy()

    def launch_solve(self, gradient: wp.array, moving: wp.array, tolerance: float, max_iterations: int) -> None:
        """:meth:`solve` for one world, but from what :attr:`solution` holds; it can be recorded."""
        launch = _launcher(self._device)
        self._active.fill_(1)
        self.multiply(self.solution, self._product)
        found = [self._residual, self._preconditioned]
        launch(linear.start_from, self.shape, [gradient, self._inverse, self._product], found)
        self._begin(moving)
        if self._device.is_cpu:
            wp.capture_while(self._active, lambda: self._iterate(tolerance, max_iterations))
        else:
            # Iterations that are left over cost less than to ask whether to go on, which not every driver can.
            for _ in range(max_iterations):
                self._iterate(tolerance, max_iterations)

    def hold_vertices(self, held: wp.array) -> None:
        """Let vertices whose entry is not 0 keep still in the next solve; after :meth:`precondition`, one world."""
        wp.launch(linear.hold_vertices, dim=self.shape, inputs=[held, self._inverse], device=self._device)

    def multiply(self, direction: wp.array, product: wp.array) -> None:
        """``product`` = H ``direction``, in the worlds whose solve goes on: all, until one began."""
        launch = _launcher(self._device)
        launch(
            linear.pair_products,
            len(self.pair_stiffness),
            [direction.flatten(), self._contact, self.pair_stiffness],
            [self._pair_force],
        )
        launch(
            linear.multiply,
            self.shape,
            [
                direction,
                self._row_start,
                self._columns,
                self.blocks,
                *self._far,
                self._contact,
                self._pair_force,
                self._active,
            ],
            [product],
        )

    def to_scipy(self, world: int) -> sparse.csr_matrix:
        """One world's matrix [N/m] in SciPy's form, shape [3 vertex_count, 3 vertex_count]."""
        from scipy import sparse

        model, c, count = self._model, self._contact, self._model.vertex_count
        shape = (3 * count, 3 * count)
        blocks = self.blocks.numpy()[world].astype(np.float64)
        near = sparse.bsr_matrix((blocks, model.columns, model.row_start), shape=shape).tocsr()
        far = sparse.csr_matrix((model.far_coefficients, model.far_columns, model.far_start), shape=(count, count))
        vertices = c.pair_vertices.numpy()[: int(c.pair_total.numpy()[0])]
        pairs = np.flatnonzero(vertices[:, 0] // count == world)
        vertices = vertices[pairs] - world * count
        factors = c.pair_weights.numpy()[pairs].astype(np.float64)[:, :, None] * c.pair_normal.numpy()[pairs][:, None]
        rows = np.repeat(np.arange(len(pairs)), 12)
        columns = (3 * vertices[:, :, None] + np.arange(3)).ravel()
        jacobian = sparse.csr_matrix((factors.ravel(), (rows, columns)), shape=(len(pairs), 3 * count))
        stiffness = sparse.diags(self.pair_stiffness.numpy()[pairs].astype(np.float64))
        return (near + sparse.kron(far, sparse.identity(3)) + jacobian.T @ stiffness @ jacobian).tocsr()

    def _hold_pairs(self) -> None:
        """Make room for as many self-contact pairs as the contact's list now holds."""
        capacity = len(self._contact.pair_strength)
        self.pair_stiffness = wp.zeros(capacity, dtype=wp.float32, device=self._device)
        self._pair_force = wp.zeros(capacity, dtype=wp.vec3, device=self._device)
        self._chunks: dict[tuple[float, int], LaunchGraph] = {}  # They keep the arrays that they were made with.

    def _begin(self, moving: wp.array) -> None:
        """First direction and scalars from the residual and its preconditioned self."""
        launch = _launcher(self._device)
        self._correct()
        wp.copy(self._direction, self._preconditioned)
        self._dot(self._residual, self._preconditioned)
        scalars = [self._energy, self.first_energy, self._active, self._iterations]
        launch(linear.start_scalars, self.shape[0], [self._partial, moving], scalars)

    def _correct(self) -> None:
        """From the residual preconditioned block by block to what the whole preconditioner makes of it."""
        launch = _launcher(self._device)
        for outwards, layers in ((True, self._layers[1:]), (False, self._layers[-2::-1])):
            for layer in layers:
                inputs = [layer.start, self._inverse, self._contact, self.pair_stiffness, outwards]
                launch(linear.give_way, layer.stop - layer.start, inputs, [self._preconditioned])
        if self._correction is not None:
            self._correction.add(self._residual, self._preconditioned)

    def _dot(self, a: wp.array, b: wp.array) -> None:
        launch = _launcher(self._device)
        launch(linear.partial_dot, (self.shape[0], PARTS), [a, b], [self._partial])

    def _chunk(self, tolerance: float, max_iterations: int) -> LaunchGraph:
        """Some iterations, recorded once a tolerance: replaying costs a fraction of launching."""

        def iterations() -> None:
            for _ in range(self._chunk_size):
                self._iterate(tolerance, max_iterations)

        key = tolerance, max_iterations
        if key not in self._chunks:
            self._chunks[key] = LaunchGraph(iterations, (linear, coarse), self._device)
        return self._chunks[key]

    def _iterate(self, tolerance: float, max_iterations: int) -> None:
        launch = _launcher(self._device)
        worlds = self.shape[0]
        self.multiply(self._direction, self._product)
        self._dot(self._direction, self._product)
        scalars = [self._partial, self._energy, self._iterations, self._active]
        launch(linear.step_length, worlds, scalars, [self._alpha])
        launch(
            linear.advance,
            self.shape,
            [self._alpha, self._direction, self._product, self._inverse, self.solution, self._residual],
            [self._preconditioned],
        )
        self._correct()
        self._dot(self._residual, self._preconditioned)
        launch(
            linear.next_scalars,
            worlds,
            [
                self._partial,
                self.first_energy,
                wp.float64(tolerance * tolerance),
                max_iterations,
                self._energy,
                self._active,
                self._iterations,
            ],
            [self._beta],
        )
        launch(linear.turn_direction, self.shape, [self._beta, self._preconditioned, self._direction], [])


def _mirrored(model: ClothModel) -> IntArray:
    """Blocks above the diagonal, each with the one that mirrors it, shape [pair_count, 2]."""
    rows, columns = rows_of(model.row_start).astype(np.int64), model.columns.astype(np.int64)
    # Ascending, as blocks are.
    mirror = np.searchsorted(rows * model.vertex_count + columns, columns * model.vertex_count + rows)
    above = np.flatnonzero(rows < columns)
    return np.stack([above, mirror[above]], 1).astype(np.int32)


def _launcher(device: wp.Device) -> Callable[[Any, Any, list, list], None]:
    def launch(kernel: Any, dim: Any, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device)

    return launch
