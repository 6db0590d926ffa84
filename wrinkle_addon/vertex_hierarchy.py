"""A field over a garment's vertices as small integers: coarse vertices first, each finer one told from those around it.

Principal components are smooth over the cloth, so what a vertex has is close to what its neighbours let expect. The
hierarchy comes from rest positions alone, in whole numbers, so every machine that knows them finds the same one.
Grids of growing cells choose it: a cell keeps its first vertex, the others are expected from the nearest kept ones
around them. Expectation is from decoded neighbours, so no vertex is off by more than its own rounding.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .rig import FloatArray, IntArray

NEIGHBOURS = 4
"""Kept vertices from which one is expected; more blur, fewer miss the slope."""

FLATNESS = 0.1
"""How reluctantly slopes are followed: the ridge of the fit, beside the spread of the neighbours."""

ROUNDING = 0.4
"""Fractions above 1 - this are rounded away from zero: zeros are cheap, and what they lose counts twice less."""

LARGEST = 2**20
"""Coordinates in lattice units stay below this, so that a cell fits one integer."""

_NOWHERE = 2**60


@dataclass(frozen=True, eq=False)
class Level:
    """Vertices that are expected from coarser ones.

    Attributes:
        vertices: Their indices, shape [count].
        neighbours: Coarser vertices around each, shape [count, NEIGHBOURS].
        weights: By which their values give the expected one, shape [count, NEIGHBOURS].
    """

    vertices: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    weights: NDArray[np.float32]


class VertexHierarchy:
    """The levels of a garment.

    Args:
        lattice: Rest positions in whole units, none below 0, shape [vertex_count, 3].

    Raises:
        ValueError: If a coordinate is out of range.
    """

    def __init__(self, lattice: IntArray):
        if not len(lattice) or lattice.min() < 0 or lattice.max() >= LARGEST:
            raise ValueError("The rest positions lie outside the lattice.")
        self._lattice = lattice.astype(np.int64)
        kept = np.arange(len(lattice))
        levels: list[Level] = []
        exponent = 0
        while len(kept) > 1:
            cell = round(2.0 ** (exponent / 2))
            keys, first = np.unique(_keys(self._lattice[kept] // cell), return_index=True)
            if len(keys) < len(kept):
                coarse = kept[first]
                levels.append(self._level(np.setdiff1d(kept, coarse), coarse, keys, cell))
                kept = coarse
            exponent += 1
        self._root = kept
        self._levels = levels[::-1]

    def quantise(self, values: NDArray[np.float32], step: float) -> tuple[IntArray, NDArray[np.float32]]:
        """Integers that stand for a field, and the field that they decode to.

        Args:
            values: Shape [vertex_count, channel_count].
            step: What one unit is worth; no decoded value is off by more than 1 - ROUNDING of it.
        """
        codes = np.zeros(values.shape, np.int32)
        decoded = np.zeros(values.shape, np.float32)
        for vertices, expected in self._walk(decoded):
            wanted = (values[vertices] - expected) / np.float32(step)
            codes[vertices] = np.copysign(np.floor(np.abs(wanted) + ROUNDING), wanted)
            decoded[vertices] = expected + np.float32(step) * codes[vertices]
        return codes, decoded

    def restore(self, codes: IntArray, step: float) -> NDArray[np.float32]:
        """The field of integers from :meth:`quantise`."""
        decoded = np.zeros(codes.shape, np.float32)
        for vertices, expected in self._walk(decoded):
            decoded[vertices] = expected + np.float32(step) * codes[vertices]
        return decoded

    def _walk(self, decoded: NDArray[np.float32]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32]]]:
        """Vertices and what is expected of them, from what is decoded by then."""
        yield self._root, np.zeros((1, decoded.shape[1]), np.float32)
        for level in self._levels:
            expected = level.weights[:, :1] * decoded[level.neighbours[:, 0]]
            for k in range(1, NEIGHBOURS):
                expected += level.weights[:, k : k + 1] * decoded[level.neighbours[:, k]]
            yield level.vertices, expected

    def _level(self, fine: NDArray[np.int64], coarse: NDArray[np.int64], keys: NDArray[np.int64], cell: int) -> Level:
        places = self._lattice[fine]
        candidates, distances = [], []
        for around in np.ndindex(3, 3, 3):
            wanted = _keys(places // cell + np.array(around) - 1)
            found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            squared = ((self._lattice[coarse[found]] - places) ** 2).sum(1)
            candidates.append(coarse[found])
            distances.append(np.where(keys[found] == wanted, squared, _NOWHERE))
        distance = np.stack(distances, 1)
        nearest = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS]
        neighbours = np.take_along_axis(np.stack(candidates, 1), nearest, 1)
        squared = np.take_along_axis(distance, nearest, 1)
        return Level(fine, neighbours, _fit(self._lattice[neighbours] - places[:, None], squared))


def _keys(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for each cell; cells may lie one outside the lattice."""
    return ((cells[:, 0] + 1) << 42) | ((cells[:, 1] + 1) << 21) | (cells[:, 2] + 1)


def _fit(offsets: NDArray[np.int64], squared: NDArray[np.int64]) -> NDArray[np.float32]:
    """Weights of neighbours whose values a sloping plane through space is fitted to (moving least squares).

    Args:
        offsets: Neighbours from the vertex, shape [count, NEIGHBOURS, 3].
        squared: Their squared lengths, _NOWHERE for those that are none, shape [count, NEIGHBOURS].
    """
    there = squared < _NOWHERE
    nearness = np.where(there, 1.0 / (squared + 1.0), 0.0)
    total = nearness.sum(1)
    spread = np.sqrt(np.maximum((nearness * np.where(there, squared, 0)).sum(1) / total, 1.0))
    terms: FloatArray = np.ones((*squared.shape, 4))
    terms[:, :, 1:] = np.where(there[:, :, None], offsets, 0) / spread[:, None, None]
    system = np.einsum("vi,via,vib->vab", nearness, terms, terms)
    system[:, [1, 2, 3], [1, 2, 3]] += FLATNESS * total[:, None]
    unit = np.zeros((len(squared), 4, 1))
    unit[:, 0] = 1.0
    solved = np.linalg.solve(system, unit)[:, :, 0]
    return (nearness * np.einsum("via,va->vi", terms, solved)).astype(np.float32)
