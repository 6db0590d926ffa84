"""The first start: kernels compile behind the window, which plays as soon as they are there."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon import kernel_cache
from wrinkle_synthesis.wrinkle_addon.blender import first_start as module
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.blender.command import own_command
from wrinkle_synthesis.wrinkle_addon.blender.first_start import FirstStart


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch) -> FirstStart:
    """A start in a window whose kernels are not compiled."""
    start = FirstStart()
    start.is_over = False
    monkeypatch.setattr(module, "first_start", start)
    monkeypatch.setattr(playback, "first_start", start)
    monkeypatch.setattr(module, "are_compiled", lambda devices: False)
    return start


def run_instead(monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    monkeypatch.setattr(module, "own_command", lambda *arguments: [sys.executable, "-c", script])


def wait_for(start: FirstStart) -> list[str]:
    """Poll to the end; what was shown meanwhile."""
    texts = []
    until = time.monotonic() + 60.0
    while not start.is_over:
        assert time.monotonic() < until
        start.poll()
        texts.append(start.text)
        time.sleep(0.01)
    return texts


def test_in_the_background_nothing_is_waited_for() -> None:
    assert FirstStart().is_over


def test_the_window_plays_nothing_until_kernels_are_there(
    bumps: Bumps, database: Path, start: FirstStart, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_instead(monkeypatch, "")
    empty_scene()
    arm = build_arm("", database)
    pose = arm.animate([{"elbow_L": [1.0]}])[0]
    bpy.context.scene.frame_set(1)
    assert playback.status(arm.sleeve).player is None and not playback.status(arm.sleeve).error
    wait_for(start)
    arm.sleeve.update_tag()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(arm.to_object_space(bumps.shape(pose)), evaluated_positions(arm.sleeve), atol=2e-4)


def test_progress_is_shown_as_it_is_told(start: FirstStart, monkeypatch: pytest.MonkeyPatch) -> None:
    event = json.dumps({"event": "kernels", "done": 3, "total": 9})
    run_instead(monkeypatch, f"import sys; print('warning', file=sys.stderr); print({event!r}, file=sys.stderr)")
    assert wait_for(start)[-1] == "3 of 9"
    assert start.problem == ""


def test_a_compiler_that_fails_leaves_compiling_to_first_use(
    start: FirstStart, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_instead(monkeypatch, "raise SystemExit('no space left')")
    wait_for(start)
    assert start.problem == "no space left"


def test_ending_takes_the_process_down(start: FirstStart, monkeypatch: pytest.MonkeyPatch) -> None:
    run_instead(monkeypatch, "import time; time.sleep(60)")
    start.poll()
    process = start._process
    assert process is not None and process.poll() is None
    start.end()
    assert start.is_over and process.poll() is not None


def test_kernels_that_are_compiled_are_known_until_the_cache_is_emptied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = own_command("kernels", "--progress", "json")
    assert "kernels" in command
    monkeypatch.setattr(kernel_cache, "cache_folder", lambda: tmp_path)
    assert not kernel_cache.are_compiled(["cpu"])
    counts = list(kernel_cache.compile_kernels(["cpu"]))
    assert counts == [(k, len(counts)) for k in range(1, len(counts) + 1)]
    assert kernel_cache.are_compiled(["cpu"])
    for path in tmp_path.iterdir():
        path.unlink()
    assert not kernel_cache.are_compiled(["cpu"])


def test_the_self_test_shows_what_works(monkeypatch: pytest.MonkeyPatch) -> None:
    from wrinkle_synthesis.operators import self_test
    from wrinkle_synthesis.wrinkle_addon.blender.preferences import test_lines

    result = json.dumps({"checks": [{"name": "bake", "text": "2 samples", "passed": False, "seconds": 1.0}]})
    monkeypatch.setattr(self_test, "own_command", lambda *arguments: [sys.executable, "-c", f"print({result!r})"])
    with pytest.raises(RuntimeError, match="2 samples"):
        bpy.ops.wrinkle.self_test()
    assert test_lines == [(False, "Bake, 1.0 s: 2 samples")]
    assert subprocess.run(own_command("kernels", "--help"), capture_output=True, check=False).returncode == 0
