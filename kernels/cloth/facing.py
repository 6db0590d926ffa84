"""Which way a garment faces the body where it has slid away from the skin that it was modelled on."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def garment_normals(
    positions: wp.array2d[wp.vec3d],
    faces: wp.array2d[wp.int32],
    around_start: wp.array[wp.int32],
    around: wp.array[wp.int32],
    # outputs
    normals: wp.array2d[wp.vec3],
):
    """Area-weighted vertex normals, not of unit length [m^2]; ``around`` lists the faces around each vertex."""
    world, vertex = wp.tid()
    total = wp.vec3d()
    for k in range(around_start[vertex], around_start[vertex + 1]):
        face = around[k]
        a = positions[world, faces[face, 0]]
        total += wp.cross(positions[world, faces[face, 1]] - a, positions[world, faces[face, 2]] - a)
    normals[world, vertex] = wp.vec3(total)


@wp.kernel
def mean_normals(
    normals: wp.array2d[wp.vec3],
    begin: wp.array[wp.int32],
    neighbours: wp.array[wp.int32],
    # outputs
    mean: wp.array2d[wp.vec3],
):
    """The mean of each vertex and its neighbours."""
    world, vertex = wp.tid()
    total = normals[world, vertex]
    for k in range(begin[vertex], begin[vertex + 1]):
        total += normals[world, neighbours[k]]
    mean[world, vertex] = total / wp.float32(1 + begin[vertex + 1] - begin[vertex])


@wp.kernel
def face_as_it_lies(
    outward: wp.array2d[wp.vec3],
    normals: wp.array2d[wp.vec3],
    least_cosine: wp.float32,
    # outputs
    facing: wp.array2d[wp.vec3],
):
    """The outward direction that the skin gives, or where the garment has turned away from it, its own normal.

    A vertex that has no outward direction gets none.
    """
    world, vertex = wp.tid()
    given = outward[world, vertex]
    own = wp.normalize(normals[world, vertex])
    turned = wp.length_sq(given) > 0.0 and wp.length_sq(own) > 0.0 and wp.dot(given, own) < least_cosine
    facing[world, vertex] = wp.where(turned, own, given)
