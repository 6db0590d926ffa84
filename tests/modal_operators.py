"""Operators as a window drives them, where there is no window."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import bpy
import pytest

TIMER, ESCAPE, MOUSE = (SimpleNamespace(type=name) for name in ("TIMER", "ESC", "MOUSEMOVE"))
LONG = 300.0
"""What a process may take on a slow machine [s]."""


class Window:
    """What a modal operator needs of Blender's context, and what it was told."""

    def __init__(self) -> None:
        self.told: list[str | None] = []
        self.timers = 0
        self.window = object()
        self.workspace = SimpleNamespace(name="Layout", status_text_set=self.told.append)
        self.window_manager = SimpleNamespace(
            windows=[],
            event_timer_add=self._add_timer,
            event_timer_remove=self._remove_timer,
            modal_handler_add=lambda operator: True,
        )

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)

    def _add_timer(self, tick: float, window: object) -> object:
        self.timers += 1
        return object()

    def _remove_timer(self, timer: object) -> None:
        self.timers -= 1


class WithWindow:
    """The module bpy of a Blender that has a window."""

    app = SimpleNamespace(background=False)

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy, name)


def operator_of(
    cls: type[bpy.types.Operator], module: ModuleType, window: Window, patch: pytest.MonkeyPatch, **chosen: object
) -> SimpleNamespace:
    """An operator with these properties chosen, its reports among what the window was told."""
    patch.setattr(module, "bpy", WithWindow())
    group, name = cls.bl_idname.split(".")
    described = getattr(getattr(bpy.ops, group), name).get_rna_type().properties
    defaults = {each.identifier: each.default for each in described if hasattr(each, "default")}
    said = {name: getattr(cls, name, "") for name in ("doing", "stopping")}
    made = SimpleNamespace(**{**defaults, **chosen, **said})
    for attribute, value in vars(cls).items():
        if attribute.startswith("_") and value is None:
            setattr(made, attribute, None)
    made.properties = SimpleNamespace(is_property_set=lambda name: name in chosen)
    made.report = lambda kind, text: window.told.append(text)
    for base in reversed(cls.__mro__):
        for name, method in vars(base).items():
            if isinstance(method, FunctionType):
                setattr(made, name, partial(method, made))
    return made


def tick_until_done(
    operator: SimpleNamespace, window: Window, between: Callable[[], object] = lambda: None
) -> set[str]:
    """Send ticks as a window does until the operator has ended; ``between`` is called after each but the last."""
    end = time.monotonic() + LONG
    while (answer := operator.modal(window, TIMER)) in ({"PASS_THROUGH"}, {"RUNNING_MODAL"}):
        assert time.monotonic() < end
        between()
        time.sleep(0.05)
    return answer
