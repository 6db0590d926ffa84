"""Bringing synthesised garments into line with a coarse layer (Wang et al. 2010, section 3.4; W80-W86).

All kernels gather, in a fixed order; the same input gives the same bits.
"""

from typing import Any

import warp as wp

from .blend import join_offsets
from .natural import natural

wp.set_module_options({"enable_backward": False})

# Offsets that lie side by side, and are read at once.
LANES = 2
mat_lanes = wp.types.matrix((LANES, 3), wp.float32)

# Four entries of a row, weights in whole shares of FULL_WEIGHT: reading them takes longer than all else.
FULL_WEIGHT = wp.constant(65535)
vec4us = wp.types.vector(4, wp.uint16)

COLUMNS = wp.constant(32)
Columns = wp.types.vector(length=int(COLUMNS), dtype=wp.float32)


@wp.kernel
def downsample(
    first: wp.int32,
    positions: wp.array[wp.vec3],
    offsets: wp.array2d[wp.vec3],
    start: wp.array[wp.int32],
    members: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    # outputs
    means: wp.array[wp.vec3],
    offset_means: wp.array2d[mat_lanes],
):
    """Means of the fine vertices around every coarse one [m] (eq 5): of positions, and of several offsets of them.

    Those of offset k are row k % LANES of [k / LANES]. ``weights`` are a_uv over their sum; a coarse vertex without
    fine ones has no mean, and nothing takes it up. Vertices from ``first`` on; each thread of a split launch has its
    own part, here and below.
    """
    v = natural(first + wp.tid())
    mean = wp.vec3()
    for k in range(start[v], start[v + 1]):
        mean += weights[natural(k)] * positions[natural(members[natural(k)])]
    means[v] = mean
    for side in range(offset_means.shape[0]):
        found = mat_lanes()
        for k in range(start[v], start[v + 1]):
            for lane in range(LANES):
                if LANES * side + lane < offsets.shape[0]:
                    member = natural(members[natural(k)])
                    found[lane] += weights[natural(k)] * offsets[LANES * side + lane, member]
        offset_means[side, v] = found


@wp.kernel
def join_aligned_offsets(
    first: wp.int32,
    offset_means: wp.array2d[mat_lanes],
    start: wp.array[wp.int32],
    columns: wp.array[Any],
    weights: wp.array[vec4us],
    strength: wp.float32,
    positions: wp.array[wp.vec3],
    # in and out
    offsets: wp.array2d[wp.vec3],
    # outputs
    joined: wp.array[wp.vec3],
):
    """Take ``strength`` of the coarse vertices' means away from every offset, and add them joined as joints' are [m].

    ``weights`` are a_uv after Laplacian smoothing over the fine mesh, four at a time (eq 6).
    """
    u = natural(first + wp.tid())
    share = strength / wp.float32(FULL_WEIGHT)
    total = wp.vec3()
    for side in range(offset_means.shape[0]):
        taken = mat_lanes()
        for k in range(start[u], start[u + 1]):
            c = columns[natural(k)]
            w = weights[natural(k)]
            taken += (
                wp.float32(w[0]) * offset_means[side, wp.int32(c[0])]
                + wp.float32(w[1]) * offset_means[side, wp.int32(c[1])]
            ) + (
                wp.float32(w[2]) * offset_means[side, wp.int32(c[2])]
                + wp.float32(w[3]) * offset_means[side, wp.int32(c[3])]
            )
        for lane in range(LANES):
            if LANES * side + lane < offsets.shape[0]:
                offset = offsets[LANES * side + lane, u] - share * taken[lane]
                offsets[LANES * side + lane, u] = offset
                total += offset
    largest = wp.float32(0.0)
    for k in range(offsets.shape[0]):
        largest = wp.max(largest, wp.abs(wp.dot(total, offsets[k, u])))
    joined[u] = positions[u] + join_offsets(total, largest)


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
    means: wp.array[wp.vec3],
    # outputs
    missing: wp.array[wp.vec3],
):
    """How far the means of :func:`downsample` are from where they belong as the coarse layer lies [m].

    Places are sums over the coarse vertices around, by weights, and over the normals of the triangles around, by
    heights [m].
    """
    v = natural(first + wp.tid())
    place = wp.vec3()
    for k in range(start[v], start[v + 1]):
        place += weights[natural(k)] * coarse[natural(columns[natural(k)])]
    for k in range(height_start[v], height_start[v + 1]):
        corners = triangles[k]
        a = coarse[corners[0]]
        place += heights[k] * wp.normalize(wp.cross(coarse[corners[1]] - a, coarse[corners[2]] - a))
    missing[v] = place - means[v]


@wp.kernel
def attach_mesh(
    first: wp.int32,
    missing: wp.array[wp.vec3],
    start: wp.array[wp.int32],
    columns: wp.array[Any],
    weights: wp.array[vec4us],
    strength: wp.float32,
    # in and out
    positions: wp.array[wp.vec3],
):
    """Move every fine vertex by ``strength`` of what is missing around it [m] (eq 6).

    ``weights`` as for :func:`join_aligned_offsets`.
    """
    u = natural(first + wp.tid())
    moved = wp.vec3()
    for k in range(start[u], start[u + 1]):
        c = columns[natural(k)]
        w = weights[natural(k)]
        moved += (wp.float32(w[0]) * missing[wp.int32(c[0])] + wp.float32(w[1]) * missing[wp.int32(c[1])]) + (
            wp.float32(w[2]) * missing[wp.int32(c[2])] + wp.float32(w[3]) * missing[wp.int32(c[3])]
        )
    positions[u] += (strength / wp.float32(FULL_WEIGHT)) * moved


# Columns of a coarse layer of more vertices than 16 bits hold take twice the room.
wp.overload(join_aligned_offsets, {"columns": wp.array[vec4us]})
wp.overload(join_aligned_offsets, {"columns": wp.array[wp.vec4i]})
wp.overload(attach_mesh, {"columns": wp.array[vec4us]})
wp.overload(attach_mesh, {"columns": wp.array[wp.vec4i]})


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
