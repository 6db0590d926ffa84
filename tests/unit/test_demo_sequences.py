"""The first paper's five sequences: their authored motions, their table, and, taking minutes, one of them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wrinkle_synthesis.demo import packages
from wrinkle_synthesis.demo.figures import FULL, SKINNING
from wrinkle_synthesis.demo.garment import GARMENTS
from wrinkle_synthesis.demo.keyframes import FRAMES_PER_SECOND, MOTIONS, find_clip, keyframed
from wrinkle_synthesis.demo.motion import CLIPS, part, to_rig
from wrinkle_synthesis.demo.outfit import COARSE, WHOLE
from wrinkle_synthesis.demo.sequences import SEQUENCES, SequenceDemo, main, run_sequence, tabulate
from wrinkle_synthesis.wrinkle_addon.evaluate import OURS

HEAD_HEIGHT = 1.6
"""Of the clips' skeleton as it stands [m]."""


def bone_ends(name: str, bone: str) -> np.ndarray:
    """Where a bone ends in every frame [m], facing +z with y up and the left along +x, shape [frame_count, 3]."""
    rig, poses = to_rig(keyframed(name))
    number = rig.index[bone]
    return np.array(
        [pose.matrices[number, :3, 3] + rig.lengths[number] * pose.matrices[number, :3, 1] for pose in poses]
    )


# --- authored motions ---------------------------------------------------------------------------------------------


def test_stretching_reaches_up_with_both_hands_and_bends_aside() -> None:
    left, right, neck = (bone_ends("stretch", bone) for bone in ("LeftForeArm", "RightForeArm", "Spine"))
    assert (left[0, 1], right[0, 1]) < (1.0, 1.0)
    assert min(left[:, 1].max(), right[:, 1].max()) > HEAD_HEIGHT
    assert np.ptp(neck[:, 0]) > 0.1


def test_pointing_goes_from_ahead_to_aside_at_the_height_of_the_shoulder() -> None:
    hand, shoulder = bone_ends("point", "RightForeArm"), bone_ends("point", "Spine")
    keys = [round(time * FRAMES_PER_SECOND) for time in MOTIONS["point"]]
    ahead, aside = (hand[frame] - shoulder[frame] for frame in (keys[1], keys[3]))
    assert ahead[2] > 0.4 and aside[0] < -0.4
    # The shoulder lies a few centimetres beside the end of the spine.
    assert abs(ahead[1]) < 0.15 and abs(aside[1]) < 0.15


@pytest.mark.parametrize("name", MOTIONS)
def test_authored_motions_begin_and_end_at_rest_and_never_jerk(name: str) -> None:
    hand = bone_ends(name, "RightForeArm")
    speed = FRAMES_PER_SECOND * np.linalg.norm(np.diff(hand, axis=0), axis=1)
    # Leaving rest by a cubic takes a sixth of the greatest speed in the first of a dozen frames.
    assert max(speed[0], speed[-1]) < 0.2 * speed.max()
    # A person's hand moves at some metres a second, and from frame to frame at much the same speed.
    assert speed.max() < 6.0 and np.abs(np.diff(speed)).max() < 0.3 * speed.max()


def test_a_clip_is_found_by_its_name_and_a_part_of_it_begins_at_zero() -> None:
    clip = part(find_clip("point"), 11, 20)
    np.testing.assert_allclose(clip.times, np.arange(10) / FRAMES_PER_SECOND, atol=1e-12)
    np.testing.assert_array_equal(clip.turns, keyframed("point").turns[10:20])
    assert len(part(keyframed("point"), 1, 0).times) == len(keyframed("point").times)


# --- the table ----------------------------------------------------------------------------------------------------


def test_the_sequences_are_the_papers() -> None:
    men = {name for name, recipe in SEQUENCES.items() if recipe.sex == "male"}
    assert men == {"stretching", "kicking", "running"} and set(SEQUENCES) - men == {"dancing", "pointing"}
    for name, recipe in SEQUENCES.items():
        assert recipe.garments == (("shirt", "trousers") if name in men else ("tshirt", "cropped"))
        assert recipe.clip in (*CLIPS, *MOTIONS) and set(recipe.garments) <= set(GARMENTS) and recipe.coarse > 0


@pytest.mark.parametrize("name", SEQUENCES)
def test_a_sequence_expects_a_time_of_every_stage(tmp_path: Path, name: str) -> None:
    assert list(SequenceDemo(tmp_path, SEQUENCES[name]).stages) == list(SEQUENCES[name].expected)


def test_the_table_tells_what_was_measured() -> None:
    garment: dict[str, Any] = {
        "vertices": 3_500,
        "rmse_mm": {SKINNING: 30.0, COARSE: 14.0, OURS: 12.0, FULL: 0.0},
        "curvature": {COARSE: {"ratio": 0.6}, OURS: {"ratio": 0.9, "correlation": 0.85}},
        "inside": {OURS: 0.002, FULL: 0.0},
        "inside_overlap": {OURS: 0.0015, FULL: 0.0},
        "passing": {COARSE: 0.0, OURS: 2.0, FULL: 1.0},
    }
    whole = {**garment, "vertices": 7_000, "between": {COARSE: 0.0, OURS: 5.0, FULL: 3.0}}
    report = {"databases": {"tshirt": {"samples": 49}}, "measured": {"tshirt": garment, WHOLE: whole}}
    shared = "30.0 mm | 14.0 mm | 12.0 mm | 0.90 (0.60) | 0.85 | 0.20 (0.15) %"
    assert tabulate({"dancing": report}).splitlines()[2:] == [
        f"| dancing | tshirt | 3,500 | 49 | {shared} | 2 (1) |",
        # Of the whole, pairs of two garments.
        f"| dancing | outfit | 7,000 |  | {shared} | 5 (3) |",
    ]


def test_an_unknown_sequence_is_refused_with_those_there_are(tmp_path: Path, capsys: Any) -> None:
    assert main(["moonwalking", "--out", str(tmp_path)]) == 2
    assert "no 'moonwalking'" in capsys.readouterr().err and not list(tmp_path.iterdir())


# --- the whole ----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_small_sequence_is_made_and_not_made_again(tmp_path: Path) -> None:
    pytest.importorskip("bpy")
    try:
        packages.package_folder(packages.BODY)
    except packages.PackageError as error:
        pytest.skip(str(error))
    small = replace(
        SEQUENCES["pointing"],
        vertex_count=1_200, coarse=200, samples=3, played=(1, 4), rows=1, picture_size=(90, 100), picture_rays=1,
    )  # fmt: skip
    made = run_sequence("pointing", tmp_path, recipe=small)
    folder = tmp_path / "pointing"
    assert json.loads((folder / "sequence.json").read_text(encoding="utf-8"))["measured"] == made["measured"]
    assert list(made["measured"]) == list(made["databases"]) + [WHOLE] == ["tshirt", "cropped", WHOLE]
    assert made["coarse"]["garments"] == ["cropped", "tshirt"] and made["coarse"]["frames"] == 4
    assert [frame["frame"] for frame in made["measured"][WHOLE]["frames"]] == [1, 2, 3, 4]
    errors = made["measured"][WHOLE]["rmse_mm"]
    # Two hundred coarse vertices and three samples promise no more than the right garment in the right place.
    assert errors[FULL] == 0.0 < errors[OURS] < 1.5 * errors[SKINNING]
    assert (folder / "side_by_side.png").stat().st_size > 0
    before = {path: path.stat().st_mtime_ns for path in folder.glob("*.pc2")}
    assert len(before) == 4 and run_sequence("pointing", tmp_path, recipe=small)["measured"] == made["measured"]
    assert {path: path.stat().st_mtime_ns for path in folder.glob("*.pc2")} == before
