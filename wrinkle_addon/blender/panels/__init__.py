"""The sidebar of the 3D view, tab Wrinkle: one path from the character to the finished clip, a step a panel."""

from __future__ import annotations

from . import bake, character, coarse, joints, output, plan, play, report
from .layout import WrinklePanel

__all__ = ["WrinklePanel", "classes"]

classes = (
    *character.classes,
    *joints.classes,
    *plan.classes,
    *bake.classes,
    *play.classes,
    *coarse.classes,
    *output.classes,
    *report.classes,
)
