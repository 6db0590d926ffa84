"""Who wears what, guessed from what is selected."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from .setup import find_armature


@dataclass(frozen=True)
class CharacterGuess:
    """Objects to set up; those that could not be guessed are None."""

    garment: bpy.types.Object | None
    body: bpy.types.Object | None
    armature: bpy.types.Object | None

    @property
    def missing(self) -> str:
        """One sentence on what to do next; empty if there is nothing."""
        if self.garment is None:
            return "Select the garment, last of all."
        if self.body is None:
            return "Select the body that wears the garment, then the garment."
        if self.armature is None:
            return "Give the body an Armature modifier, or parent it to its armature."
        return ""


def guess_character(context: bpy.types.Context) -> CharacterGuess:
    """The active mesh is the garment. Its body is the one that it was set up with, another selected mesh, or else the
    mesh of the view layer that an armature moves and that the garment lies over most closely."""
    garment = context.object
    if garment is None or garment.type != "MESH":
        return CharacterGuess(None, None, None)
    body = garment.wrinkles.body or _selected_body(context, garment) or _nearest_body(context, garment)
    return CharacterGuess(garment, body, None if body is None else find_armature(garment, body))


def _selected_body(context: bpy.types.Context, garment: bpy.types.Object) -> bpy.types.Object | None:
    others = [ob for ob in context.selected_objects if ob.type == "MESH" and ob != garment]
    return next((ob for ob in others if _is_moved(ob)), others[0] if others else None)


def _nearest_body(context: bpy.types.Context, garment: bpy.types.Object) -> bpy.types.Object | None:
    """Of the meshes that reach around the garment, or nearly so, the one with most vertices."""
    around = []
    for ob in context.visible_objects:
        if ob.type == "MESH" and ob != garment and ob.wrinkles.armature is None and _is_moved(ob):
            share = _overlap(_bounds(garment), _bounds(ob))
            if share > 0.5:
                around.append((len(ob.data.vertices), ob.name, ob))
    return max(around)[2] if around else None


def _is_moved(ob: bpy.types.Object) -> bool:
    return bool(ob.vertex_groups) and find_armature(ob, ob) is not None


def _bounds(ob: bpy.types.Object) -> np.ndarray:
    """Lowest and highest corner in the world, shape [2, 3]."""
    corners = np.array([ob.matrix_world @ Vector(corner) for corner in ob.bound_box])
    return np.stack([corners.min(0), corners.max(0)])


def _overlap(inner: np.ndarray, outer: np.ndarray) -> float:
    """Share of the inner box's extent, in its worst direction, that lies within the outer one."""
    shared = np.minimum(inner[1], outer[1]) - np.maximum(inner[0], outer[0])
    extent = np.maximum(inner[1] - inner[0], 1e-9)
    return float((np.maximum(shared, 0.0) / extent).min())
