"""Bringing synthesised garments into line with a coarse layer (Wang et al. 2010, section 3.4; W80-W86).

Several meshes of one garment are dealt with at once, shapes [mesh_count, fine_count]. All kernels gather, in a fixed
order; the same input gives the same bits.
"""

import warp as wp

from .blend import join_offsets

wp.set_module_options({"enable_backward": False})

# Meshes whose offsets lie side by side, and are read at once.
LANES = 4
mat_lanes = wp.types.matrix((LANES, 3), wp.float32)

COLUMNS = wp.constant(32)
Columns = wp.types.vector(length=int(COLUMNS), dtype=wp.float32)


@wp.kernel
def place_on_coarse(
    first: wp.int32,
    coarse: wp.array[wp.vec3],
    corners: wp.array2d[wp.int32],
    places: wp.array[wp.vec3],
    # outputs
    carried: wp.array[wp.vec3],
):
    """Where each fine vertex lies if it keeps its place on its coarse triangle [m].

    A place is two coordinates along the triangle's edges from its first corner, and the height over it [m].
    Vertices from ``first`` on; each thread of a split launch has its own part, here and below.
    """
    u = first + wp.tid()
    a = coarse[corners[u, 0]]
    b = coarse[corners[u, 1]] - a
    c = coarse[corners[u, 2]] - a
    place = places[u]
    carried[u] = a + place[0] * b + place[1] * c + place[2] * wp.normalize(wp.cross(b, c))


@wp.kernel
def downsample_offsets(
    first: wp.int32,
    coarse: wp.array[wp.vec3],
    carried: wp.array[wp.vec3],
    meshes: wp.array2d[wp.vec3],
    start: wp.array[wp.int32],
    members: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    as_published: wp.bool,
    strength: wp.float32,
    # outputs
    offsets: wp.array2d[mat_lanes],
):
    """Offset of every coarse vertex from the fine vertices around it [m], a row of mesh % LANES of mesh / LANES (eq 5).

    ``weights`` are a_uv over their sum; a coarse vertex without fine ones has no offset, and nothing takes it up. As
    published the offset is from the fine vertices to v itself, which is not zero where the two meshes coincide; here
    it is to where each of them lies on the coarse mesh. ``strength`` is the share of the way that is gone.
    """
    v = first + wp.tid()
    for side in range(offsets.shape[0]):
        found = mat_lanes()
        for k in range(start[v], start[v + 1]):
            u = members[k]
            target = carried[u]
            if as_published:
                target = coarse[v]
            for lane in range(LANES):
                if LANES * side + lane < meshes.shape[0]:
                    found[lane] += weights[k] * (target - meshes[LANES * side + lane, u])
        offsets[side, v] = strength * found


@wp.kernel
def upsample_offsets(
    first: wp.int32,
    offsets: wp.array2d[mat_lanes],
    start: wp.array[wp.int32],
    columns: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    # in and out
    meshes: wp.array2d[wp.vec3],
):
    """Move every fine vertex by the offsets of the coarse vertices around it [m] (eq 6).

    ``weights`` are a_uv after Laplacian smoothing over the fine mesh.
    """
    u = first + wp.tid()
    for side in range(offsets.shape[0]):
        moved = mat_lanes()
        for lane in range(LANES):
            if LANES * side + lane < meshes.shape[0]:
                moved[lane] = meshes[LANES * side + lane, u]
        for k in range(start[u], start[u + 1]):
            moved += weights[k] * offsets[side, columns[k]]
        for lane in range(LANES):
            if LANES * side + lane < meshes.shape[0]:
                meshes[LANES * side + lane, u] = moved[lane]


@wp.kernel
def smooth_columns(
    start: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    step: wp.float32,
    values: wp.array[Columns],
    # outputs
    smoothed: wp.array[Columns],
):
    """One step of Laplacian smoothing of many fields at once: a share of the way to the neighbours' weighted mean."""
    u = wp.tid()
    mean = Columns()
    for k in range(start[u], start[u + 1]):
        mean += weights[k] * values[neighbours[k]]
    smoothed[u] = values[u] + step * (mean - values[u])


@wp.kernel
def blend_meshes(
    meshes: wp.array2d[wp.vec3],
    shares: wp.array2d[wp.float32],
    # outputs
    positions: wp.array[wp.vec3],
):
    """Weighted mean of meshes on every vertex [m]; shares add up to 1, shape [mesh_count, fine_count]."""
    u = wp.tid()
    total = wp.vec3()
    for mesh in range(meshes.shape[0]):
        total += shares[mesh, u] * meshes[mesh, u]
    positions[u] = total


@wp.kernel
def join_meshes(
    first: wp.int32,
    meshes: wp.array2d[wp.vec3],
    # outputs
    positions: wp.array[wp.vec3],
):
    """The first mesh with the other meshes' offsets from it joined, as joints' offsets over skinning are [m]."""
    u = first + wp.tid()
    total = wp.vec3()
    for mesh in range(1, meshes.shape[0]):
        total += meshes[mesh, u] - meshes[0, u]
    largest = wp.float32(0.0)
    for mesh in range(1, meshes.shape[0]):
        largest = wp.max(largest, wp.abs(wp.dot(total, meshes[mesh, u] - meshes[0, u])))
    positions[u] = meshes[0, u] + join_offsets(total, largest)
