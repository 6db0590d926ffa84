"""The coarse dynamic simulation: what moves the garments at large, in real time (Wang et al. 2010, section 3.2).

    simulation = CoarseSimulation([CoarseLayer("Shirt", coarse.positions, coarse.faces)], body.faces, body.positions)
    simulation.start(body_at_first_frame, [skinned_at_first_frame])
    for body_positions, skinned in frames:
        report = simulation.step(body_positions, [skinned], 1.0 / 30.0)
        simulation.positions[0]

The energies are those of the fine solver (:mod:`.cloth`), from the same kernels, and the time steps are its BDF2. What
makes it quick (W43, W49): a few steps a frame with one linearisation each, which begins so near to the step's end that
it keeps their order; no collision of a garment with itself (W44); the body's closest triangles are looked for once a
frame and then followed (W45); and all launches of a frame are recorded once and replayed. Garments worn over each other
are one system (W46).

A vertex whose strength is 0 rides on the skinned garment, through the body if need be. One whose strength lies between
0 and 1 is simulated freely and shown that far away from the skinned garment. Pins pull, and the body may keep them off.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ..kernels.cloth import (
    assembly,
    bending,
    body_surface,
    contact,
    frame_steps,
    hinges,
    layers,
    linear,
    springs,
    triangles,
)
from .cloth import STANDARD_GRAVITY
from .cloth_contact import ContactSettings
from .cloth_model import FloatArray, join_models
from .coarse_contact import CoarseContact, arrive, make_path
from .coarse_layers import CoarseLayer, CoarseReport, CoarseSettings, CoarseState, model_of, shares_of
from .divergence import first_lost
from .elasticity import Elasticity, upload_garment
from .launch_graph import LaunchGraph
from .linear_solver import BlockSystem
from .threads import THREADS, Ahead
from .time_integration import step_coefficients

__all__ = ["CoarseLayer", "CoarseReport", "CoarseSettings", "CoarseSimulation", "CoarseState"]

THICKNESS = 0.003
"""Distance over which contact with the body goes from no force to its full pressure [m]; at most the buffer."""
LAYER_GAP = 0.003
"""Distance at which garments touch each other [m]."""
DEPTH, RADIUS = 0.05, 0.1
"""Depth from which a vertex is not put back on the skin, and how far away the body is looked for [m]."""
PIN_STIFFNESS = 200.0
"""What a full pin pulls a vertex with [N/m], and others with their share."""
TOLERANCE, ITERATIONS = 0.02, 24
"""Share of its residual at which a linear system counts as solved, and the bound on its iterations."""
SPEED_SAMPLE = 1000
"""Vertices of the body that tell how fast it moves."""
LONGEST_STEP = 0.05
"""How far a linear system moves a vertex at most [m]."""
MOTION = ("positions", "velocities", "before", "velocities_before")
"""What goes on from step to step, of the kernels' motion and of the state alike."""
PRE_ROLL_STEP = 1.0 / 150.0
"""Length of the pre-roll's time steps [s]."""
SETTLE_SPAN, SETTLE_STEPS, SETTLED = 1.0 / 30.0, 100, 2.0e-4
"""Settling: length of its steps without velocity [s], their bound, and the largest motion in one that ends it [m]."""


MODULES = (assembly, bending, body_surface, contact, frame_steps, hinges, layers, linear, springs, triangles)
"""Modules of kernels that a step launches."""


class CoarseSimulation:
    """Simulates the garments of one character together.

    Args:
        layers: The garments, from the innermost to the outermost.
        body_faces: Triangles of the body, outward by their winding, shape [body_triangle_count, 3].
        body_positions: The body at rest [m], shape [body_vertex_count, 3].

    Raises:
        ValueError: If there is no garment, or one of them or the body cannot be simulated; one sentence says why.
    """

    def __init__(
        self, layers: Sequence[CoarseLayer], body_faces: ArrayLike, body_positions: ArrayLike, *, device: str = "cpu"
    ):
        self.layers = tuple(layers)
        self.device = wp.get_device(device)
        body_faces = np.ascontiguousarray(body_faces, np.int32)
        body_positions = np.asarray(body_positions, np.float64)
        if not self.layers:
            raise ValueError("There is no garment to simulate.")
        if not len(body_faces):
            raise ValueError("The body has no faces to collide with.")
        self._body_count = len(body_positions)
        self._threads = THREADS if self.device.is_cpu else 1
        models = [model_of(layer) for layer in self.layers]
        self.model = models[0] if len(models) == 1 else join_models(models)
        settings = [layer.settings for layer in self.layers]
        self._steps = max(one.steps for one in settings)
        self._pre_roll = max(one.pre_roll for one in settings)
        self._teleport = min(one.teleport for one in settings)
        thickness = min(THICKNESS, *(one.buffer for one in settings), THICKNESS)
        lift = self._per_vertex([one.buffer - thickness for one in settings])
        contact_settings = ContactSettings(thickness=thickness, depth=DEPTH, radius=RADIUS, self_thickness=LAYER_GAP)
        limbs = [layer.limbs for layer in self.layers]
        self._allocate()
        motion = self._motion.positions, self._skin
        self._contact = CoarseContact(self.model, contact_settings, lift, limbs, body_faces, body_positions, *motion)
        self._garment = upload_garment(self.model, np.zeros(self.model.vertex_count), self.device)
        self._elasticity = Elasticity(self.model, self._garment, 1)
        parts = [part.vertices for part in self.model.parts]
        self._system = BlockSystem(
            self.model, self._garment, self._elasticity, self._contact.frozen, 1, corrected=False, layers=parts
        )
        self._step = LaunchGraph(partial(self._launch_step, 0), MODULES, self.device)
        self._frame = LaunchGraph(self._launch_frame, MODULES, self.device)
        self._search: Ahead | None = None
        self._last_step: float | None = None
        self.set_gravity([0.0, 0.0, -STANDARD_GRAVITY])

    # State

    @property
    def positions(self) -> list[NDArray[np.float32]]:
        """Where each layer is shown [m], shape [n, 3] each; copies."""
        shown = self._shown.numpy()
        return [shown[part.vertices].copy() for part in self.model.parts]

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Acceleration of free fall [m/s^2], shape [3]."""
        self._gravity.assign(np.asarray(gravity, np.float64).reshape(1, 3))

    def state(self) -> CoarseState:
        motion, contact_ = self._motion, self._contact
        points, skin = contact_.points, self._skin
        return CoarseState(
            **{name: getattr(motion, name).numpy().copy() for name in MOTION},
            anchor_faces=contact_.anchor_face.numpy().copy(),
            anchor_weights=contact_.anchor_weights.numpy().copy(),
            candidates=contact_.candidate.numpy().copy(),
            found_from=contact_.found_from.numpy().copy(),
            heights=contact_.gap.numpy().copy(),
            body=np.stack([points.earlier.numpy(), points.last.numpy()]),
            skin=np.stack([skin.earlier.numpy(), skin.last.numpy()]),
            last_step=np.array([self._last_step or 0.0]),
        )

    def restore(self, state: CoarseState) -> None:
        """Go on from a state of :meth:`state`, to the bit.

        Raises:
            ValueError: If it is that of other garments or of another body.
        """
        if state.positions.shape != (1, self.model.vertex_count, 3) or state.body.shape[1] != self._body_count:
            raise ValueError("The state belongs to other garments or to another body; simulate from the first frame.")
        self._forget_search()
        for body, skin in zip(state.body, state.skin, strict=True):
            self._set_out(body, skin)
            self._arrive()
        for name in MOTION:
            getattr(self._motion, name).assign(getattr(state, name))
        self._contact.anchor_face.assign(state.anchor_faces)
        self._contact.anchor_weights.assign(state.anchor_weights)
        self._contact.candidate.assign(state.candidates)
        self._contact.found_from.assign(state.found_from)
        self._contact.gap.assign(state.heights)
        self._last_step = float(state.last_step[0]) or None
        self._show()

    # Motion

    def start(self, body_positions: ArrayLike, carried: Sequence[ArrayLike]) -> CoarseReport:
        """Begin at a first frame: settle there, and let the pre-roll pass.

        Args:
            body_positions: The body [m], shape [body_vertex_count, 3].
            carried: Each layer carried there by plain skinning [m], shape [n, 3] each.
        """
        body, skin = self._given(body_positions, carried)
        return self._restart(body, skin, "")

    def step(self, body_positions: ArrayLike, carried: Sequence[ArrayLike], dt: float) -> CoarseReport:
        """Advance by a frame of ``dt`` [s], at whose end the body and the skinned layers are where these say.

        Raises:
            ValueError: If there is no time in the frame, or something is not of its shape; one sentence says what.
        """
        if not dt > 0.0:
            raise ValueError(f"A frame must last longer than 0 s, not {dt} s; check the frame rate.")
        body, skin = self._given(body_positions, carried)
        sample = slice(None, None, 1 + self._body_count // SPEED_SAMPLE)
        moved = body[sample] - self._contact.points.last.numpy()[sample]
        speed = float(np.median(np.linalg.norm(moved, axis=1))) / dt
        if speed > self._teleport:
            return self._restart(body, skin, f"The body jumped at {speed:.0f} m/s.")
        self._set_out(body, skin)
        self._advance(dt)
        if not np.isfinite(self._motion.positions.numpy()).all():
            return self._restart(body, skin, "The garment was thrown about too fast to follow.")
        return self._report(False, "")

    def look_ahead(self) -> None:
        """Begin to look for what is near at the beginning of the coming frame, on another thread of a CPU.

        It is known before the body sets out. The frame is the same to the bit without it.
        """
        for recorded in (self._frame, self._contact):  # While a frame is simulated, others are at work on it.
            recorded.prepare()
        if self._search is None and self._threads > 1:
            self._search = Ahead(self._contact.find)

    # Inner workings

    def _restart(self, body: NDArray[np.float32], skin: NDArray[np.float32], reason: str) -> CoarseReport:
        self._forget_search()
        self._set_out(body, skin)
        for _ in range(2):
            self._arrive()
        for name in MOTION:
            getattr(self._motion, name).zero_()
        self._motion.positions.assign(skin.astype(np.float64)[None])
        self._contact.forget()
        self._settle()
        frame = self._steps * PRE_ROLL_STEP
        for _ in range(round(self._pre_roll / frame)):
            self._advance(frame)
        self._contact.launch_measure()
        self._show()
        return self._report(True, reason)

    def _settle(self) -> None:
        """Come to rest where the body stands: steps without velocity."""
        self._rest()
        self._elasticity.set_damping_rate(0.0)
        for _ in range(SETTLE_STEPS):
            before = self._motion.positions.numpy().copy()
            self._contact.find()
            self._contact.take_found()
            self._set_clock([[SETTLE_SPAN, -1.0, 0.0, SETTLE_SPAN, 1.0, 1.0]])
            self._step()
            self._rest()
            if np.linalg.norm(self._motion.positions.numpy() - before, axis=2).max() < SETTLED:
                break

    def _rest(self) -> None:
        """Forget all motion."""
        self._motion.velocities.zero_()
        self._last_step = None

    def _advance(self, dt: float) -> None:
        """The steps of a frame of ``dt`` [s]."""
        search, self._search = self._search or Ahead(self._contact.find, kept=True), None
        search.finish()
        length = dt / self._steps
        self._elasticity.set_damping_rate(1.0 / length)
        clocks = []
        for number in range(self._steps):
            c = step_coefficients(length, self._last_step)
            self._last_step = length
            shares = [number / self._steps, (number + 1) / self._steps]
            clocks.append([c.span, c.now, c.before, length, *shares])
        self._set_clock(clocks)
        self._frame()

    def _set_clock(self, clocks: list[list[float]]) -> None:
        """The clock of each coming step, as :mod:`..kernels.cloth.frame_steps` reads it."""
        self._clock[: len(clocks)].assign(np.array(clocks))

    def _forget_search(self) -> None:
        """What was begun is of another motion than what comes."""
        search, self._search = self._search, None
        if search is not None:
            search.finish()

    def _set_out(self, body: NDArray[np.float32], skin: NDArray[np.float32]) -> None:
        """Body and skin set out for the coming frame."""
        self._contact.move_body(body)
        self._skin.coming.assign(skin)

    def _arrive(self) -> None:
        """The coming frame is the last one."""
        self._contact.arrive()
        arrive(self._skin)

    def _launch_frame(self) -> None:
        """All that is launched for a frame once its clock is set."""
        self._contact.take_found()
        for number in range(self._steps):
            self._launch_step(number)
        self._contact.launch_measure()
        self._show()
        self._arrive()

    def _launch_step(self, number: int) -> None:
        """A time step of the frame: linearised, solved and made."""
        clock, motion, contact_, system = self._clock[number], self._motion, self._contact, self._system
        positions = motion.positions
        self._elasticity.remember_strain(positions)
        driven = [motion, self._garment.pin_stiffness, self._inverse_dt2, system.solution]
        self._launch(frame_steps.begin_step, [self._skin, clock, *driven])
        contact_.launch_move(clock)
        contact_.launch_freeze(motion, clock)
        self._elasticity.deform(positions)
        self._launch_gradient()
        system.assemble(positions, self._inverse_dt2, self._kept)
        system.precondition(positions)
        system.hold_vertices(motion.held)
        system.launch_solve(self._gradient, self._moving, TOLERANCE, ITERATIONS)
        self._launch(frame_steps.move_vertices, [system.solution, wp.float64(LONGEST_STEP), positions])
        self._launch(frame_steps.end_step, [clock, contact_.touching, contact_.planes, motion])
        contact_.launch_expel(motion, clock)
        contact_.launch_follow()

    def _launch_gradient(self) -> None:
        motion, elasticity = self._motion, self._elasticity
        inputs = [
            motion.positions,
            self._garment,
            self._contact.frozen,
            self._gravity,
            motion.target,
            self._inverse_dt2,
            motion.pin_target,
            elasticity.deformation,
            elasticity.stress,
            self._contact.pair_force,
        ]
        shape = (1, self.model.vertex_count)
        wp.launch(assembly.gradient, dim=shape, inputs=inputs, outputs=[self._gradient], device=self.device)
        for elements in elasticity.elements:
            elements.add_gradient(self._gradient)
        self._launch(frame_steps.add_force, [self._contact.ahead, self._gradient])

    def _show(self) -> None:
        self._launch(frame_steps.show_positions, [self._skin, self._strength, self._motion, self._shown])

    def _report(self, restarted: bool, reason: str) -> CoarseReport:
        return CoarseReport(restarted, reason, self._contact.deepest(), self._contact.crossed())

    def _given(
        self, body_positions: ArrayLike, carried: Sequence[ArrayLike]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The body and all layers of a frame, checked; shapes [body_vertex_count, 3] and [vertex_count, 3]."""
        body = np.asarray(body_positions, np.float32)
        if body.shape != (self._body_count, 3):
            raise ValueError(
                f"The body has {self._body_count} vertices, but {len(body)} in this frame; "
                "it must keep its mesh over the whole motion."
            )
        if len(carried) != len(self.layers):
            raise ValueError(f"There are {len(self.layers)} garments, but {len(carried)} were carried along.")
        parts = [np.asarray(values, np.float32) for values in carried]
        for layer, part in zip(self.layers, parts, strict=True):
            if part.shape != (len(layer.positions), 3):
                raise ValueError(
                    f"The coarse mesh of '{layer.name}' has {len(layer.positions)} vertices, "
                    f"but {len(part)} in this frame."
                )
        skin = np.concatenate(parts)
        for name, values in (("body", body), ("skinned garment", skin)):
            if not np.isfinite(values).all():
                lost = first_lost(values[None].astype(np.float64))
                raise ValueError(f"The {name} has positions that are not numbers, first at vertex {lost}.")
        return body, skin

    def _per_vertex(self, values: Sequence[float]) -> FloatArray:
        """One number a layer, for all its vertices."""
        return np.repeat(np.asarray(values, np.float64), [len(layer.positions) for layer in self.layers])

    def _allocate(self) -> None:
        count = self.model.vertex_count

        def zeros(shape: tuple[int, ...] | int, dtype: Any) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=self.device)

        motion = frame_steps.Motion()
        for name in (*MOTION, "past", "target", "pin_target"):
            setattr(motion, name, zeros((1, count), wp.vec3d))
        pins = np.concatenate([shares_of(layer, "pins", 0.0) for layer in self.layers])
        strength = np.concatenate([shares_of(layer, "strength", 1.0) for layer in self.layers])
        drag = self.model.mass * self._per_vertex([layer.settings.damping for layer in self.layers])
        motion.pins = wp.array(PIN_STIFFNESS * pins, dtype=wp.float64, device=self.device)
        motion.drag = wp.array(drag, dtype=wp.float64, device=self.device)
        motion.held = wp.array(strength <= 0.0, dtype=wp.int32, device=self.device)
        self._motion = motion
        self._strength = wp.array(strength, dtype=wp.float64, device=self.device)
        self._skin = make_path(count, self.device)
        self._shown = zeros(count, wp.vec3)
        self._clock = zeros((self._steps, frame_steps.CLOCK_SIZE), wp.float64)
        self._gradient = zeros((1, count), wp.vec3d)
        self._gravity, self._inverse_dt2 = zeros(1, wp.vec3d), zeros(1, wp.float64)
        self._kept, self._moving = zeros(1, wp.float64), wp.ones(1, dtype=wp.int32, device=self.device)

    def _launch(self, kernel: Any, inputs: list) -> None:
        wp.launch(kernel, dim=self.model.vertex_count, inputs=inputs, device=self.device)
