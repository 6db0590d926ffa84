"""The sample plan: grids, order, symmetry, shards."""

import numpy as np
import pytest
from dolls import doll, grid_of
from skeletons import human
from wrinkle_synthesis.wrinkle_addon.joints import find_joints, with_ranges
from wrinkle_synthesis.wrinkle_addon.plan import (
    Sample,
    SamplePlan,
    budget_plan,
    counted_angles,
    paper_plan,
    spaced_angles,
)
from wrinkle_synthesis.wrinkle_addon.symmetry import find_mirror


def symmetric_plan(budget: int = 60) -> SamplePlan:
    character = doll()
    mirror = find_mirror(character.rig, character.joints, character.garment, character.body)
    assert mirror is not None
    return budget_plan(character.joints, budget, mirror)


def test_spaced_angles_hold_zero_and_both_ends_and_keep_the_step():
    for low, high in ((-0.8, 1.8), (0.0, 2.5), (-1.0, 0.0)):
        angles = np.array(spaced_angles(low, high, np.radians(15)))
        assert 0.0 in angles and np.isclose(angles[0], low) and np.isclose(angles[-1], high)
        # Gaps may exceed the step by a tenth of it rather than cost another sample.
        assert np.diff(angles).max() <= np.radians(15) * 1.1


def test_counted_angles_share_the_count_by_the_extent():
    assert np.allclose(counted_angles(-1.0, 1.0, 3), [-1, 0, 1])
    assert np.allclose(counted_angles(-1.0, 3.0, 5), [-1, 0, 1, 2, 3])
    assert len(counted_angles(0.0, 1.0, 3)) == 3 and counted_angles(0.0, 1.0, 3)[0] == 0.0
    assert len(counted_angles(-1.0, 0.0, 4)) == 4 and counted_angles(-1.0, 0.0, 4)[-1] == 0.0


def test_the_papers_plan_has_about_as_many_samples_as_the_paper():
    """W15-W18: 325 for the upper body and 202 for the lower; spine 3 x 3 x 5."""
    joints = find_joints(human()).joints
    upper = [joint for name, joint in joints.items() if joint and name.split("_")[0] in ("elbow", "shoulder", "spine")]
    lower = [joint for name, joint in joints.items() if joint and name.split("_")[0] in ("knee", "hip")]
    plan = paper_plan(upper)
    assert plan.grid["spine"].shape == (3, 3, 5)
    # The paper does not print its ranges (X03); a fifth more or less is the same order of work.
    assert 325 * 0.8 < len(plan.samples) + 1 < 325 * 1.2
    assert 202 * 0.8 < len(paper_plan(lower).samples) + 1 < 202 * 1.2


def test_a_sample_comes_after_its_parent_which_is_a_neighbour_nearer_to_rest():
    plan = paper_plan(doll().joints)
    seen = set()
    for sample in plan.samples:
        parent = plan.parent(sample)
        if parent is None:
            assert np.count_nonzero(plan.angles(sample)) == 1
        else:
            assert parent in seen
            steps = np.abs(np.subtract(sample.index, parent.index))
            assert steps.sum() == 1
            assert np.abs(plan.angles(parent)).sum() < np.abs(plan.angles(sample)).sum()
        seen.add(sample)
    assert len(seen) == len(plan.samples)


def test_what_is_left_out_is_passed_over_on_the_way_from_rest_and_takes_the_nearest_others_wrinkles():
    shoulder = doll().joint("shoulder_L")
    grid = grid_of(shoulder, [0, 40], [-30, 0, 30], [-30, 0, 20, 60])

    def sample(*index: int) -> Sample:
        return Sample("shoulder_L", index)

    plan = SamplePlan((grid,), left_out=frozenset([sample(0, 1, 2), sample(1, 0, 0), sample(0, 0, 0)]))
    assert not plan.left_out & {*plan.simulated} and len(plan.simulated) == len(plan.samples) - 3
    # From rest past the node that is left out.
    assert plan.parent(sample(0, 1, 3)) is None
    assert plan.parent(sample(0, 2, 3)) == sample(0, 2, 2)
    for each in plan.simulated:
        assert plan.parent(each) not in plan.left_out
    # 20 degrees from rest, 40 from the far end.
    assert plan.stand_ins[sample(0, 1, 2)] == Sample("shoulder_L", grid.rest)
    # Both are 30 degrees away; the first in the grid stands in.
    assert plan.stand_ins[sample(0, 0, 0)] == next(s for s in plan.samples if s in (sample(0, 0, 1), sample(0, 1, 0)))
    # The nearest, at 20 degrees, is farther from rest.
    towards = SamplePlan((grid_of(shoulder, [0], [0, 40], [0, 30, 50]),), left_out=frozenset([sample(0, 1, 1)]))
    assert towards.stand_ins[sample(0, 1, 1)] == sample(0, 1, 0)
    assert plan.stand_ins.keys() == plan.left_out
    assert plan.seconds(1000) < SamplePlan((grid,)).seconds(1000)


def test_shards_cut_the_simulated_samples_into_even_parts():
    plan = symmetric_plan()
    parts = [plan.shard(number, 7) for number in range(7)]
    assert [sample for part in parts for sample in part] == list(plan.simulated)
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
    with pytest.raises(ValueError, match=r"no shard 7/7"):
        plan.shard(7, 7)


def test_on_a_symmetric_character_one_side_is_simulated_and_the_other_is_its_image():
    plan = symmetric_plan()
    assert {sample.joint for sample in plan.simulated} == {"elbow_L", "shoulder_L"}
    assert len(plan.simulated) * 2 == len(plan.samples)
    for sample in plan.samples:
        image = plan.image(sample)
        if image is not None:
            assert image in plan.simulated
            assert plan.mirror is not None
            assert np.allclose(plan.angles(sample), plan.mirror.signs[image.joint] * plan.angles(image))


def test_a_joint_of_the_middle_is_simulated_to_one_side():
    rig = human()
    spine = find_joints(rig).joints["spine"]
    assert spine is not None
    character = doll()
    mirror = find_mirror(character.rig, [*character.joints, spine], character.garment, character.body)
    plan = SamplePlan((grid_of(spine, [-20, 0, 20], [-20, 0, 30], [-15, 0, 15]),), mirror)
    # Of 26 nodes, 2 bend only forwards or back and are their own images; half of the other 24 are simulated.
    assert len(plan.simulated) == 2 + 12
    for sample in plan.simulated:
        parent = plan.parent(sample)
        assert parent is None or plan.image(parent) is None


@pytest.mark.parametrize("budget", [1, 6, 36, 100, 300])
def test_a_budget_is_kept_and_used(budget: int):
    plan = symmetric_plan(budget)
    assert 0.6 * budget < len(plan.simulated) <= budget
    for grid in plan.grids:
        for (low, high), angles in zip(grid.joint.limits, grid.angles, strict=True):
            # A side of a range that has samples has one at its end.
            assert angles[0] == 0.0 or np.isclose(angles[0], low)
            assert angles[-1] == 0.0 or np.isclose(angles[-1], high)


def test_a_budget_goes_first_to_where_cloth_moves_most():
    limits = {"elbow_L": [(0, 90)], "shoulder_L": [(-20, 20), (-10, 100), (-50, 50)]}
    joints = [with_ranges(doll().joint(name), degrees) for name, degrees in limits.items()]
    few = budget_plan(joints, 8).grid
    assert few["shoulder_L"].shape[1] > 2 and few["shoulder_L"].shape[0] == 1
    many = budget_plan(joints, 60).grid
    assert all(a <= b for name in limits for a, b in zip(few[name].shape, many[name].shape, strict=True))
    assert many["shoulder_L"].shape[1] > many["shoulder_L"].shape[0] > 1


def test_an_empty_budget_is_refused():
    with pytest.raises(ValueError, match="at least one sample"):
        budget_plan(doll().joints, 0)


def test_both_sides_of_a_budget_plan_have_the_same_grid_without_symmetry_too():
    plan = budget_plan(doll().joints, 140)
    assert plan.grid["elbow_L"].shape == plan.grid["elbow_R"].shape
    assert plan.grid["shoulder_L"].shape == plan.grid["shoulder_R"].shape


def test_sample_names_are_unique_and_fit_a_file_name():
    plan = paper_plan(doll().joints)
    names = [sample.name for sample in plan.samples]
    assert len(set(names)) == len(names)
    assert all(name.replace("-", "").replace("_", "").isalnum() for name in names)
    assert Sample("elbow_L", (3,)).name == "elbow_L-3"
