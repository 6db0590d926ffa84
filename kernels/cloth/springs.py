"""The material of Wang et al. 2010, section 3.1: springs along every edge, and between the opposite corners of
neighbouring triangles (W21, W22).

A length spring with the length l, the rest length L and the stiffness k [N/m] holds

    W = k/2 (l - L)^2          [J].

A bending spring does not resist being stretched. Compressed, it gives way like a beam that buckles into an arc of its
own length, with the stiffness b in N m^2 (Choi and Ko 2002, "Stable but responsive cloth"):

    W = b/2 L c^2 = 2 b u^2 / L,     l / L = sin(u) / u,     f = dW/dl = 4 b u^2 / (L^2 (cos(u) - sin(u) / u))

for the arc's curvature c = 2 u / L. The beam's force starts from its buckling load and not from zero: until it is met,
at u = ``turn``, the spring is a length spring, whose W it then goes on from. f stays continuous.

With d the direction of the spring the Hessian of its end is f' d d^T + f / l (I - d d^T). The second term is left out
where the spring is compressed, as Choi and Ko do, to have it positive semi-definite.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Springs:
    """Springs of a garment between pairs of vertices; ``beam`` [N m^2] is 0 for length springs."""

    vertices: wp.array2d[wp.int32]
    rest_length: wp.array[wp.float64]
    stiffness: wp.array[wp.float64]
    beam: wp.array[wp.float64]
    turn: wp.array[wp.float64]


@wp.func
def sinc(u: wp.float64) -> wp.float64:
    """sin(u) / u."""
    if wp.abs(u) < wp.float64(1.0e-4):
        return wp.float64(1.0) - u * u / wp.float64(6.0)
    return wp.sin(u) / u


@wp.func
def inverse_sinc(share: wp.float64) -> wp.float64:
    """u in [0, pi] with sin(u) / u = share."""
    rest = wp.max(wp.float64(1.0) - share, wp.float64(0.0))
    # Exact at both ends; Newton's method doubles its digits each time.
    u = wp.sqrt(rest * (wp.float64(6.0) + wp.float64(wp.pi * wp.pi - 6.0) * rest))
    for _ in range(5):
        if u > wp.float64(1.0e-6):
            u -= (wp.sin(u) - share * u) / (wp.cos(u) - share)
    return u


@wp.func
def spring_law(length: wp.float64, rest: wp.float64, stiffness: wp.float64, beam: wp.float64, turn: wp.float64):
    """Energy [J], force along the spring [N] and its derivative [N/m] at this length [m]."""
    two = wp.float64(2.0)
    half = wp.float64(0.5)
    past = length - rest
    if beam > wp.float64(0.0):
        if past >= wp.float64(0.0):
            return wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
        if length < rest * sinc(turn):
            u = inverse_sinc(length / rest)
            bow = wp.cos(u) - sinc(u)
            met = rest * (sinc(turn) - wp.float64(1.0))
            energy = two * beam * (u * u - turn * turn) / rest + half * stiffness * met * met
            scale = wp.float64(4.0) * beam / (rest * rest)
            slope = scale * (two * u / bow + u * u * (wp.sin(u) + bow / u) / (bow * bow))
            return energy, scale * u * u / bow, slope * u / (rest * bow)
    return half * stiffness * past * past, stiffness * past, stiffness


@wp.func
def spring_hessian(
    d: wp.vec3d, length: wp.float64, force: wp.float64, slope: wp.float64, kept: wp.float64
) -> wp.mat33d:
    """Second derivative of the energy by an end of the spring [N/m], with this share of what makes it indefinite."""
    across = wp.max(force, kept * force) / length
    along = wp.outer(d, d)
    return slope * along + across * (wp.identity(n=3, dtype=wp.float64) - along)


@wp.kernel
def stretch_springs(
    positions: wp.array2d[wp.vec3d],
    springs: Springs,
    # outputs
    direction: wp.array2d[wp.vec3d],
    state: wp.array2d[wp.vec3d],
    energy: wp.array2d[wp.float64],
):
    """Direction from first to second end, (length [m], force [N], its derivative [N/m]) and energy [J]."""
    world, spring = wp.tid()
    along = positions[world, springs.vertices[spring, 1]] - positions[world, springs.vertices[spring, 0]]
    length = wp.length(along)
    found, force, slope = spring_law(
        length, springs.rest_length[spring], springs.stiffness[spring], springs.beam[spring], springs.turn[spring]
    )
    direction[world, spring] = along / length
    state[world, spring] = wp.vec3d(length, force, slope)
    energy[world, spring] = found


@wp.kernel
def add_spring_gradient(
    direction: wp.array2d[wp.vec3d],
    state: wp.array2d[wp.vec3d],
    start: wp.array[wp.int32],
    places: wp.array[wp.int32],
    # in and out
    gradient: wp.array2d[wp.vec3d],
):
    """Add the derivative of all springs' energy by every vertex [N]; ``places`` are spring * 2 + end."""
    world, vertex = wp.tid()
    total = wp.vec3d()
    for k in range(start[vertex], start[vertex + 1]):
        spring = places[k] // 2
        sign = wp.where(places[k] % 2 == 1, wp.float64(1.0), wp.float64(-1.0))
        total += sign * state[world, spring][1] * direction[world, spring]
    gradient[world, vertex] = gradient[world, vertex] + total


@wp.kernel
def add_spring_blocks(
    direction: wp.array2d[wp.vec3d],
    state: wp.array2d[wp.vec3d],
    kept: wp.array[wp.float64],
    start: wp.array[wp.int32],
    places: wp.array[wp.int32],
    # in and out
    blocks: wp.array2d[wp.mat33],
):
    """Add the Hessian [N/m], with the share ``kept`` of what makes it indefinite.

    ``places`` are spring * 4 + row * 2 + column.
    """
    world, entry = wp.tid()
    total = wp.mat33d()
    for k in range(start[entry], start[entry + 1]):
        spring = places[k] // 4
        d = direction[world, spring]
        s = state[world, spring]
        part = spring_hessian(d, s[0], s[1], s[2], kept[world])
        if (places[k] // 2) % 2 != places[k] % 2:
            part = -part
        total += part
    blocks[world, entry] = blocks[world, entry] + wp.mat33(total)
