"""Pushing a garment out of the body that it is worn on (Xu et al. 2014, section 5, eq 11 and 12; S28 to S30).

Every vertex walks over the posed body from the triangle under it at rest to the foot below it. What it lacks there of
its clearance is spread over the garment around it, so that folds are pushed out whole. Then other limbs that came in
its way push, too. All kernels gather, in a fixed order; the same input gives the same bits.
"""

import warp as wp

from .posed_surface import PosedSurface, find_foot, height_over_plane, rise_between

wp.set_module_options({"enable_backward": False})

# Cosines between the skin's normal and another limb's from where on that limb is less, and no wall against it.
ASIDE = wp.constant(wp.vec2(-0.1, 0.3))
# A vertex is moved out of another limb by at most this many times what the shortest way out would take.
OVERSHOOT = wp.constant(3.0)
# Height over the plane of a near triangle, above all clearance, from which on nothing more needs to be known [m].
PLAINLY_OUTSIDE = wp.constant(0.01)


@wp.struct
class LimbGrids:
    """A grid of cells around each limb at rest; each cell knows the limb's triangle closest to its centre.

    Attributes:
        frames: Rows of the matrices that take points of the pose to each limb at rest, shape [limb_count, 3].
        box: Lowest and highest corner of a box around each posed limb and its surroundings, shape [limb_count, 2].
        origin: Lowest corner of each grid, shape [limb_count].
        shape: Cells along the axes, shape [limb_count, 3].
        first: Where each grid's cells begin, shape [limb_count].
        cells: Triangle of every cell, -1 far from the limb.
        width: Size of a cell.
    """

    frames: wp.array2d[wp.vec4]
    box: wp.array2d[wp.vec3]
    origin: wp.array[wp.vec3]
    shape: wp.array2d[wp.int32]
    first: wp.array[wp.int32]
    cells: wp.array[wp.int32]
    width: wp.float32


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
def cell_triangle(grids: LimbGrids, limb: wp.int32, p: wp.vec3) -> wp.int32:
    """The limb's triangle about a point of the pose; -1 where it is far."""
    found = wp.int32(-1)
    low = grids.box[limb, 0]
    high = grids.box[limb, 1]
    if p[0] < low[0] or p[1] < low[1] or p[2] < low[2] or p[0] > high[0] or p[1] > high[1] or p[2] > high[2]:
        return found
    q = wp.vec4(p[0], p[1], p[2], 1.0)
    at = wp.vec3(wp.dot(grids.frames[limb, 0], q), wp.dot(grids.frames[limb, 1], q), wp.dot(grids.frames[limb, 2], q))
    at = (at - grids.origin[limb]) / grids.width
    i = wp.int32(wp.floor(at[0]))
    j = wp.int32(wp.floor(at[1]))
    k = wp.int32(wp.floor(at[2]))
    if i >= 0 and j >= 0 and k >= 0:
        if i < grids.shape[limb, 0] and j < grids.shape[limb, 1] and k < grids.shape[limb, 2]:
            found = grids.cells[grids.first[limb] + (i * grids.shape[limb, 1] + j) * grids.shape[limb, 2] + k]
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

    Where nothing is lacking by far, feet are left out: face -1, and the height is rough.
    """
    v = first + wp.tid()
    p = positions[v]
    needed = needed_height(rest_height[v], clearance)
    below = nearer_triangle(surface, grids, p, start[v])
    over = height_over_plane(surface, below, p) / clearance.metre
    if over > needed + PLAINLY_OUTSIDE:
        face[v] = -1
        height[v] = over
        lack[v] = 0.0
        return
    foot, h, n, trust = find_foot(surface, p, below, tolerance * clearance.metre)
    h = h / clearance.metre
    if h < needed:
        asked = needed
        for limb in range(grids.first.shape[0]):
            if limb != surface.limb[foot]:
                skin = p - h * clearance.metre * n
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
    v = first + wp.tid()
    most = wp.float32(0.0)
    for k in range(begin[v], begin[v + 1]):
        u = neighbours[k]
        most = wp.max(most, lack[u] + wp.length(positions[u] - positions[v]) / clearance.metre)
    believed[v] = wp.min(lack[v], most)


@wp.kernel
def largest_around(
    first: wp.int32,
    begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    values: wp.array[wp.float32],
    # outputs
    largest: wp.array[wp.float32],
):
    """The largest value of each vertex and its neighbours."""
    v = first + wp.tid()
    most = values[v]
    for k in range(begin[v], begin[v + 1]):
        most = wp.max(most, values[neighbours[k]])
    largest[v] = most


@wp.kernel
def mean_around(
    first: wp.int32,
    begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    values: wp.array[wp.float32],
    # outputs
    mean: wp.array[wp.float32],
):
    """Each vertex half way to the mean of its neighbours."""
    v = first + wp.tid()
    total = wp.float32(0.0)
    for k in range(begin[v], begin[v + 1]):
        total += values[neighbours[k]]
    mean[v] = 0.5 * values[v] + 0.5 * total / wp.float32(wp.max(begin[v + 1] - begin[v], 1))


@wp.kernel
def find_missing_feet(
    first: wp.int32,
    positions: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    push: wp.array[wp.float32],
    surface: PosedSurface,
    grids: LimbGrids,
    clearance: Clearance,
    tolerance: wp.float32,
    # in and out
    face: wp.array[wp.int32],
    height: wp.array[wp.float32],
    normal: wp.array[wp.vec3],
):
    """The feet that :func:`find_lacks` left out, where a neighbour's push has spread to."""
    v = first + wp.tid()
    if face[v] < 0 and push[v] > 0.0:
        below = nearer_triangle(surface, grids, positions[v], start[v])
        foot, h, n, _trust = find_foot(surface, positions[v], below, tolerance * clearance.metre)
        face[v] = foot
        height[v] = h / clearance.metre
        normal[v] = n


# --- out of other limbs, and to its place -------------------------------------------------------------------------


@wp.kernel
def push_between_limbs(
    first: wp.int32,
    positions: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    push: wp.array[wp.float32],
    face: wp.array[wp.int32],
    height: wp.array[wp.float32],
    normal: wp.array[wp.vec3],
    rest_height: wp.array[wp.float32],
    surface: PosedSurface,
    grids: LimbGrids,
    clearance: Clearance,
    tolerance: wp.float32,
    moves: wp.array[wp.vec3],
    again: wp.bool,
    # outputs
    further: wp.array[wp.vec3],
):
    """Moves out of the own limb, by the push [m] (eq 11), and out of others, on from where ``moves`` lead."""
    v = first + wp.tid()
    move = moves[v]
    further[v] = move
    if again and wp.length_sq(move) == 0.0:
        return
    needed = needed_height(rest_height[v], clearance)
    place = positions[v]
    own_face = start[v]
    h = height[v]
    n = normal[v]
    if face[v] >= 0:
        own_face = face[v]
        place += push[v] * clearance.metre * n
    for limb in range(grids.first.shape[0]):
        begin = wp.int32(-1)
        if limb != surface.limb[own_face]:
            begin = cell_triangle(grids, limb, place + move)
        if begin >= 0:
            if height_over_plane(surface, begin, place + move) > clearance.metre * PLAINLY_OUTSIDE:
                begin = wp.int32(-1)
        if begin >= 0:
            p = place + move
            _foot, g, m, trust = find_foot(surface, p, begin, tolerance * clearance.metre)
            lack = needed - g / clearance.metre
            if lack > 0.0:
                if face[v] < 0:
                    below = nearer_triangle(surface, grids, positions[v], start[v])
                    own_face, h, n, _sure = find_foot(surface, positions[v], below, tolerance * clearance.metre)
                    h = h / clearance.metre
                skin = positions[v] - h * clearance.metre * n
                wall, wall_height, sure, apart = facing_wall(surface, grids, limb, skin, n, clearance, tolerance)
                now = wp.dot(p - skin, n) / clearance.metre
                g = wall_height + wp.dot(p - skin, wall) / clearance.metre
                asked = height_between(needed, g, now, wp.max(-wp.dot(wall, n), 0.0))
                between = softened(wp.min(asked - g, OVERSHOOT * lack), clearance.soft, clearance.deep)
                shortest = trust * softened(lack, clearance.soft, clearance.overlap)
                move += apart * clearance.metre * (sure * between * wall + (1.0 - sure) * shortest * m)
    further[v] = move


@wp.kernel
def mean_move_around(
    first: wp.int32,
    begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    moves: wp.array[wp.vec3],
    # outputs
    mean: wp.array[wp.vec3],
):
    """Each vertex's move half way to the mean of its neighbours'."""
    v = first + wp.tid()
    total = wp.vec3()
    for k in range(begin[v], begin[v + 1]):
        total += moves[neighbours[k]]
    mean[v] = 0.5 * moves[v] + 0.5 * total / wp.float32(wp.max(begin[v + 1] - begin[v], 1))


@wp.kernel
def push_out(
    first: wp.int32,
    push: wp.array[wp.float32],
    normal: wp.array[wp.vec3],
    moves: wp.array[wp.vec3],
    clearance: Clearance,
    # in and out
    positions: wp.array[wp.vec3],
):
    """Move every vertex by its push [m] along its normal (eq 11), and on out of other limbs."""
    v = first + wp.tid()
    if push[v] > 0.0:
        positions[v] = positions[v] + push[v] * clearance.metre * normal[v]
    positions[v] = positions[v] + moves[v]
