"""The modifier that puts a garment where the played positions say: one Geometry Nodes group, shared by all garments."""

from __future__ import annotations

import re
from typing import Any

import bpy

MODIFIER = "Wrinkles"
VERSION = 3
"""Raised whenever the node group changes, so that an older one in a file is replaced."""
GROUP = f"{MODIFIER} {VERSION}"
ATTRIBUTE = "wrinkle_position"
"""Float vector on the garment's points: played positions in object space."""
NO_FRAME = -1.0e7
"""Stored frame that is no scene's: the modifier lets the skinned garment through."""

PRESENT = "wrinkle_addon_is_here"
"""Property of node groups that there is as long as the add-on is; in a file it leaves nothing."""
_LIVE = "Live"
"""The node that says so, by a driver: without the add-on Blender cannot find the property, and falls back to 0."""

_ANY_VERSION = re.compile(rf"{MODIFIER} \d+(\.\d+)?")
_INPUTS = (
    ("Factor", 1.0, "How far the garment goes from its skinned to its played shape"),
    ("Mask", 1.0, "The same for each vertex: a number, or a vertex group"),
    ("Frame", NO_FRAME, "Frame that the stored positions belong to"),
)
_OBJECTS = ("Coarse", "Body")
"""What a modifier names is evaluated with it, wherever it is hidden; naming is all that these inputs do."""


# --- the modifier -------------------------------------------------------------------------------------------------


def find_modifier(garment: bpy.types.Object) -> bpy.types.NodesModifier | None:
    """The garment's Wrinkles modifier, whatever it is called by now."""
    for modifier in garment.modifiers:
        if modifier.type == "NODES" and modifier.node_group and is_ours(modifier.node_group):
            return modifier
    return None


def add_modifier(garment: bpy.types.Object) -> bpy.types.NodesModifier:
    """See to one Wrinkles modifier on the garment: right after its Armature modifier, where a new one is placed."""
    modifier = find_modifier(garment)
    if modifier is None:
        modifier = garment.modifiers.new(MODIFIER, "NODES")
        armatures = [i for i, other in enumerate(garment.modifiers) if other.type == "ARMATURE"]
        garment.modifiers.move(len(garment.modifiers) - 1, armatures[-1] + 1 if armatures else 0)
    group = modifier.node_group
    if group is None or group.name != GROUP:
        modifier.node_group = wrinkles_group()
        set_input(modifier, "Frame", NO_FRAME)
    return modifier


def set_input(modifier: bpy.types.NodesModifier, name: str, value: float | bpy.types.Object | None) -> None:
    """Set an input of the modifier; the garment is evaluated anew only once it is tagged."""
    identifier = _identifier(modifier, name)
    if _inputs_are_properties():
        getattr(modifier.properties.inputs, identifier).value = value
    else:
        modifier[identifier] = value


def get_input(modifier: bpy.types.NodesModifier, name: str) -> Any:
    """Value of an input of the modifier."""
    identifier = _identifier(modifier, name)
    if _inputs_are_properties():
        return getattr(modifier.properties.inputs, identifier).value
    return modifier[identifier]


def shows_all(modifier: bpy.types.NodesModifier) -> bool:
    """Whether nothing of the skinned shape is left to see where played positions are shown: no factor, no mask."""
    identifier = _identifier(modifier, "Mask")
    if _inputs_are_properties():
        masked = getattr(modifier.properties.inputs, identifier).type == "ATTRIBUTE"
    else:
        masked = bool(modifier.get(f"{identifier}_use_attribute", False))
    return not masked and min(get_input(modifier, "Factor"), get_input(modifier, "Mask")) >= 1.0


def set_mask(modifier: bpy.types.NodesModifier, vertex_group: str) -> None:
    """Show wrinkles by the weights of a vertex group; everywhere for an empty name."""
    identifier = _identifier(modifier, "Mask")
    if _inputs_are_properties():
        socket = getattr(modifier.properties.inputs, identifier)
        socket.type = "ATTRIBUTE" if vertex_group else "VALUE"
        socket.attribute_name = vertex_group
    else:
        modifier[f"{identifier}_use_attribute"] = bool(vertex_group)
        modifier[f"{identifier}_attribute_name"] = vertex_group


def _inputs_are_properties() -> bool:
    """From Blender 5.2 on, inputs are RNA properties; before, custom properties of the modifier."""
    return "properties" in bpy.types.NodesModifier.bl_rna.properties


def _identifier(modifier: bpy.types.NodesModifier, name: str) -> str:
    for item in modifier.node_group.interface.items_tree:
        if item.name == name and item.in_out == "INPUT":
            return item.identifier
    raise ValueError(f"The node group '{modifier.node_group.name}' was changed: it has no input '{name}'; delete it.")


def is_ours(group: bpy.types.NodeTree) -> bool:
    """Whether a node group is one of this add-on's, of whatever version."""
    return _ANY_VERSION.fullmatch(group.name) is not None


# --- the node group -----------------------------------------------------------------------------------------------


def wrinkles_group() -> bpy.types.GeometryNodeTree:
    """The node group of this version: the file's own, or a new one."""
    return bpy.data.node_groups.get((GROUP, None)) or _build_group()


def _build_group() -> bpy.types.GeometryNodeTree:
    """Positions from the attribute, mixed in by Factor * Mask, where the attribute exists and Frame is the scene's.

    The scene's time node counts fractions of frames too, so that positions of one subframe are never shown in another.
    Without the add-on nothing is mixed in, whatever frame a file was written in: Blender's autosave asks nobody.
    """
    group = bpy.data.node_groups.new(GROUP, "GeometryNodeTree")
    group.is_modifier = True
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    for name, default, description in _INPUTS:
        socket = group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        socket.description, socket.default_value = description, default
        if name == "Frame":
            socket.hide_in_modifier = True
        else:
            socket.min_value, socket.max_value, socket.subtype = 0.0, 1.0, "FACTOR"
    for name in _OBJECTS:
        socket = group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketObject")
        socket.hide_in_modifier = True
    nodes, link = group.nodes, group.links.new
    inputs = nodes.new("NodeGroupInput").outputs
    played = nodes.new("GeometryNodeInputNamedAttribute")
    played.data_type = "FLOAT_VECTOR"
    played.inputs["Name"].default_value = ATTRIBUTE
    current = _math(group, "COMPARE", inputs["Frame"], nodes.new("GeometryNodeInputSceneTime").outputs["Frame"])
    shown = _math(group, "MULTIPLY", current, played.outputs["Exists"])
    wanted = _math(group, "MULTIPLY", inputs["Factor"], inputs["Mask"])
    weight = _math(group, "MULTIPLY", _math(group, "MULTIPLY", shown, _add_live(group)), wanted)
    mix = nodes.new("ShaderNodeMix")
    mix.data_type = "VECTOR"
    sockets = {socket.identifier: socket for socket in (*mix.inputs, *mix.outputs)}
    link(weight, sockets["Factor_Float"])
    link(nodes.new("GeometryNodeInputPosition").outputs["Position"], sockets["A_Vector"])
    link(played.outputs["Attribute"], sockets["B_Vector"])
    move = nodes.new("GeometryNodeSetPosition")
    link(inputs["Geometry"], move.inputs["Geometry"])
    link(weight, move.inputs["Selection"])
    link(sockets["Result_Vector"], move.inputs["Position"])
    link(move.outputs["Geometry"], nodes.new("NodeGroupOutput").inputs["Geometry"])
    for place, node in enumerate(nodes):
        node.location = (220 * (place % 4), -240 * (place // 4))
    return group


def _add_live(group: bpy.types.GeometryNodeTree) -> bpy.types.NodeSocket:
    """1 where the add-on is, 0 where the file is opened without it."""
    node = group.nodes.new("ShaderNodeValue")
    node.name = node.label = _LIVE
    driver = node.outputs[0].driver_add("default_value").driver
    # The value of its one variable: no Python, which many do not let files run.
    driver.type = "AVERAGE"
    target = driver.variables.new().targets[0]
    target.id_type, target.id, target.data_path = "NODETREE", group, PRESENT
    target.use_fallback_value, target.fallback_value = True, 0.0
    return node.outputs[0]


def wake_group(group: bpy.types.GeometryNodeTree) -> None:
    """See to it that the driver is looked at, if the file was opened before the add-on was there."""
    live = group.nodes.get(_LIVE)
    if live is not None and live.outputs[0].default_value < 1.0:
        group.update_tag()


def _math(
    group: bpy.types.GeometryNodeTree, operation: str, a: bpy.types.NodeSocket, b: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """A Math node over two sockets; COMPARE gives 1 where they differ by no more than 0.0001, else 0."""
    node = group.nodes.new("ShaderNodeMath")
    node.operation = operation
    node.inputs[2].default_value = 1.0e-4
    group.links.new(a, node.inputs[0])
    group.links.new(b, node.inputs[1])
    return node.outputs[0]
