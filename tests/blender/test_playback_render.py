"""Renders show the frame that they are of, compared by pixels with a plain mesh of the expected shape."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
import pytest
from pictures import (
    DIFFERENT,
    EEVEE,
    SAME,
    alpha,
    bending,
    difference,
    expected_picture,
    filmed_arm,
    fresh_process,
    plain_mesh,
    render_animation,
    render_still,
)
from small_character import Arm, Bumps
from wrinkle_synthesis.wrinkle_addon.blender.handlers import suspended

ENGINES = ["CYCLES", "BLENDER_WORKBENCH", pytest.param(EEVEE, marks=pytest.mark.long)]
"""EEVEE compiles its shaders for half a minute."""


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def arm(bumps: Bumps, database: Path) -> Arm:
    return filmed_arm(database)


def test_an_animation_render_shows_each_frame_in_its_own_pose(
    arm: Arm, bumps: Bumps, engine: str, tmp_path: Path
) -> None:
    scene = bpy.context.scene
    scene.render.engine = engine
    poses = bending(arm)
    scene.frame_set(3)
    for picture, pose in zip(render_animation(tmp_path), poses, strict=True):
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
path, out, *frames = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.wm.open_mainfile(filepath=path)
assert [modifier.type for modifier in bpy.data.objects["sleeve"].modifiers] == ["ARMATURE"]
scene = bpy.context.scene
for frame in map(int, frames):
    scene.frame_set(frame)
    scene.render.filepath = f"{out}{frame}.png"
    bpy.ops.render.render(write_still=True)
os._exit(0)
"""


def test_a_file_that_was_never_played_renders_the_same_in_fresh_processes_and_in_reverse(
    arm: Arm, tmp_path: Path
) -> None:
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
    for frames in ((4, 2, 1), (3,)):
        command = fresh_process(RENDER, tmp_path / "arm.blend", tmp_path / "fresh-", *frames)
        subprocess.run(command, check=True, timeout=120)
    for frame, here in enumerate(render_animation(tmp_path), 1):
        np.testing.assert_array_equal(alpha(tmp_path / f"fresh-{frame}.png"), here)


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


@pytest.mark.parametrize("blurring", ["CYCLES", pytest.param(EEVEE, marks=pytest.mark.long)])
def test_motion_blur_takes_the_shapes_of_its_subframes(arm: Arm, bumps: Bumps, blurring: str, tmp_path: Path) -> None:
    """With strengths keyed linearly on a held pose, a shape key keyed the same way must blur the same way."""
    scene = bpy.context.scene
    scene.render.engine = blurring
    scene.cycles.samples = 64
    scene.eevee.taa_render_samples, scene.eevee.motion_blur_steps = 16, 4
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
    plain = plain_mesh(arm, shapes[0])
    plain.shape_key_add(name="Basis")
    key = plain.shape_key_add(name="Key")
    key.points.foreach_set("co", shapes[1].astype(np.float32).ravel())
    for frame, value in ((1, 0.0), (4, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    animation = plain.data.shape_keys.animation_data
    for curve in animation.action.layers[0].strips[0].channelbag(animation.action_slot).fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    arm.sleeve.hide_render = True
    return render_still(path)
