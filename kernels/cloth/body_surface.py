"""Geometry of a triangle surface: closest points, normals, and the smooth surface that its vertex normals describe."""

import warp as wp

from ..natural import natural

wp.set_module_options({"enable_backward": False})


@wp.struct
class BodySurface:
    """The posed body of every world.

    Attributes:
        meshes: Its bounding volume trees, one a world.
        points, normals: Vertices [m] and unit vertex normals, [world_count, vertex_count].
        faces: Triangles, shape [triangle_count, 3].
        beside: The triangle across the edge from each corner, -1 at a border.
        limb: Limb of each triangle.
    """

    meshes: wp.array[wp.uint64]
    points: wp.array2d[wp.vec3]
    normals: wp.array2d[wp.vec3]
    faces: wp.array2d[wp.int32]
    beside: wp.array2d[wp.int32]
    limb: wp.array[wp.int32]


@wp.func
def closest_point_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Barycentric coordinates of the point of triangle abc closest to p (Ericson 2005, section 5.1.5)."""
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    bp = p - b
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return wp.vec3(1.0 - v, v, 0.0)
    cp = p - c
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return wp.vec3(1.0 - w, 0.0, w)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - w, w)
    total = va + vb + vc
    return wp.vec3(va / total, vb / total, vc / total)


@wp.func
def corner_of(faces: wp.array2d[wp.int32], face: wp.int32, k: wp.int32) -> wp.int32:
    """The vertex at corner k of a triangle, which must be there: a face of -1 is far past the array's end."""
    return natural(faces[natural(face), k])


@wp.func
def triangle_point(
    points: wp.array2d[wp.vec3], faces: wp.array2d[wp.int32], world: wp.int32, face: wp.int32, w: wp.vec3
) -> wp.vec3:
    """Point at barycentric coordinates w of a triangle."""
    return (
        points[world, corner_of(faces, face, 0)] * w[0]
        + points[world, corner_of(faces, face, 1)] * w[1]
        + points[world, corner_of(faces, face, 2)] * w[2]
    )


@wp.func
def closest_point_of_face(
    points: wp.array2d[wp.vec3], faces: wp.array2d[wp.int32], world: wp.int32, face: wp.int32, p: wp.vec3
):
    """Coordinates of the closest point of a triangle to p, and how far away it is [m]."""
    a = points[world, corner_of(faces, face, 0)]
    b = points[world, corner_of(faces, face, 1)]
    c = points[world, corner_of(faces, face, 2)]
    w = closest_point_on_triangle(p, a, b, c)
    return w, wp.length(p - triangle_point(points, faces, world, face, w))


@wp.kernel
def carry_points(
    positions: wp.array[wp.vec3],
    corners: wp.array[wp.vec3i],
    weights: wp.array[wp.vec3],
    # outputs
    carried: wp.array[wp.vec3],
):
    """Points on triangles of a surface where it is now [m], by corners and their weights."""
    point = wp.tid()
    c = corners[point]
    w = weights[point]
    carried[point] = w[0] * positions[c[0]] + w[1] * positions[c[1]] + w[2] * positions[c[2]]


@wp.func
def face_direction(
    points: wp.array2d[wp.vec3], faces: wp.array2d[wp.int32], world: wp.int32, face: wp.int32
) -> wp.vec3:
    """Unit normal of a triangle."""
    a = points[world, corner_of(faces, face, 0)]
    return wp.normalize(
        wp.cross(points[world, corner_of(faces, face, 1)] - a, points[world, corner_of(faces, face, 2)] - a)
    )


@wp.kernel
def face_normals(
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    # outputs
    normals: wp.array2d[wp.vec3],
):
    """Normals of the triangles, each as long as twice its area."""
    world, face = wp.tid()
    a = points[world, corner_of(faces, face, 0)]
    normals[world, face] = wp.cross(
        points[world, corner_of(faces, face, 1)] - a, points[world, corner_of(faces, face, 2)] - a
    )


@wp.func
def normal_around(
    face_normals: wp.array[wp.vec3], around_start: wp.array[wp.int32], around: wp.array[wp.int32], vertex: wp.int32
) -> wp.vec3:
    """Area-weighted unit normal of a vertex; ``around`` lists the faces around each one."""
    total = wp.vec3()
    for k in range(around_start[vertex], around_start[vertex + 1]):
        total += face_normals[natural(around[natural(k)])]
    return wp.normalize(total)


@wp.kernel
def vertex_normals(
    face_normals: wp.array2d[wp.vec3],
    around_start: wp.array[wp.int32],
    around: wp.array[wp.int32],
    # outputs
    normals: wp.array2d[wp.vec3],
):
    """Normals of the vertices; see :func:`normal_around`."""
    world, vertex = wp.tid()
    normals[world, vertex] = normal_around(face_normals[world], around_start, around, vertex)


@wp.func
def plane_weights(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Barycentric coordinates, possibly outside [0, 1], of the projection of p onto the plane of triangle abc."""
    u = b - a
    v = c - a
    w = p - a
    uu = wp.dot(u, u)
    uv = wp.dot(u, v)
    vv = wp.dot(v, v)
    wu = wp.dot(w, u)
    wv = wp.dot(w, v)
    determinant = uu * vv - uv * uv
    if determinant <= 1.0e-20:
        return wp.vec3(1.0, 0.0, 0.0)
    s = (vv * wu - uv * wv) / determinant
    t = (uu * wv - uv * wu) / determinant
    return wp.vec3(1.0 - s - t, s, t)


@wp.func
def smooth_step(
    a: wp.vec3, b: wp.vec3, c: wp.vec3, na: wp.vec3, nb: wp.vec3, nc: wp.vec3, height: wp.float32
) -> tuple[wp.vec3, wp.vec3, wp.float32]:
    """A step of Phong projection onto a triangle abc with vertex normals, all as seen from the point.

    The triangle is raised along its normals by ``height`` to where the point should be. Returns the point's barycentric
    coordinates there, possibly outside [0, 1], the interpolated normal, and by how much the height is to change.
    """
    ra = a + height * na
    rb = b + height * nb
    rc = c + height * nc
    w = plane_weights(wp.vec3(), ra, rb, rc)
    normal = w[0] * na + w[1] * nb + w[2] * nc
    facing = wp.cross(rb - ra, rc - ra)
    return w, normal, -wp.dot(ra, facing) / wp.dot(normal, facing)


@wp.func
def farthest_corner(w: wp.vec3) -> wp.int32:
    """Corner opposite to the edge that a point with these barycentric coordinates lies farthest beyond."""
    least = wp.min(w)
    return wp.where(w[0] == least, 0, wp.where(w[1] == least, 1, 2))


# Triangles that the walk of smooth_foot visits at most, and where it is close enough [m].
FOOT_STEPS = wp.constant(16)
FOOT_TOLERANCE = wp.constant(1.0e-7)


@wp.func
def smooth_foot(body: BodySurface, world: wp.int32, p: wp.vec3d, start: wp.int32, w: wp.vec3):
    """Where the surface's interpolated normal points at p: triangle, barycentric coordinates, height [m], normal.

    Phong projection (Panozzo et al. 2013, Weighted averages on surfaces, section 3.2). The closest point jumps from one
    triangle to the next wherever they form a hollow, and its direction with it; this one moves on steadily. The walk
    begins at triangle ``start`` and coordinates w, the closest point; the triangle is -1 where it finds no end, as
    beyond a border or where the normals cross.
    """
    face = start
    found = wp.int32(-1)
    height = wp.float32(0.0)
    normal = wp.vec3()
    for step in range(FOOT_STEPS):
        # As seen from p, which keeps the full precision of its position.
        a = wp.vec3(wp.vec3d(body.points[world, corner_of(body.faces, face, 0)]) - p)
        b = wp.vec3(wp.vec3d(body.points[world, corner_of(body.faces, face, 1)]) - p)
        c = wp.vec3(wp.vec3d(body.points[world, corner_of(body.faces, face, 2)]) - p)
        na = body.normals[world, corner_of(body.faces, face, 0)]
        nb = body.normals[world, corner_of(body.faces, face, 1)]
        nc = body.normals[world, corner_of(body.faces, face, 2)]
        if step == 0:
            normal = w[0] * na + w[1] * nb + w[2] * nc
            height = -wp.dot(w[0] * a + w[1] * b + w[2] * c, normal) / wp.dot(normal, normal)
        w, normal, rise = smooth_step(a, b, c, na, nb, nc, height)
        height += rise
        if wp.min(w) >= -1.0e-6:
            if wp.abs(rise) < FOOT_TOLERANCE:
                found = face
                break
        elif wp.abs(rise) < 1.0e-4:
            # Across the edge; only once the height is about right.
            face = body.beside[natural(face), farthest_corner(w)]
            if face < 0:
                break
    return found, w, height, normal


@wp.func
def hollow_bend(body: BodySurface, world: wp.int32, face: wp.int32, height: wp.float32, normal: wp.vec3) -> wp.vec3:
    """How the normal of :func:`smooth_foot` turns against a vertex that moves along a hollow surface.

    A vector c along the direction of the strongest turn, |c|^2 [1/m] its rate; a force f along the normal then resists
    such motion with the stiffness f c c^T [N/m]. Zero where the surface is flat or bulges.
    """
    na = body.normals[world, corner_of(body.faces, face, 0)]
    nb = body.normals[world, corner_of(body.faces, face, 1)] - na
    nc = body.normals[world, corner_of(body.faces, face, 2)] - na
    a = body.points[world, corner_of(body.faces, face, 0)]
    b = body.points[world, corner_of(body.faces, face, 1)] - a + height * nb
    c = body.points[world, corner_of(body.faces, face, 2)] - a + height * nc
    e1 = wp.normalize(b)
    e2 = wp.normalize(wp.cross(wp.cross(b, c), e1))
    along = wp.dot(b, e1)
    askew = wp.dot(c, e1)
    across = wp.dot(c, e2)
    if along < 1.0e-6 or across < 1.0e-6:
        return wp.vec3()
    # Rates of the normal along e1 and e2, as (e1, e2) components.
    r11 = wp.dot(nb, e1) / along
    r21 = wp.dot(nb, e2) / along
    r12 = (wp.dot(nc, e1) - r11 * askew) / across
    r22 = (wp.dot(nc, e2) - r21 * askew) / across
    mean = 0.5 * (r11 + r22)
    half = 0.5 * (r11 - r22)
    skew = 0.5 * (r12 + r21)
    rate = (mean - wp.sqrt(half * half + skew * skew)) / wp.length(normal)
    if rate >= 0.0:
        return wp.vec3()
    # The direction of the smaller eigenvalue, a right angle from that of the larger.
    angle = 0.5 * wp.atan2(skew, half)
    return wp.sqrt(-rate) * (wp.cos(angle) * e2 - wp.sin(angle) * e1)
