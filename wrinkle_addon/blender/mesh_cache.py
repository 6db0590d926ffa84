"""Blender's own Mesh Cache modifier, playing a finished garment without the add-on."""

from __future__ import annotations

from pathlib import Path

import bpy

from .node_group import find_modifier, get_input

MODIFIER = "Wrinkles Cache"


def add_cache(garment: bpy.types.Object, cache: Path, first: int) -> bpy.types.MeshCacheModifier:
    """See to one Mesh Cache modifier that shows a point cache where the Wrinkles modifier showed wrinkles.

    Args:
        garment: The garment object.
        cache: The PC2 file; stored relative to the open file, if that was ever saved.
        first: Frame of its first sample.

    Raises:
        ValueError: If the garment is linked from another file; one sentence.
    """
    if garment.library is not None:
        raise ValueError(f"The garment '{garment.name}' is linked from another file; make a library override of it.")
    wrinkles = find_modifier(garment)
    modifier = garment.modifiers.get(MODIFIER)
    if modifier is None or modifier.type != "MESH_CACHE":
        modifier = garment.modifiers.new(MODIFIER, "MESH_CACHE")
        before = [i for i, other in enumerate(garment.modifiers) if other.type == "ARMATURE" or other == wrinkles]
        garment.modifiers.move(len(garment.modifiers) - 1, max(before, default=-1) + 1)
    assert isinstance(modifier, bpy.types.MeshCacheModifier)
    modifier.cache_format, modifier.filepath = "PC2", _file_path(cache)
    # Sample k is frame first + k, in the garment's own axes, whatever the frame rate.
    modifier.time_mode, modifier.play_mode, modifier.deform_mode = "FRAME", "SCENE", "OVERWRITE"
    modifier.frame_start, modifier.frame_scale, modifier.interpolation = first, 1.0, "LINEAR"
    modifier.forward_axis, modifier.up_axis, modifier.flip_axis = "POS_Y", "POS_Z", (False, False, False)
    modifier.factor = get_input(wrinkles, "Factor") if wrinkles is not None else 1.0
    modifier.vertex_group = garment.wrinkles.mask
    return modifier


def play_cache(garment: bpy.types.Object, cache: Path, first: int) -> None:
    """Let the garment play a point cache from now on, and no database; arguments as in :func:`add_cache`."""
    add_cache(garment, cache, first)
    garment.wrinkles.enabled = False


def _file_path(cache: Path) -> str:
    path = str(cache.resolve())
    if not bpy.data.filepath:
        return path
    try:
        return bpy.path.relpath(path)
    except ValueError:
        # Another drive on Windows.
        return path
