"""The foot of a point on a posed surface: from a triangle not far away, over its neighbours, to the place below it.

Cheaper than a search of the whole surface, and a point keeps to its own side of a thin limb.
"""

import warp as wp

from .cloth.body_surface import closest_point_on_triangle, farthest_corner, smooth_step

wp.set_module_options({"enable_backward": False})

# Triangles that a walk visits at most: downhill to the closest point, then along the smooth surface.
DOWNHILL_STEPS = wp.constant(48)
SMOOTH_STEPS = wp.constant(12)
# Cosines between the normal and the direction to the vertex at which a foot that is no smooth one stops and starts to
# count: sideways of a border there is nothing to be pushed out of.
ASKEW = wp.constant(wp.vec2(0.5, 0.9))
# A smooth foot lies at most this many times as far away as the closest point: in a narrow cleft it is the bottom.
STEEPEST = wp.constant(2.0)


@wp.struct
class PosedSurface:
    """The surface that a garment is kept outside of, in one pose.

    Attributes:
        points, normals: Vertices and unit vertex normals, shape [vertex_count].
        faces: Triangles, shape [triangle_count, 3].
        beside: The triangle across the edge opposite each corner, -1 at a border.
        limb: Limb of each triangle.
    """

    points: wp.array[wp.vec3]
    normals: wp.array[wp.vec3]
    faces: wp.array2d[wp.int32]
    beside: wp.array2d[wp.int32]
    limb: wp.array[wp.int32]


@wp.func
def rise_between(x: wp.float32, low: wp.float32, high: wp.float32) -> wp.float32:
    """From 0 to 1 between two values, smoothly."""
    t = wp.clamp((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def surface_place(surface: PosedSurface, face: wp.int32, w: wp.vec3) -> wp.vec3:
    """Point at barycentric coordinates w of a triangle."""
    return (
        w[0] * surface.points[surface.faces[face, 0]]
        + w[1] * surface.points[surface.faces[face, 1]]
        + w[2] * surface.points[surface.faces[face, 2]]
    )


@wp.func
def surface_normal(surface: PosedSurface, face: wp.int32, w: wp.vec3) -> wp.vec3:
    """Interpolated normal there, not of unit length."""
    return (
        w[0] * surface.normals[surface.faces[face, 0]]
        + w[1] * surface.normals[surface.faces[face, 1]]
        + w[2] * surface.normals[surface.faces[face, 2]]
    )


@wp.func
def closest_on_face(surface: PosedSurface, p: wp.vec3, face: wp.int32):
    """Barycentric coordinates of a triangle's point that is closest to p, and its squared distance."""
    w = closest_point_on_triangle(
        p,
        surface.points[surface.faces[face, 0]],
        surface.points[surface.faces[face, 1]],
        surface.points[surface.faces[face, 2]],
    )
    away = p - surface_place(surface, face, w)
    return w, wp.dot(away, away)


@wp.func
def height_over_corner(surface: PosedSurface, face: wp.int32, p: wp.vec3) -> wp.float32:
    """Height of p over the plane that touches the surface at a triangle's first corner."""
    corner = surface.faces[face, 0]
    return wp.dot(p - surface.points[corner], surface.normals[corner])


@wp.func
def walk_downhill(surface: PosedSurface, p: wp.vec3, start: wp.int32):
    """From triangle to neighbouring triangle as long as they come closer to p: the last one, and the place on it."""
    face = start
    w, squared = closest_on_face(surface, p, face)
    for _ in range(DOWNHILL_STEPS):
        best = wp.int32(-1)
        best_w = w
        # Across every edge that the closest point lies on: one, or two at a corner.
        for corner in range(3):
            other = surface.beside[face, corner]
            if w[corner] <= 0.0 and other >= 0:
                v, d = closest_on_face(surface, p, other)
                if d < squared:
                    best = other
                    best_w = v
                    squared = d
        if best < 0:
            break
        face = best
        w = best_w
    return face, w


@wp.func
def walk_smooth(surface: PosedSurface, p: wp.vec3, start: wp.int32, place: wp.vec3, tolerance: wp.float32):
    """Where the surface's interpolated normal points at p: triangle, height, unit normal; -1 if the walk finds no end.

    The walk of :func:`.cloth.body_surface.smooth_foot`, in single precision, in any unit, and as near as is needed
    here. Unlike the closest point it moves on steadily over hollows.
    """
    face = start
    w = place
    found = wp.int32(-1)
    normal = surface_normal(surface, face, w)
    height = wp.dot(p - surface_place(surface, face, w), normal) / wp.dot(normal, normal)
    for _ in range(SMOOTH_STEPS):
        na = surface.normals[surface.faces[face, 0]]
        nb = surface.normals[surface.faces[face, 1]]
        nc = surface.normals[surface.faces[face, 2]]
        a = surface.points[surface.faces[face, 0]] - p
        b = surface.points[surface.faces[face, 1]] - p
        c = surface.points[surface.faces[face, 2]] - p
        w, normal, rise = smooth_step(a, b, c, na, nb, nc, height)
        height += rise
        if wp.min(w) >= -1.0e-5:
            if wp.abs(rise) < tolerance:
                found = face
                break
        elif wp.abs(rise) < 10.0 * tolerance:
            # Across the edge; only once the height is about right.
            face = surface.beside[face, farthest_corner(w)]
            if face < 0:
                break
    size = wp.length(normal)
    return found, height * size, normal / size


@wp.func
def find_foot(surface: PosedSurface, p: wp.vec3, start: wp.int32, tolerance: wp.float32):
    """Foot of p, walking from a triangle: triangle, height over it, unit normal, and how far it is to be trusted.

    Where no smooth foot is found the closest point is taken, with full trust below and above it and none sideways.
    """
    face, w = walk_downhill(surface, p, start)
    trust = wp.float32(1.0)
    foot, height, normal = walk_smooth(surface, p, face, w, tolerance)
    away = p - surface_place(surface, face, w)
    farthest = STEEPEST * wp.length(away)
    height = wp.clamp(height, -farthest, farthest)
    if foot < 0:
        foot = face
        normal = wp.normalize(surface_normal(surface, face, w))
        height = wp.dot(away, normal)
        trust = rise_between(wp.abs(height), ASKEW[0] * wp.length(away), ASKEW[1] * wp.length(away))
    if not wp.isfinite(height) or not wp.isfinite(normal[0] + normal[1] + normal[2]):
        # Faces without area have no normal.
        normal = wp.vec3()
        height = wp.length(away)
        trust = 0.0
    return foot, height, normal, trust
