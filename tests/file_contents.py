"""Everything that the open file holds, as plain values: two files with the same contents are the same file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np

PASSING = {
    # Of this session or of the moment, not of the file.
    "session_uid", "bl_rna", "rna_type", "tag", "is_evaluated", "users", "original", "bound_box", "persistent_uid",
    "is_runtime_data", "particle_edit", "execution_time", "preview", "is_updated", "depsgraph", "is_missing",
    # Computed from the rest.
    "dimensions", "loop_triangles", "loop_triangle_polygons", "vertex_normals", "polygon_normals", "corner_normals",
    "normals_domain", "is_valid", "total_vert_sel", "total_edge_sel", "total_face_sel", "edge_keys",
}  # fmt: skip


def file_contents() -> dict[str, Any]:
    """Every value of every data-block, by its path from ``bpy.data``; data-blocks stand for themselves by name."""
    contents: dict[str, Any] = {}
    for collection in bpy.data.bl_rna.properties:
        if collection.type != "COLLECTION" or collection.identifier in ("window_managers", "workspaces", "screens"):
            continue
        for block in getattr(bpy.data, collection.identifier):
            path = f"{collection.identifier}[{block.name}]"
            contents |= dict(_values(path, block))
            if isinstance(block, bpy.types.Mesh):
                contents |= dict(_mesh(path, block))
    return contents


def _values(path: str, struct: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    for described in struct.bl_rna.properties:
        name = described.identifier
        if name in PASSING or name.startswith("is_property"):
            continue
        try:
            value = getattr(struct, name)
        except (AttributeError, RuntimeError, TypeError):
            continue
        where = f"{path}.{name}"
        if described.type == "POINTER":
            if value is None or isinstance(value, bpy.types.ID):
                yield where, None if value is None else (type(value).__name__, value.name)
            elif depth < 3:
                yield from _values(where, value, depth + 1)
        elif described.type == "COLLECTION":
            yield from _items(where, value, depth)
        elif getattr(described, "is_array", False):
            yield where, str(np.array(value).tolist())
        else:
            yield where, str(value)


def _items(path: str, items: Any, depth: int) -> Iterator[tuple[str, Any]]:
    """Elements one by one; the many of a mesh are told apart by :func:`_mesh`."""
    if len(items) > 64 or depth >= 3:
        yield path, len(items)
        return
    for number, item in enumerate(items):
        if isinstance(item, bpy.types.ID):
            yield f"{path}[{number}]", item.name
        else:
            yield from _values(f"{path}[{number}]", item, depth + 1)


def _mesh(path: str, mesh: bpy.types.Mesh) -> Iterator[tuple[str, Any]]:
    for attribute in mesh.attributes:
        field = {"FLOAT_VECTOR": ("vector", 3), "FLOAT_COLOR": ("color", 4), "BYTE_COLOR": ("color", 4)}
        name, width = field.get(attribute.data_type, ("value", 2 if "2" in attribute.data_type else 1))
        if attribute.data_type == "FLOAT2":
            name = "vector"
        kind = np.float32 if "FLOAT" in attribute.data_type or "COLOR" in attribute.data_type else np.int32
        values = np.empty(width * len(attribute.data), kind)
        attribute.data.foreach_get(name, values)
        yield f"{path}.attributes[{attribute.name}]", (attribute.data_type, attribute.domain, values.tobytes())
    groups = [[(each.group, each.weight) for each in vertex.groups] for vertex in mesh.vertices]
    yield f"{path}.weights", str(groups)
    corners = [tuple(face.vertices) for face in mesh.polygons]
    yield f"{path}.faces", str(corners)


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Paths of the values that are not the same in both."""
    missing = object()
    return sorted(
        path for path in before.keys() | after.keys() if before.get(path, missing) != after.get(path, missing)
    )
