"""Coarse meshes made from garments: even, true to borders and layers, at any number of vertices."""

import numpy as np
import pytest
from cloth_shapes import sheet, sphere, tube
from wrinkle_synthesis.wrinkle_addon.coarse_mesh import COUNT_TOLERANCE, make_coarse_mesh
from wrinkle_synthesis.wrinkle_addon.garment import bind_to_surface
from wrinkle_synthesis.wrinkle_addon.topology import border_edges, connected_parts, mesh_edges


def joined(*parts):
    first = np.cumsum([0] + [len(positions) for positions, _ in parts])
    faces = [faces + start for (_, faces), start in zip(parts, first[:-1], strict=True)]
    return np.concatenate([positions for positions, _ in parts]), np.concatenate(faces)


def pieces(faces):
    return len(np.unique(connected_parts(mesh_edges(faces)[0], faces.max() + 1)))


def euler(mesh):
    return len(mesh.positions) - len(mesh_edges(mesh.faces)[0]) + len(mesh.faces)


def face_normals(positions, faces):
    a, b, c = (positions[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def fold(gap, length=0.3, width=0.3, columns=90, rows=40):
    """A sheet folded over itself, its two layers ``gap`` apart [m]."""
    positions, faces = sheet(columns, rows, 2.0 * length, width)
    along, radius = positions[:, 0].copy(), 0.5 * gap
    flat = length - 0.5 * np.pi * radius
    angle = np.clip((along - flat) / radius, 0.0, np.pi)
    beyond = np.maximum(along - flat - np.pi * radius, 0.0)
    positions[:, 0] = np.minimum(along, flat) + radius * np.sin(angle) - beyond
    positions[:, 2] = radius * (1.0 - np.cos(angle))
    return positions, faces


@pytest.mark.parametrize("count", [60, 200, 700])
def test_the_count_is_met_on_a_mesh_of_any_size(count):
    positions, faces = tube(61, 40, 0.5, 0.06)
    mesh = make_coarse_mesh("Sleeve", positions, faces, count)
    assert abs(len(mesh.positions) / count - 1.0) <= COUNT_TOLERANCE


def test_a_coarse_mesh_is_a_manifold_that_faces_as_the_garment_does():
    positions, faces = tube(60, 40, 0.5, 0.06)
    mesh = make_coarse_mesh("Sleeve", positions, faces, 120)
    assert euler(mesh) == 0 and pieces(mesh.faces) == 1
    directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)
    outward = mesh.positions[mesh.faces].mean(1) * [0.0, 1.0, 1.0]
    assert ((face_normals(mesh.positions, mesh.faces) * outward).sum(1) > 0.0).all()


def test_triangles_are_even():
    positions, faces = sphere(0.3, 4)
    mesh = make_coarse_mesh("Ball", positions, faces, 300)
    corners = mesh.positions[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    quality = 4.0 * np.sqrt(3.0) * area / (sides**2).sum(1)
    # Isotropic remeshing keeps edges within its own thresholds, 4/5 and 4/3, but for a few.
    assert sides.min() > 0.6 * sides.mean() and sides.max() < 1.5 * sides.mean()
    assert quality.min() > 0.6 and np.median(quality) > 0.95


def test_vertices_lie_on_the_garment():
    positions, faces = sphere(0.3, 4)
    mesh = make_coarse_mesh("Ball", positions, faces, 300)
    # Single precision of closest points on triangles of a third of a metre.
    assert np.abs(bind_to_surface(mesh.positions, positions, faces).distance).max() < 1e-6


def test_a_sheet_keeps_its_corners_and_its_borders():
    positions, faces = sheet(50, 30, 0.5, 0.3)
    mesh = make_coarse_mesh("Sheet", positions, faces, 60)
    for corner in [(0.0, 0.0), (0.5, 0.0), (0.0, 0.3), (0.5, 0.3)]:
        assert np.linalg.norm(mesh.positions[:, :2] - corner, axis=1).min() < 1e-9
    border = np.unique(border_edges(mesh.faces))
    x, y = mesh.positions[border, :2].T
    assert np.minimum.reduce([x, 0.5 - x, y, 0.3 - y]).max() < 1e-9
    corners = mesh.positions[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert area.sum() == pytest.approx(0.15, rel=1e-9)


def test_cuffs_stay_round():
    positions, faces = tube(60, 40, 0.5, 0.06)
    mesh = make_coarse_mesh("Sleeve", positions, faces, 120)
    x, y, z = mesh.positions[np.unique(border_edges(mesh.faces))].T
    np.testing.assert_allclose(np.abs(x), 0.25, atol=1e-9)
    # On the chords of the garment's own forty corners.
    assert np.hypot(y, z).min() > 0.06 * np.cos(np.pi / 40) - 1e-9
    ring = np.sort(np.arctan2(z, y)[x > 0.0])
    assert np.diff(np.append(ring, ring[0] + 2.0 * np.pi)).max() < 2.0 * np.pi / 6.0


def test_pieces_that_lie_on_each_other_do_not_grow_together():
    upper, faces = sheet(40, 40, 0.4, 0.4)
    lower = upper - [0.0, 0.0, 0.001]
    mesh = make_coarse_mesh("Layers", *joined((upper, faces), (lower, faces)), 150)
    assert pieces(mesh.faces) == 2
    height = mesh.positions[mesh.faces, 2]
    assert (np.ptp(height, axis=1) < 1e-6).all()
    assert np.sum(height.mean(1) < -0.0005) == pytest.approx(0.5 * len(height), rel=0.2)


@pytest.mark.parametrize("gap", [0.04, 0.01, 0.004])
def test_a_fold_keeps_its_end_and_its_layers_apart(gap):
    positions, faces = fold(gap)
    mesh = make_coarse_mesh("Fold", positions, faces, 200)
    assert euler(mesh) == 1
    # No edge is as long as the way from layer to layer is where they are far from the end, and none cuts it off.
    distance = np.abs(bind_to_surface(positions, mesh.positions, mesh.faces).distance)
    assert distance.max() < 0.75 * mesh.edge_length


def test_a_sleeve_with_thickness_keeps_its_ends():
    outer, faces = tube(60, 40, 0.5, 0.06)
    inner, count = tube(60, 40, 0.5, 0.058)[0], len(outer)
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    rim = edges[~np.isin(edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0])]
    a, b = rim.T
    walls = [np.stack([b, a, a + count], 1), np.stack([b, a + count, b + count], 1)]
    shell = np.concatenate([faces, faces[:, ::-1] + count, *walls]).astype(np.int32)
    mesh = make_coarse_mesh("Sleeve", np.concatenate([outer, inner]), shell, 300)
    assert euler(mesh) == 0 and len(border_edges(mesh.faces)) == 0
    np.testing.assert_allclose([mesh.positions[:, 0].min(), mesh.positions[:, 0].max()], [-0.25, 0.25], atol=0.002)


def test_small_pieces_are_left_out():
    shirt = sheet(40, 40, 0.4, 0.4)
    button, faces = sphere(0.006, 2)
    mesh = make_coarse_mesh("Shirt", *joined(shirt, (button + [0.2, 0.2, 0.01], faces)), 100)
    assert pieces(mesh.faces) == 1 and np.abs(mesh.positions[:, 2]).max() < 1e-9


def test_the_same_garment_gives_the_same_bits():
    positions, faces = tube(40, 30, 0.4, 0.06)
    first, second = (make_coarse_mesh("Sleeve", positions, faces, 80) for _ in range(2))
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.faces, second.faces)


def test_what_cannot_be_meshed_is_refused_in_one_sentence():
    positions, faces = sheet(20, 20, 0.4, 0.4)
    with pytest.raises(ValueError, match="'Shirt' has no faces"):
        make_coarse_mesh("Shirt", positions, faces[:0])
    with pytest.raises(ValueError, match="not numbers"):
        make_coarse_mesh("Shirt", np.where(positions > 0.39, np.nan, positions), faces, 100)
    with pytest.raises(ValueError, match="from 24 to 440 vertices, not 441"):
        make_coarse_mesh("Shirt", positions, faces, 441)
    flipped = faces.copy()
    flipped[7] = flipped[7, ::-1]
    with pytest.raises(ValueError, match="face opposite ways; recalculate its normals"):
        make_coarse_mesh("Shirt", positions, flipped, 100)
    other = sheet(20, 20, 0.4, 0.4)
    touching = np.where(other[1] == 0, 0, other[1] + len(positions))
    used, index = np.unique(np.concatenate([faces, touching]), return_inverse=True)
    both = np.concatenate([positions, other[0] * [-1.0, -1.0, 1.0]])[used]
    with pytest.raises(ValueError, match="1 vertices at which open borders touch"):
        make_coarse_mesh("Shirt", both, index.reshape(-1, 3).astype(np.int32), 100)
