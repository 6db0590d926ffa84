"""Try a bake and a play on this machine, behind the window."""

from __future__ import annotations

import json
import subprocess

import bpy

from ..wrinkle_addon.blender.command import own_command
from ..wrinkle_addon.blender.preferences import chosen_device, test_lines

TICK = 0.25
"""Time between two looks at the process [s]."""


class WRINKLE_OT_self_test(bpy.types.Operator):
    """Bake and play a small sleeve on the chosen device, in a process of its own"""

    bl_idname = "wrinkle.self_test"
    bl_label = "Self-Test"

    _running: subprocess.Popen[str] | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if cls._running is not None:
            cls.poll_message_set("The self-test is running.")
        return cls._running is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """To the end."""
        self._start()
        return self._finish()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Behind the window."""
        self._start()
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        process = type(self)._running
        if event.type != "TIMER" or process is None or process.poll() is None:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        outcome = self._finish()
        for window in context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "PREFERENCES":
                    area.tag_redraw()
        return outcome

    def cancel(self, context: bpy.types.Context) -> None:
        """Another file was opened, or Blender closes."""
        unregister()

    def _start(self) -> None:
        test_lines[:] = [(True, "Self-test: running; the first time it compiles for some seconds")]
        # What it prints is one line, which no pipe is too small for.
        type(self)._running = subprocess.Popen(
            own_command("doctor", "--self-test", "--json", "--device", chosen_device()),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            encoding="utf-8",
            errors="replace",
        )

    def _finish(self) -> set[str]:
        process = type(self)._running
        assert process is not None
        output, _ = process.communicate()
        type(self)._running = None
        lines = [line for line in output.splitlines() if line.startswith("{")]
        checks = json.loads(lines[-1]).get("checks", []) if lines else []
        test_lines[:] = [
            (check["passed"], f"{check['name'].capitalize()}, {check['seconds']:.1f} s: {check['text']}")
            for check in checks
        ] or [(False, f"The self-test ended with code {process.returncode}; run wrinkle doctor --self-test.")]
        works = all(passed for passed, _ in test_lines)
        self.report({"INFO" if works else "ERROR"}, f"Self-test: {'all works' if works else test_lines[-1][1]}")
        return {"FINISHED"}


classes = (WRINKLE_OT_self_test,)


def register() -> None:
    """Nothing runs yet."""


def unregister() -> None:
    """Take a running test down with the add-on."""
    if WRINKLE_OT_self_test._running is not None:
        WRINKLE_OT_self_test._running.kill()
        WRINKLE_OT_self_test._running.wait()
        WRINKLE_OT_self_test._running = None
