"""How much a joint changes the detail of cloth: Laplacians of its samples, and how far they lie apart."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def laplacian_of_samples(
    first: wp.int32,
    start: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    weights: wp.array[wp.float32],
    offsets: wp.array2d[wp.vec3],
    # outputs
    details: wp.array2d[wp.vec3],
):
    """Each vertex's offset less the weighted mean of its neighbours', in every sample [m].

    Args:
        start, neighbours, weights: Rows of the operator; each row's weights add up to 1.
        offsets, details: Shape [vertex_count, sample_count].
    """
    vertex = first + wp.tid()
    for sample in range(offsets.shape[1]):
        detail = offsets[vertex, sample]
        for entry in range(start[vertex], start[vertex + 1]):
            detail -= weights[entry] * offsets[neighbours[entry], sample]
        details[vertex, sample] = detail


@wp.kernel
def mean_distance_of_pairs(
    first: wp.int32,
    details: wp.array2d[wp.vec3],
    # outputs
    influence: wp.array[wp.float32],
):
    """Mean over all pairs of samples of how far their details lie apart on a vertex [m]; at least two samples."""
    vertex = first + wp.tid()
    count = details.shape[1]
    total = wp.float64(0.0)
    for sample in range(1, count):
        detail = details[vertex, sample]
        # Short sums in single precision, the long one in double.
        part = wp.float32(0.0)
        for other in range(sample):
            part += wp.length(detail - details[vertex, other])
        total += wp.float64(part)
    influence[vertex] = wp.float32(total / wp.float64(count * (count - 1) / 2))
