"""The cloth simulation against physics that can be worked out by hand, and its promises to whoever bakes with it."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cloth_shapes import NO_TOUCH, Sleeve, floor, free_cloth, raised, sheet, sphere, tube
from wrinkle_synthesis.wrinkle_addon.cloth import STANDARD_GRAVITY, ClothSimulation, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model

G = STANDARD_GRAVITY
EXACT = SolverSettings(linear_tolerance=1.0e-6, linear_iterations=3000, newton_iterations=4)


# --- motion -------------------------------------------------------------------------------------------------------


def test_free_fall_is_what_backward_euler_makes_of_it(device):
    rest, faces = sheet(5, 5, 0.2, 0.2)
    simulation = free_cloth(build_cloth_model(rest, faces, Fabric()), solver_settings=EXACT, device=device)
    velocity = np.array([0.3, -0.2, 1.0])
    simulation.start(rest, np.tile(velocity, (len(rest), 1)))
    dt, steps = 1.0 / 60.0, 12
    for _ in range(steps):
        simulation.step(floor(-100.0)[0], dt)
    fallen = rest + steps * dt * velocity - np.array([0.0, 0.0, 0.5 * G * dt**2 * steps * (steps + 1)])
    # The linear system is solved in float32 to one millionth of each step.
    assert np.abs(simulation.positions[0] - fallen).max() < 1e-8


def test_momentum_is_kept_without_gravity(device):
    rng = np.random.default_rng(1)
    layer, faces = sheet(6, 6, 0.1, 0.1)
    rest = np.concatenate([layer, raised(layer, 0.05)])
    model = build_cloth_model(rest, np.concatenate([faces, faces + len(layer)]), Fabric())
    body, body_faces = floor(-100.0)
    simulation = ClothSimulation(model, body_faces, body, solver_settings=EXACT, device=device)
    simulation.set_gravity(np.zeros(3))
    # Two crumpled layers fly into each other.
    velocity = np.concatenate([np.tile([0.1, 0.0, 0.4], (len(layer), 1)), np.tile([0.0, 0.0, -0.4], (len(layer), 1))])
    simulation.start(np.concatenate([layer, raised(layer, 0.008)]) + 5e-4 * rng.normal(size=rest.shape), velocity)
    before = (model.mass[:, None] * velocity).sum(0)
    touched = False
    for _ in range(15):
        simulation.step(body, 1.0 / 120.0)
        touched |= bool(simulation._contact.frozen.pair_count.numpy().any())
    after = (model.mass[:, None] * simulation.state().velocities[0]).sum(0)
    assert touched
    # Of the momentum that each layer brought in; the steps are solved to about 1e-5.
    assert np.abs(after - before).max() < 1e-4 * model.mass.sum() * 0.4


def test_a_step_of_no_length_is_refused(device):
    rest, faces = sheet(2, 2, 0.1, 0.1)
    simulation = free_cloth(build_cloth_model(rest, faces, Fabric()), device=device)
    with pytest.raises(ValueError, match="longer than 0 s"):
        simulation.step(floor(-100.0)[0], 0.0)


# --- elasticity ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("direction", [0.0, 0.6, np.pi / 2.0])
@pytest.mark.parametrize("irregular", [0.0, 0.25], ids=["regular", "irregular"])
def test_bending_energy_of_a_cylinder(device, direction, irregular):
    """1/2 B kappa^2 for each area, whichever way the mesh lies."""
    rest, faces = sheet(30, 30, 0.3, 0.3)
    inner = ((rest[:, :2] > 1e-9) & (rest[:, :2] < 0.3 - 1e-9)).all(1)
    rest[inner, :2] += irregular * 0.01 * np.random.default_rng(2).uniform(-1.0, 1.0, size=(inner.sum(), 2))
    bending, radius = 1.0e-2, 0.5
    fabric = Fabric(bending=bending, poisson=0.3)
    simulation = free_cloth(build_cloth_model(rest, faces, fabric), device=device)
    simulation.set_gravity(np.zeros(3))
    along = np.array([np.cos(direction), np.sin(direction), 0.0])
    across = np.cross([0.0, 0.0, 1.0], along)
    angle = (rest @ along / radius)[:, None]
    rolled = (rest @ across)[:, None] * across + radius * (np.sin(angle) * along + np.cos(angle) * [0.0, 0.0, 1.0])
    simulation.start(rolled)
    stretching = simulation._triangle_energy
    energy = simulation.energy()[0] - stretching.numpy().sum()
    # The free border, where a triangle has fewer neighbours, is one cell in fifteen.
    assert energy == pytest.approx(0.5 * bending / radius**2 * 0.3**2, rel=0.04)


def heavy_elastica(length, stiffness, density):
    """Where the end of a clamped heavy strip hangs, (x, z) [m]: B theta'' = rho g (L - s) cos theta."""
    from scipy.integrate import solve_bvp

    s = np.linspace(0.0, length, 200)
    guess = np.stack([-1.2 * (1.0 - np.exp(-4.0 * s / length)), np.zeros_like(s), s, np.zeros_like(s)])

    def slope(s, y):
        return np.stack([y[1], density * G / stiffness * (length - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(start, end):
        return np.array([start[0], end[1], start[2], start[3]])

    solution = solve_bvp(slope, ends, s, guess, tol=1e-8, max_nodes=100000)
    assert solution.success
    return solution.y[2:, -1]


@pytest.mark.parametrize("ratio", [5.0, 50.0], ids=["stiff", "soft"])
def test_a_clamped_strip_hangs_like_the_heavy_elastica(device, ratio):
    """``ratio`` is weight against stiffness, rho g L^3 / B; the end within 2 percent of the length."""
    length, width, density, columns = 0.2, 0.05, 0.15, 40
    stiffness = density * G * length**3 / ratio
    cell = length / columns
    rest, faces = sheet(columns + 1, 10, length + cell, width)
    rest[:, 0] -= cell  # One column of cells lies in the clamp.
    clamped = rest[:, 0] < 1e-9
    simulation = free_cloth(
        build_cloth_model(rest, faces, Fabric(stretch=2000.0, poisson=0.0, bending=stiffness, density=density)),
        pin_stiffness=np.where(clamped, 1.0e5, 0.0),
        solver_settings=SolverSettings(linear_tolerance=0.02, linear_iterations=1500),
        device=device,
    )
    simulation.place_pins(rest)
    simulation.start(rest)
    report = simulation.settle(0.01, 150)
    end = simulation.positions[0][rest[:, 0] > length - 1e-9].mean(0)
    assert report.converged
    assert np.linalg.norm(end[[0, 2]] - heavy_elastica(length, stiffness, density)) < 0.02 * length


def test_uniaxial_stretch_is_the_analytic_one(device):
    """N = lambda Y (lambda^2 - 1) / 2 for each width, and no force on the sides when they draw in by Poisson's law."""
    rest, faces = sheet(8, 6, 0.2, 0.1)
    fabric = Fabric(stretch=80.0, poisson=0.3)
    simulation = free_cloth(build_cloth_model(rest, faces, fabric), device=device)
    simulation.set_gravity(np.zeros(3))
    stretch = 1.15
    narrowed = np.sqrt(1.0 - fabric.poisson * (stretch**2 - 1.0))
    force = simulation.residual(rest * [stretch, narrowed, 1.0])[0]
    end = rest[:, 0] > 0.2 - 1e-9
    pull = 0.5 * stretch * fabric.stretch * (stretch**2 - 1.0) * 0.1
    assert -force[end].sum(0) == pytest.approx([pull, 0.0, 0.0], abs=1e-9)
    # Bending takes no part in a plane; what is left are roundings of its large coefficients.
    between = (rest[:, 0] > 1e-9) & ~end
    assert np.abs(force[between]).max() < 1e-9


def test_ease_makes_the_rest_shape_longer_than_the_surface(device):
    rest, faces = sheet(4, 4, 0.1, 0.1)
    along = np.tile([1.0, 0.0, 0.0], (len(faces), 1))
    model = build_cloth_model(rest, faces, Fabric(), length_directions=along, ease=(0.05, 0.08))
    simulation = free_cloth(model, device=device)
    simulation.set_gravity(np.zeros(3))
    assert model.rest_area.sum() == pytest.approx(0.01 * 1.05 * 1.08)
    assert np.abs(simulation.residual(rest * [1.08, 1.05, 1.0])).max() < 1e-9
    assert np.abs(simulation.residual(rest)).max() > 1e-3


# --- friction -----------------------------------------------------------------------------------------------------


def patch_on_floor(device, friction=0.3, **settings):
    """A patch that lies on a level floor at rest; returns the simulation, the floor and where the patch lies."""
    rest, faces = sheet(8, 8, 0.1, 0.1)
    rest[:, :2] -= 0.05
    body, body_faces = floor(0.0, 4.0)
    model = build_cloth_model(rest, faces, Fabric(friction=friction))
    simulation = ClothSimulation(model, body_faces, body, contact_settings=NO_TOUCH, device=device, **settings)
    simulation.start(raised(rest, 0.0025))
    assert simulation.settle(1e-3).converged
    return simulation, body, simulation.positions[0]


def inclined(share, friction=0.3):
    """Gravity as on a slope whose tangent is this share of the coefficient of friction, and the slope's angle."""
    angle = np.arctan(share * friction)
    return G * np.array([np.sin(angle), 0.0, -np.cos(angle)]), angle


def test_a_patch_sticks_just_below_the_friction_angle(device):
    simulation, body, _start = patch_on_floor(device)
    simulation.set_gravity(inclined(0.99)[0])
    assert simulation.settle(0.01).converged
    held = simulation.positions[0]
    for _ in range(60):
        simulation.step(body, 1.0 / 60.0)
    # A second on the slope; sliding freely it would have gone 1.4 m.
    assert np.abs(simulation.positions[0] - held).max() < 1e-5


def test_a_patch_slips_just_above_the_friction_angle(device):
    simulation, body, _start = patch_on_floor(device)
    gravity, angle = inclined(1.01)
    simulation.set_gravity(gravity)
    speeds = []
    for _ in range(90):
        simulation.step(body, 1.0 / 60.0)
        speeds.append(simulation.state().velocities[0, :, 0].mean())
    # Coulomb's acceleration, once the first jolt has passed: 0.028 m/s^2 of the slope's 2.8.
    expected = G * (np.sin(angle) - 0.3 * np.cos(angle))
    assert (speeds[-1] - speeds[29]) / 1.0 == pytest.approx(expected, rel=0.05)


def test_a_sliding_patch_slows_down_by_friction(device):
    simulation, body, start = patch_on_floor(device)
    simulation.start(start, np.tile([0.8, 0.0, 0.0], (len(start), 1)))
    dt, steps = 1.0 / 120.0, 24
    speeds = []
    for _ in range(steps + 1):
        simulation.step(body, dt)
        speeds.append(simulation.state().velocities[0, :, 0].mean())
    # The first step only takes hold: what begins to touch has not been dragged yet.
    assert speeds[0] - speeds[-1] == pytest.approx(0.3 * G * steps * dt, rel=0.01)


def test_a_patch_does_not_creep_on_a_body_that_tilts_and_turns(device):
    simulation, body, start = patch_on_floor(device)
    before = np.eye(3)
    for k in range(1, 101):
        tilt, turn = np.radians(12.0) * np.sin(2.0 * np.pi * k / 20.0), 2.0 * np.pi * k / 100.0
        c, s = np.cos(tilt), np.sin(tilt)
        lean = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        c, s = np.cos(turn), np.sin(turn)
        after = lean @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        simulation.follow(body @ after.T, simulation.positions[0] @ (after @ before.T).T)
        simulation.settle(0.05)
        before = after
    # The floor is back where it was. The spring of static friction gives 0.5 mm before it lets go.
    assert np.abs(simulation.positions[0] - start).max() < 5e-5


def test_settling_again_moves_nothing(device):
    simulation, _body, _start = patch_on_floor(device)
    simulation.set_gravity(inclined(0.9)[0])
    simulation.settle(0.01)
    held = simulation.positions[0]
    for _ in range(100):
        simulation.settle(0.0, 1)  # A tolerance that nothing meets: every call takes a step.
    assert np.abs(simulation.positions[0] - held).max() < 5e-6
    assert simulation.settle(0.01).iterations == 0


def test_stepping_on_at_rest_moves_nothing(device):
    simulation, body, _start = patch_on_floor(device)
    simulation.set_gravity(inclined(0.9)[0])
    simulation.settle(0.001)
    held = simulation.positions[0]
    for _ in range(100):
        simulation.step(body, 1.0 / 60.0)
    assert np.abs(simulation.positions[0] - held).max() < 1e-6


# --- contact and equilibrium --------------------------------------------------------------------------------------


def sheet_over_sphere(device, cells=40):
    rest, faces = sheet(cells, cells, 0.3, 0.3)
    rest[:, :2] -= 0.15
    body, body_faces = sphere(0.1, 4)
    simulation = ClothSimulation(build_cloth_model(rest, faces, Fabric()), body_faces, body, device=device)
    simulation.start(raised(rest, 0.105))
    return simulation


def test_a_sheet_settles_on_a_sphere_without_going_into_it(device):
    simulation = sheet_over_sphere(device)
    report = simulation.settle(1.0, 100)
    assert report.converged and report.residual < 1.0
    assert simulation.relative_residual()[0] == pytest.approx(report.residual, rel=0.01)
    assert simulation.clearance().min() > 0.0


def test_settling_lowers_the_energy_all_the_way(device):
    simulation = sheet_over_sphere(device, cells=20)
    energies = [simulation.energy()[0]]
    # From the same start each time, so that each run is the one before and one step more.
    start = simulation.state()
    for iterations in range(1, 25):
        simulation.restore(start)
        simulation.settle(0.0, iterations)
        energies.append(simulation.energy()[0])
    # Contact is found anew after each step: what that adds is a thousandth of what the step gained at first.
    assert np.diff(energies).max() < 1e-3 * (energies[0] - energies[-1])
    assert energies[-1] < energies[0]


@pytest.mark.parametrize("depth", [0.015, 0.03])
def test_cloth_that_starts_inside_the_body_comes_out(device, depth):
    rest, faces = sheet(16, 16, 0.06, 0.06)
    rest[:, :2] -= 0.03
    body, body_faces = sphere(0.1, 4)
    simulation = ClothSimulation(build_cloth_model(rest, faces, Fabric()), body_faces, body, device=device)
    simulation.start(raised(rest, 0.1 - depth))
    assert simulation.clearance().min() < -depth + 0.001
    report = simulation.settle(1.0)
    assert report.converged
    assert simulation.clearance().min() > 0.0


@pytest.mark.parametrize("degrees", [60.0, 90.0])
def test_a_sleeve_settles_on_a_bent_arm(device, degrees):
    sleeve = Sleeve(75, 40, device=device)
    assert sleeve.simulation.settle(1.0).converged
    sleeve.bend(degrees)
    report = sleeve.simulation.settle(1.0)
    assert report.converged and report.iterations <= 60
    assert sleeve.simulation.clearance().min() > 0.0


def test_a_sleeve_settles_to_a_tenth_of_its_weight(device):
    sleeve = Sleeve(50, 40, device=device)
    sleeve.simulation.settle(1.0)
    sleeve.bend(45.0)
    report = sleeve.simulation.settle(0.1, 100)
    assert report.converged and report.residual < 0.1


def test_a_body_that_cuts_into_itself_is_borne(device):
    """At 130 degrees the crook of this arm passes through itself: no place there is free of the body."""
    sleeve = Sleeve(50, 40, width=0.06, device=device)
    sleeve.simulation.settle(1.0)
    sleeve.bend(130.0)
    report = sleeve.simulation.settle(1.0, 60)
    x = sleeve.simulation.positions
    assert np.isfinite(x).all() and np.abs(x).max() < 1.0
    assert report.iterations <= 60
    assert report.converged == (report.residual <= 1.0)
    assert sleeve.simulation.relative_residual()[0] == pytest.approx(report.residual, rel=0.05)


@pytest.mark.long
def test_a_fine_sleeve_settles_with_layers_pressed_together(device):
    """Edges about as long as the cloth's thickness, folded tightly: a vertex touches a dozen triangles at once."""
    sleeve = Sleeve(120, 100, width=0.06, device=device)
    assert sleeve.simulation.settle(1.0).converged
    sleeve.bend(75.0)
    assert sleeve.simulation.settle(1.0).converged
    assert sleeve.simulation.settle(0.1, 120).converged


# --- the same bits ------------------------------------------------------------------------------------------------


def bent_sleeve(device, world_count=1):
    sleeve = Sleeve(20, 16, world_count=world_count, device=device)
    sleeve.simulation.settle(1.0)
    sleeve.bend(50.0, step=5.0)
    sleeve.simulation.settle(1.0)
    return sleeve


def digest(simulation):
    state = simulation.state()
    total = hashlib.sha256()
    earlier = [state.earlier.positions, state.earlier.velocities] if state.earlier else []
    for values in (state.positions, state.velocities, state.anchor_faces, state.anchor_weights, *earlier):
        total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()


def test_a_second_run_gives_the_same_bits(device):
    assert digest(bent_sleeve(device).simulation) == digest(bent_sleeve(device).simulation)


def test_a_fresh_process_gives_the_same_bits(device):
    script = "import sys; sys.path[:0] = sys.argv[1:3]; import test_cloth_simulation as t; "
    script += "print(t.digest(t.bent_sleeve(sys.argv[3]).simulation))"
    here = Path(__file__).parent
    command = [sys.executable, "-c", script, str(here), str(here.parent), device]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert output.split()[-1] == digest(bent_sleeve(device).simulation)


def test_going_on_from_a_state_gives_the_same_bits(device):
    straight, broken = Sleeve(20, 16, device=device), Sleeve(20, 16, device=device)
    for sleeve in (straight, broken):
        sleeve.simulation.settle(1.0)
        sleeve.bend(25.0, step=5.0)
    state = broken.simulation.state()
    resumed = Sleeve(20, 16, device=device)
    resumed.bend(25.0, step=25.0)  # Brings body and pins to the place that the state belongs to.
    resumed.simulation.restore(state)
    for sleeve in (straight, resumed):
        sleeve.bend(50.0, step=5.0)
        sleeve.simulation.settle(1.0)
    assert digest(straight.simulation) == digest(resumed.simulation)


@pytest.mark.parametrize("order", [1, 2], ids=["backward Euler", "BDF2"])
def test_stepping_on_from_a_state_gives_the_same_bits(device, order):
    """Also where the time step changes, and in the middle of a slide."""

    def sliding():
        simulation, body, start = patch_on_floor(device, solver_settings=SolverSettings(order=order))
        simulation.start(start, np.tile([0.5, 0.2, 0.0], (len(start), 1)))
        return simulation, body

    straight, body = sliding()
    for dt in (0.01, 0.01, 0.005):
        straight.step(body, dt)
    state = straight.state()
    resumed, _body = sliding()
    resumed.restore(state)
    for simulation in (straight, resumed):
        for dt in (0.01, 0.01, 0.02):
            simulation.step(body, dt)
    assert (state.earlier is not None) == (order == 2)
    assert digest(straight) == digest(resumed)


def test_a_world_does_not_depend_on_its_neighbours(device):
    """The same sleeve alone, and between two others that are bent further and settle later."""
    rest, faces = tube(20, 16, 0.3, 0.055)
    body, body_faces = tube(30, 20, 0.5, 0.04)
    model = build_cloth_model(rest, faces, Fabric())
    pins = np.where(np.arange(len(rest)) < 16, 10.0, 0.0)
    shifts = np.array([0.0, 0.004, 0.012])

    def run(worlds):
        bodies = np.stack([body + np.array([0.0, shifts[w], 0.0]) for w in worlds])
        simulation = ClothSimulation(
            model, body_faces, bodies, pin_stiffness=pins, world_count=len(worlds), device=device
        )
        simulation.place_pins(rest)
        simulation.start(rest)
        simulation.step(bodies, 1.0 / 60.0)
        simulation.follow(bodies + np.array([0.0, 0.0, 0.002]), simulation.positions)
        report = simulation.settle(0.5, 40)
        state = simulation.state()
        return report, [state.positions, state.velocities, state.anchor_faces, state.anchor_weights]

    _report, together = run([0, 1, 2])
    iterations = set()
    for world in range(3):
        report, alone = run([world])
        iterations.add(report.iterations)
        for a, b in zip(together, alone, strict=True):
            assert np.array_equal(a[world], b[0])
    assert len(iterations) > 1  # They did not all end at the same time.


# --- bad input ----------------------------------------------------------------------------------------------------


def test_bad_input_is_refused_in_one_sentence(device):
    rest, faces = sheet(3, 3, 0.1, 0.1)
    model = build_cloth_model(rest, faces, Fabric())
    body, body_faces = floor()
    with pytest.raises(ValueError, match="no faces"):
        ClothSimulation(model, np.zeros((0, 3), int), body, device=device)
    with pytest.raises(ValueError, match="not numbers"):
        ClothSimulation(model, body_faces, np.full_like(body, np.nan), device=device)
    with pytest.raises(ValueError, match="16 numbers that are not negative"):
        ClothSimulation(model, body_faces, body, pin_stiffness=np.ones(3), device=device)
    with pytest.raises(ValueError, match="16 numbers that are not negative"):
        ClothSimulation(model, body_faces, body, pin_stiffness=np.full(16, -1.0), device=device)
    simulation = ClothSimulation(model, body_faces, body, device=device)
    with pytest.raises(ValueError, match=r"positions must have the shape \[16, 3\]"):
        simulation.start(rest[:-1])
    with pytest.raises(ValueError, match="positions hold values that are not numbers"):
        simulation.start(np.full_like(rest, np.inf))
    with pytest.raises(ValueError, match=r"body_positions must have the shape \[25, 3\]"):
        simulation.move_body(body[:-1])
    with pytest.raises(ValueError, match="velocities"):
        simulation.start(rest, rest[:3])


@pytest.mark.parametrize("name", ["thickness", "pressure", "depth", "slip", "radius"])
def test_contact_settings_must_be_positive(name):
    with pytest.raises(ValueError, match=f"{name} must be greater than 0"):
        ContactSettings(**{name: 0.0})


def test_self_contact_thickness_must_not_be_negative():
    with pytest.raises(ValueError, match="self_thickness must not be negative"):
        ContactSettings(self_thickness=-0.001)


@pytest.mark.parametrize(
    "values",
    [{"stretch": 0.0}, {"bending": -1.0}, {"density": 0.0}, {"poisson": 0.5}, {"friction": -0.1}, {"shear": 0}],
)
def test_a_fabric_that_cannot_be_is_refused(values):
    with pytest.raises(ValueError, match=next(iter(values)).replace("poisson", "Poisson")):
        Fabric(**values)


def test_a_triangle_without_area_is_refused():
    rest, faces = sheet(2, 2, 0.1, 0.1)
    rest[4] = rest[1]
    with pytest.raises(ValueError, match="no area"):
        build_cloth_model(rest, faces, Fabric())
