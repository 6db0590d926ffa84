"""A bake and a play of a small sleeve, to see whether they work on this machine."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import warp as wp

from .bake import BakeJob, SimulatedSamples, bake
from .database import WrinkleDatabase
from .garment import Body, Garment, SkinWeights
from .joint_wrinkles import BlendWeights, Formulation, JointWrinkles
from .kernel_cache import compile_kernels
from .plan import JointGrid, SamplePlan
from .rig import FloatArray, IntArray, Joint, Pose, Rig
from .wearer import BakeSettings

LENGTH, BODY, SLEEVE = 0.5, 0.04, 0.05
"""Length of the arm and radii of arm and sleeve [m]."""
TOLERANCE = 3.0e-4
"""What a database may lose [m]: offsets below 0.1 mm are left out, half precision costs 0.05 mm at most."""

WELL_SETTLED = 5.0
"""Residual that tells cloth which nearly rests from a solver that does not work [nodal weights]."""


@dataclass(frozen=True)
class Check:
    """One thing that was tried: what, how it went in a sentence, whether well, and its time [s]."""

    name: str
    text: str
    passed: bool
    seconds: float


def self_test(device: str) -> Iterator[Check]:
    """Compile the kernels, bake a sleeve in two poses, play it; ends after the first failure.

    Args:
        device: Warp device, not "auto".
    """
    with tempfile.TemporaryDirectory(prefix="wrinkle-test-") as folder:
        trials = (("kernels", _compile), ("bake", _bake), ("play", _play))
        for name, trial in trials:
            began = time.perf_counter()
            try:
                text, passed = trial(Path(folder), device)
            except Exception as error:
                text, passed = f"{type(error).__name__}: {error}", False
            yield Check(name, text, passed, time.perf_counter() - began)
            if not passed:
                return


def _compile(folder: Path, device: str) -> tuple[str, bool]:
    count = max(total for _, total in compile_kernels([device]))
    return f"{count} modules loaded", True


def _bake(folder: Path, device: str) -> tuple[str, bool]:
    job = sleeve_job()
    events = list(bake(job, SimulatedSamples(job, _Skinned(job), folder, device), folder))
    residual = max(event.report["residual"] for event in events)
    return f"{len(events)} samples, {residual:.2g} nodal weights from equilibrium", bool(residual < WELL_SETTLED)


def _play(folder: Path, device: str) -> tuple[str, bool]:
    """Every sample must come out of the database as it went in."""
    database = WrinkleDatabase.open(folder)
    job = sleeve_job()
    evaluator = JointWrinkles(database, Formulation.OFFSETS, BlendWeights.DISTANCE).bind(device)
    positions = wp.zeros(job.garment.vertex_count, dtype=wp.vec3, device=device)
    source = SimulatedSamples(job, _Skinned(job), folder, device)
    worst = 0.0
    for batch in source.batches(job.plan.simulated):
        for sample, shape in batch.items():
            evaluator.evaluate(job.pose(sample), positions)
            worst = max(worst, float(np.abs(positions.numpy() - shape.positions).max()))
    return f"samples come back within {1000.0 * worst:.2f} mm", worst < TOLERANCE


# --- a sleeve on an arm of two bones ------------------------------------------------------------------------------


class _Skinned:
    """The arm in any pose: plain skinning."""

    def __init__(self, job: BakeJob):
        self._job = job
        self._weights = SkinWeights.from_dense(job.body.weights)

    def positions(self, pose: Pose) -> FloatArray:
        return self._weights.carry(pose.deformations(self._job.rig), self._job.body.positions)


def sleeve_job() -> BakeJob:
    """The smallest bake: an elbow at 0 and 40 degrees, on a sleeve of 400 vertices."""
    # A bone points along its own +y; the arm lies along x.
    rest = np.tile(np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), (2, 1, 1))
    rest[1, 0, 3] = LENGTH / 2
    rig = Rig(("upper", "lower"), np.array([-1, 0], np.int32), rest, np.full(2, LENGTH / 2), np.array([0.0, 0, -1]))
    angle = np.radians(40.0)
    elbow = Joint("elbow", ("lower",), "upper", 1, np.array([[0.0, -1, 0]]), np.array([[0.0, angle]]), np.ones(1))
    positions, faces = _tube(BODY, 12, 25)
    body = Body(positions, faces, _weights(positions))
    positions, faces = _tube(SLEEVE, 16, 25)
    weights = SkinWeights.from_dense(_weights(positions))
    garment = Garment("sleeve", positions, faces, weights, np.zeros(len(positions), np.float32))
    return BakeJob(rig, garment, body, SamplePlan((JointGrid(elbow, ((0.0, float(angle)),)),)), BakeSettings())


def _tube(radius: float, around: int, along: int) -> tuple[FloatArray, IntArray]:
    x, angle = np.meshgrid(np.linspace(0.0, LENGTH, along), 2.0 * np.pi * np.arange(around) / around, indexing="ij")
    vertices = np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], -1).reshape(-1, 3)
    ring, k = np.meshgrid(np.arange(along - 1) * around, np.arange(around), indexing="ij")
    a, b = ring + k, ring + (k + 1) % around
    faces = np.stack([np.stack([a, b, b + around], -1), np.stack([a, b + around, a + around], -1)], 2)
    return vertices, faces.reshape(-1, 3).astype(np.int32)


def _weights(positions: FloatArray) -> FloatArray:
    """Of both bones, blended over 10 cm around the elbow."""
    lower = np.clip((positions[:, 0] - LENGTH / 2) / 0.1 + 0.5, 0.0, 1.0)
    return np.stack([1.0 - lower, lower], 1)
