"""A point cache made in parts: by many, in any order, stopped at any moment, it comes out the same."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from wrinkle_synthesis.wrinkle_addon import cache_parts
from wrinkle_synthesis.wrinkle_addon.cache_parts import CacheParts
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache
from wrinkle_synthesis.wrinkle_addon.storage import StorageError

VERTICES = 7
CLIP = range(-3, 20)


@pytest.fixture(autouse=True)
def short_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_parts, "LONGEST", 5)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "shirt.pc2"


def parts_of(out: Path, key: str = "key", vertex_count: int = VERTICES) -> CacheParts:
    return CacheParts.beside(out, key, vertex_count)


def shape(frame: int) -> np.ndarray:
    return np.random.default_rng(1000 + frame).random((VERTICES, 3)).astype(np.float32)


def shapes(frames: range) -> Iterator[np.ndarray]:
    return (shape(frame) for frame in frames)


def fill(parts: CacheParts, frames: range, positions: Callable[[range], Iterator[np.ndarray]] = shapes) -> list[range]:
    return list(parts.fill(frames, positions))


def assert_whole(out: Path) -> None:
    cache = PointCache(out)
    assert cache.start == CLIP.start
    np.testing.assert_array_equal(cache.frames, np.stack(list(shapes(CLIP))))


def test_parts_made_in_any_order_and_overlapping_join_into_one_cache(out: Path):
    parts = parts_of(out)
    for part in (range(12, 20), range(-3, 2), range(0, 14)):
        fill(parts_of(out), part)
    assert parts.missing(CLIP) == []
    parts.join(CLIP, out)
    assert_whole(out)
    parts.remove()
    assert [path.name for path in out.parent.iterdir()] == ["shirt.pc2"]


def test_what_is_there_is_not_made_again(out: Path):
    fill(parts_of(out), range(2, 8))
    made = fill(parts_of(out), CLIP)
    assert [frame for stretch in made for frame in stretch] == [frame for frame in CLIP if frame not in range(2, 8)]
    assert max(map(len, made)) == 5
    assert fill(parts_of(out), CLIP) == []


def test_joining_says_what_is_missing_and_leaves_an_older_result(out: Path):
    out.write_bytes(b"older")
    fill(parts_of(out), range(-3, 11))
    with pytest.raises(StorageError, match=r"9 of 23 frames of '.*shirt.pc2' are still to be made, the first is 11"):
        parts_of(out).join(CLIP, out)
    assert out.read_bytes() == b"older"


def test_a_run_that_is_interrupted_goes_on_after_its_last_part(out: Path):
    def interrupted(frames: range) -> Iterator[np.ndarray]:
        for frame in frames:
            if frame == 9:
                raise KeyboardInterrupt
            yield shape(frame)

    with pytest.raises(KeyboardInterrupt):
        fill(parts_of(out), CLIP, interrupted)
    assert parts_of(out).missing(CLIP)[0].start == 7
    assert not [path for path in parts_of(out).folder.iterdir() if path.suffix != ".pc2"]
    fill(parts_of(out), CLIP)
    parts_of(out).join(CLIP, out)
    assert_whole(out)


KILLED = """
import sys, time
from pathlib import Path
import numpy as np
from wrinkle_synthesis.wrinkle_addon import cache_parts
cache_parts.LONGEST = 5
def shapes(frames):
    for frame in frames:
        time.sleep(0.02)
        yield np.random.default_rng(1000 + frame).random((7, 3)).astype(np.float32)
parts = cache_parts.CacheParts.beside(Path(sys.argv[1]), "key", 7)
print("begins", flush=True)
for made in parts.fill(range(-3, 20), shapes):
    print(made, flush=True)
"""


def test_a_process_that_is_killed_leaves_whole_parts_only(out: Path):
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(out)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for _ in range(3):
        process.stdout.readline()
    # In the middle of the third part, whose five frames take a tenth of a second.
    time.sleep(0.05)
    process.kill()
    process.wait()
    process.stdout.close()
    missing = [frame for stretch in parts_of(out).missing(CLIP) for frame in stretch]
    assert missing == list(CLIP)[-len(missing) :] and 0 < len(missing) <= 13
    fill(parts_of(out), CLIP)
    parts_of(out).join(CLIP, out)
    assert_whole(out)
    parts_of(out).remove()
    assert [path.name for path in out.parent.iterdir()] == ["shirt.pc2"]


def test_two_processes_on_the_same_frames_do_each_other_no_harm(out: Path):
    processes = [subprocess.Popen([sys.executable, "-c", KILLED, str(out)], stdout=subprocess.DEVNULL) for _ in "ab"]
    assert [process.wait() for process in processes] == [0, 0]
    parts_of(out).join(CLIP, out)
    assert_whole(out)


def test_parts_of_another_file_another_count_or_with_damage_are_made_anew(out: Path):
    fill(parts_of(out, "other"), CLIP)
    fill(parts_of(out, vertex_count=3), range(0, 4), lambda frames: (np.zeros((3, 3), np.float32) for _ in frames))
    assert sum(map(len, parts_of(out).missing(CLIP))) == len(CLIP)
    fill(parts_of(out), CLIP)
    victim = next(parts_of(out).folder.glob("key_2_*"))
    victim.write_bytes(victim.read_bytes()[:-4])
    assert parts_of(out).missing(CLIP) == [range(2, 7)]
    fill(parts_of(out), CLIP)
    parts_of(out).join(CLIP, out)
    assert_whole(out)


def test_positions_of_another_count_are_refused_and_nothing_is_left(out: Path):
    with pytest.raises(StorageError, match="has 3 vertices, not 7"):
        fill(parts_of(out), CLIP, lambda frames: (np.zeros((3, 3), np.float32) for _ in frames))
    assert not list(parts_of(out).folder.iterdir())
