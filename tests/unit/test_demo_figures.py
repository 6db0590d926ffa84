"""The paper's figures: what their numbers mean, and where they are drawn from."""

from pathlib import Path

import numpy as np
import pytest
from wrinkle_synthesis.demo.figures import FINAL, FULL, compare_sums, curvature_colours
from wrinkle_synthesis.demo.recipe import QUICK
from wrinkle_synthesis.demo.results import Results


def test_sums_are_compared_by_level_by_course_and_by_swing() -> None:
    full = np.array([1.0, 3.0, 2.0, 4.0])
    found = compare_sums({FULL: full, FINAL: 0.5 * full, "against it": 5.0 - full})
    assert found[FULL] == pytest.approx({"ratio": 1.0, "correlation": 1.0, "fluctuation": 1.0})
    assert found[FINAL] == pytest.approx({"ratio": 0.5, "correlation": 1.0, "fluctuation": 0.5})
    assert found["against it"] == pytest.approx({"ratio": 1.0, "correlation": -1.0, "fluctuation": 1.0})


def test_a_garment_that_keeps_still_has_no_correlation() -> None:
    full = np.array([1.0, 3.0, 2.0, 4.0])
    assert compare_sums({FULL: full, FINAL: np.full(4, 2.0)})[FINAL]["correlation"] is None


def test_more_curvature_is_brighter() -> None:
    pytest.importorskip("matplotlib")
    colours = curvature_colours(np.array([0.0, 15.0, 30.0, 60.0, 600.0], np.float32))
    brightness = colours[:, :3].sum(1)
    assert (np.diff(brightness[:4]) > 0.0).all()
    assert brightness[4] == brightness[3]


def test_a_demo_tells_what_was_made_in_its_folder(tmp_path: Path) -> None:
    Results(tmp_path, QUICK.choices)
    assert Results.recipe_of(tmp_path)["garment"] == QUICK.garment
    with pytest.raises(ValueError, match="holds no demo"):
        Results.recipe_of(tmp_path / "stages")
