"""A bake of batches: samples simulated side by side, to the same bytes as one by one, whatever happens to some."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from dolls import Doll, doll, grid_of
from wrinkle_synthesis.wrinkle_addon.bake import BakeEvent, BakeJob, SimulatedSamples, bake
from wrinkle_synthesis.wrinkle_addon.linear_solver import BlockSystem
from wrinkle_synthesis.wrinkle_addon.plan import SamplePlan
from wrinkle_synthesis.wrinkle_addon.rig import Pose
from wrinkle_synthesis.wrinkle_addon.wearer import Wearer

NAMES = ["elbow_L-0", "elbow_L-2", "elbow_R-1", "elbow_R-2"]
"""Of the plan below, in its order."""


@pytest.fixture(scope="module")
def character() -> Doll:
    return doll(21, 8, ("elbow_L", "elbow_R"))


@pytest.fixture(scope="module")
def job(character: Doll) -> BakeJob:
    """Ways of 4 steps from rest, and one of 2 from a sample."""
    left = grid_of(character.joint("elbow_L"), [-10, 0, 10])
    right = grid_of(character.joint("elbow_R"), [0, 10, 15])
    return character.job(SamplePlan((left, right)), settle_iterations=8)


@pytest.fixture(scope="module")
def one_by_one(job: BakeJob, character: Doll, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one_by_one")
    assert run(job, character, folder, 1) == ["rest", *NAMES]
    return folder


def events(job: BakeJob, bodies: Doll | Vanishing, folder: Path, batch: int) -> Iterator[BakeEvent]:
    return bake(job, SimulatedSamples(job, bodies, folder, batch=batch), folder)


def run(job: BakeJob, bodies: Doll | Vanishing, folder: Path, batch: int, count: int = 10) -> list[str]:
    """Bake until so many samples are finished; returns their names."""
    return [event.name for _, event in zip(range(count), events(job, bodies, folder, batch), strict=False)]


def contents(folder: Path) -> dict[str, bytes]:
    """All files, states and reports as well."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("batch", [2, 3])
def test_batches_give_the_bytes_of_one_by_one(
    job: BakeJob, character: Doll, one_by_one: Path, tmp_path: Path, batch: int
):
    told = list(events(job, character, tmp_path, batch))
    assert sorted(event.name for event in told) == sorted(["rest", *NAMES])
    assert [event.done for event in told] == [1, 2, 3, 4, 5] and told[-1].remaining == 0.0
    assert contents(tmp_path) == contents(one_by_one)


@pytest.mark.parametrize(
    ("batch", "expected"),
    [
        (16, [["elbow_R-1", "elbow_L-0", "elbow_L-2"], ["elbow_R-2"]]),
        (2, [["elbow_R-1", "elbow_L-0"], ["elbow_L-2"], ["elbow_R-2"]]),
    ],
)
def test_samples_of_a_batch_take_equally_many_steps_and_what_others_wait_for_goes_first(
    job: BakeJob, character: Doll, tmp_path: Path, batch: int, expected: list[list[str]]
):
    source = SimulatedSamples(job, character, tmp_path, batch=batch)
    assert [[sample.name for sample in shapes] for shapes in source.batches(job.plan.samples)] == expected


def test_samples_asked_for_in_another_order_come_out_the_same(
    job: BakeJob, character: Doll, one_by_one: Path, tmp_path: Path
):
    """Also a sample whose parent is not asked for: that is made for it."""
    elbows = {sample.name: sample for sample in job.plan.samples}
    source = SimulatedSamples(job, character, tmp_path, batch=2)
    made = [list(shapes) for shapes in source.batches([elbows["elbow_R-2"], elbows["elbow_L-2"]])]
    assert made == [[elbows["elbow_L-2"]], [elbows["elbow_R-2"]]]
    run(job, character, tmp_path, 2)
    assert contents(tmp_path) == contents(one_by_one)


@pytest.mark.parametrize("finished", [2, 3])
def test_a_bake_stopped_within_a_batch_goes_on_to_the_same_bytes(
    job: BakeJob, character: Doll, one_by_one: Path, tmp_path: Path, finished: int
):
    first = run(job, character, tmp_path, 3, finished)
    second = run(job, character, tmp_path, 2)
    assert sorted(first + second) == sorted(["rest", *NAMES])
    assert contents(tmp_path) == contents(one_by_one)


@dataclass(frozen=True)
class Vanishing:
    """A body whose vertex 5 is nowhere once its right elbow bends."""

    character: Doll

    def positions(self, pose: Pose) -> np.ndarray:
        positions = self.character.positions(pose).copy()
        rig = self.character.rig
        if np.abs(pose.matrices - rig.rest)[rig.index["forearm_R"]].max() > 1e-6:
            positions[5] = np.nan
        return positions


def test_a_sample_that_fails_is_named_and_its_neighbours_are_kept(
    job: BakeJob, character: Doll, one_by_one: Path, tmp_path: Path
):
    finished = []
    with pytest.raises(ValueError, match=r"^Sample elbow_R-1: body_positions hold values .* not numbers"):
        for event in events(job, Vanishing(character), tmp_path, 3):
            finished.append(event.name)
    assert finished == ["rest", "elbow_L-0", "elbow_L-2"]
    assert run(job, character, tmp_path, 3) == ["elbow_R-1", "elbow_R-2"]
    assert contents(tmp_path) == contents(one_by_one)


def test_samples_whose_batch_lost_its_numbers_are_simulated_one_by_one(
    job: BakeJob, character: Doll, one_by_one: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    solve = BlockSystem.solve

    def spoiled(system: BlockSystem, *arguments) -> np.ndarray:
        iterations = solve(system, *arguments)
        if system.shape[0] > 1:
            solution = system.solution.numpy()
            solution[1, 100] = np.nan
            system.solution.assign(solution)
        return iterations

    monkeypatch.setattr(BlockSystem, "solve", spoiled)
    assert sorted(run(job, character, tmp_path, 2)) == sorted(["rest", *NAMES])
    assert contents(tmp_path) == contents(one_by_one)


def test_a_batch_of_no_sample_is_refused(job: BakeJob, character: Doll, tmp_path: Path):
    with pytest.raises(ValueError, match="A batch holds at least one sample, not 0"):
        SimulatedSamples(job, character, tmp_path, batch=0)


def test_a_garment_that_is_drawn_apart_settles_again_and_its_neighbour_does_not(job: BakeJob, character: Doll):
    """The cloth of one world is folded through itself: a few vertices are put two rings further along the sleeve."""

    def wearer(count: int) -> Wearer:
        return Wearer(character.rig, character.garment, character.body, character, job.settings, world_count=count)

    around = 8
    smooth = character.garment.positions
    folded = smooth.copy()
    folded[4 * around + 1 : 4 * around + 4] = smooth[7 * around + 1 : 7 * around + 4] + [0.0, 0.0, 0.01]
    rest = Pose.at_rest(character.rig)
    reports, shapes = [], []
    for garment in (smooth, folded):
        alone = wearer(1)
        alone.begin(garment, rest)
        reports += alone.settle()
        shapes += [*alone.positions]
    assert [report["untanglings"] for report in reports] == [0, 1]
    together = wearer(2)
    together.begin(np.stack([smooth, folded]), [rest, rest])
    assert together.settle() == reports
    assert np.array_equal(together.positions, shapes)
