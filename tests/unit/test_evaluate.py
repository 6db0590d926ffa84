"""The measures: curvature, intersections, depth, errors and popping, against shapes whose answers are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from baked_dolls import baked, bump, full_plan
from cloth_shapes import sphere, tube
from dolls import Doll, doll
from wrinkle_synthesis.wrinkle_addon.evaluate import EvaluatedFrame, evaluate
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import JointWrinkles
from wrinkle_synthesis.wrinkle_addon.penetration import PushOut, bind_clearance
from wrinkle_synthesis.wrinkle_addon.rig import pose_of_angles
from wrinkle_synthesis.wrinkle_addon.surface import BodyVolume, SurfaceMeasures
from wrinkle_synthesis.wrinkle_addon.wearer import worn_limbs


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


def triangles_meet(positions, first, second):
    """Whether an edge of one triangle passes through the inside of the other, by solving for the place, in float64."""
    for edges, triangle in ((first, second), (second, first)):
        a, b, c = positions[triangle]
        for start, end in ((edges[0], edges[1]), (edges[1], edges[2]), (edges[2], edges[0])):
            matrix = np.stack([positions[end] - positions[start], a - b, a - c], 1)
            if not {start, end} & set(triangle) and np.linalg.det(matrix) != 0.0:
                along, u, v = np.linalg.solve(matrix, a - positions[start])
                if 0.0 < along < 1.0 and u > 0.0 and v > 0.0 and u + v < 1.0:
                    return True
    return False


@pytest.mark.parametrize("crumple", [0.015, 0.03])
def test_every_intersecting_pair_of_triangles_is_counted_once(crumple):
    positions, faces = tube(7, 8, 0.1, 0.03)
    positions = positions + crumple * np.random.default_rng(1).normal(size=positions.shape)
    found = SurfaceMeasures(faces, len(positions)).self_intersections(positions)
    # Triangles that share an edge count as one surface; in general position they never meet otherwise.
    expected = [
        (i, j)
        for i in range(len(faces))
        for j in range(i + 1, len(faces))
        if len(set(faces[i]) & set(faces[j])) < 2 and triangles_meet(positions, faces[i], faces[j])
    ]
    assert found.tolist() == [list(pair) for pair in expected]
    assert len(expected) > (5 if crumple < 0.02 else 100)


def test_an_edge_that_passes_exactly_through_another_edge_is_counted():
    """Layers whose edges cross in the very middle, as regular grids do; rounding would miss or double them."""
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    upright = np.array([[0.5, 0.5, -0.5], [0.5, 0.5, 0.5], [2.0, 2.0, 0.5], [2.0, 2.0, -0.5]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    measures = SurfaceMeasures(faces, 8)
    edges, triangles = measures.self_crossings(np.concatenate([flat, upright]))
    crossed = [t for e, t in zip(edges, triangles, strict=True) if set(measures.edges[e]) == {4, 5}]
    assert len(crossed) == 1 and crossed[0] in (0, 1)


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
    around = np.flatnonzero((faces == vertex).any(1))
    assert measures.self_intersections(pushed).tolist() == [sorted([opposite, t]) for t in around]


def test_depth_inside_a_sphere_is_the_distance_to_its_skin():
    skin, faces = sphere(0.2, 4)
    points = np.array([[0.0, 0.0, 0.15], [0.0, 0.1, 0.0], [0.3, 0.0, 0.0]])
    depth, covered = BodyVolume(skin, faces).depth(points)
    assert depth == pytest.approx([0.05, 0.1, 0.0], abs=2e-3)
    assert not covered.any()


def test_depth_tells_in_from_out_at_a_sharp_edge():
    """Beside the thin edge of a wedge, the nearest vertices' normals point the wrong way."""
    wedge = np.array([[0.0, 0.0, 0.0], [0.0, 0.2, 0.0], [0.2, 0.0, 0.01], [0.2, 0.2, 0.01], [0.2, 0.0, -0.01],
                      [0.2, 0.2, -0.01]])  # fmt: skip
    faces = np.array([[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4], [2, 4, 3], [3, 4, 5], [0, 4, 2], [1, 3, 5]])
    rng = np.random.default_rng(2)
    points = rng.uniform([-0.1, -0.05, -0.03], [0.25, 0.25, 0.03], (1200, 3))
    x, y, z = points.T
    inside = (x > 0.0) & (x < 0.2) & (y > 0.0) & (y < 0.2) & (np.abs(z) < 0.05 * x)
    depth, _ = BodyVolume(wedge, faces).depth(points)
    assert np.array_equal(depth > 0.0, inside)
    assert inside.sum() > 40


def test_depth_where_the_body_cuts_into_itself_is_told_apart():
    one, faces = sphere(0.1, 4)
    body = np.concatenate([one - [0.06, 0.0, 0.0], one + [0.06, 0.0, 0.0]])
    volume = BodyVolume(body, np.concatenate([faces, faces + len(one)]))
    # In the lens that both share, in one of them alone, and outside both.
    depth, covered = volume.depth(np.array([[0.01, 0.0, 0.0], [0.14, 0.0, 0.0], [0.0, 0.0, 0.12]]))
    assert depth == pytest.approx([0.03, 0.02, 0.0], abs=1e-3)
    assert covered.tolist() == [True, False, False]


def test_depth_agrees_with_the_solid_angles_of_all_triangles():
    """The winding number by its definition (Van Oosterom and Strackee 1983), on a body with an open end."""
    body, faces = tube(21, 24, 0.4, 0.05)
    points = np.random.default_rng(3).uniform(-0.07, 0.07, (300, 3)) * [2.0, 1.0, 1.0]
    a, b, c = (body[faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    above = (a * np.cross(b, c)).sum(2)
    below = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    winding = np.arctan2(above, below).sum(1) / (2.0 * np.pi)
    # The kernel sums far triangles by groups, which is good to some percent.
    sure = np.abs(winding - 0.5) > 0.05
    depth, _ = BodyVolume(body, faces).depth(points)
    assert np.array_equal((depth > 0.0)[sure], (winding > 0.5)[sure])
    assert sure.mean() > 0.9


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


def test_what_is_kept_clear_is_measured_as_it_is_shown(character: Doll, database):
    sunk = replace(database, rest=0.92 * database.rest + 0.08 * database.rest.mean(0))
    clip = frames(character, database)
    before = evaluate(sunk, clip, character.body.faces)
    limbs = worn_limbs(character.rig, character.garment, character.body)
    body = character.body
    binding = bind_clearance(database.rest, character.garment.faces, body.positions, body.faces, limbs)
    after = evaluate(sunk, clip, body.faces, push=PushOut(binding))
    assert before["inside_share"] > 0.05
    assert after["inside_share"] - after["inside_overlap_share"] < 0.1 * before["inside_share"]
    assert after["rmse_mm"]["skinning"] == before["rmse_mm"]["skinning"]
    assert after["rmse_mm"]["ours"] < before["rmse_mm"]["ours"]


def test_another_vertex_count_and_an_empty_clip_are_refused(character: Doll, database):
    pose = frames(character, database)[0].pose
    with pytest.raises(ValueError, match="reference has 5 vertices"):
        evaluate(database, [EvaluatedFrame(1, pose, np.zeros((5, 3)))], None)
    with pytest.raises(ValueError, match="no frame"):
        evaluate(database, [], None)
