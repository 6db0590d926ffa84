"""The second door of the command line, ``blender --background FILE --command wrinkle VERB ...``, from both sides."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import bpy

from .preferences import PACKAGE

classes = ()
_handle: Any = None


def own_command(verb: str, *arguments: str) -> list[str]:
    """The command line that runs a verb in another process, through the door that this one came through."""
    verb_line = [verb, *arguments]
    if not Path(bpy.app.binary_path).stem.lower().startswith("blender"):
        return [sys.executable, "-m", "wrinkle_synthesis.wrinkle_addon.cli", *verb_line]
    # Named here, the add-on is there even where this Blender was started without the user's preferences.
    return [bpy.app.binary_path, "--background", "--addons", PACKAGE, "--command", "wrinkle", *verb_line]


def register() -> None:
    global _handle  # noqa: PLW0603 - Blender hands it out once and wants it back
    _handle = bpy.utils.register_cli_command("wrinkle", _run)


def unregister() -> None:
    bpy.utils.unregister_cli_command(_handle)


def _run(arguments: list[str]) -> int:
    from ..cli import main

    return main(arguments)
