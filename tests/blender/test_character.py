"""What is read of a garment object."""

from __future__ import annotations

import bpy
import numpy as np
from dolls import doll
from figures import build_figure
from small_character import empty_scene
from wrinkle_synthesis.wrinkle_addon.blender.armature import read_rig
from wrinkle_synthesis.wrinkle_addon.blender.character import read_garment, rig_from_world
from wrinkle_synthesis.wrinkle_addon.blender.setup import setup_garment

FIGURE = doll(31, 12)


def test_the_warp_is_read_from_the_uv_map_where_the_fabric_has_a_direction() -> None:
    empty_scene()
    build_figure(FIGURE)
    shirt = setup_garment(bpy.data.objects["shirt"], bpy.data.objects["body"], None, 0).garment
    armature = shirt.wrinkles.armature
    rig, to_rig = read_rig(armature), rig_from_world(armature)
    assert read_garment(shirt, rig, to_rig, directed=True).warp is None
    # A pattern that is the shirt seen from the front, lying on its side: V runs along x.
    layer = shirt.data.uv_layers.new(name="UVMap")
    for loop in shirt.data.loops:
        x, y, z = shirt.data.vertices[loop.vertex_index].co
        layer.data[loop.index].uv = (z + 0.3 * y, x)
    warp = read_garment(shirt, rig, to_rig, directed=True).warp
    assert warp is not None and warp.shape == (len(shirt.data.loop_triangles), 3)
    assert read_garment(shirt, rig, to_rig).warp is None
    # Along the warp V grows, and U stays what it is; texture coordinates are single precision.
    assert (warp[:, 0] > 0.0).all()
    assert np.abs(warp @ [0.0, 0.3, 1.0]).max() < 1e-4
