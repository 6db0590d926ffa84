"""The quaternion algebra against SciPy's."""

import numpy as np
import pytest
from wrinkle_synthesis.wrinkle_addon import rotations

Rotation = pytest.importorskip("scipy.spatial.transform").Rotation


def random_turns(count: int = 200, seed: int = 0) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=(count, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, :1] < 0, -q, q)


def scipy_of(q: np.ndarray):
    return Rotation.from_quat(q[..., [1, 2, 3, 0]])


def test_products_rotations_and_vectors_are_scipys():
    a, b = random_turns(seed=1), random_turns(seed=2)
    vectors = np.random.default_rng(3).normal(size=(200, 3))
    assert np.allclose(scipy_of(rotations.multiply(a, b)).as_matrix(), (scipy_of(a) * scipy_of(b)).as_matrix())
    assert np.allclose(rotations.rotate(a, vectors), scipy_of(a).apply(vectors))
    assert np.allclose(rotations.to_matrices(a), scipy_of(a).as_matrix())
    assert np.allclose(rotations.to_rotvec(a), scipy_of(a).as_rotvec())


def test_conversions_there_and_back_lose_nothing():
    q = random_turns()
    assert np.allclose(rotations.from_matrices(rotations.to_matrices(q)), q, atol=1e-12)
    assert np.allclose(rotations.from_rotvec(rotations.to_rotvec(q)), q, atol=1e-12)
    tiny = np.array([[1e-9, 0, 0], [0, 0, 0]])
    assert np.allclose(rotations.to_rotvec(rotations.from_rotvec(tiny)), tiny, atol=1e-18)


def test_scale_and_shear_are_taken_off_a_matrix():
    q = random_turns(50)
    scaled = rotations.to_matrices(q) * np.random.default_rng(1).uniform(0.01, 100, size=(50, 1, 1))
    assert np.allclose(rotations.from_matrices(scaled), q, atol=1e-9)


def test_a_turn_splits_into_swing_and_twist():
    axis = np.array([0.6, 0.0, 0.8])
    q = random_turns()
    twist = rotations.from_rotvec(rotations.twist_angle(q, axis)[:, None] * axis)
    swing = rotations.multiply(q, rotations.conjugate(twist))
    assert np.abs(swing[:, 1:] @ axis).max() < 1e-12


def test_the_shortest_turn_between_directions_takes_one_to_the_other():
    rng = np.random.default_rng(5)
    for start, end in rng.normal(size=(50, 2, 3)):
        turned = rotations.rotate(rotations.between(start, end), start / np.linalg.norm(start))
        assert np.allclose(turned, end / np.linalg.norm(end))
    assert np.allclose(rotations.rotate(rotations.between([0, 0, 1], [0, 0, -1]), [0, 0, 1.0]), [0, 0, -1])


def test_slerp_is_scipys():
    from scipy.spatial.transform import Slerp

    a, b = random_turns(2, seed=7)
    if a @ b < 0:
        b = -b
    for t in (0.0, 0.3, 1.0):
        expected = Slerp([0, 1], scipy_of(np.stack([a, b])))(t).as_matrix()
        assert np.allclose(rotations.to_matrices(rotations.slerp(a, b, t)), expected)
