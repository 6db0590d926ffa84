"""Where the edges of a mesh pass through its own triangles or those of another mesh, exactly but for rounding.

Everything is decided by signs of volumes in float64. A sign is taken with the vertices in the order of their numbers,
and zero counts as positive: so neighbouring triangles agree about an edge that passes through the side between them,
and it passes through one of the two, never through none or both.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

# Boxes are searched in float32; this much more [m] covers its rounding at lengths up to 10 m.
ROUNDING = wp.constant(wp.float32(1.0e-6))


@wp.func
def passes_left(p: wp.vec3d, q: wp.vec3d, points: wp.array[wp.vec3d], a: wp.int32, b: wp.int32) -> wp.bool:
    """Whether the line pq passes the edge ab on its left; of ab and ba, always one or the other."""
    low = wp.min(a, b)
    high = wp.max(a, b)
    left = wp.dot(q - p, wp.cross(points[low] - p, points[high] - p)) >= wp.float64(0.0)
    return left == (a == low)


@wp.func
def edge_cuts_triangle(
    p: wp.vec3d, q: wp.vec3d, points: wp.array[wp.vec3d], a: wp.int32, b: wp.int32, c: wp.int32
) -> wp.bool:
    """Whether the segment pq passes through the triangle abc."""
    zero = wp.float64(0.0)
    area = wp.cross(points[b] - points[a], points[c] - points[a])
    if (wp.dot(area, p - points[a]) >= zero) == (wp.dot(area, q - points[a]) >= zero):
        return False
    left = passes_left(p, q, points, a, b)
    return left == passes_left(p, q, points, b, c) and left == passes_left(p, q, points, c, a)


@wp.func
def cuts(
    i: wp.int32,
    j: wp.int32,
    points: wp.array[wp.vec3d],
    other_points: wp.array[wp.vec3d],
    other_faces: wp.array2d[wp.int32],
    face: wp.int32,
    same: wp.bool,
) -> wp.bool:
    """Whether edge ij passes through a triangle; with ``same``, both are one mesh and must not share a vertex."""
    a = other_faces[face, 0]
    b = other_faces[face, 1]
    c = other_faces[face, 2]
    if same and (a == i or b == i or c == i or a == j or b == j or c == j):
        return False
    return edge_cuts_triangle(points[i], points[j], other_points, a, b, c)


@wp.kernel
def count_crossings(
    points: wp.array[wp.vec3d],
    edges: wp.array2d[wp.int32],
    other_mesh: wp.uint64,
    other_points: wp.array[wp.vec3d],
    other_faces: wp.array2d[wp.int32],
    same: wp.bool,
    # outputs
    count: wp.array[wp.int32],
):
    """How many triangles of the other mesh each edge passes through."""
    edge = wp.tid()
    i = edges[edge, 0]
    j = edges[edge, 1]
    p = wp.vec3(points[i])
    q = wp.vec3(points[j])
    box = wp.vec3(ROUNDING, ROUNDING, ROUNDING)
    query = wp.mesh_query_aabb(other_mesh, wp.min(p, q) - box, wp.max(p, q) + box)
    face = wp.int32(0)
    found = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        if cuts(i, j, points, other_points, other_faces, face, same):
            found += 1
    count[edge] = found


@wp.kernel
def fill_crossings(
    points: wp.array[wp.vec3d],
    edges: wp.array2d[wp.int32],
    other_mesh: wp.uint64,
    other_points: wp.array[wp.vec3d],
    other_faces: wp.array2d[wp.int32],
    same: wp.bool,
    start: wp.array[wp.int32],
    count: wp.array[wp.int32],
    # outputs
    crossed: wp.array[wp.int32],
):
    """Write the triangles that :func:`count_crossings` counted, in any order."""
    edge = wp.tid()
    if count[edge] == 0:
        return
    i = edges[edge, 0]
    j = edges[edge, 1]
    p = wp.vec3(points[i])
    q = wp.vec3(points[j])
    box = wp.vec3(ROUNDING, ROUNDING, ROUNDING)
    query = wp.mesh_query_aabb(other_mesh, wp.min(p, q) - box, wp.max(p, q) + box)
    face = wp.int32(0)
    place = start[edge]
    while wp.mesh_query_aabb_next(query, face):
        if cuts(i, j, points, other_points, other_faces, face, same):
            crossed[place] = face
            place += 1
