"""A linked garment that can wrinkle here."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender import playback
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.blender.write import make_writable
from .polls import has_garment


class WRINKLE_OT_make_local_mesh(bpy.types.Operator):
    """Give the linked garment a mesh of its own in this file, for its wrinkles; all else stays linked"""

    bl_idname = "wrinkle.make_local_mesh"
    bl_label = "Make Mesh Local"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not has_garment(cls, context):
            return False
        garment = active_garment(context)
        assert garment is not None
        if garment.library is None and garment.data.library is None:
            cls.poll_message_set("The garment's mesh is local already")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        if garment.library is not None:
            name = garment.name
            # The whole character, so that the override's armature and body are overrides, too.
            whole = next((each for each in bpy.data.collections if name in each.all_objects and each.library), garment)
            if whole.override_hierarchy_create(context.scene, context.view_layer) is None:
                self.report({"ERROR"}, f"No library override of '{name}' could be made.")
                return {"CANCELLED"}
            _replace(context.scene, whole)
            garment = next(ob for ob in bpy.data.objects if ob.name == name and ob.library is None)
            context.view_layer.objects.active = garment
        make_writable(garment)
        playback.forget(garment)
        garment.update_tag()
        return {"FINISHED"}


def _replace(scene: bpy.types.Scene, linked: bpy.types.Collection | bpy.types.Object) -> None:
    """Take what the override stands for out of the scene."""
    for parent in (scene.collection, *scene.collection.children_recursive):
        if parent.library is None:
            within = parent.children if isinstance(linked, bpy.types.Collection) else parent.objects
            if linked in within.values():
                within.unlink(linked)


classes = (WRINKLE_OT_make_local_mesh,)
