"""Which joint takes which angles: the samples of a wrinkle database, their order, their price (W15-W20).

Not every node of a grid is simulated: one side's stand for the other's, where the character is symmetric, and where the
body passes through itself another node stands in (:mod:`.self_overlap`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np

from .rig import FloatArray, Joint
from .symmetry import Mirror, other_side

HINGE_STEP = np.radians(15.0)
BALL_STEP = np.radians(30.0)
TWIST_COUNT = 3
SPINE_COUNTS = (3, 3, 5)
STEP_TOLERANCE = 0.1
"""Share of a step by which gaps may be wider than asked for, rather than adding a whole slab of samples."""

CURVING = 0.17
"""Error of interpolation over the square of the gap, beside how far cloth moves for an angle [1/rad] (measured)."""
TWIST, HINGE = 0.5, 0.2
"""How far a limb's twist and a hinge move cloth for their angle, beside a ball's swing (measured on a shirt)."""
SECONDS_PER_VERTEX = 1.2e-3
"""Measured time of one sample a vertex on one CPU core [s]: the mean over the demo's plan, 592 s for 37 samples of
11,775 vertices, less a little for the other work on that machine."""
SAMPLE_BYTES, GARMENT_BYTES = 10.0, 130.0
"""What a vertex takes in a sample, moved and in half precision, and in what is kept of the garment at rest; measured
databases of 13, 72 and 315 samples were 16, -1 and 4 percent larger."""
LEAST_RANGE = np.radians(5.0)
"""Sides of a range that are smaller than this are not sampled."""


@dataclass(frozen=True)
class Sample:
    """One joint turned to one node of its grid; all others rest.

    Attributes:
        joint: The joint's name.
        index: Node of the grid in each degree of freedom.
    """

    joint: str
    index: tuple[int, ...]

    @property
    def name(self) -> str:
        return f"{self.joint}-{'-'.join(str(i) for i in self.index)}"


@dataclass(frozen=True, eq=False)
class JointGrid:
    """The angles at which a joint is sampled.

    Attributes:
        joint: The joint.
        angles: For each degree of freedom, ascending angles that hold 0 [rad].
    """

    joint: Joint
    angles: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        if len(self.angles) != self.joint.dof:
            raise ValueError(f"Joint {self.joint.name} needs a list of angles for each degree of freedom.")
        for values in self.angles:
            if 0.0 not in values or list(values) != sorted(set(values)):
                raise ValueError(f"The angles of joint {self.joint.name} must ascend and hold 0.")

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(values) for values in self.angles)

    @cached_property
    def rest(self) -> tuple[int, ...]:
        """The node at which the joint rests."""
        return tuple(values.index(0.0) for values in self.angles)

    def at(self, index: Sequence[int]) -> FloatArray:
        """Angles of a node [rad], shape [dof]."""
        return np.array([values[i] for values, i in zip(self.angles, index, strict=True)])

    def parent(self, index: tuple[int, ...]) -> tuple[int, ...]:
        """The neighbour one node nearer to rest, last degree of freedom first; rest is its own parent."""
        for axis in reversed(range(len(index))):
            if index[axis] != self.rest[axis]:
                step = 1 if index[axis] < self.rest[axis] else -1
                return (*index[:axis], index[axis] + step, *index[axis + 1 :])
        return index

    def nodes(self) -> Iterator[tuple[int, ...]]:
        """All nodes but rest, depth first from rest, so that each comes after its parent."""
        children: dict[tuple[int, ...], list[tuple[int, ...]]] = {}
        for index in itertools.product(*(range(n) for n in self.shape)):
            if index != self.rest:
                children.setdefault(self.parent(index), []).append(index)
        stack = children.get(self.rest, [])[::-1]
        while stack:
            index = stack.pop()
            yield index
            stack.extend(children.get(index, [])[::-1])


@dataclass(frozen=True, eq=False)
class SamplePlan:
    """All samples of a bake, next to the rest pose.

    Attributes:
        grids: The joints and their angles.
        mirror: Symmetry by which one side's samples are reflected into the other's, or None.
        left_out: Samples that take another one's wrinkles, as no place is left for cloth in their poses.
    """

    grids: tuple[JointGrid, ...]
    mirror: Mirror | None = None
    left_out: frozenset[Sample] = frozenset()

    @cached_property
    def grid(self) -> Mapping[str, JointGrid]:
        return {grid.joint.name: grid for grid in self.grids}

    @cached_property
    def samples(self) -> tuple[Sample, ...]:
        """Every sample, parents first."""
        return tuple(Sample(grid.joint.name, index) for grid in self.grids for index in grid.nodes())

    @cached_property
    def simulated(self) -> tuple[Sample, ...]:
        """The samples that must be simulated; the rest are mirror images of these, or take their wrinkles."""
        return tuple(sample for sample in self.originals if sample not in self.left_out)

    @cached_property
    def originals(self) -> tuple[Sample, ...]:
        """The samples that are not mirror images of others."""
        return tuple(sample for sample in self.samples if self.image(sample) is None)

    @cached_property
    def stand_ins(self) -> Mapping[Sample, Sample]:
        """For each original that is left out, the nearest one in angle that is simulated, or the joint at rest.

        It lies between rest and the other in every degree of freedom, where limbs do not meet as much. Of two that are
        equally near it is the one that comes first in the grid.
        """
        found = {}
        for sample in self.originals:
            if sample not in self.left_out:
                continue
            grid, angles = self.grid[sample.joint], self.angles(sample)
            free = [Sample(sample.joint, grid.rest), *(each for each in self.simulated if each.joint == sample.joint)]
            place = np.array([grid.at(each.index) for each in free])
            apart = np.linalg.norm(place - angles, axis=1)
            between = ((place * angles >= 0.0) & (np.abs(place) <= np.abs(angles))).all(1)
            apart[~between] = np.inf
            # Angles that differ by rounding alone are equally near.
            found[sample] = free[int(np.argmax(apart < apart.min() + 1e-6))]
        return found

    def angles(self, sample: Sample) -> FloatArray:
        """Angles of the sample's joint [rad], shape [dof]."""
        return self.grid[sample.joint].at(sample.index)

    def parent(self, sample: Sample) -> Sample | None:
        """The sample to simulate this one from, past any that are left out; None for the rest pose."""
        grid = self.grid[sample.joint]
        index = grid.parent(sample.index)
        while index != grid.rest and Sample(sample.joint, index) in self.left_out:
            index = grid.parent(index)
        return None if index == grid.rest else Sample(sample.joint, index)

    def image(self, sample: Sample) -> Sample | None:
        """The sample whose mirror image this one is, or None if it is an original itself.

        Of two samples that mirror each other the one is the original whose joint comes first in the plan, or, for a
        joint in the middle, whose first angle that changes its sign is positive. That choice passes from a sample to
        its parent, so an original never waits for a mirrored one.
        """
        if self.mirror is None:
            return None
        partner = self.mirror.joints[sample.joint]
        names = [grid.joint.name for grid in self.grids]
        if partner not in names or names.index(partner) > names.index(sample.joint):
            return None
        signs = self.mirror.signs[sample.joint]
        angles = self.angles(sample)
        if partner == sample.joint:
            odd = angles[(signs < 0) & (angles != 0.0)]
            if not len(odd) or odd[0] > 0.0:
                return None
        return self.reflected(sample)

    def reflected(self, sample: Sample) -> Sample | None:
        """The sample at the mirrored angles; None without a mirror, or if the other joint's grid has no such node."""
        if self.mirror is None:
            return None
        partner = self.mirror.joints[sample.joint]
        if partner not in self.grid:
            return None
        index = []
        angles = self.mirror.signs[sample.joint] * self.angles(sample)
        for values, angle in zip(self.grid[partner].angles, angles, strict=True):
            nearest = int(np.argmin(np.abs(np.array(values) - angle)))
            if abs(values[nearest] - angle) > 1e-6:
                return None
            index.append(nearest)
        return Sample(partner, tuple(index))

    def shard(self, number: int, count: int) -> tuple[Sample, ...]:
        """One of ``count`` consecutive parts of the simulated samples, as even as they go.

        Raises:
            ValueError: If there is no such shard.
        """
        if count < 1 or not 0 <= number < count:
            raise ValueError(f"There is no shard {number}/{count}; shards go from 0/{count} to {count - 1}/{count}.")
        total = len(self.simulated)
        return self.simulated[number * total // count : (number + 1) * total // count]

    def raw_bytes(self, vertex_count: int) -> int:
        """Size of the paper's own form: every position of every sample as three floats (W34)."""
        return (len(self.samples) + 1) * vertex_count * 12

    def stored_bytes(self, vertex_count: int) -> float:
        """About how large a database is."""
        return vertex_count * (SAMPLE_BYTES * len(self.samples) + GARMENT_BYTES)

    def seconds(self, vertex_count: int) -> float:
        """About how long a bake takes on one CPU core [s]."""
        return SECONDS_PER_VERTEX * vertex_count * (len(self.simulated) + 1)


def duration_text(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def spaced_angles(low: float, high: float, step: float) -> tuple[float, ...]:
    """Angles from low to high through 0, no further apart than ``step`` [rad], evenly spaced on each side of 0."""
    return _angles(low, high, _intervals(-low, step), _intervals(high, step))


def _intervals(extent: float, step: float) -> int:
    """Number of steps over an extent; none where there is hardly any."""
    return max(1, int(np.ceil(extent / step - STEP_TOLERANCE))) if extent > STEP_TOLERANCE * step else 0


def counted_angles(low: float, high: float, count: int) -> tuple[float, ...]:
    """``count`` angles from low to high with 0 among them, shared out so that the widest gap is smallest [rad]."""
    least_below, least_above = int(low < 0.0), int(high > 0.0)
    splits = [(below, count - 1 - below) for below in range(least_below, count - least_above)]
    if not splits:
        return (0.0,)
    below, above = min(splits, key=lambda n: max(-low / max(n[0], 1), high / max(n[1], 1)))
    return _angles(low, high, below if low < 0.0 else 0, above if high > 0.0 else 0)


def _angles(low: float, high: float, below: int, above: int) -> tuple[float, ...]:
    """0, ``below`` even steps down to low and ``above`` even steps up to high [rad]."""
    return (
        *(low * (1 - k / below) for k in range(below)),
        0.0,
        *(high * (k + 1) / above for k in range(above)),
    )


def paper_plan(
    joints: Sequence[Joint], mirror: Mirror | None = None, steps: Mapping[str, float] = MappingProxyType({})
) -> SamplePlan:
    """The paper's plan: hinges every 15 degrees, balls every 30, the spine 3 x 3 x 5 (W15, W16).

    The paper does not print its ranges nor how the other balls are cut (X03). Here they have three nodes of twist, as
    its spine has, which with human ranges comes to 315 samples on the upper body and 229 on the lower (W17, W18).

    Args:
        steps: Widest gap between two angles of joints that are cut otherwise [rad]; a ball's twist keeps its nodes.
    """
    return SamplePlan(tuple(_paper_grid(joint, steps.get(joint.name)) for joint in joints), mirror)


def _paper_grid(joint: Joint, own_step: float | None) -> JointGrid:
    if joint.is_chain and joint.dof == 3 and own_step is None:
        counts = zip(joint.limits, SPINE_COUNTS, strict=True)
        angles = tuple(counted_angles(low, high, count) for (low, high), count in counts)
    else:
        step = own_step or (HINGE_STEP if joint.is_hinge else BALL_STEP)
        angles = tuple(spaced_angles(low, high, step) for low, high in joint.limits)
        if not joint.is_hinge:
            angles = (counted_angles(joint.limits[0, 0], joint.limits[0, 1], TWIST_COUNT), *angles[1:])
    return JointGrid(joint, angles)


def budget_plan(joints: Sequence[Joint], simulated: int, mirror: Mirror | None = None) -> SamplePlan:
    """The plan that leaves the least unknown for no more than ``simulated`` simulated samples.

    Starts from the rest pose alone and, over and over, refines the side of a range where a sample tells the most, as
    long as the budget holds. A side that got no sample keeps the wrinkles of the rest pose.

    Raises:
        ValueError: If not a single sample is allowed.
    """
    if simulated < 1:
        raise ValueError(f"A plan needs at least one sample, not {simulated}.")
    intervals = {joint.name: [[0, 0] for _ in joint.limits] for joint in joints}

    def plan() -> SamplePlan:
        grids = (
            JointGrid(
                joint,
                tuple(
                    _angles(*limits, *counts)
                    for limits, counts in zip(joint.limits, intervals[joint.name], strict=True)
                ),
            )
            for joint in joints
        )
        return SamplePlan(tuple(grids), mirror)

    current = plan()
    names = {joint.name for joint in joints}
    frozen: set[tuple[str, int, int]] = set()
    while True:
        gain = {
            (joint.name, axis, side): _gain(joint, axis, side, intervals[joint.name])
            for joint in joints
            for axis in range(joint.dof)
            for side in (0, 1)
            if abs(joint.limits[axis, side]) >= LEAST_RANGE and (joint.name, axis, side) not in frozen
        }
        if not gain:
            return current
        name, axis, side = max(gain, key=lambda key: gain[key])
        # Both sides of the body get the same grid, so that their samples can be each other's images.
        other = partner if (partner := other_side(name)) in names else name
        flips = mirror is not None and mirror.signs[name][axis] < 0
        together = {(name, axis, side), (other, axis, 1 - side if flips else side)} & {*gain}
        for joint_name, k, end in together:
            intervals[joint_name][k][end] += 1
        refined = plan()
        if len(refined.simulated) <= simulated:
            current = refined
            continue
        for joint_name, k, end in together:
            intervals[joint_name][k][end] -= 1
        frozen |= together


def _gain(joint: Joint, axis: int, side: int, intervals: Sequence[Sequence[int]]) -> float:
    """What another interval on one side of a range makes known, for each sample that it costs [rad of swing]."""
    cost = np.prod([1 + sum(counts) for k, counts in enumerate(intervals) if k != axis])
    count = intervals[axis][side]
    return float(_unknown(joint, axis, side, count) - _unknown(joint, axis, side, count + 1)) / float(cost)


def _unknown(joint: Joint, axis: int, side: int, intervals: int) -> float:
    """How much is not known of one side of a range that is cut into some intervals [rad of swing]."""
    effect = HINGE if joint.is_hinge else TWIST if axis == 0 else 1.0
    extent = abs(joint.limits[axis, side])
    return effect * (extent if intervals == 0 else CURVING * (extent / intervals) ** 2)
