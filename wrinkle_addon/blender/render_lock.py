"""Blender's Lock Interface: a render from the window plays on a thread of its own, beside which nothing else may."""

from __future__ import annotations

import bpy

from .preferences import PACKAGE


def lock_interface(garment: bpy.types.Object) -> None:
    """Lock the interface during renders of the garment's scenes, unless the preferences say not to."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    if addon is not None and not addon.preferences.lock_interface:
        return
    for scene in garment.users_scene:
        if not scene.render.use_lock_interface:
            scene.render.use_lock_interface = True


class WRINKLE_PT_render_lock(bpy.types.Panel):
    """Blender may crash while it renders from this window"""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Wrinkle"
    bl_label = "Rendering"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        scene = context.scene
        return not scene.render.use_lock_interface and any(
            ob.type == "MESH" and ob.wrinkles.enabled for ob in scene.objects
        )

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.label(text="Renders from this window", icon="ERROR")
        column.label(text="may stop Blender.", icon="BLANK1")
        self.layout.prop(context.scene.render, "use_lock_interface", toggle=True, icon="LOCKED")


classes = (WRINKLE_PT_render_lock,)
