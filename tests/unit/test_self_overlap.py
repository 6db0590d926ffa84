"""Poses in which the body passes through itself: told from mere creases, left out of the bake, and stood in for."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from dolls import grid_of, tube_along, weights_by_distance
from skeletons import human
from wrinkle_synthesis.wrinkle_addon import rotations, self_overlap
from wrinkle_synthesis.wrinkle_addon.bake import BakeJob, SampleShape, bake
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase, sample_frame, write_sample
from wrinkle_synthesis.wrinkle_addon.garment import Body, Garment, skin_garment
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import Formulation, JointWrinkles
from wrinkle_synthesis.wrinkle_addon.joints import find_joints
from wrinkle_synthesis.wrinkle_addon.plan import Sample, SamplePlan
from wrinkle_synthesis.wrinkle_addon.rig import FloatArray, IntArray, Joint, Rig
from wrinkle_synthesis.wrinkle_addon.self_overlap import (
    MOST_AWAY,
    SelfOverlap,
    describe_left_out,
    leave_out_overlaps,
)
from wrinkle_synthesis.wrinkle_addon.storage import StorageError
from wrinkle_synthesis.wrinkle_addon.symmetry import find_mirror
from wrinkle_synthesis.wrinkle_addon.wearer import BakeSettings

CROSSED, CLOSE = -30.0, -8.0
"""Sideways swings of one leg [degrees]: through the other one, and just up to it."""


@dataclass(frozen=True, eq=False)
class Legs:
    """Two legs that are tubes, in two wider ones."""

    rig: Rig
    body: Body
    trousers: Garment

    def joint(self, name: str) -> Joint:
        joint = find_joints(self.rig).joints[name]
        assert joint is not None
        return joint

    def areas(self, overlap: SelfOverlap, name: str, *degrees: float) -> tuple[float, float]:
        return overlap.areas(self.joint(name), np.radians(degrees))

    def leaves_place(self, overlap: SelfOverlap, name: str, *degrees: float) -> bool:
        return overlap.leaves_place(self.joint(name), np.radians(degrees))


def tubes(rig: Rig, radius: float, rings: int, around: int) -> tuple[FloatArray, IntArray]:
    positions, faces = [], []
    for side in "LR":
        path = [rig.heads[rig.index[f"{part}_{side}"]] for part in ("thigh", "shin", "foot")]
        points, triangles = tube_along(path, radius, rings, around)
        faces.append(triangles + sum(map(len, positions)))
        positions.append(points)
    # One side is the other's mirror image to the bit.
    positions[1] = positions[0] * [-1.0, 1.0, 1.0]
    faces[1] = faces[0][:, ::-1] + len(positions[0])
    return np.concatenate(positions), np.concatenate(faces).astype(np.int32)


@cache
def legs() -> Legs:
    rig = human()
    positions, faces = tubes(rig, 0.07, 41, 16)
    body = Body(positions, faces, weights_by_distance(rig, positions))
    positions, faces = tubes(rig, 0.085, 31, 12)
    weights = skin_garment(positions, faces, body)
    return Legs(rig, body, Garment("trousers", positions, faces, weights, np.zeros(len(positions), np.float32)))


# --- how far --------------------------------------------------------------------------------------------------------


def test_legs_that_pass_through_each_other_leave_no_place_and_a_bent_knee_does() -> None:
    overlap = SelfOverlap(legs().rig, legs().trousers, legs().body)
    assert legs().areas(overlap, "hip_L", 0, 0, 0) == (0.0, 0.0)
    assert legs().leaves_place(overlap, "hip_L", 0, 0, CLOSE)
    assert not legs().leaves_place(overlap, "hip_L", 0, 0, CROSSED)
    # Raised, it crosses in front of the other one.
    assert legs().leaves_place(overlap, "hip_L", 0, 60, CROSSED)
    # The calf presses into the thigh, but in the crease alone; bent on, the shin comes through it.
    pressed, away = legs().areas(overlap, "knee_L", 130)
    assert pressed > MOST_AWAY > away and legs().leaves_place(overlap, "knee_L", 130)
    assert not legs().leaves_place(overlap, "knee_L", 150)


def test_too_much_is_buried_in_a_crease_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    overlap = SelfOverlap(legs().rig, legs().trousers, legs().body)
    pressed, away = legs().areas(overlap, "knee_L", 130)
    monkeypatch.setattr(self_overlap, "MOST_BURIED", 0.9 * pressed)
    assert away < MOST_AWAY and not legs().leaves_place(overlap, "knee_L", 130)


def test_both_sides_are_measured_alike() -> None:
    overlap = SelfOverlap(legs().rig, legs().trousers, legs().body)
    areas = [legs().areas(overlap, name, 0, 0, CROSSED)[1] for name in ("hip_L", "hip_R")]
    assert areas[0] == pytest.approx(areas[1], rel=0.05)


def test_what_lies_inside_the_body_at_rest_does_not_count() -> None:
    whole = legs()
    bone, bone_faces = tubes(whole.rig, 0.02, 41, 16)
    count = len(whole.body.positions)
    stuffed = Body(
        np.concatenate([whole.body.positions, bone]),
        np.concatenate([whole.body.faces, bone_faces + count]),
        np.concatenate([whole.body.weights, weights_by_distance(whole.rig, bone)]),
    )
    overlap = SelfOverlap(whole.rig, whole.trousers, stuffed)
    for angle in (0.0, 30.0):
        assert whole.areas(overlap, "hip_L", 0, 0, angle) == (0.0, 0.0)


def test_limbs_far_from_the_garment_do_not_count() -> None:
    whole = legs()
    shins = Garment("socks", *tubes(whole.rig, 0.085, 31, 12), whole.trousers.weights, whole.trousers.pins)
    low = shins.positions[:, 2] < 0.12
    faces = shins.faces[low[shins.faces].all(1)]
    used = np.unique(faces)
    socks = replace(shins, positions=shins.positions[used], faces=np.searchsorted(used, faces).astype(np.int32))
    # The shin comes through the thigh.
    assert min(whole.areas(SelfOverlap(whole.rig, whole.trousers, whole.body), "knee_L", 140)) > 0.0
    assert whole.areas(SelfOverlap(whole.rig, socks, whole.body), "knee_L", 140) == (0.0, 0.0)


# --- what it does to a plan -----------------------------------------------------------------------------------------


def plan_of(names: Sequence[str] = ("hip_L", "hip_R"), *, mirrored: bool = True) -> SamplePlan:
    joints = [legs().joint(name) for name in names]
    mirror = find_mirror(legs().rig, joints, legs().trousers, legs().body) if mirrored else None
    assert (mirror is not None) == mirrored
    sideways = {name: [CROSSED, CLOSE, 0.0, 20.0] for name in names}
    if mirror is not None and mirror.signs["hip_L"][2] < 0:
        sideways["hip_R"] = sorted(-angle for angle in sideways["hip_L"])
    grids = tuple(grid_of(joint, [0], [0], sideways[joint.name]) for joint in joints)
    return SamplePlan(grids, mirror)


def left_out(plan: SamplePlan) -> SamplePlan:
    return leave_out_overlaps(plan, legs().rig, legs().trousers, legs().body)


def test_a_pose_without_a_place_is_left_out_on_both_sides() -> None:
    for mirrored in (True, False):
        plan = left_out(plan_of(mirrored=mirrored))
        turned = {sample.joint: np.degrees(plan.angles(sample)[2]) for sample in plan.left_out}
        assert turned.keys() == {"hip_L", "hip_R"} and np.allclose(np.abs([*turned.values()]), -CROSSED)
        assert len(plan.samples) == 6 and len(plan.simulated) == (2 if mirrored else 4)
        assert not plan.left_out & {*plan.simulated}
        assert "In 2 of 7 samples limbs pass through each other" in describe_left_out(plan)


def test_a_plan_with_a_place_everywhere_is_as_it_was() -> None:
    knee = legs().joint("knee_L")
    plan = SamplePlan((grid_of(knee, [0, 60, 120]),))
    assert left_out(plan).simulated == plan.samples and describe_left_out(left_out(plan)) == ""
    assert job_of(left_out(plan)).key == job_of(plan).key


def test_what_is_left_out_takes_part_in_the_key() -> None:
    assert job_of(left_out(plan_of())).key != job_of(plan_of()).key


# --- what is baked --------------------------------------------------------------------------------------------------


def job_of(plan: SamplePlan) -> BakeJob:
    return BakeJob(legs().rig, legs().trousers, legs().body, plan, BakeSettings())


@dataclass(frozen=True, eq=False)
class Waves:
    """Samples that are skinning with waves of a centimetre in the skinned frame."""

    job: BakeJob

    def rest(self) -> SampleShape:
        return SampleShape(self.job.garment.positions, {"residual": 0.0})

    def batches(self, wanted: Sequence[Sample]) -> Iterator[dict[Sample, SampleShape]]:
        return ({sample: self.shape(sample)} for sample in wanted)

    def shape(self, sample: Sample) -> SampleShape:
        skinned, turns = sample_frame(self.job.header, self.job.garment.positions, sample)
        return SampleShape(skinned + rotations.rotate(turns, self.offsets(sample)), {"residual": 0.1, "inside": 3})

    def offsets(self, sample: Sample) -> FloatArray:
        return 0.01 * np.sin(30.0 * self.job.garment.positions + self.job.plan.angles(sample)[2])


def baked(plan: SamplePlan, folder: Path, shards: int = 1) -> WrinkleDatabase:
    job = job_of(plan)
    for number in range(shards):
        for event in bake(job, Waves(job), folder, shard=(number, shards)):
            assert event.name == "rest" or event.name in {sample.name for sample in plan.simulated}
    return WrinkleDatabase.open(folder, check_hashes=True)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("mirrored", [True, False])
def test_it_has_the_wrinkles_of_the_nearest_sample_in_its_own_pose(tmp_path: Path, mirrored: bool) -> None:
    plan = left_out(plan_of(mirrored=mirrored))
    database = baked(plan, tmp_path)
    for sample in plan.left_out & {*plan.originals}:
        stand_in = plan.stand_ins[sample]
        assert np.degrees(np.abs(plan.angles(stand_in)[2])) == pytest.approx(-CLOSE)
        assert database.sample(sample).report == {"stand_in": stand_in.name}
        mine, its = database.sample(sample), database.sample(stand_in)
        np.testing.assert_array_equal(mine.vertices, its.vertices)
        np.testing.assert_allclose(mine.offsets, its.offsets, atol=1e-5)
        # Carried to its own pose, not left in the other one.
        skinned, _ = sample_frame(database.header, database.rest, sample)
        assert np.linalg.norm(database.positions(sample) - skinned, axis=1).max() < 0.02


def test_its_mirror_image_is_the_other_sides(tmp_path: Path) -> None:
    plan = left_out(plan_of())
    assert plan.mirror is not None
    database = baked(plan, tmp_path)
    for image in plan.left_out:
        original = plan.image(image)
        if original is not None:
            report = database.sample(image).report
            assert report == {"stand_in": plan.stand_ins[original].name, "mirrored": original.name}
            expected = plan.mirror.reflect_garment(database.positions(original))
            np.testing.assert_allclose(database.positions(image), expected, atol=3e-4)
            found = database.mirrored(image)
            assert found is not None and found[0] == original


def test_without_any_other_sample_it_is_skinned(tmp_path: Path) -> None:
    grid = grid_of(legs().joint("hip_L"), [0], [0], [CROSSED, 0])
    plan = left_out(SamplePlan((grid,)))
    assert plan.simulated == ()
    database = baked(plan, tmp_path)
    (sample,) = plan.samples
    assert len(database.sample(sample).vertices) == 0


def test_shards_and_an_interrupted_bake_give_the_bytes_of_one_bake(tmp_path: Path) -> None:
    plan = left_out(plan_of())
    baked(plan, tmp_path / "one")
    baked(plan, tmp_path / "shards", shards=2)
    job = job_of(plan)
    events = bake(job, Waves(job), tmp_path / "stopped")
    next(events), next(events)
    events.close()
    baked(plan, tmp_path / "stopped")
    assert contents(tmp_path / "one") == contents(tmp_path / "shards") == contents(tmp_path / "stopped")


@pytest.mark.parametrize("written", range(6))
def test_a_bake_that_ends_between_a_sample_and_what_is_made_from_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: int
) -> None:
    plan = left_out(plan_of())
    baked(plan, tmp_path / "whole")
    count = 0

    def write_some(*arguments: Any) -> None:
        nonlocal count
        if count == written:
            raise StorageError("The disk is full.")
        count += 1
        write_sample(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr("wrinkle_synthesis.wrinkle_addon.bake.write_sample", write_some)
        with pytest.raises(StorageError):
            baked(plan, tmp_path / "torn")
    baked(plan, tmp_path / "torn")
    assert contents(tmp_path / "torn") == contents(tmp_path / "whole")


@pytest.mark.parametrize("formulation", [Formulation.OFFSETS, Formulation.PAPER, Formulation.NEAREST])
def test_every_formulation_plays_it_in_its_own_pose(tmp_path: Path, formulation: Formulation) -> None:
    plan = left_out(plan_of(("hip_L",), mirrored=False))
    database = baked(plan, tmp_path)
    (sample,) = plan.left_out
    evaluator = JointWrinkles(database, formulation).bind("cpu")
    out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device="cpu")
    evaluator.evaluate(job_of(plan).pose(sample), out)
    # Half precision, and offsets that are too small to be stored.
    np.testing.assert_allclose(out.numpy(), database.positions(sample), atol=3e-4)


def test_it_can_be_corrected_by_hand_and_restored(tmp_path: Path) -> None:
    plan = left_out(plan_of())
    database = baked(plan, tmp_path)
    sample = next(iter(plan.stand_ins))
    before = database.positions(sample)
    corrected = database.corrected(sample, before + [0.0, 0.0, 0.01])
    np.testing.assert_allclose(corrected.positions(sample), before + [0.0, 0.0, 0.01], atol=3e-4)
    np.testing.assert_array_equal(corrected.restored(sample).positions(sample), before)
