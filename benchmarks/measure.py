"""What all benchmarks share: their options, timing side by side, the machine's memory bandwidth, and the report."""

# pyright: reportMissingImports=false
from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from wrinkle_synthesis.wrinkle_addon.folder_verbs import choose_device

wp.config.log_level = wp.LOG_WARNING

Seconds = NDArray[np.float64]

COPIED_BYTES = 256 * 2**20
"""Size of the array that is copied to measure bandwidth, far beyond any cache."""


@dataclass(frozen=True)
class Options:
    """What the command line asks for.

    Attributes:
        json: File for the figures; "-" is standard output, None is nowhere.
        device: Warp device.
        quick: A tiny size, to see that the benchmark runs; its figures mean nothing.
        picture: Where the picture goes, of a benchmark that makes one; None is nowhere.
        scene, recording: A .blend file and a recorded animation of its garment, of a benchmark that takes one.
    """

    json: str | None
    device: str
    quick: bool
    picture: Path | None = None
    scene: Path | None = None
    recording: Path | None = None


def read_options(description: str | None, *, picture: bool = False, recording: bool = False) -> Options:
    """The options of a benchmark; ``picture`` says that it can make one, ``recording`` that it can take one."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", nargs="?", const="-", metavar="FILE", help="write the figures as one JSON object")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0, ...; left out, a GPU if there is one")
    parser.add_argument("--quick", action="store_true", help="a tiny size, to see that it runs")
    if picture:
        parser.add_argument("--picture", type=Path, metavar="FILE", help="draw what was measured, .png or .jpg")
    if recording:
        parser.add_argument("--scene", type=Path, metavar="FILE", help="a .blend file with a garment that was set up")
        parser.add_argument("--recording", type=Path, metavar="FILE", help="a recorded animation of that garment")
    given = parser.parse_args()
    if recording and (given.scene is None) != (given.recording is None):
        parser.error("A recording needs its scene, and a scene its recording.")
    try:
        paths = (getattr(given, name, None) for name in ("picture", "scene", "recording"))
        return Options(given.json, choose_device(given.device), given.quick, *paths)
    except ValueError as error:
        parser.error(str(error))


@dataclass(frozen=True)
class Contestant:
    """Something that is timed beside others.

    Attributes:
        act: What is timed, called with the number of a frame.
        prepare: Called before a pass over the frames, untimed.
    """

    act: Callable[[int], object]
    prepare: Callable[[], object] = lambda: None


def side_by_side(contestants: Mapping[str, Contestant], frames: Sequence[int], passes: int) -> dict[str, Seconds]:
    """Seconds that each contestant takes for each frame, shape [passes, frame_count].

    They take turns, a pass over all frames each, so that all meet the same machine. A first frame is not counted.
    """
    seconds = {name: np.zeros((passes, len(frames))) for name in contestants}
    for number in range(passes):
        for name, contestant in contestants.items():
            contestant.prepare()
            contestant.act(frames[-1])
            for place, frame in enumerate(frames):
                started = time.perf_counter()
                contestant.act(frame)
                seconds[name][number, place] = time.perf_counter() - started
    return seconds


def undisturbed(seconds: Seconds) -> float:
    """Mean over the frames of the fastest pass over each [s]: what the work takes when nothing else runs."""
    return float(seconds.min(0).mean())


def memory_bandwidth(device: str, threads: int) -> Callable[[int], None]:
    """An act that copies :data:`COPIED_BYTES`, so moves twice as many, over as many threads as the CPU may use."""
    if wp.get_device(device).is_cuda:
        origin = wp.zeros(COPIED_BYTES, dtype=wp.uint8, device=device)
        copy = wp.zeros_like(origin)

        def on_device(number: int) -> None:
            wp.copy(copy, origin)
            wp.synchronize_device(device)

        return on_device
    parts = np.array_split(np.ones(COPIED_BYTES // 8), threads)
    copies = [np.zeros_like(part) for part in parts]
    pool = ThreadPoolExecutor(threads)

    def on_threads(number: int) -> None:
        list(pool.map(np.copyto, copies, parts))

    return on_threads


@dataclass
class Report:
    """The figures of one benchmark: a table to read and an object to keep.

    Attributes:
        name: The benchmark's name.
        options: What was asked for.
        figures: What goes into the JSON object, each named with its unit.
    """

    name: str
    options: Options
    figures: dict[str, Any] = field(default_factory=dict)
    _lines: list[str] = field(default_factory=list)

    def table(self, title: str, rows: Sequence[Sequence[str]]) -> None:
        """Add a table; its first row is the head."""
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        self._lines += ["", title]
        for row in rows:
            cells = (cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))
            self._lines.append("  ".join([f"  {row[0]:{widths[0]}}", *cells]))

    def line(self, text: str) -> None:
        self._lines.append(text)

    def target(self, what: str, value: float, bound: float, *, at_least: bool) -> None:
        """Say whether a figure reaches what was set as its target; a quick run says nothing."""
        if self.options.quick:
            return
        reached = value >= bound if at_least else value <= bound
        self.line(
            f"  {what}: {value:.3g}, target {'at least' if at_least else 'at most'} {bound:g}: "
            + ("reached" if reached else "MISSED")
        )

    def finish(self) -> None:
        """Print the tables and write the object."""
        machine = {
            "system": platform.system(),
            "machine": platform.machine(),
            "cpus": os.cpu_count(),
            "python": platform.python_version(),
            "warp": wp.config.version,
            "device": wp.get_device(self.options.device).name,
        }
        figures = {"name": self.name, "quick": self.options.quick, "machine": machine, **self.figures}
        to_stdout = self.options.json == "-"
        head = f"{self.name} on {machine['device']}, {machine['cpus']} CPUs" + (
            " (quick)" if self.options.quick else ""
        )
        print("\n".join([head, *self._lines]), file=sys.stderr if to_stdout else sys.stdout, flush=True)
        text = json.dumps(figures, indent=2)
        if to_stdout:
            print(text, flush=True)
        elif self.options.json is not None:
            Path(self.options.json).write_text(text + "\n", encoding="utf-8")


def milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.2f} ms" if seconds < 1.0 else f"{seconds:.2f} s"


def times(ratio: float) -> str:
    return f"{ratio:.3g}x"
