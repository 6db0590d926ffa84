"""Grids around the limbs of a body: which limbs a point of the pose may be near, and their triangles about it."""

import warp as wp

from .posed_surface import LIMB, PosedSurface, height_over_corner, interpolated, walk_downhill

wp.set_module_options({"enable_backward": False})

# Height over a near vertex's plane, above all clearance, from which on nothing more needs to be known [m].
PLAINLY_OUTSIDE = wp.constant(0.01)
# From a cell's centre to its corners, in cells, and what rounding may add.
CELL_RADIUS = wp.constant(0.88)


mat_frame = wp.types.matrix((3, 4), wp.float32)


@wp.struct
class LimbGrids:
    """A grid of cells around each limb at rest; each cell knows the limb's triangle closest to its centre.

    Attributes:
        frames: What takes points of the pose to cells of each limb's grid, shape [limb_count].
        extents: Cells along the axes, and where each grid's cells begin, shape [limb_count].
        cells: Triangle of every cell, -1 far from the limb.
        gaps: How many cells' widths it is from every cell to the closest one with a triangle.
    """

    frames: wp.array[mat_frame]
    extents: wp.array[wp.vec4i]
    cells: wp.array[wp.int32]
    gaps: wp.array[wp.float32]


@wp.func
def cell_number(extent: wp.vec4i, i: wp.int32, j: wp.int32, k: wp.int32) -> wp.int32:
    return extent[3] + (i * extent[1] + j) * extent[2] + k


@wp.func
def cell_triangle(grids: LimbGrids, limb: wp.int32, p: wp.vec3) -> wp.int32:
    """The limb's triangle about a point of the pose; -1 where it is far."""
    found = wp.int32(-1)
    at = grids.frames[limb] * wp.vec4(p[0], p[1], p[2], 1.0)
    if at[0] >= 0.0 and at[1] >= 0.0 and at[2] >= 0.0:
        i = wp.int32(at[0])
        j = wp.int32(at[1])
        k = wp.int32(at[2])
        extent = grids.extents[limb]
        if i < extent[0] and j < extent[1] and k < extent[2]:
            found = grids.cells[cell_number(extent, i, j, k)]
    return found


@wp.func
def reaches_limb(grids: LimbGrids, limb: wp.int32, centre: wp.vec3, radius: wp.float32) -> wp.bool:
    """Whether a point of the pose so near to ``centre`` may lie in a cell with a triangle."""
    extent = grids.extents[limb]
    if extent[0] == 0:
        return False
    frame = grids.frames[limb]
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
    gap = wp.max(grids.gaps[cell] - CELL_RADIUS, 0.0)
    return aside + gap * gap <= reach * reach


@wp.func
def limbs_around(grids: LimbGrids, low: wp.vec3, high: wp.vec3) -> wp.int32:
    """Limbs, as bits, that have cells with triangles between two corners of the pose: few but a vertex's own."""
    found = wp.int32(0)
    if low[0] <= high[0]:
        centre = 0.5 * (low + high)
        radius = 0.5 * wp.length(high - low)
        for limb in range(grids.extents.shape[0]):
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
    return wp.length(p - interpolated(surface.points, surface.triangles[face], w))


@wp.func
def nearer_triangle(surface: PosedSurface, grids: LimbGrids, p: wp.vec3, start: wp.int32) -> wp.int32:
    """Where a walk begins: the triangle under the vertex at rest, or that of its limb's cell now if it is nearer.

    Of a thin limb that is the other side at times. A triangle that the vertex is inside of gives way to one that it is
    outside of, if the walk from that ends nearer.
    """
    found = start
    if grids.extents.shape[0] > 0:
        under = surface.triangles[start]
        other = cell_triangle(grids, under[LIMB], p)
        if other >= 0 and other != start:
            near = surface.points[under[0]] - p
            other_near = surface.points[surface.triangles[other][0]] - p
            if wp.length_sq(other_near) < wp.length_sq(near):
                found = other
                other = start
            if height_over_corner(surface, found, p) < 0.0 and height_over_corner(surface, other, p) > 0.0:
                if distance_downhill(surface, p, other) < distance_downhill(surface, p, found):
                    found = other
    return found
