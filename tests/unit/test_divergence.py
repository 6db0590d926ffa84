"""Numbers that get lost are missed where they do: one sentence, and nothing of them in the database."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from cloth_shapes import free_cloth, sheet
from dolls import Doll, doll, grid_of
from wrinkle_synthesis.wrinkle_addon import storage
from wrinkle_synthesis.wrinkle_addon.bake import STATES, BakeJob, SimulatedSamples, bake
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.divergence import Divergence, find_divergence
from wrinkle_synthesis.wrinkle_addon.garment import Body
from wrinkle_synthesis.wrinkle_addon.linear_solver import BlockSystem
from wrinkle_synthesis.wrinkle_addon.plan import SamplePlan
from wrinkle_synthesis.wrinkle_addon.rig import Pose


@pytest.fixture(scope="module")
def character() -> Doll:
    return doll(31, 12, ("elbow_L",))


def bent(character: Doll) -> BakeJob:
    return character.job(SamplePlan((grid_of(character.joint("elbow_L"), [0, 10, 20]),)), settle_iterations=8)


def spoil_solutions(monkeypatch: pytest.MonkeyPatch, vertex: int, after: int) -> None:
    """Let linear systems be solved by what is no number at this vertex, after so many that are solved well."""
    solve, calls = BlockSystem.solve, []

    def spoiled(system: BlockSystem, *arguments) -> int:
        iterations = solve(system, *arguments)
        calls.append(iterations)
        if len(calls) > after:
            solution = system.solution.numpy()
            solution[0, vertex] = np.nan
            system.solution.assign(solution)
        return iterations

    monkeypatch.setattr(BlockSystem, "solve", spoiled)


def test_the_vertex_that_lost_its_numbers_first_is_found():
    positions, gradient = np.zeros((2, 5, 3)), np.zeros((2, 5, 3))
    gradient[1, 3, 0] = -7.0
    assert find_divergence(positions, gradient).vertex == 3
    gradient[0, 2, 1] = np.inf
    assert find_divergence(positions, gradient).vertex == 2
    positions[1, 4, 2] = np.nan
    assert find_divergence(positions, gradient).vertex == 4


@pytest.mark.parametrize("act", ["settle", "follow", "step"])
def test_the_garment_keeps_its_numbers_when_a_step_has_none(act: str, device: str, monkeypatch: pytest.MonkeyPatch):
    rest, faces = sheet(6, 6, 0.1, 0.1)
    simulation = free_cloth(build_cloth_model(rest, faces, Fabric()), device=device)
    simulation.start(rest)
    body = simulation.body_positions[0]
    spoil_solutions(monkeypatch, vertex=8, after=1)
    with pytest.raises(Divergence, match=r"The cloth at vertex \d+ moved to no number; .*\."):
        if act == "settle":
            simulation.settle(0.0)
        elif act == "follow":
            simulation.follow(body, rest)
        else:
            simulation.step(body, 0.01)
    assert np.isfinite(simulation.positions).all()


def test_forces_that_are_no_numbers_are_missed_though_the_energy_has_one(device: str):
    """Springs know no direction at length zero: two ends in one place push each other nowhere."""
    rest, faces = sheet(6, 6, 0.1, 0.1)
    simulation = free_cloth(build_cloth_model(rest, faces, Fabric(material="springs")), device=device)
    drawn = rest.copy()
    drawn[faces[20, 1]] = drawn[faces[20, 0]]
    simulation.start(drawn)
    assert np.isfinite(simulation.energy()).all()
    with pytest.raises(Divergence) as caught:
        simulation.settle()
    assert caught.value.vertex in faces[20, :2]


@pytest.mark.parametrize(("after", "what"), [(3, "The rest pose"), (45, r"Sample elbow_L-[12]")])
def test_a_bake_that_loses_its_numbers_says_in_which_sample_and_where(
    character: Doll, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int, what: str
):
    job = bent(character)
    spoil_solutions(monkeypatch, vertex=100, after=after)
    finished = []
    place = rf"{what}: the cloth near \w+ \(vertex \d+\) moved to no number; .*\.$"
    with pytest.raises(ValueError, match=place):
        for event in bake(job, SimulatedSamples(job, character, tmp_path), tmp_path):
            finished.append(event.name)
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert {path.name.rsplit("-", 1)[0] for path in written} == {"header", *finished}
    for path in written:
        storage.read_arrays(path)  # Refuses what holds values that are not numbers.


def test_a_bake_goes_on_to_the_same_bytes_after_its_numbers_were_lost(character: Doll, tmp_path: Path):
    job = bent(character)

    def contents(folder: Path) -> dict[str, bytes]:
        return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    with pytest.MonkeyPatch.context() as monkeypatch:
        spoil_solutions(monkeypatch, vertex=100, after=20)
        with pytest.raises(ValueError, match="moved to no number"):
            list(bake(job, SimulatedSamples(job, character, tmp_path / "lost"), tmp_path / "lost"))
    for name in ("lost", "whole"):
        list(bake(job, SimulatedSamples(job, character, tmp_path / name), tmp_path / name))
    assert contents(tmp_path / "lost") == contents(tmp_path / "whole")
    assert (tmp_path / "whole" / STATES).is_dir()


@dataclass(frozen=True)
class Vanishing:
    """A body whose vertex 5 is nowhere once the elbow bends."""

    character: Doll

    def positions(self, pose: Pose) -> np.ndarray:
        positions = self.character.positions(pose).copy()
        if np.abs(pose.matrices - self.character.rig.rest).max() > 1e-6:
            positions[5] = np.nan
        return positions


def test_a_body_that_loses_its_numbers_in_a_pose_is_refused_by_sample_and_vertex(character: Doll, tmp_path: Path):
    job = bent(character)
    events = bake(job, SimulatedSamples(job, Vanishing(character), tmp_path), tmp_path)
    assert next(events).name == "rest"
    with pytest.raises(ValueError, match=r"Sample elbow_L-1: body_positions hold values .* not numbers, .*vertex 5\.$"):
        next(events)


def test_a_body_that_has_none_at_rest_is_refused_before_the_bake(character: Doll):
    positions = character.body.positions.copy()
    positions[[3, 8], 1] = np.inf
    job = bent(character)
    with pytest.raises(ValueError, match="2 vertices of the body have positions that are not numbers; repair the mesh"):
        BakeJob(job.rig, job.garment, Body(positions, job.body.faces, job.body.weights), job.plan, job.settings)


def test_a_fabric_whose_forces_no_number_can_hold_is_told_of(tmp_path: Path, character: Doll):
    job = character.job(bent(character).plan, fabric=Fabric(stretch=1e300), settle_iterations=8)
    with pytest.raises(ValueError, match=r"The rest pose: the cloth near \w+ \(vertex \d+\) moved to no number"):
        list(bake(job, SimulatedSamples(job, character, tmp_path), tmp_path))
