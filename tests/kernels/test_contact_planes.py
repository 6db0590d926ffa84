"""Planes of the body that the garment touches: closest points, smooth feet, folds, what lies across, what was held."""

import numpy as np
import warp as wp
from cloth_shapes import closest_point, raised, sheet, sphere, tube
from wrinkle_synthesis.kernels.cloth import body_surface, contact_planes
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings, Limbs
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model

# Kernels look in float32 at lengths up to 1 m: 1 micrometre leaves room for a few roundings.
FLOAT32 = 1.0e-6


@wp.kernel
def evaluate_closest_point(
    points: wp.array[wp.vec3], triangles: wp.array2d[wp.vec3], weights: wp.array[wp.vec3], closest: wp.array[wp.vec3]
):
    i = wp.tid()
    w = body_surface.closest_point_on_triangle(points[i], triangles[i, 0], triangles[i, 1], triangles[i, 2])
    weights[i] = w
    closest[i] = w[0] * triangles[i, 0] + w[1] * triangles[i, 1] + w[2] * triangles[i, 2]


def test_closest_point_on_a_triangle_is_the_closest(device):
    rng = np.random.default_rng(1)
    count = 1500
    triangles = 0.1 * rng.normal(size=(count, 3, 3))
    triangles[::5, 2] = triangles[::5, 1] + 1e-3 * rng.normal(size=(len(triangles[::5]), 3))  # Slivers too.
    points = 0.2 * rng.normal(size=(count, 3))
    points[::7] = triangles[::7, 0]
    weights, closest = (wp.zeros(count, dtype=wp.vec3, device=device) for _ in range(2))
    inputs = [wp.array(values.astype(np.float32), dtype=wp.vec3, device=device) for values in (points, triangles)]
    wp.launch(evaluate_closest_point, count, inputs, [weights, closest], device=device)
    expected = np.array([closest_point(p, t) for p, t in zip(points, triangles, strict=True)])
    distance = np.linalg.norm(points - closest.numpy(), axis=1)
    assert np.abs(distance - np.linalg.norm(points - expected, axis=1)).max() < FLOAT32
    assert weights.numpy().min() >= 0.0
    assert np.abs(weights.numpy().sum(1) - 1.0).max() < FLOAT32


def searching(points, body, body_faces, device, outward=None, limbs=None, **settings):
    """A simulation whose garment vertices are these points."""
    rest, faces = sheet(len(points) // 2 - 1, 1, 1.0, 0.1)
    assert len(rest) == len(points)
    settings = ContactSettings(self_thickness=0.0, **settings)
    model = build_cloth_model(rest, faces, Fabric())
    simulation = ClothSimulation(model, body_faces, body, contact_settings=settings, limbs=limbs, device=device)
    simulation.start(points)
    if outward is not None:
        simulation.set_outward(outward)
    return simulation


def found(simulation, points=None):
    """Faces, points and normals of the planes that a remembering search finds, each [vertex_count, PLANES, ...]."""
    if points is not None:
        simulation._positions.assign(points[None])
    simulation._contact.find(simulation._positions, simulation._moving, simulation._moving)
    frozen = simulation._contact.frozen
    shape = (simulation.model.vertex_count, contact_planes.PLANES)
    return (
        frozen.face.numpy().reshape(shape),
        frozen.point.numpy().reshape(*shape, 3),
        frozen.normal.numpy().reshape(*shape, 3),
    )


def touching(points, body, body_faces, device, outward=None, **settings):
    """The planes of these points."""
    return found(searching(points, body, body_faces, device, outward, **settings))


def vertex_normals(points, faces):
    """Unit vertex normals weighted by area, in float64."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normals = np.zeros_like(points)
    np.add.at(normals, faces.ravel(), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_the_plane_lies_where_the_interpolated_normal_points_at_the_vertex(device):
    rng = np.random.default_rng(2)
    body, faces = sphere(0.1, 2)
    direction = rng.normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # The sphere's polyhedron lies up to 1.3 mm inside it.
    points = np.where(rng.random((60, 1)) < 0.5, rng.uniform(0.102, 0.15, (60, 1)), rng.uniform(0.07, 0.096, (60, 1)))
    points = points * direction
    radius_of_search = 0.03
    simulation = searching(points, body, faces, device, radius=radius_of_search)
    face, point, normal = found(simulation)
    expected = np.array(
        [min((closest_point(p, t) for t in body[faces]), key=lambda q: np.linalg.norm(p - q)) for p in points]
    )
    distance = np.linalg.norm(points - expected, axis=1)
    near = distance < radius_of_search
    assert np.array_equal(face[:, 0] >= 0, near)
    assert near.any() and not near.all()
    weights = simulation._contact._planes.weights.numpy().reshape(60, -1, 3)[:, 0]
    foot = np.einsum("vk,vkc->vc", weights, body[faces[face[:, 0]]])[near]
    across = np.einsum("vk,vkc->vc", weights, vertex_normals(body, faces)[faces[face[:, 0]]])[near]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    assert np.abs(point[near, 0] - foot).max() < FLOAT32
    assert np.abs(normal[near, 0] - across).max() < 1e-5  # Weights of float32 over edges of 3 cm.
    assert np.linalg.norm(np.cross(points[near] - foot, across), axis=1).max() < FLOAT32
    gap = ((points - point[:, 0]) * normal[:, 0]).sum(1)[near]
    assert np.array_equal(gap > 0.0, np.linalg.norm(points[near], axis=1) > 0.1)
    # No point is nearer than the closest; on so round a body the foot is hardly farther.
    assert (np.abs(gap) > distance[near] - FLOAT32).all() and (np.abs(gap) < 1.03 * distance[near]).all()


def test_the_plane_turns_steadily_across_a_hollow(device):
    """Within a pipe of 12 sides the closest point jumps by 30 degrees wherever the next side comes nearer."""
    body, faces = tube(3, 12, 0.1, 0.05)
    step = 0.5
    angle = np.radians(np.arange(0.0, 90.0, step))
    points = np.stack([np.full(len(angle), 0.02), 0.04 * np.cos(angle), 0.04 * np.sin(angle)], 1)
    face, _point, normal = touching(points, body, faces[:, ::-1], device)
    assert (face[:, 0] >= 0).all()
    turn = np.degrees(np.arccos(np.clip((normal[1:, 0] * normal[:-1, 0]).sum(1), -1.0, 1.0)))
    assert turn.max() < 4.0 * step
    assert np.degrees(np.arccos(normal[0, 0] @ normal[-1, 0])) > 80.0


def test_the_normals_of_a_hollow_turn_against_the_vertex(device):
    body, faces = tube(40, 96, 0.1, 0.03)
    angle = np.linspace(0.1, 2.0, 8)
    around = np.stack([np.zeros(8), -np.sin(angle), np.cos(angle)], 1)
    for height, hollow in ((0.01, True), (-0.01, False)):
        points = (0.03 - height) * np.stack([np.zeros(8), np.cos(angle), np.sin(angle)], 1) + [0.004, 0.0, 0.0]
        simulation = searching(points, body, faces[:, ::-1] if hollow else faces, device)
        found(simulation)
        bend = simulation._contact.frozen.hollow.numpy().reshape(8, -1, 3)[:, 0]
        rate = (bend**2).sum(1)
        if hollow:
            # On the way round at 20 mm from the axis the normal makes a whole turn; 96 sides are nearly a circle.
            assert np.allclose(rate, 1.0 / 0.02, rtol=0.02)
            assert (np.abs((bend * around).sum(1)) > 0.999 * np.sqrt(rate)).all()
        else:
            # Rounding alone turns the normals of a straight pipe along its axis.
            assert rate.max() < 0.1


def facing_boards(lower, upper):
    """Two boards at these heights [m] that face each other, limbs 0 and 1."""
    board, faces = sheet(4, 4, 0.2, 0.2)
    body = np.concatenate([raised(board, lower), raised(board, upper)])
    body_faces = np.concatenate([faces, faces[:, ::-1] + len(board)])
    return body, body_faces, np.repeat([0, 1], len(faces)).astype(np.int32)


def test_skin_in_the_way_holds_a_vertex_that_is_worn_elsewhere(device):
    """As the trunk does a sleeve that has got 5 mm into it."""
    body, faces, of_triangles = facing_boards(0.0, 0.02)
    points, up = np.tile([[0.11, 0.07, 0.025]], (4, 1)), np.tile([0.0, 0.0, 1.0], (4, 1))
    limbs = Limbs(of_triangles, np.ones(4, np.int32))
    face, point, normal = found(searching(points, body, faces, device, up, limbs))
    assert (of_triangles[face] == [0, 1]).all()
    assert np.allclose(((points[:, None] - point) * normal).sum(2), [0.025, -0.005], atol=FLOAT32)


def test_skin_that_lies_inside_another_limb_leaves_its_vertex_free_of_that(device):
    """Where limbs cut into each other no place is free of both; the vertex stays with its own."""
    body, faces, of_triangles = facing_boards(0.02, 0.0)
    points, up = np.tile([[0.11, 0.07, 0.022]], (4, 1)), np.tile([0.0, 0.0, 1.0], (4, 1))
    face, _point, normal = found(searching(points, body, faces, device, up, Limbs(of_triangles, np.ones(4, np.int32))))
    assert (of_triangles[face[:, 0]] == 0).all() and (face[:, 1] == -1).all()
    assert np.allclose(normal[:, 0], up, atol=1e-6)


def test_a_vertex_at_the_edge_of_where_limbs_meet_gets_out_of_the_limb_across(device):
    """Two boards that cut into each other left of x = 0.1 and part to the right of it, like the crook of an elbow.

    The vertex's own skin lies in the other limb, so that the way from there meets nothing; the closest skin is free.
    """
    body, faces, of_triangles = facing_boards(0.0, 0.0)
    angle = 0.6
    across = body[len(body) // 2 :]
    across[:, 2] += np.tan(angle) * (across[:, 0] - 0.1)
    along, out = np.array([np.cos(angle), 0.0, np.sin(angle)]), np.array([np.sin(angle), 0.0, -np.cos(angle)])
    points, up = np.tile([0.1, 0.07, 0.0] + 0.002 * along - 0.005 * out, (4, 1)), np.tile([0.0, 0.0, 1.0], (4, 1))
    assert points[0, 0] < 0.1
    limbs = Limbs(of_triangles, np.ones(4, np.int32))
    face, point, normal = found(searching(points, body, faces, device, up, limbs))
    assert (of_triangles[face] == [0, 1]).all()
    # Normals are kept in float32 until they are made unit vectors.
    assert np.allclose(normal[:, 1], out, atol=1e-6)
    assert np.allclose(((points - point[:, 1]) * normal[:, 1]).sum(1), -0.005, atol=FLOAT32)


def test_the_far_side_of_a_limb_draws_nothing_through_it(device):
    """As an arm that swept into cloth which hangs beside the trunk."""
    board, board_faces = sheet(4, 4, 0.2, 0.2)
    body = np.concatenate([board, raised(board, 0.01)])
    faces = np.concatenate([board_faces, board_faces + len(board)])
    of_triangles = np.repeat([0, 1], len(board_faces)).astype(np.int32)
    points, up = np.tile([[0.11, 0.07, 0.006]], (4, 1)), np.tile([0.0, 0.0, 1.0], (4, 1))
    face, _point, _normal = found(searching(points, body, faces, device, up, Limbs(of_triangles, np.ones(4, np.int32))))
    assert (of_triangles[face[:, 0]] == 0).all() and (face[:, 1] == -1).all()


def test_worn_skin_far_above_nearer_skin_is_the_other_side_of_a_limb(device):
    body, faces, of_triangles = facing_boards(0.03, -0.001)
    points, up = np.tile([[0.11, 0.07, 0.0]], (4, 1)), np.tile([0.0, 0.0, 1.0], (4, 1))
    limbs = Limbs(of_triangles, np.ones(4, np.int32))
    assert (found(searching(points, body, faces, device, up, limbs))[0] == -1).all()


def test_both_walls_of_a_corner_hold_once_both_were_touched(device):
    """Two boards that cut through each other: the closest of them changes from one linearisation to the next."""
    board, faces = sheet(8, 8, 0.2, 0.2)
    floor = board - [0.02, 0.0, 0.0]
    wall = board[:, [2, 1, 0]] - [0.0, 0.0, 0.02]  # Faces along x, which its swapped axes turn round.
    body, body_faces = np.concatenate([floor, wall]), np.concatenate([faces, faces[:, ::-1] + len(board)])
    low, near = np.tile([[0.002, 0.11, 0.001]], (4, 1)), np.tile([[0.001, 0.11, 0.002]], (4, 1))
    simulation = searching(low, body, body_faces, device)
    face, _point, normal = found(simulation)
    assert (face[:, 1] == -1).all() and np.allclose(normal[:, 0], [0.0, 0.0, 1.0], atol=1e-6)
    face, _point, normal = found(simulation, near)
    assert (face >= 0).all()
    assert np.allclose(normal[:, 0], [1.0, 0.0, 0.0], atol=1e-6)
    assert np.allclose(normal[:, 1], [0.0, 0.0, 1.0], atol=1e-6)
    face, _point, normal = found(simulation, low)
    assert (face >= 0).all() and np.allclose(normal[:, 1], [1.0, 0.0, 0.0], atol=1e-6)
    simulation.move_body(body)
    assert (found(simulation)[0][:, 1] == -1).all()


def shares(simulation, points, patience):
    """The share of its full pressure that each wall of the first vertex gives, by the axis along which it faces."""
    simulation._positions.assign(points[None])
    patience = wp.array([patience], dtype=wp.int32, device=simulation.device)
    simulation._contact.find(simulation._positions, simulation._moving, simulation._moving, patience)
    frozen = simulation._contact.frozen
    axes = np.abs(frozen.normal.numpy()[0, : contact_planes.PLANES]).argmax(1)
    given = frozen.share.numpy()[0, : contact_planes.PLANES]
    touched = frozen.face.numpy()[0, : contact_planes.PLANES] >= 0
    return {int(axis): float(share) for axis, share in zip(axes[touched], given[touched], strict=True)}


def corner_of_walls():
    """Three walls that cut through each other in the origin, one more than a vertex has planes, and places before each
    of them, by the axis along which it faces."""
    board, faces = sheet(8, 8, 0.2, 0.2)
    board = board - [0.02, 0.02, 0.0]
    body = np.concatenate([board[:, np.roll([0, 1, 2], turn)] for turn in (2, 1, 0)])
    places = [np.tile([np.roll([0.001, 0.002, 0.0025], axis)], (4, 1)) for axis in range(3)]
    return body, np.concatenate([faces + k * len(board) for k in range(3)]), places


def test_a_wall_that_comes_upon_a_vertex_out_of_nothing_gives_way_once_patience_is_over(device):
    """Of three walls two are seen at a time; the third comes back with all its pressure, as far as is borne."""
    body, faces, places = corner_of_walls()
    simulation = searching(places[0], body, faces, device)
    assert shares(simulation, places[0], 1) == {0: 1.0}
    # The closest wall presses from nowhere; the one that was touched before is kept.
    assert shares(simulation, places[1], 1) == {1: 1.0, 0: 1.0}
    given = shares(simulation, places[2], 1)
    assert np.isclose(given[2], 0.1) and given[1] == 1.0
    given = shares(simulation, places[0], 1)
    assert np.isclose(given[0], 0.01) and np.isclose(given[2], 0.1)
    # What is kept touching keeps its share; where the body has moved, all is well again.
    assert shares(simulation, places[0], 1) == given
    simulation.move_body(body)
    assert shares(simulation, places[0], 0) == {0: 1.0}


def test_a_wall_that_a_vertex_comes_to_gives_all_of_its_pressure_however_often(device):
    body, faces, _places = corner_of_walls()
    away = np.tile([0.005, 0.05, 0.05], (4, 1))
    near = np.tile([0.001, 0.05, 0.05], (4, 1))
    simulation = searching(away, body, faces, device)
    for _ in range(3):
        shares(simulation, away, 0)
        assert shares(simulation, near, 0) == {0: 1.0}


def test_a_surface_that_faces_away_from_the_vertex_is_passed_over(device):
    # Two boards, facing down above the point and facing up below it; the nearer one belongs to another limb.
    board, faces = sheet(4, 4, 0.2, 0.2)
    upper, lower = raised(board, 0.01), board - [0.0, 0.0, 0.02]
    body = np.concatenate([upper, lower])
    body_faces = np.concatenate([faces[:, ::-1], faces + len(board)])
    points = np.tile([[0.11, 0.07, 0.0]], (4, 1))
    _face, _point, normal = touching(points, body, body_faces, device, np.tile([0.0, 0.0, 1.0], (4, 1)))
    assert np.allclose(normal[:, 0], [0.0, 0.0, 1.0], atol=1e-6)
    _face, _point, normal = touching(points, body, body_faces, device, np.tile([0.0, 0.0, -1.0], (4, 1)))
    assert np.allclose(normal[:, 0], [0.0, 0.0, -1.0], atol=1e-6)


def test_a_vertex_in_a_fold_of_the_body_is_held_by_both_sides(device):
    # Two boards 4 mm apart that face each other, like the skin on both sides of a bent elbow.
    board, faces = sheet(4, 4, 0.2, 0.2)
    body = np.concatenate([raised(board, 0.002), board - [0.0, 0.0, 0.002]])
    body_faces = np.concatenate([faces[:, ::-1], faces + len(board)])
    points = np.array([[0.11, 0.07, z] for z in (0.0005, -0.0005, 0.0, 0.001)])
    face, point, normal = touching(points, body, body_faces, device)
    assert (face >= 0).all()
    gap = ((points[:, None] - point) * normal).sum(2)
    assert np.allclose(gap.sum(1), 0.004, atol=FLOAT32)
    assert np.allclose((normal[:, 0] * normal[:, 1]).sum(1), -1.0, atol=1e-6)


def test_a_convex_ridge_gives_one_plane(device):
    body, faces = sphere(0.02, 0)  # An icosahedron: its faces meet at 138 degrees, its edges are sharp.
    top = body[np.argmax(body[:, 2])]
    points = np.tile(1.05 * top, (4, 1))
    face, _point, _normal = touching(points, body, faces, device)
    assert (face[:, 0] >= 0).all() and (face[:, 1] == -1).all()


def box(half):
    """A closed box about the origin, its corners at +-half: vertices, triangles that face outwards."""
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)


def test_skin_that_a_vertex_outside_the_body_lies_behind_does_not_hold_it(device):
    """The closest skin that it may touch is the box's side, whose plane it lies 5 mm behind, above the box's top."""
    body, faces = box(0.05)
    above = np.array([[0.045, 0.0, 0.052], [0.045, 0.01, 0.052], [0.06, 0.0, 0.03], [0.06, 0.01, 0.03]])
    top = np.arange(len(faces)) // 2 == 5
    limbs = Limbs(top.astype(np.int32), np.ones(len(above), np.int32))
    outward = np.array([[1.0, 0.0, 0.0]] * len(above))
    face, _, normal = found(searching(above, body, faces, device, outward, limbs))
    assert (face[:2, 0] == -1).all()
    # The box's interpolated normals lean over its edges.
    assert (face[2:, 0] // 2 == 1).all() and (normal[2:, 0] @ [1.0, 0.0, 0.0] > 0.85).all()


def test_a_single_wall_holds_from_behind(device):
    """A wall encloses nothing, but what has sunk into it must come out again."""
    ground, faces = sheet(4, 4, 1.0, 1.0)
    points = np.array([[0.4, 0.5, -0.002], [0.5, 0.5, -0.008], [0.6, 0.5, -0.02], [0.5, 0.4, 0.002]])
    face, point, normal = touching(points, ground, faces, device)
    assert (face[:, 0] >= 0).all()
    assert np.abs(normal[:, 0] - [0.0, 0.0, 1.0]).max() < FLOAT32 and np.abs(point[:, 0, 2]).max() < FLOAT32
