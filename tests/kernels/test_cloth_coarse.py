"""The coarse correction of the linear solver against dense matrices, and what it is there for."""

import numpy as np
import warp as wp
from cloth_shapes import NO_TOUCH, floor, free_cloth, raised, sheet, tube
from scipy import sparse
from scipy.sparse import csgraph
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.coarse_correction import _positive_inverse
from wrinkle_synthesis.wrinkle_addon.coarse_space import aggregate, coarse_levels

LEVER = 0.01


def two_parts():
    """A tube and a sheet that lies inside it, in one garment of two parts."""
    around, faces = tube(20, 18, 0.3, 0.05)
    inside, inner = sheet(6, 6, 0.1, 0.06)
    return np.concatenate([around, inside]), np.concatenate([faces, inner + len(around)])


def crumpled(device, world_count=1):
    """A free garment of two parts, linearised at crumpled positions."""
    rest, faces = two_parts()
    rng = np.random.default_rng(4)
    model = build_cloth_model(rest, faces, Fabric())
    simulation = free_cloth(model, device=device, world_count=world_count)
    positions = rest + 5.0e-4 * rng.normal(size=(world_count, *rest.shape))
    simulation.start(positions)
    simulation._contact.find(simulation._positions, simulation._none)
    simulation._set_inertia(positions, np.full(world_count, 1.0 / 0.05**2))
    simulation._evaluate_gradient()
    simulation._linearise()
    return simulation, positions


def rigid_motions(points, centres, node):
    """Dense matrix from nodes' motions to points' displacements, as coarse.py describes them."""
    motions = np.zeros((3 * len(points), 6 * len(centres)))
    for i, (point, k) in enumerate(zip(points, node, strict=True)):
        x, y, z = (point - centres[k]) / LEVER
        motions[3 * i : 3 * i + 3, 6 * k : 6 * k + 3] = np.eye(3)
        motions[3 * i : 3 * i + 3, 6 * k + 3 : 6 * k + 6] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return motions


def dense_of_first(system, world):
    """Matrix of the first coarse level, dense."""
    level, _ = coarse_levels(system._model)
    blocks = system._correction._matrix.numpy()[world]
    return sparse.bsr_matrix((blocks, level.columns, level.row_start), shape=(6 * level.count,) * 2).toarray()


# --- groups of vertices -------------------------------------------------------------------------------------------


def test_groups_hold_every_vertex_once_and_are_connected():
    rest, faces = two_parts()
    model = build_cloth_model(rest, faces, Fabric())
    node = aggregate(rest, model.row_start, model.columns, 24)
    assert np.array_equal(np.unique(node), np.arange(node.max() + 1))
    rows = np.repeat(np.arange(len(rest)), np.diff(model.row_start))
    inside = node[rows] == node[model.columns]
    graph = sparse.coo_matrix((np.ones(inside.sum()), (rows[inside], model.columns[inside])))
    assert csgraph.connected_components(graph)[0] == node.max() + 1


def test_a_part_without_a_seed_of_its_own_gets_one():
    rest, faces = two_parts()
    model = build_cloth_model(rest, faces, Fabric())
    assert aggregate(rest, model.row_start, model.columns, 1).max() + 1 == 2


def test_groups_are_of_like_size():
    rest, faces = sheet(40, 40, 0.4, 0.4)
    model = build_cloth_model(rest, faces, Fabric())
    sizes = np.bincount(coarse_levels(model)[0].node)
    # Seeds that are farthest from each other are at least a radius apart: areas differ by a factor of four or so.
    assert sizes.min() >= 4 and sizes.max() <= 40


# --- the matrices -------------------------------------------------------------------------------------------------


def test_the_first_level_is_the_matrix_between_rigid_motions(device):
    simulation, positions = crumpled(device, world_count=2)
    system = simulation._system
    level, _ = coarse_levels(system._model)
    for world in range(2):
        points = positions[world]
        centres = np.stack([np.bincount(level.node, axis) for axis in points.T], 1)
        centres /= np.bincount(level.node)[:, None]
        motions = rigid_motions(points, centres, level.node)
        expected = motions.T @ (system.to_scipy(world) @ motions)
        # Blocks are float32, and rigid motions cancel most of what they hold.
        assert np.abs(dense_of_first(system, world) - expected).max() < 1e-5 * np.abs(expected).max()


def test_the_second_level_is_the_matrix_between_rigid_motions_of_the_first(device):
    simulation, _ = crumpled(device)
    system = simulation._system
    correction = system._correction
    _, level = coarse_levels(system._model)
    fine, whole = correction._first.centre.numpy()[0], correction._second.centre.numpy()[0]
    up = np.zeros((6 * len(fine), 6 * len(whole)))
    moved = rigid_motions(fine, whole, level.node)
    for i, k in enumerate(level.node):
        up[6 * i : 6 * i + 3] = moved[3 * i : 3 * i + 3]
        up[6 * i + 3 : 6 * i + 6, 6 * k + 3 : 6 * k + 6] = np.eye(3)
    first = dense_of_first(system, 0)
    for k in range(0, len(first), 6):
        first[k : k + 6, k : k + 6] += 1.0e-6 * first[k : k + 6, k : k + 6].trace() * np.eye(6)
    expected = up.T @ first @ up
    assert np.abs(correction._dense.numpy()[0] - expected).max() < 1e-12 * np.abs(expected).max()


def test_inverse_by_halves_is_the_inverse():
    rng = np.random.default_rng(5)
    root = rng.normal(size=(2, 300, 300))
    matrices = root @ root.transpose(0, 2, 1) + 10.0 * np.eye(300)
    assert np.abs(_positive_inverse(matrices) @ matrices - np.eye(300)).max() < 1e-4


def test_the_correction_is_symmetric_and_positive(device):
    simulation, positions = crumpled(device)
    correction = simulation._system._correction
    rng = np.random.default_rng(6)

    def corrected(residual):
        preconditioned = wp.zeros(positions.shape[:2], dtype=wp.vec3, device=device)
        correction.add(wp.array(residual, dtype=wp.vec3, device=device), preconditioned)
        return preconditioned.numpy().astype(np.float64)

    for _ in range(5):
        a, b = rng.normal(size=(2, *positions.shape)).astype(np.float32)
        across, back, along = (b * corrected(a)).sum(), (a * corrected(b)).sum(), (a * corrected(a)).sum()
        assert along > 0.0
        # Vertices are float32.
        assert abs(across - back) < 1e-5 * along


# --- what it is there for -----------------------------------------------------------------------------------------


def iterations_of(cells, device):
    """Iterations that a hanging strip of so many cells takes for its first step to equilibrium."""
    rest, faces = sheet(4 * cells, cells, 0.4, 0.1)
    model = build_cloth_model(rest, faces, Fabric())
    body, body_faces = floor(-10.0)
    pins = np.where(rest[:, 0] < 1e-9, 1.0e3, 0.0)
    simulation = ClothSimulation(
        model,
        body_faces,
        body,
        pin_stiffness=pins,
        contact_settings=NO_TOUCH,
        device=device,
        solver_settings=SolverSettings(linear_tolerance=1e-2, linear_iterations=2000),
    )
    simulation.place_pins(rest)
    simulation.start(raised(rest, 0.0))
    simulation._contact.find(simulation._positions, simulation._none)
    simulation._set_inertia(rest[None], np.full(1, 1.0 / 0.1**2))
    simulation._evaluate_gradient()
    simulation._linearise()
    system = simulation._system
    return system.solve(simulation._gradient, simulation._moving, 1e-4, 3000)


def test_a_finer_mesh_takes_few_more_iterations(device):
    coarse_mesh, fine_mesh = iterations_of(8, device), iterations_of(24, device)
    # Nine times the vertices; without the correction the iterations grow with a mesh's length in edges or faster.
    assert fine_mesh < 2.0 * coarse_mesh, (coarse_mesh, fine_mesh)
