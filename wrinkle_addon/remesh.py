"""Even triangles on a smooth surface with sharp borders: isotropic remeshing (Botsch & Kobbelt 2004, section 4).

Edges are split, collapsed and flipped and vertices slid along the surface until all edges have about one length and
nearly all vertices six neighbours. Every pass works on whole arrays: of all edges that want a change, those are
changed together whose surroundings do not touch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Puts vertices with the given unit normals and borders (bit masks) on the surface and on their border curves.
Projection = Callable[[FloatArray, FloatArray, IntArray], FloatArray]

# Where an edge is split or collapsed, as multiples of the wanted length (Botsch & Kobbelt).
SPLIT_ABOVE, COLLAPSE_BELOW = 4.0 / 3.0, 4.0 / 5.0
# Cosine between a triangle's normals before and after a change, below which the change is refused.
NORMAL_AGREEMENT = 0.5
COLLAPSE_ROUNDS = 4
# Share of the way to the middle of its neighbours that a vertex goes at once; below 1, or the mesh would oscillate.
DAMPING = 0.8
# Pull of a vertex on a plane, where one on a fold has up to 1; and what stands for zero in a divisor.
LEAST_PULL, TINY = 1e-3, 1e-30


@dataclass(frozen=True, eq=False)
class Patch:
    """A triangle mesh whose borders keep to given curves.

    Attributes:
        vertices: Positions [m], shape [n, 3].
        triangles: Facing outwards, shape [m, 3].
        borders: Bit mask of the border curves each vertex lies on, 0 inside; two bits make a corner, shape [n].
    """

    vertices: FloatArray
    triangles: IntArray
    borders: IntArray


@dataclass(frozen=True, eq=False)
class Edges:
    """The edges of a manifold triangle mesh.

    Attributes:
        ends: Vertices with the smaller index first, shape [edge_count, 2].
        triangles: The one or two triangles beside each edge, -1 where there is none, shape [edge_count, 2].
        opposite: The corners of these triangles off the edge, -1 where there is none, shape [edge_count, 2].
        of_triangle: The edges from each corner to the next, shape [triangle_count, 3].
    """

    ends: IntArray
    triangles: IntArray
    opposite: IntArray
    of_triangle: IntArray

    @staticmethod
    def of(triangles: IntArray) -> Edges:
        """Raises ValueError if an edge has more than two triangles."""
        half = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        stride = int(triangles.max()) + 1
        keys = half.min(1) * stride + half.max(1)
        unique_keys, index, count = np.unique(keys, return_inverse=True, return_counts=True)
        if (count > 2).any():
            raise ValueError("An edge of the mesh has more than two triangles.")
        ends = np.stack(np.divmod(unique_keys, stride), 1)
        order = np.argsort(index, kind="stable")
        first = np.concatenate([[0], np.cumsum(count)[:-1]])
        second = np.where(count == 2, first + 1, -1)
        corner = np.roll(triangles, 1, axis=1).reshape(-1)

        def both(values: IntArray) -> IntArray:
            ordered = values[order]
            return np.stack([ordered[first], np.where(second >= 0, ordered[second], -1)], 1)

        owners = np.arange(len(triangles)).repeat(3)
        return Edges(ends, both(owners), both(corner), index.reshape(-1, 3))

    @property
    def is_border(self) -> BoolArray:
        return self.triangles[:, 1] < 0

    def lengths(self, vertices: FloatArray) -> FloatArray:
        return np.linalg.norm(vertices[self.ends[:, 1]] - vertices[self.ends[:, 0]], axis=1)


def remesh(patch: Patch, length: float, project: Projection, passes: int, coarsen: bool = False) -> Patch:
    """Bring all edges near the wanted length [m], in passes of splitting, collapsing, flipping and sliding.

    Args:
        coarsen: For edges that become as long as the surface's folds are wide: vertices on folds stay there, or layers
            would slip off them pass by pass; and many edges collapse at once.
    """
    for _ in range(passes):
        patch = split_long_edges(patch, SPLIT_ABOVE * length)
        patch = collapse_short_edges(patch, COLLAPSE_BELOW * length, SPLIT_ABOVE * length, coarsen)
        patch = flip_edges(patch, valence_gain)
        patch = slide(patch, project, coarsen)
    return patch


def polish(patch: Patch, project: Projection, passes: int, coarsen: bool = False) -> Patch:
    """Even out a mesh without changing its number of vertices."""
    for _ in range(passes):
        patch = flip_edges(patch, valence_gain)
        patch = slide(patch, project, coarsen)
    patch = flip_edges(patch, angle_gain)
    return slide(patch, project, coarsen)


def normals(vertices: FloatArray, triangles: IntArray) -> FloatArray:
    """Normals of triangles, as long as twice their areas, shape [m, 3]."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def split_long_edges(patch: Patch, longest: float) -> Patch:
    """Halve every edge longer than ``longest`` [m]; a triangle becomes two, three or four."""
    edges = Edges.of(patch.triangles)
    long = edges.lengths(patch.vertices) > longest
    if not long.any():
        return patch
    ends = edges.ends[long]
    middle = np.full(len(long), -1)
    middle[long] = len(patch.vertices) + np.arange(len(ends))
    borders = np.where(edges.is_border[long], patch.borders[ends[:, 0]] & patch.borders[ends[:, 1]], 0)
    vertices = np.concatenate([patch.vertices, patch.vertices[ends].mean(1)])
    return Patch(vertices, divided(patch.triangles, middle[edges.of_triangle]), np.append(patch.borders, borders))


def divided(triangles: IntArray, middles: IntArray) -> IntArray:
    """Triangles divided at points on their edges (vertex indices, -1 where an edge is whole), both of shape [m, 3]."""
    has_point = middles >= 0
    count = has_point.sum(1)
    found = [triangles[count == 0]]
    # Rotate each triangle so that its divided edges come first, and one template a case is enough.
    start = np.where(count == 1, np.argmax(has_point, 1), np.where(count == 2, (np.argmin(has_point, 1) + 1) % 3, 0))
    turn = (start[:, None] + np.arange(3)) % 3
    (a, b, c), (ab, bc, ca) = np.take_along_axis(triangles, turn, 1).T, np.take_along_axis(middles, turn, 1).T
    templates = {
        1: ((a, ab, c), (ab, b, c)),
        2: ((a, ab, c), (ab, bc, c), (ab, b, bc)),
        3: ((a, ab, ca), (ab, b, bc), (bc, c, ca), (ab, bc, ca)),
    }
    for number, pieces in templates.items():
        found += [np.stack(piece, 1)[count == number] for piece in pieces]
    return np.concatenate(found)


def collapse_short_edges(patch: Patch, shortest: float, longest: float, coarsen: bool = False) -> Patch:
    """Merge the ends of every edge shorter than ``shortest`` where that makes no edge longer than ``longest`` [m]."""
    # What is left over after a few rounds goes in the next pass, from better places.
    for _ in range(COLLAPSE_ROUNDS):
        edges = Edges.of(patch.triangles)
        lengths = edges.lengths(patch.vertices)
        kept, place = _collapse_targets(patch, edges, coarsen)
        # Edges of about one length go in the order of their numbers: sorted by length few are shorter than all around.
        cost = np.floor(2.0 * np.log2(lengths)) if coarsen else lengths
        wanted = (lengths < shortest) & (kept >= 0)
        wanted[wanted] = _is_linked_simply(edges, wanted, len(patch.vertices))
        wanted[wanted] = ~_spoils(patch, edges.ends[wanted], place[wanted], longest)
        chosen = wanted & _cheapest_around(edges, cost, wanted, len(patch.vertices))
        if not chosen.any():
            break
        patch = _merge(patch, edges.ends[chosen], kept[chosen], place[chosen])
    return patch


def _collapse_targets(patch: Patch, edges: Edges, coarsen: bool) -> tuple[IntArray, FloatArray]:
    """The end that stays (-1 where an edge must not collapse), shape [n], and where it then lies, shape [n, 3]."""
    a, b = edges.ends.T
    border_a, border_b = patch.borders[a], patch.borders[b]
    along = edges.is_border
    equal = (border_a == border_b) & (along | (border_a == 0))
    # A vertex may only slide into one that lies on all its borders, and along a border only.
    into_b = ~equal & ((border_a & border_b) == border_a) & (along | (border_a == 0))
    into_a = ~equal & ~into_b & ((border_a & border_b) == border_b) & (along | (border_b == 0))
    kept = np.where(equal | into_a, a, np.where(into_b, b, -1))
    middle = patch.vertices[edges.ends].mean(1)
    if coarsen:
        # Nearer to the end that lies on a fold; in the middle where neither does.
        pull = ((1.0 - flatness(patch)) ** 2 + LEAST_PULL)[edges.ends]
        middle = (pull[..., None] * patch.vertices[edges.ends]).sum(1) / pull.sum(1, keepdims=True)
    return kept, np.where(equal[:, None], middle, patch.vertices[kept])


def flatness(patch: Patch) -> FloatArray:
    """How much the triangles around each vertex face one way: 1 on a plane, 0 on a closed fold, shape [n]."""
    faces = normals(patch.vertices, patch.triangles)
    total = _sums(patch.triangles.T.reshape(-1), np.tile(faces, (3, 1)), len(patch.vertices))
    size = np.bincount(patch.triangles.T.reshape(-1), np.tile(np.linalg.norm(faces, axis=1), 3), len(patch.vertices))
    return np.linalg.norm(total, axis=1) / np.maximum(size, TINY)


def _is_linked_simply(edges: Edges, wanted: BoolArray, vertex_count: int) -> BoolArray:
    """Whether wanted edges' ends share no neighbours but the corners opposite to them (the link condition)."""
    a, b = edges.ends[wanted].T
    edge, neighbour = _incident(a, np.concatenate([edges.ends, edges.ends[:, ::-1]]), vertex_count)
    shared = np.bincount(edge[_contains(edges, neighbour, b[edge], vertex_count)], minlength=len(a))
    return shared == np.where(edges.is_border[wanted], 1, 2)


def _incident(vertices: IntArray, pairs: IntArray, vertex_count: int) -> tuple[IntArray, IntArray]:
    """For each vertex asked for, its place in the list and the second of every pair that has it as the first."""
    order = np.argsort(pairs[:, 0], kind="stable")
    degree = np.bincount(pairs[:, 0], minlength=vertex_count)
    first = np.cumsum(degree) - degree
    repeats = degree[vertices]
    owner = np.arange(len(vertices)).repeat(repeats)
    nth = np.arange(len(owner)) - (np.cumsum(repeats) - repeats)[owner]
    return owner, pairs[order[first[vertices][owner] + nth], 1]


def _contains(edges: Edges, a: IntArray, b: IntArray, vertex_count: int) -> BoolArray:
    """Whether the mesh has edges between these vertices."""
    keys = edges.ends[:, 0] * vertex_count + edges.ends[:, 1]
    key = np.minimum(a, b) * vertex_count + np.maximum(a, b)
    return keys[np.minimum(np.searchsorted(keys, key), len(keys) - 1)] == key


def _spoils(patch: Patch, ends: IntArray, place: FloatArray, longest: float) -> BoolArray:
    """Which collapses would turn a triangle over or make an edge too long."""
    spoils = np.zeros(len(ends), bool)
    corners = np.stack([patch.triangles.reshape(-1), np.arange(len(patch.triangles)).repeat(3)], 1)
    for near, far in (ends.T, ends.T[::-1]):
        collapse, triangle = _incident(near, corners, len(patch.vertices))
        triangles = patch.triangles[triangle]
        stays = (triangles != far[collapse, None]).all(1)
        collapse, triangles = collapse[stays], triangles[stays]
        points = patch.vertices[triangles]
        moved = np.where((triangles == near[collapse, None])[..., None], place[collapse, None], points)
        before, after = (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) for p in (points, moved))
        agreement = NORMAL_AGREEMENT * np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        longest_side = np.linalg.norm(moved - np.roll(moved, 1, axis=1), axis=2).max(1)
        spoils[collapse[((before * after).sum(1) < agreement) | (longest_side > longest)]] = True
    return spoils


def _cheapest_around(edges: Edges, cost: FloatArray, wanted: BoolArray, vertex_count: int) -> BoolArray:
    """Edges cheaper than all other wanted ones at their ends and at these ends' neighbours."""
    rank = _ranks(cost)
    best = np.full(vertex_count, len(cost))
    for end in edges.ends[wanted].T:
        np.minimum.at(best, end, rank[wanted])
    around = best.copy()
    np.minimum.at(around, edges.ends[:, 0], best[edges.ends[:, 1]])
    np.minimum.at(around, edges.ends[:, 1], best[edges.ends[:, 0]])
    return rank <= around[edges.ends].min(1)


def _ranks(cost: FloatArray) -> IntArray:
    """Places in ascending order; equal costs get different places, so that of two neighbours one can always go."""
    ranks = np.empty(len(cost), np.int64)
    ranks[np.argsort(cost, kind="stable")] = np.arange(len(cost))
    return ranks


def _merge(patch: Patch, ends: IntArray, kept: IntArray, place: FloatArray) -> Patch:
    target = np.arange(len(patch.vertices))
    target[ends] = kept[:, None]
    vertices = patch.vertices.copy()
    vertices[kept] = place
    triangles = target[patch.triangles]
    a, b, c = triangles.T
    return compact(Patch(vertices, triangles[(a != b) & (b != c) & (c != a)], patch.borders))


def compact(patch: Patch) -> Patch:
    """Without vertices that no triangle uses."""
    used, index = np.unique(patch.triangles, return_inverse=True)
    return Patch(patch.vertices[used], index.reshape(-1, 3), patch.borders[used])


def valence_gain(patch: Patch, edges: Edges) -> FloatArray:
    """How much nearer to six neighbours (four on a border) flipping each edge brings its surroundings, shape [n]."""
    count = np.bincount(edges.ends.reshape(-1), minlength=len(patch.vertices))
    excess = count - np.where(patch.borders > 0, 4, 6)
    a, b = excess[edges.ends].T
    c, d = excess[edges.opposite].T
    before = a**2 + b**2 + c**2 + d**2
    after = (a - 1) ** 2 + (b - 1) ** 2 + (c + 1) ** 2 + (d + 1) ** 2
    return (before - after).astype(np.float64)


def angle_gain(patch: Patch, edges: Edges) -> FloatArray:
    """By how much the angles opposite to each edge exceed a half turn (Delaunay's criterion) [rad], shape [n]."""
    angles = np.zeros(len(edges.ends))
    for corner in edges.opposite.T:
        p, q = (patch.vertices[end] - patch.vertices[corner] for end in edges.ends.T)
        angles += np.arctan2(np.linalg.norm(np.cross(p, q), axis=1), (p * q).sum(1))
    return angles - np.pi - 1e-3


def flip_edges(patch: Patch, gain: Callable[[Patch, Edges], FloatArray]) -> Patch:
    """Turn edges between two triangles to their other diagonal where that gains, the best ones that do not touch."""
    edges = Edges.of(patch.triangles)
    vertex_count = len(patch.vertices)
    gains = np.where(edges.is_border, -1.0, gain(patch, edges))
    exists = _contains(edges, edges.opposite[:, 0], edges.opposite[:, 1], vertex_count)
    wanted = np.flatnonzero((gains > 0.0) & ~exists)
    first, second = edges.triangles[wanted].T
    (a, b), (c, d) = edges.ends[wanted].T, edges.opposite[wanted].T
    # The new triangles keep the winding of the first one, in which the edge may run from a to b or back.
    corners = patch.triangles[first]
    forward = ((corners == a[:, None]) & (np.roll(corners, -1, axis=1) == b[:, None])).any(1)
    start, end = np.where(forward, a, b), np.where(forward, b, a)
    flipped = np.stack([np.stack([c, d, end], 1), np.stack([d, c, start], 1)], 1)
    old = normals(patch.vertices, patch.triangles[first]) + normals(patch.vertices, patch.triangles[second])
    agreement = NORMAL_AGREEMENT * np.linalg.norm(old, axis=1)
    sound = np.ones(len(wanted), bool)
    for side in range(2):
        new = normals(patch.vertices, flipped[:, side])
        sound &= (new * old).sum(1) > agreement * np.linalg.norm(new, axis=1)
    around = np.stack([a, b, c, d], 1)[sound]
    rank = _ranks(-gains[wanted[sound]])
    best = np.full(vertex_count, len(rank))
    for corner in around.T:
        np.minimum.at(best, corner, rank)
    chosen = rank <= best[around].min(1)
    triangles = patch.triangles.copy()
    triangles[edges.triangles[wanted[sound][chosen]]] = flipped[sound][chosen]
    return Patch(patch.vertices, triangles, patch.borders)


def slide(patch: Patch, project: Projection, coarsen: bool = False) -> Patch:
    """Move vertices towards the middle of their neighbours along the surface, border vertices along their border.

    When coarsening, vertices inside move the less the more sharply the surface is bent there.
    """
    edges = Edges.of(patch.triangles)
    on_border = patch.borders > 0
    near, far = np.concatenate([edges.ends, edges.ends[:, ::-1]]).T
    # A border vertex follows its two neighbours along the border, an inner one all of its neighbours.
    pulls = np.tile(edges.is_border, 2) | ~on_border[near]
    total = _sums(near[pulls], patch.vertices[far[pulls]], len(patch.vertices))
    weight = np.bincount(near[pulls], minlength=len(patch.vertices))
    step = total / weight[:, None] - patch.vertices
    faces = normals(patch.vertices, patch.triangles)
    normal = _sums(patch.triangles.T.reshape(-1), np.tile(faces, (3, 1)), len(patch.vertices))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), TINY)
    step -= (step * normal).sum(1, keepdims=True) * normal
    if coarsen:
        step *= np.where(on_border, 1.0, np.maximum(2.0 * flatness(patch) - 1.0, 0.0))[:, None]
    is_corner = (patch.borders & (patch.borders - 1)) != 0
    step[is_corner] = 0.0
    return Patch(project(patch.vertices + DAMPING * step, normal, patch.borders), patch.triangles, patch.borders)


def _sums(index: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sum of the values that go to each index, shape [count, 3]."""
    return np.stack([np.bincount(index, column, count).astype(np.float64) for column in values.T], 1)
