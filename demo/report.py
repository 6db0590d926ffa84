"""The demo's report: one JSON object with all that was measured, and the same for people."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def describe_machine(doctor: Mapping[str, Any]) -> dict[str, Any]:
    """Processor, cores, and what `wrinkle doctor` says."""
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "device": doctor["device"],
        "versions": dict(doctor["versions"]),
    }


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def write_report(folder: Path, report: Mapping[str, Any]) -> tuple[Path, Path]:
    """Write report.json and report.md into a folder; returns their paths."""
    as_json, as_text = folder / "report.json", folder / "report.md"
    as_json.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    as_text.write_text(to_markdown(report), encoding="utf-8")
    return as_json, as_text


def to_markdown(report: Mapping[str, Any]) -> str:
    """The report as a page of Markdown."""
    parts = [
        _head(report),
        *(_evaluation(title, report[name]) for name, title in REFERENCES),
        _bake(report),
        _times(report),
    ]
    return "\n\n".join(parts) + "\n"


REFERENCES = (
    ("settle", "Against the equilibrium at each frame's pose"),
    ("simulate", "Against the full dynamic simulation"),
)


def _head(report: Mapping[str, Any]) -> str:
    setup, machine = report["setup"], report["machine"]
    return "\n".join(
        [
            "# What the demo measured",
            "",
            "![Skinning alone, synthesis and full simulation](side_by_side.png)",
            "",
            f"A {report['recipe']['garment']} of {setup['vertices']:,} vertices, the motion-capture clip "
            f"*{report['recipe']['clip']}* of {report['frames']} frames, on {machine['processor']} "
            f"({machine['cores']} cores, device {machine['device']}). In the pictures skin under the cloth is "
            "left out, in all columns alike.",
        ]
    )


def _evaluation(title: str, result: Mapping[str, Any]) -> str:
    names = list(result["rmse_mm"])
    rows = [("whole garment", result), *result["regions"].items()]
    lines = [
        f"## {title}",
        "",
        f"RMS error in mm over {result['frame_count']} frames (largest error of any vertex in brackets).",
        "",
        _table(
            ["region", *names],
            [
                [region, *(f"{found['rmse_mm'][name]:.2f} ({found['max_mm'][name]:.0f})" for name in names)]
                for region, found in rows
            ],
        ),
        "",
        f"- Error of ours as a share of skinning's: {result['rmse_mm']['ours'] / result['rmse_mm']['skinning']:.2f}.",
        f"- Sum of curvature, ours to the reference's: {result['curvature_ratio']:.3f}"
        + _and(", correlation over the clip {:.2f}", result["curvature_correlation"])
        + ".",
    ]
    if result["inside_share"] is not None:
        lines.append(
            f"- Vertices of ours inside the body by more than 1 mm: {100 * result['inside_share']:.2f} %, of these "
            f"{100 * result['inside_overlap_share']:.2f} % where the body cuts into itself, "
            f"the deepest {result['deepest_mm']:.1f} mm."
        )
    if result["acceleration_ratio"] is not None:
        lines.append(f"- Mean acceleration, ours to the reference's: {result['acceleration_ratio']:.2f}.")
    if result["reference"]:
        said = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in result["reference"].items())
        lines.append(f"- The reference itself, at worst: {said}.")
    return "\n".join(lines)


def _and(text: str, value: float | None) -> str:
    return "" if value is None else text.format(value)


def _bake(report: Mapping[str, Any]) -> str:
    plan, info = report["plan"], report["database"]
    grids = [
        [name, " x ".join(map(str, joint["grid"])), "; ".join(_range(angles) for angles in joint["angles_deg"])]
        for name, joint in plan["joints"].items()
    ]
    return "\n".join(
        [
            "## The database",
            "",
            _table(["joint", "grid", "degrees from rest"], grids),
            "",
            f"- {info['samples']} shapes with the rest pose, {plan['simulated']} of them simulated"
            + (", the others mirrored." if plan["symmetric"] else ".")
            + _left_out(info["left_out"]),
            f"- {info['sample_bytes'] / 1e6:.1f} MB of samples, {info['raw_bytes'] / 1e6:.1f} MB as raw positions "
            f"({info['times_smaller_than_raw']} times smaller); {info['bytes'] / 1e6:.1f} MB in all.",
            f"- Worst residual {info['worst_residual']} nodal weights; "
            f"{info['unconverged']} samples missed their tolerance.",
            f"- Worst sample: {info['inside']} vertices more than 1 mm inside the body, {info['self_intersections']} "
            "pairs of triangles that intersect, not counting where the body cuts into itself.",
        ]
    )


def _left_out(names: Sequence[str]) -> str:
    return f" In {len(names)} limbs pass through each other; they have the wrinkles of another one." if names else ""


def _range(angles: Sequence[float]) -> str:
    return f"{angles[0]:.0f} to {angles[-1]:.0f}"


def _times(report: Mapping[str, Any]) -> str:
    rows = [[stage, *(f"{spent[kind]:.0f}" for kind in TIMES)] for stage, spent in report["times"].items()]
    rows.append(["in all", *(f"{sum(spent[kind] for spent in report['times'].values()):.0f}" for kind in TIMES)])
    return "\n".join(["## Times", "", _table(["stage", *TIMES.values()], rows)])


TIMES = {"seconds": "seconds", "processor_seconds": "processor seconds"}


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
