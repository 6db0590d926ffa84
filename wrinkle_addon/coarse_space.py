"""Groups of neighbouring vertices that move as rigid bodies: the coarse levels of the linear solver, built once.

Long waves of a fine sheet are what conjugate gradients are slow at. A group of vertices that moves rigidly costs the
fabric no energy inside, so rigid motions of groups (three translations and three rotations each) tell long waves
exactly where stiffness is lowest, and better than any interpolation of displacements (Vanek, Mandel and Brezina 1996:
aggregation with the near-kernel of elasticity).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .cloth_model import ClothModel, FloatArray, IntArray
from .topology import group, row_starts, rows_of

NODE_SIZE = 16
"""Vertices that move as one on the first coarse level."""
LARGEST_COARSEST = 96
"""Rigid bodies of the second coarse level, whose dense matrix is inverted."""


@dataclass(frozen=True, eq=False)
class CoarseLevel:
    """Nodes of a finer level, put together.

    Attributes:
        node: Coarse node of each finer node, shape [fine_count].
        member_start, members: Finer nodes of each coarse one.
        row_start, columns: Which coarse nodes share an entry, row by row, in ascending order.
        rows: The row of each entry.
        diagonal_entry: Place of each node in its own row.
        contribution_start, contributions: For each entry, the entries of the finer level that add to it.
    """

    node: IntArray
    member_start: IntArray
    members: IntArray
    row_start: IntArray
    columns: IntArray
    rows: IntArray
    diagonal_entry: IntArray
    contribution_start: IntArray
    contributions: IntArray

    @property
    def count(self) -> int:
        return len(self.member_start) - 1


def coarse_levels(model: ClothModel) -> tuple[CoarseLevel, CoarseLevel]:
    """The two coarse levels of a garment.

    The entries that contribute to the first one are those of the one-ring, then those of the far bending.
    """
    vertex_count = model.vertex_count
    rows = np.concatenate([rows_of(model.row_start), rows_of(model.far_start)])
    columns = np.concatenate([model.columns, model.far_columns])
    node = aggregate(model.rest_positions, model.row_start, model.columns, max(1, vertex_count // NODE_SIZE))
    first = _level(node, rows, columns)
    centres = np.stack([np.bincount(node, axis) for axis in model.rest_positions.T], 1)
    centres /= np.bincount(node)[:, None]
    node = aggregate(centres, first.row_start, first.columns, max(1, min(LARGEST_COARSEST, first.count // 4)))
    return first, _level(node, first.rows, first.columns)


def aggregate(positions: FloatArray, row_start: IntArray, columns: IntArray, count: int) -> IntArray:
    """Group the nodes of a graph around nodes far from each other, by the way along edges; the group of each node.

    Args:
        positions: Of the nodes [m], shape [node_count, 3].
        row_start, columns: Neighbours of each node, itself included.
        count: Groups asked for; there are more if the graph has more parts.
    """
    rows = rows_of(row_start)
    lengths = np.linalg.norm(positions[rows] - positions[columns], axis=1)
    seeds = _far_apart(positions, count)
    distance = np.full(len(positions), np.inf)
    distance[seeds] = 0.0
    owner = np.full(len(positions), -1)
    owner[seeds] = np.arange(len(seeds))
    while True:
        reached = distance[columns] + lengths
        nearest = np.minimum.reduceat(reached, row_start[:-1])
        closer = nearest < distance
        if closer.any():
            entries = np.flatnonzero((reached == nearest[rows]) & closer[rows])
            # Of several ways that are equally short, the last one listed; always the same.
            owner[rows[entries]] = owner[columns[entries]]
            distance = np.where(closer, nearest, distance)
        elif (owner < 0).any():
            # A part of the garment that no seed lies in.
            seed = np.flatnonzero(owner < 0)[0]
            distance[seed], owner[seed] = 0.0, owner.max() + 1
        else:
            return np.unique(owner, return_inverse=True)[1].astype(np.int32)


def _far_apart(positions: FloatArray, count: int) -> IntArray:
    """Nodes each of which was the farthest from those before it."""
    seeds = np.empty(count, np.int32)
    distance = ((positions - positions.mean(0)) ** 2).sum(1)
    for k in range(count):
        seeds[k] = distance.argmax()
        towards = ((positions - positions[seeds[k]]) ** 2).sum(1)
        distance = towards if k == 0 else np.minimum(distance, towards)
    return np.unique(seeds)


def _level(node: IntArray, rows: IntArray, columns: IntArray) -> CoarseLevel:
    count = int(node.max()) + 1
    member_start, members = group(node, count)
    keys, entry = np.unique(node[rows].astype(np.int64) * count + node[columns], return_inverse=True)
    contribution_start, contributions = group(entry.ravel(), len(keys))
    coarse_rows, coarse_columns = (keys // count).astype(np.int32), (keys % count).astype(np.int32)
    return CoarseLevel(
        node=node,
        member_start=member_start,
        members=members,
        row_start=row_starts(coarse_rows, count),
        columns=coarse_columns,
        rows=coarse_rows,
        diagonal_entry=np.flatnonzero(coarse_rows == coarse_columns).astype(np.int32),
        contribution_start=contribution_start,
        contributions=contributions,
    )
