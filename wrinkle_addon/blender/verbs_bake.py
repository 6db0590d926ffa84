"""The verbs plan and bake."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import bpy

from ..attendance import Attendance
from ..bake import BakeEvent, BakeJob, SimulatedSamples, finish
from ..bake import bake as bake_samples
from ..database import MANIFEST, read_manifest
from ..folder_verbs import choose_device
from ..plan import duration_text
from ..self_overlap import describe_left_out
from .bake_workers import run_workers
from .character import sampling_stage
from .command import own_command
from .files import check_output, save_character
from .setup import stage_job
from .verb_options import find_database, find_garment, open_file, say
from .verbs_setup import choose_plan

BATCH_ON_GPU = 16
"""Samples that are simulated side by side on a GPU, which one of them leaves idle; an estimate, see docs/solver.md."""


def plan(options: argparse.Namespace) -> Mapping[str, Any]:
    """What a bake would make and cost; with another plan than the garment's own, if one is asked for."""
    if options.out is not None:
        check_output(options.out, ".blend")
    open_file(options)
    garment = find_garment(options)
    choose_plan(garment.wrinkles, options)
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        job = stage_job(garment, stage)
    if options.out is not None:
        save_character(options.out)
    sample_plan, vertices = job.plan, job.garment.vertex_count
    seconds = sample_plan.seconds(vertices)
    joints = {
        grid.joint.name: {
            "samples": math.prod(grid.shape) - 1,
            "grid": list(grid.shape),
            "angles_deg": [[round(math.degrees(a), 2) for a in values] for values in grid.angles],
        }
        for grid in sample_plan.grids
    }
    stored = sample_plan.stored_bytes(vertices)
    text = [f"{name}: {' x '.join(map(str, joint['grid']))}" for name, joint in joints.items()]
    text.append(
        f"{len(sample_plan.samples) + 1} samples, {len(sample_plan.simulated) + 1} to simulate, "
        f"about {stored / 1e6:.3g} MB and {duration_text(seconds)} on one core"
    )
    text += filter(None, [describe_left_out(sample_plan)])
    return {
        "samples": len(sample_plan.samples) + 1,
        "simulated": len(sample_plan.simulated) + 1,
        "left_out": sorted(sample.name for sample in sample_plan.left_out),
        "vertices": vertices,
        "joints": joints,
        "raw_bytes": sample_plan.raw_bytes(vertices),
        "stored_bytes": stored,
        "hours": seconds / 3600.0,
        "symmetric": sample_plan.mirror is not None,
        "key": job.key,
        "text": "\n".join(text),
    }


def bake(options: argparse.Namespace) -> Mapping[str, Any]:
    device = choose_device(options.device)
    shard = _shard(options.shard)
    open_file(options)
    garment = find_garment(options)
    folder = find_database(options, garment)
    report = _reporter(options.progress)
    if options.attended:
        report = _attended(report, options.attendance)
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        job = stage_job(garment, stage)
        _check_folder(folder, job)
        source = SimulatedSamples(job, stage, folder, device, _batch(options.batch, device))
        shared = options.workers > 1 and shard == (0, 1) and len(job.plan.simulated) >= options.workers
        # All workers start from the same rest pose.
        for event in bake_samples(job, source, folder, shard=shard, rest_only=shared):
            report(event)
    if shared:
        _share(options, garment, folder, report)
    complete = finish(job, folder)
    text = f"{folder} is complete." if complete else f"This part of {folder} is baked; other shards are not."
    return {
        "database": str(folder),
        "key": job.key,
        "samples": len(job.plan.samples) + 1,
        "left_out": sorted(sample.name for sample in job.plan.left_out),
        "complete": complete,
        "text": " ".join(filter(None, [text, describe_left_out(job.plan)])),
    }


def _check_folder(folder: Path, job: BakeJob) -> None:
    """Refuse to bake over the database of another garment.

    Raises:
        ValueError: One sentence with both garments' names.
    """
    if not (folder / MANIFEST).exists():
        return
    manifest = read_manifest(folder)
    owner = manifest.get("garment", {}).get("name")
    if manifest.get("key") != job.key and owner != job.garment.name:
        raise ValueError(
            f"The folder '{folder}' holds the database of the garment '{owner}'; "
            f"choose another folder for '{job.garment.name}'."
        )


def _shard(text: str | None) -> tuple[int, int]:
    if text is None:
        return 0, 1
    try:
        number, count = (int(part) for part in text.split("/"))
    except ValueError:
        raise ValueError(f"A shard is given as I/N, such as 0/4, not '{text}'.") from None
    if not 0 <= number < count:
        raise ValueError(f"There is no shard '{text}'; of N shards, I goes from 0 to N-1.")
    return number, count


def _batch(count: int | None, device: str) -> int:
    """How many samples are simulated side by side: a CPU takes as long for each of them as for one alone."""
    if count is not None:
        return count
    return BATCH_ON_GPU if device.startswith("cuda") else 1


def _reporter(kind: str) -> Callable[[BakeEvent], None]:
    def as_json(event: BakeEvent) -> None:
        remaining = None if math.isnan(event.remaining) else round(event.remaining, 1)
        data = {
            "event": "sample",
            "name": event.name,
            "done": event.done,
            "total": event.total,
            "seconds": round(event.seconds, 2),
            "remaining": remaining,
            "report": dict(event.report),
        }
        print(json.dumps(data), file=sys.stderr, flush=True)

    def as_text(event: BakeEvent) -> None:
        left = "" if math.isnan(event.remaining) else f", {event.remaining / 60:.1f} min left"
        residual = event.report.get("residual")
        note = f", residual {residual:.2g}" if residual is not None else ""
        note += f", not at rest near {event.report['restless']}" if "restless" in event.report else ""
        say(f"[{event.done}/{event.total}] {event.name}: {event.seconds:.1f} s{note}{left}")

    return as_json if kind == "json" else as_text


def _attended(report: Callable[[BakeEvent], None], attendance: Attendance) -> Callable[[BakeEvent], None]:
    """Report, and wait with the next sample if told to."""

    def report_and_wait(event: BakeEvent) -> None:
        report(event)
        attendance.wait()

    return report_and_wait


def _share(
    options: argparse.Namespace, garment: bpy.types.Object, folder: Path, report: Callable[[BakeEvent], None]
) -> None:
    """Bake in several processes, one shard each."""
    file = str(options.file or bpy.data.filepath)
    batch = () if options.batch is None else ("--batch", str(options.batch))
    run_workers(
        [
            own_command(
                "bake", file, "--garment", garment.name, "--database", str(folder), "--device", options.device,
                "--shard", f"{number}/{options.workers}", *batch, "--progress", "json",
            )
            for number in range(options.workers)
        ],
        report,
    )  # fmt: skip
