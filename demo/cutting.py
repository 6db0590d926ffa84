"""From a form to a sewn garment: rolling-ball closing, ease, openings, even triangles, mirror symmetry.

See :mod:`.garment` for the patterns that are cut this way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..wrinkle_addon.remesh import Edges, Patch, compact, divided, normals, polish, remesh
from ..wrinkle_addon.topology import connected_parts
from . import implicit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Distance of the cloth from its form [m], as a function of points, shape [..., 3] to [...].
Ease = Callable[[FloatArray], FloatArray]

# Spacing of the grid that holds the garment's surface, and the blur that takes away what the closing left [m].
SPACING = 0.015
BLUR = 0.012
# How far from a form its cloth can matter: ease, fillet and blur together [m].
REACH = 0.08
# The meshed vertex count may differ from the wanted one by this share.
COUNT_TOLERANCE = 0.02
# No edge may be shorter than this share of the usual one.
SHORTEST_EDGE = 0.3


@dataclass(frozen=True, eq=False)
class Form:
    """A piece of the body that cloth wraps as one.

    Attributes:
        vertices: Its surface [m], shape [n, 3]; holes are closed.
        triangles: Facing outwards, shape [m, 3].
        ball: Radius of the ball that rolls over it [m]: tighter hollows are spanned.
        ease: Distance of the cloth from it.
        fillet: How softly its cloth passes into that of the forms before it [m]; unused in the first.
        paired: Whether this is a left limb whose mirror image belongs to the garment too.
    """

    vertices: FloatArray
    triangles: IntArray
    ball: float
    ease: Ease
    fillet: float = 0.0
    paired: bool = False


@dataclass(frozen=True, eq=False)
class PlaneCut:
    """A border of the garment in a plane.

    Attributes:
        forms: Indices of the forms whose cloth it cuts.
        point: A point of the plane [m], shape [3].
        normal: Unit vector towards the side that is cut away, shape [3].
    """

    forms: tuple[int, ...]
    point: FloatArray
    normal: FloatArray

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance beyond the plane [m], shape [..., 3] to [...]."""
        return (points - self.point) @ self.normal

    def onto(self, points: FloatArray) -> FloatArray:
        """The nearest points of the plane, shape [n, 3]."""
        return points - self.distance(points)[:, None] * self.normal


@dataclass(frozen=True, eq=False)
class BallCut:
    """A border of the garment on a ball, whose inside is cut away; see :class:`PlaneCut`."""

    forms: tuple[int, ...]
    centre: FloatArray
    radius: float

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance inside the ball [m], shape [..., 3] to [...]."""
        return self.radius - np.linalg.norm(points - self.centre, axis=-1)

    def onto(self, points: FloatArray) -> FloatArray:
        """The nearest points of the ball's surface, shape [n, 3]."""
        offset = points - self.centre
        return self.centre + offset * (self.radius / np.linalg.norm(offset, axis=1, keepdims=True))


Opening = PlaneCut | BallCut


@dataclass(frozen=True, eq=False)
class Surface:
    """The whole garment's surface as a function, negative inside, and that of each form alone."""

    whole: implicit.Field
    forms: tuple[implicit.Field, ...]


def cut(forms: Sequence[Form], openings: Sequence[Opening], vertex_count: int) -> tuple[FloatArray, IntArray, IntArray]:
    """Make a garment over forms that are symmetric in x = 0.

    Args:
        forms: The body parts it covers.
        openings: Where it ends.
        vertex_count: Wanted number of vertices, met within COUNT_TOLERANCE.

    Returns:
        Vertices [m], shape [n, 3], triangles facing outwards, shape [m, 3], and each vertex's mirror image, shape [n].
    """
    surface = drape(forms)
    half = mesh_evenly(open_half(surface, openings), surface, openings, vertex_count)
    return mirrored(half)


def drape(forms: Sequence[Form]) -> Surface:
    """Close every form's hollows, move the cloth off by its ease, and join all."""
    corners = np.concatenate([form.vertices for form in forms])
    low, high = corners.min(0) - REACH, corners.max(0) + REACH
    width = max(high[0], -low[0])
    grid = implicit.Grid.around([-width, *low[1:]], [width, *high[1:]], SPACING)
    points = grid.points()
    fields = []
    for form in forms:
        closed = implicit.closing(form.vertices, form.triangles, form.ball, grid, REACH)
        fields.append(implicit.Field(grid, closed.values - form.ease(points)))
    whole = fields[0].values
    for form, field in zip(forms[1:], fields[1:], strict=True):
        whole = implicit.smooth_union(whole, field.values, form.fillet)
        if form.paired:
            whole = implicit.smooth_union(whole, field.mirrored().values, form.fillet)
    return Surface(implicit.Field(grid, whole).blurred(BLUR), tuple(fields))


def open_half(surface: Surface, openings: Sequence[Opening]) -> Patch:
    """The left half of the surface without what lies beyond the openings.

    Bit 0 of its borders is the middle plane x = 0, bit i + 1 is opening i.
    """
    vertices, triangles = surface.whole.left_half().level_set()
    patch = Patch(vertices, triangles, np.zeros(len(vertices), np.int64))
    for opening in openings:
        distance = opening.distance(patch.vertices)
        form = np.argmin([field.sample(patch.vertices)[0] for field in surface.forms], 0)
        patch = clip(patch, np.where(np.isin(form, opening.forms), distance, -1.0))
    patch = largest_piece(patch)
    edges = Edges.of(patch.triangles)
    ends = edges.ends[edges.is_border]
    curves = [patch.vertices[:, 0], *(opening.distance(patch.vertices) for opening in openings)]
    nearest = np.argmin([np.abs(curve)[ends].max(1) for curve in curves], 0)
    borders = np.zeros(len(patch.vertices), np.int64)
    for end in ends.T:
        np.bitwise_or.at(borders, end, 1 << nearest)
    return Patch(patch.vertices, patch.triangles, borders)


def clip(patch: Patch, beyond: FloatArray) -> Patch:
    """Without what lies where a value given at the vertices is positive; crossed triangles are divided there."""
    # Cuts that all but hit a vertex go through it, or needles would be left.
    beyond = np.where(np.abs(beyond) < 1e-6, 0.0, beyond)
    edges = Edges.of(patch.triangles)
    crossed = np.sign(beyond)[edges.ends].prod(1) < 0.0
    a, b = edges.ends[crossed].T
    t = (beyond[a] / (beyond[a] - beyond[b]))[:, None]
    added = np.full(len(edges.ends), -1)
    added[crossed] = len(patch.vertices) + np.arange(len(a))
    vertices = np.concatenate([patch.vertices, (1.0 - t) * patch.vertices[a] + t * patch.vertices[b]])
    beyond = np.append(beyond, np.zeros(len(a)))
    triangles = divided(patch.triangles, added[edges.of_triangle])
    triangles = triangles[beyond[triangles].max(1) <= 0.0]
    return compact(Patch(vertices, triangles, np.zeros(len(vertices), np.int64)))


def largest_piece(patch: Patch) -> Patch:
    """The connected piece with the most triangles."""
    label = connected_parts(Edges.of(patch.triangles).ends, len(patch.vertices))
    piece = label[patch.triangles[:, 0]]
    return compact(Patch(patch.vertices, patch.triangles[piece == np.bincount(piece).argmax()], patch.borders))


def mesh_evenly(half: Patch, surface: Surface, openings: Sequence[Opening], vertex_count: int) -> Patch:
    """Even triangles on the half garment, so many that the whole one has the wanted count.

    Raises:
        ValueError: If that fails, as it does where triangles would be as large as the garment's details, or where an
            opening only grazes the surface.
    """

    def project(points: FloatArray, _normals: FloatArray, borders: IntArray) -> FloatArray:
        points = points.copy()
        for _ in range(3):
            value, gradient = surface.whole.sample(points)
            points -= (value / (gradient**2).sum(1))[:, None] * gradient
            for bit, opening in enumerate(openings, 1):
                on = (borders >> bit & 1) == 1
                points[on] = opening.onto(points[on])
            points[(borders & 1) == 1, 0] = 0.0
        return points

    area = np.linalg.norm(normals(half.vertices, half.triangles), axis=1).sum()
    # A vertex owns two triangles of side s, together s^2 sqrt(3) / 2.
    length = np.sqrt(2.0 * area / (np.sqrt(3.0) * vertex_count))
    for passes in (8, 3, 3, 3, 3):
        half = remesh(half, length, project, passes)
        count = 2 * len(half.vertices) - np.count_nonzero(half.borders & 1)
        if abs(count / vertex_count - 1.0) < COUNT_TOLERANCE:
            half = polish(half, project, passes=20)
            if Edges.of(half.triangles).lengths(half.vertices).min() > SHORTEST_EDGE * length:
                return half
        length *= np.sqrt(count / vertex_count)
    raise ValueError(
        f"The garment could not be meshed evenly with {vertex_count} vertices; ask for more, or for a body of a more "
        "usual build."
    )


def mirrored(half: Patch) -> tuple[FloatArray, IntArray, IntArray]:
    """Both halves sewn along x = 0: vertices, triangles and each vertex's mirror image."""
    off_middle = np.flatnonzero((half.borders & 1) == 0)
    twin = np.arange(len(half.vertices))
    twin[off_middle] = len(half.vertices) + np.arange(len(off_middle))
    vertices = np.concatenate([half.vertices, half.vertices[off_middle] * [-1.0, 1.0, 1.0]])
    triangles = np.concatenate([half.triangles, twin[half.triangles][:, ::-1]])
    return vertices, triangles, np.append(twin, off_middle)
