"""Finished garments in files that need no add-on: what is read back is what was shown."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import Arm, Bumps, build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon import cache_parts
from wrinkle_synthesis.wrinkle_addon.blender import clip_synthesis, exporters
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache

FRAMES = range(3, 9)
HUNDREDTH = 1.0e-5
"""0.01 mm: what may differ between what was shown and what is read back [m]."""


@pytest.fixture
def arm(database: Path, bumps: Bumps) -> Arm:
    """An arm that bends and lifts over frames 3 to 8, away from the world's origin, at 25 frames a second."""
    empty_scene()
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = FRAMES.start, FRAMES.stop - 1, 25
    arm = build_arm("", database)
    angles = [{"elbow_L": [0.25 * k], "shoulder_L": [0.05 * k, 0.1 * k, 0.0]} for k in range(len(FRAMES))]
    arm.animate(angles, start=FRAMES.start)
    arm.armature.rotation_euler = arm.sleeve.rotation_euler = (0.1, 0.2, 0.3)
    arm.armature.location = (0.3, 0.2, 0.1)
    arm.armature.keyframe_insert("location", frame=FRAMES.start)
    arm.armature.location = (0.6, 0.2, 0.4)
    arm.armature.keyframe_insert("location", frame=FRAMES.stop - 1)
    bpy.context.view_layer.objects.active = arm.sleeve
    return arm


@pytest.fixture
def file(arm: Arm, tmp_path: Path) -> Path:
    return save(tmp_path / "arm.blend")


def save(path: Path) -> Path:
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def in_world(name: str) -> np.ndarray:
    """An object as it is shown in every frame, in world space, shape [frame_count, vertex_count, 3]."""
    shown = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        evaluated = bpy.data.objects[name].evaluated_get(bpy.context.evaluated_depsgraph_get())
        shown.append([evaluated.matrix_world @ vertex.co for vertex in evaluated.data.vertices])
    return np.array(shown)


def only_mesh() -> str:
    (mesh,) = (ob.name for ob in bpy.data.objects if ob.type == "MESH")
    return mesh


def import_into_empty_scene(path: Path) -> None:
    empty_scene()
    bpy.context.scene.render.fps = 25
    if path.suffix == ".abc":
        bpy.ops.wm.alembic_import(filepath=str(path))
    else:
        bpy.ops.wm.usd_import(filepath=str(path))


# --- equal to what was shown --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [".abc", ".usdc", ".usda", ".usd"])
def test_an_exported_garment_is_the_one_that_was_shown(wrinkle, file: Path, tmp_path: Path, kind: str) -> None:
    shown = in_world("sleeve")
    outcome = wrinkle("synthesize", file, "--out", tmp_path / f"sleeve{kind}", "--json")
    assert outcome.code == 0, outcome.errors
    import_into_empty_scene(tmp_path / f"sleeve{kind}")
    # The garment alone is in the file: no armature, no body.
    np.testing.assert_allclose(in_world(only_mesh()), shown, atol=HUNDREDTH)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.blend", f"sleeve{kind}"]


@pytest.mark.parametrize("kind", [".abc", ".usdc"])
def test_later_modifiers_a_mask_and_a_hidden_garment_are_exported_as_shown(
    wrinkle, arm: Arm, tmp_path: Path, kind: str
) -> None:
    subdivision = arm.sleeve.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels = subdivision.render_levels = 1
    half = arm.sleeve.vertex_groups.new(name="half")
    half.add(list(range(0, 200)), 0.5, "REPLACE")
    arm.sleeve.wrinkles.mask = "half"
    shown = in_world("sleeve")
    arm.sleeve.hide_render = True
    assert wrinkle("synthesize", save(tmp_path / "arm.blend"), "--out", tmp_path / f"sleeve{kind}").code == 0
    import_into_empty_scene(tmp_path / f"sleeve{kind}")
    np.testing.assert_allclose(in_world(only_mesh()), shown, atol=HUNDREDTH)


def test_a_saved_copy_plays_the_cache_without_the_add_on(wrinkle, file: Path, tmp_path: Path) -> None:
    shown = in_world("sleeve")
    (tmp_path / "farm").mkdir()
    arguments = ("--out", tmp_path / "farm" / "sleeve.pc2", "--blend", tmp_path / "farm" / "sleeve.blend")
    assert wrinkle("synthesize", file, *arguments).code == 0
    # Both may go elsewhere together.
    shutil.move(tmp_path / "farm", tmp_path / "elsewhere")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "elsewhere" / "sleeve.blend"))
    sleeve = bpy.data.objects["sleeve"]
    assert not sleeve.wrinkles.enabled
    assert sleeve.modifiers["Wrinkles Cache"].filepath == "//sleeve.pc2"
    np.testing.assert_allclose(in_world("sleeve"), shown, atol=HUNDREDTH)
    bpy.ops.wm.open_mainfile(filepath=str(file))
    assert "Wrinkles Cache" not in bpy.data.objects["sleeve"].modifiers


@pytest.mark.parametrize("name", ["sleeve.pc2", "sleeve.abc", "sleeve.usdc"])
def test_the_operator_writes_what_is_shown_and_changes_nothing(arm: Arm, tmp_path: Path, name: str) -> None:
    shown = in_world("sleeve")
    modifiers, scenes = arm.sleeve.modifiers.keys(), bpy.data.scenes.keys()
    assert bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / name)) == {"FINISHED"}
    assert (arm.sleeve.modifiers.keys(), bpy.data.scenes.keys()) == (modifiers, scenes)
    assert arm.sleeve.wrinkles.enabled and bpy.context.scene.frame_current == FRAMES.stop - 1
    np.testing.assert_allclose(in_world("sleeve"), shown, atol=1e-7)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    if name.endswith(".pc2"):
        assert len(PointCache(tmp_path / name).frames) == len(FRAMES)
        return
    import_into_empty_scene(tmp_path / name)
    np.testing.assert_allclose(in_world(only_mesh()), shown, atol=HUNDREDTH)


def test_the_operator_lets_the_garment_play_the_cache(arm: Arm, tmp_path: Path) -> None:
    shown = in_world("sleeve")
    for _ in range(2):
        assert bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "sleeve.pc2"), play=True) == {"FINISHED"}
        assert not arm.sleeve.wrinkles.enabled
        np.testing.assert_allclose(in_world("sleeve"), shown, atol=HUNDREDTH)
    assert [modifier.type for modifier in arm.sleeve.modifiers] == ["ARMATURE", "NODES", "MESH_CACHE"]


# --- in parts -----------------------------------------------------------------------------------------------------


def test_parts_in_any_order_make_the_same_file_as_one_run(wrinkle, file: Path, tmp_path: Path) -> None:
    one, many = tmp_path / "one.pc2", tmp_path / "many.pc2"
    assert wrinkle("synthesize", file, "--out", one).code == 0
    for part in ("6:8", "3:4", "4:5"):
        assert wrinkle("synthesize", file, "--out", many, "--part", part).code == 0
    assert not many.exists()
    assert wrinkle("synthesize", file, "--out", many, "--json").result["made"] == 0
    assert many.read_bytes() == one.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.blend", "many.pc2", "one.pc2"]


def test_the_last_run_makes_what_is_missing(wrinkle, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "sleeve.usdc"
    shown = in_world("sleeve")
    wrinkle("synthesize", file, "--out", out, "--part", "4:6")
    assert wrinkle("synthesize", file, "--out", out, "--json").result["made"] == len(FRAMES) - 3
    import_into_empty_scene(out)
    np.testing.assert_allclose(in_world(only_mesh()), shown, atol=HUNDREDTH)


def test_a_run_that_is_stopped_goes_on(wrinkle, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_parts, "LONGEST", 2)
    whole = clip_synthesis.step_frames

    def stopped(*arguments: object):
        for frame in whole(*arguments):
            if frame == 6:
                raise KeyboardInterrupt
            yield frame

    monkeypatch.setattr(clip_synthesis, "step_frames", stopped)
    assert wrinkle("synthesize", file, "--out", tmp_path / "a.pc2").code == 130
    assert not (tmp_path / "a.pc2").exists()
    monkeypatch.setattr(clip_synthesis, "step_frames", whole)
    assert wrinkle("synthesize", file, "--out", tmp_path / "a.pc2", "--json").result["made"] == 4
    assert wrinkle("synthesize", file, "--out", tmp_path / "b.pc2").code == 0
    assert (tmp_path / "a.pc2").read_bytes() == (tmp_path / "b.pc2").read_bytes()


def test_parts_of_a_file_or_of_options_that_changed_are_not_used(wrinkle, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "sleeve.pc2"
    wrinkle("synthesize", file, "--out", out, "--part", "3:8")
    paper = wrinkle("synthesize", file, "--out", out, "--part", "3:8", "--formulation", "paper", "--json")
    assert paper.result["made"] == len(FRAMES)
    bpy.data.objects["sleeve"].wrinkles.strength = 0.5
    save(file)
    assert wrinkle("synthesize", file, "--out", out, "--json").result["made"] == len(FRAMES)
    assert not (tmp_path / "sleeve.pc2.parts").exists()


# --- refused ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--out", "a.pc2", "--part", "7:9"), "The part 7:9 is not within the frames 3 to 8."),
        (("--out", "a.pc2", "--part", "3:8:2"), "A part is given as FIRST:LAST"),
        (("--out", "a.pc2", "--part", "8:3"), "8:3 is empty"),
        (
            (
                "--out",
                "a.obj",
            ),
            "saved as a .pc2, .abc, .usd, .usdc or .usda file, not as 'a.obj'",
        ),
        (("--out", "a.pc2", "--blend", "a.txt"), "saved as a .blend file"),
        (("--out", "a.abc", "--blend", "b.blend"), "With --blend, the whole clip is written, and as a .pc2 file."),
        (("--out", "a.pc2", "--blend", "b.blend", "--part", "3:4"), "With --blend, the whole clip is written"),
    ],
)
def test_output_that_makes_no_sense_is_said_in_one_sentence(
    wrinkle, file: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], sentence: str
) -> None:
    monkeypatch.chdir(file.parent)
    assert sentence in wrinkle("synthesize", "arm.blend", *arguments).complaint
    assert [path.name for path in file.parent.iterdir()] == ["arm.blend"]


def test_a_blender_without_an_exporter_says_so_before_any_work(
    wrinkle, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exporters, "_is_built_in", lambda name: False)
    complaint = wrinkle("synthesize", file, "--out", tmp_path / "a.abc").complaint
    assert complaint == "This Blender was built without Alembic; write a .pc2 file, or use an official build."
    with pytest.raises(RuntimeError, match="built without USD"):
        bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "a.usd"))


def test_the_operator_refuses_what_cannot_be_written_or_played(arm: Arm, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="frame range is empty"):
        bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "a.pc2"), frame_start=5, frame_end=4)
    with pytest.raises(RuntimeError, match="Mesh Cache modifier plays"):
        bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "a.abc"), play=True)
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Leave edit mode"):
        bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "a.abc"))
    bpy.ops.object.mode_set(mode="OBJECT")
    arm.sleeve.wrinkles.database = str(tmp_path / "none.wrinkles")
    with pytest.raises(RuntimeError, match="There is no database"):
        bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "a.pc2"))
    assert not list(tmp_path.iterdir())


def test_an_export_that_fails_leaves_an_older_file_and_the_garment_as_they_were(
    wrinkle, arm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a.abc"
    out.write_bytes(b"older")

    def fails(path: Path, frames: range) -> None:
        path.write_bytes(b"torn")
        raise RuntimeError("Error: the disk is full")

    monkeypatch.setattr(exporters, "_export", fails)
    with pytest.raises(RuntimeError, match="could not be written: the disk is full"):
        bpy.ops.wrinkle.write_clip(filepath=str(out))
    assert out.read_bytes() == b"older" and [path.name for path in tmp_path.iterdir()] == ["a.abc"]
    assert [modifier.type for modifier in arm.sleeve.modifiers] == ["ARMATURE", "NODES"]
    assert len(bpy.data.scenes) == 1
