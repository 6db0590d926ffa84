"""Axes and human ranges of joints, read from the rest pose.

Signs follow one rule: **a pose mirrored across the body has the same angles at the mirrored joint**. So positive means
the same movement on both sides:

========  =========================  ==========================  ====================================
joint     hinge, or twist            first swing                 second swing
========  =========================  ==========================  ====================================
elbow     flexion
knee      flexion (shin backwards)
shoulder  internal rotation          abduction (raise sideways)  flexion (bring forward)
hip       internal rotation          flexion (raise forward)     abduction (spread)
limb end  internal rotation          flexion (bring forward)     abduction (away from the midline)
spine     turning to the left        bending forward             bending to the left
========  =========================  ==========================  ====================================

The spine and other joints on the midline are their own mirror image: there turning and sideways bending change sign.
The swing axes of a limb are those of the hanging limb (straight down: flexion about the left-right axis, abduction
about the front-back axis), carried by the shortest turn from hanging to where the limb rests; so they mean the same in
a T-pose and in an A-pose. The spine turns about the body's own vertical, however it curves.
"""

from __future__ import annotations

import numpy as np

from . import rotations
from .body_frame import CLEAR_BEND, BodyFrame, unit, without
from .rig import FloatArray

# Lowest and highest angle against the anatomical neutral pose (standing, arms hanging, limbs straight) [degrees], in
# the order of the table above: the normal ranges of the American Academy of Orthopaedic Surgeons (Joint Motion: Method
# of Measuring and Recording, 1965), also in Norkin & White, Measurement of Joint Motion. The swing of the shoulder is
# the one that daily tasks use (Namdari et al. 2012, J. Shoulder Elbow Surg. 21, 1177-1183: flexion 121, extension 46,
# abduction 128), because a swing near a half turn has no unique axis.
HUMAN_RANGES: dict[str, tuple[tuple[float, float], ...]] = {
    "elbow": ((0.0, 150.0),),
    "knee": ((0.0, 135.0),),
    "shoulder": ((-90.0, 70.0), (0.0, 128.0), (-46.0, 121.0)),
    "hip": ((-45.0, 45.0), (-30.0, 120.0), (-30.0, 45.0)),
    "spine": ((-45.0, 45.0), (-25.0, 80.0), (-35.0, 35.0)),
    "wrist": ((-80.0, 80.0), (-70.0, 80.0), (-30.0, 20.0)),
    "ankle": ((-5.0, 5.0), (-50.0, 20.0), (-35.0, 15.0)),
    "neck": ((-60.0, 60.0), (-45.0, 45.0), (-45.0, 45.0)),
}


def hinge_axis(kind: str, upper: FloatArray, lower: FloatArray, frame: BodyFrame) -> FloatArray:
    """Axis of an elbow or a knee, positive when it flexes, shape [3].

    A rest bend of more than 5 degrees tells the axis; a straighter limb, or one that is bent where no such joint bends,
    takes it from anatomy: a shin folds backwards about the left-right axis, a forearm folds forward.

    Args:
        kind: "elbow" or "knee".
        upper: Direction of the upper arm or thigh at rest, unit vector, shape [3].
        lower: Direction of the forearm or shin, shape [3].
        frame: The body's directions.
    """
    anatomical = _anatomical_hinge_axis(kind, unit(upper + lower), frame)
    bend = bend_angle(upper, lower)
    if bend > CLEAR_BEND:
        bent = unit(np.cross(upper, lower))
        tolerance = min(bend + np.radians(30.0 if kind == "knee" else 45.0), np.radians(90.0))
        if bent @ anatomical > np.cos(tolerance):
            return bent
    return anatomical


def bend_angle(upper: FloatArray, lower: FloatArray) -> float:
    """Angle between two directions [rad]."""
    return float(np.arctan2(np.linalg.norm(np.cross(upper, lower)), upper @ lower))


def _anatomical_hinge_axis(kind: str, along: FloatArray, frame: BodyFrame) -> FloatArray:
    towards = -frame.forward if kind == "knee" else frame.forward
    if abs(along @ towards) > 0.95:
        towards = frame.up
    return np.cross(along, without(towards, along))


def limb_axes(kind: str, side: str, along: FloatArray, frame: BodyFrame) -> FloatArray:
    """Twist and two swing axes of a joint of a limb, by the table above, shape [3, 3].

    Args:
        kind: "shoulder" has abduction first; every other kind has flexion first.
        side: "L" or "R".
        along: Direction of the limb at rest, unit vector, shape [3].
        frame: The body's directions.
    """
    outwards = 1.0 if side == "L" else -1.0
    forward = rotations.rotate(rotations.between(-frame.up, along), frame.forward)
    abduction, flexion = outwards * forward, np.cross(along, forward)
    swings = [abduction, flexion] if kind == "shoulder" else [flexion, abduction]
    return np.stack([outwards * along, *swings])


def trunk_axes(along: FloatArray, frame: BodyFrame) -> FloatArray:
    """Turning to the left, bending forward and bending to the left about a trunk that rests along ``along``, [3, 3]."""
    carried = rotations.between(frame.up, along)
    forward, left = rotations.rotate(carried, frame.forward), rotations.rotate(carried, frame.left)
    return np.stack([along, left, -forward])


def rest_angles(kind: str, axes: FloatArray, upper: FloatArray, lower: FloatArray, frame: BodyFrame) -> FloatArray:
    """Angles of the rest pose against the anatomical neutral one [rad], shape [dof].

    Args:
        kind: The joint's kind, "elbow" ... "neck".
        axes: The joint's axes, shape [dof, 3].
        upper: Direction of the segment before the joint at rest, shape [3].
        lower: Direction of the segment after it, shape [3].
        frame: The body's directions.
    """
    if len(axes) == 1:
        return np.array([np.arctan2(axes[0] @ np.cross(upper, lower), upper @ lower)])
    if kind in ("shoulder", "hip"):
        # The axes are carried along by the same turn, so its parts about them are those about the hanging axes.
        swing = rotations.to_rotvec(rotations.between(-frame.up, lower))
        return np.array([0.0, *(axes[1:] @ swing)])
    return np.zeros(3)


def human_limits(kind: str, rest: FloatArray) -> FloatArray:
    """Human range of a joint relative to its rest pose [rad], shape [dof, 2]; it always holds 0.

    An unknown kind gets 45 degrees to either side.
    """
    ranges = HUMAN_RANGES.get(kind, ((-45.0, 45.0),) * len(rest))
    limits = np.radians(np.array(ranges)) - rest[:, None]
    return np.stack([np.minimum(limits[:, 0], 0.0), np.maximum(limits[:, 1], 0.0)], axis=1)
