"""Motions of a few key poses, for what the demo's motion capture has not: stretching and pointing.

They are authored, not recorded. A key pose holds rotation vectors [degrees] of some joints in the clips' axes (facing
+x, up +y, right +z, all limbs hanging down); joints that are left out stand straight. Cubics lead from pose to pose,
at rest in each.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from ..wrinkle_addon import rotations
from .motion import SKELETON, Clip, load_clip

Vector = tuple[float, float, float]
KeyPose = Mapping[str, Vector]

FRAMES_PER_SECOND = 30
HIPS_HEIGHT = 0.85
"""Of the skeleton as it stands [m]."""

STANDING: KeyPose = {
    "RightArm": (-12.0, 0.0, 0.0),
    "LeftArm": (12.0, 0.0, 0.0),
    "RightForeArm": (0.0, 0.0, 15.0),
    "LeftForeArm": (0.0, 0.0, 15.0),
}
REACHING_UP: KeyPose = {
    "RightArm": (-140.0, 0.0, 0.0),
    "LeftArm": (140.0, 0.0, 0.0),
    "RightForeArm": (0.0, 0.0, 25.0),
    "LeftForeArm": (0.0, 0.0, 25.0),
}
POINTING_AHEAD: KeyPose = {**STANDING, "RightArm": (0.0, 0.0, 95.0), "RightForeArm": (0.0, 0.0, 5.0)}
POINTING_ASIDE: KeyPose = {
    **STANDING,
    "Spine": (0.0, -30.0, 0.0),
    "Neck": (0.0, -30.0, 0.0),
    "RightArm": (-70.0, 0.0, 55.0),
    "RightForeArm": (0.0, 0.0, 5.0),
}
MOTIONS: dict[str, dict[float, KeyPose]] = {
    "stretch": {
        0.0: STANDING,
        0.55: REACHING_UP,
        0.95: {**REACHING_UP, "Spine": (25.0, 0.0, 0.0)},
        1.3: {**REACHING_UP, "Spine": (-10.0, 0.0, 0.0)},
    },
    "point": {0.0: STANDING, 0.4: POINTING_AHEAD, 0.6: POINTING_AHEAD, 1.05: POINTING_ASIDE, 1.3: POINTING_ASIDE},
}
"""Key poses by time [s]."""


def keyframed(name: str) -> Clip:
    """One of :data:`MOTIONS`, frame by frame."""
    keys = MOTIONS[name]
    key_times = np.array(list(keys))
    vectors = np.array([[pose.get(segment.name, (0.0, 0.0, 0.0)) for segment in SKELETON] for pose in keys.values()])
    times = np.arange(round(key_times[-1] * FRAMES_PER_SECOND) + 1) / FRAMES_PER_SECOND
    turned: NDArray[np.float64] = CubicHermiteSpline(key_times, np.deg2rad(vectors), np.zeros_like(vectors))(times)
    positions = np.tile([0.0, HIPS_HEIGHT, 0.0], (len(times), 1))
    return Clip(name, times, positions, rotations.from_rotvec(turned), loops=False)


def find_clip(name: str) -> Clip:
    """A motion of this module, or a recorded one.

    Raises:
        ValueError: If there is neither.
        PackageError: If the recorded ones cannot be had.
    """
    return keyframed(name) if name in MOTIONS else load_clip(name)
