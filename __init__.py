"""Wrinkle Synthesis: clothes that wrinkle with every pose of a rig.

This folder is the Blender extension and, at the same time, the Python package ``wrinkle_synthesis``. Importing it
needs no Blender; registering it does.
"""


def register() -> None:
    """Register properties, operators, panels, handlers and the command-line verbs with Blender."""
    from .operators import registration

    registration.register()


def unregister() -> None:
    """Undo :func:`register`, in reverse order."""
    from .operators import registration

    registration.unregister()
