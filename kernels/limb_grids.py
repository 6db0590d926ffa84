"""Grids around the limbs of a body: which limbs a point of the pose may be near, and their triangles about it."""

import warp as wp

from .natural import natural
from .posed_surface import LIMB, PosedSurface, height_over_corner, point_at, walk_downhill

wp.set_module_options({"enable_backward": False})

# Height over a near vertex's plane, above all clearance, from which on nothing more needs to be known [m].
PLAINLY_OUTSIDE = wp.constant(0.01)
# From a cell's centre to its corners, in cells, and what rounding may add.
CELL_RADIUS = wp.constant(0.88)


mat_frame = wp.types.matrix((3, 4), wp.float32)


@wp.struct
class LimbGrid:
    """A grid of cells around a limb at rest.

    Attributes:
        frame: What takes points of the pose to cells.
        extent: Cells along the axes, and where they begin among those of all limbs.
    """

    frame: mat_frame
    extent: wp.vec4i


@wp.struct
class GridCell:
    """A cell of a limb's grid.

    Attributes:
        triangle: The limb's triangle closest to its centre, -1 far from the limb.
        gap: How many cells' widths it is to the closest one with a triangle.
    """

    triangle: wp.int32
    gap: wp.float32


@wp.struct
class LimbGrids:
    """The grids around a body's limbs, shape [limb_count], and the cells of all of them in a row."""

    limbs: wp.array[LimbGrid]
    cells: wp.array[GridCell]


@wp.kernel
def fit_limbs(
    points: wp.array[wp.vec3],
    members: wp.array2d[wp.int32],
    rest: wp.array2d[wp.vec3],
    centre: wp.array[wp.vec3],
    cell: wp.float32,
    # outputs
    limbs: wp.array[LimbGrid],
):
    """What takes points of a pose to cells of each limb's grid, by some of its vertices (Kabsch 1976).

    Args:
        points: The body in that pose, in any unit of length.
        members: Vertices that tell how a limb lies, shape [limb_count, member_count].
        rest: Where they lie at rest about their mean [m].
        centre: That mean from the grid's lowest corner [m].
        cell: Size of a cell [m].
    """
    limb = wp.tid()
    count = members.shape[1]
    mean = wp.vec3()
    for k in range(count):
        mean += points[members[limb, k]]
    mean = mean / wp.float32(count)
    spread = wp.mat33()
    size = wp.float32(0.0)
    posed_size = wp.float32(0.0)
    for k in range(count):
        posed = points[members[limb, k]] - mean
        spread += wp.outer(rest[limb, k], posed)
        size += wp.length_sq(rest[limb, k])
        posed_size += wp.length_sq(posed)
    # Both are rotations, strengths have signs: no limb is turned inside out. In single precision they are not found.
    sizes = wp.max(wp.sqrt(size * posed_size), 1.0e-30)
    u, _strength, v = wp.svd3(wp.mat33d(spread / sizes))
    turn = (wp.sqrt(size / wp.max(posed_size, 1.0e-30)) / cell) * wp.mat33(u * wp.transpose(v))
    moved = centre[limb] / cell - turn * mean
    limbs[limb].frame = mat_frame(
        turn[0, 0], turn[0, 1], turn[0, 2], moved[0],
        turn[1, 0], turn[1, 1], turn[1, 2], moved[1],
        turn[2, 0], turn[2, 1], turn[2, 2], moved[2],
    )  # fmt: skip


@wp.func
def cell_number(extent: wp.vec4i, i: wp.int32, j: wp.int32, k: wp.int32) -> wp.int32:
    return extent[3] + (i * extent[1] + j) * extent[2] + k


@wp.func
def cell_triangle(grids: LimbGrids, limb: wp.int32, p: wp.vec3) -> wp.int32:
    """The limb's triangle about a point of the pose; -1 where it is far."""
    found = wp.int32(-1)
    at = grids.limbs[natural(limb)].frame * wp.vec4(p[0], p[1], p[2], 1.0)
    extent = grids.limbs[natural(limb)].extent
    # Before they are whole numbers: of a limb without size, places have no room in those.
    within = at[0] >= 0.0 and at[1] >= 0.0 and at[2] >= 0.0
    for axis in range(3):
        within = within and at[axis] < wp.float32(extent[axis])
    if within:
        found = grids.cells[natural(cell_number(extent, wp.int32(at[0]), wp.int32(at[1]), wp.int32(at[2])))].triangle
    return found


@wp.func
def reaches_limb(grids: LimbGrids, limb: wp.int32, centre: wp.vec3, radius: wp.float32) -> wp.bool:
    """Whether a point of the pose so near to ``centre`` may lie in a cell with a triangle."""
    extent = grids.limbs[limb].extent
    if extent[0] == 0:
        return False
    frame = grids.limbs[limb].frame
    reach = radius * wp.length(wp.vec3(frame[0, 0], frame[0, 1], frame[0, 2])) + CELL_RADIUS
    at = frame * wp.vec4(centre[0], centre[1], centre[2], 1.0)
    within = wp.vec3()
    for axis in range(3):
        within[axis] = wp.clamp(at[axis], 0.0, wp.float32(extent[axis]) - 0.01)
    aside = wp.length_sq(at - within)
    if aside > reach * reach:
        return False
    cell = cell_number(extent, wp.int32(within[0]), wp.int32(within[1]), wp.int32(within[2]))
    # To a place in a box that a point lies beside, it is as far as the two legs of a right angle at least.
    gap = wp.max(grids.cells[cell].gap - CELL_RADIUS, 0.0)
    return aside + gap * gap <= reach * reach


@wp.func
def limbs_around(grids: LimbGrids, low: wp.vec3, high: wp.vec3) -> wp.int32:
    """Limbs, as bits, that have cells with triangles between two corners of the pose: few but a vertex's own."""
    found = wp.int32(0)
    if low[0] <= high[0]:
        centre = 0.5 * (low + high)
        radius = 0.5 * wp.length(high - low)
        for limb in range(grids.limbs.shape[0]):
            if reaches_limb(grids, limb, centre, radius):
                found = found | (1 << limb)
    return found


@wp.func
def limb_triangle(surface: PosedSurface, grids: LimbGrids, limb: wp.int32, p: wp.vec3, metre: wp.float32) -> wp.int32:
    """The limb's triangle about a point of the pose; -1 where the point is plainly outside."""
    found = cell_triangle(grids, limb, p)
    if found >= 0:
        if height_over_corner(surface, found, p) > metre * PLAINLY_OUTSIDE:
            found = wp.int32(-1)
    return found


@wp.func
def distance_downhill(surface: PosedSurface, p: wp.vec3, start: wp.int32) -> wp.float32:
    """How far p is from where a walk from this triangle ends."""
    face, w = walk_downhill(surface, p, start, -1)
    return wp.length(p - point_at(surface.vertices, surface.triangles[natural(face)], w))


@wp.func
def nearer_triangle(surface: PosedSurface, grids: LimbGrids, p: wp.vec3, start: wp.int32) -> wp.int32:
    """Where a walk begins: the triangle under the vertex at rest, or that of its limb's cell now if it is nearer.

    Of a thin limb that is the other side at times. A triangle that the vertex is inside of gives way to one that it is
    outside of, if the walk from that ends nearer.
    """
    found = start
    if grids.limbs.shape[0] > 0:
        under = surface.triangles[natural(start)]
        other = cell_triangle(grids, under[LIMB], p)
        if other >= 0 and other != start:
            near = surface.vertices[natural(under[0])].position - p
            other_corner = surface.triangles[natural(other)][0]
            other_near = surface.vertices[natural(other_corner)].position - p
            if wp.length_sq(other_near) < wp.length_sq(near):
                found = other
                other = start
            if height_over_corner(surface, found, p) < 0.0 and height_over_corner(surface, other, p) > 0.0:
                if distance_downhill(surface, p, other) < distance_downhill(surface, p, found):
                    found = other
    return found
