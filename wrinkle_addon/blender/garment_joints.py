"""The joints of a garment that was set up: choosing, adding, removing them, and their ranges."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np

from ..joints import make_joint, ranges_from_poses, with_ranges
from ..symmetry import other_side
from .armature import read_rig
from .clip import parse_frames, read_clip
from .properties import GarmentSettings, JointSettings


def find_joint(settings: GarmentSettings, name: str) -> JointSettings:
    """A joint by its name.

    Raises:
        ValueError: If the garment has no such joint; the sentence lists those it has.
    """
    for joint in settings.joints:
        if joint.name == name:
            return joint
    known = ", ".join(joint.name for joint in settings.joints) or "none"
    raise ValueError(f"The garment has no joint '{name}'; its joints: {known}.")


def choose_joints(settings: GarmentSettings, names: Sequence[str]) -> None:
    """Sample these joints and no others."""
    chosen = [find_joint(settings, name).name for name in names]
    for joint in settings.joints:
        joint.enabled = joint.name in chosen


def add_joint(garment: bpy.types.Object, name: str, bones: Sequence[str] = (), dof: int = 3) -> None:
    """Add a joint, or give one of this name other bones; its range is human where its kind is known.

    Args:
        bones: The bones that turn, from the trunk outwards; left out, those found for a wrist, an ankle or the neck.
        dof: 1 for a hinge, 3 for a ball.

    Raises:
        ValueError: If the rig has no such bone, or the joint was not found.
    """
    settings = garment.wrinkles
    joint = make_joint(read_rig(settings.armature), name, bones or None, dof=dof)
    for stored in settings.joints:
        if stored.name == name:
            stored.store(joint)
            return
    settings.joints.add().store(joint)


def remove_joint(settings: GarmentSettings, name: str) -> None:
    """Remove a joint; its strength is forgotten with it."""
    found = find_joint(settings, name)
    settings.joints.remove(next(i for i, joint in enumerate(settings.joints) if joint == found))


def set_range(settings: GarmentSettings, name: str, degrees: Sequence[tuple[float, float]]) -> None:
    """Set the lowest and highest angle [degrees] of each degree of freedom.

    Raises:
        ValueError: If there are too many or too few, or a range does not hold the rest pose, 0.
    """
    stored = find_joint(settings, name)
    stored.store(with_ranges(stored.joint(), degrees))


def mirror_joint(settings: GarmentSettings, name: str) -> None:
    """Give the joint on the other side this one's range, mirrored, its step and its strength.

    Raises:
        ValueError: If there is no such joint, or the character is not known to be symmetric.
    """
    joint, partner = find_joint(settings, name), find_joint(settings, other_side(name))
    signs = json.loads(settings.mirror_signs or "{}").get(name)
    if signs is None and joint.joint().dof > 1:
        raise ValueError(
            f"It is not known how the angles of {name} mirror; set the range of {partner.name} by hand. "
            f"{settings.asymmetry}".rstrip()
        )
    for axis, sign in enumerate(signs or [1.0]):
        low, high = sorted((sign * joint.low[axis], sign * joint.high[axis]))
        partner.low[axis], partner.high[axis] = low, high
    partner.step, partner.strength, partner.enabled = joint.step, joint.strength, joint.enabled


def take_ranges(garment: bpy.types.Object, frames: Sequence[float], margin: float) -> None:
    """Set the joints' ranges to what some frames of the animation use, plus a margin [rad]."""
    settings = garment.wrinkles
    rig = read_rig(settings.armature)
    poses = [clip.pose for clip in read_clip(garment, rig, frames)]
    joints = ranges_from_poses(rig, [stored.joint() for stored in settings.joints], poses, margin)
    for stored, joint in zip(settings.joints, joints, strict=True):
        stored.store(joint)


def take_named_ranges(garment: bpy.types.Object, name: str, margin: float) -> None:
    """Set the joints' ranges to what an action of this name uses, or frames FIRST:LAST of the animation.

    Raises:
        ValueError: If it is neither; the sentence lists the file's actions.
    """
    action = bpy.data.actions.get(name)
    if action is not None:
        with _playing(garment.wrinkles.armature, action) as frames:
            take_ranges(garment, frames, margin)
        return
    if not set(name) <= set("0123456789:-"):
        names = ", ".join(sorted(action.name for action in bpy.data.actions)) or "none"
        raise ValueError(f"The file has no action '{name}'; its actions: {names}.")
    take_ranges(garment, parse_frames(name), margin)


@contextmanager
def _playing(armature: bpy.types.Object, action: bpy.types.Action) -> Iterator[list[int]]:
    """Let an armature play an action alone for a while; gives the action's frames."""
    animation = armature.animation_data_create()
    before = animation.action, animation.action_slot, animation.use_nla
    try:
        animation.use_nla = False
        animation.action = action
        if animation.action_slot is None:
            slots = animation.action_suitable_slots
            if not len(slots):
                raise ValueError(f"The action '{action.name}' does not move an armature; choose another one.")
            animation.action_slot = slots[0]
        first, last = action.frame_range
        yield list(range(int(np.floor(first)), int(np.ceil(last)) + 1))
    finally:
        animation.action, animation.use_nla = before[0], before[2]
        if before[1] is not None:
            animation.action_slot = before[1]
