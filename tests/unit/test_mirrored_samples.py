"""Which baked sample is the mirror image of which, told from the database alone."""

from pathlib import Path

import numpy as np
from baked_dolls import baked
from dolls import doll, grid_of
from wrinkle_synthesis.wrinkle_addon.plan import Sample, SamplePlan
from wrinkle_synthesis.wrinkle_addon.symmetry import find_mirror


def plan(mirrored: bool) -> tuple:
    character = doll(21, 8, ("elbow_L", "elbow_R"))
    mirror = find_mirror(character.rig, character.joints, character.garment, character.body)
    assert mirror is not None
    degrees = [-30, 0, 30, 60]
    other = sorted(mirror.signs["elbow_L"][0] * np.array(degrees))
    grids = (grid_of(character.joint("elbow_L"), degrees), grid_of(character.joint("elbow_R"), other))
    return character, SamplePlan(grids, mirror if mirrored else None)


def test_images_are_each_others_at_mirrored_angles(tmp_path: Path) -> None:
    character, samples = plan(mirrored=True)
    database = baked(tmp_path / "a.wrinkles", character, samples)
    for sample in samples.samples:
        found = database.mirrored(sample)
        assert found is not None
        other, mirror = found
        assert other.joint != sample.joint
        back = database.mirrored(other)
        assert back is not None and back[0] == sample
        angles = mirror.signs[sample.joint] * samples.angles(sample)
        np.testing.assert_allclose(samples.angles(other), angles)
        # What the bake wrote there; offsets under 0.1 mm are left out, and some are stored as float16.
        image = mirror.reflect_garment(database.positions(sample))
        np.testing.assert_allclose(database.positions(other), image, atol=2.5e-4)


def test_sides_that_were_simulated_one_by_one_are_no_images(tmp_path: Path) -> None:
    character, samples = plan(mirrored=False)
    database = baked(tmp_path / "a.wrinkles", character, samples)
    assert all(database.mirrored(Sample("elbow_L", index)) is None for index in ((0,), (2,)))
