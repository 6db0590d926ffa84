"""Hinges and springs of a garment at rest: what the chosen bending and stretching energies are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .fabrics import Fabric, Pair, both
from .plate_bending import FloatArray
from .topology import IntArray, group, inner_edges, mesh_edges

BlockKeys = NDArray[np.int64]
"""Blocks of the Hessian as row * vertex_count + column."""

LATTICE = 8.0 / 9.0
"""Beams between opposite corners that bend like a plate, as a share of its stiffness times area over length: exact on
equilateral triangles, where each direction has three beams at 60 degrees."""


@dataclass(frozen=True, eq=False)
class Gathering:
    """Where elements of n vertices each add to vertices and to blocks of the Hessian.

    Attributes:
        corner_start, corners: For each vertex its places in elements, element * n + corner.
        block_start, blocks: For each block of the Hessian its places, element * n^2 + row * n + column.
    """

    corner_start: IntArray
    corners: IntArray
    block_start: IntArray
    blocks: IntArray


@dataclass(frozen=True, eq=False)
class HingeRest:
    """Hinges at rest; see :mod:`..kernels.cloth.hinges`.

    Attributes:
        vertices: (edge start, edge end, opposite corners), shape [hinge_count, 4].
        stiffness: [N m], shape [hinge_count].
        rest_angle: [rad], shape [hinge_count].
    """

    vertices: IntArray
    stiffness: FloatArray
    rest_angle: FloatArray


@dataclass(frozen=True, eq=False)
class SpringRest:
    """Springs at rest; see :mod:`..kernels.cloth.springs`.

    Attributes:
        vertices: Both ends, shape [spring_count, 2].
        rest_length: [m], shape [spring_count].
        stiffness: [N/m], shape [spring_count].
        beam: Stiffness of the beam [N m^2], 0 for length springs, shape [spring_count].
        turn: u at which the beam takes over, shape [spring_count].
    """

    vertices: IntArray
    rest_length: FloatArray
    stiffness: FloatArray
    beam: FloatArray
    turn: FloatArray


def make_hinges(positions: FloatArray, faces: IntArray, edges: FloatArray, fabric: Fabric) -> HingeRest:
    """Hinges over all inner edges.

    Args:
        positions: The garment as modelled [m], shape [vertex_count, 3].
        faces: Triangles, shape [triangle_count, 3].
        edges: Rest edge matrices in warp and weft [m], shape [triangle_count, 2, 2].
        fabric: The material.
    """
    vertices, sides = inner_edges(faces)
    along = _sides(edges)[sides]
    square = (along**2).sum(2).mean(1)
    # A hinge bends across its edge: the share of the warp is the edge's share of the weft.
    stiffness = _towards(fabric.bending, (along[..., 1] ** 2).sum(1) / (along**2).sum((1, 2)))
    area = 0.5 * np.linalg.det(edges)[sides // 3].sum(1)
    return HingeRest(vertices, stiffness * square / area, fabric.rest_bend * _angles(positions, vertices))


def make_springs(faces: IntArray, edges: FloatArray, fabric: Fabric) -> SpringRest:
    """Length springs along all edges, then bending springs between opposite corners; arguments as :func:`make_hinges`.

    A length spring is as stiff as makes a sheet of equilateral triangles stretch like its fabric, on any mesh in
    proportion to the area of its triangles (Van Gelder 1998, "Approximate simulation of elastic membranes by
    triangulated spring meshes").
    """
    area = 0.5 * np.linalg.det(edges)
    vertices, edge_of_side = mesh_edges(faces)
    edge = edge_of_side.ravel()
    along = _sides(edges)
    size = np.linalg.norm(along, axis=1)
    count = np.bincount(edge)
    rest = np.bincount(edge, size) / count
    warp = np.bincount(edge, along[:, 0] ** 2 / size**2) / count
    own = np.bincount(edge, np.repeat(area, 3))
    opposite, across, both_areas, warp_across = _opposites(faces, edges, area)
    beam = LATTICE * _towards(fabric.bending, warp_across) * both_areas / across
    rest_length = np.concatenate([rest, across])
    stiffness = _towards(fabric.stretch, np.concatenate([warp, warp_across]))
    stiffness *= np.concatenate([own, both_areas]) / rest_length**2
    beam = np.concatenate([np.zeros(len(rest)), beam])
    return SpringRest(
        np.concatenate([vertices, opposite]).astype(np.int32),
        rest_length,
        stiffness,
        beam,
        _turns(rest_length, stiffness, beam),
    )


def gather(vertices: IntArray, vertex_count: int, blocks: BlockKeys) -> Gathering:
    """Where elements add to vertices and blocks.

    Args:
        vertices: Vertices of each element, shape [element_count, n].
        vertex_count: Of the garment.
        blocks: The Hessian's blocks, ascending.
    """
    places = np.searchsorted(blocks, element_keys(vertices, vertex_count))
    return Gathering(*group(vertices.ravel(), vertex_count), *group(places, len(blocks)))


def element_keys(vertices: IntArray, vertex_count: int) -> BlockKeys:
    """Blocks of every pair of corners, shape [element_count * n * n]."""
    wide = vertices.astype(np.int64)
    return (wide[:, :, None] * vertex_count + wide[:, None, :]).ravel()


def _sides(edges: FloatArray) -> FloatArray:
    """Every triangle's sides in warp and weft [m], from each corner to the next, shape [3 * triangle_count, 2]."""
    first, second = edges[:, :, 0], edges[:, :, 1]
    return np.stack([first, second - first, -second], 1).reshape(-1, 2)


def _opposites(
    faces: IntArray, edges: FloatArray, area: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Opposite corners of neighbouring triangles, their distance when unfolded [m], the area of both triangles [m^2],
    and the share of the warp in their direction."""
    vertices, sides = inner_edges(faces)
    along = _sides(edges)
    size = np.linalg.norm(along, axis=1)
    unit = along / size[:, None]
    # The third corner of the first triangle from the edge's start: the side before it, turned round.
    before = -along.reshape(-1, 3, 2)[:, [2, 0, 1]].reshape(-1, 2)
    ahead = (before * unit).sum(1)
    height = 2.0 * np.repeat(area, 3) / size
    first, second = sides.T
    # The second triangle runs along the edge the other way, and lies on its other side.
    run, rise = ahead[first] - (size[second] - ahead[second]), height[first] + height[second]
    distance = np.hypot(run, rise)
    across = np.stack([-unit[first, 1], unit[first, 0]], 1)
    direction = (run[:, None] * unit[first] + rise[:, None] * across) / distance[:, None]
    return vertices[:, 2:], distance, (area[first // 3] + area[second // 3]), direction[:, 0] ** 2


def _towards(value: Pair, warp_share: FloatArray) -> FloatArray:
    """A stiffness in a direction whose squared cosine with the warp is given, as of an orthotropic plate."""
    warp, weft = np.sqrt(both(value))
    return (warp * warp_share + weft * (1.0 - warp_share)) ** 2


def _angles(positions: FloatArray, hinges: IntArray) -> FloatArray:
    """Angle of every hinge [rad], in the sense of :func:`~.kernels.cloth.hinges.hinge_angle`."""
    x0, x1, x2, x3 = (positions[hinges[:, k]] for k in range(4))
    e = x1 - x0
    first, second = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    sine = (np.cross(first, second) * e).sum(1) / np.linalg.norm(e, axis=1)
    return np.arctan2(sine, (first * second).sum(1))


def _turns(rest: FloatArray, stiffness: FloatArray, beam: FloatArray) -> FloatArray:
    """u where the buckled beam's force meets that of a length spring, pi where it never does, by bisection."""
    low, high = np.full(len(rest), 1e-3), np.full(len(rest), np.pi)
    for _ in range(50):
        u = 0.5 * (low + high)
        sinc = np.sin(u) / u
        stronger = 4.0 * beam * u**2 / (rest**2 * (np.cos(u) - sinc)) < stiffness * rest * (sinc - 1.0)
        low, high = np.where(stronger, u, low), np.where(stronger, high, u)
    return low
