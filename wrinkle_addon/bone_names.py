"""What a bone's name says: which part of the body, which side, and whether it is only a helper.

Names are evidence, not truth: the search in :mod:`anatomy` weighs them against the shape of the skeleton.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Sequence
from dataclasses import dataclass

# The first pattern found in the joined words of a name decides; so the longer and rarer words stand first.
# "arm", "leg", "shoulder" and "hip" mean different bones in different conventions and stay ambiguous.
_PARTS: tuple[tuple[str, str], ...] = (
    ("finger", r"thumb|index|middle|^mid$|^ring|pinky|little|finger|carpal|palm|親指|人指|人差|中指|薬指|小指"),
    ("toe", r"toe|tarsal|^ball$|つま先|爪先|足先"),
    ("face", r"eye|jaw|brow|^lips?$|mouth|^ears?$|nose|tongue|teeth|cheek|lid|face|chin|temple|forehead|目"),
    ("soft", r"breast|boob|bust|pector|nipple|glute|butt(?!ock)|tail|wing|hair|skirt|cape|胸|乳|髪|スカート"),
    ("forearm", r"fore?arm|low(er)?arm|arm(lower|low)|elbow|radius|ulna|ひじ|肘"),
    ("upperarm", r"up(per)?arm|arm(upper|up)|shldr|humerus|bicep|腕"),
    ("clavicle", r"clav|collar|scapula|肩"),
    ("shoulder", r"shoulder"),
    ("hand", r"hand|wrist|手"),
    ("shin", r"shin|calf|low(er)?leg|leg(lower|low)|knee|tibia|ひざ|膝|すね"),
    ("thigh", r"thigh|up(per)?leg|leg(upper|up)|femur|太もも|もも"),
    ("foot", r"foot|ankle|足首"),
    ("head", r"head|skull|頭"),
    ("neck", r"neck|cervical|首"),
    ("chest", r"chest|thorax|sternum|ribcage|upperbody"),
    ("pelvis", r"pelvis|下半身|腰"),
    ("hip", r"hip|buttock"),
    ("spine", r"spine|back|abdomen|waist|torso|belly|stomach|lumbar|上半身"),
    ("leg", r"leg|足"),
    ("arm", r"arm(?!ature)"),
    ("root", r"root|master|cog|cent(er|re)|センター|グルーブ|全ての親"),
)
_PART_PATTERNS = tuple((part, re.compile(pattern)) for part, pattern in _PARTS)

# Bones that follow or steer others. A few of them carry skin (twist bones), but none of them is a joint.
_HELPER_WORDS = frozenset(
    "twist twists roll helper help corrective correction corr share ik fk pole target tgt ctrl ctl control con cntrl "
    "drv driver driven mch org tweak aux dummy socket attach phys physics sec dyn dynamic jiggle bulge muscle "
    "volume vol fix adjust weapon prop heel offset 捩 cancel end nub tip site".split()
)
_HELPER_ENDINGS = re.compile(r"(twist|roll|helper|share|sharebone|bulge|muscle|jiggle|ctrl|ik|nub|捩\w*)$")

_LEFT_WORDS = frozenset(["left", "l", "lft", "lf", "lt"])
_RIGHT_WORDS = frozenset(["right", "r", "rgt", "rt", "rgh"])
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|[^\W\d_A-Za-z]+")


@dataclass(frozen=True)
class BoneLabel:
    """What a name says about a bone.

    Attributes:
        part: "upperarm", "forearm", "hand", "thigh", "shin", "foot", "toe", "clavicle", "spine", "chest", "neck",
            "head", "pelvis", "finger", "face", "soft" (breasts, hair, cloth), "root", an ambiguous "arm", "leg",
            "shoulder" or "hip", or "" where the name says nothing.
        side: "L", "R" or "".
        helper: Whether the name says that the bone only follows or steers others (twist, IK, control, corrective).
    """

    part: str = ""
    side: str = ""
    helper: bool = False


def read_bone_names(names: Sequence[str]) -> list[BoneLabel]:
    """Read the names of all bones of one rig.

    A helper word that stands in most names of the rig is a prefix of its maker and says nothing. In a rig that marks
    its deforming bones (DEF-), all others are helpers.
    """
    words = [set(_words(name)) for name in names]
    prefixes = {word for word in _HELPER_WORDS if sum(word in said for said in words) > 0.7 * len(names)}
    marked = sum("def" in said for said in words) >= 8
    labels: list[BoneLabel] = []
    for name, said in zip(names, words, strict=True):
        label = read_bone_name(name, prefixes)
        helper = label.helper or (marked and "def" not in said)
        labels.append(BoneLabel(label.part, label.side, helper))
    return labels


def _words(name: str) -> list[str]:
    """The words of a name in lower case, its namespace left out."""
    text = unicodedata.normalize("NFKC", name)
    text = re.split(r"[:|]", text)[-1] or text
    return [word.lower() for word in _WORD.findall(text)]


def read_bone_name(name: str, ignored: Collection[str] = ()) -> BoneLabel:
    """Read one bone name in any usual convention (Rigify, Mixamo, Unreal, VRM, Daz, Biped, BVH, MMD, SMPL ...).

    Args:
        name: The name.
        ignored: Words that say nothing in this rig.
    """
    side, words = _take_side([word for word in _words(name) if word not in ignored])
    joined = "".join(word for word in words if len(word) > 1 or not word.isascii())
    helper = any(word in _HELPER_WORDS for word in words) or bool(_HELPER_ENDINGS.search(joined))
    return BoneLabel(_part(joined, side), side, helper)


def _part(joined: str, side: str) -> str:
    for part, pattern in _PART_PATTERNS:
        if pattern.search(joined):
            if part == "hip" and not side:
                return "pelvis"
            return "hip" if part == "pelvis" and side else part
    return ""


def _take_side(words: list[str]) -> tuple[str, list[str]]:
    """The side that the words name, and the words without it."""
    for i, word in enumerate(words):
        rest = words[:i] + words[i + 1 :]
        if word in _LEFT_WORDS:
            return "L", rest
        if word in _RIGHT_WORDS:
            return "R", rest
    for i, word in enumerate(words):
        for side, spelling in (("L", "left"), ("R", "right"), ("L", "左"), ("R", "右")):
            if word.startswith(spelling) or word.endswith(spelling):
                return side, [*words[:i], word.removeprefix(spelling).removesuffix(spelling), *words[i + 1 :]]
    for i, word in enumerate(words):
        # "lthigh", "rarm", "handl": one letter glued to a word that means something without it.
        for side, letter in (("L", "l"), ("R", "r")):
            for bare in (word.removeprefix(letter), word.removesuffix(letter)):
                if bare != word and _is_limb_word(bare):
                    return side, [*words[:i], bare, *words[i + 1 :]]
    return "", words


def _is_limb_word(word: str) -> bool:
    return word in _LIMB_WORDS


_LIMB_WORDS = frozenset(
    "arm leg hand foot thigh shin calf knee elbow wrist ankle shoulder hip toe upperarm forearm lowerarm upperleg "
    "lowerleg upleg uparm clavicle collar shldr thumb".split()
)
