"""The doll as Blender objects: an armature, its body, and a shirt that is not set up yet."""

from __future__ import annotations

import bpy
import numpy as np
from armatures import armature_of
from dolls import Doll


def mesh_object(name: str, vertices: np.ndarray, faces: np.ndarray) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(ob)
    return ob


def build_figure(figure: Doll) -> None:
    """The objects "Figure" (armature), "body" and "shirt"."""
    armature = armature_of(figure.rig)
    body = mesh_object("body", figure.body.positions, figure.body.faces)
    for bone, weights in zip(figure.rig.names, figure.body.weights.T, strict=True):
        group = body.vertex_groups.new(name=bone)
        for vertex in np.flatnonzero(weights):
            group.add([int(vertex)], float(weights[vertex]), "REPLACE")
    body.modifiers.new("Armature", "ARMATURE").object = armature
    mesh_object("shirt", figure.garment.positions, figure.garment.faces)
