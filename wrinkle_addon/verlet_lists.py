"""Host side of the Verlet lists: remembers what the garment may come to touch of itself, and when to look again."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ..kernels.cloth import verlet_lists as kernels
from .cloth_model import ClothModel

# Lists hold what is within reach and this many reaches more: wider ones last longer, but take longer to go through.
MARGIN_REACHES = 1.0
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

    def __init__(
        self, model: ClothModel, faces: wp.array, edges: wp.array, world_count: int, reach: float, rest_reach: float
    ):
        """``reach``: within which everything is found [m]; ``rest_reach``: within which neighbours at rest are not."""
        self._device = faces.device
        self._faces, self.edges = faces, edges
        self._margin = MARGIN_REACHES * reach
        self._reaches = [reach + self._margin, rest_reach]
        rest = np.ascontiguousarray(model.rest_positions[None].astype(np.float32))
        self._rest_points = wp.array(rest, dtype=wp.vec3, device=self._device)
        self.points = wp.array(np.repeat(rest, world_count, 0), dtype=wp.vec3, device=self._device)
        self._listed = wp.full(self.points.shape, wp.vec3(np.nan), dtype=wp.vec3, device=self._device)
        self._make_trees(world_count)
        owners = world_count * (model.vertex_count + len(edges))
        self.count, self._room = (wp.zeros(owners, dtype=wp.int32, device=self._device) for _ in range(2))
        self.start = wp.zeros(owners + 1, dtype=wp.int32, device=self._device)
        self.candidates = wp.zeros(0, dtype=wp.int32, device=self._device)
        self._flag = wp.zeros(1, dtype=wp.int32, device=self._device)

    def update(self, positions: wp.array) -> None:
        """Put the garment here (float64 [m]); the lists are made anew if any vertex has moved too far for them.

        Two that come within reach have each moved by less than half the margin, so they were within reach and margin
        of each other when the lists were made. So what is found through the lists does not depend on their age.
        """
        limit = 0.5 * self._margin - ROUNDING
        moved = [self.points, self._flag]
        self._flag.zero_()
        self._launch(kernels.move_points, self.points.shape, [positions, self._listed, limit], moved)
        if self._flag.numpy()[0]:
            self._refit()
            self._list()
            wp.copy(self._listed, self.points)

    def _refit(self) -> None:
        self._bound_edges()
        for tree in (*self._meshes, *self._edge_trees):
            tree.refit()

    def _list(self) -> None:
        """Fill the rows, and once more where their room was too small."""
        shape = self.points.shape
        vertices = shape[0] * shape[1]
        points = [self.points, self._rest_points]
        near = [*points, self._faces, self._mesh_ids, *self._reaches, self.start[: vertices + 1]]
        crossing = [*points, self.edges, self._tree_ids, *self._reaches, self.start[vertices:]]
        while True:
            self._launch(kernels.list_triangles, shape, near, [self.count[:vertices], self.candidates])
            self._launch(kernels.list_edges, self._lower.shape, crossing, [self.count[vertices:], self.candidates])
            self._flag.zero_()
            self._launch(kernels.widen_rows, len(self.count), [self.start, self.count], [self._room, self._flag])
            if not self._flag.numpy()[0]:
                return
            wp.utils.array_scan(self._room, self.start[1:], inclusive=True)
            total = int(self.start[-1:].numpy()[0])
            if total > len(self.candidates):
                self.candidates = wp.zeros(total + total // 2, dtype=wp.int32, device=self._device)

    def _make_trees(self, world_count: int) -> None:
        """Bounding volume trees of each world's triangles and of its edges."""
        indices = wp.array(self._faces.numpy().ravel(), dtype=wp.int32, device=self._device)
        shape = (world_count, len(self.edges))
        self._lower, self._upper = (wp.zeros(shape, dtype=wp.vec3, device=self._device) for _ in range(2))
        self._bound_edges()
        self._meshes = [wp.Mesh(points=self.points[world], indices=indices) for world in range(world_count)]
        self._edge_trees = [wp.Bvh(self._lower[world], self._upper[world]) for world in range(world_count)]
        self._mesh_ids, self._tree_ids = (
            wp.array([tree.id for tree in trees], dtype=wp.uint64, device=self._device)
            for trees in (self._meshes, self._edge_trees)
        )

    def _bound_edges(self) -> None:
        self._launch(kernels.edge_boxes, self._lower.shape, [self.points, self.edges], [self._lower, self._upper])

    def _launch(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)
