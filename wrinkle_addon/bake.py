"""The bake: every sample of a plan, simulated or otherwise come by, into a wrinkle database.

``bake`` is a generator of events; whoever drains it prints, draws a progress bar or reports to a farm. It may stop at
any moment: what is finished lies in the folder, and the next run goes on from there, to the same bytes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from . import storage
from .database import (
    DatabaseHeader,
    carried_over,
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

SOLVER_VERSION = 7
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

    def batches(self, wanted: Sequence[Sample]) -> Iterator[Mapping[Sample, SampleShape]]:
        """Every sample that is wanted, parents before their children; those that were made together come together."""
        ...


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
                *([sorted(sample.name for sample in self.plan.left_out)] if self.plan.left_out else []),
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
        seconds: Time this one took, or its share of those that were made together [s].
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
        An event after each finished sample, in the order in which the source makes them.

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
    for grid in job.plan.grids:
        _write_made_from(job, folder, rest, Sample(grid.joint.name, grid.rest), SampleShape(rest, {}))
    spent = []
    started = time.perf_counter()
    for shapes in source.batches(todo):
        share = (time.perf_counter() - started) / len(shapes)
        for sample, shape in shapes.items():
            started = time.perf_counter()
            # The sample itself comes last: where it is, all that is made from it is, too.
            _write_made_from(job, folder, rest, sample, shape)
            write_sample(folder, job.header, rest, sample, shape.positions, shape.report)
            spent.append(share + time.perf_counter() - started)
            count = len(spent)
            remaining = float(np.mean(spent)) * (len(todo) - count)
            yield BakeEvent(sample.name, done + count, total, spent[-1], remaining, shape.report)
        started = time.perf_counter()
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


def _write_made_from(job: BakeJob, folder: Path, rest: FloatArray, sample: Sample, shape: SampleShape) -> None:
    """Write what is made from a simulated sample: those that it stands in for, and the mirror images of all of them."""
    plan, header = job.plan, job.header
    made = {sample: shape}
    for other in (other for other, stand_in in plan.stand_ins.items() if stand_in == sample):
        positions = carried_over(header, rest, sample, other, shape.positions)
        made[other] = SampleShape(positions, {"stand_in": sample.name})
        write_sample(folder, header, rest, other, positions, made[other].report)
    if plan.mirror is None:
        return
    for image in plan.samples:
        original = plan.image(image)
        if original in made:
            report = {**made[original].report, "mirrored": original.name}
            positions = plan.mirror.reflect_garment(made[original].positions)
            write_sample(folder, header, rest, image, positions, report)


# --- our own solver as the source ---------------------------------------------------------------------------------


class SimulatedSamples:
    """Samples from our own cloth simulation, each from its parent on the grid (W20).

    The shape of every sample that others start from is kept in the folder to the bit, so that they come out the same
    from this process or another. Friction needs no memory of its own: a garment that lies still tells it.

    Samples whose parents are there and whose ways from them take equally many steps are simulated side by side, so that
    none waits for another before it settles. Each comes out the same to the bit alone or beside any others.

    Args:
        job: What to bake.
        bodies: The body in any pose.
        folder: The database's folder.
        device: Warp device.
        batch: How many samples are simulated side by side at most; on a CPU it saves nothing.

    Raises:
        ValueError: If a batch holds no sample.
    """

    def __init__(self, job: BakeJob, bodies: BodySource, folder: Path | str, device: str = "cpu", batch: int = 1):
        if batch < 1:
            raise ValueError(f"A batch holds at least one sample, not {batch}.")
        self._job = job
        self._bodies = bodies
        self._states = Path(folder) / STATES
        self._device, self._batch = device, batch
        self._step_counts: dict[Sample, int] = {}
        self._wearers: dict[int, Wearer] = {}
        self.wearer = self._wearer_of(1)

    def rest(self) -> SampleShape:
        path = self._path("rest")
        if path.exists():
            return self._read(path)
        with told_of("The rest pose", self._job.rig, self._job.garment):
            [report] = self.wearer.dress()
        [positions] = self.wearer.positions
        mirror = self._job.plan.mirror
        if mirror is not None:
            # Rounding makes the two sides drift apart; samples of one side stand for the other, so rest must not.
            positions = 0.5 * (positions + mirror.reflect_garment(positions))
        return self._write(path, SampleShape(positions, report))

    def batches(self, wanted: Sequence[Sample]) -> Iterator[Mapping[Sample, SampleShape]]:
        while wanted:
            # Looked for each time: another process may have made them.
            there = [sample for sample in wanted if self._is_there(sample)]
            for sample in there:
                yield {sample: self._read(self._path(sample.name))}
            wanted = [sample for sample in wanted if sample not in there]
            made = self._make(self._next_batch(wanted)) if wanted else ()
            for shapes in made:
                if asked := {sample: shape for sample, shape in shapes.items() if sample in wanted}:
                    yield asked
                wanted = [sample for sample in wanted if sample not in shapes]

    def _next_batch(self, wanted: Sequence[Sample]) -> list[Sample]:
        """Samples that can be simulated side by side now: first those that the most others wait for, one after another.

        So the last nodes of the grids, which nothing waits for, are left for full batches.
        """
        plan = self._job.plan
        lacking = self._lacking(wanted)
        ready = [sample for sample in lacking if plan.parent(sample) not in lacking]
        if self._batch == 1:
            return ready[:1]
        behind = dict.fromkeys(lacking, 0)
        for sample in reversed(lacking):
            parent = plan.parent(sample)
            if parent in behind:
                behind[parent] = max(behind[parent], behind[sample] + 1)
        ready.sort(key=lambda sample: -behind[sample])
        return [sample for sample in ready if self._step_count(sample) == self._step_count(ready[0])][: self._batch]

    def _lacking(self, wanted: Sequence[Sample]) -> dict[Sample, None]:
        """What must be simulated for these samples, parents before their children."""
        lacking: dict[Sample, None] = {}
        for sample in wanted:
            line, ancestor = [], sample
            while ancestor is not None and ancestor not in lacking and not self._is_there(ancestor):
                line.append(ancestor)
                ancestor = self._job.plan.parent(ancestor)
            lacking.update(dict.fromkeys(reversed(line)))
        return lacking

    def _make(self, batch: Sequence[Sample]) -> Iterator[Mapping[Sample, SampleShape]]:
        """Simulate samples side by side. If one fails, one by one: then it is known which, and the others are kept."""
        try:
            shapes = self._simulate(batch)
        except ValueError:
            if len(batch) == 1:
                raise
        else:
            yield shapes
            return
        failures = []
        for sample in batch:
            try:
                shapes = self._simulate([sample])
            except ValueError as error:
                failures.append(error)
            else:
                yield shapes
        if failures:
            raise failures[0]

    def _simulate(self, batch: Sequence[Sample]) -> dict[Sample, SampleShape]:
        parents = [self._job.plan.parent(sample) for sample in batch]
        shapes = [self.rest() if parent is None else self._read(self._path(parent.name)) for parent in parents]
        wearer = self._wearer_of(len(batch))
        with told_of(f"Sample {batch[0].name}", self._job.rig, self._job.garment):
            wearer.begin(np.stack([shape.positions for shape in shapes]), [self._pose(each, 0.0) for each in batch])
            for fraction in self._fractions(batch[0]):
                wearer.follow([self._pose(each, float(fraction)) for each in batch])
            reports = wearer.settle()
        found = [SampleShape(*each) for each in zip(wearer.positions, reports, strict=True)]
        return {each: self._write(self._path(each.name), shape) for each, shape in zip(batch, found, strict=True)}

    def _pose(self, sample: Sample, fraction: float) -> Pose:
        """The pose at a fraction of the way from the parent's to the sample's own."""
        plan, parent = self._job.plan, self._job.plan.parent(sample)
        end = plan.angles(sample)
        start = np.zeros_like(end) if parent is None else plan.angles(parent)
        angles = start + fraction * (end - start)
        return pose_of_angles(self._job.rig, self._job.header.joints, {sample.joint: angles})

    def _fractions(self, sample: Sample) -> FloatArray:
        return self.wearer.fractions(self._pose(sample, 0.0), self._pose(sample, 1.0))

    def _step_count(self, sample: Sample) -> int:
        if sample not in self._step_counts:
            self._step_counts[sample] = len(self._fractions(sample))
        return self._step_counts[sample]

    def _wearer_of(self, count: int) -> Wearer:
        """The simulation of so many samples: one for each size that batches come in, as a world without work costs
        as much as one with it."""
        if count not in self._wearers:
            job = self._job
            self._wearers[count] = Wearer(
                job.rig, job.garment, job.body, self._bodies, job.settings, self._device, count
            )
        return self._wearers[count]

    def _is_there(self, sample: Sample) -> bool:
        return self._path(sample.name).exists()

    def _path(self, name: str) -> Path:
        return self._states / f"{name}-{self._job.key}{storage.ARRAY_SUFFIX}"

    def _write(self, path: Path, shape: SampleShape) -> SampleShape:
        storage.make_folder(self._states)
        storage.write_arrays(path, {"positions": shape.positions}, dict(shape.report))
        return shape

    def _read(self, path: Path) -> SampleShape:
        arrays, report = storage.read_arrays(path)
        return SampleShape(arrays["positions"], report)
