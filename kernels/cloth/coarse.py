"""Coarse correction of the conjugate gradients: rigid motions of groups of vertices, then of groups of those.

A node moves by six numbers: a translation t [m] and a rotation times LEVER [m]; a point d away from the node's centre
moves by t + S r with S = -[d]x / LEVER. The matrix of a level is that of the finer one between such motions (Galerkin),
so the correction is as good as the energy allows, in every pose.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

vec6d = wp.types.vector(length=6, dtype=wp.float64)
mat66d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)

# Gives rotations the size of translations [m]; about as far as a node's vertices are from its centre.
LEVER = wp.constant(wp.float64(0.01))
# Share of the Jacobi step that smooths every wave whatever the matrix: less than 2 over its largest eigenvalue.
DAMPING = wp.constant(wp.float64(0.66))
# Share of a node's stiffness that every motion costs at least: nodes of one vertex have no rotation, and blocks in
# float32 err enough to make a motion that should cost nothing pay. Little beside what holds a garment on a body.
LEAST_STIFFNESS = wp.constant(wp.float64(1.0e-6))


@wp.struct
class Level:
    """One coarse level; see ``wrinkle_addon/coarse_space.py``."""

    node: wp.array[wp.int32]
    member_start: wp.array[wp.int32]
    members: wp.array[wp.int32]
    row_start: wp.array[wp.int32]
    columns: wp.array[wp.int32]
    rows: wp.array[wp.int32]
    diagonal_entry: wp.array[wp.int32]
    contribution_start: wp.array[wp.int32]
    contributions: wp.array[wp.int32]
    centre: wp.array2d[wp.vec3d]


@wp.func
def rotation_motion(point: wp.vec3d, centre: wp.vec3d) -> wp.mat33d:
    """S: how a point moves by a node's rotation."""
    return wp.skew(point - centre) * (-wp.float64(1.0) / LEVER)


@wp.func
def join_blocks(a: wp.mat33d, b: wp.mat33d, c: wp.mat33d, d: wp.mat33d) -> mat66d:
    """The matrix ((a, b), (c, d))."""
    whole = mat66d()
    for i in range(3):
        for j in range(3):
            whole[i, j] = a[i, j]
            whole[i, j + 3] = b[i, j]
            whole[i + 3, j] = c[i, j]
            whole[i + 3, j + 3] = d[i, j]
    return whole


@wp.func
def split_block(whole: mat66d, i: wp.int32, j: wp.int32) -> wp.mat33d:
    """A quarter of a matrix: rows 3 i to 3 i + 2, columns 3 j to 3 j + 2."""
    part = wp.mat33d()
    for k in range(3):
        for m in range(3):
            part[k, m] = whole[3 * i + k, 3 * j + m]
    return part


@wp.func
def join_vectors(a: wp.vec3d, b: wp.vec3d) -> vec6d:
    return vec6d(a[0], a[1], a[2], b[0], b[1], b[2])


@wp.func
def head(v: vec6d) -> wp.vec3d:
    return wp.vec3d(v[0], v[1], v[2])


@wp.func
def tail(v: vec6d) -> wp.vec3d:
    return wp.vec3d(v[3], v[4], v[5])


# --- the matrices -------------------------------------------------------------------------------------------------


@wp.kernel
def place_nodes(
    points: wp.array2d[wp.vec3d],
    # in and out
    level: Level,
):
    """Centre of every node [m]: the mean of its members."""
    world, node = wp.tid()
    total = wp.vec3d()
    start = level.member_start[node]
    end = level.member_start[node + 1]
    for k in range(start, end):
        total += points[world, level.members[k]]
    level.centre[world, node] = total / wp.float64(end - start)


@wp.kernel
def gather_vertices(
    positions: wp.array2d[wp.vec3d],
    near_rows: wp.array[wp.int32],
    near_columns: wp.array[wp.int32],
    blocks: wp.array2d[wp.mat33],
    diagonal: wp.array2d[wp.mat33],
    far_rows: wp.array[wp.int32],
    far_columns: wp.array[wp.int32],
    far_coefficients: wp.array[wp.float32],
    level: Level,
    # outputs
    matrix: wp.array2d[mat66d],
):
    """Matrix of the first coarse level; ``diagonal`` stands for the diagonal blocks, self-contact included."""
    world, entry = wp.tid()
    row_centre = level.centre[world, level.rows[entry]]
    column_centre = level.centre[world, level.columns[entry]]
    near_count = near_columns.shape[0]
    a = wp.mat33d()
    b = wp.mat33d()
    c = wp.mat33d()
    d = wp.mat33d()
    for k in range(level.contribution_start[entry], level.contribution_start[entry + 1]):
        code = level.contributions[k]
        if code < near_count:
            i = near_rows[code]
            j = near_columns[code]
            if i == j:
                stiffness = wp.mat33d(diagonal[world, i])
            else:
                stiffness = wp.mat33d(blocks[world, code])
        else:
            i = far_rows[code - near_count]
            j = far_columns[code - near_count]
            stiffness = wp.float64(far_coefficients[code - near_count]) * wp.identity(n=3, dtype=wp.float64)
        turned_row = wp.transpose(rotation_motion(positions[world, i], row_centre))
        turned = stiffness * rotation_motion(positions[world, j], column_centre)
        a += stiffness
        b += turned
        c += turned_row * stiffness
        d += turned_row * turned
    matrix[world, entry] = join_blocks(a, b, c, d)


@wp.func
def least_stiffness(own: mat66d) -> wp.float64:
    """What every motion of a node costs at least [N/m]."""
    total = wp.float64(0.0)
    for i in range(6):
        total += own[i, i]
    return LEAST_STIFFNESS * total


@wp.kernel
def invert_diagonal(
    level: Level,
    matrix: wp.array2d[mat66d],
    # outputs
    smoother: wp.array2d[mat66d],
):
    """Damped inverse of every node's own block [m/N]."""
    world, node = wp.tid()
    own = matrix[world, level.diagonal_entry[node]]
    padding = least_stiffness(own) * wp.identity(n=3, dtype=wp.float64)
    a = wp.inverse(split_block(own, 0, 0) + padding)
    b = split_block(own, 0, 1)
    across = a * b
    d = wp.inverse(split_block(own, 1, 1) + padding - wp.transpose(b) * across)
    corner = -across * d
    smoother[world, node] = DAMPING * join_blocks(a - corner * wp.transpose(across), corner, wp.transpose(corner), d)


@wp.kernel
def gather_nodes(
    finer: Level,
    finer_matrix: wp.array2d[mat66d],
    level: Level,
    # outputs
    dense: wp.array3d[wp.float64],
):
    """Matrix of the second coarse level, dense, shape [world_count, 6 node_count, 6 node_count].

    Writes the same entries every time; the others are zero from the beginning.
    """
    world, entry = wp.tid()
    row = level.rows[entry]
    column = level.columns[entry]
    a = wp.mat33d()
    b = wp.mat33d()
    c = wp.mat33d()
    d = wp.mat33d()
    for k in range(level.contribution_start[entry], level.contribution_start[entry + 1]):
        code = level.contributions[k]
        block = finer_matrix[world, code]
        if finer.rows[code] == finer.columns[code]:
            block += least_stiffness(block) * wp.identity(n=6, dtype=wp.float64)
        turned_row = wp.transpose(rotation_motion(finer.centre[world, finer.rows[code]], level.centre[world, row]))
        turned = rotation_motion(finer.centre[world, finer.columns[code]], level.centre[world, column])
        p = split_block(block, 0, 0)
        q = split_block(block, 0, 1) + p * turned
        r = split_block(block, 1, 0)
        a += p
        b += q
        c += turned_row * p + r
        d += turned_row * q + r * turned + split_block(block, 1, 1)
    whole = join_blocks(a, b, c, d)
    for i in range(6):
        for j in range(6):
            dense[world, 6 * row + i, 6 * column + j] = whole[i, j]


# --- one cycle ----------------------------------------------------------------------------------------------------


@wp.kernel
def restrict_vertices(
    positions: wp.array2d[wp.vec3d],
    residual: wp.array2d[wp.vec3],
    level: Level,
    smoother: wp.array2d[mat66d],
    # outputs
    force: wp.array2d[vec6d],
    motion: wp.array2d[vec6d],
):
    """Force and moment on every node from the vertices' [N], and the first step that smooths them [m]."""
    world, node = wp.tid()
    centre = level.centre[world, node]
    push = wp.vec3d()
    turn = wp.vec3d()
    for k in range(level.member_start[node], level.member_start[node + 1]):
        vertex = level.members[k]
        f = wp.vec3d(residual[world, vertex])
        push += f
        turn += wp.cross(positions[world, vertex] - centre, f) / LEVER
    total = join_vectors(push, turn)
    force[world, node] = total
    motion[world, node] = smoother[world, node] * total


@wp.func
def node_residual(
    level: Level,
    matrix: wp.array2d[mat66d],
    force: wp.array2d[vec6d],
    motion: wp.array2d[vec6d],
    world: wp.int32,
    node: wp.int32,
) -> vec6d:
    """Force that a motion of all nodes leaves on one."""
    left = force[world, node]
    for entry in range(level.row_start[node], level.row_start[node + 1]):
        left -= matrix[world, entry] * motion[world, level.columns[entry]]
    return left


@wp.kernel
def find_left(
    level: Level,
    matrix: wp.array2d[mat66d],
    force: wp.array2d[vec6d],
    motion: wp.array2d[vec6d],
    # outputs
    left: wp.array2d[vec6d],
):
    """Force that is left on every node."""
    world, node = wp.tid()
    left[world, node] = node_residual(level, matrix, force, motion, world, node)


@wp.kernel
def restrict_nodes(
    finer: Level,
    left: wp.array2d[vec6d],
    level: Level,
    # outputs
    force: wp.array2d[vec6d],
):
    """Force and moment on every node of the second level."""
    world, node = wp.tid()
    centre = level.centre[world, node]
    push = wp.vec3d()
    turn = wp.vec3d()
    for k in range(level.member_start[node], level.member_start[node + 1]):
        member = level.members[k]
        f = head(left[world, member])
        push += f
        turn += tail(left[world, member]) + wp.cross(finer.centre[world, member] - centre, f) / LEVER
    force[world, node] = join_vectors(push, turn)


@wp.kernel
def solve_coarsest(
    inverse: wp.array3d[wp.float64],
    force: wp.array2d[vec6d],
    # outputs
    motion: wp.array2d[vec6d],
):
    """Motion of every node of the second level [m], by its rows of the inverse matrix."""
    world, node = wp.tid()
    total = vec6d()
    for other in range(force.shape[1]):
        f = force[world, other]
        for i in range(6):
            for j in range(6):
                total[i] += inverse[world, 6 * node + i, 6 * other + j] * f[j]
    motion[world, node] = total


@wp.kernel
def prolong_nodes(
    finer: Level,
    level: Level,
    coarse_motion: wp.array2d[vec6d],
    # in and out
    motion: wp.array2d[vec6d],
):
    """Take nodes of the first level along with those of the second."""
    world, node = wp.tid()
    owner = level.node[node]
    moved = coarse_motion[world, owner]
    lever = finer.centre[world, node] - level.centre[world, owner]
    carried = head(moved) + wp.cross(tail(moved), lever) / LEVER
    motion[world, node] = motion[world, node] + join_vectors(carried, tail(moved))


@wp.kernel
def smooth_nodes(
    level: Level,
    matrix: wp.array2d[mat66d],
    smoother: wp.array2d[mat66d],
    force: wp.array2d[vec6d],
    motion: wp.array2d[vec6d],
    # outputs
    smoothed: wp.array2d[vec6d],
):
    """The second smoothing step, which makes the cycle symmetric."""
    world, node = wp.tid()
    left = node_residual(level, matrix, force, motion, world, node)
    smoothed[world, node] = motion[world, node] + smoother[world, node] * left


@wp.kernel
def prolong_vertices(
    positions: wp.array2d[wp.vec3d],
    level: Level,
    motion: wp.array2d[vec6d],
    # in and out
    preconditioned: wp.array2d[wp.vec3],
):
    """Add to every vertex the motion of its node [m]."""
    world, vertex = wp.tid()
    node = level.node[vertex]
    moved = motion[world, node]
    lever = positions[world, vertex] - level.centre[world, node]
    preconditioned[world, vertex] = preconditioned[world, vertex] + wp.vec3(
        head(moved) + wp.cross(tail(moved), lever) / LEVER
    )
