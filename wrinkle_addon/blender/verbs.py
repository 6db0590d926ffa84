"""The verbs that open a scene, behind both doors of the command line, by their names."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from typing import Any

import bpy

from ..attendance import Attendance
from . import handlers, verbs_bake, verbs_flow, verbs_influence, verbs_play, verbs_setup

VERBS: Mapping[str, Callable[[argparse.Namespace], Mapping[str, Any]]] = {
    "setup": verbs_setup.setup,
    "joints": verbs_setup.joints,
    "animate": verbs_setup.animate,
    "check": verbs_setup.check,
    "plan": verbs_bake.plan,
    "bake": verbs_bake.bake,
    "synthesize": verbs_play.synthesize,
    "simulate": verbs_play.simulate,
    "evaluate": verbs_play.evaluate,
    "influence": verbs_influence.influence,
    "flow": verbs_flow.flow,
}
"""Each gives a JSON object, with "text" for people and, if it is not 0, "exit_code"."""


def run(name: str, options: argparse.Namespace) -> Mapping[str, Any]:
    """Run a verb, with our properties known to Blender and no playing while it works."""
    _ensure_registered()
    if getattr(options, "attended", False):
        options.attendance = Attendance(sys.stdin)
    with handlers.suspended():
        return VERBS[name](options)


def _ensure_registered() -> None:
    """Inside Blender the add-on is enabled; under the plain module its properties are registered here."""
    if not hasattr(bpy.types.Object, "wrinkles"):
        from ... import register

        register()
