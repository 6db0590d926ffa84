"""What each joint changes: the measure against its definition, what it ignores, and the weights made of it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from baked_dolls import baked, bump
from dolls import Doll, doll, grid_of
from wrinkle_synthesis.wrinkle_addon import method
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase, sample_frame
from wrinkle_synthesis.wrinkle_addon.detail_transfer import cotangent_weights
from wrinkle_synthesis.wrinkle_addon.influence import (
    influence_by_region,
    influence_colours,
    influence_shares,
    influence_windows,
    inside_of_bend,
    joint_names,
    measure_influence,
    scaled_influence,
    smoothed_influence,
)
from wrinkle_synthesis.wrinkle_addon.plan import SamplePlan

GRID = {"elbow_L": ([-30, 0, 45, 90],), "shoulder_L": ([0, 40], [0, 30, 60], [0]), "elbow_R": ([0],)}


@pytest.fixture(scope="module")
def character() -> Doll:
    return doll()


@pytest.fixture(scope="module")
def wrinkled(character: Doll, tmp_path_factory: pytest.TempPathFactory) -> WrinkleDatabase:
    """Bumps around the left elbow and shoulder; the right elbow has no sample but rest."""
    plan = SamplePlan(tuple(grid_of(character.joint(name), *degrees) for name, degrees in GRID.items()))
    bumps = {name: bump(character, name) for name in ("elbow_L", "shoulder_L")}
    return baked(tmp_path_factory.mktemp("wrinkled"), character, plan, bumps)


def offsets_of(database: WrinkleDatabase, joint: str) -> np.ndarray:
    """Offsets of all samples and of rest, shape [sample_count, vertex_count, 3]."""
    shapes = [np.zeros_like(database.rest)]
    for sample, stored in database.samples():
        if sample.joint == joint:
            shapes.append(np.zeros_like(database.rest))
            shapes[-1][stored.vertices] = stored.offsets
    return np.stack(shapes)


def measured(database: WrinkleDatabase, device: str = "cpu") -> dict[str, np.ndarray]:
    return measure_influence(database.header, database.rest, dict(database.samples()), device)


def laplacian(database: WrinkleDatabase, values: np.ndarray) -> np.ndarray:
    start, neighbours, weights = cotangent_weights(database.rest, database.header.garment.faces)
    return values - np.add.reduceat(weights[:, None] * values[neighbours], start[:-1], axis=0)


def test_influence_is_the_mean_length_of_the_laplacian_of_the_offsets_between_all_pairs(
    wrinkled: WrinkleDatabase, device: str
):
    """W70, pair by pair in float64: the Laplacian of each pair's own offset."""
    found = measured(wrinkled, device)
    for joint in ("elbow_L", "shoulder_L"):
        pairs = list(itertools.combinations(offsets_of(wrinkled, joint), 2))
        expected = sum(np.linalg.norm(laplacian(wrinkled, b - a), axis=1) for a, b in pairs) / len(pairs)
        # Single precision of lengths up to a centimetre.
        np.testing.assert_allclose(found[joint], expected, atol=1e-7)
        assert expected.max() > 1e-4
    assert (found["elbow_R"] == 0.0).all()


def test_influence_is_the_same_to_the_bit_however_many_threads_measure_it(
    wrinkled: WrinkleDatabase, monkeypatch: pytest.MonkeyPatch
):
    once = measured(wrinkled)
    monkeypatch.setattr(method, "LEAST_SPLIT", 100)
    monkeypatch.setattr(method, "THREADS", 3)
    for joint, values in measured(wrinkled).items():
        np.testing.assert_array_equal(values, once[joint])


def test_a_limb_that_only_turns_has_no_influence_though_in_its_poses_it_would(
    character: Doll, tmp_path_factory: pytest.TempPathFactory
):
    """Why samples are compared un-posed: the Laplacian takes away what is dragged along, but not what turns."""
    plan = SamplePlan((grid_of(character.joint("elbow_L"), *GRID["elbow_L"]),))
    database = baked(tmp_path_factory.mktemp("skin"), character, plan)
    # Offsets below 0.1 mm are not stored; of skinning, none is.
    assert measured(database)["elbow_L"].max() == 0.0
    posed = [laplacian(database, database.rest)]
    posed += [laplacian(database, sample_frame(database.header, database.rest, sample)[0]) for sample in plan.samples]
    far = np.flatnonzero(database.header.regions.vertex_segment == database.header.regions.joints["elbow_L"][1])
    seeming = np.mean([np.linalg.norm(b - a, axis=1) for a, b in itertools.combinations(posed, 2)], axis=0)
    assert np.median(seeming[far]) > 1e-4


def test_a_joint_acts_most_where_it_is(wrinkled: WrinkleDatabase, character: Doll):
    found = measured(wrinkled)
    regions = influence_by_region(found["elbow_L"], wrinkled.header.regions)
    assert regions["elbow_L"] > 10 * regions["elbow_R"]
    place = wrinkled.rest[found["elbow_L"].argmax()]
    assert np.linalg.norm(place - character.joint("elbow_L").pivot(character.rig)) < 0.2


def test_the_inside_of_a_bend_is_told_from_the_outside(wrinkled: WrinkleDatabase, character: Doll):
    joint, rig, rest = character.joint("elbow_L"), character.rig, wrinkled.rest
    forearm = rig.tails[rig.index[joint.far]] - joint.pivot(rig)
    # Where the forearm goes by a small positive angle.
    inward = character.joint("elbow_L").turn([0.01])
    moved = np.cross(2.0 * inward[1:], forearm)
    inside = ((rest - joint.pivot(rig)) @ moved > 0.0).astype(float)
    assert inside_of_bend(1.0 + inside, joint, rig, rest) == pytest.approx(2.0)
    assert inside_of_bend(np.zeros(len(rest)), joint, rig, rest) is None
    assert inside_of_bend(1.0 + inside, character.joint("shoulder_L"), rig, rest) is None


def test_smoothing_keeps_an_even_map_and_takes_wrinkles_out_of_an_uneven_one(wrinkled: WrinkleDatabase):
    faces = wrinkled.header.garment.faces
    noise = np.random.default_rng(1).random(len(wrinkled.rest))
    smooth = smoothed_influence({"even": np.full(len(noise), 0.3), "uneven": noise}, wrinkled.rest, faces)
    # Weights of the operator are single precision.
    np.testing.assert_allclose(smooth["even"], 0.3, rtol=1e-4)
    jumps = [np.abs(values[faces[:, 0]] - values[faces[:, 1]]).mean() for values in (noise, smooth["uneven"])]
    assert jumps[1] < 0.3 * jumps[0]
    assert smooth["uneven"].mean() == pytest.approx(noise.mean(), rel=0.05)


def test_shares_add_up_to_one_and_windows_are_one_for_the_strongest():
    influence = {"a": np.array([3.0, 0.0, 0.0]), "b": np.array([1.0, 2.0, 0.0])}
    shares, windows = influence_shares(influence), influence_windows(influence)
    np.testing.assert_allclose(shares["a"], [0.75, 0.0, 0.0])
    np.testing.assert_allclose(shares["b"], [0.25, 1.0, 0.0])
    np.testing.assert_allclose(windows["a"], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(windows["b"], [np.sqrt(1 / 3), 1.0, 0.0])


def test_colours_go_from_dark_blue_to_red_and_one_stray_vertex_does_not_darken_the_rest():
    values = np.linspace(0.0, 1.0, 1000)
    values[0] = 100.0
    scaled = scaled_influence(values)
    assert scaled[-20] > 0.95 and scaled.max() == 1.0
    assert (scaled_influence(np.zeros(5)) == 0.0).all()
    colours = influence_colours(np.array([0.0, 1.0]))
    assert colours.dtype == np.float32 and (colours[:, 3] == 1.0).all()
    assert colours[0, 2] > colours[0, 0] and colours[1, 0] > colours[1, 2]


def test_a_joint_without_samples_is_refused_by_name(wrinkled: WrinkleDatabase):
    assert joint_names(wrinkled.header) == list(GRID)
    assert joint_names(wrinkled.header, ["elbow_L"]) == ["elbow_L"]
    with pytest.raises(ValueError, match="no samples of a joint 'knee_L'; it has elbow_L, shoulder_L, elbow_R"):
        joint_names(wrinkled.header, ["knee_L"])
