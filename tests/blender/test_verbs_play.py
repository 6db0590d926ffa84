"""The verbs that play a clip: synthesize, simulate, evaluate."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from fake_layout import draw
from small_character import TOLERANCE, Arm, Bumps, build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon.blender.panels.report import WRINKLE_PT_report
from wrinkle_synthesis.wrinkle_addon.pc2 import PointCache
from wrinkle_synthesis.wrinkle_addon.rig import Pose


@pytest.fixture
def poses() -> list[Pose]:
    return []


@pytest.fixture
def arm(database: Path, bumps: Bumps, poses: list[Pose]) -> Arm:
    """An arm that bends and lifts over frames 1 to 5."""
    empty_scene()
    arm = build_arm("", database)
    poses += arm.animate([{"elbow_L": [0.3 * k], "shoulder_L": [0.0, 0.1 * k, 0.0]} for k in range(5)])
    bpy.context.scene.frame_end = 5
    return arm


@pytest.fixture
def file(arm: Arm, tmp_path: Path) -> Path:
    return save(tmp_path / "arm.blend")


def save(path: Path) -> Path:
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


# --- synthesize ---------------------------------------------------------------------------------------------------


def test_a_cache_holds_every_frame_in_the_garments_own_space(
    wrinkle, arm: Arm, bumps: Bumps, poses: list[Pose], tmp_path: Path
) -> None:
    arm.armature.location = arm.sleeve.location = (0.3, 0.2, 0.1)
    arm.sleeve.wrinkles.body.location = arm.sleeve.location
    bpy.context.view_layer.update()
    expected = [arm.to_object_space(bumps.shape(pose)) for pose in poses]
    outcome = wrinkle("synthesize", save(tmp_path / "a.blend"), "--out", tmp_path / "a.pc2", "--json")
    assert outcome.result["frames"] == 5 and outcome.result["clamped_deg"] == {}
    cache = PointCache(tmp_path / "a.pc2")
    assert cache.start == 1
    np.testing.assert_allclose(cache.frames, expected, atol=TOLERANCE)


def test_a_character_that_was_scaled_after_the_bake_keeps_its_wrinkles(
    wrinkle, arm: Arm, bumps: Bumps, poses: list[Pose], tmp_path: Path
) -> None:
    expected = [arm.to_object_space(bumps.shape(pose)) for pose in poses]
    for ob in (arm.armature, arm.sleeve, arm.sleeve.wrinkles.body):
        ob.scale = (1.5, 1.5, 1.5)
    assert wrinkle("synthesize", save(tmp_path / "a.blend"), "--out", tmp_path / "a.pc2").code == 0
    np.testing.assert_allclose(PointCache(tmp_path / "a.pc2").frames, expected, atol=TOLERANCE)


def test_blender_reads_the_cache_without_the_addon(wrinkle, file: Path, tmp_path: Path) -> None:
    assert wrinkle("synthesize", file, "--out", tmp_path / "a.pc2", "--frames", "2:4").code == 0
    sleeve = bpy.data.objects["sleeve"]
    sleeve.modifiers.clear()
    modifier = sleeve.modifiers.new("Cache", "MESH_CACHE")
    modifier.cache_format, modifier.filepath, modifier.frame_start = "PC2", str(tmp_path / "a.pc2"), 2
    for frame in (2, 3, 4):
        bpy.context.scene.frame_set(frame)
        mesh = sleeve.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        shown = np.array([vertex.co for vertex in mesh.vertices])
        np.testing.assert_allclose(shown, PointCache(tmp_path / "a.pc2").frames[frame - 2], atol=1e-6)


def test_angles_beyond_the_samples_are_told(wrinkle, arm: Arm, tmp_path: Path) -> None:
    arm.animate([{"elbow_L": [np.radians(100.0)]}])
    outcome = wrinkle(
        "synthesize", save(tmp_path / "a.blend"), "--frames", "1:1", "--out", tmp_path / "a.pc2", "--json"
    )
    assert outcome.result["clamped_deg"]["elbow_L"] == pytest.approx(10.0, abs=0.1)


# --- simulate and evaluate ----------------------------------------------------------------------------------------


def test_a_simulated_clip_is_a_reference(wrinkle, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "s.pc2"
    outcome = wrinkle("simulate", file, "--fine", "--frames", "1:2", "--substeps", 2, "--pre-roll", 0.1, "--out", out)
    assert outcome.code == 0, outcome.errors
    result = wrinkle("evaluate", file, "--frames", "1:2", "--reference", out, "--json").result
    assert result["frame_count"] == 2 and set(result["rmse_mm"]) == {"skinning", "nearest", "paper", "ours"}


def test_a_synthesized_clip_is_what_evaluation_calls_ours(wrinkle, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.pc2"
    assert wrinkle("synthesize", file, "--out", out).code == 0
    result = wrinkle("evaluate", file, "--reference", out, "--plots", tmp_path / "plots", "--json").result
    # A cache holds single precision.
    assert result["max_mm"]["ours"] < 0.01 < result["max_mm"]["skinning"]
    assert all(Path(path).is_file() for path in result["plots"])


def test_a_kept_evaluation_is_told_and_drawn_by_the_panel(wrinkle, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.pc2"
    assert wrinkle("synthesize", file, "--out", out).code == 0
    result = wrinkle("evaluate", file, "--reference", out, "--keep", "--json").result
    bpy.ops.wm.open_mainfile(filepath=str(file))
    garment = next(ob for ob in bpy.data.objects if ob.wrinkles.armature is not None)
    bpy.context.view_layer.objects.active = garment
    garment.wrinkles.enabled = True
    bpy.context.view_layer.update()
    shown = draw(WRINKLE_PT_report)
    assert f"{result['rmse_mm']['skinning']:.2f} mm RMS" in shown.labels
    assert bpy.ops.wrinkle.plot_evaluation() == {"FINISHED"}
    assert {f"{garment.name} error", f"{garment.name} wrinkles"} <= set(bpy.data.images.keys())


def test_over_a_coarse_layer_ours_follows_it_in_evaluation_too(wrinkle, arm: Arm, tmp_path: Path) -> None:
    bpy.context.view_layer.objects.active = arm.sleeve
    bpy.ops.wrinkle.make_coarse_mesh(vertex_count=60)
    arm.sleeve.wrinkles.coarse_layer = "MESH"
    blown = arm.sleeve.wrinkles.coarse.modifiers.new("blow", "DISPLACE")
    blown.direction, blown.mid_level, blown.strength = "Z", 0.0, 0.05
    file, out = save(tmp_path / "a.blend"), tmp_path / "a.pc2"
    assert wrinkle("synthesize", file, "--out", out).code == 0
    result = wrinkle("evaluate", file, "--reference", out, "--json").result
    # A cache holds single precision; what does not follow is off by the blow.
    assert result["max_mm"]["ours"] < 0.01 and result["rmse_mm"]["skinning"] > 40.0


def test_equilibria_are_a_reference(wrinkle, file: Path) -> None:
    result = wrinkle("evaluate", file, "--frames", "1:5:4", "--json").result
    assert [frame["frame"] for frame in result["frames"]] == [1.0, 5.0]
    assert result["rmse_mm"]["skinning"] > 0.0


# --- refused ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("synthesize", "--frames", "5:1", "--out", "a.pc2"), "5:1 is empty"),
        (("synthesize", "--frames", "one", "--out", "a.pc2"), "FIRST:LAST"),
        (("synthesize", "--frames", "1:5:2", "--out", "a.pc2"), "holds every frame; leave the step out"),
        (("simulate", "--fine", "--out", "a.abc"), "saved as a .pc2 file"),
        (("synthesize", "--out", "far/a.pc2"), "There is no folder"),
        (("synthesize", "--out", "a.pc2", "--device", "cuda:77"), "no device 'cuda:77'"),
        (("synthesize", "--out", "a.pc2", "--database", "none.wrinkles"), "There is no database"),
        (("simulate", "--out", "a.pc2"), "add --fine"),
        (("evaluate", "--reference", "none.pc2"), "Cannot read the point cache"),
        (("evaluate", "--reference", "arm.blend"), "is not a PC2 point cache"),
        (("evaluate", "--plots", "arm.blend"), "Cannot write to the folder"),
    ],
)
def test_options_that_make_no_sense_are_said_in_one_sentence(
    wrinkle, file: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], sentence: str
) -> None:
    monkeypatch.chdir(file.parent)
    assert sentence in wrinkle(arguments[0], "arm.blend", *arguments[1:]).complaint
    assert not Path("a.pc2").exists()


def test_a_cache_that_does_not_fit_is_refused(wrinkle, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.pc2"
    wrinkle("synthesize", file, "--out", out, "--frames", "1:3")
    assert "holds frames 1 to 3, not 1 to 5" in wrinkle("evaluate", file, "--reference", out).complaint
    data = bytearray(out.read_bytes())
    data[16:20] = (120).to_bytes(4, "little")
    out.write_bytes(data)
    complaint = wrinkle("evaluate", file, "--reference", out, "--frames", "1:3").complaint
    assert "120 vertices a frame, the garment 360" in complaint


def other_topology(arm: Arm) -> None:
    arm.sleeve.data.vertices.add(1)


def other_rig(arm: Arm) -> None:
    bpy.context.view_layer.objects.active = arm.armature
    bpy.ops.object.mode_set(mode="EDIT")
    arm.armature.data.edit_bones["lower"].tail.z += 0.05
    bpy.ops.object.mode_set(mode="OBJECT")


def lost_bone(arm: Arm) -> None:
    arm.armature.data.bones["lower"].name = "forearm"


def other_garment(arm: Arm) -> None:
    arm.sleeve.name = "glove"
    arm.sleeve.data.vertices.add(1)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (other_topology, "topology of the garment 'sleeve' changed since the bake"),
        (other_rig, "changed since the bake: the bone 'lower' rests elsewhere"),
        (lost_bone, "changed since the bake: it has lost the bone 'lower'"),
        (other_garment, "'glove' was baked for 'sleeve', another mesh"),
    ],
)
def test_what_changed_since_the_bake_is_named(
    wrinkle, arm: Arm, tmp_path: Path, change: Callable[[Arm], None], sentence: str
) -> None:
    change(arm)
    file = save(tmp_path / "arm.blend")
    assert sentence in wrinkle("synthesize", file, "--out", tmp_path / "a.pc2").complaint
    assert sentence in wrinkle("evaluate", file).complaint


def test_a_damaged_database_is_named(wrinkle, file: Path, database: Path, tmp_path: Path) -> None:
    own = Path(shutil.copytree(database, tmp_path / "own.wrinkles"))
    sample = next(own.glob("elbow_L-1-*"))
    sample.write_bytes(sample.read_bytes()[:-9])
    arguments = ("synthesize", file, "--database", own, "--out", tmp_path / "a.pc2")
    assert "damaged or truncated" in wrinkle(*arguments).complaint
    sample.unlink()
    assert "is missing" in wrinkle(*arguments).complaint
    assert not (tmp_path / "a.pc2").exists()
