"""Garments, meshes and poses at the end of what may be asked for: what each comes to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bake_outcomes import outcome_of
from dolls import Array, Doll, tube_along
from random_bakes import RADII, RANGES, RandomBake, kept, limb, path, with_slivers
from skeletons import scaled
from wrinkle_synthesis.wrinkle_addon.bake import BakeSettings
from wrinkle_synthesis.wrinkle_addon.fabrics import Fabric
from wrinkle_synthesis.wrinkle_addon.garment import Garment, skin_garment
from wrinkle_synthesis.wrinkle_addon.joints import find_joints, with_ranges
from wrinkle_synthesis.wrinkle_addon.plan import JointGrid, SamplePlan

RINGS, AROUND = 31, 16


def bake_of(
    name: str = "elbow_L",
    degrees: tuple[float, ...] = (60.0,),
    gap: float = 0.01,
    spoil=lambda positions, faces: (positions, faces),
    scale: float = 1.0,
    **settings,
) -> RandomBake:
    """A tube around the limb of a joint, this far from its skin [m], and one sample of the joint at these angles."""
    part, ranges = RANGES[name]
    rig, body = limb(part)
    joint = find_joints(rig).joints[name]
    assert joint is not None
    positions, faces = spoil(*tube_along(path(rig, part), RADII[part] + gap, RINGS, AROUND))
    if scale != 1.0:
        rig, positions, body = scaled(rig, scale), scale * positions, replace(body, positions=scale * body.positions)
    garment = Garment(
        "tube", positions, faces, skin_garment(positions, faces, body), np.zeros(len(positions), np.float32)
    )
    grid = JointGrid(with_ranges(joint, ranges), tuple((tuple(sorted({0.0, np.radians(a)}))) for a in degrees))
    settings = {"turn_step": float(np.radians(6.0)), **settings}
    return RandomBake(part, "tube", Doll(rig, body, garment, (joint,)), SamplePlan((grid,)), BakeSettings(**settings))


def ends_of(name: str) -> list[tuple[float, ...]]:
    """A joint at all its lowest and at all its highest angles."""
    lows, highs = zip(*RANGES[name][1], strict=True)
    return [lows, highs]


@pytest.mark.parametrize(
    ("name", "degrees"), [(name, degrees) for name in RANGES for degrees in ends_of(name)], ids=str
)
def test_a_joint_at_all_its_limits(name: str, degrees: tuple[float, ...], tmp_path: Path):
    drawn = bake_of(name, degrees)
    print(outcome_of(drawn, len(drawn.plan.simulated) - 1, tmp_path))


@pytest.mark.parametrize("gap", [-0.001, -0.005, -0.01, -0.02])
def test_a_garment_that_starts_in_the_body(gap: float, tmp_path: Path):
    print(outcome_of(bake_of(gap=gap), 0, tmp_path))


@pytest.mark.parametrize("times", [2.0, 3.0, 4.0])
def test_a_garment_a_few_times_too_large(times: float, tmp_path: Path):
    print(outcome_of(bake_of(gap=(times - 1.0) * RADII["arm"]), 0, tmp_path))


def strip(positions: Array, faces: Array) -> tuple[Array, Array]:
    columns = faces % AROUND
    return kept(positions, faces, (columns <= 1).all(1))


def cuff(positions: Array, faces: Array) -> tuple[Array, Array]:
    rings = faces // AROUND
    return kept(positions, faces, ((rings >= 10) & (rings <= 11)).all(1))


def triangle(positions: Array, faces: Array) -> tuple[Array, Array]:
    return kept(positions, faces, np.array([300]))


@pytest.mark.parametrize("spoil", [strip, cuff, triangle])
def test_a_garment_of_next_to_nothing(spoil, tmp_path: Path):
    print(outcome_of(bake_of(spoil=spoil), 0, tmp_path))


@pytest.mark.parametrize("aspect", [50.0, 1000.0, 1.0e5])
@pytest.mark.parametrize("material", ["plate", "hinges", "springs"])
def test_slivers(material, aspect: float, tmp_path: Path):
    def slivers(positions: Array, faces: Array) -> tuple[Array, Array]:
        return with_slivers(positions, faces, range(7, len(faces), 40), aspect), faces

    print(outcome_of(bake_of(spoil=slivers, fabric=Fabric(material=material)), 0, tmp_path))


@pytest.mark.parametrize("scale", [0.01, 0.1, 10.0, 100.0])
def test_units_that_are_no_metres(scale: float, tmp_path: Path):
    print(outcome_of(bake_of(scale=scale), 0, tmp_path))
