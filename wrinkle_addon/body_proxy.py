"""A coarser body for garments to collide with, carried along by the body (Wang et al. 2010, section 3.2; W41, W42).

    proxy = make_body_proxy(body.positions, body.faces)      # about 20,000 triangles, once
    simulation = CoarseSimulation(layers, proxy.faces, proxy.carry(body.positions))
    simulation.step(proxy.carry(positions), ...)             # each frame

The proxy's triangles are even where the body's are not: fine in hands and face, where no garment is. Its corners lie on
the body, so that its faces cut through what bulges and float over what is hollow; :meth:`BodyProxy.gaps` says how far.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ..kernels.cloth import body_surface
from .cloth_model import FloatArray, IntArray
from .coarse_mesh import make_coarse_mesh
from .garment import Body, bind_to_surface

VERTEX_COUNT = 10_000
"""Vertices of a proxy where nothing else is asked for; the paper's has 11,000 and 20,000 triangles (W42)."""


@dataclass(frozen=True, eq=False)
class BodyProxy:
    """A coarser mesh on a body.

    Attributes:
        faces: Triangles, facing as the body's, shape [proxy_triangle_count, 3].
        corners: Body vertices that carry each of its vertices, shape [proxy_vertex_count, 3].
        weights: Their shares, which add up to 1, shape [proxy_vertex_count, 3].
    """

    faces: IntArray
    corners: IntArray
    weights: NDArray[np.float32]

    def carry(self, positions: ArrayLike) -> NDArray[np.float32]:
        """The proxy where the body is [m], shape [proxy_vertex_count, 3], from [body_vertex_count, 3]."""
        points = wp.array(np.ascontiguousarray(positions, np.float32), dtype=wp.vec3, device="cpu", copy=False)
        carried = wp.empty(len(self.corners), dtype=wp.vec3, device="cpu")
        wp.launch(body_surface.carry_points, len(self.corners), [points, *self._bound], [carried], device="cpu")
        return carried.numpy()

    @cached_property
    def _bound(self) -> tuple[wp.array, wp.array]:
        """Corners and weights as kernels read them."""
        corners = wp.array(self.corners.astype(np.int32), dtype=wp.vec3i, device="cpu")
        return corners, wp.array(self.weights.astype(np.float32), dtype=wp.vec3, device="cpu")

    def of_body(self, body: Body) -> Body:
        """The proxy as a body of its own, with the body's skin weights: what tells its limbs apart."""
        weights = np.einsum("pc,pcb->pb", self.weights, body.weights[self.corners])
        return Body(self.carry(body.positions).astype(np.float64), self.faces, weights)

    def gaps(self, positions: FloatArray) -> NDArray[np.float32]:
        """How far each vertex of the body sticks out of the proxy [m], negative under it, shape [body_vertex_count]."""
        return bind_to_surface(positions, self.carry(positions).astype(np.float64), self.faces).distance


def make_body_proxy(positions: FloatArray, faces: IntArray, vertex_count: int = VERTEX_COUNT) -> BodyProxy:
    """A proxy of a body.

    Args:
        positions: The body at rest [m], shape [body_vertex_count, 3].
        faces: Its triangles, outward by their winding, shape [body_triangle_count, 3].
        vertex_count: Wanted number of vertices, less than the body has.

    Raises:
        ValueError: If the body's mesh cannot be coarsened; one sentence that says why.
    """
    positions = np.asarray(positions, np.float64)
    try:
        mesh = make_coarse_mesh("body", positions, faces, vertex_count)
    except ValueError as error:
        raise ValueError(f"No proxy can be made of the body: {error}") from error
    binding = bind_to_surface(mesh.positions, positions, faces)
    return BodyProxy(mesh.faces, faces[binding.faces].astype(np.int32), binding.weights)
