"""Giving a garment a coarse mesh: one made from it, skinned as it is, or any other of the scene."""

from __future__ import annotations

import bpy
import numpy as np

from ..cloth_model import FloatArray
from ..coarse_mesh import VERTEX_COUNT, CoarseMesh, make_coarse_mesh
from ..garment import bind_to_surface
from .character import read_mesh
from .coarse_layer import doubt_of, match_coarse
from .coarse_scene import SIMULATION
from .setup import bind_to_armature

SUFFIX = ".coarse"
LEAST_WEIGHT = 1.0e-3
"""Weights below this are left out of a vertex group."""


def make_coarse(garment: bpy.types.Object, vertex_count: int = VERTEX_COUNT) -> bpy.types.Object:
    """Make a coarse mesh from a garment and let the garment follow a simulation of it.

    The new object, ``GARMENT.coarse``, stands where the garment does, has its vertex groups and an Armature modifier,
    and is hidden; an earlier one is replaced.

    Raises:
        ValueError: If the garment was not set up, or cannot be meshed with so many vertices; one sentence.
    """
    settings = garment.wrinkles
    if settings.armature is None:
        raise ValueError(f"The garment '{garment.name}' has no armature; set it up first.")
    positions, faces = read_mesh(garment.data)
    made = make_coarse_mesh(garment.name, positions, faces, vertex_count)
    earlier = bpy.data.objects.get(garment.name + SUFFIX)
    if earlier is not None and earlier == settings.coarse:
        bpy.data.objects.remove(earlier)
    coarse = _place_beside(garment, made)
    closest = bind_to_surface(made.positions, positions, faces)
    _write_groups(coarse, garment, np.take(faces, closest.faces, 0), closest.weights)
    bind_to_armature(coarse, settings.armature)
    choose(garment, coarse, SIMULATION)
    return coarse


def choose(garment: bpy.types.Object, coarse: bpy.types.Object, layer: str) -> str:
    """Let a garment follow a mesh of the scene.

    Args:
        layer: MESH to follow it as Blender moves it, SIMULATION to follow a simulation of it.

    Returns:
        A sentence on what is doubtful about it; empty if nothing is.

    Raises:
        ValueError: If the mesh cannot be the garment's coarse layer; one sentence that says what to do.
    """
    bpy.context.view_layer.update()
    settings = garment.wrinkles
    settings.coarse, settings.coarse_layer = coarse, layer
    return doubt_of(coarse.name, match_coarse(garment))


def _place_beside(garment: bpy.types.Object, made: CoarseMesh) -> bpy.types.Object:
    """A hidden object of the coarse mesh that stands, and is carried, as the garment is."""
    name = garment.name + SUFFIX
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(made.positions.tolist(), [], made.faces.tolist())
    coarse = bpy.data.objects.new(name, mesh)
    for collection in garment.users_collection:
        collection.objects.link(coarse)
    for place in ("parent", "parent_type", "parent_bone", "matrix_parent_inverse", "matrix_basis"):
        setattr(coarse, place, getattr(garment, place))
    for place in ("delta_location", "delta_rotation_euler", "delta_scale"):
        setattr(coarse, place, getattr(garment, place))
    coarse.display_type = "WIRE"
    coarse.hide_render = coarse.hide_viewport = True
    return coarse


def _write_groups(coarse: bpy.types.Object, garment: bpy.types.Object, corners: np.ndarray, shares: np.ndarray) -> None:
    """Give the coarse mesh the garment's vertex groups: bones, pins, masks.

    Args:
        corners, shares: The garment's vertices around each coarse one and what they count, shape [coarse_count, 3].
    """
    weights = _read_groups(garment)
    found = np.einsum("vc,vcg->vg", shares.astype(np.float64), weights[corners])
    for number, group in enumerate(garment.vertex_groups):
        made = coarse.vertex_groups.new(name=group.name)
        for vertex in np.flatnonzero(found[:, number] > LEAST_WEIGHT):
            made.add([int(vertex)], float(found[vertex, number]), "REPLACE")


def _read_groups(ob: bpy.types.Object) -> FloatArray:
    """Weights of all vertex groups, shape [vertex_count, group_count]."""
    weights = np.zeros((len(ob.data.vertices), len(ob.vertex_groups)))
    for vertex in ob.data.vertices:
        for element in vertex.groups:
            weights[vertex.index, element.group] = element.weight
    return weights
