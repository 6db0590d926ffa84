"""The garment as a material body: rest state, masses and the sparsity of its equations, built once.

Built from the garment's rest surface with NumPy; :class:`~.cloth.ClothSimulation` uploads it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TypeVar

import numpy as np

from .elastic_elements import (
    BlockKeys,
    Gathering,
    HingeRest,
    SpringRest,
    element_keys,
    gather,
    make_hinges,
    make_springs,
)
from .fabrics import Fabric
from .plate_bending import FloatArray, bending_matrix
from .topology import IntArray, group, inner_edges, row_starts, rows_of

Rest = TypeVar("Rest", HingeRest, SpringRest)


@dataclass(frozen=True)
class FabricPart:
    """Vertices and triangles of a model that are of one fabric."""

    fabric: Fabric
    vertices: slice
    triangles: slice


@dataclass(frozen=True, eq=False)
class ClothModel:
    """Rest state and sparsity of one garment, or of several that are simulated together.

    Attributes:
        parts: Its fabrics, in the order of the vertices; one garment has one.
        rest_positions: The rest surface [m], shape [vertex_count, 3].
        faces: Triangles, shape [triangle_count, 3].
        rest_inverse: Inverse of the rest edge matrix in material axes [1/m], shape [triangle_count, 2, 2].
        rest_area: Rest area of each triangle [m^2], shape [triangle_count].
        mass: Mass of each vertex [kg], shape [vertex_count].
        area: Rest area that each vertex stands for [m^2], shape [vertex_count].
        corner_start, corners: For each vertex the list of its triangle corners, triangle * 3 + corner.
        row_start, columns: One-ring of each vertex, itself included, in ascending order; for hinges or springs also
            the corners opposite to it.
        diagonal_entry: Place of each vertex in its own row.
        contribution_start, contributions: For each block the triangle corners pairs that add to it,
            triangle * 9 + row corner * 3 + column corner.
        bending_start, bending_columns, bending_coefficients: The matrix Q of the quadratic bending energy [N/m].
        block_bending: The part of Q that falls on the one-ring's blocks [N/m].
        far_start, far_columns, far_coefficients: The part of Q outside the one-ring [N/m].
        hinges, springs: Those of a fabric that is made of them, with where they add to vertices and blocks.
    """

    parts: tuple[FabricPart, ...]
    rest_positions: FloatArray
    faces: IntArray
    rest_inverse: FloatArray
    rest_area: FloatArray
    mass: FloatArray
    area: FloatArray
    corner_start: IntArray
    corners: IntArray
    row_start: IntArray
    columns: IntArray
    diagonal_entry: IntArray
    contribution_start: IntArray
    contributions: IntArray
    bending_start: IntArray
    bending_columns: IntArray
    bending_coefficients: FloatArray
    block_bending: FloatArray
    far_start: IntArray
    far_columns: IntArray
    far_coefficients: FloatArray = field(repr=False)
    hinges: tuple[HingeRest, Gathering] | None = None
    springs: tuple[SpringRest, Gathering] | None = None

    @property
    def fabric(self) -> Fabric:
        """The fabric of a single garment."""
        (part,) = self.parts
        return part.fabric

    @property
    def vertex_count(self) -> int:
        return len(self.rest_positions)

    @property
    def triangle_count(self) -> int:
        return len(self.faces)


def build_cloth_model(
    positions: FloatArray,
    faces: IntArray,
    fabric: Fabric,
    *,
    length_directions: FloatArray | None = None,
    warp_directions: FloatArray | None = None,
    ease: tuple[float, float] = (0.0, 0.0),
) -> ClothModel:
    """Build the model of a garment cut like ``positions`` and then let out by ``ease``.

    Args:
        positions: The garment's rest surface [m], shape [vertex_count, 3].
        faces: Triangles, shape [triangle_count, 3].
        fabric: The material.
        length_directions: Direction of each triangle's length (along the limb), shape [triangle_count, 3]; needed
            when there is ease.
        warp_directions: Direction of the fabric's warp on each triangle, shape [triangle_count, 3]; left out, and
            where it is zero, that of the length.
        ease: Extra cloth around the girth and along the length, as shares of the surface's own size: design slack
            that turns a shell into a garment that can fold.

    Raises:
        ValueError: If a triangle has no area, or no two of them share an edge.
    """
    positions = np.asarray(positions, np.float64)
    faces = np.asarray(faces, np.int32)
    corners = positions[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = np.cross(first, second)
    doubled = np.linalg.norm(normals, axis=1)
    if (doubled < 1e-12).any():
        raise ValueError(f"{int((doubled < 1e-12).sum())} triangles of the garment have no area; merge by distance.")
    if not len(inner_edges(faces)[0]):
        raise ValueError("No two faces of the garment share an edge; merge vertices by distance.")
    normals /= doubled[:, None]
    length = _in_plane(first if length_directions is None else length_directions, normals, first)
    warp = length if warp_directions is None else _in_plane(warp_directions, normals, length)
    edges = _material_edges(first, second, normals, length, warp, ease)
    rest_area = 0.5 * np.linalg.det(edges).astype(np.float64)
    vertex_count = len(positions)
    area = np.bincount(faces.ravel(), np.repeat(rest_area / 3.0, 3), vertex_count).astype(np.float64)
    corner_start, corner_list = group(faces.ravel(), vertex_count)
    hinges = make_hinges(positions, faces, edges, fabric) if fabric.material == "hinges" else None
    springs = make_springs(faces, edges, fabric) if fabric.material == "springs" else None
    elements = hinges or springs
    blocks, contribution_start, contributions = _blocks(faces, elements and elements.vertices, vertex_count)
    rows, columns = blocks // vertex_count, (blocks % vertex_count).astype(np.int32)
    row_start = row_starts(rows, vertex_count)
    if elements is None:
        b_rows, b_columns, b_values = bending_matrix(positions, faces, warp, fabric.plate)
    else:
        b_rows, b_columns, b_values = np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0)
    bending_start = row_starts(b_rows, vertex_count)
    # Both lists are sorted by (row, column), so their keys can be searched.
    bending_keys = b_rows.astype(np.int64) * vertex_count + b_columns
    place = np.minimum(np.searchsorted(blocks, bending_keys), len(blocks) - 1)
    near = blocks[place] == bending_keys
    block_bending = np.zeros(len(columns))
    block_bending[place[near]] = b_values[near]
    return ClothModel(
        parts=(FabricPart(fabric, slice(0, vertex_count), slice(0, len(faces))),),
        rest_positions=positions,
        faces=faces,
        rest_inverse=np.linalg.inv(edges).astype(np.float64),
        rest_area=rest_area,
        mass=area * fabric.density,
        area=area,
        corner_start=corner_start,
        corners=corner_list,
        row_start=row_start,
        columns=columns,
        diagonal_entry=np.flatnonzero(rows == columns).astype(np.int32),
        contribution_start=contribution_start,
        contributions=contributions,
        bending_start=bending_start,
        bending_columns=b_columns.astype(np.int32),
        bending_coefficients=b_values,
        block_bending=block_bending,
        far_start=row_starts(b_rows[~near], vertex_count),
        far_columns=b_columns[~near].astype(np.int32),
        far_coefficients=b_values[~near],
        hinges=hinges and (hinges, gather(hinges.vertices, vertex_count, blocks)),
        springs=springs and (springs, gather(springs.vertices, vertex_count, blocks)),
    )


def join_models(models: Sequence[ClothModel]) -> ClothModel:
    """Several garments as one model, in their order; nothing connects them."""
    vertices = np.cumsum([0] + [model.vertex_count for model in models])
    triangles = np.cumsum([0] + [model.triangle_count for model in models])

    def joined(name: str, first: np.ndarray | None = None) -> np.ndarray:
        """The models' arrays in a row; entries that are indices count on from the first one of each model."""
        values = [getattr(model, name) for model in models]
        if first is not None:
            values = [(part + offset).astype(np.int32) for part, offset in zip(values, first, strict=False)]
        return np.concatenate(values)

    def starts(name: str) -> IntArray:
        counts = np.concatenate([np.diff(getattr(model, name)) for model in models])
        return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)

    blocks = np.cumsum([0] + [len(model.columns) for model in models])
    parts = [
        FabricPart(
            model.fabric, slice(int(v), int(v) + model.vertex_count), slice(int(t), int(t) + model.triangle_count)
        )
        for model, v, t in zip(models, vertices[:-1], triangles[:-1], strict=True)
    ]
    block_keys = rows_of(starts("row_start")) * np.int64(vertices[-1]) + joined("columns", vertices)
    return ClothModel(
        parts=tuple(parts),
        rest_positions=joined("rest_positions"),
        faces=joined("faces", vertices),
        rest_inverse=joined("rest_inverse"),
        rest_area=joined("rest_area"),
        mass=joined("mass"),
        area=joined("area"),
        corner_start=starts("corner_start"),
        corners=joined("corners", 3 * triangles),
        row_start=starts("row_start"),
        columns=joined("columns", vertices),
        diagonal_entry=joined("diagonal_entry", blocks),
        contribution_start=starts("contribution_start"),
        contributions=joined("contributions", 9 * triangles),
        bending_start=starts("bending_start"),
        bending_columns=joined("bending_columns", vertices),
        bending_coefficients=joined("bending_coefficients"),
        block_bending=joined("block_bending"),
        far_start=starts("far_start"),
        far_columns=joined("far_columns", vertices),
        far_coefficients=joined("far_coefficients"),
        hinges=_join_elements([model.hinges for model in models], vertices, block_keys),
        springs=_join_elements([model.springs for model in models], vertices, block_keys),
    )


def _join_elements(
    elements: Sequence[tuple[Rest, Gathering] | None], first_vertex: np.ndarray, blocks: BlockKeys
) -> tuple[Rest, Gathering] | None:
    """Hinges or springs of several models as those of one."""
    shifted = [
        replace(found[0], vertices=(found[0].vertices + first).astype(np.int32))
        for found, first in zip(elements, first_vertex, strict=False)
        if found is not None
    ]
    if not shifted:
        return None
    rest = type(shifted[0])(
        **{one.name: np.concatenate([getattr(part, one.name) for part in shifted]) for one in fields(shifted[0])}
    )
    return rest, gather(rest.vertices, int(first_vertex[-1]), blocks)


def _in_plane(directions: FloatArray, normals: FloatArray, otherwise: FloatArray) -> FloatArray:
    """Directions laid into their triangles' planes, unit vectors, shape [triangle_count, 3].

    One that stands on its triangle tells nothing; there it is taken from ``otherwise``, which lies in the plane.
    """
    flat = directions - (directions * normals).sum(1, keepdims=True) * normals
    flat = np.where((np.linalg.norm(flat, axis=1) > 1e-6)[:, None], flat, otherwise)
    return flat / np.linalg.norm(flat, axis=1)[:, None]


def _material_edges(
    first: FloatArray,
    second: FloatArray,
    normals: FloatArray,
    length: FloatArray,
    warp: FloatArray,
    ease: tuple[float, float],
) -> FloatArray:
    """Rest edge matrices in warp and weft [m], shape [triangle_count, 2, 2]: eased along the length, then turned."""
    girth = np.cross(normals, length)
    cosine, sine = (warp * length).sum(1), (warp * girth).sum(1)
    edges = np.empty((len(first), 2, 2), np.float64)
    for column, edge in enumerate((first, second)):
        along, around = (edge * length).sum(1) * (1.0 + ease[1]), (edge * girth).sum(1) * (1.0 + ease[0])
        edges[:, 0, column] = cosine * along + sine * around
        edges[:, 1, column] = cosine * around - sine * along
    return edges


def _blocks(faces: IntArray, elements: IntArray | None, vertex_count: int) -> tuple[BlockKeys, IntArray, IntArray]:
    """Blocks of the Hessian, and for each one the corner pairs of triangles that contribute to it.

    Returns:
        blocks: Ascending.
        start, contributions: Lists of triangle * 9 + row corner * 3 + column corner.
    """
    keys = element_keys(faces, vertex_count)
    more = [] if elements is None else [element_keys(elements, vertex_count)]
    blocks = np.unique(np.concatenate([keys, *more]))
    start, contributions = group(np.searchsorted(blocks, keys), len(blocks))
    return blocks, start, contributions
