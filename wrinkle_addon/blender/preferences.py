"""What belongs to the machine rather than to a file."""

from __future__ import annotations

import bpy
import warp as wp

from ..folder_verbs import choose_device
from ..kernel_cache import cache_folder
from ..machine_verbs import describe_devices, driver_version

PACKAGE = __name__.removesuffix(".wrinkle_addon.blender.preferences")
"""The add-on's module: bl_ext.REPOSITORY.wrinkle_synthesis as an extension."""

test_lines: list[tuple[bool, str]] = []
"""What the last self-test found: whether it went well, and a sentence."""


def _devices(preferences: WrinklePreferences, context: bpy.types.Context, edit_text: str) -> list[str]:
    """What the field offers while one types."""
    return ["auto", *map(str, wp.get_devices())]


class WrinklePreferences(bpy.types.AddonPreferences):
    """Preferences of the add-on."""

    bl_idname = PACKAGE

    device: bpy.props.StringProperty(
        name="Device",
        default="auto",
        description="What plays and bakes wrinkles: auto (the first graphics card, else the processor), cpu, cuda:0",
        search=_devices,
    )
    lock_interface: bpy.props.BoolProperty(
        name="Lock Interface in Renders",
        default=True,
        description="Turn Blender's Lock Interface on in scenes with wrinkles; without it, renders from the window may "
        "crash. Otherwise the sidebar offers it",
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "device")
        try:
            chosen = choose_device(self.device)
        except ValueError as error:
            layout.label(text=str(error), icon="ERROR")
            chosen = ""
        column = layout.column(align=True)
        for name, text in describe_devices().items():
            _line(column, name, text, "RADIOBUT_ON" if name == chosen else "RADIOBUT_OFF")
        column = layout.column(align=True)
        _line(column, "Driver", driver_version() or "No CUDA driver was found; the processor does all work")
        _line(column, "Warp", wp.config.version)
        folder = str(cache_folder())
        row = _line(column, "Kernels", folder)
        row.operator("wm.path_open", text="", icon="FILE_FOLDER").filepath = folder
        layout.prop(self, "lock_interface")
        layout.operator("wrinkle.self_test", icon="PLAY")
        for passed, text in test_lines:
            layout.label(text=text, icon="CHECKMARK" if passed else "ERROR")


def _line(column: bpy.types.UILayout, name: str, text: str, icon: str = "NONE") -> bpy.types.UILayout:
    """A name and what there is to say of it, as Blender lays out a property."""
    split = column.split(factor=0.4)
    left = split.row()
    left.alignment = "RIGHT"
    left.label(text=name)
    row = split.row()
    row.label(text=text, icon=icon)
    return row


def device_name() -> str:
    """The device asked for; "auto" where the package is used without being enabled as an add-on."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return addon.preferences.device if addon is not None else "auto"


def chosen_device() -> str:
    """The device that is used; the processor where the one that was asked for is not there."""
    try:
        return choose_device(device_name())
    except ValueError:
        return "cpu"


classes = (WrinklePreferences,)
