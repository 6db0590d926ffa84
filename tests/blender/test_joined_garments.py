"""The demo's garments in a file: worn over each other, and joined to one mesh."""

from pathlib import Path

import bpy
import pytest
from wrinkle_synthesis.demo.outfit import join, wear_over


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A file with three garments, each with a vertex group of its own and one that all have."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    for number, name in enumerate(("coat", "shirt", "vest")):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([(0.0, 0.0, number), (1.0, 0.0, number), (0.0, 1.0, number)], [], [(0, 1, 2)])
        mesh.materials.append(bpy.data.materials.new(name))
        garment = bpy.data.objects.new(name, mesh)
        bpy.context.scene.collection.objects.link(garment)
        for group in ("bands", name):
            garment.vertex_groups.new(name=group).add([0], 1.0, "REPLACE")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    return tmp_path / "scene.blend"


def test_each_garment_is_worn_over_the_next_one(scene: Path) -> None:
    wear_over(scene, ("coat", "shirt", "vest"))
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    coat, shirt, vest = (bpy.data.objects[name].wrinkles for name in ("coat", "shirt", "vest"))
    assert [coat.worn_over.name, shirt.worn_over.name, vest.worn_over] == ["shirt", "vest", None]
    assert [coat.coarse_order, shirt.coarse_order, vest.coarse_order] == [2, 1, 0]


def test_joined_garments_keep_their_order_their_groups_and_their_materials(scene: Path, tmp_path: Path) -> None:
    join(scene, ("coat", "shirt", "vest"), tmp_path / "joined.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "joined.blend"))
    (garment,) = bpy.data.objects
    heights = [round(vertex.co.z) for vertex in garment.data.vertices]
    assert garment.name == "coat" and heights == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert {group.name for group in garment.vertex_groups} == {"bands", "coat", "shirt", "vest"}
    assert [material.name for material in garment.data.materials] == ["coat", "shirt", "vest"]
    assert [face.material_index for face in garment.data.polygons] == [0, 1, 2]
