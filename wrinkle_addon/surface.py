"""Measures of a garment's surface: curvature, self-intersections, depth inside the body."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.curvature import mean_curvature
from ..kernels.intersections import mark_cut_triangles
from .cloth_model import FloatArray, IntArray, group, mesh_edges
from .garment import bind_to_surface


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
        """Triangles that an edge of the same mesh passes through, ascending."""
        return self._cut(positions, positions, self.faces, same=True)[0]

    def body_intersections(self, positions: FloatArray, body: FloatArray, body_faces: IntArray) -> int:
        """Number of this mesh's edges that pass through a triangle of the body."""
        return len(self._cut(positions, body, body_faces, same=False)[1])

    def _cut(
        self, positions: FloatArray, other: FloatArray, other_faces: IntArray, *, same: bool
    ) -> tuple[IntArray, IntArray]:
        """Triangles of the other mesh that are cut, and edges of this one that cut."""
        other_points = _points(other)
        faces = wp.array(np.ascontiguousarray(other_faces, np.int32), dtype=wp.int32, device="cpu")
        mesh = wp.Mesh(points=other_points, indices=faces.flatten())
        edges = wp.array(self.edges, dtype=wp.int32, device="cpu")
        cut = wp.zeros(len(other_faces), dtype=wp.int32, device="cpu")
        cutting = wp.zeros(len(self.edges), dtype=wp.int32, device="cpu")
        wp.launch(
            mark_cut_triangles,
            dim=len(self.edges),
            inputs=[_points(positions), edges, mesh.id, other_points, faces, same],
            outputs=[cut, cutting],
            device="cpu",
        )
        return np.flatnonzero(cut.numpy()).astype(np.int32), np.flatnonzero(cutting.numpy()).astype(np.int32)


def depth_inside(positions: FloatArray, body: FloatArray, body_faces: IntArray) -> NDArray[np.float32]:
    """How deep each vertex lies inside a closed body [m], 0 outside, shape [vertex_count]."""
    return np.maximum(-bind_to_surface(positions, body, body_faces).distance, 0.0)


def _points(positions: FloatArray) -> wp.array:
    return wp.array(np.ascontiguousarray(positions, np.float32), dtype=wp.vec3, device="cpu")
