"""Two Blenders have one file open: one bakes; the other looks on, is told why it must wait, and plays the result."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import pytest
from small_character import Arm, build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon.blender.bake_process import BakeProcess
from wrinkle_synthesis.wrinkle_addon.database import MANIFEST

OTHER = """
import json, os, sys
import bpy
import wrinkle_synthesis
from wrinkle_synthesis.wrinkle_addon.blender import playback

wrinkle_synthesis.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
sleeve = bpy.data.objects["sleeve"]
bpy.context.view_layer.objects.active = sleeve

def look():
    sleeve.wrinkles.enabled = True
    bpy.context.view_layer.update()
    known = playback.status(sleeve)
    return "plays" if known.plays else known.error

def bake():
    try:
        bpy.ops.wrinkle.bake()
    except RuntimeError as error:
        return str(error)
    return "baked"

for line in sys.stdin:
    print("said", json.dumps({"look": look, "bake": bake}[line.strip()]()), flush=True)
os._exit(0)
"""


class Other:
    """Another Blender with the file open.

    Args:
        file: The .blend file.
    """

    def __init__(self, file: Path):
        self.process = subprocess.Popen(
            [sys.executable, "-c", OTHER, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def told(self, word: str) -> str:
        """What it says when it is told to look or to bake."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"{word}\n")
        self.process.stdin.flush()
        return next(json.loads(line[5:]) for line in self.process.stdout if line.startswith("said "))


@pytest.fixture
def arm(tmp_path: Path) -> Arm:
    """A saved arm whose sleeve was never baked, with a plan of a few samples."""
    empty_scene()
    arm = build_arm()
    settings = arm.sleeve.wrinkles
    settings.database, settings.plan, settings.budget = "//sleeve.wrinkles", "BUDGET", 3
    settings.joints["shoulder_L"].enabled = False
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    return arm


@pytest.fixture
def other(arm: Arm) -> Iterator[Other]:
    other = Other(Path(bpy.data.filepath))
    yield other
    other.process.communicate()


@pytest.fixture
def process(arm: Arm) -> Iterator[BakeProcess]:
    """This Blender's bake, waiting after its first sample."""
    with BakeProcess(arm.sleeve) as process:
        process.pause()
        while process.progress.done < 1:
            assert process.poll(0.1)
        yield process


def finish(process: BakeProcess) -> None:
    process.go_on()
    while process.poll(0.1):
        pass


def files_of(folder: Path) -> dict[str, tuple[bytes, int]]:
    """What lies there, and when each sample was written."""
    return {
        path.name: (path.read_bytes(), path.stat().st_mtime_ns if path.name != MANIFEST else 0)
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_the_other_one_may_not_bake_meanwhile_and_then_has_nothing_left_to_bake(
    arm: Arm, process: BakeProcess, other: Other
) -> None:
    assert "is just being baked; wait until that is done" in other.told("look")
    assert "Another Blender is baking into" in (refused := other.told("bake"))
    assert "wait until it is done, stop it there, or choose another folder" in refused
    finish(process)
    process.close()
    folder = Path(bpy.path.abspath(arm.sleeve.wrinkles.database))
    before = files_of(folder)
    assert other.told("look") == "plays" and other.told("bake") == "baked" and other.told("look") == "plays"
    assert files_of(folder) == before


def test_the_other_one_plays_on_while_its_database_is_baked_anew(arm: Arm, process: BakeProcess, other: Other) -> None:
    finish(process)
    process.close()
    assert other.told("look") == "plays"
    arm.sleeve.wrinkles.ease_girth = 8.0
    with BakeProcess(arm.sleeve) as anew:
        while anew.poll(0.1):
            assert anew.progress.done or other.told("look") == "plays"
    assert other.told("look") == "plays"
