"""Where something is wrong with a character: what a complaint carries, so that an artist can be taken there."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


class Part(enum.Enum):
    """What a place lies on."""

    GARMENT = "garment"
    BODY = "body"
    ARMATURE = "armature"
    JOINT = "joint"


@dataclass(frozen=True)
class Place:
    """Where to look.

    Attributes:
        part: What it lies on.
        vertices: Vertices of that mesh, ascending; none for the whole object.
        names: Bones of the armature, or the one joint.
    """

    part: Part
    vertices: tuple[int, ...] = ()
    names: tuple[str, ...] = ()

    @staticmethod
    def of_vertices(part: Part, chosen: ArrayLike) -> Place:
        """Vertices of a mesh: a mask of shape [vertex_count], or their numbers in any order and shape."""
        chosen = np.asarray(chosen)
        numbers = np.flatnonzero(chosen) if chosen.dtype == bool else np.unique(chosen)
        return Place(part, tuple(numbers.tolist()))


class PlacedError(ValueError):
    """One sentence that says what is wrong and what to do, and where."""

    def __init__(self, sentence: str, place: Place):
        super().__init__(sentence)
        self.place = place
