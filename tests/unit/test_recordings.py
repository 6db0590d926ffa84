"""Recordings of every kind are read as what they hold, and refused in one sentence where they cannot be."""

from pathlib import Path

import numpy as np
import pytest
from flow_clips import write_mdd
from wrinkle_synthesis.wrinkle_addon.pc2 import write_pc2
from wrinkle_synthesis.wrinkle_addon.recordings import gather, open_recording

FRAMES = np.random.default_rng(4).standard_normal((6, 8, 3)).astype(np.float32)


def write_objs(folder: Path, faces: str = "f 1/1/1 2/2/2 3/3/3") -> None:
    for number, frame in enumerate(FRAMES, 7):
        lines = ["# a mesh", *(f"v {x} {y} {z}" for x, y, z in frame.tolist()), "vt 0 0", faces]
        (folder / f"take2_{number:04}.obj").write_text("\n".join(lines))


def test_point_caches_hold_what_was_written(tmp_path: Path):
    write_pc2(tmp_path / "a.pc2", 8, 3.0, iter(FRAMES), 6)
    write_mdd(tmp_path / "a.mdd", FRAMES)
    pc2, mdd = open_recording(tmp_path / "a.pc2"), open_recording(tmp_path / "a.mdd", start=9.0)
    assert pc2.start == 3.0
    assert mdd.start == 9.0
    for found in (pc2, mdd):
        assert (found.frame_count, found.vertex_count) == (6, 8)
        assert np.array_equal(found.frames, FRAMES)


def test_numbered_files_are_read_in_the_order_of_their_numbers(tmp_path: Path):
    for number, frame in enumerate(FRAMES, 8):
        np.save(tmp_path / f"f{number}.npy", frame)
    assert np.array_equal(open_recording(tmp_path).frames, FRAMES)


def test_obj_files_have_y_up(tmp_path: Path):
    write_objs(tmp_path)
    found = open_recording(tmp_path)
    # Decimals of single precision numbers read back as the same numbers.
    assert np.array_equal(found.frames, FRAMES)
    assert np.allclose(found.to_object[:3, :3] @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


def test_obj_files_may_number_their_normals_anew_but_not_their_faces(tmp_path: Path):
    write_objs(tmp_path)
    path = tmp_path / "take2_0009.obj"
    text = path.read_text()
    path.write_text(text.replace("1/1/1", "1/1/4"))
    open_recording(tmp_path)
    path.write_text(text.replace("f 1/1/1", "f 4/1/1"))
    with pytest.raises(ValueError, match="one topology"):
        open_recording(tmp_path)


def test_a_changing_number_of_vertices_is_refused():
    with pytest.raises(ValueError, match="8 vertices at first and 7 in sample 2"):
        list(gather([FRAMES[0], FRAMES[1, :7]], 2, "a"))


def test_what_is_missing_truncated_or_something_else_is_refused(tmp_path: Path):
    write_pc2(tmp_path / "a.pc2", 8, 3.0, iter(FRAMES), 6)
    (tmp_path / "short.pc2").write_bytes((tmp_path / "a.pc2").read_bytes()[:-5])
    write_mdd(tmp_path / "a.mdd", FRAMES)
    (tmp_path / "short.mdd").write_bytes((tmp_path / "a.mdd").read_bytes()[:-5])
    (tmp_path / "no.mdd").write_bytes(b"abc")
    (tmp_path / "other.txt").write_text("hello")
    (tmp_path / "empty").mkdir()
    gap = tmp_path / "gap"
    gap.mkdir()
    for number in (1, 3):
        np.save(gap / f"{number}.npy", FRAMES[0])
    for name, sentence in {
        "short.pc2": "truncated",
        "short.mdd": "truncated",
        "no.mdd": "is not an MDD",
        "other.txt": "no recording that can be read",
        "missing.abc": "There is no recording",
        "empty": "holds no numbered",
        "gap": "has no file number 2",
    }.items():
        with pytest.raises(ValueError, match=sentence):
            open_recording(tmp_path / name)
