"""Influence of joints, as the artist sees it: colours on the garment, plots, and weights made of it."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon import plots
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase
from wrinkle_synthesis.wrinkle_addon.influence import influence_colours, measure_influence, scaled_influence
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import BlendWeights, JointWrinkles


@pytest.fixture
def arm(database: Path, bumps: Bumps) -> Arm:
    empty_scene()
    arm = build_arm("", database)
    bpy.context.view_layer.objects.active = arm.sleeve
    return arm


@pytest.fixture
def file(arm: Arm, tmp_path: Path) -> Path:
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    return tmp_path / "arm.blend"


def expected_colours(database: Path, joint: str) -> np.ndarray:
    opened = WrinkleDatabase.open(database)
    return influence_colours(
        scaled_influence(measure_influence(opened.header, opened.rest, dict(opened.samples()))[joint])
    )


def painted(garment: bpy.types.Object, joint: str) -> np.ndarray:
    data = garment.data.color_attributes[f"influence_{joint}"].data
    colours = np.empty(4 * len(data), np.float32)
    data.foreach_get("color", colours)
    return colours.reshape(-1, 4)


def test_the_operator_colours_the_garment_and_shows_the_chosen_joint(arm: Arm, database: Path) -> None:
    arm.sleeve.wrinkles.active_joint = 1
    assert bpy.ops.wrinkle.show_influence() == {"FINISHED"}
    assert arm.sleeve.data.color_attributes.active_color.name == "influence_shoulder_L"
    for joint in ("elbow_L", "shoulder_L"):
        np.testing.assert_allclose(painted(arm.sleeve, joint), expected_colours(database, joint), atol=1e-6)
    # Pressed again, it writes to the same attributes.
    assert bpy.ops.wrinkle.show_influence() == {"FINISHED"}
    assert len(arm.sleeve.data.color_attributes) == 2


def test_a_joint_that_was_not_sampled_is_refused(arm: Arm) -> None:
    arm.sleeve.wrinkles.joints[0].name = "knee_L"
    with pytest.raises(RuntimeError, match="no samples of a joint 'knee_L'"):
        bpy.ops.wrinkle.show_influence()


def test_a_garment_in_edit_mode_is_not_painted(arm: Arm) -> None:
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Leave edit mode"):
        bpy.ops.wrinkle.show_influence()
    bpy.ops.object.mode_set(mode="OBJECT")


def test_the_verb_tells_and_paints(wrinkle, file: Path, database: Path, tmp_path: Path) -> None:
    out = tmp_path / "coloured.blend"
    result = wrinkle("influence", file, "--out", out, "--json").result
    elbow = result["joints"]["elbow_L"]
    assert elbow["samples"] == 3 and elbow["largest_mm"] > 0.0
    assert set(elbow["regions_mm"]) == {"shoulder_L", "elbow_L"}
    assert elbow["inside_of_bend"] is not None and result["joints"]["shoulder_L"]["inside_of_bend"] is None
    bpy.ops.wm.open_mainfile(filepath=str(out))
    np.testing.assert_allclose(
        painted(bpy.data.objects["sleeve"], "elbow_L"), expected_colours(database, "elbow_L"), atol=1e-6
    )


def test_the_verb_plots_every_joint(wrinkle, file: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    drawn = [Path(path) for path in wrinkle("influence", file, "--plots", tmp_path / "p", "--json").result["plots"]]
    assert [path.name for path in drawn] == ["influence_elbow_L.png", "influence_shoulder_L.png"]
    assert all(path.stat().st_size > 10_000 for path in drawn)


@pytest.mark.parametrize("verb", ["influence", "evaluate"])
def test_plots_without_matplotlib_are_refused_before_any_work(
    wrinkle, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    monkeypatch.setattr(plots.importlib.util, "find_spec", lambda name: None)
    assert "Plots need Matplotlib" in wrinkle(verb, file, "--plots", tmp_path / "p").complaint
    assert not (tmp_path / "p").exists()


def test_the_verb_takes_the_joints_that_are_named(wrinkle, file: Path) -> None:
    assert list(wrinkle("influence", file, "--joints", "shoulder_L", "--json").result["joints"]) == ["shoulder_L"]
    assert (
        "no samples of a joint 'knee_L'; it has elbow_L" in wrinkle("influence", file, "--joints", "knee_L").complaint
    )


def test_measured_weights_are_played_when_they_are_chosen(arm: Arm, database: Path) -> None:
    pose = arm.animate([{"elbow_L": [0.7], "shoulder_L": [0.3, 0.2, -0.1]}])[0]
    shown = {}
    for weights in BlendWeights:
        arm.sleeve.wrinkles.weights = weights.name
        bpy.context.scene.frame_set(1)
        shown[weights] = evaluated_positions(arm.sleeve)
        method = JointWrinkles(WrinkleDatabase.open(database), weights=weights)
        expected = arm.to_object_space(method.bind().positions(pose).astype(float))
        # Matrices come from Blender in single precision.
        np.testing.assert_allclose(shown[weights], expected, atol=5e-6)
    assert np.abs(shown[BlendWeights.MEASURED] - shown[BlendWeights.DISTANCE]).max() > 1e-4


def test_evaluation_and_synthesis_take_the_weights_that_are_named(wrinkle, file: Path, tmp_path: Path) -> None:
    cache = tmp_path / "measured.pc2"
    frames = ("--frames", "1:2")
    assert wrinkle("synthesize", file, "--out", cache, "--weights", "measured", *frames).code == 0
    ours = {
        weights: wrinkle("evaluate", file, "--reference", cache, "--weights", weights, *frames, "--json").result[
            "max_mm"
        ]["ours"]
        for weights in ("measured", "distance")
    }
    # A cache holds single precision.
    assert ours["measured"] < 0.01
    assert "invalid choice: 'guessed'" in wrinkle("synthesize", file, "--weights", "guessed", "--out", cache).complaint
