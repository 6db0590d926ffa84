"""What binds the garment to the body and the rig: weights, regions, symmetry."""

from dataclasses import replace

import numpy as np
import pytest
from dolls import Doll, doll, tube_along
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.garment import (
    Body,
    Garment,
    SkinWeights,
    bind_to_surface,
    distances_to_segments,
    find_regions,
    neighbour_mean,
    skin_garment,
    vertex_neighbours,
    vertex_normals,
    warp_directions,
)
from wrinkle_synthesis.wrinkle_addon.place import PlacedError
from wrinkle_synthesis.wrinkle_addon.rig import pose_of_angles
from wrinkle_synthesis.wrinkle_addon.symmetry import find_mirror, require_mirror


@pytest.fixture(scope="module")
def character() -> Doll:
    return doll()


def test_closest_points_lie_on_the_surface_and_know_their_side(character: Doll):
    body = character.body
    outside = body.positions + 0.01 * vertex_normals(body.positions, body.faces)
    inside = body.positions - 0.01 * vertex_normals(body.positions, body.faces)
    # Where the tube turns, another part of it may be nearer than the vertex started from.
    for points, sign in ((outside, 1.0), (inside, -1.0)):
        binding = bind_to_surface(points, body.positions, body.faces)
        assert (np.sign(binding.distance) == sign).mean() > 0.99
        closest = np.einsum("pc,pcd->pd", binding.weights, body.positions[body.faces[binding.faces]])
        assert np.allclose(np.linalg.norm(points - closest, axis=1), np.abs(binding.distance), atol=1e-6)
        assert np.abs(binding.distance).max() < 0.0101


def test_skin_weights_come_from_the_body_beneath_and_are_smooth(character: Doll):
    dense = character.garment.weights.to_dense(character.rig.bone_count)
    assert np.allclose(dense.sum(1), 1.0, atol=1e-6)
    forearm = character.rig.index["forearm_L"]
    beyond = np.linalg.norm(character.garment.positions - character.rig.tails[forearm], axis=1) < 0.07
    assert beyond.any() and (dense[beyond, forearm] > 0.5).all()
    faces = character.garment.faces
    # Neighbouring rings are about 2 cm apart, and weights change over some 10 cm.
    assert np.abs(dense[faces[:, 0]] - dense[faces[:, 1]]).max() < 0.35


def test_a_garment_over_an_unweighted_part_is_refused(character: Doll):
    body = Body(character.body.positions, character.body.faces, np.zeros_like(character.body.weights))
    with pytest.raises(ValueError, match="no deforming bone"):
        skin_garment(character.garment.positions, character.garment.faces, body)


def test_weights_survive_the_way_through_their_dense_form():
    dense = np.random.default_rng(0).random((20, 9))
    dense[dense < 0.5] = 0.0
    dense[:, 0] += 0.01
    weights = SkinWeights.from_dense(dense)
    kept = np.sort(dense, axis=1)[:, -6:]
    assert np.allclose(np.sort(weights.to_dense(9), axis=1)[:, -6:], kept / kept.sum(1, keepdims=True), atol=1e-6)


def test_skinning_by_one_rotation_is_that_rotation(character: Doll):
    turn = rotations.from_rotvec([0.3, -1.0, 0.5])
    matrices = np.tile(np.eye(4), (character.rig.bone_count, 1, 1))
    matrices[:, :3, :3] = rotations.to_matrices(turn)
    matrices[:, :3, 3] = [1.0, 2.0, 3.0]
    weights = character.garment.weights
    carried = weights.carry(matrices, character.garment.positions)
    assert np.allclose(carried, rotations.rotate(turn, character.garment.positions) + [1, 2, 3], atol=1e-6)
    # Opposite signs of the same quaternion must not cancel.
    turns = np.where(np.arange(character.rig.bone_count)[:, None] % 2, turn, -turn)
    blended = weights.turn(turns)
    assert np.allclose(np.abs(blended @ turn), 1.0)


def test_each_vertex_belongs_to_the_region_of_the_limb_it_covers(character: Doll):
    regions = find_regions(character.rig, character.joints, character.garment.weights)
    near, far = regions.joints["elbow_L"]
    assert regions.joints["shoulder_L"][1] == near
    middle = 0.5 * (character.rig.heads + character.rig.tails)
    for bone, segment in (("forearm_L", far), ("upperarm_L", near), ("upperarm_R", regions.joints["shoulder_R"][1])):
        distance = np.linalg.norm(character.garment.positions - middle[character.rig.index[bone]], axis=1)
        assert (regions.vertex_segment[distance < 0.08] == segment).all()


def test_distances_to_regions_are_those_of_brute_force(character: Doll):
    regions = find_regions(character.rig, character.joints, character.garment.weights)
    positions, faces = character.garment.positions, character.garment.faces
    distances = distances_to_segments(positions, faces, regions)
    for segment in np.unique(regions.vertex_segment):
        members = positions[regions.vertex_segment == segment]
        brute = np.linalg.norm(positions[:, None] - members, axis=2).min(1)
        assert (distances[regions.vertex_segment == segment, segment] == 0.0).all()
        # To triangles rather than vertices: nearer by up to half an edge, and a seam's triangles belong to neither.
        assert np.abs(distances[:, segment] - brute).max() < 0.03


def test_a_symmetric_character_is_its_own_mirror_image(character: Doll):
    mirror = find_mirror(character.rig, character.joints, character.garment, character.body)
    assert mirror is not None
    assert np.abs(mirror.reflect_garment(character.garment.positions) - character.garment.positions).max() < 1e-9
    assert mirror.joints["elbow_L"] == "elbow_R"
    for name in ("elbow_L", "shoulder_L"):
        joint = character.joint(name)
        angles = 0.4 * np.arange(1, joint.dof + 1)
        partner = mirror.joints[name]
        mine = character.positions(pose_of_angles(character.rig, character.joints, {name: angles}))
        theirs = character.positions(
            pose_of_angles(character.rig, character.joints, {partner: mirror.signs[name] * angles})
        )
        assert np.abs(mirror.reflect(mine)[::-1].mean(0) - theirs.mean(0)).max() < 1e-3


CAUSES = {
    "garment": "The garment 'sleeve' is not symmetric: 2 of its vertices",
    "faces": "The garment 'sleeve' is not symmetric: 2 of its triangles",
    "fabric": "The fabric of the garment 'sleeve' is not symmetric",
    "body": "The body is not symmetric: .* up to 1..0 mm",
    "rig": "The rig is not symmetric at joints elbow_L and elbow_R: an axis is turned 1.8°",
    "joint": "Joint elbow_R is sampled without elbow_L",
}


@pytest.mark.parametrize("part", CAUSES)
def test_a_character_that_is_not_symmetric_is_told_where(character: Doll, part: str):
    garment, body, rig, joints = character.garment, character.body, character.rig, list(character.joints)
    if part == "garment":
        positions = garment.positions.copy()
        positions[10] += 0.001
        garment = Garment(garment.name, positions, garment.faces, garment.weights, garment.pins)
    elif part == "faces":
        garment = Garment(garment.name, garment.positions, garment.faces[2:], garment.weights, garment.pins)
    elif part == "joint":
        joints = [joint for joint in joints if joint.name != "elbow_L"]
    elif part == "fabric":
        assert find_mirror(rig, character.joints, cut_along(garment, [1.0, 0.0, 0.0]), body) is not None
        garment = cut_along(garment, [0.8, 0.6, 0.0])
    elif part == "body":
        positions = body.positions.copy()
        positions[positions[:, 0] > 0.3] += [0.0, 0.01, 0.0]
        body = Body(positions, body.faces, body.weights)
    else:
        rest = rig.rest.copy()
        rest[rig.index["forearm_L"], :3, 3] += 0.01
        rig = type(rig)(rig.names, rig.parents, rest, rig.lengths, rig.gravity)
    assert find_mirror(rig, joints, garment, body) is None
    with pytest.raises(PlacedError, match=CAUSES[part]):
        require_mirror(rig, joints, garment, body)


def cut_along(garment: Garment, warp: list[float]) -> Garment:
    return replace(garment, warp=np.tile(warp, (len(garment.faces), 1)))


def test_the_warp_lies_where_v_grows():
    rng = np.random.default_rng(3)
    faces = np.array([[0, 1, 2], [2, 1, 3]], np.int32)
    flat = rng.normal(size=(4, 2))
    u, v = np.array([0.6, 0.0, 0.8]), np.array([0.0, -1.0, 0.0])
    positions = flat[:, :1] * u + 3.0 * flat[:, 1:] * v
    found = warp_directions(positions, faces, flat[faces])
    assert found is not None
    assert np.abs(found - v).max() < 1e-12
    # A mirrored map turns the pattern over, but not its warp.
    mirrored = warp_directions(positions, faces, flat[faces] * [-1.0, 1.0])
    assert mirrored is not None
    assert np.abs(mirrored - v).max() < 1e-12


def test_triangles_without_texture_coordinates_have_no_warp():
    rng = np.random.default_rng(4)
    positions, faces = rng.normal(size=(4, 3)), np.array([[0, 1, 2], [2, 1, 3]], np.int32)
    uvs = rng.normal(size=(2, 3, 2))
    uvs[1] = [0.5, 0.5]
    found = warp_directions(positions, faces, uvs)
    assert found is not None
    assert np.linalg.norm(found, axis=1) == pytest.approx([1.0, 0.0])
    assert warp_directions(positions, faces, 0.0 * uvs) is None


def test_the_mean_over_neighbours_is_what_its_name_says():
    positions, faces = tube_along([np.zeros(3), np.array([1.0, 0.0, 0.0])], 0.1, 5, 6)
    means = neighbour_mean(positions, vertex_neighbours(faces, len(positions)))
    neighbours = {int(v) for face in faces for v in face if 8 in face} - {8}
    assert np.allclose(means[8], positions[sorted(neighbours)].mean(0))
