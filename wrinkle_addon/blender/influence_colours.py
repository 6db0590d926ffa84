"""Influence maps of joints as colour attributes of a garment's mesh."""

from __future__ import annotations

from collections.abc import Mapping

import bpy

from ..influence import influence_colours, scaled_influence
from ..rig import FloatArray

PREFIX = "influence_"
"""Before the joint's name in the name of its colour attribute."""


def paint_influence(garment: bpy.types.Object, influence: Mapping[str, FloatArray], shown: str) -> None:
    """Store influence maps on the garment's points; each is scaled by itself, from dark blue to red.

    Args:
        garment: A garment with a mesh of its own.
        influence: For each joint, shape [vertex_count].
        shown: The joint whose map becomes the mesh's active colour.
    """
    colours = garment.data.color_attributes
    for joint, values in influence.items():
        name = PREFIX + joint
        attribute = colours.get(name)
        if attribute is not None and (attribute.data_type, attribute.domain) != ("FLOAT_COLOR", "POINT"):
            colours.remove(attribute)
            attribute = None
        if attribute is None:
            attribute = colours.new(name, "FLOAT_COLOR", "POINT")
        attribute.data.foreach_set("color", influence_colours(scaled_influence(values)).ravel())
    colours.active_color = colours[PREFIX + shown]
    garment.data.update()
