"""Kernels of the coarse simulation's steps against float64 references."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import closest_point, sphere, tube
from wrinkle_synthesis.kernels.cloth import frame_steps, layers
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings, make_body, make_planes, reach_of
from wrinkle_synthesis.wrinkle_addon.coarse_contact import make_path


def path(device, *positions):
    made = make_path(len(positions[0]), device)
    for name, values in zip(("earlier", "last", "coming"), positions, strict=True):
        getattr(made, name).assign(values.astype(np.float32))
    return made


def along(device, positions, share):
    """Where a path lies, by way of the body that follows it."""
    faces = np.array([[0, 1, 2]], np.int32)
    body, _ = make_body(faces, positions[0][None], device)
    clock = wp.array([0.0, 0.0, 0.0, 0.0, 0.0, share], dtype=wp.float64, device=device)
    normals = path(device, *(np.tile([0.0, 0.0, 1.0], (3, 1)) for _ in range(3)))
    inputs = [path(device, *positions), normals, clock, body]
    wp.launch(frame_steps.move_body, dim=3, inputs=inputs, device=device)
    return body.points.numpy()[0]


def test_a_path_goes_through_both_frames_and_leaves_with_their_mean_velocity(device):
    rng = np.random.default_rng(0)
    earlier, last, coming = (rng.normal(size=(3, 3)).astype(np.float32) for _ in range(3))
    positions = earlier, last, coming
    np.testing.assert_allclose(along(device, positions, 0.0), last, atol=1e-6)
    np.testing.assert_allclose(along(device, positions, 1.0), coming, atol=1e-6)
    step = 1.0e-3
    begins = (along(device, positions, step) - last) / step
    ends = (coming - along(device, positions, 1.0 - step)) / step
    # One-sided differences over a thousandth, in float32.
    np.testing.assert_allclose(begins, 0.5 * (coming - earlier), atol=0.02)
    np.testing.assert_allclose(ends, coming - last, atol=0.02)


def test_a_steady_motion_stays_steady(device):
    start, speed = np.random.default_rng(1).normal(size=(2, 3, 3))
    for share in (0.2, 0.5, 0.9):
        found = along(device, (start - speed, start, start + speed), share)
        np.testing.assert_allclose(found, start + share * speed, atol=1e-6)


@pytest.fixture
def ball(device):
    """A ball, points around it and their directions from its centre."""
    positions, faces = sphere(0.1, 2)
    body, meshes = make_body(faces, positions[None], device)
    directions = np.random.default_rng(2).normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = directions * np.linspace(0.09, 0.13, 60)[:, None]
    normals = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    body.normals.assign(normals.astype(np.float32)[None])
    body.limb = wp.zeros(len(faces), dtype=wp.int32, device=device)
    return positions, faces, body, meshes, points, directions


UNKNOWN = int(frame_steps.UNKNOWN)


FAR_ABOVE = 1.0
"""Height [m] of vertices that touch nothing."""


def candidates(ball, device, known, came_from=None, moved=(0.0, 0.0, 0.0)):
    """What is close to points that were elsewhere, and to a ball that has moved by ``moved`` since."""
    positions, _, body, _, points, directions = ball
    count = len(points)
    found = wp.array(known, dtype=wp.int32, device=device)
    found_from = wp.array(points[None] if came_from is None else came_from[None], dtype=wp.vec3d, device=device)
    wp.launch(
        frame_steps.find_candidates,
        dim=count,
        inputs=[
            wp.array(points[None], dtype=wp.vec3d, device=device),
            wp.array(directions[None].astype(np.float32), dtype=wp.vec3, device=device),
            wp.ones(count, dtype=wp.int32, device=device),
            body,
            path(device, positions - moved, positions, positions),
            reach_of(ContactSettings(radius=0.1)),
            wp.zeros(count, dtype=wp.float64, device=device),
            found_from,
            found,
            wp.full(count, FAR_ABOVE, dtype=wp.float32, device=device),
        ],
        device=device,
    )
    np.testing.assert_array_equal(found_from.numpy()[0], points)
    return found.numpy()


def from_ball(ball):
    """Distance of each point to every triangle [m], and whether it lies in the ball; facets lie up to 3 mm inside."""
    positions, faces, _, _, points, _ = ball
    distances = np.array([[np.linalg.norm(p - closest_point(p, positions[f])) for f in faces] for p in points])
    return distances, np.linalg.norm(points, axis=1) < 0.097


def test_candidates_are_the_closest_triangles_whatever_was_close_before(device, ball):
    distances, inside = from_ball(ball)
    count, triangles = distances.shape
    rng = np.random.default_rng(3)
    unknown = np.full(count, UNKNOWN)
    known = unknown, np.full(count, -1), distances.argsort(1)[:, 5], rng.integers(0, triangles, count)
    for before in known:
        found = candidates(ball, device, before)
        counts = (np.linalg.norm(ball[4], axis=1) > 0.1) | (before is unknown)
        chosen = distances[np.arange(count), found]
        # Equally near ones differ by the rounding of float32.
        np.testing.assert_allclose(chosen[counts], distances.min(1)[counts], atol=1e-6)
        if before is not unknown:
            # What was in the ball a frame ago already has not come through its skin since.
            assert ((found == before) | (found == -1))[inside].all()


@pytest.mark.parametrize("moving", ["the points", "the ball"])
def test_skin_that_was_passed_through_is_where_a_vertex_came_in(device, ball, moving):
    """All by the same way: along x, as seen from the ball."""
    positions, faces, _, _, points, outward = ball
    _, inside = from_ball(ball)
    way = np.array([0.3, 0.0, 0.0])
    came_from, moved = (points + way, np.zeros(3)) if moving == "the points" else (points, way)
    outward[:] = [1.0, 0.0, 0.0]
    found = candidates(ball, device, np.full(len(points), -1), came_from, moved)
    entered = positions[faces[found[inside]]].mean(1)
    across = points[inside][:, 1:]
    assert inside.sum() > 5
    beside = np.concatenate([np.sqrt(0.1**2 - (across**2).sum(1))[:, None], across], 1)
    # Edges are 3 cm long, and longer along x where the ball slopes away.
    assert np.linalg.norm((entered - beside)[:, 1:], axis=1).max() < 0.03
    assert (entered[:, 0] > 0.0).all()


def test_planes_follow_a_body_that_has_moved_on_and_lie_off_its_skin(device, ball):
    """From candidates of the body where it was, a little turned and shifted since."""
    positions, _, body, _, points, _ = ball
    known = candidates(ball, device, np.full(len(points), UNKNOWN))
    angle, shift, lift = 0.1, np.array([0.01, 0.0, -0.005]), 0.004
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    body.points.assign((positions @ turn.T + shift).astype(np.float32)[None])
    normals = positions @ turn.T / 0.1
    body.normals.assign(normals.astype(np.float32)[None])
    count = len(points)
    planes, _ = make_planes(ContactSettings(), (1, 2 * count), device)
    held = wp.array(known, dtype=wp.int32, device=device)
    motion = frame_steps.Motion()
    motion.positions = motion.before = places = wp.array(points[None], dtype=wp.vec3d, device=device)
    # Some lie in the ball, and must have been there before.
    sunk = wp.full(count, -1.0, dtype=wp.float32, device=device)
    clock = wp.zeros(frame_steps.CLOCK_SIZE, dtype=wp.float64, device=device)
    still = path(device, *(body.points.numpy()[0] for _ in range(3)))
    lifts = wp.array(np.full(count, lift), dtype=wp.float64, device=device)
    inputs = [motion, places, sunk, clock, wp.float64(1.0), body, still, lifts, held, planes]
    wp.launch(frame_steps.follow_planes, dim=count, inputs=inputs, device=device)
    point, normal = planes.point.numpy()[0, ::2], planes.normal.numpy()[0, ::2]
    away = points - shift
    radial = away / np.linalg.norm(away, axis=1, keepdims=True)
    # Triangles of a ball of 2 subdivisions are 30 mm long and lie up to 2 mm inside it.
    assert ((normal * radial).sum(1) > np.cos(0.1)).all()
    heights = np.linalg.norm(point - shift, axis=1)
    assert np.abs(heights - 0.1 - lift).max() < 0.002


def test_vertices_outside_an_outer_garment_and_over_a_triangle_collide(device):
    """W46, in float64: outside, and projected inside the closest triangle; the outer garment is an open tube."""
    outer, faces = tube(9, 16, 0.4, 0.06)
    rng = np.random.default_rng(4)
    angle, height = rng.uniform(0.0, 2.0 * np.pi, 80), rng.uniform(-0.3, 0.3, 80)
    radius = rng.uniform(0.05, 0.07, 80)
    inner = np.stack([height, radius * np.cos(angle), radius * np.sin(angle)], 1)
    positions = np.concatenate([inner, outer])
    faces = faces + len(inner)
    rounded = wp.array(positions[None].astype(np.float32), dtype=wp.vec3, device=device)
    outward = np.zeros_like(positions)
    outward[:, 1:] = positions[:, 1:] / np.linalg.norm(positions[:, 1:], axis=1, keepdims=True)
    mesh = wp.Mesh(
        points=wp.array(outer.astype(np.float32), dtype=wp.vec3, device=device),
        indices=wp.array((faces - len(inner)).ravel(), dtype=wp.int32, device=device),
    )
    pairs = layers.LayerPairs()
    pairs.vertex = wp.array(np.arange(80), dtype=wp.int32, device=device)
    pairs.layer, pairs.face = (wp.zeros(80, dtype=wp.int32, device=device) for _ in range(2))
    pairs.closest = wp.full(80, -1, dtype=wp.int32, device=device)
    pairs.area = wp.ones(80, dtype=wp.float64, device=device)
    vertices = wp.zeros(80, dtype=wp.vec4i, device=device)
    gap = wp.zeros(80, dtype=wp.float32, device=device)
    surface = [
        wp.array(faces, dtype=wp.int32, device=device),
        wp.array([mesh.id], dtype=wp.uint64, device=device),
        wp.zeros(1, dtype=wp.int32, device=device),
    ]
    directions = wp.array(outward[None].astype(np.float32), dtype=wp.vec3, device=device)
    inputs = [rounded, directions, *surface, 0.1]
    wp.launch(layers.find_layer_pairs, dim=80, inputs=inputs, outputs=[pairs, vertices], device=device)
    exact = wp.array(positions[None], dtype=wp.vec3d, device=device)
    wp.launch(layers.measure_layer_gaps, dim=80, inputs=[exact, vertices, pairs], outputs=[gap], device=device)
    collides = gap.numpy() < 0.0
    expected, sure = np.zeros(80, bool), np.ones(80, bool)
    for i, p in enumerate(inner):
        corners = positions[faces]
        nearest = np.argmin([np.linalg.norm(p - closest_point(p, triangle)) for triangle in corners])
        a, b, c = corners[nearest]
        normal = np.cross(b - a, c - a)
        areas = np.array([np.cross(v - u, p - u) @ normal for u, v in ((b, c), (c, a), (a, b))]) / (normal @ normal)
        expected[i] = areas.min() > 0.0 and (p - a) @ normal > 0.0
        # On an edge rounding decides, and on the surface itself.
        sure[i] = np.abs(areas).min() > 1e-4 and abs((p - a) @ normal) / np.linalg.norm(normal) > 1e-6
    assert expected[sure].sum() > 15 and (~expected[sure]).sum() > 15
    np.testing.assert_array_equal(collides[sure], expected[sure])
