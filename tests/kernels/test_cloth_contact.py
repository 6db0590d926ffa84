"""Pairs of the garment that touch each other, against brute force."""

import numpy as np
import pytest
from cloth_shapes import NO_TOUCH, closest_point, raised, sheet, sphere
from wrinkle_synthesis.kernels.cloth import self_contact
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.topology import mesh_edges

# Kernels look in float32 at lengths up to 1 m: 1 micrometre leaves room for a few roundings.
FLOAT32 = 1.0e-6


def closest_distance_of_edges(p, q):
    """Distance of two segments, and whether both closest points lie between the ends: ends and inside, in float64."""
    ends = []
    for point, (start, end) in ((p[0], q), (p[1], q), (q[0], p), (q[1], p)):
        t = np.clip((point - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
        ends.append(np.linalg.norm(point - start - t * (end - start)))
    between, *_ = np.linalg.lstsq(np.stack([p[1] - p[0], q[0] - q[1]], 1), q[0] - p[0], rcond=None)
    inside = bool((between > 0.0).all() and (between < 1.0).all())
    if inside:
        ends.append(np.linalg.norm(p[0] + between[0] * (p[1] - p[0]) - q[0] - between[1] * (q[1] - q[0])))
    return min(ends), inside


def crumpled_layers(device, thickness):
    """Two crumpled layers near each other, on a mesh much finer than the thickness: a vertex touches many triangles.

    Returns the rest and present positions, the faces and the frozen contact.
    """
    rng = np.random.default_rng(3)
    layer, faces = sheet(12, 12, 0.02, 0.02)
    rest = np.concatenate([layer, raised(layer, 0.05)])
    both = np.concatenate([faces, faces + len(layer)])
    x = np.concatenate([layer, raised(layer, 0.0015)]) + 2e-4 * rng.normal(size=rest.shape)
    model = build_cloth_model(rest, both, Fabric())
    body, body_faces = sphere(0.1, 0)
    settings = ContactSettings(self_thickness=thickness)
    simulation = ClothSimulation(model, body_faces, raised(body, 5.0), contact_settings=settings, device=device)
    simulation.start(x)
    simulation._contact.find(simulation._positions, simulation._moving)
    return rest, x, both, simulation._contact.frozen


def pairs_of(frozen):
    """Vertices and signed weights of every pair, those of vertex and triangle first."""
    total = frozen.pair_total.numpy()[0]
    return frozen.pair_vertices.numpy()[:total], frozen.pair_weights.numpy()[:total]


def test_every_vertex_triangle_pair_within_reach_is_found_once_and_in_order(device):
    thickness = 0.003
    rest, x, both, frozen = crumpled_layers(device, thickness)
    vertices, weights = pairs_of(frozen)
    near = weights[:, 0] == 1.0
    triangle_of = {tuple(face): i for i, face in enumerate(both)}
    triangle = np.array([triangle_of[tuple(v[1:])] for v in vertices[near]])
    owner = vertices[near, 0]
    assert (np.diff(owner * len(both) + triangle) > 0).all()
    reach = self_contact.REACH_THICKNESSES * thickness
    for vertex in range(0, len(x), 17):
        distance = np.array([np.linalg.norm(x[vertex] - closest_point(x[vertex], t)) for t in x[both]])
        apart = np.array([np.linalg.norm(rest[vertex] - closest_point(rest[vertex], t)) for t in rest[both]])
        expected = (distance < reach - FLOAT32) & (apart > self_contact.REST_THICKNESSES * thickness)
        found = triangle[owner == vertex]
        assert set(np.flatnonzero(expected)) <= set(found)
        assert (distance[found] < reach + FLOAT32).all()
    assert np.bincount(owner).max() > 25


def test_every_crossing_pair_of_edges_within_reach_is_found_once_and_in_order(device):
    thickness = 0.003
    rest, x, both, frozen = crumpled_layers(device, thickness)
    vertices, weights = pairs_of(frozen)
    crossing = weights[:, 0] < 1.0
    edges, _ = mesh_edges(both)
    edge_of = {tuple(edge): i for i, edge in enumerate(edges)}
    first = np.array([edge_of[tuple(v[:2])] for v in vertices[crossing]])
    second = np.array([edge_of[tuple(v[2:])] for v in vertices[crossing]])
    assert (first < second).all()
    assert (np.diff(first * len(edges) + second) > 0).all()
    reach, rest_reach = (s * thickness for s in (self_contact.REACH_THICKNESSES, self_contact.REST_THICKNESSES))
    for edge in range(0, len(edges), 131):
        found = set(second[first == edge])
        for other in range(edge + 1, len(edges)):
            distance, inside = closest_distance_of_edges(x[edges[edge]], x[edges[other]])
            if inside and distance < reach - FLOAT32:
                apart, _ = closest_distance_of_edges(rest[edges[edge]], rest[edges[other]])
                # A pair that fades to nothing may be left out.
                assert apart <= rest_reach or other in found or faded(x[edges[edge]], x[edges[other]])
            else:
                assert other not in found or distance < reach + FLOAT32
    points = np.einsum("pc,pcd->pd", weights[crossing], x[vertices[crossing]])
    normal = frozen.pair_normal.numpy()[: len(weights)][crossing]
    assert np.abs(points - np.linalg.norm(points, axis=1)[:, None] * normal).max() < FLOAT32


def faded(p, q):
    """Whether two edges cross so near an end, or so nearly parallel, that rounding decides on their pair."""
    between, *_ = np.linalg.lstsq(np.stack([p[1] - p[0], q[0] - q[1]], 1), q[0] - p[0], rcond=None)
    sine = np.linalg.norm(np.cross(p[1] - p[0], q[1] - q[0]))
    sine /= np.linalg.norm(p[1] - p[0]) * np.linalg.norm(q[1] - q[0])
    return bool(min(between.min(), 1.0 - between.max()) < 1e-3 or sine < 2e-3)


def test_each_pair_is_in_the_lists_of_its_four_vertices_in_order(device):
    _rest, x, _both, frozen = crumpled_layers(device, 0.003)
    vertices, weights = pairs_of(frozen)
    assert np.abs(weights.sum(1)).max() < 1e-6
    begin, size, incident = frozen.incident_start.numpy(), frozen.incident_count.numpy(), frozen.incident.numpy()
    assert size.sum() == vertices.size
    owner = np.repeat(np.arange(len(x)), size)
    listed = np.concatenate([incident[b : b + s] for b, s in zip(begin, size, strict=True)])
    assert np.array_equal(np.sort(listed), np.arange(vertices.size))
    assert np.array_equal(vertices[listed // 4, listed % 4], owner)
    assert (np.diff(listed)[np.diff(owner) == 0] > 0).all()


def test_neighbours_in_the_rest_shape_never_touch(device):
    layer, faces = sheet(8, 8, 0.016, 0.016)
    model = build_cloth_model(layer, faces, Fabric())
    body, body_faces = sphere(0.1, 0)
    simulation = ClothSimulation(model, body_faces, raised(body, 5.0), device=device)
    simulation.start(0.9 * layer)
    simulation._contact.find(simulation._positions, simulation._moving)
    vertices, weights = pairs_of(simulation._contact.frozen)
    apart = [
        np.linalg.norm(layer[v[0]] - closest_point(layer[v[0]], layer[v[1:]]))
        if w[0] == 1.0
        else closest_distance_of_edges(layer[v[:2]], layer[v[2:]])[0]
        for v, w in zip(vertices, weights, strict=True)
    ]
    assert min(apart, default=1.0) > self_contact.REST_THICKNESSES * 0.003


def test_an_edge_that_falls_across_another_is_held(device):
    """Two crossed strips of two triangles each: no vertex of one ever comes near a triangle of the other."""
    strip = np.array([[-0.1, -0.01, 0.0], [0.1, -0.01, 0.0], [0.1, 0.01, 0.0], [-0.1, 0.01, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    across = strip[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    rest = np.concatenate([strip, raised(across, 0.05)])
    model = build_cloth_model(rest, np.concatenate([faces, faces + 4]), Fabric())
    body, body_faces = sphere(0.1, 0)
    pins = np.where(np.arange(8) < 4, 1.0e4, 0.0)
    simulation = ClothSimulation(model, body_faces, raised(body, -5.0), pin_stiffness=pins, device=device)
    simulation.place_pins(rest)
    simulation.start(np.concatenate([strip, raised(across, 0.004)]))
    for _ in range(60):
        simulation.step(raised(body, -5.0), 1.0 / 60.0)
    lowest = simulation.positions[0][4:, 2].min()
    assert 0.0 < lowest < 0.003


def test_self_contact_can_be_left_out(device):
    layer, faces = sheet(2, 2, 0.02, 0.02)
    rest = np.concatenate([layer, raised(layer, 0.05)])
    model = build_cloth_model(rest, np.concatenate([faces, faces + len(layer)]), Fabric())
    body, body_faces = sphere(0.1, 0)
    far = raised(body, 5.0)
    simulation = ClothSimulation(model, body_faces, far, contact_settings=NO_TOUCH, device=device)
    simulation.set_gravity([0.0, 0.0, 0.0])
    simulation.start(np.concatenate([layer, raised(layer, 0.001)]))
    assert simulation.relative_residual()[0] == pytest.approx(0.0, abs=1e-9)
