"""Shapes of the sleeve side by side, from one camera, by Cycles."""

# pyright: reportMissingImports=false
from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from sleeve import Case, Faces, FloatArray
from wrinkle_synthesis.demo.picture import compose
from wrinkle_synthesis.demo.rendering import quiet

SIZE, SAMPLES, FIELD = (460, 400), 40, 28.0
"""Pixels, rays a pixel, and the angle of view [degrees]."""
VIEWS = {"from the side": (0.03, -0.85, 0.33), "into the elbow": (-0.42, -0.25, 0.78)}
"""Where the camera stands [m]."""
TARGET = (0.02, 0.0, 0.055)
CLOTH, SKIN, AIR = (0.16, 0.30, 0.52), (0.62, 0.44, 0.36), (0.30, 0.31, 0.33)
LIGHTS = (((-0.6, -0.5, 0.9), 0.25, 9.0), ((0.9, -0.6, 0.2), 1.0, 2.0))
"""Direction, size [m] and power [W]; the first one rakes along the sleeve."""


def draw(case: Case, shapes: Mapping[str, FloatArray], path: Path) -> None:
    """Draw the shapes, each in a column with its name above, into one picture: .png or .jpg."""
    columns = list(enumerate(shapes.values()))
    with tempfile.TemporaryDirectory() as folder:
        rows = [
            [_render(case, shape, camera, Path(folder) / f"{row}{column}.png") for column, shape in columns]
            for row, camera in enumerate(VIEWS.values())
        ]
        compose(rows, list(shapes), [[view] + [""] * (len(shapes) - 1) for view in VIEWS], path)


def _render(case: Case, shape: FloatArray, camera: tuple[float, float, float], path: Path) -> Path:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _add_mesh("cloth", shape, case.faces, CLOTH)
    _add_mesh("arm", case.body(math.inf), case.body_faces, SKIN)
    _light_and_aim(scene, camera)
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", SAMPLES, True
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(path)
    with quiet():
        bpy.ops.render.render(write_still=True)
    return path


def _add_mesh(name: str, positions: FloatArray, faces: Faces, colour: tuple[float, float, float]) -> None:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(positions.tolist(), [], faces.tolist())
    mesh.shade_smooth()
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = 0.85
    mesh.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))


def _light_and_aim(scene: bpy.types.Scene, place: tuple[float, float, float]) -> None:
    scene.world = bpy.data.worlds.new("air")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*AIR, 1.0)
    camera = bpy.data.cameras.new("camera")
    camera.angle = math.radians(FIELD)
    scene.camera = _add(scene, camera, place, "-Z")
    for direction, size, power in LIGHTS:
        light = bpy.data.lights.new("light", "AREA")
        light.size, light.energy = size, power
        _add(scene, light, tuple(np.add(TARGET, direction)), "-Z")


def _add(scene: bpy.types.Scene, data: bpy.types.ID, place: tuple[float, ...], forward: str) -> bpy.types.Object:
    ob = bpy.data.objects.new(data.name, data)
    scene.collection.objects.link(ob)
    ob.location = place
    ob.rotation_euler = (Vector(TARGET) - Vector(place)).to_track_quat(forward, "Y").to_euler()
    return ob
