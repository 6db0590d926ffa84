"""Pushing a garment out of the body that it is worn on (Xu et al. 2014, section 5, eq 11 and 12; S28 to S30).

Every vertex walks over the posed body from the triangle under it at rest to the foot below it. What it lacks there of
its clearance is spread over the garment around it, so that folds are pushed out whole. Then other limbs that came in
its way push, too. All kernels gather, in a fixed order; the same input gives the same bits. A thread deals with a block
of vertices, on a GPU with one: what surface and grids it is given, it reads once.
"""

import warp as wp

from .posed_surface import PosedSurface, find_foot, height_over_corner, rise_between

wp.set_module_options({"enable_backward": False})

# Cosines between the skin's normal and another limb's from where on that limb is less, and no wall against it.
ASIDE = wp.constant(wp.vec2(-0.1, 0.3))
# A vertex is moved out of another limb by at most this many times what the shortest way out would take.
OVERSHOOT = wp.constant(3.0)
# Height over a near vertex's plane, above all clearance, from which on nothing more needs to be known [m].
PLAINLY_OUTSIDE = wp.constant(0.01)
# Boxes along each axis that the posed space is divided into.
BOXES = wp.constant(12)


@wp.struct
class LimbGrids:
    """A grid of cells around each limb at rest; each cell knows the limb's triangle closest to its centre.

    Attributes:
        frames: Rows of the matrices that take points of the pose to each limb at rest, shape [limb_count, 3].
        origin: Lowest corner of each grid, shape [limb_count].
        shape: Cells along the axes, shape [limb_count, 3].
        first: Where each grid's cells begin, shape [limb_count].
        cells: Triangle of every cell, -1 far from the limb.
        width: Size of a cell.
        near: Limbs, as bits, that points of each box of the posed space may be near; see :func:`find_near_limbs`.
        corner: Lowest corner of those boxes.
        box: Their size along the axes.
    """

    frames: wp.array2d[wp.vec4]
    origin: wp.array[wp.vec3]
    shape: wp.array2d[wp.int32]
    first: wp.array[wp.int32]
    cells: wp.array[wp.int32]
    width: wp.float32
    near: wp.array[wp.int32]
    corner: wp.vec3
    box: wp.vec3


@wp.struct
class Clearance:
    """How a garment is kept clear.

    Attributes:
        metre: Length of a metre in the space of the positions.
        most: Height that is enough, whatever it was at rest [m].
        soft: Lack up to which pushing sets in gently [m].
        deep: Lacks at which pushing begins to fade and has faded [m]: that far in, a foot means nothing.
        overlap: Depths of a limb in another one at which they begin to be, and are, too deep to push cloth between [m].
    """

    metre: wp.float32
    most: wp.float32
    soft: wp.float32
    deep: wp.vec2
    overlap: wp.vec2


# --- out of the limb that the vertex is worn on -------------------------------------------------------------------


@wp.kernel
def heights_over_surface(
    positions: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    surface: PosedSurface,
    tolerance: wp.float32,
    # outputs
    height: wp.array[wp.float32],
):
    """Height of every vertex over its foot."""
    v = wp.tid()
    _foot, h, _normal, _trust = find_foot(surface, positions[v], start[v], tolerance)
    height[v] = h


@wp.func
def softened(lack: wp.float32, soft: wp.float32, deep: wp.vec2) -> wp.float32:
    """Push that a lack asks for [m]: it sets in without a kink, and fades where the vertex lies too deep."""
    x = wp.max(lack, 0.0)
    push = wp.where(x < soft, 0.5 * x * x / soft, x - 0.5 * soft)
    return push * (1.0 - rise_between(x, deep[0], deep[1]))


@wp.func
def needed_height(rest_height: wp.float32, clearance: Clearance) -> wp.float32:
    """d0 of eq 12 [m]: what it was at rest, if that is less than enough."""
    return wp.min(rest_height, clearance.most)


@wp.func
def height_between(needed: wp.float32, height: wp.float32, other: wp.float32, facing: wp.float32) -> wp.float32:
    """Height that a wall can ask for [m] if another one, ``other`` [m] away, faces it: half of the room between them.

    ``facing`` is 1 for walls that look at each other, 0 for walls at right angles or on the same side.
    """
    return needed - facing * wp.max(needed - 0.5 * (height + other), 0.0)


@wp.func
def in_limb_grid(grids: LimbGrids, limb: wp.int32, p: wp.vec3) -> wp.vec3:
    """A point of the pose in cells of a limb's grid."""
    q = wp.vec4(p[0], p[1], p[2], 1.0)
    at = wp.vec3(wp.dot(grids.frames[limb, 0], q), wp.dot(grids.frames[limb, 1], q), wp.dot(grids.frames[limb, 2], q))
    return (at - grids.origin[limb]) / grids.width


@wp.func
def cell_triangle(grids: LimbGrids, limb: wp.int32, p: wp.vec3) -> wp.int32:
    """The limb's triangle about a point of the pose; -1 where it is far."""
    found = wp.int32(-1)
    at = in_limb_grid(grids, limb, p)
    i = wp.int32(wp.floor(at[0]))
    j = wp.int32(wp.floor(at[1]))
    k = wp.int32(wp.floor(at[2]))
    if i >= 0 and j >= 0 and k >= 0:
        if i < grids.shape[limb, 0] and j < grids.shape[limb, 1] and k < grids.shape[limb, 2]:
            found = grids.cells[grids.first[limb] + (i * grids.shape[limb, 1] + j) * grids.shape[limb, 2] + k]
    return found


@wp.kernel
def find_near_limbs(
    grids: LimbGrids,
    # outputs
    near: wp.array[wp.int32],
):
    """Limbs whose grids reach into each box of the posed space, as bits: few points are near any but their own."""
    number = wp.tid()
    k = number % BOXES
    j = (number // BOXES) % BOXES
    i = number // (BOXES * BOXES)
    place = wp.vec3(wp.float32(i) + 0.5, wp.float32(j) + 0.5, wp.float32(k) + 0.5)
    centre = grids.corner + wp.cw_mul(grids.box, place)
    bits = wp.int32(0)
    for limb in range(grids.first.shape[0]):
        at = in_limb_grid(grids, limb, centre)
        reaches = wp.int32(1)
        for axis in range(3):
            row = grids.frames[limb, axis]
            # From a box's centre to its sides, in cells.
            margin = 0.5 * wp.dot(wp.abs(wp.vec3(row[0], row[1], row[2])), grids.box) / grids.width
            if at[axis] < -margin or at[axis] > wp.float32(grids.shape[limb, axis]) + margin:
                reaches = wp.int32(0)
        bits = bits | (reaches << limb)
    near[number] = bits


@wp.func
def near_limbs(grids: LimbGrids, p: wp.vec3, own: wp.int32) -> wp.int32:
    """Limbs, as bits, that a point of the pose may be near, without its own."""
    found = wp.int32(0)
    at = wp.cw_div(p - grids.corner, grids.box)
    i = wp.int32(wp.floor(at[0]))
    j = wp.int32(wp.floor(at[1]))
    k = wp.int32(wp.floor(at[2]))
    if i >= 0 and j >= 0 and k >= 0 and i < BOXES and j < BOXES and k < BOXES:
        found = grids.near[(i * BOXES + j) * BOXES + k] & ~(1 << own)
    return found


@wp.func
def facing_wall(
    surface: PosedSurface,
    grids: LimbGrids,
    limb: wp.int32,
    skin: wp.vec3,
    normal: wp.vec3,
    clearance: Clearance,
    tolerance: wp.float32,
):
    """The wall that another limb puts up against a place on the skin: normal, height of the place over it [m], how sure
    it is one, and how far the limbs are apart (0 where they are so deep in each other that nothing is between them).

    Cloth belongs between the two, whichever way is shorter out of the other limb. What looks the same way as the skin
    itself is no wall.
    """
    start = cell_triangle(grids, limb, skin)
    wall = normal
    height = wp.float32(0.0)
    trust = wp.float32(0.0)
    apart = wp.float32(1.0)
    if start >= 0:
        _foot, h, wall, trust = find_foot(surface, skin, start, tolerance * clearance.metre)
        height = h / clearance.metre
        trust *= 1.0 - rise_between(wp.dot(wall, normal), ASIDE[0], ASIDE[1])
        apart = 1.0 - trust * rise_between(-height, clearance.overlap[0], clearance.overlap[1])
    return wall, height, trust, apart


@wp.func
def nearer_triangle(surface: PosedSurface, grids: LimbGrids, p: wp.vec3, start: wp.int32) -> wp.int32:
    """Where a walk begins: the triangle under the vertex at rest, or that of its limb's cell now if it is nearer."""
    found = start
    if grids.first.shape[0] > 0:
        other = cell_triangle(grids, surface.limb[start], p)
        if other >= 0:
            near = surface.points[surface.faces[start, 0]] - p
            other_near = surface.points[surface.faces[other, 0]] - p
            if wp.length_sq(other_near) < wp.length_sq(near):
                found = other
    return found


@wp.kernel
def find_lacks(
    first: wp.int32,
    block_size: wp.int32,
    positions: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    rest_height: wp.array[wp.float32],
    surface: PosedSurface,
    grids: LimbGrids,
    clearance: Clearance,
    tolerance: wp.float32,
    # outputs
    face: wp.array[wp.int32],
    height: wp.array[wp.float32],
    normal: wp.array[wp.vec3],
    lack: wp.array[wp.float32],
):
    """Foot of every vertex, its height over it [m], its normal, and the push that it needs [m] (eq 12).

    Where nothing is lacking by far, feet are left out: face -1, no normal, and the height is rough.
    """
    block = (first + wp.tid()) * block_size
    for v in range(block, wp.min(block + block_size, positions.shape[0])):
        p = positions[v]
        needed = needed_height(rest_height[v], clearance)
        below = nearer_triangle(surface, grids, p, start[v])
        over = height_over_corner(surface, below, p) / clearance.metre
        if over > needed + PLAINLY_OUTSIDE:
            face[v] = -1
            height[v] = over
            normal[v] = wp.vec3()
            lack[v] = 0.0
            continue
        foot, h, n, trust = find_foot(surface, p, below, tolerance * clearance.metre)
        h = h / clearance.metre
        if h < needed:
            asked = needed
            skin = p - h * clearance.metre * n
            near = near_limbs(grids, skin, surface.limb[foot])
            for limb in range(grids.first.shape[0]):
                if (near >> limb) & 1 != 0:
                    wall, wall_height, sure, _apart = facing_wall(surface, grids, limb, skin, n, clearance, tolerance)
                    cosine = wp.dot(wall, n)
                    facing = sure * wp.max(-cosine, 0.0)
                    asked = wp.min(asked, height_between(needed, h, wall_height + cosine * h, facing))
            needed = asked
        face[v] = foot
        height[v] = h
        normal[v] = n
        lack[v] = trust * softened(needed - h, clearance.soft, clearance.deep)


@wp.kernel
def believable_lacks(
    first: wp.int32,
    block_size: wp.int32,
    positions: wp.array[wp.vec3],
    begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    lack: wp.array[wp.float32],
    clearance: Clearance,
    # outputs
    believed: wp.array[wp.float32],
):
    """Lacks that no vertex alone has [m]: heights of neighbours differ by no more than they are apart.

    In a crook a lone vertex may find its foot on the wrong side of the limb.
    """
    block = (first + wp.tid()) * block_size
    for v in range(block, wp.min(block + block_size, positions.shape[0])):
        most = wp.float32(0.0)
        if lack[v] > 0.0:
            for k in range(begin[v], begin[v + 1]):
                u = neighbours[k]
                most = wp.max(most, lack[u] + wp.length(positions[u] - positions[v]) / clearance.metre)
        believed[v] = wp.min(lack[v], most)


@wp.kernel
def largest_around(
    first: wp.int32,
    block_size: wp.int32,
    begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    values: wp.array[wp.float32],
    # outputs
    largest: wp.array[wp.float32],
):
    """The largest value of each vertex and its neighbours."""
    block = (first + wp.tid()) * block_size
    for v in range(block, wp.min(block + block_size, values.shape[0])):
        most = values[v]
        for k in range(begin[v], begin[v + 1]):
            most = wp.max(most, values[neighbours[k]])
        largest[v] = most


@wp.kernel
def mean_around(
    first: wp.int32,
    block_size: wp.int32,
    begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    values: wp.array[wp.float32],
    # outputs
    mean: wp.array[wp.float32],
):
    """Each vertex half way to the mean of its neighbours."""
    block = (first + wp.tid()) * block_size
    for v in range(block, wp.min(block + block_size, values.shape[0])):
        total = wp.float32(0.0)
        for k in range(begin[v], begin[v + 1]):
            total += values[neighbours[k]]
        mean[v] = 0.5 * values[v] + 0.5 * total / wp.float32(wp.max(begin[v + 1] - begin[v], 1))


# --- out of other limbs, and to its place -------------------------------------------------------------------------


@wp.func
def limb_triangle(surface: PosedSurface, grids: LimbGrids, limb: wp.int32, p: wp.vec3, metre: wp.float32) -> wp.int32:
    """The limb's triangle about a point of the pose; -1 where the point is plainly outside."""
    found = cell_triangle(grids, limb, p)
    if found >= 0:
        if height_over_corner(surface, found, p) > metre * PLAINLY_OUTSIDE:
            found = wp.int32(-1)
    return found


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
    clearance: Clearance,
    tolerance: wp.float32,
) -> wp.vec3:
    """Move out of another limb of a vertex that now is at p, near its triangle ``begin``.

    ``height`` [m] and ``normal`` are those of where it was over its own limb; without a normal they are not known yet.
    """
    move = wp.vec3()
    _foot, g, m, trust = find_foot(surface, p, begin, tolerance * clearance.metre)
    lack = needed - g / clearance.metre
    if lack > 0.0:
        n = normal
        h = height * clearance.metre
        if wp.length_sq(n) == 0.0:
            below = nearer_triangle(surface, grids, position, own)
            _face, h, n, _sure = find_foot(surface, position, below, tolerance * clearance.metre)
        skin = position - h * n
        wall, wall_height, sure, apart = facing_wall(surface, grids, limb, skin, n, clearance, tolerance)
        now = wp.dot(p - skin, n) / clearance.metre
        g = wall_height + wp.dot(p - skin, wall) / clearance.metre
        asked = height_between(needed, g, now, wp.max(-wp.dot(wall, n), 0.0))
        between = softened(wp.min(asked - g, OVERSHOOT * lack), clearance.soft, clearance.deep)
        shortest = trust * softened(lack, clearance.soft, clearance.overlap)
        move = apart * clearance.metre * (sure * between * wall + (1.0 - sure) * shortest * m)
    return move


@wp.kernel
def push_between_limbs(
    first: wp.int32,
    block_size: wp.int32,
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
):
    """Moves out of other limbs of what :func:`push_out` pushes out of its own.

    The feet that :func:`find_lacks` left out are found here, where a neighbour's push has spread to.
    """
    block = (first + wp.tid()) * block_size
    for v in range(block, wp.min(block + block_size, positions.shape[0])):
        p = positions[v]
        if face[v] < 0 and push[v] > 0.0:
            below = nearer_triangle(surface, grids, p, start[v])
            foot, h, n, _trust = find_foot(surface, p, below, tolerance * clearance.metre)
            face[v] = foot
            height[v] = h / clearance.metre
            normal[v] = n
        own = wp.where(face[v] >= 0, face[v], start[v])
        needed = needed_height(rest_height[v], clearance)
        pushed = p + push[v] * clearance.metre * normal[v]
        move = wp.vec3()
        near = near_limbs(grids, pushed, surface.limb[own])
        for limb in range(grids.first.shape[0]):
            if (near >> limb) & 1 != 0:
                begin = limb_triangle(surface, grids, limb, pushed + move, clearance.metre)
                if begin >= 0:
                    move += move_out_of_limb(
                        surface,
                        grids,
                        limb,
                        begin,
                        pushed + move,
                        p,
                        own,
                        height[v],
                        normal[v],
                        needed,
                        clearance,
                        tolerance,
                    )
        moves[v] = move


@wp.kernel
def push_out(
    first: wp.int32,
    block_size: wp.int32,
    begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    start: wp.array[wp.int32],
    rest_height: wp.array[wp.float32],
    push: wp.array[wp.float32],
    face: wp.array[wp.int32],
    height: wp.array[wp.float32],
    normal: wp.array[wp.vec3],
    moves: wp.array[wp.vec3],
    surface: PosedSurface,
    grids: LimbGrids,
    clearance: Clearance,
    tolerance: wp.float32,
    # in and out
    positions: wp.array[wp.vec3],
):
    """Move every vertex by its push [m] along its normal (eq 11), and on out of other limbs.

    There it goes half way to where its neighbours go, and out of what is still in its way then.
    """
    block = (first + wp.tid()) * block_size
    for v in range(block, wp.min(block + block_size, positions.shape[0])):
        total = wp.vec3()
        for k in range(begin[v], begin[v + 1]):
            total += moves[neighbours[k]]
        move = 0.5 * moves[v] + 0.5 * total / wp.float32(wp.max(begin[v + 1] - begin[v], 1))
        p = positions[v]
        pushed = p + push[v] * clearance.metre * normal[v]
        if wp.length_sq(move) > 0.0:
            own = wp.where(face[v] >= 0, face[v], start[v])
            needed = needed_height(rest_height[v], clearance)
            near = near_limbs(grids, pushed + move, surface.limb[own])
            for limb in range(grids.first.shape[0]):
                if (near >> limb) & 1 != 0:
                    here = limb_triangle(surface, grids, limb, pushed + move, clearance.metre)
                    if here >= 0:
                        move += move_out_of_limb(
                            surface,
                            grids,
                            limb,
                            here,
                            pushed + move,
                            p,
                            own,
                            height[v],
                            normal[v],
                            needed,
                            clearance,
                            tolerance,
                        )
        positions[v] = pushed + move
