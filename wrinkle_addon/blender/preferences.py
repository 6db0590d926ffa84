"""What belongs to the machine rather than to a file."""

from __future__ import annotations

import bpy

from ..folder_verbs import choose_device

PACKAGE = __name__.removesuffix(".wrinkle_addon.blender.preferences")
"""The add-on's module: bl_ext.REPOSITORY.wrinkle_synthesis as an extension."""


class WrinklePreferences(bpy.types.AddonPreferences):
    """Preferences of the add-on."""

    bl_idname = PACKAGE

    device: bpy.props.StringProperty(
        name="Device", default="auto", description="What plays and bakes wrinkles: auto, cpu, cuda:0"
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "device")
        try:
            self.layout.label(text=f"Using {choose_device(self.device)}")
        except ValueError as error:
            self.layout.label(text=str(error), icon="ERROR")


def device_name() -> str:
    """The device asked for; "auto" where the package is used without being enabled as an add-on."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return addon.preferences.device if addon is not None else "auto"


classes = (WrinklePreferences,)
