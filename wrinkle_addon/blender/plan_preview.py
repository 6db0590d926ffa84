"""What a bake would make and cost, as the artist changes ranges and plan: told from settings alone, within a redraw."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import bpy
import numpy as np

from ..plan import SamplePlan, budget_plan, duration_text, paper_plan
from ..rig import Joint
from ..self_overlap import describe_left_out
from ..symmetry import Mirror, other_side, symmetric_limits
from .properties import defined_joint


@dataclass(frozen=True)
class PlanPreview:
    """A plan in numbers.

    Attributes:
        samples, simulated: How many there are, and how many of them are simulated, rest included.
        mirrored: How many are mirror images of these.
        left_out: What is said of those that are neither; empty if there are none, or as long as that is not known.
        megabytes: About how large the database is.
        seconds: About how long a bake takes on one CPU core [s].
        grids: Number of angles of every sampled joint, by degree of freedom.
    """

    samples: int
    simulated: int
    mirrored: int
    left_out: str
    megabytes: float
    seconds: float
    grids: Mapping[str, tuple[int, ...]]

    @property
    def duration(self) -> str:
        return duration_text(self.seconds)


def preview_plan(garment: bpy.types.Object, checked: SamplePlan | None = None) -> PlanPreview | None:
    """The plan that the garment's settings ask for; None if no joint is sampled.

    Args:
        checked: That plan, if the check has made it since they were changed: it has seen where the body leaves no place
            for cloth, for which a redraw has no time.
    """
    settings = garment.wrinkles
    enabled = [joint for joint in settings.joints if joint.enabled]
    if not enabled:
        return None
    asked = tuple(
        (joint.name, joint.definition, tuple(joint.low), tuple(joint.high), float(joint.step)) for joint in enabled
    )
    signs = settings.mirror_signs if settings.use_symmetry else ""
    budget = settings.budget if settings.plan == "BUDGET" else 0
    plan = checked or _plan(asked, signs, budget)
    count = len(garment.data.vertices)
    return PlanPreview(
        len(plan.samples) + 1,
        len(plan.simulated) + 1,
        len(plan.samples) - len(plan.simulated) - len(plan.left_out),
        describe_left_out(plan),
        plan.stored_bytes(count) / 1e6,
        plan.seconds(count),
        {grid.joint.name: grid.shape for grid in plan.grids},
    )


@lru_cache(maxsize=32)
def _plan(asked: tuple[Any, ...], signs: str, budget: int) -> SamplePlan:
    joints = [defined_joint(*each[:4]) for each in asked]
    mirror = _mirror(joints, signs)
    if mirror is not None:
        joints = symmetric_limits(joints, mirror)
    if budget:
        return budget_plan(joints, budget, mirror)
    return paper_plan(joints, mirror, {each[0]: each[4] for each in asked if each[4] > 0.0})


def signs_text(mirror: Mirror) -> str:
    """What a plan needs to know of a symmetric character, to be stored with a garment."""
    return json.dumps({name: signs.tolist() for name, signs in mirror.signs.items()})


def _mirror(joints: list[Joint], text: str) -> Mirror | None:
    """The symmetry of the joints alone: enough to count samples, as neither plane nor vertices matter for that."""
    signs = json.loads(text) if text else {}
    names = {joint.name for joint in joints}
    partners = {name: other_side(name) for name in names}
    if not names <= signs.keys() or not set(partners.values()) <= names or all(a == b for a, b in partners.items()):
        return None
    known = {name: np.array(values) for name, values in signs.items()}
    return Mirror(np.zeros(3), np.zeros(3), np.zeros(0, np.int32), partners, known)
