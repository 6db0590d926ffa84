"""Playing survives what artists do to a file, and a file never depends on the add-on to look right."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
import wrinkle_synthesis
from small_character import TOLERANCE, Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.blender.handlers import suspended
from wrinkle_synthesis.wrinkle_addon.blender.node_group import NO_FRAME, find_modifier, get_input

EVALUATE = """
import os, sys
import bpy, numpy as np
path, frame, sleeve, out, addon = sys.argv[1:]
if addon == "with":
    import warp as wp
    wp.config.log_level = wp.LOG_WARNING
    import wrinkle_synthesis
    wrinkle_synthesis.register()
bpy.ops.wm.open_mainfile(filepath=path)
if frame != "-":
    bpy.context.scene.frame_set(int(frame))
mesh = bpy.data.objects[sleeve].evaluated_get(bpy.context.evaluated_depsgraph_get()).data
positions = np.empty(3 * len(mesh.vertices), np.float32)
mesh.attributes["position"].data.foreach_get("vector", positions)
np.save(out, positions.reshape(-1, 3))
os._exit(0)
"""


def in_fresh_blender(path: Path, frame: int | None, addon: bool, tmp_path: Path, sleeve: str = "sleeve") -> np.ndarray:
    """The sleeve of a saved file as another process evaluates it."""
    out = tmp_path / "positions.npy"
    arguments = [str(path), "-" if frame is None else str(frame), sleeve, str(out), "with" if addon else "without"]
    subprocess.run([sys.executable, "-c", EVALUATE, *arguments], check=True, timeout=120)
    return np.load(out)


@pytest.fixture
def arm(bumps: Bumps, database: Path) -> Arm:
    empty_scene()
    return build_arm("", database)


def shows(arm: Arm, expected: np.ndarray) -> bool:
    found = evaluated_positions(arm.sleeve)
    return found.shape == expected.shape and bool(np.abs(found - expected).max() < TOLERANCE)


def save(path: Path) -> Path:
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


# --- saving and opening -------------------------------------------------------------------------------------------


def test_without_the_addon_a_saved_file_shows_the_skinned_garment(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    bpy.context.scene.frame_set(1)
    pose = arm.bend(1.0)
    bpy.context.view_layer.update()
    path = save(tmp_path / "arm.blend")
    plain = in_fresh_blender(path, None, False, tmp_path)
    modifier = find_modifier(arm.sleeve)
    assert shows(arm, bumps.shape(pose)), "saving must not change what the artist sees"
    modifier.show_viewport = False
    np.testing.assert_array_equal(plain, evaluated_positions(arm.sleeve))


@pytest.fixture
def autosave(arm: Arm, tmp_path: Path) -> Path:
    """A file as Blender writes it by itself, without calling a handler."""
    bpy.context.scene.frame_set(1)
    arm.bend(1.0)
    bpy.context.view_layer.update()
    lists = bpy.app.handlers.save_pre, bpy.app.handlers.save_post
    called = [list(handlers) for handlers in lists]
    for handlers in lists:
        handlers.clear()
    path = save(tmp_path / "autosave.blend")
    for handlers, before in zip(lists, called, strict=True):
        handlers.extend(before)
    return path


def test_without_the_addon_an_autosave_shows_the_skinned_garment(arm: Arm, autosave: Path, tmp_path: Path) -> None:
    modifier = find_modifier(arm.sleeve)
    played = evaluated_positions(arm.sleeve)
    modifier.show_viewport = False
    skinned = evaluated_positions(arm.sleeve)
    assert np.abs(played - skinned).max() > 1e-3
    for frame in (None, 1):
        np.testing.assert_array_equal(in_fresh_blender(autosave, frame, False, tmp_path), skinned)


def test_an_addon_that_comes_after_the_file_plays_it(bumps: Bumps, autosave: Path) -> None:
    wrinkle_synthesis.unregister()
    try:
        bpy.ops.wm.open_mainfile(filepath=str(autosave))
        skinned = evaluated_positions(bpy.data.objects["sleeve"])
    finally:
        wrinkle_synthesis.register()
    bpy.context.scene.frame_set(1)
    assert np.abs(evaluated_positions(bpy.data.objects["sleeve"]) - skinned).max() > 1e-3


def test_a_fresh_process_shows_the_same_bits(arm: Arm, tmp_path: Path) -> None:
    arm.animate([{"elbow_L": [0.12 * k], "shoulder_L": [0.04 * k, 0.0, 0.02 * k]} for k in range(12)])
    path = save(tmp_path / "arm.blend")
    bpy.context.scene.frame_set(8)
    np.testing.assert_array_equal(in_fresh_blender(path, 8, True, tmp_path), evaluated_positions(arm.sleeve))


def test_an_opened_file_is_played_with_its_database_beside_it(
    arm: Arm, bumps: Bumps, database: Path, tmp_path: Path
) -> None:
    (tmp_path / "sleeve.wrinkles").symlink_to(database)
    pose = arm.animate([{"elbow_L": [1.0]}] * 2)[0]
    arm.sleeve.wrinkles.database = "//sleeve.wrinkles"
    path = save(tmp_path / "arm.blend")
    empty_scene()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    bpy.context.scene.frame_set(2)
    objects = bpy.data.objects
    assert shows(Arm(objects["rig"], objects["sleeve"], arm.rig), bumps.shape(pose))


# --- undo and edit mode -------------------------------------------------------------------------------------------


def test_undo_and_redo_show_the_pose_that_came_back(arm: Arm, bumps: Bumps) -> None:
    bpy.context.preferences.edit.use_global_undo = True
    poses = []
    for angle in (0.4, 1.2):
        poses.append(arm.bend(angle))
        bpy.context.view_layer.update()
        bpy.ops.ed.undo_push(message=f"bend to {angle}")
    for step, pose in ((bpy.ops.ed.undo, poses[0]), (bpy.ops.ed.redo, poses[1])):
        assert step() == {"FINISHED"}
        bpy.context.view_layer.update()
        objects = bpy.data.objects
        now = Arm(objects["rig"], objects["sleeve"], arm.rig)
        assert playback.status(now.sleeve).player is not None
        assert shows(now, bumps.shape(pose))


def test_undo_of_something_else_shows_the_pose_although_the_mesh_came_back_with_another(arm: Arm, bumps: Bumps) -> None:
    bpy.context.preferences.edit.use_global_undo = True
    arm.bend(0.4)
    bpy.context.view_layer.update()
    pose = arm.bend(1.2)
    with suspended():
        bpy.ops.ed.undo_push(message="posed, not yet played")
    arm.sleeve.wrinkles.body.location.x = 1.0
    bpy.ops.ed.undo_push(message="moved something else")
    assert bpy.ops.ed.undo() == {"FINISHED"}
    bpy.context.view_layer.update()
    objects = bpy.data.objects
    assert shows(Arm(objects["rig"], objects["sleeve"], arm.rig), bumps.shape(pose))


def test_edit_mode_is_left_alone_and_playing_goes_on_after_it(arm: Arm, bumps: Bumps) -> None:
    arm.animate([{"elbow_L": [0.1 * k]} for k in range(12)])
    bpy.context.scene.frame_set(3)
    bpy.context.view_layer.objects.active = arm.sleeve
    bpy.ops.object.mode_set(mode="EDIT")
    for frame in (5, 8):
        bpy.context.scene.frame_set(frame)
        assert playback.status(arm.sleeve).error == ""
        assert get_input(find_modifier(arm.sleeve), "Frame") == NO_FRAME
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    assert shows(arm, bumps.shape(bumps.pose({"elbow_L": np.array([0.7])})))


# --- objects ------------------------------------------------------------------------------------------------------


def test_renaming_changes_nothing(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(1.0)
    bpy.context.view_layer.update()
    player = playback.status(arm.sleeve).player
    for ob in (arm.sleeve, arm.armature):
        ob.name = ob.data.name = f"other {ob.name}"
    find_modifier(arm.sleeve).name = "My Folds"
    bpy.context.scene.frame_set(2)
    assert shows(arm, bumps.shape(pose))
    assert playback.status(arm.sleeve).player is player


@pytest.mark.parametrize("linked", [False, True])
def test_a_duplicated_garment_is_played_on_its_own(arm: Arm, bumps: Bumps, linked: bool) -> None:
    pose = arm.bend(1.0)
    bpy.context.view_layer.update()
    copy = arm.sleeve.copy()
    if not linked:
        copy.data = copy.data.copy()
    bpy.context.scene.collection.objects.link(copy)
    copy.location.z = 1.0
    copy.wrinkles.strength = 0.0
    bpy.context.scene.frame_set(2)
    assert shows(arm, bumps.shape(pose))
    other = Arm(arm.armature, copy, arm.rig)
    plain = bumps.shape(pose, {"elbow_L": 0.0, "shoulder_L": 0.0})
    assert shows(other, plain - [0.0, 0.0, 1.0])


def test_a_removed_garment_is_forgotten(arm: Arm, database: Path) -> None:
    other = build_arm("other ", database)
    bpy.context.view_layer.update()
    assert playback.status(other.sleeve).player is not None
    uid = other.sleeve.session_uid
    bpy.data.objects.remove(other.sleeve)
    bpy.context.scene.frame_set(2)
    assert uid not in playback._statuses
    assert playback.status(arm.sleeve).player is not None


def test_hidden_garments_are_not_played(arm: Arm) -> None:
    arm.sleeve.hide_viewport = True
    bpy.context.scene.frame_set(2)
    assert playback.status(arm.sleeve).player is None


# --- garments of other files --------------------------------------------------------------------------------------


@pytest.fixture
def library(arm: Arm, tmp_path: Path) -> Path:
    """A file with the whole character in a collection, already played once."""
    character = bpy.data.collections.new("Character")
    for ob in list(bpy.context.scene.objects):
        bpy.context.scene.collection.objects.unlink(ob)
        character.objects.link(ob)
    bpy.context.scene.collection.children.link(character)
    bpy.context.view_layer.update()
    return save(tmp_path / "library.blend")


def link_character(library: Path) -> bpy.types.Collection:
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.collections = ["Character"]
    return target.collections[0]


def local_arm(bumps: Bumps) -> Arm:
    local = {ob.name: ob for ob in bpy.data.objects if ob.library is None}
    return Arm(local["rig"], local["sleeve"], bumps.job.rig)


def test_an_override_of_a_linked_garment_gets_a_mesh_of_its_own(library: Path, bumps: Bumps) -> None:
    scene = empty_scene()
    link_character(library).override_hierarchy_create(scene, bpy.context.view_layer)
    arm = local_arm(bumps)
    pose = arm.bend(1.0)
    scene.frame_set(2)
    assert playback.status(arm.sleeve).error == ""
    assert arm.sleeve.data.library is None
    assert shows(arm, bumps.shape(pose))


def test_an_override_keeps_its_own_settings_in_a_saved_file(library: Path, bumps: Bumps, tmp_path: Path) -> None:
    scene = empty_scene()
    link_character(library).override_hierarchy_create(scene, bpy.context.view_layer)
    pose = local_arm(bumps).bend(1.0)
    local_arm(bumps).sleeve.wrinkles.joints["elbow_L"].strength = 0.5
    scene.frame_set(2)
    path = save(tmp_path / "shot.blend")
    empty_scene()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    bpy.context.scene.frame_set(3)
    assert shows(local_arm(bumps), bumps.shape(pose, {"elbow_L": 0.5}))


def test_a_linked_garment_is_refused(library: Path) -> None:
    scene = empty_scene()
    scene.collection.children.link(link_character(library))
    bpy.context.view_layer.update()
    assert "library override" in playback.status(bpy.data.objects["sleeve"]).error
