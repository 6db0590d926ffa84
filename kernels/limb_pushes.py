"""Pushing a garment out of limbs that came in its way, after that which it is worn on (:mod:`.penetration`), and to its
place.

Cloth between two limbs is moved half way between them. Where they overlap, near the crease in which they meet, it is
moved out to that: the body leaves a place there.
"""

import warp as wp

from .limb_grids import LimbGrids, limb_triangle, limbs_around, nearer_triangle
from .natural import natural
from .penetration import CLUSTER, NOWHERE, Clearance, facing_wall, height_between, needed_height, softened
from .posed_surface import LIMB, PosedSurface, find_foot, find_foot_within, rise_between
from .spreading import RING, Neighbours

wp.set_module_options({"enable_backward": False})

# A vertex is moved out of another limb by at most this many times what the shortest way out would take.
OVERSHOOT = wp.constant(3.0)
# Depths in another limb at which the way to the crease begins to count and counts in full [m].
ENTERED = wp.constant(wp.vec2(0.0005, 0.002))
# Feet that are at most this far from each other [m] and whose normals have at least this cosine are one.
ONE_PLACE = wp.constant(wp.float32(0.001))
ONE_WAY = wp.constant(wp.float32(0.9))


@wp.func
def are_one_place(
    height: wp.float32, normal: wp.vec3, other_height: wp.float32, other_normal: wp.vec3, metre: wp.float32
) -> wp.bool:
    """Whether two feet of a vertex are one place on the skin: limbs that a joint ties together are one surface."""
    between = wp.length(height * normal - other_height * other_normal)
    return between < ONE_PLACE * metre and wp.dot(normal, other_normal) > ONE_WAY


@wp.func
def move_out_of_limb(
    surface: PosedSurface,
    grids: LimbGrids,
    limb: wp.int32,
    begin: wp.int32,
    p: wp.vec3,
    position: wp.vec3,
    own: wp.int32,
    height: wp.float32,
    normal: wp.vec3,
    needed: wp.float32,
    dealt: wp.vec3,
    dealt_normal: wp.vec3,
    clearance: Clearance,
    tolerance: wp.float32,
):
    """Move out of another limb of a vertex that now is at p, near its triangle ``begin``, what it lacks there [m], and
    the limb's skin below it: place and normal.

    ``height`` [m] and ``normal`` are those of where it was over its own limb; without a normal they are not known yet.
    Skin at ``dealt`` that looks the same way was dealt with: limbs that a joint ties together are one surface.
    """
    move = wp.vec3()
    enough = needed * clearance.metre
    foot, g, m, trust = find_foot_within(
        surface, p, begin, surface.triangles[natural(own)][LIMB], tolerance * clearance.metre, enough
    )
    lack = needed - g / clearance.metre
    wall_skin = p - g * m
    if wp.length(wall_skin - dealt) < ONE_PLACE * clearance.metre and wp.dot(m, dealt_normal) > ONE_WAY:
        lack = wp.float32(0.0)
    # Skin that looks the other way is not the vertex's own.
    if lack > 0.0 and (wp.dot(normal, m) > 0.0 or wp.length_sq(normal) == 0.0):
        _here, own_height, own_normal, _sure = find_foot(surface, p, own, tolerance * clearance.metre)
        if are_one_place(own_height, own_normal, g, m, clearance.metre):
            lack = wp.float32(0.0)
    if lack > 0.0:
        n = normal
        h = height * clearance.metre
        if wp.length_sq(n) == 0.0:
            below = nearer_triangle(surface, grids, position, own)
            _face, h, n, _sure = find_foot(surface, position, below, tolerance * clearance.metre)
        skin = position - h * n
        wall, wall_height, sure, apart = facing_wall(surface, grids, limb, foot, skin, n, clearance, tolerance)
        now = wp.dot(p - skin, n) / clearance.metre
        g = wall_height + wp.dot(p - skin, wall) / clearance.metre
        asked = height_between(needed, g, now, wp.max(-wp.dot(wall, n), 0.0))
        between = softened(wp.min(asked - g, OVERSHOOT * lack), clearance.soft, clearance.deep)
        shortest = trust * softened(lack, clearance.soft, clearance.overlap)
        move = apart * clearance.metre * (sure * between * wall + (1.0 - sure) * shortest * m)
    return move, lack, wall_skin, m


@wp.func
def move_out_of_limbs(
    surface: PosedSurface,
    grids: LimbGrids,
    limbs: wp.int32,
    pushed: wp.vec3,
    begun: wp.vec3,
    position: wp.vec3,
    own: wp.int32,
    height: wp.float32,
    normal: wp.vec3,
    needed: wp.float32,
    clearance: Clearance,
    tolerance: wp.float32,
):
    """Go on with the move ``begun`` of a vertex that was ``pushed`` out of its own limb, out of these limbs (bits) one
    after the other: the whole move, the most that it lacked [m], and a triangle of the limb where it did, -1 for none.
    """
    move = begun
    most = wp.float32(0.0)
    most_in = wp.int32(-1)
    dealt = wp.vec3(NOWHERE)
    dealt_normal = wp.vec3()
    for limb in range(grids.limbs.shape[0]):
        if (limbs >> limb) & 1 != 0:
            begin = limb_triangle(surface, grids, limb, pushed + move, clearance.metre)
            if begin >= 0:
                away, lack, skin, outward = move_out_of_limb(
                    surface,
                    grids,
                    limb,
                    begin,
                    pushed + move,
                    position,
                    own,
                    height,
                    normal,
                    needed,
                    dealt,
                    dealt_normal,
                    clearance,
                    tolerance,
                )
                move += away
                if lack > 0.0:
                    dealt = skin
                    dealt_normal = outward
                if lack > most:
                    most = lack
                    most_in = begin
    return move, most, most_in


@wp.kernel
def push_between_limbs(
    first: wp.int32,
    block_size: wp.int32,
    order: wp.array[wp.int32],
    positions: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    rest_height: wp.array[wp.float32],
    push: wp.array[wp.float32],
    surface: PosedSurface,
    grids: LimbGrids,
    clearance: Clearance,
    tolerance: wp.float32,
    # in and out
    face: wp.array[wp.int32],
    height: wp.array[wp.float32],
    normal: wp.array[wp.vec3],
    # outputs
    moves: wp.array[wp.vec3],
    limb_lack: wp.array[wp.float32],
):
    """Moves out of other limbs of what :func:`push_out` pushes out of its own, and the most that it lacks there [m].

    The feet that :func:`find_lacks` left out are found here, where a neighbour's push has spread to.
    """
    block = (first + wp.tid()) * block_size
    end = wp.min(block + block_size, positions.shape[0])
    for cluster in range(block, end, CLUSTER):
        stop = wp.min(cluster + CLUSTER, end)
        low = wp.vec3(NOWHERE)
        high = wp.vec3(-NOWHERE)
        for i in range(cluster, stop):
            v = natural(order[natural(i)])
            p = positions[v]
            if push[v] > 0.0 and face[v] < 0:
                below = nearer_triangle(surface, grids, p, start[v])
                foot, h, n, _trust = find_foot(surface, p, below, tolerance * clearance.metre)
                face[v] = foot
                height[v] = h / clearance.metre
                normal[v] = n
            pushed = p + push[v] * clearance.metre * normal[v]
            low = wp.min(low, pushed)
            high = wp.max(high, pushed)
        limbs = limbs_around(grids, low, high)
        for i in range(cluster, stop):
            v = natural(order[natural(i)])
            p = positions[v]
            own = wp.where(face[v] >= 0, face[v], start[v])
            needed = needed_height(rest_height[v], clearance)
            pushed = p + push[v] * clearance.metre * normal[v]
            near = limbs & ~(1 << surface.triangles[natural(own)][LIMB])
            move = wp.vec3()
            most = wp.float32(0.0)
            if near != 0:
                move, most, _most_in = move_out_of_limbs(
                    surface,
                    grids,
                    near,
                    pushed,
                    move,
                    p,
                    own,
                    height[v],
                    normal[v],
                    needed,
                    clearance,
                    tolerance,
                )
            moves[v] = move
            limb_lack[v] = most


@wp.func
def lacks_around(neighbours: Neighbours, lack: wp.array[wp.float32], v: wp.int32) -> wp.bool:
    """Whether a vertex or one of its neighbours lacks anything: few do."""
    ring = neighbours.ring[v]
    total = lack[v]
    for k in range(RING):
        total += lack[natural(ring[k])]
    for k in range(neighbours.begin[v] + RING, neighbours.begin[v + 1]):
        total += lack[neighbours.all[k]]
    return total > 0.0


@wp.func
def mean_move(neighbours: Neighbours, moves: wp.array[wp.vec3], v: wp.int32) -> wp.vec3:
    """Half of a vertex's move and half of the mean of its neighbours'."""
    begin = neighbours.begin[v]
    end = neighbours.begin[v + 1]
    total = wp.vec3()
    for k in range(begin, end):
        total += moves[natural(neighbours.all[natural(k)])]
    return 0.5 * moves[v] + 0.5 * total / wp.float32(wp.max(end - begin, 1))


@wp.func
def way_out_of_both(lack: wp.float32, normal: wp.vec3, other_lack: wp.float32, other_normal: wp.vec3) -> wp.vec3:
    """The shortest move that two planes' lacks ask for; they are below 0 outside."""
    cosine = wp.dot(normal, other_normal)
    move = wp.vec3()
    if lack > 0.0 or other_lack > 0.0:
        if lack > 0.0 and lack * cosine >= other_lack:
            move = lack * normal
        elif other_lack > 0.0 and other_lack * cosine >= lack:
            move = other_lack * other_normal
        else:
            # Of the cosine, little is left of the angle between planes that face each other: they meet far away.
            steep = wp.max(wp.length_sq(wp.cross(normal, other_normal)), 1.0e-12)
            move = ((lack - cosine * other_lack) * normal + (other_lack - cosine * lack) * other_normal) / steep
    return move


@wp.func
def move_to_crease(
    surface: PosedSurface,
    p: wp.vec3,
    own: wp.int32,
    other: wp.int32,
    needed: wp.float32,
    clearance: Clearance,
    tolerance: wp.float32,
) -> wp.vec3:
    """Move of a vertex inside another limb, near its triangle ``other``, to where that meets its own, if it is near."""
    _foot, height, normal, trust = find_foot(surface, p, own, tolerance * clearance.metre)
    _other, other_height, other_normal, other_trust = find_foot(surface, p, other, tolerance * clearance.metre)
    # What lay inside at rest may lie as deep here.
    allowed = wp.min(needed, 0.0) * clearance.metre
    lack = allowed - height
    other_lack = allowed - other_height
    sure = trust * other_trust * rise_between(other_lack / clearance.metre, ENTERED[0], ENTERED[1])
    move = wp.vec3()
    # Without trust a foot may have no numbers; of a single wall there is no crease.
    if sure > 0.0 and not are_one_place(height, normal, other_height, other_normal, clearance.metre):
        move = way_out_of_both(lack, normal, other_lack, other_normal)
        far = wp.length(move) / clearance.metre
        move *= sure * (1.0 - rise_between(far, clearance.crease[0], clearance.crease[1]))
    return move


@wp.kernel
def push_out(
    first: wp.int32,
    block_size: wp.int32,
    neighbours: Neighbours,
    start: wp.array[wp.int32],
    rest_height: wp.array[wp.float32],
    push: wp.array[wp.float32],
    face: wp.array[wp.int32],
    height: wp.array[wp.float32],
    normal: wp.array[wp.vec3],
    moves: wp.array[wp.vec3],
    limb_lack: wp.array[wp.float32],
    surface: PosedSurface,
    grids: LimbGrids,
    clearance: Clearance,
    tolerance: wp.float32,
    # in and out
    positions: wp.array[wp.vec3],
):
    """Move every vertex by its push [m] along its normal (eq 11), and on out of other limbs.

    There it goes half way to where its neighbours go, and out of what is still in its way then; where that leaves it in
    two limbs, to the crease between them.
    """
    block = (first + wp.tid()) * block_size
    for i in range(block, wp.min(block + block_size, positions.shape[0])):
        v = natural(i)
        p = positions[v]
        pushed = p + push[v] * clearance.metre * normal[v]
        move = wp.vec3()
        if lacks_around(neighbours, limb_lack, v):
            move = mean_move(neighbours, moves, v)
            own = wp.where(face[v] >= 0, face[v], start[v])
            needed = needed_height(rest_height[v], clearance)
            place = pushed + move
            near = limbs_around(grids, place, place) & ~(1 << surface.triangles[natural(own)][LIMB])
            move, _most, most_in = move_out_of_limbs(
                surface,
                grids,
                near,
                pushed,
                move,
                p,
                own,
                height[v],
                normal[v],
                needed,
                clearance,
                tolerance,
            )
            if most_in >= 0:
                move += move_to_crease(surface, pushed + move, own, most_in, needed, clearance, tolerance)
        positions[v] = pushed + move
