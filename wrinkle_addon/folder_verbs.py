"""Verbs that need no scene: what lies in a database folder."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import warp as wp

from . import storage
from .database import (
    MANIFEST,
    DatabaseHeader,
    WrinkleDatabase,
    expected_files,
    find_problems,
    read_manifest,
    sample_path,
    write_manifest,
)
from .storage import StorageError


def merge(options: argparse.Namespace) -> Mapping[str, Any]:
    """Write the manifest over samples from any number of shards."""
    folder = _folder(options)
    header = _unfinished(folder)
    write_manifest(folder, header)
    count = len(header.plan.samples) + 1
    return {"samples": count, "key": header.key, "text": f"{count} samples merged in {folder}."}


def verify(options: argparse.Namespace) -> Mapping[str, Any]:
    """Compare every file with its hash; what is missing or damaged is the work still to do."""
    folder = _folder(options)
    if (folder / MANIFEST).exists():
        problems = find_problems(folder, read_manifest(folder))
    else:
        header = _unfinished(folder)
        missing = [path for path in expected_files(folder, header.key, header.plan) if not path.exists()]
        problems = [f"{path.name} is missing" for path in missing]
    if not problems:
        WrinkleDatabase.open(folder)
    text = "\n".join(problems) if problems else f"{folder} is complete and undamaged."
    return {"ok": not problems, "problems": problems, "text": text, "exit_code": 1 if problems else 0}


def info(options: argparse.Namespace) -> Mapping[str, Any]:
    """What a database holds, what it weighs, and how its samples came out."""
    database = WrinkleDatabase.open(_folder(options))
    header = database.header
    named = [(sample.name, stored.report) for sample, stored in database.samples()]
    reports = [report for _, report in named]
    stored = sum(sample_path(database.folder, header.key, sample).stat().st_size for sample in header.plan.samples)
    raw = header.plan.raw_bytes(header.garment.vertex_count)
    joints = {grid.joint.name: list(grid.shape) for grid in header.plan.grids}
    residuals = [report["residual"] for report in reports if "residual" in report]
    result = {
        "garment": header.garment.name,
        "vertices": header.garment.vertex_count,
        "samples": len(header.plan.samples) + 1,
        "joints": joints,
        "bytes": database.stored_bytes,
        "sample_bytes": stored,
        "raw_bytes": raw,
        "times_smaller_than_raw": round(raw / max(stored, 1), 2),
        "worst_residual": max(residuals, default=None),
        "unconverged": sum(not report.get("converged", True) for report in reports),
        "restless": {
            name: report["restless"] for name, report in named if "restless" in report and "mirrored" not in report
        },
        "inside": max((report.get("inside", 0) for report in reports), default=0),
        "left_out": [name for name, report in named if "stand_in" in report],
        "corrected": [name for name, report in named if "corrected" in report],
        "self_intersections": max((report.get("self_intersections", 0) for report in reports), default=0),
    }
    lines = [
        f"{result['garment']}: {result['vertices']} vertices, {result['samples']} samples",
        *(f"  {name}: {' x '.join(map(str, shape))}" for name, shape in joints.items()),
        f"  {stored / 1e6:.3g} MB of samples, {raw / 1e6:.3g} MB as raw positions "
        f"({result['times_smaller_than_raw']} times smaller)",
    ]
    if result["left_out"]:
        count = len(result["left_out"])
        lines.append(f"  {count} have another sample's wrinkles, as limbs pass through each other in their poses")
    if result["corrected"]:
        lines.append(f"  corrected by hand: {', '.join(result['corrected'])}")
    if result["unconverged"]:
        lines.append(
            f"  {result['unconverged']} samples did not come to rest; "
            f"the worst is {result['worst_residual']:.2g} nodal weights from equilibrium"
        )
        lines += [f"    {name}, near {place}" for name, place in result["restless"].items()]
    return {**result, "text": "\n".join(lines)}


def choose_device(name: str) -> str:
    """The Warp device of a name; "auto" is the first GPU, else the CPU.

    Raises:
        ValueError: If there is no such device; one sentence that lists those there are.
    """
    if name == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    known = [str(device) for device in wp.get_devices()]
    if name not in known:
        raise ValueError(f"There is no device '{name}' here; there is {', '.join(known)}.")
    return name


def _folder(options: argparse.Namespace) -> Path:
    folder = options.folder or options.database
    if folder is None:
        raise ValueError("Name the database folder.")
    if not folder.is_dir():
        raise StorageError(f"There is no database '{folder}'.")
    return folder


def _unfinished(folder: Path) -> DatabaseHeader:
    """The header of a database whose manifest is still to be written; of the finished one, if there is no other."""
    keys = {path.stem.removeprefix("header-") for path in folder.glob(f"header-*{storage.ARRAY_SUFFIX}")}
    if len(keys) > 1 and (folder / MANIFEST).exists():
        keys.discard(read_manifest(folder).get("key", ""))
    if not keys:
        raise StorageError(f"'{folder}' holds no bake; run the bake first.")
    if len(keys) > 1:
        raise StorageError(
            f"'{folder}' holds {len(keys)} different bakes; keep the files of one key and remove the others."
        )
    return DatabaseHeader.read(folder, keys.pop())
