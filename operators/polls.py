"""What operators wait for, told where their buttons are greyed out."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.bake_process import running
from ..wrinkle_addon.blender.properties import active_garment


def has_garment(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """A garment that was set up is active, or its armature."""
    if active_garment(context) is None:
        operator.poll_message_set("Select a garment that was set up, or its armature")
        return False
    return True


def has_database(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """The active garment names a database."""
    if not has_garment(operator, context):
        return False
    garment = active_garment(context)
    assert garment is not None
    if not garment.wrinkles.database:
        operator.poll_message_set("Bake the garment first, or choose the folder of its database")
        return False
    return True


def is_idle(operator: type[bpy.types.Operator]) -> bool:
    """No bake runs behind the window."""
    if running:
        operator.poll_message_set("A bake is running; wait until it is done, or stop it")
        return False
    return True


def bakes(operator: type[bpy.types.Operator]) -> bool:
    """A bake runs behind the window."""
    if not running:
        operator.poll_message_set("No bake is running")
        return False
    return True
