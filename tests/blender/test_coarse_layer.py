"""Wrinkles over any mesh that moves: what the garment follows, in windows and in renders, and what is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import bpy
import numpy as np
import pytest
from small_character import TOLERANCE, Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.blender.handlers import RENDER_FAILED
from wrinkle_synthesis.wrinkle_addon.blender.node_group import find_modifier, get_input
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache

ANGLES = [{"elbow_L": [0.2 * k]} for k in range(6)]


@pytest.fixture
def arm(database: Path, bumps: Bumps) -> Arm:
    empty_scene()
    return build_arm("", database)


def make_coarse(arm: Arm, count: int = 60) -> bpy.types.Object:
    """The sleeve's own coarse mesh, made in one click, to be followed as Blender moves it."""
    bpy.context.view_layer.objects.active = arm.sleeve
    assert bpy.ops.wrinkle.make_coarse_mesh(vertex_count=count) == {"FINISHED"}
    arm.sleeve.wrinkles.coarse_layer = "MESH"
    bpy.context.view_layer.update()
    return arm.sleeve.wrinkles.coarse


def blow(coarse: bpy.types.Object, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> bpy.types.Modifier:
    """Move a mesh aside by a modifier, as a simulation would."""
    for axis, amount in zip("XYZ", (x, y, z), strict=True):
        modifier = coarse.modifiers.new("blow", "DISPLACE")
        modifier.direction, modifier.mid_level, modifier.strength = axis, 0.0, amount
    return modifier


def shown(arm: Arm) -> np.ndarray:
    """The sleeve after an update, in the metres of the rig; the panel complains of nothing."""
    bpy.context.view_layer.update()
    assert playback.status(arm.sleeve).error == ""
    return evaluated_positions(arm.sleeve)


def error_of(arm: Arm) -> str:
    """What the panel says; the sleeve shows its skinned shape."""
    bpy.context.view_layer.update()
    error = playback.status(arm.sleeve).error
    positions, modifier = evaluated_positions(arm.sleeve), find_modifier(arm.sleeve)
    modifier.show_viewport = False
    np.testing.assert_array_equal(positions, evaluated_positions(arm.sleeve))
    modifier.show_viewport = True
    return error


# --- what the garment follows -------------------------------------------------------------------------------------


def test_one_click_makes_a_hidden_skinned_mesh_of_the_wanted_size(arm: Arm) -> None:
    coarse = make_coarse(arm)
    assert abs(len(coarse.data.vertices) - 60) <= 15
    assert coarse.name == "sleeve.coarse" and coarse.hide_render and coarse.hide_viewport
    assert {group.name for group in coarse.vertex_groups} == {"upper", "lower"}
    arm.bend(1.0)
    np.testing.assert_allclose(weights_by_place(coarse), weights_by_place(arm.sleeve), atol=0.1)
    make_coarse(arm, 90)
    assert [ob.name for ob in bpy.data.objects if "coarse" in ob.name] == ["sleeve.coarse"]


def weights_by_place(ob: bpy.types.Object) -> np.ndarray:
    """Mean weight of the lower bone over six stretches of the arm."""
    group = ob.vertex_groups["lower"].index
    sums = np.zeros((6, 2))
    for vertex in ob.data.vertices:
        weight = sum(element.weight for element in vertex.groups if element.group == group)
        sums[min(int(vertex.co.x * 10.0), 5)] += weight, 1.0
    return sums[:, 0] / sums[:, 1]


def test_the_garment_goes_where_the_coarse_mesh_goes_and_keeps_its_wrinkles(arm: Arm, bumps: Bumps) -> None:
    pose = arm.bend(1.0)
    plain = shown(arm)
    blow(make_coarse(arm), z=0.05)
    moved = shown(arm)
    # What is finer than the coarse mesh stays, what is coarser is the coarse mesh's own.
    assert np.abs((moved - plain).mean(0) - [0.0, 0.0, 0.05]).max() < 2e-3
    np.testing.assert_allclose(plain, arm.to_object_space(bumps.shape(pose)), atol=TOLERANCE)


def test_how_far_it_follows_is_a_factor_that_can_be_keyed(arm: Arm) -> None:
    arm.bend(1.0)
    plain = shown(arm)
    blow(make_coarse(arm), z=0.05)
    whole = shown(arm)
    for frame, follow in ((1, 0.0), (11, 1.0)):
        arm.sleeve.wrinkles.follow = follow
        arm.sleeve.wrinkles.keyframe_insert("follow", frame=frame)
    for frame, share in ((1, 0.0), (6, 0.5), (11, 1.0)):
        bpy.context.scene.frame_set(frame)
        np.testing.assert_allclose(shown(arm), plain + share * (whole - plain), atol=1e-6)


def test_a_moving_coarse_mesh_shows_without_a_change_of_frame_or_pose(arm: Arm) -> None:
    modifier = blow(make_coarse(arm), z=0.02)
    before = shown(arm)
    modifier.strength = 0.06
    assert np.abs((shown(arm) - before).mean(0) - [0.0, 0.0, 0.04]).max() < 1e-4


def test_blenders_own_cloth_carries_the_wrinkles(arm: Arm) -> None:
    coarse = make_coarse(arm)
    coarse.modifiers.clear()
    cloth = coarse.modifiers.new("Cloth", "CLOTH")
    cloth.settings.quality = 3
    scene = bpy.context.scene
    heights = []
    for frame in range(1, 7):
        scene.frame_set(frame)
        cloth_mesh = coarse.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        fallen = np.mean([vertex.co.z for vertex in cloth_mesh.vertices])
        heights.append(shown(arm)[:, 2].mean() - fallen)
        # The unpinned sleeve falls freely, and the wrinkled one with it.
        assert abs(heights[-1] - heights[0]) < 2e-3
    assert fallen < -0.02


def test_a_surface_deform_rig_carries_the_wrinkles(arm: Arm) -> None:
    target = make_coarse(arm)
    coarse = target.copy()
    coarse.data = target.data.copy()
    coarse.modifiers.clear()
    bpy.context.scene.collection.objects.link(coarse)
    coarse.hide_viewport = target.hide_viewport = False
    bound = coarse.modifiers.new("Bound", "SURFACE_DEFORM")
    bound.target = target
    bpy.context.view_layer.update()
    with bpy.context.temp_override(object=coarse):
        assert bpy.ops.object.surfacedeform_bind(modifier="Bound") == {"FINISHED"}
    arm.sleeve.wrinkles.coarse = coarse
    before = shown(arm)
    blow(target, y=0.03)
    assert np.abs((shown(arm) - before).mean(0) - [0.0, 0.03, 0.0]).max() < 1e-3


def move_along(coarse: bpy.types.Object) -> None:
    """Rise by 5 cm over eleven frames."""
    modifier = blow(coarse)
    modifier.strength = 0.0
    modifier.keyframe_insert("strength", frame=1)
    modifier.strength = 0.05
    modifier.keyframe_insert("strength", frame=11)


def follows_in_every_frame(arm: Arm, start: np.ndarray, to: Mapping[int, np.ndarray]) -> bool:
    """Whether the garment moves from its start as the coarse mesh has moved by each frame."""
    moved = {}
    for frame in to:
        bpy.context.scene.frame_set(frame)
        moved[frame] = (shown(arm) - start).mean(0)
    return all(np.abs(moved[frame] - offset).max() < 2e-3 for frame, offset in to.items())


RISE = {1: np.zeros(3), 6: np.array([0.0, 0.0, 0.025]), 11: np.array([0.0, 0.0, 0.05])}


def test_an_alembic_cache_carries_the_wrinkles(arm: Arm, tmp_path: Path) -> None:
    start = shown(arm)
    coarse = make_coarse(arm)
    move_along(coarse)
    coarse.hide_viewport = coarse.hide_render = False
    bpy.ops.object.select_all(action="DESELECT")
    coarse.select_set(True)
    path = str(tmp_path / "coarse.abc")
    bpy.ops.wm.alembic_export(filepath=path, start=1, end=11, selected=True, as_background_job=False)
    bpy.data.objects.remove(coarse)
    bpy.ops.wm.alembic_import(filepath=path, as_background_job=False)
    cache = bpy.context.selected_objects[0]
    assert [modifier.type for modifier in cache.modifiers] == ["MESH_SEQUENCE_CACHE"]
    arm.sleeve.wrinkles.coarse = cache
    assert follows_in_every_frame(arm, start, RISE)


def test_a_linked_mesh_carries_the_wrinkles(arm: Arm, tmp_path: Path) -> None:
    """Of another file, and the same overridden to stand elsewhere."""
    start = shown(arm)
    coarse = make_coarse(arm)
    coarse.modifiers.clear()
    move_along(coarse)
    path = str(tmp_path / "coarse.blend")
    bpy.data.libraries.write(path, {coarse})
    bpy.data.objects.remove(coarse)
    with bpy.data.libraries.load(path, link=True) as (there, here):
        here.objects = list(there.objects)
    linked = next(ob for ob in here.objects if ob.type == "MESH")
    bpy.context.scene.collection.objects.link(linked)
    arm.sleeve.wrinkles.coarse = linked
    assert follows_in_every_frame(arm, start, RISE)
    override = linked.override_create(remap_local_usages=True)
    override.location.x += 0.03
    assert arm.sleeve.wrinkles.coarse == override
    assert follows_in_every_frame(arm, start, {frame: rise + [0.03, 0.0, 0.0] for frame, rise in RISE.items()})


def test_the_coarse_mesh_may_stand_elsewhere_in_its_own_space(arm: Arm) -> None:
    coarse = make_coarse(arm)
    blow(coarse, z=0.05)
    expected = shown(arm)
    world = coarse.matrix_world.copy()
    coarse.modifiers.clear()
    coarse.data.transform(world @ world.inverted())
    for vertex in coarse.data.vertices:
        vertex.co = (vertex.co * 100.0) + type(vertex.co)((5.0, 0.0, 0.0))
    coarse.scale, coarse.location = (0.01,) * 3, (-0.05, 0.0, 0.0)
    arm.bend(0.0)
    bpy.context.view_layer.update()
    arm.sleeve.wrinkles.coarse = coarse
    coarse.location.z += 0.05
    np.testing.assert_allclose(shown(arm), expected, atol=1e-4)


def test_the_same_frame_has_the_same_bits_from_any_visiting_order(arm: Arm) -> None:
    scene = bpy.context.scene
    arm.animate(ANGLES)
    blow(make_coarse(arm), z=0.05)
    first = {}
    for frame in range(1, 7):
        scene.frame_set(frame)
        first[frame] = shown(arm)
    for frame in (6, 2, 5, 1):
        scene.frame_set(frame)
        np.testing.assert_array_equal(shown(arm), first[frame])


def test_switching_the_layer_off_shows_the_wrinkles_over_skinning_again(arm: Arm) -> None:
    arm.bend(1.0)
    plain = shown(arm)
    blow(make_coarse(arm), z=0.05)
    assert np.abs(shown(arm) - plain).max() > 0.04
    arm.sleeve.wrinkles.coarse_layer = "NONE"
    np.testing.assert_array_equal(shown(arm), plain)
    assert get_input(find_modifier(arm.sleeve), "Coarse") is None


def test_a_point_cache_holds_what_was_shown(wrinkle, arm: Arm, tmp_path: Path) -> None:
    arm.animate(ANGLES)
    blow(make_coarse(arm), z=0.05)
    expected = []
    for frame in range(1, 7):
        bpy.context.scene.frame_set(frame)
        expected.append(shown(arm))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert wrinkle("synthesize", tmp_path / "a.blend", "--frames", "1:6", "--out", tmp_path / "a.pc2").code == 0
    np.testing.assert_allclose(PointCache(tmp_path / "a.pc2").frames, expected, atol=1e-5)


def test_a_render_evaluates_the_hidden_coarse_mesh(arm: Arm) -> None:
    """Blender leaves what a render does not show unevaluated, unless something that it shows needs it."""
    scene = bpy.context.scene
    arm.animate(ANGLES)
    blow(make_coarse(arm), z=0.05)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.frame_set(4)
    expected = shown(arm)
    seen = []

    def look(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        if depsgraph.mode == "RENDER":
            positions = np.empty(3 * len(arm.sleeve.data.vertices), np.float32)
            arm.sleeve.data.attributes["wrinkle_position"].data.foreach_get("vector", positions)
            seen.append(positions.reshape(-1, 3))

    bpy.app.handlers.frame_change_post.append(look)
    try:
        bpy.ops.render.render()
    finally:
        bpy.app.handlers.frame_change_post.remove(look)
    assert seen
    np.testing.assert_array_equal(seen[-1], expected)


# --- setting up ---------------------------------------------------------------------------------------------------


def test_setup_makes_a_coarse_mesh_or_takes_one(wrinkle, arm: Arm, tmp_path: Path) -> None:
    file, out = tmp_path / "arm.blend", tmp_path / "ready.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    ready = ("setup", file, "--garment", "sleeve", "--body", "body", "--subdivide", 0, "--samples", 2, "--out", out)
    outcome = wrinkle(*ready, "--coarse", "make:60", "--json")
    assert outcome.result["coarse"] == "sleeve.coarse" and outcome.result["notes"] == []
    settings = bpy.data.objects["sleeve"].wrinkles
    assert (settings.coarse_layer, settings.coarse_cache) == ("SIMULATION", "//rig.coarse")
    for text, layer in (("sleeve.coarse", "MESH"), ("simulate:sleeve.coarse", "SIMULATION")):
        outcome = wrinkle("setup", out, *ready[2:], "--coarse", text, "--json")
        assert outcome.result["coarse"] == "sleeve.coarse"
        assert bpy.data.objects["sleeve"].wrinkles.coarse_layer == layer
    assert "no coarse mesh 'shawl'; its meshes: body, sleeve" in wrinkle(*ready, "--coarse", "shawl").complaint
    assert "make:700, not 'make:few'" in wrinkle(*ready, "--coarse", "make:few").complaint
    assert "needs from 24 to" in wrinkle(*ready, "--coarse", "make:3").complaint
    assert "cannot be its own coarse mesh" in wrinkle(*ready, "--coarse", "sleeve").complaint


# --- refused ------------------------------------------------------------------------------------------------------


def remove(arm: Arm, coarse: bpy.types.Object) -> None:
    bpy.data.objects.remove(coarse)


def no_faces(arm: Arm, coarse: bpy.types.Object) -> None:
    coarse.data.clear_geometry()
    coarse.data.vertices.add(3)


def subdivide(arm: Arm, coarse: bpy.types.Object) -> None:
    coarse.modifiers.new("Subdivision", "SUBSURF")


def far_away(arm: Arm, coarse: bpy.types.Object) -> None:
    coarse.location.y += 3.0
    bpy.context.view_layer.update()
    arm.sleeve.wrinkles.coarse = coarse


def more_pieces(arm: Arm, coarse: bpy.types.Object) -> None:
    other = coarse.copy()
    other.data = coarse.data.copy()
    other.hide_viewport = coarse.hide_viewport = False
    bpy.context.scene.collection.objects.link(other)
    bpy.context.view_layer.update()
    with bpy.context.temp_override(
        active_object=coarse, object=coarse, selected_objects=[coarse, other], selected_editable_objects=[coarse, other]
    ):
        bpy.ops.object.join()


def itself(arm: Arm, coarse: bpy.types.Object) -> None:
    arm.sleeve.wrinkles.coarse = arm.sleeve


def loop(arm: Arm, coarse: bpy.types.Object) -> None:
    between = bpy.data.objects.new("between", coarse.data.copy())
    bpy.context.scene.collection.objects.link(between)
    between.modifiers.new("Wrap", "SHRINKWRAP").target = arm.sleeve
    coarse.modifiers.new("Wrap", "SHRINKWRAP").target = between
    arm.sleeve.wrinkles.coarse = coarse


def inside_out(arm: Arm, coarse: bpy.types.Object) -> None:
    coarse.data.flip_normals()
    coarse.data.update()
    arm.sleeve.wrinkles.coarse = coarse


def explode(arm: Arm, coarse: bpy.types.Object) -> None:
    coarse.data.vertices[3].co.x = float("nan")
    coarse.data.update()


def edited(arm: Arm, coarse: bpy.types.Object) -> None:
    coarse.hide_viewport = False
    bpy.context.view_layer.objects.active = coarse
    bpy.ops.object.mode_set(mode="EDIT")


REFUSED = [
    (remove, "coarse mesh of the garment 'sleeve' is missing"),
    (no_faces, "'sleeve.coarse' has no faces"),
    (subdivide, "vertices in this frame and"),
    (far_away, "m away from the garment; put it where"),
    (more_pieces, "has 2 separate pieces and the garment 1"),
    (itself, "cannot be its own coarse mesh"),
    (loop, "'sleeve.coarse' depends on the garment 'sleeve' itself"),
    (inside_out, "faces inwards where the garment faces outwards"),
    (explode, "'sleeve.coarse' has positions that are not numbers in this frame"),
    (edited, "'sleeve.coarse' is being edited"),
]


@pytest.mark.parametrize(("change", "sentence"), REFUSED)
def test_a_coarse_mesh_that_cannot_be_is_told_in_one_sentence_and_the_garment_is_skinned(
    arm: Arm, change: Callable[[Arm, bpy.types.Object], None], sentence: str
) -> None:
    # Fine enough that the far side of the sleeve is out of reach.
    coarse = make_coarse(arm, 200)
    shown(arm)
    change(arm, coarse)
    error = error_of(arm)
    assert sentence in error
    assert "\n" not in error and error.endswith(".")
    # The next frame says the same; whoever chooses another layer has his wrinkles back.
    assert error_of(arm) == error
    if bpy.context.object is not None and bpy.context.object.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    make_coarse(arm)
    shown(arm)


def test_what_was_mended_is_tried_again(arm: Arm) -> None:
    coarse = make_coarse(arm, 200)
    inside_out(arm, coarse)
    assert "faces inwards" in error_of(arm)
    inside_out(arm, coarse)
    shown(arm)
    edited(arm, coarse)
    assert "being edited" in error_of(arm)
    bpy.ops.object.mode_set(mode="OBJECT")
    shown(arm)


RENDER = """
import sys
import bpy
import wrinkle_synthesis
wrinkle_synthesis.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
bpy.data.objects.remove(bpy.data.objects["sleeve.coarse"])
bpy.context.scene.frame_set(3)
print("went on")
"""


def test_a_background_process_ends_with_a_sentence(arm: Arm, tmp_path: Path) -> None:
    make_coarse(arm)
    file = tmp_path / "arm.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    command = [sys.executable, "-c", RENDER, str(file)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120, env=dict(os.environ))
    assert done.returncode == RENDER_FAILED and "went on" not in done.stdout
    assert "wrinkle: The coarse mesh of the garment 'sleeve' is missing" in done.stderr
