"""Where a simulation lost its numbers, told in one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from .cloth_model import FloatArray
from .garment import Garment
from .rig import Rig


class Divergence(ValueError):
    """Cloth whose forces or moves are no numbers any more.

    Attributes:
        vertex: Where it began, as far as can be told.
    """

    def __init__(self, vertex: int):
        super().__init__(
            f"The cloth at vertex {vertex} moved to no number; repair the faces of garment and body there."
        )
        self.vertex = vertex


def find_divergence(positions: FloatArray, gradient: FloatArray) -> Divergence:
    """The first vertex without numbers, or the one that is pushed hardest if what follows from them is none.

    Args:
        positions: Vertices [m], shape [world_count, vertex_count, 3].
        gradient: Minus the force on them [N], of the same shape.
    """
    for values in (positions, gradient):
        if not np.isfinite(values).all():
            return Divergence(first_lost(values))
    return Divergence(int(np.abs(gradient).max(2).max(0).argmax()))


def first_lost(values: FloatArray) -> int:
    """The first vertex of the first world with a value that is no number; shape [world_count, vertex_count, 3]."""
    return int(np.argwhere(~np.isfinite(values))[0, 1])


def place_of(rig: Rig, garment: Garment, vertex: int) -> str:
    """Where a vertex of the garment is, for people: the bone that carries most of it, and its number."""
    return f"{rig.names[garment.weights.bones[vertex, 0]]} (vertex {vertex})"


@contextmanager
def told_of(what: str, rig: Rig, garment: Garment) -> Iterator[None]:
    """Tell of what goes wrong inside: what was simulated, and near which bone.

    Raises:
        ValueError: One sentence that begins with ``what``.
    """
    try:
        yield
    except Divergence as error:
        raise ValueError(
            f"{what}: the cloth near {place_of(rig, garment, error.vertex)} moved to no number; "
            "repair long thin faces of garment and body there, or choose a softer fabric."
        ) from error
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
