"""The back ends of `joints` and `animate` on files of every kind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from skeletons import CONVENTIONS, human, t_posed
from wrinkle_synthesis.wrinkle_addon.bvh import write_bvh
from wrinkle_synthesis.wrinkle_addon.joints import JOINT_NAMES, find_joints
from wrinkle_synthesis.wrinkle_addon.rig import Pose, joint_angles, pose_of_angles

bpy = pytest.importorskip("bpy")

from armatures import armature_of, evaluated  # noqa: E402
from wrinkle_synthesis.wrinkle_addon.blender.armature import read_pose, read_rig  # noqa: E402
from wrinkle_synthesis.wrinkle_addon.blender.rig_files import animate_file, joints_of_file  # noqa: E402

UNREAL = CONVENTIONS["Unreal"]


@pytest.fixture(autouse=True)
def empty_file() -> Iterator[None]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    yield
    bpy.ops.wm.read_factory_settings(use_empty=True)


def skinned_armature() -> None:
    """An armature that moves a mesh; importers and exporters ask for one."""
    armature = armature_of(human(UNREAL))
    mesh = bpy.data.meshes.new("Body")
    mesh.from_pydata([(0, 0, 1), (0.1, 0, 1), (0, 0, 1.1)], [], [(0, 1, 2)])
    body = bpy.data.objects.new("Body", mesh)
    bpy.context.scene.collection.objects.link(body)
    body.parent = armature
    body.vertex_groups.new(name="spine_01").add([0, 1, 2], 1.0, "REPLACE")
    body.modifiers.new("Armature", "ARMATURE").object = armature


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """Four frames in which a T-posed figure bends elbows and knees further and further, at 25 frames a second."""
    names = CONVENTIONS["Mixamo"]
    rig = t_posed(human(names), lambda part: names.get(part, ""))
    joints = find_joints(rig).found
    bends = [{name: [a] for name in ("elbow_L", "elbow_R", "knee_L", "knee_R")} for a in (0.0, 0.4, 0.8, 1.2)]
    path = tmp_path / "bends.bvh"
    write_bvh(path, rig, [pose_of_angles(rig, joints, each) for each in bends], 25.0)
    return path


def save(kind: str, folder: Path) -> Path:
    path = folder / f"figure{kind}"
    if kind == ".blend":
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    elif kind == ".fbx":
        bpy.ops.export_scene.fbx(filepath=str(path), add_leaf_bones=False)
    else:
        bpy.ops.export_scene.gltf(filepath=str(path))
    return path


# --- joints -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [".blend", ".fbx", ".glb", ".gltf"])
def test_joints_of_every_kind_of_file(kind: str, tmp_path: Path) -> None:
    skinned_armature()
    path = save(kind, tmp_path) if kind != ".gltf" else tmp_path / "figure.gltf"
    if kind == ".gltf":
        bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLTF_SEPARATE")
    described = joints_of_file(path)
    assert set(JOINT_NAMES) < set(described) and described["considered"] == {}
    assert described["elbow_L"]["bones"] == ["lowerarm_l"] and described["knee_R"]["bones"] == ["calf_r"]
    assert described["spine"]["bones"] == ["spine_01", "spine_02", "spine_03"]
    expected = find_joints(human(UNREAL)).joints["elbow_L"]
    np.testing.assert_allclose(described["elbow_L"]["range_deg"], np.degrees(expected.limits[0]), atol=0.1)


def test_joints_of_a_clip(clip: Path) -> None:
    assert joints_of_file(clip)["elbow_L"]["bones"] == ["mixamorig:LeftForeArm"]


# --- animate ----------------------------------------------------------------------------------------------------------


def test_a_clip_is_played_on_the_character_and_saved(clip: Path, tmp_path: Path) -> None:
    skinned_armature()
    result = animate_file(save(".blend", tmp_path), None, clip, tmp_path / "out.blend")
    assert result["frames"] == 4 and result["fps"] == 25.0 and result["joints"] == sorted(JOINT_NAMES)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    scene, armature = bpy.context.scene, bpy.data.objects["Figure"]
    assert (scene.render.fps, scene.render.fps_base, scene.frame_start, scene.frame_end) == (25, 1.0, 1, 4)
    rig = read_rig(armature)
    joints = find_joints(rig).found
    rest = {joint.name: -joint.limits[0, 0] for joint in joints if joint.is_hinge}
    for frame, bend in enumerate((0.0, 0.4, 0.8, 1.2), start=1):
        scene.frame_set(frame)
        angles = joint_angles(rig, joints, read_pose(evaluated(armature), rig))
        for name in ("elbow_L", "elbow_R", "knee_L", "knee_R"):
            # The clip rests straight, the character bent: the bend itself is the same.
            assert angles[name][0] + rest[name] == pytest.approx(bend, abs=1e-3)


@pytest.mark.parametrize("fps", [23.976, 30.0, 120.0])
def test_the_scene_plays_at_the_clips_rate(fps: float, tmp_path: Path) -> None:
    rig = human(UNREAL)
    write_bvh(tmp_path / "clip.bvh", rig, [Pose(rig.rest)] * 3, fps)
    skinned_armature()
    animate_file(save(".blend", tmp_path), "Figure", tmp_path / "clip.bvh", tmp_path / "out.blend")
    render = bpy.context.scene.render
    assert render.fps / render.fps_base == pytest.approx(fps, rel=1e-4)


# --- bad input --------------------------------------------------------------------------------------------------------


def test_bad_files_are_said_in_one_sentence(clip: Path, tmp_path: Path) -> None:
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "empty.blend"))
    (tmp_path / "noise.blend").write_bytes(b"noise" * 100)
    (tmp_path / "noise.glb").write_bytes(b"noise" * 100)
    (tmp_path / "noise.fbx").write_bytes(b"noise" * 100)
    (tmp_path / "notes.txt").write_text("noise")
    cases = {
        "none.blend": "There is no file",
        "empty.blend": "has no armature",
        "noise.blend": "noise.blend could not be opened",
        "noise.glb": "noise.glb could not be opened",
        "noise.fbx": "noise.fbx could not be opened",
        "notes.txt": r"notes.txt is no \.blend, \.glb, \.gltf",
        "none.bvh": "There is no motion file",
    }
    for name, sentence in cases.items():
        with pytest.raises(ValueError, match=sentence) as error:
            joints_of_file(tmp_path / name)
        assert "\n" not in str(error.value)
    skinned_armature()
    figure = save(".blend", tmp_path)
    with pytest.raises(ValueError, match=r"saved as a \.blend"):
        animate_file(figure, None, clip, tmp_path / "out.glb")
    with pytest.raises(ValueError, match="no folder"):
        animate_file(figure, None, clip, tmp_path / "nowhere" / "out.blend")
    with pytest.raises(ValueError, match="no motion file"):
        animate_file(figure, None, tmp_path / "none.bvh", tmp_path / "out.blend")


def test_several_armatures_must_be_named(clip: Path, tmp_path: Path) -> None:
    armature_of(human(UNREAL))
    armature_of(human(UNREAL)).name = "Other"
    path = save(".blend", tmp_path)
    with pytest.raises(ValueError, match="several armatures, Figure, Other; name one"):
        joints_of_file(path)
    with pytest.raises(ValueError, match="no armature Third; it has Figure, Other"):
        joints_of_file(path, "Third")
    assert joints_of_file(path, "Other")["knee_L"]["bones"] == ["calf_l"]


def test_of_several_armatures_the_only_one_that_moves_a_mesh_is_meant(tmp_path: Path) -> None:
    skinned_armature()
    # As a generated Rigify rig lies beside what it was generated from.
    armature_of(human()).name = "metarig"
    assert joints_of_file(save(".blend", tmp_path))["knee_L"]["bones"] == ["calf_l"]
