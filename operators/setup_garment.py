"""Set a garment up: weights, joints, settings."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.guess import guess_character
from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.setup import SetupResult
from ..wrinkle_addon.blender.setup import setup_garment as set_up


class WRINKLE_OT_setup_garment(bpy.types.Operator):
    """Make a garment ready: give it the body's weights and find the joints that will wrinkle it"""

    bl_idname = "wrinkle.setup_garment"
    bl_label = "Set Up Garment"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    garment: bpy.props.StringProperty(name="Garment", description="The mesh that is to wrinkle")
    body: bpy.props.StringProperty(name="Body", description="The mesh that the garment is worn on")
    armature: bpy.props.StringProperty(name="Armature", description="Left out, the one that moves the body")
    subdivide: bpy.props.IntProperty(
        name="Subdivide", default=-1, min=-1, soft_max=4, description="Levels; -1 for as many as fine folds need"
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Offer who wears what, as far as the selection tells."""
        guess = guess_character(context)
        for name, ob in (("garment", guess.garment), ("body", guess.body), ("armature", guess.armature)):
            setattr(self, name, ob.name if ob is not None else "")
        return context.window_manager.invoke_props_dialog(self, width=360)

    def draw(self, context: bpy.types.Context) -> None:
        for name, icon in (("garment", "MATCLOTH"), ("body", "MESH_DATA"), ("armature", "ARMATURE_DATA")):
            self.layout.prop_search(self, name, context.scene, "objects", icon=icon)
        self.layout.prop(self, "subdivide")

    def execute(self, context: bpy.types.Context) -> set[str]:
        objects = context.scene.objects
        garment, body = objects.get(self.garment), objects.get(self.body)
        armature = objects.get(self.armature)
        for name, ob in (("garment", garment), ("body", body)):
            if ob is None:
                self.report({"ERROR"}, f"Choose a {name}.")
                return {"CANCELLED"}
        try:
            with suspended():
                result = set_up(garment, body, armature, None if self.subdivide < 0 else self.subdivide)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        result.garment.wrinkles.notes = "\n".join(_notes(result))
        _select(context, result.garment)
        self.report({"INFO"}, f"{result.garment.name} has {len(result.joints)} joints: {', '.join(result.joints)}")
        return {"FINISHED"}


def _notes(result: SetupResult) -> list[str]:
    """Sentences on joints that were not found, with the bones that were considered, and on deceiving names."""
    notes = list(result.notes)
    for name, missing in result.search.missing.items():
        considered = f" Considered: {', '.join(missing.considered)}." if missing.considered else ""
        notes.append(f"{name}: {missing.reason}{considered}")
    return notes


def _select(context: bpy.types.Context, garment: bpy.types.Object) -> None:
    for ob in context.selected_objects:
        ob.select_set(False)
    garment.select_set(True)
    context.view_layer.objects.active = garment


classes = (WRINKLE_OT_setup_garment,)
