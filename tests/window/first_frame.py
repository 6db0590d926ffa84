"""How long it takes from Blender's start to the first wrinkled frame of a file that was baked before.

Run by tools/window.py as ``blender ready.blend --python first_frame.py -- START``, with the time of the start [s since
the epoch]; ends Blender. Lines that begin with "window:" are shown to whoever runs it.
"""

from __future__ import annotations

import importlib
import os
import sys
import time

import bpy

PACKAGE = "bl_ext.user_default.wrinkle_synthesis"
START = float(sys.argv[-1])
LONG = 600.0
"""What all of it may take on a slow machine [s]."""

first_start = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.first_start").first_start
playback = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.playback")

reached: dict[str, float] = {}
"""When what was reached [s]."""


def look() -> float:
    """Note what is there now, and leave when there is nothing more to wait for."""
    garment = next(ob for ob in bpy.data.objects if ob.type == "MESH" and len(ob.wrinkles.joints))
    garment.wrinkles.enabled = True
    known = playback.status(garment)
    passed = time.time() - START
    reached.setdefault("the window was there", passed)
    if first_start.is_over:
        reached.setdefault("kernels were there", passed)
    if known.plays or known.error or passed > LONG:
        reached["the first frame wrinkled"] = passed
        told = ", ".join(f"{what} after {seconds:.1f} s" for what, seconds in reached.items())
        print(f"window: {known.error or told}", flush=True)
        first_start.end()
        os._exit(int(not known.plays))
    return 0.05


bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(look, first_interval=0.0)
