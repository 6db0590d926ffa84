"""A whole bake behind a window that stays open: how long the window is kept busy, what it says, what it shows.

Run by tools/window.py as ``blender SCENE.blend --python whole_bake.py -- SHOTS`` on a file whose garment is set up and
not baked yet. Ticks are told by the processor's time: the machine is busy baking. The log of them lies with the shots.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

from mouse import Hand, Steps
from screenplay import PACKAGE, SHOTS, first_start, open_sidebar, run, say, wait_for

BEAT = 0.02
"""Time between two looks at how long the window was kept busy [s]."""
NIGHT = 7200.0
"""What a whole bake may take [s]."""

file_process = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.file_process")
playback = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.playback")
behind_window = importlib.import_module(f"{PACKAGE}.operators.behind_window")


class Log:
    """What was said and how busy the window was, by the seconds since the start.

    Attributes:
        doing: What the window is doing at present, for those entries that are told by it.
    """

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._last = time.thread_time()
        self.doing = ""
        self.said: list[tuple[float, str]] = []
        self.busy: list[tuple[float, str, float]] = []
        self.calls: dict[str, list[float]] = {}

    @property
    def now(self) -> float:
        return round(time.monotonic() - self._began, 2)

    def say(self, text: str) -> None:
        if not self.said or self.said[-1][1] != text:
            self.said.append((self.now, text))

    def beat(self) -> float:
        """The time of the processor that the window's thread took since the last beat, its drawing included."""
        busy = time.thread_time()
        self.busy.append((self.now, self.doing, round(busy - self._last, 4)))
        self._last = time.thread_time()
        return BEAT

    @contextmanager
    def timing(self, what: str) -> Iterator[None]:
        began = time.thread_time()
        try:
            yield
        finally:
            self.calls.setdefault(what, []).append(time.thread_time() - began)

    def tell(self) -> None:
        """The longest of everything, and all of it into a file."""
        for what, times in self.calls.items():
            say(f"{what}: {len(times)} times, at most {1000 * max(times):.0f} ms of the processor")
        for doing in dict.fromkeys(doing for _, doing, _ in self.busy):
            times = sorted(busy for _, said, busy in self.busy if said == doing)
            say(f"{doing}: the window busy for {1000 * times[-1]:.0f} ms at most, drawing included")
        whole: dict[str, Any] = {"said": self.said, "busy": self.busy, "calls": self.calls}
        (SHOTS / "whole_bake.json").write_text(json.dumps(whole))


log = Log()


def measure() -> None:
    """Time the window's own work. Blender looks at how many arguments it may give: wrappers name them."""
    look, play = behind_window.BehindWindow.modal, playback.play_scene

    def modal(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        with log.timing("a tick of the operator"):
            return look(self, context, event)

    def play_scene(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, *, only_changes: bool = False) -> list[str]:
        with log.timing("playing a frame"):
            return play(scene, depsgraph, only_changes=only_changes)

    behind_window.BehindWindow.modal, playback.play_scene = modal, play_scene


def the_whole_bake(hand: Hand) -> Steps:
    yield from wait_for(lambda: first_start.is_over, "kernels are compiled")
    garment = next(ob for ob in bpy.data.objects if ob.type == "MESH" and len(ob.wrinkles.joints))
    bpy.context.view_layer.objects.active = garment
    yield from open_sidebar(hand)
    garment.wrinkles.database = "//whole_bake.wrinkles"
    measure()
    log.doing = "baking"
    bpy.app.timers.register(log.beat)
    began = time.monotonic()
    yield from hand.click("wrinkle.bake")
    yield from wait_for(lambda: file_process.running, "the bake begins")
    (process,) = file_process.running.values()
    yield from samples(process, 1)
    yield from shoot(hand, "start")
    yield from samples(process, process.progress.total // 4)
    yield from pause(hand, process)
    yield from samples(process, process.progress.total // 2)
    yield from shoot(hand, "middle")
    yield from samples(process, process.progress.total - 1)
    log.doing = "the bake's end and the first frame"
    yield from wait_for(lambda: said(process) and not file_process.running, "the bake ends", NIGHT)
    say(f"the whole bake of {process.progress.total} samples took {time.monotonic() - began:.0f} s")
    yield from wait_for(lambda: playback.status(garment).plays, "the garment plays")
    yield 2.0
    yield from shoot(hand, "end")
    log.doing = "another frame"
    bpy.context.scene.frame_set((bpy.context.scene.frame_start + bpy.context.scene.frame_end) // 2)
    yield 2.0
    yield from shoot(hand, "played")
    assert not playback.status(garment).error, playback.status(garment).error
    log.tell()


def samples(process: Any, count: int) -> Steps:
    """Until so many are baked."""
    yield from wait_for(lambda: said(process) and process.progress.done >= count, f"{count} samples are baked", NIGHT)


def said(process: Any) -> bool:
    """Takes down what the status bar says."""
    log.say(behind_window._status(process))
    return True


def pause(hand: Hand, process: Any) -> Steps:
    """By the button; the sample in work is finished, and then none is until the button is pressed again."""
    yield from hand.click("wrinkle.pause_bake")
    assert process.paused
    until = time.monotonic() + 60.0
    yield from wait_for(lambda: said(process) and time.monotonic() > until, "the sample in work is finished")
    waited_at = process.progress.done
    yield from shoot(hand, "paused")
    until = time.monotonic() + 60.0
    yield from wait_for(lambda: said(process) and time.monotonic() > until, "a minute goes by")
    assert process.progress.done == waited_at, "Samples were baked while the bake was paused."
    yield from hand.click("wrinkle.pause_bake")
    assert not process.paused


def shoot(hand: Hand, name: str) -> Steps:
    yield from hand.shoot(name)
    yield from hand.shoot(f"sidebar_{name}", sidebar=True)


run(the_whole_bake, ("Getting Ready", "Character", "Plan", "Bake", "Play"))
