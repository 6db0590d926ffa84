"""Which way is up, forward and left for a character, read from its skeleton at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .bone_names import BoneLabel
from .bone_tree import descendants
from .limbs import Limb
from .rig import FloatArray, IntArray, Rig

# A rest bend below this is no evidence [rad]; rigs are modelled straight to within a few degrees.
CLEAR_BEND = np.radians(5.0)


@dataclass(frozen=True, eq=False)
class BodyFrame:
    """The character's own directions at rest, orthogonal unit vectors in rig space, shape [3] each.

    A Blender character faces -y with z up, so its left is +x; here they come from the body itself.
    """

    left: FloatArray
    up: FloatArray
    forward: FloatArray

    @property
    def matrix(self) -> FloatArray:
        """Columns left, up, forward, shape [3, 3]."""
        return np.stack([self.left, self.up, self.forward], axis=1)


def unit(vector: FloatArray) -> FloatArray:
    """The vector at length one; zero stays zero."""
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def without(vector: FloatArray, axis: FloatArray) -> FloatArray:
    """The part of a vector orthogonal to a unit axis, at length one; zero where nothing is left."""
    return unit(vector - (vector @ axis) * axis)


def limb_points(rig: Rig, limb: Limb) -> FloatArray:
    """Heads of first, middle and end of a limb, a bone's tail standing for what is missing [m], shape [3, 3]."""
    if limb.middle < 0:
        return np.stack([rig.heads[limb.first], rig.tails[limb.first], rig.tails[limb.first]])
    end = rig.heads[limb.end] if limb.end >= 0 else rig.tails[limb.middle]
    return np.stack([rig.heads[limb.first], rig.heads[limb.middle], end])


def find_frame(
    rig: Rig,
    parents: IntArray,
    labels: Sequence[BoneLabel],
    pairs: Mapping[str, tuple[Limb, Limb] | None],
) -> BodyFrame:
    """The body's directions from its arms and legs.

    Up runs from the hips to the shoulders and is set exactly against gravity, or along an axis of the rig, where it is
    near. Forward is told by the toes; without toes by the bends of knees and elbows, the face and the side names; and
    last by Blender's convention that a character faces -y.
    """
    up = _up(rig, pairs)
    across = _across(rig, up, pairs)
    forward = unit(np.cross(across, up))
    sign = _facing(rig, parents, labels, pairs, up, across, forward)
    return BodyFrame(left=sign * across, up=up, forward=sign * forward)


def _up(rig: Rig, pairs: Mapping[str, tuple[Limb, Limb] | None]) -> FloatArray:
    mids = {kind: np.mean([limb_points(rig, limb) for limb in pair], axis=0) for kind, pair in pairs.items() if pair}
    if len(mids) == 2:
        up = mids["arm"][0] - mids["leg"][0]
    elif "leg" in mids:
        up = mids["leg"][0] - mids["leg"][2]
    else:
        return -rig.gravity
    up = unit(up)
    axes = [-rig.gravity, *np.eye(3), *-np.eye(3)]
    limits = np.cos(np.radians([45.0] + [30.0] * 6))
    for axis, limit in zip(axes, limits, strict=True):
        if up @ axis > limit:
            return axis.copy()
    return up


def _across(rig: Rig, up: FloatArray, pairs: Mapping[str, tuple[Limb, Limb] | None]) -> FloatArray:
    """Unit vector from one side of the body to the other, its sign free."""
    across = np.zeros(3)
    for kind in ("arm", "leg"):
        # The hips tell, if there are legs: no pose moves them apart, as it does shoulders.
        if pair := pairs.get(kind):
            across = without((limb_points(rig, pair[0]) - limb_points(rig, pair[1]))[0], up)
    if not across.any():
        x = np.array([1.0, 0.0, 0.0])
        across = x if abs(up @ x) < 0.9 else np.array([0.0, 1.0, 0.0])
    across = without(across, up)
    for axis in (*np.eye(3), *-np.eye(3)):
        # Measured skeletons are a little uneven; their axes are meant.
        if across @ axis > np.cos(np.radians(2.0)) and abs(axis @ up) < 1e-9:
            return axis
    return across


def _facing(
    rig: Rig,
    parents: IntArray,
    labels: Sequence[BoneLabel],
    pairs: Mapping[str, tuple[Limb, Limb] | None],
    up: FloatArray,
    across: FloatArray,
    forward: FloatArray,
) -> float:
    """+1 where ``forward`` is the character's own, -1 where it is the opposite."""
    toes = _toe_evidence(rig, parents, pairs, forward)
    if abs(toes) > 1.0:
        return float(np.sign(toes))
    weak = (
        toes
        + _bend_evidence(rig, pairs, forward)
        + _face_evidence(rig, parents, labels, pairs, up, forward)
        + _name_evidence(rig, labels, pairs, across)
    )
    if abs(weak) > 0.3:
        return float(np.sign(weak))
    convention = np.array([0.0, -1.0, 0.0]) if abs(up[2]) > 0.7 else np.array([0.0, 0.0, 1.0])
    return 1.0 if forward @ convention >= 0 else -1.0


def _toe_evidence(
    rig: Rig, parents: IntArray, pairs: Mapping[str, tuple[Limb, Limb] | None], forward: FloatArray
) -> float:
    """Beyond 1 where toe bones reach clearly forward (or backward) of the ankles; a bare tail is weaker evidence."""
    if not pairs.get("leg"):
        return 0.0
    below = descendants(parents)
    reach, by_bones = 0.0, False
    for limb in pairs["leg"] or ():
        if limb.end < 0:
            continue
        hip, _, ankle = limb_points(rig, limb)
        bones = np.flatnonzero(below[limb.end])
        heads = (rig.heads[bones] - ankle) @ forward / np.linalg.norm(hip - ankle)
        tails = (rig.tails[bones] - ankle) @ forward / np.linalg.norm(hip - ankle)
        furthest = heads[np.argmax(np.abs(heads))]
        if abs(furthest) > 0.05:
            by_bones = True
            reach += furthest
        elif not by_bones:
            reach += tails[np.argmax(np.abs(tails))]
    if abs(reach) < 0.06:
        return 0.0
    return float(np.sign(reach)) * (2.0 if by_bones else 0.9)


def _bend_evidence(rig: Rig, pairs: Mapping[str, tuple[Limb, Limb] | None], forward: FloatArray) -> float:
    """Knees stand forward of the line from hip to ankle; elbows stand behind that from shoulder to wrist."""
    evidence = 0.0
    for kind, sign, weight in (("leg", 1.0, 0.8), ("arm", -1.0, 0.6)):
        for limb in pairs.get(kind) or ():
            first, middle, end = limb_points(rig, limb)
            upper, lower = unit(middle - first), unit(end - middle)
            bend = upper - lower
            if np.arccos(np.clip(upper @ lower, -1.0, 1.0)) > CLEAR_BEND:
                evidence += 0.5 * weight * sign * float(unit(bend) @ forward)
    return evidence


def _face_evidence(
    rig: Rig,
    parents: IntArray,
    labels: Sequence[BoneLabel],
    pairs: Mapping[str, tuple[Limb, Limb] | None],
    up: FloatArray,
    forward: FloatArray,
) -> float:
    """Eyes, jaw and nose lie in front of the bone that carries them."""
    offsets = [
        float(unit(rig.heads[bone] - rig.heads[parents[bone]]) @ forward)
        for bone in range(rig.bone_count)
        if labels[bone].part == "face" and parents[bone] >= 0 and labels[parents[bone]].part == "head"
    ]
    return 0.8 * float(np.mean(offsets)) if offsets else 0.0


def _name_evidence(
    rig: Rig, labels: Sequence[BoneLabel], pairs: Mapping[str, tuple[Limb, Limb] | None], across: FloatArray
) -> float:
    """Bones named left should lie at the left."""
    votes = []
    for pair in pairs.values():
        for limb, other in (pair, pair[::-1]) if pair else ():
            lies = np.sign((limb_points(rig, limb) - limb_points(rig, other))[0] @ across)
            for bone in (limb.first, limb.middle):
                if labels[bone].side:
                    votes.append(lies * (1.0 if labels[bone].side == "L" else -1.0))
    return 1.2 * float(np.mean(votes)) if votes else 0.0
