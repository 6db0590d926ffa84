"""The same bits: from a second run, from a state, next to other worlds, and in another order of samples."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cloth_shapes import Sleeve, patch_on_floor, tube
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model


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
    script = "import sys; sys.path[:0] = sys.argv[1:3]; import test_cloth_same_bits as t; "
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


class ShiftedSleeves:
    """Samples of a short sleeve whose arm stands off its axis by different ways: they settle at different times."""

    def __init__(self, device, order=1):
        self.device = device
        self.settings = SolverSettings(order=order)
        self.rest, faces = tube(20, 16, 0.3, 0.055)
        self.body, self.body_faces = tube(30, 20, 0.5, 0.04)
        self.model = build_cloth_model(self.rest, faces, Fabric())
        self.shifts = np.array([0.0, 0.004, 0.012, 0.008])

    def simulation(self, world_count):
        pins = np.where(np.arange(len(self.rest)) < 16, 10.0, 0.0)
        bodies = np.repeat(self.body[None], world_count, 0)
        return ClothSimulation(
            self.model,
            self.body_faces,
            bodies,
            pin_stiffness=pins,
            solver_settings=self.settings,
            world_count=world_count,
            device=self.device,
        )

    def run(self, samples, simulation=None):
        """Simulate these samples side by side; returns iterations to settle and, for each, its report and state."""
        bodies = np.stack([self.body + np.array([0.0, self.shifts[k], 0.0]) for k in samples])
        simulation = simulation or self.simulation(len(samples))
        simulation.move_body(bodies)
        simulation.place_pins(self.rest)
        simulation.start(self.rest)
        for dt in (1.0 / 60.0, 1.0 / 60.0, 1.0 / 120.0):
            simulation.step(bodies, dt)
        simulation.follow(bodies + np.array([0.0, 0.0, 0.002]), simulation.positions)
        report = simulation.settle(0.5, 40)
        simulation.step(bodies, 1.0 / 60.0)
        simulation.step(bodies, 1.0 / 60.0)
        state = simulation.state()
        arrays = [*vars(report).values(), state.positions, state.velocities, state.anchor_faces, state.anchor_weights]
        if state.earlier:
            arrays += [state.earlier.positions, state.earlier.velocities]
        return tuple(report.iterations), {k: [a[i] for a in arrays] for i, k in enumerate(samples)}


def same(first, second):
    return all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize("order", [1, 2], ids=["backward Euler", "BDF2"])
def test_a_sample_depends_neither_on_its_neighbours_nor_on_their_order(device, order):
    sleeves = ShiftedSleeves(device, order)
    alone = [sleeves.run([k]) for k in range(4)]
    assert len({iterations for iterations, _states in alone}) > 1  # They do not all settle at the same time.
    for batch in ([0, 1, 2], [2, 1, 0], [3, 2], [1, 3, 0, 2]):
        _iterations, together = sleeves.run(batch)
        for k in batch:
            assert same(together[k], alone[k][1][k])


def test_worlds_that_are_left_out_of_settling_stay_as_they_are_to_the_bit(device):
    sleeves = ShiftedSleeves(device)
    together, alone = sleeves.simulation(2), sleeves.simulation(1)
    for simulation, samples in ((together, [1, 2]), (alone, [2])):
        simulation.move_body(np.stack([sleeves.body + np.array([0.0, sleeves.shifts[k], 0.0]) for k in samples]))
        simulation.place_pins(sleeves.rest)
        simulation.start(sleeves.rest)
    report = together.settle(0.5, 40, worlds=np.array([False, True]))
    expected = alone.settle(0.5, 40)
    assert same([values[1] for values in vars(report).values()], [values[0] for values in vars(expected).values()])
    assert np.array_equal(together.positions, [sleeves.rest, alone.positions[0]])
    assert report.iterations[0] == 0 and not report.converged[0]
    # The one left out settles afterwards as if nothing had been.
    report = together.settle(0.5, 40, worlds=np.array([True, False]))
    first = sleeves.simulation(1)
    first.move_body(sleeves.body + np.array([0.0, sleeves.shifts[1], 0.0]))
    first.place_pins(sleeves.rest)
    first.start(sleeves.rest)
    assert report.residual[0] == first.settle(0.5, 40).residual[0]
    assert np.array_equal(together.positions, [first.positions[0], alone.positions[0]])


def test_a_sample_does_not_depend_on_those_simulated_before_it(device):
    """One simulation runs samples one after the other, in two orders."""
    sleeves = ShiftedSleeves(device)
    forward, backward = sleeves.simulation(1), sleeves.simulation(1)
    first = {k: sleeves.run([k], forward)[1][k] for k in (0, 1, 2)}
    second = {k: sleeves.run([k], backward)[1][k] for k in (2, 0, 1)}
    for k in first:
        assert same(first[k], second[k])
