"""A garment is kept outside the one that it is worn over, wherever both are shown; where it cannot be, that is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import Arm, Bumps, bake_bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.bake import SampleShape, bake
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.garment import bind_to_surface
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache

ANGLES = [{"elbow_L": [0.1 * k]} for k in range(6)]


@pytest.fixture
def arm(bumps: Bumps, database: Path, tmp_path: Path) -> Arm:
    """An arm in two sleeves of one shape, 12 mm off the arm; the outer one's bumps are switched off."""
    empty_scene()
    arm = build_arm("", database)
    outer = arm.sleeve.copy()
    outer.data = arm.sleeve.data.copy()
    outer.name = "coat"
    bpy.context.scene.collection.objects.link(outer)
    bpy.context.view_layer.update()
    coat = Arm(arm.armature, outer, arm.rig)
    outer.wrinkles.database = str(tmp_path / "coat.wrinkles")
    bake_bumps(coat, tmp_path / "coat.wrinkles")
    outer.wrinkles.strength = 0.0
    outer.wrinkles.worn_over = arm.sleeve
    arm.animate(ANGLES)
    bpy.context.scene.frame_end = len(ANGLES)
    return arm


def coat() -> bpy.types.Object:
    return bpy.data.objects["coat"]


def heights(arm: Arm) -> np.ndarray:
    """Height of the coat over the sleeve as both are shown [m], where the sleeve has a bump."""
    mesh = arm.sleeve.data
    mesh.calc_loop_triangles()
    faces = np.array([triangle.vertices[:] for triangle in mesh.loop_triangles], np.int32)
    points = evaluated_positions(coat()).astype(np.float64)
    found = bind_to_surface(points, evaluated_positions(arm.sleeve).astype(np.float64), faces).distance
    return found[np.abs(np.array([v.co.x for v in mesh.vertices]) - 0.3) < 0.1]


def note() -> str:
    status = playback.status(coat())
    assert status.error == "" and status.player is not None
    return status.player.note


def test_the_outer_garment_is_pushed_out_of_the_inner_one(arm: Arm) -> None:
    scene = bpy.context.scene
    coat().wrinkles.worn_over = None
    scene.frame_set(6)
    # The sleeve's bump of 30 mm a radian stands out of the coat.
    assert heights(arm).min() < -0.005
    coat().wrinkles.worn_over = arm.sleeve
    for frame in (6, 3, 5):
        scene.frame_set(frame)
        assert note() == ""
        # Both lay on each other at rest, so that the settled height is 0; half of the softness is left out.
        assert heights(arm).min() > -0.001


class Shrunk(Bumps):
    """The sleeve settled narrower than it was modelled."""

    def rest(self) -> SampleShape:
        return SampleShape(self.job.garment.positions * [1.0, 0.96, 0.96], {})


def test_an_outer_garment_that_settled_inside_the_inner_one_is_worn_over_it_as_modelled(
    arm: Arm, tmp_path: Path
) -> None:
    shrunk = Shrunk(Arm(arm.armature, coat(), arm.rig).job())
    for _ in bake(shrunk.job, shrunk, tmp_path / "shrunk.wrinkles"):
        pass
    settings, scene = coat().wrinkles, bpy.context.scene
    settings.database, settings.worn_over = str(tmp_path / "shrunk.wrinkles"), None
    scene.frame_set(1)
    assert heights(arm).max() < -0.002
    settings.worn_over = arm.sleeve
    scene.frame_set(2)
    assert note() == "" and heights(arm).min() > -0.001


def test_frames_have_the_same_bits_in_any_order_whichever_object_comes_first(arm: Arm) -> None:
    shown = {}
    for frame in (1, 6, 3, 6, 1, 3):
        bpy.context.scene.frame_set(frame)
        np.testing.assert_array_equal(evaluated_positions(coat()), shown.setdefault(frame, evaluated_positions(coat())))


def test_what_is_written_is_what_is_shown(arm: Arm, wrinkle: Callable, tmp_path: Path) -> None:
    shown = []
    for frame in range(1, 7):
        bpy.context.scene.frame_set(frame)
        shown.append(evaluated_positions(coat()))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    result = wrinkle(
        "synthesize", tmp_path / "arm.blend", "--garment", "coat", "--out", tmp_path / "coat.pc2", "--json"
    ).result
    assert result["notes"] == []
    np.testing.assert_allclose(PointCache(tmp_path / "coat.pc2").frames, shown, atol=1e-6)


def switch_off(arm: Arm) -> str:
    arm.sleeve.wrinkles.enabled = False
    return "The garment 'sleeve' plays no wrinkles."


def wear_over_each_other(arm: Arm) -> str:
    arm.sleeve.wrinkles.worn_over = coat()
    return "The garment 'coat' is worn over 'coat', which is worn over itself; let one of them be worn over nothing."


@pytest.mark.parametrize("change", [switch_off, wear_over_each_other])
def test_a_garment_that_cannot_be_kept_outside_plays_as_it_is_and_that_is_told(
    arm: Arm, change: Callable[[Arm], str]
) -> None:
    coat().wrinkles.worn_over = None
    bpy.context.scene.frame_set(6)
    expected = evaluated_positions(coat())
    coat().wrinkles.worn_over = arm.sleeve
    sentence = change(arm)
    bpy.context.scene.frame_set(5)
    bpy.context.scene.frame_set(6)
    np.testing.assert_array_equal(evaluated_positions(coat()), expected)
    assert note() == f"{sentence} The garment 'coat' plays without being kept outside it."
