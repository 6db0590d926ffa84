"""A garment replays its recorded animation in Blender: through the handler, the operator and the command line."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import Arm, build_arm, empty_scene, evaluated_positions, heights
from wrinkle_synthesis.wrinkle_addon import cli
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.blender.flow_compression import READING, compress_garment
from wrinkle_synthesis.wrinkle_addon.blender.flow_playback import FlowPlayer
from wrinkle_synthesis.wrinkle_addon.blender.flow_recording import SCENE, RecordingChoice
from wrinkle_synthesis.wrinkle_addon.blender.handlers import suspended
from wrinkle_synthesis.wrinkle_addon.blender.write import show_skinned
from wrinkle_synthesis.wrinkle_addon.flow_compress import Goal
from wrinkle_synthesis.wrinkle_addon.flow_file import read_flow
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache, write_pc2

FRAMES = range(3, 15)
ERROR = 0.2
"""Root mean square error asked for [mm]."""


@pytest.fixture
def arm() -> Arm:
    """An arm that bends and walks off, in a sleeve whose folds are an animated shape key."""
    empty_scene()
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = FRAMES.start, FRAMES.stop - 1
    arm = build_arm()
    arm.animate([{"elbow_L": [0.1 * k], "shoulder_L": [0.03 * k, 0.0, 0.02 * k]} for k in range(12)], FRAMES.start)
    arm.armature.rotation_euler = (0.1, 0.2, 0.3)
    for place, frame in ((0.3, FRAMES.start), (0.8, FRAMES.stop - 1)):
        arm.armature.location = (place, 0.1, 0.0)
        arm.armature.keyframe_insert("location", frame=frame)
    sleeve = arm.sleeve
    sleeve.parent = sleeve.wrinkles.body.parent = arm.armature
    sleeve.shape_key_add(name="Basis")
    key = sleeve.shape_key_add(name="Folds")
    for point in key.data:
        point.co.z += 0.01 * np.sin(40.0 * point.co.x)
    for value, frame in ((0.0, FRAMES.start), (1.0, FRAMES.stop - 1)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    bpy.context.view_layer.objects.active = sleeve
    return arm


def record(arm: Arm) -> dict[int, np.ndarray]:
    """The sleeve as its modifiers show it, in object space, by frame."""
    shown = {}
    with suspended():
        show_skinned(arm.sleeve)
        for frame in FRAMES:
            bpy.context.scene.frame_set(frame)
            shown[frame] = evaluated_positions(arm.sleeve)
    return shown


def compress(tmp_path: Path, **options) -> Path:
    out = tmp_path / "sleeve.flow"
    assert bpy.ops.wrinkle.compress_flow(filepath=str(out), error=ERROR, **options) == {"FINISHED"}
    return out


def rms_mm(found: np.ndarray, expected: np.ndarray) -> float:
    return 1e3 * float(np.sqrt(np.square(found - expected).sum(-1).mean()))


def folds_off(arm: Arm) -> None:
    """Take away what made the folds: whatever is shown now comes from the flow."""
    arm.sleeve.shape_key_clear()


def run(*arguments: object, expect: int = 0, capsys: pytest.CaptureFixture) -> dict:
    code = cli.main([*map(str, arguments), "--json"])
    result = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert code == expect, result
    return result


# --- playback -----------------------------------------------------------------------------------------------------


def test_every_frame_shows_what_was_recorded_in_any_order(arm: Arm, tmp_path: Path) -> None:
    recorded = record(arm)
    compress(tmp_path)
    folds_off(arm)
    shown = {}
    for frame in (14, 3, 9, 5, 9):
        bpy.context.scene.frame_set(frame)
        assert playback.status(arm.sleeve).error == ""
        positions = evaluated_positions(arm.sleeve)
        # The bound is on the mean over the clip; one frame may be worse.
        assert rms_mm(positions, recorded[frame]) < 3 * ERROR
        assert np.array_equal(shown.setdefault(frame, positions), positions)
    assert rms_mm(recorded[14], record(arm)[14]) > 5.0


def test_strength_0_is_skinning_and_changes_show_at_once(arm: Arm, tmp_path: Path) -> None:
    compress(tmp_path)
    folds_off(arm)
    bpy.context.scene.frame_set(12)
    skinned = record(arm)[12]
    bpy.context.scene.frame_set(12)
    recorded = evaluated_positions(arm.sleeve)
    arm.sleeve.wrinkles.strength = 0.0
    plain = evaluated_positions(arm.sleeve)
    # Coded weights and rest positions are rounded by up to 0.5 % and 0.05 mm.
    assert rms_mm(plain, skinned) < 1.0
    arm.sleeve.wrinkles.strength = 2.0
    assert np.allclose(evaluated_positions(arm.sleeve), 2 * recorded - plain, atol=1e-5)


def test_subframes_and_time_settings(arm: Arm, tmp_path: Path) -> None:
    scene, settings = bpy.context.scene, arm.sleeve.wrinkles.flow
    compress(tmp_path)
    arm.armature.animation_data_clear()
    scene.frame_set(8)
    at_8 = evaluated_positions(arm.sleeve)
    scene.frame_set(9)
    at_9 = evaluated_positions(arm.sleeve)
    scene.frame_set(8, subframe=0.5)
    assert np.allclose(evaluated_positions(arm.sleeve), 0.5 * (at_8 + at_9), atol=1e-5)
    settings.offset = 1.0
    scene.frame_set(9)
    assert np.array_equal(evaluated_positions(arm.sleeve), at_8)
    settings.offset, settings.speed = 0.0, 2.0
    scene.frame_set(6)
    assert np.array_equal(evaluated_positions(arm.sleeve), at_9)
    settings.speed = 1.0
    scene.frame_set(30)
    player = playback.status(arm.sleeve).player
    assert isinstance(player, FlowPlayer)
    assert player.note == "16 frames outside of the recording: its end is held"
    settings.ends = "LOOP"
    scene.frame_set(8 + 11)
    assert np.array_equal(evaluated_positions(arm.sleeve), at_8)
    assert player.note == ""


def test_a_saved_file_plays_again_and_saves_the_skinned_shape(arm: Arm, tmp_path: Path) -> None:
    compress(tmp_path)
    bpy.context.scene.frame_set(12)
    shown = evaluated_positions(arm.sleeve)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.context.scene.frame_set(12)
    assert np.array_equal(evaluated_positions(bpy.data.objects["sleeve"]), shown)


def test_compressing_tells_how_far_it_is_and_leaves_the_scene_as_it_was(arm: Arm, tmp_path: Path) -> None:
    out, scene = tmp_path / "sleeve.flow", bpy.context.scene
    scene.frame_set(7)
    playing = len(bpy.app.handlers.frame_change_post)
    shares = []
    compress_garment(
        arm.sleeve, RecordingChoice(SCENE, FRAMES), Goal(rms_mm=ERROR), out, lambda share, text: shares.append(share)
    )
    assert shares == sorted(shares) and shares[-1] <= 1.0
    assert len([share for share in shares if share <= READING]) >= 2 * len(FRAMES)
    assert scene.frame_current == 7
    assert len(bpy.app.handlers.frame_change_post) == playing
    assert list(tmp_path.iterdir()) == [out]


def test_the_file_tells_what_other_errors_would_cost(arm: Arm, tmp_path: Path) -> None:
    sizes, errors = zip(*read_flow(compress(tmp_path)).header.curve, strict=True)
    assert sorted(sizes) == list(sizes)
    assert sorted(errors, reverse=True) == list(errors)


def test_switching_the_replay_off_goes_back_to_the_database_s_ways(arm: Arm, tmp_path: Path) -> None:
    compress(tmp_path)
    arm.sleeve.wrinkles.flow.replays = False
    with suspended():
        pass
    playback.play_scene(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    assert "has no database" in playback.status(arm.sleeve).error


def test_a_replay_is_pushed_out_of_the_body_where_that_is_asked_for(arm: Arm, tmp_path: Path) -> None:
    compress(tmp_path)
    folds_off(arm)
    settings = arm.sleeve.wrinkles
    bpy.context.scene.frame_set(14)
    # Exaggerated, the folds go through the arm.
    settings.strength = 3.0
    through = evaluated_positions(arm.sleeve)
    assert heights(arm).min() < -0.003
    settings.flow.clear_of_body = True
    bpy.context.view_layer.update()
    # The clearance of 3 mm, less half of the softness, and less what the arm's facets of 20 mm make of it.
    assert heights(arm).min() > 0.0015
    arm.sleeve.wrinkles.body.hide_viewport = True
    bpy.context.view_layer.update()
    player = playback.status(arm.sleeve).player
    assert isinstance(player, FlowPlayer)
    assert "is hidden. The garment 'sleeve' plays without being kept clear of it." in player.note
    assert np.array_equal(evaluated_positions(arm.sleeve), through)


# --- what does not fit --------------------------------------------------------------------------------------------


def error_of(arm: Arm) -> str:
    playback.doubt(arm.sleeve)
    playback.play_scene(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    return playback.status(arm.sleeve).error


def test_another_mesh_another_rig_and_a_damaged_file_are_said(arm: Arm, tmp_path: Path) -> None:
    path = compress(tmp_path)
    folds_off(arm)
    bpy.context.scene.frame_set(8)
    assert error_of(arm) == ""
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    playback.forget(arm.sleeve)
    assert "damaged" in error_of(arm)
    path.write_bytes(whole)
    assert error_of(arm) == ""
    arm.armature.data.bones["lower"].name = "forearm"
    assert "has lost the bone 'lower'; undo the change or compress the recording again" in error_of(arm)
    arm.armature.data.bones["forearm"].name = "lower"
    other = bpy.data.meshes.new("other")
    other.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    arm.sleeve.data = other
    assert "is not the recorded mesh" in error_of(arm)


def test_modifiers_that_change_the_topology_are_refused(arm: Arm, tmp_path: Path) -> None:
    arm.sleeve.modifiers.new("fine", "SUBSURF")
    with pytest.raises(RuntimeError, match="switch off the modifiers"):
        compress(tmp_path)


# --- recordings from files ----------------------------------------------------------------------------------------


@pytest.fixture
def cache(arm: Arm, tmp_path: Path) -> Path:
    recorded = record(arm)
    frames = (recorded[frame].astype(np.float32) for frame in FRAMES)
    write_pc2(tmp_path / "sleeve.pc2", len(recorded[3]), FRAMES.start, frames, len(FRAMES))
    return tmp_path / "sleeve.pc2"


@pytest.mark.parametrize("weights", ["own", "nearest", "surface", "fit"])
def test_any_weights_keep_the_bound(arm: Arm, cache: Path, tmp_path: Path, weights: str, capsys) -> None:
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    out = tmp_path / "a.flow"
    blend = tmp_path / "arm.blend"
    made = run(
        "flow", "compress", blend, "--recording", cache, "--weights", weights, "--error", ERROR, "--out", out,
        capsys=capsys,
    )  # fmt: skip
    assert made["measured_rms_mm"] <= made["rms_mm"] == ERROR
    checked = run("flow", "verify", out, blend, "--recording", cache, capsys=capsys)
    assert checked["ok"]
    assert checked["rms_mm"] == pytest.approx(made["measured_rms_mm"], rel=1e-3)


def test_a_recording_comes_back_as_a_point_cache(arm: Arm, cache: Path, tmp_path: Path, capsys) -> None:
    blend, out, back = tmp_path / "arm.blend", tmp_path / "flows" / "a.flow", tmp_path / "back.pc2"
    out.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    run("flow", "compress", blend, "--recording", "scene", "--error", ERROR, "--out", out, capsys=capsys)
    told = run("flow", "info", out, capsys=capsys)
    assert (told["frames"], told["first_frame"], told["garment"]) == (12, 3.0, "sleeve")
    played = run("flow", "play", blend, "--flow", out, "--out", back, "--frames", "3:17", capsys=capsys)
    assert played["outside"] == 3
    assert rms_mm(PointCache(back).frames[:12], PointCache(cache).frames) <= ERROR
    shown = tmp_path / "elsewhere" / "shown.blend"
    shown.parent.mkdir()
    run("flow", "play", blend, "--flow", out, "--blend", shown, "--speed", "0.5", capsys=capsys)
    bpy.ops.wm.open_mainfile(filepath=str(shown))
    settings = bpy.data.objects["sleeve"].wrinkles
    assert settings.enabled
    assert settings.flow.replays
    assert settings.flow.speed == 0.5
    assert settings.flow.path == "//../flows/a.flow"
    bpy.context.scene.frame_set(8)
    assert playback.status(bpy.data.objects["sleeve"]).error == ""


@pytest.mark.parametrize("suffix", [".abc", ".usdc"])
def test_alembic_and_usd_come_in_through_blender_s_importers(arm: Arm, tmp_path: Path, suffix: str) -> None:
    if not getattr(bpy.app.build_options, {".abc": "alembic", ".usdc": "usd"}[suffix]):
        pytest.skip("This Blender was built without it.")
    recorded = record(arm)
    path = tmp_path / f"take{suffix}"
    bpy.ops.object.select_all(action="DESELECT")
    arm.sleeve.select_set(True)
    with suspended():
        if suffix == ".abc":
            bpy.ops.wm.alembic_export(filepath=str(path), start=3, end=14, selected=True, as_background_job=False)
        else:
            bpy.ops.wm.usd_export(
                filepath=str(path), selected_objects_only=True, export_animation=True, export_armatures=False,
                export_shapekeys=False, export_materials=False,
            )  # fmt: skip
    objects = set(bpy.data.objects.keys())
    compress(tmp_path, recording=str(path))
    assert set(bpy.data.objects.keys()) == objects
    folds_off(arm)
    for frame in (4, 13):
        bpy.context.scene.frame_set(frame)
        assert rms_mm(evaluated_positions(arm.sleeve), recorded[frame]) < 3 * ERROR


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--error", "1", "--components", "3"], "not allowed with"),
        (["--components", "12"], "components of 12 frames"),
        (["--error", "-1"], "are above 0"),
        (["--garment", "nobody"], "no garment 'nobody'"),
        (["--recording", "missing.pc2"], "Cannot read the point cache"),
        (["--frames", "3:14:2"], "every frame"),
        (["--frames", "5:5"], "has one frame"),
        (["--size", "100"], "do not even hold"),
    ],
)
def test_bad_input_is_one_sentence(arm: Arm, tmp_path: Path, capsys, arguments: list[str], sentence: str) -> None:
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    out = ["--out", tmp_path / "a.flow"]
    result = run("flow", "compress", tmp_path / "arm.blend", *out, *arguments, expect=2, capsys=capsys)
    assert sentence in result["error"]
    assert not (tmp_path / "a.flow").exists()
