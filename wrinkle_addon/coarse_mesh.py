"""A coarse mesh made from a garment: what simulates its large motion (Wang et al. 2010, section 3.2; W40).

The garment's own triangles are collapsed, flipped and slid over its surface (:mod:`.remesh`) until they are few, even
and nearly equilateral; nothing is un-subdivided, as then the fine mesh would show the coarse one's edges (W84). Open
borders keep to the garment's own, and their corners stay where they are. Vertices only ever merge along edges, so
layers that lie on each other never grow together, and folds keep their ends. Pieces too small for a few coarse
triangles (buttons, a pocket sewn on) are left out: they ride on the triangles under them (:mod:`.correspondence`).

    coarse = make_coarse_mesh("Shirt", positions, faces)         # 700 vertices
    coarse.positions, coarse.faces

The same input gives the same mesh, to the bit.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .cloth_model import FloatArray, IntArray
from .garment import check_surface
from .remesh import Edges, Patch, compact, normals, polish, remesh
from .surface import FacingSurface
from .topology import connected_parts, mesh_edges

VERTEX_COUNT = 700
"""Vertices of a coarse mesh where nothing else is asked for; the paper's have 600 to 800 (W40)."""
COUNT_TOLERANCE = 0.05
"""The count may differ from the wanted one by this share, at once ..."""
MOST_OFF = 0.25
"""... and where a garment's borders and folds leave nothing better."""
ATTEMPTS = 6
"""Edge lengths that are tried before a count is given up."""
LEAST_COUNT = 24
"""Vertices below which nothing is left of a garment's shape."""
SMALLEST_PIECE = 12
"""A piece that would get fewer vertices than this is left out."""
STEP = 1.3
"""How much longer edges grow before the mesh is evened out again: about what merging every other vertex does."""
CORNER_ANGLE = np.radians(60.0)
"""Turn of a border over the length of a coarse edge from which it is a corner, which stays [rad]."""
BITS = 62
"""Border curves that can be told apart; two that share a number are still never joined."""


@dataclass(frozen=True, eq=False)
class CoarseMesh:
    """The coarse layer of a garment as made, in the garment's own space.

    Attributes:
        positions: Vertices on the garment's surface [m], shape [vertex_count, 3].
        faces: Triangles, facing as the garment's, shape [triangle_count, 3].
    """

    positions: FloatArray
    faces: IntArray

    @cached_property
    def edge_length(self) -> float:
        """Mean length of its edges [m]."""
        return mean_edge_length(self.positions, self.faces)


def mean_edge_length(positions: FloatArray, faces: IntArray) -> float:
    """Mean length of a mesh's edges [m]."""
    a, b = mesh_edges(faces)[0].T
    return float(np.linalg.norm(positions[a] - positions[b], axis=1).mean())


def make_coarse_mesh(name: str, positions: FloatArray, faces: IntArray, vertex_count: int = VERTEX_COUNT) -> CoarseMesh:
    """Coarse triangles on a garment.

    Args:
        name: The garment's, for what is said about it.
        positions: Its vertices [m], shape [fine_count, 3].
        faces: Its triangles, shape [fine_triangle_count, 3].
        vertex_count: Wanted number of coarse vertices, met within COUNT_TOLERANCE on nearly all garments.

    Raises:
        ValueError: If the garment is no surface that can be simulated, or cannot be meshed with so many vertices; one
            sentence that says what is wrong and what to do.
    """
    check_surface(name, positions, faces)
    check_winding(name, faces)
    if not LEAST_COUNT <= vertex_count < len(positions):
        raise ValueError(
            f"A coarse mesh of the garment '{name}' needs from {LEAST_COUNT} to {len(positions) - 1} vertices, "
            f"not {vertex_count}."
        )
    pieces = _large_pieces(np.asarray(positions, np.float64), faces, vertex_count)
    area = sum(_area(piece) for piece in pieces)
    # A vertex owns two triangles of side s, together s^2 sqrt(3) / 2.
    length = np.sqrt(2.0 * area / (np.sqrt(3.0) * vertex_count))
    found = [_coarsen(piece, length) for piece in pieces]
    best = [patch for patch, _ in found]
    for _ in range(ATTEMPTS):
        count = sum(len(patch.vertices) for patch, _ in found)
        best = min(best, [patch for patch, _ in found], key=lambda patches: abs(_count(patches) - vertex_count))
        if abs(count / vertex_count - 1.0) < COUNT_TOLERANCE:
            break
        length *= np.sqrt(count / vertex_count)
        found = [(_even_out(patch, shape, length), shape) for patch, shape in found]
    if abs(_count(best) / vertex_count - 1.0) > MOST_OFF:
        raise ValueError(
            f"The garment '{name}' could not be meshed evenly with {vertex_count} vertices (it came to "
            f"{_count(best)}); ask for more, or choose a coarse mesh of your own."
        )
    return _joined(best)


def _count(patches: list[Patch]) -> int:
    return sum(len(patch.vertices) for patch in patches)


def check_winding(name: str, faces: IntArray) -> None:
    """Refuse a mesh whose neighbouring triangles face opposite ways, or hang together by a single vertex.

    Raises:
        ValueError: One sentence that says what is wrong and what to do.
    """
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    twice = len(directed) - len(np.unique(directed, axis=0))
    if twice:
        raise ValueError(
            f"The garment '{name}' has {twice} edges whose two faces face opposite ways; recalculate its normals."
        )
    _, index, count = np.unique(np.sort(directed, axis=1), axis=0, return_index=True, return_counts=True)
    starts = directed[index[count == 1], 0]
    touching = len(starts) - len(np.unique(starts))
    if touching:
        raise ValueError(
            f"The garment '{name}' has {touching} vertices at which open borders touch; split them or fill the gap."
        )


def _large_pieces(positions: FloatArray, faces: IntArray, vertex_count: int) -> list[Patch]:
    """The connected pieces worth meshing, at least the largest, in the order of their first vertices."""
    label = connected_parts(mesh_edges(faces)[0], len(positions))[faces[:, 0]]
    borders = np.zeros(len(positions), np.int64)
    pieces = [
        compact(Patch(positions, faces[label == number].astype(np.int64), borders)) for number in np.unique(label)
    ]
    areas = np.array([_area(piece) for piece in pieces])
    large = areas * vertex_count >= SMALLEST_PIECE * areas.sum()
    large[areas.argmax()] = True
    return [piece for piece, kept in zip(pieces, large, strict=True) if kept]


def _area(patch: Patch) -> float:
    return 0.5 * float(np.linalg.norm(normals(patch.vertices, patch.triangles), axis=1).sum())


def _joined(patches: list[Patch]) -> CoarseMesh:
    first = np.cumsum([0] + [len(patch.vertices) for patch in patches])
    faces = [patch.triangles + start for patch, start in zip(patches, first[:-1], strict=True)]
    return CoarseMesh(np.concatenate([patch.vertices for patch in patches]), np.concatenate(faces).astype(np.int32))


def _coarsen(piece: Patch, length: float) -> tuple[Patch, _Shape]:
    """A connected piece with edges of about this length [m], and what its vertices keep to."""
    curves = border_curves(piece, length)
    borders = np.zeros(len(piece.vertices), np.int64)
    for number, curve in enumerate(curves):
        borders[curve] |= 1 << (number % BITS)
    shape = _Shape(piece, curves, length)
    # Of edges that are about as long the one numbered first merges: in no order, many are the first ones around.
    number = np.random.default_rng(0).permutation(len(piece.vertices))
    order = np.argsort(number)
    patch = Patch(piece.vertices[order], number[piece.triangles], borders[order])
    start = float(np.median(Edges.of(patch.triangles).lengths(patch.vertices)))
    steps = max(1, round(np.log(length / start) / np.log(STEP)))
    for step in range(1, steps + 1):
        between = start * (length / start) ** (step / steps)
        patch = remesh(patch, between, shape.project, passes=2, coarsen=True)
    return _even_out(patch, shape, length), shape


def _even_out(patch: Patch, shape: _Shape, length: float) -> Patch:
    patch = remesh(patch, length, shape.project, passes=4, coarsen=True)
    return polish(patch, shape.project, passes=10, coarsen=True)


def border_curves(piece: Patch, length: float) -> list[NDArray[np.int64]]:
    """The open borders as lists of vertices in order, cut at their corners; a smooth loop ends where it begins.

    Args:
        piece: A manifold mesh.
        length: Over which a border must turn by CORNER_ANGLE to have a corner [m].
    """
    half = piece.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    key = half.min(1) * len(piece.vertices) + half.max(1)
    _, index, count = np.unique(key, return_index=True, return_counts=True)
    after = dict(half[np.sort(index[count == 1])].tolist())
    curves = []
    while after:
        loop = [min(after)]
        while loop[-1] in after:
            loop.append(after.pop(loop[-1]))
        curves += _cut_at_corners(np.array(loop), piece.vertices, length)
    return curves


def _cut_at_corners(loop: NDArray[np.int64], vertices: FloatArray, length: float) -> list[NDArray[np.int64]]:
    """A closed loop of vertices, the first one again at its end, as curves between corners."""
    points = vertices[loop]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])

    def at(s: FloatArray) -> FloatArray:
        return np.stack([np.interp(s % along[-1], along, column) for column in points.T], 1)

    here, reach = along[:-1], min(0.5 * length, along[-1] / 6.0)
    back, ahead = points[:-1] - at(here - reach), at(here + reach) - points[:-1]
    turn = np.arctan2(np.linalg.norm(np.cross(back, ahead), axis=1), (back * ahead).sum(1))
    # The sharpest place of each bend: within reach along the border none turns more.
    apart = np.abs(here[:, None] - here)
    apart = np.minimum(apart, along[-1] - apart)
    sharpest = np.array([turn[near].max() for near in apart <= reach]) <= turn
    corners = np.flatnonzero(sharpest & (turn > CORNER_ANGLE))
    if not len(corners):
        return [loop]
    if len(corners) == 1:
        # A curve needs two ends: the place opposite to the only corner.
        corners = np.sort([corners[0], np.abs((here - here[corners[0]]) % along[-1] - 0.5 * along[-1]).argmin()])
    turned = np.roll(loop[:-1], -corners[0])
    places = np.append(corners - corners[0], len(turned))
    turned = np.append(turned, turned[0])
    return [turned[a : b + 1] for a, b in itertools.pairwise(places)]


class _Shape:
    """The surface and the border curves that a piece's coarse vertices keep to."""

    def __init__(self, piece: Patch, curves: list[NDArray[np.int64]], reach: float):
        self._vertices = piece.vertices
        self._triangles = piece.triangles
        self._surface = FacingSurface(piece.vertices, piece.triangles.astype(np.int32))
        self._reach = reach
        self._curves: dict[int, list[FloatArray]] = {}
        for number, curve in enumerate(curves):
            ends = np.stack([piece.vertices[curve[:-1]], piece.vertices[curve[1:]]], 1)
            self._curves.setdefault(number % BITS, []).append(ends)

    def project(self, points: FloatArray, normals: FloatArray, borders: NDArray[np.int64]) -> FloatArray:
        """Closest points of the surface that face as the vertices do, for border vertices of their own curves."""
        face, weights = self._surface.closest(points, normals, self._reach)
        projected = np.einsum("pc,pcd->pd", weights, self._vertices[self._triangles[face]])
        is_corner = (borders & (borders - 1)) != 0
        for bit, curves in self._curves.items():
            on = (borders == 1 << bit) & ~is_corner
            projected[on] = _closest_on_segments(points[on], np.concatenate(curves))
        projected[is_corner] = points[is_corner]
        return projected


def _closest_on_segments(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Closest points on segments, shape [segment_count, 2, 3]."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    t = ((points[:, None] - start) * along).sum(2) / (along**2).sum(1)
    found = start + np.clip(t, 0.0, 1.0)[..., None] * along
    nearest = ((found - points[:, None]) ** 2).sum(2).argmin(1)
    return found[np.arange(len(points)), nearest]
