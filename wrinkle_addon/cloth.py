"""The cloth simulation: one garment, or many copies of it side by side, on a moving body.

Implicit: each step minimises the incremental potential (inertia, elasticity, contact, friction) by Newton's method
with conjugate gradients, contact planes frozen in between and found again before each linearisation.

Arrays in and out are NumPy. With several worlds they have a leading axis [world_count]; worlds never meet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ..kernels.cloth import assembly, contact, linear, membrane, self_contact
from .cloth_model import ClothModel, group
from .linear_solver import PARTS, BlockSystem

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class ContactSettings:
    """How the garment touches the body and itself.

    Attributes:
        thickness: Distance from the body at which contact begins [m].
        pressure: Pressure that holds the garment off when it is pressed down to the surface itself [Pa].
        depth: Depth inside the body beyond which the force stops growing [m].
        slip: How far a vertex gives before static friction lets go [m].
        radius: How far around a vertex the body is looked for [m].
        least_cosine: A body triangle touches a vertex only if the cosine between its normal and the vertex's outward
            direction is larger than this; keeps the cloth of one limb from clinging to another.
        self_thickness: Distance at which the garment touches itself [m], 0 to let it pass.
    """

    thickness: float = 0.003
    pressure: float = 3.0e3
    depth: float = 0.01
    slip: float = 0.0005
    radius: float = 0.04
    least_cosine: float = -0.2
    self_thickness: float = 0.003


@dataclass(frozen=True)
class SolverSettings:
    """Where iterations stop.

    Attributes:
        linear_tolerance: Share of its first residual at which a linear system counts as solved (inexact Newton).
        linear_iterations: Bound on the iterations of one linear system.
        newton_iterations: Linearisations of one step.
        line_search_halvings: How often a step that does not lower the energy is halved.
    """

    linear_tolerance: float = 0.05
    linear_iterations: int = 150
    newton_iterations: int = 2
    line_search_halvings: int = 6


@dataclass(frozen=True, eq=False)
class ClothState:
    """What a simulation goes on from: positions [m], velocities [m/s], and the friction anchors on the body.

    Shapes [world_count, vertex_count, 3] and [world_count, vertex_count]; anchor_faces holds -1 where nothing sticks.
    """

    positions: FloatArray
    velocities: FloatArray
    anchor_faces: IntArray
    anchor_weights: NDArray[np.float32]


@dataclass(frozen=True)
class SettleReport:
    """How close to equilibrium a garment came.

    Attributes:
        residual: Root mean square of the force left on a vertex, in nodal weights, the worst of all worlds.
        iterations: Linearisations taken.
        linear_iterations: Conjugate gradient iterations taken.
        converged: Whether the residual fell below the tolerance asked for.
    """

    residual: float
    iterations: int
    linear_iterations: int
    converged: bool


class ClothSimulation:
    """Simulates ``world_count`` copies of a garment, each on its own body of one topology.

    Args:
        model: The garment.
        body_faces: Triangles of the body, outward by their winding, shape [body_triangle_count, 3].
        body_positions: The body at the start [m], shape [body_vertex_count, 3] or with a leading [world_count].
        pin_stiffness: Stiffness that holds each vertex to its pin target [N/m], shape [vertex_count]; see
            :meth:`place_pins`. None pins nothing.

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
        self._allocate_state()
        self._make_body(body_faces, self._per_world(body_positions, "body_positions"))
        self._make_contact()
        self._system = BlockSystem(model, self._garment, self._contact, world_count)
        self.set_gravity([0.0, 0.0, -STANDARD_GRAVITY])

    # State

    @property
    def positions(self) -> FloatArray:
        """Vertex positions [m], shape [world_count, vertex_count, 3]; a copy."""
        return self._positions.numpy().copy()

    def start(self, positions: ArrayLike, velocities: ArrayLike | None = None) -> None:
        """Begin from these positions [m] and velocities [m/s] with no memory of earlier contact.

        Shapes [vertex_count, 3], or with a leading [world_count].
        """
        self._positions.assign(self._per_world(positions, "positions"))
        self._start_positions.assign(self._positions)
        if velocities is None:
            self._velocities.zero_()
        else:
            self._velocities.assign(self._per_world(velocities, "velocities"))
        self._anchor_face.fill_(-1)

    def state(self) -> ClothState:
        return ClothState(
            self._positions.numpy().copy(),
            self._velocities.numpy().copy(),
            self._anchor_face.numpy().copy(),
            self._anchor_weights.numpy().copy(),
        )

    def restore(self, state: ClothState) -> None:
        """Go on from a state of :meth:`state`, to the bit."""
        self.start(state.positions, state.velocities)
        self._anchor_face.assign(state.anchor_faces)
        self._anchor_weights.assign(state.anchor_weights)

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Acceleration of free fall [m/s^2], shape [3] or [world_count, 3]."""
        self._gravity.assign(np.broadcast_to(np.asarray(gravity, np.float64), (self.world_count, 3)))

    def set_outward(self, directions: ArrayLike) -> None:
        """Where each vertex's outside is: unit vectors, shape [vertex_count, 3] or with a leading [world_count].

        Left alone, every body triangle is accepted.
        """
        self._outward.assign(self._per_world(directions, "directions").astype(np.float32))

    def place_pins(self, targets: ArrayLike) -> None:
        """Where pinned vertices are held [m], shape [vertex_count, 3] or with a leading [world_count]."""
        self._pin_target.assign(self._per_world(targets, "targets"))

    def move_body(self, body_positions: ArrayLike) -> None:
        """Put the body somewhere else [m]; friction anchors go with it."""
        self._body_points.assign(self._per_world(body_positions, "body_positions").astype(np.float32))
        for mesh in self._body_meshes:
            mesh.refit()
        self._launch(
            contact.vertex_normals,
            self._body_points.shape,
            [self._body_points, self._body_faces, self._body_corner_start, self._body_corners],
            [self._body_normals],
        )

    # Motion

    def step(self, body_positions: ArrayLike, dt: float, *, guess: ArrayLike | None = None) -> None:
        """Advance by ``dt`` [s] with backward Euler while the body moves to ``body_positions`` [m].

        Args:
            guess: Where to begin the search for the new positions [m], such as the garment carried along by the
                body's skinning; changes what contact is met on the way, not what is solved.
        """
        if dt <= 0.0:
            raise ValueError(f"A time step must be longer than 0 s, not {dt} s.")
        before = self._positions.numpy().copy()
        target = before + dt * self._velocities.numpy()
        self.move_body(body_positions)
        self._start_positions.assign(self._positions)
        self._positions.assign(target if guess is None else self._per_world(guess, "guess"))
        self._minimise(target, dt, self.solver_settings.newton_iterations)
        self._velocities.assign((self._positions.numpy() - before) / dt)

    def follow(self, body_positions: ArrayLike, carried: ArrayLike, dt: float = 1.0 / 30.0) -> None:
        """Advance without inertia while the body moves: the garment is carried along and then relaxes.

        Args:
            body_positions: The body's next positions [m].
            carried: The garment moved along with the body [m], from which it relaxes.
            dt: Time to relax [s]; the mass it leaves in the system holds the garment back from what does not resist.
        """
        self.move_body(body_positions)
        self._positions.assign(self._per_world(carried, "carried"))
        self._start_positions.assign(self._positions)
        self._minimise(self._positions.numpy().copy(), dt, self.solver_settings.newton_iterations)
        self._velocities.zero_()

    def settle(self, tolerance: float = 1.0, max_iterations: int = 60) -> SettleReport:
        """Go to static equilibrium with the body at rest.

        Steps without velocity whose time span doubles while they lower the energy: Newton's method for the
        equilibrium, with just as much mass kept in the system as it needs.

        Args:
            tolerance: Residual to stop at, in root mean square nodal weights (1 for Wang et al., 0.1 for Xu et al.).
            max_iterations: Bound on the linearisations.
        """
        dt = 1.0 / 15.0
        linear_total = 0
        self._velocities.zero_()
        residual = math.inf
        for iteration in range(max_iterations + 1):
            self._start_positions.assign(self._positions)
            self._linearise_contact()
            self._set_inertia(self._positions.numpy(), 0.0)
            residual = float(self._rms_residual(self._evaluate_gradient()).max())
            if residual <= tolerance or iteration == max_iterations:
                break
            self._set_inertia(self._positions.numpy(), 1.0 / dt**2)
            iterations, length = self._newton_step()
            linear_total += iterations
            dt = min(2.0 * dt, 1.0e3) if length == 1.0 else max(0.5 * dt, 1.0 / 240.0)
        return SettleReport(residual, iteration, linear_total, residual <= tolerance)

    # Equilibrium

    def residual(self, positions: ArrayLike | None = None) -> FloatArray:
        """Static force on every vertex [N], contact included, shape [world_count, vertex_count, 3]."""
        self._at(positions)
        return -self._evaluate_gradient().numpy()

    def relative_residual(self) -> FloatArray:
        """Root mean square static force in nodal weights, shape [world_count]."""
        self._at(None)
        return self._rms_residual(self._evaluate_gradient())

    def hessian(self, positions: ArrayLike | None = None, world: int = 0):
        """Static Hessian [N/m] with contact included, as a SciPy CSR matrix of shape [3 vertex_count, 3 vertex_count].

        Needs SciPy.
        """
        from scipy import sparse

        self._at(positions)
        self._evaluate_gradient()
        self._system.assemble(self._positions, self._deformation, self._stress, self._inverse_dt2, exact=True)
        model, count = self.model, self.model.vertex_count
        shape = (3 * count, 3 * count)
        near = sparse.bsr_matrix(
            (self._system.blocks.numpy()[world].astype(np.float64), model.columns, model.row_start), shape=shape
        )
        far = sparse.csr_matrix((model.far_coefficients, model.far_columns, model.far_start), shape=(count, count))
        total = near.tocsr() + sparse.kron(far, sparse.identity(3)).tocsr()
        slots = self_contact.SLOTS
        owned = np.arange(slots)[None, :] < self._contact.slot_count.numpy()[world][:, None]
        slot = np.flatnonzero(owned.ravel())
        if len(slot):
            corners = model.faces[self._contact.slot_triangle.numpy()[world][slot]]
            weights = self._contact.slot_weights.numpy()[world][slot].astype(np.float64)
            normals = self._contact.slot_normal.numpy()[world][slot].astype(np.float64)
            vertices = np.concatenate([(slot // slots)[:, None], corners], 1)
            factors = np.concatenate([np.ones((len(slot), 1)), -weights], 1)[:, :, None] * normals[:, None, :]
            rows = np.repeat(np.arange(len(slot)), 12)
            columns = (3 * vertices[:, :, None] + np.arange(3)).ravel()
            jacobian = sparse.csr_matrix((factors.ravel(), (rows, columns)), shape=(len(slot), 3 * count))
            stiffness = self._system.slot_stiffness.numpy()[world][slot].astype(np.float64)
            total = total + jacobian.T @ sparse.diags(stiffness) @ jacobian
        return total.tocsr()

    def clearance(self) -> NDArray[np.float32]:
        """Signed distance of every vertex to the body [m], negative inside, 1e6 far away, [world_count, vertex_count]."""
        self._find_body_contacts()
        gap = wp.zeros(self.shape, dtype=wp.float32, device=self.device)
        c = self._contact
        self._launch(contact.measure_depth, self.shape, [self._positions, c.face, c.point, c.normal], [gap])
        return gap.numpy()

    # Inner workings

    def _minimise(self, target: FloatArray, dt: float, iterations: int) -> None:
        """Newton's method on the incremental potential of one step."""
        self._set_inertia(target, 1.0 / dt**2)
        for _ in range(iterations):
            self._linearise_contact()
            self._evaluate_gradient()
            self._newton_step()

    def _newton_step(self) -> tuple[int, float]:
        """One linearisation at the frozen contact: conjugate gradients, then the line search.

        Returns the iterations of the former and the smallest step length that the latter left a world.
        """
        settings = self.solver_settings
        self._evaluate_gradient()
        before = self._evaluate_energy()
        self._system.assemble(self._positions, self._deformation, self._stress, self._inverse_dt2)
        iterations = self._system.solve(self._gradient, settings.linear_tolerance, settings.linear_iterations)
        start = self._positions.numpy().copy()
        step = self._system.solution.numpy().astype(np.float64)
        length = np.ones(self.world_count)
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
        return iterations, float(length.min())

    def _evaluate_gradient(self) -> wp.array:
        self._deform()
        self._launch(
            assembly.slot_forces, self.shape, [self._positions, self._garment, self._contact], [self._slot_force]
        )
        self._launch(
            assembly.gradient,
            self.shape,
            [
                self._positions,
                self._garment,
                self._contact,
                self._gravity,
                self._inertia_target,
                self._inverse_dt2,
                self._pin_target,
                self._deformation,
                self._stress,
                self._slot_force,
            ],
            [self._gradient],
        )
        return self._gradient

    def _evaluate_energy(self) -> FloatArray:
        """Incremental potential of each world [J], shape [world_count]."""
        self._deform()
        self._launch(
            assembly.vertex_energies,
            self.shape,
            [
                self._positions,
                self._garment,
                self._contact,
                self._gravity,
                self._inertia_target,
                self._inverse_dt2,
                self._pin_target,
            ],
            [self._vertex_energy],
        )
        return self._vertex_energy.numpy().sum(1) + self._triangle_energy.numpy().sum(1)

    def _deform(self) -> None:
        g = self._garment
        self._launch(
            membrane.deform_triangles,
            (self.world_count, self.model.triangle_count),
            [self._positions, g.faces, g.rest_inverse, g.rest_area, g.stiffness],
            [self._deformation, self._stress, self._triangle_energy],
        )

    def _at(self, positions: ArrayLike | None) -> None:
        """Static state at these positions: contacts found, no inertia."""
        if positions is not None:
            self._positions.assign(self._per_world(positions, "positions"))
        self._linearise_contact()
        self._set_inertia(self._positions.numpy(), 0.0)

    def _set_inertia(self, target: FloatArray, inverse_dt2: float) -> None:
        self._inertia_target.assign(target)
        self._inverse_dt2.fill_(inverse_dt2)

    def _rms_residual(self, gradient: wp.array) -> FloatArray:
        forces = gradient.numpy()
        weight = self.model.mass.mean() * STANDARD_GRAVITY
        return np.sqrt((forces**2).sum(2).mean(1)) / weight

    def _linearise_contact(self) -> None:
        """Find the contact planes of the positions as they are, and freeze friction bounds and self-contacts."""
        self._find_body_contacts()
        c = self._contact
        settings = self.contact_settings
        self._launch(
            contact.update_anchors,
            self.shape,
            [
                self._positions,
                self._garment.area,
                self._body_points,
                self._body_faces,
                c.face,
                self._face_weights,
                c.point,
                c.normal,
                wp.float64(settings.thickness),
                wp.float64(settings.pressure),
                wp.float64(settings.depth),
                wp.float64(self.model.fabric.friction),
                wp.float64(settings.slip),
                self._anchor_face,
                self._anchor_weights,
            ],
            [c.anchor, c.friction_bound],
        )
        if settings.self_thickness > 0.0:
            self._find_self_contacts()

    def _find_body_contacts(self) -> None:
        c = self._contact
        settings = self.contact_settings
        self._launch(
            contact.find_body_contacts,
            self.shape,
            [
                self._positions,
                self._outward,
                self._body_ids,
                self._body_points,
                self._body_faces,
                self._body_normals,
                settings.radius,
                settings.thickness + settings.depth,
                settings.least_cosine,
            ],
            [c.face, self._face_weights, c.point, c.normal],
        )

    def _find_self_contacts(self) -> None:
        c = self._contact
        faces = self._garment.faces
        self._launch(self_contact.to_single, self.shape, [self._positions], [self._points])
        for mesh in self._garment_meshes:
            mesh.refit()
        self._launch(
            self_contact.find_self_contacts,
            self.shape,
            [self._points, self._rest_points, faces, self._garment_ids, self.contact_settings.self_thickness],
            [c.slot_count, c.slot_triangle, c.slot_weights, c.slot_normal],
        )
        lists = [faces, c.slot_count, c.slot_triangle, self.model.vertex_count]
        c.incident_count.zero_()
        self._launch(self_contact.count_incident, self.shape, lists, [c.incident_count])
        wp.utils.array_scan(c.incident_count, c.incident_start, inclusive=False)
        c.incident_count.zero_()
        self._launch(
            self_contact.fill_incident, self.shape, [*lists, c.incident_start], [c.incident_count, c.incident]
        )
        self._launch(
            self_contact.sort_incident, len(c.incident_count), [c.incident_start, c.incident_count, c.incident], []
        )

    def _launch(self, kernel: wp.Kernel, dim: object, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)

    def _per_world(self, values: ArrayLike, name: str) -> FloatArray:
        array = np.asarray(values, np.float64)
        if array.ndim == 2:
            array = np.broadcast_to(array, (self.world_count, *array.shape))
        if array.ndim != 3 or array.shape[0] != self.world_count or array.shape[2] != 3:
            raise ValueError(f"{name} must have the shape [count, 3] or [{self.world_count}, count, 3].")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} hold values that are not numbers.")
        return np.ascontiguousarray(array)

    def _upload_garment(self, pin_stiffness: ArrayLike | None) -> assembly.Garment:
        model = self.model
        garment = assembly.Garment()
        garment.faces = wp.array(model.faces, dtype=wp.int32, device=self.device)
        garment.rest_inverse = wp.array(model.rest_inverse, dtype=wp.mat22d, device=self.device)
        garment.stiffness = wp.vec4d(*model.fabric.stiffness)
        for name in ("rest_area", "mass", "area", "bending_coefficients"):
            setattr(garment, name, wp.array(getattr(model, name), dtype=wp.float64, device=self.device))
        for name in ("corner_start", "corners", "bending_start", "bending_columns"):
            setattr(garment, name, wp.array(getattr(model, name), dtype=wp.int32, device=self.device))
        pins = np.zeros(model.vertex_count) if pin_stiffness is None else np.asarray(pin_stiffness, np.float64)
        garment.pin_stiffness = wp.array(pins, dtype=wp.float64, device=self.device)
        return garment

    def _allocate_state(self) -> None:
        def array(shape: tuple[int, ...] | int, dtype: type) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=self.device)

        triangles = (self.world_count, self.model.triangle_count)
        self._positions = array(self.shape, wp.vec3d)
        self._start_positions = array(self.shape, wp.vec3d)
        self._velocities = array(self.shape, wp.vec3d)
        self._inertia_target = array(self.shape, wp.vec3d)
        self._pin_target = array(self.shape, wp.vec3d)
        self._gradient = array(self.shape, wp.vec3d)
        self._outward = array(self.shape, wp.vec3)
        self._points = array(self.shape, wp.vec3)
        self._vertex_energy = array(self.shape, wp.float64)
        self._deformation = array(triangles, membrane.mat32d)
        self._stress = array(triangles, wp.vec3d)
        self._triangle_energy = array(triangles, wp.float64)
        self._inverse_dt2 = array(self.world_count, wp.float64)
        self._gravity = array(self.world_count, wp.vec3d)
        self._slot_force = array((self.world_count, self.model.vertex_count * self_contact.SLOTS), wp.vec3)

    def _make_body(self, faces: IntArray, positions: FloatArray) -> None:
        vertex_count = positions.shape[1]
        start, corners = group(faces.ravel(), vertex_count)
        self._body_faces = wp.array(faces, dtype=wp.int32, device=self.device)
        self._body_corner_start = wp.array(start, dtype=wp.int32, device=self.device)
        self._body_corners = wp.array(corners, dtype=wp.int32, device=self.device)
        self._body_points = wp.array(positions.astype(np.float32), dtype=wp.vec3, device=self.device)
        self._body_normals = wp.zeros(self._body_points.shape, dtype=wp.vec3, device=self.device)
        self._body_meshes, self._body_ids = self._meshes(self._body_points, self._body_faces)
        self.move_body(positions)

    def _meshes(self, points: wp.array, faces: wp.array) -> tuple[list[wp.Mesh], wp.array]:
        """One bounding volume tree a world over rows of ``points``."""
        indices = wp.array(faces.numpy().ravel(), dtype=wp.int32, device=self.device)
        meshes = [wp.Mesh(points=points[world], indices=indices) for world in range(self.world_count)]
        return meshes, wp.array([mesh.id for mesh in meshes], dtype=wp.uint64, device=self.device)

    def _make_contact(self) -> None:
        settings = self.contact_settings
        worlds, vertices = self.shape
        planes = (worlds, vertices * contact.PLANES)
        slots = (worlds, vertices * self_contact.SLOTS)

        def array(shape: tuple[int, ...] | int, dtype: type) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=self.device)

        c = assembly.Contact()
        c.thickness = wp.float64(settings.thickness)
        c.pressure = wp.float64(settings.pressure)
        c.depth = wp.float64(settings.depth)
        c.slip = wp.float64(settings.slip)
        c.face, c.point, c.normal = array(planes, wp.int32), array(planes, wp.vec3d), array(planes, wp.vec3d)
        c.anchor, c.friction_bound = array(self.shape, wp.vec3d), array(self.shape, wp.float64)
        c.self_thickness = wp.float64(settings.self_thickness)
        c.self_pressure = wp.float64(settings.pressure)
        c.slot_count, c.slot_triangle = array(self.shape, wp.int32), array(slots, wp.int32)
        c.slot_weights, c.slot_normal = array(slots, wp.vec3), array(slots, wp.vec3)
        c.incident_start, c.incident_count = array(worlds * vertices, wp.int32), array(worlds * vertices, wp.int32)
        c.incident = array(worlds * vertices * self_contact.SLOTS * 3, wp.int32)
        self._contact = c
        self._face_weights = array(planes, wp.vec3)
        self._anchor_face = array(self.shape, wp.int32)
        self._anchor_face.fill_(-1)
        self._anchor_weights = array(self.shape, wp.vec3)
        rest = np.ascontiguousarray(self.model.rest_positions[None].astype(np.float32))
        self._rest_points = wp.array(rest, dtype=wp.vec3, device=self.device)
        self._points.assign(np.repeat(rest, worlds, 0))
        self._garment_meshes, self._garment_ids = self._meshes(self._points, self._garment.faces)
