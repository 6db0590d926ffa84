"""Planes that hold a vertex, what was touched one linearisation before, and how contact gives way.

Where limbs of a body pass through each other, no rule of what touches what is continuous: a vertex that is pushed out
of one wall lies all at once deep under another, and back. On neither side is there an equilibrium, only on the border
with a share of either force (Filippov 1988, *Differential Equations with Discontinuous Righthand Sides*). So a wall
that comes upon a vertex out of nothing again and again presses it less each time, until the cloth around it bears what
is left. Walls that a vertex comes to, and those that it has kept touching, press as ever.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

PLANES = wp.constant(2)
# A wall is the one that was touched before if its normal has turned by less than this cosine and the vertex lies at the
# same height over both, to this [m].
SAME_COSINE = wp.constant(wp.float64(0.8))
SAME_HEIGHT = wp.constant(wp.float64(1.0e-3))
# Once patience has run out, contact that comes out of nothing presses this share of what it did the time before.
YIELD = wp.constant(0.1)


@wp.struct
class ContactPlanes:
    """Planes of every vertex, entries vertex * PLANES + k of each world.

    Attributes:
        face, weights: Body triangle and barycentric coordinates; -1 where there is none.
        point, normal: A point of the plane [m] and its outward unit normal.
        hollow: How the normal turns where the body is hollow, see :func:`~.body_surface.hollow_bend`.
        share: Share of the full pressure that the plane gives, see :func:`wall_share`.
    """

    face: wp.array2d[wp.int32]
    weights: wp.array2d[wp.vec3]
    point: wp.array2d[wp.vec3d]
    normal: wp.array2d[wp.vec3d]
    hollow: wp.array2d[wp.vec3]
    share: wp.array2d[wp.float32]


@wp.struct
class TouchedWalls:
    """What every vertex touched one linearisation before, entries vertex * PLANES + k of each world.

    Attributes:
        face, weights: Body triangle and barycentric coordinates; -1 where nothing was touched.
        point, normal: The plane there: a point [m] and its outward unit normal.
        share: Share of the full pressure that it gave.
        position: Where the vertex was [m], [world_count, vertex_count].
        sudden: How many walls have come upon the vertex out of nothing since the body moved, -1 before it was looked
            for, [world_count, vertex_count].
    """

    face: wp.array2d[wp.int32]
    weights: wp.array2d[wp.vec3]
    point: wp.array2d[wp.vec3d]
    normal: wp.array2d[wp.vec3d]
    share: wp.array2d[wp.float32]
    position: wp.array2d[wp.vec3d]
    sudden: wp.array2d[wp.int32]


@wp.struct
class ContactReach:
    """Lengths of the search [m] and the least cosine between a triangle's normal and a vertex's outward direction."""

    radius: wp.float32
    thickness: wp.float32
    depth: wp.float32
    least_cosine: wp.float32


@wp.func
def sudden_share(times: wp.int32, patience: wp.int32) -> wp.float32:
    """Share of its full pressure that contact gives which has come out of nothing so many times, of which ``patience``
    are borne.
    """
    return wp.pow(YIELD, wp.float32(wp.max(times - patience, 0)))


@wp.func
def wall_share(
    planes: ContactPlanes,
    touched: TouchedWalls,
    reach: ContactReach,
    world: wp.int32,
    vertex: wp.int32,
    plane: wp.int32,
    x: wp.vec3d,
    patience: wp.int32,
):
    """Share of its full pressure that a plane gives, and whether its wall has come upon the vertex out of nothing.

    It has if it presses the vertex, would have pressed it where the vertex was before, and was not touched then. A wall
    that the vertex came to gives all of its pressure, one that was touched before the share that it gave.
    """
    thickness = wp.float64(reach.thickness)
    c = planes.point[world, plane]
    n = planes.normal[world, plane]
    height = wp.dot(x - c, n)
    before = wp.dot(touched.position[world, vertex] - c, n)
    if touched.sudden[world, vertex] < 0 or height >= thickness or before >= thickness:
        return wp.float32(1.0), wp.bool(False)
    for k in range(PLANES):
        other = vertex * PLANES + k
        if touched.face[world, other] >= 0 and wp.dot(touched.normal[world, other], n) > SAME_COSINE:
            turned = wp.dot(x - touched.point[world, other], touched.normal[world, other])
            if wp.abs(turned - height) < SAME_HEIGHT:
                return touched.share[world, other], wp.bool(False)
    return sudden_share(touched.sudden[world, vertex] + 1, patience), wp.bool(True)


@wp.func
def share_pressure(
    planes: ContactPlanes,
    touched: TouchedWalls,
    reach: ContactReach,
    world: wp.int32,
    vertex: wp.int32,
    x: wp.vec3d,
    patience: wp.int32,
) -> wp.bool:
    """Give each plane of a vertex its share; whether a wall has come upon the vertex out of nothing."""
    sudden = wp.bool(False)
    for k in range(PLANES):
        plane = vertex * PLANES + k
        if planes.face[world, plane] >= 0:
            share, new = wall_share(planes, touched, reach, world, vertex, plane, x, patience)
            planes.share[world, plane] = share
            sudden = sudden or new
    return sudden


@wp.func
def remember_walls(
    planes: ContactPlanes,
    reach: ContactReach,
    world: wp.int32,
    vertex: wp.int32,
    x: wp.vec3d,
    sudden: wp.bool,
    touched: TouchedWalls,
):
    """Keep in mind what a vertex touches now."""
    touched.position[world, vertex] = x
    touched.sudden[world, vertex] = wp.max(touched.sudden[world, vertex], 0) + wp.where(sudden, 1, 0)
    for k in range(PLANES):
        plane = vertex * PLANES + k
        touched.face[world, plane] = -1
        if planes.face[world, plane] >= 0:
            if wp.dot(x - planes.point[world, plane], planes.normal[world, plane]) < wp.float64(reach.thickness):
                touched.face[world, plane] = planes.face[world, plane]
                touched.weights[world, plane] = planes.weights[world, plane]
                touched.point[world, plane] = planes.point[world, plane]
                touched.normal[world, plane] = planes.normal[world, plane]
                touched.share[world, plane] = planes.share[world, plane]
