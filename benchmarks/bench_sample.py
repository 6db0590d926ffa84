"""How long one sample of a bake takes: the demo's shirt walked to a node of the plan and settled there.

Settled twice: to a residual of one nodal weight, which is what the target asks for, and to the tolerance of a bake.
Where the time goes is looked for in a third run, as looking takes time, too.

Beside it, what a frame of Blender's own Cloth costs on the same shirt with self-collision on and twice its default
steps, and so how many of its frames a sample is worth. Blender's Cloth has no test for equilibrium; a shape at rest
takes it tens of frames.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import cProfile
import os
import pstats
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
from measure import Report, milliseconds, read_options
from outfit import SHELL, Outfit, SkinnedBody, dress
from wrinkle_synthesis.wrinkle_addon.plan import paper_plan
from wrinkle_synthesis.wrinkle_addon.rig import Pose, pose_of_angles
from wrinkle_synthesis.wrinkle_addon.wearer import BakeSettings, Wearer

SIZES = (2_000, 12_000, 25_000)
MOST_SECONDS = {2_000: 1.0, 25_000: 10.0}
"""Targets for one core, by the size of the garment."""
TARGET_RESIDUAL = 1.0
"""The residual that the targets are for, in nodal weights."""
EASE = (0.03, 0.04)
"""Extra cloth in girth and length, as a garment that was set up in Blender has."""
JOINT, STEPS_FROM_REST = "elbow_L", 3
"""The sample is so many nodes from rest; it starts from the settled node before it."""
CLOTH_QUALITY, CLOTH_FRAMES = 10, 6
STAGES = {
    "contact search": ("cloth_contact.py", "find"),
    "assembly": ("linear_solver.py", "assemble"),
    "preconditioner": ("linear_solver.py", "precondition"),
    "conjugate gradients": ("linear_solver.py", "solve"),
    "forces": ("cloth.py", "_evaluate_gradient"),
    "energies": ("cloth.py", "_evaluate_energy"),
}
"""Stages of the solver, by the file and the function whose time they are."""


def measure_sample(outfit: Outfit, *, quick: bool) -> dict[str, Any]:
    """Bake one sample as a bake does; its figures."""
    settings = BakeSettings(ease=EASE)
    if quick:
        settings = replace(settings, settle_iterations=2, turn_step=1.0)
    wearer = Wearer(outfit.rig, outfit.garment, outfit.body, SkinnedBody(outfit), settings)
    grid = paper_plan(outfit.joints).grid[JOINT]
    node = grid.rest[0] + STEPS_FROM_REST
    start, end = (pose_of_angles(outfit.rig, [grid.joint], {JOINT: grid.at((n,))}) for n in (node - 1, node))
    started = time.perf_counter()
    [rest] = wearer.dress()
    rest_seconds = time.perf_counter() - started
    wearer.walk(start)
    wearer.settle()
    shape = wearer.positions

    def simulate(tolerance: float) -> tuple[dict[str, Any], float, float]:
        """Report of the sample, time to walk to it and time to settle [s]."""
        started = time.perf_counter()
        wearer.begin(shape, start)
        for fraction in wearer.fractions(start, end):
            wearer.follow(Pose(end.matrices) if fraction == 1.0 else _between(outfit, grid, node, float(fraction)))
        walked = time.perf_counter()
        [report] = wearer.settle(tolerance)
        return report, walked - started, time.perf_counter() - walked

    simulate(settings.settle_tolerance)  # What is recorded once, and memory that is taken once.
    weighed, *weighed_seconds = simulate(TARGET_RESIDUAL)
    report, *seconds = simulate(settings.settle_tolerance)
    profile = cProfile.Profile()
    with profile:
        _, *profiled_seconds = simulate(settings.settle_tolerance)
    return {
        "vertices": outfit.garment.vertex_count,
        "seconds": sum(seconds),
        "walk_seconds": seconds[0],
        "settle_seconds": seconds[1],
        "weight_seconds": sum(weighed_seconds),
        "weight_settle_seconds": weighed_seconds[1],
        "weight_residual": weighed["residual"],
        "weight_newton_iterations": weighed["iterations"],
        "rest_seconds": rest_seconds,
        "rest_residual": rest["residual"],
        "residual": report["residual"],
        "converged": report["converged"],
        "newton_iterations": report["iterations"],
        "linear_iterations": report["linear_iterations"],
        "profiled_seconds": sum(profiled_seconds),
        "stage_seconds": stage_seconds(profile),
    }


def _between(outfit: Outfit, grid: Any, node: int, fraction: float) -> Pose:
    angles = (1.0 - fraction) * grid.at((node - 1,)) + fraction * grid.at((node,))
    return pose_of_angles(outfit.rig, [grid.joint], {grid.joint.name: angles})


def stage_seconds(profile: cProfile.Profile) -> dict[str, float]:
    """Time inside each stage of the solver [s]."""
    stats: dict[tuple[str, int, str], tuple] = pstats.Stats(profile).stats  # pyright: ignore[reportAttributeAccessIssue]
    seconds = dict.fromkeys(STAGES, 0.0)
    for (path, _, function), (_, _, _, cumulative, _) in stats.items():
        for stage, place in STAGES.items():
            if (os.path.basename(path), function) == place:
                seconds[stage] += cumulative
    return seconds


def measure_cloth(outfit: Outfit, *, quick: bool) -> float:
    """Seconds a frame of Blender's Cloth on the same shirt, the median of a few."""
    from stage import TUNED_DISTANCES, add_cloth, open_stage, simulate_cloth

    stage = open_stage(outfit)
    add_cloth(stage, "cloth", quality=CLOTH_QUALITY, self_collision=True, distances=TUNED_DISTANCES)
    return float(np.median(simulate_cloth(stage, "cloth", 1 if quick else CLOTH_FRAMES)))


def main() -> None:
    report = Report("sample", read_options(__doc__))
    quick = report.options.quick
    outfits = [dress([SHELL], 0)] if quick else [dress(["shirt"], size) for size in SIZES]
    results = []
    for outfit in outfits:
        result = measure_sample(outfit, quick=quick)
        result["cloth_frame_seconds"] = measure_cloth(outfit, quick=quick)
        result["cloth_frames"] = result["seconds"] / result["cloth_frame_seconds"]
        results.append(result)
    heads = [f"{result['vertices']} vertices" for result in results]
    rows = [["", *heads]]
    for name, key in (
        ("one sample", "seconds"),
        ("  walk to it", "walk_seconds"),
        ("  settle", "settle_seconds"),
        ("one sample to 1 nodal weight", "weight_seconds"),
        ("  settle", "weight_settle_seconds"),
    ):
        rows.append([name, *(milliseconds(result[key]) for result in results)])
    for stage in STAGES:
        shares = (result["stage_seconds"][stage] / result["profiled_seconds"] for result in results)
        rows.append([f"of the first {stage}", *(f"{share:.0%}" for share in shares)])
    for key in ("newton_iterations", "linear_iterations", "residual", "weight_newton_iterations", "rest_residual"):
        rows.append([key.replace("_", " "), *(f"{result[key]:g}" for result in results)])
    rows.append(["rest pose", *(milliseconds(result["rest_seconds"]) for result in results)])
    rows.append(["a frame of Blender's Cloth", *(milliseconds(result["cloth_frame_seconds"]) for result in results)])
    rows.append(["one sample in frames of Blender's Cloth", *(f"{result['cloth_frames']:.1f}" for result in results)])
    report.table(f"{JOINT}, {STEPS_FROM_REST} nodes from rest, residuals in nodal weights", rows)
    for size, result in zip(SIZES, results, strict=False):
        if size in MOST_SECONDS:
            for what, key in (("1 nodal weight", "weight_seconds"), (f"{result['residual']:g}", "seconds")):
                name = f"seconds to a residual of {what} at {size} vertices"
                report.target(name, result[key], MOST_SECONDS[size], at_least=False)
    report.figures |= {"seconds": results[-1]["seconds"], "samples": results}
    report.finish()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(0)


if __name__ == "__main__":
    main()
