"""The demo's studio: files in which the dressed character moves before a backdrop, lit, a camera going along."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..wrinkle_addon.pc2 import PointCache

FloatArray = NDArray[np.float64]

CACHE_MODIFIER = "Wrinkle Cache"
STAGE = "Stage"
# Area lights: direction from the character, which looks along -y; size as a share of the distance; power [W] at 1 m.
# The key rakes along the cloth, so that every fold casts a shadow.
LIGHTS = {
    "key": ((-1.0, -0.25, 0.6), 0.15, 20.0),
    "fill": ((0.9, -1.0, 0.3), 1.2, 1.5),
    "rim": ((0.9, 0.6, 0.9), 0.4, 9.0),
}
VIEW_FROM = (0.45, -1.0, 0.12)
LIGHT_DISTANCE = 3.0
AMBIENT = (0.12, 0.125, 0.135)
# The backdrop's wall stands this far behind, joined to the floor by a bend of this radius; its half width [m].
WALL, BEND, WIDTH = 2.0, 1.5, 8.0
# Linear colours and roughness.
SKIN = ((0.40, 0.30, 0.25), 0.55)
LEGGINGS = ((0.028, 0.03, 0.036), 0.7)
CLOTH = ((0.10, 0.22, 0.30), 0.9)
CLOTH_BENEATH = ((0.30, 0.24, 0.17), 0.9)
BANDS = ((0.06, 0.14, 0.20), 0.9)
GROUND = ((0.30, 0.30, 0.31), 0.9)
ARM_PARTS = ("arm", "hand", "finger", "thumb")
# Leggings reach from above the ankles to the waist, which the shirt covers, as shares of the body's height.
LEGGINGS_HEIGHTS = (0.055, 0.62)
# Skin is left out if it is this near to the cloth, and the cloth there this far from its edges [m].
COVERED, COVER_REACH, COVER_EDGE = "under cloth", 0.06, 0.05
# Room around what is shown, as a share of its size.
MARGIN = 1.06
# Of the head, so much is shown above the cloth [m].
HEADROOM = 0.22
PICTURE_SIZE = (720, 800)
# The camera follows the character as softly as the mean over this many frames to either side.
FOLLOW = 4


def make_skinned(scene_path: Path, garment: str, path: Path) -> None:
    """Save a copy of a scene in which the garment's wrinkles have no strength."""
    open_garment(scene_path, garment).wrinkles.strength = 0.0
    save(path)


def make_live(scene_path: Path, garment: str, cache: Path, path: Path) -> None:
    """Save a copy of a scene, lit and framed, in which the add-on plays the garment's database.

    Args:
        cache: Where the garment goes, for the camera.
    """
    shown = open_garment(scene_path, garment)
    _furnish(shown, cache)
    shown.wrinkles.enabled = True
    save(path)


def make_playback(scene_path: Path, garment: str, cache: Path, path: Path) -> None:
    """Save a copy of a scene, lit and framed, in which a point cache plays the garment, with or without the add-on."""
    shown = open_garment(scene_path, garment)
    _furnish(shown, cache)
    # The cache's path is stored relative to the file, which must have its place first.
    save(path)
    show_cache(shown, cache)
    save(path)


def open_garment(scene_path: Path, garment: str) -> Any:
    """The garment in a freshly opened file, with the add-on's properties known to Blender."""
    import bpy

    if not hasattr(bpy.types.Object, "wrinkles"):
        from .. import register

        register()
    bpy.ops.wm.open_mainfile(filepath=str(scene_path.resolve()))
    return bpy.data.objects[garment]


def save(path: Path) -> None:
    import bpy

    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), compress=True)


def _furnish(garment: Any, cache: Path) -> None:
    import bpy

    dress_body(garment.wrinkles.body, garment)
    _dress_garment(garment)
    light_and_follow(bpy.context.scene, cache, rest_positions(garment))
    garment.wrinkles.armature.hide_viewport = True


def show_cache(garment: Any, cache: Path) -> None:
    """Let a point cache, and nothing else, move the garment."""
    import bpy

    modifier = garment.modifiers.get(CACHE_MODIFIER)
    if modifier is None:
        garment.modifiers.clear()
        modifier = garment.modifiers.new(CACHE_MODIFIER, "MESH_CACHE")
        modifier.cache_format, modifier.deform_mode, modifier.play_mode = "PC2", "OVERWRITE", "SCENE"
        modifier.forward_axis, modifier.up_axis = "POS_Y", "POS_Z"
    modifier.filepath = bpy.path.relpath(str(cache.resolve()))
    modifier.frame_start = PointCache(cache).start


def show_shape(garment: Any, positions: NDArray[np.float32], faces: NDArray[np.int32]) -> None:
    """Let the garment be one shape, of whatever mesh, that nothing moves; in the garment's object space."""
    import bpy

    mesh = bpy.data.meshes.new(garment.name)
    mesh.from_pydata(positions.tolist(), [], faces.tolist())
    mesh.shade_smooth()
    mesh.materials.append(_material("cloth", CLOTH))
    garment.modifiers.clear()
    garment.data = mesh


def paint_vertices(garment: Any, colours: NDArray[np.float32]) -> None:
    """Let the garment shine in a colour of its own at every vertex, whatever the light; shape [vertex_count, 4]."""
    import bpy

    layer = garment.data.color_attributes.new("shown", "FLOAT_COLOR", "POINT")
    layer.data.foreach_set("color", colours.astype(np.float32).ravel())
    material = bpy.data.materials.get("colours") or bpy.data.materials.new("colours")
    material.use_nodes = True
    tree: Any = material.node_tree
    tree.nodes.clear()
    read, shine = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeEmission")
    read.attribute_name = layer.name
    tree.links.new(read.outputs["Color"], shine.inputs["Color"])
    tree.links.new(shine.outputs["Emission"], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    garment.data.materials[0] = material


def rest_positions(garment: Any) -> FloatArray:
    """The garment's modelled shape in world space, shape [vertex_count, 3]."""
    positions = np.empty(3 * len(garment.data.vertices), np.float32)
    garment.data.vertices.foreach_get("co", positions)
    world = np.array(garment.matrix_world, np.float64)
    return positions.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]


def dress_body(body: Any, garment: Any) -> None:
    """Paint leggings on the body, and leave out the skin that the garment covers, as productions do.

    Args:
        body: The body object.
        garment: The garment object.
    """
    _paint(body, SKIN)
    body.data.materials.append(_material("leggings", LEGGINGS))
    world = np.array(body.matrix_world, np.float64)
    skin = np.array([vertex.co for vertex in body.data.vertices]) @ world[:3, :3].T + world[:3, 3]
    arms = {group.index for group in body.vertex_groups if any(part in group.name.lower() for part in ARM_PARTS)}
    is_arm = np.array([any(g.group in arms and g.weight > 0.3 for g in v.groups) for v in body.data.vertices])
    low, high = LEGGINGS_HEIGHTS[0] * skin[:, 2].max(), LEGGINGS_HEIGHTS[1] * skin[:, 2].max()
    is_leg = ~is_arm & (skin[:, 2] > low) & (skin[:, 2] < high)
    for face in body.data.polygons:
        face.material_index = int(all(is_leg[i] for i in face.vertices))
    group = body.vertex_groups.new(name=COVERED)
    group.add(np.flatnonzero(_is_covered(skin, garment)).tolist(), 1.0, "REPLACE")
    mask = body.modifiers.new("Skin under cloth", "MASK")
    mask.vertex_group, mask.invert_vertex_group = COVERED, True
    # In renders alone, so that the body in the viewport, which bakes are made on, stays whole.
    mask.show_viewport = False


def _is_covered(skin: FloatArray, garment: Any) -> NDArray[np.bool_]:
    """Which points of the skin lie under the garment, away from its edges; shape [point_count]."""
    from scipy.spatial import KDTree

    cloth = rest_positions(garment)
    sides = np.array([loop.edge_index for loop in garment.data.loops])
    ends = np.array([edge.vertices[:] for edge in garment.data.edges])
    rim = cloth[np.unique(ends[np.bincount(sides, minlength=len(ends)) == 1])]
    distance, nearest = KDTree(cloth).query(skin)
    return (distance < COVER_REACH) & (KDTree(rim).query(cloth)[0][nearest] > COVER_EDGE)


def _dress_garment(garment: Any) -> None:
    """Paint the garment, its ribbed bands darker, and otherwise what was joined to it and is worn beneath."""
    _paint(garment, CLOTH)
    for slot in range(1, len(garment.data.materials)):
        garment.data.materials[slot] = _material("cloth beneath", CLOTH_BENEATH)
    bands = garment.vertex_groups.get(garment.wrinkles.pin_group)
    if bands is None:
        return
    garment.data.materials.append(_material("bands", BANDS))
    in_band = [any(e.group == bands.index for e in vertex.groups) for vertex in garment.data.vertices]
    for face in garment.data.polygons:
        if all(in_band[i] for i in face.vertices):
            face.material_index = len(garment.data.materials) - 1


def _paint(thing: Any, look: tuple[tuple[float, float, float], float]) -> None:
    thing.data.materials[0] = _material(f"{thing.name} studio", look)


def _material(name: str, look: tuple[tuple[float, float, float], float]) -> Any:
    import bpy

    colour, roughness = look
    material = bpy.data.materials.get(name) or bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    material.diffuse_color = (*colour, 1.0)
    tree: Any = material.node_tree
    shader = tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Specular IOR Level"].default_value = 0.25
    return material


# --- a camera that goes along -------------------------------------------------------------------------------------


def light_and_follow(scene: Any, cache: Path, rest: FloatArray) -> None:
    """Put lights, floor and camera on a stage that goes with the character, facing it from where it mostly looks."""
    import bpy

    frames = PointCache(cache)
    centres, heading = _follow(np.asarray(frames.frames, np.float64), rest)
    stage = bpy.data.objects.new(STAGE, None)
    scene.collection.objects.link(stage)
    stage.rotation_euler = (0.0, 0.0, heading)
    for number, centre in enumerate(centres):
        stage.location = centre
        stage.keyframe_insert("location", frame=frames.start + number)
    for thing in [thing for thing in scene.objects if thing.type in ("LIGHT", "CAMERA")]:
        bpy.data.objects.remove(thing)
    for name, (direction, extent, power) in LIGHTS.items():
        light = bpy.data.lights.new(name, "AREA")
        light.size, light.energy = extent * LIGHT_DISTANCE, power * LIGHT_DISTANCE**2
        _on_stage(scene, stage, name, light, direction, LIGHT_DISTANCE)
    camera = bpy.data.cameras.new("camera")
    camera.lens = 70.0
    scene.camera = _on_stage(scene, stage, "camera", camera, VIEW_FROM, 1.0)
    scene.render.resolution_x, scene.render.resolution_y = PICTURE_SIZE
    aim(scene, to_stage(np.asarray(frames.frames, np.float64) - centres[:, None], heading))
    _set_backdrop(scene, stage)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*AMBIENT, 1.0)


def _follow(frames: FloatArray, rest: FloatArray) -> tuple[FloatArray, float]:
    """Where the garment's middle is in every frame, softly, and which way it mostly turned from rest [rad]."""
    centres = 0.5 * (frames.min(1) + frames.max(1))
    # The ground stays where it is.
    centres[:, 2] = centres[:, 2].mean()
    padded = np.pad(centres, ((FOLLOW, FOLLOW), (0, 0)), mode="edge")
    soft = np.stack([padded[k : k + 2 * FOLLOW + 1].mean(0) for k in range(len(centres))])
    flat = rest[:, :2] - rest[:, :2].mean(0)
    turned = frames[:, :, :2] - frames[:, :, :2].mean(1, keepdims=True)
    sines = (flat[:, 0] * turned[..., 1] - flat[:, 1] * turned[..., 0]).sum(1)
    cosines = (flat * turned).sum((1, 2))
    length = np.hypot(sines, cosines)
    return soft, float(np.arctan2((sines / length).sum(), (cosines / length).sum()))


def _on_stage(scene: Any, stage: Any, name: str, data: Any, direction: Sequence[float], distance: float) -> Any:
    import bpy
    from mathutils import Vector

    thing = bpy.data.objects.new(name, data)
    scene.collection.objects.link(thing)
    thing.parent = stage
    away = Vector(direction).normalized()
    thing.location = distance * away
    thing.rotation_euler = away.to_track_quat("Z", "Y").to_euler()
    return thing


def to_stage(points: FloatArray, heading: float) -> FloatArray:
    """Points relative to the stage's place, along its axes, shape [point_count, 3]."""
    cosine, sine = np.cos(heading), np.sin(heading)
    return points.reshape(-1, 3) @ np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def aim(scene: Any, points: FloatArray) -> None:
    """Move the camera, as it is turned, so that the picture just holds what is shown and some of the head.

    Args:
        scene: A scene with a camera on a stage.
        points: What is shown, in the stage's space [m], shape [point_count, 3].
    """
    camera, render = scene.camera, scene.render
    turn = np.array(camera.rotation_euler.to_matrix(), np.float64)
    seen = points @ turn
    low, high = seen.min(0), seen.max(0)
    high[1] += HEADROOM
    aspect = render.resolution_x / render.resolution_y
    across = max(high[0] - low[0], (high[1] - low[1]) * aspect)
    # The sensor's width spans the longer side of the picture.
    distance = MARGIN * across * camera.data.lens / (camera.data.sensor_width * min(1.0, aspect))
    camera.location = turn @ (0.5 * (low + high)) + distance * turn[:, 2]


def _set_backdrop(scene: Any, stage: Any) -> None:
    """A floor that sweeps up into a wall behind the character."""
    import bpy

    turns = np.linspace(0.0, 0.5 * np.pi, 13)
    sweep = [(WALL + BEND * np.sin(turn), BEND * (1.0 - np.cos(turn))) for turn in turns]
    profile = [(-WIDTH, 0.0), *sweep, (WALL + BEND, WIDTH)]
    # The sweep stands across the camera's line of sight.
    along = -np.array(VIEW_FROM[:2]) / np.hypot(*VIEW_FROM[:2])
    across = np.array([along[1], -along[0]])
    vertices = [(*(side * WIDTH * across + far * along), up) for far, up in profile for side in (-1.0, 1.0)]
    mesh = bpy.data.meshes.new("backdrop")
    mesh.from_pydata(vertices, [], [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(len(profile) - 1)])
    mesh.shade_smooth()
    mesh.materials.append(_material("backdrop", GROUND))
    backdrop = bpy.data.objects.new("backdrop", mesh)
    scene.collection.objects.link(backdrop)
    backdrop.parent = stage
    backdrop.location = (0.0, 0.0, -stage.location.z)
