"""Databases of the doll, baked from formulas in a moment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from dolls import Doll, ShapedSamples, grid_of
from wrinkle_synthesis.wrinkle_addon.bake import bake
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase
from wrinkle_synthesis.wrinkle_addon.plan import SamplePlan

GRID = {
    "elbow_L": ([-30, 0, 30, 60, 90],),
    "elbow_R": ([-30, 0, 30, 60, 90],),
    "shoulder_L": ([-40, 0, 40], [-30, 0, 30, 60], [-30, 0, 30, 60]),
    "shoulder_R": ([-40, 0, 40], [-30, 0, 30, 60], [-30, 0, 30, 60]),
}


def full_plan(character: Doll) -> SamplePlan:
    return SamplePlan(tuple(grid_of(character.joint(name), *degrees) for name, degrees in GRID.items()))


def bump(character: Doll, joint: str, size: float = 0.02):
    """Offsets of up to ``size`` [m] around a joint, smooth in place and angle."""
    positions = character.garment.positions
    distance = np.linalg.norm(positions - character.joint(joint).pivot(character.rig), axis=1)
    shape = size * np.exp(-((distance / 0.12) ** 2))[:, None] * np.sin(30 * positions + [0.0, 1.0, 2.0])
    return lambda angles: np.sin(angles).sum() * shape


def baked(folder: Path, character: Doll, plan: SamplePlan, bumps: Mapping[str, Any] | None = None) -> WrinkleDatabase:
    for _ in bake(character.job(plan), ShapedSamples(character, plan, bumps), folder):
        pass
    return WrinkleDatabase.open(folder, check_hashes=True)
