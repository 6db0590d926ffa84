"""Skinning that nobody sees: Armature modifiers are left out while the animation plays."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from .node_group import find_modifier, shows_all


@dataclass
class Animation:
    """Whether a window plays the animation: then a frame follows a frame, and each is played here."""

    plays: bool = False


_animation = Animation()


def let_skinning_rest(may: bool) -> None:
    """Whether garments go without their Armature modifiers where nobody sees them; all get them back if not."""
    _animation.plays = may
    if not may:
        for ob in bpy.data.objects:
            if ob.type == "MESH":
                wake_skinning(ob)


def let_rest(garment: bpy.types.Object, evaluated: bpy.types.Object) -> None:
    """Leave out the skinning of a garment that is shown in full while the animation plays."""
    (rest_skinning if _animation.plays and _is_covered(evaluated) else wake_skinning)(garment)


def _is_covered(evaluated: bpy.types.Object) -> bool:
    """Whether played positions leave nothing of the skinned shape to see; Factor and Mask may be animated."""
    modifier = find_modifier(evaluated)
    return modifier is not None and shows_all(modifier)


def rest_skinning(garment: bpy.types.Object) -> None:
    """Switch off the viewport's Armature modifier of a garment whose played positions cover all that it does.

    Blender would evaluate it twice a frame, before and after the positions are written: a third of a frame's time.
    One that the artist switched off is left alone.
    """
    armatures = [] if garment.wrinkles.skinning_rests else _armature_modifiers(garment)
    if armatures and all(armature.show_viewport for armature in armatures):
        garment.wrinkles.skinning_rests = True
        for armature in armatures:
            armature.show_viewport = False


def wake_skinning(garment: bpy.types.Object) -> None:
    """Switch on again what :func:`rest_skinning` switched off."""
    if garment.wrinkles.skinning_rests:
        garment.wrinkles.skinning_rests = False
        for armature in _armature_modifiers(garment):
            armature.show_viewport = True


def _armature_modifiers(garment: bpy.types.Object) -> list[bpy.types.ArmatureModifier]:
    return [modifier for modifier in garment.modifiers if modifier.type == "ARMATURE"]
