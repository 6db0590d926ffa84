"""The verb that bakes coarse layers: simulate without --fine."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from ..coarse_bake import BakedFrame
from ..folder_verbs import choose_device
from .simulate_coarse import bake_coarse
from .verb_options import find_frames, find_garment, open_file, say, say_share


def simulate_coarse(options: argparse.Namespace) -> Mapping[str, Any]:
    if options.out is not None:
        raise ValueError(
            "The coarse simulation goes into the cache that the file names; leave --out away, or add --fine."
        )
    device = choose_device(options.device)
    open_file(options)
    garment, frames = find_garment(options), find_frames(options, every=True)
    run = bake_coarse(garment, frames[0], frames[-1], device)
    if run.reason:
        say(run.reason)
    baked = []
    for step in run.frames:
        _say_step(options, step, (step.frame - run.first + 1) / (run.last - run.first + 1))
        baked.append(step)
    kept = sum(step.kept for step in baked)
    restarts = {step.frame: step.report["reason"] for step in baked if step.report["reason"]}
    text = [f"{len(baked) - kept} frames simulated, {kept} kept, in {run.folder}."]
    text += [f"Frame {frame} begins anew: {reason}" for frame, reason in restarts.items()]
    intersected = baked[0].report["crossed"]
    if intersected:
        text.append(f"{intersected} vertices of inner layers lie outside an outer one from the start.")
    return {
        "frames": len(baked),
        "simulated": len(baked) - kept,
        "kept": kept,
        "garments": list(run.garments),
        "cache": str(run.folder),
        "replaced": run.reason,
        "motion_changed_from": next((step.frame for step in baked if step.moved), None),
        "restarts": restarts,
        "intersected": intersected,
        "deepest_mm": round(1e3 * max(step.report["deepest"] for step in baked), 3),
        "crossed": max(step.report["crossed"] for step in baked),
        "text": "\n".join(text),
    }


def _say_step(options: argparse.Namespace, step: BakedFrame, share: float) -> None:
    if step.moved:
        say(f"The motion changed from frame {step.frame} on: {step.moved} elsewhere.")
    deepest, crossed = 1e3 * step.report["deepest"], step.report["crossed"]
    text = f"frame {step.frame}: deepest {deepest:.1f} mm under the skin, {crossed} vertices through another layer"
    say_share(options, share, f"frame {step.frame}: kept" if step.kept else text)
