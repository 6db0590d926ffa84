"""How many frames a second Blender plays with a wrinkling garment of 46,000 vertices, whole frames with the body.

A frame is frame_set with all its handlers, and reading the evaluated garment. Beside it: the garment kept clear of the
body, the paper's form, the skinned garment without wrinkles, a point cache of the same frames (what else plays without
simulating), and no garment.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from measure import Contestant, Report, milliseconds, read_options, side_by_side, times, undisturbed
from outfit import SHELL, dress

VERTICES, FRAMES, PASSES = 46_500, 20, 6
LEAST_FPS = 60.0
MOST_CLEARING_MS = 10.0
PARTS = {
    "wrinkles": "wrinkles, default form",
    "clear": "wrinkles, kept clear of the body",
    "paper": "wrinkles, the paper's form",
    "cache": "point cache (PC2) of the same frames",
    "skinned": "skinned garment, no wrinkles",
    "none": "body alone",
}


def main() -> None:
    report = Report("frame", read_options(__doc__))
    quick = report.options.quick
    from stage import Stage, add_point_cache, open_stage

    stage: Stage = open_stage(dress([SHELL], 0) if quick else dress(["shirt", "trousers"], VERTICES))
    with tempfile.TemporaryDirectory() as name:
        database = stage.bake(Path(name), quick=quick)
        stage.add_wrinkles("wrinkles", database)
        stage.add_wrinkles("clear", database, clear=True)
        stage.add_wrinkles("paper", database, "PAPER")
        frames = stage.frames(2 if quick else FRAMES)
        add_point_cache(stage, "cache", "wrinkles", Path(name) / "cache.pc2", range(1, stage.frame_count + 1))
        contestants = {
            key: Contestant(stage.play, lambda key=key: stage.show(key if key != "none" else None)) for key in PARTS
        }
        seconds = side_by_side(contestants, frames, 1 if quick else PASSES)
    time = {key: undisturbed(values) for key, values in seconds.items()}
    fps = 1.0 / time["wrinkles"]
    rows = [["", "frame", "frames/s", "of a skinned frame", "garment's part"]]
    for key, what in PARTS.items():
        part = milliseconds(time[key] - time["none"])
        rows.append([what, milliseconds(time[key]), f"{1.0 / time[key]:.0f}", times(time[key] / time["skinned"]), part])
    count = stage.outfit.garment.vertex_count
    report.table(f"{count} vertices, {len(stage.outfit.joints)} joints, body of {len(stage.body.data.vertices)}", rows)
    clearing = time["clear"] - time["wrinkles"]
    report.target("frames a second", fps, LEAST_FPS, at_least=True)
    report.target("ms to keep the garment clear", 1e3 * clearing, MOST_CLEARING_MS, at_least=False)
    report.figures |= {
        "vertices": count,
        "fps": fps,
        "frame_ms": 1e3 * time["wrinkles"],
        "clear_fps": 1.0 / time["clear"],
        "clearing_ms": 1e3 * clearing,
        "clearing_ratio_to_synthesis": clearing / (time["wrinkles"] - time["none"]),
        "paper_fps": 1.0 / time["paper"],
        "point_cache_fps": 1.0 / time["cache"],
        "skinned_fps": 1.0 / time["skinned"],
        "body_fps": 1.0 / time["none"],
        "garment_ms": 1e3 * (time["wrinkles"] - time["none"]),
        "ratio_to_skinned": time["wrinkles"] / time["skinned"],
        "ratio_to_point_cache": time["wrinkles"] / time["cache"],
    }
    report.finish()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(0)


if __name__ == "__main__":
    main()
