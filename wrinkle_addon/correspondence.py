"""Which coarse triangle each vertex of a garment rides on (Wang et al. 2010, section 3.4; W80).

    match = find_correspondence("Shirt", fine_positions, fine_faces, coarse_positions, coarse_faces)
    match.corners, match.weights      # a_uv: three coarse vertices and their weights for every fine vertex
    match.doubtful                    # fine vertices whose neighbours ride elsewhere

Any triangle mesh over the garment can be the coarse one. Both are given at one instant at which they lie on each other:
a made coarse mesh and the garment that it was made from, a cloth object and the garment in the rest pose.

The nearest triangle may belong to another layer or to the inside of a sleeve. So of two that are about as near the one
that faces along the garment's (smoothed) normal is taken; then neighbouring fine vertices must ride on triangles near
each other. Where they do not, the largest part of the garment that hangs together is believed, and the rest is matched
anew from its edge inwards, each vertex among the triangles around those of its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .cloth_model import FloatArray, IntArray
from .coarse_space import aggregate
from .garment import neighbour_mean, vertex_neighbours, vertex_normals
from .surface import FacingSurface
from .topology import border_edges, connected_parts, group, mesh_edges, row_starts, rows_of

NORMAL_ROUNDS = 5
"""Rounds of averaging over neighbours that take wrinkles out of the garment's normals."""
FARTHEST = 0.1
"""Median distance from which a coarse mesh does not lie on the garment, as a share of the garment's size."""
NEAR_EDGES = 3
"""Edges of the coarse mesh between triangles that the two ends of a garment's edge may ride on."""
MOST_REVERSED = 0.6
"""Share of the garment over triangles that face away, from which the coarse mesh is inside out."""


@dataclass(frozen=True, eq=False)
class Correspondence:
    """A garment's vertices on the triangles of a coarse mesh.

    Attributes:
        faces: Coarse triangle of each fine vertex, shape [fine_count].
        corners: Its vertices, shape [fine_count, 3].
        weights: a_uv: barycentric coordinates of the point of the triangle that is closest to the fine vertex, at least
            0 and adding up to 1, shape [fine_count, 3].
        places: Where the fine vertex lies exactly: coordinates along the triangle's edges 01 and 02, not held inside
            it, and the height over its plane [m], shape [fine_count, 3].
        distance: From the fine vertex to its triangle [m], shape [fine_count].
        on_border: Whether each fine vertex lies on an open border, shape [fine_count].
        coarse_on_border: The same of each coarse vertex, shape [coarse_count].
        repaired: Fine vertices that had found a wrong layer or side, ascending.
        doubtful: Fine vertices that ride far from where a neighbour does, or to do as it does farther from themselves
            than need be, by more than a coarse edge; ascending.
    """

    faces: IntArray
    corners: IntArray
    weights: NDArray[np.float32]
    places: NDArray[np.float32]
    distance: FloatArray
    on_border: NDArray[np.bool_]
    coarse_on_border: NDArray[np.bool_]
    repaired: IntArray
    doubtful: IntArray

    @property
    def fine_count(self) -> int:
        return len(self.faces)

    @property
    def coarse_count(self) -> int:
        return len(self.coarse_on_border)

    def members(self, *, as_published: bool = False) -> tuple[IntArray, IntArray, NDArray[np.float32]]:
        """The fine vertices around each coarse one: (start, vertices, shares that add up to 1 a coarse vertex).

        Around a coarse vertex on a border only those on the border count, if there are some: all others lie on one
        side of it, and what turns with a hem would be averaged away. As published all count.
        """
        entry = np.flatnonzero(self.weights.ravel() > 0.0)
        owner = self.corners.ravel()[entry]
        if not as_published:
            on_border = self.on_border[entry // 3]
            has_border = np.bincount(owner, on_border, self.coarse_count) > 0
            kept = on_border | ~(self.coarse_on_border & has_border)[owner]
            entry, owner = entry[kept], owner[kept]
        start, order = group(owner, self.coarse_count)
        weight = self.weights.ravel()[entry].astype(np.float64)
        shares = weight / np.bincount(owner, weight, self.coarse_count)[owner]
        return start, (entry[order] // 3).astype(np.int32), shares[order].astype(np.float32)


def find_correspondence(
    name: str, positions: FloatArray, faces: IntArray, coarse_positions: FloatArray, coarse_faces: IntArray
) -> Correspondence:
    """Match a garment with a coarse mesh.

    Args:
        name: The coarse mesh's, for what is said about it.
        positions, faces: The garment, [fine_count, 3] [m] and [fine_triangle_count, 3].
        coarse_positions, coarse_faces: The coarse mesh at the same instant, in the same space.

    Raises:
        ValueError: If the coarse mesh is none that can carry the garment; one sentence that says what to do.
    """
    positions, coarse_positions = np.asarray(positions, np.float64), np.asarray(coarse_positions, np.float64)
    _check_coarse(name, coarse_positions, coarse_faces)
    edges, coarse_edges = mesh_edges(faces)[0], mesh_edges(coarse_faces)[0]
    _check_pieces(name, _piece_count(faces, edges), _piece_count(coarse_faces, coarse_edges))
    length = float(_lengths(coarse_positions, coarse_edges).mean())
    normals, neighbours = vertex_normals(positions, faces), vertex_neighbours(faces, len(positions))
    for _ in range(NORMAL_ROUNDS):
        normals = normals + neighbour_mean(normals, neighbours)
    surface = FacingSurface(coarse_positions, coarse_faces)
    face, weights = surface.closest(positions, normals, reach=length)
    _check_fit(name, positions, normals, coarse_positions[coarse_faces[face]], weights)
    near = _NearTriangles(coarse_positions, coarse_faces, most=len(positions) // 2)
    nearest = _distances(positions, coarse_positions[coarse_faces[face]], weights)
    repaired = _repair(surface, near, edges, positions, normals, face, weights)
    corners = coarse_faces[face].astype(np.int32)
    distance = _distances(positions, coarse_positions[corners], weights)
    apart = edges[~near.contains(face[edges[:, 0]], face[edges[:, 1]])]
    stretched = np.flatnonzero(distance > nearest + length)
    return Correspondence(
        faces=face,
        corners=corners,
        weights=weights,
        places=_places(positions, coarse_positions[corners]),
        distance=distance,
        on_border=_on_border(faces, len(positions)),
        coarse_on_border=_on_border(coarse_faces, len(coarse_positions)),
        repaired=repaired,
        doubtful=np.union1d(apart, stretched).astype(np.int32),
    )


def _repair(
    surface: FacingSurface,
    near: _NearTriangles,
    edges: IntArray,
    positions: FloatArray,
    normals: FloatArray,
    face: IntArray,
    weights: NDArray[np.float32],
) -> IntArray:
    """Match again, in place, all that does not hang together with most of its piece; returns what that changed."""
    count, found = len(positions), face.copy()
    agree = near.contains(face[edges[:, 0]], face[edges[:, 1]])
    island = connected_parts(edges[agree], count)
    piece = connected_parts(edges, count)
    size = np.bincount(island, minlength=count)
    # The last of each piece in the order of sizes is its largest island.
    order = np.lexsort((-island, size[island], piece))
    largest = np.empty(count, np.int64)
    largest[piece[order]] = island[order]
    settled = island == largest[piece]
    both = np.concatenate([edges, edges[:, ::-1]])
    while True:
        front = both[settled[both[:, 0]] & ~settled[both[:, 1]]]
        if not len(front):
            return np.flatnonzero(face != found).astype(np.int32)
        vertices, start, candidates = near.around(face[front[:, 0]], front[:, 1])
        face[vertices], weights[vertices] = surface.closest_among(
            positions[vertices], normals[vertices], start, candidates
        )
        settled[vertices] = True


class _NearTriangles:
    """Which triangles of a mesh lie near each other: those whose first corners are a few edges apart.

    Args:
        positions, faces: The mesh, every vertex in a triangle.
        most: Vertices beyond which neighbouring ones are taken together: edges then are no shorter than a garment's.
    """

    def __init__(self, positions: FloatArray, faces: IntArray, most: int):
        start, neighbours = vertex_neighbours(faces, len(positions))
        node = np.arange(len(positions))
        if len(positions) > most:
            node = aggregate(positions, start, neighbours, most)
        self._node = node[faces[:, 0]]
        self._count = int(node.max()) + 1
        self._members = group(self._node, self._count)
        own = np.arange(self._count)
        step = np.unique(
            np.append(node[rows_of(start)] * np.int64(self._count) + node[neighbours], own * (self._count + 1))
        )
        around = step
        for _ in range(NEAR_EDGES - 1):
            first, second = np.divmod(around, self._count)
            place, third = _expand(row_starts(step // self._count, self._count), step % self._count, second)
            around = np.unique(first[place] * self._count + third)
        self._keys = around
        self._start = row_starts(around // self._count, self._count)

    def contains(self, first: IntArray, second: IntArray) -> NDArray[np.bool_]:
        """Whether triangles are near each other, pair by pair."""
        keys = self._node[first] * np.int64(self._count) + self._node[second]
        return self._keys[np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)] == keys

    def around(self, triangles: IntArray, vertices: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """All triangles near to some of a vertex's, from pairs of the two: (vertices, start, triangles)."""
        place, node = _expand(self._start, self._keys % self._count, self._node[triangles])
        owners, vertex = np.unique(vertices[place], return_inverse=True)
        pairs = np.unique(vertex.astype(np.int64).ravel() * self._count + node)
        place, near = _expand(*self._members, pairs % self._count)
        # Within a vertex in the order of the nodes, and so always the same.
        return owners, row_starts((pairs // self._count)[place], len(owners)), near.astype(np.int32)


def _expand(start: IntArray, entries: IntArray, rows: IntArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Every entry of each row asked for: (place of the row in the list, entry)."""
    count = np.diff(start)[rows]
    place = np.arange(len(rows)).repeat(count)
    nth = np.arange(len(place)) - (np.cumsum(count) - count)[place]
    return place, entries[start[:-1][rows][place] + nth].astype(np.int64)


def _places(points: FloatArray, corners: FloatArray) -> NDArray[np.float32]:
    """Coordinates of points along triangles' edges 01 and 02 and over their planes [m], shape [point_count, 3]."""
    b, c, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = np.cross(b, c)
    squared = (normal**2).sum(1)
    along_b = (np.cross(p, c) * normal).sum(1) / squared
    along_c = (np.cross(b, p) * normal).sum(1) / squared
    return np.stack([along_b, along_c, (p * normal).sum(1) / np.sqrt(squared)], 1).astype(np.float32)


def _on_border(faces: IntArray, count: int) -> NDArray[np.bool_]:
    on_border = np.zeros(count, bool)
    on_border[border_edges(faces)] = True
    return on_border


def _distances(points: FloatArray, corners: FloatArray, weights: NDArray[np.float32]) -> FloatArray:
    return np.linalg.norm(points - np.einsum("uc,ucd->ud", weights, corners), axis=1)


def _lengths(positions: FloatArray, edges: IntArray) -> FloatArray:
    return np.linalg.norm(positions[edges[:, 1]] - positions[edges[:, 0]], axis=1)


def _piece_count(faces: IntArray, edges: IntArray) -> int:
    used = np.unique(faces)
    return len(np.unique(connected_parts(edges, int(faces.max()) + 1)[used]))


def _check_coarse(name: str, positions: FloatArray, faces: IntArray) -> None:
    if not len(faces):
        raise ValueError(f"The coarse mesh '{name}' has no faces; choose a mesh with a surface.")
    if not np.isfinite(positions).all():
        raise ValueError(f"The coarse mesh '{name}' has positions that are not numbers; repair the mesh.")
    loose = len(positions) - len(np.unique(faces))
    if loose:
        raise ValueError(
            f"The coarse mesh '{name}' has {loose} loose vertices that belong to no face; delete loose geometry."
        )
    corners = positions[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    flat = int((area < 1e-6 * np.median(area)).sum()) if area.any() else len(faces)
    if flat:
        raise ValueError(
            f"The coarse mesh '{name}' has {flat} faces without area; merge vertices by distance or dissolve them."
        )


def _check_pieces(name: str, count: int, coarse_count: int) -> None:
    # Fewer are welcome: buttons may ride on a shirt.
    if coarse_count > count:
        raise ValueError(
            f"The coarse mesh '{name}' has {coarse_count} separate pieces and the garment {count}; "
            "join the pieces that belong together, or choose another coarse mesh."
        )


def _check_fit(
    name: str, positions: FloatArray, normals: FloatArray, corners: FloatArray, weights: NDArray[np.float32]
) -> None:
    distance = _distances(positions, corners, weights)
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    if np.median(distance) > FARTHEST * size:
        raise ValueError(
            f"The coarse mesh '{name}' is {np.median(distance):.2f} m away from the garment; "
            "put it where the garment is, in the same pose."
        )
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if ((facing * normals).sum(1) < 0.0).mean() > MOST_REVERSED:
        raise ValueError(f"The coarse mesh '{name}' faces inwards where the garment faces outwards; flip its normals.")
