"""Giving a garment a coarse mesh: one made from it, skinned as it is, or any other of the scene."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import NDArray

from ..cloth_model import FloatArray, IntArray
from ..coarse_mesh import VERTEX_COUNT, CoarseMesh, make_coarse_mesh
from ..correspondence import find_correspondence
from ..garment import bind_to_surface
from .character import read_mesh
from .coarse_layer import doubt_of, match_coarse
from .coarse_scene import SIMULATION
from .setup import bind_to_armature

SUFFIX = ".coarse"
LEAST_WEIGHT = 1.0e-3
"""Weights below this are left out of a vertex group."""


@dataclass(frozen=True, eq=False)
class CoarseOrder:
    """A garment as modelled, and about how many vertices its coarse mesh is to have; without Blender's data.

    Attributes:
        positions, faces: In its object space, shape [vertex_count, 3] and [triangle_count, 3].
    """

    name: str
    positions: FloatArray
    faces: IntArray
    vertex_count: int

    @staticmethod
    def of(garment: bpy.types.Object, vertex_count: int = VERTEX_COUNT) -> CoarseOrder:
        """Raises ValueError, with one sentence, if the garment was not set up."""
        if garment.wrinkles.armature is None:
            raise ValueError(f"The garment '{garment.name}' has no armature; set it up first.")
        return CoarseOrder(garment.name, *read_mesh(garment.data), vertex_count)

    def make(self) -> CoarseMade:
        """The mesh itself, which takes seconds.

        Raises:
            ValueError: If the garment cannot be meshed with so many vertices, or followed so; one sentence.
        """
        made = make_coarse_mesh(self.name, self.positions, self.faces, self.vertex_count)
        closest = bind_to_surface(made.positions, self.positions, self.faces)
        find_correspondence(self.name + SUFFIX, self.positions, self.faces, made.positions, made.faces)
        return CoarseMade(made, np.take(self.faces, closest.faces, 0), closest.weights, len(self.positions))


@dataclass(frozen=True, eq=False)
class CoarseMade:
    """A coarse mesh, and the garment's vertices around each of its own.

    Attributes:
        corners, shares: Those vertices and what they count, shape [coarse_count, 3].
        fine_count: Vertices of the garment that it was made from.
    """

    mesh: CoarseMesh
    corners: IntArray
    shares: NDArray[np.float32]
    fine_count: int


def make_coarse(garment: bpy.types.Object, vertex_count: int = VERTEX_COUNT) -> bpy.types.Object:
    """Make a coarse mesh from a garment and let the garment follow a simulation of it.

    Raises:
        ValueError: If the garment was not set up, or cannot be meshed with so many vertices; one sentence.
    """
    return place_coarse(garment, CoarseOrder.of(garment, vertex_count).make())


def place_coarse(garment: bpy.types.Object, made: CoarseMade) -> bpy.types.Object:
    """Let a garment follow a simulation of a coarse mesh that was made from it.

    The new object, ``GARMENT.coarse``, stands where the garment does, has its vertex groups and an Armature modifier,
    and is hidden; an earlier one is replaced.

    Raises:
        ValueError: If the garment is no longer what it was made from; one sentence.
    """
    settings = garment.wrinkles
    if len(garment.data.vertices) != made.fine_count or settings.armature is None:
        raise ValueError(f"The garment '{garment.name}' changed while its coarse mesh was made; make it again.")
    earlier = bpy.data.objects.get(garment.name + SUFFIX)
    if earlier is not None and earlier == settings.coarse:
        bpy.data.objects.remove(earlier)
    coarse = _place_beside(garment, made.mesh)
    _write_groups(coarse, garment, made.corners, made.shares)
    bind_to_armature(coarse, settings.armature)
    _follow(garment, coarse, SIMULATION)
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
    _follow(garment, coarse, layer)
    return doubt_of(coarse.name, match_coarse(garment))


def _follow(garment: bpy.types.Object, coarse: bpy.types.Object, layer: str) -> None:
    bpy.context.view_layer.update()
    settings = garment.wrinkles
    settings.coarse, settings.coarse_layer = coarse, layer


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
