"""The verb bake: in one go, in shards, killed in the middle, and refused before any work is lost."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon import cli
from wrinkle_synthesis.wrinkle_addon.blender.command import own_command
from wrinkle_synthesis.wrinkle_addon.blender.preferences import PACKAGE
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase


def save_arm(path: Path, size: float = 1.0) -> Path:
    """A file with an arm whose sleeve is ready to be baked in four samples, its database beside it."""
    arm = build_arm(size=size)
    settings = arm.sleeve.wrinkles
    settings.database, settings.plan, settings.budget = "//sleeve.wrinkles", "BUDGET", 3
    settings.joints["shoulder_L"].enabled = False
    arm.animate([{"elbow_L": [0.3 * k]} for k in range(4)])
    bpy.context.scene.frame_end = 4
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    empty_scene()
    return save_arm(tmp_path / "arm.blend")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the arm's database, baked in one go."""
    empty_scene()
    path = save_arm(tmp_path_factory.mktemp("whole") / "arm.blend")
    assert cli.main(["bake", str(path)]) == 0
    return path.with_name("sleeve.wrinkles")


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- the same bytes, however they came about ----------------------------------------------------------------------


def test_a_second_bake_finds_nothing_to_do(wrinkle, arm: Path, whole: Path) -> None:
    folder = Path(shutil.copytree(whole, arm.with_name("sleeve.wrinkles")))
    outcome = wrinkle("bake", arm, "--json")
    assert outcome.code == 0 and outcome.result["complete"] and outcome.result["samples"] == 4
    assert outcome.errors == ""
    assert contents(folder) == contents(whole)


def test_shards_are_merged_to_the_bytes_of_one_bake(wrinkle, arm: Path, whole: Path) -> None:
    folder = arm.with_name("sleeve.wrinkles")
    first = wrinkle("bake", arm, "--shard", "1/2", "--json")
    assert first.code == 0 and not first.result["complete"]
    assert "still to be baked" in wrinkle("merge", folder).complaint
    assert (
        "is not finished; run the bake again" in wrinkle("synthesize", arm, "--out", arm.with_suffix(".pc2")).complaint
    )
    second = wrinkle("bake", arm, "--shard", "0/2", "--batch", 3, "--json")
    assert second.code == 0 and second.result["complete"]
    (folder / "manifest.json").unlink()
    assert wrinkle("merge", folder).code == 0
    assert contents(folder) == contents(whole)
    assert wrinkle("verify", folder).code == 0


def test_workers_give_the_bytes_of_one_process(wrinkle, arm: Path, whole: Path) -> None:
    outcome = wrinkle("bake", arm, "--workers", 2, "--batch", 2)
    assert outcome.code == 0, outcome.errors
    assert contents(arm.with_name("sleeve.wrinkles")) == contents(whole)
    assert "[5/5]" in outcome.errors, "three samples, and the rest pose known to both workers"


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, cli.INTERRUPTED), (signal.SIGTERM, cli.INTERRUPTED), (signal.SIGKILL, -signal.SIGKILL)],
)
def test_a_bake_ended_in_the_middle_goes_on_to_the_same_bytes(
    wrinkle, arm: Path, whole: Path, number: signal.Signals, code: int
) -> None:
    command = [sys.executable, "-m", cli.__name__, "bake", str(arm), "--progress", "json"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert json.loads(process.stderr.readline())["name"] == "rest"
        process.send_signal(number)
        rest = process.stderr.read()
    assert process.returncode == code, rest
    if code == cli.INTERRUPTED:
        assert json.loads(rest.splitlines()[-1]) == {"event": "error", "message": "Interrupted."}
    folder = arm.with_name("sleeve.wrinkles")
    assert 0 < len(contents(folder)) < len(contents(whole))
    assert wrinkle("verify", folder).code == 1
    assert wrinkle("bake", arm).code == 0
    finished = {name: data for name, data in contents(folder).items() if not name.endswith(".tmp")}
    assert finished == contents(whole)


@pytest.mark.parametrize("how", ["scene", "objects"])
def test_a_character_in_centimetres_is_baked_in_metres(wrinkle, tmp_path: Path, whole: Path, how: str) -> None:
    empty_scene()
    if how == "scene":
        bpy.context.scene.unit_settings.scale_length = 0.01
    arm = save_arm(tmp_path / "arm.blend", 100.0)
    if how == "objects":
        for ob in bpy.data.objects:
            ob.scale = (0.01, 0.01, 0.01)
        bpy.ops.wm.save_as_mainfile(filepath=str(arm))
    assert wrinkle("bake", arm).code == 0
    baked, expected = WrinkleDatabase.open(tmp_path / "sleeve.wrinkles"), WrinkleDatabase.open(whole)
    np.testing.assert_allclose(baked.header.rig.lengths, [0.3, 0.3], rtol=1e-5)
    # Single precision in other units, and an equilibrium that is found only to its tolerance.
    # Friction lets cloth rest in more than one place, and the two are rounded apart; a wrong unit is metres off.
    np.testing.assert_allclose(baked.rest, expected.rest, atol=3e-3)
    out = tmp_path / "sleeve.pc2"
    assert wrinkle("synthesize", arm, "--out", out).code == 0
    evaluated = wrinkle("evaluate", arm, "--reference", out, "--json").result
    # A cache holds single precision.
    assert evaluated["max_mm"]["ours"] < 0.01 < 1.0 < evaluated["max_mm"]["skinning"] < 100.0


# --- left out -----------------------------------------------------------------------------------------------------


def test_a_pose_in_which_limbs_pass_through_each_other_is_left_out_and_told(wrinkle, tmp_path: Path) -> None:
    empty_scene()
    path = save_arm(tmp_path / "arm.blend")
    settings = bpy.data.objects["sleeve"].wrinkles
    # The forearm lies in the upper arm.
    settings.joints["elbow_L"].high[0], settings.budget = np.radians(165.0), 2
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    sentence = "In 1 of 3 samples limbs pass through each other so far that cloth has no place"
    planned = wrinkle("plan", path, "--json").result
    assert planned["left_out"] == ["elbow_L-2"] and planned["simulated"] == 2
    assert sentence in wrinkle("plan", path).output
    assert any(sentence in note for note in wrinkle("check", path, "--json").result["notes"])
    assert sentence in wrinkle("bake", path).output
    folder = path.with_name("sleeve.wrinkles")
    assert wrinkle("info", folder, "--json").result["left_out"] == ["elbow_L-2"]
    assert "1 have another sample's wrinkles" in wrinkle("info", folder).output
    assert wrinkle("verify", folder).code == 0
    # It is played there as anywhere else.
    assert wrinkle("synthesize", path, "--out", path.with_suffix(".pc2")).code == 0


# --- refused ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--device", "cuda:77"), "no device 'cuda:77' here; there is cpu"),
        (("--shard", "2/2"), "no shard '2/2'"),
        (("--shard", "half"), "such as 0/4, not 'half'"),
        (("--batch", "0"), "at least one sample, not 0"),
        (("--garment", "hat"), "no garment 'hat'; its meshes: body, sleeve"),
    ],
)
def test_options_that_name_nothing_are_said_before_any_work(
    wrinkle, arm: Path, arguments: tuple[str, ...], sentence: str
) -> None:
    assert sentence in wrinkle("bake", arm, *arguments).complaint
    assert not arm.with_name("sleeve.wrinkles").exists()


def test_a_folder_that_cannot_be_written_to_is_said_before_any_work(wrinkle, arm: Path) -> None:
    arm.with_name("file").write_text("")
    outcome = wrinkle("bake", arm, "--database", arm.with_name("file") / "sleeve.wrinkles")
    assert "Cannot write to the folder" in outcome.complaint


def test_the_folder_of_another_garment_is_kept(wrinkle, tmp_path: Path, whole: Path) -> None:
    empty_scene()
    folder = Path(shutil.copytree(whole, tmp_path / "sleeve.wrinkles"))
    arm = save_arm(tmp_path / "arm.blend")
    bpy.data.objects["sleeve"].name = "glove"
    bpy.data.objects["glove"].wrinkles.ease_girth = 7.0
    bpy.ops.wm.save_mainfile()
    sentence = "holds the database of the garment 'sleeve'; choose another folder for 'glove'"
    assert sentence in wrinkle("bake", arm).complaint
    assert contents(folder) == contents(whole)


def test_a_full_disk_ends_a_bake_that_goes_on_later(
    wrinkle, arm: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace, folder = os.replace, arm.with_name("sleeve.wrinkles")

    def fill_up(source: Path, target: Path) -> None:
        if "elbow_L-2" in target.name:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", fill_up)
    outcome = wrinkle("bake", arm)
    assert outcome.code == 2 and outcome.errors.splitlines()[-1].endswith("free some space or choose another place.")
    assert "the disk is full" in outcome.errors
    monkeypatch.undo()
    assert wrinkle("bake", arm).code == 0
    assert contents(folder) == contents(whole)


# --- processes of its own -----------------------------------------------------------------------------------------


def test_another_process_comes_in_by_the_same_door(monkeypatch: pytest.MonkeyPatch) -> None:
    module = [sys.executable, "-m", "wrinkle_synthesis.wrinkle_addon.cli", "bake", "a.blend", "--workers", "2"]
    assert own_command("bake", "a.blend", "--workers", "2") == module

    class Application:
        binary_path = "/opt/blender/blender"

    monkeypatch.setattr(bpy, "app", Application)
    inside = ["/opt/blender/blender", "--background", "--addons", PACKAGE, "--command", "wrinkle", "bake", "a.blend"]
    assert own_command("bake", "a.blend") == inside
