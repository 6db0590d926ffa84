"""The verbs that make a character ready, on files as an artist has them: setup, joints, check, plan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from dolls import doll
from figures import build_figure, mesh_object
from small_character import build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon.fabrics import FABRICS

FIGURE = doll(31, 12)


@pytest.fixture
def figure(tmp_path: Path) -> Path:
    """A file with a body and a shirt that is not set up."""
    empty_scene()
    build_figure(FIGURE)
    return save(tmp_path / "figure.blend")


@pytest.fixture
def ready(figure: Path, tmp_path: Path, wrinkle) -> Path:
    """The same, set up with a plan of six simulated samples."""
    path = tmp_path / "ready.blend"
    arguments = ("--subdivide", 0, "--joints", "elbow_L,elbow_R", "--samples", 6, "--out", path)
    outcome = wrinkle("setup", figure, "--garment", "shirt", "--body", "body", *arguments)
    assert outcome.code == 0, outcome.errors
    return path


def save(path: Path) -> Path:
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def garment(path: Path) -> bpy.types.Object:
    """The shirt in a file."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.data.objects["shirt"]


# --- setup --------------------------------------------------------------------------------------------------------


def test_setup_finds_the_joints_that_move_the_garment(wrinkle, figure: Path, tmp_path: Path) -> None:
    arguments = ("--garment", "shirt", "--body", "body", "--ease", "2,3", "--quick", "--out", tmp_path / "out.blend")
    outcome = wrinkle("setup", figure, *arguments, "--json")
    assert outcome.code == 0, outcome.errors
    assert outcome.result["sampled"] == ["elbow_L", "elbow_R", "shoulder_L", "shoulder_R"]
    assert outcome.result["vertices"] >= 10_000
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    settings = bpy.data.objects["shirt.wrinkles"].wrinkles
    assert (settings.ease_girth, settings.ease_length, settings.plan, settings.budget) == (2.0, 3.0, "BUDGET", 36)
    assert settings.database == "//shirt.wrinkles"


def test_setup_takes_a_fabric_by_its_name(wrinkle, figure: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.blend"
    arguments = ("--garment", "shirt", "--body", "body", "--subdivide", 0, "--out", out)
    outcome = wrinkle("setup", figure, *arguments, "--fabric", "denim")
    assert outcome.code == 0, outcome.errors
    assert garment(out).wrinkles.bake_settings().fabric == FABRICS["denim"]
    complaint = wrinkle("setup", figure, *arguments, "--fabric", "felt").complaint
    assert complaint.startswith("There is no fabric 'felt'")


def loose_vertex() -> None:
    bpy.data.objects["shirt"].data.vertices.add(1)


def third_face() -> None:
    positions = [vertex.co[:] for vertex in bpy.data.objects["shirt"].data.vertices]
    faces = [tuple(polygon.vertices) for polygon in bpy.data.objects["shirt"].data.polygons]
    replace_shirt(positions, [*faces, (*faces[100][:2], 3)])


def flat_face() -> None:
    positions = [vertex.co[:] for vertex in bpy.data.objects["shirt"].data.vertices]
    faces = [tuple(polygon.vertices) for polygon in bpy.data.objects["shirt"].data.polygons]
    a, b, c = faces[100]
    positions[c] = tuple(0.5 * (np.array(positions[a]) + np.array(positions[b])))
    replace_shirt(positions, faces)


def replace_shirt(positions: list, faces: list) -> None:
    bpy.data.objects.remove(bpy.data.objects["shirt"])
    mesh_object("shirt", np.array(positions), np.array(faces))


def not_a_number() -> None:
    bpy.data.objects["shirt"].data.vertices[5].co.x = np.nan


def no_garment_faces() -> None:
    replace_shirt([(0.0, 0.0, 1.0), (0.1, 0.0, 1.0)], [])


def far_away() -> None:
    bpy.data.objects["shirt"].location.z = 3.0


def deep_inside() -> None:
    centres = FIGURE.garment.positions.reshape(31, 12, 3).mean(1, keepdims=True).repeat(12, 1).reshape(-1, 3)
    replace_shirt((centres + 0.05 * (FIGURE.garment.positions - centres)).tolist(), FIGURE.garment.faces.tolist())


def no_armature() -> None:
    bpy.data.objects.remove(bpy.data.objects["Figure"])


def body_without_faces() -> None:
    bpy.data.objects["body"].data.clear_geometry()


def body_without_weights() -> None:
    bpy.data.objects["body"].vertex_groups.clear()


def uneven_scale() -> None:
    bpy.data.objects["Figure"].scale = (1.0, 1.0, 2.0)


def giant() -> None:
    bpy.context.scene.unit_settings.scale_length = 100.0


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (loose_vertex, "1 loose vertices that belong to no face"),
        (third_face, "1 edges with more than two faces"),
        (flat_face, "faces without area"),
        (not_a_number, "1 vertices of the garment 'shirt' have positions that are not numbers"),
        (no_garment_faces, "'shirt' has no faces"),
        (far_away, "m away from the body; put it on the body"),
        (deep_inside, "more than 30 mm inside the body"),
        (no_armature, "'shirt' has no armature"),
        (body_without_faces, "'body' has no faces"),
        (body_without_weights, "'body' has no vertex groups named like the deforming bones"),
        (uneven_scale, "scaled unevenly"),
        (giant, "m tall; set the scene's unit scale"),
    ],
)
def test_what_cannot_be_set_up_is_said_in_one_sentence_and_nothing_is_written(
    wrinkle, figure: Path, tmp_path: Path, spoil: Callable[[], None], sentence: str
) -> None:
    spoil()
    save(figure)
    out = tmp_path / "out.blend"
    outcome = wrinkle("setup", figure, "--garment", "shirt", "--body", "body", "--subdivide", 0, "--out", out)
    assert sentence in outcome.complaint
    assert not out.exists()


OPTIONS = {"": "figure.blend", "--garment": "shirt", "--body": "body", "--subdivide": "0", "--out": "out.blend"}


@pytest.mark.parametrize(
    ("option", "value", "sentence"),
    [
        ("", "none.blend", "There is no file"),
        ("--garment", "coat", "its meshes: body, shirt"),
        ("--garment", "Figure", "'Figure' is no mesh"),
        ("--body", "shirt", "are the same object"),
        ("--armature", "rig", "its armatures: Figure"),
        ("--out", "out.obj", "saved as a .blend file"),
        ("--out", "far/out.blend", "There is no folder"),
        ("--ease", "3", "GIRTH,LENGTH"),
        ("--pins", "belt", "no vertex group 'belt'"),
        ("--joints", "tail", "no joint 'tail'; its joints: elbow_L"),
        ("--samples", "0", "at least one sample, not 0"),
        ("--ranges", "Dance", "no action 'Dance'; its actions: none"),
        ("--ranges", "5:1", "5:1 is empty"),
    ],
)
def test_options_that_name_nothing_are_said_in_one_sentence(
    wrinkle, figure: Path, monkeypatch: pytest.MonkeyPatch, option: str, value: str, sentence: str
) -> None:
    monkeypatch.chdir(figure.parent)
    options = {**OPTIONS, option: value}
    arguments = [part for name, given in options.items() for part in ((name, given) if name else (given,))]
    assert sentence in wrinkle("setup", *arguments).complaint
    assert not Path("out.blend").exists()


def test_a_verb_without_a_file_asks_for_one(wrinkle) -> None:
    empty_scene()
    for verb in ("check", "plan", "bake", "joints"):
        assert "No file is open; name a file that exists" in wrinkle(verb).complaint


def test_a_garment_that_was_not_set_up_is_named(wrinkle, figure: Path) -> None:
    assert "No garment in the file was set up" in wrinkle("plan", figure).complaint


def test_several_garments_must_be_told_apart(wrinkle, tmp_path: Path) -> None:
    empty_scene()
    build_arm("left ")
    build_arm("right ")
    path = save(tmp_path / "arms.blend")
    assert "left sleeve, right sleeve; name one" in wrinkle("plan", path).complaint
    assert "'left body' was not set up" in wrinkle("plan", path, "--garment", "left body").complaint
    assert wrinkle("plan", path, "--garment", "left sleeve").code == 0


# --- joints -------------------------------------------------------------------------------------------------------


def test_the_joints_of_a_garment_are_shown_with_what_is_sampled(wrinkle, ready: Path) -> None:
    shown = wrinkle("joints", ready, "--garment", "shirt", "--json").result
    assert set(shown) == {"elbow_L", "elbow_R", "shoulder_L", "shoulder_R"}
    assert shown["elbow_L"]["bones"] == ["forearm_L"] and shown["elbow_L"]["sampled"]
    assert not shown["shoulder_L"]["sampled"]


def test_joints_are_added_by_name_or_by_bones(wrinkle, ready: Path, tmp_path: Path) -> None:
    out = tmp_path / "more.blend"
    added = ("--add", "wrist_L", "--add", "neck", "--add", "waist=spine2", "--add-hinge", "knuckle_R=hand_R")
    outcome = wrinkle("joints", ready, *added, "--sample", "wrist_L,knuckle_R", "--out", out)
    assert outcome.code == 0, outcome.errors
    shown = wrinkle("joints", out, "--garment", "shirt", "--json").result
    assert shown["wrist_L"]["bones"] == ["hand_L"] and shown["wrist_L"]["dof"] == 3
    assert shown["neck"]["bones"] == ["neck", "head"]
    assert shown["waist"]["bones"] == ["spine2"]
    assert shown["knuckle_R"]["dof"] == 1
    assert {name for name, joint in shown.items() if joint["sampled"]} == {"wrist_L", "knuckle_R"}
    assert set(wrinkle("plan", out, "--full", "--json").result["joints"]) == {"wrist_L", "knuckle_R"}


def test_joints_are_changed_and_removed(wrinkle, ready: Path, tmp_path: Path) -> None:
    out = tmp_path / "changed.blend"
    changes = ("--remove", "shoulder_R", "--range", "elbow_L=-5:90", "--range", "shoulder_L=0:10,-20:30,-40:50")
    assert wrinkle("joints", ready, *changes, "--add-hinge", "elbow_R=hand_R", "--out", out).code == 0
    shown = wrinkle("joints", out, "--garment", "shirt", "--json").result
    assert "shoulder_R" not in shown
    assert shown["elbow_R"]["bones"] == ["hand_R"]
    np.testing.assert_allclose(shown["elbow_L"]["range_deg"], [-5, 90], atol=0.01)
    np.testing.assert_allclose(shown["shoulder_L"]["range_deg"], [[0, 10], [-20, 30], [-40, 50]], atol=0.01)


def test_ranges_are_taken_from_an_action_or_from_frames(wrinkle, tmp_path: Path) -> None:
    empty_scene()
    arm = build_arm()
    arm.animate([{"elbow_L": [0.1 * k]} for k in range(9)])
    wave = arm.armature.animation_data.action
    wave.name = "Wave"
    arm.animate([{"elbow_L": [0.5]}, {"elbow_L": [0.0]}])
    path, out = save(tmp_path / "arm.blend"), tmp_path / "out.blend"
    bpy.data.actions["Wave"].use_fake_user = True
    save(path)
    for ranges, expected in (("Wave", np.degrees(0.8)), ("1:2", np.degrees(0.5))):
        outcome = wrinkle("joints", path, "--ranges", ranges, "--margin", 2, "--out", out, "--json")
        np.testing.assert_allclose(outcome.result["elbow_L"]["range_deg"], [-2, expected + 2], atol=0.01)
        bpy.ops.wm.open_mainfile(filepath=str(out))
        assert bpy.data.objects["rig"].animation_data.action != bpy.data.actions["Wave"]
    assert "no action 'Dance'; its actions: " in wrinkle("joints", path, "--ranges", "Dance", "--out", out).complaint


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("--add", "tail"), "No bone was found for joint tail; name the bones that turn"),
        (("--add", "tail=tail_1"), "which the rig does not have"),
        (("--add", "a/b=hand_L"), "cannot be a joint's name"),
        (("--remove", "spine"), "no joint 'spine'; its joints: elbow_L"),
        (("--sample", "spine"), "no joint 'spine'; its joints: elbow_L"),
        (("--range", "elbow_L"), "A range is given as"),
        (("--range", "elbow_L=10"), "A range is given as"),
        (("--range", "elbow_L=1:2,3:4"), "needs 1 ranges"),
        (("--range", "elbow_L=10:40"), "elbow_L"),
        (("--range", "elbow_L=nan:40"), "needs 1 ranges"),
        (("--ranges", "9:3"), "9:3 is empty"),
    ],
)
def test_changes_that_make_no_sense_are_said_in_one_sentence(
    wrinkle, ready: Path, tmp_path: Path, change: tuple[str, ...], sentence: str
) -> None:
    out = tmp_path / "out.blend"
    assert sentence in wrinkle("joints", ready, *change, "--out", out).complaint
    assert not out.exists()


def test_changes_must_be_saved_somewhere(wrinkle, ready: Path) -> None:
    assert "with --out" in wrinkle("joints", ready, "--remove", "elbow_L").complaint


# --- plan and check -----------------------------------------------------------------------------------------------


def test_a_plan_says_what_it_costs_and_can_be_chosen(wrinkle, ready: Path, tmp_path: Path) -> None:
    stored = wrinkle("plan", ready, "--json").result
    assert stored["simulated"] == 7 and stored["samples"] == 13 and stored["symmetric"]
    assert stored["raw_bytes"] == 13 * FIGURE.garment.vertex_count * 12
    assert wrinkle("plan", ready, "--quick", "--json").result["simulated"] == 37
    full = wrinkle("plan", ready, "--full", "--json").result
    steps = np.diff(full["joints"]["elbow_L"]["angles_deg"][0])
    assert steps.max() < 16.5
    assert wrinkle("plan", ready, "--json").result == stored
    chosen = tmp_path / "chosen.blend"
    wrinkle("plan", ready, "--full", "--out", chosen)
    assert wrinkle("plan", chosen, "--json").result == full


def test_check_finds_what_would_stop_a_bake(wrinkle, ready: Path) -> None:
    outcome = wrinkle("check", ready, "--json")
    assert outcome.code == 0 and outcome.result["ok"]
    assert "is not baked yet" in outcome.result["notes"][-1]
    garment(ready).location.z = 2.0
    save(ready)
    outcome = wrinkle("check", ready, "--json")
    assert outcome.code == 2 and "m away from the body" in outcome.result["problems"][0]


def test_a_removed_body_or_bone_is_named(wrinkle, ready: Path) -> None:
    garment(ready)
    armature = bpy.data.objects["Figure"]
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones.remove(armature.data.edit_bones["forearm_L"])
    bpy.ops.object.mode_set(mode="OBJECT")
    save(ready)
    assert "forearm_L, which the armature no longer has" in wrinkle("plan", ready).complaint
    bpy.data.objects.remove(bpy.data.objects["body"])
    save(ready)
    assert "has lost its body" in wrinkle("plan", ready).complaint


def test_a_rig_without_human_joints_gets_them_by_hand(wrinkle, tmp_path: Path) -> None:
    empty_scene()
    arm = build_arm()
    path, out = save(tmp_path / "arm.blend"), tmp_path / "out.blend"
    outcome = wrinkle("setup", path, "--garment", "sleeve", "--body", "body", "--subdivide", 0, "--out", out, "--json")
    assert outcome.code == 0 and outcome.result["sampled"] == []
    assert "No joint of the garment 'sleeve' is chosen for sampling" in wrinkle("plan", out).complaint
    added = ("--add-hinge", f"bend={arm.rig.names[1]}", "--out", path)
    assert wrinkle("joints", out, "--garment", "sleeve", *added).code == 0
    assert list(wrinkle("plan", path, "--json").result["joints"]) == ["bend"]


# --- other kinds of files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [".glb", ".fbx"])
def test_an_imported_character_is_set_up_whole(wrinkle, figure: Path, tmp_path: Path, kind: str) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(figure))
    for name in ("body", "shirt"):
        bpy.data.objects[name].parent = bpy.data.objects["Figure"]
    path, out = tmp_path / f"figure{kind}", tmp_path / "out.blend"
    if kind == ".fbx":
        bpy.ops.export_scene.fbx(filepath=str(path), add_leaf_bones=False)
    else:
        bpy.ops.export_scene.gltf(filepath=str(path))
    options = ("--subdivide", 0, "--samples", 2, "--out", out, "--json")
    result = wrinkle("setup", path, "--garment", "shirt", "--body", "body", *options).result
    assert result["vertices"] == FIGURE.garment.vertex_count and result["notes"] == []
    assert set(result["sampled"]) == {"elbow_L", "elbow_R", "shoulder_L", "shoulder_R"}
    # An FBX file is in centimetres; what is baked is in metres all the same.
    assert wrinkle("check", out).code == 0


def test_a_shirt_that_only_looks_sewn_is_told(wrinkle, figure: Path, tmp_path: Path) -> None:
    positions, faces = FIGURE.garment.positions, FIGURE.garment.faces
    replace_shirt(positions[faces].reshape(-1, 3).tolist(), np.arange(3 * len(faces)).reshape(-1, 3).tolist())
    save(figure)
    options = ("--subdivide", 0, "--out", tmp_path / "out.blend", "--json")
    (note,) = wrinkle("setup", figure, "--garment", "shirt", "--body", "body", *options).result["notes"]
    assert f"{3 * len(faces)} vertices of 'shirt' lie where others do" in note
