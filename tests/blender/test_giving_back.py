"""Turning off, cancelling and removing give the artist's file back as it was, to the last bit."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
import wrinkle_synthesis
from dolls import doll
from figures import build_figure
from file_contents import differences, file_contents
from small_character import Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.blender import file_process
from wrinkle_synthesis.wrinkle_addon.blender.bake_process import BakeProcess
from wrinkle_synthesis.wrinkle_addon.blender.node_group import find_modifier

LOCKED = "scenes[Scene].render.use_lock_interface"
"""The one setting that playing leaves behind: a render from the window plays on a thread of its own."""


@pytest.fixture
def figure() -> None:
    """A body, and a shirt with a group, modifiers and weights of the artist's own."""
    empty_scene()
    build_figure(doll(21, 8))
    shirt = bpy.data.objects["shirt"]
    for name, weight in (("mine", 0.25), ("forearm_L", 0.125), ("last", 1.0)):
        shirt.vertex_groups.new(name=name).add([1, 5, 9], weight, "REPLACE")
    shirt.vertex_groups["mine"].lock_weight = True
    shirt.vertex_groups.active = shirt.vertex_groups["mine"]
    armature = shirt.modifiers.new("Deform", "ARMATURE")
    armature.object = bpy.data.objects["Figure"]
    armature.use_bone_envelopes = armature.use_deform_preserve_volume = True
    shirt.modifiers.new("Thickness", "SOLIDIFY").thickness = 0.003
    bpy.context.view_layer.update()


def select(name: str) -> bpy.types.Object:
    for ob in bpy.context.selected_objects:
        ob.select_set(False)
    ob = bpy.data.objects[name]
    ob.select_set(True)
    bpy.context.view_layer.objects.active = ob
    return ob


def contents() -> dict[str, object]:
    """What the file holds, with the shirt as the active object."""
    select("shirt")
    bpy.context.view_layer.update()
    return file_contents()


def set_up(subdivide: int) -> bpy.types.Object:
    assert bpy.ops.wrinkle.setup_garment(garment="shirt", body="body", subdivide=subdivide) == {"FINISHED"}
    return bpy.context.object


@pytest.mark.parametrize("subdivide", [0, 1])
def test_removing_wrinkles_gives_the_file_back(figure: None, subdivide: int) -> None:
    before = contents()
    garment = set_up(subdivide)
    assert (garment.name == "shirt") == (subdivide == 0)
    assert differences(before, file_contents())
    assert bpy.ops.wrinkle.remove_wrinkles() == {"FINISHED"}
    assert differences(before, contents()) == []


def test_setting_up_twice_still_remembers_the_first_time(figure: None) -> None:
    before = contents()
    set_up(0)
    set_up(0)
    bpy.ops.wrinkle.remove_wrinkles()
    assert differences(before, contents()) == []


def test_removing_after_playing_gives_the_file_back(bumps: Bumps, database: Path) -> None:
    empty_scene()
    arm = build_arm()
    settings = arm.sleeve.wrinkles
    armature, body, joints = settings.armature, settings.body, [joint.joint() for joint in settings.joints]
    arm.sleeve.property_unset("wrinkles")
    bpy.context.view_layer.objects.active = arm.sleeve
    bpy.context.view_layer.update()
    before = file_contents()
    settings = arm.sleeve.wrinkles
    settings.armature, settings.body, settings.database = armature, body, str(database)
    for joint in joints:
        settings.joints.add().store(joint)
    settings.enabled = True
    arm.bend(1.0)
    bpy.context.view_layer.update()
    bpy.ops.wrinkle.show_influence()
    assert find_modifier(arm.sleeve) is not None
    arm.armature.pose.bones["lower"].rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    arm.armature.pose.bones["lower"].rotation_mode = "QUATERNION"
    assert bpy.ops.wrinkle.remove_wrinkles() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert set(differences(before, file_contents())) <= {LOCKED}


def test_what_the_artist_changed_since_stays(figure: None) -> None:
    garment = set_up(0)
    garment.vertex_groups.new(name="new").add([3], 0.5, "REPLACE")
    garment.vertex_groups["mine"].add([2], 0.75, "REPLACE")
    garment.data.vertices[0].co.x += 0.01
    moved = garment.data.vertices[0].co.x
    garment.modifiers.new("Later", "SMOOTH")
    bpy.ops.wrinkle.remove_wrinkles()
    assert [group.name for group in garment.vertex_groups] == ["mine", "forearm_L", "last", "new"]
    assert garment.vertex_groups["mine"].weight(2) == 0.75 and garment.vertex_groups["new"].weight(3) == 0.5
    assert garment.data.vertices[0].co.x == moved
    assert [modifier.name for modifier in garment.modifiers] == ["Deform", "Thickness", "Later"]


def test_a_mesh_of_another_number_of_vertices_keeps_its_wrinkles(figure: None) -> None:
    garment = set_up(0)
    garment.data.vertices.add(1)
    with pytest.raises(RuntimeError, match="another number of vertices"):
        bpy.ops.wrinkle.remove_wrinkles()
    assert garment.wrinkles.armature is not None


def test_a_cancelled_bake_leaves_the_file_as_it_was(
    bumps: Bumps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_process, "own_command", lambda *arguments: [sys.executable, "-c", "input()"])
    empty_scene()
    arm = build_arm()
    arm.sleeve.wrinkles.database = str(tmp_path / "s.wrinkles")
    bpy.context.view_layer.update()
    before = file_contents()
    process = BakeProcess(arm.sleeve)
    process.poll(0.1)
    process.close()
    assert differences(before, file_contents()) == []
    assert list((tmp_path / "s.wrinkles").iterdir()) == []


@pytest.mark.parametrize("operator", ["check_garment", "plot_samples"])
def test_looking_changes_nothing_of_the_character(bumps: Bumps, database: Path, operator: str) -> None:
    empty_scene()
    arm = build_arm("", database)
    bpy.context.view_layer.objects.active = arm.sleeve
    # Symmetry is looked for here for the first time.
    bpy.ops.wrinkle.check_garment()
    bpy.context.view_layer.update()
    before = file_contents()
    assert getattr(bpy.ops.wrinkle, operator)() == {"FINISHED"}
    assert [path for path in differences(before, file_contents()) if not path.startswith("images[")] == []


def test_switching_the_addon_off_shows_the_skinned_garment(bumps: Bumps, database: Path) -> None:
    empty_scene()
    arm = build_arm("", database)
    arm.bend(1.0)
    bpy.context.view_layer.update()
    played = evaluated_positions(arm.sleeve)
    modifier = find_modifier(arm.sleeve)
    own = np.array([vertex.co for vertex in arm.sleeve.data.vertices])
    modifier.show_viewport = False
    skinned = evaluated_positions(arm.sleeve)
    modifier.show_viewport = True
    wrinkle_synthesis.unregister()
    try:
        np.testing.assert_array_equal(evaluated_positions(arm.sleeve), skinned)
        np.testing.assert_array_equal([vertex.co for vertex in arm.sleeve.data.vertices], own)
    finally:
        wrinkle_synthesis.register()
    assert np.abs(played - skinned).max() > 1e-3


# --- a bake whose Blender goes away -------------------------------------------------------------------------------

ATTENDED = """
import sys, time
from wrinkle_synthesis.wrinkle_addon.attendance import Attendance
try:
    attendance = Attendance(sys.stdin)
    print("ready", flush=True)
    while True:
        attendance.wait()
        time.sleep(0.05)
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("paused", [False, True])
def test_a_bake_ends_with_the_blender_that_started_it(paused: bool) -> None:
    child = subprocess.Popen([sys.executable, "-c", ATTENDED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdin is not None and child.stdout is not None and child.stdout.readline() == "ready\n"
    if paused:
        child.stdin.write("pause\n")
        child.stdin.flush()
        time.sleep(0.3)
    assert child.poll() is None
    child.stdin.close()
    assert child.wait(30) == 130


CLOSED = """
import os, signal, sys
sys.path[:0] = [{tests!r}]
import bpy
import wrinkle_synthesis
wrinkle_synthesis.register()
from small_character import build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon.blender.bake_process import BakeProcess
empty_scene()
arm = build_arm()
arm.sleeve.wrinkles.database = sys.argv[1]
process = BakeProcess(arm.sleeve)
while not process.progress.done:
    assert process.poll(0.1)
print("child", process._process.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
def test_a_blender_that_is_killed_takes_its_bake_along_and_the_next_one_goes_on(
    bumps: Bumps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, copies = tmp_path / "s.wrinkles", tmp_path / "copies"
    copies.mkdir()
    monkeypatch.setenv("TMPDIR", str(copies))
    monkeypatch.setattr(tempfile, "tempdir", str(copies))
    code = CLOSED.format(tests=str(Path(__file__).parents[1]))
    run = [sys.executable, "-c", code, str(folder)]
    ended = subprocess.run(run, check=False, stdout=subprocess.PIPE, text=True, timeout=300)
    told = [line for line in ended.stdout.splitlines() if line.startswith("child ")]
    assert ended.returncode == -9 and told
    child, end = int(told[0].split()[1]), time.monotonic() + 60.0
    while is_alive(child):
        assert time.monotonic() < end
        time.sleep(0.1)
    finished = {path.name: path.stat().st_mtime_ns for path in folder.glob("rest-*")}
    (left,) = copies.glob(f"{file_process.PREFIX}*")
    assert finished
    monkeypatch.setattr(file_process, "LEFT_BEHIND", -1.0)
    # Its lock is free, and what was finished is not made again.
    empty_scene()
    arm = build_arm()
    settings = arm.sleeve.wrinkles
    settings.database = str(folder)
    with BakeProcess(arm.sleeve) as process:
        assert not left.exists()
        assert len(list(copies.glob(f"{file_process.PREFIX}*"))) == 1
        file_process.sweep()
        while not process.progress.done:
            assert process.poll(0.1)
    assert {path.name: path.stat().st_mtime_ns for path in folder.glob("rest-*")} == finished


def is_alive(process: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has asked after does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
