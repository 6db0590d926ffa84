"""The demo's body and rig."""

import numpy as np
import pytest
from wrinkle_synthesis.demo import packages
from wrinkle_synthesis.demo.character import RIGS, Build, Character, bone_axes, load_character, mirrored_bones


@pytest.fixture(scope="module", autouse=True)
def cached() -> None:
    try:
        packages.package_folder(packages.BODY)
    except packages.PackageError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module", params=[("male", "cmu_mb"), ("female", "game_engine")], ids=["male", "female"])
def character(request: pytest.FixtureRequest) -> Character:
    sex, rig = request.param
    return load_character(Build(sex), rig)


def test_the_body_is_the_base_mesh_in_human_size_on_the_floor(character: Character) -> None:
    vertices = character.body.vertices
    assert vertices.shape == (13_380, 3) and character.body.quads.shape == (13_378, 4)
    assert vertices[:, 2].min() == 0.0 and 1.5 < vertices[:, 2].max() < 1.9
    assert character.body.uvs.shape == (13_378, 4, 2)
    assert 0.0 <= character.body.uvs.min() and character.body.uvs.max() <= 1.0


def test_it_faces_minus_y_with_left_along_x(character: Character) -> None:
    marks = character.landmarks
    assert marks["l-foot-1"][1] < marks["l-ankle"][1] - 0.05
    assert marks["l-elbow"][0] > 0.2 and marks["r-elbow"][0] < -0.2


def test_skin_faces_outwards(character: Character) -> None:
    points = character.body.vertices[character.body.triangles]
    volume = (points[:, 0] * np.cross(points[:, 1], points[:, 2])).sum() / 6.0
    # A body of 50 to 90 kg is about as many litres.
    assert 0.04 < volume < 0.1


def test_every_vertex_is_carried_by_bones(character: Character) -> None:
    for weights in (character.weights, character.shell_weights):
        np.testing.assert_allclose(weights.sum(1), 1.0, atol=1e-9)
        assert weights.min() >= 0.0 and weights.shape[1] == character.rig.bone_count


def test_body_and_weights_are_their_own_mirror_image(character: Character) -> None:
    images = character.body.vertices * [-1.0, 1.0, 1.0]
    order = [np.lexsort(np.round(points, 6).T) for points in (character.body.vertices, images)]
    np.testing.assert_array_equal(character.body.vertices[order[0]], images[order[1]])
    np.testing.assert_allclose(
        character.weights[order[0]], character.weights[order[1]][:, mirrored_bones(character.rig)], atol=1e-12
    )


def test_bones_sit_at_the_joints_of_this_body(character: Character) -> None:
    rig, marks = character.rig, character.landmarks
    knee, elbow = ("LeftLeg", "LeftForeArm") if "LeftLeg" in rig.index else ("calf_l", "lowerarm_l")
    np.testing.assert_allclose(rig.heads[rig.index[knee]], marks["l-knee"], atol=1e-12)
    np.testing.assert_allclose(rig.tails[rig.index[elbow]], marks["l-hand"], atol=1e-12)


def test_bone_counts_of_the_rigs() -> None:
    assert [load_character(rig=name).rig.bone_count for name in RIGS] == [31, 53]


def test_sex_age_and_build_shape_the_body() -> None:
    average = load_character().body.vertices
    for other in (Build("female"), Build(age=70.0), Build(muscle=1.0), Build(weight=0.0)):
        assert np.abs(load_character(other).body.vertices - average).max() > 0.01
    heavy, half_heavy = (load_character(Build(weight=w)).body.vertices for w in (1.0, 0.75))
    # Targets add up linearly, up to the shift that keeps the soles on the floor.
    offset = half_heavy - 0.5 * (average + heavy)
    np.testing.assert_allclose(offset - offset[0], 0.0, atol=1e-9)


@pytest.mark.parametrize("values", [{"sex": "other"}, {"age": 12.0}, {"muscle": 1.5}, {"weight": -0.1}])
def test_what_is_not_possible_is_refused(values: dict) -> None:
    with pytest.raises(ValueError, match="demo's body"):
        Build(**values)


def test_an_unknown_rig_is_named() -> None:
    with pytest.raises(ValueError, match="'unknown'"):
        load_character(rig="unknown")


@pytest.mark.parametrize("direction", [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.3, -0.9, 0.2), (0.0, 0.0, 1.0)])
def test_bone_axes_are_a_rotation_along_the_bone(direction: tuple[float, float, float]) -> None:
    axes = bone_axes(direction, roll=0.7)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(axes[:, 1], np.array(direction) / np.linalg.norm(direction), atol=1e-12)
