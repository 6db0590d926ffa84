"""Files are whole or not there, the same input gives the same bytes, and damage is said in one sentence."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from wrinkle_synthesis.wrinkle_addon import storage
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache, write_pc2
from wrinkle_synthesis.wrinkle_addon.storage import StorageError


def some_arrays(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "offsets": rng.normal(size=(50, 3)).astype(np.float16),
        "vertices": np.arange(50, dtype=np.int32),
        "positions": rng.normal(size=(50, 3)),
    }


def test_arrays_and_metadata_come_back_as_they_were(tmp_path: Path):
    arrays, metadata = some_arrays(), {"joint": "elbow_L", "angles": [0.1, -2.5], "deep": {"b": [1], "a": None}}
    storage.write_arrays(tmp_path / "a.safetensors", arrays, metadata)
    back, found = storage.read_arrays(tmp_path / "a.safetensors")
    assert found == metadata
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)


def test_the_same_input_gives_the_same_bytes_in_another_process(tmp_path: Path):
    storage.write_arrays(tmp_path / "here.safetensors", some_arrays(), {"z": 1, "a": [1.5, "x"], "m": {"q": 1, "b": 2}})
    code = (
        "import sys; sys.path[:0] = sys.argv[2:]\n"
        "from test_storage import some_arrays\n"
        "from pathlib import Path\n"
        "from wrinkle_synthesis.wrinkle_addon import storage\n"
        "arrays = dict(reversed(list(some_arrays().items())))\n"
        "storage.write_arrays(Path(sys.argv[1]), arrays, {'m': {'b': 2, 'q': 1}, 'a': [1.5, 'x'], 'z': 1})\n"
    )
    here = Path(__file__).parent
    subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "there.safetensors"), str(here), str(here.parent)],
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "7"},
    )
    assert (tmp_path / "here.safetensors").read_bytes() == (tmp_path / "there.safetensors").read_bytes()


@pytest.mark.parametrize("kept", [0, 7, 60, 300, -1])
def test_a_truncated_file_is_refused(tmp_path: Path, kept: int):
    path = tmp_path / "a.safetensors"
    storage.write_arrays(path, some_arrays(), {})
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(StorageError, match="damaged or truncated"):
        storage.read_arrays(path)


def test_a_file_of_another_kind_is_refused(tmp_path: Path):
    path = tmp_path / "a.safetensors"
    path.write_bytes(os.urandom(4000))
    with pytest.raises(StorageError, match="damaged or truncated"):
        storage.read_arrays(path)


def test_values_that_are_not_numbers_are_refused(tmp_path: Path):
    storage.write_arrays(tmp_path / "a.safetensors", {"offsets": np.array([1.0, np.nan])}, {})
    with pytest.raises(StorageError, match="not numbers"):
        storage.read_arrays(tmp_path / "a.safetensors")


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(StorageError, match=r"no file .*gone\.safetensors"):
        storage.read_arrays(tmp_path / "gone.safetensors")


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_leaves_nothing_behind_and_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.json"
    storage.write_json(path, {"old": True})
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(StorageError, match="the disk is full"):
        storage.write_json(path, {"old": False})
    monkeypatch.undo()
    assert storage.read_json(path) == {"old": True}
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="Cannot write to the folder"):
        storage.make_folder(tmp_path / "file" / "database")


def test_a_point_cache_comes_back_and_its_damage_is_seen(tmp_path: Path):
    frames = np.random.default_rng(1).normal(size=(4, 10, 3)).astype(np.float32)
    path = tmp_path / "clip.pc2"
    write_pc2(path, 10, 7, iter(frames), 4)
    cache = PointCache(path)
    assert cache.start == 7
    np.testing.assert_array_equal(cache.frames, frames)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(StorageError, match="truncated"):
        PointCache(path)
    path.write_bytes(b"something else entirely, long enough for a header")
    with pytest.raises(StorageError, match="not a PC2"):
        PointCache(path)


def test_a_point_cache_with_a_missing_frame_is_not_left_behind(tmp_path: Path):
    with pytest.raises(StorageError, match="got 1 frames, not 2"):
        write_pc2(tmp_path / "clip.pc2", 2, 1, iter([np.zeros((2, 3), np.float32)]), 2)
    assert not list(tmp_path.iterdir())
