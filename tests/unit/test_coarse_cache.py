"""The history of a coarse simulation on disk: whole, resumable, and refused where it is of something else."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from wrinkle_synthesis.wrinkle_addon import storage
from wrinkle_synthesis.wrinkle_addon.coarse_bake import CoarseHistory, SceneFrame, bake_history
from wrinkle_synthesis.wrinkle_addon.coarse_cache import STATE_EVERY, CoarseCache, CoarseSpec, NotSimulated
from wrinkle_synthesis.wrinkle_addon.storage import StorageError

SPEC = CoarseSpec(
    garments={"vest": "a1", "coat": "b2"},
    body="c3",
    settings={"vest": {"steps": 5, "fabric": {"density": 0.2}}, "coat": {"steps": 5, "fabric": {"density": 0.4}}},
    fps=30.0,
    solver="1",
)


@dataclass(frozen=True)
class Report:
    restarted: bool


@dataclass(frozen=True, eq=False)
class State:
    positions: np.ndarray
    velocities: np.ndarray


class Springs:
    """A stand-in for the simulation: points that swing after the skinned layers, with all the memory that has."""

    def __init__(self):
        self.starts = self.steps = self.looks = 0

    def start(self, body_positions, carried):
        self.starts += 1
        self._positions = np.stack(carried).astype(np.float64)
        self._velocities = np.zeros_like(self._positions)
        return Report(True)

    def step(self, body_positions, carried, dt):
        self.steps += 1
        self._velocities += dt * 50.0 * (np.stack(carried) - self._positions)
        self._positions += dt * self._velocities
        return Report(False)

    def look_ahead(self):
        self.looks += 1

    @property
    def positions(self):
        return [layer.astype(np.float32) for layer in self._positions]

    def state(self):
        return State(self._positions.copy(), self._velocities.copy())

    def restore(self, state):
        self._positions, self._velocities = state.positions.copy(), state.velocities.copy()


def scene(frame, sway=1.0):
    """The scene in a frame: everything follows one hand that swings."""
    hand = np.array([[np.sin(0.2 * frame) * sway, 0.01 * frame, 1.0]], np.float32)
    carried = {"vest": hand + np.float32([[0.0, 0.1, 0.0]]), "coat": hand + np.float32([[0.0, 0.2, 0.0]])}
    return SceneFrame(frame, hand, carried, {"armature": hand, "body": hand[:1]})


def simulate(folder: Path, frames: range, scene_of=scene, spec=SPEC):
    """Fill the cache over frames, going on with what lies there: (cache, simulation, what happened)."""
    try:
        cache = CoarseCache.open(folder)
        cache.check(spec)
    except NotSimulated:
        cache = CoarseCache.begin(folder, spec, frames[0])
    springs = Springs()
    history = CoarseHistory(springs, cache, State)
    events = list(bake_history(history, map(scene_of, frames), frames[-1]))
    return cache, springs, events


def content(folder: Path):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "shirt.coarse"


# --- reading ------------------------------------------------------------------------------------------------------


def test_frames_are_read_at_random_and_between_for_motion_blur(folder):
    simulate(folder, range(1, 41))
    cache = CoarseCache.open(folder)
    assert (cache.first, cache.last) == (1, 40)
    for frame in (40, 3, 17):
        assert set(cache.positions(frame)) == {"vest", "coat"}
    between = 0.75 * cache.positions(7)["vest"] + 0.25 * cache.positions(8)["vest"]
    # Single precision.
    np.testing.assert_allclose(cache.positions(7.25)["vest"], between, atol=1e-6)
    cache.check(SPEC)
    cache.read_of(17, scene(17).motion)


@pytest.mark.parametrize(
    ("time", "words"), [(0, "0; simulate from it"), (41, "41; simulate up to it"), (40.25, "41; "), (-3.5, "-4; ")]
)
def test_a_frame_outside_is_refused(folder, time, words):
    cache, _, _ = simulate(folder, range(1, 41))
    with pytest.raises(NotSimulated, match=f"holds frames 1 to 40, not frame {words}"):
        cache.positions(time)


def test_a_folder_without_a_simulation_says_so(folder):
    with pytest.raises(NotSimulated, match=r"There is no coarse simulation in .* simulate it first"):
        CoarseCache.open(folder)


def test_damage_is_named(folder):
    cache, _, _ = simulate(folder, range(1, 5))
    path = next(folder.glob("frame-*-000003.*"))
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(StorageError, match="damaged or truncated"):
        cache.positions(3)
    (folder / "manifest.json").write_text('{"format": 1}')
    with pytest.raises(StorageError, match="is damaged"):
        CoarseCache.open(folder)
    (folder / "manifest.json").write_text('{"format": 99}')
    with pytest.raises(StorageError, match="format 99"):
        CoarseCache.open(folder)


# --- going on -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stopped", [1, 12, STATE_EVERY, STATE_EVERY + 1, 2 * STATE_EVERY - 1])
def test_a_simulation_that_was_stopped_goes_on_to_the_same_bits(folder, tmp_path, stopped):
    simulate(tmp_path / "whole", range(1, 61))
    cache = CoarseCache.begin(folder, SPEC, 1)
    events = bake_history(CoarseHistory(Springs(), cache, State), map(scene, range(1, 61)), 60)
    for _ in range(stopped):
        next(events)
    _, springs, found = simulate(folder, range(1, 61))
    assert content(folder) == content(tmp_path / "whole")
    assert springs.starts == 0 and springs.steps <= 60 - stopped + STATE_EVERY
    assert [event.kept for event in found] == [True] * stopped + [False] * (60 - stopped)


def test_a_frame_is_there_at_once_and_its_file_when_it_is_written(folder, monkeypatch):
    begun, may_write = threading.Event(), threading.Event()
    write_arrays = storage.write_arrays

    def slow(*arguments):
        begun.set()
        may_write.wait()
        write_arrays(*arguments)

    cache = CoarseCache.begin(folder, SPEC, 1)
    monkeypatch.setattr(storage, "write_arrays", slow)
    CoarseHistory(Springs(), cache, State).advance(scene(1))
    # Nothing is written beside a frame that somebody waits for.
    assert not begun.wait(0.2)
    cache.write_behind()
    assert begun.wait(60.0)
    assert set(cache.positions(1)) == {"vest", "coat"} and CoarseCache.open(folder).last == 0
    may_write.set()
    cache.flush()
    assert CoarseCache.open(folder).last == 1


def test_a_frame_that_cannot_be_written_is_not_there(folder, monkeypatch):
    def refuse(*arguments):
        raise StorageError("The disk is full.")

    history = CoarseHistory(Springs(), CoarseCache.begin(folder, SPEC, 1), State)
    history.advance(scene(1))
    history.cache.flush()
    monkeypatch.setattr(storage, "write_arrays", refuse)
    history.advance(scene(2))
    with pytest.raises(StorageError, match="full"):
        history.advance(scene(3))
    assert history.cache.last == 1 and not history.follows(3)
    with pytest.raises(NotSimulated):
        history.cache.read(2)


def test_a_longer_range_goes_on_where_the_last_one_ended(folder):
    simulate(folder, range(1, 31))
    cache, springs, events = simulate(folder, range(1, 41))
    assert (springs.starts, springs.steps, cache.last) == (0, 10, 40)
    assert sum(event.kept for event in events) == 30


def test_a_complete_range_is_left_alone(folder):
    simulate(folder, range(1, 31))
    before = content(folder)
    _, springs, events = simulate(folder, range(1, 31))
    assert springs.steps == 0 and all(event.kept for event in events)
    assert content(folder) == before


def test_a_history_begins_at_its_first_frame_or_goes_on_from_a_state(folder):
    cache, _, _ = simulate(folder, range(1, 31))
    history = CoarseHistory(Springs(), cache, State)
    assert history.follows(1) and history.follows(2) and history.follows(31) and history.follows(STATE_EVERY + 2)
    assert not history.follows(7) and not history.follows(33)
    history.advance(scene(31))
    assert history.follows(32) and cache.last == 31
    with pytest.raises(NotSimulated, match="cannot go on from frame 5"):
        history.advance(scene(6))


# --- what changed -------------------------------------------------------------------------------------------------


def test_another_motion_is_simulated_again_from_where_it_differs(folder, tmp_path):
    def changed(frame):
        return scene(frame, 1.0 if frame < 34 else 1.2)

    simulate(folder, range(1, 61))
    cache = CoarseCache.open(folder)
    with pytest.raises(NotSimulated, match="the armature is elsewhere in frame 34; simulate again"):
        cache.read_of(34, changed(34).motion)
    _, springs, events = simulate(folder, range(1, 61), changed)
    assert [event.frame for event in events if event.moved] == [34]
    assert sum(event.kept for event in events) == 33 and springs.starts == 0
    simulate(tmp_path / "anew", range(1, 61), changed)
    assert content(folder) == content(tmp_path / "anew")


def test_what_rounding_moves_has_not_moved(folder):
    cache, _, _ = simulate(folder, range(1, 4))
    near = {name: points + np.float32(5e-5) for name, points in scene(2).motion.items()}
    cache.read_of(2, near)
    cache.read_of(2, {"body": near["body"]})
    with pytest.raises(NotSimulated, match="the body is elsewhere"):
        cache.read_of(2, {**near, "body": near["body"] + np.float32(1e-3)})
    with pytest.raises(NotSimulated, match="the body is elsewhere"):
        cache.read_of(2, {"body": np.zeros((7, 3), np.float32)})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"garments": {"vest": "a1", "coat": "99"}}, "before the garment 'coat' changed; simulate again"),
        ({"garments": {"coat": "b2", "vest": "a1"}}, "before the layers (vest, coat, now coat, vest) changed"),
        ({"garments": {"vest": "a1"}}, "before the layers (vest, coat, now vest) changed"),
        ({"body": "99"}, "before the body's mesh changed"),
        ({"fps": 25.0}, "before the frame rate (30, now 25) changed"),
        ({"solver": "2"}, "before the solver changed"),
        (
            {"settings": {**SPEC.settings, "vest": {"steps": 4, "fabric": {"density": 0.3}}}, "fps": 24.0},
            "before the setting density (0.2, now 0.3), the setting steps (5, now 4) and the frame rate (30, now 24) ",
        ),
    ],
)
def test_a_cache_of_something_else_says_what_changed(folder, change, words):
    cache, _, _ = simulate(folder, range(1, 4))
    with pytest.raises(NotSimulated) as refused:
        cache.check(replace(SPEC, **change))
    assert words in str(refused.value)
    cache.check(SPEC)


def test_a_cache_of_something_else_is_replaced_whole(folder):
    simulate(folder, range(1, 30))
    other = replace(SPEC, fps=25.0)
    simulate(folder, range(1, 11), spec=other)
    cache = CoarseCache.open(folder)
    assert cache.last == 10 and len(list(folder.glob("frame-*"))) == 10
    cache.check(other)
