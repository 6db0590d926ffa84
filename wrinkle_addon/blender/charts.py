"""Charts as images of the file, drawn with what Blender itself brings: it has no Matplotlib."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import blf
import bpy
import imbuf
import numpy as np
from numpy.typing import NDArray

from ..rig import FloatArray

WIDTH, HEIGHT = 1200, 480
LEFT, RIGHT, BOTTOM, TOP = 90, 20, 60, 50
"""Margins around the bars [pixels]."""
PAPER, INK, GRID = (0.11, 0.11, 0.12), (0.9, 0.9, 0.9), (0.25, 0.25, 0.27)
BAR, MARKED = (0.3, 0.55, 0.85), (0.9, 0.45, 0.2)
TEXT_SIZE = 15.0


@dataclass(frozen=True, eq=False)
class Chart:
    """Bars side by side.

    Attributes:
        title: With the unit.
        values: Heights, none negative, shape [bar_count].
        marked: Bars of the other colour, shape [bar_count].
        groups: Names below the bars, each with the number of its first bar.
    """

    title: str
    values: FloatArray
    marked: NDArray[np.bool_]
    groups: Sequence[tuple[int, str]] = field(default_factory=tuple)


def draw_charts(context: bpy.types.Context, garment: str, charts: Mapping[str, Chart]) -> Iterator[str]:
    """Draw charts of a garment one by one, the first into every open Image Editor; yields the images' names."""
    for number, (name, chart) in enumerate(charts.items()):
        image = show_chart(f"{garment} {name}", chart)
        for area in context.screen.areas if context.screen is not None and number == 0 else ():
            if area.type == "IMAGE_EDITOR":
                area.spaces.active.image = image
        yield image.name


def show_chart(name: str, chart: Chart) -> bpy.types.Image:
    """Draw a chart into an image of the file, packed; one of this name is drawn anew."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chart.png"
        _save(chart_pixels(chart), path)
        _write_text(chart, path)
        loaded = bpy.data.images.load(str(path))
        earlier = bpy.data.images.get(name)
        if earlier is not None:
            earlier.user_remap(loaded)
            bpy.data.images.remove(earlier)
        loaded.name = name
        loaded.pack()
    return loaded


def tick_step(highest: float) -> float:
    """A round number of which three to seven fit under a height."""
    power = 10.0 ** np.floor(np.log10(max(highest, 1e-30) / 3.0))
    return float(next(power * k for k in (1.0, 2.0, 5.0, 10.0) if highest / (power * k) <= 7.0))


def chart_pixels(chart: Chart) -> NDArray[np.float32]:
    """The chart without its words, the lowest row first, shape [HEIGHT, WIDTH, 4]."""
    pixels = np.empty((HEIGHT, WIDTH, 4), np.float32)
    pixels[:] = (*PAPER, 1.0)
    top = _top(chart)
    for value in _ticks(chart):
        pixels[_row(value, top), LEFT : WIDTH - RIGHT, :3] = GRID
    for number, value in enumerate(chart.values):
        left, right = _columns(chart, number)
        pixels[BOTTOM : _row(value, top) + 1, left:right, :3] = MARKED if chart.marked[number] else BAR
    pixels[BOTTOM - 1, LEFT : WIDTH - RIGHT, :3] = INK
    for first, _ in chart.groups:
        pixels[BOTTOM - 12 : BOTTOM, _columns(chart, first)[0], :3] = INK
    return pixels


def _top(chart: Chart) -> float:
    return max(float(chart.values.max(initial=0.0)) * 1.05, 1e-12)


def _ticks(chart: Chart) -> FloatArray:
    return np.arange(0.0, _top(chart), tick_step(_top(chart)))


def _row(value: float, top: float) -> int:
    return BOTTOM + int((HEIGHT - TOP - BOTTOM) * value / top)


def _columns(chart: Chart, number: int) -> tuple[int, int]:
    """First column of a bar, and the one after its last; a gap between two bars where there is room."""
    width = (WIDTH - LEFT - RIGHT) / max(len(chart.values), 1)
    left = LEFT + int(width * number)
    return left, max(LEFT + int(width * (number + 1)) - (1 if width > 3.0 else 0), left + 1)


def _save(pixels: NDArray[np.float32], path: Path) -> None:
    image = bpy.data.images.new("Wrinkle Chart", WIDTH, HEIGHT)
    try:
        image.pixels.foreach_set(pixels.ravel())
        image.filepath_raw, image.file_format = str(path), "PNG"
        image.save()
    finally:
        bpy.data.images.remove(image)


def _write_text(chart: Chart, path: Path) -> None:
    """Write the words over the picture; Blender before 4.5 cannot, and shows it without."""
    if not hasattr(blf, "bind_imbuf"):
        return
    buffer = imbuf.load(str(path))
    with blf.bind_imbuf(0, buffer):
        blf.size(0, TEXT_SIZE)
        blf.color(0, *INK, 1.0)
        _put(chart.title, LEFT, HEIGHT - TOP + 18)
        for value in _ticks(chart):
            _put(f"{value:.3g}", 12, _row(float(value), _top(chart)) - 5)
        end = 0.0
        for first, text in chart.groups:
            left = _columns(chart, first)[0] + 4
            if left >= end:
                _put(text, left, BOTTOM - 30)
                end = left + blf.dimensions(0, text)[0] + 8
    imbuf.write(buffer, filepath=str(path))


def _put(text: str, x: float, y: float) -> None:
    blf.position(0, x, y, 0.0)
    blf.draw_buffer(0, text)
