"""The foot of a point on a posed surface: from a triangle not far away, over its neighbours, to the place below it.

Cheaper than a search of the whole surface, and a point keeps to its own side of a thin limb.
"""

import warp as wp

from .cloth.body_surface import closest_point_on_triangle, farthest_corner, normal_around, smooth_step
from .natural import natural

wp.set_module_options({"enable_backward": False})

# Triangles that a walk visits at most: downhill to the closest point, then along the smooth surface.
DOWNHILL_STEPS = wp.constant(48)
SMOOTH_STEPS = wp.constant(12)
# Cosines between the normal and the direction to the vertex at which a foot that is no smooth one stops and starts to
# count: sideways of a border there is nothing to be pushed out of.
ASKEW = wp.constant(wp.vec2(0.5, 0.9))
# A smooth foot lies at most this many times as far away as the closest point: in a narrow cleft it is the bottom.
STEEPEST = wp.constant(2.0)


vec_triangle = wp.types.vector(8, wp.int32)
"""A triangle of a posed surface: its corners, the triangles across the edges opposite them (-1 at a border), its limb,
and nothing; read at once."""
LIMB = wp.constant(6)


@wp.struct
class SkinVertex:
    """A vertex of a posed surface and its unit normal; they are read together."""

    position: wp.vec3
    normal: wp.vec3


@wp.struct
class PosedSurface:
    """The surface that a garment is kept outside of, in one pose.

    Few arrays: a function that is not inlined is given a copy of them with every call.

    Attributes:
        vertices: Where they are, shape [vertex_count].
        triangles: See :data:`vec_triangle`, shape [triangle_count].
    """

    vertices: wp.array[SkinVertex]
    triangles: wp.array[vec_triangle]


@wp.kernel
def pose_vertices(
    first: wp.int32,
    points: wp.array[wp.vec3],
    face_normals: wp.array[wp.vec3],
    around_start: wp.array[wp.int32],
    around: wp.array[wp.int32],
    # outputs
    vertices: wp.array[SkinVertex],
):
    """Vertices from ``first`` on with their normals."""
    v = natural(first + wp.tid())
    vertex = SkinVertex()
    vertex.position = points[v]
    vertex.normal = normal_around(face_normals, around_start, around, v)
    vertices[v] = vertex


@wp.func
def rise_between(x: wp.float32, low: wp.float32, high: wp.float32) -> wp.float32:
    """From 0 to 1 between two values, smoothly."""
    t = wp.clamp((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def point_at(vertices: wp.array[SkinVertex], triangle: vec_triangle, w: wp.vec3) -> wp.vec3:
    """Point at barycentric coordinates w of a triangle."""
    return (
        w[0] * vertices[natural(triangle[0])].position
        + w[1] * vertices[natural(triangle[1])].position
        + w[2] * vertices[natural(triangle[2])].position
    )


@wp.func
def normal_at(vertices: wp.array[SkinVertex], triangle: vec_triangle, w: wp.vec3) -> wp.vec3:
    """Normal, not of unit length, at barycentric coordinates w of a triangle."""
    return (
        w[0] * vertices[natural(triangle[0])].normal
        + w[1] * vertices[natural(triangle[1])].normal
        + w[2] * vertices[natural(triangle[2])].normal
    )


@wp.func
def closest_on_triangle(vertices: wp.array[SkinVertex], triangle: vec_triangle, p: wp.vec3):
    """Barycentric coordinates of a triangle's point that is closest to p, and its squared distance."""
    a = vertices[natural(triangle[0])].position
    b = vertices[natural(triangle[1])].position
    c = vertices[natural(triangle[2])].position
    w = closest_point_on_triangle(p, a, b, c)
    away = p - (w[0] * a + w[1] * b + w[2] * c)
    return w, wp.dot(away, away)


@wp.func
def height_over_corner(surface: PosedSurface, face: wp.int32, p: wp.vec3) -> wp.float32:
    """Height of p over the plane that touches the surface at a triangle's first corner."""
    corner = natural(surface.triangles[natural(face)][0])
    return wp.dot(p - surface.vertices[corner].position, surface.vertices[corner].normal)


@wp.func
def walk_downhill(surface: PosedSurface, p: wp.vec3, start: wp.int32, own: wp.int32):
    """From triangle to neighbouring triangle as long as they come closer to p: the last one, and the place on it.

    The walk ends where it comes to the limb ``own``; -1 for none.
    """
    face = start
    triangle = surface.triangles[natural(face)]
    w, squared = closest_on_triangle(surface.vertices, triangle, p)
    for _ in range(DOWNHILL_STEPS):
        best = wp.int32(-1)
        best_w = w
        best_triangle = triangle
        # Across every edge that the closest point lies on: one, or two at a corner.
        for corner in range(3):
            other = triangle[3 + corner]
            if w[corner] <= 0.0 and other >= 0:
                across = surface.triangles[natural(other)]
                v, d = closest_on_triangle(surface.vertices, across, p)
                if d < squared:
                    best = other
                    best_w = v
                    best_triangle = across
                    squared = d
        if best < 0:
            break
        face = best
        w = best_w
        triangle = best_triangle
        if triangle[LIMB] == own:
            break
    return face, w


@wp.func
def walk_smooth(surface: PosedSurface, p: wp.vec3, start: wp.int32, place: wp.vec3, tolerance: wp.float32):
    """Where the surface's interpolated normal points at p: triangle, height, unit normal; -1 if the walk finds no end.

    The walk of :func:`.cloth.body_surface.smooth_foot`, in single precision, in any unit, and as near as is needed
    here. Unlike the closest point it moves on steadily over hollows.
    """
    face = start
    triangle = surface.triangles[natural(face)]
    w = place
    found = wp.int32(-1)
    normal = normal_at(surface.vertices, triangle, w)
    height = wp.dot(p - point_at(surface.vertices, triangle, w), normal) / wp.dot(normal, normal)
    for _ in range(SMOOTH_STEPS):
        i = natural(triangle[0])
        j = natural(triangle[1])
        k = natural(triangle[2])
        w, normal, rise = smooth_step(
            surface.vertices[i].position - p,
            surface.vertices[j].position - p,
            surface.vertices[k].position - p,
            surface.vertices[i].normal,
            surface.vertices[j].normal,
            surface.vertices[k].normal,
            height,
        )
        height += rise
        if w[0] >= -1.0e-5 and w[1] >= -1.0e-5 and w[2] >= -1.0e-5:
            if wp.abs(rise) < tolerance:
                found = face
                break
        elif wp.abs(rise) < 10.0 * tolerance:
            # Across the edge; only once the height is about right.
            face = triangle[3 + farthest_corner(w)]
            if face < 0:
                break
            triangle = surface.triangles[natural(face)]
    size = wp.length(normal)
    return found, height * size, normal / size


@wp.func
def foot_near(surface: PosedSurface, p: wp.vec3, face: wp.int32, w: wp.vec3, tolerance: wp.float32):
    """Foot of p whose closest point is known: triangle, height over it, unit normal, and how far it is to be trusted.

    Where no smooth foot is found the closest point is taken, with full trust below and above it and none sideways.
    """
    trust = wp.float32(1.0)
    foot, height, normal = walk_smooth(surface, p, face, w, tolerance)
    away = p - point_at(surface.vertices, surface.triangles[natural(face)], w)
    farthest = STEEPEST * wp.length(away)
    height = wp.clamp(height, -farthest, farthest)
    if foot < 0:
        foot = face
        normal = wp.normalize(normal_at(surface.vertices, surface.triangles[natural(face)], w))
        height = wp.dot(away, normal)
        trust = rise_between(wp.abs(height), ASKEW[0] * wp.length(away), ASKEW[1] * wp.length(away))
    if not wp.isfinite(height) or not wp.isfinite(normal[0] + normal[1] + normal[2]):
        # Faces without area have no normal.
        normal = wp.vec3()
        height = wp.length(away)
        trust = 0.0
    return foot, height, normal, trust


@wp.func
def find_foot(surface: PosedSurface, p: wp.vec3, start: wp.int32, tolerance: wp.float32):
    """Foot of p, walking from a triangle; see :func:`foot_near`."""
    face, w = walk_downhill(surface, p, start, -1)
    foot, height, normal, trust = foot_near(surface, p, face, w, tolerance)
    return foot, height, normal, trust


@wp.func
def find_foot_within(
    surface: PosedSurface, p: wp.vec3, start: wp.int32, own: wp.int32, tolerance: wp.float32, enough: wp.float32
):
    """:func:`find_foot` where it may be closer than ``enough`` and not on the limb ``own`` (-1 for none).

    Else the place that the walk came to, whose normal is near enough, and no less than ``enough`` for the height.
    """
    foot, w = walk_downhill(surface, p, start, own)
    triangle = surface.triangles[natural(foot)]
    away = p - point_at(surface.vertices, triangle, w)
    outward = normal_at(surface.vertices, triangle, w)
    distance = wp.length(away)
    normal = outward / wp.length(outward)
    height = wp.dot(away, normal)
    trust = wp.float32(1.0)
    plain = distance > enough and height >= ASKEW[1] * distance
    if plain or triangle[LIMB] == own:
        height = wp.max(distance, enough)
    else:
        foot, height, normal, trust = foot_near(surface, p, foot, w, tolerance)
    return foot, height, normal, trust
