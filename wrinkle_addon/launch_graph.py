"""Launches that follow each other, recorded once and replayed: no Python runs between them, and its lock is free."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import ModuleType

import warp as wp

from .threads import alone


class LaunchGraph:
    """The launches of an act. Recordings keep the arrays that they were made with.

    Warp records whatever any thread launches meanwhile. So as long as others are at work nothing is recorded, and the
    act runs as it is: slower, with the same bits.

    Args:
        act: Launches and copies alone; it must not ask other threads for help.
        modules: Whose kernels it launches: nothing may compile while recording.
        device: Where.
    """

    def __init__(self, act: Callable[[], object], modules: Sequence[ModuleType], device: wp.Device):
        self._act, self._modules, self._device = act, modules, device
        self._graph: wp.Graph | None = None

    def __call__(self) -> None:
        """Run the act."""
        self.prepare()
        if self._graph is None:
            self._act()
        else:
            wp.capture_launch(self._graph)

    def prepare(self) -> None:
        """Record the act if nobody else is at work, and do not run it; later acts may begin while others are."""
        if self._graph is None:
            self._graph = self._record()

    def _record(self) -> wp.Graph | None:
        for module in self._modules:
            wp.load_module(module, device=self._device)
        with alone() as free:
            if not free:
                return None
            with wp.ScopedCapture(device=self._device, force_module_load=False) as capture:
                self._act()
            return capture.graph
