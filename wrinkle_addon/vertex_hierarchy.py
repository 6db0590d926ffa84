"""A field over a garment's vertices as small integers: coarse vertices first, each finer one told from those around it.

Principal components are smooth over the cloth, so what a vertex has is close to what its neighbours let expect. The
hierarchy comes from rest positions alone, in whole numbers, so every machine that knows them finds the same one.
Grids of growing cells choose it: a cell keeps its first vertex, the others are expected from the nearest kept ones
around them. Expectation is from decoded neighbours, so no vertex is off by more than its own rounding.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .adaptive_code import Surroundings
from .rig import FloatArray, IntArray

NEIGHBOURS = 5
"""Kept vertices from which one is expected; more blur, fewer miss the slope."""

FLATNESS = 0.05
"""How reluctantly slopes are followed: the ridge of the fit, beside the spread of the neighbours."""

ROUNDING = 0.43
"""Fractions above 1 - this are rounded away from zero: zeros are cheap, and what they lose counts twice less."""

FINER = 0.87
"""Step of a level over that of the next finer one: all finer vertices follow what a coarse one has."""

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

    Attributes:
        lattice: Rest positions in whole units, none below 0, shape [vertex_count, 3].

    Raises:
        ValueError: If a coordinate is out of range.
    """

    def __init__(self, lattice: IntArray):
        if not len(lattice) or lattice.min() < 0 or lattice.max() >= LARGEST:
            raise ValueError("The rest positions lie outside the lattice.")
        self.lattice = lattice.astype(np.int64)
        kept = np.arange(len(lattice))
        levels: list[Level] = []
        exponent = 0
        while len(kept) > 1:
            cell = round(2.0 ** (exponent / 2))
            keys, first = np.unique(_keys(self.lattice[kept] // cell), return_index=True)
            if len(keys) < len(kept):
                coarse = kept[first]
                levels.append(self._level(np.setdiff1d(kept, coarse), coarse, keys, cell))
                kept = coarse
            exponent += 1
        self._root = kept
        self._levels = levels[::-1]

    def quantise(
        self, values: NDArray[np.float32], step: float, finer: float = FINER
    ) -> tuple[IntArray, NDArray[np.float32]]:
        """Integers that stand for a field, and the field that they decode to.

        Args:
            values: Shape [vertex_count, channel_count].
            step: What one unit is worth at the finest vertices, where the most are; no decoded value is off by more
                than 1 - ROUNDING of it.
            finer: Step of a level over that of the next finer one.
        """
        codes = np.zeros(values.shape, np.int32)
        decoded = np.zeros(values.shape, np.float32)
        for vertices, unit, expected in self._walk(decoded, step, finer):
            wanted = (values[vertices] - expected) / unit
            codes[vertices] = np.copysign(np.floor(np.abs(wanted) + ROUNDING), wanted)
            decoded[vertices] = expected + unit * codes[vertices]
        return codes, decoded

    def restore(self, codes: IntArray, step: float, finer: float = FINER) -> NDArray[np.float32]:
        """The field of integers from :meth:`quantise`."""
        decoded = np.zeros(codes.shape, np.float32)
        for vertices, unit, expected in self._walk(decoded, step, finer):
            decoded[vertices] = expected + unit * codes[vertices]
        return decoded

    @cached_property
    def surroundings(self) -> Surroundings:
        """The vertices from coarse to fine, and what each is expected from."""
        neighbours = np.full((len(self.lattice), NEIGHBOURS), -1, np.int32)
        for level in self._levels:
            neighbours[level.vertices] = level.neighbours
        order = np.concatenate([self._root, *(level.vertices for level in self._levels)])
        return Surroundings(order.astype(np.int32), neighbours)

    def _walk(
        self, decoded: NDArray[np.float32], step: float, finer: float
    ) -> Iterator[tuple[NDArray[np.int64], np.float32, NDArray[np.float32]]]:
        """Vertices, what a unit is worth there, and what is expected of them, from what is decoded by then."""
        units = np.float32(step) * np.float32(finer) ** np.arange(len(self._levels), -1, -1, dtype=np.float32)
        yield self._root, units[0], np.zeros((1, decoded.shape[1]), np.float32)
        for level, unit in zip(self._levels, units[1:], strict=True):
            expected = level.weights[:, :1] * decoded[level.neighbours[:, 0]]
            for k in range(1, NEIGHBOURS):
                expected += level.weights[:, k : k + 1] * decoded[level.neighbours[:, k]]
            yield level.vertices, unit, expected

    def _level(self, fine: NDArray[np.int64], coarse: NDArray[np.int64], keys: NDArray[np.int64], cell: int) -> Level:
        places = self.lattice[fine]
        candidates, distances = [], []
        for around in np.ndindex(3, 3, 3):
            wanted = _keys(places // cell + np.array(around) - 1)
            found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            squared = ((self.lattice[coarse[found]] - places) ** 2).sum(1)
            candidates.append(coarse[found])
            distances.append(np.where(keys[found] == wanted, squared, _NOWHERE))
        distance = np.stack(distances, 1)
        nearest = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS]
        neighbours = np.take_along_axis(np.stack(candidates, 1), nearest, 1)
        squared = np.take_along_axis(distance, nearest, 1)
        return Level(fine, neighbours, _fit(self.lattice[neighbours] - places[:, None], squared))


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
