"""Preconditioned conjugate gradients for many worlds side by side, each with its own step lengths.

A world that has converged takes steps of length zero and so keeps its bits, whatever its neighbours do. Scalars stay
on the device: a number of iterations can be recorded once and replayed.
"""

import warp as wp

from ..natural import natural
from .assembly import Contact, gather_pairs

wp.set_module_options({"enable_backward": False})


@wp.kernel
def pair_products(
    direction: wp.array[wp.vec3],
    contact: Contact,
    pair_stiffness: wp.array[wp.float32],
    # outputs
    force: wp.array[wp.vec3],
):
    """Stiffness of every pair times the direction [N]; ``direction`` of all worlds in one row."""
    pair = natural(wp.tid())
    if pair >= contact.pair_total[0]:
        return
    v = contact.pair_vertices[pair]
    w = contact.pair_weights[pair]
    n = contact.pair_normal[pair]
    relative = (
        w[0] * direction[natural(v[0])]
        + w[1] * direction[natural(v[1])]
        + w[2] * direction[natural(v[2])]
        + w[3] * direction[natural(v[3])]
    )
    force[pair] = n * (pair_stiffness[pair] * wp.dot(n, relative))


@wp.kernel
def multiply(
    direction: wp.array2d[wp.vec3],
    row_start: wp.array[wp.int32],
    columns: wp.array[wp.int32],
    blocks: wp.array2d[wp.mat33],
    far_start: wp.array[wp.int32],
    far_columns: wp.array[wp.vec4i],
    far_coefficients: wp.array[wp.vec4],
    contact: Contact,
    pair_force: wp.array[wp.vec3],
    active: wp.array[wp.int32],
    # outputs
    product: wp.array2d[wp.vec3],
):
    """Hessian times direction, row by row [N], the far entries of a row four at a time.

    Worlds that are done keep what they had.
    """
    world, i = wp.tid()
    vertex = natural(i)
    if active[world] == 0:
        return
    total = wp.vec3()
    for k in range(row_start[vertex], row_start[vertex + 1]):
        total += blocks[world, natural(k)] * direction[world, natural(columns[natural(k)])]
    for k in range(far_start[vertex], far_start[vertex + 1]):
        c = far_columns[natural(k)]
        w = far_coefficients[natural(k)]
        total += (w[0] * direction[world, natural(c[0])] + w[1] * direction[world, natural(c[1])]) + (
            w[2] * direction[world, natural(c[2])] + w[3] * direction[world, natural(c[3])]
        )
    product[world, vertex] = total + gather_pairs(pair_force, contact, world * direction.shape[1] + vertex)


@wp.kernel
def hold_vertices(held: wp.array[wp.int32], inverse: wp.array2d[wp.mat33]):
    """Take vertices out of the system: a preconditioner of zero never moves them."""
    world, vertex = wp.tid()
    if held[vertex] != 0:
        inverse[world, vertex] = wp.mat33()


@wp.kernel
def start(
    gradient: wp.array2d[wp.vec3d],
    inverse: wp.array2d[wp.mat33],
    # outputs
    solution: wp.array2d[wp.vec3],
    residual: wp.array2d[wp.vec3],
    preconditioned: wp.array2d[wp.vec3],
):
    """Begin at zero: residual minus the gradient."""
    world, i = wp.tid()
    vertex = natural(i)
    r = -wp.vec3(gradient[world, vertex])
    z = inverse[world, vertex] * r
    solution[world, vertex] = wp.vec3()
    residual[world, vertex] = r
    preconditioned[world, vertex] = z


@wp.kernel
def start_from(
    gradient: wp.array2d[wp.vec3d],
    inverse: wp.array2d[wp.mat33],
    product: wp.array2d[wp.vec3],
    # outputs
    residual: wp.array2d[wp.vec3],
    preconditioned: wp.array2d[wp.vec3],
):
    """Begin at a solution whose product with the Hessian is known: residual minus both."""
    world, i = wp.tid()
    vertex = natural(i)
    r = -wp.vec3(gradient[world, vertex]) - product[world, vertex]
    residual[world, vertex] = r
    preconditioned[world, vertex] = inverse[world, vertex] * r


@wp.kernel
def give_way(
    first: wp.int32,
    inverse: wp.array2d[wp.mat33],
    contact: Contact,
    pair_stiffness: wp.array[wp.float32],
    outwards: wp.bool,
    # in and out
    preconditioned: wp.array2d[wp.vec3],
):
    """Let a layer's vertices, from ``first`` on, give way to the layers inside of it, or else to those outside [m].

    Of every pair, what its inner layer's vertex does pushes its outer layer's triangle, or the other way round.
    """
    vertex = natural(first + wp.tid())
    push = wp.vec3()
    start = contact.incident_start[vertex]
    for k in range(start, start + contact.incident_count[vertex]):
        incident = natural(contact.incident[natural(k)])
        pair = incident >> 2
        corner = incident & 3
        if (corner != 0) == outwards:
            v = contact.pair_vertices[pair]
            w = contact.pair_weights[pair]
            n = contact.pair_normal[pair]
            moved = w[0] * preconditioned[0, natural(v[0])]
            if not outwards:
                moved = (
                    w[1] * preconditioned[0, natural(v[1])]
                    + w[2] * preconditioned[0, natural(v[2])]
                    + w[3] * preconditioned[0, natural(v[3])]
                )
            push += (w[corner] * pair_stiffness[pair] * wp.dot(n, moved)) * n
    preconditioned[0, vertex] -= inverse[0, vertex] * push


@wp.kernel
def partial_dot(
    a: wp.array2d[wp.vec3],
    b: wp.array2d[wp.vec3],
    # outputs
    partial: wp.array2d[wp.float64],
):
    """Dot product of a run of neighbouring entries; one run a thread."""
    world, part = wp.tid()
    count = a.shape[1]
    parts = partial.shape[1]
    total = wp.float64(0.0)
    for i in range(part * count // parts, (part + 1) * count // parts):
        total += wp.float64(wp.dot(a[world, natural(i)], b[world, natural(i)]))
    partial[world, part] = total


@wp.func
def sum_parts(partial: wp.array2d[wp.float64], world: wp.int32) -> wp.float64:
    total = wp.float64(0.0)
    for part in range(partial.shape[1]):
        total += partial[world, part]
    return total


@wp.kernel
def start_scalars(
    partial: wp.array2d[wp.float64],
    moving: wp.array[wp.int32],
    # outputs
    energy: wp.array[wp.float64],
    first_energy: wp.array[wp.float64],
    active: wp.array[wp.int32],
    iterations: wp.array[wp.int32],
):
    """r z at the start; a world that rests or whose residual is zero is done."""
    world = wp.tid()
    value = sum_parts(partial, world)
    energy[world] = value
    first_energy[world] = value
    active[world] = wp.where(value > wp.float64(0.0) and moving[world] != 0, 1, 0)
    iterations[world] = 0


@wp.kernel
def step_length(
    partial: wp.array2d[wp.float64],
    energy: wp.array[wp.float64],
    iterations: wp.array[wp.int32],
    # in and out
    active: wp.array[wp.int32],
    # outputs
    alpha: wp.array[wp.float32],
):
    """alpha = r z / p A p; a direction without positive curvature ends the world's iteration.

    If it is the first one, it is taken as it is: the preconditioned gradient still goes downhill.
    """
    world = wp.tid()
    alpha[world] = 0.0
    if active[world] != 0:
        curvature = sum_parts(partial, world)
        if curvature > wp.float64(0.0):
            alpha[world] = wp.float32(energy[world] / curvature)
        else:
            alpha[world] = wp.where(iterations[world] == 0, 1.0, 0.0)
            active[world] = 0


@wp.kernel
def advance(
    alpha: wp.array[wp.float32],
    direction: wp.array2d[wp.vec3],
    product: wp.array2d[wp.vec3],
    inverse: wp.array2d[wp.mat33],
    # in and out
    solution: wp.array2d[wp.vec3],
    residual: wp.array2d[wp.vec3],
    # outputs
    preconditioned: wp.array2d[wp.vec3],
):
    world, i = wp.tid()
    vertex = natural(i)
    a = alpha[world]
    solution[world, vertex] = solution[world, vertex] + a * direction[world, vertex]
    r = residual[world, vertex] - a * product[world, vertex]
    residual[world, vertex] = r
    preconditioned[world, vertex] = inverse[world, vertex] * r


@wp.kernel
def next_scalars(
    partial: wp.array2d[wp.float64],
    first_energy: wp.array[wp.float64],
    tolerance2: wp.float64,
    max_iterations: wp.int32,
    # in and out
    energy: wp.array[wp.float64],
    active: wp.array[wp.int32],
    iterations: wp.array[wp.int32],
    # outputs
    beta: wp.array[wp.float32],
):
    """beta = new r z / old r z; done when r z fell below ``tolerance2`` times its first value, or at the bound."""
    world = wp.tid()
    beta[world] = 0.0
    if active[world] == 0:
        return
    value = sum_parts(partial, world)
    beta[world] = wp.float32(value / energy[world])
    energy[world] = value
    iterations[world] = iterations[world] + 1
    if value <= tolerance2 * first_energy[world] or iterations[world] >= max_iterations:
        active[world] = 0


@wp.kernel
def turn_direction(
    beta: wp.array[wp.float32],
    preconditioned: wp.array2d[wp.vec3],
    # in and out
    direction: wp.array2d[wp.vec3],
):
    world, i = wp.tid()
    vertex = natural(i)
    direction[world, vertex] = preconditioned[world, vertex] + beta[world] * direction[world, vertex]
