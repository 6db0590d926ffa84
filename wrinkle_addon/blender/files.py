"""Opening a character's file, whatever its kind, and finding the armature in it."""

from __future__ import annotations

from pathlib import Path

import bpy

_IMPORTERS = {".glb": "io_scene_gltf2", ".gltf": "io_scene_gltf2", ".fbx": "io_scene_fbx"}


def open_character(path: str | Path) -> None:
    """Make a .blend, .glb, .gltf or .fbx file the open file; an imported one lies in an otherwise empty scene.

    Raises:
        ValueError: If the file is missing, of another kind, or cannot be read; one sentence.
    """
    import addon_utils  # The bpy wheel can find this only once bpy is imported.

    path = Path(path)
    if not path.is_file():
        raise ValueError(f"There is no file {path}.")
    kind = path.suffix.lower()
    try:
        if kind == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
        elif kind in _IMPORTERS:
            bpy.ops.wm.read_factory_settings(use_empty=True)
            addon_utils.enable(_IMPORTERS[kind])
            importer = bpy.ops.import_scene.fbx if kind == ".fbx" else bpy.ops.import_scene.gltf
            importer(filepath=str(path.resolve()))
        else:
            raise ValueError(f"{path.name} is no .blend, .glb, .gltf or .fbx file.")
    except RuntimeError as error:
        reason = " ".join(str(error).removeprefix("Error: ").split()).rstrip(".")
        raise ValueError(f"{path.name} could not be opened: {reason}.") from error


def choose_armature(name: str | None = None) -> bpy.types.Object:
    """The armature of the open file: the named one, or the only one.

    Raises:
        ValueError: If there is none, none of that name, or several and no name; one sentence that lists them.
    """
    armatures = [ob for ob in bpy.data.objects if ob.type == "ARMATURE" and ob.users_scene]
    names = ", ".join(sorted(ob.name for ob in armatures))
    if not armatures:
        raise ValueError("The file has no armature.")
    if name is not None:
        for ob in armatures:
            if ob.name == name:
                return ob
        raise ValueError(f"The file has no armature {name}; it has {names}.")
    if len(armatures) > 1:
        raise ValueError(f"The file has several armatures, {names}; name one.")
    return armatures[0]
