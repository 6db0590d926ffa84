"""Human skeletons for tests: one body, in any naming convention, rest pose, orientation and state of disorder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.rig import Pose, Rig, pose_from_local_turns

# part: (parent part, head, tail) [m], z up, facing -y, the left half and the midline; A-pose with bent elbows.
_HALF = {
    "pelvis": ("", (0.0, 0.0, 0.95), (0.0, 0.01, 1.05)),
    "spine1": ("pelvis", (0.0, 0.01, 1.05), (0.0, 0.0, 1.16)),
    "spine2": ("spine1", (0.0, 0.0, 1.16), (0.0, 0.01, 1.27)),
    "chest": ("spine2", (0.0, 0.01, 1.27), (0.0, 0.02, 1.45)),
    "neck": ("chest", (0.0, 0.02, 1.45), (0.0, 0.0, 1.54)),
    "head": ("neck", (0.0, 0.0, 1.54), (0.0, 0.0, 1.74)),
    "clavicle_L": ("chest", (0.02, -0.01, 1.41), (0.17, 0.01, 1.40)),
    "upperarm_L": ("clavicle_L", (0.17, 0.01, 1.40), (0.36, 0.03, 1.21)),
    "forearm_L": ("upperarm_L", (0.36, 0.03, 1.21), (0.51, -0.08, 1.04)),
    "hand_L": ("forearm_L", (0.51, -0.08, 1.04), (0.56, -0.12, 0.97)),
    "thumb_L": ("hand_L", (0.51, -0.12, 1.02), (0.52, -0.17, 0.99)),
    "index_L": ("hand_L", (0.57, -0.15, 0.98), (0.60, -0.19, 0.93)),
    "ring_L": ("hand_L", (0.58, -0.12, 0.96), (0.61, -0.15, 0.91)),
    "thigh_L": ("pelvis", (0.10, 0.0, 0.92), (0.12, -0.02, 0.50)),
    "shin_L": ("thigh_L", (0.12, -0.02, 0.50), (0.13, 0.03, 0.09)),
    "foot_L": ("shin_L", (0.13, 0.03, 0.09), (0.14, -0.09, 0.03)),
    "toe_L": ("foot_L", (0.14, -0.09, 0.03), (0.145, -0.17, 0.02)),
}
Bones = dict[str, tuple[str, tuple[float, float, float], tuple[float, float, float]]]


def _mirror(part: str) -> str:
    return part[:-1] + "R" if part.endswith("_L") else part


def body_bones() -> Bones:
    """The whole body by part, parents first."""
    bones: Bones = dict(_HALF)
    for part, (parent, head, tail) in _HALF.items():
        if part.endswith("_L"):
            bones[_mirror(part)] = (_mirror(parent), (-head[0], *head[1:]), (-tail[0], *tail[1:]))
    return bones


def rig_of(bones: Mapping[str, tuple], gravity: Iterable[float] = (0.0, 0.0, -1.0)) -> Rig:
    """A rig from a table of name: (parent or "", head, tail); parents may come later."""
    names: list[str] = []

    def add(name: str) -> None:
        if name not in names:
            if bones[name][0]:
                add(bones[name][0])
            names.append(name)

    for name in bones:
        add(name)
    heads = np.array([bones[name][1] for name in names], float)
    lines = np.array([bones[name][2] for name in names], float) - heads
    rest = np.tile(np.eye(4), (len(names), 1, 1))
    rest[:, :3, :3] = [rotations.to_matrices(rotations.between((0.0, 1.0, 0.0), line)) for line in lines]
    rest[:, :3, 3] = heads
    return Rig(
        names=tuple(names),
        parents=np.array([names.index(bones[name][0]) if bones[name][0] else -1 for name in names], np.int32),
        rest=rest,
        lengths=np.linalg.norm(lines, axis=1),
        gravity=np.array(tuple(gravity)),
    )


def human(name_of: Mapping[str, str] | Callable[[str], str] = lambda part: part, drop: Iterable[str] = ()) -> Rig:
    """The body named by a table or a function of the part; parts without a name, or in ``drop``, are left out."""
    bones = body_bones()
    table = name_of if callable(name_of) else lambda part: name_of.get(part, "")  # type: ignore[union-attr]
    dropped = set(drop) | {part for part in bones if not table(part)}

    def carrier(part: str) -> str:
        while part in dropped:
            part = bones[part][0]
        return table(part) if part else ""

    return rig_of({table(p): (carrier(parent), h, t) for p, (parent, h, t) in bones.items() if p not in dropped})


# --- disorder -----------------------------------------------------------------------------------------------------


def renamed(rig: Rig, names: Iterable[str]) -> Rig:
    return replace(rig, names=tuple(names))


def nameless(rig: Rig) -> Rig:
    return renamed(rig, [f"bone{i:03d}" for i in range(rig.bone_count)])


def turned(rig: Rig, rotvec: Iterable[float]) -> Rig:
    """The rig lying in another orientation, gravity with it."""
    turn = np.eye(4)
    turn[:3, :3] = rotations.to_matrices(rotations.from_rotvec(np.array(tuple(rotvec))))
    return replace(rig, rest=turn @ rig.rest, gravity=turn[:3, :3] @ rig.gravity)


def scaled(rig: Rig, factor: float) -> Rig:
    rest = rig.rest.copy()
    rest[:, :3, 3] *= factor
    return replace(rig, rest=rest, lengths=rig.lengths * factor)


def rolled(rig: Rig, seed: int) -> Rig:
    """Every bone rolled about itself at random."""
    angles = np.random.default_rng(seed).uniform(-np.pi, np.pi, rig.bone_count)
    rest = rig.rest.copy()
    rest[:, :3, :3] = rest[:, :3, :3] @ rotations.to_matrices(rotations.from_rotvec(angles[:, None] * [0.0, 1.0, 0.0]))
    return replace(rig, rest=rest)


def with_stray_tails(rig: Rig, seed: int) -> Rig:
    """Bones with children point anywhere, as importers leave them that keep a file's own local axes."""
    spins = np.random.default_rng(seed).normal(size=(rig.bone_count, 3))
    rest = rig.rest.copy()
    for bone in range(rig.bone_count):
        if rig.children(bone):
            rest[bone, :3, :3] = rest[bone, :3, :3] @ rotations.to_matrices(rotations.from_rotvec(spins[bone]))
    return replace(rig, rest=rest)


def with_bones(rig: Rig, bones: Mapping[str, tuple]) -> Rig:
    """The rig with further bones, name: (parent, head, tail)."""
    table = {
        name: (rig.names[parent] if parent >= 0 else "", head, tail)
        for name, parent, head, tail in zip(rig.names, rig.parents, rig.heads, rig.tails, strict=True)
    }
    return rig_of({**table, **bones}, rig.gravity)


def rested(rig: Rig, pose: Pose) -> Rig:
    """The rig with a pose as its rest pose."""
    return replace(rig, rest=pose.matrices)


def posed(rig: Rig, **rotvecs: Iterable[float]) -> Pose:
    """A pose from local turns, bone name to rotation vector [rad]."""
    local = np.tile([1.0, 0.0, 0.0, 0.0], (rig.bone_count, 1))
    for name, rotvec in rotvecs.items():
        local[rig.index[name]] = rotations.from_rotvec(np.array(tuple(rotvec)))
    return pose_from_local_turns(rig, local)


def t_posed(rig: Rig, name_of: Callable[[str], str] = lambda part: part) -> Rig:
    """The body with straight arms held out sideways and straight legs (named by ``name_of``)."""
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (rig.bone_count, 1))
    goals = {"upperarm": (1.0, 0.0, 0.0), "forearm": (1.0, 0.0, 0.0), "hand": (1.0, 0.0, 0.0)}
    goals |= {"thigh": (0.0, 0.0, -1.0), "shin": (0.0, 0.0, -1.0)}
    following = {"upperarm": "forearm", "forearm": "hand", "hand": "index", "thigh": "shin", "shin": "foot"}
    for side, sign in (("L", 1.0), ("R", -1.0)):
        for part, goal in goals.items():
            bone, after = (rig.index.get(name_of(f"{p}_{side}"), -1) for p in (part, following[part]))
            if bone < 0 or after < 0:
                continue
            line = rig.heads[after] - rig.heads[bone]
            turns[bone] = rotations.between(line, (sign * goal[0], goal[1], goal[2]))
    # Turns above are absolute: take off what the parent already did.
    local = turns.copy()
    for bone, parent in enumerate(rig.parents):
        if parent >= 0 and (turns[bone] != [1.0, 0.0, 0.0, 0.0]).any():
            local[bone] = rotations.multiply(rotations.conjugate(turns[parent]), turns[bone])
        elif parent >= 0 and (turns[parent] != [1.0, 0.0, 0.0, 0.0]).any():
            local[bone] = [1.0, 0.0, 0.0, 0.0]
            turns[bone] = turns[parent]
    return rested(rig, pose_from_local_turns(rig, local))


# --- naming conventions -------------------------------------------------------------------------------------------


def _both(pattern: Callable[[str, str], str], words: Mapping[str, str], sides: tuple[str, str]) -> dict[str, str]:
    table: dict[str, str] = {}
    for part in body_bones():
        stem, _, side = part.partition("_")
        if stem in words:
            table[part] = pattern(words[stem], sides["LR".index(side)] if side else "")
    return table


_PLAIN = {"pelvis": "hips", "spine1": "spine", "spine2": "spine1", "chest": "chest", "neck": "neck", "head": "head"}
_UNREAL = {
    "pelvis": "pelvis", "spine1": "spine_01", "spine2": "spine_02", "chest": "spine_03", "neck": "neck_01",
    "head": "head", "clavicle": "clavicle", "upperarm": "upperarm", "forearm": "lowerarm", "hand": "hand",
    "thumb": "thumb_01", "index": "index_01", "ring": "ring_01", "thigh": "thigh", "shin": "calf", "foot": "foot",
    "toe": "ball",
}  # fmt: skip
_MOTIONBUILDER = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "chest": "Spine2", "neck": "Neck", "head": "Head",
    "clavicle": "Shoulder", "upperarm": "Arm", "forearm": "ForeArm", "hand": "Hand", "thumb": "HandThumb1",
    "index": "HandIndex1", "ring": "HandRing1", "thigh": "UpLeg", "shin": "Leg", "foot": "Foot", "toe": "ToeBase",
}  # fmt: skip
_RIGIFY = {
    "pelvis": "spine", "spine1": "spine.001", "spine2": "spine.002", "chest": "spine.003", "neck": "spine.004",
    "head": "spine.005", "clavicle": "shoulder", "upperarm": "upper_arm", "forearm": "forearm", "hand": "hand",
    "thumb": "thumb.01", "index": "f_index.01", "ring": "f_ring.01", "thigh": "thigh", "shin": "shin",
    "foot": "foot", "toe": "toe",
}  # fmt: skip
_SMPL = {
    "pelvis": "pelvis", "spine1": "spine1", "spine2": "spine2", "chest": "spine3", "neck": "neck", "head": "head",
    "clavicle": "collar", "upperarm": "shoulder", "forearm": "elbow", "hand": "wrist", "index": "index1",
    "thigh": "hip", "shin": "knee", "foot": "ankle", "toe": "foot",
}  # fmt: skip
_VRM = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Chest", "chest": "UpperChest", "neck": "Neck", "head": "Head",
    "clavicle": "Shoulder", "upperarm": "UpperArm", "forearm": "LowerArm", "hand": "Hand", "thumb": "Thumb1",
    "index": "Index1", "ring": "Ring1", "thigh": "UpperLeg", "shin": "LowerLeg", "foot": "Foot", "toe": "ToeBase",
}  # fmt: skip
_DAZ = {
    "pelvis": "hip", "spine1": "abdomen", "spine2": "abdomen2", "chest": "chest", "neck": "neck", "head": "head",
    "clavicle": "Collar", "upperarm": "Shldr", "forearm": "ForeArm", "hand": "Hand", "thumb": "Thumb1",
    "index": "Index1", "ring": "Ring1", "thigh": "Thigh", "shin": "Shin", "foot": "Foot", "toe": "Toe",
}  # fmt: skip
_BIPED = {
    "pelvis": "Pelvis", "spine1": "Spine", "spine2": "Spine1", "chest": "Spine2", "neck": "Neck", "head": "Head",
    "clavicle": "Clavicle", "upperarm": "UpperArm", "forearm": "Forearm", "hand": "Hand", "thumb": "Finger0",
    "index": "Finger1", "ring": "Finger3", "thigh": "Thigh", "shin": "Calf", "foot": "Foot", "toe": "Toe0",
}  # fmt: skip
_MAKEHUMAN = {
    "pelvis": "root", "spine1": "spine05", "spine2": "spine03", "chest": "spine01", "neck": "neck01", "head": "head",
    "clavicle": "clavicle", "upperarm": "upperarm01", "forearm": "lowerarm01", "hand": "wrist", "thumb": "finger1-1",
    "index": "finger2-1", "ring": "finger4-1", "thigh": "upperleg01", "shin": "lowerleg01", "foot": "foot",
    "toe": "toe1-1",
}  # fmt: skip
_MMD = {
    "pelvis": "センター", "spine1": "上半身", "spine2": "上半身2", "chest": "上半身3", "neck": "首", "head": "頭",
    "clavicle": "肩", "upperarm": "腕", "forearm": "ひじ", "hand": "手首", "thumb": "親指０", "index": "人指１",
    "ring": "薬指１", "thigh": "足", "shin": "ひざ", "foot": "足首", "toe": "つま先",
}  # fmt: skip
_WORDS = {
    **_PLAIN, "clavicle": "collar", "upperarm": "upper arm", "forearm": "lower arm", "hand": "hand", "thigh": "thigh",
    "shin": "calf", "foot": "foot", "toe": "toe",
}  # fmt: skip
_OLD_BVH = {
    "pelvis": "Hips", "spine1": "Waist", "chest": "Chest", "neck": "Neck", "head": "Head", "clavicle": "Collar",
    "upperarm": "Shoulder", "forearm": "Elbow", "hand": "Wrist", "thigh": "Hip", "shin": "Knee", "foot": "Ankle",
}  # fmt: skip
_AMBIGUOUS = {
    **_PLAIN, "clavicle": "shoulder", "upperarm": "arm", "forearm": "elbow", "hand": "wrist", "thigh": "leg",
    "shin": "knee", "foot": "ankle", "toe": "toe",
}  # fmt: skip


def _daz_name(word: str, side: str) -> str:
    return side + word


def _biped_name(word: str, side: str) -> str:
    return " ".join(filter(None, ("Bip01", side, word)))


def _prefixed(prefix: str) -> Callable[[str, str], str]:
    return lambda word, side: prefix + side + word


def _suffixed(separator: str) -> Callable[[str, str], str]:
    return lambda word, side: word + (separator + side if side else "")


def _rigify_deform(word: str, side: str) -> str:
    stem, dot, number = word.partition(".")
    return "DEF-" + stem + (f".{side}" if side else "") + dot + number


CONVENTIONS: dict[str, dict[str, str]] = {
    "Rigify metarig": _both(_suffixed("."), _RIGIFY, ("L", "R")),
    "Rigify generated": _both(_rigify_deform, _RIGIFY, ("L", "R")),
    "Mixamo": _both(_prefixed("mixamorig:"), _MOTIONBUILDER, ("Left", "Right")),
    "MotionBuilder": _both(_prefixed("Character1_"), _MOTIONBUILDER, ("Left", "Right")),
    "CMU BVH": _both(_prefixed(""), _MOTIONBUILDER, ("Left", "Right")),
    "Neo prefix": _both(_prefixed("Neo_"), _MOTIONBUILDER, ("Left", "Right")),
    "MakeHuman default": _both(_suffixed("."), _MAKEHUMAN, ("L", "R")),
    "Unreal": _both(_suffixed("_"), _UNREAL, ("l", "r")),
    "VRoid": _both(lambda word, side: f"J_Bip_{side or 'C'}_{word}", _VRM, ("L", "R")),
    "VRM": _both(lambda word, side: side + word if side else word, _VRM, ("left", "right")),
    "SMPL": _both(lambda word, side: f"{side}_{word}" if side else word, _SMPL, ("left", "right")),
    "SMPL short": _both(lambda word, side: f"{side}_{word.title()}" if side else word, _SMPL, ("L", "R")),
    "Daz": _both(_daz_name, _DAZ, ("l", "r")),
    "3ds Max Biped": _both(_biped_name, _BIPED, ("L", "R")),
    "Biped underscores": _both(lambda w, s: "_".join(filter(None, ("Bip001", s, w))), _BIPED, ("L", "R")),
    "Character Creator": _both(lambda w, s: "_".join(filter(None, ("CC_Base", s, w))), _BIPED, ("L", "R")),
    "MMD": _both(lambda word, side: side + word, _MMD, ("左", "右")),
    "old BVH": _both(_prefixed(""), _OLD_BVH, ("Left", "Right")),
    "Left words": _both(lambda word, side: f"{side} {word}".strip(), _WORDS, ("Left", "Right")),
    "left_words": _both(lambda w, s: f"{s} {w}".strip().replace(" ", "_"), _WORDS, ("left", "right")),
    "words.left": _both(_suffixed("."), _WORDS, ("left", "right")),
    "words-l": _both(_suffixed("-"), _WORDS, ("l", "r")),
    "WORDS_L": _both(lambda w, s: (w + (f"_{s}" if s else "")).upper().replace(" ", ""), _WORDS, ("L", "R")),
    "LEFTWORDS": _both(lambda w, s: (s + w).upper().replace(" ", ""), _WORDS, ("LEFT", "RIGHT")),
    "l words": _both(lambda word, side: f"{side} {word}".strip(), _WORDS, ("l", "r")),
    "lwords": _both(lambda word, side: side + word.replace(" ", ""), _WORDS, ("l", "r")),
    "wordsL": _both(lambda word, side: word.replace(" ", "") + side, _WORDS, ("L", "R")),
    "ambiguous": _both(lambda word, side: f"{side} {word}".strip(), _AMBIGUOUS, ("Left", "Right")),
}
