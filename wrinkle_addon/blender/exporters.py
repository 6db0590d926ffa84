"""A cached garment through Blender's own Alembic and USD exporters, where the running Blender has them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy

from ..storage import temporary_name
from .mesh_cache import add_cache
from .write import show_skinned

EXPORTERS = {".abc": "Alembic", ".usd": "USD", ".usdc": "USD", ".usda": "USD"}
"""Name of the exporter by the file's suffix."""


def check_exporter(path: Path) -> None:
    """See that this Blender can write such a file.

    Raises:
        ValueError: If it was built without; one sentence.
    """
    name = EXPORTERS[path.suffix.lower()]
    if not _is_built_in(name):
        raise ValueError(f"This Blender was built without {name}; write a .pc2 file, or use an official build.")


def export_garment(garment: bpy.types.Object, cache: Path, frames: range, out: Path, work: Path) -> None:
    """Export a garment as its modifiers show it, with a point cache in the place of the wrinkles; atomically.

    Neither the scene nor the garment is changed in the end. Geometry, UVs, colours and normals are written, of the
    garment alone; materials are not.

    Args:
        garment: The garment object.
        cache: PC2 file of the frames.
        frames: The frames to export.
        out: The .abc or .usd file.
        work: A folder on the same disk.

    Raises:
        ValueError: If the exporter fails; one sentence.
    """
    unfinished = temporary_name(work / "export").with_suffix(out.suffix.lower())
    with _cached(garment, cache, frames), _alone(garment, frames) as scene:
        try:
            with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
                _export(unfinished, frames)
            os.replace(unfinished, out)
        except (RuntimeError, OSError) as error:
            reason = " ".join(str(error).replace("Error: ", "").split()).rstrip(".")
            raise ValueError(f"'{out}' could not be written: {reason}.") from error


def _export(path: Path, frames: range) -> None:
    if EXPORTERS[path.suffix] == "Alembic":
        bpy.ops.wm.alembic_export(
            filepath=str(path),
            check_existing=False,
            start=frames.start,
            end=frames.stop - 1,
            apply_subdiv=True,
            vcolors=True,
            as_background_job=False,
        )
    else:
        # An armature that is exported takes the place of the mesh's own animation.
        bpy.ops.wm.usd_export(
            filepath=str(path),
            check_existing=False,
            export_animation=True,
            export_armatures=False,
            export_shapekeys=False,
            export_materials=False,
            export_subdivision="TESSELLATE",
        )


def _is_built_in(name: str) -> bool:
    return bool(getattr(bpy.app.build_options, name.lower(), False))


@contextmanager
def _cached(garment: bpy.types.Object, cache: Path, frames: range) -> Iterator[None]:
    """The garment playing a cache, and visible."""
    show_skinned(garment)
    before: dict[str, Any] = {name: getattr(garment, name) for name in ("hide_render", "hide_viewport")}
    known = set(garment.modifiers.keys())
    modifier = add_cache(garment, cache, frames.start)
    garment.hide_render = garment.hide_viewport = False
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(garment, name, value)
        if modifier.name not in known:
            garment.modifiers.remove(modifier)


@contextmanager
def _alone(garment: bpy.types.Object, frames: range) -> Iterator[bpy.types.Scene]:
    """A scene of these frames with nothing in it but the garment."""
    own, scene = bpy.context.scene, bpy.data.scenes.new("Wrinkles Export")
    try:
        scene.frame_start, scene.frame_end = frames.start, frames.stop - 1
        scene.render.fps, scene.render.fps_base = own.render.fps, own.render.fps_base
        for name in ("system", "scale_length", "length_unit"):
            setattr(scene.unit_settings, name, getattr(own.unit_settings, name))
        scene.collection.objects.link(garment)
        yield scene
    finally:
        bpy.data.scenes.remove(scene)
