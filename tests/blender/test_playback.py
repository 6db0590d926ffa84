"""A garment in Blender shows the pose of the frame that Blender shows, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import (
    RADIUS,
    TOLERANCE,
    Arm,
    Bumps,
    bake_bumps,
    build_arm,
    empty_scene,
    evaluated_positions,
)
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.blender.handlers import suspended
from wrinkle_synthesis.wrinkle_addon.blender.node_group import ATTRIBUTE, GROUP, find_modifier
from wrinkle_synthesis.wrinkle_addon.rig import Pose

ANGLES = [{"elbow_L": [0.12 * k], "shoulder_L": [0.04 * k, -0.03 * k, 0.02 * k]} for k in range(12)]
NO_WRINKLES = {"elbow_L": 0.0, "shoulder_L": 0.0}


@pytest.fixture
def scene(bumps: Bumps) -> bpy.types.Scene:
    return empty_scene()


@pytest.fixture
def arm(scene: bpy.types.Scene, database: Path) -> Arm:
    return build_arm("", database)


def assert_shows(arm: Arm, bumps: Bumps, pose: Pose, strength: Mapping[str, float] | None = None) -> None:
    """The sleeve looks as its database says for this pose."""
    assert playback.status(arm.sleeve).error == ""
    expected = arm.to_object_space(bumps.shape(pose, strength))
    scale = np.linalg.norm(arm.to_object_space(np.array([[1.0, 0, 0], [0, 0, 0]])) @ [[1.0], [0], [0]])
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), expected, atol=TOLERANCE * max(1.0, scale))


def skinned(arm: Arm) -> np.ndarray:
    """The sleeve as its Armature modifier alone shows it."""
    modifier = find_modifier(arm.sleeve)
    shown, modifier.show_viewport = modifier.show_viewport, False
    positions = evaluated_positions(arm.sleeve)
    modifier.show_viewport = shown
    return positions


# --- frames -------------------------------------------------------------------------------------------------------


def test_every_frame_shows_its_own_pose_in_any_order(scene: bpy.types.Scene, arm: Arm, bumps: Bumps) -> None:
    poses = arm.animate(ANGLES)
    for frame in (1, 7, 3, 12, 11, 3):
        scene.frame_set(frame)
        assert_shows(arm, bumps, poses[frame - 1])


def test_subframes_show_the_pose_between(scene: bpy.types.Scene, arm: Arm, bumps: Bumps) -> None:
    # One joint about one axis: the pose between two keys has the angle between theirs, to a fraction of the tolerance.
    arm.animate([{"elbow_L": [0.1 * k]} for k in range(12)])
    for time in (4.0, 3.75, 4.25, 4.0):
        scene.frame_set(int(time), subframe=time % 1.0)
        assert_shows(arm, bumps, bumps.pose({"elbow_L": np.array([0.1 * (time - 1.0)])}))


def test_the_same_frame_has_the_same_bits_from_any_visiting_order(scene: bpy.types.Scene, arm: Arm) -> None:
    arm.animate(ANGLES)
    first = {}
    for frame in range(1, 13):
        scene.frame_set(frame)
        first[frame] = evaluated_positions(arm.sleeve)
    for frame in (12, 2, 9, 4, 1):
        scene.frame_set(frame)
        np.testing.assert_array_equal(evaluated_positions(arm.sleeve), first[frame])


def test_another_frame_than_the_stored_one_shows_the_skinned_garment(scene: bpy.types.Scene, arm: Arm) -> None:
    arm.animate(ANGLES)
    scene.frame_set(9)
    with suspended():
        scene.frame_set(5)
        np.testing.assert_array_equal(evaluated_positions(arm.sleeve), skinned(arm))
        scene.frame_set(9, subframe=0.5)
        np.testing.assert_array_equal(evaluated_positions(arm.sleeve), skinned(arm))


# --- posing by hand -----------------------------------------------------------------------------------------------


def test_posing_by_hand_shows_at_once_without_a_change_of_frame(arm: Arm, bumps: Bumps) -> None:
    for angle in (0.3, 1.2, 0.8):
        pose = arm.bend(angle)
        bpy.context.view_layer.update()
        assert_shows(arm, bumps, pose)


def test_an_update_that_moves_nothing_writes_nothing(arm: Arm) -> None:
    arm.bend(0.5)
    bpy.context.view_layer.update()
    updated = []

    def count(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        updated.append(arm.sleeve.data in [update.id.original for update in depsgraph.updates])

    bpy.app.handlers.depsgraph_update_post.append(count)
    try:
        for _ in range(4):
            bpy.context.view_layer.update()
            arm.armature.update_tag()
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(count)
    # The first update after posing takes the written mesh in; none after it finds a mesh that was written again.
    assert not any(updated[1:])


def test_nothing_is_played_while_suspended(arm: Arm, bumps: Bumps) -> None:
    with suspended():
        pose = arm.bend(0.9)
        bpy.context.view_layer.update()
        assert find_modifier(arm.sleeve) is None
    bpy.context.scene.frame_set(1)
    assert_shows(arm, bumps, pose)


# --- strengths and masks ------------------------------------------------------------------------------------------


def test_strength_zero_shows_the_settled_garment_skinned(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(1.0)
    arm.sleeve.wrinkles.strength = 0.0
    bpy.context.view_layer.update()
    assert_shows(arm, bumps, pose, NO_WRINKLES)


def test_each_joint_has_its_own_strength(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(1.0)
    arm.sleeve.wrinkles.strength = 0.8
    arm.sleeve.wrinkles.joints["elbow_L"].strength = 0.5
    bpy.context.view_layer.update()
    assert_shows(arm, bumps, pose, {"elbow_L": 0.4, "shoulder_L": 0.8})


def test_keyed_strengths_are_those_of_the_frame(scene: bpy.types.Scene, arm: Arm, bumps: Bumps) -> None:
    pose = arm.animate([{"elbow_L": [1.0]}] * 2)[0]
    for frame, value in ((1, 0.0), (11, 1.0)):
        arm.sleeve.wrinkles.joints["elbow_L"].strength = value
        arm.sleeve.wrinkles.joints["elbow_L"].keyframe_insert("strength", frame=frame)
        arm.sleeve.wrinkles.strength = 0.5 + 0.5 * value
        arm.sleeve.wrinkles.keyframe_insert("strength", frame=frame)
    for frame, strength in ((1, 0.0), (6, 0.375), (11, 1.0)):
        scene.frame_set(frame)
        assert_shows(arm, bumps, pose, {"elbow_L": strength})


def test_a_vertex_group_masks_the_wrinkles(arm: Arm, bumps: Bumps) -> None:
    half = arm.sleeve.vertex_groups.new(name="half")
    half.add(range(0, 180), 1.0, "REPLACE")
    half.add(range(180, 240), 0.5, "REPLACE")
    pose = arm.bend(1.0)
    arm.sleeve.wrinkles.mask = "half"
    bpy.context.view_layer.update()
    played, plain = arm.to_object_space(bumps.shape(pose)), skinned(arm)
    share = np.repeat([1.0, 0.5, 0.0], [180, 60, 120])[:, None]
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), plain + share * (played - plain), atol=TOLERANCE)
    arm.sleeve.wrinkles.mask = ""
    bpy.context.view_layer.update()
    assert_shows(arm, bumps, pose)


# --- the modifier -------------------------------------------------------------------------------------------------


def test_the_modifier_stands_right_after_the_armature(arm: Arm) -> None:
    arm.sleeve.modifiers.new("Solidify", "SOLIDIFY")
    bpy.context.view_layer.update()
    assert [modifier.type for modifier in arm.sleeve.modifiers] == ["ARMATURE", "NODES", "SOLIDIFY"]


def test_turning_the_modifier_off_shows_the_skinned_garment(arm: Arm) -> None:
    arm.bend(1.0)
    bpy.context.view_layer.update()
    modifier = find_modifier(arm.sleeve)
    played = evaluated_positions(arm.sleeve)
    modifier.show_viewport = False
    plain = evaluated_positions(arm.sleeve)
    modifier.show_viewport = True
    assert np.abs(played - plain).max() > 0.01
    np.testing.assert_array_equal(evaluated_positions(arm.sleeve), played)


def test_switching_wrinkles_off_shows_the_skinned_garment(arm: Arm) -> None:
    arm.bend(1.0)
    bpy.context.view_layer.update()
    arm.sleeve.wrinkles.enabled = False
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(evaluated_positions(arm.sleeve), skinned(arm))


def test_modifiers_behind_it_work_on_the_wrinkled_garment(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(1.0)
    arm.sleeve.modifiers.new("Subdivision", "SUBSURF").levels = 1
    thickness = arm.sleeve.modifiers.new("Solidify", "SOLIDIFY")
    thickness.thickness, thickness.use_rim = 0.004, False
    bpy.context.view_layer.update()
    shown = evaluated_positions(arm.sleeve)
    count = len(arm.sleeve.data.vertices)
    assert len(shown) == 2 * (count + len(arm.sleeve.data.edges) + len(arm.sleeve.data.polygons))
    # Subdivision keeps the first vertices first and moves them by a part of an edge, here at most 8 mm.
    np.testing.assert_allclose(shown[:count], arm.to_object_space(bumps.shape(pose)), atol=0.008)
    assert np.abs(shown[:count] - arm.to_object_space(bumps.shape(pose, NO_WRINKLES))).max() > 0.02


def test_an_outdated_node_group_is_replaced(arm: Arm, bumps: Bumps) -> None:
    bpy.context.view_layer.update()
    modifier = find_modifier(arm.sleeve)
    modifier.node_group.name = "Wrinkles 0"
    pose = arm.bend(1.0)
    bpy.context.view_layer.update()
    assert modifier.node_group.name == GROUP
    assert len(arm.sleeve.modifiers) == 2
    assert_shows(arm, bumps, pose)


def test_a_missing_attribute_shows_the_skinned_garment(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(1.0)
    bpy.context.view_layer.update()
    mesh = arm.sleeve.data
    mesh.attributes.remove(mesh.attributes[ATTRIBUTE])
    with suspended():
        bpy.context.view_layer.update()
        np.testing.assert_array_equal(evaluated_positions(arm.sleeve), skinned(arm))
    bpy.context.scene.frame_set(2)
    assert_shows(arm, bumps, pose)


# --- where things are ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1.0, 0.01, 2.5])
def test_character_and_garment_may_be_moved_turned_and_scaled(
    scene: bpy.types.Scene, arm: Arm, bumps: Bumps, scale: float
) -> None:
    pose = arm.animate(ANGLES)[8]
    for ob in (arm.armature, arm.sleeve):
        ob.location, ob.rotation_euler, ob.scale = (3.0, -2.0, 1.0), (0.4, 1.1, -2.0), (scale,) * 3
    arm.sleeve.delta_location = (0.1, 0.0, 0.2)
    scene.frame_set(9)
    played = evaluated_positions(arm.sleeve)
    # The character is the one that was baked, whatever its size in this scene.
    offset = np.array(arm.sleeve.matrix_world.inverted().to_3x3()) @ [-0.1, 0.0, -0.2]
    assert playback.status(arm.sleeve).error == ""
    np.testing.assert_allclose(played, bumps.shape(pose) + offset, atol=TOLERANCE)


def test_a_character_in_centimetres_is_played_in_centimetres(
    scene: bpy.types.Scene, database: Path, bumps: Bumps
) -> None:
    scene.unit_settings.scale_length = 0.01
    arm = build_arm("", database, size=100.0)
    poses = arm.animate(ANGLES)
    scene.frame_set(9)
    assert_shows(arm, bumps, poses[8])


def test_an_animated_object_carries_its_garment_along(scene: bpy.types.Scene, arm: Arm, bumps: Bumps) -> None:
    pose = arm.animate([{"elbow_L": [1.0]}] * 2)[0]
    for frame, x in ((1, 0.0), (11, 5.0)):
        arm.armature.location.x = x
        arm.armature.keyframe_insert("location", frame=frame)
    for frame in (1, 6, 11):
        scene.frame_set(frame)
        assert_shows(arm, bumps, pose)


def test_several_garments_on_one_character_share_its_pose(
    scene: bpy.types.Scene, arm: Arm, database: Path, bumps: Bumps, tmp_path: Path
) -> None:
    wide = build_arm("wide ", around=10, along=20)
    bpy.data.objects.remove(wide.armature)
    wide.sleeve.wrinkles.armature = arm.armature
    wide.sleeve.modifiers[0].object = arm.armature
    both = Arm(arm.armature, wide.sleeve, arm.rig)
    wide_bumps = bake_bumps(both, tmp_path)
    wide.sleeve.wrinkles.database, wide.sleeve.wrinkles.enabled = str(tmp_path), True
    poses = arm.animate(ANGLES)
    for frame in (9, 4):
        scene.frame_set(frame)
        assert_shows(arm, bumps, poses[frame - 1])
        assert_shows(both, wide_bumps, poses[frame - 1])


def test_several_characters_in_one_scene_have_a_pose_each(scene: bpy.types.Scene, database: Path, bumps: Bumps) -> None:
    arms = [build_arm(f"{k} ", database) for k in range(3)]
    poses = []
    for k, arm in enumerate(arms):
        arm.armature.location.y = arm.sleeve.location.y = float(k)
        poses.append(arm.animate([{"elbow_L": [0.1 * frame * (k + 1)]} for frame in range(6)]))
    for frame in (5, 2):
        scene.frame_set(frame)
        for arm, own in zip(arms, poses, strict=True):
            assert_shows(arm, bumps, own[frame - 1])


def test_joints_beyond_their_samples_are_reported(arm: Arm) -> None:
    arm.bend(np.pi / 2 + 0.25)
    bpy.context.view_layer.update()
    player = playback.status(arm.sleeve).player
    assert player is not None
    np.testing.assert_allclose(player.clamped["elbow_L"], [0.25], atol=1e-5)
    arm.bend(1.0)
    bpy.context.view_layer.update()
    assert not player.clamped


def test_the_sleeve_is_wider_than_the_arm(arm: Arm) -> None:
    """The tests' own premise: skinned and played shapes differ."""
    bpy.context.view_layer.update()
    assert np.abs(evaluated_positions(arm.sleeve)[:, 1]).max() > 1.2 * RADIUS
