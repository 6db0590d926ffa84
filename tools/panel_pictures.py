"""Cut the pictures of docs/panel.md out of the screenshots that `make window` has left in build/window."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
SHOTS, PICTURES = ROOT / "build" / "window", ROOT / "docs" / "images" / "panel"
PANELS = ("Character", "Joints", "Plan", "Bake", "Play", "Coarse Layer", "Cache", "Export", "Report")
CUTS = {
    "path": ("sidebar_played", "Character", "Report"),
    "character": ("sidebar_checked", "Character", "Character"),
    "joints": ("sidebar_played", "Joints", "Joints"),
    "plan": ("sidebar_later_steps", "Plan", "Plan"),
    "bake": ("sidebar_baking", "Bake", "Bake"),
    "samples": ("sidebar_later_steps", "Bake", "Bake"),
    "play": ("sidebar_played", "Play", "Play"),
    "coarse_layer": ("sidebar_later_steps", "Coarse Layer", "Coarse Layer"),
    "cache": ("sidebar_later_steps", "Cache", "Export"),
    "report": ("sidebar_later_steps", "Report", "Report"),
}
"""For each picture the screenshot that it is cut out of, its first panel and its last."""

BOXES = {
    "set_up": ("setup_dialog", (502, 144, 890, 326)),
    "preferences": ("preferences", (177, 94, 1041, 592)),
    "ghost": ("ghost", (60, 640, 750, 1140)),
}
"""For each other picture the screenshot of the whole window, and where it lies there: left, top, right, bottom."""

GAP = 66.0
"""Between two panels there is nothing but the sidebar's ground, which is darker than this [of 255]."""
LEFT, RIGHT = 9, 30
"""What lies in the sidebar beside its panels: a margin, and the tabs [pixels]."""
STRIP = 15
"""Less than any panel's height, more than what lies between two [pixels]."""


def main() -> None:
    for picture, (name, first, last) in CUTS.items():
        shot = screenshot(name)
        rows = panel_rows(np.asarray(shot, np.float64)[:, LEFT + 2 : shot.width - RIGHT])
        if len(rows) < len(PANELS):
            sys.exit(f"panel_pictures: {name} shows {len(rows)} panels of {len(PANELS)}.")
        top, bottom = rows[PANELS.index(first)][0], rows[PANELS.index(last)][1]
        save(shot.crop((LEFT, top, shot.width - RIGHT, bottom)), picture)
    for picture, (name, box) in BOXES.items():
        save(screenshot(name).crop(box), picture)


def screenshot(name: str) -> Image.Image:
    return Image.open(next(SHOTS.glob(f"[0-9][0-9]_{name}.png"))).convert("RGB")


def save(image: Image.Image, picture: str) -> None:
    image.save(PICTURES / f"{picture}.png", optimize=True)


def panel_rows(pixels: np.ndarray) -> list[tuple[int, int]]:
    """First row of each panel and the row after its last, from the pixels of a sidebar, shape [height, width, 3]; what
    lies below them counts as one more."""
    is_gap = (np.ptp(pixels, axis=1).max(1) <= 12.0) & (pixels.mean((1, 2)) < GAP)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], is_gap, [True]]).astype(np.int8)))
    # Above each panel lies a strip that a panel is dragged over.
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a > STRIP]


if __name__ == "__main__":
    main()
