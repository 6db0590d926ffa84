"""What the options of a verb name in the open file: objects, folders, frames."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import bpy

from .clip import parse_frames
from .files import database_folder, open_character


def open_file(options: argparse.Namespace) -> None:
    """Open the file that is named, or go on with the one that Blender opened.

    Raises:
        ValueError: If there is no file; Blender itself runs commands without one.
    """
    if options.file is None:
        open_path()
    else:
        open_character(options.file)


def open_path() -> Path:
    """Path of the file that Blender opened.

    Raises:
        ValueError: If there is none.
    """
    if not bpy.data.filepath:
        raise ValueError("No file is open; name a file that exists.")
    return Path(bpy.data.filepath)


def find_object(name: str, role: str) -> bpy.types.Object:
    """The object of this name.

    Raises:
        ValueError: If there is none; the sentence lists those there are.
    """
    ob = bpy.data.objects.get(name)
    if ob is None:
        kind, plural = ("ARMATURE", "armatures") if role == "armature" else ("MESH", "meshes")
        names = ", ".join(sorted(other.name for other in bpy.data.objects if other.type == kind)) or "none"
        raise ValueError(f"The file has no {role} '{name}'; its {plural}: {names}.")
    return ob


def find_garment(options: argparse.Namespace) -> bpy.types.Object:
    """The garment that is named, or its fine copy, or the only one in the file that was set up.

    Raises:
        ValueError: If there is no such garment, or it misses its body or its armature.
    """
    ready = [ob for ob in bpy.data.objects if ob.type == "MESH" and (ob.wrinkles.armature or ob.wrinkles.joints)]
    garment = _choose(ready, options.garment)
    settings = garment.wrinkles
    for role, ob in (("armature", settings.armature), ("body", settings.body)):
        if ob is None:
            raise ValueError(f"The garment '{garment.name}' has lost its {role}; set it up again.")
    return garment


def _choose(ready: list[bpy.types.Object], name: str | None) -> bpy.types.Object:
    if name is None:
        if len(ready) == 1:
            return ready[0]
        if not ready:
            raise ValueError("No garment in the file was set up; run setup first.")
        names = ", ".join(ob.name for ob in ready)
        raise ValueError(f"Several garments were set up, {names}; name one with --garment.")
    for ob in ready:
        if ob.name == name or (ob.wrinkles.original and ob.wrinkles.original.name == name):
            return ob
    find_object(name, "garment")
    raise ValueError(f"The garment '{name}' was not set up; run setup first.")


def find_database(options: argparse.Namespace, garment: bpy.types.Object) -> Path:
    """The database folder that is named, or the one that the garment remembers."""
    return options.database if options.database is not None else database_folder(garment)


def find_frames(options: argparse.Namespace, *, every: bool = False) -> list[int]:
    """The frames that are named, or the scene's own range.

    Args:
        every: Refuse to leave frames out: a point cache and a simulation go from one frame to the next.
    """
    scene = bpy.context.scene
    frames = parse_frames(options.frames or f"{scene.frame_start}:{scene.frame_end}")
    if every and len(frames) != frames[-1] - frames[0] + 1:
        raise ValueError(f"A point cache holds every frame; leave the step out of '{options.frames}'.")
    return frames


def say(text: str) -> None:
    """Progress, for people."""
    print(text, file=sys.stderr, flush=True)


def say_share(options: argparse.Namespace, share: float, text: str) -> None:
    """Progress, for people, or as an event for whoever started this process."""
    if options.progress == "json":
        say(json.dumps({"event": "step", "share": round(share, 4), "text": text}))
    else:
        say(text)
