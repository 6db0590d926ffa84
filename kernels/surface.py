"""Closest points on a triangle mesh, for binding one surface to another."""

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
