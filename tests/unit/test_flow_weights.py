"""Weights for a recorded garment: of the nearest body vertex, or fitted to the recording."""

import numpy as np
import pytest
from flow_clips import arm_poses, arm_rig, clip, sleeve, sleeve_weights
from wrinkle_synthesis.wrinkle_addon.flow_weights import fit_weights, nearest_weights
from wrinkle_synthesis.wrinkle_addon.garment import Body, SkinWeights
from wrinkle_synthesis.wrinkle_addon.recordings import Recording


def body(weights: np.ndarray | None = None) -> Body:
    positions = sleeve(30, 16) * [1.0, 0.8, 0.8]
    dense = sleeve_weights(positions).to_dense(3) if weights is None else weights
    return Body(positions, np.array([[0, 1, 16]], np.int32), dense)


def test_every_vertex_takes_the_weights_of_the_nearest_body_vertex():
    rest, worn = sleeve(), body()
    found = nearest_weights(rest, worn).to_dense(3)
    distances = np.linalg.norm(rest[:, None] - worn.positions[None], axis=2)
    # Two body vertices may be equally near: any of them will do.
    for vertex, near in enumerate(distances < distances.min(1, keepdims=True) + 1e-9):
        assert np.abs(worn.weights[near] - found[vertex]).max(1).min() < 1e-6


def test_a_body_that_no_bone_carries_is_refused():
    with pytest.raises(ValueError, match="no deforming bone moves"):
        nearest_weights(sleeve(), body(np.zeros((480, 3))))


def test_a_fit_finds_the_weights_that_a_recording_was_made_with():
    rig, rest = arm_rig(), sleeve(20, 12)
    true, poses = sleeve_weights(rest), arm_poses(arm_rig(), 30)
    frames = np.stack([true.carry(pose.deformations(rig), rest) for pose in poses]).astype(np.float32)
    start = SkinWeights.from_dense(np.tile([0.5, 0.5, 0.0], (len(rest), 1)))
    recording = Recording("skinned", frames, 1.0, np.eye(4))
    found = fit_weights(start, rest, recording, rig, poses, np.tile(np.eye(4), (30, 1, 1))).to_dense(3)
    # What it started from counts a thousandth.
    assert np.abs(found - true.to_dense(3)).max() < 0.02
    assert found.min() >= 0.0
    assert np.allclose(found.sum(1), 1.0, atol=1e-6)


def test_a_fit_brings_skinning_no_farther_from_a_wrinkled_recording():
    source = clip(30, along=20, around=12)

    def error(weights: SkinWeights) -> float:
        total = 0.0
        for number, pose in enumerate(source.poses):
            matrix = source.to_rig[number]
            wanted = source.recording.frames[number] @ matrix[:3, :3].T + matrix[:3, 3]
            total += float(np.square(weights.carry(pose.deformations(source.rig), source.rest) - wanted).sum())
        return total

    fitted = fit_weights(source.weights, source.rest, source.recording, source.rig, source.poses, source.to_rig)
    assert error(fitted) < error(source.weights)
