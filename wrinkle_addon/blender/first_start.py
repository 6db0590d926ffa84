"""The first start: kernels are compiled in a process of their own, so that the window never stands still.

Until they are there the window plays nothing; in the background they are compiled where they are first used.
"""

from __future__ import annotations

import atexit
import json
import queue
import subprocess
import threading

import bpy

from ..kernel_cache import are_compiled
from .command import own_command
from .made_behind import tag_garments
from .preferences import chosen_device

TICK = 0.25
"""Time between two looks at the process [s]."""


class FirstStart:
    """The process that compiles, if there is one.

    Attributes:
        is_over: Whether kernels are there, or are to be compiled where they are used.
        done, total: Modules; total is 0 before the first is done.
        problem: The last line of a process that failed; kernels are then compiled where they are used.
    """

    def __init__(self) -> None:
        self.is_over = bpy.app.background
        self.done = self.total = 0
        self.problem = ""
        self._begun = False
        self._process: subprocess.Popen[str] | None = None
        self._lines: queue.Queue[str | None] = queue.Queue()

    @property
    def text(self) -> str:
        """How far it is, for the panel and the status bar."""
        return f"{self.done} of {self.total}" if self.total else "Starting"

    def _begin(self) -> None:
        """Start compiling, if there is anything to compile."""
        device = chosen_device()
        self._begun = True
        if are_compiled(list(dict.fromkeys(("cpu", device)))):
            self.is_over = True
            return
        command = own_command("kernels", "--device", device, "--progress", "json")
        self._process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, encoding="utf-8", errors="replace"
        )
        atexit.register(self.end)
        threading.Thread(target=self._read, args=(self._process,), daemon=True).start()

    def poll(self) -> None:
        """Begin, or take in what the process has said."""
        if not self._begun and not self.is_over:
            self._begin()
        while not self.is_over:
            try:
                line = self._lines.get_nowait()
            except queue.Empty:
                return
            if line is None:
                if self._process is not None and self._process.wait() == 0:
                    self.problem = ""
                self.end()
            elif line.startswith("{"):
                event = json.loads(line)
                self.done, self.total = event.get("done", self.done), event.get("total", self.total)
                self.problem = event.get("message", "")
            elif line.strip():
                self.problem = line.strip()

    def end(self) -> None:
        """Leave no process behind."""
        self.is_over = True
        atexit.unregister(self.end)
        if self._process is None:
            return
        self._process.terminate()
        self._process.wait()
        self._process = None

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        for line in process.stderr:
            self._lines.put(line)
        self._lines.put(None)


first_start = FirstStart()


def _tick() -> float | None:
    """Begin, then look at the process until it ends; then whatever waits for kernels is played."""
    before = first_start.is_over, first_start.text
    first_start.poll()
    if (first_start.is_over, first_start.text) != before:
        _show()
    if not first_start.is_over:
        return TICK
    tag_garments()
    return None


def _show() -> None:
    text = None if first_start.is_over else f"First start, compiling kernels: {first_start.text}"
    for window in bpy.context.window_manager.windows:
        window.workspace.status_text_set(text)
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PREFERENCES"):
                area.tag_redraw()


def draw_progress(layout: bpy.types.UILayout) -> None:
    """What is going on, and why nothing wrinkles yet."""
    layout.label(text="First start: compiling kernels", icon="TIME")
    layout.progress(factor=first_start.done / max(first_start.total, 1), text=first_start.text)


class WRINKLE_PT_first_start(bpy.types.Panel):
    """Kernels are compiled once; garments wrinkle as soon as that is done"""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Wrinkle"
    bl_label = "Getting Ready"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return not first_start.is_over

    def draw(self, context: bpy.types.Context) -> None:
        draw_progress(self.layout)


classes = (WRINKLE_PT_first_start,)


def register() -> None:
    if not first_start.is_over:
        # Once the window is there; Blender starts no process while it registers add-ons.
        bpy.app.timers.register(_tick, first_interval=0.5, persistent=True)


def unregister() -> None:
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    first_start.end()
