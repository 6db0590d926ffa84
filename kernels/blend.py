"""From a pose to the garment: the joints' interpolated samples put together on every vertex."""

import warp as wp

from .interpolate import CORNERS, interpolate_about_axis, interpolate_about_point
from .natural import natural
from .skinning import Skin, skinned_position, skinned_turn

wp.set_module_options({"enable_backward": False})


Corners = wp.types.vector(length=int(CORNERS), dtype=wp.int32)
CornerWeights = wp.types.vector(length=int(CORNERS), dtype=wp.float32)


@wp.func
def transform(rows: wp.array[wp.vec4], matrix: wp.int32, p: wp.vec3) -> wp.vec3:
    """A point under an affine matrix, given as three consecutive rows."""
    h = wp.vec4(p[0], p[1], p[2], 1.0)
    row = 3 * matrix
    return wp.vec3(wp.dot(rows[row], h), wp.dot(rows[row + 1], h), wp.dot(rows[row + 2], h))


@wp.struct
class Offsets:
    """Samples as offsets over skinning, each joint's only on the vertices that it moves.

    Vertices are dealt with in blocks of ``block_size``. The entries of joint J in block b, one a vertex, are
    entry_start[J, b] to entry_start[J, b + 1], and offsets[start + entry] is a sample's. entry_offset is room for what
    they come to in a pose.
    """

    block_size: wp.int32
    entry_start: wp.array2d[wp.int32]
    entry_vertex: wp.array[wp.int32]
    entry_window: wp.array[wp.float32]
    entry_offset: wp.array[wp.vec3]
    offsets: wp.array[wp.vec3]


@wp.struct
class Sums:
    """What the joints' offsets come to in every mesh, on every vertex: their sum, and the largest share of one joint.

    A share is a joint's offset projected on the sum, times the sum's length; see :func:`join_offsets`.
    """

    total: wp.array2d[wp.vec3]
    largest: wp.array2d[wp.float32]


@wp.func
def join_offsets(total: wp.vec3, largest: wp.float32) -> wp.vec3:
    """What the joints' offsets do together, from their sum and the largest share of one joint in it.

    Joints that pull cloth the same way do not pull it farther: it goes where the one brings it that pulls most, or
    comes to lie against the skin. So along its direction the sum is no longer than the longest of the joints' offsets
    there. One joint alone keeps its offset as it is.
    """
    squared = wp.dot(total, total)
    if squared <= largest:
        return total
    return (largest / squared) * total


@wp.kernel
def join_all_offsets(
    offsets: wp.array2d[wp.vec3],
    # outputs
    joined: wp.array[wp.vec3],
):
    """Offsets of every joint, shape [joint_count, vertex_count], joined on every vertex [m]."""
    vertex = wp.tid()
    total = wp.vec3()
    for joint in range(offsets.shape[0]):
        total += offsets[joint, vertex]
    largest = wp.float32(0.0)
    for joint in range(offsets.shape[0]):
        largest = wp.max(largest, wp.abs(wp.dot(total, offsets[joint, vertex])))
    joined[vertex] = join_offsets(total, largest)


@wp.func
def add_joint(
    samples: Offsets,
    block: wp.int32,
    joint: wp.int32,
    start: Corners,
    weight: CornerWeights,
    strength: wp.float32,
    mesh: wp.int32,
    # outputs
    sums: Sums,
):
    """Interpolate a joint's offsets multilinearly on every vertex of a block, and add them to a mesh's sums."""
    for i in range(samples.entry_start[joint, block], samples.entry_start[joint, block + 1]):
        entry = natural(i)
        offset = wp.vec3()
        # Unrolled, with starts and weights in registers.
        for corner in range(CORNERS):
            if start[corner] >= 0:
                offset += weight[corner] * samples.offsets[start[corner] + entry]
        offset = (strength * samples.entry_window[entry]) * offset
        vertex = natural(samples.entry_vertex[entry])
        samples.entry_offset[entry] = offset
        sums.total[mesh, vertex] = sums.total[mesh, vertex] + offset


@wp.func
def find_largest(
    samples: Offsets,
    block: wp.int32,
    joint: wp.int32,
    mesh: wp.int32,
    # outputs
    sums: Sums,
):
    """Compare a joint's shares in a mesh's sums on every vertex of a block with the largest so far."""
    for i in range(samples.entry_start[joint, block], samples.entry_start[joint, block + 1]):
        entry = natural(i)
        vertex = natural(samples.entry_vertex[entry])
        share = wp.abs(wp.dot(sums.total[mesh, vertex], samples.entry_offset[entry]))
        sums.largest[mesh, vertex] = wp.max(sums.largest[mesh, vertex], share)


@wp.kernel
def blend_offsets(
    first: wp.int32,
    skin: Skin,
    samples: Offsets,
    matrices: wp.array[wp.vec4],
    turns: wp.array[wp.quat],
    corner_start: wp.array[Corners],
    corner_weight: wp.array[CornerWeights],
    strength: wp.array[wp.float32],
    mesh_of_joint: wp.array[wp.int32],
    placement: wp.array[wp.mat33],
    # outputs
    sums: Sums,
    positions: wp.array2d[wp.vec3],
):
    """p(v) = x(v) + Q(v) d(v), d joined from strength_J phi_J(v) delta_J(v, a_J) of all joints of a mesh.

    The first mesh is the garment with its joints; of every other one it is the offset Q(v) d(v) alone.

    Blocks of vertices from ``first`` on; each thread of a split launch has its own part. Joint by joint a block is
    read in long runs, which a CPU takes at several times the speed of vertex by vertex; on a GPU blocks are single
    vertices.

    Args:
        corner_start: Where each corner's sample begins, -1 past the last corner in use, shape [joint_count].
        corner_weight: Weights of the corners; the rest sample's offset is zero and left out.
        mesh_of_joint: Row of ``positions``, shape [mesh_count, vertex_count], that each joint counts in.
        matrices: Of the bones, into the space asked for.
        placement: What takes directions in rig space [m] there, one matrix.
    """
    block = first + wp.tid()
    begin = block * samples.block_size
    end = wp.min(begin + samples.block_size, positions.shape[1])
    for mesh in range(positions.shape[0]):
        for i in range(begin, end):
            vertex = natural(i)
            sums.total[mesh, vertex] = wp.vec3()
            sums.largest[mesh, vertex] = 0.0
    for joint in range(corner_start.shape[0]):
        if corner_start[joint][0] >= 0 and strength[joint] != 0.0:
            mesh = mesh_of_joint[joint]
            add_joint(samples, block, joint, corner_start[joint], corner_weight[joint], strength[joint], mesh, sums)
    for joint in range(corner_start.shape[0]):
        if corner_start[joint][0] >= 0 and strength[joint] != 0.0:
            find_largest(samples, block, joint, mesh_of_joint[joint], sums)
    for i in range(begin, end):
        vertex = natural(i)
        turn = skinned_turn(skin, turns, vertex)
        for mesh in range(positions.shape[0]):
            offset = join_offsets(sums.total[mesh, vertex], sums.largest[mesh, vertex])
            positions[mesh, vertex] = placement[0] * wp.quat_rotate(turn, offset)
        positions[0, vertex] = positions[0, vertex] + skinned_position(skin, matrices, vertex)


@wp.kernel
def take_first_away(positions: wp.array2d[wp.vec3]):
    """Turn all meshes but the first into their offsets from it, shape [mesh_count, vertex_count]."""
    vertex = wp.tid()
    for mesh in range(1, positions.shape[0]):
        positions[mesh, vertex] -= positions[0, vertex]


@wp.struct
class Positions:
    """Samples as positions in rig space, each joint's on the vertices of its two regions (W65).

    The entries of vertex v, one a joint, are entry_start[v] to entry_start[v + 1]; entry_frame numbers the rigid frame
    of the vertex's region as the joint sees it, entry_weight is eq 4's weight.
    """

    entry_start: wp.array[wp.int32]
    entry_joint: wp.array[wp.int32]
    entry_place: wp.array[wp.int32]
    entry_frame: wp.array[wp.int32]
    entry_weight: wp.array[wp.float32]
    positions: wp.array[wp.vec3]


@wp.struct
class Cells:
    """Where each joint stands between its samples, shapes [joint_count] and [joint_count, ...].

    Corner c of a cell takes the upper node of twist, first swing, second swing by its bits 1, 2, 4.
    """

    corner_start: wp.array2d[wp.int32]
    fraction: wp.array[wp.vec3]
    dof: wp.array[wp.int32]
    centre: wp.array[wp.vec3]
    hinge_axis: wp.array[wp.vec3]
    hinge_about_axis: wp.int32
    twist_axis: wp.array2d[wp.vec3]


@wp.func
def interpolate_position(samples: Positions, cells: Cells, joint: wp.int32, place: wp.int32) -> wp.vec3:
    """One vertex of a joint's wrinkle mesh [m]: eq 3 over twist at each swing node, eq 1 over the swings (W69)."""
    t = cells.fraction[joint]
    centre = cells.centre[joint]
    p0 = samples.positions[cells.corner_start[joint, 0] + place]
    if cells.dof[joint] == 1:
        p1 = samples.positions[cells.corner_start[joint, 1] + place]
        if cells.hinge_about_axis != 0:
            return interpolate_about_axis(p0, p1, centre, cells.hinge_axis[joint], t[0])
        return interpolate_about_point(p0, p1, centre, t[0])
    over_first = wp.vec3()
    result = wp.vec3()
    for second in range(2):
        for first in range(2):
            node = first + 2 * second
            low = samples.positions[cells.corner_start[joint, 2 * node] + place]
            high = samples.positions[cells.corner_start[joint, 2 * node + 1] + place]
            twisted = interpolate_about_axis(low, high, centre, cells.twist_axis[joint, node], t[0])
            if first == 0:
                over_first = twisted
            else:
                over_first = interpolate_about_point(over_first, twisted, centre, t[1])
        if second == 0:
            result = over_first
        else:
            result = interpolate_about_point(result, over_first, centre, t[2])
    return result


@wp.kernel
def blend_positions(
    first: wp.int32,
    skin: Skin,
    samples: Positions,
    cells: Cells,
    frames: wp.array[wp.vec4],
    matrices: wp.array[wp.vec4],
    strength: wp.array[wp.float32],
    # outputs
    positions: wp.array[wp.vec3],
):
    """The joints' wrinkle meshes, each carried rigidly with the vertex's region into the pose, averaged by eq 4.

    Bones and frames lead into the space asked for. A joint of strength s gives s of its own mesh and 1 - s of the
    skinned garment; so does a region without joints.
    """
    vertex = first + wp.tid()
    total = wp.vec3()
    used = wp.float32(0.0)
    for entry in range(samples.entry_start[vertex], samples.entry_start[vertex + 1]):
        joint = samples.entry_joint[entry]
        weight = strength[joint] * samples.entry_weight[entry]
        if weight != 0.0:
            p = interpolate_position(samples, cells, joint, samples.entry_place[entry])
            total += weight * transform(frames, samples.entry_frame[entry], p)
            used += weight
    if used != 1.0:
        total += (1.0 - used) * skinned_position(skin, matrices, vertex)
    positions[vertex] = total
