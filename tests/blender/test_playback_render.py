"""Renders show the frame that they are of, compared by pixels with a plain mesh of the expected shape."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import Arm, Bumps, build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon.blender.handlers import suspended
from wrinkle_synthesis.wrinkle_addon.rig import Pose

SIZE = 48
SAME = 0.005
"""Mean difference of two pictures of one shape: the database's tolerance moves edges by a hundredth of a pixel."""
DIFFERENT = 0.05
"""Mean difference that two poses, or wrinkles and skinning, have at least."""

ENGINES = ["CYCLES", "BLENDER_WORKBENCH"]


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def arm(bumps: Bumps, database: Path) -> Arm:
    """The arm from its side, black on white, so that a picture is a silhouette."""
    scene = empty_scene()
    arm = build_arm("", database)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 0.8
    scene.camera.location, scene.camera.rotation_euler = (0.3, -2.0, 0.2), (np.pi / 2, 0.0, 0.0)
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.film_transparent = True
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.frame_start, scene.frame_end = 1, 4
    return arm


def alpha(path: Path) -> np.ndarray:
    """How much of each pixel a picture covers, shape [SIZE, SIZE]."""
    image = bpy.data.images.load(str(path))
    pixels = np.array(image.pixels).reshape(SIZE, SIZE, 4)[:, :, 3]
    bpy.data.images.remove(image)
    return pixels


def render_still(path: Path) -> np.ndarray:
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return alpha(path)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference over the pixels that either picture covers at all."""
    covered = (a > 0.0) | (b > 0.0)
    return float(np.abs(a - b)[covered].mean())


def expected_picture(arm: Arm, positions: np.ndarray, path: Path) -> np.ndarray:
    """The same view of a plain mesh of these positions."""
    mesh = bpy.data.meshes.new("expected")
    quads = [list(polygon.vertices) for polygon in arm.sleeve.data.polygons]
    mesh.from_pydata(positions.tolist(), [], quads)
    plain = bpy.data.objects.new("expected", mesh)
    bpy.context.scene.collection.objects.link(plain)
    arm.sleeve.hide_render = True
    try:
        return render_still(path)
    finally:
        arm.sleeve.hide_render = False
        bpy.data.objects.remove(plain)


def bending(arm: Arm, start: int = 1) -> list[Pose]:
    return arm.animate([{"elbow_L": [angle]} for angle in (0.2, 0.7, 1.5, 1.1)], start)


def test_an_animation_render_shows_each_frame_in_its_own_pose(
    arm: Arm, bumps: Bumps, engine: str, tmp_path: Path
) -> None:
    scene = bpy.context.scene
    scene.render.engine = engine
    poses = bending(arm)
    scene.frame_set(3)
    scene.render.filepath = str(tmp_path / "frame-####")
    bpy.ops.render.render(animation=True)
    pictures = [alpha(tmp_path / f"frame-{frame:04}.png") for frame in range(1, 5)]
    for picture, pose in zip(pictures, poses, strict=True):
        assert difference(picture, expected_picture(arm, bumps.shape(pose), tmp_path / "expected.png")) < SAME
        plain = bumps.shape(pose, {"elbow_L": 0.0, "shoulder_L": 0.0})
        if pose is not poses[0]:
            assert difference(picture, expected_picture(arm, plain, tmp_path / "plain.png")) > DIFFERENT


def test_a_still_shows_the_frame_that_was_set_without_stepping_to_it(
    arm: Arm, bumps: Bumps, engine: str, tmp_path: Path
) -> None:
    scene = bpy.context.scene
    scene.render.engine = engine
    poses = bending(arm)
    for frame in (4, 2):
        scene.frame_current = frame
        picture = render_still(tmp_path / "still.png")
        assert (
            difference(picture, expected_picture(arm, bumps.shape(poses[frame - 1]), tmp_path / "expected.png")) < SAME
        )


RENDER = """
import os, sys
import bpy
import wrinkle_synthesis
wrinkle_synthesis.register()
path, out = sys.argv[1:]
bpy.ops.wm.open_mainfile(filepath=path)
assert [modifier.type for modifier in bpy.data.objects["sleeve"].modifiers] == ["ARMATURE"]
bpy.context.scene.render.filepath = out
bpy.ops.render.render(animation=True)
os._exit(0)
"""


def test_a_file_that_was_never_played_renders_the_same_in_a_fresh_process(arm: Arm, tmp_path: Path) -> None:
    """A farm's view: the modifier, the attribute and the mesh of its own come into being within the render."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    with suspended():
        bending(arm)
        twin = arm.sleeve.copy()
        scene.collection.objects.link(twin)
        twin.location.y = 0.3
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    assert arm.sleeve.data == twin.data
    arguments = [str(tmp_path / "arm.blend"), str(tmp_path / "fresh-####")]
    subprocess.run([sys.executable, "-c", RENDER, *arguments], check=True, timeout=120)
    scene.render.filepath = str(tmp_path / "here-####")
    bpy.ops.render.render(animation=True)
    for frame in range(1, 5):
        fresh, here = (alpha(tmp_path / f"{name}-{frame:04}.png") for name in ("fresh", "here"))
        np.testing.assert_array_equal(fresh, here)


def test_a_render_without_the_modifier_shows_the_skinned_garment(arm: Arm, tmp_path: Path) -> None:
    bpy.context.scene.render.engine = "CYCLES"
    bending(arm)
    bpy.context.scene.frame_set(3)
    played = render_still(tmp_path / "played.png")
    arm.sleeve.modifiers["Wrinkles"].show_render = False
    skinned = render_still(tmp_path / "skinned.png")
    arm.sleeve.modifiers.remove(arm.sleeve.modifiers["Wrinkles"])
    arm.sleeve.wrinkles.enabled = False
    assert difference(played, skinned) > DIFFERENT
    np.testing.assert_array_equal(skinned, render_still(tmp_path / "without.png"))


def test_motion_blur_takes_the_shapes_of_its_subframes(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    """With strengths keyed linearly on a held pose, a shape key keyed the same way must blur the same way."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 64
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    pose = arm.animate([{"elbow_L": [1.4]}] * 4)[0]
    shapes = [bumps.shape(pose, {"elbow_L": strength}) for strength in (0.0, 12.0)]
    for frame, strength in ((1, 0.0), (4, 12.0)):
        arm.sleeve.wrinkles.joints["elbow_L"].strength = strength
        arm.sleeve.wrinkles.joints["elbow_L"].keyframe_insert("strength", frame=frame)
    make_linear(arm.sleeve)
    scene.frame_set(2)
    blurred = render_still(tmp_path / "blurred.png")
    scene.render.use_motion_blur = False
    sharp = render_still(tmp_path / "sharp.png")
    scene.render.use_motion_blur = True
    expected = expected_blur(arm, shapes, tmp_path / "expected.png")
    assert difference(blurred, expected) < SAME
    assert difference(sharp, expected) > DIFFERENT


def make_linear(ob: bpy.types.Object) -> None:
    """Key values linearly."""
    strip = ob.animation_data.action.layers[0].strips[0]
    for curve in strip.channelbag(ob.animation_data.action_slot).fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"


def expected_blur(arm: Arm, shapes: Sequence[np.ndarray], path: Path) -> np.ndarray:
    """A picture of a shape key that goes from one shape to the other over frames 1 to 4."""
    mesh = bpy.data.meshes.new("expected")
    mesh.from_pydata(shapes[0].tolist(), [], [list(polygon.vertices) for polygon in arm.sleeve.data.polygons])
    plain = bpy.data.objects.new("expected", mesh)
    bpy.context.scene.collection.objects.link(plain)
    plain.shape_key_add(name="Basis")
    key = plain.shape_key_add(name="Key")
    key.points.foreach_set("co", shapes[1].astype(np.float32).ravel())
    for frame, value in ((1, 0.0), (4, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    animation = mesh.shape_keys.animation_data
    for curve in animation.action.layers[0].strips[0].channelbag(animation.action_slot).fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    arm.sleeve.hide_render = True
    return render_still(path)
