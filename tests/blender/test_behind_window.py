"""Long work goes on behind the window: no tick does any of it, and its result is what the window's own would be."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
import warp as wp
from fake_layout import draw
from modal_operators import ESCAPE, MOUSE, Window, operator_of, tick_until_done
from small_character import Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.operators import bake, compress_flow, evaluate, simulate_coarse, write_clip
from wrinkle_synthesis.wrinkle_addon.blender import coarse_layer, file_process, panels, playback
from wrinkle_synthesis.wrinkle_addon.blender.file_process import FileProcess, running
from wrinkle_synthesis.wrinkle_addon.blender.samples import open_database
from wrinkle_synthesis.wrinkle_addon.evaluation_record import read_evaluation
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache

FRAMES = 4


@pytest.fixture
def arm(bumps: Bumps, database: Path, tmp_path: Path) -> Arm:
    """A played arm that bends over four frames, with a database of its own."""
    folder = shutil.copytree(database, tmp_path / "sleeve.wrinkles")
    scene = empty_scene()
    arm = build_arm("", folder)
    arm.animate([{"elbow_L": [0.2 * k]} for k in range(FRAMES)])
    scene.frame_start, scene.frame_end = 1, FRAMES
    bpy.context.view_layer.objects.active = arm.sleeve
    scene.frame_set(2)
    return arm


@pytest.fixture(autouse=True)
def nothing_runs() -> None:
    running.clear()


class Work:
    """Counts the work that this process does: kernels launched, and frames stepped to."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.done = 0
        launch = wp.launch

        def counted(*arguments: object, **options: object) -> object:
            self.done += 1
            return launch(*arguments, **options)

        patch.setattr(wp, "launch", counted)
        bpy.app.handlers.frame_change_pre.append(self._stepped)

    def _stepped(self, *arguments: object) -> None:
        self.done += 1

    def close(self) -> None:
        bpy.app.handlers.frame_change_pre.remove(self._stepped)


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch):
    counted = Work(monkeypatch)
    yield counted
    counted.close()


def run(begin: Callable[[], set[str]], operator, window: Window, work: Work) -> None:
    """From the button to the result; all that this process does in between is to look."""
    assert begin() == {"RUNNING_MODAL"}
    work.done = 0
    assert window.timers == 1 and len(running) == 1
    assert operator.modal(window, MOUSE) == {"PASS_THROUGH"}

    def looked() -> None:
        assert work.done == 0
        assert str(window.told[-1]).endswith("Esc stops.")

    assert tick_until_done(operator, window, looked) == {"FINISHED"}, window.told
    assert window.timers == 0 and not running


def test_a_recording_is_compressed_behind_the_window(
    arm: Arm, tmp_path: Path, work: Work, monkeypatch: pytest.MonkeyPatch
) -> None:
    window, out = Window(), tmp_path / "sleeve.flow"
    # A property of Blender's is single precision.
    error = float(np.float32(0.2))
    operator = operator_of(
        compress_flow.WRINKLE_OT_compress_flow, compress_flow, window, monkeypatch, filepath=str(out), error=error
    )
    run(lambda: operator.execute(window), operator, window, work)
    assert any("MB written to" in str(told) for told in window.told)
    assert arm.sleeve.wrinkles.flow.replays and Path(arm.sleeve.wrinkles.flow.path) == out
    behind = out.read_bytes()
    # As the same operator does it where there is no window.
    monkeypatch.undo()
    arm.sleeve.wrinkles.flow.replays = False
    assert bpy.ops.wrinkle.compress_flow(filepath=str(out), error=0.2) == {"FINISHED"}
    assert out.read_bytes() == behind


def test_a_clip_is_written_behind_the_window(
    arm: Arm, tmp_path: Path, work: Work, monkeypatch: pytest.MonkeyPatch
) -> None:
    window, out = Window(), tmp_path / "sleeve.pc2"
    operator = operator_of(write_clip.WRINKLE_OT_write_clip, write_clip, window, monkeypatch, filepath=str(out))
    run(lambda: operator.execute(window), operator, window, work)
    assert not list(tmp_path.glob("*.parts"))
    monkeypatch.undo()
    assert bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "own.pc2")) == {"FINISHED"}
    np.testing.assert_array_equal(PointCache(out).frames, PointCache(tmp_path / "own.pc2").frames)


def test_the_coarse_layer_is_simulated_behind_the_window(
    arm: Arm, tmp_path: Path, work: Work, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bpy.ops.wrinkle.make_coarse_mesh(vertex_count=60) == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    settings = arm.sleeve.wrinkles
    settings.coarse_layer, settings.coarse_pre_roll = "SIMULATION", 0.1
    # A folder beside the file that is not there yet means one beside this file, not beside the copy of it.
    assert settings.coarse_cache.startswith("//")
    monkeypatch.setattr(coarse_layer, "in_background", lambda: False)
    window = Window()
    operator = operator_of(simulate_coarse.WRINKLE_OT_simulate_coarse, simulate_coarse, window, monkeypatch)
    bpy.context.view_layer.update()
    player = playback.status(arm.sleeve).player
    run(lambda: operator.invoke(window, None), operator, window, work)
    assert f"{FRAMES} frames simulated, 0 kept" in window.told
    assert Path(bpy.path.abspath(settings.coarse_cache)).is_dir()
    for frame in (4, 1, 3):
        bpy.context.scene.frame_set(frame)
        known = playback.status(arm.sleeve)
        assert known.error == "" and known.player is not None and known.player.coarse.note == ""
        # Binding takes the longest, and is not done again.
        assert known.player is player


def test_playing_does_not_fill_a_cache_that_a_process_fills(
    arm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bpy.ops.wrinkle.make_coarse_mesh(vertex_count=60)
    settings = arm.sleeve.wrinkles
    settings.coarse_cache, settings.coarse_layer = str(tmp_path / "coarse"), "SIMULATION"
    monkeypatch.setattr(coarse_layer, "in_background", lambda: False)

    class Filling:
        verb, doing = file_process.SIMULATE, "Simulating"

    running[arm.sleeve.session_uid] = Filling()  # type: ignore[assignment]
    for frame in (1, 2):
        bpy.context.scene.frame_set(frame)
    assert not (tmp_path / "coarse").exists()


def test_the_evaluate_button_keeps_a_record_and_draws_it(
    arm: Arm, tmp_path: Path, work: Work, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bpy.ops.wrinkle.write_clip(filepath=str(tmp_path / "own.pc2")) == {"FINISHED"}
    window = Window()
    operator = operator_of(
        evaluate.WRINKLE_OT_evaluate, evaluate, window, monkeypatch,
        reference="cache", cache=str(tmp_path / "own.pc2"), frame_start=1, frame_end=FRAMES, frame_step=2,
    )  # fmt: skip
    run(lambda: operator.execute(window), operator, window, work)
    database = open_database(arm.sleeve)
    kept = read_evaluation(database.folder, database.header.key)
    assert kept is not None and [frame["frame"] for frame in kept["frames"]] == [1, 3]
    # Compared with what it plays itself; a cache holds single precision.
    assert kept["rmse_mm"]["ours"] < 0.01 < kept["rmse_mm"]["skinning"]
    assert {"sleeve error", "sleeve wrinkles"} <= set(bpy.data.images.keys())
    assert f"{kept['rmse_mm']['skinning']:.2f} mm RMS" in draw(panels.report.WRINKLE_PT_report).labels


# --- stopping and failing -----------------------------------------------------------------------------------------

WAITING = """
import json, sys, time
print(json.dumps({"event": "step", "share": 0.25, "text": "frame 1"}), file=sys.stderr, flush=True)
time.sleep(600)
"""
STUBBORN = """
import signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("{}", flush=True)
time.sleep(600)
"""
FAILING = """
import json, sys
print(json.dumps({"event": "error", "message": "The frames are gone."}), file=sys.stderr)
sys.exit(2)
"""


def stand_in(patch: pytest.MonkeyPatch, code: str) -> None:
    patch.setattr(file_process, "own_command", lambda *arguments: [sys.executable, "-c", code])


def writing(arm: Arm, window: Window, patch: pytest.MonkeyPatch, out: Path):
    operator = operator_of(write_clip.WRINKLE_OT_write_clip, write_clip, window, patch, filepath=str(out))
    assert operator.execute(window) == {"RUNNING_MODAL"}
    return operator


def test_escape_stops_at_once_and_leaves_nothing(arm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, WAITING)
    window, out = Window(), tmp_path / "out" / "sleeve.pc2"
    out.parent.mkdir()
    operator = writing(arm, window, monkeypatch, out)
    (process,) = running.values()
    while process.progress.share == 0.0:
        operator.modal(window, MOUSE)
        assert process.poll(1.0)
    assert "25 %; frame 1" in draw_status(operator, window)
    (out.parent / "sleeve.pc2.parts").mkdir()
    # The window does not wait for the process to end; it looks again, as long as it takes.
    assert operator.modal(window, ESCAPE) == {"RUNNING_MODAL"}
    assert process.stopped
    assert tick_until_done(operator, window) == {"CANCELLED"}
    assert "Writing stopped; no file was written." in window.told
    assert window.timers == 0 and not running and not list(out.parent.iterdir())


def draw_status(operator, window: Window) -> str:
    operator.modal(window, type(MOUSE)(type="TIMER"))
    return str(window.told[-1])


def test_a_process_that_does_not_listen_is_killed_when_patience_ends(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, STUBBORN)
    monkeypatch.setattr(file_process, "PATIENCE", 0.5)
    with FileProcess(arm.sleeve, "synthesize", (), doing="Writing") as process:
        while not process.result == {} or not process._result_path.read_text():
            assert process.poll(0.05)
        process.stop()
        assert process.poll()
        while process.poll(0.05):
            pass
    assert process._process is not None and process._process.poll() is not None


def test_what_fails_behind_the_window_is_told_in_its_own_words(
    arm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in(monkeypatch, FAILING)
    window = Window()
    operator = writing(arm, window, monkeypatch, tmp_path / "a.pc2")
    assert tick_until_done(operator, window) == {"CANCELLED"}
    assert "The frames are gone." in window.told and not running


def test_one_thing_at_a_time_runs_and_buttons_say_so(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    class Running:
        verb, doing = file_process.EVALUATE, "Evaluating"
        paused = stopped = False
        progress = file_process.StepProgress(0.5, "50 %", "frame 3")

    running[arm.sleeve.session_uid] = Running()  # type: ignore[assignment]
    for name in ("bake", "evaluate", "write_clip", "compress_flow"):
        assert not getattr(bpy.ops.wrinkle, name).poll(), name
    assert bpy.ops.wrinkle.stop_process.poll() and not bpy.ops.wrinkle.pause_bake.poll()
    shown = draw(panels.report.WRINKLE_PT_report)
    assert "wrinkle.stop_process" in shown.operators and "wrinkle.evaluate" not in shown.operators
    assert {"50 %", "frame 3"} <= set(shown.labels)


# --- a bake that was stopped --------------------------------------------------------------------------------------


def test_after_a_stopped_bake_the_panel_says_what_is_there_now(
    arm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "later.wrinkles"
    arm.sleeve.wrinkles.database = str(folder)
    bpy.context.view_layer.update()
    assert "There is no database" in draw(panels.play.WRINKLE_PT_play).text
    stand_in(monkeypatch, WAITING.replace('"step", "share": 0.25, "text": "frame 1"', '"error", "message": ""'))
    window = Window()
    operator = operator_of(bake.WRINKLE_OT_bake, bake, window, monkeypatch)
    assert operator.invoke(window, None) == {"RUNNING_MODAL"}
    # Nothing is wrong as long as it is being baked.
    assert "There is no database" not in draw(panels.play.WRINKLE_PT_play).text
    operator.modal(window, ESCAPE)
    assert tick_until_done(operator, window) == {"CANCELLED"}
    bpy.context.view_layer.update()
    assert "is not finished" in draw(panels.play.WRINKLE_PT_play).text
    # And if another one has baked it meanwhile, it plays.
    shutil.copytree(tmp_path / "sleeve.wrinkles", folder, dirs_exist_ok=True)
    assert operator.invoke(window, None) == {"RUNNING_MODAL"}
    operator.modal(window, ESCAPE)
    tick_until_done(operator, window)
    bpy.context.view_layer.update()
    assert playback.status(arm.sleeve).error == ""
    assert len(evaluated_positions(arm.sleeve)) == len(arm.sleeve.data.vertices)
