"""Bringing synthesised garments into line with a coarse layer (Wang et al. 2010, section 3.4; W80-W86).

Several meshes of one garment are dealt with at once, shapes [mesh_count, fine_count]. All kernels gather, in a fixed
order; the same input gives the same bits.
"""

import warp as wp

from .blend import join_offsets

wp.set_module_options({"enable_backward": False})

# Meshes whose offsets lie side by side, and are read at once.
LANES = 3
mat_lanes = wp.types.matrix((LANES, 3), wp.float32)

COLUMNS = wp.constant(32)
Columns = wp.types.vector(length=int(COLUMNS), dtype=wp.float32)


@wp.kernel
def downsample_meshes(
    first: wp.int32,
    meshes: wp.array2d[wp.vec3],
    start: wp.array[wp.int32],
    members: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    # outputs
    means: wp.array2d[mat_lanes],
):
    """Mean of the fine vertices around every coarse one [m], a row of mesh % LANES of mesh / LANES (eq 5).

    ``weights`` are a_uv over their sum; a coarse vertex without fine ones has no mean, and nothing takes it up.
    Vertices from ``first`` on; each thread of a split launch has its own part, here and below.
    """
    v = first + wp.tid()
    for side in range(means.shape[0]):
        found = mat_lanes()
        for k in range(start[v], start[v + 1]):
            for lane in range(LANES):
                if LANES * side + lane < meshes.shape[0]:
                    found[lane] += weights[k] * meshes[LANES * side + lane, members[k]]
        means[side, v] = found


@wp.func
def detach_vertex(
    u: wp.int32,
    means: wp.array2d[mat_lanes],
    start: wp.array[wp.int32],
    columns: wp.array[wp.vec4i],
    weights: wp.array[wp.vec4],
    strength: wp.float32,
    # in and out
    meshes: wp.array2d[wp.vec3],
):
    """Take the coarse vertices' means away from a fine vertex of every mesh [m]."""
    for side in range(means.shape[0]):
        taken = mat_lanes()
        for k in range(start[u], start[u + 1]):
            c = columns[k]
            w = weights[k]
            taken += (w[0] * means[side, c[0]] + w[1] * means[side, c[1]]) + (
                w[2] * means[side, c[2]] + w[3] * means[side, c[3]]
            )
        for lane in range(LANES):
            if LANES * side + lane < meshes.shape[0]:
                meshes[LANES * side + lane, u] -= strength * taken[lane]


@wp.kernel
def detach_meshes(
    first: wp.int32,
    means: wp.array2d[mat_lanes],
    start: wp.array[wp.int32],
    columns: wp.array[wp.vec4i],
    weights: wp.array[wp.vec4],
    strength: wp.float32,
    # in and out
    meshes: wp.array2d[wp.vec3],
):
    """Take the coarse vertices' means away from every fine vertex [m], ``strength`` of them (eq 6's second half).

    ``weights`` are a_uv after Laplacian smoothing over the fine mesh, four at a time.
    """
    detach_vertex(first + wp.tid(), means, start, columns, weights, strength, meshes)


@wp.kernel
def join_detached_meshes(
    first: wp.int32,
    means: wp.array2d[mat_lanes],
    start: wp.array[wp.int32],
    columns: wp.array[wp.vec4i],
    weights: wp.array[wp.vec4],
    strength: wp.float32,
    # in and out
    meshes: wp.array2d[wp.vec3],
    # outputs
    positions: wp.array[wp.vec3],
):
    """As :func:`detach_meshes`; then the first mesh with the others' offsets from it joined as joints' are [m]."""
    u = first + wp.tid()
    detach_vertex(u, means, start, columns, weights, strength, meshes)
    total = wp.vec3()
    for mesh in range(1, meshes.shape[0]):
        total += meshes[mesh, u] - meshes[0, u]
    largest = wp.float32(0.0)
    for mesh in range(1, meshes.shape[0]):
        largest = wp.max(largest, wp.abs(wp.dot(total, meshes[mesh, u] - meshes[0, u])))
    positions[u] = meshes[0, u] + join_offsets(total, largest)


@wp.kernel
def place_means(
    first: wp.int32,
    coarse: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    columns: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    height_start: wp.array[wp.int32],
    triangles: wp.array[wp.vec3i],
    heights: wp.array[wp.float32],
    # outputs
    means: wp.array[wp.vec3],
):
    """Where the means of :func:`downsample_meshes` belong as the coarse layer lies [m].

    Sums over the coarse vertices around, by weights, and over the normals of the triangles around, by heights [m].
    """
    v = first + wp.tid()
    mean = wp.vec3()
    for k in range(start[v], start[v + 1]):
        mean += weights[k] * coarse[columns[k]]
    for k in range(height_start[v], height_start[v + 1]):
        corners = triangles[k]
        a = coarse[corners[0]]
        mean += heights[k] * wp.normalize(wp.cross(coarse[corners[1]] - a, coarse[corners[2]] - a))
    means[v] = mean


@wp.kernel
def attach_mesh(
    first: wp.int32,
    means: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    columns: wp.array[wp.vec4i],
    weights: wp.array[wp.vec4],
    strength: wp.float32,
    # in and out
    positions: wp.array[wp.vec3],
):
    """Add to every fine vertex the means as they belong [m] (eq 6's first half); as :func:`detach_meshes`."""
    u = first + wp.tid()
    added = wp.vec3()
    for k in range(start[u], start[u + 1]):
        c = columns[k]
        w = weights[k]
        added += (w[0] * means[c[0]] + w[1] * means[c[1]]) + (w[2] * means[c[2]] + w[3] * means[c[3]])
    positions[u] += strength * added


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
