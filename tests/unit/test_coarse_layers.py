"""Garments worn over each other in the coarse simulation: the inner one stays inside."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import tube, turned
from scipy.linalg import block_diag
from wrinkle_synthesis.wrinkle_addon import coarse_contact, coarse_simulation
from wrinkle_synthesis.wrinkle_addon.coarse_simulation import CoarseLayer, CoarseSettings, CoarseSimulation

FRAME = 1.0 / 30.0


def shirt_over_trousers(gap, device="cpu"):
    """Two sleeves on one arm, the inner one ``gap`` [m] under the outer one."""
    arm = tube(40, 24, 0.6, 0.04)
    inner, outer = tube(20, 16, 0.4, 0.055), tube(16, 20, 0.3, 0.055 + gap)
    settings = CoarseSettings(buffer=0.004, pre_roll=0.3), CoarseSettings(buffer=0.01, pre_roll=0.3)
    layers = [
        CoarseLayer(name, *mesh, one)
        for name, mesh, one in zip(("Trousers", "Shirt"), (inner, outer), settings, strict=True)
    ]
    return CoarseSimulation(layers, arm[1], arm[0], device=device), arm[0], [inner[0], outer[0]]


def test_what_is_worn_underneath_stays_underneath(device):
    simulation, arm, garments = shirt_over_trousers(0.01, device)
    assert simulation.start(arm, garments).crossed == 0
    crossed = []
    for frame in range(20):
        angle = 0.8 * np.sin(2.0 * np.pi * (frame + 1) / 20.0)
        crossed.append(simulation.step(turned(arm, angle), [turned(one, angle) for one in garments], FRAME).crossed)
    # Triangles of 2 cm: of 320 vertices a few may poke through between the outer one's for a frame.
    assert max(crossed) <= 6


def test_layers_that_start_through_each_other_are_counted_and_go_on():
    simulation, arm, garments = shirt_over_trousers(-0.006)
    settle = simulation._settle
    found = []
    simulation._settle = lambda: (
        simulation._contact.find(),
        simulation._contact.launch_measure(),
        found.append(simulation._contact.crossed()),
        settle(),
    )
    report = simulation.start(arm, garments)
    assert found[0] > 100
    # The outer sleeve is the narrower one, so some of the inner one stays outside for now.
    assert report.crossed < 0.5 * found[0]
    assert np.isfinite(simulation.positions[0]).all()


def test_looking_ahead_changes_no_bit_of_layers():
    plain, arm, garments = shirt_over_trousers(0.002)
    eager, _, _ = shirt_over_trousers(0.002)
    for simulation in (plain, eager):
        simulation.start(arm, garments)
    for angle in (0.1, 0.3, 0.2):
        eager.look_ahead()
        for simulation in (plain, eager):
            simulation.step(turned(arm, angle), [turned(one, angle) for one in garments], FRAME)
        for one, other in zip(plain.positions, eager.positions, strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("away", [0.0, 200.0])
def test_what_was_closest_before_changes_nothing_that_is_found(device, away):
    """Far from the origin, too, where distances of single precision are rough."""
    simulation, arm, garments = shirt_over_trousers(0.002, device)
    simulation.start(arm + away, [one + away for one in garments])
    contact = simulation._contact
    for angle in (0.2, 0.6, -0.3):
        simulation.step(turned(arm, angle) + away, [turned(one, angle) + away for one in garments], FRAME)
        found = []
        for forget in (lambda: None, lambda: contact._pairs.closest.fill_(-1)):
            forget()
            contact.find()
            found.append(contact.frozen.pair_vertices.numpy().copy())
        assert (found[0][:, 0] != found[0][:, 1]).sum() > 100
        np.testing.assert_array_equal(*found)


def touching_layers(device, count=2):
    """The linear system of a step in which sleeves on an arm press on each other, its matrix, and a force [N]."""
    arm = tube(40, 24, 0.6, 0.04)
    sleeves = [tube(20 - 2 * number, 16, 0.4, 0.055 - 0.002 * number) for number in range(count)]
    layers = [
        CoarseLayer(f"Sleeve {number}", *mesh, CoarseSettings(buffer=0.004, pre_roll=0.1))
        for number, mesh in enumerate(sleeves)
    ]
    simulation = CoarseSimulation(layers, arm[1], arm[0], device=device)
    simulation.start(arm[0], [mesh[0] for mesh in sleeves])
    simulation.step(turned(arm[0], 0.2), [turned(mesh[0], 0.2) for mesh in sleeves], FRAME)
    system = simulation._system
    force = np.random.default_rng(7).normal(size=(1, simulation.model.vertex_count, 3))
    return system, system.to_scipy(0).toarray(), force


@pytest.mark.parametrize("count", [2, 3])
def test_layers_are_preconditioned_one_after_the_other_outwards_and_back(device, count):
    system, matrix, force = touching_layers(device, count)
    inverse = block_diag(*system._inverse.numpy()[0].astype(np.float64))
    layer = np.repeat(np.arange(count), [3 * (part.stop - part.start) for part in system._layers])
    lower = np.where(layer[:, None] > layer, matrix, 0.0)
    for outer in range(1, count):
        assert np.abs(lower[layer == outer]).max() > 100.0
    diagonal = np.zeros_like(matrix)
    for start in range(0, len(matrix), 3):
        block = slice(start, start + 3)
        diagonal[block, block] = np.linalg.inv(inverse[block, block])
    expected = np.linalg.solve((diagonal + lower).T, diagonal @ np.linalg.solve(diagonal + lower, force.ravel()))
    preconditioned = (inverse @ force.ravel()).reshape(force.shape)
    system._preconditioned.assign(preconditioned.astype(np.float32))
    system._correct()
    found = system._preconditioned.numpy().ravel()
    # Sums of some ten products in single precision.
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    assert np.abs(found - preconditioned.ravel()).max() > 0.01 * np.abs(expected).max()


def test_going_through_the_layers_saves_iterations_and_solves_the_same_system():
    system, matrix, force = touching_layers("cpu")
    gradient = wp.array(-force, dtype=wp.vec3d, device="cpu")
    iterations = []
    for layers in (system._layers, ()):
        system._layers = layers
        system.solution.zero_()
        system.launch_solve(gradient, wp.ones(1, dtype=wp.int32, device="cpu"), 1.0e-4, 500)
        iterations.append(int(system._iterations.numpy()[0]))
        residual = matrix @ system.solution.numpy().ravel().astype(np.float64) - force.ravel()
        # The tolerance is one of the preconditioned norm.
        assert np.linalg.norm(residual) < 1e-2 * np.linalg.norm(force)
    assert 1 < iterations[0] < 0.8 * iterations[1]


def test_any_number_of_threads_gives_the_same_bits(monkeypatch):
    def simulated(threads):
        for module in (coarse_simulation, coarse_contact):
            monkeypatch.setattr(module, "THREADS", threads)
        simulation, arm, garments = shirt_over_trousers(0.002)
        simulation.start(arm, garments)
        for angle in (0.1, 0.3, 0.2):
            simulation.step(turned(arm, angle), [turned(one, angle) for one in garments], FRAME)
        return simulation.positions

    for one, other in zip(simulated(1), simulated(2), strict=True):
        np.testing.assert_array_equal(one, other)
