"""Proofs of friction: Coulomb's law on a slope and on the level, and an elastic strip pressed until it slips."""

import numpy as np
import pytest
from cloth_shapes import floor, inclined, patch_on_floor, sheet
from wrinkle_synthesis.wrinkle_addon.cloth import STANDARD_GRAVITY, ClothSimulation, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model

G = STANDARD_GRAVITY
ORDERS = pytest.mark.parametrize("order", [1, 2], ids=["backward Euler", "BDF2"])
COEFFICIENTS = pytest.mark.parametrize("friction", [0.1, 0.3, 0.6])


@ORDERS
@COEFFICIENTS
def test_a_patch_sticks_to_a_slope_just_below_the_friction_angle(device, friction, order):
    """A thousandth below: the patch stays where it settled, for two seconds."""
    simulation, body, _start = patch_on_floor(device, friction, solver_settings=SolverSettings(order=order))
    simulation.set_gravity(inclined(0.999, friction)[0])
    assert simulation.settle(0.001, 100).converged
    held = simulation.positions[0]
    for _ in range(120):
        simulation.step(body, 1.0 / 60.0)
    # Sliding freely it would have gone two metres and more; what is left is the last of the settling.
    assert np.abs(simulation.positions[0] - held).max() < 1e-5


@ORDERS
@COEFFICIENTS
def test_a_patch_slides_down_a_slope_just_above_the_friction_angle(device, friction, order):
    """A thousandth above, with Coulomb's acceleration g (sin a - mu cos a)."""
    simulation, body, _start = patch_on_floor(device, friction, solver_settings=SolverSettings(order=order))
    gravity, angle = inclined(1.001, friction)
    simulation.set_gravity(gravity)
    simulation.settle(0.001, 100)
    speeds = []
    for _ in range(120):
        simulation.step(body, 1.0 / 60.0)
        speeds.append(simulation.state().velocities[0, :, 0].mean())
    expected = G * (np.sin(angle) - friction * np.cos(angle))
    # The difference of two forces a thousand times as large, each good to a few hundred-thousandths.
    assert speeds[-1] - speeds[59] == pytest.approx(expected, rel=0.03)


@ORDERS
@COEFFICIENTS
def test_a_sliding_patch_slows_down_by_friction(device, friction, order):
    simulation, body, start = patch_on_floor(device, friction, solver_settings=SolverSettings(order=order))
    simulation.start(start, np.tile([2.0, 0.0, 0.0], (len(start), 1)))
    dt, steps = 1.0 / 120.0, 24
    speeds = []
    for _ in range(steps):
        simulation.step(body, dt)
        speeds.append(simulation.state().velocities[0, :, 0].mean())
    # The first steps only take hold: what begins to touch has not been dragged yet.
    lost = speeds[steps // 2] - speeds[-1]
    assert lost == pytest.approx(friction * G * (steps // 2 - 1) * dt, rel=1e-3)


# --- a strip pressed against the floor ----------------------------------------------------------------------------


def pressed_elastica(shortening, shape, forces, friction=None):
    """Equilibria of a planar elastica that is clamped upright and whose lower end stands on the floor.

    B theta'' = -(N sin theta + F cos theta), theta the angle from the clamp's direction, theta(0) = theta'(L) = 0, in
    units of L and B. The floor is nearer than the strip is long by ``shortening``, a share of the length.

    Args:
        shortening: Ascending, shape [state_count].
        shape: theta, theta', x and height of the first state, nearly, at even places, shape [4, point_count].
        forces: Its N and F, nearly.
        friction: None holds the end straight below the clamp. Else it has slid to where F is this times N.

    Returns:
        N, F and the place x of the end [lengths of the strip], shape [state_count] each.
    """
    from scipy.integrate import solve_bvp

    s = np.linspace(0.0, 1.0, shape.shape[1])
    states = []
    for share in shortening:

        def slope(_s, y, p):
            return np.stack([y[1], -(p[0] * np.sin(y[0]) + p[1] * np.cos(y[0])), np.sin(y[0]), np.cos(y[0])])

        def ends(start, end, p, height=1.0 - share):
            held = end[2] if friction is None else p[1] - friction * p[0]
            return np.array([start[0], start[2], start[3], end[1], held, end[3] - height])

        solution = solve_bvp(slope, ends, s, shape, p=forces, tol=1e-8, max_nodes=20000)
        assert solution.success
        s, shape, forces = solution.x, solution.y, solution.p
        states.append([*forces, shape[2, -1]])
    return np.array(states).T


def bowed(angle, shortening):
    """A state of the elastica that is shortened by bending along ``angle``, of any size, shape [point_count]."""
    from scipy.integrate import cumulative_trapezoid, trapezoid

    s = np.linspace(0.0, 1.0, len(angle))
    angle = angle * np.sqrt(2.0 * shortening / trapezoid(angle**2, s))
    return np.stack([angle, np.gradient(angle, s), cumulative_trapezoid(angle, s, initial=0.0), s])


def lean_of_a_stuck_strip(shortening):
    """Sideways over upright force on the end as long as it has not slipped, shape [state_count]."""
    k = 4.493409457909064  # tan k = k: buckling of a strip clamped at one end and held at the other.
    shape = bowed(np.cos(k * np.linspace(1.0, 0.0, 200)) / np.cos(k) - 1.0, shortening[0])
    upright, sideways, _place = pressed_elastica(shortening, shape, np.array([k**2, 0.0]))
    return np.abs(sideways / upright)


def way_of_a_slipped_strip(shortening, friction):
    """How far the end has slid [lengths of the strip], where friction holds it from sliding on, shape [state_count].

    Once it gives way, a strip pushes its end the harder the farther it slides. It comes to rest bent to one side alone,
    as one that is clamped at one end and free at the other.
    """
    shape = bowed(1.0 - np.cos(0.5 * np.pi * np.linspace(0.0, 1.0, 200)), shortening[0])
    return pressed_elastica(shortening, shape, np.array([2.5, -2.5 * friction]), -friction)[2]


class PressedStrip:
    """A strip without weight that stands on the floor and whose clamp comes down.

    A row of pinned cells clamps it. The plate's curvature there is taken over half a cell on either side of their lower
    border, so that the clamp begins in their middle.
    """

    def __init__(self, friction, device, length=0.2, bending=1.0e-3, columns=40):
        self.length = length
        self.cell = length / (columns + 0.5)
        self.rest, faces = sheet(columns + 1, 2, (columns + 1) * self.cell, 0.02)
        self.below = self.rest[:, 0] - self.cell
        # Thin contact and little give, so that they do not add to the strip's own shape.
        self.slip = 5.0e-5
        contact = ContactSettings(thickness=0.002, slip=self.slip, self_thickness=0.0, radius=0.01)
        self.body, body_faces = floor(0.0, 2.0)
        fabric = Fabric(stretch=5000.0, poisson=0.0, bending=bending, friction=friction)
        self.simulation = ClothSimulation(
            build_cloth_model(self.rest, faces, fabric),
            body_faces,
            self.body,
            contact_settings=contact,
            pin_stiffness=np.where(self.below < 1e-9, 1.0e5, 0.0),
            solver_settings=SolverSettings(linear_tolerance=1e-3, linear_iterations=3000, newton_iterations=5),
            device=device,
        )
        self.simulation.set_gravity(np.zeros(3))
        self.clamp = self.below.max() + 0.0015
        self.free = np.clip(self.below / self.below.max(), 0.0, 1.0)
        bowed = self.straight()
        bowed[:, 0] += 1e-3 * self.free**2 * (1.0 - self.free)
        self.simulation.place_pins(self.straight())
        self.simulation.start(bowed)
        self.simulation.settle(0.005, 60)

    def straight(self):
        return np.stack([np.zeros(len(self.rest)), self.rest[:, 1], self.clamp - self.below], 1)

    def press(self, way):
        """Bring the clamp down by ``way`` [m]."""
        self.clamp -= way
        self.simulation.place_pins(self.straight())
        carried = self.simulation.positions[0]
        carried[:, 2] -= way * (1.0 - self.free)
        self.simulation.follow(self.body, carried, dt=1.0)

    def foot(self):
        """Where the lower end is [m]."""
        return self.simulation.positions[0][self.below > self.below.max() - 1e-9].mean(0)

    def shortening(self):
        return 1.0 - (self.clamp + 0.5 * self.cell - self.foot()[2]) / self.length


@pytest.mark.parametrize(
    ("friction", "measures"),
    [
        (0.1, {}),
        pytest.param(0.15, {}, marks=pytest.mark.long),
        (0.2, {}),
        pytest.param(0.25, {}, marks=pytest.mark.long),
        pytest.param(0.3, {}, marks=pytest.mark.long),
        pytest.param(0.2, {"length": 0.1, "bending": 1.0e-5}, marks=pytest.mark.long),
        pytest.param(0.2, {"length": 0.4, "bending": 1.0e-2}, marks=pytest.mark.long),
    ],
)
def test_a_strip_pressed_on_the_floor_slips_when_the_elastica_leans_by_its_friction(device, friction, measures):
    """The stick-slip test of Romero et al. (see the proofs of strips), after Sano, Yamaguchi and Wada, Slip morphology
    of elastic strips on frictional rigid substrates (Physical Review Letters 118, 178001, 2017): how far strips of any
    length and stiffness can be shortened is a function of friction alone.
    """
    states = np.linspace(0.002, 0.35, 70)
    expected = np.interp(friction, lean_of_a_stuck_strip(states), states)
    strip = PressedStrip(friction, device, **measures)
    while abs(strip.foot()[0]) < 2.0 * strip.slip and strip.shortening() < states[-1]:
        strip.press(0.0025 * strip.length)
    # One step of the clamp, and two per cent for what gives besides bending: contact, friction's spring and the mesh.
    assert strip.shortening() == pytest.approx(expected, abs=0.0025 + 0.02 * expected)


@pytest.mark.parametrize("friction", [0.1, pytest.param(0.2, marks=pytest.mark.long)])
def test_a_strip_that_slipped_slides_on_as_the_elastica_that_friction_just_holds(device, friction):
    states = np.linspace(0.1, 0.31, 43)
    way = way_of_a_slipped_strip(states, friction)
    strip = PressedStrip(friction, device)
    for share in (0.1, 0.2, 0.3) if friction < 0.15 else (0.2, 0.3):
        while strip.shortening() < share:
            strip.press(0.0025 * strip.length)
        expected = np.interp(strip.shortening(), states, way)
        # In lengths of the strip: a twenty-fifth of a cell.
        assert abs(strip.foot()[0]) / strip.length == pytest.approx(expected, abs=0.001)
