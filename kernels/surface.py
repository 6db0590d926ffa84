"""Closest points on a triangle mesh, for binding one surface to another, and depth inside it."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def closest_surface_points(
    points: wp.array[wp.vec3],
    mesh: wp.uint64,
    # outputs
    face: wp.array[wp.int32],
    weights: wp.array[wp.vec3],
    distance: wp.array[wp.float32],
):
    """Closest triangle, barycentric coordinates and distance [m] for every point."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], 1.0e6)
    w = wp.vec3(query.u, query.v, 1.0 - query.u - query.v)
    face[i] = query.face
    weights[i] = w
    distance[i] = wp.length(points[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v))


@wp.kernel
def depth_in_body(
    points: wp.array[wp.vec3],
    mesh: wp.uint64,
    faces: wp.array2d[wp.int32],
    body: wp.array[wp.vec3],
    clear: wp.float32,
    # outputs
    depth: wp.array[wp.float32],
    covered: wp.array[wp.int32],
):
    """How deep each point lies inside a body [m], 0 outside, and whether the body covers its own skin there.

    Inside is where the winding number exceeds one half (Barill et al. 2018), which holds for surfaces with small
    holes and for bodies that cut into themselves. The skin is covered where ``clear`` [m] above the closest point is
    inside the body again.
    """
    i = wp.tid()
    p = points[i]
    query = wp.mesh_query_point_sign_winding_number(mesh, p, 1.0e6)
    a = body[faces[query.face, 0]]
    b = body[faces[query.face, 1]]
    c = body[faces[query.face, 2]]
    closest = query.u * a + query.v * b + (1.0 - query.u - query.v) * c
    depth[i] = wp.where(query.sign < 0.0, wp.length(p - closest), 0.0)
    above = closest + clear * wp.normalize(wp.cross(b - a, c - a))
    over = wp.mesh_query_point_sign_winding_number(mesh, above, 1.0e6)
    covered[i] = wp.where(over.sign < 0.0, 1, 0)
