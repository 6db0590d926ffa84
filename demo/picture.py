"""Pictures put side by side with their captions, and films made of pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

CAPTION, GAP = 0.075, 0.012
INK, PAPER = (40, 42, 46), (250, 250, 249)


def compose(
    rows: Sequence[Sequence[Path]], columns: Sequence[str], corners: Sequence[Sequence[str]], path: Path
) -> Path:
    """Put equally large pictures into a table.

    Args:
        rows: Pictures, row by row.
        columns: Caption above each column.
        corners: Caption in the corner of each picture; empty for none.
        path: Where the result goes: .png or .jpg.

    Raises:
        ValueError: If rows or captions do not match, or pictures differ in size.
    """
    from PIL import Image, ImageDraw

    if any(len(row) != len(columns) for row in (*rows, *corners)) or len(corners) != len(rows):
        raise ValueError("Every row needs a picture for each column, and a caption.")
    images = [[Image.open(picture).convert("RGB") for picture in row] for row in rows]
    sizes = {image.size for row in images for image in row}
    if len(sizes) != 1:
        raise ValueError(f"Pictures of different sizes cannot be put side by side: {sorted(sizes)}.")
    ((across, down),) = sizes
    caption, gap = round(CAPTION * across), max(2, round(GAP * across))
    sheet = Image.new("RGB", (len(columns) * (across + gap) - gap, caption + len(rows) * (down + gap) - gap), PAPER)
    draw = ImageDraw.Draw(sheet)
    font = _font(round(0.6 * caption))
    for k, text in enumerate(columns):
        draw.text((k * (across + gap) + across // 2, caption // 2), text, INK, font, anchor="mm")
    for r, row in enumerate(images):
        top = caption + r * (down + gap)
        for k, image in enumerate(row):
            left = k * (across + gap)
            sheet.paste(image, (left, top))
            draw.text((left + gap * 2, top + gap * 2), corners[r][k], INK, _font(round(0.45 * caption)))
    # Films need even sides.
    sheet = sheet.crop((0, 0, sheet.width - sheet.width % 2, sheet.height - sheet.height % 2))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, optimize=True)
    return path


def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)


def make_film(pictures: Sequence[Path], path: Path, frames_per_second: int, repeats: int = 1) -> Path:
    """Make an H.264 film of equally large pictures in one folder, with Blender's own encoder."""
    import bpy
    from PIL import Image

    from .rendering import quiet

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    shown = [picture for _ in range(repeats) for picture in pictures]
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strip = strips.new_image("film", filepath=str(shown[0].resolve()), channel=1, frame_start=1)
    for picture in shown[1:]:
        strip.elements.append(picture.name)
    render = scene.render
    scene.frame_start, scene.frame_end = 1, len(shown)
    with Image.open(shown[0]) as first:
        render.resolution_x, render.resolution_y = first.size
    render.resolution_percentage, render.fps = 100, frames_per_second
    # Pictures are shown as they are.
    scene.view_settings.view_transform = "Standard"
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "VIDEO"
    render.image_settings.file_format = "FFMPEG"
    render.ffmpeg.format, render.ffmpeg.codec, render.ffmpeg.constant_rate_factor = "MPEG4", "H264", "HIGH"
    render.filepath = str(path.resolve())
    with quiet():
        bpy.ops.render.render(animation=True)
    return path
