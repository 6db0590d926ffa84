"""The bake: every sample of a plan, simulated or otherwise come by, into a wrinkle database.

``bake`` is a generator of events; whoever drains it prints, draws a progress bar or reports to a farm. It may stop at
any moment: what is finished lies in the folder, and the next run goes on from there, to the same bytes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from . import storage
from .database import (
    DatabaseHeader,
    expected_files,
    header_path,
    rest_path,
    sample_path,
    write_manifest,
    write_rest,
    write_sample,
)
from .divergence import told_of
from .garment import Body, Garment, bind_to_surface, check_body, check_fit, check_surface, find_regions
from .plan import Sample, SamplePlan
from .rig import FloatArray, Pose, Rig, pose_of_angles
from .wearer import BakeSettings, BodySource, Wearer

SOLVER_VERSION = 5
"""Raised whenever the solver gives other samples for the same input, so that old ones are not taken for new."""

STATES = "states"


@dataclass(frozen=True, eq=False)
class SampleShape:
    """The garment in one sample's pose [m], shape [vertex_count, 3], and what there is to say of it."""

    positions: FloatArray
    report: Mapping[str, Any]


class SampleSource(Protocol):
    """Whoever gives the garment's shape for a sample: our solver, another one, a scan (W07)."""

    def rest(self) -> SampleShape: ...

    def sample(self, sample: Sample) -> SampleShape: ...


@dataclass(frozen=True, eq=False)
class BakeJob:
    """Everything that decides the bytes of a database.

    Raises:
        ValueError: One sentence, if the garment cannot be simulated on this body.
    """

    rig: Rig
    garment: Garment
    body: Body
    plan: SamplePlan
    settings: BakeSettings

    def __post_init__(self) -> None:
        check_surface(self.garment.name, self.garment.positions, self.garment.faces)
        check_body(self.body)
        distance = bind_to_surface(self.garment.positions, self.body.positions, self.body.faces).distance
        check_fit(self.garment.name, self.garment.positions, self.body, distance)

    @cached_property
    def key(self) -> str:
        """Hash of the job; part of every file's name."""
        grids = [[grid.joint.name, grid.joint.bones, grid.joint.near, grid.angles] for grid in self.plan.grids]
        joints = [np.round(np.concatenate([g.joint.axes.ravel(), g.joint.shares]), 6).tolist() for g in self.plan.grids]
        return storage.content_key(
            [
                SOLVER_VERSION,
                self.garment.fingerprint(),
                self.body.fingerprint(),
                self.rig.fingerprint(),
                grids,
                joints,
                self.plan.mirror is not None,
                asdict(self.settings),
            ]
        )

    @cached_property
    def header(self) -> DatabaseHeader:
        joints = [grid.joint for grid in self.plan.grids]
        regions = find_regions(self.rig, joints, self.garment.weights)
        return DatabaseHeader(self.key, self.rig, self.plan, self.garment, regions, asdict(self.settings))

    def pose(self, sample: Sample) -> Pose:
        """The pose of a sample: its joint turned, all others at rest."""
        return pose_of_angles(self.rig, self.header.joints, {sample.joint: self.plan.angles(sample)})


@dataclass(frozen=True)
class BakeEvent:
    """Progress of a bake.

    Attributes:
        name: File or sample that was just finished.
        done: Samples that are finished, rest included.
        total: Samples in all, rest included.
        seconds: Time this one took [s].
        remaining: Estimated time for the rest [s].
        report: What its source said of it.
    """

    name: str
    done: int
    total: int
    seconds: float
    remaining: float
    report: Mapping[str, Any]


def bake(
    job: BakeJob,
    source: SampleSource,
    folder: Path | str,
    *,
    shard: tuple[int, int] = (0, 1),
    rest_only: bool = False,
) -> Iterator[BakeEvent]:
    """Bake one shard of a job into a folder, skipping what is there, and finish the database if it is complete.

    Args:
        job: What to bake.
        source: Where the samples come from.
        folder: The database's folder.
        shard: (number, count) of the part to bake.
        rest_only: Stop after the rest pose, which every shard needs.

    Yields:
        An event after each finished sample.

    Raises:
        StorageError: If the folder cannot be written to or the disk is full.
    """
    folder = Path(folder)
    mine = job.plan.shard(*shard)
    storage.make_folder(folder)
    if not header_path(folder, job.key).exists():
        job.header.write(folder)
    todo = [sample for sample in mine if not sample_path(folder, job.key, sample).exists()]
    started = time.perf_counter()
    rest, report = _rest(job, source, folder)
    total, done = 1 + len(mine), 1 + len(mine) - len(todo)
    if report is not None:
        yield BakeEvent("rest", done, total, time.perf_counter() - started, float("nan"), report)
    if rest_only:
        return
    spent = []
    for count, sample in enumerate(todo, 1):
        started = time.perf_counter()
        shape = source.sample(sample)
        write_sample(folder, job.header, rest, sample, shape.positions, shape.report)
        _write_image(job, folder, rest, sample, shape)
        spent.append(time.perf_counter() - started)
        remaining = float(np.mean(spent)) * (len(todo) - count)
        yield BakeEvent(sample.name, done + count, total, spent[-1], remaining, shape.report)
    finish(job, folder)


def finish(job: BakeJob, folder: Path | str) -> bool:
    """Write the manifest if every sample is there, whichever shards they came from; says whether it did."""
    folder = Path(folder)
    if not all(path.exists() for path in expected_files(folder, job.key, job.plan)):
        return False
    write_manifest(folder, job.header)
    return True


def _rest(job: BakeJob, source: SampleSource, folder: Path) -> tuple[FloatArray, Mapping[str, Any] | None]:
    """The settled rest garment, from the folder or made now; the report only if made now."""
    path = rest_path(folder, job.key)
    report = None
    if not path.exists():
        shape = source.rest()
        report = shape.report
        write_rest(folder, job.header, shape.positions, shape.report)
    arrays, _ = storage.read_arrays(path)
    return arrays["positions"], report


def _write_image(job: BakeJob, folder: Path, rest: FloatArray, sample: Sample, shape: SampleShape) -> None:
    """Write the mirror image of a simulated sample, if the plan has one."""
    mirror = job.plan.mirror
    if mirror is None:
        return
    for other in job.plan.samples:
        if job.plan.image(other) == sample:
            report = {**shape.report, "mirrored": sample.name}
            write_sample(folder, job.header, rest, other, mirror.reflect_garment(shape.positions), report)


# --- our own solver as the source ---------------------------------------------------------------------------------


class SimulatedSamples:
    """Samples from our own cloth simulation, each from its parent on the grid (W20).

    The shape of every sample that others start from is kept in the folder to the bit, so that they come out the same
    from this process or another. Friction needs no memory of its own: a garment that lies still tells it.

    Args:
        job: What to bake.
        bodies: The body in any pose.
        folder: The database's folder.
        device: Warp device.
    """

    def __init__(self, job: BakeJob, bodies: BodySource, folder: Path | str, device: str = "cpu"):
        self._job = job
        self._bodies = bodies
        self._states = Path(folder) / STATES
        self.wearer = Wearer(job.rig, job.garment, job.body, bodies, job.settings, device)

    def rest(self) -> SampleShape:
        path = self._path("rest")
        if path.exists():
            return self._read(path)
        with told_of("The rest pose", self._job.rig, self._job.garment):
            report = self.wearer.dress()
        positions = self.wearer.positions
        mirror = self._job.plan.mirror
        if mirror is not None:
            # Rounding makes the two sides drift apart; samples of one side stand for the other, so rest must not.
            positions = 0.5 * (positions + mirror.reflect_garment(positions))
        return self._write(path, SampleShape(positions, report))

    def sample(self, sample: Sample) -> SampleShape:
        path = self._path(sample.name)
        if path.exists():
            return self._read(path)
        plan, wearer = self._job.plan, self.wearer
        parent = plan.parent(sample)
        end = plan.angles(sample)
        start = np.zeros_like(end) if parent is None else plan.angles(parent)
        shape = self.rest() if parent is None else self.sample(parent)

        def pose(fraction: float) -> Pose:
            angles = start + fraction * (end - start)
            return pose_of_angles(self._job.rig, self._job.header.joints, {sample.joint: angles})

        with told_of(f"Sample {sample.name}", self._job.rig, self._job.garment):
            wearer.begin(shape.positions, pose(0.0))
            for fraction in wearer.fractions(pose(0.0), pose(1.0)):
                wearer.follow(pose(float(fraction)))
            report = wearer.settle()
        return self._write(path, SampleShape(wearer.positions, report))

    def _path(self, name: str) -> Path:
        return self._states / f"{name}-{self._job.key}{storage.ARRAY_SUFFIX}"

    def _write(self, path: Path, shape: SampleShape) -> SampleShape:
        storage.make_folder(self._states)
        storage.write_arrays(path, {"positions": shape.positions}, dict(shape.report))
        return shape

    def _read(self, path: Path) -> SampleShape:
        arrays, report = storage.read_arrays(path)
        return SampleShape(arrays["positions"], report)
