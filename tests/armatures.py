"""Armature objects for the tests that run in Blender."""

from __future__ import annotations

import bpy
from wrinkle_synthesis.wrinkle_addon.rig import Rig


def armature_of(rig: Rig, connect: bool = False) -> bpy.types.Object:
    """An armature object "Figure" with the rig's bones; with ``connect``, those that touch their parents hang on."""
    armature = bpy.data.objects.new("Figure", bpy.data.armatures.new("Figure"))
    bpy.context.scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for row, name in enumerate(rig.names):
        bone = armature.data.edit_bones.new(name)
        bone.head, bone.tail = rig.heads[row], rig.tails[row]
        if rig.parents[row] >= 0:
            bone.parent = armature.data.edit_bones[rig.names[rig.parents[row]]]
            bone.use_connect = connect and (bone.parent.tail - bone.head).length < 1e-6
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def evaluated(armature: bpy.types.Object) -> bpy.types.Object:
    """The armature as the dependency graph sees it now."""
    return armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
