"""Contact of the garment with a moving triangle body.

Each vertex looks for the closest point of the body. The contact is a plane through that point, frozen while one
linear system is solved. A body that bends also cuts into itself, in the crook of an elbow or under an arm; there the
closest surface may be the wrong limb. So a vertex touches only the limbs that it is worn on, and no triangle that faces
away from the vertex's own outward direction. The force grows with the square of the depth within the thickness and
stays constant deep inside, so that a place where no cloth can be free of the body does not tear the rest of the
garment.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

PLANES = wp.constant(2)
# A second surface counts as facing the first when their normals are further apart than 60 degrees.
FACING_COSINE = wp.constant(0.5)


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
def triangle_point(
    points: wp.array2d[wp.vec3], faces: wp.array2d[wp.int32], world: wp.int32, face: wp.int32, w: wp.vec3
) -> wp.vec3:
    """Point at barycentric coordinates w of a triangle."""
    return (
        points[world, faces[face, 0]] * w[0]
        + points[world, faces[face, 1]] * w[1]
        + points[world, faces[face, 2]] * w[2]
    )


@wp.func
def face_direction(
    points: wp.array2d[wp.vec3], faces: wp.array2d[wp.int32], world: wp.int32, face: wp.int32
) -> wp.vec3:
    """Unit normal of a triangle."""
    a = points[world, faces[face, 0]]
    return wp.normalize(wp.cross(points[world, faces[face, 1]] - a, points[world, faces[face, 2]] - a))


@wp.func
def is_worn(limb: wp.int32, limbs: wp.int32, facing: wp.vec3, outward: wp.vec3, least_cosine: wp.float32) -> wp.bool:
    """Whether a vertex can touch a triangle: one of its limbs (bits), not facing away from its outward direction."""
    return (limbs >> limb) & 1 == 1 and wp.dot(facing, outward) > least_cosine


@wp.func
def closest_worn_triangle(
    mesh: wp.uint64,
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    face_limb: wp.array[wp.int32],
    world: wp.int32,
    p: wp.vec3,
    limbs: wp.int32,
    outward: wp.vec3,
    least_cosine: wp.float32,
    radius: wp.float32,
):
    """The closest triangle within ``radius`` [m] that a vertex can touch; -1 if there is none."""
    best = wp.int32(-1)
    best_weights = wp.vec3()
    best_distance = radius
    reach = wp.vec3(radius, radius, radius)
    query = wp.mesh_query_aabb(mesh, p - reach, p + reach)
    candidate = wp.int32(0)
    while wp.mesh_query_aabb_next(query, candidate):
        facing = face_direction(points, faces, world, candidate)
        if is_worn(face_limb[candidate], limbs, facing, outward, least_cosine):
            w = closest_point_on_triangle(
                p,
                points[world, faces[candidate, 0]],
                points[world, faces[candidate, 1]],
                points[world, faces[candidate, 2]],
            )
            distance = wp.length(p - triangle_point(points, faces, world, candidate, w))
            if distance < best_distance:
                best = candidate
                best_weights = w
                best_distance = distance
    return best, best_weights


@wp.kernel
def vertex_normals(
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    corner_start: wp.array[wp.int32],
    corners: wp.array[wp.int32],
    # outputs
    normals: wp.array2d[wp.vec3],
):
    """Area-weighted vertex normals; ``corners`` lists face * 3 + corner for each vertex."""
    world, vertex = wp.tid()
    total = wp.vec3()
    for k in range(corner_start[vertex], corner_start[vertex + 1]):
        face = corners[k] // 3
        a = points[world, faces[face, 0]]
        total += wp.cross(points[world, faces[face, 1]] - a, points[world, faces[face, 2]] - a)
    normals[world, vertex] = wp.normalize(total)


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


@wp.kernel
def find_body_contacts(
    positions: wp.array2d[wp.vec3d],
    outward: wp.array2d[wp.vec3],
    limbs: wp.array[wp.int32],
    meshes: wp.array[wp.uint64],
    body_points: wp.array2d[wp.vec3],
    body_faces: wp.array2d[wp.int32],
    body_limb: wp.array[wp.int32],
    body_normals: wp.array2d[wp.vec3],
    radius: wp.float32,
    thickness: wp.float32,
    fold_radius: wp.float32,
    least_cosine: wp.float32,
    # outputs
    face: wp.array2d[wp.int32],
    weights: wp.array2d[wp.vec3],
    point: wp.array2d[wp.vec3d],
    normal: wp.array2d[wp.vec3d],
):
    """Contact planes of every vertex: closest body point [m] and outward unit normal; face -1 where there is none.

    The first plane is the closest within ``radius`` [m]; a second, within ``fold_radius``, belongs to a surface that
    faces the first one across a fold of the body, and is looked for where the first is nearer than two thicknesses.
    Planes of a vertex are entries vertex * PLANES + k.
    """
    world, vertex = wp.tid()
    p = wp.vec3(positions[world, vertex])
    out = outward[world, vertex]
    worn = limbs[vertex]
    first = vertex * PLANES
    face[world, first] = -1
    face[world, first + 1] = -1
    found = wp.int32(-1)
    w = wp.vec3()
    query = wp.mesh_query_point_no_sign(meshes[world], p, radius)
    if query.result:
        found = query.face
        w = wp.vec3(query.u, query.v, 1.0 - query.u - query.v)
        facing = face_direction(body_points, body_faces, world, found)
        if not is_worn(body_limb[found], worn, facing, out, least_cosine):
            found, w = closest_worn_triangle(
                meshes[world], body_points, body_faces, body_limb, world, p, worn, out, least_cosine, radius
            )
    if found < 0:
        return
    closest = triangle_point(body_points, body_faces, world, found, w)
    smooth = wp.normalize(triangle_point(body_normals, body_faces, world, found, w))
    direction = contact_normal(p, closest, smooth)
    face[world, first] = found
    weights[world, first] = w
    point[world, first] = wp.vec3d(closest)
    normal[world, first] = wp.normalize(wp.vec3d(direction))
    # Outside and off this surface, a vertex is off every other one too.
    if wp.dot(p - closest, direction) > 2.0 * thickness or wp.length(p - closest) > fold_radius:
        return
    best = wp.int32(-1)
    best_distance = fold_radius
    reach = wp.vec3(fold_radius, fold_radius, fold_radius)
    near = wp.mesh_query_aabb(meshes[world], p - reach, p + reach)
    candidate = wp.int32(0)
    while wp.mesh_query_aabb_next(near, candidate):
        facing = face_direction(body_points, body_faces, world, candidate)
        across = wp.dot(facing, direction) < FACING_COSINE
        if across and is_worn(body_limb[candidate], worn, facing, out, least_cosine):
            v = closest_point_on_triangle(
                p,
                body_points[world, body_faces[candidate, 0]],
                body_points[world, body_faces[candidate, 1]],
                body_points[world, body_faces[candidate, 2]],
            )
            other = triangle_point(body_points, body_faces, world, candidate, v)
            distance = wp.length(p - other)
            # The first surface must lie in front of the second, or they meet in a ridge or cut into each other; and the
            # vertex must lie over the triangle or under it, not beside it, where in and out mean nothing.
            over = wp.abs(wp.dot(p - other, facing)) >= FACING_COSINE * distance
            if distance < best_distance and over and wp.dot(closest - other, facing) > 0.0:
                turned = contact_normal(p, other, facing)
                if wp.dot(turned, direction) < FACING_COSINE:
                    best = candidate
                    best_distance = distance
                    weights[world, first + 1] = v
                    point[world, first + 1] = wp.vec3d(other)
                    normal[world, first + 1] = wp.normalize(wp.vec3d(turned))
    face[world, first + 1] = best


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
def anchor_alignment(
    body_points: wp.array2d[wp.vec3],
    body_faces: wp.array2d[wp.int32],
    world: wp.int32,
    anchor_face: wp.int32,
    plane_face: wp.int32,
    normal: wp.vec3d,
) -> wp.float32:
    """How well an anchor's triangle faces along a plane's normal; 0 where one of them is missing."""
    if anchor_face < 0 or plane_face < 0:
        return wp.float32(0.0)
    return wp.dot(face_direction(body_points, body_faces, world, anchor_face), wp.vec3(normal))


@wp.kernel
def update_anchors(
    positions: wp.array2d[wp.vec3d],
    area: wp.array[wp.float64],
    body_points: wp.array2d[wp.vec3],
    body_faces: wp.array2d[wp.int32],
    face: wp.array2d[wp.int32],
    weights: wp.array2d[wp.vec3],
    point: wp.array2d[wp.vec3d],
    normal: wp.array2d[wp.vec3d],
    thickness: wp.float64,
    pressure: wp.float64,
    depth: wp.float64,
    friction: wp.float64,
    holding: wp.float64,
    slip: wp.float64,
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
    world, vertex = wp.tid()
    first = vertex * PLANES
    # A vertex in a fold has two planes, which change places as it moves; anchors stay with their surface.
    straight = wp.float32(0.0)
    crossed = wp.float32(0.0)
    for k in range(PLANES):
        held = anchor_face[world, first + k]
        straight += anchor_alignment(
            body_points, body_faces, world, held, face[world, first + k], normal[world, first + k]
        )
        crossed += anchor_alignment(
            body_points, body_faces, world, held, face[world, first + 1 - k], normal[world, first + 1 - k]
        )
    turn = wp.where(crossed > straight, 1, 0)
    old_face = wp.vec2i(anchor_face[world, first + turn], anchor_face[world, first + 1 - turn])
    old_weights = wp.matrix_from_rows(anchor_weights[world, first + turn], anchor_weights[world, first + 1 - turn])
    x = positions[world, vertex]
    for k in range(PLANES):
        plane = first + k
        bound = wp.float64(0.0)
        if face[world, plane] >= 0:
            gap = wp.dot(x - point[world, plane], normal[world, plane])
            bound = holding * contact_force(gap, thickness, pressure * area[vertex], depth)
        held_face = wp.int32(-1)
        held_weights = wp.vec3()
        anchor = wp.vec3d()
        if bound > wp.float64(0.0):
            c = point[world, plane]
            n = normal[world, plane]
            found = face[world, plane]
            held_face = old_face[k]
            held_weights = old_weights[k]
            anchor = c
            if held_face < 0:
                held_face = found
                held_weights = weights[world, plane]
            else:
                anchor = wp.vec3d(triangle_point(body_points, body_faces, world, held_face, held_weights))
                drift = x - anchor
                drift = drift - n * wp.dot(drift, n)
                length = wp.length(drift)
                if following[world] == 0 and length > slip:
                    bound = bound * friction / holding
                elif length > slip:
                    # Walk from the contact point back towards the old anchor, on the plane of the contact triangle;
                    # the weights may leave the triangle by a little, which is still a point that moves with the body.
                    anchor = c - drift * (slip * friction / (holding * length))
                    held_face = found
                    held_weights = plane_weights(
                        wp.vec3(anchor),
                        body_points[world, body_faces[found, 0]],
                        body_points[world, body_faces[found, 1]],
                        body_points[world, body_faces[found, 2]],
                    )
        anchor_point[world, plane] = anchor
        friction_bound[world, plane] = bound
        if following[world] != 0:
            anchor_face[world, plane] = held_face
            anchor_weights[world, plane] = held_weights


@wp.kernel
def hold_anchors(
    gradient: wp.array2d[wp.vec3d],
    body_points: wp.array2d[wp.vec3],
    body_faces: wp.array2d[wp.int32],
    face: wp.array2d[wp.int32],
    point: wp.array2d[wp.vec3d],
    normal: wp.array2d[wp.vec3d],
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
            n = normal[world, plane]
            g = gradient[world, vertex]
            # The spring's stiffness is bound / slip, and the plane's share of the load is bound / total.
            drift = (n * wp.dot(g, n) - g) * (slip / total)
            length = wp.length(drift)
            if length > slip:
                drift = drift * (slip / length)
            found = face[world, plane]
            anchor_face[world, plane] = found
            anchor_weights[world, plane] = plane_weights(
                wp.vec3(point[world, plane] - drift),
                body_points[world, body_faces[found, 0]],
                body_points[world, body_faces[found, 1]],
                body_points[world, body_faces[found, 2]],
            )


@wp.kernel
def expel_vertices(
    face: wp.array2d[wp.int32],
    point: wp.array2d[wp.vec3d],
    normal: wp.array2d[wp.vec3d],
    limit: wp.float64,
    # in and out
    positions: wp.array2d[wp.vec3d],
):
    """Put vertices that lie deeper in the body than ``limit`` [m] on its skin, unless a fold's other side is there."""
    world, vertex = wp.tid()
    first = vertex * PLANES
    if face[world, first] < 0:
        return
    n = normal[world, first]
    x = positions[world, vertex]
    gap = wp.dot(x - point[world, first], n)
    if gap >= -limit:
        return
    x = x - n * gap
    if face[world, first + 1] < 0 or wp.dot(x - point[world, first + 1], normal[world, first + 1]) >= wp.float64(0.0):
        positions[world, vertex] = x


@wp.kernel
def measure_depth(
    positions: wp.array2d[wp.vec3d],
    face: wp.array2d[wp.int32],
    point: wp.array2d[wp.vec3d],
    normal: wp.array2d[wp.vec3d],
    # outputs
    gap: wp.array2d[wp.float32],
):
    """Signed distance of every vertex to the body [m], negative inside, 1e6 where no body is near."""
    world, vertex = wp.tid()
    distance = wp.float32(1.0e6)
    first = vertex * PLANES
    if face[world, first] >= 0:
        distance = wp.float32(wp.dot(positions[world, vertex] - point[world, first], normal[world, first]))
    gap[world, vertex] = distance
