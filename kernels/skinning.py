"""Linear blend skinning with one rotation a vertex: the frame in which offsets are stored."""

import warp as wp

from .natural import natural

wp.set_module_options({"enable_backward": False})


@wp.struct
class Skin:
    """Rest positions [m], shape [vertex_count], and bone influences, heaviest first, shape [vertex_count, count]."""

    rest: wp.array[wp.vec3]
    bones: wp.array2d[wp.int32]
    weights: wp.array2d[wp.float32]


@wp.func
def skinned_position(skin: Skin, matrices: wp.array[wp.vec4], vertex: wp.int32) -> wp.vec3:
    """x(v) [m]: the rest position carried by the blended bone matrices, given as three rows each."""
    rest = skin.rest[vertex]
    p = wp.vec4(rest[0], rest[1], rest[2], 1.0)
    row0 = wp.vec4()
    row1 = wp.vec4()
    row2 = wp.vec4()
    for k in range(skin.weights.shape[1]):
        w = skin.weights[vertex, natural(k)]
        if w == 0.0:
            break
        row = natural(3 * skin.bones[vertex, natural(k)])
        row0 += w * matrices[row]
        row1 += w * matrices[row + 1]
        row2 += w * matrices[row + 2]
    return wp.vec3(wp.dot(row0, p), wp.dot(row1, p), wp.dot(row2, p))


@wp.func
def skinned_turn(skin: Skin, turns: wp.array[wp.quat], vertex: wp.int32) -> wp.quat:
    """Q(v): the normalised weighted quaternion of the bones, each on the side of the heaviest one's."""
    first = turns[skin.bones[vertex, 0]]
    total = wp.quat(0.0, 0.0, 0.0, 0.0)
    for k in range(skin.weights.shape[1]):
        w = skin.weights[vertex, natural(k)]
        if w == 0.0:
            break
        q = turns[natural(skin.bones[vertex, natural(k)])]
        if wp.dot(q, first) < 0.0:
            w = -w
        total = total + w * q
    return wp.normalize(total)
