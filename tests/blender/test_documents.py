"""Every command and every piece of Python in the documents runs, in the order of the pages, on a small figure."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from documents import Command, commands, snippets
from dolls import doll
from figures import build_figure
from small_character import empty_scene
from wrinkle_synthesis.wrinkle_addon.bvh import write_bvh
from wrinkle_synthesis.wrinkle_addon.rig import pose_of_angles

FIGURE = doll(31, 12)

ORDER = ("farm.md", "README.md", "first_wrinkles.md", "fabric_and_plan.md", "coarse_layer.md")
"""Pages that others build on come first; the rest come last."""

SMALLER = {
    "setup": ("--subdivide", "0", "--joints", "elbow_L,elbow_R", "--samples", "2"),
    "simulate": ("--frames", "1:3"),
    "evaluate": ("--frames", "1:3"),
    "flow compress": ("--frames", "1:3"),
    "flow play": ("--frames", "1:3"),
}
"""What is put behind a command, so that it takes seconds; a later option counts."""

COARSE = {"make": "make:100"}
"""The coarse mesh of a garment that has less than the usual number of vertices."""

LEFT_OUT = ("demo",)
"""Verbs that have tests of their own and take minutes."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a reader would be: a character, a clip for it, and a folder that machines share."""
    empty_scene()
    build_figure(FIGURE)
    bpy.context.scene.frame_end = 5
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hero.blend"))
    angles = np.linspace(0.0, 0.6, 5)
    poses = [pose_of_angles(FIGURE.rig, FIGURE.joints, {"elbow_L": [a], "elbow_R": [a]}) for a in angles]
    write_bvh(tmp_path / "dance.bvh", FIGURE.rig, poses, 24.0)
    (tmp_path / "shared").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def in_order(command: Command) -> int:
    return ORDER.index(command.page) if command.page in ORDER else len(ORDER)


def made_small(command: Command, folder: Path) -> list[str]:
    """The command's arguments, on the shared folder of this test, and small."""
    verb = " ".join(command.arguments[:2]) if command.arguments[0] == "flow" else command.arguments[0]
    words = (COARSE.get(word, word).replace("/shared", str(folder / "shared")) for word in command.arguments)
    return [*words, *SMALLER.get(verb, ())]


@pytest.mark.long
def test_a_reader_can_type_everything(wrinkle, folder: Path) -> None:
    for command in sorted(commands(), key=in_order):
        if command.arguments[0] not in LEFT_OUT:
            outcome = wrinkle(*made_small(command, folder))
            assert outcome.code == 0, f"{command}: {outcome.errors}"
    for page, text in snippets():
        exec(compile(text, page, "exec"), {})
