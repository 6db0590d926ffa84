"""The doll as Blender objects: an armature, its body, and a shirt that is not set up yet."""

from __future__ import annotations

import math

import bpy
import numpy as np
from armatures import armature_of
from dolls import Doll
from mathutils import Matrix
from skeletons import CONVENTIONS


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


def leave_as_imported(convention: str = "Mixamo") -> None:
    """Turn the figure into what Blender makes of another program's file: its bone names, centimetres, y up, the meshes
    children of the armature, which undoes that by its own scale and turn."""
    armature = bpy.data.objects["Figure"]
    for part, name in CONVENTIONS[convention].items():
        if part in armature.data.bones:
            # The vertex groups follow.
            armature.data.bones[part].name = name
    to_world = Matrix.Rotation(math.pi / 2, 4, "X") @ Matrix.Scale(0.01, 4)
    for ob in (armature, bpy.data.objects["body"], bpy.data.objects["shirt"]):
        ob.data.transform(to_world.inverted())
        ob.parent = None if ob == armature else armature
    armature.matrix_world = to_world
    bpy.context.view_layer.update()
