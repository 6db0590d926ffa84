"""Where each vertex of the garment touches the body: up to two planes a vertex, found anew before each linearisation.

The first plane lies at the closest skin that the vertex is worn on. A body that bends also cuts into itself, in the
crook of an elbow or under an arm, where the closest skin may be the wrong limb's: a vertex touches only the limbs that
it is worn on, and no triangle that faces away from the vertex's own outward direction.

The second plane holds it against what lies across: skin of any limb that is met on the way from the first plane to the
vertex, as of the trunk under a sleeve; else the skin that was touched one linearisation before. Without that memory a
vertex between two walls sees now one and now the other, and never comes to rest.

Where limbs pass through each other walls still come out of nothing, and give way in time (``touched_walls``).
"""

import warp as wp

from .body_surface import (
    BodySurface,
    closest_point_on_triangle,
    face_direction,
    hollow_bend,
    smooth_foot,
    triangle_point,
)
from .touched_walls import PLANES, ContactPlanes, ContactReach, TouchedWalls, remember_walls, share_pressure

wp.set_module_options({"enable_backward": False})

# A smooth foot that is this many times as far away as the closest point is none: in a narrow cleft it is the bottom.
STEEPEST = wp.constant(2.0)
# Below this [m] two places on the skin are one.
SKIN = wp.constant(1.0e-4)
NOWHERE = wp.constant(1.0e6)
# A vertex that has this many thicknesses of free space around it touches nothing, nor will after the next step.
CLEAR_THICKNESSES = wp.constant(2.0)
# A vertex this far below its skin [m] must be in the body, where the winding number, to this accuracy, is at least so
# much: a half of what it is in a closed one, as under a single wall it is no more than one half.
ACCURACY = wp.constant(2.0)
INSIDE = wp.constant(0.25)
SUNK = wp.constant(5.0e-4)


@wp.struct
class FreeSpace:
    """The ball of every vertex, [world_count, vertex_count], that no skin reached into when it was last looked for.

    Attributes:
        centre: Where the vertex was [m].
        radius: How far the closest skin was [m], 0 if it is to be looked for in any case.
    """

    centre: wp.array2d[wp.vec3d]
    radius: wp.array2d[wp.float32]


@wp.func
def is_worn(limb: wp.int32, limbs: wp.int32, facing: wp.vec3, outward: wp.vec3, least_cosine: wp.float32) -> wp.bool:
    """Whether a vertex can touch a triangle: one of its limbs (bits), not facing away from its outward direction."""
    return (limbs >> limb) & 1 == 1 and wp.dot(facing, outward) > least_cosine


@wp.func
def closest_worn_triangle(
    body: BodySurface,
    world: wp.int32,
    p: wp.vec3,
    limbs: wp.int32,
    outward: wp.vec3,
    reach: ContactReach,
    in_front: wp.bool,
):
    """The closest triangle within reach that a vertex can touch, by looking at all; -1 if there is none.

    If the vertex is known to be ``in_front`` of the body, triangles that it lies behind do not count.
    """
    best = wp.int32(-1)
    best_weights = wp.vec3()
    best_distance = reach.radius
    box = wp.vec3(reach.radius, reach.radius, reach.radius)
    query = wp.mesh_query_aabb(body.meshes[world], p - box, p + box)
    candidate = wp.int32(0)
    while wp.mesh_query_aabb_next(query, candidate):
        if (limbs >> body.limb[candidate]) & 1 == 0:
            continue
        facing = face_direction(body.points, body.faces, world, candidate)
        if is_worn(body.limb[candidate], limbs, facing, outward, reach.least_cosine):
            w = closest_point_on_triangle(
                p,
                body.points[world, body.faces[candidate, 0]],
                body.points[world, body.faces[candidate, 1]],
                body.points[world, body.faces[candidate, 2]],
            )
            away = p - triangle_point(body.points, body.faces, world, candidate, w)
            distance = wp.length(away)
            if distance < best_distance and not (in_front and wp.dot(away, facing) <= 0.0):
                best = candidate
                best_weights = w
                best_distance = distance
    return best, best_weights


@wp.func
def contact_normal(p: wp.vec3, closest: wp.vec3, outside: wp.vec3) -> wp.vec3:
    """Unit direction from the closest body point to p, turned outwards; ``outside`` itself where they coincide."""
    away = p - closest
    distance = wp.length(away)
    # Closer than 10 micrometres the difference vector is rounding noise.
    if distance < 1.0e-5:
        return outside
    if wp.dot(away, outside) < 0.0:
        distance = -distance
    return away / distance


@wp.func
def set_plane(
    planes: ContactPlanes,
    world: wp.int32,
    plane: wp.int32,
    face: wp.int32,
    w: wp.vec3,
    closest: wp.vec3,
    direction: wp.vec3,
):
    """A plane through a point of a triangle."""
    planes.face[world, plane] = face
    planes.weights[world, plane] = w
    planes.point[world, plane] = wp.vec3d(closest)
    planes.normal[world, plane] = wp.normalize(wp.vec3d(direction))
    planes.hollow[world, plane] = wp.vec3()


@wp.func
def set_smooth_plane(
    planes: ContactPlanes,
    body: BodySurface,
    world: wp.int32,
    plane: wp.int32,
    x: wp.vec3d,
    foot: wp.int32,
    w: wp.vec3,
    height: wp.float32,
    normal: wp.vec3,
):
    """A plane at the place that :func:`smooth_foot` found below x."""
    planes.face[world, plane] = foot
    planes.weights[world, plane] = w
    planes.point[world, plane] = x - wp.vec3d(normal) * wp.float64(height)
    planes.normal[world, plane] = wp.normalize(wp.vec3d(normal))
    planes.hollow[world, plane] = hollow_bend(body, world, foot, height, normal)


@wp.func
def find_skin(body: BodySurface, reach: ContactReach, world: wp.int32, p: wp.vec3, limbs: wp.int32, outward: wp.vec3):
    """The closest skin that a vertex is worn on: triangle (-1 if there is none), barycentric coordinates, and whether
    nearer skin was passed over."""
    query = wp.mesh_query_point_no_sign(body.meshes[world], p, reach.radius)
    found = wp.int32(-1)
    w = wp.vec3()
    passed = wp.bool(False)
    if query.result:
        found = query.face
        w = wp.vec3(query.u, query.v, 1.0 - query.u - query.v)
        facing = face_direction(body.points, body.faces, world, found)
        passed = not is_worn(body.limb[found], limbs, facing, outward, reach.least_cosine)
        if passed:
            found, w = closest_worn_triangle(body, world, p, limbs, outward, reach, False)
    return found, w, passed


@wp.func
def side_of_skin(body: BodySurface, world: wp.int32, p: wp.vec3, found: wp.int32, w: wp.vec3):
    """The place at coordinates w of triangle ``found``, which is the closest to p [m], the unit direction outwards from
    there, and how far along it p lies [m], negative under the skin."""
    closest = triangle_point(body.points, body.faces, world, found, w)
    smooth = wp.normalize(triangle_point(body.normals, body.faces, world, found, w))
    direction = contact_normal(p, closest, smooth)
    return closest, direction, wp.dot(p - closest, direction)


@wp.func
def hold_plane(
    planes: ContactPlanes,
    body: BodySurface,
    world: wp.int32,
    plane: wp.int32,
    x: wp.vec3d,
    found: wp.int32,
    w: wp.vec3,
    closest: wp.vec3,
    direction: wp.vec3,
    gap: wp.float32,
):
    """The plane that skin holds against x: where its smooth surface points at x, if that is near the closest point."""
    set_plane(planes, world, plane, found, w, closest, direction)
    foot, v, height, turned = smooth_foot(body, world, x, found, w)
    if foot >= 0 and height * gap >= 0.0 and wp.abs(height) <= STEEPEST * wp.abs(gap):
        set_smooth_plane(planes, body, world, plane, x, foot, v, height, turned)


@wp.func
def find_first_plane(
    planes: ContactPlanes,
    body: BodySurface,
    reach: ContactReach,
    world: wp.int32,
    vertex: wp.int32,
    x: wp.vec3d,
    limbs: wp.int32,
    outward: wp.vec3,
    free: FreeSpace,
) -> wp.bool:
    """The plane at the closest skin that the vertex is worn on; whether there is one."""
    found, w, passed = find_skin(body, reach, world, wp.vec3(x), limbs, outward)
    free.centre[world, vertex] = x
    free.radius[world, vertex] = wp.where(passed, 0.0, reach.radius)
    if found < 0:
        return False
    p = wp.vec3(x)
    closest, direction, gap = side_of_skin(body, world, p, found, w)
    if not passed:
        free.radius[world, vertex] = gap
    # Worn skin far above, beyond skin that is nearer and not worn, is the other side of a limb.
    if passed and gap < -reach.depth:
        return False
    # Where skinning has folded the body, skin may lie above a vertex with no body in between.
    if gap < -SUNK:
        around = wp.mesh_query_point_sign_winding_number(body.meshes[world], p, reach.radius, ACCURACY, INSIDE)
        if around.result and around.sign > 0.0:
            found, w = closest_worn_triangle(body, world, p, limbs, outward, reach, True)
            if found < 0:
                return False
            closest = triangle_point(body.points, body.faces, world, found, w)
            direction = wp.normalize(p - closest)
            gap = wp.length(p - closest)
    hold_plane(planes, body, world, vertex * PLANES, x, found, w, closest, direction, gap)
    return True


@wp.func
def find_facing_plane(
    planes: ContactPlanes, body: BodySurface, reach: ContactReach, world: wp.int32, vertex: wp.int32, x: wp.vec3d
) -> wp.float32:
    """The plane of whatever skin is met on the way from the first plane to the vertex or a little beyond it; the
    vertex's distance from it [m].
    """
    first = vertex * PLANES
    p = wp.vec3(x)
    start = wp.vec3(planes.point[world, first])
    direction = wp.vec3(planes.normal[world, first])
    rise = wp.max(wp.dot(p - start, direction), 0.0) + 2.0 * reach.thickness
    ray = wp.mesh_query_ray(body.meshes[world], start + SKIN * direction, direction, rise)
    if not ray.result or wp.dot(ray.normal, direction) >= 0.0:
        return NOWHERE
    w = wp.vec3(ray.u, ray.v, 1.0 - ray.u - ray.v)
    met = triangle_point(body.points, body.faces, world, ray.face, w)
    gap = wp.dot(p - met, ray.normal)
    foot, v, height, turned = smooth_foot(body, world, x, ray.face, w)
    if foot >= 0 and wp.abs(height) <= STEEPEST * (wp.abs(gap) + reach.thickness):
        # The normals of a hollow can lead to its bottom from both sides.
        if wp.length(triangle_point(body.points, body.faces, world, foot, v) - start) < SKIN:
            return NOWHERE
        set_smooth_plane(planes, body, world, first + 1, x, foot, v, height, turned)
        return height
    set_plane(planes, world, first + 1, ray.face, w, met, ray.normal)
    return gap


@wp.func
def find_burying_plane(
    planes: ContactPlanes, body: BodySurface, reach: ContactReach, world: wp.int32, vertex: wp.int32, x: wp.vec3d
) -> wp.float32:
    """The plane of the closest skin, if the vertex lies in the body below it, it faces the first plane and the body
    ends there; the vertex's distance from it [m], negative.

    So a vertex gets out of the limb across even if its own skin is in there too, at the edge of where the two meet.
    """
    first = vertex * PLANES
    p = wp.vec3(x)
    query = wp.mesh_query_point_no_sign(body.meshes[world], p, 2.0 * reach.thickness)
    if not query.result:
        return NOWHERE
    w = wp.vec3(query.u, query.v, 1.0 - query.u - query.v)
    closest, direction, gap = side_of_skin(body, world, p, query.face, w)
    own = wp.vec3(planes.normal[world, first])
    if gap > -SKIN or wp.dot(direction, own) >= 0.0 or wp.dot(p - wp.vec3(planes.point[world, first]), own) <= 0.0:
        return NOWHERE
    above = closest + SUNK * direction
    around = wp.mesh_query_point_sign_winding_number(body.meshes[world], above, reach.radius, ACCURACY, INSIDE)
    if around.result and around.sign < 0.0:
        return NOWHERE
    hold_plane(planes, body, world, first + 1, x, query.face, w, closest, direction, gap)
    return gap


@wp.func
def find_held_plane(
    planes: ContactPlanes,
    body: BodySurface,
    reach: ContactReach,
    world: wp.int32,
    vertex: wp.int32,
    x: wp.vec3d,
    held: wp.int32,
    w: wp.vec3,
) -> wp.bool:
    """The plane of skin that was touched before at triangle ``held``, if the vertex is still pressed against it."""
    foot, v, height, turned = smooth_foot(body, world, x, held, w)
    if foot < 0 or height >= reach.thickness or height <= -reach.radius:
        return False
    start = wp.vec3(planes.point[world, vertex * PLANES])
    if wp.length(triangle_point(body.points, body.faces, world, foot, v) - start) < SKIN:
        return False
    set_smooth_plane(planes, body, world, vertex * PLANES + 1, x, foot, v, height, turned)
    return True


@wp.kernel
def find_contact_planes(
    positions: wp.array2d[wp.vec3d],
    outward: wp.array2d[wp.vec3],
    limbs: wp.array[wp.int32],
    body: BodySurface,
    reach: ContactReach,
    remembering: wp.array[wp.int32],
    patience: wp.array[wp.int32],
    # in and out
    touched: TouchedWalls,
    free: FreeSpace,
    planes: ContactPlanes,
):
    """Contact planes of every vertex; those of a vertex that is still in free space stay as they are.

    ``touched`` is what was touched before; worlds that are ``remembering`` store there what is touched now. So many
    walls that come out of nothing are borne as each world's ``patience`` says.
    """
    world, vertex = wp.tid()
    x = positions[world, vertex]
    moved = wp.float32(wp.length(x - free.centre[world, vertex]))
    if free.radius[world, vertex] - moved > CLEAR_THICKNESSES * reach.thickness:
        return
    first = vertex * PLANES
    planes.face[world, first] = -1
    planes.face[world, first + 1] = -1
    if find_first_plane(planes, body, reach, world, vertex, x, limbs[vertex], outward[world, vertex], free):
        gap = find_facing_plane(planes, body, reach, world, vertex, x)
        if gap == NOWHERE and free.radius[world, vertex] == 0.0:
            gap = find_burying_plane(planes, body, reach, world, vertex, x)
        for k in range(PLANES):
            held = touched.face[world, first + k]
            if gap > reach.thickness and held >= 0:
                if find_held_plane(planes, body, reach, world, vertex, x, held, touched.weights[world, first + k]):
                    gap = wp.float32(0.0)
    sudden = share_pressure(planes, touched, reach, world, vertex, x, patience[world])
    if remembering[world] != 0:
        remember_walls(planes, reach, world, vertex, x, sudden, touched)
