"""The law of contact between garment and body, and where friction holds on.

Each vertex meets planes that ``contact_planes`` found, frozen while one linear system is solved. The force grows with
the square of the depth within the thickness and stays constant deep inside, so that a place where no cloth can be free
of the body does not tear the rest of the garment.
"""

import warp as wp

from ..natural import natural
from .body_surface import BodySurface, face_direction, plane_weights, triangle_point
from .touched_walls import PLANES, ContactPlanes

wp.set_module_options({"enable_backward": False})


@wp.func
def contact_energy(gap: wp.float64, thickness: wp.float64, strength: wp.float64, depth: wp.float64) -> wp.float64:
    """Energy [J] at distance ``gap`` [m] from the surface: cubic below the thickness, linear below -depth.

    ``strength`` is the force at the surface itself [N]. The force grows with the square of the compression, so that a
    contact begins without a jump in stiffness; a spring would switch on and off at every light touch.
    """
    press = thickness - gap
    if press <= wp.float64(0.0):
        return wp.float64(0.0)
    limit = thickness + depth
    scale = strength / (thickness * thickness)
    if press <= limit:
        return scale * press * press * press / wp.float64(3.0)
    return scale * limit * limit * (press - wp.float64(2.0) * limit / wp.float64(3.0))


@wp.func
def contact_force(gap: wp.float64, thickness: wp.float64, strength: wp.float64, depth: wp.float64) -> wp.float64:
    """Outward force [N]: minus the derivative of :func:`contact_energy`."""
    press = wp.clamp(thickness - gap, wp.float64(0.0), thickness + depth) / thickness
    return strength * press * press


@wp.func
def contact_curvature(gap: wp.float64, thickness: wp.float64, strength: wp.float64, depth: wp.float64) -> wp.float64:
    """Second derivative [N/m]; kept at its largest deep inside, where it would vanish."""
    press = wp.clamp(thickness - gap, wp.float64(0.0), thickness + depth)
    return wp.float64(2.0) * strength * press / (thickness * thickness)


@wp.struct
class ContactLaw:
    """How hard a contact pushes and how much of that friction holds; see ``wrinkle_addon/cloth_contact.py``.

    Attributes:
        thickness, depth, slip: Lengths [m].
        pressure: At the body's surface [Pa].
        friction, holding: Coefficients of a vertex that slips and of one that sticks.
    """

    thickness: wp.float64
    depth: wp.float64
    slip: wp.float64
    pressure: wp.float64
    friction: wp.float64
    holding: wp.float64


@wp.func
def anchor_alignment(
    body: BodySurface,
    world: wp.int32,
    anchor_face: wp.int32,
    plane_face: wp.int32,
    normal: wp.vec3d,
) -> wp.float32:
    """How well an anchor's triangle faces along a plane's normal; 0 where one of them is missing."""
    if anchor_face < 0 or plane_face < 0:
        return wp.float32(0.0)
    return wp.dot(face_direction(body.points, body.faces, world, anchor_face), wp.vec3(normal))


@wp.func
def anchor_weights_on(
    body: BodySurface,
    world: wp.int32,
    face: wp.int32,
    anchor: wp.vec3d,
    normal: wp.vec3d,
) -> wp.vec3:
    """Barycentric coordinates of an anchor, moved along the contact's normal onto the plane of a triangle.

    The triangle may lie askew to the contact's plane; this way friction sees the anchor in the same place again.
    """
    a = body.points[world, body.faces[face, 0]]
    facing = wp.vec3d(face_direction(body.points, body.faces, world, face))
    onto = wp.dot(wp.vec3d(a) - anchor, facing) / wp.max(wp.dot(normal, facing), wp.float64(0.1))
    return plane_weights(
        wp.vec3(anchor + normal * onto),
        a,
        body.points[world, body.faces[face, 1]],
        body.points[world, body.faces[face, 2]],
    )


@wp.kernel
def update_anchors(
    positions: wp.array2d[wp.vec3d],
    area: wp.array[wp.float64],
    body: BodySurface,
    planes: ContactPlanes,
    law: ContactLaw,
    following: wp.array[wp.int32],
    # in and out
    anchor_face: wp.array2d[wp.int32],
    anchor_weights: wp.array2d[wp.vec3],
    # outputs
    anchor_point: wp.array2d[wp.vec3d],
    friction_bound: wp.array2d[wp.float64],
):
    """Place the friction anchor [m] of each touched plane and freeze its bound mu f_n [N].

    The coefficient is ``holding`` while the vertex sticks and ``friction`` while it slips. New contacts stick where
    they are. In worlds that are ``following``, an anchor that a slipping vertex has left behind follows it until the
    spring holds exactly the bound of slipping; it is stored on the body's surface, so that it moves with the body. In
    the other worlds anchors are read and not written.
    """
    world, i = wp.tid()
    vertex = natural(i)
    first = vertex * PLANES
    # A vertex in a fold has two planes, which change places as it moves; anchors stay with their surface.
    straight = wp.float32(0.0)
    crossed = wp.float32(0.0)
    for k in range(PLANES):
        held = anchor_face[world, first + k]
        straight += anchor_alignment(body, world, held, planes.face[world, first + k], planes.normal[world, first + k])
        crossed += anchor_alignment(
            body, world, held, planes.face[world, first + 1 - k], planes.normal[world, first + 1 - k]
        )
    turn = wp.where(crossed > straight, 1, 0)
    old_face = wp.vec2i(anchor_face[world, first + turn], anchor_face[world, first + 1 - turn])
    old_weights = wp.matrix_from_rows(anchor_weights[world, first + turn], anchor_weights[world, first + 1 - turn])
    x = positions[world, vertex]
    for k in range(PLANES):
        plane = first + k
        bound = wp.float64(0.0)
        if planes.face[world, plane] >= 0:
            gap = wp.dot(x - planes.point[world, plane], planes.normal[world, plane])
            strength = law.pressure * area[vertex] * wp.float64(planes.share[world, plane])
            bound = law.holding * contact_force(gap, law.thickness, strength, law.depth)
        held_face = wp.int32(-1)
        held_weights = wp.vec3()
        anchor = wp.vec3d()
        if bound > wp.float64(0.0):
            c = planes.point[world, plane]
            n = planes.normal[world, plane]
            found = planes.face[world, plane]
            held_face = old_face[k]
            held_weights = old_weights[k]
            anchor = c
            if held_face < 0:
                held_face = found
                held_weights = planes.weights[world, plane]
            else:
                anchor = wp.vec3d(triangle_point(body.points, body.faces, world, held_face, held_weights))
                drift = x - anchor
                drift = drift - n * wp.dot(drift, n)
                length = wp.length(drift)
                if following[world] == 0 and length > law.slip:
                    bound = bound * law.friction / law.holding
                elif length > law.slip:
                    # Walk from the contact point back towards the old anchor, on the plane of the contact triangle;
                    # the weights may leave the triangle by a little, which is still a point that moves with the body.
                    anchor = c - drift * (law.slip * law.friction / (law.holding * length))
                    held_face = found
                    held_weights = anchor_weights_on(body, world, found, anchor, n)
        anchor_point[world, plane] = anchor
        friction_bound[world, plane] = bound
        if following[world] != 0:
            anchor_face[world, plane] = held_face
            anchor_weights[world, plane] = held_weights


@wp.kernel
def hold_anchors(
    gradient: wp.array2d[wp.vec3d],
    body: BodySurface,
    planes: ContactPlanes,
    friction_bound: wp.array2d[wp.float64],
    slip: wp.float64,
    # outputs
    anchor_face: wp.array2d[wp.int32],
    anchor_weights: wp.array2d[wp.vec3],
):
    """Place anchors so that friction balances a gradient [N] that was taken without it, as far as its bounds allow.

    With two planes each takes its share by its bound.
    """
    world, vertex = wp.tid()
    first = vertex * PLANES
    total = wp.float64(0.0)
    for k in range(PLANES):
        total += friction_bound[world, first + k]
    for k in range(PLANES):
        plane = first + k
        if friction_bound[world, plane] > wp.float64(0.0):
            n = planes.normal[world, plane]
            g = gradient[world, vertex]
            # The spring's stiffness is bound / slip, and the plane's share of the load is bound / total.
            drift = (n * wp.dot(g, n) - g) * (slip / total)
            length = wp.length(drift)
            if length > slip:
                drift = drift * (slip / length)
            found = planes.face[world, plane]
            anchor_face[world, plane] = found
            anchor_weights[world, plane] = anchor_weights_on(body, world, found, planes.point[world, plane] - drift, n)


@wp.kernel
def expel_vertices(
    planes: ContactPlanes,
    limit: wp.float64,
    deepest: wp.float64,
    # in and out
    positions: wp.array2d[wp.vec3d],
):
    """Put vertices that lie deeper in the body than ``limit`` [m] on its skin, unless a fold's other side is there.

    One that lies deeper than ``deepest`` [m] stays: the skin that it came through may well be another.
    """
    world, vertex = wp.tid()
    first = vertex * PLANES
    if planes.face[world, first] < 0:
        return
    n = planes.normal[world, first]
    x = positions[world, vertex]
    gap = wp.dot(x - planes.point[world, first], n)
    if gap >= -limit or gap < -deepest:
        return
    x = x - n * gap
    second = first + 1
    if planes.face[world, second] >= 0:
        if wp.dot(x - planes.point[world, second], planes.normal[world, second]) < wp.float64(0.0):
            return
    positions[world, vertex] = x


@wp.kernel
def measure_depth(
    positions: wp.array2d[wp.vec3d],
    planes: ContactPlanes,
    # outputs
    gap: wp.array2d[wp.float32],
):
    """Signed distance of every vertex to the body [m], negative inside, 1e6 where no body is near."""
    world, vertex = wp.tid()
    distance = wp.float32(1.0e6)
    first = vertex * PLANES
    if planes.face[world, first] >= 0:
        distance = wp.float32(
            wp.dot(positions[world, vertex] - planes.point[world, first], planes.normal[world, first])
        )
    gap[world, vertex] = distance
