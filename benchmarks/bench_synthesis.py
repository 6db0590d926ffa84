"""How long one pose takes to become a garment, beside what its bytes need at the machine's memory bandwidth.

The outfit is the demo's shirt and trousers in one mesh of 46,000 vertices with all nine joints, and the paper's plan.
Every frame of a spin kick is another pose, so that the joints keep changing cells.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
import warp as wp
from measure import (
    COPIED_BYTES,
    Contestant,
    Report,
    memory_bandwidth,
    milliseconds,
    read_options,
    side_by_side,
    times,
    undisturbed,
)
from outfit import SHELL, Outfit, dress, make_plan, write_database
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import Formulation, JointWrinkles, corner_nodes, find_cell
from wrinkle_synthesis.wrinkle_addon.method import LEAST_SPLIT, Evaluator
from wrinkle_synthesis.wrinkle_addon.rig import Pose, joint_angles
from wrinkle_synthesis.wrinkle_addon.threads import THREADS

VERTICES, FRAMES, PASSES = 46_500, 12, 8
MOST_TIMES_BANDWIDTH = {"cpu": 16.0, "cuda": 2.0}
VECTOR, WORD = 12, 4
"""Bytes of a position and of an index or a weight."""


def touched_bytes(method: JointWrinkles, pose: Pose) -> int:
    """Bytes that the default form must read and write in a pose, each once: skin, entries, corners' offsets, result."""
    header = method.header
    count = method.vertex_count
    used = int((header.garment.weights.weights > 0.0).sum())
    total = count * (VECTOR + WORD + VECTOR) + used * 2 * WORD
    angles = joint_angles(header.rig, header.joints, pose)
    for grid in header.plan.grids:
        name = grid.joint.name
        moved = np.zeros(count, bool)
        for sample, stored in method.samples.items():
            if sample.joint == name:
                moved[stored.vertices] = True
        entries = int((moved & (method.window(name) > 0.0)).sum())
        nodes = corner_nodes(find_cell(grid, angles[name]))
        corners = sum(weight > 0.0 and node != grid.rest for node, weight in nodes)
        total += entries * (3 * WORD + corners * VECTOR)
    return total


def synthesis(
    method: JointWrinkles, poses: list[Pose], device: str, strength: float = 1.0
) -> tuple[Evaluator, Callable[[int], None]]:
    """The method on the device, and an action that evaluates it in another pose each round."""
    evaluator = method.bind(device)
    out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device=device)

    def evaluate(number: int) -> None:
        evaluator.evaluate(poses[number], out, strength)
        wp.synchronize_device(device)

    return evaluator, evaluate


def without_launch(evaluator: Evaluator, evaluate: Callable[[int], None]) -> Callable[[int], None]:
    """The same action without its kernel: what NumPy does with the pose, and the uploads."""

    def prepare(number: int) -> None:
        with mock.patch.object(evaluator, "_launch", new=_nothing):
            evaluate(number)

    return prepare


def _nothing(*arguments: object) -> None:
    pass


def gpu_seconds(evaluator: Evaluator, pose: Pose, device: str, repeats: int = 200) -> float:
    """Time of one synthesis on a GPU, uploads included, recorded once and replayed without Python in between [s]."""
    out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device=device)
    evaluator.evaluate(pose, out)
    with wp.ScopedCapture(device=device) as capture:
        evaluator.evaluate(pose, out)
    start, end = (wp.Event(device=device, enable_timing=True) for _ in range(2))
    wp.record_event(start)
    for _ in range(repeats):
        wp.capture_launch(capture.graph)
    wp.record_event(end)
    return wp.get_event_elapsed_time(start, end) / repeats / 1e3


def numpy_skinning(outfit: Outfit, poses: list[Pose]) -> Callable[[int], None]:
    def skin(number: int) -> None:
        deformations = poses[number].deformations(outfit.rig)
        outfit.garment.weights.carry(deformations, outfit.garment.positions)

    return skin


def measure(outfit: Outfit, database: WrinkleDatabase, report: Report) -> None:
    options = report.options
    on_gpu = wp.get_device(options.device).is_cuda
    poses = outfit.poses()
    method = JointWrinkles(database)
    count = method.vertex_count
    threads = max(1, min(THREADS, count // LEAST_SPLIT))
    evaluator, whole = synthesis(method, poses, options.device)
    _, skinned = synthesis(method, poses, options.device, strength=0.0)
    _, paper = synthesis(JointWrinkles(database, Formulation.PAPER), poses, options.device)
    acts = {
        "copy": memory_bandwidth(options.device, threads),
        "whole": whole,
        "skinning": skinned,
        "pose": without_launch(evaluator, whole),
        "paper": paper,
        "numpy": numpy_skinning(outfit, poses),
    }
    frames = np.linspace(0, len(poses) - 1, 2 if options.quick else FRAMES).astype(int).tolist()
    passes = 1 if options.quick else PASSES
    seconds = side_by_side({name: Contestant(act) for name, act in acts.items()}, frames, passes)
    time = {name: undisturbed(values) for name, values in seconds.items()}
    bandwidth = 2 * COPIED_BYTES / float(seconds["copy"].min())
    touched = float(np.mean([touched_bytes(method, poses[frame]) for frame in frames]))
    limit = touched / bandwidth
    parts = {
        "pose in NumPy": time["pose"],
        "skinning": time["skinning"] - time["pose"],
        "interpolation and blending": time["whole"] - time["skinning"],
        "whole synthesis": time["whole"],
        "the paper's form": time["paper"],
        "skinning alone in NumPy": time["numpy"],
    }
    if on_gpu:
        parts["whole synthesis, replayed graph"] = gpu_seconds(evaluator, poses[len(poses) // 2], options.device)
    judged = parts["whole synthesis, replayed graph" if on_gpu else "whole synthesis"]
    rows = [["", "time", "of the limit", "of the whole"]]
    rows += [
        [name, milliseconds(value), times(value / limit), times(value / time["whole"])] for name, value in parts.items()
    ]
    report.table(
        f"{count} vertices, {len(outfit.joints)} joints, {len(method.samples)} samples, {threads} threads; "
        f"limit: {touched / 1e6:.1f} MB at {bandwidth / 1e9:.1f} GB/s, {milliseconds(limit)}",
        rows,
    )
    kind = "cuda" if on_gpu else "cpu"
    report.target("whole synthesis over the limit", judged / limit, MOST_TIMES_BANDWIDTH[kind], at_least=False)
    report.line(f"  share of the GPU's bandwidth: {limit / judged:.0%}" if on_gpu else "  no GPU was measured")
    report.figures |= {
        "vertices": count,
        "joints": len(outfit.joints),
        "samples": len(method.samples),
        "threads": threads,
        "touched_megabytes": touched / 1e6,
        "bandwidth_gigabytes_per_second": bandwidth / 1e9,
        "limit_ms": 1e3 * limit,
        "ms": 1e3 * judged,
        "pose_ms": 1e3 * parts["pose in NumPy"],
        "skinning_ms": 1e3 * parts["skinning"],
        "blending_ms": 1e3 * parts["interpolation and blending"],
        "paper_ms": 1e3 * time["paper"],
        "numpy_skinning_ms": 1e3 * time["numpy"],
        "ratio_to_bandwidth": judged / limit,
        "paper_ratio_to_bandwidth": time["paper"] / limit,
    }


def main() -> None:
    report = Report("synthesis", read_options(__doc__))
    quick = report.options.quick
    outfit = dress([SHELL], 0) if quick else dress(["shirt", "trousers"], VERTICES)
    with tempfile.TemporaryDirectory() as folder:
        plan = make_plan(outfit.joints, quick=quick)
        database = write_database(outfit.rig, outfit.garment, outfit.body, plan, Path(folder) / "outfit.wrinkles")
        measure(outfit, database, report)
    report.finish()


if __name__ == "__main__":
    main()
