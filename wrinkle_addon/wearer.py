"""A simulated garment on a posed body, and how it is simulated: what a bake and every reference are made with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from . import rotations
from .cloth import STANDARD_GRAVITY, ClothSimulation, ContactSettings, SolverSettings
from .cloth_contact import Limbs
from .cloth_model import Fabric, build_cloth_model
from .cloth_state import SettleReport
from .divergence import place_of
from .garment import Body, Garment, distances_to_surface, find_regions
from .joints import find_joints
from .rig import FloatArray, Pose, Rig, pose_between
from .settle_safeguards import RESTLESS
from .surface import BodyVolume, SurfaceMeasures

ROUNDS = 2
"""How often a garment settles: again where its layers were drawn apart or it did not come to rest."""

REST_EFFORT = 3
"""How many times as many linearisations the rest pose may take: what it lacks shows in every sample."""

SLIDE = 0.14
"""How far cloth may slide from the limb that it lies on in the rest pose onto another one [m]."""


@dataclass(frozen=True)
class BakeSettings:
    """How samples are simulated.

    Attributes:
        fabric: What the garment is made of.
        contact: How it touches the body and itself.
        solver: Where iterations stop.
        ease: Extra cloth around the girth and along the length, as shares (0.05 is 5 percent).
        turn_step: Largest turn of any bone between two steps of the body [rad].
        rest_tolerance: Residual at which the rest pose is in equilibrium, in nodal weights; what it lacks would show
            in every sample, far from the joint that moves.
        settle_tolerance: Residual at which a sample is in equilibrium.
        settle_iterations: Bound on the linearisations of one equilibrium; the rest pose may take three times as many.
        trapped: Share of the vertices that need not come to rest, caught where the body cuts into itself.
        pin_stiffness: How hard a fully pinned vertex is held to the skin [N/m].
    """

    fabric: Fabric = field(default_factory=Fabric)
    contact: ContactSettings = field(default_factory=ContactSettings)
    solver: SolverSettings = field(default_factory=SolverSettings)
    ease: tuple[float, float] = (0.0, 0.0)
    turn_step: float = float(np.radians(3.0))
    rest_tolerance: float = 0.05
    settle_tolerance: float = 0.3
    settle_iterations: int = 120
    trapped: float = 0.005
    pin_stiffness: float = 20.0


Poses = Pose | Sequence[Pose]
"""A pose, or one for each world."""


class BodySource(Protocol):
    """Whoever knows the body's shape in a pose: Blender's own evaluation, or plain skinning in tests."""

    def positions(self, pose: Pose) -> FloatArray:
        """Body vertices in rig space [m], shape [body_vertex_count, 3]."""
        ...


class Wearer:
    """A simulated garment on a posed body: poses in, settled cloth out.

    Keeps the last pose, so that it can carry the cloth along with the skin to the next one. Or ``world_count`` of them
    side by side: wherever a pose goes in, one for each world may; what comes out is for each world, the one as well.
    """

    def __init__(
        self,
        rig: Rig,
        garment: Garment,
        body: Body,
        bodies: BodySource,
        settings: BakeSettings,
        device: str = "cpu",
        world_count: int = 1,
    ):
        self.rig, self.garment, self.bodies, self.settings = rig, garment, bodies, settings
        model = build_cloth_model(
            garment.positions,
            garment.faces,
            settings.fabric,
            length_directions=limb_directions(rig, garment),
            warp_directions=garment.warp,
            ease=settings.ease,
        )
        self._poses: Sequence[Pose] = [Pose.at_rest(rig)] * world_count
        self._surface = SurfaceMeasures(garment.faces, garment.vertex_count)
        self._body_faces = body.faces
        self.simulation = ClothSimulation(
            model,
            body.faces,
            body.positions,
            contact_settings=settings.contact,
            solver_settings=settings.solver,
            pin_stiffness=garment.pins * settings.pin_stiffness,
            limbs=worn_limbs(rig, garment, body),
            world_count=world_count,
            device=device,
        )
        self.simulation.set_gravity(rig.gravity * STANDARD_GRAVITY)

    @property
    def positions(self) -> FloatArray:
        """The garment as it lies [m], shape [world_count, vertex_count, 3]."""
        return self.simulation.positions

    def dress(self) -> list[dict[str, Any]]:
        """Put the modelled garment on in the rest pose and let it settle; reports as :meth:`settle` does."""
        self._place(Pose.at_rest(self.rig))
        self.simulation.start(self.garment.positions)
        self.simulation.move_body(self._body_positions())
        return self.settle(
            self.settings.rest_tolerance, trapped=0.0, iterations=REST_EFFORT * self.settings.settle_iterations
        )

    def begin(self, positions: FloatArray, pose: Poses) -> None:
        """Start from a garment that lies still in this pose [m], held by friction.

        Shape [vertex_count, 3], or with a leading [world_count].
        """
        self._place(pose)
        self.simulation.start(positions)
        self.simulation.move_body(self._body_positions())
        self.simulation.hold()

    def fractions(self, start: Pose, end: Pose) -> FloatArray:
        """Even steps from one pose to another, none turning a bone further than the settings allow."""
        turns = rotations.multiply(rotations.conjugate(start.turns(self.rig)), end.turns(self.rig))
        largest = float(np.linalg.norm(rotations.to_rotvec(turns), axis=1).max())
        count = max(1, int(np.ceil(largest / self.settings.turn_step - 1e-6)))
        return np.arange(1, count + 1) / count

    def follow(self, pose: Poses) -> None:
        """Move the body a small step on; the garment is carried along by its skin and relaxes."""
        carried = self._carried(pose)
        self._place(pose)
        self.simulation.follow(self._body_positions(), carried)

    def step(self, pose: Poses, dt: float) -> None:
        """Move the body on in time; the garment keeps its momentum."""
        carried = self._carried(pose)
        self._place(pose)
        self.simulation.step(self._body_positions(), dt, guess=carried)

    def _carried(self, pose: Poses) -> FloatArray:
        """The garments moved along with their skin from the last pose to the next [m], shape of :attr:`positions`."""

        def carried(before: Pose, after: Pose, positions: FloatArray) -> FloatArray:
            # Each bone's own motion is blended, never the inverse of a blend, which is singular at a large twist.
            motion = after.deformations(self.rig) @ np.linalg.inv(before.deformations(self.rig))
            return self.garment.weights.carry(motion, positions)

        return np.stack([*map(carried, self._poses, self._per_world(pose), self.positions)])

    def walk(self, pose: Poses) -> None:
        """Move the body to a pose along every bone's arc, in small steps; as many as the longest way needs."""
        ways = [*zip(self._poses, self._per_world(pose), strict=True)]
        for fraction in max((self.fractions(*way) for way in ways), key=len):
            self.follow([e if fraction == 1.0 else pose_between(self.rig, s, e, float(fraction)) for s, e in ways])

    def settle(
        self, tolerance: float | None = None, trapped: float | None = None, iterations: int | None = None
    ) -> list[dict[str, Any]]:
        """Bring the garment to equilibrium; reports for each world how close it came and how it lies.

        Where it has passed through itself it is drawn apart and settles again, a few times at most.

        Args:
            tolerance: Residual to stop at, in nodal weights; left out, that of a sample.
            trapped: Share of the vertices that need not come to rest; left out, that of a sample.
            iterations: Bound on the linearisations; left out, that of a sample.
        """
        settings = self.settings
        tolerance = settings.settle_tolerance if tolerance is None else tolerance
        trapped = settings.trapped if trapped is None else trapped
        iterations = settings.settle_iterations if iterations is None else iterations
        simulation = self.simulation
        told: list[dict[str, Any]] = [{} for _ in self._poses]
        settling, drawn = np.ones(len(told), bool), np.zeros(len(told), int)
        rounds: list[SettleReport] = []
        while settling.any():
            last = len(rounds) == ROUNDS - 1
            overtime = iterations if last else 0
            rounds.append(simulation.settle(tolerance, iterations, trapped=trapped, overtime=overtime, worlds=settling))
            again = np.zeros_like(settling)
            if not last:
                tangled = settling & (simulation.untangle() > 0)
                drawn += tangled
                again = tangled | (settling & (rounds[-1].residual > RESTLESS))
            # A world that is done is told of before its neighbours go on.
            for world in np.flatnonzero(settling & ~again):
                told[world] = {**self._effort(rounds, world), "untanglings": int(drawn[world]), **self._lie(world)}
            settling = again
        return told

    def _effort(self, rounds: Sequence[SettleReport], world: int) -> dict[str, Any]:
        """What it took one world to settle, from one untangling to the next, and how close it came."""
        last = rounds[-1]
        return {
            "residual": round(float(last.residual[world]), 4),
            "whole_residual": round(float(last.whole_residual[world]), 4),
            "converged": bool(last.converged[world]),
            "iterations": int(sum(each.iterations[world] for each in rounds)),
            "linear_iterations": int(sum(each.linear_iterations[world] for each in rounds)),
            **({} if last.converged[world] else {"restless": self._restless(world)}),
        }

    def _restless(self, world: int) -> str:
        """Where the largest force is left."""
        force = np.linalg.norm(self.simulation.residual()[world], axis=1)
        return place_of(self.rig, self.garment, int(force.argmax()))

    def lie(self) -> list[dict[str, Any]]:
        """How each garment lies: vertices more than 1 mm inside the body, the deepest [mm], pairs of its triangles that
        intersect. Those where the body cuts into itself, so that no place is free, are counted apart ("overlap").
        """
        return [self._lie(world) for world in range(len(self._poses))]

    def _lie(self, world: int) -> dict[str, Any]:
        positions, limit = self.positions[world], 0.001
        body = BodyVolume(self.simulation.body_positions[world], self._body_faces)
        depth, overlap = body.depth(positions, limit)
        pairs = self._surface.self_intersections(positions)
        between = body.overlap(positions[self.garment.faces[pairs]].mean((1, 2)), limit)
        return {
            "inside": int((depth > limit)[~overlap].sum()),
            "inside_overlap": int((depth > limit)[overlap].sum()),
            "deepest_mm": round(float(depth[~overlap].max(initial=0.0) * 1e3), 3),
            "self_intersections": int((~between).sum()),
            "self_intersections_overlap": int(between.sum()),
        }

    def _place(self, pose: Poses) -> None:
        """Turn what goes with the skin: the outward directions and the pins."""
        garment, weights = self.garment, self.garment.weights
        self._poses = poses = self._per_world(pose)
        outward = [rotations.rotate(weights.turn(each.turns(self.rig)), garment.normals) for each in poses]
        pins = [weights.carry(each.deformations(self.rig), garment.positions) for each in poses]
        self.simulation.set_outward(np.stack(outward))
        self.simulation.place_pins(np.stack(pins))

    def _body_positions(self) -> FloatArray:
        """The body in every world's pose [m], shape [world_count, body_vertex_count, 3]."""
        return np.stack([self.bodies.positions(pose) for pose in self._poses])

    def _per_world(self, pose: Poses) -> Sequence[Pose]:
        return [pose] * len(self._poses) if isinstance(pose, Pose) else pose


def worn_limbs(rig: Rig, garment: Garment, body: Body) -> Limbs:
    """The limb that each body triangle belongs to, and those that each garment vertex is worn on: its own, and any that
    lies within a slide's reach of it.

    Limbs are what the joints of the skeleton divide, whichever of them are sampled.
    """
    regions = find_regions(rig, find_joints(rig).found, garment.weights)
    count = len(regions.segments)
    of_bone = np.eye(count)[regions.bone_segment]
    of_triangles = (body.weights @ of_bone)[body.faces].sum(1).argmax(1)
    worn = np.eye(count, dtype=bool)[regions.vertex_segment]
    for limb in range(count):
        triangles = body.faces[of_triangles == limb]
        if len(triangles):
            worn[:, limb] |= distances_to_surface(garment.positions, body.positions, triangles) < SLIDE
    return Limbs(of_triangles.astype(np.int32), (worn @ (1 << np.arange(count))).astype(np.int32))


def limb_directions(rig: Rig, garment: Garment) -> FloatArray:
    """Direction along the limb under each triangle, from its bones, unit vectors, shape [triangle_count, 3]."""
    directions = garment.weights.blend(rig.rest[:, :3, 1])
    faces = directions[garment.faces].sum(1)
    return faces / np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-9)
