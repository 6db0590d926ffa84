"""Which garments nobody sees, so that nothing is played for them: hidden ones, and those that a render leaves out."""

from __future__ import annotations

import bpy
import numpy as np

from .node_group import find_modifier

FULL_DETAIL = "FULL"
"""Of what a viewport or a render may show of a garment, all."""


def is_culled(garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether Cycles will cull a garment because the camera does not see it.

    As Cycles decides it (intern/cycles/blender/object_cull.cpp): by the corners of the bounding box, where both scene
    and object ask for it, in frustums of one eye. What is culled stays skinned, so Cycles decides on the same box.

    Args:
        garment: The original object.
        depsgraph: A render's; a viewport culls nothing here.
    """
    scene = depsgraph.scene_eval
    if depsgraph.mode != "RENDER" or scene.render.engine != "CYCLES" or not scene.render.use_simplify:
        return False
    camera, evaluated = scene.camera, garment.evaluated_get(depsgraph)
    if camera is None or camera.type != "CAMERA" or camera.data.type == "PANO" or scene.render.use_multiview:
        return False
    if not (scene.cycles.use_camera_cull and evaluated.cycles.use_camera_cull):
        return False
    if scene.cycles.use_distance_cull and evaluated.cycles.use_distance_cull:
        # Then an object goes only if it is far away as well.
        return False
    return _is_outside(evaluated, camera, depsgraph, scene.cycles.camera_cull_margin)


def _is_outside(
    evaluated: bpy.types.Object, camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph, margin: float
) -> bool:
    """Whether no corner of the bounding box comes near the picture, which goes from -1 to 1 here."""
    render = depsgraph.scene_eval.render
    projection = camera.evaluated_get(depsgraph).calc_matrix_camera(
        depsgraph,
        x=render.resolution_x,
        y=render.resolution_y,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    to_clip = np.array(projection @ camera.matrix_world.normalized().inverted() @ evaluated.matrix_world)
    corners = np.concatenate([np.array(evaluated.bound_box), np.ones((8, 1))], 1) @ to_clip.T
    if np.any(corners[:, 3] <= 0.0):
        # Partly or wholly behind the camera, where projections turn over: left to Cycles.
        return False
    places = 0.5 + 0.5 * corners[:, :2] / corners[:, 3:]
    return bool(np.any(places.min(0) >= 1.0 + margin) or np.any(places.max(0) <= -margin))


def is_shown(garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether its own eye and that of its modifier are open; a garment without one will get one."""
    modifier = find_modifier(garment)
    if depsgraph.mode == "RENDER":
        return modifier is None or modifier.show_render
    if modifier is not None and not modifier.show_viewport:
        return False
    return not garment.hide_get(view_layer=depsgraph.view_layer) or _is_needed(garment)


def _is_needed(garment: bpy.types.Object) -> bool:
    """Whether another object follows a garment that is hidden, by a modifier or a constraint."""
    return any(isinstance(user, bpy.types.Object) for user in bpy.data.user_map(subset=[garment])[garment])
