"""Wrinkle flow (Kim and Farbiz): a recording's residual over skinning, taken off it and put back."""

import warp as wp

from .blend import transform
from .skinning import Skin, skinned_position, skinned_turn

wp.set_module_options({"enable_backward": False})


@wp.struct
class BonePose:
    """Bones of one frame: deformations as three rows each, their rotations, and the dual parts of their quaternions.

    Shapes [3 * bone_count], [bone_count] and [bone_count].
    """

    matrices: wp.array[wp.vec4]
    turns: wp.array[wp.quat]
    duals: wp.array[wp.quat]


@wp.func
def dual_quaternion_position(
    skin: Skin, turns: wp.array[wp.quat], duals: wp.array[wp.quat], vertex: wp.int32
) -> wp.vec3:
    """x(v) [m] by dual quaternion skinning (Kavan et al. 2008), blended on the side of the heaviest bone."""
    first = turns[skin.bones[vertex, 0]]
    real = wp.quat(0.0, 0.0, 0.0, 0.0)
    dual = wp.quat(0.0, 0.0, 0.0, 0.0)
    for k in range(skin.weights.shape[1]):
        w = skin.weights[vertex, k]
        if w == 0.0:
            break
        bone = skin.bones[vertex, k]
        if wp.dot(turns[bone], first) < 0.0:
            w = -w
        real = real + w * turns[bone]
        dual = dual + w * duals[bone]
    length = wp.length(real)
    real = real / length
    dual = dual / length
    shift = dual * wp.quat_inverse(real)
    return wp.quat_rotate(real, skin.rest[vertex]) + 2.0 * wp.vec3(shift[0], shift[1], shift[2])


@wp.func
def carried(
    skin: Skin,
    matrices: wp.array[wp.vec4],
    turns: wp.array[wp.quat],
    duals: wp.array[wp.quat],
    dual_quaternions: wp.bool,
    vertex: wp.int32,
) -> wp.vec3:
    """x(v) [m] by the skinning that was chosen."""
    if dual_quaternions:
        return dual_quaternion_position(skin, turns, duals, vertex)
    return skinned_position(skin, matrices, vertex)


@wp.kernel
def take_residuals(
    skin: Skin,
    matrices: wp.array2d[wp.vec4],
    turns: wp.array2d[wp.quat],
    duals: wp.array2d[wp.quat],
    dual_quaternions: wp.bool,
    in_bone_frames: wp.bool,
    to_rig: wp.array2d[wp.vec4],
    first: wp.int32,
    recorded: wp.array2d[wp.vec3],
    # outputs
    residuals: wp.array2d[wp.vec3],
):
    """a = x - x^ (F03) of a stretch of vertices in all frames [m], shape [frame_count, stretch].

    The recording is in any space that ``to_rig``, three rows a frame, takes to rig space.
    """
    frame, place = wp.tid()
    vertex = first + place
    skinned = carried(skin, matrices[frame], turns[frame], duals[frame], dual_quaternions, vertex)
    residual = transform(to_rig[frame], 0, recorded[frame, place]) - skinned
    if in_bone_frames:
        residual = wp.quat_rotate_inv(skinned_turn(skin, turns[frame], vertex), residual)
    residuals[frame, place] = residual


@wp.func
def placed(
    skin: Skin,
    pose: BonePose,
    dual_quaternions: wp.bool,
    in_bone_frames: wp.bool,
    strength: wp.float32,
    placement: wp.array[wp.vec4],
    vertex: wp.int32,
    residual: wp.vec3,
) -> wp.vec3:
    """The skinned vertex with its residual (F06), under the placement."""
    offset = strength * residual
    if in_bone_frames:
        offset = wp.quat_rotate(skinned_turn(skin, pose.turns, vertex), offset)
    skinned = carried(skin, pose.matrices, pose.turns, pose.duals, dual_quaternions, vertex)
    return transform(placement, 0, skinned + offset)


@wp.kernel
def add_residuals(
    first: wp.int32,
    skin: Skin,
    pose: BonePose,
    dual_quaternions: wp.bool,
    in_bone_frames: wp.bool,
    strength: wp.float32,
    placement: wp.array[wp.vec4],
    residuals: wp.array[wp.vec3],
    # outputs
    positions: wp.array[wp.vec3],
):
    """x~ = x^ + a (F06) with residuals that are summed already [m], shape [vertex_count]."""
    vertex = first + wp.tid()
    positions[vertex] = placed(
        skin, pose, dual_quaternions, in_bone_frames, strength, placement, vertex, residuals[vertex]
    )


@wp.kernel
def add_flow(
    first: wp.int32,
    skin: Skin,
    pose: BonePose,
    dual_quaternions: wp.bool,
    in_bone_frames: wp.bool,
    strength: wp.float32,
    placement: wp.array[wp.vec4],
    basis: wp.array2d[wp.vec3],
    coefficients: wp.array[wp.float32],
    # outputs
    positions: wp.array[wp.vec3],
):
    """x~ = x^ + U z (F06); the basis [m] has shape [component_count, vertex_count], its first row is the mean."""
    vertex = first + wp.tid()
    residual = wp.vec3()
    for k in range(basis.shape[0]):
        residual += coefficients[k] * basis[k, vertex]
    positions[vertex] = placed(skin, pose, dual_quaternions, in_bone_frames, strength, placement, vertex, residual)
