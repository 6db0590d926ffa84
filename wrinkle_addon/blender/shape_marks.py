"""Marks by which it is told in a redraw whether a character still has the shape that something was found on."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import bpy
import numpy as np

Marks = tuple[int, ...]
"""Of garment, body and armature, and of the coarse mesh if there is one; 0 for what cannot be looked at just now."""


def shape_marks(garment: bpy.types.Object) -> Marks:
    """The shapes as modelled: a vertex or a resting bone that moved makes another mark, weights do not."""
    settings = garment.wrinkles
    return tuple(map(_mark, (garment, settings.body, settings.armature, settings.coarse)))


def same_shapes(marks: Sequence[int], garment: bpy.types.Object) -> bool:
    """Whether a character has the shape of these marks, as far as it can be looked at."""
    return all(not (then and now) or then == now for then, now in zip(marks, shape_marks(garment), strict=False))


def _mark(ob: bpy.types.Object | None) -> int:
    if ob is None:
        return 0
    if ob.type == "ARMATURE":
        rest = np.empty(16 * len(ob.data.bones), np.float32)
        ob.data.bones.foreach_get("matrix_local", rest)
        return zlib.crc32(rest.tobytes())
    if ob.type != "MESH" or ob.data.is_editmode:
        return 0
    positions = np.empty(3 * len(ob.data.vertices), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", positions)
    return zlib.crc32(positions.tobytes())
