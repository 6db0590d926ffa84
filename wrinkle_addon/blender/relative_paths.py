"""Paths beside the file when the file is saved elsewhere: Blender remaps its own, and leaves those of add-ons alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

PATHS = ("database", "coarse_cache")

_before: list[tuple[int, str, str]] = []
"""What was remapped for the save that is going on: the garment's session_uid, the property, its old value."""


def remap_paths(target: str) -> None:
    """Before a file is saved: what lies beside the open file is named from the folder that the new one goes to.

    A folder that is not there yet goes on meaning one beside the file, wherever that is.
    """
    _before.clear()
    if not bpy.data.filepath or not target or Path(target).parent == Path(bpy.data.filepath).parent:
        return
    for garment, name in _relative():
        old = getattr(garment.wrinkles, name)
        if not Path(bpy.path.abspath(old)).exists():
            continue
        try:
            new = bpy.path.relpath(bpy.path.abspath(old), start=str(Path(target).parent))
        except ValueError:
            new = bpy.path.abspath(old)  # Another drive on Windows.
        _before.append((garment.session_uid, name, old))
        setattr(garment.wrinkles, name, new)


def keep_paths(saved: str) -> None:
    """After saving to a path, empty if that failed: unless it is the open file now, that keeps its own paths."""
    if not saved or Path(saved) != Path(bpy.data.filepath):
        garments = {ob.session_uid: ob for ob in bpy.data.objects}
        for uid, name, old in _before:
            setattr(garments[uid].wrinkles, name, old)
    _before.clear()


@contextmanager
def absolute_paths() -> Iterator[None]:
    """For a copy of the file that works as if it lay where the open one does, whatever is there already."""
    before = [(garment, name, getattr(garment.wrinkles, name)) for garment, name in _relative() if bpy.data.filepath]
    for garment, name, path in before:
        setattr(garment.wrinkles, name, bpy.path.abspath(path))
    try:
        yield
    finally:
        for garment, name, path in before:
            setattr(garment.wrinkles, name, path)


def _relative() -> Iterator[tuple[bpy.types.Object, str]]:
    for ob in bpy.data.objects:
        if ob.type == "MESH" and ob.library is None and ob.wrinkles.armature is not None:
            for name in PATHS:
                if getattr(ob.wrinkles, name).startswith("//"):
                    yield ob, name
