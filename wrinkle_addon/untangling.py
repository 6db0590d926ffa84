"""Recovery from tangles: layers of a garment that have passed through each other are drawn apart again.

Two surfaces that pass through each other meet in a contour. Moving each place where an edge pierces a triangle so that
the contour becomes shorter makes it shrink and vanish, with no need to know which side was right (Volino and
Magnenat-Thalmann 2006, Resolving surface collisions through intersection contour minimization). Each place is moved
by its own pull and, as much again, by that of its whole contour: a long contour has next to none between its ends.
It works on closed contours and on those that end at a border; one that is as short as it can be, straight from border
to border, stays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .cloth_model import FloatArray, IntArray
from .surface import BodyVolume, SurfaceMeasures

MAX_PASSES = 100
# In a time step; what takes longer goes on coming apart in the next one.
STEP_PASSES = 25
# A tangle that has not got smaller for so many passes will not come apart.
PATIENCE = 25
# Edges flatter than this against the triangle they pierce count as no flatter: their places would run far.
LEAST_SINE = 0.05
# A place that is pulled at by less than about this moves by less than the full step; one contour's end pulls by 1.
SOFT_PULL = 0.1


def untangle_worlds(
    positions: FloatArray,
    surface: SurfaceMeasures,
    step: float,
    bodies: NDArray[np.float32],
    body_faces: IntArray,
    max_passes: int = MAX_PASSES,
) -> tuple[FloatArray, IntArray]:
    """:func:`untangle` for every world, [world_count, vertex_count, 3], on bodies [world_count, body_vertex_count, 3].

    Returns the positions, and how many edges pierced triangles in each world before, shape [world_count].
    """
    positions, found = positions.copy(), np.zeros(len(positions), np.int32)
    for world, garment in enumerate(positions):
        if len(surface.self_crossings(garment)[0]):
            positions[world], pierced = untangle(
                garment, surface, step, BodyVolume(bodies[world], body_faces), max_passes
            )
            found[world] = pierced[0]
    return positions, found


def untangle(
    positions: FloatArray,
    surface: SurfaceMeasures,
    step: float,
    body: BodyVolume | None = None,
    max_passes: int = MAX_PASSES,
) -> tuple[FloatArray, IntArray]:
    """Draw layers apart that pass through each other.

    Args:
        positions: The garment [m], shape [vertex_count, 3].
        surface: Its topology.
        step: How far a vertex moves in one pass at most [m].
        body: What the garment is worn on; where it cuts into itself, so must the garment, and is left alone.
        max_passes: Bound on the passes.

    Returns:
        The positions with the fewest meetings of edges and triangles on the way, and how many there were before each
        pass; the last is 0 if all came apart.
    """
    best = positions = positions.copy()
    pierced: list[int] = []
    while True:
        edges, faces = surface.self_crossings(positions)
        if body is not None and len(edges):
            overlap = body.overlap(positions[surface.faces[faces]].mean(1))
            edges, faces = edges[~overlap], faces[~overlap]
        if not pierced or len(edges) < min(pierced):
            best = positions
        pierced.append(len(edges))
        stuck = len(pierced) - int(np.argmin(pierced)) > PATIENCE
        if not len(edges) or stuck or len(pierced) > max_passes:
            return best, np.array(pierced, np.int32)
        positions = positions + _pass(positions, surface, edges, faces, step)


def _pass(positions: FloatArray, surface: SurfaceMeasures, edges: IntArray, faces: IntArray, step: float) -> FloatArray:
    """Move of every vertex that shortens the contour [m], shape [vertex_count, 3]."""
    vertices = np.concatenate([surface.edges[edges], surface.faces[faces]], 1)
    weights, pull = _pull(positions, surface, edges, vertices)
    label, side = _contours(surface, edges, faces)
    whole = np.zeros((label.max() + 1, 3))
    np.add.at(whole, label, side[:, None] * pull)
    wanted = step * (_softened(pull) + side[:, None] * _softened(whole)[label])
    # The least moves of the five vertices that move edge and triangle apart by as much as is wanted.
    share = weights / (weights**2).sum(1, keepdims=True)
    moves = np.zeros_like(positions)
    np.add.at(moves, vertices, share[:, :, None] * wanted[:, None, :])
    length = np.linalg.norm(moves, axis=1, keepdims=True)
    return moves * np.minimum(1.0, step / np.maximum(length, 1e-12))


def _softened(pull: FloatArray) -> FloatArray:
    return pull / np.sqrt((pull**2).sum(1, keepdims=True) + SOFT_PULL**2)


def _contours(surface: SurfaceMeasures, edges: IntArray, faces: IntArray) -> tuple[IntArray, FloatArray]:
    """The contour that each meeting of an edge and a triangle lies on, shape [count], and 1 or -1 as the edge belongs
    to the contour's one surface or to the other.

    Meetings are neighbours on a contour when they lie between the same two triangles.
    """
    between: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for meeting, (edge, face) in enumerate(zip(edges.tolist(), faces.tolist(), strict=True)):
        for beside in surface.triangles_of_edges[edge].tolist():
            if beside >= 0:
                between.setdefault((min(beside, face), max(beside, face)), []).append((meeting, beside))
    neighbours: list[list[tuple[int, float]]] = [[] for _ in edges]
    for meetings in between.values():
        for first, one in meetings:
            for second, other in meetings:
                if first != second:
                    neighbours[first].append((second, 1.0 if one == other else -1.0))
    label, side = np.full(len(edges), -1, np.int32), np.ones(len(edges))
    for start in range(len(edges)):
        if label[start] < 0:
            label[start] = label.max() + 1
            reached = [start]
            while reached:
                here = reached.pop()
                for there, turn in neighbours[here]:
                    if label[there] < 0:
                        label[there], side[there] = label[here], turn * side[here]
                        reached.append(there)
    return label, side


def _pull(
    positions: FloatArray, surface: SurfaceMeasures, edges: IntArray, vertices: IntArray
) -> tuple[NDArray[np.float64], FloatArray]:
    """Signed weights of an edge's two vertices and its pierced triangle's three in their meeting place, shape
    [count, 5], and minus the derivative of the contour's length by the edge's move against the triangle, [count, 3].
    """
    p, q, a, b, c = (positions[vertices[:, k]] for k in range(5))
    normal = np.cross(b - a, c - a)
    area = np.maximum(np.linalg.norm(normal, axis=1), 1e-20)
    normal /= area[:, None]
    # By the distances of both ends from the plane, one of which may be zero; never both but by rounding.
    before, beyond = np.abs(_dot(p - a, normal)), np.abs(_dot(q - a, normal))
    along = before / np.maximum(before + beyond, 1e-20)
    place = p + along[:, None] * (q - p)
    of_a = np.clip(_dot(np.cross(c - b, place - b), normal) / area, 0.0, 1.0)
    of_b = np.clip(_dot(np.cross(a - c, place - c), normal) / area, 0.0, 1.0 - of_a)
    weights = np.stack([1.0 - along, along, -of_a, -of_b, of_a + of_b - 1.0], 1)
    direction = (q - p) / np.linalg.norm(q - p, axis=1, keepdims=True)
    rise = _dot(direction, normal)
    rise = np.copysign(np.maximum(np.abs(rise), LEAST_SINE), rise)
    pull = np.zeros_like(p)
    for triangle in surface.triangles_of_edges[edges].T:
        beside = triangle >= 0
        opposite = np.where(beside, surface.faces[triangle].sum(1) - vertices[:, :2].sum(1), vertices[:, 0])
        inner = positions[opposite] - p
        inner -= _dot(inner, direction)[:, None] * direction
        # The contour runs along both planes, from the edge into the triangle beside it.
        contour = np.cross(normal, np.cross(q - p, positions[opposite] - p))
        contour *= np.sign(_dot(contour, inner))[:, None]
        contour /= np.maximum(np.linalg.norm(contour, axis=1), 1e-20)[:, None]
        # The meeting place stays on the triangle's plane: it slides along the edge as the edge moves.
        shorter = contour - (_dot(contour, direction) / rise)[:, None] * normal
        pull += np.where(beside[:, None], shorter, 0.0)
    return weights, pull


def _dot(a: FloatArray, b: FloatArray) -> NDArray[np.float64]:
    return (a * b).sum(1)
