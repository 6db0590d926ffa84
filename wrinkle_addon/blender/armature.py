"""Armatures: their deforming skeleton and their poses into arrays, and motion back onto their bones."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..bone_tree import parents_among, top_down
from ..rig import FloatArray, Pose, Rig

# Scales that differ by less than this are one scale; object scales are single precision.
_SCALE_TOLERANCE = 1e-3
# Channels that never leave rest by more than this get no keys [rad, m].
_STILL = 1e-6


# --- reading ------------------------------------------------------------------------------------------------------


def read_rig(armature: bpy.types.Object, scene: bpy.types.Scene | None = None) -> Rig:
    """The deforming bones of an armature at rest, in rig space: the object's own axes, in metres.

    The object's scale and the scene's unit scale are folded into the lengths. A bone's parent is its nearest deforming
    ancestor; where an ancestor does not deform but has a deforming twin in its place (generated Rigify rigs: ORG- and
    DEF-), the twin.

    Args:
        armature: The armature object.
        scene: The scene whose units count; left out, the current one.

    Raises:
        ValueError: If no bone deforms, or the object is scaled unevenly or mirrored; one sentence.
    """
    if not any(bone.use_deform for bone in armature.data.bones):
        raise ValueError(
            f"The armature {armature.name} has no deforming bones; switch on Deform for the bones that move its meshes."
        )
    scale = rig_scale(armature, scene)
    every = list(armature.data.bones)
    place = {bone.name: i for i, bone in enumerate(every)}
    above = parents_among(
        parents=np.array([place[bone.parent.name] if bone.parent else -1 for bone in every], np.int32),
        kept=np.array([bone.use_deform for bone in every]),
        heads=np.array([bone.head_local for bone in every], np.float64),
        directions=np.array([bone.matrix_local.col[1][:3] for bone in every], np.float64),
    )
    order = [i for i in top_down(above) if every[i].use_deform]
    row = {i: new for new, i in enumerate(order)}
    rest = np.array([every[i].matrix_local for i in order], np.float64)
    rest[:, :3, 3] *= scale
    down = armature.matrix_world.to_3x3().normalized().inverted() @ Vector((0.0, 0.0, -1.0))
    return Rig(
        names=tuple(every[i].name for i in order),
        parents=np.array([row.get(int(above[i]), -1) for i in order], np.int32),
        rest=rest,
        lengths=np.array([every[i].length for i in order], np.float64) * scale,
        gravity=np.array(down.normalized(), np.float64),
    )


def rig_scale(armature: bpy.types.Object, scene: bpy.types.Scene | None = None) -> float:
    """Metres per unit of the armature's own space.

    Raises:
        ValueError: If the object is scaled unevenly, sheared or mirrored.
    """
    axes = np.array(armature.matrix_world.to_3x3(), np.float64)
    lengths = np.linalg.norm(axes, axis=0)
    scale = float(lengths.mean())
    uneven = scale <= 0.0 or np.abs(axes.T @ axes / (scale * scale) - np.eye(3)).max() > _SCALE_TOLERANCE
    if uneven or np.linalg.det(axes) < 0.0:
        raise ValueError(
            f"The armature {armature.name} is scaled unevenly or mirrored "
            f"({', '.join(f'{length:.3g}' for length in lengths)}); apply its scale."
        )
    return scale * float((scene or bpy.context.scene).unit_settings.scale_length)


class PoseReader:
    """Reads the poses of one rig from its evaluated armature, in one call and without allocating the large arrays."""

    def __init__(self, armature: bpy.types.Object, rig: Rig, scene: bpy.types.Scene | None = None) -> None:
        """Prepare for an armature.

        Raises:
            ValueError: If a bone of the rig is gone from the armature.
        """
        names = [bone.name for bone in armature.pose.bones]
        place = {name: i for i, name in enumerate(names)}
        missing = [name for name in rig.names if name not in place]
        if missing:
            raise ValueError(f"The armature {armature.name} has lost the bone {missing[0]}; set the garment up again.")
        self._bones = np.array([place[name] for name in rig.names])
        self._scale = rig_scale(armature, scene)
        self._buffer = np.empty(len(names) * 16, np.float32)

    def read(self, evaluated: bpy.types.Object) -> Pose:
        """The pose of ``armature.evaluated_get(depsgraph)``.

        Raises:
            ValueError: If bones were added or removed since the reader was made.
        """
        bones = evaluated.pose.bones
        if len(bones) * 16 != len(self._buffer):
            raise ValueError(f"The armature {evaluated.name} has other bones than before; set the garment up again.")
        bones.foreach_get("matrix", self._buffer)
        # Blender hands matrices over column by column.
        matrices = self._buffer.reshape(-1, 4, 4).transpose(0, 2, 1)[self._bones].astype(np.float64)
        matrices[:, :3, 3] *= self._scale
        return Pose(matrices)


def read_pose(evaluated: bpy.types.Object, rig: Rig) -> Pose:
    """One pose of an evaluated armature; for many, keep a :class:`PoseReader`."""
    return PoseReader(evaluated, rig).read(evaluated)


# --- writing ------------------------------------------------------------------------------------------------------


def apply_motion(
    armature: bpy.types.Object,
    rig: Rig,
    poses: Sequence[Pose],
    name: str = "Motion",
    start: int = 1,
    scene: bpy.types.Scene | None = None,
) -> list[str]:
    """Key poses onto an armature's deforming bones, one frame a pose, as a new action.

    Whatever else moves these bones is silenced: constraints and drivers on them and on the bones that carry them, and
    NLA tracks. Control bones and IK targets stay as they rest. The keyed bones turn to quaternions.

    Args:
        armature: The armature object; its mode, and everything but its animation, is left alone.
        rig: The rig read from it.
        poses: One pose a frame, in rig space.
        name: Name of the new action.
        start: Frame of the first pose.
        scene: The scene whose units count; left out, the current one.

    Returns:
        Sentences on what was silenced.

    Raises:
        ValueError: If there is no pose.
    """
    if not poses:
        raise ValueError("There is no pose to key.")
    carried = _with_carriers(armature, rig)
    notes = _silence(armature, carried)
    scale = rig_scale(armature, scene)
    posed = np.stack([pose.matrices for pose in poses])
    posed[..., :3, 3] /= scale
    locals_ = local_matrices(armature, rig, carried, posed)
    channels = _new_action(armature, name)
    stuck = []
    for bone_name, matrices in locals_.items():
        bone = armature.pose.bones[bone_name]
        bone.matrix_basis = Matrix.Identity(4)
        bone.rotation_mode = "QUATERNION"
        turns, places = _turns_and_places(matrices)
        if np.abs(turns[:, 1:]).max() > _STILL:
            _key(channels, bone.path_from_id("rotation_quaternion"), turns, start, bone_name)
        if np.abs(places).max() > _STILL / scale:
            if bone.bone.use_connect:
                stuck.append(f"{bone_name} ({np.abs(places).max() * scale * 1e3:.1f} mm)")
            else:
                _key(channels, bone.path_from_id("location"), places, start, bone_name)
    if stuck:
        notes.append(f"These bones are connected to their parents and cannot leave them: {', '.join(stuck)}.")
    return notes


def _with_carriers(armature: bpy.types.Object, rig: Rig) -> list[bpy.types.Bone]:
    """The rig's bones and all bones above them, parents first."""
    names = {above.name for name in rig.names for above in armature.data.bones[name].parent_recursive}
    names |= set(rig.names)
    return sorted((armature.data.bones[name] for name in names), key=lambda bone: len(bone.parent_recursive))


def _silence(armature: bpy.types.Object, bones: Sequence[bpy.types.Bone]) -> list[str]:
    """Mute what would fight the keys; sentences on what was muted."""
    notes: list[str] = []
    if armature.data.pose_position == "REST":
        armature.data.pose_position = "POSE"
        notes.append(f"The armature {armature.name} was shown in its rest position, and is now posed.")
    constrained = 0
    for bone in bones:
        for constraint in armature.pose.bones[bone.name].constraints:
            constrained += not constraint.mute
            constraint.mute = True
    if constrained:
        notes.append(
            f"{constrained} constraints on the keyed bones of {armature.name} are muted; its controls do not move."
        )
    animation = armature.animation_data
    if animation is not None:
        paths = tuple(f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"].' for bone in bones)
        driven = [curve for curve in animation.drivers if curve.data_path.startswith(paths) and not curve.mute]
        for curve in driven:
            curve.mute = True
        tracks = [track for track in animation.nla_tracks if not track.mute]
        for track in tracks:
            track.mute = True
        if driven:
            notes.append(f"{len(driven)} drivers on the keyed bones of {armature.name} are muted.")
        if tracks:
            notes.append(f"{len(tracks)} NLA tracks of {armature.name} are muted.")
        if animation.action is not None:
            notes.append(f"The action {animation.action.name} of {armature.name} is replaced.")
    return notes


def local_matrices(
    armature: bpy.types.Object, rig: Rig, bones: Sequence[bpy.types.Bone], posed: FloatArray
) -> dict[str, list[Matrix]]:
    """Local matrices (``matrix_basis``) of the bones that give the posed matrices, bone to one matrix a frame.

    Bones above that do not deform keep their local rest, and are in the result as identities.
    """
    result: dict[str, list[Matrix]] = {bone.name: [] for bone in bones}
    identity = Matrix.Identity(4)
    for frame in posed:
        placed: dict[str, Matrix] = {}
        for bone in bones:
            rest, parent = bone.matrix_local, bone.parent
            above = {"parent_matrix": placed[parent.name], "parent_matrix_local": parent.matrix_local} if parent else {}
            row = rig.index.get(bone.name)
            if row is None:
                placed[bone.name] = bone.convert_local_to_pose(identity, rest, **above)
                result[bone.name].append(identity)
            else:
                placed[bone.name] = Matrix(frame[row].tolist())
                local = bone.convert_local_to_pose(placed[bone.name], rest, invert=True, **above)
                result[bone.name].append(local)
    return result


def _turns_and_places(matrices: Sequence[Matrix]) -> tuple[FloatArray, FloatArray]:
    """Quaternions without jumps of sign, shape [frame_count, 4], and translations, shape [frame_count, 3]."""
    turns = np.array([matrix.to_quaternion() for matrix in matrices], np.float64)
    for i in range(1, len(turns)):
        if turns[i] @ turns[i - 1] < 0.0:
            turns[i] *= -1.0
    return turns, np.array([matrix.translation for matrix in matrices], np.float64)


def _new_action(armature: bpy.types.Object, name: str) -> bpy.types.ActionChannelbag:
    """A new layered action on the armature, ready for curves (Blender 4.4 and later)."""
    action = bpy.data.actions.new(name)
    slot = action.slots.new(id_type="OBJECT", name=armature.name)
    animation = armature.animation_data_create()
    animation.action = action
    animation.action_slot = slot
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True)


def _key(channels: bpy.types.ActionChannelbag, path: str, values: FloatArray, start: int, group: str) -> None:
    """One linear curve for each column of ``values``, one key a frame."""
    folder = channels.groups.get(group) or channels.groups.new(group)
    for column in range(values.shape[1]):
        curve = channels.fcurves.new(path, index=column)
        curve.group = folder
        curve.keyframe_points.add(len(values))
        points = np.stack([np.arange(start, start + len(values), dtype=np.float64), values[:, column]], axis=1)
        curve.keyframe_points.foreach_set("co", points.ravel())
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
        curve.update()
