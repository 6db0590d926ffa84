"""Synthesis from a wrinkle database: what both formulations promise, on every device there is."""

from pathlib import Path

import numpy as np
import pytest
import warp as wp
from baked_dolls import GRID, baked, bump, full_plan
from dolls import Doll, doll, grid_of
from synthesis_reference import about_axis, about_point, joined, offsets_over_skinning, papers_form
from wrinkle_synthesis.kernels.blend import join_all_offsets
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase, skin_frame
from wrinkle_synthesis.wrinkle_addon.garment import Garment, SkinWeights
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import BlendWeights, Formulation, JointWrinkles, find_cell
from wrinkle_synthesis.wrinkle_addon.plan import SamplePlan
from wrinkle_synthesis.wrinkle_addon.rig import Pose, pose_from_local_turns, pose_of_angles

# The kernels are single precision at coordinates of about 1 m.
SINGLE = 2e-6


@pytest.fixture(scope="module")
def character() -> Doll:
    return doll()


@pytest.fixture(scope="module")
def skin_only(character: Doll, tmp_path_factory: pytest.TempPathFactory) -> WrinkleDatabase:
    return baked(tmp_path_factory.mktemp("skin"), character, full_plan(character))


@pytest.fixture(scope="module")
def wrinkled(character: Doll, tmp_path_factory: pytest.TempPathFactory) -> WrinkleDatabase:
    bumps = {name: bump(character, name) for name in GRID}
    return baked(tmp_path_factory.mktemp("wrinkled"), character, full_plan(character), bumps)


def with_local_turns(character: Doll, pose: Pose, **rotvecs: tuple[float, float, float]) -> Pose:
    """The pose with more bones turned, by rotation vectors in rig space [degrees]."""
    local = pose.local_turns(character.rig)
    for name, degrees in rotvecs.items():
        bone = character.rig.index[name]
        local[bone] = rotations.multiply(rotations.from_rotvec(np.radians(degrees)), local[bone])
    return pose_from_local_turns(character.rig, local)


def unsampled_poses(character: Doll) -> dict[str, Pose]:
    """Poses that no plan samples: they must simply follow the skin."""
    angles = {"elbow_L": [np.radians(60)], "shoulder_R": np.radians([0.0, 40.0, 20.0])}
    pose = pose_of_angles(character.rig, character.joints, angles)
    line = character.rig.tails[character.rig.index["forearm_L"]] - character.rig.heads[character.rig.index["forearm_L"]]
    pronation = tuple(40.0 * line / np.linalg.norm(line))
    past = pose_of_angles(character.rig, character.joints, {"elbow_L": [np.radians(110)]})
    return {
        "forearm pronated by 40 degrees": with_local_turns(character, pose, forearm_L=pronation),
        "clavicles raised by 15 degrees": with_local_turns(
            character, pose, clavicle_L=(0, -15, 0), clavicle_R=(0, 15, 0)
        ),
        "spine bent unevenly": with_local_turns(
            character, pose, spine1=(25, 0, 0), spine2=(0, 0, 10), chest=(-5, 8, 0)
        ),
        "elbow 20 degrees past its range": past,
    }


# --- the default formulation --------------------------------------------------------------------------------------


def test_samples_that_are_skinning_reproduce_skinning_in_every_pose(
    character: Doll, skin_only: WrinkleDatabase, device: str
):
    evaluator = JointWrinkles(skin_only).bind(device)
    rng = np.random.default_rng(3)
    poses = [character.random_pose(rng) for _ in range(20)] + list(unsampled_poses(character).values())
    for pose in poses:
        skinned, _ = skin_frame(character.rig, character.garment.weights, character.garment.positions, pose)
        # The promise is 0.01 mm.
        assert np.abs(evaluator.positions(pose) - skinned).max() < 1e-5


def test_every_sample_is_reproduced_at_its_own_angles(character: Doll, wrinkled: WrinkleDatabase, device: str):
    evaluator = JointWrinkles(wrinkled).bind(device)
    for sample in wrinkled.header.plan.samples[::7]:
        angles = wrinkled.header.plan.angles(sample)
        pose = pose_of_angles(character.rig, character.joints, {sample.joint: angles})
        error = np.abs(evaluator.positions(pose) - wrinkled.positions(sample)).max()
        # Stored as float16 to 0.05 mm; offsets below 0.1 mm are left out.
        assert error < 2e-4


def test_the_kernel_agrees_with_the_reference(character: Doll, wrinkled: WrinkleDatabase, device: str):
    method = JointWrinkles(wrinkled)
    evaluator = method.bind(device)
    rng = np.random.default_rng(5)
    for _ in range(8):
        pose = character.random_pose(rng)
        strength = {name: float(rng.random() * 1.5) for name in GRID}
        reference = offsets_over_skinning(method, pose, strength)
        assert np.abs(evaluator.positions(pose, strength) - reference).max() < SINGLE


def test_joints_that_pull_the_same_way_do_not_pull_farther_than_one():
    up, down, aside = np.array([[[0.0, 0.0, 3.0]]]), np.array([[[0.0, 0.0, -1.0]]]), np.array([[[4.0, 0.0, 0.0]]])
    for offsets, expected in (
        ([up], 3.0),
        ([up, up], 3.0),
        ([up, 0.5 * up, 0.2 * up], 3.0),
        # What cancels is added up plainly.
        ([up, down], 2.0),
        ([up, -up], 0.0),
        ([up, np.zeros_like(up)], 3.0),
        # Across each other: 16 / 5 along the sum, which would be 5 long.
        ([up, aside], 16.0 / 5.0),
    ):
        assert np.isclose(np.linalg.norm(joined(np.concatenate(offsets))), expected)


def test_joined_offsets_are_no_longer_than_their_sum_and_than_the_longest_of_them(device: str):
    rng = np.random.default_rng(17)
    # Of all sizes next to each other, some joints without any.
    offsets = (
        rng.normal(size=(5, 1000, 3)) * 10.0 ** rng.uniform(-4, -1, (5, 1000, 1)) * (rng.random((5, 1000, 1)) > 0.3)
    )
    given = wp.array(offsets.astype(np.float32), dtype=wp.vec3, device=device)
    out = wp.zeros(offsets.shape[1], dtype=wp.vec3, device=device)
    wp.launch(join_all_offsets, out.shape, [given], [out], device=device)
    assert np.abs(out.numpy() - joined(offsets)).max() < SINGLE
    lengths = np.linalg.norm(out.numpy(), axis=1)
    assert (lengths <= np.linalg.norm(offsets, axis=2).max(0) + SINGLE).all()
    assert (lengths <= np.linalg.norm(offsets.sum(0), axis=1) + SINGLE).all()
    alone = (np.abs(offsets).max(2) > 0.0).sum(0) == 1
    np.testing.assert_array_equal(out.numpy()[alone], given.numpy().sum(0)[alone])


@pytest.mark.parametrize("formulation", [Formulation.OFFSETS, Formulation.PAPER])
def test_strength_zero_is_skinning(character: Doll, wrinkled: WrinkleDatabase, device: str, formulation: Formulation):
    evaluator = JointWrinkles(wrinkled, formulation).bind(device)
    pose = character.random_pose(np.random.default_rng(11))
    skinned, _ = skin_frame(character.rig, character.garment.weights, wrinkled.rest, pose)
    assert np.abs(evaluator.positions(pose, 0.0) - skinned).max() < SINGLE
    half = evaluator.positions(pose, 0.5).astype(float)
    assert np.allclose(half, 0.5 * (skinned + evaluator.positions(pose)), atol=2 * SINGLE)


@pytest.mark.parametrize("formulation", [Formulation.OFFSETS, Formulation.PAPER])
def test_groups_of_joints_synthesised_apart_are_each_what_they_are_alone(
    character: Doll, wrinkled: WrinkleDatabase, device: str, formulation: Formulation
):
    evaluator = JointWrinkles(wrinkled, formulation).bind(device)
    pose = character.random_pose(np.random.default_rng(13))
    names = [joint.name for joint in wrinkled.header.joints]
    groups = (names[::2], names[1::2])
    meshes = wp.zeros((3, evaluator.vertex_count), dtype=wp.vec3, device=device)
    evaluator.evaluate_apart(pose, groups, meshes, {names[0]: 0.5})
    skinned, *offsets = meshes.numpy()
    np.testing.assert_array_equal(skinned, evaluator.positions(pose, 0.0))
    for offset, group in zip(offsets, groups, strict=True):
        alone = {name: {names[0]: 0.5}.get(name, 1.0) if name in group else 0.0 for name in names}
        assert np.abs(skinned + offset - evaluator.positions(pose, alone)).max() < SINGLE


@pytest.mark.parametrize("name", ["forearm pronated by 40 degrees", "clavicles raised by 15 degrees",
                                  "spine bent unevenly", "elbow 20 degrees past its range"])  # fmt: skip
def test_no_seam_opens_when_bones_turn_that_were_not_sampled(
    character: Doll, wrinkled: WrinkleDatabase, device: str, name: str
):
    pose = unsampled_poses(character)[name]
    evaluator = JointWrinkles(wrinkled).bind(device)
    skinned, turns = skin_frame(character.rig, character.garment.weights, wrinkled.rest, pose)
    offsets = rotations.rotate(rotations.conjugate(turns), evaluator.positions(pose) - skinned)
    faces = wrinkled.header.garment.faces
    jumps = np.linalg.norm(offsets[faces[:, 0]] - offsets[faces[:, 1]], axis=1)
    # Neighbours differ by no more than the bumps themselves do, over an edge and at full strength.
    allowed = sum(
        np.linalg.norm(shape[faces[:, 0]] - shape[faces[:, 1]], axis=1).max()
        for shape in (bump(character, joint)(np.full(3, np.radians(60))) for joint in GRID)
    )
    assert jumps.max() < allowed


def test_angles_beyond_the_samples_are_clamped_and_said(character: Doll, wrinkled: WrinkleDatabase, device: str):
    evaluator = JointWrinkles(wrinkled).bind(device)
    past = pose_of_angles(character.rig, character.joints, {"elbow_L": [np.radians(110)]})
    end = pose_of_angles(character.rig, character.joints, {"elbow_L": [np.radians(90)]})
    positions = evaluator.positions(past)
    assert list(evaluator.clamped) == ["elbow_L"]
    assert np.isclose(evaluator.clamped["elbow_L"][0], np.radians(20))
    evaluator.positions(end)
    assert not evaluator.clamped
    # The wrinkles stay those of the last sample while the skin goes on.
    weights = character.garment.weights
    local = []
    for pose, shape in ((past, positions), (end, evaluator.positions(end))):
        skinned, turns = skin_frame(character.rig, weights, wrinkled.rest, pose)
        local.append(rotations.rotate(rotations.conjugate(turns), shape - skinned))
    assert np.abs(local[0] - local[1]).max() < 3 * SINGLE


def test_placement_carries_the_result_into_another_space(character: Doll, wrinkled: WrinkleDatabase, device: str):
    pose = character.random_pose(np.random.default_rng(2))
    placement = np.eye(4)
    placement[:3] = np.random.default_rng(4).normal(size=(3, 4))
    for formulation in Formulation:
        evaluator = JointWrinkles(wrinkled, formulation).bind(device)
        out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device=device)
        evaluator.evaluate(pose, out, placement=placement)
        expected = evaluator.positions(pose) @ placement[:3, :3].T + placement[:3, 3]
        assert np.abs(out.numpy() - expected).max() < 10 * SINGLE
        groups = [[joint.name for joint in wrinkled.header.joints]]
        apart, placed = (wp.zeros((2, evaluator.vertex_count), dtype=wp.vec3, device=device) for _ in range(2))
        evaluator.evaluate_apart(pose, groups, apart)
        evaluator.evaluate_apart(pose, groups, placed, placement=placement)
        expected = apart.numpy() @ placement[:3, :3].T
        expected[0] += placement[:3, 3].astype(np.float32)
        assert np.abs(placed.numpy() - expected).max() < 10 * SINGLE


def test_a_frame_is_the_same_to_the_bit_from_any_order(character: Doll, wrinkled: WrinkleDatabase, device: str):
    rng = np.random.default_rng(9)
    poses = [character.random_pose(rng) for _ in range(6)]
    for formulation in Formulation:
        evaluator = JointWrinkles(wrinkled, formulation).bind(device)
        forwards = [evaluator.positions(pose) for pose in poses]
        fresh = JointWrinkles(wrinkled, formulation).bind(device)
        backwards = [fresh.positions(pose) for pose in reversed(poses)][::-1]
        for a, b in zip(forwards, backwards, strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_launch_split_over_threads_gives_the_same_bits(
    character: Doll, wrinkled: WrinkleDatabase, monkeypatch: pytest.MonkeyPatch
):
    pose = character.random_pose(np.random.default_rng(1))
    whole = JointWrinkles(wrinkled).bind("cpu").positions(pose)
    from wrinkle_synthesis.wrinkle_addon import method

    monkeypatch.setattr(method, "LEAST_SPLIT", 100)
    monkeypatch.setattr(method, "THREADS", 3)
    np.testing.assert_array_equal(JointWrinkles(wrinkled).bind("cpu").positions(pose), whole)


def test_the_window_is_one_around_the_joint_and_fades_smoothly(character: Doll, wrinkled: WrinkleDatabase):
    method = JointWrinkles(wrinkled)
    window = method.window("elbow_L")
    regions = wrinkled.header.regions
    near, far = regions.joints["elbow_L"]
    assert (window[np.isin(regions.vertex_segment, [near, far])] == 1.0).all()
    # The other hand is nearly as far away as the window reaches.
    assert window.min() < 0.1
    faces = wrinkled.header.garment.faces
    assert np.abs(window[faces[:, 0]] - window[faces[:, 1]]).max() < 0.2


@pytest.mark.parametrize("formulation", [Formulation.OFFSETS, Formulation.PAPER])
def test_measured_weights_take_the_place_of_those_by_distance(
    character: Doll, wrinkled: WrinkleDatabase, device: str, formulation: Formulation
):
    method = JointWrinkles(wrinkled, formulation, BlendWeights.MEASURED)
    strongest = np.max([method.window(name) for name in GRID], axis=0)
    np.testing.assert_allclose(strongest, 1.0, rtol=1e-6)
    np.testing.assert_allclose(np.sum(list(method.joint_weights().values()), axis=0), 1.0)
    evaluator, by_distance = method.bind(device), JointWrinkles(wrinkled, formulation).bind(device)
    reference = papers_form if formulation is Formulation.PAPER else offsets_over_skinning
    rng = np.random.default_rng(6)
    for _ in range(3):
        pose = character.random_pose(rng)
        positions = evaluator.positions(pose)
        # Single precision; arcs near their axis lose a digit more.
        assert np.abs(positions - reference(method, pose)).max() < 1e-5
        assert np.abs(positions - by_distance.positions(pose)).max() > 1e-4


# --- the paper's formulation --------------------------------------------------------------------------------------


@pytest.mark.parametrize("about_axis_too", [True, False])
def test_the_papers_kernel_agrees_with_the_reference(
    character: Doll, wrinkled: WrinkleDatabase, device: str, about_axis_too: bool
):
    method = JointWrinkles(wrinkled, Formulation.PAPER, hinges_about_axis=about_axis_too)
    evaluator = method.bind(device)
    rng = np.random.default_rng(6)
    for _ in range(5):
        pose = character.random_pose(rng)
        # Arcs lose a few more bits than sums, near parallel arms.
        assert np.abs(evaluator.positions(pose) - papers_form(method, pose)).max() < 2e-5


def rigid_sleeve(folder: Path, name: str, *degrees: list[float]) -> tuple[Doll, WrinkleDatabase]:
    """A sleeve that turns as a whole with the bones beyond one joint, sampled there."""
    base = doll(names=(name,))
    joint = base.joint(name)
    beyond = base.rig.index[joint.far]
    bones = np.full((base.garment.vertex_count, 6), 0, np.int32)
    bones[:, 0] = beyond
    weights = np.zeros(bones.shape, np.float32)
    weights[:, 0] = 1.0
    garment = Garment(
        "rigid", base.garment.positions, base.garment.faces, SkinWeights(bones, weights), base.garment.pins
    )
    character = Doll(base.rig, base.body, garment, base.joints)
    return character, baked(folder, character, SamplePlan((grid_of(joint, *degrees),)))


def sleeve_error(character: Doll, database: WrinkleDatabase, method: JointWrinkles, degrees: list[float]) -> float:
    """Largest error [mm] on the sleeve of the limb beyond the joint."""
    joint = character.joints[0]
    bone = character.rig.index[joint.far]
    limb = [k == bone or character.rig.is_ancestor(bone, k) for k in range(character.rig.bone_count)]
    beyond = doll().garment.weights.to_dense(character.rig.bone_count)[:, limb].sum(1) > 0.9
    pose = pose_of_angles(character.rig, character.joints, {joint.name: np.radians(degrees)})
    exact, _ = skin_frame(character.rig, character.garment.weights, database.rest, pose)
    return float(np.linalg.norm(method.bind().positions(pose) - exact, axis=1)[beyond].max() * 1e3)


@pytest.mark.parametrize(("step", "low", "high"), [(15, 0.35, 0.65), (30, 1.5, 2.5)])
def test_eq_1_bends_a_rigid_hinge_by_the_error_of_its_own_circles(tmp_path: Path, step: int, low: float, high: float):
    """Each vertex turns on its own great circle: 0.5 mm at 15 degrees, 2 mm at 30 (design, section 3)."""
    character, database = rigid_sleeve(tmp_path, "elbow_L", [0, step])
    own_circles = JointWrinkles(database, Formulation.PAPER, hinges_about_axis=False)
    assert low < sleeve_error(character, database, own_circles, [step / 2]) < high
    assert sleeve_error(character, database, JointWrinkles(database, Formulation.PAPER), [step / 2]) < 0.01
    assert sleeve_error(character, database, JointWrinkles(database), [step / 2]) < 0.01


def test_a_rigid_ball_in_a_30_degree_cell_costs_the_paper_millimetres_and_offsets_nothing(tmp_path: Path):
    """6 to 11 mm in 30-degree ball cells (design, section 3); the figure depends on the lever arm."""
    character, database = rigid_sleeve(tmp_path, "shoulder_L", [0, 30], [0, 30], [0, 30])
    paper = JointWrinkles(database, Formulation.PAPER)
    assert 2.0 < sleeve_error(character, database, paper, [15, 15, 15]) < 15.0
    assert sleeve_error(character, database, JointWrinkles(database), [15, 15, 15]) < 0.01


def test_linear_interpolation_shrinks_what_eq_1_keeps():
    """W61: halfway through a right angle a straight line cuts the corner by 1 - cos 45 degrees."""
    rng = np.random.default_rng(8)
    arms = rng.normal(size=(200, 3))
    arms[:, 2] = 0.0
    turn = rotations.from_rotvec([0.0, 0.0, np.pi / 2])
    ends = rotations.rotate(turn, arms)
    straight = 0.5 * (arms + ends)
    arc = about_point(arms, ends, np.zeros(3), 0.5)
    lengths = np.linalg.norm(arms, axis=1)
    assert np.allclose(np.linalg.norm(straight, axis=1) / lengths, np.cos(np.pi / 4))
    assert np.allclose(np.linalg.norm(arc, axis=1), lengths)


def test_arcs_stay_defined_where_their_plane_is_not():
    """X01: parallel, opposite and vanishing arms fall back to a straight line."""
    centre = np.zeros(3)
    p0 = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    p1 = np.array([[2.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    straight = 0.5 * (p0 + p1)
    assert np.allclose(about_point(p0, p1, centre, 0.5), straight)
    on_axis = np.array([[0.0, 0.0, 1.0]])
    assert np.allclose(about_axis(on_axis, 2 * on_axis, centre, np.array([0.0, 0.0, 1.0]), 0.5), 1.5 * on_axis)


def test_eq_4_weights_are_the_papers_and_add_up_to_one(wrinkled: WrinkleDatabase):
    """W66: written out for the chest, whose neighbours here are both upper arms."""
    method = JointWrinkles(wrinkled)
    regions = wrinkled.header.regions
    weights = method.distance_weights()
    assert np.allclose(np.sum(list(weights.values()), axis=0), 1.0)
    chest = regions.vertex_segment == regions.joints["shoulder_L"][0]
    distances = np.maximum(method.segment_distances, 1e-4)
    left = distances[chest, regions.joints["shoulder_L"][1]]
    right = distances[chest, regions.joints["shoulder_R"][1]]
    assert np.allclose(weights["shoulder_L"][chest], right / (left + right))
    arm = regions.vertex_segment == regions.joints["elbow_L"][0]
    assert np.allclose((weights["shoulder_L"] + weights["elbow_L"])[arm], 1.0)
    forearm = regions.vertex_segment == regions.joints["elbow_L"][1]
    assert np.allclose(weights["elbow_L"][forearm], 1.0)


def test_a_cell_is_found_by_its_angles_and_clamped_at_the_ends():
    grid = grid_of(doll().joint("elbow_L"), [-30, 0, 30, 60])
    for degrees, lower, fraction, beyond in ((-40, 0, 0.0, -10), (-15, 0, 0.5, 0), (0, 1, 0.0, 0), (45, 2, 0.5, 0),
                                             (60, 2, 1.0, 0), (75, 2, 1.0, 15)):  # fmt: skip
        cell = find_cell(grid, np.radians([float(degrees)]))
        assert cell.lower == (lower,) and cell.upper == (lower + 1,)
        assert np.isclose(cell.fraction[0], fraction) and np.isclose(np.degrees(cell.beyond[0]), beyond)
