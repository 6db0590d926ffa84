"""Measures of a garment's surface: curvature, self-intersections, depth inside the body; and closest points on it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.curvature import mean_curvature
from ..kernels.intersections import count_crossings, fill_crossings
from ..kernels.surface import closest_facing_points, closest_listed_points, depth_in_body
from .cloth_model import FloatArray, IntArray
from .topology import group, mesh_edges


class SurfaceMeasures:
    """Measures of one mesh topology.

    Args:
        faces: Triangles, shape [triangle_count, 3].
        vertex_count: Number of vertices.
    """

    def __init__(self, faces: IntArray, vertex_count: int):
        self.faces = np.ascontiguousarray(faces, np.int32)
        self._count = vertex_count
        start, corners = group(self.faces.ravel(), vertex_count)
        self._faces = wp.array(self.faces, dtype=wp.int32, device="cpu")
        self._corner_start = wp.array(start, dtype=wp.int32, device="cpu")
        self._corners = wp.array(corners, dtype=wp.int32, device="cpu")
        self._mesh: wp.Mesh | None = None

    @cached_property
    def edges(self) -> IntArray:
        """Every edge once, shape [edge_count, 2]."""
        return mesh_edges(self.faces)[0]

    def mean_curvature(self, positions: FloatArray) -> NDArray[np.float32]:
        """|H| at every vertex [1/m], shape [vertex_count]; on open borders it holds the border's own bend too."""
        curvature = wp.zeros(self._count, dtype=wp.float32, device="cpu")
        wp.launch(
            mean_curvature,
            dim=self._count,
            inputs=[_points(positions), self._faces, self._corner_start, self._corners],
            outputs=[curvature],
            device="cpu",
        )
        return curvature.numpy()

    def self_intersections(self, positions: FloatArray) -> IntArray:
        """Every pair of triangles that pass through each other, once and in order, shape [pair_count, 2].

        Two triangles meet where an edge of one passes through the other. Triangles that share a vertex can meet only
        so that the opposite edge of one passes through the other; those that share an edge count as one surface.
        """
        edge, face = self.self_crossings(positions)
        sides = self.triangles_of_edges[edge]
        pairs = np.stack([sides, np.broadcast_to(face[:, None], sides.shape)], 2).reshape(-1, 2)
        return np.unique(np.sort(pairs[pairs[:, 0] >= 0], axis=1), axis=0)

    def self_crossings(self, positions: FloatArray) -> tuple[IntArray, IntArray]:
        """Edges of the mesh, and the triangles of the same mesh that they pass through, in order."""
        # A tree that is refitted finds the same as a new one, which costs far more.
        if self._mesh is None:
            self._mesh = wp.Mesh(points=_points(positions), indices=self._faces.flatten())
        else:
            self._mesh.points = _points(positions)
        return self._crossings(positions, positions, self._mesh, same=True)

    def body_intersections(self, positions: FloatArray, body: FloatArray, body_faces: IntArray) -> int:
        """Number of this mesh's edges that pass through a triangle of the body."""
        indices = wp.array(np.ascontiguousarray(body_faces, np.int32).ravel(), dtype=wp.int32, device="cpu")
        mesh = wp.Mesh(points=_points(body), indices=indices)
        return len(np.unique(self._crossings(positions, body, mesh, same=False)[0]))

    @cached_property
    def triangles_of_edges(self) -> IntArray:
        """Triangles on both sides of every edge, -1 where there is none, shape [edge_count, most]."""
        edge_of_side = mesh_edges(self.faces)[1]
        start, sides = group(edge_of_side.ravel(), len(self.edges))
        count = np.diff(start)
        triangles = np.full((len(count), count.max()), -1, np.int32)
        for k in range(count.max()):
            has = count > k
            triangles[has, k] = sides[start[:-1][has] + k] // 3
        return triangles

    def _crossings(
        self, positions: FloatArray, other: FloatArray, mesh: wp.Mesh, *, same: bool
    ) -> tuple[IntArray, IntArray]:
        """Edges of this mesh, and the triangles of the other one (``other``: its points) that they pass through."""
        edges = wp.array(self.edges, dtype=wp.int32, device="cpu")
        exact = [
            wp.array(np.ascontiguousarray(p, np.float64), dtype=wp.vec3d, device="cpu") for p in (positions, other)
        ]
        inputs = [exact[0], edges, mesh.id, exact[1], mesh.indices.reshape((-1, 3)), same]
        count = wp.zeros(len(self.edges), dtype=wp.int32, device="cpu")
        wp.launch(count_crossings, dim=len(self.edges), inputs=inputs, outputs=[count], device="cpu")
        counts = count.numpy()
        start = wp.array(np.cumsum(counts) - counts, dtype=wp.int32, device="cpu")
        crossed = wp.zeros(int(counts.sum()), dtype=wp.int32, device="cpu")
        inputs += [start, count]
        wp.launch(fill_crossings, dim=len(self.edges), inputs=inputs, outputs=[crossed], device="cpu")
        edge, face = np.repeat(np.arange(len(counts), dtype=np.int32), counts), crossed.numpy()
        order = np.lexsort((face, edge))
        return edge, face[order]


class BodyVolume:
    """The inside of a posed body, whose triangles face outwards; it may cut into itself and have small holes."""

    def __init__(self, positions: FloatArray, faces: IntArray):
        self._positions = _points(positions)
        self._faces = wp.array(np.ascontiguousarray(faces, np.int32), dtype=wp.int32, device="cpu")
        self._mesh = wp.Mesh(points=self._positions, indices=self._faces.flatten(), support_winding_number=True)

    def depth(self, points: FloatArray, clear: float = 0.001) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """How deep points lie inside the body, and which of these where the body itself leaves no place.

        Args:
            points: Where to look [m], shape [point_count, 3].
            clear: The body leaves no place where it is met again this far above its skin [m].

        Returns:
            Distance to the closest skin [m], 0 outside, and whether the body covers that skin, both [point_count]; the
            latter is only told of points inside.
        """
        return self._look(points, clear, everywhere=False)

    def overlap(self, points: FloatArray, clear: float = 0.001) -> NDArray[np.bool_]:
        """Whether the body covers the skin that is closest to each point, inside or not, as :meth:`depth` tells."""
        return self._look(points, clear, everywhere=True)[1]

    def _look(
        self, points: FloatArray, clear: float, *, everywhere: bool
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        depth = wp.zeros(len(points), dtype=wp.float32, device="cpu")
        covered = wp.zeros(len(points), dtype=wp.int32, device="cpu")
        wp.launch(
            depth_in_body,
            dim=len(points),
            inputs=[_points(points), self._mesh.id, self._faces, self._positions, clear, everywhere],
            outputs=[depth, covered],
            device="cpu",
        )
        return depth.numpy(), covered.numpy().astype(bool)


class FacingSurface:
    """A triangle mesh on which points with normals look for the closest place that faces as they do.

    So a point finds the outside of a sleeve and not its inside, and its own layer of a folded collar.

    Args:
        positions: Vertices [m], shape [vertex_count, 3].
        faces: Triangles, shape [triangle_count, 3].
    """

    def __init__(self, positions: FloatArray, faces: IntArray):
        self._positions = _points(positions)
        self._faces = wp.array(np.ascontiguousarray(faces, np.int32), dtype=wp.int32, device="cpu")
        self._mesh = wp.Mesh(points=self._positions, indices=self._faces.flatten())

    def closest(self, points: FloatArray, normals: FloatArray, reach: float) -> tuple[IntArray, NDArray[np.float32]]:
        """Closest triangle, shape [point_count], and barycentric coordinates on it, shape [point_count, 3].

        If the closest triangle faces away from a point's normal, one that does not is preferred that is at most
        ``reach`` [m] farther.
        """
        inputs = [_points(points), _points(normals), self._mesh.id, self._positions, self._faces, reach]
        return self._found(closest_facing_points, inputs, len(points))

    def closest_among(
        self, points: FloatArray, normals: FloatArray, start: IntArray, candidates: IntArray
    ) -> tuple[IntArray, NDArray[np.float32]]:
        """The same among each point's own candidates, ``candidates[start[i] : start[i + 1]]``, of which it has some."""
        lists = [wp.array(values, dtype=wp.int32, device="cpu") for values in (start, candidates)]
        inputs = [_points(points), _points(normals), self._positions, self._faces, *lists]
        return self._found(closest_listed_points, inputs, len(points))

    def _found(self, kernel: wp.Kernel, inputs: list, count: int) -> tuple[IntArray, NDArray[np.float32]]:
        face = wp.zeros(count, dtype=wp.int32, device="cpu")
        weights = wp.zeros(count, dtype=wp.vec3, device="cpu")
        wp.launch(kernel, dim=count, inputs=inputs, outputs=[face, weights], device="cpu")
        return face.numpy(), weights.numpy()


def _points(positions: FloatArray) -> wp.array:
    return wp.array(np.ascontiguousarray(positions, np.float32), dtype=wp.vec3, device="cpu")
