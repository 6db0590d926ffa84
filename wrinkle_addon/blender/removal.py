"""Taking wrinkles off a garment: what setting up and playing changed is put back as it was, bit for bit."""

from __future__ import annotations

import bpy

from . import playback
from .armature import read_rig
from .influence_colours import PREFIX
from .mesh_cache import MODIFIER as CACHE_MODIFIER
from .node_group import ATTRIBUTE, find_modifier, is_ours
from .write import show_skinned


def remember_garment(garment: bpy.types.Object) -> bpy.types.Object:
    """The garment as it is, in an object that no scene shows; made before setting up changes weights and modifiers."""
    before = garment.wrinkles.before
    if before is None:
        before = garment.copy()
        before.data = garment.data.copy()
        before.name = f"{garment.name}.before"
        # A garment that settings were copied to is set up for the first time all the same.
        before.property_unset("wrinkles")
    return before


def remove_wrinkles(garment: bpy.types.Object) -> bpy.types.Object:
    """Take off everything that the add-on put on a garment; returns the artist's own garment.

    A fine copy goes, and its original is shown as it was. What the artist changed besides, in place, stays: geometry,
    materials, modifiers, groups that are not named like bones.

    Raises:
        ValueError: If the garment is linked, or its own weights no longer fit its mesh; one sentence.
    """
    if garment.library is not None:
        raise ValueError(f"The garment '{garment.name}' is linked from another file; remove its wrinkles there.")
    if garment.data.is_editmode:
        raise ValueError("Leave edit mode first.")
    settings = garment.wrinkles
    original, before = settings.original, settings.before
    if original is None and before is not None and len(before.data.vertices) != len(garment.data.vertices):
        raise ValueError(
            f"The mesh of '{garment.name}' has another number of vertices than before it was set up, so that its old "
            "weights do not fit; undo that change first."
        )
    show_skinned(garment)
    playback.forget(garment)
    opened = [ob for ob in bpy.data.objects if ob.wrinkle_sample.garment == garment]
    for ob in opened:
        _remove_object(ob)
    if original is not None:
        original.hide_viewport, original.hide_render = settings.original_hidden
        _remove_object(garment)
    else:
        _take_off(garment)
        if before is not None:
            _put_back_weights(garment, before)
            _put_back_armatures(garment, before)
            _remove_object(before)
        garment.property_unset("wrinkles")
    _remove_unused_groups()
    return original or garment


def _take_off(garment: bpy.types.Object) -> None:
    """Modifiers and attributes of ours."""
    for modifier in (find_modifier(garment), garment.modifiers.get(CACHE_MODIFIER)):
        if modifier is not None:
            garment.modifiers.remove(modifier)
    attributes = garment.data.attributes
    for name in [each.name for each in attributes if each.name == ATTRIBUTE or each.name.startswith(PREFIX)]:
        attributes.remove(attributes[name])


def _put_back_weights(garment: bpy.types.Object, before: bpy.types.Object) -> None:
    """The groups of bones as they were before; of other groups, what the artist has made of them since."""
    bones = set(read_rig(garment.wrinkles.armature).names) if garment.wrinkles.armature is not None else set()
    known = [group.name for group in before.vertex_groups]
    others = [group.name for group in garment.vertex_groups if group.name not in bones]
    active = garment.vertex_groups.active.name if garment.vertex_groups.active in others else None
    names = [name for name in known if name in bones or name in others]
    names += [name for name in others if name not in known]
    weights = {name: _weights(garment if name in others else before, name) for name in names}
    garment.vertex_groups.clear()
    for name in names:
        group = garment.vertex_groups.new(name=name)
        if name in known:
            group.lock_weight = before.vertex_groups[name].lock_weight
        for vertex, weight in weights[name].items():
            group.add([vertex], weight, "REPLACE")
    shown = active or (before.vertex_groups.active.name if before.vertex_groups.active else None)
    if shown in garment.vertex_groups:
        garment.vertex_groups.active = garment.vertex_groups[shown]


def _weights(ob: bpy.types.Object, name: str) -> dict[int, float]:
    index = ob.vertex_groups[name].index
    vertices = ob.data.vertices
    return {vertex.index: each.weight for vertex in vertices for each in vertex.groups if each.group == index}


def _put_back_armatures(garment: bpy.types.Object, before: bpy.types.Object) -> None:
    """Armature modifiers as they were before, where they were."""
    active = garment.modifiers.active
    shown = before.modifiers.active if active is None or active.type == "ARMATURE" else active
    name = None if shown is None else shown.name
    for modifier in [each for each in garment.modifiers if each.type == "ARMATURE"]:
        garment.modifiers.remove(modifier)
    for place, old in enumerate(before.modifiers):
        if old.type != "ARMATURE":
            continue
        new = garment.modifiers.new(old.name, "ARMATURE")
        for prop in old.bl_rna.properties:
            if not prop.is_readonly and prop.identifier != "name":
                setattr(new, prop.identifier, getattr(old, prop.identifier))
        garment.modifiers.move(len(garment.modifiers) - 1, min(place, len(garment.modifiers) - 1))
    if name in garment.modifiers:
        garment.modifiers.active = garment.modifiers[name]


def _remove_object(ob: bpy.types.Object) -> None:
    mesh = ob.data
    bpy.data.objects.remove(ob)
    if mesh.users == 0:
        bpy.data.meshes.remove(mesh)


def _remove_unused_groups() -> None:
    """Node groups of ours that nothing uses any more."""
    for group in [each for each in bpy.data.node_groups if is_ours(each) and each.users == 0]:
        bpy.data.node_groups.remove(group)
