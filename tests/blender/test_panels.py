"""The sidebar as an animator reads it: one path, reasons instead of dead buttons, places instead of riddles."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from dolls import doll
from fake_layout import SidebarContext, draw
from figures import build_figure
from small_character import Arm, Bumps, build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon.blender import file_process, flow_panel, panels, playback
from wrinkle_synthesis.wrinkle_addon.blender.bake_process import BakeProcess, BakeProgress
from wrinkle_synthesis.wrinkle_addon.blender.file_process import BAKE, running
from wrinkle_synthesis.wrinkle_addon.blender.guess import guess_character
from wrinkle_synthesis.wrinkle_addon.blender.inspection import Finding, findings_of
from wrinkle_synthesis.wrinkle_addon.blender.plan_preview import preview_plan

STEPS = ["Character", "Joints", "Plan", "Bake", "Play", "Coarse Layer", "Cache", "Export", "Report"]


@pytest.fixture
def arm(bumps: Bumps, database: Path) -> Arm:
    empty_scene()
    arm = build_arm("", database)
    bpy.context.view_layer.objects.active = arm.sleeve
    bpy.context.view_layer.update()
    return arm


def all_panels() -> list[type[bpy.types.Panel]]:
    return [cls for cls in (*panels.classes, *flow_panel.classes) if issubclass(cls, bpy.types.Panel)]


def test_the_tab_holds_one_path_from_the_character_to_the_report() -> None:
    steps = [panel for panel in all_panels() if not hasattr(panel, "bl_parent_id")]
    assert [panel.bl_label for panel in steps] == STEPS
    assert {panel.bl_category for panel in all_panels()} == {"Wrinkle"}


@pytest.mark.parametrize("panel", all_panels(), ids=lambda panel: panel.__name__)
def test_every_panel_draws(arm: Arm, panel: type[bpy.types.Panel]) -> None:
    assert not hasattr(panel, "poll") or panel.poll(SidebarContext())
    assert draw(panel).operators or draw(panel).properties or draw(panel).labels


@pytest.mark.parametrize("panel", all_panels(), ids=lambda panel: panel.__name__)
def test_every_panel_draws_before_anything_was_baked(arm: Arm, panel: type[bpy.types.Panel]) -> None:
    arm.sleeve.wrinkles.database = ""
    arm.sleeve.wrinkles.enabled = False
    arm.sleeve.wrinkles.coarse_layer = "SIMULATION"
    arm.sleeve.wrinkles.plan = "BUDGET"
    draw(panel)


def test_lengths_show_their_unit_whatever_the_scenes_own_is(arm: Arm) -> None:
    arm.sleeve.wrinkles.coarse_layer = "SIMULATION"
    assert draw(panels.play.WRINKLE_PT_play).named["clearance"] == "Clearance (m)"
    assert draw(panels.coarse.WRINKLE_PT_coarse).named["coarse_buffer"] == "Buffer (m)"


def test_without_a_garment_there_is_the_first_step_alone() -> None:
    empty_scene()
    context = SidebarContext()
    shown = [panel for panel in all_panels() if not hasattr(panel, "poll") or panel.poll(context)]
    assert shown == [panels.character.WRINKLE_PT_character]
    assert "Select the garment" in draw(panels.character.WRINKLE_PT_character).text


# --- the character ------------------------------------------------------------------------------------------------


@pytest.fixture
def figure() -> None:
    empty_scene()
    build_figure(doll(21, 8))


@pytest.mark.parametrize("selected", [(), ("body",)])
def test_body_and_armature_are_guessed_from_the_garment(figure: None, selected: tuple[str, ...]) -> None:
    objects = bpy.data.objects
    for ob in objects:
        ob.select_set(ob.name in selected)
    bpy.context.view_layer.objects.active = objects["shirt"]
    guess = guess_character(bpy.context)
    assert (guess.garment, guess.body, guess.armature) == (objects["shirt"], objects["body"], objects["Figure"])
    assert guess.missing == ""
    shown = draw(panels.character.WRINKLE_PT_character)
    assert {"shirt", "body", "Figure"} <= set(shown.labels)


def test_what_is_missing_for_a_guess_is_said(figure: None) -> None:
    bpy.data.objects.remove(bpy.data.objects["body"])
    bpy.context.view_layer.objects.active = bpy.data.objects["shirt"]
    assert "Select the body" in draw(panels.character.WRINKLE_PT_character).text


# --- the check ----------------------------------------------------------------------------------------------------


def checked(arm: Arm) -> list[str]:
    assert bpy.ops.wrinkle.check_garment() == {"FINISHED"}
    return [finding.text for finding in listed(arm) if finding.stops]


def listed(arm: Arm) -> list[Finding]:
    findings = findings_of(arm.sleeve)
    assert findings is not None
    return findings


def index_of(arm: Arm, words: str) -> int:
    return next(i for i, each in enumerate(listed(arm)) if words in each.text)


def test_a_sound_garment_has_no_problems(arm: Arm) -> None:
    assert checked(arm) == []
    assert "Ready to bake" in draw(panels.character.WRINKLE_PT_problems).labels


@pytest.mark.parametrize("part", ["garment", "rig"])
def test_what_was_found_is_no_longer_shown_once_the_shape_is_another(arm: Arm, part: str) -> None:
    checked(arm)
    vertex = arm.sleeve.data.vertices[0]
    if part == "garment":
        vertex.co.z += 1e-4
    else:
        bpy.context.view_layer.objects.active = arm.armature
        bpy.ops.object.mode_set(mode="EDIT")
        arm.armature.data.edit_bones["lower"].tail.z += 0.01
        bpy.ops.object.mode_set(mode="OBJECT")
        bpy.context.view_layer.objects.active = arm.sleeve
    assert findings_of(arm.sleeve) is None
    assert "Not checked as it is now" in draw(panels.character.WRINKLE_PT_problems).text
    if part == "garment":
        vertex.co.z -= 1e-4
        checked(arm)
        # Who was sent to a place in edit mode still reads why.
        bpy.ops.object.mode_set(mode="EDIT")
        assert findings_of(arm.sleeve) is not None
        bpy.ops.object.mode_set(mode="OBJECT")


def test_every_problem_is_listed_with_a_button_to_its_place(arm: Arm) -> None:
    mesh = arm.sleeve.data
    arm.sleeve.vertex_groups["upper"].remove([0, 1])
    mesh.vertices.add(2)
    arm.armature.data.bones["lower"].name = "other"
    problems = checked(arm)
    assert len(problems) == 3
    shown = draw(panels.character.WRINKLE_PT_problems)
    assert shown.operators.count("wrinkle.show_problem") == 3


def test_the_button_selects_the_vertices(arm: Arm) -> None:
    arm.sleeve.vertex_groups["upper"].remove([3, 4])
    checked(arm)
    bpy.ops.wrinkle.show_problem(index=index_of(arm, "no bone weights"))
    assert bpy.context.mode == "EDIT_MESH"
    bpy.ops.object.mode_set(mode="OBJECT")
    chosen = np.zeros(len(arm.sleeve.data.vertices), bool)
    arm.sleeve.data.vertices.foreach_get("select", chosen)
    assert set(np.flatnonzero(chosen)) == {3, 4}


def test_the_button_selects_the_bones_of_a_joint(arm: Arm) -> None:
    arm.armature.data.bones["lower"].name = "other"
    checked(arm)
    bpy.ops.wrinkle.show_problem(index=index_of(arm, "uses the bone lower"))
    assert bpy.context.mode == "POSE"
    chosen = {bone.name for bone in arm.armature.pose.bones if (bone if hasattr(bone, "select") else bone.bone).select}
    assert chosen == {"upper"}
    assert arm.sleeve.wrinkles.active_joint == 0


def test_a_list_that_is_out_of_date_is_refused(arm: Arm) -> None:
    arm.sleeve.vertex_groups["upper"].remove([3, 4])
    checked(arm)
    index = index_of(arm, "no bone weights")
    arm.sleeve.data.vertices.add(1)
    for gone in (index, 99):
        with pytest.raises(RuntimeError, match="out of date"):
            bpy.ops.wrinkle.show_problem(index=gone)


CHANGES: dict[str, Callable[[Arm], None]] = {
    "the plan": lambda arm: setattr(arm.sleeve.wrinkles, "plan", "BUDGET"),
    "a range": lambda arm: setattr(arm.sleeve.wrinkles.joints[0], "high", (0.5, 0.0, 0.0)),
    "a joint switched off": lambda arm: setattr(arm.sleeve.wrinkles.joints[0], "enabled", False),
    "the fabric": lambda arm: setattr(arm.sleeve.wrinkles, "density", 0.2),
    "the body": lambda arm: setattr(arm.sleeve.wrinkles, "body", None),
    "the coarse layer": lambda arm: setattr(arm.sleeve.wrinkles, "coarse_layer", "MESH"),
    "the mesh": lambda arm: arm.sleeve.data.vertices.add(1),
    "a bone": lambda arm: setattr(arm.armature.data.bones["lower"], "name", "other"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_what_was_found_goes_with_what_it_was_found_on(arm: Arm, change: Callable[[Arm], None]) -> None:
    checked(arm)
    change(arm)
    assert draw(panels.character.WRINKLE_PT_problems).labels == ["Not checked as it is now."]


def test_what_was_found_before_a_bake_goes_with_it(arm: Arm, database: Path, tmp_path: Path) -> None:
    baked = tmp_path / "baked.wrinkles"
    arm.sleeve.wrinkles.database = str(baked)
    checked(arm)
    assert "not baked yet" in draw(panels.character.WRINKLE_PT_problems).text
    shutil.copytree(database, baked)
    assert draw(panels.character.WRINKLE_PT_problems).labels == ["Not checked as it is now."]


def test_what_was_found_outlasts_playing_and_looking(arm: Arm) -> None:
    arm.sleeve.vertex_groups["upper"].remove([3, 4])
    checked(arm)
    bpy.ops.wrinkle.show_problem(index=index_of(arm, "no bone weights"))
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.scene.frame_set(7)
    arm.sleeve.wrinkles.strength = 0.5
    assert len(listed(arm))


# --- joints and plan ----------------------------------------------------------------------------------------------


@pytest.fixture
def shirt(figure: None) -> bpy.types.Object:
    assert bpy.ops.wrinkle.setup_garment(garment="shirt", body="body", subdivide=0) == {"FINISHED"}
    return bpy.context.object


def test_the_plan_is_counted_as_it_is_changed(wrinkle, shirt: bpy.types.Object, tmp_path: Path) -> None:
    for plan in ("PAPER", "BUDGET"):
        shirt.wrinkles.plan = plan
        shown = preview_plan(shirt)
        assert shown is not None
        path = tmp_path / f"{plan}.blend"
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
        planned = wrinkle("plan", path, "--json").result
        bpy.ops.wm.open_mainfile(filepath=str(path))
        shirt = bpy.data.objects["shirt"]
        assert (shown.samples, shown.simulated) == (planned["samples"], planned["simulated"])
        assert shown.megabytes == pytest.approx(planned["stored_bytes"] / 1e6)
        assert shown.seconds == pytest.approx(3600 * planned["hours"])


def test_the_samples_that_were_asked_for_are_those_that_are_told(shirt: bpy.types.Object) -> None:
    shirt.wrinkles.plan, shirt.wrinkles.budget = "BUDGET", 8
    for joint in shirt.wrinkles.joints:
        joint.enabled = joint.name.startswith("elbow")
    shirt.wrinkles.use_symmetry = False
    assert "8 and the rest pose" in draw(panels.plan.WRINKLE_PT_plan).text
    shirt.wrinkles.use_symmetry = True
    text = draw(panels.plan.WRINKLE_PT_plan).text
    assert "8 and the rest pose" in text and "Mirrored 8" in " ".join(text.split())


@pytest.mark.parametrize(("part", "name"), [("body", "The body"), ("shirt", "The garment 'shirt'")])
def test_a_character_that_is_not_symmetric_is_told_why(figure: None, part: str, name: str) -> None:
    mesh = bpy.data.objects[part].data
    for vertex in mesh.vertices:
        if vertex.co.x > 0.3:
            vertex.co.y += 0.01
    bpy.ops.wrinkle.setup_garment(garment="shirt", body="body", subdivide=0)
    garment = bpy.context.object
    text = draw(panels.plan.WRINKLE_PT_plan).text
    assert f"Both sides are simulated. {name} is not symmetric" in text and "symmetrize it" in text
    bpy.ops.wrinkle.check_garment()
    (finding,) = [each for each in findings_of(garment) or () if "not symmetric" in each.text]
    assert not finding.stops and finding.place is not None and len(finding.place.vertices)
    garment.wrinkles.use_symmetry = False
    assert "symmetric" not in draw(panels.plan.WRINKLE_PT_plan).text


def test_symmetry_is_looked_for_again_by_the_check(shirt: bpy.types.Object) -> None:
    def says() -> str:
        return draw(panels.plan.WRINKLE_PT_plan).text

    assert "Check looks anew" not in says() and "Both sides" not in says()
    for shift, told in ((0.01, True), (-0.01, False)):
        for vertex in bpy.data.objects["body"].data.vertices:
            vertex.co.y += shift if vertex.co.x > 0.3 else 0.0
        assert "Check looks anew which side mirrors which" in says()
        bpy.ops.wrinkle.check_garment()
        assert "Check looks anew" not in says() and ("The body is not symmetric" in says()) == told
        assert bool(shirt.wrinkles.mirror_signs) != told


def test_a_joint_may_have_a_step_of_its_own(shirt: bpy.types.Object) -> None:
    joint = shirt.wrinkles.joints["elbow_L"]
    joint.low[0], joint.high[0] = 0.0, np.radians(90.0)
    counts = []
    for degrees in (0.0, 45.0, 10.0):
        joint.step = np.radians(degrees)
        counts.append(preview_plan(shirt).grids["elbow_L"])
    # The other elbow's range counts, too, as one side's samples serve both; so only the order is certain.
    assert counts[1] < counts[0] < counts[2]


def test_what_is_left_out_is_told_once_the_check_has_seen_it(arm: Arm) -> None:
    settings = arm.sleeve.wrinkles
    settings.plan, settings.budget, settings.use_symmetry = "BUDGET", 2, False
    settings.joints["shoulder_L"].enabled = False
    # At its end the forearm lies in the upper arm.
    settings.joints["elbow_L"].high[0] = np.radians(165.0)
    sentence = "In 1 of 3 samples limbs pass through each other"
    assert sentence not in draw(panels.plan.WRINKLE_PT_plan).text
    assert bpy.ops.wrinkle.check_garment() == {"FINISHED"}
    text = draw(panels.plan.WRINKLE_PT_plan).text
    assert sentence in text and "1 and the rest pose" in text and "Mirrored" not in text
    settings.joints["elbow_L"].high[0] = np.radians(90.0)
    text = draw(panels.plan.WRINKLE_PT_plan).text
    assert sentence not in text and "2 and the rest pose" in text


def test_nothing_to_sample_is_said(arm: Arm) -> None:
    for joint in arm.sleeve.wrinkles.joints:
        joint.enabled = False
    assert "switch a joint on" in draw(panels.plan.WRINKLE_PT_plan).text


def test_a_joint_is_mirrored_to_the_other_side(shirt: bpy.types.Object) -> None:
    settings = shirt.wrinkles
    settings.active_joint = settings.joints.find("shoulder_L")
    joint, partner = settings.joints["shoulder_L"], settings.joints["shoulder_R"]
    joint.low, joint.high, joint.step, joint.enabled = (-0.1, -0.2, -0.3), (0.4, 0.5, 0.6), 0.2, False
    assert bpy.ops.wrinkle.mirror_joint() == {"FINISHED"}
    assert not partner.enabled and partner.step == pytest.approx(0.2)
    for axis in range(3):
        own, other = (joint.low[axis], joint.high[axis]), (partner.low[axis], partner.high[axis])
        assert other == pytest.approx(own) or other == pytest.approx((-own[1], -own[0]))
    # Twice mirrored is as it was.
    settings.active_joint = settings.joints.find("shoulder_R")
    bpy.ops.wrinkle.mirror_joint()
    np.testing.assert_allclose(joint.low, (-0.1, -0.2, -0.3), atol=1e-6)


def test_a_joint_of_the_middle_has_nothing_to_mirror(arm: Arm) -> None:
    assert not bpy.ops.wrinkle.mirror_joint.poll()


# --- the bake -----------------------------------------------------------------------------------------------------


def test_a_running_bake_tells_how_far_it_is(arm: Arm) -> None:
    class Running:
        verb, doing = BAKE, "Baking wrinkles"
        paused = stopped = False
        progress = BakeProgress(3, 12, "elbow_L-2", 90.0, 0.013, ("elbow_L-1",))

    running[arm.sleeve.session_uid] = Running()
    try:
        shown = draw(panels.bake.WRINKLE_PT_bake)
        assert "3 of 12 samples, 2 min left" in shown.labels
        assert "elbow_L-2, residual 0.013" in shown.labels
        assert "1 did not come to rest" in shown.labels
        assert {"wrinkle.pause_bake", "wrinkle.stop_process"} <= set(shown.operators)
        assert not bpy.ops.wrinkle.bake.poll()
    finally:
        running.clear()
    assert not bpy.ops.wrinkle.pause_bake.poll() and not bpy.ops.wrinkle.stop_process.poll()


def wait_for(process: BakeProcess, done: int) -> None:
    deadline = time.monotonic() + 120.0
    while process.progress.done < done and process.poll(0.1):
        assert time.monotonic() < deadline


def test_a_paused_bake_waits_with_the_next_sample_and_goes_on(arm: Arm, tmp_path: Path) -> None:
    settings = arm.sleeve.wrinkles
    settings.database, settings.plan, settings.budget = str(tmp_path / "s.wrinkles"), "BUDGET", 3
    settings.joints["shoulder_L"].enabled = False
    with BakeProcess(arm.sleeve) as process:
        process.pause()
        assert process.paused
        wait_for(process, 1)
        # Nothing more comes: one that did not pause would finish these samples in less.
        end = time.monotonic() + 3.0
        while time.monotonic() < end:
            assert process.poll(0.1)
        assert process.progress.done == 1
        process.go_on()
        wait_for(process, process.progress.total)
        assert process.progress.residual is not None


def test_two_windows_do_not_bake_into_one_folder(arm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setattr(file_process, "own_command", lambda *arguments: [sys.executable, "-c", "input()"])
    arm.sleeve.wrinkles.database = str(tmp_path / "s.wrinkles")
    with BakeProcess(arm.sleeve):
        with pytest.raises(ValueError, match="Another Blender is baking into"):
            BakeProcess(arm.sleeve)
    assert not list((tmp_path / "s.wrinkles").iterdir())


# --- playing and the report ---------------------------------------------------------------------------------------


def test_an_error_is_shown_where_the_garment_is_played(arm: Arm, tmp_path: Path) -> None:
    arm.sleeve.wrinkles.database = str(tmp_path / "nowhere.wrinkles")
    bpy.context.view_layer.update()
    shown = draw(panels.play.WRINKLE_PT_play)
    assert "There is no database" in shown.text


def test_the_report_names_samples_that_did_not_come_to_rest(arm: Arm) -> None:
    player = playback.status(arm.sleeve).player
    assert player is not None
    player.reports = {"elbow_L-1": {"residual": 0.5, "converged": False, "restless": "the cuff"}, "elbow_L-2": {}}
    shown = draw(panels.report.WRINKLE_PT_report)
    assert "elbow_L-1  the cuff" in shown.labels
    assert "0.5" in shown.labels
