"""Edges of a triangle mesh, and lists of what belongs to whom, in orders that are always the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int32]


def inner_edges(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Edges between two triangles, in a fixed order.

    Returns:
        vertices: (edge start, edge end, opposite in the first, opposite in the second), shape [edge_count, 4]; the edge
            runs along the winding of its first triangle.
        sides: Where the edge lies in its two triangles, as triangle * 3 + corner that the edge starts from, shape
            [edge_count, 2].
    """
    starts = faces.ravel()
    ends = faces[:, [1, 2, 0]].ravel()
    opposites = faces[:, [2, 0, 1]].ravel()
    low, high = np.minimum(starts, ends).astype(np.int64), np.maximum(starts, ends)
    keys = low * (int(faces.max(initial=0)) + 1) + high
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    first, second = order[:-1][same], order[1:][same]
    vertices = np.stack([starts[first], ends[first], opposites[first], opposites[second]], 1)
    return vertices.astype(np.int32), np.stack([first, second], 1).astype(np.int32)


def border_edges(faces: IntArray) -> IntArray:
    """Edges of one triangle only, shape [border_edge_count, 2]."""
    edges, edge_of_side = mesh_edges(faces)
    return edges[np.bincount(edge_of_side.ravel()) == 1]


def connected_parts(pairs: NDArray[np.integer], count: int) -> NDArray[np.int64]:
    """The lowest of all that each one hangs together with through pairs, shape [count]."""
    label = np.arange(count)
    while True:
        lowest = label[pairs].min(1)
        if (label[pairs] == lowest[:, None]).all():
            return label
        for end in pairs.T:
            np.minimum.at(label, label[end], lowest)
        while (label[label] != label).any():
            label = label[label]


def group(owners: NDArray[np.integer], owner_count: int) -> tuple[IntArray, IntArray]:
    """Lists of entries by owner: (start, entries) with entries[start[i] : start[i + 1]] owned by i, ascending."""
    start = np.concatenate([[0], np.cumsum(np.bincount(owners, minlength=owner_count))])
    return start.astype(np.int32), np.argsort(owners, kind="stable").astype(np.int32)


def faces_around(faces: IntArray, vertex_count: int) -> tuple[IntArray, IntArray]:
    """The triangles around every vertex: (start, triangles), as :func:`group` lists them."""
    start, corners = group(faces.ravel(), vertex_count)
    return start, corners // 3


def distinct_pairs(first: NDArray[np.integer], second: NDArray[np.integer]) -> tuple[IntArray, IntArray]:
    """Every pair of numbers once, ascending, shape [distinct_count, 2], and which of them each pair is, [count]."""
    # As one number each: NumPy sorts those many times faster than rows.
    stride = int(second.max(initial=0)) + 1
    keys, which = np.unique(first.astype(np.int64) * stride + second, return_inverse=True)
    return np.stack(np.divmod(keys, stride), 1).astype(np.int32), which.astype(np.int32)


def mesh_edges(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Every edge once, shape [edge_count, 2], and the edge of each triangle's sides 01, 12, 20, [triangle_count, 3]."""
    sides = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges, edge_of_side = distinct_pairs(sides.min(1), sides.max(1))
    return edges, edge_of_side.reshape(-1, 3)


def row_starts(sorted_rows: NDArray[np.integer], row_count: int) -> IntArray:
    """Where each row begins in a list sorted by rows, and where the last one ends, shape [row_count + 1]."""
    return np.searchsorted(sorted_rows, np.arange(row_count + 1)).astype(np.int32)


def rows_of(row_start: IntArray) -> IntArray:
    """The row of each entry of a list whose rows begin at ``row_start``."""
    return np.repeat(np.arange(len(row_start) - 1, dtype=np.int32), np.diff(row_start))


def by_fours(start: IntArray, columns: IntArray, weights: NDArray) -> tuple[IntArray, IntArray, NDArray]:
    """Rows of a sparse matrix four entries at a time, the last ones of each row filled up with zeros.

    Those are in its first column, so that what is not a number elsewhere stays out of it.

    Returns:
        Where each row's fours begin, [row_count + 1], and their columns and weights, [four_count, 4] each.
    """
    row = rows_of(start)
    fours = -(-np.diff(start) // 4)
    first = np.concatenate([[0], np.cumsum(fours)]).astype(np.int32)
    place = 4 * first[row] + np.arange(len(columns)) - start[row]
    wide_columns = columns[np.repeat(start[:-1], 4 * fours)].astype(np.int32)
    wide_weights = np.zeros(4 * first[-1], weights.dtype)
    wide_columns[place], wide_weights[place] = columns, weights
    return first, wide_columns.reshape(-1, 4), wide_weights.reshape(-1, 4)


def triangles_beside(faces: IntArray) -> IntArray:
    """The triangle across the edge that lies opposite each corner, -1 at a border, shape [triangle_count, 3]."""
    _, sides = inner_edges(faces)
    beside = np.full(faces.size, -1, np.int32)
    for near, far in (sides.T, sides.T[::-1]):
        # The edge that starts from corner k ends at k + 1, so it lies opposite corner k + 2.
        beside[near - near % 3 + (near + 2) % 3] = far // 3
    return beside.reshape(-1, 3)
