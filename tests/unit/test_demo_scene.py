"""The demo's .blend file, opened again."""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from wrinkle_synthesis.demo import packages  # noqa: E402
from wrinkle_synthesis.demo.character import Build, load_character  # noqa: E402
from wrinkle_synthesis.demo.scene import PIN_GROUP, build_character  # noqa: E402

VERTEX_COUNT = 3_000


@pytest.fixture(scope="module", params=["cmu_mb", "game_engine"])
def rig_name(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The name of the rig of the character that is open in Blender."""
    try:
        packages.package_folder(packages.BODY)
    except packages.PackageError as error:
        pytest.skip(str(error))
    path = tmp_path_factory.mktemp("scene") / "new folder" / "character.blend"
    build_character(path, "female", ("tshirt", "trousers"), VERTEX_COUNT, request.param)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return request.param


def positions(name: str) -> np.ndarray:
    """Vertices as Blender's modifiers leave them [m]."""
    mesh = bpy.data.objects[name].evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    found = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", found)
    return found.reshape(-1, 3)


@pytest.mark.usefixtures("rig_name")
def test_it_holds_the_dressed_character() -> None:
    kinds = {thing.name: thing.type for thing in bpy.data.objects}
    assert {name for name, kind in kinds.items() if kind == "MESH"} == {"body", "tshirt", "trousers"}
    assert kinds["Rig"] == "ARMATURE" and bpy.context.scene.camera is not None
    assert len(bpy.data.objects["body"].data.vertices) == 13_380
    assert len(bpy.data.objects["tshirt"].data.vertices) == pytest.approx(VERTEX_COUNT, rel=0.02)


def test_bones_are_those_of_the_rig(rig_name: str) -> None:
    rig = load_character(Build("female"), rig_name).rig
    bones = bpy.data.objects["Rig"].data.bones
    assert set(bones.keys()) == set(rig.names)
    for name, rest, length, parent in zip(rig.names, rig.rest, rig.lengths, rig.parents, strict=True):
        # Blender keeps bones in single precision, as head, tail and roll.
        np.testing.assert_allclose(np.array(bones[name].matrix_local), rest, atol=1e-4)
        assert bones[name].length == pytest.approx(length, abs=1e-5)
        assert (bones[name].parent.name if bones[name].parent else "") == (rig.names[parent] if parent >= 0 else "")


@pytest.mark.usefixtures("rig_name")
@pytest.mark.parametrize("name", ["body", "tshirt", "trousers"])
def test_meshes_follow_the_rig_and_rest_where_they_were_modelled(name: str) -> None:
    skinned, armature = bpy.data.objects[name], bpy.data.objects["Rig"]
    assert skinned.parent == armature
    assert [modifier.object for modifier in skinned.modifiers] == [armature]
    assert {group.name for group in skinned.vertex_groups} <= {*armature.data.bones.keys(), PIN_GROUP}
    modelled = np.array([vertex.co for vertex in skinned.data.vertices])
    np.testing.assert_allclose(positions(name), modelled, atol=1e-5)


def test_a_raised_thigh_takes_its_trouser_leg_along(rig_name: str) -> None:
    bone = bpy.data.objects["Rig"].pose.bones["LeftUpLeg" if rig_name == "cmu_mb" else "thigh_l"]
    before = positions("trousers")
    bone.rotation_mode = "QUATERNION"
    bone.rotation_quaternion = (0.9, 0.4, 0.0, 0.17)
    bpy.context.view_layer.update()
    moved = np.linalg.norm(positions("trousers") - before, axis=1)
    bone.rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    left = before[:, 0] > 0.08
    assert moved[left & (before[:, 2] < 0.5)].min() > 0.1
    assert moved[~left & (before[:, 0] < -0.08)].max() < 0.02


def test_what_cannot_be_built_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'toga'"):
        build_character(tmp_path / "x.blend", garments=("toga",))
