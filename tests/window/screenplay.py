"""What is done in a window step by step, with a wait after each; Blender ends after the last."""

from __future__ import annotations

import importlib
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import bpy
from mouse import Hand, Steps

BEGAN = time.monotonic()
PACKAGE = "bl_ext.user_default.wrinkle_synthesis"
SHOTS = Path(sys.argv[sys.argv.index("--") + 1])
LONG = 600.0
"""What anything may take on a slow machine [s]."""

first_start = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.first_start").first_start


def run(what: Callable[[Hand], Steps], panels: tuple[str, ...]) -> None:
    """Do it once the window stands, with these panels open, and end Blender: with code 1 if it failed."""
    bpy.context.preferences.view.show_splash = False
    open_panels(panels)

    def begin() -> None:
        hand = Hand(SHOTS)
        steps = what(hand)
        bpy.app.timers.register(lambda: tick(steps, hand), first_interval=0.0)

    bpy.app.timers.register(begin, first_interval=2.0)


def tick(steps: Steps, hand: Hand) -> float:
    """Go on to the next wait, or leave Blender."""
    code = 0
    try:
        return next(steps)
    except StopIteration:
        pass
    except BaseException:
        traceback.print_exc()
        for _ in hand.shoot("failed"):
            pass
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    first_start.end()
    os._exit(code)


def open_panels(labels: tuple[str, ...]) -> None:
    """Let these panels start open and the others closed; Blender offers no other hand to it than the mouse's."""
    package = sys.modules[PACKAGE]
    package.unregister()
    first_start.__init__()
    pending = [bpy.types.Panel]
    while pending:
        panel = pending.pop()
        pending += panel.__subclasses__()
        if panel.__module__.startswith(PACKAGE) and hasattr(panel, "bl_label"):
            options = set(getattr(panel, "bl_options", ())) - {"DEFAULT_CLOSED"}
            panel.bl_options = options | (set() if panel.bl_label in labels else {"DEFAULT_CLOSED"})
    package.register()


def open_sidebar(hand: Hand) -> Steps:
    """The 3D view as large as it goes, with our tab in front."""
    with bpy.context.temp_override(window=hand.window, area=hand.area):
        hand.area.spaces.active.show_region_ui = True
    yield 0.8
    hand.region("UI").active_panel_category = "Wrinkle"
    with bpy.context.temp_override(window=hand.window, area=hand.area, region=hand.region("WINDOW")):
        bpy.ops.view3d.view_axis(type="FRONT")
        bpy.ops.view3d.view_all()
    yield 0.8


def wait_for(condition: Callable[[], object], what: str, longest: float = LONG) -> Steps:
    until = time.monotonic() + longest
    while not condition():
        assert time.monotonic() < until, f"Not within {longest:.0f} s: {what}."
        yield 0.1


def say(text: str) -> None:
    print(f"window: {text}", flush=True)
