"""The whole potential of a garment: its gradient, its Hessian, and the solver for the linear system."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import floor, free_cloth, raised, sheet, sphere
from scipy.sparse import linalg
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model


def tangled_scene(device, world_count=1):
    """Two crumpled layers on a sphere that touch it and each other, stick and slip on it, and are pinned.

    Returns the simulation with its contact found, and the positions.
    """
    rng = np.random.default_rng(4)
    layer, faces = sheet(6, 6, 0.12, 0.12)
    layer = layer - [0.06, 0.06, 0.0]
    rest = np.concatenate([layer, raised(layer, 0.05)])
    model = build_cloth_model(rest, np.concatenate([faces, faces + len(layer)]), Fabric(bending=1.0e-3))
    body, body_faces = sphere(0.2, 4)
    body = body - [0.0, 0.0, 0.2]
    pins = np.zeros(len(rest))
    pins[:3] = 5.0
    simulation = ClothSimulation(
        model,
        body_faces,
        body,
        contact_settings=ContactSettings(slip=0.001, pressure=3.0e3),
        pin_stiffness=pins,
        world_count=world_count,
        device=device,
    )
    simulation.place_pins(rest + 0.01)
    positions = []
    for world in range(world_count):
        x = np.concatenate([layer, raised(layer, 0.0022)]) * [0.97, 0.97, 1.0]
        x[:, 2] += np.sqrt(0.2**2 - (x[:, :2] ** 2).sum(1)) - 0.2 + 0.0015
        positions.append(x + (4e-4 + 1e-4 * world) * rng.normal(size=x.shape))
    positions = np.array(positions)
    # Anchors form at one place; then the layers move on, by less and by more than the slip length.
    simulation.start(positions)
    simulation._contact.find(simulation._positions, simulation._moving)
    positions[..., 0] += rng.uniform(0.0, 0.0022, size=positions.shape[:2])
    simulation._positions.assign(positions)
    find(simulation)
    return simulation, positions


def find(simulation):
    """Freeze the contact, anchors as they are."""
    simulation._contact.find(simulation._positions, simulation._none)


def potential(simulation, positions):
    """Energy with the contact as it was found last, shape [world_count]."""
    simulation._positions.assign(positions)
    return simulation._evaluate_energy()


def gradient(simulation, positions):
    simulation._positions.assign(positions)
    return simulation._evaluate_gradient().numpy().copy()


def set_inertia(simulation, positions, dt):
    simulation._set_inertia(positions + 0.003, np.full(simulation.world_count, 1.0 / dt**2))


def test_the_scene_of_these_tests_has_every_kind_of_contact(device):
    simulation, positions = tangled_scene(device)
    c = simulation._contact.frozen
    touched = c.friction_bound.numpy() > 0.0
    drift = np.linalg.norm(positions[0][:, None] - c.anchor.numpy().reshape(*positions[0].shape[:1], -1, 3), axis=2)
    weights = c.pair_weights.numpy()[: c.pair_total.numpy()[0]]
    assert touched.sum() > 20 and (weights[:, 0] == 1.0).sum() > 100 and (weights[:, 0] < 1.0).sum() > 100
    assert (drift.ravel()[touched[0]] < 0.9e-3).any() and (drift.ravel()[touched[0]] > 1.0e-3).any()


def test_gradient_of_the_whole_is_the_derivative_of_its_energy(device):
    simulation, positions = tangled_scene(device)
    set_inertia(simulation, positions, 0.02)
    exact = gradient(simulation, positions)[0]
    rng = np.random.default_rng(5)
    step = 1.0e-7
    for vertex, axis in zip(rng.integers(0, len(exact), 60), rng.integers(0, 3, 60), strict=True):
        move = np.zeros_like(positions)
        move[0, vertex, axis] = step
        difference = (potential(simulation, positions + move) - potential(simulation, positions - move))[0] / (2 * step)
        # Forces of self-contact are float32; kinks of the contact are within the step of a few vertices.
        assert exact[vertex, axis] == pytest.approx(difference, abs=2e-6 * np.abs(exact).max())


def test_hessian_of_the_whole_is_the_derivative_of_its_gradient(device):
    simulation, positions = tangled_scene(device)
    exact = simulation.hessian(positions)
    simulation._set_inertia(positions, np.zeros(1))
    rng = np.random.default_rng(6)
    # Forces of self-contact are float32: their rounding over the step is about 1e-3 of the stiffness.
    step = 1.0e-6
    error, size = [], []
    for _ in range(20):
        direction = rng.normal(size=positions.shape)
        ahead = gradient(simulation, positions + step * direction)
        behind = gradient(simulation, positions - step * direction)
        difference = (ahead - behind).ravel() / (2.0 * step)
        error.append(np.abs(exact @ direction.ravel() - difference))
        size.append(np.abs(difference))
    assert np.max(error) < 2e-3 * np.max(size)


def test_hessian_is_symmetric_and_one_row_for_each_coordinate(device):
    simulation, positions = tangled_scene(device)
    matrix = simulation.hessian(positions)
    assert matrix.shape == (3 * positions.shape[1],) * 2
    assert abs(matrix - matrix.T).max() < 1e-6 * abs(matrix).max()


def test_residual_is_minus_the_gradient_without_inertia(device):
    simulation, positions = tangled_scene(device)
    simulation._set_inertia(positions, np.zeros(1))
    assert np.array_equal(simulation.residual(positions), -gradient(simulation, positions))


def test_looking_at_the_residual_changes_nothing(device):
    simulation, positions = tangled_scene(device)
    simulation.start(positions)
    simulation.settle(1e-9, 3)
    before = simulation.state()
    simulation.residual(positions + 0.01)
    simulation.hessian(positions)
    simulation.relative_residual()
    simulation.clearance()
    after = simulation.state()
    for name in ("positions", "velocities", "anchor_faces", "anchor_weights"):
        assert np.array_equal(getattr(before, name), getattr(after, name))


@pytest.mark.parametrize(
    ("kept", "spans"),
    # The exact Hessian of this crumpled scene is positive definite for short time spans only.
    [(0.0, (0.001, 0.01, 0.05)), (1.0, (0.0003, 0.001, 0.002))],
    ids=["projected", "exact"],
)
def test_conjugate_gradients_solve_what_a_direct_solver_solves(device, kept, spans):
    simulation, positions = tangled_scene(device, world_count=3)
    system = simulation._system
    # Worlds of very different conditioning, so that they end after different numbers of iterations.
    simulation._set_inertia(positions + 0.003, 1.0 / np.array(spans) ** 2)
    right = gradient(simulation, positions)
    simulation._kept.fill_(kept)
    simulation._linearise()
    system.solve(simulation._gradient, simulation._moving, 1.0e-6, 2000)
    iterations = system._iterations.numpy()
    assert len(set(iterations)) == 3 and iterations.max() < 2000
    for world in range(3):
        matrix = system.to_scipy(world)
        expected = -linalg.spsolve(matrix.tocsc(), right[world].ravel()).reshape(-1, 3)
        found = system.solution.numpy()[world]
        # float32 matrix, vectors and step lengths.
        assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()


def test_the_product_is_that_of_the_exported_matrix(device):
    simulation, positions = tangled_scene(device, world_count=2)
    system = simulation._system
    set_inertia(simulation, positions, 0.01)
    gradient(simulation, positions)
    simulation._linearise()
    direction = np.random.default_rng(8).normal(size=positions.shape)
    product = wp.zeros(positions.shape[:2], dtype=wp.vec3, device=device)
    system.multiply(wp.array(direction.astype(np.float32), dtype=wp.vec3, device=device), product)
    for world in range(2):
        expected = (system.to_scipy(world) @ direction[world].ravel()).reshape(-1, 3)
        # float32 sums of a few dozen terms.
        assert np.abs(product.numpy()[world] - expected).max() < 1e-5 * np.abs(expected).max()


def test_a_world_that_rests_takes_no_step(device):
    simulation, positions = tangled_scene(device, world_count=3)
    set_inertia(simulation, positions, 0.01)
    gradient(simulation, positions)
    simulation._moving.assign(np.array([1, 0, 1], np.int32))
    system = simulation._system
    simulation._linearise()
    system.solve(simulation._gradient, simulation._moving, 1.0e-3, 100)
    sizes = np.abs(system.solution.numpy()).max((1, 2))
    assert sizes[1] == 0.0 and sizes[0] > 0.0 and sizes[2] > 0.0


def test_an_indefinite_system_ends_in_a_step_that_goes_downhill(device):
    # A sheet that is pressed together in its plane buckles: its Hessian has negative eigenvalues.
    rest, faces = sheet(8, 8, 0.2, 0.2)
    rng = np.random.default_rng(7)
    simulation = free_cloth(build_cloth_model(rest, faces, Fabric()), device=device)
    simulation.start(0.9 * rest + 1e-4 * rng.normal(size=rest.shape))
    assert linalg.eigsh(simulation.hessian(), 1, which="SA")[0][0] < 0.0
    find(simulation)
    simulation._set_inertia(simulation.positions, np.zeros(1))
    simulation._kept.fill_(1.0)
    slope = simulation._evaluate_gradient().numpy().copy()
    simulation._newton_step()
    assert (slope * simulation._system.solution.numpy()).sum() < 0.0


def test_pairs_beyond_the_room_that_was_made_are_kept(device):
    # Two fine layers right on each other have many times more pairs than vertices.
    layer, faces = sheet(14, 14, 0.014, 0.014)
    rest = np.concatenate([layer, raised(layer, 0.05)])
    model = build_cloth_model(rest, np.concatenate([faces, faces + len(layer)]), Fabric())
    body, body_faces = floor(-1.0)
    simulation = ClothSimulation(
        model, body_faces, body, solver_settings=SolverSettings(linear_iterations=20), device=device
    )
    room = len(simulation._contact.frozen.pair_strength)
    simulation.set_gravity(np.zeros(3))
    simulation.start(np.concatenate([layer, raised(layer, 0.002)]))
    before = simulation.relative_residual()[0]
    report = simulation.settle(0.1, 40)
    assert simulation._contact.frozen.incident_count.numpy().max() > 8
    assert len(simulation._contact.frozen.pair_strength) > room
    assert report.residual < 0.01 * before
