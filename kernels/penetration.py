"""Pushing a garment out of the body that it is worn on (Xu et al. 2014, section 5, eq 11 and 12; S28 to S30).

Every vertex walks over the posed body from the triangle under it at rest to the foot below it. What it lacks there of
its clearance is spread over the garment around it, so that folds are pushed out whole. Then other limbs that came in
its way push, too (:mod:`.limb_pushes`). All kernels gather, in a fixed order; the same input gives the same bits. A
thread deals with a block of vertices, on a GPU with one: what surface and grids it is given, it reads once.
"""

import warp as wp

from .limb_grids import PLAINLY_OUTSIDE, LimbGrids, cell_triangle, limbs_around, nearer_triangle
from .natural import natural
from .posed_surface import LIMB, PosedSurface, find_foot, find_foot_within, height_over_corner, rise_between
from .spreading import Neighbours

wp.set_module_options({"enable_backward": False})

# Cosines between the skin's normal and another limb's from where on that limb is less, and no wall against it.
ASIDE = wp.constant(wp.vec2(-0.1, 0.3))
# Heights of neighbours differ by at most this many times what the two are apart.
UNLIKE = wp.constant(1.5)
# A vertex is nearly outside where it lies at most this part as deep as elsewhere.
SHALLOWER = wp.constant(0.25)
# Vertices next to each other, in the order that they are dealt with, for which limbs near them are looked for at once.
CLUSTER = wp.constant(64)
# Farther than any point of the pose.
NOWHERE = wp.constant(wp.float32(1.0e30))


@wp.struct
class Clearance:
    """How a garment is kept clear.

    Attributes:
        metre: Length of a metre in the space of the positions.
        most: Height that is enough, whatever it was at rest [m].
        soft: Lack up to which pushing sets in gently [m].
        deep: Lacks at which pushing begins to fade and has faded [m]: that far in, a foot means nothing.
        overlap: Depths of a limb in another one at which they begin to be, and are, too deep to push cloth between [m].
        crease: Distances from where two limbs meet at which cloth in both begins to be, and is, left inside [m].
    """

    metre: wp.float32
    most: wp.float32
    soft: wp.float32
    deep: wp.vec2
    overlap: wp.vec2
    crease: wp.vec2


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
def facing_wall(
    surface: PosedSurface,
    grids: LimbGrids,
    limb: wp.int32,
    otherwise: wp.int32,
    skin: wp.vec3,
    normal: wp.vec3,
    clearance: Clearance,
    tolerance: wp.float32,
):
    """The wall that another limb puts up against a place on the skin: normal, height of the place over it [m], how sure
    it is one, and how far the limbs are apart (0 where they are so deep in each other that nothing is between them).

    Cloth belongs between the two, whichever way is shorter out of the other limb. What looks the same way as the skin
    itself is no wall. Where the limb's grid does not reach, it is looked for from the triangle ``otherwise`` (-1: there
    is none).
    """
    start = cell_triangle(grids, limb, skin)
    if start < 0:
        start = otherwise
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
def asked_height(
    surface: PosedSurface,
    grids: LimbGrids,
    near: wp.int32,
    skin: wp.vec3,
    normal: wp.vec3,
    height: wp.float32,
    needed: wp.float32,
    clearance: Clearance,
    tolerance: wp.float32,
) -> wp.float32:
    """Height that is asked for at a place on the skin [m]: less than ``needed`` where other limbs leave no room."""
    asked = needed
    for limb in range(grids.limbs.shape[0]):
        if (near >> limb) & 1 != 0:
            wall, wall_height, sure, _apart = facing_wall(surface, grids, limb, -1, skin, normal, clearance, tolerance)
            cosine = wp.dot(wall, normal)
            facing = sure * wp.max(-cosine, 0.0)
            asked = wp.min(asked, height_between(needed, height, wall_height + cosine * height, facing))
    return asked


@wp.func
def lack_over(
    surface: PosedSurface,
    grids: LimbGrids,
    limbs: wp.int32,
    position: wp.vec3,
    foot: wp.int32,
    height: wp.float32,
    normal: wp.vec3,
    needed: wp.float32,
    clearance: Clearance,
    tolerance: wp.float32,
) -> wp.float32:
    """Push that a vertex needs over its foot [m], where these limbs are around."""
    asked = needed
    near = limbs & ~(1 << surface.triangles[natural(foot)][LIMB])
    if near != 0:
        skin = position - height * clearance.metre * normal
        asked = asked_height(surface, grids, near, skin, normal, height, needed, clearance, tolerance)
    return softened(asked - height, clearance.soft, clearance.deep)


@wp.kernel
def find_lacks(
    first: wp.int32,
    block_size: wp.int32,
    order: wp.array[wp.int32],
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
    end = wp.min(block + block_size, positions.shape[0])
    for cluster in range(block, end, CLUSTER):
        stop = wp.min(cluster + CLUSTER, end)
        low = wp.vec3(NOWHERE)
        high = wp.vec3(-NOWHERE)
        for i in range(cluster, stop):
            v = natural(order[natural(i)])
            p = positions[v]
            needed = needed_height(rest_height[v], clearance)
            below = nearer_triangle(surface, grids, p, start[v])
            foot = wp.int32(-1)
            h = height_over_corner(surface, below, p)
            n = wp.vec3()
            trust = wp.float32(0.0)
            enough = needed * clearance.metre
            if h <= enough + PLAINLY_OUTSIDE * clearance.metre:
                foot, h, n, trust = find_foot_within(surface, p, below, -1, tolerance * clearance.metre, enough)
                if h < enough:
                    low = wp.min(low, p - h * n)
                    high = wp.max(high, p - h * n)
            face[v] = foot
            height[v] = h / clearance.metre
            normal[v] = n
            lack[v] = trust
        limbs = limbs_around(grids, low, high)
        for i in range(cluster, stop):
            v = natural(order[natural(i)])
            h = height[v]
            needed = needed_height(rest_height[v], clearance)
            if face[v] >= 0 and h < needed:
                foot = face[v]
                n = normal[v]
                lack[v] *= lack_over(surface, grids, limbs, positions[v], foot, h, n, needed, clearance, tolerance)
            else:
                lack[v] = 0.0


@wp.kernel
def mend_feet(
    first: wp.int32,
    block_size: wp.int32,
    neighbours: Neighbours,
    positions: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    rest_height: wp.array[wp.float32],
    found_face: wp.array[wp.int32],
    found_height: wp.array[wp.float32],
    found_normal: wp.array[wp.vec3],
    found_lack: wp.array[wp.float32],
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
    """The feet that :func:`find_lacks` found, or nearer ones that neighbours lead to.

    A walk may end in a crook, on skin that goes away from the vertex again before it comes near. A neighbour whose
    height is another by more than the two are apart (no distance from a body is) knows of better skin: if the vertex is
    nearly outside there, then it does not lie deep inside.
    """
    block = (first + wp.tid()) * block_size
    for i in range(block, wp.min(block + block_size, positions.shape[0])):
        v = natural(i)
        p = positions[v]
        foot = found_face[v]
        h = found_height[v]
        n = found_normal[v]
        needed_push = found_lack[v]
        if foot >= 0 and h < 0.0:
            needed = needed_height(rest_height[v], clearance)
            nearest = -h
            for k in range(neighbours.begin[v], neighbours.begin[v + 1]):
                u = neighbours.all[k]
                apart = wp.length(positions[u] - p) / clearance.metre
                if found_height[u] - found_height[v] > UNLIKE * apart:
                    begin = found_face[u]
                    if begin < 0:
                        begin = nearer_triangle(surface, grids, positions[u], start[u])
                    other, other_height, other_normal, trust = find_foot(surface, p, begin, tolerance * clearance.metre)
                    other_height /= clearance.metre
                    if other_height > SHALLOWER * found_height[v] and wp.abs(other_height) < nearest:
                        foot = other
                        h = other_height
                        n = other_normal
                        nearest = wp.abs(h)
                        skin = p - h * clearance.metre * n
                        limbs = limbs_around(grids, skin, skin)
                        needed_push = trust * lack_over(
                            surface, grids, limbs, p, foot, h, n, needed, clearance, tolerance
                        )
        face[v] = foot
        height[v] = h
        normal[v] = n
        lack[v] = needed_push
