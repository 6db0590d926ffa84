"""A garment that cannot be played says why in one sentence, shows its skinned shape, and stops a render."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import bmesh
import bpy
import numpy as np
import pytest
from small_character import TOLERANCE, Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.blender import playback, player, preferences
from wrinkle_synthesis.wrinkle_addon.blender.handlers import RENDER_FAILED
from wrinkle_synthesis.wrinkle_addon.blender.node_group import find_modifier


@pytest.fixture
def own_database(database: Path, tmp_path: Path, bumps: Bumps) -> Path:
    """A copy of the arm's database, to be damaged."""
    return Path(shutil.copytree(database, tmp_path / "own.wrinkles"))


@pytest.fixture
def arm(own_database: Path) -> Arm:
    empty_scene()
    return build_arm("", own_database)


def error_of(arm: Arm) -> str:
    """What the panel says after an update; the garment then shows its skinned shape."""
    arm.bend(1.0)
    bpy.context.view_layer.update()
    error = playback.status(arm.sleeve).error
    modifier = find_modifier(arm.sleeve)
    if modifier is not None:
        shown = evaluated_positions(arm.sleeve)
        modifier.show_viewport = False
        np.testing.assert_array_equal(shown, evaluated_positions(arm.sleeve))
        modifier.show_viewport = True
    return error


# --- databases ----------------------------------------------------------------------------------------------------


def remove_folder(folder: Path) -> None:
    shutil.rmtree(folder)


def remove_manifest(folder: Path) -> None:
    (folder / "manifest.json").unlink()


def remove_sample(folder: Path) -> None:
    next(folder.glob("elbow*")).unlink()


def truncate_sample(folder: Path) -> None:
    path = next(folder.glob("elbow*"))
    path.write_bytes(path.read_bytes()[:-100])


def raise_format(folder: Path) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "format": 99}))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (remove_folder, "There is no database"),
        (remove_manifest, "is not finished"),
        (remove_sample, "is missing"),
        (truncate_sample, "damaged or truncated"),
        (raise_format, "format 99"),
    ],
)
def test_a_bad_database_is_named_in_one_sentence(
    arm: Arm, own_database: Path, damage: Callable[[Path], None], words: str
) -> None:
    damage(own_database)
    error = error_of(arm)
    assert words in error
    assert "\n" not in error


def test_a_failed_database_is_not_opened_again_until_something_changes(
    arm: Arm, own_database: Path, database: Path
) -> None:
    own_database.rename(own_database.with_name("away"))
    assert "There is no database" in error_of(arm)
    own_database.with_name("away").rename(own_database)
    assert "There is no database" in error_of(arm)
    arm.sleeve.wrinkles.database = str(database)
    assert error_of_played(arm) == ""


def error_of_played(arm: Arm) -> str:
    bpy.context.view_layer.update()
    return playback.status(arm.sleeve).error


def test_no_database_and_no_armature_are_named(arm: Arm) -> None:
    arm.sleeve.wrinkles.database = ""
    assert "has no database" in error_of(arm)
    arm.sleeve.wrinkles.armature = None
    assert "has no armature" in error_of(arm)


def test_an_unknown_device_is_named(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(player, "device_name", lambda: "cuda:77")
    assert "no device 'cuda:77'" in error_of(arm)
    assert preferences.device_name() == "auto"


# --- garments and rigs --------------------------------------------------------------------------------------------


def test_a_changed_topology_is_named(arm: Arm) -> None:
    bpy.context.view_layer.update()
    arm.sleeve.data.vertices.add(1)
    error = error_of(arm)
    assert "topology" in error
    assert "361 vertices, the bake 360" in error


def test_an_edge_that_was_turned_in_edit_mode_is_named(arm: Arm) -> None:
    bpy.context.view_layer.objects.active = arm.sleeve
    bpy.context.view_layer.update()
    assert playback.status(arm.sleeve).error == ""
    bpy.ops.object.mode_set(mode="EDIT")
    mesh = bmesh.from_edit_mesh(arm.sleeve.data)
    inner = next(edge for edge in mesh.edges if len(edge.link_faces) == 2)
    bmesh.ops.rotate_edges(mesh, edges=[inner], use_ccw=False)
    bmesh.update_edit_mesh(arm.sleeve.data)
    bpy.context.view_layer.update()
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    assert "topology" in playback.status(arm.sleeve).error


def test_another_mesh_of_the_same_size_is_named(arm: Arm) -> None:
    bpy.context.view_layer.update()
    quads = [list(polygon.vertices) for polygon in arm.sleeve.data.polygons]
    vertices = [vertex.co for vertex in arm.sleeve.data.vertices]
    arm.sleeve.data = bpy.data.meshes.new("another")
    arm.sleeve.data.from_pydata(vertices, [], [*quads[:-1], [0, 1, 13, 25]])
    bpy.context.view_layer.update()
    assert "changed since the bake" in playback.status(arm.sleeve).error


def test_moved_vertices_are_no_change_of_topology(arm: Arm, bumps: Bumps) -> None:
    for vertex in arm.sleeve.data.vertices:
        vertex.co.y *= 1.0 + 0.3 * np.sin(vertex.index)
    pose = arm.bend(1.0)
    bpy.context.view_layer.update()
    assert playback.status(arm.sleeve).error == ""
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), bumps.shape(pose), atol=TOLERANCE)


def test_the_database_of_another_garment_is_named(bumps: Bumps, database: Path) -> None:
    empty_scene()
    error = error_of(build_arm("other ", database, along=20))
    assert "'other sleeve' was baked for 'sleeve'" in error


def edit_bone(arm: Arm, edit: Callable[[bpy.types.EditBone], None]) -> None:
    bpy.context.view_layer.objects.active = arm.armature
    bpy.ops.object.mode_set(mode="EDIT")
    edit(arm.armature.data.edit_bones["lower"])
    bpy.ops.object.mode_set(mode="OBJECT")


def move_tail(bone: bpy.types.EditBone) -> None:
    bone.tail.z += 0.1


def roll(bone: bpy.types.EditBone) -> None:
    bone.roll += 0.2


def rename(bone: bpy.types.EditBone) -> None:
    bone.name = "forearm"


@pytest.mark.parametrize("edit", [move_tail, roll, rename])
def test_a_changed_rig_is_named(arm: Arm, edit: Callable[[bpy.types.EditBone], None]) -> None:
    edit_bone(arm, edit)
    bpy.context.view_layer.update()
    error = playback.status(arm.sleeve).error
    assert "rig 'rig' changed since the bake" in error
    assert "'lower'" in error


def test_an_added_bone_is_no_change_of_the_rig(arm: Arm, bumps: Bumps) -> None:
    def add(bone: bpy.types.EditBone) -> None:
        hand = arm.armature.data.edit_bones.new("a hand")
        hand.head, hand.tail, hand.parent = bone.tail, bone.tail * 1.2, bone

    edit_bone(arm, add)
    pose = arm.bend(1.0)
    bpy.context.view_layer.update()
    assert playback.status(arm.sleeve).error == ""
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), bumps.shape(pose), atol=TOLERANCE)


def test_a_change_that_is_undone_is_forgiven(arm: Arm, bumps: Bumps) -> None:
    bpy.context.view_layer.update()
    edit_bone(arm, roll)
    assert "changed" in error_of(arm)
    edit_bone(arm, lambda bone: setattr(bone, "roll", bone.roll - 0.2))
    pose = arm.bend(1.0)
    bpy.context.view_layer.update()
    assert playback.status(arm.sleeve).error == ""
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), bumps.shape(pose), atol=TOLERANCE)


# --- renders ------------------------------------------------------------------------------------------------------

RENDER = """
import os, sys
import bpy
import wrinkle_synthesis
wrinkle_synthesis.register()
path, how, out = sys.argv[1:]
bpy.ops.wm.open_mainfile(filepath=path)
scene = bpy.context.scene
scene.render.filepath = out
if how == "animation":
    bpy.ops.render.render(animation=True)
elif how == "still":
    bpy.ops.render.render(write_still=True)
else:
    scene.frame_set(2)
sys.stdout.flush()
os._exit(0)
"""


@pytest.mark.parametrize("how", ["animation", "still", "frame_set"])
def test_a_background_process_ends_with_code_3_where_a_garment_cannot_be_played(
    arm: Arm, own_database: Path, tmp_path: Path, how: str
) -> None:
    scene = bpy.context.scene
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.frame_end = 2
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    path = tmp_path / "arm.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    shutil.rmtree(own_database)
    frames = tmp_path / "frames"
    run = subprocess.run(
        [sys.executable, "-c", RENDER, str(path), how, f"{frames}{os.sep}"],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == RENDER_FAILED, run.stderr
    assert "wrinkle: There is no database" in run.stderr
    assert not frames.exists() or not list(frames.iterdir())
