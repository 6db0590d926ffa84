"""Which coarse triangle each vertex of a garment rides on: the nearest one of its own layer and side."""

import numpy as np
import pytest
from cloth_shapes import sheet, tube
from wrinkle_synthesis.wrinkle_addon.coarse_mesh import make_coarse_mesh
from wrinkle_synthesis.wrinkle_addon.correspondence import find_correspondence


def joined(*parts):
    first = np.cumsum([0] + [len(positions) for positions, _ in parts])
    faces = [faces + start for (_, faces), start in zip(parts, first[:-1], strict=True)]
    return np.concatenate([positions for positions, _ in parts]), np.concatenate(faces)


def bump(positions, height):
    """A sheet of 0.4 m with its middle raised [m]."""
    distance = np.linalg.norm(positions[:, :2] - 0.2, axis=1)
    return positions + np.array([0.0, 0.0, 1.0]) * (height * np.exp(-((distance / 0.08) ** 2)))[:, None]


def test_a_made_coarse_mesh_carries_every_vertex_on_a_triangle_below_it():
    positions, faces = tube(60, 40, 0.5, 0.06)
    coarse = make_coarse_mesh("Sleeve", positions, faces, 90)
    match = find_correspondence("Coarse", positions, faces, coarse.positions, coarse.faces)
    # A chord of the coarse edge's length lies this far below a tube of 6 cm; triangles dip as far as two of them.
    assert match.distance.max() < 2.0 * coarse.edge_length**2 / (8.0 * 0.06)
    assert len(match.doubtful) == 0
    assert (match.weights >= 0.0).all()
    np.testing.assert_allclose(match.weights.sum(1), 1.0, atol=1e-6)
    np.testing.assert_array_equal(match.corners, coarse.faces[match.faces])


def test_places_give_back_every_vertex():
    positions, faces = tube(60, 40, 0.5, 0.06)
    coarse = make_coarse_mesh("Sleeve", positions, faces, 90)
    match = find_correspondence("Coarse", positions, faces, coarse.positions, coarse.faces)
    a, b, c = (coarse.positions[match.corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along_b, along_c, height = match.places.T[:, :, None]
    # Places are float32.
    np.testing.assert_allclose(a + along_b * (b - a) + along_c * (c - a) + height * normal, positions, atol=1e-7)


def test_a_vertex_finds_its_own_side_of_a_flattened_sleeve():
    flat = np.array([1.0, 1.0, 0.05])
    positions, faces = tube(60, 40, 0.5, 0.06)
    coarse = make_coarse_mesh("Sleeve", positions, faces, 90)
    # The coarse sleeve is turned a little, so that the far side often is the nearest.
    turn = np.radians(8.0)
    tilt = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
    match = find_correspondence("Coarse", positions * flat, faces, (coarse.positions * flat) @ tilt.T, coarse.faces)
    side = coarse.positions[match.corners, 2].mean(1)
    # Away from the crease, where either side is right.
    clear = np.abs(positions[:, 2]) > 0.04
    assert (np.sign(side) == np.sign(positions[:, 2]))[clear].all()


def test_vertices_that_found_another_layer_are_put_back_on_their_own():
    upper, faces = sheet(40, 40, 0.4, 0.4)
    lower = upper - [0.0, 0.0, 0.006]
    coarse, coarse_faces = sheet(8, 8, 0.4, 0.4)
    # In their middle the coarse layers have changed places: the nearest one is the wrong one there.
    layers = joined((bump(coarse, -0.008), coarse_faces), (bump(coarse - [0.0, 0.0, 0.006], 0.008), coarse_faces))
    match = find_correspondence("Layers", *joined((upper, faces), (lower, faces)), *layers)
    own = match.faces // len(coarse_faces)
    assert (own[: len(upper)] == 0).all() and (own[len(upper) :] == 1).all()
    assert len(match.repaired) > 50
    assert len(match.doubtful) == 0


def test_neighbours_that_ride_far_apart_are_reported():
    positions, faces = sheet(40, 40, 0.4, 0.4)
    coarse, coarse_faces = sheet(20, 20, 0.4, 0.4)
    # A slit almost to the end, on whose banks nothing can follow both sides.
    x, y, _ = coarse[coarse_faces].mean(1).T
    slit = (np.abs(x - 0.2) < 0.04) & (y < 0.3)
    used, index = np.unique(coarse_faces[~slit], return_inverse=True)
    match = find_correspondence("Torn", positions, faces, coarse[used], index.reshape(-1, 3).astype(np.int32))
    x, y, _ = positions[match.doubtful].T
    assert len(x) > 20 and np.abs(x - 0.2).max() < 0.02 and y.max() < 0.3


def test_a_coarse_mesh_may_be_finer_than_the_garment():
    positions, faces = sheet(10, 10, 0.4, 0.4)
    fine, fine_faces = sheet(60, 60, 0.4, 0.4)
    match = find_correspondence("Cloth", positions, faces, fine, fine_faces)
    assert match.distance.max() < 1e-6 and len(match.doubtful) == 0
    start, members, shares = match.members()
    assert (np.diff(start) == 0).any() and np.isfinite(shares).all() and members.max() < len(positions)


def test_shares_of_fine_vertices_add_up_to_1_on_every_coarse_vertex():
    positions, faces = tube(60, 40, 0.5, 0.06)
    coarse = make_coarse_mesh("Sleeve", positions, faces, 90)
    match = find_correspondence("Coarse", positions, faces, coarse.positions, coarse.faces)
    for as_published in (False, True):
        start, _, shares = match.members(as_published=as_published)
        np.testing.assert_allclose(np.add.reduceat(shares, start[:-1]), 1.0, atol=1e-5)


def test_buttons_ride_on_the_shirt():
    shirt, faces = sheet(40, 40, 0.4, 0.4)
    button, button_faces = tube(4, 12, 0.004, 0.006)
    garment = joined((shirt, faces), (button + [0.2, 0.2, 0.01], button_faces))
    coarse = make_coarse_mesh("Shirt", *garment, 100)
    match = find_correspondence("Coarse", *garment, coarse.positions, coarse.faces)
    assert len(match.doubtful) == 0
    assert np.linalg.norm(coarse.positions[match.corners[len(shirt) :]].mean(1)[:, :2] - 0.2, axis=1).max() < 0.06


def test_a_coarse_mesh_that_cannot_carry_the_garment_is_refused_in_one_sentence():
    positions, faces = sheet(20, 20, 0.4, 0.4)
    coarse, coarse_faces = sheet(6, 6, 0.4, 0.4)
    with pytest.raises(ValueError, match="'Proxy' has no faces"):
        find_correspondence("Proxy", positions, faces, coarse, coarse_faces[:0])
    with pytest.raises(ValueError, match="not numbers"):
        find_correspondence("Proxy", positions, faces, coarse * np.nan, coarse_faces)
    with pytest.raises(ValueError, match="1 loose vertices"):
        find_correspondence("Proxy", positions, faces, np.append(coarse, [[0.0, 0.0, 0.0]], 0), coarse_faces)
    with pytest.raises(ValueError, match="72 faces without area"):
        find_correspondence("Proxy", positions, faces, coarse * 0.0, coarse_faces)
    with pytest.raises(ValueError, match=r"1\.00 m away from the garment"):
        find_correspondence("Proxy", positions, faces, coarse + [0.0, 0.0, 1.0], coarse_faces)
    with pytest.raises(ValueError, match="flip its normals"):
        find_correspondence("Proxy", positions, faces, coarse, coarse_faces[:, ::-1])
    two = joined((coarse * 0.45, coarse_faces), (coarse * 0.45 + [0.2, 0.0, 0.0], coarse_faces))
    with pytest.raises(ValueError, match="2 separate pieces and the garment 1"):
        find_correspondence("Proxy", positions, faces, *two)
