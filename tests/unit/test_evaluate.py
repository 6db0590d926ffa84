"""The measures: curvature, intersections, depth, errors and popping, against shapes whose answers are known."""

from pathlib import Path

import numpy as np
import pytest
from baked_dolls import baked, bump, full_plan
from cloth_shapes import sphere, tube
from dolls import Doll, doll
from wrinkle_synthesis.wrinkle_addon.evaluate import EvaluatedFrame, evaluate
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import JointWrinkles
from wrinkle_synthesis.wrinkle_addon.rig import pose_of_angles
from wrinkle_synthesis.wrinkle_addon.surface import SurfaceMeasures, depth_inside


def test_a_sphere_has_the_curvature_of_its_radius():
    positions, faces = sphere(0.25, 4)
    curvature = SurfaceMeasures(faces, len(positions)).mean_curvature(positions)
    # Barycentric areas of an icosphere are uneven by some percent.
    assert np.median(curvature) == pytest.approx(4.0, rel=0.03)
    assert curvature.min() > 3.2 and curvature.max() < 4.8


def test_a_tube_has_half_the_curvature_of_its_radius():
    positions, faces = tube(61, 48, 0.6, 0.05)
    curvature = SurfaceMeasures(faces, len(positions)).mean_curvature(positions)
    inner = np.abs(positions[:, 0]) < 0.25
    assert np.median(curvature[inner]) == pytest.approx(10.0, rel=0.02)


def test_intersecting_triangles_are_counted_and_neighbours_are_not():
    positions, faces = tube(21, 24, 0.4, 0.05)
    measures = SurfaceMeasures(faces, len(positions))
    assert len(measures.self_intersections(positions)) == 0
    pushed = positions.copy()
    # One vertex through the middle of a triangle in the opposite wall: its six edges cross that one.
    vertex = 10 * 24 + 3
    centres = positions[faces].mean(1)
    opposite = np.argmin(np.linalg.norm(centres - positions[vertex] * [1.0, -1.0, -1.0], axis=1))
    pushed[vertex] = centres[opposite] * [1.0, 1.4, 1.4]
    assert measures.self_intersections(pushed).tolist() == [opposite]


def test_depth_inside_a_sphere_is_the_distance_to_its_skin():
    skin, faces = sphere(0.2, 4)
    points = np.array([[0.0, 0.0, 0.15], [0.0, 0.1, 0.0], [0.3, 0.0, 0.0]])
    assert depth_inside(points, skin, faces) == pytest.approx([0.05, 0.1, 0.0], abs=2e-3)


@pytest.fixture(scope="module")
def character() -> Doll:
    return doll()


@pytest.fixture(scope="module")
def database(character: Doll, tmp_path_factory: pytest.TempPathFactory):
    folder: Path = tmp_path_factory.mktemp("evaluate")
    return baked(folder, character, full_plan(character), {"elbow_L": bump(character, "elbow_L")})


def frames(character: Doll, database, shift: float = 0.0, wobble: float = 0.0) -> list[EvaluatedFrame]:
    """A bending elbow whose reference is our own result, moved by ``shift`` or shaking by ``wobble`` [m]."""
    evaluator = JointWrinkles(database).bind()
    result = []
    for number, degrees in enumerate(np.linspace(0, 80, 9)):
        pose = pose_of_angles(character.rig, character.joints, {"elbow_L": [np.radians(degrees)]})
        reference = evaluator.positions(pose).astype(float) + [shift, 0.0, 0.0]
        reference += wobble * (-1.0) ** number * np.array([0.0, 0.0, 1.0])
        result.append(EvaluatedFrame(number + 1, pose, reference, character.positions(pose), {"residual": 0.5}))
    return result


def test_errors_are_root_mean_squares_in_millimetres(character: Doll, database):
    result = evaluate(database, frames(character, database, shift=0.003), character.body.faces)
    assert result["rmse_mm"]["ours"] == pytest.approx(3.0, abs=1e-3)
    assert result["max_mm"]["ours"] == pytest.approx(3.0, abs=1e-3)
    assert result["rmse_mm"]["skinning"] > result["rmse_mm"]["ours"]
    assert [frame["frame"] for frame in result["frames"]] == list(range(1, 10))
    assert all(frame["rmse_mm"]["ours"] == pytest.approx(3.0, abs=1e-3) for frame in result["frames"])
    assert {"elbow_L", "shoulder_L"} <= set(result["regions"])
    assert result["curvature_ratio"] == pytest.approx(1.0, abs=1e-4)
    assert result["curvature_correlation"] == pytest.approx(1.0, abs=1e-4)
    assert result["reference"]["residual"] == 0.5


def test_a_reference_that_shakes_has_the_larger_accelerations(character: Doll, database):
    still = evaluate(database, frames(character, database), character.body.faces)
    shaken = evaluate(database, frames(character, database, wobble=0.001), character.body.faces)
    assert still["acceleration_ratio"] == pytest.approx(1.0, abs=1e-3)
    assert shaken["acceleration_ratio"] < 0.8


def test_penetration_is_the_share_of_vertices_inside(character: Doll, database):
    result = evaluate(database, frames(character, database), character.body.faces)
    deep = [
        EvaluatedFrame(f.frame, f.pose, f.reference, f.body * 1.0 + 0.0, f.report) for f in frames(character, database)
    ]
    assert result["inside_share"] == pytest.approx(evaluate(database, deep, character.body.faces)["inside_share"])
    assert 0.0 <= result["inside_share"] < 0.1


def test_another_vertex_count_and_an_empty_clip_are_refused(character: Doll, database):
    pose = frames(character, database)[0].pose
    with pytest.raises(ValueError, match="reference has 5 vertices"):
        evaluate(database, [EvaluatedFrame(1, pose, np.zeros((5, 3)))], None)
    with pytest.raises(ValueError, match="no frame"):
        evaluate(database, [], None)
