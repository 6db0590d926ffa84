"""A played garment is kept clear of its body; where it cannot be, it plays as it is and that is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import Arm, Bumps, build_arm, empty_scene, evaluated_positions, heights
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache

# Bumps that lift the sleeve by up to 24 mm: its lower side goes through the arm, 12 mm away.
ANGLES = [{"elbow_L": [0.1 * k], "shoulder_L": [0.06 * k, 0.06 * k, -0.06 * k]} for k in range(6)]


@pytest.fixture
def scene(bumps: Bumps) -> bpy.types.Scene:
    return empty_scene()


@pytest.fixture
def arm(scene: bpy.types.Scene, database: Path) -> Arm:
    arm = build_arm("", database)
    arm.animate(ANGLES)
    scene.frame_end = len(ANGLES)
    arm.sleeve.wrinkles.clear_of_body = True
    return arm


def note(arm: Arm) -> str:
    status = playback.status(arm.sleeve)
    assert status.error == "" and status.player is not None
    return status.player.note


def synthesised(scene: bpy.types.Scene, arm: Arm, frame: int) -> np.ndarray:
    """The sleeve of a frame as the database alone has it."""
    arm.sleeve.wrinkles.clear_of_body = False
    scene.frame_set(frame)
    shown = evaluated_positions(arm.sleeve)
    arm.sleeve.wrinkles.clear_of_body = True
    return shown


# --- kept clear ---------------------------------------------------------------------------------------------------


def test_the_push_may_be_left_to_renders_and_files(scene: bpy.types.Scene, arm: Arm, tmp_path: Path) -> None:
    alone = synthesised(scene, arm, 6)
    arm.sleeve.wrinkles.viewport_detail = "QUICK"
    scene.frame_set(6)
    np.testing.assert_array_equal(evaluated_positions(arm.sleeve), alone)
    bpy.context.view_layer.objects.active = arm.sleeve
    assert bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "clear.pc2")) == {"FINISHED"}
    assert np.abs(PointCache(tmp_path / "clear.pc2").frames[5] - alone).max() > 0.005


@pytest.mark.parametrize(("in_viewport", "in_render"), [("QUICK", "FULL"), ("FULL", "QUICK")])
def test_the_push_may_be_left_out_in_the_viewport_or_in_renders(
    scene: bpy.types.Scene, arm: Arm, in_viewport: str, in_render: str
) -> None:
    settings = arm.sleeve.wrinkles
    scene.frame_set(6)
    shapes = {"FULL": evaluated_positions(arm.sleeve), "QUICK": synthesised(scene, arm, 6)}
    settings.viewport_detail, settings.render_detail = in_viewport, in_render
    bpy.ops.object.camera_add()
    scene.camera, scene.render.engine = bpy.context.object, "BLENDER_WORKBENCH"
    scene.render.resolution_x = scene.render.resolution_y = 8
    rendered: list[np.ndarray] = []

    def remember(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        if depsgraph.mode == "RENDER":
            bpy.context.view_layer.update()
            player = playback.status(arm.sleeve).player
            assert player is not None
            rendered.append(player.positions.copy())

    bpy.app.handlers.frame_change_post.append(remember)
    try:
        bpy.ops.render.render()
    finally:
        bpy.app.handlers.frame_change_post.remove(remember)
    # A render evaluates its own copies of the matrices.
    np.testing.assert_allclose(rendered[-1], shapes[in_render], atol=1e-6)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), shapes[in_viewport], atol=1e-6)


def test_a_played_garment_is_outside_its_body(scene: bpy.types.Scene, arm: Arm) -> None:
    arm.sleeve.wrinkles.clear_of_body = False
    scene.frame_set(6)
    assert heights(arm).min() < -0.005
    arm.sleeve.wrinkles.clear_of_body = True
    for frame in (6, 4, 2):
        scene.frame_set(frame)
        assert note(arm) == ""
        # The clearance of 3 mm, less half of the softness, and less what the arm's facets of 20 mm make of it.
        assert heights(arm).min() > 0.0015


def test_a_garment_that_is_outside_is_left_as_it_is(scene: bpy.types.Scene, arm: Arm) -> None:
    expected = synthesised(scene, arm, 1)
    scene.frame_set(2)
    scene.frame_set(1)
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), expected, atol=1e-6)


def test_frames_have_the_same_bits_in_any_order(scene: bpy.types.Scene, arm: Arm) -> None:
    shown = {}
    for frame in (1, 6, 3, 5, 3, 6, 1):
        scene.frame_set(frame)
        np.testing.assert_array_equal(
            evaluated_positions(arm.sleeve), shown.setdefault(frame, evaluated_positions(arm.sleeve))
        )


def test_another_clearance_counts_at_once(scene: bpy.types.Scene, arm: Arm) -> None:
    scene.frame_set(6)
    lowest = heights(arm).min()
    arm.sleeve.wrinkles.clearance = 0.008
    bpy.context.view_layer.update()
    assert heights(arm).min() == pytest.approx(lowest + 0.005, abs=0.001)


def test_a_body_that_moves_alone_is_followed(scene: bpy.types.Scene, arm: Arm) -> None:
    scene.frame_set(1)
    arm.sleeve.wrinkles.body.location.z = 0.02
    bpy.context.view_layer.update()
    assert heights(arm).min() > 0.0015


@pytest.mark.parametrize("scale", [0.01, 3.0])
def test_a_character_of_any_scale_is_kept_clear(scene: bpy.types.Scene, arm: Arm, scale: float) -> None:
    for ob in (arm.armature, arm.sleeve, arm.sleeve.wrinkles.body):
        ob.scale = (scale, scale, scale)
    scene.frame_set(6)
    assert heights(arm).min() > 0.0015


def test_what_is_written_is_what_is_shown(scene: bpy.types.Scene, arm: Arm, wrinkle: Callable, tmp_path: Path) -> None:
    shown = []
    for frame in range(1, 7):
        scene.frame_set(frame)
        shown.append(evaluated_positions(arm.sleeve))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    result = wrinkle("synthesize", tmp_path / "arm.blend", "--out", tmp_path / "arm.pc2", "--json").result
    assert result["notes"] == []
    np.testing.assert_allclose(PointCache(tmp_path / "arm.pc2").frames, shown, atol=1e-6)


def test_a_body_hidden_by_the_eye_still_counts(scene: bpy.types.Scene, arm: Arm) -> None:
    arm.sleeve.wrinkles.body.hide_set(True)
    scene.frame_set(6)
    assert note(arm) == "" and heights(arm).min() > 0.0015


# --- not kept clear -----------------------------------------------------------------------------------------------


def remove(arm: Arm) -> str:
    arm.sleeve.wrinkles.body = None
    return "No body is set."


def replace_by_a_light(arm: Arm) -> str:
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    bpy.context.scene.collection.objects.link(lamp)
    arm.sleeve.wrinkles.body = lamp
    return "The body 'lamp' is no mesh."


def strip(arm: Arm) -> str:
    arm.sleeve.wrinkles.body.data.clear_geometry()
    return "The body has no faces; choose the mesh that the garment is worn on."


@pytest.mark.parametrize("change", [remove, replace_by_a_light, strip])
def test_without_its_body_a_garment_plays_as_it_is_and_that_is_told(
    scene: bpy.types.Scene, arm: Arm, change: Callable[[Arm], str]
) -> None:
    expected = synthesised(scene, arm, 6)
    scene.frame_set(5)
    sentence = change(arm)
    scene.frame_set(6)
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), expected, atol=1e-6)
    assert note(arm) == f"{sentence} The garment 'sleeve' plays without being kept clear of it."


def hide(arm: Arm) -> str:
    arm.sleeve.wrinkles.body.hide_viewport = True
    return "is hidden"


def subdivide(arm: Arm) -> str:
    arm.sleeve.wrinkles.body.modifiers.new("Finer", "SUBSURF")
    return "is shown with another mesh than its own"


def mask(arm: Arm) -> str:
    body = arm.sleeve.wrinkles.body
    body.vertex_groups.new(name="covered").add(range(40), 1.0, "REPLACE")
    modifier = body.modifiers.new("Skin under cloth", "MASK")
    modifier.vertex_group, modifier.invert_vertex_group = "covered", True
    return "is shown with another mesh than its own"


@pytest.mark.parametrize("change", [hide, subdivide, mask])
def test_the_plain_skinning_of_its_own_mesh_stands_for_a_body_that_is_not_shown_with_it(
    scene: bpy.types.Scene, arm: Arm, change: Callable[[Arm], str]
) -> None:
    scene.frame_set(6)
    expected = evaluated_positions(arm.sleeve)
    scene.frame_set(5)
    how = change(arm)
    scene.frame_set(6)
    # Blender skins this body just so; the two paths round differently.
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), expected, atol=1e-5)
    assert note(arm) == f"The body 'body' {how}; the garment 'sleeve' is kept clear of its plain skinning."


def test_a_body_that_comes_back_counts_again(scene: bpy.types.Scene, arm: Arm) -> None:
    body = arm.sleeve.wrinkles.body
    body.hide_viewport = True
    scene.frame_set(6)
    assert note(arm) != ""
    body.hide_viewport = False
    scene.frame_set(5)
    assert note(arm) == "" and heights(arm).min() > 0.0015
