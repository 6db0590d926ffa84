"""The scene that benchmarks in Blender share: the demo's character, a garment on it, a spin kick, and its rivals."""

# pyright: reportMissingImports=false
from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import wrinkle_synthesis
from outfit import Outfit, make_plan, spin_kick, write_database
from wrinkle_synthesis.demo.scene import build_character
from wrinkle_synthesis.wrinkle_addon.blender import handlers
from wrinkle_synthesis.wrinkle_addon.blender.armature import apply_motion, read_rig
from wrinkle_synthesis.wrinkle_addon.blender.character import read_garment, rig_from_world
from wrinkle_synthesis.wrinkle_addon.blender.setup import bind_to_armature, write_weights
from wrinkle_synthesis.wrinkle_addon.joints import find_joints
from wrinkle_synthesis.wrinkle_addon.pc2 import write_pc2
from wrinkle_synthesis.wrinkle_addon.rig import FloatArray

TUNED_DISTANCES = (0.004, 0.002)
"""How far Blender's Cloth stays from the body and from itself [m], set by someone who knows what it costs.

Its own 15 mm are as much as a shirt's ease and three of its edges: everything touches everything.
"""


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene with a moving character.

    Attributes:
        outfit: What the character wears.
        armature, body: Its objects.
        garments: Objects of the same garment, by what they show; one at a time is to be seen.
        frame_count: Frames of the motion, from 1 on.
    """

    outfit: Outfit
    armature: bpy.types.Object
    body: bpy.types.Object
    garments: dict[str, bpy.types.Object]
    frame_count: int

    def add_garment(self, name: str) -> bpy.types.Object:
        """Another object of the garment, skinned to the armature, with a mesh of its own."""
        garment, rig = self.outfit.garment, self.outfit.rig
        if self.garments:
            ob = next(iter(self.garments.values())).copy()
            ob.data = ob.data.copy()
            for modifier in list(ob.modifiers)[1:]:
                ob.modifiers.remove(modifier)
            ob.wrinkles.enabled = False
        else:
            mesh = bpy.data.meshes.new(name)
            mesh.from_pydata(garment.positions.tolist(), [], garment.faces.tolist())
            mesh.shade_smooth()
            ob = bpy.data.objects.new(name, mesh)
            ob.parent = self.armature
            write_weights(ob, rig, garment.weights)
            bind_to_armature(ob, self.armature)
        ob.name = name
        bpy.context.scene.collection.objects.link(ob)
        self.garments[name] = ob
        bpy.context.view_layer.update()
        return ob

    def add_wrinkles(
        self, name: str, database: Path, formulation: str = "OFFSETS", *, clear: bool = False
    ) -> bpy.types.Object:
        """A garment that plays a database, and is kept clear of the body if ``clear`` says so."""
        ob = self.add_garment(name)
        settings = ob.wrinkles
        settings.armature, settings.body = self.armature, self.body
        settings.joints.clear()
        for joint in self.outfit.joints:
            settings.joints.add().store(joint)
        settings.database, settings.formulation = str(database), formulation
        settings.clear_of_body = clear
        settings.enabled = True
        return ob

    def bake(self, folder: Path, *, quick: bool) -> Path:
        """A database of formulas of the garment, as it is in the scene."""
        rig = read_rig(self.armature)
        outfit = self.outfit
        garment = read_garment(self.add_garment("skinned"), rig, rig_from_world(self.armature))
        path = folder / "garment.wrinkles"
        write_database(rig, garment, outfit.body, make_plan(outfit.joints, quick=quick), path)
        return path

    def show(self, name: str | None) -> None:
        """Let one of the garments be seen, or none, in an animation that a window would play from now on."""
        handlers.begin_animation()
        for other, ob in self.garments.items():
            ob.hide_viewport = other != name

    def play(self, frame: int) -> FloatArray | None:
        """Go to a frame; returns the positions of the garment that is seen, as Blender evaluates it."""
        bpy.context.scene.frame_set(frame)
        shown = next((ob for ob in self.garments.values() if not ob.hide_viewport), None)
        if shown is None:
            return None
        mesh = shown.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        positions = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.attributes["position"].data.foreach_get("vector", positions)
        return positions.reshape(-1, 3)

    def frames(self, count: int) -> list[int]:
        """Frames spread over the motion."""
        return np.linspace(1, self.frame_count, count).astype(int).tolist()


def open_stage(outfit: Outfit) -> Stage:
    """Build the scene, in place of whatever is open; registers the add-on first, if it is not yet."""
    if not hasattr(bpy.types.Object, "wrinkles"):
        wrinkle_synthesis.register()
    with tempfile.TemporaryDirectory() as folder:
        build_character(Path(folder) / "character.blend", garments=())
    armature, body = bpy.data.objects["Rig"], bpy.data.objects["body"]
    rig = read_rig(armature)
    # Blender may list the bones in another order.
    order = [outfit.rig.index[name] for name in rig.names]
    dense = outfit.garment.weights.to_dense(outfit.rig.bone_count)[:, order]
    names = {joint.name for joint in outfit.joints}
    outfit = outfit.on_rig(
        rig, dense, outfit.body.weights[:, order], [j for j in find_joints(rig).found if j.name in names]
    )
    poses = spin_kick(rig)
    apply_motion(armature, rig, poses)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, len(poses)
    return Stage(outfit, armature, body, {}, len(poses))


# --- rivals -------------------------------------------------------------------------------------------------------


def add_cloth(
    stage: Stage, name: str, *, quality: int, self_collision: bool = False, distances: tuple[float, float] | None = None
) -> bpy.types.Object:
    """A garment that Blender's own Cloth modifier simulates, starting from the skinned shape.

    Args:
        quality: Steps a frame.
        distances: From the body and from itself [m]; Blender's own if left out.
    """
    ob = stage.add_garment(name)
    modifier = ob.modifiers.new("Cloth", "CLOTH")
    modifier.settings.quality = quality
    modifier.collision_settings.use_self_collision = self_collision
    if distances is not None:
        modifier.collision_settings.distance_min, modifier.collision_settings.self_distance_min = distances
    modifier.point_cache.frame_start, modifier.point_cache.frame_end = 1, stage.frame_count
    return ob


def simulate_cloth(stage: Stage, name: str, frame_count: int) -> list[float]:
    """Seconds that Blender takes for each frame of a Cloth garment after the first, in order."""
    stage.show(name)
    # Costs time in every frame, so only while there is any Cloth.
    collision = stage.body.modifiers.new("Collision", "COLLISION")
    stage.body.collision.thickness_outer = stage.garments[name].modifiers["Cloth"].collision_settings.distance_min
    stage.play(1)
    seconds = []
    for frame in range(2, 2 + frame_count):
        started = time.perf_counter()
        stage.play(frame)
        seconds.append(time.perf_counter() - started)
    stage.body.modifiers.remove(collision)
    return seconds


def add_shape_keys(stage: Stage, name: str, count: int, bones: Sequence[str]) -> bpy.types.Object:
    """A garment with dense native shape keys, each driven by the rotation of a bone and never zero."""
    ob = stage.add_garment(name)
    ob.shape_key_add(name="Basis")
    rest = stage.outfit.garment.positions
    for number in range(count):
        key = ob.shape_key_add(name=f"wrinkle {number}")
        moved = rest + 0.0005 * np.sin(40.0 * rest + number)
        key.points.foreach_set("co", moved.astype(np.float32).ravel())
        driver = key.driver_add("value").driver
        driver.type, driver.expression = "SCRIPTED", "0.3 + 0.1 * turn"
        variable = driver.variables.new()
        variable.name, variable.type = "turn", "TRANSFORMS"
        target = variable.targets[0]
        target.id, target.bone_target = stage.armature, bones[number % len(bones)]
        target.transform_type, target.transform_space = "ROT_X", "LOCAL_SPACE"
    return ob


def add_point_cache(stage: Stage, name: str, source: str, path: Path, frames: range) -> bpy.types.Object:
    """A garment that plays back what another one showed, from a file of all its positions."""
    stage.show(source)
    recorded = (positions for frame in frames if (positions := stage.play(frame)) is not None)
    write_pc2(path, stage.outfit.garment.vertex_count, frames.start, recorded, len(frames))
    ob = stage.add_garment(name)
    modifier = ob.modifiers.new("Cache", "MESH_CACHE")
    modifier.cache_format, modifier.filepath = "PC2", str(path)
    modifier.frame_start = frames.start
    return ob
