"""While a window plays the animation, Armature modifiers whose work nobody sees rest, and nothing else changes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.blender import handlers, playback
from wrinkle_synthesis.wrinkle_addon.blender.node_group import find_modifier, set_input

ANGLES = [{"elbow_L": [0.12 * k], "shoulder_L": [0.04 * k, -0.03 * k, 0.02 * k]} for k in range(12)]


@pytest.fixture
def arm(bumps: Bumps, database: Path) -> Iterator[Arm]:
    empty_scene()
    arm = build_arm("", database)
    arm.animate(ANGLES)
    yield arm
    handlers.end_animation()


def shown(arm: Arm, frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    return evaluated_positions(arm.sleeve)


def skinning_rests(arm: Arm) -> bool:
    return not arm.sleeve.modifiers["Armature"].show_viewport


def play_some_frames(arm: Arm) -> None:
    handlers.begin_animation()
    for frame in (2, 3, 4):
        bpy.context.scene.frame_set(frame)
    assert skinning_rests(arm)


def test_it_is_blender_that_says_when_the_animation_plays() -> None:
    assert handlers.begin_animation in bpy.app.handlers.animation_playback_pre
    assert handlers.end_animation in bpy.app.handlers.animation_playback_post


def test_frames_show_the_same_bits_as_when_stepped_through(arm: Arm) -> None:
    stepped = [shown(arm, frame) for frame in (2, 5, 9)]
    assert not skinning_rests(arm)
    play_some_frames(arm)
    for frame, expected in zip((2, 5, 9), stepped, strict=True):
        np.testing.assert_array_equal(shown(arm, frame), expected)
        assert skinning_rests(arm)
    handlers.end_animation()
    assert not skinning_rests(arm)
    np.testing.assert_array_equal(evaluated_positions(arm.sleeve), stepped[-1])


def test_skinning_that_shows_through_does_not_rest(arm: Arm) -> None:
    expected = shown(arm, 9)
    play_some_frames(arm)
    modifier = find_modifier(arm.sleeve)
    set_input(modifier, "Factor", 0.5)
    arm.sleeve.update_tag()
    mixed = shown(arm, 9)
    assert not skinning_rests(arm)
    modifier.show_viewport = False
    bpy.context.view_layer.update()
    np.testing.assert_allclose(mixed, 0.5 * (expected + evaluated_positions(arm.sleeve)), atol=1e-6)
    modifier.show_viewport = True
    set_input(modifier, "Factor", 1.0)
    arm.sleeve.vertex_groups.new(name="half").add(range(100), 1.0, "REPLACE")
    arm.sleeve.wrinkles.mask = "half"
    bpy.context.scene.frame_set(4)
    bpy.context.scene.frame_set(5)
    assert not skinning_rests(arm)


def test_an_armature_modifier_that_the_artist_switched_off_stays_off(arm: Arm) -> None:
    arm.sleeve.modifiers["Armature"].show_viewport = False
    handlers.begin_animation()
    bpy.context.scene.frame_set(2)
    bpy.context.scene.frame_set(3)
    handlers.end_animation()
    assert not arm.sleeve.modifiers["Armature"].show_viewport


@pytest.mark.parametrize("how", ["switched off", "eye closed", "edit mode", "fails", "unregistered", "suspended"])
def test_a_garment_that_is_no_longer_played_is_skinned(arm: Arm, how: str) -> None:
    play_some_frames(arm)
    modifier = find_modifier(arm.sleeve)
    if how == "switched off":
        arm.sleeve.wrinkles.enabled = False
    elif how == "eye closed":
        modifier.show_viewport = False
    elif how == "edit mode":
        bpy.context.view_layer.objects.active = arm.sleeve
        bpy.ops.object.mode_set(mode="EDIT")
    elif how == "fails":
        arm.sleeve.wrinkles.database = "//nothing.wrinkles"
    elif how == "unregistered":
        handlers.unregister()
    else:
        with handlers.suspended():
            assert not skinning_rests(arm)
    bpy.context.view_layer.update()
    assert not skinning_rests(arm) or how == "suspended"
    if how == "edit mode":
        bpy.ops.object.mode_set(mode="OBJECT")
    elif how == "unregistered":
        handlers.register()


def test_a_file_saved_meanwhile_has_its_skinning(arm: Arm, tmp_path: Path) -> None:
    play_some_frames(arm)
    path = tmp_path / "arm.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.objects = ["sleeve"]
    assert wanted.objects[0].modifiers["Armature"].show_viewport


def test_an_undo_step_made_meanwhile_has_its_skinning(arm: Arm) -> None:
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    play_some_frames(arm)
    bpy.ops.ed.undo_push(message="meanwhile")
    handlers.end_animation()
    arm.armature.location.x = 1.0
    bpy.ops.ed.undo_push(message="after")
    assert bpy.ops.ed.undo() == {"FINISHED"}
    bpy.context.view_layer.update()
    sleeve = bpy.data.objects["sleeve"]
    assert sleeve.modifiers["Armature"].show_viewport
    assert playback.status(sleeve).error == ""
