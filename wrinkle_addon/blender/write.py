"""Played positions onto the garment's mesh, where the Wrinkles modifier reads them."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from .node_group import ATTRIBUTE, NO_FRAME, add_modifier, find_modifier, get_input, set_input, wake_group
from .skinning_rest import wake_skinning


def make_writable(garment: bpy.types.Object) -> None:
    """See to it that the garment has a mesh of its own in this file.

    Overrides of one linked garment, and linked duplicates, share a mesh that cannot hold several shapes.

    Raises:
        ValueError: If the garment itself is linked from another file.
    """
    if garment.library is not None:
        raise ValueError(
            f"The garment '{garment.name}' is linked from another file and cannot be written to; "
            "make a library override of it."
        )
    mesh = garment.data
    if mesh.library is not None or mesh.users - mesh.use_fake_user > 1:
        garment.data = mesh.copy()


def show_positions(garment: bpy.types.Object, positions: NDArray[np.float32], frame: float) -> None:
    """Show positions in one frame, until others are shown.

    Args:
        garment: A garment with a mesh of its own, not in edit mode.
        positions: In the garment's object space, contiguous, shape [vertex_count, 3].
        frame: The scene's frame that they belong to, with its fraction.
    """
    mesh = garment.data
    attribute = mesh.attributes.get(ATTRIBUTE)
    if attribute is not None and (attribute.data_type, attribute.domain) != ("FLOAT_VECTOR", "POINT"):
        mesh.attributes.remove(attribute)
        attribute = None
    if attribute is None:
        attribute = mesh.attributes.new(ATTRIBUTE, "FLOAT_VECTOR", "POINT")
    attribute.data.foreach_set("vector", positions.reshape(-1))
    modifier = add_modifier(garment)
    set_input(modifier, "Frame", frame)
    wake_group(modifier.node_group)
    mesh.update()


def show_skinned(garment: bpy.types.Object) -> None:
    """Let the skinned garment through until positions are shown again."""
    wake_skinning(garment)
    modifier = find_modifier(garment)
    if modifier is not None and get_input(modifier, "Frame") != NO_FRAME:
        set_input(modifier, "Frame", NO_FRAME)
        garment.update_tag(refresh={"DATA"})
