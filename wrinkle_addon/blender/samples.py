"""Single samples of a garment's database in the scene: found by angles, opened as meshes, written back (W08)."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np

from ..database import MANIFEST, WrinkleDatabase
from ..plan import JointGrid, Sample
from ..rig import FloatArray
from .correction_undo import note_versions, play_anew
from .files import database_folder
from .matching import check_database, match_rig
from .node_group import ATTRIBUTE


@lru_cache(maxsize=8)
def _opened(folder: Path, written: int, corrected: int) -> WrinkleDatabase:
    return WrinkleDatabase.open(folder)


def open_database(garment: bpy.types.Object) -> WrinkleDatabase:
    """The garment's database, read anew only when it was baked or corrected since.

    Raises:
        ValueError: If there is none, or it cannot be read; one sentence.
    """
    folder = database_folder(garment)
    corrected = max((path.stat().st_mtime_ns for path in folder.glob("corrections-*.json")), default=0)
    try:
        written = (folder / MANIFEST).stat().st_mtime_ns
    except OSError:
        written = 0
    return _opened(folder, written, corrected)


def nearest_node(grid: JointGrid, angles: FloatArray) -> tuple[int, ...]:
    """The node of a joint's grid that lies nearest to some angles [rad] in every degree of freedom."""
    return tuple(
        int(np.abs(np.array(values) - angle).argmin()) for values, angle in zip(grid.angles, angles, strict=False)
    )


def chosen_sample(garment: bpy.types.Object) -> tuple[WrinkleDatabase, Sample]:
    """The sample of the chosen joint that lies nearest to the ghost's angles.

    Raises:
        ValueError: If there is no such sample; one sentence that says why, and what to do.
    """
    settings = garment.wrinkles
    database = open_database(garment)
    if not 0 <= settings.active_joint < len(settings.joints):
        raise ValueError("Choose a joint in the list of joints.")
    name = settings.joints[settings.active_joint].name
    grid = database.header.plan.grid.get(name)
    if grid is None:
        raise ValueError(f"The database has no samples of {name}; choose another joint.")
    index = nearest_node(grid, np.array(settings.ghost.angles))
    if index == grid.rest:
        raise ValueError(f"Turn {name} with the angles: this is its rest pose, which is no sample.")
    return database, Sample(name, index)


def sample_positions(garment: bpy.types.Object, database: WrinkleDatabase, sample: Sample) -> FloatArray:
    """A sample in the armature's own space and units, shape [vertex_count, 3].

    Raises:
        ValueError: If garment or rig are not what was baked; one sentence.
    """
    scale = match_rig(garment.wrinkles.armature, database.header)
    return database.positions(sample) / scale


# --- as a mesh ----------------------------------------------------------------------------------------------------


def open_sample(garment: bpy.types.Object, database: WrinkleDatabase, sample: Sample) -> bpy.types.Object:
    """A new object of a sample's shape where the armature stands, for any of Blender's tools.

    Raises:
        ValueError: If garment or rig are not what was baked; one sentence.
    """
    check_database(garment, database.header)
    positions = sample_positions(garment, database, sample)
    mesh = garment.data.copy()
    mesh.name = f"{garment.name} {sample.name}"
    ob = bpy.data.objects.new(mesh.name, mesh)
    ob.shape_key_clear()
    if (played := mesh.attributes.get(ATTRIBUTE)) is not None:
        mesh.attributes.remove(played)
    mesh.attributes["position"].data.foreach_set("vector", positions.astype(np.float32).ravel())
    # Written this way, normals and bounds stay stale until a vertex is touched.
    mesh.vertices[0].co = mesh.vertices[0].co
    mesh.update()
    ob.matrix_world = garment.wrinkles.armature.matrix_world
    opened = ob.wrinkle_sample
    opened.garment, opened.joint, opened.key = garment, sample.joint, database.header.key
    opened.index = (*sample.index, 0, 0)[:3]
    for collection in garment.users_collection:
        collection.objects.link(ob)
    return ob


def find_opened(context: bpy.types.Context) -> bpy.types.Object | None:
    """The opened sample that is active, or else the one of the active garment."""
    active = context.object
    if active is None or active.wrinkle_sample.garment is not None:
        return active
    return next((ob for ob in context.scene.objects if ob.wrinkle_sample.garment == active), None)


def write_sample(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph, *, mirror: bool = False) -> list[Sample]:
    """Store an opened sample as it is shown now, with its modifiers and shape keys, as the sample's newest version.

    Args:
        mirror: Also store its mirror image, where the bake had one.

    Returns:
        The samples that were corrected.

    Raises:
        ValueError: If it does not fit the garment's database any more; one sentence.
    """
    opened = ob.wrinkle_sample
    garment = opened.garment
    database = open_database(garment)
    if database.header.key != opened.key:
        raise ValueError(f"The database was baked anew since '{ob.name}' was opened; open the sample again.")
    sample = Sample(opened.joint, tuple(opened.index[: database.header.plan.grid[opened.joint].joint.dof]))
    mesh = ob.evaluated_get(depsgraph).data
    count = database.header.garment.vertex_count
    if len(mesh.vertices) != count:
        raise ValueError(
            f"'{ob.name}' has {len(mesh.vertices)} vertices, the sample {count}; "
            "undo what changed their number, and use tools that move vertices only."
        )
    positions = np.empty(3 * count, np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions)
    if not np.isfinite(positions).all():
        raise ValueError(f"'{ob.name}' has vertices at positions that are not numbers; undo that change.")
    scale = match_rig(garment.wrinkles.armature, database.header)
    shapes = {sample: scale * positions.reshape(-1, 3).astype(np.float64)}
    if mirror and (found := database.mirrored(sample)) is not None:
        shapes[found[0]] = found[1].reflect_garment(shapes[sample])
    corrected = database
    for each, shape in shapes.items():
        corrected = corrected.corrected(each, shape)
    note_versions(garment, database.corrections, corrected.corrections, [each.name for each in shapes])
    play_anew(database.folder)
    return list(shapes)


def restore_sample(garment: bpy.types.Object) -> Sample:
    """Let the chosen sample count as baked again; its mirror image stays as it is.

    Raises:
        ValueError: If it was never corrected; one sentence.
    """
    database, sample = chosen_sample(garment)
    if database.corrections.path(sample.name) is None:
        raise ValueError(f"The sample {sample.name} is as it was baked.")
    restored = database.restored(sample)
    note_versions(garment, database.corrections, restored.corrections, [sample.name])
    play_anew(database.folder)
    return sample
