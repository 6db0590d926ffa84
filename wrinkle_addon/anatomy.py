"""A human body read into a skeleton: its frame, trunk, arms and legs.

Bone names and the shape of the bone tree are weighed together (:mod:`limbs`); left and right come from where a limb
lies once the body's own up and forward are known, so wrong or swapped side labels do no harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .body_frame import BodyFrame, find_frame, limb_points
from .bone_names import BoneLabel, read_bone_names
from .bone_tree import ancestors_of, children_of, descendants, parents_among
from .limbs import LIMB_PARTS, Limb, lone_limb, search_limbs, stub_limb
from .rig import FloatArray, IntArray, Rig

SIDES = ("L", "R")


@dataclass(frozen=True, eq=False)
class Anatomy:
    """What was found. Bones are indices; a missing bone is -1, a missing chain empty, a missing limb absent.

    Attributes:
        frame: The character's own directions.
        parents: The hierarchy that was searched: the rig's own, with loose pieces attached to what they touch.
        labels: What each bone's name says.
        pelvis: The bone that carries the legs.
        chest: The bone that carries the arms.
        spine: Bones from above the pelvis up to the chest, the chest included.
        neck: Bones from the neck up to the head.
        limbs: "arm_L", "arm_R", "leg_L", "leg_R".
        clavicles: Bones between chest and upper arm, for "L" and "R".
        notes: Sentences about names that the shape of the skeleton overruled.
    """

    frame: BodyFrame
    parents: IntArray
    labels: Sequence[BoneLabel]
    pelvis: int
    chest: int
    spine: tuple[int, ...]
    neck: tuple[int, ...]
    limbs: dict[str, Limb]
    clavicles: dict[str, tuple[int, ...]]
    notes: tuple[str, ...]


def find_anatomy(rig: Rig) -> Anatomy:
    """Read a human body into a rig, as far as there is one."""
    names = read_bone_names(rig.names)
    parents, labels, pairs = _search(rig, names)
    frame = find_frame(rig, parents, labels, pairs)
    limbs = _sided_pairs(rig, frame, pairs) | _lone_limbs(rig, parents, labels, frame, pairs)
    pelvis = _carrier(rig, parents, labels, limbs, "leg", "pelvis")
    chest = _carrier(rig, parents, labels, limbs, "arm", "chest")
    neck_base = -1
    if chest >= 0 and chest != pelvis and _carries_as_neck(rig, parents, labels, frame, limbs, pelvis, chest):
        neck_base, chest = chest, int(parents[chest])
    neck = _neck(rig, parents, labels, frame, limbs, chest, neck_base)
    return Anatomy(
        frame=frame,
        parents=parents,
        labels=labels,
        pelvis=pelvis,
        chest=chest,
        spine=_spine(parents, labels, pelvis, chest),
        neck=neck,
        limbs=limbs,
        clavicles={
            side: _between(parents, labels, limbs[f"arm_{side}"].first, {chest, neck_base})
            for side in SIDES
            if f"arm_{side}" in limbs
        },
        notes=_name_notes(rig, names, limbs),
    )


def _search(
    rig: Rig, names: Sequence[BoneLabel]
) -> tuple[IntArray, Sequence[BoneLabel], dict[str, tuple[Limb, Limb] | None]]:
    """The hierarchy to search, the labels to believe, and the pairs of arms and legs.

    Names that leave no body standing deceive; the shape alone may still tell.
    """
    tries = []
    for labels in (names, [BoneLabel()] * len(names)):
        parents = attach_loose_bones(rig, labels)
        found = search_limbs(rig, parents, labels)
        tries.append((parents, labels, {"arm": found.arms, "leg": found.legs}))
        if found.arms and found.legs:
            return tries[-1]
    return tries[0]


def attach_loose_bones(rig: Rig, labels: Sequence[BoneLabel]) -> IntArray:
    """The hierarchy to search: no helpers in between, and loose pieces attached to what they touch, [bone_count].

    Rigs built on constraints leave limbs without a parent, hang every bone on one root, or lead through control bones.
    """
    helpers = np.array([label.helper for label in labels])
    parents = parents_among(rig.parents, ~helpers, rig.heads, rig.rest[:, :3, 1])
    size = float(np.linalg.norm(np.ptp(rig.heads, axis=0))) or 1.0
    for root in np.flatnonzero(parents < 0):
        if rig.bone_count > 3 and np.count_nonzero(parents == root) > 0.6 * rig.bone_count:
            # A flat rig: hanging on the root says nothing.
            parents[parents == root] = -1
    for bone in range(rig.bone_count):
        parent = int(parents[bone])
        if parent >= 0 and parents[parent] >= 0:
            continue
        if parent >= 0 and _distances_to_bones(rig, parents, rig.heads[bone], size)[parent] < 0.03 * size:
            continue
        to_tails = np.linalg.norm(rig.tails - rig.heads[bone], axis=1)
        to_tails[descendants(parents)[bone] | helpers] = np.inf
        if to_tails.min() < 1e-3 * size:
            parents[bone] = int(np.argmin(to_tails))
    _join_trees(rig, parents, helpers, size)
    return parents


def _join_trees(rig: Rig, parents: IntArray, helpers: NDArray[np.bool_], size: float) -> None:
    """Attach every tree that lies near another one to it, nearest first, and of equally near ones the smaller first."""
    distances = {root: _distances_to_bones(rig, parents, rig.heads[root], size) for root in children_of(parents, -1)}
    while distances:
        below = descendants(parents)
        tops = [(ancestors_of(parents, bone) or [bone])[-1] for bone in range(rig.bone_count)]
        weight = below[tops].sum(1)
        best: tuple[float, int, int, int] | None = None
        for root, distance in distances.items():
            open_ = ~below[root] & ~helpers
            if open_.any():
                near = np.round(np.where(open_, distance, np.inf) / size, 3)
                carrier = int(np.lexsort((-weight, near))[0])
                best = min(filter(None, (best, (float(near[carrier]), int(weight[root]), root, carrier))))
        if best is None or best[0] > 0.12:
            return
        parents[best[2]] = best[3]
        del distances[best[2]]


def _distances_to_bones(rig: Rig, parents: IntArray, point: FloatArray, size: float) -> FloatArray:
    """Distance of a point from every bone's line from head to tail [m], shape [bone_count].

    Importers invent the tails of bones without children, often far beyond the body; those count as short.
    """
    longest = np.where(np.isin(np.arange(rig.bone_count), parents), 0.1 * size, 0.04 * size)
    lines = rig.rest[:, :3, 1] * np.minimum(rig.lengths, longest)[:, None]
    offsets = point - rig.heads
    along = np.clip((offsets * lines).sum(1) / np.maximum((lines * lines).sum(1), 1e-18), 0.0, 1.0)
    return np.linalg.norm(offsets - along[:, None] * lines, axis=1)


# --- limbs and their sides ----------------------------------------------------------------------------------------


def _sided_pairs(rig: Rig, frame: BodyFrame, pairs: dict[str, tuple[Limb, Limb] | None]) -> dict[str, Limb]:
    limbs: dict[str, Limb] = {}
    for kind, pair in pairs.items():
        if pair:
            a, b = pair
            gap = (limb_points(rig, a) - limb_points(rig, b))[:2].mean(0)
            left, right = (a, b) if gap @ frame.left > 0 else (b, a)
            limbs |= {f"{kind}_L": left, f"{kind}_R": right}
    return limbs


def _lone_limbs(
    rig: Rig,
    parents: IntArray,
    labels: Sequence[BoneLabel],
    frame: BodyFrame,
    pairs: dict[str, tuple[Limb, Limb] | None],
) -> dict[str, Limb]:
    """Limbs without a partner, or of one piece, where names vouch for them; a lone limb's side is where it lies."""
    taken = {bone for pair in pairs.values() if pair for limb in pair for bone in (limb.first, limb.middle)}
    known = [limb_points(rig, limb)[0] for pair in pairs.values() if pair for limb in pair]
    centre = np.mean(known, axis=0) if known else rig.heads.mean(0)
    lone: dict[str, Limb] = {}
    for kind, pair in pairs.items():
        if pair is None and (limb := lone_limb(rig, parents, labels, kind, taken)):
            side = "L" if (limb_points(rig, limb)[0] - centre) @ frame.left > 0 else "R"
            lone[f"{kind}_{side if known else labels[limb.first].side or side}"] = limb
            taken |= {limb.first, limb.middle}
    for kind, pair in pairs.items():
        for side in SIDES if pair is None else ():
            key = f"{kind}_{side}"
            if key not in lone and (limb := stub_limb(labels, kind, side, taken)):
                lone[key] = limb
    return lone


# --- trunk --------------------------------------------------------------------------------------------------------


def _carrier(
    rig: Rig, parents: IntArray, labels: Sequence[BoneLabel], limbs: dict[str, Limb], kind: str, part: str
) -> int:
    """The lowest bone that carries all limbs of one kind; without such limbs, the bone that is named for it."""
    chains = [ancestors_of(parents, limbs[f"{kind}_{side}"].first) for side in SIDES if f"{kind}_{side}" in limbs]
    if len(chains) == 2:
        return next((bone for bone in chains[0] if bone in chains[1]), -1)
    if chains:
        named = [bone for bone in chains[0] if labels[bone].part == part and not labels[bone].side]
        return next(iter(named or chains[0]), -1)
    named = [b for b in range(rig.bone_count) if labels[b].part == part and not labels[b].side and not labels[b].helper]
    return named[-1 if part == "chest" else 0] if named else -1


def _carries_as_neck(
    rig: Rig,
    parents: IntArray,
    labels: Sequence[BoneLabel],
    frame: BodyFrame,
    limbs: dict[str, Limb],
    pelvis: int,
    bone: int,
) -> bool:
    """Whether the arms hang on the neck, as in 3ds Max Biped: its pivot lies about as high as the shoulders."""
    arms = [limb_points(rig, limb)[0] for key, limb in limbs.items() if key.startswith("arm")]
    below = int(parents[bone])
    if not arms or below < 0 or below == pelvis or pelvis < 0:
        return False
    trunk = float((np.mean(arms, axis=0) - rig.heads[pelvis]) @ frame.up)
    drop = float((np.mean(arms, axis=0) - rig.heads[bone]) @ frame.up) / max(trunk, 1e-9)
    return drop < {"neck": 0.15, "": 0.05}.get(labels[bone].part, 0.0)


def _spine(parents: IntArray, labels: Sequence[BoneLabel], pelvis: int, chest: int) -> tuple[int, ...]:
    """Bones above the pelvis up to the chest, the chest included; helpers in between ride along."""
    if chest < 0 or chest == pelvis:
        return ()
    chain = [chest, *ancestors_of(parents, chest)]
    stop = {pelvis, *ancestors_of(parents, pelvis)} if pelvis >= 0 else set()
    bones: list[int] = []
    for bone in chain:
        if bone in stop or (pelvis < 0 and labels[bone].part in ("pelvis", "root")):
            break
        bones.append(bone)
    kept = [bone for bone in bones if not labels[bone].helper or bone == chest]
    return tuple(reversed(kept))


def _between(parents: IntArray, labels: Sequence[BoneLabel], bone: int, stop: set[int]) -> tuple[int, ...]:
    """Bones above ``bone`` up to, without, the first of ``stop``, from the trunk outwards; helpers are left out."""
    bones: list[int] = []
    for above in ancestors_of(parents, bone):
        if above in stop:
            return tuple(reversed([b for b in bones if not labels[b].helper]))
        bones.append(above)
    return ()


def _neck(
    rig: Rig,
    parents: IntArray,
    labels: Sequence[BoneLabel],
    frame: BodyFrame,
    limbs: dict[str, Limb],
    chest: int,
    neck_base: int,
) -> tuple[int, ...]:
    """Bones from the chest up to the head: the branch that climbs highest near the body's midline."""
    if chest < 0:
        return ()
    below = descendants(parents)
    limb_bones = [limb.first for limb in limbs.values()]
    heights = rig.heads @ frame.up
    size = float(np.ptp(heights)) or 1.0
    chain: list[int] = [neck_base] if neck_base >= 0 else []
    bone: int = chain[-1] if chain else chest
    while len(chain) < 8 and not (chain and labels[bone].part == "head"):
        children = [
            c
            for c in children_of(parents, bone)
            if not labels[c].helper
            and not below[c, limb_bones].any()
            and abs((rig.heads[c] - rig.heads[chest]) @ frame.left) < 0.03 * size
            and heights[c] > heights[chest]
            and labels[c].part not in ("face", "soft")
        ]
        if not children:
            break
        named = [c for c in children if labels[c].part in ("neck", "head")]
        if chain and not named and len(children) < len(children_of(parents, bone)):
            # A face branches off here, so this is the head.
            break
        bone = max(named or children, key=lambda c: float(heights[below[c]].max()))
        chain.append(bone)
    return tuple(chain)


# --- names against shape ------------------------------------------------------------------------------------------


def _name_notes(rig: Rig, labels: Sequence[BoneLabel], limbs: dict[str, Limb]) -> tuple[str, ...]:
    words = {"L": "left", "R": "right"}
    places = {"arm": ("upper arm", "forearm"), "leg": ("thigh", "shin")}
    notes: list[str] = []
    for key, limb in limbs.items():
        kind, side = key.split("_")
        for i, bone in enumerate((limb.first, limb.middle)[: 2 if limb.middle >= 0 else 1]):
            label = labels[bone]
            wrong_side = label.side and label.side != side
            wrong_part = label.part and label.part not in LIMB_PARTS[kind][i]
            if wrong_side or wrong_part:
                notes.append(
                    f"The bone {rig.names[bone]} is taken as the {words[side]} {places[kind][i]}, where it lies, "
                    "against its name."
                )
    return tuple(notes)
