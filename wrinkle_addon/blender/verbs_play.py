"""The verbs that play a clip: synthesize, simulate, evaluate."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..bake import BakeJob
from ..database import MANIFEST, WrinkleDatabase
from ..evaluate import EvaluatedFrame, worst_of
from ..evaluate import evaluate as evaluate_frames
from ..evaluation_record import write_evaluation
from ..folder_verbs import choose_device
from ..joint_wrinkles import BlendWeights, Formulation, JointWrinkles
from ..losses import LossFinder, mean_losses
from ..pc2 import PointCache, write_pc2
from ..penetration import ClearanceSettings, PushOut
from ..plots import check_plots, plot_evaluation
from ..reference import SettledReference, SimulationSettings, simulate_clip
from ..rig import FloatArray, Pose
from ..wearer import Wearer
from .character import SamplingStage, apply, sampling_stage
from .clearance import Worn, bind_to_body
from .clip import ClipFrame, parse_frames, read_clip
from .clip_synthesis import CACHE, ClipSynthesis, check_result, write_clip, write_parts
from .coarse_layer import CoarseBinding
from .files import check_output, save_character
from .matching import check_database
from .mesh_cache import play_cache
from .setup import stage_job
from .verb_options import find_database, find_frames, find_garment, open_file, say_share
from .verbs_coarse import simulate_coarse

Shapes = Iterator[tuple[FloatArray, Mapping[str, Any]]]
"""The garment in rig space [m], shape [vertex_count, 3], frame by frame, and what there is to say of it."""


def synthesize(options: argparse.Namespace) -> Mapping[str, Any]:
    """A finished clip, or a part of it."""
    device = choose_device(options.device)
    check_result(options.out)
    if options.blend is not None:
        check_output(options.blend, ".blend")
        if options.out.suffix.lower() != CACHE or options.part:
            raise ValueError(f"With --blend, the whole clip is written, and as a {CACHE} file.")
    open_file(options)
    garment, listed = find_garment(options), find_frames(options, every=True)
    frames = range(listed[0], listed[-1] + 1)
    part = _part(options.part, frames) if options.part else frames
    formulation = Formulation(options.formulation) if options.formulation else None
    synthesis = ClipSynthesis(garment, find_database(options, garment), formulation, _weights(options, garment), device)
    key, made = synthesis.file_key(), 0

    def report(stretch: range) -> None:
        nonlocal made
        made += len(stretch)
        say_share(options, made / len(part), f"frames {stretch.start} to {stretch.stop - 1}")

    if options.part:
        write_parts(synthesis, part, options.out, key, report)
    else:
        write_clip(synthesis, frames, options.out, key, report)
    if options.blend is not None:
        play_cache(garment, options.out, frames.start)
        save_character(options.blend)
    whole = f"Frames {part.start} to {part.stop - 1} of" if options.part else f"{len(frames)} frames written to"
    text = [f"{whole} {options.out}{' are there' if options.part else ''}."]
    text += [
        f"{name} goes {angle:.0f} degrees beyond its samples."
        for name, angle in synthesis.clamped_deg.items()
        if angle >= 0.5
    ]
    text += [f"{note} ({count} frames)" for note, count in synthesis.notes.items()]
    return {
        "frames": len(part),
        "made": made,
        "cache": str(options.out),
        "clamped_deg": synthesis.clamped_deg,
        "notes": list(synthesis.notes),
        "text": "\n".join(text),
    }


def _part(text: str, frames: range) -> range:
    """Some of the frames, of "A:B"."""
    part = parse_frames(text)
    if text.count(":") != 1:
        raise ValueError(f"A part is given as FIRST:LAST, not '{text}'.")
    if part[0] not in frames or part[-1] not in frames:
        raise ValueError(f"The part {text} is not within the frames {frames.start} to {frames.stop - 1}.")
    return range(part[0], part[-1] + 1)


def _weights(options: argparse.Namespace, garment: bpy.types.Object) -> BlendWeights:
    """The weights that are named, or those that the garment remembers."""
    return BlendWeights(options.weights) if options.weights else BlendWeights[garment.wrinkles.weights]


def simulate(options: argparse.Namespace) -> Mapping[str, Any]:
    return _simulate_fine(options) if options.fine else simulate_coarse(options)


def _simulate_fine(options: argparse.Namespace) -> Mapping[str, Any]:
    if options.out is None:
        raise ValueError("Name the .pc2 file for the full simulation with --out.")
    settings = SimulationSettings(options.substeps, options.pre_roll)
    device = choose_device(options.device)
    check_output(options.out, ".pc2")
    open_file(options)
    garment, frames = find_garment(options), find_frames(options, every=True)
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        job = stage_job(garment, stage)
        rest = _baked_rest(options, garment, job)
        clips = list(read_clip(garment, stage.rig, frames))
        shapes = _simulated(job, stage, clips, rest, settings, device)
        reports: list[Mapping[str, Any]] = []

        def positions() -> Iterator[NDArray[np.float32]]:
            for clip, (shape, report) in zip(clips, shapes, strict=True):
                reports.append(report)
                _say_frame(options, len(reports) / len(clips), clip, report)
                yield apply(clip.rig_to_garment, shape).astype(np.float32)

        write_pc2(options.out, job.garment.vertex_count, frames[0], positions(), len(frames))
    text = f"{len(frames)} frames written to {options.out}."
    return {"frames": len(frames), "cache": str(options.out), "worst": worst_of(reports), "text": text}


def _baked_rest(options: argparse.Namespace, garment: bpy.types.Object, job: BakeJob) -> FloatArray | None:
    """The settled rest garment, if it was baked for this very job."""
    if options.database is None and not garment.wrinkles.database:
        return None
    folder = find_database(options, garment)
    if not (folder / MANIFEST).exists():
        return None
    database = WrinkleDatabase.open(folder)
    return database.rest if database.header.key == job.key else None


def _say_frame(options: argparse.Namespace, share: float, clip: ClipFrame, report: Mapping[str, Any]) -> None:
    details = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in report.items())
    say_share(options, share, f"frame {clip.frame:g}{': ' if details else ''}{details}")


def _simulated(
    job: BakeJob,
    stage: SamplingStage,
    clips: Sequence[ClipFrame],
    rest: FloatArray | None,
    settings: SimulationSettings,
    device: str,
) -> Shapes:
    """The full simulation of frames without a gap; the garment settles in the rest pose first if it has not yet."""
    wearer = Wearer(job.rig, job.garment, job.body, WorldBodies(stage), job.settings, device)
    if rest is None:
        wearer.dress()
    first = wearer.positions[0] if rest is None else rest
    fps = bpy.context.scene.render.fps / bpy.context.scene.render.fps_base
    poses = [clip.in_world() for clip in clips]
    down = np.array([0.0, 0.0, -1.0])
    for clip, shape in zip(clips, simulate_clip(wearer, first, poses, down, fps, settings), strict=True):
        yield apply(np.linalg.inv(clip.rig_to_world), shape.positions), shape.report


class WorldBodies:
    """The body of poses whose bones hold the whole character's motion: posed at its root, then carried rigidly."""

    def __init__(self, stage: SamplingStage):
        self._stage = stage

    def positions(self, pose: Pose) -> FloatArray:
        upright, root = pose.with_root_at_rest(self._stage.rig)
        return apply(root, self._stage.positions(upright))


# --- measuring ----------------------------------------------------------------------------------------------------


def evaluate(options: argparse.Namespace) -> Mapping[str, Any]:
    device = choose_device(options.device)
    cache = None if options.reference in ("settle", "simulate") else PointCache(Path(options.reference))
    if options.losses and options.reference != "settle":
        raise ValueError("Losses are told apart at the equilibrium; use --losses with --reference settle.")
    if options.plots is not None:
        check_plots(options.plots)
    open_file(options)
    garment, frames = find_garment(options), find_frames(options)
    database = WrinkleDatabase.open(find_database(options, garment))
    check_database(garment, database.header)
    if cache is not None:
        _check_cache(cache, frames, database.header.garment.vertex_count)
    weights = _weights(options, garment)
    layered = list(_over_coarse(garment, database, frames, weights, device))
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        job = stage_job(garment, stage)
        clips = list(read_clip(garment, stage.rig, frames))
        if cache is not None:
            references = _recorded(cache, clips)
        elif options.reference == "simulate":
            whole = list(read_clip(garment, stage.rig, range(frames[0], frames[-1] + 1)))
            shapes = _simulated(job, stage, whole, database.rest, SimulationSettings(), device)
            references = (shape for clip, shape in zip(whole, shapes, strict=True) if clip.frame in frames)
        else:
            references = _settled(job, stage, clips, database, device, losses=options.losses)

        def compared() -> Iterator[EvaluatedFrame]:
            frames_of = zip(clips, layered, references, strict=True)
            for number, (clip, over_coarse, (shape, report)) in enumerate(frames_of, 1):
                _say_frame(options, number / len(clips), clip, report)
                upright, root = clip.pose.with_root_at_rest(stage.rig)
                body = apply(root, stage.positions(upright))
                yield EvaluatedFrame(clip.frame, clip.pose, shape, body, report, over_coarse)

        push = None
        if garment.wrinkles.clear_of_body:
            push = PushOut(
                bind_to_body(Worn.of_database(database), job.body),
                ClearanceSettings(garment.wrinkles.clearance),
                device,
            )
        result = evaluate_frames(database, compared(), job.body.faces, device, weights, push)
    if options.keep:
        write_evaluation(database.folder, database.header.key, result)
    if options.plots is not None:
        result["plots"] = [str(path) for path in plot_evaluation(result, options.plots)]
    rows = [
        f"{name:10} {value:8.2f} mm RMS  {result['max_mm'][name]:8.2f} mm max"
        for name, value in result["rmse_mm"].items()
    ]
    if options.losses:
        result["losses_mm"] = mean_losses([frame["reference"]["losses_mm"] for frame in result["frames"]])
        rows += [f"lost by {name.replace('_', ' ')}: {value:.2f} mm RMS" for name, value in result["losses_mm"].items()]
    return {**result, "text": "\n".join(rows)}


def _over_coarse(
    garment: bpy.types.Object, database: WrinkleDatabase, frames: Sequence[int], weights: BlendWeights, device: str
) -> Iterator[NDArray[np.float32] | None]:
    """The garment over its coarse layer in every frame, in rig space [m], shape [vertex_count, 3]; None without one."""
    evaluator, binding = JointWrinkles(database, weights=weights).bind(device), CoarseBinding(database)
    positions = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device=device)
    strengths = {joint.name: 1.0 for joint in database.header.joints}
    for clip in read_clip(garment, database.header.rig, frames):
        layer = binding.read(garment, bpy.context.evaluated_depsgraph_get(), evaluator, strict=True)
        if layer is None:
            yield None
            continue
        layer.evaluate(clip.pose, positions, strengths, clip.rig_to_garment)
        yield apply(np.linalg.inv(clip.rig_to_garment), positions.numpy().astype(np.float64)).astype(np.float32)


def _settled(
    job: BakeJob,
    stage: SamplingStage,
    clips: Sequence[ClipFrame],
    database: WrinkleDatabase,
    device: str,
    *,
    losses: bool,
) -> Shapes:
    reference = SettledReference(job.rig, job.garment, job.body, stage, job.settings, database.rest, device)

    def equilibrium(pose: Pose, gravity: FloatArray, through: Sequence[Pose] = ()) -> FloatArray:
        return reference.at(pose, gravity, through).positions

    finder = LossFinder(database, equilibrium)
    for clip in clips:
        gravity = clip.rig_to_world[:3, :3].T @ np.array([0.0, 0.0, -1.0])
        shape = reference.at(clip.pose, gravity)
        found = {"losses_mm": finder.losses(clip.pose, gravity, shape.positions)} if losses else {}
        yield shape.positions, {**shape.report, **found}


def _recorded(cache: PointCache, clips: Sequence[ClipFrame]) -> Shapes:
    for clip in clips:
        recorded = cache.frames[round(clip.frame - cache.start)]
        yield apply(np.linalg.inv(clip.rig_to_garment), recorded.astype(np.float64)), {}


def _check_cache(cache: PointCache, frames: Sequence[int], vertex_count: int) -> None:
    last = cache.start + len(cache.frames) - 1
    if frames[0] < cache.start or frames[-1] > last:
        raise ValueError(f"The point cache holds frames {cache.start:g} to {last:g}, not {frames[0]} to {frames[-1]}.")
    if cache.frames.shape[1] != vertex_count:
        raise ValueError(
            f"The point cache has {cache.frames.shape[1]} vertices a frame, the garment {vertex_count}; "
            "record it from the garment that was baked."
        )
