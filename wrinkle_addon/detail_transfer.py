"""Wrinkles put over a coarse layer that moves (Wang et al. 2010, section 3.4; eq 5 and 6; W80-W86).

    match = find_correspondence("Shirt", rest, faces, coarse_rest, coarse_faces)
    transfer = DetailTransfer(match, rest, faces, device=device)      # once
    transfer.align(coarse, positions)                                 # each frame, in place

``coarse`` is where the coarse layer lies in this frame (a simulation, a cache, any mesh that moves), ``positions`` the
synthesised garment, both in one space [m] on one device. The synthesised garment is averaged down onto the coarse mesh
(eq 5), and the offset that is missing to the coarse layer is spread back over it (eq 6), smoothed over the garment so
that the coarse mesh's edges do not show (W83). The garment's own means are found before anything is known of the coarse
layer.

Four things differ from the paper's page. (a) Eq 5 compares a weighted mean of fine vertices with the coarse vertex v
itself. Where the two meshes coincide that is zero only on a plane away from borders: a sleeve is blown up and a hem
pulled out. Here each fine vertex is compared with its own place on the coarse mesh, so that a garment on its own coarse
mesh stays as it is; ``as_published`` brings the page's form back. (b) The sums in eq 6's denominators are 1, those in
eq 5's are 0 at coarse vertices that no garment lies on, whose offsets nothing uses. (c) Smoothing is linear, so it is
applied once to the weights and not every frame to the offsets: what is stored for a fine vertex are its smoothed
weights on some twenty coarse vertices. A frame then costs the same however many iterations there are. (d) On an open
border only what lies on the border counts, in eq 5 and in the smoothing, or hems would turn less than the coarse layer.

Joints that are close to each other leave no room to blend their meshes in (W86). ``close_joints`` finds them,
``transfer_groups`` puts them apart; each group's mesh is synthesised alone, aligned alone, and then they meet:

    groups = transfer_groups(names, close_joints(regions, rest, faces))
    evaluator.evaluate_apart(pose, groups, meshes)      # the skinned garment, and the groups' offsets over it
    transfer.join(meshes, positions)                    # ``blend`` is the paper's weighted mean, of aligned meshes
    transfer.attach(coarse, positions)

All that is linear, so what an offset's mean does to the coarse mesh can be taken away before the coarse layer is known.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ..kernels.transfer import (
    COLUMNS,
    FULL_WEIGHT,
    LANES,
    Columns,
    attach_mesh,
    blend_meshes,
    downsample,
    join_aligned_offsets,
    mat_lanes,
    place_means,
    smooth_columns,
    vec4us,
)
from .cloth_model import FloatArray, IntArray
from .correspondence import Correspondence
from .garment import Regions, vertex_neighbours
from .method import RecordedLaunch, SplitLaunch
from .topology import border_edges, by_fours, row_starts, rows_of

SMOOTHING_STEP = 0.5
"""Share of the way to its neighbours' mean that a value goes in one iteration; below 1, or values would oscillate."""
LEAST_WEIGHT = 1.0e-4
"""Smoothed weights below this are left out."""
LEAST_COTANGENT = 0.02
"""Angles near and above a right angle still tie their neighbours by this much."""
TOO_CLOSE = 0.1
"""Joints whose seams come nearer than this leave too little room between them [m]."""


@dataclass(frozen=True)
class TransferSettings:
    """How details are transferred.

    Attributes:
        smoothing: Iterations of Laplacian smoothing of the offsets; None takes :func:`smoothing_iterations`.
        as_published: Take eq 5 to the letter, though it changes a garment that lies on its own coarse mesh.
    """

    smoothing: int | None = None
    as_published: bool = False


def smoothing_iterations(match: Correspondence) -> int:
    """As many as there are fine vertices to a coarse one: blurs over half an edge of the coarse mesh.

    An iteration adds half the step's share of a fine edge squared to the variance along each axis.
    """
    return round(match.fine_count / len(np.unique(match.corners)))


class DetailTransfer:
    """A garment tied to its coarse layer on one device. Aligning allocates nothing but for the number of offsets.

    Args:
        match: Which coarse triangle each vertex of the garment rides on.
        positions, faces: The garment at the instant of the correspondence, [fine_count, 3] [m] and its triangles.
        settings: How.
        follow: How much of the coarse layer's motion each vertex takes on, from 0 to 1, shape [fine_count]; all of it
            if left out.
        device: Warp device.
    """

    def __init__(
        self,
        match: Correspondence,
        positions: FloatArray,
        faces: IntArray,
        settings: TransferSettings | None = None,
        follow: ArrayLike | None = None,
        device: str = "cpu",
    ):
        self.settings = settings or TransferSettings()
        self.device = wp.get_device(device)
        iterations = self.settings.smoothing
        iterations = smoothing_iterations(match) if iterations is None else iterations
        if iterations < 0:
            raise ValueError(f"Offsets cannot be smoothed {iterations} times; choose 0 or more.")
        start, columns, weights = smoothed_weights(match, positions, faces, iterations)
        if follow is not None:
            shares = np.asarray(follow, np.float32)
            if not ((shares >= 0.0) & (shares <= 1.0)).all():
                raise ValueError("How far vertices follow the coarse layer must lie between 0 and 1.")
            weights = weights * shares[rows_of(start)]
        members = match.members(as_published=self.settings.as_published)
        fours, columns, shares = by_fours(start, columns, in_whole_shares(start, weights))
        few = match.coarse_count <= 1 << 16
        arrays = (fours, wp.int32), (columns.astype(np.uint16 if few else np.int32), vec4us if few else wp.vec4i)
        self._rows = [wp.array(values, dtype=kind, device=self.device) for values, kind in (*arrays, (shares, vec4us))]
        self._members = self._upload_rows(*members)
        self._fine_count, self._coarse_count = match.fine_count, match.coarse_count
        self._split = SplitLaunch(match.fine_count, self.device)
        self._split_coarse = SplitLaunch(match.fine_count, self.device, block_count=match.coarse_count)
        self._means = wp.zeros(match.coarse_count, dtype=wp.vec3, device=self.device)
        self._recorded: dict[int, list[RecordedLaunch]] = {}
        self._attaching = self._record_attaching(mean_places(match, *members, as_published=self.settings.as_published))

    def _upload_rows(self, start: IntArray, entries: IntArray, weights: NDArray[np.floating]) -> list[wp.array]:
        kinds = wp.int32, wp.vec3i if entries.ndim > 1 else wp.int32, wp.float32
        arrays = zip((start, entries, weights), kinds, strict=True)
        return [wp.array(values, dtype=kind, device=self.device) for values, kind in arrays]

    def align(self, coarse: wp.array, positions: wp.array, strength: float = 1.0) -> None:
        """Bring a synthesised garment into line with the coarse layer, in place.

        Args:
            coarse: Where the coarse layer lies [m], array of vec3, shape [coarse_count].
            positions: The garment [m], array of vec3, shape [fine_count].
            strength: How far it goes, from 0, not at all, to 1.
        """
        self.measure(positions)
        self.attach(coarse, positions, strength)

    def measure(self, positions: wp.array) -> None:
        """Find the means of a synthesised garment on the coarse mesh, for :meth:`attach`."""
        self._launches(0)[0]({"positions": positions})

    def join(self, meshes: wp.array, positions: wp.array, strength: float = 1.0) -> None:
        """Join offsets as joints' are, each of them aligned by itself, and :meth:`measure` the garment.

        Args:
            meshes: A garment and one or more offsets of it [m], array of vec3, shape [1 + offset_count, fine_count];
                offsets are aligned in place, as far as they can be without the coarse layer.
            positions: Where to write the garment with its offsets [m], shape [fine_count].
            strength: As :meth:`attach` will be told.
        """
        changed = {"positions": meshes[0], "offsets": meshes[1:], "joined": positions, "strength": strength}
        for stage in self._launches(meshes.shape[0] - 1):
            stage(changed)

    def attach(self, coarse: wp.array, positions: wp.array, strength: float = 1.0) -> None:
        """Bring the garment that was measured or joined last into line, in place; arguments as :meth:`align`."""
        for stage in self._attaching:
            stage({"coarse": coarse, "positions": positions, "strength": strength})

    def _launches(self, offset_count: int) -> list[RecordedLaunch]:
        """What measures a garment with so many offsets, and what joins those; the arrays are still to be told."""
        sides = -(-offset_count // LANES)
        if sides not in self._recorded:
            positions = wp.zeros(self._fine_count, dtype=wp.vec3, device=self.device)
            offsets = positions.reshape((1, self._fine_count))
            means = wp.zeros((sides, self._coarse_count), dtype=mat_lanes, device=self.device)
            measure = [positions, offsets, *self._members], [self._means, means]
            join = [means, *self._rows, 1.0, positions], [offsets, positions]
            launches = [self._split_coarse.record(downsample, *measure)]
            self._recorded[sides] = [*launches, self._split.record(join_aligned_offsets, *join)]
        return self._recorded[sides]

    def _record_attaching(self, places: MeanPlaces) -> list[RecordedLaunch]:
        coarse, missing = (wp.zeros(self._coarse_count, dtype=wp.vec3, device=self.device) for _ in range(2))
        positions = wp.zeros(self._fine_count, dtype=wp.vec3, device=self.device)
        rows = [*self._upload_rows(*places.corners), *self._upload_rows(*places.normals)]
        return [
            SplitLaunch(self._coarse_count, self.device).record(place_means, [coarse, *rows, self._means], [missing]),
            self._split.record(attach_mesh, [missing, *self._rows, 1.0], [positions]),
        ]

    def blend(self, meshes: wp.array, shares: wp.array, positions: wp.array) -> None:
        """Weighted mean of aligned meshes, shape [fine_count]; shares [mesh_count, fine_count] add up to 1 (W86)."""
        wp.launch(blend_meshes, self._fine_count, [meshes, shares], [positions], device=self.device)


# --- the operator -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MeanPlaces:
    """Where the means of the fine vertices around each coarse vertex belong as the coarse layer lies.

    Attributes:
        corners: Sums over coarse vertices: where each row begins, [coarse_count + 1], vertices, and weights.
        normals: Sums over unit normals of coarse triangles: where each row begins, [coarse_count + 1], corners of the
            triangles, [entry_count, 3], and heights over them [m].
    """

    corners: tuple[IntArray, IntArray, FloatArray]
    normals: tuple[IntArray, IntArray, FloatArray]


def mean_places(
    match: Correspondence, start: IntArray, members: IntArray, shares: NDArray[np.float32], *, as_published: bool
) -> MeanPlaces:
    """Places of the means of :meth:`Correspondence.members`; as published at the coarse vertices themselves."""
    row, share = rows_of(start), shares.astype(np.float64)
    if as_published:
        full = np.flatnonzero(np.diff(start)).astype(np.int32)
        start = row_starts(full, match.coarse_count)
        none = np.zeros(match.coarse_count + 1, np.int32), np.zeros((0, 3), np.int32), np.zeros(0)
        return MeanPlaces((start, full, np.ones(len(full))), none)
    b, c, height = match.places[members].astype(np.float64).T
    weights = (share[:, None] * np.stack([1.0 - b - c, b, c], 1)).ravel()
    triangles, first, triangle = np.unique(match.faces, return_index=True, return_inverse=True)
    corners = _summed(row.repeat(3), match.corners[members].ravel(), weights, match.coarse_count)
    begin, beside, heights = _summed(row, triangle[members], share * height, match.coarse_count, len(triangles))
    return MeanPlaces(corners, (begin, match.corners[first[beside]], heights))


def _summed(
    rows: IntArray, columns: IntArray, values: FloatArray, row_count: int, column_count: int | None = None
) -> tuple[IntArray, IntArray, FloatArray]:
    """A sparse matrix from entries that may fall together: where its rows begin, columns, and values."""
    width = row_count if column_count is None else column_count
    keys, entry = np.unique(rows.astype(np.int64) * width + columns, return_inverse=True)
    start = row_starts((keys // width).astype(np.int32), row_count)
    return start, (keys % width).astype(np.int32), np.bincount(entry, values, len(keys)).astype(np.float64)


def smoothed_weights(
    match: Correspondence, positions: FloatArray, faces: IntArray, iterations: int
) -> tuple[IntArray, IntArray, NDArray[np.float32]]:
    """Eq 6's weights after Laplacian smoothing over the garment: what each fine vertex takes of coarse offsets.

    Returns:
        Where each fine vertex's entries begin, [fine_count + 1], coarse vertices in ascending order and their weights,
        which add up to 1 for every fine vertex.
    """
    laplacian = [wp.array(values, device="cpu") for values in cotangent_weights(positions, faces)]
    width, found = int(COLUMNS), []
    vertex = np.arange(match.fine_count).repeat(3)
    corner, weight = match.corners.ravel(), match.weights.ravel()
    buffers = [wp.zeros(match.fine_count, dtype=Columns, device="cpu") for _ in range(2)]
    for first in range(0, match.coarse_count, width):
        here = (corner >= first) & (corner < first + width)
        values = buffers[0].numpy()
        values[:] = 0.0
        np.add.at(values, (vertex[here], corner[here] - first), weight[here])
        for _ in range(iterations):
            inputs = [*laplacian, SMOOTHING_STEP, buffers[0]]
            wp.launch(smooth_columns, match.fine_count, inputs, [buffers[1]], device="cpu")
            buffers.reverse()
        values = buffers[0].numpy()
        rows, columns = np.nonzero(values > LEAST_WEIGHT)
        found.append((rows, columns + first, values[rows, columns]))
    rows, columns, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.lexsort((columns, rows))
    rows, columns, weights = rows[order], columns[order], weights[order].astype(np.float64)
    weights /= np.bincount(rows, weights, match.fine_count)[rows]
    return row_starts(rows, match.fine_count), columns.astype(np.int32), weights.astype(np.float32)


def in_whole_shares(start: IntArray, weights: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Weights, 0 to 1, as whole numbers of :data:`FULL_WEIGHT` shares; every row's sum is kept to half a share.

    What a row lacks after rounding down goes to the entries that lost most (Hamilton's largest remainders).
    """
    exact = weights.astype(np.float64) * int(FULL_WEIGHT)
    counts = np.floor(exact)
    rows, row_count = rows_of(start), len(start) - 1
    lost = exact - counts
    lacking = np.round(np.bincount(rows, lost, row_count)).astype(np.int64)
    order = np.lexsort((-lost, rows))
    counts[order] += np.arange(len(order)) - start[:-1][rows] < lacking[rows]
    return counts.astype(np.uint16)


def cotangent_weights(positions: FloatArray, faces: IntArray) -> tuple[IntArray, IntArray, NDArray[np.float32]]:
    """Neighbours of each vertex and their weights in a Laplacian that adds up to 1: (start, neighbours, weights).

    Cotangents of the angles opposite to an edge, at least LEAST_COTANGENT: unlike equal weights they keep to the
    surface's own measure, so that uneven triangles do not drag what is smoothed along. A vertex on an open border has
    its two neighbours along the border alone: what turns with a hem keeps its slope there.
    """
    start, neighbours = vertex_neighbours(faces, len(positions))
    # Keys of a garment of more than 46,340 vertices are too large for 32 bits.
    count, wide = len(positions), faces.astype(np.int64)
    keys = rows_of(start).astype(np.int64) * count + neighbours
    weights = np.zeros(len(keys))
    for k in range(3):
        a, b, c = wide[:, k], wide[:, (k + 1) % 3], wide[:, (k + 2) % 3]
        p, q = positions[a] - positions[c], positions[b] - positions[c]
        doubled = np.linalg.norm(np.cross(p, q), axis=1)
        cotangent = np.maximum((p * q).sum(1) / np.maximum(doubled, 1e-30), LEAST_COTANGENT)
        for near, far in ((a, b), (b, a)):
            np.add.at(weights, np.searchsorted(keys, near * count + far), cotangent)
    a, b = border_edges(faces).T.astype(np.int64)
    along = np.searchsorted(keys, np.concatenate([a * count + b, b * count + a]))
    weights[np.isin(rows_of(start), (a, b))] = 0.0
    weights[along] = np.tile(1.0 / np.linalg.norm(positions[a] - positions[b], axis=1), 2)
    weights /= np.add.reduceat(weights, start[:-1])[rows_of(start)]
    return start, neighbours, weights.astype(np.float32)


# --- joints that are close to each other --------------------------------------------------------------------------


def close_joints(
    regions: Regions, positions: FloatArray, faces: IntArray, within: float = TOO_CLOSE
) -> tuple[tuple[str, str], ...]:
    """Pairs of joints of one region whose seams come so near that their meshes have no room to blend (W86).

    Args:
        regions: The garment's.
        positions, faces: The garment at rest, [fine_count, 3] [m] and its triangles.
        within: Distance between two seams [m].
    """
    seams = {name: positions[_seam(regions, faces, sides)] for name, sides in regions.joints.items()}
    return tuple(
        (a, b)
        for a, b in itertools.combinations(regions.joints, 2)
        if set(regions.joints[a]) & set(regions.joints[b])
        and len(seams[a])
        and len(seams[b])
        and _gap(seams[a], seams[b]) < within
    )


def _seam(regions: Regions, faces: IntArray, sides: tuple[int, int]) -> IntArray:
    """Vertices of the triangles that lie on both sides of a joint."""
    segment = regions.vertex_segment[faces]
    both = (segment == sides[0]).any(1) & (segment == sides[1]).any(1)
    return np.unique(faces[both])


def _gap(points: FloatArray, others: FloatArray) -> float:
    return min(float(np.linalg.norm(others - point, axis=1).min()) for point in points)


def transfer_groups(joints: Sequence[str], close: Sequence[tuple[str, str]]) -> tuple[tuple[str, ...], ...]:
    """Joints in as few groups as it takes, in turn, to have no two close ones in one group."""
    pairs = {frozenset(pair) for pair in close}
    groups: list[list[str]] = []
    for joint in joints:
        for group in groups:
            if not any(frozenset((joint, other)) in pairs for other in group):
                group.append(joint)
                break
        else:
            groups.append([joint])
    return tuple(tuple(group) for group in groups)


def group_shares(weights: Mapping[str, FloatArray], groups: Sequence[Sequence[str]]) -> NDArray[np.float32]:
    """What each group of joints counts on every vertex: its joints' weights of eq 4, shape [group_count, fine_count].

    What a region without joints leaves over goes to the first group.
    """
    shares = np.stack([np.sum([weights[name] for name in group], axis=0) for group in groups])
    shares[0] += 1.0 - shares.sum(0)
    return shares.astype(np.float32)
