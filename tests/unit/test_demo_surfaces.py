"""Surfaces as functions on a grid, and even triangles on them."""

import numpy as np
import pytest
from wrinkle_synthesis.demo.implicit import Field, Grid, closing, smooth_union, with_holes_filled
from wrinkle_synthesis.wrinkle_addon.remesh import Edges, Patch, normals, polish, remesh

RADIUS = 0.2


def sphere(centre: tuple[float, float, float] = (0.0, 0.0, 0.0), spacing: float = 0.02, reach: float = 0.3) -> Field:
    grid = Grid.around([-reach] * 3, [reach] * 3, spacing)
    return Field(grid, np.linalg.norm(grid.points() - centre, axis=-1) - RADIUS)


def test_the_grid_mirrors_in_the_middle_plane() -> None:
    x = Grid.around([-0.31, 0.0, 0.0], [0.31, 0.1, 0.1], 0.02).points()[:, 0, 0, 0]
    np.testing.assert_allclose(x, -x[::-1], atol=1e-12)


def test_sampling_a_linear_function_is_exact() -> None:
    grid = Grid.around([-0.1] * 3, [0.1] * 3, 0.02)
    slope = np.array([1.0, -2.0, 0.5])
    points = np.random.default_rng(1).uniform(-0.07, 0.07, (50, 3))
    values, gradients = Field(grid, grid.points() @ slope + 0.3).sample(points)
    # B-splines reproduce linear functions; only rounding is left.
    np.testing.assert_allclose(values, points @ slope + 0.3, atol=1e-12)
    np.testing.assert_allclose(gradients, np.tile(slope, (50, 1)), atol=1e-11)


def test_the_gradient_is_that_of_the_value() -> None:
    field = sphere()
    points = np.random.default_rng(2).uniform(-0.2, 0.2, (50, 3))
    step = 1e-6
    numeric = np.stack(
        [(field.sample(points + step * e)[0] - field.sample(points - step * e)[0]) / (2 * step) for e in np.eye(3)], -1
    )
    np.testing.assert_allclose(field.sample(points)[1], numeric, atol=1e-7)


def test_a_level_set_is_closed_faces_outwards_and_encloses_the_volume() -> None:
    vertices, triangles = sphere().level_set()
    edges = Edges.of(triangles)
    assert not edges.is_border.any()
    assert len(vertices) - len(edges.ends) + len(triangles) == 2
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    volume = (a * np.cross(b, c)).sum() / 6.0
    # Chords across 2 cm cells cut off about h^2 / (4 r^2) of a sphere.
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.01)


def test_holes_are_closed() -> None:
    vertices, triangles = sphere().left_half().level_set()
    assert Edges.of(triangles).is_border.any()
    assert not Edges.of(with_holes_filled(vertices, triangles)[1]).is_border.any()


def test_closing_keeps_a_convex_form() -> None:
    vertices, triangles = sphere().level_set()
    grid = Grid.around([-0.25] * 3, [0.25] * 3, 0.05)
    closed = closing(vertices, triangles, 0.1, grid, reach=0.1)
    expected = np.linalg.norm(grid.points(), axis=-1) - RADIUS
    near = np.abs(expected) < 0.05
    # The form's own chords take away up to 0.7 mm, those of the offset surface (17 mm cells) 0.1 mm.
    np.testing.assert_allclose(closed.values[near], expected[near], atol=1.2e-3)


def test_closing_spans_a_hollow_the_ball_cannot_enter() -> None:
    parts = [sphere((x, 0.0, 0.0), reach=0.5) for x in (-0.19, 0.19)]
    form = Field(parts[0].grid, np.minimum(parts[0].values, parts[1].values)).level_set()
    # On the waist between the spheres the ball's centre keeps r + R from both of theirs.
    ball = 0.3
    waist = np.sqrt((RADIUS + ball) ** 2 - 0.19**2) - ball
    grid = Grid.around([-0.01, waist - 0.01, -0.01], [0.01, waist + 0.01, 0.01], 0.01)
    closed = closing(*form, ball, grid, reach=0.1)
    value, _ = closed.sample(np.array([[0.0, waist, 0.0]]))
    assert waist > 0.15  # the hollow itself reaches in to sqrt(0.2^2 - 0.19^2) = 0.06 m
    # Cells of 50 mm describe the offset surface of radius 0.3 m to 1 mm.
    assert value[0] == pytest.approx(0.0, abs=2e-3)


def test_a_smooth_union_is_the_smaller_value_where_they_differ_enough() -> None:
    a, b = np.array([0.0, 0.1, 0.05]), np.array([0.2, 0.0, 0.05])
    np.testing.assert_allclose(smooth_union(a, b, 0.04), [0.0, 0.0, 0.04], atol=1e-15)


@pytest.fixture(scope="module")
def dome() -> Patch:
    """Half a sphere, remeshed to 15 mm with its rim kept in the plane x = 0."""
    field = sphere()
    vertices, triangles = field.left_half().level_set()
    edges = Edges.of(triangles)
    borders = np.zeros(len(vertices), np.int64)
    borders[edges.ends[edges.is_border]] = 1

    def project(points: np.ndarray, _: np.ndarray, masks: np.ndarray) -> np.ndarray:
        points = points * (RADIUS / np.linalg.norm(points, axis=1, keepdims=True))
        points[masks > 0, 0] = 0.0
        return points

    return polish(remesh(Patch(vertices, triangles, borders), 0.015, project, passes=8), project, passes=20)


def test_remeshing_keeps_the_topology(dome: Patch) -> None:
    edges = Edges.of(dome.triangles)
    assert len(dome.vertices) - len(edges.ends) + len(dome.triangles) == 1
    assert set(np.flatnonzero(dome.borders)) == set(edges.ends[edges.is_border].ravel())
    assert (normals(dome.vertices, dome.triangles) * dome.vertices[dome.triangles].mean(1)).sum(1).min() > 0.0


def test_remeshed_triangles_are_even(dome: Patch) -> None:
    lengths = Edges.of(dome.triangles).lengths(dome.vertices)
    median = np.median(lengths)
    assert median == pytest.approx(0.015, rel=0.1)
    assert lengths.min() > 0.45 * median and lengths.max() < 1.6 * median
    sides = [
        np.linalg.norm(dome.vertices[dome.triangles[:, i]] - dome.vertices[dome.triangles[:, i - 1]], axis=1)
        for i in range(3)
    ]
    quality = (
        2.0 * np.sqrt(3.0) * np.linalg.norm(normals(dome.vertices, dome.triangles), axis=1) / sum(s**2 for s in sides)
    )
    assert quality.min() > 0.5 and np.median(quality) > 0.97


def test_the_rim_keeps_to_its_plane(dome: Patch) -> None:
    assert (dome.vertices[dome.borders > 0, 0] == 0.0).all()


def test_edges_of_a_mesh_that_is_no_surface_are_refused() -> None:
    with pytest.raises(ValueError, match="more than two triangles"):
        Edges.of(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
