"""Contact of the garment with itself: vertex against triangle (W28).

A pair is a frozen plane between a vertex and a point of a triangle, on the side where the vertex stands. Its
thickness is a length of its own, not a share of an edge. A vertex has a pair with every triangle within reach, so that
nothing jumps when the nearest one changes; neighbours in the rest shape are left out. Each pair pushes four vertices;
the three of the triangle collect their share through a list of incident pairs, in a fixed order, so that sums come out
the same to the bit.
"""

import warp as wp

from .contact import closest_point_on_triangle, triangle_point

wp.set_module_options({"enable_backward": False})

# Vertices closer than this many thicknesses in the rest shape never touch: a sheet that folds back on itself at the
# thickness runs through half a circle first, pi / 2 thicknesses long.
REST_THICKNESSES = 1.6
# Pairs are listed out to here, so that a step is held back by what it runs into.
REACH_THICKNESSES = 1.2


@wp.kernel
def to_single(positions: wp.array2d[wp.vec3d], single: wp.array2d[wp.vec3]):
    """Positions as float32, for the bounding volume tree."""
    world, vertex = wp.tid()
    single[world, vertex] = wp.vec3(positions[world, vertex])


@wp.func
def pair_weights(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    world: wp.int32,
    vertex: wp.int32,
    face: wp.int32,
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    rest_reach: wp.float32,
):
    """Barycentric coordinates of the triangle's closest point, and whether vertex and triangle make a pair.

    Where two limbs cut into each other, so must the cloth on them: a vertex that faces a triangle from behind, on
    limbs that face each other, is let through. Layers of one limb, such as folds, face the same way and always touch.
    """
    w = wp.vec3()
    if faces[face, 0] == vertex or faces[face, 1] == vertex or faces[face, 2] == vertex:
        return False, w
    p = points[world, vertex]
    w = closest_point_on_triangle(
        p, points[world, faces[face, 0]], points[world, faces[face, 1]], points[world, faces[face, 2]]
    )
    away = p - triangle_point(points, faces, world, face, w)
    distance = wp.length(away)
    # Closer than 0.1 micrometres there is no telling the sides apart.
    if distance >= reach or distance < 1.0e-7:
        return False, w
    facing = triangle_point(outward, faces, world, face, w)
    if wp.dot(outward[world, vertex], facing) < 0.0 and wp.dot(away, facing) < 0.0:
        return False, w
    rest = rest_points[0, vertex]
    r = closest_point_on_triangle(
        rest, rest_points[0, faces[face, 0]], rest_points[0, faces[face, 1]], rest_points[0, faces[face, 2]]
    )
    return wp.length(rest - triangle_point(rest_points, faces, 0, face, r)) > rest_reach, w


@wp.kernel
def count_pairs(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    meshes: wp.array[wp.uint64],
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    rest_reach: wp.float32,
    # outputs
    pair_count: wp.array[wp.int32],
):
    """How many triangles are within ``reach`` [m] of each vertex; entry world * vertex_count + vertex."""
    world, vertex = wp.tid()
    p = points[world, vertex]
    box = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(meshes[world], p - box, p + box)
    candidate = wp.int32(0)
    found = wp.int32(0)
    while wp.mesh_query_aabb_next(query, candidate):
        near, _w = pair_weights(points, rest_points, faces, world, vertex, candidate, outward, reach, rest_reach)
        if near:
            found += 1
    pair_count[world * points.shape[1] + vertex] = found


@wp.kernel
def fill_pairs(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    meshes: wp.array[wp.uint64],
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    rest_reach: wp.float32,
    pair_start: wp.array[wp.int32],
    pair_count: wp.array[wp.int32],
    # outputs
    triangle: wp.array[wp.int32],
    weights: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
):
    """Write the pairs that :func:`count_pairs` counted, each vertex's in ascending order of their triangles."""
    world, vertex = wp.tid()
    owner = world * points.shape[1] + vertex
    if pair_count[owner] == 0:
        return
    start = pair_start[owner]
    p = points[world, vertex]
    box = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(meshes[world], p - box, p + box)
    candidate = wp.int32(0)
    end = start
    while wp.mesh_query_aabb_next(query, candidate):
        near, w = pair_weights(points, rest_points, faces, world, vertex, candidate, outward, reach, rest_reach)
        if near:
            place = end
            while place > start and triangle[place - 1] > candidate:
                triangle[place] = triangle[place - 1]
                weights[place] = weights[place - 1]
                place -= 1
            triangle[place] = candidate
            weights[place] = w
            end += 1
    for pair in range(start, end):
        normal[pair] = wp.normalize(p - triangle_point(points, faces, world, triangle[pair], weights[pair]))


@wp.kernel
def count_incident(
    faces: wp.array2d[wp.int32],
    vertex_count: wp.int32,
    pair_start: wp.array[wp.int32],
    pair_count: wp.array[wp.int32],
    triangle: wp.array[wp.int32],
    # outputs
    incident_count: wp.array[wp.int32],
):
    """How many pairs press on each vertex as a corner of their triangle; entry world * vertex_count + vertex."""
    owner = wp.tid()
    first = owner - owner % vertex_count
    for pair in range(pair_start[owner], pair_start[owner] + pair_count[owner]):
        for corner in range(3):
            wp.atomic_add(incident_count, first + faces[triangle[pair], corner], 1)


@wp.kernel
def fill_incident(
    faces: wp.array2d[wp.int32],
    vertex_count: wp.int32,
    pair_start: wp.array[wp.int32],
    pair_count: wp.array[wp.int32],
    triangle: wp.array[wp.int32],
    incident_start: wp.array[wp.int32],
    # outputs
    incident_count: wp.array[wp.int32],
    incident: wp.array[wp.int32],
):
    """Write the lists that :func:`count_incident` counted: entries pair * 3 + corner, in any order."""
    owner = wp.tid()
    first = owner - owner % vertex_count
    for pair in range(pair_start[owner], pair_start[owner] + pair_count[owner]):
        for corner in range(3):
            pressed = first + faces[triangle[pair], corner]
            place = incident_start[pressed] + wp.atomic_add(incident_count, pressed, 1)
            incident[place] = pair * 3 + corner


@wp.kernel
def sort_incident(incident_start: wp.array[wp.int32], incident_count: wp.array[wp.int32], incident: wp.array[wp.int32]):
    """Sort each vertex's list, so that sums over it have one order."""
    owner = wp.tid()
    start = incident_start[owner]
    for k in range(start + 1, start + incident_count[owner]):
        entry = incident[k]
        place = k
        while place > start and incident[place - 1] > entry:
            incident[place] = incident[place - 1]
            place -= 1
        incident[place] = entry


@wp.func
def pair_separation(
    positions: wp.array2d[wp.vec3d],
    faces: wp.array2d[wp.int32],
    world: wp.int32,
    vertex: wp.int32,
    face: wp.int32,
    w: wp.vec3,
) -> wp.vec3d:
    """Vector from the pair's point on the triangle to its vertex [m]."""
    return (
        positions[world, vertex]
        - wp.float64(w[0]) * positions[world, faces[face, 0]]
        - wp.float64(w[1]) * positions[world, faces[face, 1]]
        - wp.float64(w[2]) * positions[world, faces[face, 2]]
    )
