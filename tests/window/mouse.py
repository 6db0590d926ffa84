"""A hand for the mouse and a camera for the screen, from inside a Blender whose window they are."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import bpy

Steps = Iterator[float]
"""Waits between what is done [s]; Blender draws and takes in events meanwhile."""

ROW = 11
"""Half the height of a button [pixels]."""
NEAR = 24
"""So many places around the last button are looked at first, and with patience."""


class Hand:
    """Works the sidebar of the largest 3D view, and takes pictures of the screen.

    Attributes:
        window: Blender's first window.

    Args:
        shots: Folder for pictures.
    """

    def __init__(self, shots: Path):
        self._shots = shots
        self._count = 0
        self._last = 10_000
        self.window = bpy.context.window_manager.windows[0]

    @property
    def area(self) -> bpy.types.Area:
        """The largest 3D view of the workspace that is shown; what became of it, if it shows something else now."""
        areas = self.window.screen.areas
        views = [area for area in areas if area.type == "VIEW_3D"]
        return max(views or areas, key=lambda area: area.width * area.height)

    def region(self, kind: str) -> bpy.types.Region:
        return next(region for region in self.area.regions if region.type == kind)

    def shoot(self, name: str, *, sidebar: bool = False) -> Steps:
        """Take a picture of the screen, or of the sidebar alone, numbered in order, the pointer out of the way."""
        self.point(2, 2)
        yield 0.6
        self._count += 1
        path = self._shots / f"{self._count:02}_{name}.png"
        part = []
        if sidebar:
            region = self.region("UI")
            top = self.window.height - region.y - region.height
            part = ["-crop", f"{region.width}x{region.height}+{region.x}+{top}", "+repage"]
        subprocess.run(["import", "-window", "root", *part, str(path)], check=True)

    def click(self, operator: str) -> Steps:
        """Click the sidebar's button of an operator, wherever it is; it must be there.

        Raises:
            AssertionError: If no place of the sidebar has it.
        """
        sidebar = self.region("UI")
        rows = range(sidebar.y + sidebar.height - 2 * ROW, sidebar.y, -ROW)
        places = [(share, y) for y in sorted(rows, key=lambda y: abs(y - self._last)) for share in (0.3, 0.75)]
        # A step's buttons come and go in one place, and while much is drawn Blender sees late what the pointer is over.
        for patience, some in ((0.25, places[:NEAR]), (0.06, places), (0.25, places)):
            for share, y in some:
                self.point(sidebar.x + int(share * sidebar.width), y)
                yield patience
                if self._button() == operator:
                    self._last = y
                    yield 0.2
                    self._do("click", "1")
                    yield 0.8
                    return
        raise AssertionError(f"The sidebar has no button of {operator}.")

    def press(self, key: str) -> Steps:
        """Press a key with the pointer over the 3D view."""
        view = self.region("WINDOW")
        self.point(view.x + view.width // 3, view.y + view.height // 3)
        yield 0.3
        self._do("key", key)
        yield 0.8

    def confirm(self) -> Steps:
        """Accept the dialog that is open under the pointer."""
        yield 0.8
        self._do("key", "Return")
        yield 0.8

    def point(self, x: int, y: int) -> None:
        """Move the pointer; as in Blender, y goes up."""
        self._do("mousemove", str(x), str(self.window.height - y))

    def _button(self) -> str:
        """The operator of the button under the pointer, as Blender itself tells it."""
        manager = bpy.context.window_manager
        manager.clipboard = ""
        with bpy.context.temp_override(window=self.window, area=self.area, region=self.region("UI")):
            if bpy.ops.ui.copy_python_command_button.poll():
                bpy.ops.ui.copy_python_command_button()
        return manager.clipboard.removeprefix("bpy.ops.").partition("(")[0]

    def _do(self, *command: str) -> None:
        subprocess.run(["xdotool", *command], check=True)
