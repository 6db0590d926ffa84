"""Garments worn over each other: as one mesh they keep their order, and are measured each by itself and together."""

from pathlib import Path

import numpy as np
import pytest
from cloth_shapes import raised, sheet, sphere
from wrinkle_synthesis.demo import outfit as outfits
from wrinkle_synthesis.demo.figures import FULL, SKINNING
from wrinkle_synthesis.demo.outfit import COARSE, WHOLE, Outfit, measure_outfit
from wrinkle_synthesis.wrinkle_addon.evaluate import OURS
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache, write_pc2

OUTER, INNER = sheet(4, 4, 0.2, 0.2), sheet(2, 2, 0.2, 0.2)
CORNER = len(OUTER[0])
"""Of the outfit, the inner garment's first vertex."""


@pytest.fixture
def outfit() -> Outfit:
    """Two sheets above a ball, in two frames."""
    ball, ball_faces = sphere(0.1)
    faces = np.concatenate([OUTER[1], INNER[1] + CORNER])
    return Outfit((7, 8), faces, {"coat": CORNER, "shirt": len(INNER[0])}, np.stack([ball, ball]), ball_faces)


@pytest.fixture
def full() -> np.ndarray:
    """The outer sheet 20 mm above the inner one; both are bent more in the second frame."""
    flat = np.concatenate([raised(OUTER[0], 0.16), raised(INNER[0], 0.14)])
    # In an exact plane rounding decides what passes through what.
    flat += 1e-4 * np.random.default_rng(1).standard_normal(flat.shape)
    return np.stack([flat + [0.0, 0.0, bend] * flat[:, :1] ** 2 for bend in (0.1, 0.5)])


def test_every_garment_has_its_vertices_and_triangles(outfit: Outfit) -> None:
    assert outfit.parts == {"coat": slice(0, 25), "shirt": slice(25, 34), WHOLE: slice(0, 34)}
    np.testing.assert_array_equal(outfit.faces_of(outfit.parts["coat"]), OUTER[1])
    np.testing.assert_array_equal(outfit.faces_of(outfit.parts["shirt"]), INNER[1])
    np.testing.assert_array_equal(outfit.faces_of(outfit.parts[WHOLE]), outfit.faces)


def test_garments_are_compared_each_by_itself_and_together(outfit: Outfit, full: np.ndarray) -> None:
    ours = full.copy()
    # 3 mm beside the full simulation, the outer garment alone.
    ours[:, :CORNER, 0] += 0.003
    found = measure_outfit(outfit, {SKINNING: ours, COARSE: ours, OURS: ours, FULL: full})
    assert [each["vertices"] for each in found.values()] == [25, 9, 34]
    errors = {name: each["rmse_mm"][OURS] for name, each in found.items()}
    assert errors == pytest.approx({"coat": 3.0, "shirt": 0.0, WHOLE: 3.0 * np.sqrt(25 / 34)})
    assert [frame["frame"] for frame in found[WHOLE]["frames"]] == [7, 8]
    assert found[WHOLE]["frames"][1]["rmse_mm"][SKINNING] == pytest.approx(errors[WHOLE])
    assert found["shirt"]["curvature"][OURS]["ratio"] == 1.0
    assert not any(found[WHOLE][what][OURS] for what in ("inside", "passing", "between"))


def test_what_passes_through_another_garment_or_the_body_is_told_of_whom(outfit: Outfit, full: np.ndarray) -> None:
    ours = full.copy()
    # The outer garment dips through the inner one, whose corner goes to the middle of the ball.
    ours[:, :CORNER, 2] -= 0.3 * (0.15 - ours[:, :CORNER, 0])
    ours[:, CORNER] = 0.0
    found = measure_outfit(outfit, {SKINNING: ours, COARSE: full, OURS: ours, FULL: full})
    assert found[WHOLE]["between"][OURS] == found[WHOLE]["passing"][OURS] > 0.0
    assert not any(found[garment]["passing"][OURS] for garment in outfit.counts)
    assert not any(found[WHOLE]["between"][made] for made in (COARSE, FULL))
    shares = [each["inside"][OURS] for each in found.values()]
    assert shares == pytest.approx([0.0, 1 / 9, 1 / 34]) and found[WHOLE]["inside"][FULL] == 0.0


def test_caches_of_garments_become_one_in_their_order(tmp_path: Path) -> None:
    parts = [tmp_path / "coat.pc2", tmp_path / "shirt.pc2"]
    shapes = [np.full((2, count, 3), count, np.float32) for count in (4, 3)]
    for part, frames in zip(parts, shapes, strict=True):
        write_pc2(part, frames.shape[1], 7.0, frames, 2)
    outfits.join_caches(parts, tmp_path / "outfit.pc2")
    made = PointCache(tmp_path / "outfit.pc2")
    assert made.start == 7.0 and not any(part.exists() for part in parts)
    np.testing.assert_array_equal(made.frames, np.concatenate(shapes, axis=1))


# --- in Blender ---------------------------------------------------------------------------------------------------


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A file with three garments, each with a vertex group of its own and one that all have."""
    bpy = pytest.importorskip("bpy")
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
    import bpy

    outfits.wear_over(scene, ("coat", "shirt", "vest"))
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    coat, shirt, vest = (bpy.data.objects[name].wrinkles for name in ("coat", "shirt", "vest"))
    assert [coat.worn_over.name, shirt.worn_over.name, vest.worn_over] == ["shirt", "vest", None]
    assert [coat.coarse_order, shirt.coarse_order, vest.coarse_order] == [2, 1, 0]


def test_joined_garments_keep_their_order_their_groups_and_their_materials(scene: Path, tmp_path: Path) -> None:
    import bpy

    outfits.join(scene, ("coat", "shirt", "vest"), tmp_path / "joined.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "joined.blend"))
    (garment,) = bpy.data.objects
    heights = [round(vertex.co.z) for vertex in garment.data.vertices]
    assert garment.name == "coat" and heights == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert {group.name for group in garment.vertex_groups} == {"bands", "coat", "shirt", "vest"}
    assert [material.name for material in garment.data.materials] == ["coat", "shirt", "vest"]
    assert [face.material_index for face in garment.data.polygons] == [0, 1, 2]
