"""The bake: resumable, the same bytes however it came about, mirrored where it may be, honest about bad input."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dolls import Doll, ShapedSamples, doll, grid_of
from wrinkle_synthesis.wrinkle_addon import database, storage
from wrinkle_synthesis.wrinkle_addon.bake import BakeEvent, BakeJob, SimulatedSamples, bake, finish
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase, sample_path
from wrinkle_synthesis.wrinkle_addon.garment import Body, Garment, SkinWeights
from wrinkle_synthesis.wrinkle_addon.plan import Sample, SamplePlan
from wrinkle_synthesis.wrinkle_addon.storage import StorageError
from wrinkle_synthesis.wrinkle_addon.symmetry import find_mirror


@pytest.fixture(scope="module")
def character() -> Doll:
    return doll()


def elbow_plan(character: Doll) -> SamplePlan:
    return SamplePlan((grid_of(character.joint("elbow_L"), [-20, 0, 20, 40, 60]),))


def bumps(character: Doll):
    return {"elbow_L": lambda angles: np.sin(angles[0]) * 0.01 * np.sin(40 * character.garment.positions)}


def contents(folder: Path) -> dict[str, bytes]:
    """The database's own files; states are scaffolding."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def drain(events: Iterator[BakeEvent]) -> list[str]:
    return [event.name for event in events]


def test_a_bake_says_what_it_did_and_how_long_the_rest_will_take(character: Doll, tmp_path: Path):
    plan = elbow_plan(character)
    events = list(bake(character.job(plan), ShapedSamples(character, plan), tmp_path))
    assert [event.name for event in events] == ["rest", "elbow_L-0", "elbow_L-2", "elbow_L-3", "elbow_L-4"]
    assert [event.done for event in events] == [1, 2, 3, 4, 5] and {event.total for event in events} == {5}
    assert events[-1].remaining == 0.0


def test_a_bake_stopped_after_any_sample_goes_on_to_the_same_bytes(character: Doll, tmp_path: Path):
    plan = elbow_plan(character)
    job = character.job(plan)
    drain(bake(job, ShapedSamples(character, plan, bumps(character)), tmp_path / "whole"))
    for stop in range(5):
        folder = tmp_path / f"stopped-{stop}"
        events = bake(job, ShapedSamples(character, plan, bumps(character)), folder)
        for _ in range(stop):
            next(events)
        events.close()
        with pytest.raises(StorageError, match=r"not finished|no database"):
            WrinkleDatabase.open(folder)
        left = drain(bake(job, ShapedSamples(character, plan, bumps(character)), folder))
        assert len(left) == 5 - stop
        assert contents(folder) == contents(tmp_path / "whole")


def test_shards_give_the_same_bytes_as_one_bake(character: Doll, tmp_path: Path):
    plan = elbow_plan(character)
    job = character.job(plan)
    drain(bake(job, ShapedSamples(character, plan, bumps(character)), tmp_path / "one"))
    for number in (2, 0, 1):
        drain(bake(job, ShapedSamples(character, plan, bumps(character)), tmp_path / "three", shard=(number, 3)))
    assert contents(tmp_path / "three") == contents(tmp_path / "one")


def test_a_finished_bake_does_nothing_again(character: Doll, tmp_path: Path):
    plan = elbow_plan(character)
    job = character.job(plan)
    drain(bake(job, ShapedSamples(character, plan), tmp_path))
    before = contents(tmp_path)
    assert drain(bake(job, ShapedSamples(character, plan), tmp_path)) == []
    assert contents(tmp_path) == before


def test_merging_writes_only_the_manifest(character: Doll, tmp_path: Path):
    plan = elbow_plan(character)
    job = character.job(plan)
    drain(bake(job, ShapedSamples(character, plan), tmp_path))
    before = contents(tmp_path)
    (tmp_path / "manifest.json").unlink()
    assert finish(job, tmp_path)
    assert contents(tmp_path) == before


def test_samples_come_back_to_a_twentieth_of_a_millimetre_in_half_the_bytes(character: Doll, tmp_path: Path):
    plan = elbow_plan(character)
    source = ShapedSamples(character, plan, bumps(character))
    drain(bake(character.job(plan), source, tmp_path))
    opened = WrinkleDatabase.open(tmp_path, check_hashes=True)
    for sample, stored in opened.samples():
        error = np.linalg.norm(opened.positions(sample) - source.sample(sample).positions, axis=1)
        kept = np.zeros(len(error), bool)
        kept[stored.vertices] = True
        assert error[kept].max() < database.HALF_ERROR + 1e-9
        assert error[~kept].max(initial=0.0) < database.LEAST_OFFSET + 1e-9
        arrays, _ = storage.read_arrays(sample_path(tmp_path, opened.header.key, sample))
        assert arrays["offsets"].dtype == np.float16
    assert opened.stored_bytes < 0.6 * plan.raw_bytes(character.garment.vertex_count) + 200_000


def test_large_offsets_are_kept_in_single_precision(character: Doll, tmp_path: Path):
    plan = elbow_plan(character)
    huge = {"elbow_L": lambda angles: np.full((character.garment.vertex_count, 3), 0.7 * angles[0])}
    source = ShapedSamples(character, plan, huge)
    drain(bake(character.job(plan), source, tmp_path))
    opened = WrinkleDatabase.open(tmp_path)
    last = Sample("elbow_L", (4,))
    assert np.abs(opened.positions(last) - source.sample(last).positions).max() < 1e-6


def test_the_key_changes_with_everything_that_a_sample_depends_on(character: Doll):
    plan = elbow_plan(character)
    garment = character.garment
    job = character.job(plan)
    moved = Garment(garment.name, garment.positions + [0, 0, 1e-4], garment.faces, garment.weights, garment.pins)
    pinned = Garment(garment.name, garment.positions, garment.faces, garment.weights, np.ones_like(garment.pins))
    biased = replace(garment, warp=np.tile([0.6, 0.8, 0.0], (len(garment.faces), 1)))
    body = Body(character.body.positions * 1.001, character.body.faces, character.body.weights)
    others = [
        character.job(SamplePlan((grid_of(character.joint("elbow_L"), [-20, 0, 20]),))),
        character.job(plan, ease=(0.01, 0.0)),
        character.job(plan, settle_tolerance=0.2),
        BakeJob(job.rig, moved, job.body, plan, job.settings),
        BakeJob(job.rig, pinned, job.body, plan, job.settings),
        BakeJob(job.rig, biased, job.body, plan, job.settings),
        BakeJob(job.rig, garment, body, plan, job.settings),
    ]
    assert len({job.key, *(other.key for other in others)}) == len(others) + 1
    assert character.job(plan).key == job.key


def test_on_a_symmetric_character_the_other_side_is_the_mirror_image(character: Doll, tmp_path: Path):
    mirror = find_mirror(character.rig, character.joints, character.garment, character.body)
    assert mirror is not None
    grids = [grid_of(character.joint(name), [0, 30, 60]) for name in ("elbow_L", "elbow_R")]
    plan = SamplePlan(tuple(grids), mirror)
    both = SamplePlan(tuple(grids))
    drain(bake(character.job(plan), ShapedSamples(character, plan), tmp_path / "mirrored"))
    drain(bake(character.job(both), ShapedSamples(character, both), tmp_path / "both"))
    mirrored, simulated = WrinkleDatabase.open(tmp_path / "mirrored"), WrinkleDatabase.open(tmp_path / "both")
    for sample in plan.samples:
        # The doll's skin weights are symmetric to single precision, so its skinned samples are as well.
        assert np.abs(mirrored.positions(sample) - simulated.positions(sample)).max() < 3e-4


@pytest.mark.parametrize("killed_after", [1, 3])
def test_our_own_solver_goes_on_from_a_killed_bake_to_the_same_bytes(tmp_path: Path, killed_after: int):
    small = doll(31, 12, ("elbow_L",))
    plan = SamplePlan((grid_of(small.joint("elbow_L"), [0, 10, 20]),))
    job = small.job(plan, settle_iterations=8)

    def run(folder: Path, count: int | None = None, shard: tuple[int, int] = (0, 1)) -> None:
        events = bake(job, SimulatedSamples(job, small, folder), folder, shard=shard)
        for _, _ in zip(range(10 if count is None else count), events, strict=False):
            pass

    run(tmp_path / "whole")
    run(tmp_path / "killed", killed_after)
    run(tmp_path / "killed")
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
    # A shard whose parents another machine bakes makes them itself, alike.
    run(tmp_path / "shards", shard=(1, 2))
    run(tmp_path / "shards", shard=(0, 2))
    assert contents(tmp_path / "shards") == contents(tmp_path / "whole")


def break_header(folder: Path) -> None:
    path = next(folder.glob("header-*"))
    path.write_bytes(path.read_bytes()[:100])


def break_version(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "format": 99}))


def swap_sample(folder: Path) -> None:
    a, b = sorted(folder.glob("elbow_L-0-*"))[0], sorted(folder.glob("rest-*"))[0]
    a.write_bytes(b.read_bytes())


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda folder: sorted(folder.glob("elbow_L-3-*"))[0].unlink(), r"elbow_L-3-\w+\.safetensors is missing"),
        (lambda folder: (folder / "manifest.json").unlink(), "not finished"),
        (lambda folder: (folder / "manifest.json").write_text("{"), "damaged"),
        (break_version, "format 99, this version reads 1"),
        (break_header, "damaged or truncated"),
        (swap_sample, "does not hold a sample of this garment"),
    ],
)
def test_a_damaged_database_is_refused_in_one_sentence(character: Doll, tmp_path: Path, damage, sentence: str):
    plan = elbow_plan(character)
    drain(bake(character.job(plan), ShapedSamples(character, plan), tmp_path))
    damage(tmp_path)
    with pytest.raises(StorageError, match=sentence):
        list(WrinkleDatabase.open(tmp_path).samples())


def test_a_changed_byte_is_found_by_its_hash(character: Doll, tmp_path: Path):
    plan = elbow_plan(character)
    drain(bake(character.job(plan), ShapedSamples(character, plan), tmp_path))
    path = sorted(tmp_path.glob("elbow_L-3-*"))[0]
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(StorageError, match=r"elbow_L-3.*is damaged"):
        WrinkleDatabase.open(tmp_path, check_hashes=True)


def changed(garment: Garment, **values) -> Garment:
    return Garment(
        garment.name, values.get("positions", garment.positions), values.get("faces", garment.faces),
        values.get("weights", garment.weights), values.get("pins", garment.pins),
    )  # fmt: skip


def with_nan(garment: Garment) -> Garment:
    positions = garment.positions.copy()
    positions[3, 1] = np.nan
    return changed(garment, positions=positions)


def with_loose_vertex(garment: Garment) -> Garment:
    weights = SkinWeights(
        np.concatenate([garment.weights.bones, garment.weights.bones[:1]]),
        np.concatenate([garment.weights.weights, garment.weights.weights[:1]]),
    )
    return changed(
        garment, positions=np.concatenate([garment.positions, garment.positions[:1]]), weights=weights,
        pins=np.zeros(garment.vertex_count + 1, np.float32),
    )  # fmt: skip


def with_flat_face(garment: Garment) -> Garment:
    positions = garment.positions.copy()
    a, b, c = garment.faces[0]
    positions[c] = 0.5 * (positions[a] + positions[b])
    return changed(garment, positions=positions)


def with_third_face(garment: Garment) -> Garment:
    a, b = garment.faces[400, :2]
    return changed(garment, faces=np.concatenate([garment.faces, [[a, b, 3]]]).astype(np.int32))


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (with_nan, "1 vertices of the garment 'sleeve' have positions that are not numbers"),
        (with_loose_vertex, "1 loose vertices"),
        (with_flat_face, "faces without area"),
        (with_third_face, "edges with more than two faces"),
        (lambda g: changed(g, faces=np.zeros((0, 3), np.int32)), "has no faces"),
        (lambda g: changed(g, positions=g.positions + [0, 0, 3.0]), "m away from the body"),
        (lambda g: changed(g, positions=shrunk(g)), "more than 30 mm inside the body"),
    ],
)
def test_a_garment_that_cannot_be_baked_is_refused_in_one_sentence(character: Doll, spoil, sentence: str):
    with pytest.raises(ValueError, match=sentence):
        BakeJob(
            character.rig,
            spoil(character.garment),
            character.body,
            elbow_plan(character),
            character.job(elbow_plan(character)).settings,
        )


def shrunk(garment: Garment) -> np.ndarray:
    """The sleeve drawn together to a string inside the arms."""
    rings = garment.positions.reshape(61, 16, 3)
    centres = rings.mean(1, keepdims=True)
    return (centres + 0.05 * (rings - centres)).reshape(-1, 3)


def test_a_body_without_faces_is_refused(character: Doll):
    bare = Body(character.body.positions, np.zeros((0, 3), np.int32), character.body.weights)
    with pytest.raises(ValueError, match="body has no faces"):
        BakeJob(
            character.rig, character.garment, bare, elbow_plan(character), character.job(elbow_plan(character)).settings
        )


def test_a_full_disk_stops_the_bake_and_leaves_what_is_finished(character: Doll, tmp_path: Path, monkeypatch):
    plan = elbow_plan(character)
    job = character.job(plan)
    events = bake(job, ShapedSamples(character, plan), tmp_path)
    next(events), next(events)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(StorageError, match="the disk is full"):
        next(events)
    monkeypatch.undo()
    assert not list(tmp_path.glob("*.tmp")) and not list(tmp_path.glob(".*"))
    assert drain(bake(job, ShapedSamples(character, plan), tmp_path)) == ["elbow_L-2", "elbow_L-3", "elbow_L-4"]
