"""The demo's .blend file: a rigged, dressed character, lit and framed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..wrinkle_addon.garment import Body, SkinWeights, skin_garment
from .character import Build, Character, load_character, mirrored_bones
from .garment import Garment, make_garment

FloatArray = NDArray[np.float64]

PIN_GROUP = "bands"
"""Vertex group of a garment's ribbed bands, which are held to the skin."""

# Linear colours and roughness of the materials.
MATERIALS = {
    "body": ((0.42, 0.27, 0.21), 0.55),
    "shirt": ((0.075, 0.17, 0.33), 0.8),
    "tshirt": ((0.45, 0.43, 0.40), 0.8),
    "trousers": ((0.055, 0.06, 0.08), 0.75),
    "cropped": ((0.055, 0.06, 0.08), 0.75),
}
# Area lights: direction from the character, size as a share of the distance, power [W] at 1 m.
LIGHTS = {
    "key": ((-1.0, -0.7, 0.7), 0.4, 11.0),
    "fill": ((1.0, -0.8, 0.1), 0.8, 2.0),
    "rim": ((0.6, 1.0, 0.8), 0.4, 12.0),
}
VIEW_FROM = (-0.35, -1.0, 0.08)
PICTURE_SIZE = (600, 800)
# Room around the character at rest, for raised arms and a step aside.
MARGIN = 1.25
FRAMES_PER_SECOND = 30


def build_character(
    path: Path,
    sex: str = "male",
    garments: Sequence[str] = ("shirt",),
    vertex_count: int = 12_000,
    rig: str = "cmu_mb",
) -> Path:
    """Write a .blend file with the demo's character, replacing whatever is open in Blender.

    It holds the objects ``Rig``, ``body`` and one for each garment by its name, all skinned to the rig, three lights
    and a camera that frames the garments.

    Args:
        path: The file to write.
        sex: "male" or "female".
        garments: Names from :data:`.garment.GARMENTS`.
        vertex_count: About how many vertices each garment gets.
        rig: "cmu_mb" or "game_engine".

    Returns:
        The path.

    Raises:
        ValueError: If a name is not known or a garment cannot be made.
        PackageError: If the character's package cannot be had.
    """
    import bpy

    character = load_character(Build(sex), rig)
    made = [make_garment(character, name, vertex_count) for name in garments]
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    armature = _add_armature(character)
    _add_body(character, armature)
    for garment in made:
        _add_garment(character, garment, armature)
    _light_and_frame(made, character)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), compress=True)
    return path


def _add_armature(character: Character) -> Any:
    import bpy
    from mathutils import Matrix, Vector

    rig = character.rig
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    bones = []
    for name, parent, rest, length in zip(rig.names, rig.parents, rig.rest, rig.lengths, strict=True):
        bone = armature.data.edit_bones.new(name)
        bone.tail = Vector((0.0, float(length), 0.0))
        bone.matrix = Matrix(rest.tolist())
        bone.parent = bones[parent] if parent >= 0 else None
        bones.append(bone)
    bpy.ops.object.mode_set(mode="OBJECT")
    armature.data.display_type = "STICK"
    armature.show_in_front = True
    return armature


def _add_body(character: Character, armature: Any) -> None:
    body = character.body
    mesh = _new_mesh("body", body.vertices, body.quads)
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", body.uvs.reshape(-1).astype(np.float32))
    _add_skinned(mesh, character, SkinWeights.from_dense(character.weights), armature)


def _add_garment(character: Character, garment: Garment, armature: Any) -> None:
    mesh = _new_mesh(garment.name, garment.vertices, garment.triangles)
    body = Body(character.body.vertices, character.body.triangles.astype(np.int32), character.weights)
    weights = skin_garment(garment.vertices, garment.triangles.astype(np.int32), body).to_dense(
        character.rig.bone_count
    )
    # Cloth in the middle is as near to the left as to the right: it follows both.
    weights += weights[garment.mirror][:, mirrored_bones(character.rig)]
    worn = _add_skinned(mesh, character, SkinWeights.from_dense(weights), armature)
    strengths = garment.held
    held = worn.vertex_groups.new(name=PIN_GROUP)
    for vertex in np.flatnonzero(strengths):
        held.add([int(vertex)], float(strengths[vertex]), "REPLACE")


def _new_mesh(name: str, vertices: FloatArray, faces: NDArray[np.int64]) -> Any:
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    mesh.shade_smooth()
    mesh.materials.append(_new_material(name))
    return mesh


def _new_material(name: str) -> Any:
    import bpy

    colour, roughness = MATERIALS[name]
    material = bpy.data.materials.new(name)
    _use_nodes(material)
    material.diffuse_color = (*colour, 1.0)
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    if name != "body":
        shader.inputs["Sheen Weight"].default_value = 0.15
    return material


def _use_nodes(owner: Any) -> None:
    # From Blender 5.0 on nodes are always used, and saying so is deprecated.
    if owner.node_tree is None:
        owner.use_nodes = True


def _add_skinned(mesh: Any, character: Character, weights: SkinWeights, armature: Any) -> Any:
    import bpy

    from ..wrinkle_addon.blender.setup import bind_to_armature, write_weights

    skinned = bpy.data.objects.new(mesh.name, mesh)
    bpy.context.scene.collection.objects.link(skinned)
    skinned.parent = armature
    write_weights(skinned, character.rig, weights)
    bind_to_armature(skinned, armature)
    return skinned


def _light_and_frame(garments: Sequence[Garment], character: Character) -> None:
    import bpy
    from mathutils import Vector

    # What is shown: all of the body that is not below the garments.
    lowest = min((float(garment.vertices[:, 2].min()) for garment in garments), default=0.0)
    shown = character.body.vertices[character.body.vertices[:, 2] > lowest - 0.1]
    low, high = shown.min(0), shown.max(0)
    centre, (width, _, height) = 0.5 * (low + high), high - low
    size = float(max(width, height))
    scene = bpy.context.scene

    def place(name: str, data: Any, direction: Sequence[float], distance: float) -> Any:
        thing = bpy.data.objects.new(name, data)
        scene.collection.objects.link(thing)
        away = Vector(direction).normalized()
        thing.location = Vector(centre) + distance * away
        thing.rotation_euler = away.to_track_quat("Z", "Y").to_euler()
        return thing

    for name, (direction, extent, power) in LIGHTS.items():
        distance = 2.0 * size
        light = bpy.data.lights.new(name, "AREA")
        light.size = extent * distance
        light.energy = power * distance**2
        place(name, light, direction, distance)

    camera = bpy.data.cameras.new("camera")
    camera.lens = 85.0
    scene.render.resolution_x, scene.render.resolution_y = PICTURE_SIZE
    # The sensor's width spans the longer side of the picture.
    across = max(height, width * PICTURE_SIZE[1] / PICTURE_SIZE[0])
    distance = MARGIN * float(across) * camera.lens / camera.sensor_width
    scene.camera = place("camera", camera, VIEW_FROM, distance)

    scene.world = bpy.data.worlds.new("world")
    _use_nodes(scene.world)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.09, 0.095, 0.105, 1.0)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 16
    scene.render.fps = FRAMES_PER_SECOND
    scene.view_settings.view_transform = "AgX"
