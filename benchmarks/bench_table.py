"""Table 1 of Wang et al. (2010) on this machine: milliseconds a frame of 500 frames of motion capture (W93-W98).

A man in a long shirt and trousers of 46,000 vertices, both over a coarse simulation, and a woman in a short shirt and
cropped trousers of 34,000 vertices, of which the trousers alone follow one (W52). Frames are whole ones, live, as the
window plays them: frame_set with all its handlers, which simulate the coarse layers and store them, and reading the
garments. Each part is timed by the clock where the frame waits for it, parts within it left out; what is left over is
Blender's own. What another thread does meanwhile, nobody waits for; it is told besides. Wrinkles are samples made of
formulas, as many and as large as the paper's plan asks for: what a frame takes does not depend on their shapes.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import wrinkle_synthesis
from measure import Report, milliseconds, read_options
from outfit import QUICK_SAMPLES, FoldedSamples
from wrinkle_synthesis.demo.motion import Clip, in_place, load_clip, resampled, to_rig
from wrinkle_synthesis.demo.scene import PIN_GROUP, build_character
from wrinkle_synthesis.wrinkle_addon.aligned_wrinkles import AlignedWrinkles
from wrinkle_synthesis.wrinkle_addon.bake import bake
from wrinkle_synthesis.wrinkle_addon.blender import clearance, coarse_layer, coarse_playing, handlers, playback
from wrinkle_synthesis.wrinkle_addon.blender.armature import apply_motion, read_rig
from wrinkle_synthesis.wrinkle_addon.blender.character import sampling_stage
from wrinkle_synthesis.wrinkle_addon.blender.coarse_setup import make_coarse
from wrinkle_synthesis.wrinkle_addon.blender.setup import setup_garment, stage_job
from wrinkle_synthesis.wrinkle_addon.coarse_cache import CoarseCache
from wrinkle_synthesis.wrinkle_addon.coarse_contact import CoarseContact
from wrinkle_synthesis.wrinkle_addon.coarse_simulation import CoarseSimulation
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import OffsetEvaluator
from wrinkle_synthesis.wrinkle_addon.joints import find_joints
from wrinkle_synthesis.wrinkle_addon.motion import retarget

FRAMES = 500
LEAST_FPS = 30.0
CLIPS = ("kick", "run", "dance_a", "punch", "dance_b", "spinkick")
PAUSE = 0.5
"""From the end of a clip to the beginning of the next one [s], which poses are interpolated over."""
BODY_PROXY = 10_000
"""Vertices of the body that cloth collides with; the paper has 11,000 (W42)."""
SYNTHESIS, COARSE, TRANSFER, CLEARANCE = "wrinkle synthesis", "coarse simulation", "wrinkle transfer", "push-out"
CACHE, HANDLING, BLENDER = "the simulation's cache", "reading poses, writing results", "Blender's own"
PARTS = (SYNTHESIS, COARSE, TRANSFER, CLEARANCE, CACHE, HANDLING, BLENDER)


@dataclass(frozen=True)
class Sequence:
    """A character of the paper's table.

    Attributes:
        sex: Of the demo's character.
        garments: From the skin outwards, and whether each follows a coarse simulation.
        vertex_count: Of all of them, about.
        paper: The paper's own table [ms]; threads ran side by side, so that parts add up to more than the total.
    """

    sex: str
    garments: dict[str, bool]
    vertex_count: int
    paper: dict[str, float]


SEQUENCES = {
    "man": Sequence(
        "male",
        {"trousers": True, "shirt": True},
        46_500,
        {SYNTHESIS: 9.0, COARSE: 135.0, TRANSFER: 72.0, "total": 84.0},
    ),
    "woman": Sequence(
        "female",
        {"cropped": True, "tshirt": False},
        34_500,
        {SYNTHESIS: 8.0, COARSE: 78.0, TRANSFER: 41.0, "total": 86.0},
    ),
}


@dataclass
class Stopwatch:
    """Time spent in parts of the program by the clock of the main thread, what parts within them take left out [s].

    Attributes:
        frames: What each part took in each frame so far.
        meanwhile: Processor time of each part on other threads, in all frames.
        processor: Processor time of all threads in each frame.
    """

    frames: list[dict[str, float]] = field(default_factory=list)
    meanwhile: dict[str, float] = field(default_factory=dict)
    processor: list[float] = field(default_factory=list)
    _open: list[float] = field(default_factory=list)

    def clear(self) -> None:
        self.frames.clear()
        self.meanwhile.clear()
        self.processor.clear()

    def time_frame(self, act: Callable[[], Any]) -> None:
        self.frames.append(dict.fromkeys(PARTS, 0.0))
        started = time.process_time()
        self.time(BLENDER, act)
        self.processor.append(time.process_time() - started)

    def milliseconds(self) -> dict[str, np.ndarray]:
        """Of each part in every frame, shape [frame_count]."""
        return {part: 1e3 * np.array([frame[part] for frame in self.frames]) for part in PARTS}

    def watch(self, part: str, owner: Any, name: str) -> None:
        """Count every call of a function towards a part from now on."""
        act = getattr(owner, name)

        def timed(*arguments: Any, **options: Any) -> Any:
            return self.time(part, lambda: act(*arguments, **options))

        setattr(owner, name, timed)

    def time(self, part: str, act: Callable[[], Any]) -> Any:
        if threading.current_thread() is not threading.main_thread():
            return self._time_meanwhile(part, act)
        self._open.append(0.0)
        started = time.perf_counter()
        try:
            return act()
        finally:
            passed = time.perf_counter() - started
            within = self._open.pop()
            if self.frames:
                self.frames[-1][part] += passed - within
            if self._open:
                self._open[-1] += passed

    def _time_meanwhile(self, part: str, act: Callable[[], Any]) -> Any:
        started = time.thread_time()
        try:
            return act()
        finally:
            self.meanwhile[part] = self.meanwhile.get(part, 0.0) + time.thread_time() - started


def make_motion(frame_count: int) -> Clip:
    """The demo's clips one after the other, until there are enough frames of them."""
    clips = [in_place(load_clip(name)) for name in CLIPS]
    times, positions, turns, last = [], [], [], -PAUSE
    while last * 30.0 < frame_count:
        for clip in clips:
            times.append(last + PAUSE + clip.times)
            last = times[-1][-1]
            positions.append(clip.positions)
            turns.append(clip.turns)
    whole = Clip("sequence", np.concatenate(times), np.concatenate(positions), np.concatenate(turns), False)
    return resampled(whole)


def open_sequence(sequence: Sequence, frame_count: int, folder: Path, *, quick: bool) -> list[bpy.types.Object]:
    """Build the scene; returns its garments, ready to be played live."""
    each = (4_000 if quick else sequence.vertex_count) // len(sequence.garments)
    build_character(folder / "character.blend", sequence.sex, tuple(sequence.garments), each)
    armature, body = bpy.data.objects["Rig"], bpy.data.objects["body"]
    rig = read_rig(armature)
    clip_rig, poses = to_rig(make_motion(frame_count))
    found = find_joints(clip_rig).found
    apply_motion(armature, rig, retarget(clip_rig, found, poses[:frame_count], rig, find_joints(rig).found))
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, frame_count
    garments = []
    for order, (name, follows) in enumerate(sequence.garments.items()):
        garment = setup_garment(bpy.data.objects[name], body, armature, 0).garment
        settings = garment.wrinkles
        settings.pin_group, settings.database = PIN_GROUP, str(folder / f"{name}.wrinkles")
        settings.plan, settings.budget = ("BUDGET", QUICK_SAMPLES) if quick else ("PAPER", settings.budget)
        with sampling_stage(armature, body) as stage:
            job = stage_job(garment, stage)
        for _ in bake(job, FoldedSamples(job), Path(settings.database)):
            pass
        if follows:
            settings.coarse_cache = str(folder / "coarse")
            settings.coarse_order, settings.coarse_proxy = order, 2_000 if quick else BODY_PROXY
            make_coarse(garment, 200 if quick else 700)
        settings.clear_of_body = settings.enabled = True
        garments.append(garment)
    return garments


def show(garments: list[bpy.types.Object], frame: int) -> None:
    """Go to a frame and read the garments as Blender evaluates them."""
    bpy.context.scene.frame_set(frame)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for garment in garments:
        coarse_layer.read_positions(garment.evaluated_get(depsgraph).data)


def play(garments: list[bpy.types.Object], frame_count: int, stopwatch: Stopwatch) -> None:
    """Play frames live; the first one, in which all is bound and the layers settle, is not counted."""
    with handlers.suspended():
        show(garments, 1)
    # The first time a frame asks for the simulation; then it is built, between two frames.
    show(garments, 1)
    with handlers.suspended():
        coarse_playing.grant_wishes()
    handlers.begin_animation()
    show(garments, 1)
    stopwatch.clear()
    for frame in range(2, frame_count + 1):
        stopwatch.time_frame(lambda frame=frame: show(garments, frame))


def measure(sequence: Sequence, stopwatch: Stopwatch, *, quick: bool) -> dict[str, Any]:
    """The table's column of one character: milliseconds a frame by part, by the clock."""
    frame_count = 6 if quick else FRAMES
    with tempfile.TemporaryDirectory() as name:
        garments = open_sequence(sequence, frame_count, Path(name), quick=quick)
        layers = [len(one.wrinkles.coarse.data.vertices) for one in garments if one.wrinkles.coarse is not None]
        play(garments, frame_count, stopwatch)
        coarse_playing.flush()
        kept = CoarseCache.open(Path(name) / "coarse")
        assert kept.last == frame_count, f"The simulation came to frame {kept.last}."
    spent = stopwatch.milliseconds()
    whole = np.sum(list(spent.values()), axis=0)
    # Other work on the machine slows every frame down, some less than others.
    fastest = np.argsort(whole)[: max(1, len(whole) // 10)]
    return {
        "vertices": sum(len(one.data.vertices) for one in garments),
        "coarse_vertices": layers,
        "frames": frame_count,
        "part_ms": {part: float(ms.mean()) for part, ms in spent.items()},
        "part_fastest_ms": {part: float(ms[fastest].mean()) for part, ms in spent.items()},
        "meanwhile_ms": {part: 1e3 * seconds / len(whole) for part, seconds in stopwatch.meanwhile.items()},
        "frame_ms": float(whole.mean()),
        "frame_fastest_ms": float(whole[fastest].mean()),
        "processor_ms": 1e3 * float(np.mean(stopwatch.processor)),
    }


def add_table(report: Report, name: str, column: dict[str, Any]) -> None:
    paper = SEQUENCES[name].paper
    rows = [["", "by the clock", "the fastest tenth", "the paper"]]
    for part in PARTS:
        spent = (column[kind][part] for kind in ("part_ms", "part_fastest_ms"))
        published = milliseconds(1e-3 * paper[part]) if part in paper else ""
        rows.append([part, *(milliseconds(1e-3 * ms) for ms in spent), published])
    whole = (column["frame_ms"], column["frame_fastest_ms"], paper["total"])
    rows.append(["whole frame", *(milliseconds(1e-3 * ms) for ms in whole)])
    rows.append(["frames a second", *(f"{1e3 / ms:.1f}" for ms in whole)])
    for part, ms in column["meanwhile_ms"].items():
        rows.append([f"meanwhile, on another thread: {part}", milliseconds(1e-3 * ms), "", ""])
    rows.append(["processor time of all threads", milliseconds(1e-3 * column["processor_ms"]), "", ""])
    layers = " and ".join(str(count) for count in column["coarse_vertices"])
    report.table(f"{name}: {column['vertices']} vertices over {layers}, {column['frames']} frames", rows)


def main() -> None:
    report = Report("table", read_options(__doc__))
    quick = report.options.quick
    wrinkle_synthesis.register()
    # Nobody looks on, but the layers shall be simulated as in a window.
    coarse_layer.in_background = lambda: False
    stopwatch = Stopwatch()
    stopwatch.watch(HANDLING, playback, "play_scene")
    stopwatch.watch(SYNTHESIS, OffsetEvaluator, "evaluate")
    stopwatch.watch(SYNTHESIS, OffsetEvaluator, "evaluate_apart")
    stopwatch.watch(TRANSFER, AlignedWrinkles, "evaluate")
    stopwatch.watch(CLEARANCE, clearance.BodyClearance, "read")
    stopwatch.watch(CLEARANCE, clearance.BodyClearance, "move")
    stopwatch.watch(CLEARANCE, clearance.BodyClearance, "clear")
    stopwatch.watch(COARSE, CoarseSimulation, "step")
    stopwatch.watch(COARSE, CoarseContact, "find")
    stopwatch.watch(CACHE, CoarseCache, "read")
    stopwatch.watch(CACHE, CoarseCache, "_store")
    names = ["man"] if quick else list(SEQUENCES)
    columns = {name: measure(SEQUENCES[name], stopwatch, quick=quick) for name in names}
    for name, column in columns.items():
        add_table(report, name, column)
    fps = 1e3 / columns["man"]["frame_ms"]
    report.target("frames a second of the man", fps, LEAST_FPS, at_least=True)
    report.figures |= {
        "fps": fps,
        "frame_ms": columns["man"]["frame_ms"],
        "sequences": columns,
        "paper_ms": {name: sequence.paper for name, sequence in SEQUENCES.items()},
    }
    report.finish()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(0)


if __name__ == "__main__":
    main()
