"""Wrinkles over a coarse layer: what it moves, what stays, and that its triangles do not show."""

import numpy as np
import pytest
import warp as wp
from baked_dolls import baked, bump, full_plan
from cloth_shapes import sheet
from dolls import doll
from synthesis_reference import joined
from wrinkle_synthesis.wrinkle_addon.coarse_mesh import make_coarse_mesh
from wrinkle_synthesis.wrinkle_addon.correspondence import find_correspondence
from wrinkle_synthesis.wrinkle_addon.detail_transfer import (
    DetailTransfer,
    TransferSettings,
    close_joints,
    cotangent_weights,
    group_shares,
    smoothing_iterations,
    transfer_groups,
)
from wrinkle_synthesis.wrinkle_addon.garment import Regions, SkinWeights
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import JointWrinkles

COLUMNS, ROWS, LENGTH, WIDTH, RADIUS = 96, 64, 0.6, 0.4, 0.3
UP = np.array([0.0, 0.0, 1.0])


class Curved:
    """A sheet bent over a cylinder, with a coarse mesh of its own."""

    def __init__(self):
        flat, self.faces = sheet(COLUMNS, ROWS, LENGTH, WIDTH)
        angle = flat[:, 0] / RADIUS
        self.normals = np.stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)], 1)
        self.along = flat[:, 0]
        self.rest = RADIUS * self.normals + flat[:, 1:2] * [0.0, 1.0, 0.0]
        self.coarse = make_coarse_mesh("Sheet", self.rest, self.faces, 150)
        coarse = self.coarse
        self.match = find_correspondence("Coarse", self.rest, self.faces, coarse.positions, coarse.faces)

    def align(self, coarse, positions, settings=None, **more):
        """The sheet brought into line with its moved coarse mesh [m], float64."""
        transfer = DetailTransfer(self.match, self.rest, self.faces, settings, **more)
        layer, out = (wp.array(points, dtype=wp.vec3, device="cpu") for points in (coarse, positions))
        transfer.align(layer, out)
        return out.numpy().astype(np.float64)


@pytest.fixture(scope="module")
def curved():
    return Curved()


def swing(points):
    """A motion much longer than a coarse edge: waves of half a metre, 20 mm high."""
    return UP * (0.02 * np.sin(12.6 * points[:, :1] + 1.0) * np.cos(10.5 * points[:, 1:2]))


def ghost(heights, length):
    """How strongly a field's Laplacian holds waves of about the coarse mesh's edge length, on the regular sheet."""
    z, h = heights.reshape(COLUMNS + 1, ROWS + 1)[8:-8, 8:-8], LENGTH / COLUMNS
    laplacian = (z[2:, 1:-1] + z[:-2, 1:-1] + z[1:-1, 2:] + z[1:-1, :-2] - 4.0 * z[1:-1, 1:-1]) / h**2
    laplacian *= np.outer(*(np.hanning(count) for count in laplacian.shape))
    k = length * np.hypot(*np.meshgrid(*(np.fft.fftfreq(count, h) for count in laplacian.shape), indexing="ij"))
    return np.sqrt((np.abs(np.fft.fft2(laplacian)[(k > 0.7) & (k < 1.4)]) ** 2).sum())


# --- smoothing ----------------------------------------------------------------------------------------------------


def test_smoothing_removes_the_ghost_of_the_coarse_mesh(curved):
    moved = curved.coarse.positions + swing(curved.coarse.positions)

    def left(smoothing):
        offsets = curved.align(moved, curved.rest, TransferSettings(smoothing)) - curved.rest
        return ghost(offsets[:, 2], curved.coarse.edge_length)

    # The motion itself holds no such waves: what is found are the creases along the coarse mesh's edges (W83).
    assert ghost(swing(curved.rest)[:, 2], curved.coarse.edge_length) < 0.01 * left(0)
    assert left(10) < 0.5 * left(0)
    assert left(None) < 0.05 * left(0)


def test_the_default_blurs_over_half_a_coarse_edge_at_any_fineness(curved):
    spread = np.sqrt(0.25 * smoothing_iterations(curved.match)) * LENGTH / COLUMNS
    # Half a step of a squared fine edge over two axes; diagonals carry nothing on a grid.
    assert spread == pytest.approx(0.5 * curved.coarse.edge_length, rel=0.2)


def test_the_garment_follows_the_coarse_layer(curved):
    moved = curved.align(curved.coarse.positions + swing(curved.coarse.positions), curved.rest)
    error = np.linalg.norm(moved - curved.rest - swing(curved.rest), axis=1)
    # Averaging down and smoothing take a tenth of a wave ten coarse edges long; more where it ends at a corner.
    assert np.sqrt((error**2).mean()) < 0.1 * 0.02 and error.max() < 0.2 * 0.02


# --- what moves and what stays ------------------------------------------------------------------------------------


def test_a_garment_on_its_own_coarse_mesh_stays_as_it_is(curved):
    # Single precision.
    np.testing.assert_allclose(curved.align(curved.coarse.positions, curved.rest), curved.rest, atol=1e-6)


def test_as_published_a_garment_on_its_own_coarse_mesh_is_blown_up(curved):
    published = curved.align(curved.coarse.positions, curved.rest, TransferSettings(as_published=True))
    outward = ((published - curved.rest) * curved.normals).sum(1)
    # A mean of points on an arc lies inside it, by about the square of a third of an edge over the diameter.
    assert outward.mean() > 0.5 * (curved.coarse.edge_length / 3.0) ** 2 / (2.0 * RADIUS)
    assert np.linalg.norm(published - curved.rest, axis=1).max() > 5e-3


def test_a_turn_of_the_coarse_layer_turns_the_garment_up_to_its_hems(curved):
    turn = np.radians(10.0)
    matrix = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
    turned = curved.align(curved.coarse.positions @ matrix.T, curved.rest)
    error = np.linalg.norm(turned - curved.rest @ matrix.T, axis=1)
    # Averages of a linear field are exact but for uneven triangles, and where two borders meet.
    assert error.mean() < 1e-3 and np.percentile(error[curved.match.on_border], 90) < 2e-3


def test_wrinkles_finer_than_the_coarse_mesh_stay(curved):
    wrinkles = 0.002 * np.sin(2.0 * np.pi * curved.along / 0.025)[:, None] * curved.normals
    aligned = curved.align(curved.coarse.positions, curved.rest + wrinkles)
    left = ((aligned - curved.rest) * wrinkles).sum() / (wrinkles**2).sum()
    assert left == pytest.approx(1.0, abs=0.05)


def test_drift_of_the_synthesised_garment_is_taken_back(curved):
    aligned = curved.align(curved.coarse.positions, curved.rest + [0.01, 0.02, -0.01])
    np.testing.assert_allclose(aligned, curved.rest, atol=1e-6)


def test_each_vertex_follows_as_far_as_it_is_told(curved):
    follow = np.zeros(len(curved.rest))
    follow[curved.along > 0.3] = 0.5
    aligned = curved.align(curved.coarse.positions + 0.02 * UP, curved.rest, follow=follow)
    np.testing.assert_allclose(aligned - curved.rest, 0.02 * UP * follow[:, None], atol=1e-6)


def test_a_coarse_layer_finer_than_the_garment_works(curved):
    flat, faces = sheet(12, 8, LENGTH, WIDTH)
    fine, fine_faces = sheet(40, 30, LENGTH, WIDTH)
    match = find_correspondence("Cloth", flat, faces, fine, fine_faces)
    out, coarse = (wp.array(points, dtype=wp.vec3, device="cpu") for points in (flat, fine + 0.05 * UP))
    DetailTransfer(match, flat, faces).align(coarse, out)
    np.testing.assert_allclose(out.numpy(), flat + 0.05 * UP, atol=1e-6)


def test_a_garment_may_have_more_vertices_than_the_square_root_of_what_32_bits_hold():
    positions, faces = sheet(220, 220, 1.0, 1.0)
    start, _, weights = cotangent_weights(positions, faces)
    assert len(positions) > 46_341
    assert np.add.reduceat(weights, start[:-1]) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("follow", [-0.1, 1.1, np.nan])
def test_vertices_that_follow_backwards_or_too_far_are_refused(curved, follow):
    shares = np.ones(len(curved.rest))
    shares[3] = follow
    with pytest.raises(ValueError, match="must lie between 0 and 1"):
        DetailTransfer(curved.match, curved.rest, curved.faces, follow=shares)


def test_a_negative_number_of_iterations_is_refused(curved):
    with pytest.raises(ValueError, match="smoothed -1 times; choose 0 or more"):
        DetailTransfer(curved.match, curved.rest, curved.faces, TransferSettings(-1))


# --- joints that are close to each other --------------------------------------------------------------------------


def hips_and_knees(gap):
    """A sheet for a garment: trunk in the middle, a thigh and a shin on each side, hips ``gap`` apart [m]."""
    positions, faces = sheet(140, 10, 1.4, 0.1)
    x = positions[:, 0] - 0.7
    segment = np.zeros(len(x), np.int32)
    for left, (thigh, shin) in ((True, (1, 2)), (False, (3, 4))):
        side = x < 0.0 if left else x > 0.0
        segment[side & (np.abs(x) > 0.5 * gap)] = thigh
        segment[side & (np.abs(x) > 0.4)] = shin
    joints = {"hip_L": (0, 1), "knee_L": (1, 2), "hip_R": (0, 3), "knee_R": (3, 4)}
    names = ("trunk", "thigh_L", "shin_L", "thigh_R", "shin_R")
    return Regions(names, (0,) * 5, np.zeros(1, np.int32), segment, joints), positions, faces


def test_joints_whose_seams_come_near_each_other_in_one_region_are_found():
    assert close_joints(*hips_and_knees(0.06)) == (("hip_L", "hip_R"),)
    assert close_joints(*hips_and_knees(0.3)) == ()
    assert close_joints(*hips_and_knees(0.3), within=0.35) == (
        ("hip_L", "knee_L"),
        ("hip_L", "hip_R"),
        ("hip_R", "knee_R"),
    )


def test_close_joints_come_into_different_groups():
    joints = ["hip_L", "knee_L", "hip_R", "knee_R"]
    assert transfer_groups(joints, [("hip_R", "hip_L")]) == (("hip_L", "knee_L", "knee_R"), ("hip_R",))
    assert transfer_groups(joints, []) == (tuple(joints),)


def test_shares_of_groups_add_up_to_1_also_where_no_joint_is():
    weights = {"hip_L": np.array([0.7, 0.0, 0.0]), "knee_L": np.array([0.3, 0.0, 0.0]), "hip_R": np.array([0, 1.0, 0])}
    shares = group_shares(weights, (("hip_L", "knee_L"), ("hip_R",)))
    np.testing.assert_allclose(shares, [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]], atol=1e-7)


def test_meshes_of_close_joints_meet_without_a_step_if_they_are_aligned_first(curved):
    # Each joint alone drags the whole sheet another way, and there are 20 mm to pass from one to the other (W86).
    right = np.clip((curved.along - 0.3) / 0.02 + 0.5, 0.0, 1.0)
    meshes = np.stack([curved.rest + 0.01 * UP, curved.rest - 0.01 * UP])
    shares = np.stack([1.0 - right, right])
    after = curved.align(curved.coarse.positions, (shares[..., None] * meshes).sum(0))
    transfer = DetailTransfer(curved.match, curved.rest, curved.faces)
    coarse, separate = (wp.array(x, dtype=wp.vec3, device="cpu") for x in (curved.coarse.positions, meshes))
    for number in range(len(meshes)):
        transfer.align(coarse, separate[number])
    first = wp.zeros(len(curved.rest), dtype=wp.vec3, device="cpu")
    transfer.blend(separate, wp.array(shares, dtype=wp.float32, device="cpu"), first)
    # Blended first, the coarse mesh is too coarse to take the step away; of 20 mm a fifth and more is left.
    assert np.ptp((after - curved.rest)[:, 2]) > 4e-3
    assert np.abs(first.numpy() - curved.rest).max() < 1e-6


def test_groups_of_joints_are_synthesised_aligned_and_joined(tmp_path):
    character = doll()
    rest, faces = character.garment.positions, character.garment.faces
    names = [joint.name for joint in character.joints]
    database = baked(tmp_path, character, full_plan(character), {name: bump(character, name) for name in names})
    coarse = make_coarse_mesh("Sleeves", rest, faces, 200)
    match = find_correspondence("Coarse", rest, faces, coarse.positions, coarse.faces)
    transfer = DetailTransfer(match, rest, faces)
    evaluator = JointWrinkles(database).bind()
    pose = character.random_pose(np.random.default_rng(1))
    # The coarse layer: skinned with the weights of the garment around each of its vertices, and blown aside.
    nearest = np.array([np.linalg.norm(rest - point, axis=1).argmin() for point in coarse.positions])
    weights = character.garment.weights
    carried = SkinWeights(weights.bones[nearest], weights.weights[nearest])
    layer = carried.carry(pose.deformations(character.rig), coarse.positions) + 0.01 * UP
    groups = transfer_groups(names, [(names[0], names[1])])
    strengths = [{name: float(name in group) for name in names} for group in ((), *groups)]

    moved = wp.array(layer, dtype=wp.vec3, device="cpu")
    meshes = wp.zeros((len(strengths), len(rest)), dtype=wp.vec3, device="cpu")
    found = wp.zeros(len(rest), dtype=wp.vec3, device="cpu")
    evaluator.evaluate_apart(pose, groups, meshes)
    transfer.join(meshes, found)
    transfer.attach(moved, found)

    alone = [wp.array(evaluator.positions(pose, strength), dtype=wp.vec3, device="cpu") for strength in strengths]
    for mesh in alone:
        transfer.align(moved, mesh)
    skinned, *others = (mesh.numpy().astype(np.float64) for mesh in alone)
    # Single precision at coordinates of about 1 m.
    np.testing.assert_allclose(found.numpy(), skinned + joined(np.stack(others) - skinned), atol=2e-6)
    assert len(groups) == 2 and np.abs(found.numpy() - skinned).max() > 0.005
