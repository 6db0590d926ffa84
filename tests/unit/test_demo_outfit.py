"""Garments worn over each other: as one mesh they keep their order, and are measured each by itself and together."""

from pathlib import Path

import numpy as np
import pytest
from cloth_shapes import raised, sheet, sphere
from wrinkle_synthesis.demo.figures import FULL, SKINNING
from wrinkle_synthesis.demo.outfit import COARSE, WHOLE, Outfit, join_caches, measure_outfit
from wrinkle_synthesis.wrinkle_addon.evaluate import OURS
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache, write_pc2

OUTER, INNER = sheet(4, 4, 0.2, 0.2), sheet(2, 2, 0.2, 0.2)
CORNER = len(OUTER[0])
"""Of the outfit, the inner garment's first vertex."""


@pytest.fixture
def outfit() -> Outfit:
    """Two sheets above a ball, in two frames."""
    ball, ball_faces = sphere(0.1)
    faces = np.concatenate([OUTER[1], INNER[1] + CORNER])
    return Outfit((7, 8), faces, {"coat": CORNER, "shirt": len(INNER[0])}, np.stack([ball, ball]), ball_faces)


@pytest.fixture
def full() -> np.ndarray:
    """The outer sheet 20 mm above the inner one; both are bent more in the second frame."""
    flat = np.concatenate([raised(OUTER[0], 0.16), raised(INNER[0], 0.14)])
    # In an exact plane rounding decides what passes through what.
    flat += 1e-4 * np.random.default_rng(1).standard_normal(flat.shape)
    return np.stack([flat + [0.0, 0.0, bend] * flat[:, :1] ** 2 for bend in (0.1, 0.5)])


def test_every_garment_has_its_vertices_and_triangles(outfit: Outfit) -> None:
    assert outfit.parts == {"coat": slice(0, 25), "shirt": slice(25, 34), WHOLE: slice(0, 34)}
    np.testing.assert_array_equal(outfit.faces_of(outfit.parts["coat"]), OUTER[1])
    np.testing.assert_array_equal(outfit.faces_of(outfit.parts["shirt"]), INNER[1])
    np.testing.assert_array_equal(outfit.faces_of(outfit.parts[WHOLE]), outfit.faces)


def test_garments_are_compared_each_by_itself_and_together(outfit: Outfit, full: np.ndarray) -> None:
    ours = full.copy()
    # 3 mm beside the full simulation, the outer garment alone.
    ours[:, :CORNER, 0] += 0.003
    found = measure_outfit(outfit, {SKINNING: ours, COARSE: ours, OURS: ours, FULL: full})
    assert [each["vertices"] for each in found.values()] == [25, 9, 34]
    errors = {name: each["rmse_mm"][OURS] for name, each in found.items()}
    assert errors == pytest.approx({"coat": 3.0, "shirt": 0.0, WHOLE: 3.0 * np.sqrt(25 / 34)})
    assert [frame["frame"] for frame in found[WHOLE]["frames"]] == [7, 8]
    assert found[WHOLE]["frames"][1]["rmse_mm"][SKINNING] == pytest.approx(errors[WHOLE])
    assert found["shirt"]["curvature"][OURS]["ratio"] == 1.0
    assert not any(found[WHOLE][what][OURS] for what in ("inside", "passing", "between"))


def test_what_passes_through_another_garment_or_the_body_is_told_of_whom(outfit: Outfit, full: np.ndarray) -> None:
    ours = full.copy()
    # The outer garment dips through the inner one, whose corner goes to the middle of the ball.
    ours[:, :CORNER, 2] -= 0.3 * (0.15 - ours[:, :CORNER, 0])
    ours[:, CORNER] = 0.0
    found = measure_outfit(outfit, {SKINNING: ours, COARSE: full, OURS: ours, FULL: full})
    assert found[WHOLE]["between"][OURS] == found[WHOLE]["passing"][OURS] > 0.0
    assert not any(found[garment]["passing"][OURS] for garment in outfit.counts)
    assert not any(found[WHOLE]["between"][made] for made in (COARSE, FULL))
    shares = [each["inside"][OURS] for each in found.values()]
    assert shares == pytest.approx([0.0, 1 / 9, 1 / 34]) and found[WHOLE]["inside"][FULL] == 0.0


def test_caches_of_garments_become_one_in_their_order(tmp_path: Path) -> None:
    parts = [tmp_path / "coat.pc2", tmp_path / "shirt.pc2"]
    shapes = [np.full((2, count, 3), count, np.float32) for count in (4, 3)]
    for part, frames in zip(parts, shapes, strict=True):
        write_pc2(part, frames.shape[1], 7.0, frames, 2)
    join_caches(parts, tmp_path / "outfit.pc2")
    made = PointCache(tmp_path / "outfit.pc2")
    assert made.start == 7.0 and not any(part.exists() for part in parts)
    np.testing.assert_array_equal(made.frames, np.concatenate(shapes, axis=1))
