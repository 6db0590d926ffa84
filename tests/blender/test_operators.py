"""What an animator presses: set up, take ranges, bake."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from dolls import doll
from figures import build_figure, leave_as_imported
from small_character import Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.blender import file_process, playback
from wrinkle_synthesis.wrinkle_addon.blender.bake_process import BakeProcess
from wrinkle_synthesis.wrinkle_addon.blender.properties import active_garment


@pytest.fixture
def arm(bumps: Bumps, tmp_path: Path) -> Arm:
    """An arm that is ready to be baked: one joint, two samples."""
    empty_scene()
    arm = build_arm()
    settings = arm.sleeve.wrinkles
    settings.database, settings.plan, settings.budget = str(tmp_path / "sleeve.wrinkles"), "BUDGET", 1
    settings.joints["shoulder_L"].enabled = False
    activate(arm.sleeve)
    return arm


def activate(ob: bpy.types.Object) -> None:
    bpy.context.view_layer.objects.active = ob


def temporary_copies() -> set[str]:
    return {path.name for path in Path(tempfile.gettempdir()).glob("wrinkle-process-*")}


# --- choosing and setting up --------------------------------------------------------------------------------------


def test_the_panel_is_about_the_active_garment_or_what_the_active_armature_wears(arm: Arm) -> None:
    assert active_garment(bpy.context) == arm.sleeve
    activate(arm.armature)
    assert active_garment(bpy.context) == arm.sleeve
    activate(arm.sleeve.wrinkles.body)
    assert active_garment(bpy.context) is None
    assert not bpy.ops.wrinkle.bake.poll()


def test_setting_up_makes_a_fine_garment_and_finds_its_joints() -> None:
    empty_scene()
    build_figure(doll())
    assert bpy.ops.wrinkle.setup_garment(garment="shirt", body="body", subdivide=1) == {"FINISHED"}
    garment = active_garment(bpy.context)
    assert garment is not None
    assert garment.name == "shirt.wrinkles"
    assert {joint.name for joint in garment.wrinkles.joints} >= {"elbow_L", "elbow_R", "shoulder_L", "shoulder_R"}
    assert not garment.wrinkles.enabled


@pytest.mark.parametrize("convention", ["Mixamo", "Unreal"])
def test_a_character_out_of_another_program_is_set_up_like_one_made_here(convention: str) -> None:
    found = []
    for imported in (False, True):
        empty_scene()
        build_figure(doll(21, 8))
        if imported:
            leave_as_imported(convention)
        assert bpy.ops.wrinkle.setup_garment(garment="shirt", body="body", subdivide=0) == {"FINISHED"}
        settings = bpy.context.object.wrinkles
        found.append({joint.name: (*joint.low, *joint.high) for joint in settings.joints})
    # A centimetre is a hundredth in single precision.
    assert found[0].keys() == found[1].keys()
    np.testing.assert_allclose([*found[0].values()], [*found[1].values()], atol=1e-4)


def test_setting_up_says_which_joints_are_missing_and_why(arm: Arm) -> None:
    assert bpy.ops.wrinkle.setup_garment(garment="sleeve", body="body", subdivide=0) == {"FINISHED"}
    notes = arm.sleeve.wrinkles.notes.splitlines()
    assert any(note.startswith("knee_L: ") for note in notes)
    assert any("Considered: " in note for note in notes)


def test_setting_up_reports_what_cannot_be_used(arm: Arm) -> None:
    with pytest.raises(RuntimeError, match="Choose a body"):
        bpy.ops.wrinkle.setup_garment(garment="sleeve", body="")
    with pytest.raises(RuntimeError, match="Garment and body are the same object"):
        bpy.ops.wrinkle.setup_garment(garment="sleeve", body="sleeve")


def test_ranges_are_taken_from_the_animation_plus_a_margin(arm: Arm) -> None:
    arm.animate([{"elbow_L": [0.2 * k], "shoulder_L": [0.0, 0.0, -0.1 * k]} for k in range(4)], start=5)
    bpy.context.scene.frame_set(3)
    assert bpy.ops.wrinkle.take_ranges(margin=0.1) == {"FINISHED"}
    elbow, shoulder = arm.sleeve.wrinkles.joints
    np.testing.assert_allclose([elbow.low[0], elbow.high[0]], [-0.1, 0.7], atol=1e-5)
    np.testing.assert_allclose([shoulder.low[2], shoulder.high[2]], [-0.4, 0.1], atol=1e-5)
    assert bpy.context.scene.frame_current == 3


# --- baking -------------------------------------------------------------------------------------------------------


def test_baking_leaves_a_played_garment_and_nothing_else(arm: Arm, tmp_path: Path) -> None:
    copies, objects = temporary_copies(), set(bpy.data.objects)
    assert bpy.ops.wrinkle.bake() == {"FINISHED"}
    assert (tmp_path / "sleeve.wrinkles" / "manifest.json").exists()
    assert temporary_copies() == copies
    assert set(bpy.data.objects) == objects
    assert bpy.data.filepath == ""
    before = evaluated_positions(arm.sleeve)
    arm.bend(1.0)
    bpy.context.view_layer.update()
    assert playback.status(arm.sleeve).error == ""
    assert np.abs(evaluated_positions(arm.sleeve) - before).max() > 0.1


def test_a_bake_that_fails_says_why_in_the_process_s_own_words(arm: Arm) -> None:
    copies = temporary_copies()
    arm.sleeve.wrinkles.joints["elbow_L"].enabled = False
    with pytest.raises(RuntimeError, match="No joint of the garment 'sleeve' is chosen"):
        bpy.ops.wrinkle.bake()
    assert temporary_copies() == copies
    assert not arm.sleeve.wrinkles.enabled


def test_a_folder_beside_an_unsaved_file_is_refused(arm: Arm) -> None:
    arm.sleeve.wrinkles.database = "//sleeve.wrinkles"
    with pytest.raises(RuntimeError, match="save it first"):
        bpy.ops.wrinkle.bake()
    arm.sleeve.wrinkles.database = ""
    with pytest.raises(RuntimeError, match="choose a folder"):
        bpy.ops.wrinkle.bake()


TALKER = """
import json, sys, time
print("some other line", file=sys.stderr)
for done in (1, 2):
    report = {"residual": 0.02, "converged": done > 1}
    event = {"event": "sample", "name": f"s{done}", "done": done, "total": 9, "seconds": 1.0, "remaining": 600.0}
    event["report"] = report
    print(json.dumps(event), file=sys.stderr, flush=True)
time.sleep(60)
"""
CRASHER = "import sys; print('out of memory', file=sys.stderr); sys.exit(1)"


def stand_in(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    monkeypatch.setattr(file_process, "own_command", lambda *arguments: [sys.executable, "-c", code])


def test_a_bake_reports_progress_and_can_be_stopped(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, TALKER)
    copies = temporary_copies()
    process = BakeProcess(arm.sleeve)
    deadline = time.monotonic() + 30.0
    while process.progress.done < 2 and time.monotonic() < deadline:
        assert process.poll(0.1)
    assert process.progress.text == "2 of 9 samples, 10 min left"
    assert process.progress.last == "s2, residual 0.02"
    assert process.progress.restless == ("s1",)
    assert len(temporary_copies() - copies) == 1
    process.close()
    assert temporary_copies() == copies
    assert process._process is not None
    assert process._process.poll() is not None


def test_a_bake_that_dies_says_its_last_words(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, CRASHER)
    copies = temporary_copies()
    with pytest.raises(RuntimeError, match=r"ended with code 1 \(out of memory\)"):
        bpy.ops.wrinkle.bake()
    assert temporary_copies() == copies
