"""Files of characters: opening one, whatever its kind, its armature, saving it, and where its databases lie."""

from __future__ import annotations

from pathlib import Path

import bmesh
import bpy

from ..storage import make_folder

_IMPORTERS = {".glb": "io_scene_gltf2", ".gltf": "io_scene_gltf2", ".fbx": "io_scene_fbx"}


def open_character(path: str | Path) -> None:
    """Make a .blend, .glb, .gltf or .fbx file the open file; an imported one lies in an otherwise empty scene.

    Raises:
        ValueError: If the file is missing, of another kind, or cannot be read; one sentence.
    """
    import addon_utils  # The bpy wheel can find this only once bpy is imported.

    path = Path(path)
    if not path.is_file():
        raise ValueError(f"There is no file '{path}'.")
    kind = path.suffix.lower()
    try:
        if kind == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
        elif kind in _IMPORTERS:
            # Factory settings would switch the add-on off, and with it what is running here.
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            addon_utils.enable(_IMPORTERS[kind])
            if kind == ".fbx":
                bpy.ops.import_scene.fbx(filepath=str(path.resolve()))
            else:
                bpy.ops.import_scene.gltf(filepath=str(path.resolve()))
                for mesh in bpy.data.meshes:
                    _weld(mesh)
        else:
            raise ValueError(f"{path.name} is no .blend, .glb, .gltf or .fbx file.")
    except RuntimeError as error:
        raise ValueError(f"{path.name} could not be opened: {_reason(error)}.") from error


def _weld(mesh: bpy.types.Mesh) -> None:
    """Join vertices of open edges that lie in one place.

    The glTF format splits a mesh along every sharp edge and every seam of its texture; cloth would come apart there.
    """
    size = max((vertex.co.length for vertex in mesh.vertices), default=0.0)
    shape = bmesh.new()
    shape.from_mesh(mesh)
    open_vertices = [vertex for vertex in shape.verts if vertex.is_boundary]
    bmesh.ops.remove_doubles(shape, verts=open_vertices, dist=1e-6 * size)
    shape.to_mesh(mesh)
    shape.free()


def choose_armature(name: str | None = None) -> bpy.types.Object:
    """The armature of the open file: the named one, the only one, or the only one that moves a mesh: a generated Rigify
    rig lies beside its metarig, which moves none.

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
    moving = [ob for ob in armatures if _moves_a_mesh(ob)] or armatures
    if len(moving) > 1:
        raise ValueError(f"The file has several armatures, {names}; name one.")
    return moving[0]


def _moves_a_mesh(armature: bpy.types.Object) -> bool:
    return any(
        modifier.type == "ARMATURE" and modifier.object == armature
        for ob in bpy.data.objects
        if ob.type == "MESH" and ob.users_scene
        for modifier in ob.modifiers
    )


def check_output(path: Path, *suffixes: str) -> None:
    """See before any work that a file can be written.

    Raises:
        ValueError: If it is to be of another kind, or its folder is missing or cannot be written to; one sentence.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        kinds = " or ".join(filter(None, (", ".join(suffixes[:-1]), suffixes[-1])))
        raise ValueError(f"The result is saved as a {kinds} file, not as '{path.name}'.")
    folder = path.resolve().parent
    if not folder.is_dir():
        raise ValueError(f"There is no folder '{folder}' to write '{path.name}' in.")
    if path.is_dir():
        raise ValueError(f"'{path}' is a folder; name a file to write.")
    make_folder(folder)


def save_character(path: Path) -> None:
    """Save the open file as a .blend file.

    Raises:
        ValueError: If it cannot be written; one sentence.
    """
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()))
    except RuntimeError as error:
        raise ValueError(f"'{path.name}' could not be saved: {_reason(error)}.") from error


def database_folder(garment: bpy.types.Object) -> Path:
    """Folder of the garment's database.

    Raises:
        ValueError: If none is set, or it is relative to a file that was never saved.
    """
    path = garment.wrinkles.database
    if not path:
        raise ValueError(f"The garment '{garment.name}' has no database; choose a folder for it.")
    if path.startswith("//") and not bpy.data.filepath:
        raise ValueError("The database lies beside the file, and the file was never saved; save it first.")
    return Path(bpy.path.abspath(path))


def _reason(error: RuntimeError) -> str:
    """What Blender reported, on one line."""
    return " ".join(str(error).replace("Error: ", "").split()).rstrip(".")
