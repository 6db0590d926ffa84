"""Verlet lists of self-contact: what a vertex or an edge may come to touch while nothing moves far (Verlet 1967).

Each owner has a row of candidates, ascending: a vertex of triangles, an edge of later edges. Rows hold all that is
within reach and margin at the listed points. A vertex that gets half the margin away from its listed point takes that
point along, and only the rows around it are renewed: so what comes within reach is always among the candidates. One is
left out only if a plane keeps it farther off than reach and margin, which holds however roughly the closest points
were found.
"""

import warp as wp

from .body_surface import closest_point_on_triangle, triangle_point
from .self_contact import closest_points_of_edges, edge_point

wp.set_module_options({"enable_backward": False})

# Rows are given room for so many more candidates than twice those they have.
SPARE = wp.constant(4)


@wp.kernel
def move_points(
    positions: wp.array2d[wp.vec3d],
    limit: wp.float32,
    # outputs
    points: wp.array2d[wp.vec3],
    listed: wp.array2d[wp.vec3],
    moved: wp.array2d[wp.int32],
):
    """Positions as float32 [m]; those farther than ``limit`` [m] from their listed points move these, too."""
    world, vertex = wp.tid()
    point = wp.vec3(positions[world, vertex])
    points[world, vertex] = point
    moved[world, vertex] = 0
    # Also what was never listed: its listed point is not a number.
    if not (wp.length(point - listed[world, vertex]) <= limit):
        listed[world, vertex] = point
        moved[world, vertex] = 1


@wp.kernel
def edge_boxes(
    points: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    # outputs
    lower: wp.array2d[wp.vec3],
    upper: wp.array2d[wp.vec3],
):
    """Bounds of every edge [m], shape [world_count, edge_count]."""
    world, edge = wp.tid()
    p = points[world, edges[edge, 0]]
    q = points[world, edges[edge, 1]]
    lower[world, edge] = wp.min(p, q)
    upper[world, edge] = wp.max(p, q)


@wp.func
def vertex_may_touch(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    world: wp.int32,
    vertex: wp.int32,
    face: wp.int32,
    reach: wp.float32,
    rest_reach: wp.float32,
) -> wp.bool:
    """Whether a triangle may be within ``reach`` [m] of a vertex and is no neighbour in the rest shape."""
    a = faces[face, 0]
    b = faces[face, 1]
    c = faces[face, 2]
    if a == vertex or b == vertex or c == vertex:
        return False
    p = points[world, vertex]
    w = closest_point_on_triangle(p, points[world, a], points[world, b], points[world, c])
    across = wp.normalize(p - triangle_point(points, faces, world, face, w))
    gap = wp.min(wp.dot(across, p - points[world, a]), wp.dot(across, p - points[world, b]))
    if wp.min(gap, wp.dot(across, p - points[world, c])) > reach:
        return False
    rest = rest_points[0, vertex]
    r = closest_point_on_triangle(rest, rest_points[0, a], rest_points[0, b], rest_points[0, c])
    return wp.length(rest - triangle_point(rest_points, faces, 0, face, r)) > rest_reach


@wp.func
def edges_may_touch(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    world: wp.int32,
    edge: wp.int32,
    other: wp.int32,
    reach: wp.float32,
    rest_reach: wp.float32,
) -> wp.bool:
    """Whether two edges may be within ``reach`` [m] of each other and are no neighbours in the rest shape."""
    i = edges[edge, 0]
    j = edges[edge, 1]
    k = edges[other, 0]
    m = edges[other, 1]
    if i == k or i == m or j == k or j == m:
        return False
    p = points[world, i]
    q = points[world, j]
    a = points[world, k]
    b = points[world, m]
    where = closest_points_of_edges(p, q, a, b)
    across = wp.normalize((1.0 - where[0]) * p + where[0] * q - (1.0 - where[1]) * a - where[1] * b)
    gap = wp.min(wp.dot(across, p - a), wp.dot(across, p - b))
    if wp.min(gap, wp.min(wp.dot(across, q - a), wp.dot(across, q - b))) > reach:
        return False
    rest = closest_points_of_edges(rest_points[0, i], rest_points[0, j], rest_points[0, k], rest_points[0, m])
    apart = edge_point(rest_points, edges, 0, edge, rest[0]) - edge_point(rest_points, edges, 0, other, rest[1])
    return wp.length(apart) > rest_reach


@wp.kernel
def mark_vertices(
    listed: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    trees: wp.array[wp.uint64],
    reach: wp.float32,
    rest_reach: wp.float32,
    moved: wp.array2d[wp.int32],
    # outputs
    renewed: wp.array2d[wp.int32],
):
    """Mark the vertices that have moved, and those that a triangle that has moved may be near."""
    world, face = wp.tid()
    i = faces[face, 0]
    j = faces[face, 1]
    k = faces[face, 2]
    if moved[world, i] + moved[world, j] + moved[world, k] == 0:
        return
    a = listed[world, i]
    b = listed[world, j]
    c = listed[world, k]
    box = wp.vec3(reach, reach, reach)
    query = wp.bvh_query_aabb(trees[world], wp.min(wp.min(a, b), c) - box, wp.max(wp.max(a, b), c) + box)
    vertex = wp.int32(0)
    while wp.bvh_query_next(query, vertex):
        if moved[world, vertex] == 1:
            renewed[world, vertex] = 1
        elif vertex_may_touch(listed, rest_points, faces, world, vertex, face, reach, rest_reach):
            renewed[world, vertex] = 1


@wp.kernel
def mark_edges(
    listed: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    trees: wp.array[wp.uint64],
    reach: wp.float32,
    rest_reach: wp.float32,
    moved: wp.array2d[wp.int32],
    # outputs
    renewed: wp.array2d[wp.int32],
):
    """Mark the edges that have moved, and earlier ones that one of these may be near."""
    world, edge = wp.tid()
    i = edges[edge, 0]
    j = edges[edge, 1]
    if moved[world, i] + moved[world, j] == 0:
        return
    renewed[world, edge] = 1
    p = listed[world, i]
    q = listed[world, j]
    box = wp.vec3(reach, reach, reach)
    query = wp.bvh_query_aabb(trees[world], wp.min(p, q) - box, wp.max(p, q) + box)
    other = wp.int32(0)
    while wp.bvh_query_next(query, other):
        if other < edge and moved[world, edges[other, 0]] + moved[world, edges[other, 1]] == 0:
            # In the order in which the other's row will ask.
            if edges_may_touch(listed, rest_points, edges, world, other, edge, reach, rest_reach):
                renewed[world, other] = 1


@wp.func
def insert(row: wp.array[wp.int32], start: wp.int32, end: wp.int32, candidate: wp.int32):
    """Add a candidate to the ascending list from start to end."""
    place = end
    while place > start and row[place - 1] > candidate:
        row[place] = row[place - 1]
        place -= 1
    row[place] = candidate


@wp.kernel
def list_triangles(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    meshes: wp.array[wp.uint64],
    reach: wp.float32,
    rest_reach: wp.float32,
    renewed: wp.array2d[wp.int32],
    start: wp.array[wp.int32],
    # outputs
    count: wp.array[wp.int32],
    candidates: wp.array[wp.int32],
):
    """Triangles that may be within ``reach`` [m] of each vertex to renew; row world * vertex_count + vertex.

    What finds no room is counted all the same.
    """
    world, vertex = wp.tid()
    if renewed[world, vertex] == 0:
        return
    owner = world * points.shape[1] + vertex
    begin = start[owner]
    room = start[owner + 1] - begin
    p = points[world, vertex]
    box = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(meshes[world], p - box, p + box)
    face = wp.int32(0)
    found = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        if vertex_may_touch(points, rest_points, faces, world, vertex, face, reach, rest_reach):
            if found < room:
                insert(candidates, begin, begin + found, face)
            found += 1
    count[owner] = found


@wp.kernel
def list_edges(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    trees: wp.array[wp.uint64],
    reach: wp.float32,
    rest_reach: wp.float32,
    renewed: wp.array2d[wp.int32],
    start: wp.array[wp.int32],
    # outputs
    count: wp.array[wp.int32],
    candidates: wp.array[wp.int32],
):
    """Later edges that may be within ``reach`` [m] of each edge to renew; row world * edge_count + edge.

    What finds no room is counted all the same.
    """
    world, edge = wp.tid()
    if renewed[world, edge] == 0:
        return
    owner = world * edges.shape[0] + edge
    begin = start[owner]
    room = start[owner + 1] - begin
    p = points[world, edges[edge, 0]]
    q = points[world, edges[edge, 1]]
    box = wp.vec3(reach, reach, reach)
    query = wp.bvh_query_aabb(trees[world], wp.min(p, q) - box, wp.max(p, q) + box)
    other = wp.int32(0)
    found = wp.int32(0)
    while wp.bvh_query_next(query, other):
        if other > edge and edges_may_touch(points, rest_points, edges, world, edge, other, reach, rest_reach):
            if found < room:
                insert(candidates, begin, begin + found, other)
            found += 1
    count[owner] = found


@wp.kernel
def find_lacking(
    start: wp.array[wp.int32],
    count: wp.array[wp.int32],
    # outputs
    room: wp.array[wp.int32],
    renewed: wp.array[wp.int32],
    lacking: wp.array[wp.int32],
):
    """Mark the rows that have not enough room, and no others; and how much room to give each."""
    owner = wp.tid()
    has = start[owner + 1] - start[owner]
    room[owner] = wp.max(has, 2 * count[owner] + SPARE)
    renewed[owner] = 0
    if count[owner] > has:
        renewed[owner] = 1
        lacking[0] = 1


@wp.kernel
def move_rows(
    old_start: wp.array[wp.int32],
    old_candidates: wp.array[wp.int32],
    renewed: wp.array[wp.int32],
    start: wp.array[wp.int32],
    count: wp.array[wp.int32],
    # outputs
    candidates: wp.array[wp.int32],
):
    """Bring the rows that are not marked to their new place."""
    owner = wp.tid()
    if renewed[owner] == 0:
        for k in range(count[owner]):
            candidates[start[owner] + k] = old_candidates[old_start[owner] + k]
