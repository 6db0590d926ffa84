"""Time steps of the cloth simulation: their order, measured, and what they keep of a motion."""

import numpy as np
import pytest
from cloth_shapes import floor, free_cloth, sheet
from wrinkle_synthesis.wrinkle_addon.cloth import STANDARD_GRAVITY, ClothState, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.time_integration import EarlierStep

G = np.array([0.0, 0.0, -STANDARD_GRAVITY])
FAR = floor(-100.0)[0]


def exact(order):
    """Settings that leave no error but that of the time steps."""
    return SolverSettings(order=order, linear_tolerance=1.0e-6, linear_iterations=3000, newton_iterations=4)


def still_cloth(order, device, cells=3, **settings):
    """A small sheet without gravity, far from any body; returns the simulation and the rest shape."""
    rest, faces = sheet(cells, cells, 0.1, 0.1)
    simulation = free_cloth(
        build_cloth_model(rest, faces, Fabric()), solver_settings=exact(order), device=device, **settings
    )
    simulation.set_gravity(np.zeros(3))
    return simulation, rest


def measured_order(errors):
    """Slope of the error over the step between the two finest of a row of halved steps."""
    return np.log2(errors[-2] / errors[-1])


def test_bdf2_falls_along_the_parabola(device):
    """A quadratic is what BDF2 is exact for, once it has two points to look back to."""
    simulation, rest = still_cloth(2, device)
    simulation.set_gravity(G)
    throw, dt, steps = np.array([0.3, -0.2, 1.0]), 1.0 / 60.0, 12

    def thrown(time):
        return (rest + time * throw + 0.5 * time**2 * G)[None], np.tile(throw + time * G, (1, len(rest), 1))

    simulation.start(rest)
    fresh = simulation.state()
    earlier = EarlierStep(*thrown(-dt), dt)
    simulation.restore(ClothState(*thrown(0.0), fresh.anchor_faces, fresh.anchor_weights, earlier))
    for _ in range(steps):
        simulation.step(FAR, dt)
    # The linear system is solved in float32 to one millionth of each step.
    assert np.abs(simulation.positions - thrown(steps * dt)[0]).max() < 1e-8


def test_bdf2_starts_with_a_step_of_backward_euler(device):
    """Which falls g dt^2 / 2 too far; of that remains 3/4 g dt^2, and the velocity is exact."""
    simulation, rest = still_cloth(2, device)
    simulation.set_gravity(G)
    simulation.start(rest)
    dt, steps = 1.0 / 60.0, 12
    for _ in range(steps):
        simulation.step(FAR, dt)
    time = steps * dt
    fallen = rest + 0.5 * time**2 * G + 0.75 * (1.0 - 3.0**-steps) * dt**2 * G
    assert np.abs(simulation.positions[0] - fallen).max() < 1e-8
    assert np.abs(simulation.state().velocities - time * G).max() < 1e-6


@pytest.mark.parametrize("order", [1, 2], ids=["backward Euler", "BDF2"])
@pytest.mark.parametrize("uneven", [1.0, 2.0], ids=["even", "uneven"])
def test_an_oscillator_is_followed_to_the_order_promised(device, order, uneven):
    """x = a cos(omega t): pins of stiffness m omega^2 on every vertex; ``uneven`` is each other step's length."""
    frequency, offset, period = 2.0 * np.pi, np.array([0.02, 0.0, 0.05]), 1.0
    errors = []
    for steps in (40, 80, 160, 320):
        mass = build_cloth_model(*sheet(3, 3, 0.1, 0.1), Fabric()).mass
        simulation, rest = still_cloth(order, device, pin_stiffness=mass * frequency**2)
        simulation.place_pins(rest)
        simulation.start(rest + offset)
        lengths = np.tile([1.0, uneven], steps // 2)
        for dt in period * lengths / lengths.sum():
            simulation.step(FAR, dt)
        errors.append(np.abs(simulation.positions[0] - rest - offset).max() / 0.05)
    # The next term of the error is some per cent of the leading one at these steps.
    assert measured_order(errors) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("order", [1, 2], ids=["backward Euler", "BDF2"])
def test_a_plucked_strip_is_followed_to_the_order_promised(device, order):
    """Against its modes: the exact motion of the same masses on the same Hessian, for a small swing."""
    from scipy import linalg

    columns, rows, length, tension = 12, 2, 0.3, 0.1
    rest, faces = sheet(columns, rows, length, 0.05)
    model = build_cloth_model(rest, faces, Fabric(stretch=20.0, poisson=0.0, stiffening=0.0))
    ends = (rest[:, 0] < 1e-9) | (rest[:, 0] > length - 1e-9)
    simulation = free_cloth(
        model, pin_stiffness=np.where(ends, 1.0e3, 0.0), solver_settings=exact(order), device=device
    )
    simulation.set_gravity(np.zeros(3))
    taut = rest * [1.0 + tension, 1.0, 1.0]
    simulation.place_pins(taut)
    simulation.start(taut)
    simulation.settle(1e-6, 40)
    taut = simulation.positions[0]
    mass = np.repeat(model.mass, 3)
    scale = 1.0 / np.sqrt(mass)
    squares, modes = linalg.eigh(simulation.hessian().toarray() * scale[:, None] * scale)
    # The first three shapes across the sheet's plane; higher ones die in either scheme, swift ones in no time.
    out_of_plane = np.flatnonzero(np.linalg.norm(modes[2::3], axis=0) > 0.99)[:3]
    modes, frequencies = scale[:, None] * modes[:, out_of_plane], np.sqrt(squares[out_of_plane])
    swing = modes[:, 0] + 0.2 * modes[:, 1] + 0.1 * modes[:, 2]
    # So small that stretching by the swing itself, which is of second order, does not show.
    size = 1.0e-6 / np.abs(swing).max()
    time = 1.25 * 2.0 * np.pi / frequencies[0]
    shares = np.array([1.0, 0.2, 0.1]) * np.cos(frequencies * time)
    errors = []
    for steps in (50, 100, 200, 400):
        simulation.start(taut + size * swing.reshape(-1, 3))
        for _ in range(steps):
            simulation.step(FAR, time / steps)
        moved = (simulation.positions[0] - taut).ravel()
        errors.append(np.abs(moved - size * modes @ shares).max() / 1.0e-6)
    assert measured_order(errors) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize("order", [1, 2], ids=["backward Euler", "BDF2"])
def test_linear_momentum_is_kept(device, order):
    """Of a crumpled sheet that springs back while it flies: inner forces have no sum."""
    simulation, rest = still_cloth(order, device, cells=6)
    rng = np.random.default_rng(5)
    velocity = np.array([0.3, -0.2, 0.4])
    simulation.start(rest + 5e-4 * rng.normal(size=rest.shape), velocity + 0.1 * rng.normal(size=rest.shape))
    mass = simulation.model.mass[:, None]
    before = (mass * simulation.state().velocities[0]).sum(0)
    for _ in range(20):
        simulation.step(FAR, 1.0 / 120.0)
    after = (mass * simulation.state().velocities[0]).sum(0)
    # The steps are solved to about one part in a million.
    assert np.abs(after - before).max() < 1e-5 * np.linalg.norm(before)


def test_inner_forces_turn_nothing(device):
    """Any shape: the forces of stretching and bending have neither sum nor moment, to their rounding."""
    simulation, rest = still_cloth(1, device, cells=6)
    crumpled = rest + 5e-3 * np.random.default_rng(6).normal(size=rest.shape)
    force = simulation.residual(crumpled)[0]
    arms = crumpled - crumpled.mean(0)
    assert np.abs(force.sum(0)).max() < 1e-12 * np.abs(force).sum()
    assert np.abs(np.cross(arms, force).sum(0)).max() < 1e-12 * np.abs(np.cross(arms, force)).sum()


def turning_lost(order, device, spin, turns, steps):
    """Share of its angular momentum that a sheet loses while it turns about its normal [1], at ``spin`` [rad/s]."""
    simulation, rest = still_cloth(order, device)
    rest = rest - rest.mean(0)
    simulation.start(rest, np.cross([0.0, 0.0, spin], rest))
    mass = simulation.model.mass[:, None]

    def momentum():
        return (mass * np.cross(simulation.positions[0], simulation.state().velocities[0])).sum(0)[2]

    before = momentum()
    for _ in range(steps):
        simulation.step(FAR, turns * 2.0 * np.pi / spin / steps)
    return 1.0 - momentum() / before


def test_a_turning_sheet_is_braked_as_backward_euler_brakes_a_rigid_one(device):
    """A step whose predecessor turned by a goes towards 2 x_n - x_n-1, so it turns by atan(sin a / (2 - cos a))."""
    steps = 100
    length = np.pi / steps
    angle = np.arctan(length)
    for _ in range(steps - 1):
        angle = np.arctan(np.sin(angle) / (2.0 - np.cos(angle)))
    # The sheet is not quite rigid: it widens by some 1e-4 when it is spun, and so does its moment of inertia.
    lost = 1.0 - np.sin(angle) / length
    assert turning_lost(1, device, 2.0 * np.pi, 0.5, steps) == pytest.approx(lost, rel=0.01)


def test_bdf2_keeps_a_sheet_turning(device):
    """A hundred steps a turn lose less than one part in a hundred, and half the step far less."""
    coarse, fine = (abs(turning_lost(2, device, 2.0 * np.pi, 1.0, steps)) for steps in (100, 200))
    assert coarse < 0.01 and fine < coarse / 4.0


def test_an_order_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="order 1"):
        SolverSettings(order=3)
