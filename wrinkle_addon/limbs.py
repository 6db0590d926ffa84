"""Arms and legs found by the shape of a skeleton, with bone names as further evidence.

A limb is a chain of two long straight parts and an end: upper arm, forearm, hand or thigh, shin, foot. Every such chain
in the tree gets a cost from its proportions and its names; mirrored chains make pairs; the pair of legs and the pair of
arms that fit best to each other and to a trunk between them win. Only head positions count, so bone rolls, tails and
local axes do not matter, and orientation does not either: legs continue the trunk, whatever way is up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .bone_names import BoneLabel
from .bone_tree import ancestors_of, children_of, descendants
from .rig import FloatArray, IntArray, Rig

# Bounds on the search; far more than a human skeleton needs.
_CANDIDATES_KEPT = 160
_PAIRS_KEPT = 24
# Dearest that still looks like a pair of limbs, like a whole body, and like half a body. Named human rigs cost -10 to
# 9, the same without names 10 to 24, a hand taken for a body 29, a dog 43.
_WORST_PAIR = 26.0
_WORST_BODY = 28.0
_WORST_LONE_PAIR = 10.0

# How well a part that a name claims fits the first, middle and last bone of each kind of limb.
LIMB_PARTS: dict[str, tuple[dict[str, float], ...]] = {
    "arm": (
        {"upperarm": 1.0, "arm": 0.9, "shoulder": 0.5},
        {"forearm": 1.0, "arm": 0.3},
        {"hand": 1.0},
    ),
    "leg": (
        {"thigh": 1.0, "leg": 0.7, "hip": 0.5},
        {"shin": 1.0, "leg": 0.7},
        {"foot": 1.0},
    ),
}
_CLAIM = 1.2
_CONFLICT = 0.7
_FOREIGN = 1.5
_FOREIGN_PARTS = frozenset(["finger", "toe", "face", "soft"])
_HELPER = 4.0


@dataclass(frozen=True)
class Limb:
    """An arm or a leg: indices of its first bone (upper arm, thigh), of its middle bone (forearm, shin) and of its end
    (hand, foot); -1 where the rig has no middle or no end.
    """

    first: int
    middle: int
    end: int


@dataclass(frozen=True)
class LimbSearch:
    """Pairs of limbs, each as two limbs in no particular order, or None where the rig has no such pair."""

    arms: tuple[Limb, Limb] | None
    legs: tuple[Limb, Limb] | None


@dataclass(frozen=True)
class _Candidates:
    """Chains that may be limbs; row i of every array is one chain."""

    limbs: list[Limb]
    first: IntArray
    points: FloatArray  # head of first, of middle, of the end, shape [count, 3, 3]
    upper: FloatArray
    lower: FloatArray
    cost: dict[str, FloatArray]  # by kind
    sides: NDArray[np.int8]  # 1 left, -1 right, 0 unknown, as the names say
    sizes: IntArray  # bones below the first one


def search_limbs(rig: Rig, parents: IntArray, labels: Sequence[BoneLabel]) -> LimbSearch:
    """Find the arms and the legs of a skeleton.

    Args:
        rig: The rig.
        parents: The hierarchy to search, shape [bone_count]; may repair that of the rig.
        labels: What each bone's name says.
    """
    below = descendants(parents)
    candidates = _find_candidates(rig, parents, below, labels)
    pairs = {kind: _best_pairs(candidates, below, kind) for kind in ("arm", "leg")}
    best: tuple[float, list[int], list[int]] = (_WORST_BODY, [], [])
    for leg_cost, *legs in pairs["leg"]:
        for arm_cost, *arms in pairs["arm"]:
            if leg_cost + arm_cost < best[0]:
                cost = leg_cost + arm_cost + _misfit(rig, below, candidates, legs, arms)
                best = min(best, (cost, legs, arms))
    if best[1]:
        return LimbSearch(arms=_limbs(candidates, best[2]), legs=_limbs(candidates, best[1]))
    return _half_body(rig, candidates, pairs)


def _limbs(candidates: _Candidates, pair: Sequence[int]) -> tuple[Limb, Limb]:
    return candidates.limbs[pair[0]], candidates.limbs[pair[1]]


def lone_limb(rig: Rig, parents: IntArray, labels: Sequence[BoneLabel], kind: str, taken: set[int]) -> Limb | None:
    """The one limb of this kind ("arm", "leg") on a body that lacks the other, where names vouch for it."""
    claims = LIMB_PARTS[kind]
    candidates = _find_candidates(rig, parents, descendants(parents), labels)
    for i in np.argsort(candidates.cost[kind]) if candidates.limbs else ():
        limb = candidates.limbs[i]
        vouched = labels[limb.first].part in claims[0] and labels[limb.middle].part in claims[1]
        if vouched and not taken & {limb.first, limb.middle}:
            return limb
    return None


def stub_limb(labels: Sequence[BoneLabel], kind: str, side: str, taken: set[int]) -> Limb | None:
    """A limb of one piece on this side, known by its name alone."""
    sure = {part for part, weight in LIMB_PARTS[kind][0].items() if weight > 0.8}
    for bone, label in enumerate(labels):
        if label.part in sure and label.side == side and not label.helper and bone not in taken:
            return Limb(bone, -1, -1)
    return None


def _find_candidates(rig: Rig, parents: IntArray, below: NDArray[np.bool_], labels: Sequence[BoneLabel]) -> _Candidates:
    heads = rig.heads
    size = float(np.linalg.norm(np.ptp(np.concatenate([heads, rig.tails]), axis=0))) or 1.0
    found: dict[tuple[int, int], list[tuple[float, Limb, FloatArray, float, float, dict[str, float]]]] = {}
    for bone in range(rig.bone_count):
        above = ancestors_of(parents, bone)
        ends = [(bone, heads[bone], above)]
        if not children_of(parents, bone):
            ends.append((-1, rig.tails[bone], [bone, *above]))
        for end, tip, up in ends:
            for limb, points, upper, lower, bend in _chains(heads, size, end, tip, up):
                costs = {
                    kind: _shape_cost(kind, upper, lower, bend, size)
                    + _name_cost(kind, limb, labels)
                    + _end_cost(kind, rig, below, parents, limb, points, up)
                    for kind in ("arm", "leg")
                }
                entry = (min(costs.values()), limb, points, upper, lower, costs)
                found.setdefault((limb.first, limb.middle), []).append(entry)
    # Of all ends of one chain only the likeliest can win.
    entries = [entry for group in found.values() for entry in sorted(group, key=lambda e: e[0])[:2]]
    entries = sorted(entries, key=lambda e: e[0])[:_CANDIDATES_KEPT]
    limbs = [entry[1] for entry in entries]
    side = {"L": 1, "R": -1, "": 0}
    return _Candidates(
        limbs=limbs,
        first=np.array([limb.first for limb in limbs], np.int32),
        points=np.array([entry[2] for entry in entries]).reshape(-1, 3, 3),
        upper=np.array([entry[3] for entry in entries]),
        lower=np.array([entry[4] for entry in entries]),
        cost={kind: np.array([entry[5][kind] for entry in entries]) for kind in ("arm", "leg")},
        sides=np.array([side[labels[limb.middle].side or labels[limb.first].side] for limb in limbs], np.int8),
        sizes=np.array([below[limb.first].sum() for limb in limbs], np.int32),
    )


def _chains(heads: FloatArray, size: float, end: int, tip: FloatArray, up: list[int]):
    """All (limb, points, upper length, lower length, crookedness) that end at ``tip``, below the bones ``up``."""
    lengths = np.linalg.norm(heads[up] - tip, axis=1)
    # A tail ends a limb without hand or foot: that of the forearm itself, or of one more bone that divides it.
    for i, middle in enumerate(up if end >= 0 else up[:2]):
        lower = float(lengths[i])
        if not 0.04 * size < lower < 0.6 * size:
            continue
        for first in up[i + 1 :]:
            upper = float(np.linalg.norm(heads[middle] - heads[first]))
            if not (0.04 * size < upper < 0.6 * size and 0.35 < lower / upper < 2.6):
                continue
            j = up.index(first)
            bend = max(
                _crookedness(heads[first], heads[middle], heads[up[i + 1 : j]]),
                _crookedness(heads[middle], tip, heads[up[:i]]),
            )
            if bend < 0.3:
                yield Limb(first, middle, end), np.stack([heads[first], heads[middle], tip]), upper, lower, bend


def _crookedness(start: FloatArray, stop: FloatArray, between: FloatArray) -> float:
    """Largest distance of the points between from the line start-stop, as a fraction of its length."""
    if not len(between):
        return 0.0
    line = stop - start
    offsets = between - start
    along = np.clip(offsets @ line / (line @ line), 0.0, 1.0)
    return float(np.linalg.norm(offsets - along[:, None] * line, axis=1).max() / np.linalg.norm(line))


def _shape_cost(kind: str, upper: float, lower: float, bend: float, size: float) -> float:
    """Human proportions: forearm a little shorter than upper arm, shin as long as thigh; longer chains are likelier."""
    usual, spread = (-0.12, 0.3) if kind == "arm" else (-0.03, 0.22)
    ratio = (np.log(lower / upper) - usual) / spread
    return float(min(ratio * ratio, 9.0) + (bend / 0.1) ** 2 - 4.0 * np.log((upper + lower) / size))


def _name_cost(kind: str, limb: Limb, labels: Sequence[BoneLabel]) -> float:
    cost = 0.0
    for bone, claims in zip((limb.first, limb.middle, limb.end), LIMB_PARTS[kind], strict=True):
        if bone < 0:
            continue
        label = labels[bone]
        # Where a limb ends, its shape says least: a wrist, a palm and a knuckle lie on one line.
        weight = 2.0 if bone == limb.end else 1.0
        if label.part in claims:
            cost -= weight * _CLAIM * claims[label.part]
        elif label.part:
            cost += weight * (_FOREIGN if label.part in _FOREIGN_PARTS else _CONFLICT)
        if label.helper:
            cost += _HELPER if bone != limb.end else 1.0
    return cost


def _end_cost(
    kind: str, rig: Rig, below: NDArray[np.bool_], parents: IntArray, limb: Limb, points: FloatArray, up: list[int]
) -> float:
    """Hands carry fingers and continue the forearm; feet turn away from the shin."""
    cost = 0.4 * up.index(limb.middle)
    if limb.end < 0:
        return cost + 1.0
    beyond = np.flatnonzero(below[limb.end])
    tip = np.concatenate([rig.heads[beyond], rig.tails[beyond]]).mean(0) - points[2]
    shaft = points[2] - points[1]
    if np.linalg.norm(tip) > 0.02 * np.linalg.norm(shaft):
        straight = float(shaft @ tip / (np.linalg.norm(shaft) * np.linalg.norm(tip)))
        cost -= 1.5 if (straight < 0.75) == (kind == "leg") else 0.0
    if kind == "arm" and len(children_of(parents, limb.end)) >= 3:
        cost -= 1.0
    return cost


def _best_pairs(candidates: _Candidates, below: NDArray[np.bool_], kind: str) -> list[tuple[float, int, int]]:
    """The cheapest mirrored pairs of one kind, as (cost, index, index)."""
    c = candidates
    if len(c.limbs) < 2:
        return []
    i, j = np.triu_indices(len(c.limbs), 1)
    apart = np.linalg.norm(c.points[i] - c.points[j], axis=2)
    reach = 0.5 * (c.upper[i] + c.lower[i] + c.upper[j] + c.lower[j])
    cost = c.cost[kind][i] + c.cost[kind][j]
    cost += np.minimum((np.log(c.upper[i] / c.upper[j]) / 0.08) ** 2, 6.0)
    cost += np.minimum((np.log(c.lower[i] / c.lower[j]) / 0.08) ** 2, 6.0)
    usual, spread = (0.3, 0.55) if kind == "arm" else (0.11, 0.6)
    width = np.maximum(0.5 * apart[:, 0] / reach, 1e-3)
    cost += np.minimum((np.log(width / usual) / spread) ** 2, 16.0)
    cost += _skewness(c.points[i] - c.points[j], apart, reach)
    cost += np.where(c.sides[i] * c.sides[j] > 0, 2.0, 0.0) - np.where(c.sides[i] * c.sides[j] < 0, 1.0, 0.0)
    cost += np.minimum(np.abs(np.log(c.sizes[i] / c.sizes[j])), 2.0)
    nested = below[c.first[i], c.first[j]] | below[c.first[j], c.first[i]]
    cost[nested | (apart.min(1) < 0.02 * reach)] = np.inf
    order = np.argsort(cost)[:_PAIRS_KEPT]
    return [(float(cost[k]), int(i[k]), int(j[k])) for k in order if cost[k] < _WORST_PAIR]


def _skewness(across: FloatArray, apart: FloatArray, reach: FloatArray) -> FloatArray:
    """Mirrored points are joined by parallel lines: cost of the angles between them, shape [pairs]."""
    units = across / np.maximum(apart, 1e-9)[..., None]
    cost = np.zeros(len(across))
    for a, b in ((0, 1), (1, 2), (0, 2)):
        angle = np.degrees(np.arccos(np.clip((units[:, a] * units[:, b]).sum(1), -1.0, 1.0)))
        weight = np.minimum(np.minimum(apart[:, a], apart[:, b]) / (0.1 * reach), 1.0)
        cost += weight * np.minimum((angle / 15.0) ** 2, 4.0)
    return cost


def _misfit(rig: Rig, below: NDArray[np.bool_], c: _Candidates, legs: list[int], arms: list[int]) -> float:
    """How badly a pair of legs and a pair of arms fit to one trunk."""
    bones = [{c.limbs[i].first, c.limbs[i].middle} for i in (*legs, *arms)]
    firsts = [c.limbs[i].first for i in (*legs, *arms)]
    if any(below[a, b] for a in firsts for b in firsts if a != b) or len(set.union(*bones)) < 8:
        return np.inf
    hips, shoulders = c.points[legs, 0].mean(0), c.points[arms, 0].mean(0)
    trunk = shoulders - hips
    length = float(np.linalg.norm(trunk))
    leg = float((c.upper[legs] + c.lower[legs]).mean())
    arm = float((c.upper[arms] + c.lower[arms]).mean())
    if length < 0.1 * leg:
        return np.inf
    up = trunk / length
    cost = min((np.log(length / (0.6 * leg)) / 0.4) ** 2, 9.0) + min((np.log(leg / (1.5 * arm)) / 0.35) ** 2, 9.0)
    for i in legs:
        down = c.points[i, 2] - c.points[i, 0]
        angle = np.degrees(np.arccos(np.clip(-(down @ up) / np.linalg.norm(down), -1.0, 1.0)))
        cost += min((angle / 22.0) ** 2, 16.0)
    across_legs, across_arms = (c.points[pair[0], 0] - c.points[pair[1], 0] for pair in (legs, arms))
    parallel = abs(across_legs @ across_arms) / (np.linalg.norm(across_legs) * np.linalg.norm(across_arms))
    cost += 6.0 * (1.0 - parallel)
    if up @ rig.gravity > 0.5:
        cost += 3.0
    carriers = [np.flatnonzero(below[:, firsts[k]] & below[:, firsts[k + 1]]) for k in (0, 2)]
    if set(carriers[1]) < set(carriers[0]):
        cost += 4.0
    elif set(carriers[0]) == set(carriers[1]):
        # No spine between arms and legs: fingers of a hand, rather than a body.
        cost += 8.0
    return float(cost)


def _half_body(rig: Rig, candidates: _Candidates, pairs: dict[str, list[tuple[float, int, int]]]) -> LimbSearch:
    """The best pair alone, on a body of which only one half is there; hanging limbs are legs."""
    best: tuple[float, str, list[int]] = (_WORST_LONE_PAIR, "", [])
    for kind, found in pairs.items():
        for cost, *pair in found:
            down = (candidates.points[pair, 2] - candidates.points[pair, 0]).mean(0)
            fall = float(down @ rig.gravity / max(float(np.linalg.norm(down)), 1e-9))
            best = min(best, (cost + (3.0 * (1.0 - fall) if kind == "leg" else 0.0), kind, pair))
    limbs = _limbs(candidates, best[2]) if best[2] else None
    return LimbSearch(arms=limbs if best[1] == "arm" else None, legs=limbs if best[1] == "leg" else None)
