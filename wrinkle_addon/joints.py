"""The joints that make wrinkles, found in any human rig (W10-W14), and their ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from . import rotations
from .anatomy import SIDES, Anatomy, find_anatomy
from .body_frame import limb_points, unit
from .bone_tree import ancestors_of
from .joint_axes import bend_angle, hinge_axis, human_limits, limb_axes, rest_angles, trunk_axes
from .limbs import LIMB_PARTS, Limb
from .rig import FloatArray, Joint, Pose, Rig

JOINT_NAMES = (
    "elbow_L", "elbow_R", "knee_L", "knee_R", "spine", "shoulder_L", "shoulder_R", "hip_L", "hip_R",
)  # fmt: skip

# How much of the shoulder's swing the clavicle takes: it lifts by some 30-40 degrees while the arm rises by 130-150
# (Inman, Saunders & Abbott 1944, Observations on the function of the shoulder joint).
CLAVICLE_SHARE = 0.25

MOST_TWIST = np.radians(120.0)
"""A ball is sampled no further about its limb [rad]: skinned half way, the limb is then cos 60 degrees = half as thick.
Captured arms and legs twist up to 180 degrees for a moment, where the angle also changes its sign."""

_WORDS = {"L": "left", "R": "right"}
_LIMB_OF = {"elbow": "arm", "shoulder": "arm", "knee": "leg", "hip": "leg"}


@dataclass(frozen=True)
class MissingJoint:
    """A joint that was not found: the bones that were considered for it, and one sentence why none of them is it."""

    considered: tuple[str, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class JointSearch:
    """What a search for the nine joints found.

    Attributes:
        joints: Each of :data:`JOINT_NAMES`, None for a missing one.
        missing: Why, for each missing one.
        notes: Sentences on bone names that the shape of the skeleton overruled.
    """

    joints: dict[str, Joint | None]
    missing: dict[str, MissingJoint]
    notes: tuple[str, ...]

    @property
    def found(self) -> list[Joint]:
        return [joint for joint in self.joints.values() if joint is not None]


def find_joints(rig: Rig) -> JointSearch:
    """Find elbows, knees, spine, shoulders and hips by bone names and by the shape of the skeleton."""
    body = find_anatomy(rig)
    joints: dict[str, Joint | None] = dict.fromkeys(JOINT_NAMES)
    for side in SIDES:
        if f"arm_{side}" in body.limbs:
            joints[f"shoulder_{side}"] = _shoulder(rig, body, side)
            joints[f"elbow_{side}"] = _hinge(rig, body, "elbow", side)
        if f"leg_{side}" in body.limbs:
            joints[f"hip_{side}"] = _hip(rig, body, side)
            joints[f"knee_{side}"] = _hinge(rig, body, "knee", side)
    joints["spine"] = _spine(rig, body)
    missing = {name: _explain(rig, body, name) for name, joint in joints.items() if joint is None}
    return JointSearch(joints, missing, body.notes)


def make_joint(
    rig: Rig,
    name: str,
    bones: Sequence[str] | str | None = None,
    near: str | None = None,
    dof: int = 3,
    body: Anatomy | None = None,
) -> Joint:
    """A joint of the user's choice: a wrist, an ankle, the neck or any other (W14).

    Axes follow the table in :mod:`joint_axes`; ranges are human for the kinds listed there, 45 degrees to either side
    for any other.

    Args:
        rig: The rig.
        name: The joint's name, "wrist_L"; what stands before _L or _R is its kind.
        bones: The bones that turn, from the trunk outwards; left out, those found for a wrist, an ankle or the neck.
        near: The bone that angles are measured against; left out, the parent of the first of ``bones``.
        dof: 1 for a hinge about the bend of the rest pose, or else about the left-right axis; 3 for a ball.
        body: The body found in the rig, to save finding it again.

    Raises:
        ValueError: If a bone is not in the rig, none was found, the name cannot be a part of a file's name, or ``dof``
            is neither 1 nor 3.
    """
    if not name.isidentifier():
        raise ValueError(f"'{name}' cannot be a joint's name; use letters, digits and underscores.")
    body = body or find_anatomy(rig)
    names = (bones,) if isinstance(bones, str) else tuple(bones or _found_bones(rig, body, name))
    for bone in (*names, *([near] if near else [])):
        if bone not in rig.index:
            raise ValueError(f"Joint {name} names the bone {bone}, which the rig does not have.")
    indices = [rig.index[bone] for bone in names]
    before = int(body.parents[indices[0]]) if near is None else (rig.index[near] if near else -1)
    kind = name.removesuffix("_L").removesuffix("_R")
    side = name[-1] if name != kind else _side_of(rig, body, indices[-1])
    upper = _direction(rig, before, indices[0]) if before >= 0 else body.frame.up
    lower = unit(_far_point(rig, indices[-1]) - rig.heads[indices[0]])
    if dof == 1:
        axes = hinge_axis("knee" if kind == "knee" else "elbow", upper, lower, body.frame)[None]
        if kind not in ("elbow", "knee") and bend_angle(upper, lower) < 1e-3:
            axes = np.cross(lower, _least_along(lower, body))[None]
    else:
        axes = limb_axes(kind, side, lower, body.frame) if side else trunk_axes(lower, body.frame)
    rest = rest_angles(kind, axes, upper, lower, body.frame)
    return Joint(
        name=name,
        bones=names,
        near=rig.names[before] if before >= 0 else "",
        dof=dof,
        axes=axes,
        limits=human_limits(kind, rest),
        shares=np.full(len(names), 1.0 / len(names)),
    )


def with_ranges(joint: Joint, degrees: ArrayLike) -> Joint:
    """The joint with other ranges.

    Args:
        joint: The joint.
        degrees: Lowest and highest angle for each degree of freedom [degrees], shape [dof, 2] (or [2] for a hinge).

    Raises:
        ValueError: If the shape is wrong, a value is not finite, or a range does not hold 0.
    """
    limits = np.radians(np.asarray(degrees, np.float64)).reshape(-1, 2) if np.size(degrees) == 2 * joint.dof else None
    if limits is None or not np.isfinite(limits).all():
        raise ValueError(f"Joint {joint.name} needs {joint.dof} ranges of a lowest and a highest angle.")
    return replace(joint, limits=limits)


def ranges_from_poses(
    rig: Rig, joints: Sequence[Joint], poses: Sequence[Pose], margin: float = np.radians(5.0)
) -> list[Joint]:
    """The joints limited to the angles that these poses use, plus a margin; every range holds the rest angle 0.

    The twist of a ball goes no further than :data:`MOST_TWIST`. Where the poses move the clavicles, their measured
    share of the shoulder's swing replaces the default.

    Args:
        rig: The rig.
        joints: Its joints.
        poses: Poses of the animation.
        margin: Added at both ends [rad].

    Raises:
        ValueError: If there is no pose.
    """
    if not poses:
        raise ValueError("Ranges cannot be taken from an action without frames.")
    turns = np.stack([pose.turns(rig) for pose in poses])
    return [_fitted(rig, joint, turns, margin) for joint in joints]


def _fitted(rig: Rig, joint: Joint, turns: FloatArray, margin: float) -> Joint:
    near = turns[:, rig.index[joint.near]] if joint.near else np.array([1.0, 0.0, 0.0, 0.0])
    relative = rotations.multiply(rotations.conjugate(near), turns[:, rig.index[joint.far]])
    angles = joint.angles_of_turn(relative)
    low, high = angles.min(0) - margin, angles.max(0) + margin
    limits = np.stack([np.minimum(low, 0.0), np.maximum(high, 0.0)], axis=1)
    if joint.dof == 3:
        limits[0] = np.clip(limits[0], -MOST_TWIST, MOST_TWIST)
    return replace(joint, limits=limits, shares=_measured_shares(rig, joint, turns, near, angles))


def _measured_shares(rig: Rig, joint: Joint, turns: FloatArray, near: FloatArray, angles: FloatArray) -> FloatArray:
    """Shares of the swing that the bones before the far one take in an animation, shape [len(bones)].

    The share of a bone is the slope of its own swing over the joint's, by least squares. Bones that keep still, or move
    on their own account, keep the default.
    """
    uneven = joint.dof == 3 and len(joint.bones) > 1 and np.ptp(joint.shares) > 1e-6
    if not uneven:
        return joint.shares
    swing = angles[:, 1:] @ joint.axes[1:]
    shares = joint.shares.copy()
    before = np.broadcast_to(near, turns[:, 0].shape)
    for i, name in enumerate(joint.bones[:-1]):
        turn = turns[:, rig.index[name]]
        own = rotations.to_rotvec(rotations.multiply(rotations.conjugate(before), turn))
        before = turn
        if np.sqrt((own * own).sum(1).mean()) > np.radians(1.0):
            shares[i] = np.clip((own * swing).sum() / max(float((swing * swing).sum()), 1e-9), 0.0, 0.5)
    shares[:-1] *= min(1.0, 0.6 / max(float(shares[:-1].sum()), 1e-9))
    shares[-1] = 1.0 - shares[:-1].sum()
    return shares


# --- the nine joints ----------------------------------------------------------------------------------------------


def _hinge(rig: Rig, body: Anatomy, kind: str, side: str) -> Joint | None:
    limb = body.limbs[f"{_LIMB_OF[kind]}_{side}"]
    if limb.middle < 0:
        return None
    first, middle, end = limb_points(rig, limb)
    upper, lower = unit(middle - first), unit(end - middle)
    axes = hinge_axis(kind, upper, lower, body.frame)[None]
    return Joint(
        name=f"{kind}_{side}",
        bones=(rig.names[limb.middle],),
        near=rig.names[_bone_before(rig, body, limb)],
        dof=1,
        axes=axes,
        limits=human_limits(kind, rest_angles(kind, axes, upper, lower, body.frame)),
        shares=np.ones(1),
    )


def _bone_before(rig: Rig, body: Anatomy, limb: Limb) -> int:
    """The bone that carries the middle one: its parent, twist bones in between included."""
    parent = int(rig.parents[limb.middle])
    own = parent >= 0 and (parent == limb.first or limb.first in ancestors_of(rig.parents, parent))
    return parent if own else int(body.parents[limb.middle])


def _shoulder(rig: Rig, body: Anatomy, side: str) -> Joint:
    clavicles = body.clavicles[side]
    shares = np.full(len(clavicles) + 1, CLAVICLE_SHARE / max(len(clavicles), 1))
    shares[-1] = 1.0 - shares[:-1].sum()
    return _ball(rig, body, "shoulder", side, (*clavicles, body.limbs[f"arm_{side}"].first), body.chest, shares)


def _hip(rig: Rig, body: Anatomy, side: str) -> Joint:
    return _ball(rig, body, "hip", side, (body.limbs[f"leg_{side}"].first,), body.pelvis, np.ones(1))


def _ball(rig: Rig, body: Anatomy, kind: str, side: str, bones: Sequence[int], near: int, shares: FloatArray) -> Joint:
    first, middle, _ = limb_points(rig, body.limbs[f"{_LIMB_OF[kind]}_{side}"])
    along = unit(middle - first)
    axes = limb_axes(kind, side, along, body.frame)
    return Joint(
        name=f"{kind}_{side}",
        bones=tuple(rig.names[bone] for bone in bones),
        near=rig.names[near] if near >= 0 else "",
        dof=3,
        axes=axes,
        limits=human_limits(kind, rest_angles(kind, axes, along, along, body.frame)),
        shares=shares,
    )


def _spine(rig: Rig, body: Anatomy) -> Joint | None:
    if not body.spine or body.pelvis < 0:
        return None
    return Joint(
        name="spine",
        bones=tuple(rig.names[bone] for bone in body.spine),
        near=rig.names[body.pelvis],
        dof=3,
        axes=trunk_axes(body.frame.up, body.frame),
        limits=human_limits("spine", np.zeros(3)),
        shares=np.full(len(body.spine), 1.0 / len(body.spine)),
    )


def _found_bones(rig: Rig, body: Anatomy, name: str) -> list[str]:
    """Bones of a wrist, an ankle or the neck."""
    limb = body.limbs.get({"wrist": "arm", "ankle": "leg"}.get(name[:-2], "") + name[-2:])
    found = body.neck if name == "neck" else (limb.end,) if limb is not None and limb.end >= 0 else ()
    if not found:
        raise ValueError(f"No bone was found for joint {name}; name the bones that turn.")
    return [rig.names[bone] for bone in found]


# --- directions for joints of the user's choice --------------------------------------------------------------------


def _far_point(rig: Rig, bone: int) -> FloatArray:
    """Where a bone leads to: the middle of its children's heads, or its tail."""
    children = rig.children(bone)
    middle = rig.heads[children].mean(0) if children else rig.tails[bone]
    return middle if np.linalg.norm(middle - rig.heads[bone]) > 1e-6 else rig.tails[bone]


def _direction(rig: Rig, bone: int, child: int) -> FloatArray:
    """Direction of a bone, towards the child's head where that is apart from its own."""
    line = rig.heads[child] - rig.heads[bone]
    return unit(line) if np.linalg.norm(line) > 1e-6 else unit(rig.tails[bone] - rig.heads[bone])


def _side_of(rig: Rig, body: Anatomy, bone: int) -> str:
    """ "L" or "R" for a bone that lies clearly beside the midline, "" on it."""
    middle = rig.heads[body.pelvis if body.pelvis >= 0 else 0]
    beside = float((rig.heads[bone] - middle) @ body.frame.left)
    return "" if abs(beside) < 0.03 * np.ptp(rig.heads @ body.frame.up) else ("L" if beside > 0 else "R")


def _least_along(direction: FloatArray, body: Anatomy) -> FloatArray:
    """Forward, or up for a bone that points forward: where a plain hinge swings its bone."""
    return body.frame.forward if abs(direction @ body.frame.forward) < 0.9 else body.frame.up


# --- what was not found ---------------------------------------------------------------------------------------------


def _explain(rig: Rig, body: Anatomy, name: str) -> MissingJoint:
    if name == "spine":
        return _explain_spine(rig, body)
    kind, side = name.split("_")
    limb = _LIMB_OF[kind]
    place = 1 if kind in ("elbow", "knee") else 0
    named = [
        bone
        for bone, label in enumerate(body.labels)
        if label.part in LIMB_PARTS[limb][place] and label.side in ("", side)
    ]
    taken = {bone for found in body.limbs.values() for bone in (found.first, found.middle, found.end)}
    unused = [bone for bone in range(rig.bone_count) if bone not in taken]
    considered = named or [bone for bone in unused if not body.labels[bone].part] or unused
    word = f"{_WORDS[side]} {limb}"
    if f"{limb}_{side}" in body.limbs:
        bone = rig.names[body.limbs[f"{limb}_{side}"].first]
        reason = f"No {_WORDS[side]} {kind} was found: the {word} has no second long bone below {bone}."
    elif named:
        reason = (
            f"No {word} was found: the bones whose names fit do not lie on a chain of two long parts, "
            "mirrored on the other side."
        )
    else:
        reason = f"No {word} was found: no bone is named for it, and no further pair of long mirrored chains is there."
    return MissingJoint(_names(rig, considered), reason)


def _explain_spine(rig: Rig, body: Anatomy) -> MissingJoint:
    named = [bone for bone, label in enumerate(body.labels) if label.part in ("spine", "chest", "pelvis")]
    known = [bone for bone in (body.pelvis, body.chest) if bone >= 0]
    considered = _names(rig, [*known, *(bone for bone in named if bone not in known)] or list(range(rig.bone_count)))
    if body.pelvis >= 0 and body.pelvis == body.chest:
        reason = f"No spine was found: arms and legs hang on the same bone, {rig.names[body.pelvis]}."
    elif body.pelvis < 0:
        reason = "No spine was found: no bone carries the legs or is named as pelvis."
    else:
        reason = "No spine was found: no bone carries the arms or is named as chest."
    return MissingJoint(considered, reason)


def _names(rig: Rig, bones: Sequence[int]) -> tuple[str, ...]:
    """At most twenty bone names; more would not be read."""
    return tuple(rig.names[bone] for bone in bones[:20])


def joints_to_json(search: JointSearch) -> dict[str, object]:
    """A search as JSON: the nine joints by name, null for a missing one; "considered" and "notes" beside them.

    A hinge has one axis and one range, a ball three of each (twist, then the swings of :mod:`joint_axes`).
    """
    described: dict[str, object] = {name: joint and describe_joint(joint) for name, joint in search.joints.items()}
    described["considered"] = {
        name: {"bones": list(missing.considered), "reason": missing.reason} for name, missing in search.missing.items()
    }
    described["notes"] = list(search.notes)
    return described


def describe_joint(joint: Joint) -> dict[str, object]:
    """One joint as JSON, angles in degrees."""
    axes = [[round(float(value), 6) for value in axis] for axis in joint.axes]
    ranges = [[round(float(value), 3) for value in pair] for pair in np.degrees(joint.limits)]
    return {
        "bones": list(joint.bones),
        "near": joint.near,
        "dof": joint.dof,
        "axis": axes[0] if joint.is_hinge else axes,
        "range_deg": ranges[0] if joint.is_hinge else ranges,
        "shares": [round(float(share), 6) for share in joint.shares],
    }
