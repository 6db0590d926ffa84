"""The second door of the command line: ``blender --background FILE --command wrinkle VERB ...``."""

from __future__ import annotations

from typing import Any

import bpy

classes = ()
_handle: Any = None


def register() -> None:
    global _handle  # noqa: PLW0603 - Blender hands it out once and wants it back
    _handle = bpy.utils.register_cli_command("wrinkle", _run)


def unregister() -> None:
    bpy.utils.unregister_cli_command(_handle)


def _run(arguments: list[str]) -> int:
    from ..cli import main

    return main(arguments)
