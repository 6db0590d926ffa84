"""Nonlinear bending: two triangles turn about the edge between them like leaves of a hinge.

With the angle t between the normals (0 where they lie flat, positive where the edge is a ridge seen from outside) and
the rest angle t0, the energy of a hinge is

    W = k/2 (t - t0)^2          [J],          k = b |e|^2 / (A0 + A1)          [N m]

for its rest length |e| [m], the rest areas of its triangles [m^2] and the bending stiffness b [N m] across it: the
discrete shells of Grinspun et al. 2003, whose hinges Bridson et al. 2003 have, too. With this k a cylinder of curvature
c holds b c^2 / 2 per area on a mesh of equilateral triangles, and on a grid with one diagonal when it is bent along a
side or across the diagonals; along the diagonals it holds three times as much: hinges depend on the mesh.

Unlike the quadratic energy of :mod:`.bending` it knows a rest angle and stays right when lengths change.

Derivatives after Tamstorf and Grinspun 2013 ("Discrete bending forces and their Jacobians"): minus the gradient of t is
a sum over both triangles of a_i N, with N = n / |n|^2 for the triangle's normal n = e x (x2 - x0) and with
a = ((x2 - x1) . u, -(x2 - x0) . u, |e|) for the edge's start x0, its end x1 and the opposite corner x2, u = e / |e|.
The outer product of that gradient is positive semi-definite; the rest of the Hessian is not.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Hinges:
    """Hinges of a garment: (edge start, edge end, opposite in the first, opposite in the second triangle)."""

    vertices: wp.array2d[wp.int32]
    stiffness: wp.array[wp.float64]
    rest_angle: wp.array[wp.float64]


@wp.func
def hinge_angle(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d) -> wp.float64:
    """t [rad], from -pi to pi."""
    e = x1 - x0
    first = wp.cross(e, x2 - x0)
    second = wp.cross(x3 - x0, e)
    return wp.atan2(wp.dot(wp.cross(first, second), wp.normalize(e)), wp.dot(first, second))


@wp.func
def leaf_share(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, i: wp.int32) -> wp.float64:
    """a_i [m] of the triangle x0 x1 x2 with its hinge from x0 to x1."""
    u = wp.normalize(x1 - x0)
    if i == 0:
        return wp.dot(x2 - x1, u)
    if i == 1:
        return -wp.dot(x2 - x0, u)
    return wp.length(x1 - x0)


@wp.func
def leaf_normal(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d) -> wp.vec3d:
    """N [1/m^2]."""
    n = wp.cross(x1 - x0, x2 - x0)
    return n / wp.dot(n, n)


@wp.func
def leaf_hessian(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, i: wp.int32, j: wp.int32) -> wp.mat33d:
    """Derivative of a_i N by corner j [1/m^2]."""
    edge = x1 - x0
    size = wp.length(edge)
    u = edge / size
    n = wp.cross(edge, x2 - x0)
    square = wp.dot(n, n)
    height = (x2 - x0) - wp.dot(x2 - x0, u) * u
    opposite = x2 - x1  # The edge that faces corner j, along the winding; moving j turns the normal about it.
    share = -height / size
    if j == 0:
        if i == 1:
            share = u + height / size
        if i == 2:
            share = -u
    elif j == 1:
        opposite = x0 - x2
        if i == 0:
            share = height / size - u
        if i == 2:
            share = u
    else:
        opposite = edge
        share = u
        if i == 1:
            share = -u
        if i == 2:
            share = wp.vec3d()
    mirror = wp.identity(n=3, dtype=wp.float64) - (wp.float64(2.0) / square) * wp.outer(n, n)
    turned = mirror * wp.skew(opposite) / square
    return leaf_share(x0, x1, x2, i) * turned + wp.outer(n / square, share)


@wp.func
def angle_gradient(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d, i: wp.int32) -> wp.vec3d:
    """Derivative of t by vertex i [1/m]."""
    total = wp.vec3d()
    if i != 3:
        total -= leaf_share(x0, x1, x2, i) * leaf_normal(x0, x1, x2)
    if i != 2:
        # The second triangle runs along the edge the other way.
        k = wp.where(i == 3, 2, 1 - i)
        total -= leaf_share(x1, x0, x3, k) * leaf_normal(x1, x0, x3)
    return total


@wp.func
def angle_hessian(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d, i: wp.int32, j: wp.int32) -> wp.mat33d:
    """Second derivative of t by vertices i and j [1/m^2]."""
    total = wp.mat33d()
    if i != 3 and j != 3:
        total -= leaf_hessian(x0, x1, x2, i, j)
    if i != 2 and j != 2:
        total -= leaf_hessian(x1, x0, x3, wp.where(i == 3, 2, 1 - i), wp.where(j == 3, 2, 1 - j))
    return total


@wp.kernel
def bend_hinges(
    positions: wp.array2d[wp.vec3d],
    hinges: Hinges,
    # outputs
    bend: wp.array2d[wp.float64],
    slope: wp.array3d[wp.vec3d],
    energy: wp.array2d[wp.float64],
):
    """Angle beyond rest t - t0 [rad], gradient of t [1/m] and energy [J] of every hinge."""
    world, hinge = wp.tid()
    x0 = positions[world, hinges.vertices[hinge, 0]]
    x1 = positions[world, hinges.vertices[hinge, 1]]
    x2 = positions[world, hinges.vertices[hinge, 2]]
    x3 = positions[world, hinges.vertices[hinge, 3]]
    beyond = hinge_angle(x0, x1, x2, x3) - hinges.rest_angle[hinge]
    bend[world, hinge] = beyond
    for i in range(4):
        slope[world, hinge, i] = angle_gradient(x0, x1, x2, x3, i)
    energy[world, hinge] = wp.float64(0.5) * hinges.stiffness[hinge] * beyond * beyond


@wp.kernel
def add_hinge_gradient(
    hinges: Hinges,
    bend: wp.array2d[wp.float64],
    slope: wp.array3d[wp.vec3d],
    start: wp.array[wp.int32],
    places: wp.array[wp.int32],
    # in and out
    gradient: wp.array2d[wp.vec3d],
):
    """Add the derivative of all hinges' energy by every vertex [N]; ``places`` are hinge * 4 + corner."""
    world, vertex = wp.tid()
    total = wp.vec3d()
    for k in range(start[vertex], start[vertex + 1]):
        hinge = places[k] // 4
        total += (hinges.stiffness[hinge] * bend[world, hinge]) * slope[world, hinge, places[k] % 4]
    gradient[world, vertex] = gradient[world, vertex] + total


@wp.kernel
def add_hinge_blocks(
    positions: wp.array2d[wp.vec3d],
    hinges: Hinges,
    bend: wp.array2d[wp.float64],
    slope: wp.array3d[wp.vec3d],
    kept: wp.array[wp.float64],
    start: wp.array[wp.int32],
    places: wp.array[wp.int32],
    # in and out
    blocks: wp.array2d[wp.mat33],
):
    """Add the Hessian [N/m], with the share ``kept`` of what makes it indefinite.

    ``places`` are hinge * 16 + row * 4 + column.
    """
    world, entry = wp.tid()
    total = wp.mat33d()
    for k in range(start[entry], start[entry + 1]):
        hinge = places[k] // 16
        i = (places[k] // 4) % 4
        j = places[k] % 4
        total += hinges.stiffness[hinge] * wp.outer(slope[world, hinge, i], slope[world, hinge, j])
        if kept[world] > wp.float64(0.0):
            curvature = angle_hessian(
                positions[world, hinges.vertices[hinge, 0]],
                positions[world, hinges.vertices[hinge, 1]],
                positions[world, hinges.vertices[hinge, 2]],
                positions[world, hinges.vertices[hinge, 3]],
                i,
                j,
            )
            total += (kept[world] * hinges.stiffness[hinge] * bend[world, hinge]) * curvature
    blocks[world, entry] = blocks[world, entry] + wp.mat33(total)
