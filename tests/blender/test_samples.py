"""Single samples: seen as a ghost, opened as a mesh, corrected, restored; charts of all of them; presets."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from fake_layout import draw
from small_character import TOLERANCE, Arm, Bumps, build_arm, elbow, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.blender import ghost, panels, playback
from wrinkle_synthesis.wrinkle_addon.blender.charts import (
    BAR,
    HEIGHT,
    MARKED,
    WIDTH,
    Chart,
    chart_pixels,
    show_chart,
    tick_step,
)
from wrinkle_synthesis.wrinkle_addon.blender.presets import FABRIC
from wrinkle_synthesis.wrinkle_addon.blender.samples import chosen_sample, nearest_node, open_database
from wrinkle_synthesis.wrinkle_addon.plan import JointGrid, Sample

HALF = Sample("elbow_L", (1,))


@pytest.fixture
def arm(bumps: Bumps, database: Path, tmp_path: Path) -> Arm:
    """An arm with a database of its own, which may be changed; the ghost shows the elbow bent by 45 degrees."""
    folder = shutil.copytree(database, tmp_path / "sleeve.wrinkles")
    empty_scene()
    arm = build_arm("", folder)
    bpy.context.view_layer.objects.active = arm.sleeve
    arm.sleeve.wrinkles.ghost.angles = (np.radians(50.0), 0.0, 0.0)
    bpy.context.view_layer.update()
    return arm


def positions_of(ob: bpy.types.Object) -> np.ndarray:
    values = np.empty(3 * len(ob.data.vertices), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", values)
    return values.reshape(-1, 3)


def move(ob: bpy.types.Object, offset: np.ndarray | list[float]) -> None:
    values = positions_of(ob) + np.asarray(offset, np.float32)
    ob.data.attributes["position"].data.foreach_set("vector", values.astype(np.float32).ravel())
    ob.data.update()


# --- choosing one -------------------------------------------------------------------------------------------------


def test_angles_choose_the_nearest_node_in_every_direction() -> None:
    grid = JointGrid(elbow(), ((-0.5, 0.0, 0.5, 1.0),))
    assert [nearest_node(grid, np.array([a])) for a in (-9.0, -0.3, 0.2, 0.7, 0.8, 9.0)] == [
        (0,), (0,), (1,), (2,), (3,), (3,)
    ]  # fmt: skip


def test_the_rest_pose_is_no_sample(arm: Arm) -> None:
    assert chosen_sample(arm.sleeve)[1] == HALF
    arm.sleeve.wrinkles.ghost.angles = (0.1, 0.0, 0.0)
    with pytest.raises(ValueError, match="rest pose"):
        chosen_sample(arm.sleeve)
    assert "rest pose" in draw(panels.bake.WRINKLE_PT_samples).text


def test_the_ghost_is_the_sample_where_the_armature_stands(arm: Arm, bumps: Bumps) -> None:
    made = ghost.make_ghost(arm.sleeve, *chosen_sample(arm.sleeve))
    pose = bumps.pose({"elbow_L": np.array([np.pi / 4])})
    np.testing.assert_allclose(made.positions, bumps.shape(pose), atol=TOLERANCE)
    assert made.colours.shape == (len(made.positions), 4)
    # Shading is what shows folds.
    assert np.ptp(made.colours[:, 2]) > 0.1 and made.colours.min() >= 0.0 and made.colours.max() <= 1.0


# --- correcting one -----------------------------------------------------------------------------------------------


def opened(arm: Arm) -> bpy.types.Object:
    assert bpy.ops.wrinkle.open_sample() == {"FINISHED"}
    return bpy.context.object


def test_a_sample_opens_as_a_mesh_of_the_garment(arm: Arm, bumps: Bumps) -> None:
    ob = opened(arm)
    pose = bumps.pose({"elbow_L": np.array([np.pi / 4])})
    np.testing.assert_allclose(positions_of(ob), bumps.shape(pose), atol=TOLERANCE)
    assert [len(face.vertices) for face in ob.data.polygons] == [
        len(face.vertices) for face in arm.sleeve.data.polygons
    ]
    assert not ob.modifiers and arm.sleeve.hide_get()
    # The sidebar is still about the garment.
    assert "wrinkle.write_sample" in draw(panels.bake.WRINKLE_PT_samples).operators


def test_what_was_sculpted_shows_in_every_pose_near_the_sample(arm: Arm, bumps: Bumps) -> None:
    changes = {}
    angles = (np.pi / 4, np.pi / 8, 3 * np.pi / 8, np.pi / 2)
    before = {}
    for angle in angles:
        arm.bend(angle)
        bpy.context.view_layer.update()
        before[angle] = evaluated_positions(arm.sleeve)
    ob = opened(arm)
    move(ob, [0.0, 0.0, 0.02])
    assert bpy.ops.wrinkle.write_sample() == {"FINISHED"}
    assert bpy.context.object == arm.sleeve and not arm.sleeve.hide_get()
    for angle in angles:
        arm.bend(angle)
        bpy.context.view_layer.update()
        assert playback.status(arm.sleeve).error == ""
        changes[angle] = np.linalg.norm(evaluated_positions(arm.sleeve) - before[angle], axis=1)
    np.testing.assert_allclose(changes[np.pi / 4], 0.02, atol=2 * TOLERANCE)
    # Halfway to a neighbour half of it is left, and nothing at the neighbour itself.
    np.testing.assert_allclose(changes[np.pi / 8], 0.01, atol=2 * TOLERANCE)
    np.testing.assert_allclose(changes[3 * np.pi / 8], 0.01, atol=2 * TOLERANCE)
    assert changes[np.pi / 2].max() < 1e-6


def test_the_baked_sample_comes_back(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(np.pi / 4)
    move(opened(arm), [0.0, 0.0, 0.02])
    bpy.ops.wrinkle.write_sample()
    assert chosen_sample(arm.sleeve)[0].corrections.path(HALF.name) is not None
    assert bpy.ops.wrinkle.restore_sample() == {"FINISHED"}
    bpy.context.view_layer.update()
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), bumps.shape(pose), atol=TOLERANCE)
    with pytest.raises(RuntimeError, match="as it was baked"):
        bpy.ops.wrinkle.restore_sample()


def test_modifiers_and_sculpt_mode_on_the_opened_sample_count(arm: Arm) -> None:
    ob = opened(arm)
    before = positions_of(ob)
    lift = ob.modifiers.new("Lift", "DISPLACE")
    lift.direction, lift.strength, lift.mid_level = "Z", 0.01, 0.0
    bpy.ops.object.mode_set(mode="SCULPT")
    assert bpy.ops.wrinkle.write_sample(keep=True) == {"FINISHED"}
    assert ob.name in bpy.data.objects
    stored = open_database(arm.sleeve).positions(HALF)
    np.testing.assert_allclose(stored, before + [0.0, 0.0, 0.01], atol=TOLERANCE)


def test_a_mesh_of_another_number_of_vertices_is_refused(arm: Arm) -> None:
    ob = opened(arm)
    ob.modifiers.new("Subdivision", "SUBSURF")
    with pytest.raises(RuntimeError, match="tools that move vertices only"):
        bpy.ops.wrinkle.write_sample()
    assert ob.name in bpy.data.objects


def test_a_sample_of_an_earlier_bake_is_refused(arm: Arm) -> None:
    opened(arm).wrinkle_sample.key = "0" * 16
    with pytest.raises(RuntimeError, match="open the sample again"):
        bpy.ops.wrinkle.write_sample()


def test_nothing_is_written_back_before_something_was_opened(arm: Arm) -> None:
    assert not bpy.ops.wrinkle.write_sample.poll()


def test_a_scaled_character_is_corrected_in_its_own_size(arm: Arm, bumps: Bumps) -> None:
    arm.armature.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    ob = opened(arm)
    np.testing.assert_allclose(np.array(ob.matrix_world), np.array(arm.armature.matrix_world))
    move(ob, [0.0, 0.0, 0.02])
    bpy.ops.wrinkle.write_sample()
    shape = bumps.shape(bumps.pose({"elbow_L": np.array([np.pi / 4])})) + [0.0, 0.0, 0.02]
    np.testing.assert_allclose(open_database(arm.sleeve).positions(HALF), shape, atol=TOLERANCE)


# --- charts -------------------------------------------------------------------------------------------------------


def test_residual_and_curvature_are_images_of_the_file(arm: Arm) -> None:
    for _ in range(2):
        assert bpy.ops.wrinkle.plot_samples() == {"FINISHED"}
    images = {image.name: tuple(image.size) for image in bpy.data.images if image.name.startswith("sleeve ")}
    assert images == {"sleeve residual": (WIDTH, HEIGHT), "sleeve curvature": (WIDTH, HEIGHT)}
    assert all(bpy.data.images[name].packed_file is not None for name in images)


def test_bars_are_as_high_as_their_values() -> None:
    chart = Chart("", np.array([1.0, 2.0, 0.0]), np.array([False, True, False]))
    pixels = chart_pixels(chart)
    bars = [(np.abs(pixels[..., :3] - colour).max(-1) < 1e-6).any(1).sum() for colour in (BAR, MARKED)]
    assert bars[1] / bars[0] == pytest.approx(2.0, abs=0.02)
    assert [tick_step(top) for top in (1.0, 0.03, 7.0, 1200.0)] == pytest.approx([0.2, 0.01, 1.0, 200.0])


def test_words_are_written_on_a_chart() -> None:
    empty = show_chart("empty", Chart("", np.ones(1), np.zeros(1, bool)))
    titled = show_chart("titled", Chart("Residual", np.ones(1), np.zeros(1, bool)))
    pixels = [np.array(image.pixels[:]) for image in (empty, titled)]
    assert np.abs(pixels[0] - pixels[1]).max() > 0.3


# --- presets ------------------------------------------------------------------------------------------------------


def test_a_fabric_is_stored_as_a_preset_and_applied_to_another_garment(
    arm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bpy.utils, "user_resource", lambda kind, *, path="", create=False: _made(tmp_path / path))
    settings = arm.sleeve.wrinkles
    settings.fabric, settings.stretch, settings.ease_girth = "OWN", 321.0, 7.0
    assert bpy.ops.wrinkle.add_fabric_preset(name="Felt") == {"FINISHED"}
    stored = tmp_path / "presets" / FABRIC / "Felt.py"
    assert "wrinkles.stretch = 321.0" in stored.read_text()
    settings.stretch, settings.ease_girth = 1.0, 0.0
    assert bpy.ops.wrinkle.apply_preset(filepath=str(stored), menu_idname="WRINKLE_PT_fabric_presets") == {"FINISHED"}
    assert (settings.stretch, settings.ease_girth) == (321.0, 7.0)


def _made(path: Path) -> str:
    path.mkdir(parents=True, exist_ok=True)
    return str(path)


def test_plans_come_with_the_addon(arm: Arm) -> None:
    folders = [Path(path) for path in bpy.utils.preset_paths("wrinkle_synthesis/plan")]
    files = {path.stem: path for folder in folders for path in folder.glob("*.py")}
    assert {"Quick", "Full"} <= files.keys()
    arm.sleeve.wrinkles.budget = 5
    bpy.ops.wrinkle.apply_preset(filepath=str(files["Quick"]), menu_idname="WRINKLE_PT_plan_presets")
    assert (arm.sleeve.wrinkles.plan, arm.sleeve.wrinkles.budget) == ("BUDGET", 36)


def test_presets_need_the_garment_itself(arm: Arm) -> None:
    bpy.context.view_layer.objects.active = arm.armature
    assert not bpy.ops.wrinkle.add_fabric_preset.poll() and not bpy.ops.wrinkle.apply_preset.poll()
