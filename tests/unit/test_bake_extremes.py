"""Garments, meshes and poses at the end of what may be asked for: what each comes to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bake_outcomes import outcome_of
from dolls import Array, Doll, tube_along
from random_bakes import RADII, RANGES, RandomBake, kept, limb, path, with_slivers
from skeletons import scaled
from wrinkle_synthesis.wrinkle_addon.fabrics import FABRICS, Fabric, Material
from wrinkle_synthesis.wrinkle_addon.garment import Garment, skin_garment
from wrinkle_synthesis.wrinkle_addon.joints import find_joints, with_ranges
from wrinkle_synthesis.wrinkle_addon.plan import JointGrid, SamplePlan
from wrinkle_synthesis.wrinkle_addon.wearer import BakeSettings

RINGS, AROUND = 31, 16


def bake_of(
    name: str = "elbow_L",
    degrees: tuple[float, ...] = (60.0,),
    gap: float = 0.01,
    spoil: Callable[[Array, Array], tuple[Array, Array]] = lambda positions, faces: (positions, faces),
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


def settled(drawn: RandomBake, folder: Path) -> dict:
    """The report of the grid's last node, checked; not one that diverged or was refused."""
    outcome = outcome_of(drawn, len(drawn.plan.simulated) - 1, folder)
    assert isinstance(outcome, dict), outcome
    return outcome


# --- poses --------------------------------------------------------------------------------------------------------


def limits() -> list:
    """Every joint at all its lowest and at all its highest angles; those of the elbow, a little beyond people's, take
    least time."""
    ends = [(name, end) for name, (_, ranges) in RANGES.items() for end in zip(*ranges, strict=True)]
    return [
        pytest.param(*end, id=f"{end[0]}{end[1]}", marks=[] if "elbow" in end[0] else pytest.mark.long) for end in ends
    ]


@pytest.mark.parametrize(("name", "degrees"), limits())
def test_a_joint_at_all_its_limits(name: str, degrees: tuple[float, ...], tmp_path: Path):
    settled(bake_of(name, degrees, turn_step=float(np.radians(12.0))), tmp_path)


# --- garments -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("depth", "ease"), [(0.001, 0.0), (0.005, 0.0), (0.01, 0.5), (0.02, 1.3)])
def test_a_garment_that_starts_in_the_body_comes_out_if_it_is_cut_wide_enough(
    depth: float, ease: float, tmp_path: Path
):
    assert settled(bake_of(degrees=(20.0,), gap=-depth, ease=(ease, 0.0)), tmp_path)["inside"] == 0


def test_a_garment_far_too_tight_stays_in_the_body_and_that_is_told(tmp_path: Path):
    """Half as wide as the arm: stretched to twice its width it presses harder than contact does."""
    report = settled(bake_of(degrees=(20.0,), gap=-0.02), tmp_path)
    assert report["inside"] > 100 and report["deepest_mm"] > 5.0


@pytest.mark.parametrize("times", [2.0, 3.0])
def test_a_garment_a_few_times_too_large(times: float, tmp_path: Path):
    settled(bake_of(degrees=(20.0,), gap=(times - 1.0) * RADII["arm"]), tmp_path)


def test_a_garment_too_large_to_be_worn_is_refused(tmp_path: Path):
    sentence = outcome_of(bake_of("spine", (0.0, 30.0, 0.0), gap=2.0 * RADII["trunk"]), 0, tmp_path)
    assert "is 0.24 m away from the body; put it on the body" in str(sentence)


def strip(positions: Array, faces: Array) -> tuple[Array, Array]:
    """One cell wide, along the arm."""
    return kept(positions, faces, (faces % AROUND <= 1).all(1))


def cuff(positions: Array, faces: Array) -> tuple[Array, Array]:
    """One cell wide, around the arm."""
    rings = faces // AROUND
    return kept(positions, faces, ((rings >= 10) & (rings <= 11)).all(1))


def pair(positions: Array, faces: Array) -> tuple[Array, Array]:
    return kept(positions, faces, np.array([300, 301]))


@pytest.mark.parametrize("spoil", [strip, cuff, pair])
def test_a_garment_of_next_to_nothing(spoil: Callable, tmp_path: Path):
    settled(bake_of(spoil=spoil), tmp_path)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == "thin" else pytest.mark.long) for name in FABRICS]
)
def test_a_garment_of_any_fabric_from_the_thinnest_to_the_stiffest(name: str, tmp_path: Path):
    settled(bake_of(fabric=FABRICS[name]), tmp_path)


def test_faces_that_are_not_sewn_together_are_refused(tmp_path: Path):
    drawn = bake_of(spoil=lambda positions, faces: kept(positions, faces, np.array([300])))
    sentence = "No two faces of the garment share an edge; merge vertices by distance."
    assert outcome_of(drawn, 0, tmp_path) == sentence


# --- meshes and units ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("aspect", "material"), [(50, "plate"), (50, "hinges"), (50, "springs"), (1000, "plate")])
def test_slivers(aspect: float, material: Material, tmp_path: Path):
    """Stiffness grows with the square of the aspect: at 1000 a determinant of it is more than float32 holds."""

    def slivers(positions: Array, faces: Array) -> tuple[Array, Array]:
        return with_slivers(positions, faces, range(7, len(faces), 40), aspect), faces

    settled(bake_of(degrees=(20.0,), spoil=slivers, fabric=Fabric(material=material)), tmp_path)


@pytest.mark.parametrize(("scale", "size"), [(0.01, "0.00566"), (100.0, "56.6")])
def test_units_that_are_no_metres_are_refused(scale: float, size: str, tmp_path: Path):
    sentence = outcome_of(bake_of(scale=scale), 0, tmp_path)
    assert sentence == (
        f"The body is {size} m tall; set the scene's unit scale, or the armature's, so that it has its true size."
    )
