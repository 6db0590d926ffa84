"""Playing the motion of one skeleton on another, by the joints found on both.

Every body segment that both rigs have (pelvis, spine, neck, head, clavicles, upper arms, forearms, hands, thighs,
shins, feet) takes the orientation that it has in the source. What "the same orientation" means is settled once, at
rest:

- Limbs match by the direction of the segment and by the axis of its hinge. So an arm that rests in a T-pose, an A-pose
  or with a bent elbow ends up pointing the same way, and elbows and knees bend in their own plane.
- The trunk, the neck, the head and the feet match by the body's own directions: both characters stand upright at rest,
  however their spines curve.

Chains of different length (a spine of three bones on one of five) are matched by interpolating along the chain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from . import rotations
from .anatomy import SIDES, Anatomy, find_anatomy
from .body_frame import CLEAR_BEND, BodyFrame, limb_points, unit, without
from .bone_tree import ancestors_of, children_of, descendants, top_down
from .joint_axes import bend_angle
from .rig import FloatArray, Joint, Pose, Rig

# Arms and legs, from the trunk outwards: segment, and the joints at its two ends.
_SEGMENTS = (
    ("upper_arm", "shoulder", "elbow"),
    ("forearm", "elbow", ""),
    ("thigh", "hip", "knee"),
    ("shin", "knee", ""),
)
# A hinge that bends this far in a clip shows its axis [rad].
_TELLING_BEND = np.radians(20.0)
# Legs further from the vertical than this are spread, not standing [rad].
_SPREAD_LEGS = np.radians(12.0)


@dataclass(frozen=True, eq=False)
class _Segment:
    """One body segment of a rig: its bones from the trunk outwards, and its frame at rest, columns in rig space."""

    bones: tuple[int, ...]
    frame: FloatArray
    is_trunk: bool


@dataclass(frozen=True, eq=False)
class _Figure:
    """A rig prepared for retargeting.

    Attributes:
        rig: The rig.
        body: Its anatomy.
        joints: Its joints, those of the anatomy corrected by the user's.
        segments: By name, "pelvis" ... "foot_R".
        pelvis: The bone that carries the legs, -1 if there is none.
        mover: The bone that carries both pelvis and spine, -1 if there is none.
        hips: Rest position that stands for the root's [m].
        leg: Length of the legs at rest [m], or of the arms on a body without legs.
        soles: Bones that can touch the floor, feet, hands and the other segments; empty without feet.
    """

    rig: Rig
    body: Anatomy
    joints: Mapping[str, Joint]
    segments: Mapping[str, _Segment]
    pelvis: int
    mover: int
    hips: FloatArray
    leg: float
    soles: tuple[int, ...]


def retarget(
    source_rig: Rig,
    source_joints: Sequence[Joint],
    source_poses: Sequence[Pose],
    target_rig: Rig,
    target_joints: Sequence[Joint],
) -> list[Pose]:
    """Poses of the target that repeat those of the source.

    Joints that the user corrected are followed. The way travelled is scaled by the length of the legs; the first frame
    stands where the target rests, and the lowest step of the clip is on the floor under its resting feet. Bones of the
    target without a counterpart ride on their parents as they rest.

    Args:
        source_rig: The rig of the clip.
        source_joints: Its joints.
        source_poses: One pose a frame.
        target_rig: The character's rig; may have other bones, another rest pose, size and up axis.
        target_joints: Its joints.

    Raises:
        ValueError: If there is no pose, or the two rigs have no joint in common.
    """
    if not source_poses:
        raise ValueError("The motion has no frames.")
    common = {joint.name for joint in source_joints} & {joint.name for joint in target_joints}
    if not common:
        raise ValueError("The skeleton of the motion and that of the character have no joint in common.")
    source_body, target_body = find_anatomy(source_rig), find_anatomy(target_rig)
    turns = np.stack([pose.turns(source_rig) for pose in source_poses])
    axes = _hinge_axes(source_rig, source_joints, turns, target_rig, target_joints)
    source = _figure(source_rig, source_body, source_joints, axes)
    target = _figure(target_rig, target_body, target_joints, {})
    to_target = target.body.frame.matrix @ source.body.frame.matrix.T
    wanted: dict[int, FloatArray] = {}
    for name, segment in target.segments.items():
        if name in source.segments:
            wanted |= _segment_turns(source, segment, name, turns, to_target)
    travel = _travel(source, target, source_poses, to_target)
    travel += _rise_to_floor(target, _assemble(target, wanted, travel))
    return [Pose(matrices) for matrices in _assemble(target, wanted, travel)]


# --- figures ------------------------------------------------------------------------------------------------------


def _figure(rig: Rig, body: Anatomy, joints: Sequence[Joint], hinge_axes: Mapping[str, FloatArray]) -> _Figure:
    by_name = {joint.name: joint for joint in joints}
    segments: dict[str, _Segment] = {}
    spine = by_name.get("spine")
    pelvis = rig.index[spine.near] if spine and spine.near else body.pelvis
    chain = tuple(rig.index[bone] for bone in spine.bones) if spine else body.spine
    trunk = {"pelvis": (pelvis,) if pelvis >= 0 else (), "spine": chain, "neck": body.neck}
    for side in SIDES:
        shoulder = by_name.get(f"shoulder_{side}")
        trunk[f"clavicle_{side}"] = tuple(rig.index[bone] for bone in shoulder.bones[:-1]) if shoulder else ()
    for name, bones in trunk.items():
        if bones:
            segments[name] = _Segment(bones, body.frame.matrix, is_trunk=True)
    for side in SIDES:
        segments |= _limb_segments(rig, body, by_name, hinge_axes, side)
    soles: set[int] = set()
    if any(name.startswith("foot") for name in segments):
        below = descendants(body.parents)
        for name, segment in segments.items():
            ends = name.startswith(("foot", "hand"))
            soles |= set(np.flatnonzero(below[segment.bones[0]]).tolist() if ends else segment.bones)
    mover = _shared_carrier(body, pelvis, chain)
    thighs = [segments[f"thigh_{side}"].bones[0] for side in SIDES if f"thigh_{side}" in segments]
    hips = rig.heads[thighs].mean(0) if thighs else rig.heads[max(mover, 0)]
    return _Figure(rig, body, by_name, segments, pelvis, mover, hips, _leg_length(rig, body), tuple(sorted(soles)))


def _limb_segments(
    rig: Rig, body: Anatomy, joints: Mapping[str, Joint], hinge_axes: Mapping[str, FloatArray], side: str
) -> dict[str, _Segment]:
    segments: dict[str, _Segment] = {}
    for name, start, stop in _SEGMENTS:
        joint, after = joints.get(f"{start}_{side}"), joints.get(f"{stop}_{side}")
        hinge = joints.get(f"{stop}_{side}" if stop else f"{start}_{side}")
        if joint is None:
            continue
        first = rig.index[joint.far]
        kind = "arm" if name in ("upper_arm", "forearm") else "leg"
        end = rig.index[after.far] if after else _limb_end(body, f"{kind}_{side}", first)
        bones = _path(body, first, end)
        tip = rig.heads[end] if end >= 0 else rig.tails[bones[-1]]
        along = unit(tip - rig.heads[first])
        across = hinge_axes.get(hinge.name, hinge.axes[0]) if hinge and hinge.is_hinge else body.frame.left
        segments[f"{name}_{side}"] = _Segment(bones, _limb_frame(along, across, body.frame), is_trunk=False)
        if not after and end >= 0:
            name_of_end = f"{'hand' if kind == 'arm' else 'foot'}_{side}"
            segments[name_of_end] = _end_segment(rig, body, kind, end, along, across)
    return segments


def _limb_end(body: Anatomy, key: str, first: int) -> int:
    """The hand or foot of a limb, if it hangs below the bone ``first``."""
    limb = body.limbs.get(key)
    if limb is None or limb.end < 0:
        return -1
    return limb.end if first in ancestors_of(body.parents, limb.end) else -1


def _path(body: Anatomy, first: int, end: int) -> tuple[int, ...]:
    """Bones from ``first`` down to, without, ``end``."""
    above = ancestors_of(body.parents, end) if end >= 0 else []
    return tuple(reversed(above[: above.index(first) + 1])) if first in above else (first,)


def _limb_frame(along: FloatArray, across: FloatArray, frame: BodyFrame) -> FloatArray:
    """Right-handed frame of a limb segment: its direction, its hinge's axis and their product, shape [3, 3]."""
    side = without(across, along)
    if not side.any():
        side = without(frame.forward, along)
    return np.stack([along, side, np.cross(along, side)], axis=1)


def _end_segment(rig: Rig, body: Anatomy, kind: str, end: int, along: FloatArray, across: FloatArray) -> _Segment:
    children = [child for child in children_of(body.parents, end) if not body.labels[child].helper]
    tip = rig.heads[children].mean(0) if children else rig.tails[end]
    line = tip - rig.heads[end]
    if kind == "arm":
        # Fingers lead on from the forearm; a tail that does not is an importer's invention.
        straight = unit(line) @ along > 0.5
        return _Segment((end,), _limb_frame(unit(line) if straight else along, across, body.frame), is_trunk=False)
    # Feet match by the floor and by where the toes point: they stand flat at rest, unless the legs are spread so far
    # that the figure cannot be standing; then the soles are square to the shins.
    sole = without(-along, body.frame.forward)
    if sole @ body.frame.up > np.cos(_SPREAD_LEGS):
        sole = body.frame.up
    toes = without(line, sole)
    if np.linalg.norm(line - (line @ sole) * sole) < 0.3 * np.linalg.norm(line) or toes @ body.frame.forward < 0.5:
        toes = without(body.frame.forward, sole)
    return _Segment((end,), np.stack([np.cross(sole, toes), sole, toes], axis=1), is_trunk=False)


def _shared_carrier(body: Anatomy, pelvis: int, spine: Sequence[int]) -> int:
    """The lowest bone that carries (or is) the pelvis and carries the spine."""
    above_spine = ancestors_of(body.parents, spine[0]) if spine else []
    if pelvis < 0:
        return next(iter(above_spine), -1)
    return next((bone for bone in (pelvis, *ancestors_of(body.parents, pelvis)) if bone in above_spine), pelvis)


def _leg_length(rig: Rig, body: Anatomy) -> float:
    """Length that sets the scale between two figures [m]: of the legs, or else of the arms, or of the whole rig."""
    for kind in ("leg", "arm"):
        limbs = [limb_points(rig, limb) for key, limb in body.limbs.items() if key.startswith(kind)]
        if limbs:
            return float(np.mean([np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for points in limbs]))
    return float(np.linalg.norm(np.ptp(rig.heads, axis=0))) or 1.0


# --- hinge axes ---------------------------------------------------------------------------------------------------


def _hinge_axes(
    source_rig: Rig,
    source_joints: Sequence[Joint],
    turns: FloatArray,
    target_rig: Rig,
    target_joints: Sequence[Joint],
) -> dict[str, FloatArray]:
    """Axes of the source's straight hinges as its motion shows them, where the target's rest pose shows its own.

    A limb that is straight at rest has its hinge axis from anatomy only. Two such guesses agree with each other; a
    guess and a measured axis need not, so then the guess gives way to what the clip shows.
    """
    axes: dict[str, FloatArray] = {}
    targets = {joint.name: joint for joint in target_joints}
    for joint in source_joints:
        other = targets.get(joint.name)
        if other is None or not (joint.is_hinge and other.is_hinge):
            continue
        if _rest_bend(target_rig, other) < CLEAR_BEND or _rest_bend(source_rig, joint) > CLEAR_BEND:
            continue
        axis = _axis_in_motion(source_rig, joint, turns)
        if axis is not None:
            axes[joint.name] = axis
    return axes


def _segment_directions(rig: Rig, joint: Joint) -> tuple[FloatArray, FloatArray]:
    """Directions of the bones before and after a hinge at rest."""
    far = rig.index[joint.far]
    near = rig.index[joint.near] if joint.near else far
    children = rig.children(far)
    lengths = [float(np.linalg.norm(rig.heads[child] - rig.heads[far])) for child in children]
    tip = rig.heads[children[int(np.argmax(lengths))]] if children else rig.tails[far]
    return unit(rig.heads[far] - rig.heads[near]), unit(tip - rig.heads[far])


def _rest_bend(rig: Rig, joint: Joint) -> float:
    return bend_angle(*_segment_directions(rig, joint))


def _axis_in_motion(rig: Rig, joint: Joint, turns: FloatArray) -> FloatArray | None:
    """The mean axis about which a clip bends a hinge, None if it never bends clearly, shape [3]."""
    upper, lower = _segment_directions(rig, joint)
    far, near = rig.index[joint.far], rig.index[joint.near]
    relative = rotations.multiply(rotations.conjugate(turns[:, near]), turns[:, far])
    bent = np.cross(upper, rotations.rotate(relative, lower))
    if np.linalg.norm(bent, axis=1).max() < np.sin(_TELLING_BEND):
        return None
    axis = unit(bent.sum(0))
    # A bend to all sides has no axis, and one far from anatomy is an error of the recording.
    steady = np.linalg.norm(bent.sum(0)) > 0.7 * np.linalg.norm(bent, axis=1).sum()
    return axis if steady and axis @ joint.axes[0] > 0.5 else None


# --- turns --------------------------------------------------------------------------------------------------------


def _segment_turns(
    source: _Figure, segment: _Segment, name: str, turns: FloatArray, to_target: FloatArray
) -> dict[int, FloatArray]:
    """Absolute turns of the target's bones of one segment in every frame, bone to [frame_count, 4]."""
    other = source.segments[name]
    count = len(segment.bones)
    before = rotations.from_matrices(to_target)
    after = rotations.from_matrices(other.frame @ segment.frame.T)
    if segment.is_trunk:
        after = rotations.conjugate(before)
    result: dict[int, FloatArray] = {}
    for i, bone in enumerate(segment.bones):
        if segment.is_trunk:
            turn = _along_chain(turns, _carrier_of(source, name), other.bones, (i + 1) / count * len(other.bones))
        else:
            place = i / (count - 1) if count > 1 else 1.0
            turn = _along_chain(turns, other.bones[0], other.bones[1:], place * (len(other.bones) - 1))
        result[bone] = rotations.multiply(rotations.multiply(before, turn), after)
    return result


def _carrier_of(source: _Figure, name: str) -> int:
    """The bone of the source on which a chain of the trunk stands; the pelvis stands on nothing."""
    below = {"pelvis": "pelvis", "spine": "pelvis", "neck": "spine", "clavicle_L": "spine", "clavicle_R": "spine"}[name]
    for segment in (below, "pelvis"):
        if segment in source.segments and segment != name:
            return source.segments[segment].bones[-1]
    return source.segments[name].bones[0]


def _along_chain(turns: FloatArray, start: int, bones: Sequence[int], place: float) -> FloatArray:
    """Turns between those of ``start`` (place 0) and of the last of ``bones`` (place len(bones)), shape [frames, 4]."""
    chain = [start, *bones]
    i = min(int(place), len(chain) - 1)
    if i == len(chain) - 1 or place - i < 1e-9:
        return turns[:, chain[i]]
    return rotations.slerp(turns[:, chain[i]], turns[:, chain[i + 1]], place - i)


# --- places -------------------------------------------------------------------------------------------------------


def _travel(source: _Figure, target: _Figure, poses: Sequence[Pose], to_target: FloatArray) -> FloatArray:
    """Where the target's hips go, starting where they rest [m], shape [frame_count, 3]."""
    bone = max(source.pelvis if source.pelvis >= 0 else source.mover, 0)
    carried = np.stack([pose.matrices[bone] for pose in poses]) @ source.rig.rest_inverse[bone]
    places = carried[:, :3, :3] @ source.hips + carried[:, :3, 3]
    return target.hips + (places - places[0]) @ to_target.T * (target.leg / source.leg)


def _rise_to_floor(target: _Figure, matrices: FloatArray) -> FloatArray:
    """Shift that brings the lowest step (or hand) of a clip to the height of the resting feet [m], shape [3]."""
    if not target.soles:
        return np.zeros(3)
    up, soles = target.body.frame.up, list(target.soles)
    return ((target.rig.heads[soles] @ up).min() - (matrices[:, soles, :3, 3] @ up).min()) * up


def _assemble(target: _Figure, wanted: Mapping[int, FloatArray], travel: FloatArray) -> FloatArray:
    """Posed matrices from absolute turns, every bone at its place on its parent, shape [frames, bones, 4, 4]."""
    rig, parents = target.rig, target.body.parents
    deformations = np.tile(np.eye(4), (len(travel), rig.bone_count, 1, 1))
    for bone in top_down(parents):
        parent = int(parents[bone])
        carrier = deformations[:, parent if parent >= 0 else bone]
        if bone == target.mover:
            still = np.tile([1.0, 0.0, 0.0, 0.0], (len(travel), 1))
            deformations[:, bone] = _rigid(wanted.get(target.pelvis, still), target.hips, travel)
        elif bone in wanted:
            head = carrier[:, :3, :3] @ rig.heads[bone] + carrier[:, :3, 3]
            deformations[:, bone] = _rigid(wanted[bone], rig.heads[bone], head)
        else:
            deformations[:, bone] = carrier
    return deformations @ rig.rest


def _rigid(turn: FloatArray, rest_point: FloatArray, point: FloatArray) -> FloatArray:
    """Matrices that turn and carry a rest point to a point, shape [frame_count, 4, 4]."""
    matrices = np.tile(np.eye(4), (len(turn), 1, 1))
    matrices[:, :3, :3] = rotations.to_matrices(turn)
    matrices[:, :3, 3] = point - matrices[:, :3, :3] @ rest_point
    return matrices
