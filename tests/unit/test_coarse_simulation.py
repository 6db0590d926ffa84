"""The coarse dynamic simulation: its physics, beside the fine solver, on a moving body, in layers; what it refuses."""

from dataclasses import fields

import numpy as np
import pytest
from cloth_shapes import floor, raised, sheet, sphere, tube, turned
from wrinkle_synthesis.wrinkle_addon import coarse_simulation
from wrinkle_synthesis.wrinkle_addon.cloth import STANDARD_GRAVITY, ClothSimulation, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import build_cloth_model, join_models
from wrinkle_synthesis.wrinkle_addon.coarse_simulation import CoarseLayer, CoarseSettings, CoarseSimulation
from wrinkle_synthesis.wrinkle_addon.fabrics import FABRICS, Fabric

FRAME = 1.0 / 30.0
FAR = floor(-100.0)
G = np.array([0.0, 0.0, -STANDARD_GRAVITY])
BARE = CoarseSettings(damping=0.0, pre_roll=0.0)


@pytest.fixture
def exact(monkeypatch):
    """No error but that of the time steps: linear systems solved to the end, and no settling before the start."""
    monkeypatch.setattr(coarse_simulation, "TOLERANCE", 1.0e-6)
    monkeypatch.setattr(coarse_simulation, "ITERATIONS", 300)
    monkeypatch.setattr(coarse_simulation, "SETTLE_STEPS", 0)


def patch(cells=6, size=0.2):
    return sheet(cells, cells, size, size)


def centred(positions):
    return positions - [*(0.5 * np.ptp(positions, axis=0))[:2], 0.0]


def flung(simulation, velocity):
    """Give everything a velocity [m/s], as if it had always had it."""
    simulation._motion.velocities.assign(np.broadcast_to(velocity, simulation._motion.velocities.numpy().shape))


def layer(positions, faces, settings=BARE, **more):
    return CoarseLayer("Shirt", positions, faces, settings, **more)


def started(layers, body=FAR, device="cpu"):
    body_positions, body_faces = body
    simulation = CoarseSimulation(layers, body_faces, body_positions, device=device)
    simulation.start(body_positions, [one.positions for one in layers])
    return simulation


# --- physics ------------------------------------------------------------------------------------------------------


def test_free_fall_is_that_of_bdf2_with_its_first_step_of_backward_euler(device, exact):
    rest, faces = patch()
    simulation = started([layer(rest, faces)], device=device)
    for _ in range(4):
        simulation.step(FAR[0], [rest], FRAME)
    steps, dt = 20, FRAME / 5
    time = steps * dt
    fallen = rest + 0.5 * time**2 * G + 0.75 * (1.0 - 3.0**-steps) * dt**2 * G
    # Positions are shown in float32; the linear system is solved to a millionth.
    assert np.abs(simulation.positions[0] - fallen).max() < 1e-6


def test_the_time_steps_are_of_second_order(device, exact):
    """A square stretched by 4 % and let go vibrates in its plane; the error falls with the square of the step."""
    rest, faces = patch(3, 0.1)
    # Stretched everywhere, so that all of the Hessian is taken into account for as long as the test lasts.
    begun = rest * [1.04, 1.04, 1.0]
    body = FAR

    def after(steps):
        settings = CoarseSettings(Fabric(stretch=10.0, stiffening=0.0), steps=steps, damping=0.0, pre_roll=0.0)
        simulation = CoarseSimulation([layer(rest, faces, settings)], body[1], body[0], device=device)
        simulation.set_gravity(np.zeros(3))
        simulation.start(body[0], [begun])
        simulation.step(body[0], [begun], 1.0e-3)
        return simulation._motion.positions.numpy()[0]

    finest = after(640)
    errors = [np.abs(after(steps) - finest).max() for steps in (40, 80, 160)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The reference has an error of its own, 1/16 of the smallest one measured.
    assert np.abs(orders - 2.0).max() < 0.2


def test_what_flies_free_keeps_its_momentum(device, exact):
    """And its angular momentum, but for the damping of the time steps."""
    rest, faces = patch()
    simulation = started([layer(rest, faces)], device=device)
    simulation.set_gravity(np.zeros(3))
    centre = rest.mean(0)
    turn, drift = np.array([0.0, 0.0, 2.0]), np.array([0.3, -0.2, 0.5])
    flung(simulation, drift + np.cross(turn, rest - centre))
    mass = simulation.model.mass[:, None]

    def momenta():
        x, v = (getattr(simulation._motion, name).numpy()[0] for name in ("positions", "velocities"))
        return (mass * v).sum(0), np.cross(x - (mass * x).sum(0) / mass.sum(), mass * v).sum(0)

    before = momenta()
    for _ in range(10):
        simulation.step(FAR[0], [rest], FRAME)
    after = momenta()
    # Forces within the cloth cancel but for the float32 of the linear system.
    assert np.abs(after[0] - before[0]).max() < 3e-5 * np.linalg.norm(before[0])
    # Measured 6 % in a third of a second at 5 steps a frame, and a sixteenth of that at 20.
    assert np.linalg.norm(after[1] - before[1]) < 0.08 * np.linalg.norm(before[1])


def test_a_garment_comes_to_rest_at_the_buffer_over_a_plane(device):
    rest, faces = patch()
    buffer = 0.008
    settings = CoarseSettings(buffer=buffer, damping=2.0, pre_roll=0.0)
    ground = floor(0.0)
    simulation = started([layer(raised(centred(rest), 0.05), faces, settings)], ground, device)
    for _ in range(30):
        report = simulation.step(ground[0], [raised(centred(rest), 0.05)], FRAME)
    height = simulation.positions[0][:, 2]
    # The cloth's weight, 1.5 N/m^2, presses it less than a hundredth of the way in at 20 kPa.
    assert np.abs(height - buffer).max() < 1e-4
    assert report.deepest == 0.0
    assert np.linalg.norm(simulation._motion.velocities.numpy()[0], axis=1).max() < 1e-3


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_friction_holds_up_to_its_angle(device, share):
    rest, faces = patch()
    ground = floor(0.0, 8.0)
    lies = raised(centred(rest), 0.005)
    settings = CoarseSettings(Fabric(friction=0.4), damping=0.0, pre_roll=1.0)
    simulation = started([layer(lies, faces, settings)], ground, device)
    angle = np.arctan(share * 0.4)
    simulation.set_gravity(STANDARD_GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
    way = []
    for _ in range(30):
        way.append(simulation.positions[0][:, 0].mean())
        simulation.step(ground[0], [lies], FRAME)
    if share < 1.0:
        # The slope comes in an instant: before it sticks, the cloth gives by a few slip lengths of half a millimetre.
        assert way[-1] - way[0] < 0.003
        assert abs(way[-1] - way[10]) < 2e-4
    else:
        gain = np.polyfit(FRAME * np.arange(30.0)[10:], way[10:], 2)[0]
        block = 0.5 * STANDARD_GRAVITY * (np.sin(angle) - 0.4 * np.cos(angle))
        assert abs(gain / block - 1.0) < 0.05


def test_a_blow_of_the_body_does_not_bounce(device):
    """A plane that suddenly comes up at 2 m/s takes the cloth along without throwing it on."""
    rest, faces = patch()
    ground = floor(0.0)
    start = raised(centred(rest), 0.01)
    simulation = started([layer(start, faces, CoarseSettings(damping=0.0, pre_roll=0.2))], ground, device)
    body, skin = ground[0], start
    heights = []
    for _ in range(6):
        body, skin = raised(body, 2.0 * FRAME), raised(skin, 2.0 * FRAME)
        simulation.step(body, [skin], FRAME)
        heights.append((simulation.positions[0][:, 2] - body[0, 2]).min())
    assert np.abs(np.array(heights) - 0.005).max() < 2e-4
    assert np.abs(simulation._motion.velocities.numpy()[0, :, 2] - 2.0).max() < 1e-3


# --- beside the fine solver -----------------------------------------------------------------------------------------


def fine_of(model, body, **settings):
    contact = ContactSettings(self_thickness=0.0, depth=coarse_simulation.DEPTH, radius=coarse_simulation.RADIUS)
    solver = SolverSettings(order=2, linear_tolerance=1e-5, linear_iterations=500, newton_iterations=6)
    return ClothSimulation(model, body[1], body[0], contact_settings=contact, solver_settings=solver, **settings)


@pytest.mark.parametrize("name", ["standard", "hinges", "springs", "damped"])
def test_it_moves_as_the_fine_solver_does(device, exact, name):
    """A sheet on springs swings; steps of the same length, once with one linearisation and once with all it takes."""
    fabric = {
        "standard": Fabric(),
        "hinges": Fabric(material="hinges"),
        "springs": Fabric(material="springs"),
        "damped": Fabric(damping=0.02),
    }[name]
    rest, faces = patch()
    pins = np.zeros(len(rest))
    pins[:7] = 0.5
    steps = 20
    settings = CoarseSettings(fabric, steps=steps, damping=0.0, pre_roll=0.0)
    simulation = started([layer(rest, faces, settings, pins=pins)], device=device)
    fine = fine_of(build_cloth_model(rest, faces, fabric), FAR, pin_stiffness=pins * coarse_simulation.PIN_STIFFNESS)
    fine.place_pins(rest)
    fine.start(rest)
    for _ in range(4):
        simulation.step(FAR[0], [rest], FRAME)
        for _ in range(steps):
            fine.step(FAR[0], FRAME / steps)
    moved = np.abs(fine.positions[0] - rest).max()
    assert moved > 0.05
    # What a single linearisation leaves; it falls with the step.
    assert np.abs(simulation._motion.positions.numpy()[0] - fine.positions[0]).max() < 0.01 * moved


def test_it_rests_on_a_body_where_the_fine_solver_does(device):
    """A cloth over a ball: both equilibria, contact, friction and all."""
    rest, faces = patch(10, 0.3)
    ball = sphere(0.1)
    start = raised(centred(rest), 0.104)
    model = build_cloth_model(start, faces, Fabric())
    thickness = coarse_simulation.THICKNESS
    settings = CoarseSettings(buffer=thickness, damping=5.0, pre_roll=3.0)
    simulation = started([layer(start, faces, settings)], ball, device)
    fine = fine_of(model, ball, device=device)
    fine.start(simulation._motion.positions.numpy()[0])
    fine.hold()
    # In the fine solver's measure: the mean force left on a vertex, in its weights.
    assert fine.relative_residual()[0] < 1.0
    report = fine.settle(0.1, 60)
    assert report.converged
    assert np.abs(fine.positions[0] - simulation._motion.positions.numpy()[0]).max() < 0.005


def test_models_joined_are_what_they_were_alone():
    first = build_cloth_model(*patch(4), Fabric())
    second = build_cloth_model(*tube(6, 12, 0.2, 0.05), Fabric(material="springs"))
    third = build_cloth_model(*patch(3), FABRICS["denim"])
    joined = join_models([first, second, third])
    assert [part.fabric for part in joined.parts] == [first.fabric, second.fabric, third.fabric]
    for model, part in zip((first, second, third), joined.parts, strict=True):
        at = part.vertices.start
        for vertex in range(model.vertex_count):
            for start, entries in (("row_start", "columns"), ("bending_start", "bending_columns")):
                rows, own = getattr(joined, start), getattr(model, start)
                here = getattr(joined, entries)[rows[at + vertex] : rows[at + vertex + 1]]
                alone = getattr(model, entries)[own[vertex] : own[vertex + 1]]
                np.testing.assert_array_equal(here, alone + at)
        np.testing.assert_array_equal(joined.rest_area[part.triangles], model.rest_area)
        np.testing.assert_array_equal(joined.faces[part.triangles], model.faces + at)
    np.testing.assert_array_equal(joined.columns[joined.diagonal_entry], np.arange(joined.vertex_count))


def test_garments_that_do_not_meet_move_as_they_do_alone(device, exact):
    rest, faces = patch()
    pins = np.zeros(len(rest))
    pins[:7] = 0.5
    fabrics = Fabric(), FABRICS["denim"]
    apart = [rest, rest + [0.0, 0.0, 1.0]]
    layers = [
        CoarseLayer(str(i), positions, faces, CoarseSettings(fabric, damping=0.0, pre_roll=0.0), pins=pins)
        for i, (positions, fabric) in enumerate(zip(apart, fabrics, strict=True))
    ]
    both = started(layers, device=device)
    alone = [started([one], device=device) for one in layers]
    for _ in range(5):
        both.step(FAR[0], apart, FRAME)
        for simulation, positions in zip(alone, apart, strict=True):
            simulation.step(FAR[0], [positions], FRAME)
    for together, simulation in zip(both.positions, alone, strict=True):
        # The linear system is solved to a millionth of what both together had to do.
        assert np.abs(together - simulation.positions[0]).max() < 1e-5


# --- a moving body --------------------------------------------------------------------------------------------------


def sleeve(device="cpu", settings=None, **more):
    """A loose sleeve on a straight arm."""
    arm = tube(40, 24, 0.6, 0.04)
    rest, faces = tube(20, 16, 0.4, 0.055)
    one = layer(rest, faces, settings or CoarseSettings(pre_roll=0.3), **more)
    simulation = CoarseSimulation([one], arm[1], arm[0], device=device)
    return simulation, arm[0], rest


def swing(simulation, arm, rest, frames, first=0):
    """Wave the arm to and fro; the reports."""
    reports = []
    for frame in range(first, first + frames):
        angle = 0.8 * np.sin(2.0 * np.pi * (frame + 1) / 20.0)
        reports.append(simulation.step(turned(arm, angle), [turned(rest, angle)], FRAME))
    return reports


def test_a_waving_arm_takes_its_sleeve_along_and_stays_inside(device):
    simulation, arm, rest = sleeve(device)
    simulation.start(arm, [rest])
    reports = swing(simulation, arm, rest, 20)
    assert not any(report.restarted for report in reports)
    # The ends of the sleeve move at up to 1.5 m/s; the buffer is 5 mm.
    assert max(report.deepest for report in reports) == 0.0
    # Half a turn of the arm later it is still on it: no vertex is farther from the skin than the sleeve is loose.
    angle = 0.8 * np.sin(2.0 * np.pi)
    radius = np.linalg.norm(turned(simulation.positions[0], -angle)[:, 1:], axis=1)
    assert radius.max() < 0.12


def limb_through_cloth(device, steps, heights):
    """Cloth that hangs by its edges over a trunk, and a limb broader than it at these heights [m], frame by frame."""
    trunk, limb = floor(0.0), sphere(0.1)
    rest, faces = patch(10, 0.3)
    cloth = raised(centred(rest), 0.03)
    pins = (np.abs(cloth[:, :2]).max(1) > 0.149).astype(float)
    body_faces = np.concatenate([trunk[1], limb[1] + len(trunk[0])])
    bodies = [np.concatenate([trunk[0], raised(limb[0] * [6.0, 6.0, 0.4], height)]) for height in heights]
    one = layer(cloth, faces, CoarseSettings(steps=steps, pre_roll=0.1), pins=pins)
    simulation = CoarseSimulation([one], body_faces, bodies[0], device=device)
    simulation.start(bodies[0], [cloth])
    for body in bodies[1:]:
        simulation.step(body, [cloth], FRAME)
    return simulation.positions[0]


@pytest.mark.parametrize("steps", [3, 5, 8, 20])
def test_a_limb_that_sweeps_through_hanging_cloth_does_not_carry_it_off(device, steps):
    """An arm against the trunk: its near side faces against the cloth, which must not come out at its far side."""
    sweep = [0.15, 0.15, 0.1, 0.05, 0.005, 0.005, 0.005, 0.005, 0.05, 0.1, 0.2, 0.2]
    shown = limb_through_cloth(device, steps, sweep)
    # It hung at 3 cm and sags a little; the limb's far side ends 24 cm high.
    assert shown[:, 2].max() < 0.035


@pytest.mark.parametrize("steps", [3, 5, 8, 20])
def test_a_limb_that_comes_up_under_the_cloth_lifts_it_however_fast(device, steps):
    """At 3.3 m/s it goes through the cloth within a frame, by the side that can be touched."""
    shown = limb_through_cloth(device, steps, [-0.1, -0.1, *[0.01] * 10])
    # On top of the limb, 5 cm high in its middle; farther out the pins pull.
    assert shown[np.linalg.norm(shown[:, :2], axis=1) < 0.1, 2].min() > 0.05


def test_a_run_repeats_to_the_bit_and_goes_on_from_its_state(device):
    first, arm, rest = sleeve(device)
    first.start(arm, [rest])
    swing(first, arm, rest, 5)
    state = first.state()
    swing(first, arm, rest, 5, first=5)
    again, _, _ = sleeve(device)
    again.start(arm, [rest])
    swing(again, arm, rest, 10)
    np.testing.assert_array_equal(again.positions[0], first.positions[0])
    resumed, _, _ = sleeve(device)
    resumed.restore(state)
    swing(resumed, arm, rest, 5, first=5)
    np.testing.assert_array_equal(resumed.positions[0], first.positions[0])


def test_looking_ahead_changes_no_bit(device):
    plain, arm, rest = sleeve(device)
    eager, _, _ = sleeve(device)
    for simulation in (plain, eager):
        simulation.start(arm, [rest])
    eager.look_ahead()
    for first in range(3):
        for simulation in (plain, eager):
            swing(simulation, arm, rest, 1, first=first)
        eager.look_ahead()
        np.testing.assert_array_equal(eager.positions[0], plain.positions[0])
    # What was begun counts neither for a state nor for where that is gone on from.
    for array in fields(state := plain.state()):
        np.testing.assert_array_equal(getattr(eager.state(), array.name), getattr(state, array.name))
    eager.restore(state)
    for simulation in (plain, eager):
        swing(simulation, arm, rest, 3, first=3)
    np.testing.assert_array_equal(eager.positions[0], plain.positions[0])


def test_a_state_shows_what_it_was_taken_of():
    first, arm, rest = sleeve()
    first.start(arm, [rest])
    swing(first, arm, rest, 3)
    other, _, _ = sleeve()
    other.restore(first.state())
    np.testing.assert_array_equal(other.positions[0], first.positions[0])


def test_it_starts_at_rest():
    simulation, arm, rest = sleeve(settings=CoarseSettings(pre_roll=1.0))
    report = simulation.start(arm, [rest])
    assert report.restarted and not report.reason
    before = simulation.positions[0]
    simulation.step(arm, [rest], FRAME)
    # Less than half a millimetre a frame, 15 mm/s, is not to be seen.
    assert np.abs(simulation.positions[0] - before).max() < 5e-4


def test_a_character_that_jumps_elsewhere_starts_anew_there_at_rest():
    simulation, arm, rest = sleeve()
    simulation.start(arm, [rest])
    swing(simulation, arm, rest, 3)
    there = np.array([3.0, 0.0, 0.0])
    report = simulation.step(arm + there, [rest + there], FRAME)
    assert report.restarted and "jumped" in report.reason
    before = simulation.positions[0]
    assert np.abs(before - rest - there).max() < 0.1
    assert not simulation.step(arm + there, [rest + there], FRAME).restarted
    assert np.abs(simulation.positions[0] - before).max() < 1e-3


def test_masks_say_how_far_a_vertex_may_leave_the_skinned_garment():
    rest, faces = patch()
    strength = np.ones(len(rest))
    strength[:7], strength[7:14] = 0.0, 0.5
    simulation = started([layer(rest, faces, strength=strength)])
    moved = rest + [0.01, 0.0, 0.0]
    for _ in range(3):
        simulation.step(FAR[0], [moved], FRAME)
    shown, simulated = simulation.positions[0], simulation._motion.positions.numpy()[0]
    np.testing.assert_array_equal(shown[:7], moved[:7].astype(np.float32))
    assert np.abs(shown[7:14] - 0.5 * (simulated + moved)[7:14]).max() < 1e-6
    assert np.abs(simulated[7:14] - moved[7:14]).max() > 0.001
    np.testing.assert_array_equal(shown[14:], simulated[14:].astype(np.float32))


def test_any_frame_rate_takes_the_same_number_of_steps_and_ends_alike():
    ends = []
    for rate in (24.0, 48.0):
        simulation, arm, rest = sleeve()
        simulation.start(arm, [rest])
        for frame in range(round(rate / 4)):
            angle = 0.8 * np.sin(2.0 * np.pi * (frame + 1) / rate)
            simulation.step(turned(arm, angle), [turned(rest, angle)], 1.0 / rate)
        ends.append(simulation.positions[0])
    # Half the step makes a difference of a few millimetres to cloth that swings.
    assert np.sqrt(((ends[0] - ends[1]) ** 2).sum(1).mean()) < 0.01


# --- layers -----------------------------------------------------------------------------------------------------------


def test_layers_push_each_other_with_one_force(device, exact):
    """Two sheets without gravity, the inner one on the wrong side: both move, their momentum stays zero."""
    rest, faces = patch()
    lower, upper = patch(5)
    # Facing up: outside is above; the inner sheet lies 2 mm above the outer one.
    layers = [layer(raised(rest, 0.002), faces), layer(lower, upper)]
    simulation = CoarseSimulation(layers, FAR[1], FAR[0], device=device)
    simulation.set_gravity(np.zeros(3))
    simulation.start(FAR[0], [one.positions for one in layers])
    report = simulation.step(FAR[0], [one.positions for one in layers], FRAME)
    velocities = simulation._motion.velocities.numpy()[0]
    momentum = simulation.model.mass[:, None] * velocities
    assert velocities[: len(rest), 2].mean() < 0.0 < velocities[len(rest) :, 2].mean()
    # The linear system is in float32, and contact 3,000 times as stiff as what it moves.
    assert np.abs(momentum.sum(0)).max() < 0.02 * np.abs(momentum).sum()
    assert report.crossed < 0.1 * len(rest)


# --- what it refuses --------------------------------------------------------------------------------------------------


def test_bad_input_is_refused_in_one_sentence():
    rest, faces = patch()
    body, body_faces = FAR

    def refuses(what, act):
        with pytest.raises(ValueError, match=what) as found:
            act()
        assert str(found.value).endswith(".") and "\n" not in str(found.value)

    def make(**changes):
        arguments = {"positions": rest, "faces": faces, "settings": BARE} | changes
        return CoarseSimulation([CoarseLayer("Shirt", **arguments)], body_faces, body)

    simulation = make()
    simulation.start(body, [rest])
    refuses("'Shirt' has no faces", lambda: make(faces=np.zeros((0, 3), np.int32)))
    refuses("'Shirt' cannot be simulated", lambda: make(positions=np.zeros_like(rest)))
    refuses("loose", lambda: make(positions=np.concatenate([rest, rest[:1]])))
    refuses("strength of 'Shirt'", lambda: make(strength=np.ones(3)))
    refuses("pins of 'Shirt'", lambda: make(pins=np.full(len(rest), 2.0)))
    refuses("no garment", lambda: CoarseSimulation([], body_faces, body))
    refuses("no faces to collide", lambda: CoarseSimulation([layer(rest, faces)], body_faces[:0], body))
    refuses("frame rate", lambda: simulation.step(body, [rest], 0.0))
    refuses("frame rate", lambda: simulation.step(body, [rest], -FRAME))
    refuses("frame rate", lambda: simulation.step(body, [rest], float("nan")))
    refuses("keep its mesh", lambda: simulation.step(body[:-1], [rest], FRAME))
    refuses("'Shirt' has 49 vertices, but 48", lambda: simulation.step(body, [rest[:-1]], FRAME))
    refuses("1 garments, but 2", lambda: simulation.step(body, [rest, rest], FRAME))
    refuses("not numbers", lambda: simulation.step(body, [rest * np.nan], FRAME))
    refuses("other garments", lambda: simulation.restore(sleeve()[0].state()))
    refuses("steps", lambda: CoarseSettings(steps=0))
    refuses("buffer", lambda: CoarseSettings(buffer=-0.001))
    refuses("pre-roll", lambda: CoarseSettings(pre_roll=-1.0))
