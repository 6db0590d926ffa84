"""Closest points on a triangle mesh, for binding one surface to another, and depth inside it."""

import warp as wp

from .cloth.body_surface import closest_point_on_triangle

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


@wp.func
def surface_point(points: wp.array[wp.vec3], faces: wp.array2d[wp.int32], face: wp.int32, w: wp.vec3) -> wp.vec3:
    """Point at barycentric coordinates w of a triangle."""
    return points[faces[face, 0]] * w[0] + points[faces[face, 1]] * w[1] + points[faces[face, 2]] * w[2]


@wp.func
def weights_on_triangle(points: wp.array[wp.vec3], faces: wp.array2d[wp.int32], face: wp.int32, p: wp.vec3) -> wp.vec3:
    """Barycentric coordinates of the point of a triangle that is closest to p."""
    return closest_point_on_triangle(p, points[faces[face, 0]], points[faces[face, 1]], points[faces[face, 2]])


@wp.func
def faces_along(points: wp.array[wp.vec3], faces: wp.array2d[wp.int32], face: wp.int32, direction: wp.vec3) -> wp.bool:
    """Whether a triangle's front looks towards a direction, not away from it."""
    a = points[faces[face, 0]]
    return wp.dot(wp.cross(points[faces[face, 1]] - a, points[faces[face, 2]] - a), direction) > 0.0


@wp.kernel
def closest_facing_points(
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    mesh: wp.uint64,
    surface: wp.array[wp.vec3],
    faces: wp.array2d[wp.int32],
    reach: wp.float32,
    # outputs
    face: wp.array[wp.int32],
    weights: wp.array[wp.vec3],
):
    """Closest triangle and barycentric coordinates on it, of one that faces along the point's normal.

    If the very closest faces away, another may be up to ``reach`` [m] farther; if there is none, the closest counts.
    """
    i = wp.tid()
    p = points[i]
    query = wp.mesh_query_point_no_sign(mesh, p, 1.0e6)
    found = query.face
    w = weights_on_triangle(surface, faces, found, p)
    if not faces_along(surface, faces, found, normals[i]):
        best = wp.length(p - surface_point(surface, faces, found, w)) + reach
        box = wp.vec3(best, best, best)
        near = wp.mesh_query_aabb(mesh, p - box, p + box)
        candidate = wp.int32(0)
        while wp.mesh_query_aabb_next(near, candidate):
            if faces_along(surface, faces, candidate, normals[i]):
                other = weights_on_triangle(surface, faces, candidate, p)
                distance = wp.length(p - surface_point(surface, faces, candidate, other))
                # Of two at the same distance the first one listed, in whatever order they are met.
                if distance < best or (distance == best and candidate < found):
                    best = distance
                    found = candidate
                    w = other
    face[i] = found
    weights[i] = w


@wp.kernel
def closest_listed_points(
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    surface: wp.array[wp.vec3],
    faces: wp.array2d[wp.int32],
    start: wp.array[wp.int32],
    candidates: wp.array[wp.int32],
    # outputs
    face: wp.array[wp.int32],
    weights: wp.array[wp.vec3],
):
    """The same among candidates [start[i], start[i + 1]) alone: those that face along the normal first."""
    i = wp.tid()
    best = wp.float32(1.0e30)
    best_faces = wp.bool(False)
    for k in range(start[i], start[i + 1]):
        candidate = candidates[k]
        w = weights_on_triangle(surface, faces, candidate, points[i])
        distance = wp.length(points[i] - surface_point(surface, faces, candidate, w))
        along = faces_along(surface, faces, candidate, normals[i])
        if (along and not best_faces) or (along == best_faces and distance < best):
            best = distance
            best_faces = along
            face[i] = candidate
            weights[i] = w


@wp.kernel
def depth_in_body(
    points: wp.array[wp.vec3],
    mesh: wp.uint64,
    faces: wp.array2d[wp.int32],
    body: wp.array[wp.vec3],
    clear: wp.float32,
    everywhere: wp.bool,
    # outputs
    depth: wp.array[wp.float32],
    covered: wp.array[wp.int32],
):
    """How deep each point lies inside a body [m], 0 outside, and whether the body covers its own skin there.

    The latter is looked for inside alone, or ``everywhere``. Inside is where the winding number exceeds one half
    (Barill et al. 2018), which holds for surfaces with small holes and for bodies that cut into themselves. The skin is
    covered where ``clear`` [m] above the closest point is inside the body again.
    """
    i = wp.tid()
    p = points[i]
    query = wp.mesh_query_point_sign_winding_number(mesh, p, 1.0e6)
    a = body[faces[query.face, 0]]
    b = body[faces[query.face, 1]]
    c = body[faces[query.face, 2]]
    closest = query.u * a + query.v * b + (1.0 - query.u - query.v) * c
    depth[i] = wp.where(query.sign < 0.0, wp.length(p - closest), 0.0)
    covered[i] = 0
    if not everywhere and query.sign >= 0.0:
        return
    above = closest + clear * wp.normalize(wp.cross(b - a, c - a))
    over = wp.mesh_query_point_sign_winding_number(mesh, above, 1.0e6)
    covered[i] = wp.where(over.sign < 0.0, 1, 0)
