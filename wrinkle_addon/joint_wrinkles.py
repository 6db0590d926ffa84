"""Method 1: a wrinkle database sampled joint by joint (Wang, Hecht, Ramamoorthi, O'Brien 2010).

Two formulations from one database. ``OFFSETS`` interpolates offsets over skinning and joins those of all joints; it is
the default: it follows bones that were not sampled and has no seams. ``PAPER`` interpolates positions along arcs (eq 1
to 3) and averages the joints' meshes by distance to the neighbouring regions (eq 4). ``NEAREST`` joins the offsets of
each joint's nearest sample; it is what the others have to beat. How far a joint reaches is told by distance, or
measured on its samples (:mod:`.influence`).
"""

from __future__ import annotations

import enum
import itertools
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.blend import (
    Cells,
    Corners,
    CornerWeights,
    Offsets,
    Positions,
    Sums,
    blend_offsets,
    blend_positions,
    take_first_away,
)
from ..kernels.interpolate import CORNERS
from ..kernels.skinning import Skin
from . import rotations
from .database import WrinkleDatabase
from .garment import SkinWeights, distances_to_segments
from .influence import influence_shares, influence_windows, measure_influence, smoothed_influence
from .method import BLOCK_SIZE, Evaluator, Method, SplitLaunch
from .plan import JointGrid, Sample
from .rig import FloatArray, JointAngles, Pose, pose_of_angles
from .topology import group

WINDOW_START, WINDOW_END = 0.5, 0.8
"""Distance from a joint's two regions at which its influence begins to fade and has faded [m]."""

SEAM_DISTANCE = 1.0e-4
"""Distances in eq 4 are kept above this [m], so that weights stay defined on a seam (X02)."""


FAR = 100.0
"""Distance that stands for a region without cloth [m]."""


class Formulation(enum.Enum):
    """How per-joint samples meet in one pose."""

    OFFSETS = "offsets"
    PAPER = "paper"
    NEAREST = "nearest"


class BlendWeights(enum.Enum):
    """Where the weights come from by which joints meet."""

    DISTANCE = "distance"
    MEASURED = "measured"


@dataclass(frozen=True)
class GridCell:
    """The cell of a joint's grid around some angles.

    Attributes:
        lower, upper: Nodes on both sides in each degree of freedom; the same one on an axis with a single node.
        fraction: Place between the lower and the upper node, from 0 to 1, shape [dof].
        beyond: How far the angles lie outside the grid [rad], shape [dof].
    """

    lower: tuple[int, ...]
    upper: tuple[int, ...]
    fraction: FloatArray
    beyond: FloatArray


def find_cell(grid: JointGrid, angles: FloatArray) -> GridCell:
    """Locate angles [rad] in a joint's grid, clamped to it."""
    lower, upper, fraction, beyond = [], [], [], []
    for values, angle in zip(grid.angles, angles.tolist(), strict=True):
        clamped = min(max(angle, values[0]), values[-1])
        node = min(max(bisect_right(values, clamped) - 1, 0), max(len(values) - 2, 0))
        above = min(node + 1, len(values) - 1)
        width = values[above] - values[node]
        lower.append(node)
        upper.append(above)
        fraction.append((clamped - values[node]) / width if width > 0.0 else 0.0)
        beyond.append(angle - clamped)
    return GridCell(tuple(lower), tuple(upper), np.array(fraction), np.array(beyond))


class JointWrinkles(Method):
    """A wrinkle database, ready to be bound to a device.

    Args:
        database: The database; every sample is read here, once.
        formulation: How samples meet.
        weights: How far each joint reaches.
        hinges_about_axis: In the paper's formulation, interpolate hinges by eq 3 about their own axis instead of eq 1.
    """

    def __init__(
        self,
        database: WrinkleDatabase,
        formulation: Formulation = Formulation.OFFSETS,
        weights: BlendWeights = BlendWeights.DISTANCE,
        *,
        hinges_about_axis: bool = True,
    ):
        self.database = database
        self.formulation = formulation
        self.weights = weights
        self.hinges_about_axis = hinges_about_axis
        self.header = database.header
        self.samples = dict(database.samples())

    @property
    def vertex_count(self) -> int:
        return self.header.garment.vertex_count

    @cached_property
    def segment_distances(self) -> FloatArray:
        """Distance of each vertex to each region of the settled garment [m], shape [vertex_count, segment_count]."""
        return distances_to_segments(self.database.rest, self.header.garment.faces, self.header.regions)

    @cached_property
    def influence(self) -> dict[str, FloatArray]:
        """What every joint changes on every vertex, measured and smoothed [m], shape [vertex_count] each."""
        measured = measure_influence(self.header, self.database.rest, self.samples)
        return smoothed_influence(measured, self.database.rest, self.header.garment.faces)

    def window(self, joint: str) -> NDArray[np.float32]:
        """phi_J, by which the joint's offsets count on a vertex, shape [vertex_count].

        By distance, 1 on and around the joint's regions, fading smoothly to 0 far away. Measured, 1 where no joint acts
        more than this one.
        """
        if self.weights is BlendWeights.MEASURED:
            return influence_windows(self.influence)[joint].astype(np.float32)
        distance = self.segment_distances[:, self.header.regions.joints[joint]].min(1)
        t = np.clip((WINDOW_END - distance) / (WINDOW_END - WINDOW_START), 0.0, 1.0)
        return (t * t * (3.0 - 2.0 * t)).astype(np.float32)

    def joint_weights(self) -> dict[str, FloatArray]:
        """By what share every joint's mesh counts on a vertex in the paper's formulation, shape [vertex_count] each."""
        return influence_shares(self.influence) if self.weights is BlendWeights.MEASURED else self.distance_weights()

    def distance_weights(self) -> dict[str, FloatArray]:
        """Eq 4's weight of every joint on every vertex, inverse to the distance of the region beyond it (W66).

        They add up to 1 wherever the vertex's region borders on a joint, and are 0 elsewhere; shape [vertex_count].
        """
        regions = self.header.regions
        own = regions.vertex_segment
        inverse: dict[str, FloatArray] = {}
        for name, (near, far) in regions.joints.items():
            beyond = np.where(own == near, far, np.where(own == far, near, -1))
            # A region without cloth lies far away, but is still the only one beyond a joint at the garment's end.
            distance = np.clip(self.segment_distances[np.arange(len(own)), np.maximum(beyond, 0)], SEAM_DISTANCE, FAR)
            inverse[name] = np.where(beyond >= 0, 1.0 / distance, 0.0)
        total = np.sum(list(inverse.values()), axis=0)
        return {name: values / np.where(total > 0.0, total, 1.0) for name, values in inverse.items()}

    def bind(self, device: str = "cpu") -> JointEvaluator:
        target = wp.get_device(device)
        if self.formulation is Formulation.PAPER:
            return PaperEvaluator(self, target)
        return OffsetEvaluator(self, target, nearest=self.formulation is Formulation.NEAREST)


class JointEvaluator(Evaluator):
    """What both formulations share: the skin, the joints' cells, and the small arrays uploaded with a pose."""

    def __init__(self, method: JointWrinkles, device: wp.Device):
        header = method.header
        self._device = device
        self._grids = header.plan.grids
        self._rig = header.rig
        self._joints = header.joints
        self._angles = JointAngles(header.rig, [grid.joint for grid in self._grids])
        self._vertex_count = header.garment.vertex_count
        self._skin = upload_skin(method.database.rest, header.garment.weights, device)
        joints, bones = len(self._grids), header.rig.bone_count
        self._matrices = HostArray((3 * bones,), wp.vec4, device)
        self._turns = HostArray((bones,), wp.quat, device)
        self._strength = HostArray((joints,), wp.float32, device)
        self.clamped: dict[str, FloatArray] = {}

    @property
    def vertex_count(self) -> int:
        return self._vertex_count

    @property
    def device(self) -> wp.Device:
        return self._device

    def evaluate_apart(
        self,
        pose: Pose,
        groups: Sequence[Sequence[str]],
        meshes: wp.array,
        strength: Mapping[str, float] | float = 1.0,
        placement: FloatArray | None = None,
    ) -> None:
        """The skinned garment, and by how much each of some groups of joints, by itself, moves it off.

        Args:
            groups: Names of the joints of each; every joint is in one.
            meshes: Array of vec3 on the evaluator's device, shape [1 + group_count, vertex_count].
        """
        names = [joint.name for joint in self._joints]
        strengths = strength if isinstance(strength, Mapping) else dict.fromkeys(names, strength)
        for number, members in enumerate(((), *groups)):
            own = {name: strengths.get(name, 1.0) if name in members else 0.0 for name in names}
            self.evaluate(pose, meshes[number], own, placement)
        wp.launch(take_first_away, self._vertex_count, [meshes], device=self._device)

    def _read_pose(
        self, pose: Pose, strength: Mapping[str, float] | float, placement: FloatArray | None
    ) -> tuple[FloatArray, list[GridCell]]:
        """Fill the arrays that every formulation needs; returns the bones' matrices, placed, and each joint's cell."""
        deformations = pose.deformations(self._rig)
        turns = rotations.from_matrices(deformations[:, :3, :3])
        placed = deformations if placement is None else placement @ deformations
        self._matrices.host[:] = placed[:, :3, :].reshape(-1, 4)
        self._turns.host[:] = turns[:, [1, 2, 3, 0]]
        cells = []
        self.clamped.clear()
        for number, (grid, angles) in enumerate(zip(self._grids, self._angles.read(turns), strict=True)):
            cell = find_cell(grid, angles)
            cells.append(cell)
            if cell.beyond.any():
                self.clamped[grid.joint.name] = cell.beyond
            name = grid.joint.name
            self._strength.host[number] = strength.get(name, 1.0) if isinstance(strength, Mapping) else strength
        for array in (self._matrices, self._turns, self._strength):
            array.upload()
        return placed, cells


class OffsetEvaluator(JointEvaluator):
    """p(v) = x(v) + Q(v) d(v), where d joins phi_J(v) delta_J(v, a_J) of all joints, or of each one's nearest sample.

    See :func:`..kernels.blend.join_offsets` for how offsets are joined.
    """

    def __init__(self, method: JointWrinkles, device: wp.Device, *, nearest: bool = False):
        super().__init__(method, device)
        self._nearest = nearest
        block_size = BLOCK_SIZE if device.is_cpu else 1
        edges = np.arange(-(-self._vertex_count // block_size) + 1) * block_size
        owners, entry_starts, windows, data = [], [], [], []
        self._starts: list[dict[tuple[int, ...], int]] = []
        base = entry_count = 0
        for grid in self._grids:
            name = grid.joint.name
            stored = {index: method.samples[Sample(name, index)] for index in grid.nodes()}
            window = method.window(name)
            moved = np.zeros(self._vertex_count, bool)
            for sample in stored.values():
                moved[sample.vertices] = True
            vertices = np.flatnonzero(moved & (window > 0.0))
            place = np.full(self._vertex_count, -1)
            place[vertices] = np.arange(len(vertices))
            starts = {}
            for index, sample in stored.items():
                block = np.zeros((len(vertices), 3), np.float32)
                kept = place[sample.vertices] >= 0
                block[place[sample.vertices[kept]]] = sample.offsets[kept]
                # Counted from the joint's first entry, so that a start plus an entry is a place.
                starts[index] = base - entry_count
                base += len(vertices)
                data.append(block)
            self._starts.append(starts)
            owners.append(vertices)
            entry_starts.append(entry_count + np.searchsorted(vertices, edges))
            windows.append(window[vertices])
            entry_count += len(vertices)
        joints = len(self._grids)
        self._corner_start = HostArray((joints,), Corners, device)
        self._corner_weight = HostArray((joints,), CornerWeights, device)
        samples = Offsets()
        samples.block_size = block_size
        samples.entry_start = wp.array(np.stack(entry_starts), dtype=wp.int32, device=device)
        samples.entry_vertex = wp.array(np.concatenate(owners), dtype=wp.int32, device=device)
        samples.entry_window = wp.array(np.concatenate(windows), dtype=wp.float32, device=device)
        samples.entry_offset = wp.zeros(entry_count, dtype=wp.vec3, device=device)
        samples.offsets = wp.array(np.concatenate(data or [np.zeros((0, 3))]), dtype=wp.vec3, device=device)
        self._samples = samples
        self._mesh_of_joint = HostArray((joints,), wp.int32, device)
        self._placement = HostArray((1,), wp.mat33, device)
        self._split = SplitLaunch(self._vertex_count, device, block_size)
        self._make_room(1)

    def evaluate(
        self,
        pose: Pose,
        out: wp.array,
        strength: Mapping[str, float] | float = 1.0,
        placement: FloatArray | None = None,
    ) -> None:
        self._mesh_of_joint.host[:] = 0
        self._evaluate(pose, out.reshape((1, self._vertex_count)), strength, placement)

    def evaluate_apart(
        self,
        pose: Pose,
        groups: Sequence[Sequence[str]],
        meshes: wp.array,
        strength: Mapping[str, float] | float = 1.0,
        placement: FloatArray | None = None,
    ) -> None:
        for number, name in enumerate(grid.joint.name for grid in self._grids):
            self._mesh_of_joint.host[number] = 1 + next(k for k, members in enumerate(groups) if name in members)
        self._evaluate(pose, meshes, strength, placement)

    def _make_room(self, mesh_count: int) -> None:
        shape = (mesh_count, self._vertex_count)
        self._sums = Sums()
        self._sums.total = wp.zeros(shape, dtype=wp.vec3, device=self._device)
        self._sums.largest = wp.zeros(shape, dtype=wp.float32, device=self._device)
        posed = [
            self._matrices,
            self._turns,
            self._corner_start,
            self._corner_weight,
            self._strength,
            self._mesh_of_joint,
            self._placement,
        ]
        inputs = [self._skin, self._samples, *(array.device for array in posed)]
        # Where the meshes are written to is told with every pose.
        self._launch = self._split.record(blend_offsets, inputs, [self._sums, self._sums.total])

    def _evaluate(
        self, pose: Pose, meshes: wp.array, strength: Mapping[str, float] | float, placement: FloatArray | None
    ) -> None:
        if meshes.shape[0] > self._sums.total.shape[0]:
            self._make_room(meshes.shape[0])
        _, cells = self._read_pose(pose, strength, placement)
        self._corner_start.host[:] = -1
        for number, (grid, cell) in enumerate(zip(self._grids, cells, strict=True)):
            corner = 0
            place = replace(cell, fraction=np.round(cell.fraction)) if self._nearest else cell
            for node, weight in corner_nodes(place):
                # The rest sample is all zeros and is not stored; a joint without strength need not be read.
                if weight * self._strength.host[number] != 0.0 and node != grid.rest:
                    self._corner_start.host[number, corner] = self._starts[number][node]
                    self._corner_weight.host[number, corner] = weight
                    corner += 1
        self._placement.host[:] = np.eye(3) if placement is None else placement[:3, :3]
        for array in (self._corner_start, self._corner_weight, self._mesh_of_joint, self._placement):
            array.upload()
        self._launch({"positions": meshes})


class PaperEvaluator(JointEvaluator):
    """Positions interpolated by eq 1 to 3 and averaged by eq 4 in the rigid frames of the regions."""

    def __init__(self, method: JointWrinkles, device: wp.Device):
        super().__init__(method, device)
        regions = method.header.regions
        self._segment_bones = regions.frames
        segments, count = len(regions.segments), len(self._grids)
        self._launch = SplitLaunch(self._vertex_count, device)
        weights = method.joint_weights()
        owners, numbers, places, frames, shares, data = [], [], [], [], [], []
        self._starts: list[dict[tuple[int, ...], int]] = []
        base = 0
        for number, grid in enumerate(self._grids):
            name = grid.joint.name
            vertices = np.flatnonzero(weights[name] > 0.0)
            starts = {}
            for index in itertools.product(*(range(n) for n in grid.shape)):
                sample = Sample(name, index)
                whole = method.database.rest if index == grid.rest else method.database.positions(sample)
                starts[index] = base
                base += len(vertices)
                data.append(whole[vertices].astype(np.float32))
            self._starts.append(starts)
            owners.append(vertices)
            numbers.append(np.full(len(vertices), number))
            places.append(np.arange(len(vertices)))
            frames.append(number * segments + regions.vertex_segment[vertices])
            shares.append(weights[name][vertices])
        start, order = group(np.concatenate(owners), self._vertex_count)
        samples = Positions()
        samples.entry_start = wp.array(start, dtype=wp.int32, device=device)
        samples.entry_joint = wp.array(np.concatenate(numbers)[order], dtype=wp.int32, device=device)
        samples.entry_place = wp.array(np.concatenate(places)[order], dtype=wp.int32, device=device)
        samples.entry_frame = wp.array(np.concatenate(frames)[order], dtype=wp.int32, device=device)
        samples.entry_weight = wp.array(np.concatenate(shares)[order], dtype=wp.float32, device=device)
        samples.positions = wp.array(np.concatenate(data), dtype=wp.vec3, device=device)
        self._samples = samples
        self._corner_start = HostArray((count, CORNERS), wp.int32, device)
        self._fraction = HostArray((count,), wp.vec3, device)
        self._twist_axis = HostArray((count, 4), wp.vec3, device)
        self._frames = HostArray((3 * count * segments,), wp.vec4, device)
        cells = Cells()
        cells.corner_start = self._corner_start.device
        cells.fraction = self._fraction.device
        cells.twist_axis = self._twist_axis.device
        cells.dof = wp.array([joint.dof for joint in self._joints], dtype=wp.int32, device=device)
        cells.centre = wp.array([joint.pivot(self._rig) for joint in self._joints], dtype=wp.vec3, device=device)
        cells.hinge_axis = wp.array([joint.axes[0] for joint in self._joints], dtype=wp.vec3, device=device)
        cells.hinge_about_axis = int(method.hinges_about_axis)
        self._cells = cells

    def evaluate(
        self,
        pose: Pose,
        out: wp.array,
        strength: Mapping[str, float] | float = 1.0,
        placement: FloatArray | None = None,
    ) -> None:
        placed, cells = self._read_pose(pose, strength, placement)
        segments = len(self._segment_bones)
        for number, (grid, cell) in enumerate(zip(self._grids, cells, strict=True)):
            joint = grid.joint
            for corner, (node, _) in enumerate(corner_nodes(cell)):
                self._corner_start.host[number, corner] = self._starts[number][node]
            self._fraction.host[number, : joint.dof] = cell.fraction
            if joint.dof == 3:
                # At each swing node the twist axis is the bone as the swing alone has turned it.
                for swing, (node, _) in enumerate(corner_nodes(cell)[::2]):
                    angles = grid.at(node)
                    turn = joint.turn([0.0, angles[1], angles[2]])
                    self._twist_axis.host[number, swing] = rotations.rotate(turn, joint.axes[0])
            clamped = grid.at(cell.lower) + cell.fraction * (grid.at(cell.upper) - grid.at(cell.lower))
            alone = pose_of_angles(self._rig, [joint], {joint.name: clamped}).deformations(self._rig)
            for segment, bone in enumerate(self._segment_bones):
                rigid = placed[bone] @ np.linalg.inv(alone[bone])
                row = 3 * (number * segments + segment)
                self._frames.host[row : row + 3] = rigid[:3, :]
        for array in (self._corner_start, self._fraction, self._twist_axis, self._frames):
            array.upload()
        self._launch(
            blend_positions,
            [
                self._skin,
                self._samples,
                self._cells,
                self._frames.device,
                self._matrices.device,
                self._strength.device,
            ],
            [out],
        )


def corner_nodes(cell: GridCell) -> list[tuple[tuple[int, ...], float]]:
    """Nodes around a cell with their multilinear weights; the bits of a corner's number choose the upper nodes."""
    nodes: list[tuple[tuple[int, ...], float]] = [((), 1.0)]
    for below, above, t in zip(cell.lower, cell.upper, cell.fraction.tolist(), strict=True):
        lower = [((*node, below), weight * (1.0 - t)) for node, weight in nodes]
        nodes = lower + [((*node, above), weight * t) for node, weight in nodes]
    return nodes


def upload_skin(rest: FloatArray, weights: SkinWeights, device: wp.Device) -> Skin:
    """The settled garment and its weights as kernels read them."""
    skin = Skin()
    skin.rest = wp.array(rest.astype(np.float32), dtype=wp.vec3, device=device)
    skin.bones = wp.array(weights.bones, dtype=wp.int32, device=device)
    skin.weights = wp.array(weights.weights, dtype=wp.float32, device=device)
    return skin


class HostArray:
    """A small array that is filled with NumPy and read by kernels; on the CPU both are the same memory.

    Attributes:
        host: The NumPy side.
        device: The Warp side, current after :meth:`upload`.
    """

    def __init__(self, shape: tuple[int, ...], dtype: type, device: wp.Device):
        self._pinned = wp.zeros(shape, dtype=dtype, device="cpu", pinned=device.is_cuda)
        self.host: NDArray = self._pinned.numpy()
        self.device = self._pinned if device.is_cpu else wp.zeros(shape, dtype=dtype, device=device)

    def upload(self) -> None:
        if self.device is not self._pinned:
            wp.copy(self.device, self._pinned)
