"""Every benchmark runs, at a tiny size, and writes its figures; what they come to is not a test's business."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
from wrinkle_synthesis.demo import packages

FOLDER = Path(__file__).parents[2] / "benchmarks"
FIGURES = {
    "synthesis": ("ms", "ratio_to_bandwidth"),
    "frame": ("fps",),
    "peers": ("times_faster_than_cloth", "ratio_to_shape_keys"),
    "sample": ("seconds",),
    "coarse": ("frame_ms", "times_faster_than_fine", "times_faster_than_blender_cloth"),
    "flow": ("times_smaller_than_pc2", "rmse_mm", "frame_ms"),
    "table": ("fps", "frame_ms"),
    "solvers": ("settled_seconds", "stepped_times_ours", "blender_times_ours", "blender_level_mm"),
}


def test_every_benchmark_runs_and_writes_its_figures(tmp_path: Path) -> None:
    pytest.importorskip("bpy")
    if not (packages.is_cached(packages.BODY) and packages.is_cached(packages.MOTION)):
        pytest.skip("The demo's packages are not in the cache.")
    running = {}
    # Side by side, because most of the time is Blender starting.
    for name in FIGURES:
        command = [
            sys.executable,
            str(FOLDER / f"bench_{name}.py"),
            "--quick",
            "--json",
            str(tmp_path / f"{name}.json"),
        ]
        running[name] = subprocess.Popen(
            [*command, "--device", "cpu"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
    for name, process in running.items():
        _, errors = process.communicate()
        assert process.returncode == 0, errors
        figures = json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
        assert figures["name"] == name
        assert figures["quick"]
        for figure in FIGURES[name]:
            assert math.isfinite(figures[figure])
            assert figures[figure] > 0.0
