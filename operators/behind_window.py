"""Operators whose work a process does behind the window, with progress in the panel and in the status bar."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import bpy

from ..wrinkle_addon.blender.file_process import FileProcess, Progress, running

TICK = 0.25
"""Time between two looks at the process [s]."""


class BehindWindow:
    """A modal operator that looks at a process now and then; nothing else of its work is done in the window.

    Attributes:
        stopping: What is told when it was stopped.
    """

    stopping = "Stopped."

    if TYPE_CHECKING:
        report: Callable[[set[str], str], None]

    def start(self, context: bpy.types.Context, garment: bpy.types.Object, process: FileProcess) -> set[str]:
        """Go on in the window while the process works."""
        self._process, self._garment, self._said = process, garment.session_uid, None
        running[self._garment] = process
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def done(self, context: bpy.types.Context, garment: bpy.types.Object, process: FileProcess) -> set[str]:
        """Show what the process has made; as long as this answers RUNNING_MODAL, it is called once more a tick."""
        raise NotImplementedError

    def dropped(self, context: bpy.types.Context) -> None:
        """Clean up behind a process that was stopped or has failed."""

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if running.get(self._garment) is not self._process:
            # Taken away, as when the add-on is switched off.
            self.cancel(context)
            return {"CANCELLED"}
        if event.type == "ESC":
            self._process.stop()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            if self._process.poll():
                self._say(context, _status(self._process))
                return {"PASS_THROUGH"}
            if (answer := self._outcome(context)) == {"RUNNING_MODAL"}:
                return answer
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            answer = {"CANCELLED"}
        self.cancel(context)
        if answer == {"CANCELLED"}:
            self.dropped(context)
        return answer

    def _say(self, context: bpy.types.Context, text: str) -> None:
        """Show how far it is, if that is news: drawing takes time from what works behind the window."""
        if (context.workspace.name, text) != self._said:
            self._said = context.workspace.name, text
            context.workspace.status_text_set(text)
            _redraw(context)

    def _outcome(self, context: bpy.types.Context) -> set[str]:
        """Of a process that has ended."""
        if self._process.stopped:
            self.report({"INFO"}, self.stopping)
            return {"CANCELLED"}
        garment = next((ob for ob in bpy.data.objects if ob.session_uid == self._garment), None)
        return {"CANCELLED"} if garment is None else self.done(context, garment, self._process)

    def cancel(self, context: bpy.types.Context) -> None:
        """Leave nothing running and nothing behind; also called when another file is opened."""
        self._process.close()
        running.pop(self._garment, None)
        context.window_manager.event_timer_remove(self._timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        _redraw(context)


def work_through(process: FileProcess) -> None:
    """Wait for a process where there is no window, with a line for every change of its progress.

    Raises:
        ValueError: With its own sentence, if it failed.
    """

    def show(progress: Progress) -> None:
        print(f"{progress.last or process.doing}: {progress.text}", file=sys.stderr, flush=True)

    process.wait(show, TICK)


def take_down() -> None:
    """End all processes: the add-on goes."""
    for process in running.values():
        process.close()
    running.clear()


def _status(process: FileProcess) -> str:
    """For the status bar."""
    if process.stopped:
        return f"{process.doing}: stopping"
    progress = process.progress
    doing = "Paused" if process.paused else process.doing
    last = f"; {progress.last}" if progress.last else ""
    return f"{doing}: {progress.text}{last}. Esc stops."


def _redraw(context: bpy.types.Context) -> None:
    # The sidebars alone, not the scene.
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()
