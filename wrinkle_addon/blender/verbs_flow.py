"""The verbs of wrinkle flows that open a scene: compress, play, verify against the recording."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from .. import flow_verbs
from ..flow import Ends, FlowMethod, Timing
from ..flow_compress import Goal, measure_errors
from ..flow_file import SUFFIX, read_flow
from ..flow_residuals import Residuals, ResidualSpace, Skinning
from ..folder_verbs import choose_device
from ..pc2 import write_pc2
from ..plots import check_plots, plot_flow
from ..steps import describe_left, finish
from .character import apply
from .clip import read_clip
from .files import check_output, choose_armature, save_character
from .flow_compression import compress_garment
from .flow_playback import check_flow_mesh, describe_outside
from .flow_recording import SCENE, RecordingChoice, read_posed
from .matching import RECORDING, match_rig
from .verb_options import find_frames, find_object, open_file, say_share

PAUSE = 0.5
"""Least time between two words of progress [s]."""


def flow(options: argparse.Namespace) -> Mapping[str, Any]:
    return {"compress": compress_recording, "play": play, "verify": verify}[options.action](options)


def compress_recording(options: argparse.Namespace) -> Mapping[str, Any]:
    """A recording into a flow."""
    goal = Goal(options.error, options.components, options.size, options.max_error) if _is_given(options) else Goal(0.5)
    check_output(options.out, SUFFIX)
    if options.plots is not None:
        check_plots(options.plots)
    open_file(options)
    garment = find_worn(options)
    made = compress_garment(
        garment,
        _choice(options),
        goal,
        options.out,
        _Teller(options),
        skinning=Skinning(options.skinning),
        space=ResidualSpace(options.space),
    )
    told = flow_verbs.describe(read_flow(options.out))
    lines = [
        f"{told['bytes'] / 1e6:.3g} MB written to {options.out}, {told['times_smaller_than_pc2']:g} times smaller than "
        "a PC2 cache.",
        f"{made.rms_mm:.3g} mm RMS, {made.max_mm:.3g} mm at most; {made.skinning_mm:.3g} mm RMS by skinning alone.",
    ]
    lines += [made.note] if made.note else []
    result = {
        **told,
        "notes": [made.note] if made.note else [],
        "measured_rms_mm": made.rms_mm,
        "measured_max_mm": made.max_mm,
        "skinning_mm": made.skinning_mm,
    }
    if options.plots is not None:
        points = [*made.header.curve, (told["bytes"], made.rms_mm)]
        result["curve"] = [{"bytes": size, "rms_mm": error} for size, error in made.header.curve]
        result["plots"] = [str(plot_flow(points, made.frame_mm, made.header.start, options.plots))]
    if options.blend is not None:
        _remember(garment, options.out, options.blend)
        save_character(options.blend)
    return {**result, "text": "\n".join(lines)}


def play(options: argparse.Namespace) -> Mapping[str, Any]:
    """Replay a flow into a point cache, or let a garment replay it from now on."""
    if options.out is None and options.blend is None:
        raise ValueError("Nothing is asked for; give --out for a point cache, or --blend for a .blend file.")
    if options.out is not None:
        check_output(options.out, ".pc2")
    if options.blend is not None:
        check_output(options.blend, ".blend")
    device = choose_device(options.device)
    found = read_flow(options.flow)
    open_file(options)
    garment = find_worn(options)
    check_flow_mesh(garment, found.header.topology, found.vertex_count)
    scale = match_rig(garment.wrinkles.armature, found, RECORDING)
    timing = Timing(options.offset, options.speed, Ends(options.ends))
    frames = find_frames(options, every=True)
    evaluator = FlowMethod(found, timing).bind(device)
    outside: list[float] = []

    def positions() -> Iterator[NDArray[np.float32]]:
        for clip in read_clip(garment, found.rig, frames, scale):
            shape = evaluator.positions(clip.pose, options.strength, frame=clip.frame)
            outside.append(evaluator.outside)
            yield apply(clip.rig_to_garment, shape.astype(np.float64)).astype(np.float32)

    if options.out is not None:
        write_pc2(options.out, found.vertex_count, frames[0], positions(), len(frames))
    if options.blend is not None:
        _remember(garment, options.flow, options.blend)
        settings = garment.wrinkles.flow
        settings.offset, settings.speed, settings.ends = options.offset, options.speed, Ends(options.ends).name
        garment.wrinkles.strength = options.strength
        save_character(options.blend)
    beyond = max(outside, default=0.0)
    lines = [f"{len(frames)} frames written to {options.out}."] if options.out is not None else []
    lines += [f"{garment.name} replays {options.flow} in {options.blend}."] if options.blend is not None else []
    lines += [f"Up to {describe_outside(beyond)}."] if beyond else []
    return {"frames": len(outside), "outside": sum(value > 0.0 for value in outside), "text": "\n".join(lines)}


def verify(options: argparse.Namespace) -> Mapping[str, Any]:
    """Replay a flow beside the recording that it was made of, and compare the error with its promise."""
    if options.recording is None:
        raise ValueError("Name the recording to compare with, by --recording, or leave the .blend file out.")
    found = read_flow(options.flow)
    open_file(options)
    garment = find_worn(options)
    check_flow_mesh(garment, found.header.topology, found.vertex_count)
    match_rig(garment.wrinkles.armature, found, RECORDING)
    first = round(found.header.start)
    choice = RecordingChoice(options.recording, range(first, first + found.frame_count), found.header.start)
    posed = finish(read_posed(garment, found.rig, choice), lambda share, text: None)
    if posed.recording.frame_count != found.frame_count:
        raise ValueError(
            f"The recording has {posed.recording.frame_count} frames, the flow {found.frame_count}; "
            "compare it with the one that it was made of."
        )
    residuals = Residuals(posed.recording, found.rig, posed.poses, posed.to_rig, found.rest, found.weights)
    errors = measure_errors(found, residuals, posed.poses)
    ok = errors.rms_mm <= found.header.rms_mm and errors.max_mm <= found.header.max_mm
    text = (
        f"{errors.rms_mm:.4g} mm RMS, {errors.max_mm:.4g} mm at most; promised are {found.header.rms_mm:g} and "
        f"{found.header.max_mm:g}: {'kept' if ok else 'BROKEN'}."
    )
    return {"ok": ok, "rms_mm": errors.rms_mm, "max_mm": errors.max_mm, "text": text, "exit_code": 0 if ok else 1}


def find_worn(options: argparse.Namespace) -> bpy.types.Object:
    """The garment that is named or the only one that was set up; one that was not gets its armature and body now.

    Raises:
        ValueError: If there is no such garment, or no armature; one sentence.
    """
    ready = [ob for ob in bpy.data.objects if ob.type == "MESH" and ob.wrinkles.armature is not None]
    if options.garment is None:
        if len(ready) != 1:
            names = ", ".join(sorted(ob.name for ob in ready)) or "none"
            raise ValueError(f"Name the garment by --garment; set up in this file: {names}.")
        garment = ready[0]
    else:
        garment = find_object(options.garment, "garment")
    if garment.type != "MESH":
        raise ValueError(f"The garment '{garment.name}' is no mesh; choose a mesh object.")
    settings = garment.wrinkles
    if getattr(options, "body", None):
        settings.body = find_object(options.body, "body")
    if options.armature or settings.armature is None:
        settings.armature = choose_armature(options.armature)
    return garment


def _is_given(options: argparse.Namespace) -> bool:
    return any(value is not None for value in (options.error, options.components, options.size, options.max_error))


def _choice(options: argparse.Namespace) -> RecordingChoice:
    listed = find_frames(options, every=True)
    frames = range(listed[0], listed[-1] + 1)
    return RecordingChoice(options.recording or SCENE, frames, options.start, options.weights)


def _remember(garment: bpy.types.Object, flow: Path, blend: Path) -> None:
    """Let a garment replay a flow, found from where the .blend file will lie."""
    garment.wrinkles.flow.path = bpy.path.relpath(str(flow.resolve()), start=str(blend.resolve().parent))
    garment.wrinkles.flow.replays = True
    garment.wrinkles.enabled = True


class _Teller:
    """Says what is done and how long it will take, when either is news."""

    def __init__(self, options: argparse.Namespace, clock: Callable[[], float] = time.monotonic):
        self._options, self._clock, self._began = options, clock, clock()
        self._last, self._spoke = "", -PAUSE

    def __call__(self, share: float, text: str) -> None:
        passed = self._clock() - self._began
        # Frames come fast, and one by one.
        if text == self._last or (passed - self._spoke < PAUSE and share < 1.0):
            return
        self._last, self._spoke = text, passed
        text = f"{text}{describe_left(share, passed)}"
        say_share(self._options, share, text if self._options.progress == "json" else f"{100 * share:3.0f} % {text}")
