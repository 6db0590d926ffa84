"""Walking a hierarchy of bones given as parent indices (-1 for a root)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .rig import FloatArray, IntArray


def children_of(parents: IntArray, bone: int) -> list[int]:
    """The bones that hang directly on a bone; those of -1 are the roots."""
    return np.flatnonzero(parents == bone).tolist()


def ancestors_of(parents: IntArray, bone: int) -> list[int]:
    """The bone's parent, its parent, and so on up to a root."""
    chain: list[int] = []
    while (bone := int(parents[bone])) >= 0:
        chain.append(bone)
    return chain


def top_down(parents: IntArray) -> list[int]:
    """All bones, parents before children, whatever order they are stored in."""
    order = children_of(parents, -1)
    for bone in order:
        order += children_of(parents, bone)
    return order


def descendants(parents: IntArray) -> NDArray[np.bool_]:
    """Whether bone j is bone i or hangs below it, shape [bone_count, bone_count]."""
    below = np.eye(len(parents), dtype=bool)
    for bone in top_down(parents):
        if parents[bone] >= 0:
            below[:, bone] |= below[:, parents[bone]]
    return below


def parents_among(parents: IntArray, kept: NDArray[np.bool_], heads: FloatArray, directions: FloatArray) -> IntArray:
    """Each bone's nearest ancestor among the kept bones, -1 for none, shape [bone_count].

    An ancestor that is not kept but has a kept twin, with the same head and direction, stands for that twin: generated
    Rigify rigs hang their deforming bones (DEF-) on others (ORG-) that lie in the same place.

    Args:
        parents: The hierarchy, shape [bone_count].
        kept: Which bones may be parents, shape [bone_count].
        heads: Bone heads [m], shape [bone_count, 3].
        directions: Unit vectors along the bones, shape [bone_count, 3].
    """
    near = 1e-4 * max(float(np.ptp(heads, axis=0).max()), 1e-9)
    result = np.full(len(parents), -1, np.int32)
    for bone in top_down(parents):
        for above in ancestors_of(parents, bone):
            if kept[above]:
                result[bone] = above
                break
            same_place = np.linalg.norm(heads - heads[above], axis=1) < near
            twins = np.flatnonzero(kept & same_place & (directions @ directions[above] > 0.999))
            twin = next((int(t) for t in twins if t != bone and bone not in ancestors_of(result, int(t))), -1)
            if twin >= 0:
                result[bone] = twin
                break
    return result
