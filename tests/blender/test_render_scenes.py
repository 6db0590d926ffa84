"""Renders of more than a garment: modifiers behind, other deformed objects, view layers, scenes, what is not seen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import pytest
from pictures import (
    DIFFERENT,
    SAME,
    bending,
    difference,
    expected_picture,
    filmed_arm,
    layer_alphas,
    plain_mesh,
    render_animation,
    render_still,
    write_layers,
    write_pictures,
)
from small_character import Arm, Bumps, arm_weights, build_arm, tube
from wrinkle_synthesis.wrinkle_addon.blender import playback
from wrinkle_synthesis.wrinkle_addon.blender.render_lock import WRINKLE_PT_render_lock
from wrinkle_synthesis.wrinkle_addon.blender.setup import bind_to_armature
from wrinkle_synthesis.wrinkle_addon.rig import Pose


@pytest.fixture(params=["CYCLES", "BLENDER_WORKBENCH"])
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def arm(bumps: Bumps, database: Path, engine: str) -> Arm:
    arm = filmed_arm(database)
    bpy.context.scene.render.engine = engine
    return arm


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of garments, one for every time that a pose was read or played for one."""
    names: list[str] = []
    read, read_pose = playback.Player.read, playback.Player.read_pose

    def counted(player: playback.Player, garment: bpy.types.Object, *arguments: Any, **options: Any) -> Any:
        names.append(garment.name)
        return read(player, garment, *arguments, **options)

    def counted_reading(player: playback.Player, armature: bpy.types.Object) -> Pose:
        names.append(armature.name)
        return read_pose(player, armature)

    monkeypatch.setattr(playback.Player, "read", counted)
    monkeypatch.setattr(playback.Player, "read_pose", counted_reading)
    return names


def second_arm(database: Path, height: float) -> Arm:
    """Another arm of the same database, that far above, straight where the first one bends."""
    arm = build_arm("second ", database)
    for ob in (arm.armature, arm.sleeve):
        ob.location.z = height
    arm.animate([{"elbow_L": [angle]} for angle in (1.5, 1.2, 0.1, 0.4)])
    return arm


# --- what comes behind and beside ---------------------------------------------------------------------------------


def test_modifiers_behind_work_on_the_played_shape(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    poses = bending(arm)
    behind = ("SUBSURF", "SOLIDIFY")
    for kind in behind:
        arm.sleeve.modifiers.new(kind, kind)
    for frame in (2, 3):
        bpy.context.scene.frame_set(frame)
        picture = render_still(tmp_path / "picture.png")
        shape = bumps.shape(poses[frame - 1])
        assert difference(picture, expected_picture(arm, shape, tmp_path / "expected.png", like=behind)) < SAME


def test_a_render_may_show_half_the_detail_of_the_viewport(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    poses = bending(arm)
    scene = bpy.context.scene
    subdivision = arm.sleeve.modifiers.new("SUBSURF", "SUBSURF")
    subdivision.levels = subdivision.render_levels = 2
    scene.render.use_simplify = True
    scene.render.simplify_subdivision, scene.render.simplify_subdivision_render = 2, 1
    in_render: list[int] = []

    def count(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        if depsgraph.mode == "RENDER":
            in_render.append(len(arm.sleeve.evaluated_get(depsgraph).data.vertices))

    scene.frame_set(3)
    in_viewport = len(arm.sleeve.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices)
    bpy.app.handlers.frame_change_post.append(count)
    try:
        picture = render_still(tmp_path / "picture.png")
    finally:
        bpy.app.handlers.frame_change_post.remove(count)
    # One level less has a quarter of the faces.
    assert in_render and 3 * max(in_render) < in_viewport
    shape = bumps.shape(poses[2])
    assert difference(picture, expected_picture(arm, shape, tmp_path / "expected.png", like=("SUBSURF",))) < SAME
    # Rendering leaves the viewport with its own detail, still played.
    bpy.context.view_layer.update()
    evaluated = arm.sleeve.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert len(evaluated.data.vertices) == in_viewport and playback.status(arm.sleeve).error == ""


def test_objects_deformed_by_the_same_armature_are_in_the_same_pose(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    """A cuff that is skinned and a button that hangs on a bone: neither a frame behind nor one ahead."""
    poses = bending(arm)
    cuff = add_cuff(arm)
    button = plain_mesh(arm, tube(0.03, 12, 30)[0] * [0.1, 1.0, 1.0] + [0.0, 0.0, 0.15])
    button.parent, button.parent_type, button.parent_bone = arm.armature, "BONE", "lower"
    pictures = render_animation(tmp_path)
    arm.sleeve.wrinkles.enabled = False
    arm.sleeve.hide_render = True
    for frame, (picture, pose) in enumerate(zip(pictures, poses, strict=True), 1):
        expected = plain_mesh(arm, bumps.shape(pose))
        bpy.context.scene.frame_set(frame)
        assert difference(picture, render_still(tmp_path / "expected.png")) < SAME
        cuff.hide_render = True
        assert difference(picture, render_still(tmp_path / "bare.png")) > SAME
        cuff.hide_render = False
        bpy.data.objects.remove(expected)


def add_cuff(arm: Arm) -> bpy.types.Object:
    """A wide ring at the wrist, parented to the armature and skinned by it."""
    positions, quads = tube(0.12, 12, 30)
    positions[:, 0] = 0.5 + 0.1 * positions[:, 0]
    mesh = bpy.data.meshes.new("cuff")
    mesh.from_pydata(positions.tolist(), [], quads)
    cuff = bpy.data.objects.new("cuff", mesh)
    bpy.context.scene.collection.objects.link(cuff)
    for bone, weights in zip(("upper", "lower"), arm_weights(positions).T, strict=True):
        group = cuff.vertex_groups.new(name=bone)
        for vertex, weight in enumerate(weights):
            group.add([vertex], float(weight), "REPLACE")
    cuff.parent = arm.armature
    bind_to_armature(cuff, arm.armature)
    return cuff


# --- view layers and scenes ---------------------------------------------------------------------------------------


def test_two_view_layers_show_each_its_own_garment(arm: Arm, bumps: Bumps, database: Path, tmp_path: Path) -> None:
    scene = bpy.context.scene
    poses = bending(arm)
    other = second_arm(database, 0.0)
    first_layer, second_layer = scene.view_layers[0], scene.view_layers.new("second")
    for each, hidden_in in ((arm, second_layer), (other, first_layer)):
        collection = bpy.data.collections.new(each.sleeve.name)
        scene.collection.children.link(collection)
        for ob in (each.sleeve, each.armature):
            collection.objects.link(ob)
            scene.collection.objects.unlink(ob)
        hidden_in.layer_collection.children[collection.name].exclude = True
    write_layers(scene)
    scene.frame_set(3)
    scene.render.filepath = str(tmp_path / "layers-####")
    bpy.ops.render.render(animation=True)
    others = [bumps.pose({"elbow_L": [angle]}) for angle in (1.5, 1.2, 0.1, 0.4)]
    scene.view_layers.remove(second_layer)
    write_pictures(scene)
    other.sleeve.hide_render = True
    for frame in (1, 3, 4):
        layers = layer_alphas(tmp_path / f"layers-{frame:04}.exr")
        for name, pose in ((first_layer.name, poses[frame - 1]), ("second", others[frame - 1])):
            picture = expected_picture(arm, bumps.shape(pose), tmp_path / "expected.png")
            assert difference(layers[name], picture) < SAME
        assert difference(*layers.values()) > DIFFERENT


def test_two_scenes_show_one_garment_each_in_its_own_frame(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    """Blender renders any scene in the frame of the one that is open."""
    poses = bending(arm)
    here = bpy.context.scene
    there = here.copy()
    for scene, frame in ((here, 2), (there, 3), (here, 4), (there, 1)):
        here.frame_current = frame
        picture = render_still(tmp_path / "picture.png", scene)
        expected = expected_picture(arm, bumps.shape(poses[frame - 1]), tmp_path / "expected.png")
        assert difference(picture, expected) < SAME


def test_a_garment_in_the_background_set_of_a_scene_is_played(arm: Arm, bumps: Bumps, tmp_path: Path) -> None:
    poses = bending(arm)
    here = bpy.context.scene
    there = here.copy()
    for ob in (arm.sleeve, arm.armature):
        there.collection.objects.unlink(ob)
    there.background_set = here
    for frame in (3, 2):
        here.frame_current = frame
        picture = render_still(tmp_path / "picture.png", there)
        expected = expected_picture(arm, bumps.shape(poses[frame - 1]), tmp_path / "expected.png")
        assert difference(picture, expected) < SAME


# --- from the window ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["BLENDER_WORKBENCH"], indirect=True)
def test_the_interface_is_locked_in_renders_and_the_lock_is_offered_once_it_is_off(arm: Arm) -> None:
    scene = bpy.context.scene
    bending(arm)
    scene.frame_set(2)
    assert scene.render.use_lock_interface
    assert not WRINKLE_PT_render_lock.poll(bpy.context)
    scene.render.use_lock_interface = False
    scene.frame_set(3)
    assert not scene.render.use_lock_interface, "what the artist switched off stays off"
    assert WRINKLE_PT_render_lock.poll(bpy.context)
    arm.sleeve.wrinkles.enabled = False
    assert not WRINKLE_PT_render_lock.poll(bpy.context)


# --- what is not seen costs nothing -------------------------------------------------------------------------------


def hide_in_renders(arm: Arm) -> None:
    arm.sleeve.hide_render = True


def exclude(arm: Arm) -> None:
    scene = bpy.context.scene
    collection = bpy.data.collections.new("away")
    scene.collection.children.link(collection)
    collection.objects.link(arm.sleeve)
    scene.collection.objects.unlink(arm.sleeve)
    bpy.context.view_layer.layer_collection.children["away"].exclude = True


def close_the_eye_of_the_modifier(arm: Arm) -> None:
    arm.sleeve.modifiers["Wrinkles"].show_render = False


def switch_off(arm: Arm) -> None:
    arm.sleeve.wrinkles.enabled = False


@pytest.mark.parametrize("hide", [hide_in_renders, exclude, close_the_eye_of_the_modifier, switch_off])
def test_a_garment_that_a_render_does_not_show_is_not_played(
    arm: Arm, hide: Callable[[Arm], None], played: list[str], tmp_path: Path
) -> None:
    bending(arm)
    bpy.context.scene.frame_set(2)
    hide(arm)
    bpy.context.scene.frame_set(1)
    played.clear()
    # Blender evaluates the window's layers as well; what is hidden from renders alone is shown there.
    bpy.context.view_layer.use = True
    arm.sleeve.hide_viewport = True
    render_animation(tmp_path)
    assert played == []


@pytest.mark.parametrize("how", ["hide_viewport", "hide_set", "collection"])
def test_a_garment_that_the_viewport_does_not_show_is_not_played(arm: Arm, how: str, played: list[str]) -> None:
    bending(arm)
    bpy.context.scene.frame_set(2)
    if how == "hide_viewport":
        arm.sleeve.hide_viewport = True
    elif how == "hide_set":
        arm.sleeve.hide_set(True)
    else:
        exclude(arm)
    bpy.context.view_layer.update()
    played.clear()
    for frame in (3, 1, 4):
        bpy.context.scene.frame_set(frame)
    assert played == []


def cull(arm: Arm) -> None:
    """Let Cycles leave out what the camera does not see."""
    scene = bpy.context.scene
    scene.render.use_simplify = scene.cycles.use_camera_cull = True
    scene.cycles.camera_cull_margin = 0.1
    arm.sleeve.cycles.use_camera_cull = True


@pytest.mark.parametrize("engine", ["CYCLES"], indirect=True)
def test_a_garment_outside_the_picture_is_not_played_where_cycles_culls_it(
    arm: Arm, played: list[str], tmp_path: Path
) -> None:
    bending(arm)
    scene = bpy.context.scene
    cull(arm)
    scene.camera.location.x = 3.0
    scene.frame_set(2)
    arm.sleeve.hide_viewport = True
    played.clear()
    render_animation(tmp_path)
    assert played == []
    # Through a mirror or by its shadow it would be seen: without culling it is played.
    arm.sleeve.cycles.use_camera_cull = False
    render_animation(tmp_path)
    assert played


@pytest.mark.parametrize("engine", ["CYCLES"], indirect=True)
@pytest.mark.parametrize("shift", [0.0, 0.35, -0.55])
def test_culling_takes_nothing_out_of_a_picture(arm: Arm, bumps: Bumps, shift: float, tmp_path: Path) -> None:
    poses = bending(arm)
    scene = bpy.context.scene
    scene.camera.location.x += shift
    cull(arm)
    scene.frame_current = 3
    picture = render_still(tmp_path / "picture.png")
    assert picture.any()
    assert difference(picture, expected_picture(arm, bumps.shape(poses[2]), tmp_path / "expected.png")) < SAME
