"""A wrinkling shirt of 46,000 vertices beside what else gives it wrinkles in Blender, on the same moving body.

Blender's own Cloth modifier simulates the shirt, with and without self-collision, as Blender sets it and with distances
tuned to the shirt; and 50 dense native shape keys, all driven and none at zero, stand for sculpted wrinkles. A frame is
frame_set and reading the evaluated shirt.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
from measure import Contestant, Report, milliseconds, read_options, side_by_side, times, undisturbed
from outfit import SHELL, dress

VERTICES, FRAMES, PASSES = 47_000, 20, 6
SHAPE_KEYS = 50
CLOTH_FRAMES = {"cloth": 6, "tuned_cloth": 12, "self_collision": 2, "tuned_self_collision": 6}
CLOTH_QUALITY = 5
"""Steps a frame: Blender's own setting."""
LEAST_TIMES = {"cloth": 300.0, "self_collision": 2000.0}
NAMES = {
    "wrinkles": "wrinkles",
    "shape_keys": f"{SHAPE_KEYS} shape keys",
    "skinned": "skinned shirt, no wrinkles",
    "none": "body alone",
    "cloth": "Blender's Cloth",
    "tuned_cloth": "Blender's Cloth, tuned distances",
    "self_collision": "Blender's Cloth with self-collision",
    "tuned_self_collision": "Blender's Cloth with self-collision, tuned distances",
}


def main() -> None:
    report = Report("peers", read_options(__doc__))
    quick = report.options.quick
    from stage import TUNED_DISTANCES, add_cloth, add_shape_keys, open_stage, simulate_cloth

    stage = open_stage(dress([SHELL], 0) if quick else dress(["shirt"], VERTICES))
    with tempfile.TemporaryDirectory() as name:
        stage.add_wrinkles("wrinkles", stage.bake(Path(name), quick=quick))
        bones = [bone for joint in stage.outfit.joints for bone in joint.bones]
        add_shape_keys(stage, "shape_keys", SHAPE_KEYS, bones)
        for key in CLOTH_FRAMES:
            distances = TUNED_DISTANCES if key.startswith("tuned") else None
            add_cloth(stage, key, quality=CLOTH_QUALITY, self_collision="self_collision" in key, distances=distances)
        contestants = {
            key: Contestant(stage.play, lambda key=key: stage.show(key if key != "none" else None))
            for key in ("wrinkles", "shape_keys", "skinned", "none")
        }
        frames, passes = stage.frames(2 if quick else FRAMES), 1 if quick else PASSES
        before = side_by_side(contestants, frames, passes)
        # A simulation cannot repeat a frame; the median of different ones stands for all.
        cloth = {
            key: float(np.median(simulate_cloth(stage, key, 1 if quick else count)))
            for key, count in CLOTH_FRAMES.items()
        }
        after = side_by_side(contestants, frames, passes)
    time = {key: undisturbed(np.concatenate([before[key], after[key]])) for key in contestants} | cloth
    ours = time["wrinkles"]
    garment = ours - time["none"]
    rows = [["", "frame", "of our frame", "garment's part", "of our part"]]
    for key, what in NAMES.items():
        part = time[key] - time["none"]
        rows.append([what, milliseconds(time[key]), times(time[key] / ours), milliseconds(part), times(part / garment)])
    count = stage.outfit.garment.vertex_count
    report.table(f"{count} vertices, {len(stage.outfit.joints)} joints, body of {len(stage.body.data.vertices)}", rows)
    for key, least in LEAST_TIMES.items():
        report.target(f"times faster than {NAMES[key]}", time[key] / ours, least, at_least=True)
    report.target(f"frame over that of {SHAPE_KEYS} shape keys", ours / time["shape_keys"], 1.0, at_least=False)
    report.figures |= {
        "vertices": count,
        "frame_ms": 1e3 * ours,
        "garment_ms": 1e3 * garment,
        **{f"{key}_seconds": seconds for key, seconds in cloth.items()},
        **{f"times_faster_than_{key}": seconds / ours for key, seconds in cloth.items()},
        **{f"garment_times_faster_than_{key}": (seconds - time["none"]) / garment for key, seconds in cloth.items()},
        "shape_keys_ms": 1e3 * time["shape_keys"],
        "ratio_to_shape_keys": ours / time["shape_keys"],
        "ratio_to_skinned": ours / time["skinned"],
    }
    report.finish()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(0)


if __name__ == "__main__":
    main()
