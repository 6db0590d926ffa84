"""The verbs that open a scene, behind both doors of the command line."""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..bake import BakeEvent, BakeJob, SimulatedSamples, Wearer, bake, finish
from ..database import WrinkleDatabase
from ..evaluate import EvaluatedFrame, evaluate
from ..folder_verbs import choose_device
from ..joint_wrinkles import Formulation, JointWrinkles
from ..joints import joints_to_json, ranges_from_poses
from ..pc2 import PointCache, write_pc2
from ..reference import SettledReference, SimulationSettings, simulate_clip
from ..rig import FloatArray, Pose
from . import handlers
from .character import SamplingStage, apply, sampling_stage
from .clip import ClipFrame, parse_frames, read_clip
from .files import open_character
from .rig_files import animate_file, joints_of_file
from .setup import setup_garment, stage_job


def run(name: str, options: argparse.Namespace) -> Mapping[str, Any]:
    """Run a verb by name, with our properties known to Blender and no playing while it works."""
    _ensure_registered()
    with handlers.suspended():
        return VERBS[name](options)


def _ensure_registered() -> None:
    """Inside Blender the add-on is enabled; under the plain module its properties are registered here."""
    if not hasattr(bpy.types.Object, "wrinkles"):
        from ... import register

        register()


def _open(options: argparse.Namespace) -> None:
    """Open the file that is named, or go on with the one that Blender opened.

    Raises:
        ValueError: If there is no file; Blender itself runs commands without one.
    """
    if options.file is not None:
        if not options.file.is_file():
            raise ValueError(f"There is no file '{options.file}'.")
        if Path(bpy.data.filepath or ".").resolve() != options.file.resolve():
            open_character(options.file)
    elif not bpy.data.filepath:
        raise ValueError("No file is open; name a .blend file that exists.")


def _object(name: str, kind: str) -> bpy.types.Object:
    ob = bpy.data.objects.get(name)
    if ob is None:
        meshes = ", ".join(sorted(other.name for other in bpy.data.objects if other.type == "MESH")) or "none"
        raise ValueError(f"The file has no {kind} '{name}'; its meshes are: {meshes}.")
    return ob


def _garment(options: argparse.Namespace) -> bpy.types.Object:
    """The garment that is named, or its fine copy, or the only one in the file that was set up."""
    ready = [ob for ob in bpy.data.objects if ob.type == "MESH" and ob.wrinkles.armature]
    names = ", ".join(ob.name for ob in ready)
    if options.garment is None:
        if len(ready) == 1:
            return ready[0]
        if not ready:
            raise ValueError("No garment in the file was set up; run setup first.")
        raise ValueError(f"Several garments were set up, {names}; name one with --garment.")
    for ob in ready:
        if ob.name == options.garment or (ob.wrinkles.original and ob.wrinkles.original.name == options.garment):
            return ob
    _object(options.garment, "garment")
    raise ValueError(f"The garment '{options.garment}' was not set up; run setup first.")


def _database_folder(options: argparse.Namespace, garment: bpy.types.Object) -> Path:
    if options.database is not None:
        return options.database
    return Path(bpy.path.abspath(garment.wrinkles.database))


def _frames(options: argparse.Namespace) -> list[int]:
    scene = bpy.context.scene
    return parse_frames(options.frames or f"{scene.frame_start}:{scene.frame_end}")


def _check_folder(path: Path) -> None:
    if not path.resolve().parent.is_dir():
        raise ValueError(f"There is no folder '{path.resolve().parent}' to write '{path.name}' in.")


def _save(path: Path) -> None:
    if path.suffix.lower() != ".blend":
        raise ValueError(f"The result is saved as a .blend file, not as '{path.name}'.")
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()))
    except RuntimeError as error:
        raise ValueError(f"'{path.name}' could not be saved: {' '.join(str(error).split())}") from error


def say(text: str) -> None:
    """Progress, for people."""
    print(text, file=sys.stderr, flush=True)


# --- setting up ---------------------------------------------------------------------------------------------------


def setup(options: argparse.Namespace) -> Mapping[str, Any]:
    _open(options)
    _check_folder(options.out)
    armature = _object(options.armature, "armature") if options.armature else None
    body = _object(options.body, "body")
    result = setup_garment(_object(options.garment, "garment"), body, armature, options.subdivide)
    settings = result.garment.wrinkles
    if options.ease:
        settings.ease_girth, settings.ease_length = _pair(options.ease)
    if options.pins is not None:
        settings.pin_group = options.pins
    if options.joints:
        _choose_joints(settings, options.joints.split(","))
    if options.ranges:
        take_ranges(result.garment, parse_frames(options.ranges), math.radians(options.margin))
    if options.samples or options.quick:
        settings.plan, settings.budget = "BUDGET", options.samples or 36
    with sampling_stage(settings.armature, settings.body) as stage:
        job = stage_job(result.garment, stage)
    _save(options.out)
    joints = joints_to_json(result.search)
    text = [f"{result.garment.name}: {job.garment.vertex_count} vertices, {len(job.plan.samples) + 1} samples"]
    text += [f"  {grid.joint.name}: {', '.join(grid.joint.bones)}" for grid in job.plan.grids]
    text += [f"  {name} was not found: {why.reason}" for name, why in result.search.missing.items()]
    text += list(result.search.notes)
    return {
        "garment": result.garment.name,
        "vertices": job.garment.vertex_count,
        "joints": joints,
        "sampled": [grid.joint.name for grid in job.plan.grids],
        "symmetric": job.plan.mirror is not None,
        "file": str(options.out),
        "text": "\n".join(text),
    }


def _pair(text: str) -> tuple[float, float]:
    try:
        girth, length = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"Ease is given as GIRTH,LENGTH in percent, not '{text}'.") from None
    return girth, length


def _choose_joints(settings: Any, names: Sequence[str]) -> None:
    known = [joint.name for joint in settings.joints]
    for name in names:
        if name not in known:
            raise ValueError(f"The garment has no joint '{name}'; it has {', '.join(known)}.")
    for joint in settings.joints:
        joint.enabled = joint.name in names


def take_ranges(garment: bpy.types.Object, frames: Sequence[float], margin: float) -> None:
    """Set the joints' ranges to what some frames of the animation use, plus a margin [rad]."""
    settings = garment.wrinkles
    with sampling_stage(settings.armature, settings.body) as stage:
        rig = stage.rig
    poses = [clip.pose for clip in read_clip(garment, rig, frames)]
    joints = ranges_from_poses(rig, [stored.joint() for stored in settings.joints], poses, margin)
    for stored, joint in zip(settings.joints, joints, strict=True):
        stored.store(joint)


def joints(options: argparse.Namespace) -> Mapping[str, Any]:
    if options.file is None and not bpy.data.filepath:
        raise ValueError("No file is open; name a .blend, .glb, .fbx or .bvh file that exists.")
    found = joints_of_file(options.file or bpy.data.filepath, options.armature)
    return {**found, "text": json.dumps(found, indent=1)} if not options.json else found


def animate(options: argparse.Namespace) -> Mapping[str, Any]:
    if options.file is None and not bpy.data.filepath:
        raise ValueError("No file is open; name a .blend file that exists.")
    result = animate_file(options.file or bpy.data.filepath, options.armature, options.motion, options.out)
    text = f"{result['armature']}: {result['frames']} frames at {result['fps']:g} fps"
    return {**result, "text": "\n".join([text, *result["notes"]])}  # type: ignore[misc]


# --- looking ahead ------------------------------------------------------------------------------------------------


def check(options: argparse.Namespace) -> Mapping[str, Any]:
    """Everything that would stop a bake or playing, found by going through the motions without simulating."""
    _open(options)
    problems, notes = [], []
    garment = _garment(options)
    settings = garment.wrinkles
    try:
        with sampling_stage(settings.armature, settings.body) as stage:
            job = stage_job(garment, stage)
            _check_extremes(stage, job)
            notes.append(f"{len(job.plan.samples) + 1} samples of {job.garment.vertex_count} vertices would be baked.")
        folder = _database_folder(options, garment)
        if (folder / "manifest.json").exists():
            key = WrinkleDatabase.open(folder, check_hashes=True).header.key
            if key != job.key:
                notes.append(f"The database '{folder}' was baked with other settings, rig, body or garment.")
        else:
            notes.append(f"The database '{folder}' is not baked yet.")
    except ValueError as error:
        problems.append(str(error))
    text = "\n".join([*problems, *notes]) or "Nothing to complain about."
    return {"ok": not problems, "problems": problems, "notes": notes, "text": text, "exit_code": 2 if problems else 0}


def _check_extremes(stage: SamplingStage, job: BakeJob) -> None:
    """Pose the body at the end of every range."""
    for sample in job.plan.samples:
        grid = job.plan.grid[sample.joint]
        if all(i in (0, n - 1) for i, n in zip(sample.index, grid.shape, strict=True)):
            if not np.isfinite(stage.positions(job.pose(sample))).all():
                raise ValueError(f"The body falls apart when joint {sample.joint} is turned to the end of its range.")


SECONDS_PER_VERTEX = 6.0e-4
"""Measured time of one sample a vertex on one CPU core, for a step of 30 degrees [s]; see benchmarks/sample.py."""


def plan(options: argparse.Namespace) -> Mapping[str, Any]:
    _open(options)
    garment = _garment(options)
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        job = stage_job(garment, stage)
    sample_plan, vertices = job.plan, job.garment.vertex_count
    seconds = SECONDS_PER_VERTEX * vertices * (len(sample_plan.simulated) + 1)
    joints = {
        grid.joint.name: {
            "samples": math.prod(grid.shape) - 1,
            "grid": list(grid.shape),
            "angles_deg": [[round(math.degrees(a), 2) for a in values] for values in grid.angles],
        }
        for grid in sample_plan.grids
    }
    raw = sample_plan.raw_bytes(vertices)
    text = [f"{name}: {' x '.join(map(str, joint['grid']))}" for name, joint in joints.items()]
    text.append(
        f"{len(sample_plan.samples) + 1} samples, {len(sample_plan.simulated) + 1} to simulate, "
        f"at most {raw / 1e6:.0f} MB, about {seconds / 3600:.1f} hours on one core"
    )
    return {
        "samples": len(sample_plan.samples) + 1,
        "simulated": len(sample_plan.simulated) + 1,
        "vertices": vertices,
        "joints": joints,
        "raw_bytes": raw,
        "hours": seconds / 3600.0,
        "symmetric": sample_plan.mirror is not None,
        "key": job.key,
        "text": "\n".join(text),
    }


# --- baking -------------------------------------------------------------------------------------------------------


def bake_verb(options: argparse.Namespace) -> Mapping[str, Any]:
    _open(options)
    device = choose_device(options.device)
    garment = _garment(options)
    folder = _database_folder(options, garment)
    shard = _shard(options.shard)
    report = _reporter(options.progress)
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        job = stage_job(garment, stage)
        source = SimulatedSamples(job, stage, folder, device)
        if options.workers > 1 and shard == (0, 1) and len(job.plan.simulated) >= options.workers:
            # The first step of a bake with no shard at all is the rest pose, which every worker needs.
            for event in bake(job, source, folder, shard=(0, 1), rest_only=True):
                report(event)
            _run_workers(options, garment, folder, report)
        else:
            for event in bake(job, source, folder, shard=shard):
                report(event)
        complete = finish(job, folder)
    if options.progress == "json":
        print(json.dumps({"event": "finished", "complete": complete}), file=sys.stderr, flush=True)
    return {
        "database": str(folder),
        "key": job.key,
        "samples": len(job.plan.samples) + 1,
        "complete": complete,
        "text": f"{folder} is complete." if complete else f"This part of {folder} is baked; other shards are not.",
    }


def _shard(text: str | None) -> tuple[int, int]:
    if text is None:
        return 0, 1
    try:
        number, count = (int(part) for part in text.split("/"))
    except ValueError:
        raise ValueError(f"A shard is given as I/N, such as 0/4, not '{text}'.") from None
    return number, count


def _reporter(kind: str) -> Callable[[BakeEvent], None]:
    def as_json(event: BakeEvent) -> None:
        data = {"event": "sample", "name": event.name, "done": event.done, "total": event.total}
        remaining = None if math.isnan(event.remaining) else round(event.remaining, 1)
        print(json.dumps({**data, "seconds": round(event.seconds, 2), "remaining": remaining, "report": dict(event.report)}),
              file=sys.stderr, flush=True)  # fmt: skip

    def as_text(event: BakeEvent) -> None:
        left = "" if math.isnan(event.remaining) else f", {event.remaining / 60:.1f} min left"
        residual = event.report.get("residual")
        note = f", residual {residual:.2g}" if residual is not None else ""
        say(f"[{event.done}/{event.total}] {event.name}: {event.seconds:.1f} s{note}{left}")

    return as_json if kind == "json" else as_text


def own_command(*arguments: str) -> list[str]:
    """The command line that runs a verb in another process, through the door that this one came through."""
    if bpy.app.binary_path and Path(bpy.app.binary_path).stem.lower().startswith("blender"):
        return [bpy.app.binary_path, "--background", *arguments[1:2], "--command", "wrinkle", *arguments]
    return [sys.executable, "-m", f"{__package__.rsplit('.', 1)[0]}.cli", *arguments]


def _run_workers(
    options: argparse.Namespace, garment: bpy.types.Object, folder: Path, report: Callable[[BakeEvent], None]
) -> None:
    """Bake in several processes, one shard each.

    Raises:
        ValueError: With the first worker's own sentence, if one fails.
    """
    file = str(options.file or bpy.data.filepath)
    workers = [
        subprocess.Popen(
            own_command(
                "bake", file, "--garment", garment.name, "--database", str(folder), "--device", options.device,
                "--shard", f"{number}/{options.workers}", "--progress", "json",
            ),
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )
        for number in range(options.workers)
    ]  # fmt: skip
    try:
        totals = _merge_progress(workers, report)
    except BaseException:
        for worker in workers:
            worker.terminate()
        raise
    finally:
        for worker in workers:
            worker.wait()
    failed = next((message for message in totals if message), None)
    if failed:
        raise ValueError(failed)


def _merge_progress(workers: list[subprocess.Popen[str]], report: Callable[[BakeEvent], None]) -> list[str]:
    """Show the workers' events as one; returns each one's error sentence, or nothing."""
    import queue
    import threading

    lines: queue.Queue[tuple[int, str | None]] = queue.Queue()

    def pump(number: int, worker: subprocess.Popen[str]) -> None:
        assert worker.stderr is not None
        for line in worker.stderr:
            lines.put((number, line))
        lines.put((number, None))

    for number, worker in enumerate(workers):
        threading.Thread(target=pump, args=(number, worker), daemon=True).start()
    done, total, remaining = [0] * len(workers), [0] * len(workers), [math.nan] * len(workers)
    errors = [""] * len(workers)
    open_count = len(workers)
    while open_count:
        number, line = lines.get()
        if line is None:
            open_count -= 1
            code = workers[number].wait()
            if code and not errors[number]:
                errors[number] = f"A baking process ended with code {code}; run the bake again, it goes on where it stopped."
            continue
        if not line.startswith("{"):
            continue
        event = json.loads(line)
        if event["event"] == "error":
            errors[number] = event["message"]
        elif event["event"] == "sample":
            done[number], total[number] = event["done"], event["total"]
            remaining[number] = math.nan if event["remaining"] is None else event["remaining"]
            left = np.nanmax(remaining) if not np.isnan(remaining).all() else math.nan
            report(BakeEvent(event["name"], sum(done), sum(total), event["seconds"], float(left), event["report"]))
    return errors


# --- playing and measuring ----------------------------------------------------------------------------------------


def synthesize(options: argparse.Namespace) -> Mapping[str, Any]:
    _open(options)
    _check_folder(options.out)
    device = choose_device(options.device)
    garment, frames = _garment(options), _frames(options)
    settings = garment.wrinkles
    database = WrinkleDatabase.open(_database_folder(options, garment))
    _check_same_garment(garment, database)
    formulation = Formulation(options.formulation) if options.formulation else Formulation[settings.formulation]
    evaluator = JointWrinkles(database, formulation).bind(device)
    clamped: dict[str, float] = {}

    def positions() -> Iterator[FloatArray]:
        for clip in read_clip(garment, database.header.rig, frames):
            # Strengths may be animated.
            found = evaluator.positions(clip.pose, settings.strengths())
            for name, beyond in evaluator.clamped.items():
                clamped[name] = max(clamped.get(name, 0.0), math.degrees(float(np.abs(beyond).max())))
            yield apply(clip.rig_to_garment, found.astype(np.float64)).astype(np.float32)

    write_pc2(options.out, database.header.garment.vertex_count, frames[0], positions(), len(frames))
    text = [f"{len(frames)} frames written to {options.out}."]
    text += [f"{name} goes {angle:.0f} degrees beyond its samples." for name, angle in clamped.items()]
    return {"frames": len(frames), "cache": str(options.out), "clamped_deg": clamped, "text": "\n".join(text)}


def _check_same_garment(garment: bpy.types.Object, database: WrinkleDatabase) -> None:
    """Refuse a database of another mesh."""
    count = len(garment.data.vertices)
    if count != database.header.garment.vertex_count:
        raise ValueError(
            f"The garment '{garment.name}' has {count} vertices, its database {database.header.garment.vertex_count}; "
            "its topology changed since the bake, so bake it again."
        )


def simulate(options: argparse.Namespace) -> Mapping[str, Any]:
    if not options.fine:
        raise ValueError("Only the full simulation is there so far; add --fine.")
    _open(options)
    _check_folder(options.out)
    device = choose_device(options.device)
    garment, frames = _garment(options), _frames(options)
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        job = stage_job(garment, stage)
        rest = _rest(options, garment, job)
        clips = list(read_clip(garment, stage.rig, frames))
        settings = SimulationSettings(options.substeps, options.pre_roll)
        shapes = _simulated(job, stage, clips, rest, settings, device)

        def positions() -> Iterator[FloatArray]:
            for clip, (shape, report) in zip(clips, shapes, strict=True):
                say(f"frame {clip.frame:g}: {report}")
                yield apply(clip.rig_to_garment, shape).astype(np.float32)

        write_pc2(options.out, job.garment.vertex_count, frames[0], positions(), len(frames))
    return {"frames": len(frames), "cache": str(options.out), "text": f"{len(frames)} frames written to {options.out}."}


def _rest(options: argparse.Namespace, garment: bpy.types.Object, job: BakeJob) -> FloatArray:
    """The settled rest garment: the database's own if there is one for this job, else settled now."""
    folder = _database_folder(options, garment)
    if (folder / "manifest.json").exists():
        database = WrinkleDatabase.open(folder)
        if database.header.key == job.key:
            return database.rest
    return job.garment.positions


def _simulated(
    job: BakeJob,
    stage: SamplingStage,
    clips: Sequence[ClipFrame],
    rest: FloatArray,
    settings: SimulationSettings,
    device: str,
) -> Iterator[tuple[FloatArray, Mapping[str, Any]]]:
    """The full simulation, in rig space [m]."""
    wearer = Wearer(job.rig, job.garment, job.body, WorldBodies(stage), job.settings, device)
    fps = bpy.context.scene.render.fps / bpy.context.scene.render.fps_base
    poses = [clip.in_world() for clip in clips]
    down = np.array([0.0, 0.0, -1.0])
    for clip, shape in zip(clips, simulate_clip(wearer, rest, poses, down, fps, settings), strict=True):
        yield apply(np.linalg.inv(clip.rig_to_world), shape.positions), shape.report


class WorldBodies:
    """The body of poses whose bones hold the whole character's motion: posed at its root, then carried rigidly."""

    def __init__(self, stage: SamplingStage):
        self._stage = stage

    def positions(self, pose: Pose) -> FloatArray:
        upright, root = pose.with_root_at_rest(self._stage.rig)
        return apply(root, self._stage.positions(upright))


def evaluate_verb(options: argparse.Namespace) -> Mapping[str, Any]:
    _open(options)
    device = choose_device(options.device)
    garment, frames = _garment(options), _frames(options)
    cache = None
    if options.reference not in ("settle", "simulate"):
        cache = PointCache(Path(options.reference))
        _check_cache(cache, frames)
    database = WrinkleDatabase.open(_database_folder(options, garment))
    _check_same_garment(garment, database)
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        job = stage_job(garment, stage)
        clips = list(read_clip(garment, stage.rig, frames))
        if cache is not None:
            references = _recorded(cache, clips)
        elif options.reference == "simulate":
            references = _simulated(job, stage, clips, database.rest, SimulationSettings(), device)
        else:
            references = _settled(job, stage, clips, database.rest, device)

        def compared() -> Iterator[EvaluatedFrame]:
            for clip, (shape, report) in zip(clips, references, strict=True):
                say(f"frame {clip.frame:g}: {dict(report)}")
                upright, root = clip.pose.with_root_at_rest(stage.rig)
                yield EvaluatedFrame(clip.frame, clip.pose, shape, apply(root, stage.positions(upright)), report)

        result = evaluate(database, compared(), job.body.faces, device)
    if options.plots:
        from ..plots import plot_evaluation

        result["plots"] = [str(path) for path in plot_evaluation(result, options.plots)]
    rows = [f"{name:10} {value:8.2f} mm RMS  {result['max_mm'][name]:8.2f} mm max" for name, value in result["rmse_mm"].items()]
    return {**result, "text": "\n".join(rows)}


def _settled(
    job: BakeJob, stage: SamplingStage, clips: Sequence[ClipFrame], rest: FloatArray, device: str
) -> Iterator[tuple[FloatArray, Mapping[str, Any]]]:
    reference = SettledReference(job.rig, job.garment, job.body, stage, job.settings, rest, device)
    for clip in clips:
        gravity = clip.rig_to_world[:3, :3].T @ np.array([0.0, 0.0, -1.0])
        shape = reference.at(clip.pose, gravity)
        yield shape.positions, shape.report


def _recorded(cache: PointCache, clips: Sequence[ClipFrame]) -> Iterator[tuple[FloatArray, Mapping[str, Any]]]:
    for clip in clips:
        recorded = cache.frames[round(clip.frame - cache.start)]
        yield apply(np.linalg.inv(clip.rig_to_garment), recorded.astype(np.float64)), {}


def _check_cache(cache: PointCache, frames: Sequence[int]) -> None:
    last = cache.start + len(cache.frames) - 1
    if frames[0] < cache.start or frames[-1] > last:
        raise ValueError(f"The point cache holds frames {cache.start:g} to {last:g}, not {frames[0]} to {frames[-1]}.")


VERBS: Mapping[str, Callable[[argparse.Namespace], Mapping[str, Any]]] = {
    "setup": setup,
    "joints": joints,
    "animate": animate,
    "check": check,
    "plan": plan,
    "bake": bake_verb,
    "synthesize": synthesize,
    "simulate": simulate,
    "evaluate": evaluate_verb,
}
