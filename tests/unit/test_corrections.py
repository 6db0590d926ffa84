"""Samples corrected by hand: the bake is kept, every version can come back, and poses near the sample change (W08)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from baked_dolls import baked, bump, full_plan
from dolls import Doll, doll
from wrinkle_synthesis.wrinkle_addon import storage
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase, sample_path
from wrinkle_synthesis.wrinkle_addon.folder_lock import FolderLock
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import JointWrinkles
from wrinkle_synthesis.wrinkle_addon.plan import Sample
from wrinkle_synthesis.wrinkle_addon.rig import pose_of_angles
from wrinkle_synthesis.wrinkle_addon.storage import StorageError

SAMPLE = Sample("elbow_L", (3,))
TOLERANCE = 2.0e-4
"""What a database may lose [m]: offsets below 0.1 mm are left out, half precision costs 0.05 mm at most."""


@pytest.fixture
def character() -> Doll:
    return doll(21, 8)


@pytest.fixture
def database(character: Doll, tmp_path: Path) -> WrinkleDatabase:
    return baked(tmp_path, character, full_plan(character), {"elbow_L": bump(character, "elbow_L")})


def dented(database: WrinkleDatabase) -> np.ndarray:
    """The sample with its vertices around the left elbow 30 mm further forward."""
    positions = database.positions(SAMPLE)
    near = np.linalg.norm(positions - positions[np.abs(positions[:, 0] - 0.5).argmin()], axis=1) < 0.1
    assert near.any()
    positions[near, 1] -= 0.03
    return positions


def test_a_correction_counts_and_the_baked_file_stays(database: WrinkleDatabase) -> None:
    path = sample_path(database.folder, database.header.key, SAMPLE)
    before, shape = path.read_bytes(), dented(database)
    database.corrected(SAMPLE, shape)
    opened = WrinkleDatabase.open(database.folder, check_hashes=True)
    np.testing.assert_allclose(opened.positions(SAMPLE), shape, atol=TOLERANCE)
    assert opened.sample(SAMPLE).report["corrected"]
    assert path.read_bytes() == before


def test_every_version_can_come_back(database: WrinkleDatabase) -> None:
    baked_shape, first = database.positions(SAMPLE), dented(database)
    database.corrected(SAMPLE, first)
    latest = database.corrected(SAMPLE, first + [0.0, 0.0, 0.01])
    for version, shape in ((2, first + [0.0, 0.0, 0.01]), (1, first), (0, baked_shape)):
        latest.restored(SAMPLE, version)
        np.testing.assert_allclose(
            WrinkleDatabase.open(database.folder).positions(SAMPLE), shape, atol=TOLERANCE, err_msg=str(version)
        )
    with pytest.raises(ValueError, match="2 corrections, but no version 3"):
        latest.restored(SAMPLE, 3)
    # Going back and correcting again writes over nothing.
    again = WrinkleDatabase.open(database.folder).corrected(SAMPLE, baked_shape + [0.0, 0.01, 0.0])
    np.testing.assert_allclose(again.restored(SAMPLE, 1).positions(SAMPLE), first, atol=TOLERANCE)


def test_poses_near_the_sample_change_and_those_beyond_its_neighbours_do_not(
    character: Doll, database: WrinkleDatabase
) -> None:
    corrected = database.corrected(SAMPLE, dented(database))
    grid = database.header.plan.grid["elbow_L"]
    node = grid.angles[0]

    def change(angle: float) -> float:
        pose = pose_of_angles(character.rig, character.joints, {"elbow_L": [angle]})
        shapes = [JointWrinkles(each).bind().positions(pose) for each in (database, corrected)]
        return float(np.abs(shapes[1] - shapes[0]).max())

    at = change(node[3])
    # The largest of the 30 mm along one axis, in the frame that the skin turned.
    assert 0.02 < at < 0.035
    assert change(0.5 * (node[3] + node[4])) == pytest.approx(0.5 * at, rel=0.02)
    assert change(0.5 * (node[1] + node[2])) < 1e-6


def test_a_damaged_or_missing_correction_is_named(database: WrinkleDatabase) -> None:
    database.corrected(SAMPLE, dented(database))
    path = next(database.folder.glob("*-edit-1.safetensors"))
    whole = path.read_bytes()
    path.write_bytes(whole[:-4] + b"\0\0\0\1")
    with pytest.raises(StorageError, match=r"edit-1\.safetensors is damaged"):
        WrinkleDatabase.open(database.folder, check_hashes=True)
    path.unlink()
    with pytest.raises(StorageError, match=r"edit-1\.safetensors is missing"):
        WrinkleDatabase.open(database.folder)
    path.write_bytes(whole)
    listed = next(database.folder.glob("corrections-*.json"))
    storage.write_json(listed, {"format": 1, "samples": {"elbow_L-3": {"current": 7, "hashes": []}}})
    with pytest.raises(StorageError, match="names a version of elbow_L-3 that is not there"):
        WrinkleDatabase.open(database.folder)
    listed.write_text("{")
    with pytest.raises(StorageError, match="damaged"):
        WrinkleDatabase.open(database.folder)


def test_corrections_of_another_bake_do_not_count(database: WrinkleDatabase, character: Doll) -> None:
    database.corrected(SAMPLE, dented(database))
    other = baked(database.folder, doll(23, 8), full_plan(doll(23, 8)))
    assert other.header.key != database.header.key
    assert not other.corrections.samples


def test_two_writers_at_once_are_refused(database: WrinkleDatabase) -> None:
    with FolderLock(database.folder), pytest.raises(StorageError, match="Another Blender"):
        database.corrected(SAMPLE, dented(database))
