"""Host side of the Verlet lists: remembers what the garment may come to touch of itself, and where to look again."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.cloth import verlet_lists as kernels
from .cloth_model import ClothModel
from .topology import mesh_edges

# Rows hold what is within reach and this many reaches more: longer rows last longer, but take longer to renew and read.
MARGIN_REACHES = 0.5
# Elements that a leaf of a tree holds: each search finds a dozen.
LEAF = 8
# Of the margin, what float32 may lose [m] at lengths up to 10 m.
ROUNDING = 1.0e-5


class VerletLists:
    """Candidates for self-contact in every world: triangles of each vertex, later edges of each edge.

    Attributes:
        points: The garment [m] at the last :meth:`update`, float32, shape [world_count, vertex_count].
        edges: Every edge of the garment once, shape [edge_count, 2].
        start, count, candidates: Row ``owner`` holds candidates[start[owner] : start[owner] + count[owner]], ascending.
            Owners are world * vertex_count + vertex, and after those of all worlds world * edge_count + edge.
    """

    def __init__(self, model: ClothModel, faces: wp.array, world_count: int, reach: float, rest_reach: float):
        """``reach``: within which everything is found [m]; ``rest_reach``: within which neighbours at rest are not."""
        self._device = faces.device
        self._margin = MARGIN_REACHES * reach
        self._reaches = [reach + self._margin, rest_reach]
        edges, _ = mesh_edges(model.faces)
        self._faces = faces
        self.edges = wp.array(edges, dtype=wp.int32, device=self._device)
        rest = np.ascontiguousarray(model.rest_positions[None].astype(np.float32))
        self._rest_points = wp.array(rest, dtype=wp.vec3, device=self._device)
        self._make_trees(np.repeat(rest, world_count, 0))
        self.points = self._zeros(self._listed.shape, wp.vec3)
        self._moved = self._zeros(self.points.shape, wp.int32)
        owners = self.points.size + self._lower.size
        self.count, self._room, self._renewed = (self._zeros(owners, wp.int32) for _ in range(3))
        self.start, self.candidates = self._zeros(owners + 1, wp.int32), self._zeros(0, wp.int32)
        self._lacking = self._zeros(1, wp.int32)

    def update(self, positions: wp.array) -> None:
        """Put the garment here (float64 [m]) and renew the rows around the vertices that have moved too far for them.

        Whatever comes within reach has moved by less than half the margin on both sides from its listed points, where
        it was within reach and margin. So what is found through the rows does not depend on their age.
        """
        shape = self.points.shape
        limit = 0.5 * self._margin - ROUNDING
        self._launch(kernels.move_points, shape, [positions, limit], [self.points, self._listed, self._moved])
        self._bound_edges()
        for tree in (*self._triangle_trees, *self._edge_trees, *self._vertex_trees):
            tree.refit()
        self._mark()
        self._list()
        while self._rows_lack_room():
            self._widen_rows()
            self._list()

    def _mark(self) -> None:
        """Mark the rows that what has moved may have got into or left."""
        self._renewed.zero_()
        of_vertices, of_edges = self._by_kind(self._renewed)
        points, reaches = [self._listed, self._rest_points], [*self._reaches, self._moved]
        faces_shape = (len(self._listed), len(self._faces))
        self._launch(
            kernels.mark_vertices, faces_shape, [*points, self._faces, self._vertex_ids, *reaches], [of_vertices]
        )
        self._launch(kernels.mark_edges, of_edges.shape, [*points, self.edges, self._edge_ids, *reaches], [of_edges])

    def _list(self) -> None:
        """Renew the rows that are marked."""
        vertices = self.points.size
        points = [self._listed, self._rest_points]
        of_vertices, of_edges = self._by_kind(self._renewed)
        near = [*points, self._faces, self._triangle_ids, *self._reaches, of_vertices, self.start[: vertices + 1]]
        crossing = [*points, self.edges, self._edge_ids, *self._reaches, of_edges, self.start[vertices:]]
        self._launch(kernels.list_triangles, of_vertices.shape, near, [self.count[:vertices], self.candidates])
        self._launch(kernels.list_edges, of_edges.shape, crossing, [self.count[vertices:], self.candidates])

    def _rows_lack_room(self) -> bool:
        """Whether any row does; marks those that do."""
        self._lacking.zero_()
        found = [self._room, self._renewed, self._lacking]
        self._launch(kernels.find_lacking, len(self.count), [self.start, self.count], found)
        return bool(self._lacking.numpy()[0])

    def _widen_rows(self) -> None:
        old = [wp.clone(self.start), self.candidates]
        wp.utils.array_scan(self._room, self.start[1:], inclusive=True)
        self.candidates = self._zeros(int(self.start[-1:].numpy()[0]), wp.int32)
        now = [self._renewed, self.start, self.count]
        self._launch(kernels.move_rows, len(self.count), [*old, *now], [self.candidates])

    def _by_kind(self, owners: wp.array) -> tuple[wp.array, wp.array]:
        """Views of what is known of all owners: of the vertices and of the edges, each with the worlds first."""
        vertices = self.points.size
        return owners[:vertices].reshape(self.points.shape), owners[vertices:].reshape(self._lower.shape)

    def _make_trees(self, points: NDArray[np.float32]) -> None:
        """Bounding volume trees of each world's triangles, edges and vertices, of which none is listed yet."""
        worlds = range(len(points))
        self._listed = wp.array(points, dtype=wp.vec3, device=self._device)
        indices = wp.array(self._faces.numpy().ravel(), dtype=wp.int32, device=self._device)
        self._lower, self._upper = (self._zeros((len(points), len(self.edges)), wp.vec3) for _ in range(2))
        self._bound_edges()
        self._triangle_trees = [
            wp.Mesh(points=self._listed[world], indices=indices, bvh_leaf_size=LEAF) for world in worlds
        ]
        self._edge_trees = [wp.Bvh(self._lower[world], self._upper[world], leaf_size=LEAF) for world in worlds]
        self._vertex_trees = [wp.Bvh(self._listed[world], self._listed[world], leaf_size=LEAF) for world in worlds]
        self._triangle_ids, self._edge_ids, self._vertex_ids = (
            wp.array([tree.id for tree in trees], dtype=wp.uint64, device=self._device)
            for trees in (self._triangle_trees, self._edge_trees, self._vertex_trees)
        )
        self._listed.fill_(wp.vec3(np.nan))

    def _bound_edges(self) -> None:
        self._launch(kernels.edge_boxes, self._lower.shape, [self._listed, self.edges], [self._lower, self._upper])

    def _zeros(self, shape: tuple[int, ...] | int, dtype: type) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self._device)

    def _launch(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)
