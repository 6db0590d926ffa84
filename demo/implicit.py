"""Surfaces as functions on a grid: signed distances, rolling-ball closing, smooth unions and level sets.

A garment is designed as a function of space, negative inside, because there cloth spans hollows, limbs join the trunk
and offsets grow without ever folding a surface over itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Kuhn's six tetrahedra of a cube; corner c sits at (c & 1, c >> 1 & 1, c >> 2 & 1).
_TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])


@dataclass(frozen=True, eq=False)
class Grid:
    """A regular grid of points.

    Attributes:
        origin: The first point [m], shape [3].
        spacing: Distance of neighbouring points [m].
        shape: Number of points along each axis.
    """

    origin: FloatArray
    spacing: float
    shape: tuple[int, int, int]

    @staticmethod
    def around(low: ArrayLike, high: ArrayLike, spacing: float) -> Grid:
        """The grid that covers a box and, as every coordinate is a multiple of the spacing, mirrors in x = 0."""
        first = np.floor(np.asarray(low, np.float64) / spacing).astype(int)
        last = np.ceil(np.asarray(high, np.float64) / spacing).astype(int)
        nx, ny, nz = (int(n) for n in last - first + 1)
        return Grid(first * spacing, spacing, (nx, ny, nz))

    def points(self) -> FloatArray:
        """All points [m], shape [nx, ny, nz, 3]."""
        return self.origin + self.spacing * np.moveaxis(np.indices(self.shape), 0, -1)


@dataclass(frozen=True, eq=False)
class Field:
    """A function of space, given on a grid and interpolated by cubic B-splines (smooth to the second derivative).

    Attributes:
        grid: The grid.
        values: The function there, shape ``grid.shape``.
    """

    grid: Grid
    values: FloatArray

    def sample(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value, shape [n], and gradient, shape [n, 3], at points of shape [n, 3]; the border is extended."""
        place = (points - self.grid.origin) / self.grid.spacing
        place = np.clip(place, 0.0, np.array(self.grid.shape) - 1.0)
        cell = np.floor(place).astype(int)
        t = place - cell
        weights = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, 3 * (t + t**2 - t**3) + 1, t**3], -1) / 6
        slopes = np.stack([-((1 - t) ** 2), 3 * t**2 - 4 * t, 1 + 2 * t - 3 * t**2, t**2], -1) / 2
        taps = np.clip(cell[..., None] + np.arange(-1, 3), 0, np.array(self.grid.shape)[:, None] - 1)
        i, j, k = taps[:, 0, :, None, None], taps[:, 1, None, :, None], taps[:, 2, None, None, :]
        near = self.values[i, j, k]
        along_z = np.einsum("nijk,nk->nij", near, weights[:, 2])
        along_yz = np.einsum("nij,nj->ni", along_z, weights[:, 1])
        gradient = np.stack(
            [
                np.einsum("ni,ni->n", along_yz, slopes[:, 0]),
                np.einsum("nij,ni,nj->n", along_z, weights[:, 0], slopes[:, 1]),
                np.einsum("nijk,ni,nj,nk->n", near, weights[:, 0], weights[:, 1], slopes[:, 2], optimize=True),
            ],
            -1,
        )
        return np.einsum("ni,ni->n", along_yz, weights[:, 0]), gradient / self.grid.spacing

    def mirrored(self) -> Field:
        """The function of the point mirrored in x = 0; the grid must reach equally far to both sides."""
        return Field(self.grid, self.values[::-1])

    def left_half(self) -> Field:
        """The function where x >= 0; the grid must have points there."""
        middle = round(-self.grid.origin[0] / self.grid.spacing)
        nx, ny, nz = self.grid.shape
        return Field(Grid(self.grid.origin * [0, 1, 1], self.grid.spacing, (nx - middle, ny, nz)), self.values[middle:])

    def blurred(self, radius: float) -> Field:
        """Convolved with a Gaussian of this standard deviation [m]."""
        reach = int(np.ceil(3.0 * radius / self.grid.spacing))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * self.grid.spacing / radius) ** 2)
        kernel /= kernel.sum()
        values = self.values
        for axis, size in enumerate(self.grid.shape):
            padded = np.pad(values, [(reach, reach) if a == axis else (0, 0) for a in range(3)], "edge")
            values = np.zeros_like(values)
            for i, weight in enumerate(kernel):
                values += weight * padded.take(range(i, i + size), axis)
        return Field(self.grid, values)

    def level_set(self, level: float = 0.0) -> tuple[FloatArray, IntArray]:
        """The surface where the function has this value, by marching tetrahedra: closed but for the grid's border.

        Returns:
            Vertices [m], shape [n, 3], and triangles that face rising values, shape [m, 3].
        """
        values = self.values - level
        values = np.where(values == 0.0, 1e-12, values)
        _, ny, nz = self.grid.shape
        offsets = [(c & 1) * ny * nz + (c >> 1 & 1) * nz + (c >> 2 & 1) for c in range(8)]
        flat = values.reshape(-1)
        starts = np.arange(flat.size).reshape(values.shape)[:-1, :-1, :-1].reshape(-1)
        corners = starts[:, None] + np.array(offsets)
        inside = flat[corners] < 0.0
        corners = corners[inside.any(1) & ~inside.all(1)]
        tetrahedra = corners[:, _TETRAHEDRA].reshape(-1, 4)
        ends = _crossed_edges(tetrahedra, flat)
        keys, index = np.unique(np.sort(ends.reshape(-1, 2), 1), axis=0, return_inverse=True)
        a, b = keys.T
        t = (flat[a] / (flat[a] - flat[b]))[:, None]
        places = np.stack(np.unravel_index(np.arange(flat.size), self.grid.shape), -1)
        vertices = self.grid.origin + self.grid.spacing * ((1.0 - t) * places[a] + t * places[b])
        return vertices, index.reshape(-1, 3)


def _crossed_edges(tetrahedra: NDArray[np.int64], values: FloatArray) -> NDArray[np.int64]:
    """Grid edges on which the corners of the level set's triangles lie, shape [triangle_count, 3, 2]."""
    negative = values[tetrahedra] < 0.0
    count = negative.sum(1)
    found = []
    for inside_count in (1, 2, 3):
        tets, inside = tetrahedra[count == inside_count], negative[count == inside_count]
        # The corner order decides which way triangles face; an even permutation puts the inner corners first.
        order = np.argsort(~inside, axis=1, kind="stable")
        odd = _is_odd(order)
        a, b, c, d = np.take_along_axis(tets, order, 1).T
        if inside_count == 1:
            triangles = [((a, b), (a, c), (a, d))]
        elif inside_count == 2:
            triangles = [((a, c), (a, d), (b, d)), ((a, c), (b, d), (b, c))]
        else:
            triangles = [((a, d), (b, d), (c, d))]
        for corners in triangles:
            edges = np.stack([np.stack(edge, -1) for edge in corners], 1)
            edges[odd] = edges[odd][:, ::-1]
            found.append(edges)
    return np.concatenate(found)


def _is_odd(permutations: NDArray[np.int64]) -> NDArray[np.bool_]:
    swaps = sum(permutations[:, i] > permutations[:, j] for i in range(4) for j in range(i + 1, 4))
    return np.asarray(swaps) % 2 == 1


@wp.kernel(enable_backward=False)
def _signed_distance(mesh: wp.uint64, points: wp.array[wp.vec3], distances: wp.array[wp.float32]):
    i = wp.tid()
    hit = wp.mesh_query_point_sign_winding_number(mesh, points[i], 1.0e6)
    nearest = wp.mesh_eval_position(mesh, hit.face, hit.u, hit.v)
    distances[i] = hit.sign * wp.length(points[i] - nearest)


def signed_distance(vertices: FloatArray, triangles: IntArray, points: FloatArray) -> FloatArray:
    """Distance to a closed surface [m], negative inside, also where the surface passes through itself.

    Args:
        vertices: The surface's vertices, shape [n, 3].
        triangles: Its triangles, facing outwards, shape [m, 3].
        points: Where to measure, shape [..., 3].
    """
    mesh = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
        indices=wp.array(triangles.reshape(-1), dtype=wp.int32, device="cpu"),
        support_winding_number=True,
    )
    queries = wp.array(points.reshape(-1, 3), dtype=wp.vec3, device="cpu")
    distances = wp.empty(len(queries), dtype=wp.float32, device="cpu")
    wp.launch(_signed_distance, dim=len(queries), inputs=[mesh.id, queries, distances], device="cpu")
    return distances.numpy().astype(np.float64).reshape(points.shape[:-1])


def with_holes_filled(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    """The surface with a fan of triangles about the centre of every boundary loop."""
    half_edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    twins = {(int(a), int(b)) for a, b in half_edges}
    following = {b: a for a, b in twins if (b, a) not in twins}
    added_vertices: list[FloatArray] = []
    added_triangles: list[tuple[int, int, int]] = []
    while following:
        loop = [next(iter(following))]
        while (step := following.pop(loop[-1], None)) is not None:
            loop.append(step)
        centre = len(vertices) + len(added_vertices)
        added_vertices.append(vertices[loop].mean(0))
        added_triangles += [(a, b, centre) for a, b in pairwise(loop)]
    if not added_vertices:
        return vertices, triangles
    return np.concatenate([vertices, added_vertices]), np.concatenate([triangles, added_triangles])


def closing(vertices: FloatArray, triangles: IntArray, radius: float, grid: Grid, reach: float) -> Field:
    """Signed distance to the surface left by a ball that rolls over the outside of a form, whose holes are closed.

    Every hollow that the ball cannot enter is spanned, as cloth does: a morphological closing by two offsets, first
    outwards by the radius and then back.

    Args:
        vertices: The form's vertices [m], shape [n, 3].
        triangles: Its triangles, facing outwards, shape [m, 3].
        radius: The ball's radius [m].
        grid: Where the result is wanted.
        reach: Farther than this from the form's bounding box [m], the distance to that box is good enough.
    """
    vertices, triangles = with_holes_filled(vertices, triangles)
    low, high = vertices.min(0), vertices.max(0)
    # The offset surface bends no tighter than the radius, so that a coarse grid describes it.
    coarse = radius / 6.0
    margin = radius + 2.0 * coarse
    wide = Grid.around(low - margin, high + margin, coarse)
    offset = Field(wide, signed_distance(vertices, triangles, wide.points())).level_set(radius)
    points = grid.points()
    values = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=-1)
    near = values < reach
    values[near] = signed_distance(*offset, points[near]) + radius
    return Field(grid, values)


def smooth_union(a: FloatArray, b: FloatArray, blend: float) -> FloatArray:
    """The smaller of two fields' values, rounded where they differ by less than ``blend`` [m]."""
    overlap = np.maximum(blend - np.abs(a - b), 0.0)
    return np.minimum(a, b) - overlap**2 / (4.0 * blend)
