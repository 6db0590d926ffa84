"""Garments behave like everything else in Blender: undo, scenes, view layers, appending, moving the file."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np
import pytest
from dolls import doll
from fake_layout import draw
from figures import build_figure
from file_contents import differences, file_contents
from small_character import TOLERANCE, Arm, Bumps, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.blender.character import apply
from wrinkle_synthesis.wrinkle_addon.blender.handlers import HANDLERS
from wrinkle_synthesis.wrinkle_addon.blender.panels.character import WRINKLE_PT_character

Shape = Callable[[np.ndarray], bool]


@pytest.fixture
def arm(undoable_arm: Arm) -> Arm:
    return undoable_arm


def shows(ob: bpy.types.Object, expected: np.ndarray, depsgraph: bpy.types.Depsgraph | None = None) -> bool:
    if depsgraph is None:
        return bool(np.abs(evaluated_positions(ob) - expected).max() < TOLERANCE)
    mesh = ob.evaluated_get(depsgraph).data
    found = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", found)
    return bool(np.abs(found.reshape(-1, 3) - expected).max() < TOLERANCE)


# --- undo and redo of every operator ------------------------------------------------------------------------------


def setup_arguments() -> dict[str, object]:
    return {"garment": "shirt", "body": "body", "subdivide": 0}


OPERATORS = {
    "remove_wrinkles": {},
    "take_ranges": {},
    "mirror_joint": {},
    "show_influence": {},
    "make_coarse_mesh": {"vertex_count": 60},
    "open_sample": {},
    "plot_samples": {},
}


def contents() -> dict[str, object]:
    bpy.context.view_layer.update()
    found = file_contents()
    # Lists of pixels, and what a redo draws anew, are the same pictures.
    return {path: value for path, value in found.items() if not path.startswith("images[")}


def check_undo(run: Callable[[], set[str]]) -> None:
    """Run an operator, undo it, redo it: the file before and after is the same each time."""
    bpy.ops.ed.undo_push(message="before")
    before = contents()
    assert run() == {"FINISHED"}
    # Operators that Python calls push no step of their own.
    bpy.ops.ed.undo_push(message="after")
    after = contents()
    assert bpy.ops.ed.undo() == {"FINISHED"}
    assert differences(before, contents()) == []
    assert bpy.ops.ed.redo() == {"FINISHED"}
    assert differences(after, contents()) == []


@pytest.mark.parametrize("operator", OPERATORS.keys() - {"mirror_joint"})
def test_undo_and_redo_of_what_an_artist_presses(arm: Arm, operator: str) -> None:
    arm.sleeve.wrinkles.ghost.angles = (0.8, 0.0, 0.0)
    arm.animate([{"elbow_L": [0.1 * k]} for k in range(4)])
    bpy.context.scene.frame_set(1)
    check_undo(lambda: getattr(bpy.ops.wrinkle, operator)(**OPERATORS[operator]))


def test_undo_and_redo_of_setting_up_and_mirroring() -> None:
    empty_scene()
    bpy.context.preferences.edit.use_global_undo = True
    build_figure(doll(21, 8))
    bpy.context.view_layer.objects.active = bpy.data.objects["shirt"]
    check_undo(lambda: bpy.ops.wrinkle.setup_garment(**setup_arguments()))
    shirt = bpy.data.objects["shirt"]
    shirt.wrinkles.active_joint = shirt.wrinkles.joints.find("elbow_L")
    shirt.wrinkles.joints["elbow_L"].high[0] = 0.5
    check_undo(bpy.ops.wrinkle.mirror_joint)


def test_every_operator_that_changes_the_file_is_a_step_of_undo() -> None:
    looking = {"stop_process", "pause_bake", "simulate_coarse", "self_test"}
    storing = {"add_fabric_preset", "add_plan_preset"}
    for name in dir(bpy.ops.wrinkle):
        undone = "UNDO" in getattr(bpy.ops.wrinkle, name).bl_options
        assert undone != (name in looking | storing), name


# --- scenes and view layers ---------------------------------------------------------------------------------------


def test_a_garment_that_is_in_two_scenes_is_played_in_both(arm: Arm, bumps: Bumps) -> None:
    poses = arm.animate([{"elbow_L": [0.15 * k]} for k in range(8)])
    first, second = bpy.context.scene, bpy.data.scenes.new("Second")
    for ob in list(first.objects):
        second.collection.objects.link(ob)
    first.frame_set(2)
    assert shows(arm.sleeve, bumps.shape(poses[1]))
    second.frame_set(6)
    layer = second.view_layers[0]
    layer.update()
    assert shows(arm.sleeve, bumps.shape(poses[5]), layer.depsgraph)


def test_a_garment_copied_to_another_scene_with_its_character_is_played_there(arm: Arm, bumps: Bumps) -> None:
    poses = arm.animate([{"elbow_L": [0.15 * k]} for k in range(8)])
    bpy.ops.scene.new(type="FULL_COPY")
    scene = bpy.data.scenes[-1]
    copies = {ob.type: ob for ob in scene.objects if ob.type == "ARMATURE" or ob.wrinkles.armature is not None}
    assert copies["MESH"] != arm.sleeve and copies["MESH"].wrinkles.armature == copies["ARMATURE"]
    scene.frame_set(5)
    scene.view_layers[0].update()
    assert shows(copies["MESH"], bumps.shape(poses[4]), scene.view_layers[0].depsgraph)


def test_both_view_layers_of_a_scene_show_the_same_garment(arm: Arm, bumps: Bumps) -> None:
    poses = arm.animate([{"elbow_L": [0.15 * k]} for k in range(8)])
    scene = bpy.context.scene
    scene.view_layers.new("Second")
    scene.frame_set(4)
    for layer in scene.view_layers:
        layer.update()
        assert shows(arm.sleeve, bumps.shape(poses[3]), layer.depsgraph)


def test_a_garment_is_played_in_a_scene_that_its_armature_is_not_in(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(0.6)
    other = bpy.data.scenes.new("Other")
    other.collection.objects.link(arm.sleeve)
    # Its Armature modifier brings the armature along.
    other.frame_set(2)
    other.view_layers[0].update()
    assert shows(arm.sleeve, bumps.shape(pose), other.view_layers[0].depsgraph)


@pytest.mark.parametrize("gone", ["armature", "body"])
def test_a_deleted_armature_or_body_is_no_crash(arm: Arm, gone: str) -> None:
    bpy.data.objects.remove(getattr(arm.sleeve.wrinkles, gone))
    bpy.context.view_layer.update()
    playback.play_scene(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    error = playback.status(arm.sleeve).error
    assert error == "" if gone == "body" else "has no armature; set it up again" in error


def test_sculpting_a_played_garment_leaves_it_played(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(0.7)
    bpy.ops.object.mode_set(mode="SCULPT")
    bpy.context.scene.frame_set(2)
    assert playback.status(arm.sleeve).error == ""
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.scene.frame_set(3)
    assert shows(arm.sleeve, bumps.shape(pose))


# --- files --------------------------------------------------------------------------------------------------------


def save(path: Path, **options: object) -> Path:
    path.parent.mkdir(exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **options)
    return path


def beside_the_file(arm: Arm, tmp_path: Path) -> Path:
    """The file saved beside its database, which it names relative to itself."""
    arm.sleeve.wrinkles.database = "//sleeve.wrinkles"
    return save(tmp_path / "arm.blend")


def test_file_and_database_move_together(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    arm.animate([{"elbow_L": [1.0]}] * 2)
    saved = beside_the_file(arm, tmp_path)
    (tmp_path / "elsewhere").mkdir()
    for path in (saved, tmp_path / "sleeve.wrinkles"):
        shutil.move(path, tmp_path / "elsewhere" / path.name)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "elsewhere" / "arm.blend"))
    bpy.context.scene.frame_set(2)
    sleeve = bpy.data.objects["sleeve"]
    assert playback.status(sleeve).error == ""
    assert shows(sleeve, bumps.shape(bumps.pose({"elbow_L": np.array([1.0])})))


def test_a_file_that_is_saved_elsewhere_still_finds_the_database(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    beside_the_file(arm, tmp_path)
    save(tmp_path / "other" / "arm.blend")
    assert arm.sleeve.wrinkles.database == "//../sleeve.wrinkles"
    pose = arm.bend(0.5)
    bpy.context.scene.frame_set(2)
    assert shows(arm.sleeve, bumps.shape(pose))
    # One that is not baked yet will lie beside the file, wherever that is.
    arm.sleeve.wrinkles.enabled = False
    arm.sleeve.wrinkles.database = "//later.wrinkles"
    save(tmp_path / "third" / "arm.blend")
    assert arm.sleeve.wrinkles.database == "//later.wrinkles"


def test_saving_a_copy_elsewhere_still_finds_the_database(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    arm.animate([{"elbow_L": [1.0]}] * 2)
    beside_the_file(arm, tmp_path)
    copy = save(tmp_path / "copies" / "copy.blend", copy=True, relative_remap=True)
    assert arm.sleeve.wrinkles.database == "//sleeve.wrinkles"
    bpy.context.scene.frame_set(1)
    assert playback.status(arm.sleeve).error == ""
    bpy.ops.wm.open_mainfile(filepath=str(copy))
    bpy.context.scene.frame_set(2)
    sleeve = bpy.data.objects["sleeve"]
    assert playback.status(sleeve).error == "", sleeve.wrinkles.database
    assert shows(sleeve, bumps.shape(bumps.pose({"elbow_L": np.array([1.0])})))


@contextmanager
def no_handlers_of_saving() -> Iterator[None]:
    """Blender calls none when it saves by itself."""
    names = [name for name in HANDLERS if name.startswith("save_")]
    for name in names:
        getattr(bpy.app.handlers, name).remove(HANDLERS[name])
    try:
        yield
    finally:
        for name in names:
            getattr(bpy.app.handlers, name).append(HANDLERS[name])


def test_a_recovered_file_goes_on_where_it_was(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    poses = arm.animate([{"elbow_L": [0.2 * k]} for k in range(6)])
    path = beside_the_file(arm, tmp_path)
    bpy.context.scene.frame_set(5)
    arm.sleeve.wrinkles.strength = 0.5
    # Blender itself gives a recovered file the path of the one that was worked on; only a window saves by itself.
    saved = tmp_path / "arm_autosave.blend"
    with no_handlers_of_saving():
        bpy.ops.wm.save_as_mainfile(filepath=str(saved), copy=True)
    empty_scene()
    assert bpy.ops.wm.recover_auto_save(filepath=str(saved)) == {"FINISHED"}
    sleeve = bpy.data.objects["sleeve"]
    assert sleeve.wrinkles.strength == 0.5
    half = {"elbow_L": 0.5, "shoulder_L": 0.5}
    for frame in (5, 3):
        bpy.context.scene.frame_set(frame)
        assert playback.status(sleeve).error == ""
        assert shows(sleeve, bumps.shape(poses[frame - 1], half))
    # Saved by hand, it is as any other file.
    save(path)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    bpy.context.scene.frame_set(2)
    assert shows(bpy.data.objects["sleeve"], bumps.shape(poses[1], half))


def test_an_appended_character_is_played(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    arm.animate([{"elbow_L": [1.0]}] * 2)
    path = save(tmp_path / "arm.blend")
    scene = empty_scene()
    with bpy.data.libraries.load(str(path)) as (source, target):
        target.objects = [name for name in source.objects if name in ("sleeve", "rig", "body")]
    for ob in target.objects:
        scene.collection.objects.link(ob)
    scene.frame_set(2)
    sleeve = bpy.data.objects["sleeve"]
    assert playback.status(sleeve).error == ""
    assert shows(sleeve, bumps.shape(bumps.pose({"elbow_L": np.array([1.0])})))


def test_a_linked_garment_gets_its_local_mesh_in_one_click(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    arm.animate([{"elbow_L": [1.0]}] * 2)
    character = bpy.data.collections.new("Character")
    for ob in list(bpy.context.scene.objects):
        bpy.context.scene.collection.objects.unlink(ob)
        character.objects.link(ob)
    bpy.context.scene.collection.children.link(character)
    path = save(tmp_path / "library.blend")
    scene = empty_scene()
    with bpy.data.libraries.load(str(path), link=True) as (_, target):
        target.collections = ["Character"]
    scene.collection.children.link(target.collections[0])
    bpy.context.view_layer.objects.active = bpy.data.objects["sleeve"]
    bpy.context.view_layer.update()
    assert "library override" in playback.status(bpy.data.objects["sleeve"]).error
    # The sidebar says why, and offers it.
    shown = draw(WRINKLE_PT_character)
    assert "wrinkles need a mesh of their own here" in shown.text and "wrinkle.make_local_mesh" in shown.operators
    assert bpy.ops.wrinkle.make_local_mesh() == {"FINISHED"}
    assert "wrinkle.make_local_mesh" not in draw(WRINKLE_PT_character).operators
    sleeve = bpy.context.object
    assert sleeve.library is None and sleeve.data.library is None
    scene.frame_set(2)
    assert playback.status(sleeve).error == ""
    assert shows(sleeve, bumps.shape(bumps.pose({"elbow_L": np.array([1.0])})))


def test_a_garment_that_was_moved_by_its_scene_is_shown_in_place(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(1.0)
    arm.sleeve.location = (0.0, 0.0, 1.0)
    bpy.context.scene.frame_set(2)
    assert shows(arm.sleeve, apply(np.linalg.inv(np.array(arm.sleeve.matrix_world)), bumps.shape(pose)))


def test_an_error_is_kept_once_however_many_frames_fail(arm: Arm, capfd: pytest.CaptureFixture[str]) -> None:
    arm.sleeve.data.vertices.add(1)
    for _ in range(10):
        playback.play_scene(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    assert "topology" in playback.status(arm.sleeve).error
    assert "Traceback" not in capfd.readouterr().err
