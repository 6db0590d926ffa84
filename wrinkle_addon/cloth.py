"""The cloth simulation: one garment, or many copies of it side by side, on a moving body.

Implicit: each step minimises the incremental potential (inertia, elasticity, contact, friction) by Newton's method
with conjugate gradients, contact planes frozen in between and found again before each linearisation.

Arrays in and out are NumPy. With several worlds they have a leading axis [world_count]; worlds never meet.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ..kernels.cloth import assembly
from .cloth_contact import ContactSearch, ContactSettings, Limbs
from .cloth_model import ClothModel, FloatArray, IntArray
from .cloth_state import ClothState, SettleReport, SolverSettings, per_world
from .divergence import find_divergence
from .elasticity import Elasticity, upload_garment
from .linear_solver import BlockSystem
from .settle_safeguards import RESTLESS, SettleSafeguards
from .surface import SurfaceMeasures
from .time_integration import EarlierStep, step_inertia
from .untangling import MAX_PASSES, STEP_PASSES, untangle_worlds

if TYPE_CHECKING:
    from scipy import sparse

STANDARD_GRAVITY = 9.80665

# A vertex that ends a step deeper in the body than this [m] is put on its skin.
EXPELLED_DEPTH = 0.001

# On its way to equilibrium a garment soon changes little: after so many linearisations ...
YOUNG_ITERATIONS = 8
# ... the coarse levels of a preconditioner serve for so many.
PRECONDITIONED = 4


class ClothSimulation:
    """Simulates ``world_count`` copies of a garment, each on its own body of one topology.

    Args:
        model: The garment.
        body_faces: Triangles of the body, outward by their winding, shape [body_triangle_count, 3].
        body_positions: The body at the start [m], shape [body_vertex_count, 3] or with a leading [world_count].
        pin_stiffness: Stiffness that holds each vertex to its pin target [N/m], shape [vertex_count]; see
            :meth:`place_pins`. None pins nothing.
        limbs: Which parts of the body each vertex may touch; None lets it touch all.

    Raises:
        ValueError: If the body has no faces.
    """

    def __init__(
        self,
        model: ClothModel,
        body_faces: ArrayLike,
        body_positions: ArrayLike,
        *,
        contact_settings: ContactSettings | None = None,
        solver_settings: SolverSettings | None = None,
        pin_stiffness: ArrayLike | None = None,
        limbs: Limbs | None = None,
        world_count: int = 1,
        device: str = "cpu",
    ):
        self.model = model
        self.contact_settings = contact_settings or ContactSettings()
        self.solver_settings = solver_settings or SolverSettings()
        self.world_count = world_count
        self.device = wp.get_device(device)
        self.shape = (world_count, model.vertex_count)
        body_faces = np.asarray(body_faces, np.int32)
        if not len(body_faces):
            raise ValueError("The body has no faces to collide with.")
        self._garment = self._upload_garment(pin_stiffness)
        self._elasticity = Elasticity(model, self._garment, world_count)
        self._allocate_state()
        self._surface = SurfaceMeasures(model.faces, model.vertex_count)
        self._body_faces = body_faces
        self._body_count = np.shape(body_positions)[-2]
        self._contact = ContactSearch(
            model,
            self.contact_settings,
            self._garment.area,
            self._garment.faces,
            body_faces,
            self._per_world(body_positions, "body_positions", self._body_count),
            limbs,
        )
        self._system = BlockSystem(model, self._garment, self._elasticity, self._contact.frozen, world_count)
        self.set_gravity([0.0, 0.0, -STANDARD_GRAVITY])

    # State

    @property
    def positions(self) -> FloatArray:
        """Vertex positions [m], shape [world_count, vertex_count, 3]; a copy."""
        return self._positions.numpy().copy()

    @property
    def body_positions(self) -> NDArray[np.float32]:
        """Body vertices [m], shape [world_count, body_vertex_count, 3]; a copy."""
        return self._contact.body_positions

    def start(self, positions: ArrayLike, velocities: ArrayLike | None = None) -> None:
        """Begin from these positions [m] and velocities [m/s] with no memory of earlier contact.

        Shapes [vertex_count, 3], or with a leading [world_count].
        """
        self._positions.assign(self._per_world(positions, "positions"))
        self._rest()
        if velocities is not None:
            self._velocities.assign(self._per_world(velocities, "velocities"))
        self._contact.forget()
        self._move_all()

    def state(self) -> ClothState:
        return ClothState(
            self.positions,
            self._velocities.numpy().copy(),
            self._contact.anchor_face.numpy().copy(),
            self._contact.anchor_weights.numpy().copy(),
            self._earlier,
        )

    def restore(self, state: ClothState) -> None:
        """Go on from a state of :meth:`state`, to the bit."""
        self.start(state.positions, state.velocities)
        self._contact.anchor_face.assign(state.anchor_faces)
        self._contact.anchor_weights.assign(state.anchor_weights)
        self._earlier = state.earlier

    def hold(self) -> None:
        """Let static friction hold the garment where it lies, as far as it can.

        A garment that lies still leaves its friction open to guess from its shape: it is what balances all other
        forces. So a settled shape is all that has to be kept of an equilibrium; call this after :meth:`start` and
        :meth:`move_body`, or the garment sags until friction has built up again.
        """
        self._contact.forget()
        self._contact.turn(self._positions)
        self._contact.find(self._positions, self._moving)
        self._set_inertia(self.positions, np.zeros(self.world_count))
        # Fresh anchors pull at nothing yet, so this gradient is without friction.
        self._contact.hold(self._evaluate_gradient())

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Acceleration of free fall [m/s^2], shape [3] or [world_count, 3]."""
        self._gravity.assign(np.broadcast_to(np.asarray(gravity, np.float64), (self.world_count, 3)))

    def set_outward(self, directions: ArrayLike) -> None:
        """Where each vertex's outside is: unit vectors, shape [vertex_count, 3] or with a leading [world_count].

        Left alone, every body triangle is accepted.
        """
        self._contact.set_outward(self._per_world(directions, "directions"))

    def place_pins(self, targets: ArrayLike) -> None:
        """Where pinned vertices are held [m], shape [vertex_count, 3] or with a leading [world_count]."""
        self._pin_target.assign(self._per_world(targets, "targets"))

    def move_body(self, body_positions: ArrayLike) -> None:
        """Put the body somewhere else [m]; friction anchors go with it.

        Shape [body_vertex_count, 3], or with a leading [world_count].
        """
        self._contact.move_body(self._per_world(body_positions, "body_positions", self._body_count))

    # Motion

    def step(self, body_positions: ArrayLike, dt: float, *, guess: ArrayLike | None = None) -> None:
        """Advance by ``dt`` [s] while the body moves to ``body_positions`` [m].

        The first step from rest, or from :meth:`start`, is one of backward Euler. Layers that have passed through each
        other are drawn apart at its end.

        Args:
            guess: Where to begin the search for the new positions [m], such as the garment carried along by the
                body's skinning; changes what contact is met on the way, not what is solved.
        """
        if dt <= 0.0:
            raise ValueError(f"A time step must be longer than 0 s, not {dt} s.")
        now = EarlierStep(self.positions, self._velocities.numpy().copy(), dt)
        inertia = step_inertia(now.positions, now.velocities, dt, self._earlier)
        self.move_body(body_positions)
        with self._elasticity.damped(self._positions, dt):
            self._positions.assign(inertia.target if guess is None else self._per_world(guess, "guess"))
            self._minimise(inertia.target, inertia.span)
        reached = self.positions
        self._velocities.assign(inertia.velocities(reached))
        if self.untangle(STEP_PASSES).any():
            self._contact.expel(self._positions, EXPELLED_DEPTH)
        if self.solver_settings.order == 2:
            # What was drawn apart has no velocity from it: its past moves along.
            self._earlier = EarlierStep(now.positions + (self.positions - reached), now.velocities, dt)

    def follow(self, body_positions: ArrayLike, carried: ArrayLike, dt: float = 1.0 / 30.0) -> None:
        """Advance without inertia while the body moves: the garment is carried along and then relaxes.

        What has passed through itself on the way is drawn apart again.

        Args:
            body_positions: The body's next positions [m].
            carried: The garment moved along with the body [m], from which it relaxes.
            dt: Time to relax [s]; the mass it leaves in the system holds the garment back from what does not resist.
        """
        self.move_body(body_positions)
        self._positions.assign(self._per_world(carried, "carried"))
        self._minimise(self.positions, dt)
        self.untangle()
        self._rest()

    def untangle(self, max_passes: int = MAX_PASSES) -> IntArray:
        """Draw layers apart that have passed through each other, in some passes, but not where the body does, too.

        Returns how many edges pierced triangles before, shape [world_count]; where there were 0, nothing has changed.
        """
        if self.contact_settings.self_thickness == 0.0:
            return np.zeros(self.world_count, np.int32)
        # A third of the thickness a pass, so that no layer is thrown over its neighbour.
        step = self.contact_settings.self_thickness / 3.0
        bodies = self.body_positions, self._body_faces
        positions, found = untangle_worlds(self.positions, self._surface, step, *bodies, max_passes)
        if found.any():
            self._positions.assign(positions)
        return found

    def settle(
        self,
        tolerance: float = 1.0,
        max_iterations: int = 60,
        *,
        trapped: float = 0.0,
        overtime: int = 0,
        worlds: NDArray[np.bool_] | None = None,
    ) -> SettleReport:
        """Go to static equilibrium with the body at rest.

        Newton's method with the safeguards of :mod:`.settle_safeguards`.

        Args:
            tolerance: Residual to stop at, in root mean square nodal weights (1 for Wang et al., 0.1 for Xu et al.).
            max_iterations: Bound on the linearisations.
            trapped: Share of the vertices that need not come to rest: cloth caught where limbs of the body cut into
                each other has no equilibrium, and must not keep the rest waiting.
            overtime: Further linearisations for garments that are restless by then.
            worlds: Which garments settle, shape [world_count]; the others stay where they are. None lets all.
        """
        count = self.world_count
        safeguards = SettleSafeguards(count)
        moving = np.ones(count, bool) if worlds is None else worlds.copy()
        residual, whole, taken = np.full(count, np.inf), np.full(count, np.inf), np.ones(count)
        iterations, linear_iterations = np.zeros(count, np.int32), np.zeros(count, np.int32)
        self._moving.assign(moving.astype(np.int32))
        self._rest()
        self._contact.turn(self._positions)
        for iteration in range(max_iterations + overtime + 1):
            self._patience.assign(safeguards.patience)
            self._contact.find(self._positions, self._moving, self._moving, self._patience)
            self._set_inertia(self.positions, np.zeros(self.world_count))
            self._evaluate_gradient()
            before, residual = residual, np.where(moving, self._rms_residual(trapped), residual)
            # Each world's own last one: contact that is looked for again in its place may remember other walls.
            whole = np.where(moving, self._rms_residual(), whole)
            if iteration:
                safeguards.judge(before, residual, taken, self._contact.touches())
            # A world that is done must not go on with its neighbours, or its result would depend on them.
            moving &= residual > (tolerance if iteration < max_iterations else max(tolerance, RESTLESS))
            if not moving.any() or iteration == max_iterations + overtime:
                break
            self._moving.assign(moving.astype(np.int32))
            self._inverse_dt2.assign(1.0 / safeguards.span**2)
            self._kept.assign(safeguards.kept)
            linear, taken = self._newton_step(
                safeguards.share, precondition=iteration < YOUNG_ITERATIONS or iteration % PRECONDITIONED == 0
            )
            iterations += moving
            linear_iterations += linear
        self._move_all()
        self._check_numbers(whole if worlds is None else whole[worlds])
        return SettleReport(residual, whole, iterations, linear_iterations, residual <= tolerance)

    # Equilibrium

    def residual(self, positions: ArrayLike | None = None) -> FloatArray:
        """Static force on every vertex [N], contact included, shape [world_count, vertex_count, 3]."""
        with self._equilibrium_at(positions):
            return -self._gradient.numpy()

    def relative_residual(self) -> FloatArray:
        """Root mean square static force in nodal weights, shape [world_count]."""
        with self._equilibrium_at(None):
            return self._rms_residual()

    def energy(self) -> FloatArray:
        """Static potential energy [J], contact included, shape [world_count]."""
        with self._equilibrium_at(None):
            return self._evaluate_energy()

    def hessian(self, positions: ArrayLike | None = None, world: int = 0) -> sparse.csr_matrix:
        """Static Hessian [N/m] with contact included, as a SciPy CSR matrix of shape [3 vertex_count, 3 vertex_count].

        Exact for contact planes and friction bounds that stay as they are at these positions. Needs SciPy.
        """
        with self._equilibrium_at(positions):
            self._kept.fill_(1.0)
            self._assemble(self._kept)
            self._kept.zero_()
            return self._system.to_scipy(world)

    def clearance(self) -> NDArray[np.float32]:
        """Signed distance of every vertex to the body [m], negative inside, 1e6 where no body is near.

        Shape [world_count, vertex_count].
        """
        return self._contact.clearance(self._positions)

    # Inner workings

    def _move_all(self) -> None:
        """No world keeps still, as some do in :meth:`settle`."""
        self._moving.fill_(1)
        self._kept.zero_()

    def _rest(self) -> None:
        """Forget all motion."""
        self._velocities.zero_()
        self._earlier = None

    def _minimise(self, target: FloatArray, dt: float) -> None:
        """Newton's method on the incremental potential of one step."""
        self._contact.turn(self._positions)
        self._set_inertia(target, np.full(self.world_count, 1.0 / dt**2))
        for _ in range(self.solver_settings.newton_iterations):
            self._contact.find(self._positions, self._none, self._moving)
            self._evaluate_gradient()
            self._newton_step()
        # What a fast body has run over in spite of all must not go on into it, nor come out on its other side.
        self._contact.expel(self._positions, EXPELLED_DEPTH)
        # Only now: a search that overshoots and comes back must not drag the anchors along.
        self._contact.follow(self._positions, self._moving)

    def _newton_step(
        self, share: FloatArray | float = 1.0, *, precondition: bool = True
    ) -> tuple[IntArray, FloatArray]:
        """One linearisation at the frozen contact and the gradient: conjugate gradients, then the line search.

        Args:
            share: Most of its step that each world takes.
            precondition: Whether the preconditioner is made anew, else its coarse levels of an earlier step serve on.

        Returns the iterations of the former and the share of its step that the latter left each world.
        """
        settings = self.solver_settings
        before = self._evaluate_energy()
        self._linearise(precondition=precondition)
        iterations = self._system.solve(
            self._gradient, self._moving, settings.linear_tolerance, settings.linear_iterations
        )
        start = self.positions
        step = self._system.solution.numpy().astype(np.float64)
        # A nearly singular Hessian asks for steps that its own linearisation does not bear.
        longest = np.linalg.norm(step, axis=2).max(1)
        self._check_numbers(before, self._system.first_energy.numpy(), longest)
        length = np.minimum(share, settings.longest_step / np.maximum(longest, 1e-12))
        worse = np.zeros(self.world_count, bool)
        for _ in range(settings.line_search_halvings + 1):
            self._positions.assign(start + length[:, None, None] * step)
            # Energies differ by less than their own rounding once a step has converged.
            worse = ~(self._evaluate_energy() <= before + 1e-12 * np.abs(before))
            if not worse.any():
                break
            length[worse] *= 0.5
        else:
            length[worse] = 0.0
            self._positions.assign(start + length[:, None, None] * step)
        return iterations, np.where(longest > 0.0, length, 0.0)

    def _check_numbers(self, *measures: FloatArray) -> None:
        """Stop before what is no number spreads; each measure of shape [world_count] stands for all vertices."""
        if not np.isfinite(measures).all():
            raise find_divergence(self.positions, self._gradient.numpy())

    def _linearise(self, *, precondition: bool = True) -> None:
        """The linear system and a preconditioner for it, which no compressive stress makes indefinite if made anew."""
        self._assemble(self._nothing_kept if precondition else self._kept)
        self._system.precondition(self._positions, coarse_levels=precondition)
        if precondition and self._kept.numpy().any():
            self._assemble(self._kept)

    def _assemble(self, kept: wp.array) -> None:
        self._system.assemble(self._positions, self._inverse_dt2, kept)

    def _evaluate_gradient(self) -> wp.array:
        self._elasticity.deform(self._positions)
        contact = self._contact
        self._push_pairs()
        self._launch(
            assembly.gradient,
            self.shape,
            [*self._potential(), self._elasticity.deformation, self._elasticity.stress, contact.pair_force],
            [self._gradient],
        )
        for elements in self._elasticity.elements:
            elements.add_gradient(self._gradient)
        return self._gradient

    def _evaluate_energy(self) -> FloatArray:
        """Incremental potential of each world [J], shape [world_count]."""
        self._elasticity.deform(self._positions)
        self._push_pairs()
        self._launch(
            assembly.vertex_energies,
            self.shape,
            [*self._potential(), self._contact.pair_energy],
            [self._vertex_energy],
        )
        return self._vertex_energy.numpy().sum(1) + self._elasticity.energy()

    def _potential(self) -> list:
        """What the incremental potential depends on, as its kernels take it."""
        return [
            self._positions,
            self._garment,
            self._contact.frozen,
            self._gravity,
            self._inertia_target,
            self._inverse_dt2,
            self._pin_target,
        ]

    def _push_pairs(self) -> None:
        contact = self._contact
        self._launch(
            assembly.pair_forces,
            len(contact.pair_force),
            [self._positions.flatten(), contact.frozen],
            [contact.pair_energy, contact.pair_force],
        )

    @contextmanager
    def _equilibrium_at(self, positions: ArrayLike | None) -> Iterator[None]:
        """Static forces at these positions, or where the garment is; the state stays as it was."""
        kept = self.positions
        if positions is not None:
            self._positions.assign(self._per_world(positions, "positions"))
        self._contact.find(self._positions, self._none)
        self._set_inertia(kept, np.zeros(self.world_count))
        self._evaluate_gradient()
        try:
            yield
        finally:
            self._positions.assign(kept)

    def _set_inertia(self, target: FloatArray, inverse_dt2: FloatArray) -> None:
        self._inertia_target.assign(target)
        self._inverse_dt2.assign(inverse_dt2)

    def _rms_residual(self, left_out: float = 0.0) -> FloatArray:
        """Root mean square of the last gradient in nodal weights, shape [world_count].

        Args:
            left_out: Share of the vertices, those with the largest forces, that do not count.
        """
        weight = self.model.mass.mean() * STANDARD_GRAVITY
        squares = np.sort((self._gradient.numpy() ** 2).sum(2), axis=1)
        counted = self.model.vertex_count - int(left_out * self.model.vertex_count)
        return np.sqrt(squares[:, :counted].mean(1)) / weight

    def _launch(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)

    def _per_world(self, values: ArrayLike, name: str, count: int | None = None) -> FloatArray:
        return per_world(values, name, self.world_count, self.model.vertex_count if count is None else count)

    def _upload_garment(self, pin_stiffness: ArrayLike | None) -> assembly.Garment:
        model = self.model
        pins = np.zeros(model.vertex_count) if pin_stiffness is None else np.asarray(pin_stiffness, np.float64)
        if pins.shape != (model.vertex_count,) or not (pins >= 0.0).all():
            raise ValueError(f"pin_stiffness must be {model.vertex_count} numbers that are not negative.")
        return upload_garment(model, pins, self.device)

    def _allocate_state(self) -> None:
        def array(shape: tuple[int, ...] | int, dtype: type) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=self.device)

        self._positions = array(self.shape, wp.vec3d)
        self._velocities = array(self.shape, wp.vec3d)
        self._earlier: EarlierStep | None = None
        self._inertia_target = array(self.shape, wp.vec3d)
        self._pin_target = array(self.shape, wp.vec3d)
        self._gradient = array(self.shape, wp.vec3d)
        self._vertex_energy = array(self.shape, wp.float64)
        self._inverse_dt2 = array(self.world_count, wp.float64)
        self._gravity = array(self.world_count, wp.vec3d)
        self._kept, self._nothing_kept = array(self.world_count, wp.float64), array(self.world_count, wp.float64)
        self._moving, self._none, self._patience = (array(self.world_count, wp.int32) for _ in range(3))
        self._moving.fill_(1)
