"""A recording into a wrinkle flow: as few bytes as an error allows, or as little error as bytes or components do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .flow import FlowMethod
from .flow_components import Components, find_components, project
from .flow_file import (
    WEIGHT_UNIT,
    Flow,
    FlowCode,
    FlowHeader,
    decode_flow,
    decode_rest,
    decode_weights,
    encode_rest,
)
from .flow_residuals import Residuals, ResidualSpace, Skinning
from .garment import SkinWeights
from .recordings import Recording
from .rig import FloatArray, IntArray, Pose, Rig
from .steps import Progress
from .vertex_hierarchy import VertexHierarchy

LOST_SHARE = 0.15
"""Share of the mean square error that left out components take; rounding takes the rest, which saves more bytes."""

COUNT_SHARE = 0.1
"""Where the number of components is given, what rounding adds to the mean square error that they leave."""

COEFFICIENT_STEP = 0.1
"""Step of coefficients, by what it moves the garment on average, over the step of the shapes: what it adds is small."""

FINEST_STEP = 1.0e-6
"""Least step of shapes [m]."""

SLACK = 0.985
"""An error this near below its bound is near enough."""

TRIES, ENOUGH_TRIES = 12, 4
"""Encodings until a bound must be kept, and until one that keeps it is good enough."""

LEFT_BODY = 0.3
"""Root mean square residual [m] from which on a garment is no longer worn, or not by this animation: skirts and capes
swing by less."""

PLAYABLE = 100_000_000
"""Values of the components, at most: what a frame reads beyond memory's good will."""


@dataclass(frozen=True)
class Goal:
    """What decides the size of a flow: exactly one of the first three, or ``max_mm`` alone.

    Attributes:
        rms_mm: Root mean square error over the clip that is not gone beyond [mm].
        components: Number of components.
        size: Bytes of the file, at most.
        max_mm: Error that no vertex goes beyond in any frame [mm]; may stand beside ``rms_mm``.
    """

    rms_mm: float | None = None
    components: int | None = None
    size: int | None = None
    max_mm: float | None = None

    def __post_init__(self) -> None:
        given = [value for value in (self.rms_mm, self.components, self.size) if value is not None]
        if len(given) > 1 or (self.max_mm is not None and self.rms_mm is None and given):
            raise ValueError("Give an error, a number of components or a size, and only one of them.")
        if not given and self.max_mm is None:
            raise ValueError("Give an error in millimetres, a number of components or a size.")
        if min(value for value in (*given, self.max_mm) if value is not None) <= 0:
            raise ValueError("Errors, sizes and numbers of components are above 0.")


@dataclass(frozen=True, eq=False)
class FlowSource:
    """A recording on a rigged character.

    Attributes:
        recording: The recording.
        rig, poses: The rig, and its pose in every frame.
        to_rig: Matrix from the recorded object's space to rig space [m] in every frame, shape [frame_count, 4, 4].
        garment, topology: Name of the garment's object and hash of its triangles.
        rest: The garment at rest in rig space [m], shape [vertex_count, 3].
        weights: What carries it.
        about: What else the file is to tell.
    """

    recording: Recording
    rig: Rig
    poses: Sequence[Pose]
    to_rig: FloatArray
    garment: str
    topology: str
    rest: FloatArray
    weights: SkinWeights
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Compressed:
    """A finished flow.

    Attributes:
        header, rig, code: What :func:`.flow_file.write_flow` takes.
        flow: The same, decoded as a reader will.
        rms_mm, max_mm: Errors measured on it, over the clip and of any vertex [mm].
        frame_mm: Root mean square error of every frame [mm], shape [frame_count].
        skinning_mm: Error of skinning alone [mm].
        note: One sentence if the garment leaves its body in some frames; else empty.
    """

    header: FlowHeader
    rig: Rig
    code: FlowCode
    flow: Flow
    rms_mm: float
    max_mm: float
    frame_mm: FloatArray
    skinning_mm: float
    note: str = ""


def compress(
    source: FlowSource,
    goal: Goal,
    skinning: Skinning = Skinning.LINEAR,
    space: ResidualSpace = ResidualSpace.BONES,
    *,
    curve: bool = False,
    progress: Progress = lambda fraction, text: None,
) -> Compressed:
    """Compress a recording.

    Args:
        source: The recording.
        goal: What decides the size.
        skinning, space: How residuals are taken.
        curve: Also estimate other sizes and their errors.
        progress: Told what share is done, and what is being done.

    Raises:
        ValueError: One sentence: one frame, positions that are not numbers, another number of vertices, more components
            than frames, or a goal that cannot be reached.
    """
    frames = source.recording.frame_count
    if goal.components is not None and goal.components >= frames:
        raise ValueError(
            f"{goal.components} components of {frames} frames are no compression; ask for at most {frames - 1}."
        )
    body = _Carried.of(source)
    residuals = Residuals(
        source.recording, body.rig, body.poses, source.to_rig, body.rest, body.weights, skinning, space
    )
    target = _first_target(goal)
    loss = LOST_SHARE * (1e-3 * target) ** 2
    most = goal.components or max(1, PLAYABLE // (3 * len(body.rest)))
    found = find_components(residuals, most, loss, lambda f, text: progress(0.4 * f, text))
    header = FlowHeader(
        source.garment, source.topology, source.recording.start, skinning, space, 0.0, 0.0, dict(source.about)
    )
    search = _Search(source, body, residuals, found, header, progress)
    best = search.by_error(goal) if goal.rms_mm or goal.max_mm else search.by_size(goal)
    note = _describe_leaving(source.recording, found.frame_squares)
    if curve:
        told = replace(best.header, curve=search.curve(best.rms_mm))
        best = replace(best, header=told, flow=replace(best.flow, header=told))
    best = replace(best, note=note)
    progress(1.0, "done")
    return best


def _describe_leaving(recording: Recording, frame_squares: FloatArray) -> str:
    """Which frames show the garment away from its body, if any: that is kept, but may be a mistake."""
    away = np.flatnonzero(frame_squares > LEFT_BODY**2)
    if not len(away):
        return ""
    worst = int(frame_squares.argmax())
    return (
        f"In {len(away)} of {len(frame_squares)} frames, first in frame {recording.start + away[0]:g}, the garment is "
        f"off its body: {math.sqrt(frame_squares[worst]):.2g} m RMS from where its bones carry it in frame "
        f"{recording.start + worst:g}; if it is not taken off there, see that recording and animation belong together."
    )


def _first_target(goal: Goal) -> float:
    """Error that components need not go below [mm]."""
    if goal.rms_mm is not None:
        return goal.rms_mm
    # Sizes and single vertices: what comes of them is not known yet.
    return goal.max_mm / 8.0 if goal.max_mm is not None else 0.0 if goal.components else 0.1


@dataclass(frozen=True, eq=False)
class _Carried:
    """A garment as the file will hold it: coded, decoded, and on none but the bones that carry it."""

    rig: Rig
    poses: list[Pose]
    hierarchy: VertexHierarchy
    origin: FloatArray
    weight_codes: IntArray
    rest: FloatArray
    weights: SkinWeights

    @staticmethod
    def of(source: FlowSource) -> _Carried:
        dense = source.weights.to_dense(source.rig.bone_count)
        bones = np.flatnonzero(dense.any(0))
        origin, lattice = encode_rest(source.rest)
        hierarchy = VertexHierarchy(lattice)
        codes, _ = hierarchy.quantise(dense[:, bones].astype(np.float32), WEIGHT_UNIT, finer=1.0)
        return _Carried(
            rig_of_bones(source.rig, bones),
            [Pose(pose.matrices[bones]) for pose in source.poses],
            hierarchy,
            origin,
            codes,
            decode_rest(origin, lattice),
            decode_weights(hierarchy, codes),
        )


def rig_of_bones(rig: Rig, bones: IntArray) -> Rig:
    """Some bones of a rig; each one's parent is its nearest ancestor among them."""
    place = {int(bone): number for number, bone in enumerate(bones)}
    parents = [next((place[up] for up in rig.ancestors(int(bone)) if up in place), -1) for bone in bones]
    names = tuple(rig.names[bone] for bone in bones)
    return Rig(names, np.array(parents, np.int32), rig.rest[bones], rig.lengths[bones], rig.gravity)


class _Search:
    """Tries steps and numbers of components on one set of components."""

    def __init__(
        self,
        source: FlowSource,
        body: _Carried,
        residuals: Residuals,
        found: Components,
        header: FlowHeader,
        progress: Progress,
    ):
        self._source, self._body, self._residuals = source, body, residuals
        self._found, self._header, self._progress = found, header, progress
        whole = np.concatenate([found.mean[None], found.shapes])
        self._fields: NDArray[np.float32] = np.ascontiguousarray(whole.transpose(1, 0, 2)).reshape(len(body.rest), -1)

    def by_error(self, goal: Goal) -> Compressed:
        """The smallest flow whose measured errors keep to the bounds."""
        step = self._first_step(_first_target(goal), self._found.count)
        best: Compressed | None = None
        nearest = math.inf, math.inf
        for number in range(TRIES):
            self._progress(0.5 + 0.5 * number / TRIES, f"trying steps of {1e6 * step:.3g} micrometres")
            tried = self.encode(self._found.count, step)
            nearest = min(nearest, (tried.rms_mm, tried.max_mm))
            ratio = max(
                tried.rms_mm / goal.rms_mm if goal.rms_mm is not None else 0.0,
                tried.max_mm / goal.max_mm if goal.max_mm is not None else 0.0,
            )
            if ratio <= 1.0 and (best is None or tried.code.size < best.code.size):
                best = tried
            if SLACK <= ratio <= 1.0 or step <= FINEST_STEP or (best is not None and number >= ENOUGH_TRIES):
                break
            step = max(step * min(max((0.993 / max(ratio, 1e-3)) ** 1.2, 0.3), 2.0), FINEST_STEP)
        if best is None:
            raise ValueError(
                f"{nearest[0]:.3g} mm RMS and {nearest[1]:.3g} mm at most is as near as "
                f"{self._found.count} components come; allow a larger error."
            )
        promise = replace(
            best.header,
            rms_mm=goal.rms_mm if goal.rms_mm is not None else best.header.rms_mm,
            max_mm=goal.max_mm if goal.max_mm is not None else best.header.max_mm,
        )
        return replace(best, header=promise, flow=replace(best.flow, header=promise))

    def by_size(self, goal: Goal) -> Compressed:
        """The best flow of a number of components, or of a size."""
        if goal.components is not None:
            lost = max(self._found.lost(self._found.count), 1e-14)
            return self.encode(self._found.count, self._step_for(COUNT_SHARE * lost, self._found.count))
        assert goal.size is not None
        overhead = 4_000 + 200 * self._body.rig.bone_count
        low, high, best = math.log(0.01), math.log(1e3 * max(self._found.reach, 1e-4)), None
        for number in range(8):
            self._progress(0.4 + 0.05 * number, "trying sizes")
            middle = 0.5 * (low + high)
            count, step = self._count_for(math.exp(middle)), self._first_step(math.exp(middle))
            fits = self._estimate(count, step)[0] + overhead <= goal.size
            low, high, best = (low, middle, (count, step)) if fits else (middle, high, best)
        while best is not None:
            tried = self.encode(*best)
            if tried.code.size + overhead <= goal.size:
                return tried
            best = (best[0], 1.1 * best[1]) if best[1] < 10.0 * self._found.reach else None
        raise ValueError(f"{goal.size} bytes do not even hold the garment at rest; allow a larger file.")

    def curve(self, around_mm: float) -> tuple[tuple[int, float], ...]:
        """Estimated bytes and errors [mm] of flows from 8 times as coarse to 4 times as fine."""
        points = []
        for factor in (8.0, 4.0, 2.0, 1.0, 0.5, 0.25):
            target = factor * around_mm
            count, step = self._count_for(target), self._first_step(target)
            size, error = self._estimate(count, step)
            points.append((size, 1e3 * math.sqrt(self._found.lost(count) + error)))
        return tuple(points)

    def encode(self, count: int, step: float) -> Compressed:
        """Quantise, make up for it in the coefficients, and measure what a reader will get."""
        body = self._body
        codes, fields = body.hierarchy.quantise(self._fields[:, : 3 * (count + 1)], step)
        shapes = np.ascontiguousarray(fields.reshape(len(codes), -1, 3).transpose(1, 0, 2))
        wanted = project(self._residuals, shapes[0], shapes[1:])
        reach = np.sqrt(np.square(shapes[1:].astype(np.float64)).sum(2).mean(1))
        steps = COEFFICIENT_STEP * step / np.maximum(reach, step * 1e-3)
        # Differences of rounded values, so that rounding does not add up.
        rounded = np.round(wanted / steps).astype(np.int64)
        code = FlowCode(
            body.origin,
            body.hierarchy,
            body.weight_codes,
            codes,
            step,
            np.diff(rounded, axis=0, prepend=0).astype(np.int32),
            steps,
        )
        flow = decode_flow(self._header, body.rig, code)
        return self._measured(code, flow)

    def _measured(self, code: FlowCode, flow: Flow) -> Compressed:
        errors = measure_errors(flow, self._residuals, self._body.poses)
        rms, largest = errors.rms_mm, errors.max_mm
        promise = replace(self._header, rms_mm=_rounded_up(rms), max_mm=_rounded_up(largest))
        skinning = 1e3 * math.sqrt(self._found.total + float(np.square(self._found.mean).sum(1).mean()))
        flow = replace(flow, header=promise)
        return Compressed(promise, self._body.rig, code, flow, rms, largest, errors.frame_mm, skinning)

    def _count_for(self, target_mm: float) -> int:
        """Components that leave no more than their share of an error."""
        loss = LOST_SHARE * (1e-3 * target_mm) ** 2
        left = self._found.total - np.cumsum(self._found.energies)
        enough = np.flatnonzero(left <= loss)
        return int(enough[0]) + 1 if len(enough) else self._found.count

    def _first_step(self, target_mm: float, count: int | None = None) -> float:
        """Step at which rounding takes what left out components leave of an error."""
        count = self._count_for(target_mm) if count is None else count
        error = (1e-3 * target_mm) ** 2
        return self._step_for(max(error - self._found.lost(count), 0.1 * error), count)

    def _step_for(self, error: float, count: int) -> float:
        """Step at which the shapes' rounding makes a mean square error [m^2]."""
        step = math.sqrt(error * 12.0 / (3.0 * (count + 1)))
        for _ in range(3):
            made = self._estimate(count, step, sizes=False)[1]
            step = max(step * min(max((error / max(made, 1e-18)) ** 0.6, 0.3), 3.0), FINEST_STEP)
        return step

    def _estimate(self, count: int, step: float, *, sizes: bool = True) -> tuple[int, float]:
        """Bytes of a flow, and the mean square error [m^2] of rounding its shapes."""
        fields = self._fields[:, : 3 * (count + 1)]
        codes, decoded = self._body.hierarchy.quantise(fields, step)
        error = float(np.square(decoded - fields).sum(1, dtype=np.float64).mean())
        if not sizes:
            return 0, error
        small = np.zeros((self._residuals.frame_count, count), np.int32)
        body = self._body
        code = FlowCode(body.origin, body.hierarchy, body.weight_codes, codes, step, small, np.ones(count))
        # Coefficients take about 5 bits.
        return code.size + 5 * small.size // 8, error


@dataclass(frozen=True, eq=False)
class FlowErrors:
    """Errors of a flow against its recording.

    Attributes:
        rms_mm, max_mm: Over the clip, and of any vertex [mm].
        frame_mm: Root mean square error of every frame [mm], shape [frame_count].
    """

    rms_mm: float
    max_mm: float
    frame_mm: FloatArray


def measure_errors(flow: Flow, residuals: Residuals, poses: Sequence[Pose], strength: float = 1.0) -> FlowErrors:
    """Replay every frame as playback does, and compare it with the recording.

    Args:
        residuals: Those of the recording.
        poses: Of the flow's rig.
        strength: 0 measures skinning alone.
    """
    evaluator = FlowMethod(flow).bind("cpu")
    out = wp.zeros(flow.vertex_count, dtype=wp.vec3, device="cpu")
    squares, largest = np.zeros(len(poses)), 0.0
    for number, pose in enumerate(poses):
        evaluator.evaluate(pose, out, strength, frame=flow.header.start + number)
        off = np.square(out.numpy() - residuals.frame_positions(number)).sum(1)
        squares[number] = off.mean()
        largest = max(largest, float(off.max()))
    return FlowErrors(1e3 * math.sqrt(squares.mean()), 1e3 * math.sqrt(largest), 1e3 * np.sqrt(squares))


def _rounded_up(error_mm: float) -> float:
    """A promise that another device's rounding keeps, too."""
    return math.ceil(1.01e4 * error_mm) / 1e4 + 1e-3
