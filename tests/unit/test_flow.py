"""Replaying: between frames, at another time and speed, at any strength, anywhere; and the file, hostile ones too."""

import json
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from flow_clips import clip
from wrinkle_synthesis.wrinkle_addon import rotations, storage
from wrinkle_synthesis.wrinkle_addon.flow import Ends, FlowMethod, Timing
from wrinkle_synthesis.wrinkle_addon.flow_compress import Compressed, Goal, compress
from wrinkle_synthesis.wrinkle_addon.flow_file import read_flow, write_flow
from wrinkle_synthesis.wrinkle_addon.flow_residuals import ResidualSpace, Skinning
from wrinkle_synthesis.wrinkle_addon.rig import FloatArray, Pose, pose_between

SOURCE = clip()
ROUNDING = 2.0e-6
"""Single precision of positions within 2 m of the origin, summed over a few terms [m]."""


@pytest.fixture(scope="module")
def made() -> Compressed:
    return compress(SOURCE, Goal(rms_mm=0.1))


def pose(number: int) -> Pose:
    return Pose(SOURCE.poses[number].matrices[:2])


def replay(made: Compressed, frame: float, at: Pose, strength: float = 1.0, **options) -> FloatArray:
    evaluator = FlowMethod(made.flow, options.pop("timing", None)).bind(options.pop("device", "cpu"))
    out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device=evaluator.device)
    evaluator.evaluate(at, out, strength, frame=frame, **options)
    return out.numpy().astype(np.float64)


def expected(made: Compressed, place: float, at: Pose, strength: float = 1.0) -> FloatArray:
    """F06 in double precision."""
    flow = made.flow
    below = min(int(place), flow.frame_count - 2)
    z = flow.coefficients[below : below + 2].astype(np.float64)
    residual = np.einsum("k,kvi->vi", z[0] + (place - below) * (z[1] - z[0]), flow.shapes.astype(np.float64))
    if flow.header.space is ResidualSpace.BONES:
        residual = rotations.rotate(flow.weights.turn(at.turns(flow.rig)), residual)
    return flow.weights.carry(at.deformations(flow.rig), flow.rest) + strength * residual


@pytest.mark.parametrize("space", ResidualSpace)
@pytest.mark.parametrize("device", [str(device) for device in wp.get_devices()])
def test_a_frame_is_skinning_plus_components(space: ResidualSpace, device: str):
    made = compress(SOURCE, Goal(components=6), space=space)
    for place, strength in ((0.0, 1.0), (17.0, 1.0), (17.4, 1.0), (39.0, 1.0), (30.0, 0.0), (30.0, 1.5)):
        at = pose(int(place))
        found = replay(made, 5.0 + place, at, strength, device=device)
        assert np.abs(found - expected(made, place, at, strength)).max() < ROUNDING


def test_dual_quaternions_turn_rigidly_where_one_bone_carries_and_keep_the_girth_of_a_twist():
    made = compress(SOURCE, Goal(components=2), Skinning.DUAL_QUATERNION)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    turns[1] = rotations.from_rotvec([2.5, 0.0, 0.0])
    deformations = np.tile(np.eye(4), (2, 1, 1))
    deformations[1, :3, :3] = rotations.to_matrices(turns[1])
    twisted = Pose(deformations @ made.flow.rig.rest)
    found = replay(made, 5.0, twisted, 0.0)
    rest = made.flow.rest
    single = made.flow.weights.weights[:, 0] == 1.0
    carried = made.flow.weights.carry(deformations, rest)
    assert np.abs(found - carried)[single].max() < ROUNDING
    # Linear blending would lose three quarters of it in the middle of a twist this far.
    girth = np.linalg.norm(found[:, 1:], axis=1)
    assert np.abs(girth - np.linalg.norm(rest[:, 1:], axis=1)).max() < ROUNDING
    assert np.linalg.norm(carried[:, 1:], axis=1).min() < 0.5 * girth.min()


def test_subframes_lie_between_frames(made: Compressed):
    at = pose_between(made.flow.rig, pose(10), pose(11), 0.5)
    between = replay(made, 15.5, at)
    assert np.abs(between - 0.5 * (replay(made, 15.0, at) + replay(made, 16.0, at))).max() < ROUNDING


def test_a_frame_is_the_same_from_any_frame_before(made: Compressed):
    evaluator = FlowMethod(made.flow).bind("cpu")
    outs = []
    for order in ((5.0, 30.0, 12.0), (44.0, 12.0)):
        out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device="cpu")
        for frame in order:
            evaluator.evaluate(pose(7), out, frame=frame)
        outs.append(out.numpy())
    assert np.array_equal(*outs)


def test_a_placement_is_put_on_last(made: Compressed):
    placement = np.eye(4)
    placement[:3] = [[0.0, -2.0, 0.0, 1.0], [2.0, 0.0, 0.0, 0.5], [0.0, 0.0, 2.0, 0.0]]
    plain = replay(made, 12.0, pose(7))
    assert (
        np.abs(replay(made, 12.0, pose(7), placement=placement) - plain @ placement[:3, :3].T - placement[:3, 3]).max()
        < 4 * ROUNDING
    )


@pytest.mark.parametrize(
    ("timing", "frame", "place", "outside"),
    [
        (Timing(), 5.0, 0.0, 0.0),
        (Timing(), 7.25, 2.25, 0.0),
        (Timing(), 3.0, 0.0, 2.0),
        (Timing(), 20.0, 9.0, 6.0),
        (Timing(offset=10.0), 16.0, 1.0, 0.0),
        (Timing(speed=0.5), 9.0, 2.0, 0.0),
        (Timing(speed=2.0), 9.0, 8.0, 0.0),
        (Timing(speed=-1.0), 5.0, 9.0, 0.0),
        (Timing(speed=-1.0), 8.0, 6.0, 0.0),
        (Timing(speed=0.0), 800.0, 0.0, 0.0),
        (Timing(ends=Ends.LOOP), 14.0, 9.0, 0.0),
        (Timing(ends=Ends.LOOP), 15.0, 1.0, 0.0),
        (Timing(ends=Ends.LOOP), 4.0, 8.0, 0.0),
    ],
)
def test_time_can_be_shifted_stretched_turned_around_held_and_repeated(
    timing: Timing, frame: float, place: float, outside: float
):
    assert timing.sample(frame, 5.0, 10) == pytest.approx((place, outside))


def test_frames_outside_the_recording_hold_its_ends_and_say_so(made: Compressed):
    evaluator = FlowMethod(made.flow).bind("cpu")
    out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device="cpu")
    evaluator.evaluate(pose(3), out, frame=80.0)
    assert evaluator.outside == 80.0 - 44.0
    assert np.array_equal(out.numpy(), replay(made, 44.0, pose(3)).astype(np.float32))


# --- the file -----------------------------------------------------------------------------------------------------


def test_a_file_gives_back_what_was_written_and_has_one_form(made: Compressed, tmp_path: Path):
    size = write_flow(tmp_path / "a.flow", made.header, made.rig, made.code)
    again = write_flow(tmp_path / "b.flow", made.header, made.rig, made.code)
    flow = read_flow(tmp_path / "a.flow")
    assert size == again == flow.stored_bytes
    assert (tmp_path / "a.flow").read_bytes() == (tmp_path / "b.flow").read_bytes()
    assert flow.header == made.header
    assert flow.rig.names == made.rig.names
    for name in ("rest", "shapes", "coefficients"):
        assert np.array_equal(getattr(flow, name), getattr(made.flow, name))
    assert np.array_equal(flow.weights.weights, made.flow.weights.weights)


def test_truncated_changed_and_other_files_are_refused_in_one_sentence(made: Compressed, tmp_path: Path):
    path = tmp_path / "a.flow"
    write_flow(path, made.header, made.rig, made.code)
    data = path.read_bytes()
    for cut in (0, 4, 100, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:cut])
        with pytest.raises(storage.StorageError, match="damaged"):
            read_flow(path)
    random = np.random.default_rng(5)
    for place in random.integers(0, len(data), 40):
        changed = bytearray(data)
        changed[place] ^= 1 << int(random.integers(8))
        path.write_bytes(changed)
        with pytest.raises(storage.StorageError):
            read_flow(path)
    storage.write_arrays(path, {"a": np.zeros(3)}, {"format": 1})
    with pytest.raises(storage.StorageError, match="is no wrinkle flow"):
        read_flow(path)
    with pytest.raises(storage.StorageError, match="There is no file"):
        read_flow(tmp_path / "missing.flow")


@pytest.mark.parametrize(
    "lie",
    [
        {"vertices": 0},
        {"vertices": 959},
        {"vertices": 4_000_000},
        {"vertices": -1},
        {"vertices": "many"},
        {"frames": 10**9},
        {"components": 19_999},
        {"bones": ["upper"]},
        {"bones": 7},
        {"bones": ["upper", "upper"]},
        {"shape_step": 0.0},
        {"shape_step": "small"},
        {"start": None},
        {"skinning": "magic"},
        {"space": []},
        {"about": 3},
    ],
)
def test_a_file_that_lies_about_itself_is_refused(made: Compressed, tmp_path: Path, lie: dict):
    from wrinkle_synthesis.wrinkle_addon import flow_file

    path = tmp_path / "a.flow"
    write_flow(path, made.header, made.rig, made.code)
    arrays, metadata = storage.read_arrays(path)
    metadata = json.loads(json.dumps(metadata)) | lie
    del metadata["hash"]
    metadata["hash"] = flow_file._hash(arrays, metadata)
    storage.write_arrays(path, arrays, metadata)
    with pytest.raises(storage.StorageError, match="holds no flow that can be replayed"):
        read_flow(path)


def test_another_version_is_said_to_be_one(made: Compressed, tmp_path: Path):
    path = tmp_path / "a.flow"
    write_flow(path, made.header, made.rig, made.code)
    arrays, metadata = storage.read_arrays(path)
    storage.write_arrays(path, arrays, metadata | {"format": 99})
    with pytest.raises(storage.StorageError, match="format 99, this version reads 2"):
        read_flow(path)
