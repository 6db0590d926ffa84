"""A clip that goes from sample to sample, so that a bake can be looked at as it will be played."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..wrinkle_addon.plan import Sample


def choose_samples(samples: Sequence[Sample], count: int) -> list[Sample]:
    """So many samples, evenly spread over those of a plan, the last one among them."""
    count = min(count, len(samples))
    return [samples[(k + 1) * len(samples) // count - 1] for k in range(count)]


def make_sample_clip(scene_path: Path, garment: str, database: Path, count: int, path: Path) -> list[str]:
    """Save a copy of a scene whose character takes the poses of samples all over the plan, a frame each from frame 1.

    Samples that have another one's wrinkles are passed over. Returns the others, each as its joint and that joint's
    angles in degrees.
    """
    import bpy

    from ..wrinkle_addon.blender.armature import apply_motion
    from ..wrinkle_addon.database import WrinkleDatabase
    from ..wrinkle_addon.rig import pose_of_angles
    from .studio import open_garment, save

    shown = open_garment(scene_path, garment)
    opened = WrinkleDatabase.open(database)
    header = opened.header
    own = [sample for sample, stored in opened.samples() if "stand_in" not in stored.report]
    turned = [(sample.joint, header.plan.angles(sample)) for sample in choose_samples(own, count)]
    poses = [pose_of_angles(header.rig, header.joints, {joint: angles}) for joint, angles in turned]
    apply_motion(shown.wrinkles.armature, header.rig, poses, "Samples")
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, len(poses)
    save(path)
    return [f"{joint} {', '.join(f'{angle:.0f}' for angle in np.degrees(angles))}" for joint, angles in turned]
