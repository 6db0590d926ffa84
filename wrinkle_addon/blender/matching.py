"""Whether a garment and its rig are still what a database was baked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import bpy
import numpy as np

from ..database import DatabaseHeader
from ..garment import Garment
from ..rig import FloatArray, IntArray, Rig

REST_TOLERANCE = 1.0e-3
"""Difference of rest matrices that is no change: 1 mm, or 0.06 degrees."""


def check_database(garment: bpy.types.Object, header: DatabaseHeader) -> float:
    """Refuse a database that was not baked for this garment and its rig.

    Returns:
        Metres of the bake per unit of the armature's own space.

    Raises:
        ValueError: One sentence that says what differs, and what to do.
    """
    check_mesh(garment, header.garment)
    return match_rig(garment.wrinkles.armature, header)


def check_mesh(garment: bpy.types.Object, baked: Garment) -> None:
    """Refuse a garment of another topology than the baked one; its name and its shape do not matter.

    Raises:
        ValueError: One sentence that says what differs, and what to do.
    """
    mesh = garment.data
    if _same_topology(mesh, baked):
        return
    counts = f"it has {len(mesh.vertices)} vertices, the bake {baked.vertex_count}"
    if garment.name != baked.name:
        raise ValueError(
            f"The database of the garment '{garment.name}' was baked for '{baked.name}', another mesh ({counts}); "
            "choose the garment's own database, or bake one."
        )
    raise ValueError(
        f"The topology of the garment '{garment.name}' changed since the bake ({counts}); "
        "undo the change or bake again."
    )


def _same_topology(mesh: bpy.types.Mesh, baked: Garment) -> bool:
    """Whether the mesh has the baked vertices and triangles, however its faces are cut into triangles now."""
    if len(mesh.vertices) != baked.vertex_count or len(mesh.loops) - 2 * len(mesh.polygons) != len(baked.faces):
        return False
    edges = np.empty(2 * len(mesh.edges), np.int32)
    mesh.edges.foreach_get("vertices", edges)
    corners = baked.faces
    triangle_edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return bool(np.isin(_keys(edges.reshape(-1, 2)), _keys(triangle_edges)).all())


def _keys(edges: IntArray) -> IntArray:
    """One number for each undirected edge."""
    ends = np.sort(edges.astype(np.int64), axis=1)
    return ends[:, 0] << 32 | ends[:, 1]


class OfRig(Protocol):
    """Something that was made for a rig."""

    @property
    def rig(self) -> Rig: ...


@dataclass(frozen=True)
class Making:
    """How something that belongs to a rig was made, in words."""

    event: str
    remedy: str


BAKE = Making("the bake", "bake again")
RECORDING = Making("the recording", "compress the recording again")


def match_rig(armature: bpy.types.Object, header: OfRig, making: Making = BAKE) -> float:
    """Metres of the bake per unit of the armature's own space, if its bones still rest as they did.

    It comes from the bones themselves, so that a character scaled as a whole keeps its wrinkles.

    Raises:
        ValueError: One sentence that says which bone differs, and what to do.
    """
    rig = header.rig
    bones = armature.data.bones
    gone = [name for name in rig.names if name not in bones]
    if gone:
        raise ValueError(
            f"The rig '{armature.name}' changed since {making.event}: it has lost the bone '{gone[0]}'; "
            f"undo the change or {making.remedy}."
        )
    scale = float(rig.lengths.sum()) / sum(bones[name].length for name in rig.names)
    difference = _rest_difference(armature, rig, scale)
    worst = int(difference.argmax())
    if difference[worst] > REST_TOLERANCE:
        raise ValueError(
            f"The rig '{armature.name}' changed since {making.event}: the bone '{rig.names[worst]}' rests elsewhere; "
            f"undo the change or {making.remedy}."
        )
    return scale


def _rest_difference(armature: bpy.types.Object, rig: Rig, scale: float) -> FloatArray:
    """How far each bone's rest matrix is from the baked one, shape [bone_count]."""
    rest = np.array([armature.data.bones[name].matrix_local for name in rig.names], np.float64)
    rest[:, :3, 3] *= scale
    return np.abs(rest - rig.rest).max((1, 2))


def glance_at(garment: bpy.types.Object) -> tuple[object, ...]:
    """What tells a changed mesh or rig at a glance; what edit mode does to a mesh besides is found on leaving it."""
    mesh, bones = garment.data, garment.wrinkles.armature.data.bones
    rest = np.empty(16 * len(bones), np.float32)
    bones.foreach_get("matrix_local", rest)
    counts = len(mesh.vertices), len(mesh.edges), len(mesh.polygons), len(mesh.loops)
    return mesh.session_uid, *counts, *bones.keys(), rest.tobytes()
