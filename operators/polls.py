"""What operators wait for, told where their buttons are greyed out."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.file_process import BAKE, running
from ..wrinkle_addon.blender.files import database_folder
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.database import MANIFEST


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


def has_samples(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """The active garment's database is finished."""
    if not has_database(operator, context):
        return False
    garment = active_garment(context)
    assert garment is not None
    try:
        finished = (database_folder(garment) / MANIFEST).exists()
    except ValueError as error:
        operator.poll_message_set(str(error))
        return False
    if not finished:
        operator.poll_message_set("The database is not finished; bake the garment first")
    return finished


def is_idle(operator: type[bpy.types.Operator]) -> bool:
    """Nothing runs behind the window."""
    for process in running.values():
        operator.poll_message_set(f"{process.doing} is not done yet; wait for it, or stop it")
        return False
    return True


def is_busy(operator: type[bpy.types.Operator]) -> bool:
    """Something runs behind the window."""
    if not running:
        operator.poll_message_set("Nothing runs that could be stopped")
        return False
    return True


def bakes(operator: type[bpy.types.Operator]) -> bool:
    """A bake runs behind the window."""
    if not any(process.verb == BAKE for process in running.values()):
        operator.poll_message_set("No bake is running")
        return False
    return True
