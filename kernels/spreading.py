"""Spreading values over a garment's vertices: largest values and means around, in gather form.

Arrays of values have an entry more than there are vertices, of 0: what a vertex with few neighbours reads for more.
"""

import warp as wp

from .natural import natural

wp.set_module_options({"enable_backward": False})

# Neighbours that are read without asking how many there are.
RING = 8
vec_ring = wp.types.vector(RING, wp.int32)


@wp.struct
class Neighbours:
    """Neighbours of the vertices along edges.

    Attributes:
        begin: Where each vertex's neighbours begin, shape [vertex_count + 1].
        all: Neighbours of all vertices.
        ring: The first ones of each, and ``vertex_count`` where there are fewer, shape [vertex_count].
    """

    begin: wp.array[wp.int32]
    all: wp.array[wp.int32]
    ring: wp.array[vec_ring]


@wp.kernel
def believable_lacks(
    first: wp.int32,
    block_size: wp.int32,
    positions: wp.array[wp.vec3],
    neighbours: Neighbours,
    lack: wp.array[wp.float32],
    metre: wp.float32,
    # outputs
    believed: wp.array[wp.float32],
):
    """Lacks that no vertex alone has [m]: heights of neighbours differ by no more than they are apart.

    In a crook a lone vertex may find its foot on the wrong side of the limb.
    """
    block = (first + wp.tid()) * block_size
    for i in range(block, wp.min(block + block_size, positions.shape[0])):
        v = natural(i)
        most = wp.float32(0.0)
        if lack[v] > 0.0:
            for k in range(neighbours.begin[v], neighbours.begin[v + 1]):
                u = neighbours.all[k]
                most = wp.max(most, lack[u] + wp.length(positions[u] - positions[v]) / metre)
        believed[v] = wp.min(lack[v], most)


@wp.kernel
def largest_around(
    first: wp.int32,
    block_size: wp.int32,
    neighbours: Neighbours,
    values: wp.array[wp.float32],
    # outputs
    largest: wp.array[wp.float32],
):
    """The largest value of each vertex and its neighbours; none is below 0."""
    block = (first + wp.tid()) * block_size
    for i in range(block, wp.min(block + block_size, neighbours.ring.shape[0])):
        v = natural(i)
        ring = neighbours.ring[v]
        most = values[v]
        for k in range(RING):
            value = values[natural(ring[k])]
            most = wp.where(value > most, value, most)
        for k in range(neighbours.begin[v] + RING, neighbours.begin[v + 1]):
            most = wp.max(most, values[neighbours.all[k]])
        largest[v] = most


@wp.kernel
def mean_around(
    first: wp.int32,
    block_size: wp.int32,
    neighbours: Neighbours,
    values: wp.array[wp.float32],
    # outputs
    mean: wp.array[wp.float32],
):
    """Each vertex half way to the mean of its neighbours."""
    block = (first + wp.tid()) * block_size
    for i in range(block, wp.min(block + block_size, neighbours.ring.shape[0])):
        v = natural(i)
        ring = neighbours.ring[v]
        total = wp.float32(0.0)
        for k in range(RING):
            total += values[natural(ring[k])]
        for k in range(neighbours.begin[v] + RING, neighbours.begin[v + 1]):
            total += values[neighbours.all[k]]
        count = neighbours.begin[v + 1] - neighbours.begin[v]
        mean[v] = 0.5 * values[v] + 0.5 * total / wp.float32(wp.max(count, 1))
