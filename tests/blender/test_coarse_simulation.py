"""Coarse simulations of a scene: baked, played at random, filled live, and refused where the scene has changed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from small_character import Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon import threads
from wrinkle_synthesis.wrinkle_addon.aligned_wrinkles import AlignedWrinkles
from wrinkle_synthesis.wrinkle_addon.blender import coarse_layer, coarse_playing, playback
from wrinkle_synthesis.wrinkle_addon.blender.handlers import RENDER_FAILED, suspended
from wrinkle_synthesis.wrinkle_addon.coarse_cache import CoarseCache
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache

FRAMES = 6


@pytest.fixture
def arm(database: Path, bumps: Bumps, tmp_path: Path) -> Arm:
    """An arm that lifts over six frames; its sleeve follows a simulation that does not exist yet."""
    scene = empty_scene()
    arm = build_arm("", database)
    arm.animate([{"elbow_L": [0.1 * k], "shoulder_L": [0.0, 0.08 * k, 0.0]} for k in range(FRAMES + 3)])
    scene.frame_start, scene.frame_end = 1, FRAMES
    with suspended():
        scene.frame_set(1)
        bpy.context.view_layer.objects.active = arm.sleeve
        bpy.ops.wrinkle.make_coarse_mesh(vertex_count=60)
        arm.sleeve.wrinkles.coarse_pre_roll = 0.1
    save(tmp_path / "arm.blend")
    return arm


@pytest.fixture
def file(arm: Arm, tmp_path: Path) -> Path:
    return tmp_path / "arm.blend"


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody looks on."""
    monkeypatch.setattr(coarse_layer, "in_background", lambda: False)


def save(path: Path) -> Path:
    with suspended():
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def sleeve() -> bpy.types.Object:
    return bpy.data.objects["sleeve"]


def note() -> str:
    player = playback.status(sleeve()).player
    assert player is not None and playback.status(sleeve()).error == ""
    return player.coarse.note


# --- baking -------------------------------------------------------------------------------------------------------


def test_simulating_fills_the_cache_beside_the_file(wrinkle, file: Path) -> None:
    result = wrinkle("simulate", file, "--frames", "1:4", "--json").result
    assert (result["simulated"], result["kept"], result["garments"]) == (4, 0, ["sleeve"])
    assert Path(result["cache"]) == file.parent / "rig.coarse"
    cache = CoarseCache.open(file.parent / "rig.coarse")
    assert (cache.first, cache.last) == (1, 4)
    assert cache.positions(4)["sleeve"].shape == (len(bpy.data.objects["sleeve.coarse"].data.vertices), 3)


def test_simulating_goes_on_and_simulates_again_what_moved(wrinkle, arm: Arm, file: Path) -> None:
    wrinkle("simulate", file, "--frames", "1:4")
    result = wrinkle("simulate", file, "--json").result
    assert (result["simulated"], result["kept"], result["replaced"]) == (2, 4, "")
    arm = Arm(bpy.data.objects["rig"], sleeve(), arm.rig)
    arm.animate([{"elbow_L": [0.1 * k + 0.2 * (k > 3)], "shoulder_L": [0.0, 0.08 * k, 0.0]} for k in range(FRAMES)])
    save(file)
    outcome = wrinkle("simulate", file, "--json")
    assert (outcome.result["simulated"], outcome.result["kept"], outcome.result["motion_changed_from"]) == (2, 4, 5)
    assert "The motion changed from frame 5 on" in outcome.errors


def test_the_same_scene_gives_the_same_bytes_at_once_or_bit_by_bit(wrinkle, file: Path) -> None:
    folder = file.parent / "rig.coarse"

    def frames() -> dict[str, bytes]:
        return {name: points.tobytes() for k in range(1, FRAMES + 1) for name, points in read(folder, k).items()}

    wrinkle("simulate", file)
    whole = frames()
    for path in folder.iterdir():
        path.unlink()
    for last in (2, 3, FRAMES):
        wrinkle("simulate", file, "--frames", f"1:{last}")
    assert frames() == whole


def read(folder: Path, frame: int) -> dict[str, np.ndarray]:
    return {f"{frame} {name}": points for name, points in CoarseCache.open(folder).positions(frame).items()}


def test_an_earlier_first_frame_begins_anew(wrinkle, file: Path) -> None:
    wrinkle("simulate", file, "--frames", "3:4")
    result = wrinkle("simulate", file, "--json").result
    assert "began at frame 3, after frame 1; it is simulated again" in result["replaced"]
    assert result["simulated"] == FRAMES


def test_a_coarser_body_is_one_number(wrinkle, arm: Arm, file: Path) -> None:
    arm.sleeve.wrinkles.coarse_proxy = 200
    save(file)
    assert wrinkle("simulate", file, "--json").result["simulated"] == FRAMES
    folder = file.parent / "rig.coarse"
    near = read(folder, FRAMES)[f"{FRAMES} sleeve"]
    sleeve().wrinkles.coarse_proxy = 0
    save(file)
    result = wrinkle("simulate", file, "--json").result
    assert "the setting body proxy (200, now 0) changed" in result["replaced"]
    difference = np.linalg.norm(read(folder, FRAMES)[f"{FRAMES} sleeve"] - near, axis=1)
    # Facets of the proxy, and where the loose sleeve slides on them.
    assert 0.0 < np.median(difference) < 0.01


def test_a_character_that_jumps_is_settled_anew_and_that_is_said(wrinkle, arm: Arm, file: Path) -> None:
    for ob in bpy.data.objects:
        for frame, x in ((3, 0.0), (4, 5.0)):
            ob.location.x = x
            ob.keyframe_insert("location", frame=frame)
    save(file)
    outcome = wrinkle("simulate", file, "--json")
    assert list(outcome.result["restarts"]) == ["4"] and "jumped at" in outcome.result["restarts"]["4"]
    bpy.context.scene.frame_set(4)
    assert "jumped at" in note() and note().endswith("The simulation begins anew here.")
    bpy.context.scene.frame_set(5)
    assert note() == ""


def test_the_operator_bakes_and_shows_what_it_baked(arm: Arm) -> None:
    assert bpy.ops.wrinkle.simulate_coarse() == {"FINISHED"}
    for frame in (5, 2):
        bpy.context.scene.frame_set(frame)
        assert note() == ""


# --- playing ------------------------------------------------------------------------------------------------------


def test_a_simulated_garment_is_played_as_it_is_written(wrinkle, file: Path) -> None:
    out = file.parent / "a.pc2"
    wrinkle("simulate", file)
    assert wrinkle("synthesize", file, "--frames", f"1:{FRAMES}", "--out", out).code == 0
    for frame in (FRAMES, 2, 4):
        bpy.context.scene.frame_set(frame)
        np.testing.assert_allclose(evaluated_positions(sleeve()), PointCache(out).frames[frame - 1], atol=1e-5)
    simulated = evaluated_positions(sleeve())
    sleeve().wrinkles.coarse_layer = "MESH"
    bpy.context.view_layer.update()
    # The simulated sleeve hangs; the skinned one does not.
    assert (simulated - evaluated_positions(sleeve()))[:, 2].min() < -2e-3


def test_motion_blur_reads_between_frames(wrinkle, file: Path) -> None:
    wrinkle("simulate", file)
    bpy.context.scene.frame_set(3, subframe=0.5)
    assert note() == ""


def test_a_frame_that_is_not_simulated_is_an_error_in_the_background(wrinkle, file: Path) -> None:
    out = ("--out", file.parent / "a.pc2")
    assert "There is no coarse simulation in" in wrinkle("synthesize", file, *out).complaint
    wrinkle("simulate", file, "--frames", "1:4")
    assert "holds frames 1 to 4, not frame 5; simulate up to it" in wrinkle("synthesize", file, *out).complaint
    assert not (file.parent / "a.pc2").exists()


RENDER = """
import sys
import bpy
import wrinkle_synthesis
wrinkle_synthesis.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
for frame in (2, 5):
    bpy.context.scene.frame_set(frame)
    print("went on after", frame, flush=True)
"""


def test_a_background_process_ends_at_a_frame_that_is_not_simulated(wrinkle, file: Path) -> None:
    wrinkle("simulate", file, "--frames", "1:4")
    command = [sys.executable, "-c", RENDER, str(file)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120, env=dict(os.environ))
    assert done.returncode == RENDER_FAILED
    assert "went on after 2" in done.stdout and "went on after 5" not in done.stdout
    assert "holds frames 1 to 4, not frame 5" in done.stderr


@pytest.mark.usefixtures("window")
def test_in_a_window_the_garment_goes_without_and_the_panel_says_why(wrinkle, file: Path) -> None:
    wrinkle("simulate", file, "--frames", "1:4")
    bpy.context.scene.frame_set(FRAMES)
    assert "holds frames 1 to 4, not frame 6" in note()
    shown = evaluated_positions(sleeve())
    sleeve().wrinkles.coarse_layer = "NONE"
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(evaluated_positions(sleeve()), shown)


@pytest.mark.usefixtures("window")
def test_files_are_never_written_without_the_coarse_layer(wrinkle, file: Path) -> None:
    wrinkle("simulate", file, "--frames", "1:4")
    out = file.parent / "a.pc2"
    assert "not frame 5" in wrinkle("synthesize", file, "--out", out).complaint
    assert not out.exists()


# --- what changed -------------------------------------------------------------------------------------------------


def move(arm: Arm) -> None:
    arm.armature.location.z = 0.1


def frame_rate(arm: Arm) -> None:
    bpy.context.scene.render.fps = 12


def reshape(arm: Arm) -> None:
    arm.sleeve.wrinkles.coarse.data.vertices[0].co.x -= 0.002


def stiffer(arm: Arm) -> None:
    arm.sleeve.wrinkles.coarse_steps = 3


def other_body(arm: Arm) -> None:
    arm.sleeve.wrinkles.body.data.vertices[0].co.x -= 0.002


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (move, "The motion changed since the coarse simulation"),
        (frame_rate, "was made before the frame rate (24, now 12) changed"),
        (reshape, "was made before the garment 'sleeve' changed"),
        (stiffer, "was made before the setting steps (5, now 3) changed"),
        (other_body, "was made before the body's mesh changed"),
    ],
)
def test_what_changed_since_it_was_simulated_is_told(
    wrinkle, arm: Arm, file: Path, window: None, change: Callable[[Arm], None], sentence: str
) -> None:
    wrinkle("simulate", file)
    here = Arm(bpy.data.objects["rig"], sleeve(), arm.rig)
    with suspended():
        change(here)
        bpy.context.view_layer.update()
    save(file)
    bpy.ops.wm.open_mainfile(filepath=str(file))
    bpy.context.scene.frame_set(3)
    assert sentence in note()
    assert wrinkle("simulate", file, "--json").result["simulated"] == FRAMES
    bpy.context.scene.frame_set(3)
    assert note() == ""


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--out", "a.pc2"), "leave --out away, or add --fine"),
        (("--fine",), "Name the .pc2 file"),
        (("--frames", "1:5:2"), "holds every frame"),
    ],
)
def test_options_that_make_no_sense_are_refused(wrinkle, file: Path, arguments: tuple[str, ...], sentence: str) -> None:
    assert sentence in wrinkle("simulate", file, *arguments).complaint


@pytest.mark.parametrize("proxy", [0, 200])
def test_a_body_that_changes_its_mesh_between_frames_is_refused(wrinkle, arm: Arm, file: Path, proxy: int) -> None:
    arm.sleeve.wrinkles.coarse_proxy = proxy
    finer = arm.sleeve.wrinkles.body.modifiers.new("Finer", "SUBSURF")
    for frame, shown in ((1, False), (3, True)):
        finer.show_viewport = shown
        finer.keyframe_insert("show_viewport", frame=frame)
    save(file)
    outcome = wrinkle("simulate", file)
    assert outcome.code == 2 and "wrinkle: The body has 384 vertices, but 1504 in this frame" in outcome.errors
    # What was simulated before it is kept.
    assert CoarseCache.open(file.parent / "rig.coarse").last == 2


def test_a_garment_that_follows_no_simulation_cannot_be_simulated(wrinkle, arm: Arm, file: Path) -> None:
    arm.sleeve.wrinkles.coarse_layer = "MESH"
    save(file)
    assert "does not follow a simulation" in wrinkle("simulate", file).complaint
    arm = Arm(bpy.data.objects["rig"], sleeve(), arm.rig)
    arm.sleeve.wrinkles.coarse_layer, arm.sleeve.wrinkles.coarse_cache = "SIMULATION", ""
    save(file)
    assert "has no folder for its coarse simulation" in wrinkle("simulate", file).complaint


def test_a_hidden_body_is_simulated_as_if_it_were_shown(wrinkle, file: Path) -> None:
    wrinkle("simulate", file, "--frames", "1:3")
    shown = read(file.parent / "rig.coarse", 3)["3 sleeve"]
    for name in ("body", "sleeve.coarse"):
        bpy.data.objects[name].hide_viewport = bpy.data.objects[name].hide_render = True
    save(file)
    assert wrinkle("simulate", file, "--frames", "1:3", "--json").result["kept"] == 3
    shutil.rmtree(file.parent / "rig.coarse")
    wrinkle("simulate", file, "--frames", "1:3")
    np.testing.assert_array_equal(read(file.parent / "rig.coarse", 3)["3 sleeve"], shown)
    sleeve().hide_viewport = True
    save(file)
    assert "The garment 'sleeve' is hidden" in wrinkle("simulate", file).complaint


# --- live ---------------------------------------------------------------------------------------------------------


def written(folder: Path) -> CoarseCache:
    """What lies on the disk once the last frame, which another thread writes, does."""
    coarse_playing.flush()
    return CoarseCache.open(folder)


def play(*frames: int) -> None:
    """What a window does: a frame, and between two frames what waits for Blender to be at leisure."""
    scene = bpy.context.scene
    for frame in frames:
        scene.frame_set(frame)
        if coarse_playing.has_wishes():
            with suspended():
                coarse_playing.grant_wishes()
            scene.frame_set(frame)


@pytest.mark.usefixtures("window")
def test_playing_from_the_first_frame_fills_the_cache(wrinkle, arm: Arm, file: Path) -> None:
    play(1, 2, 3, 4)
    folder = file.parent / "rig.coarse"
    assert note() == "" and written(folder).last == 4
    live = [read(folder, frame) for frame in range(1, 5)]
    # A jump is not simulated, nor is it guessed; coming back is going on.
    play(6)
    assert "holds frames 1 to 4, not frame 6" in note()
    play(3)
    assert note() == ""
    play(5)
    assert note() == "" and written(folder).last == 5
    wrinkle("simulate", file, "--frames", "1:5")
    baked = [read(folder, frame) for frame in range(1, 5)]
    for one, other in zip(live, baked, strict=True):
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.usefixtures("window")
def test_a_played_frame_gets_its_file_though_nobody_asks_for_it(arm: Arm, file: Path) -> None:
    play(1, 2, 3)
    given_up = time.monotonic() + 60.0
    while CoarseCache.open(file.parent / "rig.coarse").last < 3:
        assert time.monotonic() < given_up
        time.sleep(0.01)


@pytest.mark.usefixtures("window")
@pytest.mark.parametrize("threads_of", [1, 2])
def test_any_number_of_threads_shows_the_same_bits(arm: Arm, monkeypatch: pytest.MonkeyPatch, threads_of: int) -> None:
    monkeypatch.setattr(threads, "THREADS", threads_of)
    began: list[object] = []
    act = AlignedWrinkles.synthesise

    def synthesise(self: AlignedWrinkles, *arguments: Any) -> None:
        began.append(self)
        act(self, *arguments)

    monkeypatch.setattr(AlignedWrinkles, "synthesise", synthesise)
    play(1)
    began.clear()
    live = []
    for frame in (2, 3, 4):
        play(frame)
        assert note() == ""
        live.append(evaluated_positions(sleeve()))
    # Once a frame, while it is simulated.
    assert len(began) == 3
    # Read from the cache no frame waits for anything.
    for frame, positions in zip((2, 3, 4), live, strict=True):
        play(frame)
        np.testing.assert_array_equal(evaluated_positions(sleeve()), positions)


@pytest.mark.usefixtures("window")
def test_an_error_on_another_thread_is_told_and_the_next_frame_plays_again(
    arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    play(1, 2)

    def fail(*arguments: Any) -> None:
        raise ValueError("The samples are lost.")

    scene = bpy.context.scene
    with monkeypatch.context() as broken, suspended():
        broken.setattr(AlignedWrinkles, "synthesise", fail)
        scene.frame_set(3)
        errors = playback.play_scene(scene, bpy.context.evaluated_depsgraph_get())
        assert errors == [playback.status(sleeve()).error] == ["The samples are lost."]
    play(4)
    assert note() == ""


@pytest.mark.usefixtures("window")
def test_no_frame_wakes_a_thread_of_numpys(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    play(1, 2)

    def wake(*matrices: Any) -> None:
        raise AssertionError("A thread of the BLAS now spins for longer than a frame.")

    for name in ("inv", "solve"):
        monkeypatch.setattr(np.linalg, name, wake)
    play(3)
    assert note() == ""


@pytest.mark.usefixtures("window")
def test_playing_goes_on_where_a_bake_ended(wrinkle, file: Path) -> None:
    wrinkle("simulate", file, "--frames", "1:3")
    play(2)
    assert not coarse_playing.has_wishes()
    play(4, 5)
    assert note() == "" and written(file.parent / "rig.coarse").last == 5


@pytest.mark.usefixtures("window")
def test_playing_another_motion_from_the_first_frame_simulates_it_again(wrinkle, arm: Arm, file: Path) -> None:
    wrinkle("simulate", file)
    before = read(file.parent / "rig.coarse", 2)
    for ob in bpy.data.objects:
        ob.location.z += 0.1
    play(3)
    assert "The motion changed" in note()
    play(1, 2)
    assert note() == ""
    cache = written(file.parent / "rig.coarse")
    # What comes after is of the old motion, and is gone.
    assert cache.last == 2
    assert np.abs(read(cache.folder, 2)["2 sleeve"] - before["2 sleeve"])[:, 2].min() > 0.05


# --- garments worn over each other --------------------------------------------------------------------------------


def test_garments_of_one_character_and_folder_are_simulated_together(wrinkle, arm: Arm, file: Path) -> None:
    coat = build_arm("coat ", around=10, along=20)
    coat.sleeve.data.transform(((1, 0, 0, 0), (0, 1.3, 0, 0), (0, 0, 1.3, 0), (0, 0, 0, 1)))
    for unused in (coat.armature, coat.sleeve.wrinkles.body):
        bpy.data.objects.remove(unused)
    settings = coat.sleeve.wrinkles
    settings.armature, settings.body = arm.armature, arm.sleeve.wrinkles.body
    coat.sleeve.modifiers[0].object = arm.armature
    with suspended():
        bpy.context.view_layer.update()
        bpy.context.view_layer.objects.active = coat.sleeve
        bpy.ops.wrinkle.make_coarse_mesh(vertex_count=60)
    settings.coarse_order = 1
    save(file)
    result = wrinkle("simulate", file, "--garment", "sleeve", "--frames", "1:3", "--json").result
    assert result["garments"] == ["sleeve", "coat sleeve"]
    assert set(written(file.parent / "rig.coarse").positions(3)) == {"sleeve", "coat sleeve"}
    bpy.data.objects["coat sleeve"].wrinkles.coarse_layer = "NONE"
    save(file)
    assert (
        "the layers (sleeve, coat sleeve, now sleeve) changed"
        in wrinkle("synthesize", file, "--garment", "sleeve", "--out", file.parent / "a.pc2").complaint
    )
