"""References to measure synthesis against: the equilibrium at a pose, and the full dynamic simulation of a clip."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .cloth import STANDARD_GRAVITY
from .garment import Body, Garment
from .rig import FloatArray, Pose, Rig, pose_between
from .wearer import BakeSettings, BodySource, Wearer


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """The garment as a reference has it, in rig space [m], shape [vertex_count, 3], and how it lies."""

    positions: FloatArray
    report: Mapping[str, Any]


class SettledReference:
    """Static equilibrium at any pose, reached from rest along every joint's arc: what a pose alone can determine.

    Gravity points where it does in the frame, so a character that leans is settled leaning.
    """

    def __init__(
        self,
        rig: Rig,
        garment: Garment,
        body: Body,
        bodies: BodySource,
        settings: BakeSettings,
        rest: FloatArray,
        device: str = "cpu",
    ):
        self._wearer = Wearer(rig, garment, body, bodies, settings, device)
        self._rest = rest

    def at(self, pose: Pose, gravity: FloatArray, through: Sequence[Pose] = ()) -> ReferenceFrame:
        """The garment at rest in a pose; ``gravity`` is a unit vector in rig space.

        Args:
            through: Poses that the body passes on its way, the character's own place left at rest.
        """
        wearer = self._wearer
        upright, root = pose.with_root_at_rest(wearer.rig)
        wearer.simulation.set_gravity(root[:3, :3].T @ gravity * STANDARD_GRAVITY)
        wearer.begin(self._rest, Pose.at_rest(wearer.rig))
        for passed in (*through, upright):
            wearer.walk(passed)
        [report], [positions] = wearer.settle(), wearer.positions
        return ReferenceFrame(positions @ root[:3, :3].T + root[:3, 3], report)


@dataclass(frozen=True)
class SimulationSettings:
    """How a clip is simulated in full.

    Attributes:
        substeps: Steps a frame.
        pre_roll: Time spent in the first pose before the clip starts [s].
    """

    substeps: int = 4
    pre_roll: float = 0.3


def simulate_clip(
    wearer: Wearer,
    rest: FloatArray,
    poses: Sequence[Pose],
    gravity: FloatArray,
    fps: float,
    settings: SimulationSettings,
) -> Iterator[ReferenceFrame]:
    """Simulate the garment with all its inertia over a clip.

    Args:
        wearer: The garment and its body.
        rest: The settled rest garment to start from [m], shape [vertex_count, 3].
        poses: One pose a frame, with the character's own motion in the bones; frames go straight from one to the next.
        gravity: Where things fall, a unit vector in the space of the poses.
        fps: Frames a second.

    Yields:
        The garment at every frame, in the space of the poses.
    """
    rig, simulation = wearer.rig, wearer.simulation
    upright, root = poses[0].with_root_at_rest(rig)
    simulation.set_gravity(root[:3, :3].T @ gravity * STANDARD_GRAVITY)
    wearer.begin(rest, Pose.at_rest(rig))
    wearer.walk(upright)
    wearer.settle()
    simulation.set_gravity(gravity * STANDARD_GRAVITY)
    wearer.begin(wearer.positions @ root[:3, :3].T + root[:3, 3], poses[0])
    dt = 1.0 / (fps * settings.substeps)
    for _ in range(int(np.ceil(settings.pre_roll / dt))):
        wearer.step(poses[0], dt)
    yield ReferenceFrame(wearer.positions[0], wearer.lie()[0])
    for before, after in itertools.pairwise(poses):
        for step in range(1, settings.substeps + 1):
            wearer.step(pose_between(rig, before, after, step / settings.substeps), dt)
        yield ReferenceFrame(wearer.positions[0], wearer.lie()[0])
