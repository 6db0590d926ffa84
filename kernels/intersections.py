"""Which triangles of a mesh are cut by its own edges or by those of another mesh."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def edge_cuts_triangle(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.bool:
    """Whether the segment pq passes through triangle abc, by signs of volumes; touching does not count."""
    zero = wp.float64(0.0)
    u = wp.dot(wp.cross(b - a, c - a), p - a)
    v = wp.dot(wp.cross(b - a, c - a), q - a)
    if u * v >= zero:
        return False
    d = q - p
    ab = wp.dot(d, wp.cross(a - p, b - p))
    bc = wp.dot(d, wp.cross(b - p, c - p))
    ca = wp.dot(d, wp.cross(c - p, a - p))
    return (ab > zero and bc > zero and ca > zero) or (ab < zero and bc < zero and ca < zero)


@wp.kernel
def mark_cut_triangles(
    points: wp.array[wp.vec3],
    edges: wp.array2d[wp.int32],
    other_mesh: wp.uint64,
    other_points: wp.array[wp.vec3],
    other_faces: wp.array2d[wp.int32],
    same: wp.bool,
    # outputs
    cut: wp.array[wp.int32],
    cutting: wp.array[wp.int32],
):
    """Set cut[face] for every triangle of the other mesh that an edge passes through, and cutting[edge].

    With ``same``, both are one mesh, and triangles that share a vertex with the edge are left out.
    """
    edge = wp.tid()
    i = edges[edge, 0]
    j = edges[edge, 1]
    p = points[i]
    q = points[j]
    query = wp.mesh_query_aabb(other_mesh, wp.min(p, q), wp.max(p, q))
    face = wp.int32(0)
    while wp.mesh_query_aabb_next(query, face):
        a = other_faces[face, 0]
        b = other_faces[face, 1]
        c = other_faces[face, 2]
        shared = same and (a == i or b == i or c == i or a == j or b == j or c == j)
        if not shared:
            if edge_cuts_triangle(
                wp.vec3d(p),
                wp.vec3d(q),
                wp.vec3d(other_points[a]),
                wp.vec3d(other_points[b]),
                wp.vec3d(other_points[c]),
            ):
                cut[face] = 1
                cutting[edge] = 1
