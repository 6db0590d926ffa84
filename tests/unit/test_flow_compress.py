"""A flow keeps to the error it promises, in few bytes, whatever goal it was made for."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from flow_clips import clip, recorded
from wrinkle_synthesis.wrinkle_addon import flow_components, flow_residuals
from wrinkle_synthesis.wrinkle_addon.flow import FlowMethod
from wrinkle_synthesis.wrinkle_addon.flow_components import find_components
from wrinkle_synthesis.wrinkle_addon.flow_compress import Compressed, FlowSource, Goal, compress
from wrinkle_synthesis.wrinkle_addon.flow_residuals import Residuals, ResidualSpace, Skinning
from wrinkle_synthesis.wrinkle_addon.pc2 import HEADER
from wrinkle_synthesis.wrinkle_addon.recordings import Recording


def errors_mm(source: FlowSource, made: Compressed) -> tuple[float, float]:
    """Root mean square and largest error of replaying a clip [mm], by NumPy alone from what is played."""
    evaluator = FlowMethod(made.flow).bind("cpu")
    bones = [source.rig.index[name] for name in made.flow.rig.names]
    squares = []
    for number, pose in enumerate(source.poses):
        out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device="cpu")
        evaluator.evaluate(type(pose)(pose.matrices[bones]), out, frame=source.recording.start + number)
        squares.append(((out.numpy() - recorded(source, number)) ** 2).sum(1))
    return 1e3 * float(np.sqrt(np.mean(squares))), 1e3 * float(np.sqrt(np.max(squares)))


@pytest.mark.parametrize("skinning", Skinning)
@pytest.mark.parametrize("space", ResidualSpace)
def test_an_error_bound_is_kept_however_residuals_are_taken(skinning: Skinning, space: ResidualSpace):
    source = clip()
    made = compress(source, Goal(rms_mm=0.1), skinning, space)
    rms, largest = errors_mm(source, made)
    assert rms <= made.header.rms_mm == 0.1
    assert largest <= made.header.max_mm
    # Single precision of positions about 1 m from the origin, twice.
    assert made.rms_mm == pytest.approx(rms, abs=1e-3)


def test_a_bound_of_every_vertex_is_kept():
    source = clip()
    made = compress(source, Goal(max_mm=0.5))
    assert errors_mm(source, made)[1] <= made.header.max_mm == 0.5
    both = compress(source, Goal(rms_mm=0.3, max_mm=0.5))
    rms, largest = errors_mm(source, both)
    assert rms <= 0.3
    assert largest <= 0.5


def test_a_tighter_bound_takes_more_bytes_and_a_looser_one_fewer_than_a_point_cache():
    source = clip()
    sizes = [compress(source, Goal(rms_mm=error)).code.size for error in (0.05, 0.2, 0.8)]
    assert sizes[0] > sizes[1] > sizes[2]
    # The clip is too short for more: rest shape and weights alone take a kilobyte.
    assert 20 * sizes[1] < HEADER.size + source.recording.frames.nbytes


def test_a_number_of_components_is_the_number_of_components():
    made = compress(clip(), Goal(components=3))
    assert made.flow.component_count == 3
    assert made.rms_mm < compress(clip(), Goal(components=2)).rms_mm < made.skinning_mm


def test_a_size_is_not_gone_beyond_and_more_of_it_is_better():
    small, large = (compress(clip(), Goal(size=size)) for size in (9_000, 12_000))
    assert small.code.size <= 9_000
    assert large.code.size <= 12_000
    assert large.rms_mm < small.rms_mm
    with pytest.raises(ValueError, match="bytes do not even hold"):
        compress(clip(), Goal(size=1_000))


def test_residuals_seen_from_the_bones_need_fewer_components_where_wrinkles_ride_on_them():
    source = clip()
    needed = {}
    for space in ResidualSpace:
        residuals = Residuals(
            source.recording, source.rig, source.poses, source.to_rig, source.rest, source.weights, space=space
        )
        needed[space] = find_components(residuals, 30, 1e-10).count
    assert needed[ResidualSpace.BONES] < needed[ResidualSpace.POSED]


def test_random_mixtures_find_the_components_of_the_whole(monkeypatch: pytest.MonkeyPatch):
    source = clip(frame_count=90, along=12, around=8)
    residuals = Residuals(source.recording, source.rig, source.poses, source.to_rig, source.rest, source.weights)
    exact = find_components(residuals, 6)
    monkeypatch.setattr(flow_components, "EXACT_FRAMES", 10)
    sketched = find_components(residuals, 6)
    # Two power passes leave the strongest directions off by the fourth power of what follows them.
    assert np.allclose(sketched.energies, exact.energies, rtol=1e-3)
    assert sketched.total == pytest.approx(exact.total)
    monkeypatch.setattr(flow_components, "FIRST_WIDTH", 11)
    grown = find_components(residuals, 60, 1e-10)
    assert grown.lost(grown.count) <= 1.01e-10


def test_the_recording_is_never_held_whole(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(flow_residuals, "STRETCH_VALUES", 2_000)
    source = clip()
    residuals = Residuals(source.recording, source.rig, source.poses, source.to_rig, source.rest, source.weights)
    parts = [(part, block.shape) for part, block in residuals.stretches()]
    assert max(shape[1] for _, shape in parts) <= 50
    assert sum(shape[1] for _, shape in parts) == len(source.rest)


def test_bones_that_carry_nothing_are_left_out():
    assert compress(clip(), Goal(components=2)).flow.rig.names == ("upper", "lower")


def test_a_recording_that_is_skinning_alone_takes_next_to_nothing():
    source = clip()
    still = source.recording.frames.copy()
    for number, pose in enumerate(source.poses):
        skinned = source.weights.carry(pose.deformations(source.rig), source.rest)
        matrix = np.linalg.inv(source.to_rig[number])
        still[number] = skinned @ matrix[:3, :3].T + matrix[:3, 3]
    made = compress(replace(source, recording=replace(source.recording, frames=still)), Goal(rms_mm=0.2))
    assert made.rms_mm <= 0.2
    assert made.code.size < 6_000


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"frame_count": 1}, "has one frame"),
        ({"frame_count": 4}, "components of 4 frames"),
    ],
)
def test_too_few_frames_are_refused(change: dict[str, int], sentence: str):
    with pytest.raises(ValueError, match=sentence):
        compress(clip(**change), Goal(components=5) if change["frame_count"] > 1 else Goal(rms_mm=1.0))


def test_a_garment_that_leaves_its_body_is_said_and_kept():
    source = clip()
    assert compress(source, Goal(rms_mm=0.5)).note == ""
    frames = source.recording.frames.copy()
    # Thrown off, 2 m away in the object's own units, of half a metre each.
    frames[30:] += 2.0
    recording = replace(source.recording, frames=frames)
    made = compress(replace(source, recording=recording), Goal(rms_mm=0.5))
    assert "10 of 40 frames, first in frame 35, the garment is off its body" in made.note
    assert made.rms_mm <= 0.5


def test_frames_that_are_no_numbers_are_named():
    source = clip()
    source.recording.frames[7, 3, 1] = np.nan
    with pytest.raises(ValueError, match="Frame 12 of 'sleeve' has positions that are not numbers"):
        compress(source, Goal(rms_mm=0.1))


def test_a_recording_of_another_mesh_is_refused():
    source = clip()
    other = Recording("other", source.recording.frames[:, :-1], 5.0, np.eye(4))
    with pytest.raises(ValueError, match="959 vertices a frame, the garment 960"):
        compress(replace(source, recording=other), Goal(rms_mm=0.1))


def test_goals_that_say_nothing_or_too_much_are_refused():
    for goal in ({}, {"rms_mm": 1.0, "components": 3}, {"size": 5, "max_mm": 1.0}, {"rms_mm": 0.0}):
        with pytest.raises(ValueError):
            Goal(**goal)
