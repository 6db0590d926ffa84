"""A correction is undone on disk, too, and lies mirrored on the other side where the bake mirrors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import bpy
import numpy as np
import pytest
from dolls import doll
from fake_layout import draw
from figures import build_figure
from small_character import Arm, empty_scene, evaluated_positions
from wrinkle_synthesis.wrinkle_addon.bake import BakeJob, SampleShape, bake, finish
from wrinkle_synthesis.wrinkle_addon.blender import panels, playback
from wrinkle_synthesis.wrinkle_addon.blender.character import sampling_stage
from wrinkle_synthesis.wrinkle_addon.blender.correction_undo import version_after
from wrinkle_synthesis.wrinkle_addon.blender.samples import chosen_sample, open_database
from wrinkle_synthesis.wrinkle_addon.blender.setup import stage_job
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase, skin_frame
from wrinkle_synthesis.wrinkle_addon.folder_lock import FolderLock
from wrinkle_synthesis.wrinkle_addon.plan import Sample
from wrinkle_synthesis.wrinkle_addon.rig import pose_of_angles

HALF = Sample("elbow_L", (1,))


@pytest.fixture
def arm(undoable_arm: Arm) -> Arm:
    """A bent arm whose ghost is at the sample to be corrected."""
    undoable_arm.sleeve.wrinkles.ghost.angles = (np.radians(50.0), 0.0, 0.0)
    undoable_arm.bend(np.pi / 4)
    bpy.context.view_layer.update()
    return undoable_arm


def correct(height: float, **options: object) -> None:
    """Open the sample, lift it, write it back: one step of undo."""
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.wrinkle.open_sample() == {"FINISHED"}
    mesh = bpy.context.object.data
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions)
    positions[2::3] += height
    mesh.attributes["position"].data.foreach_set("vector", positions)
    mesh.update()
    bpy.ops.ed.undo_push(message="sculpted")
    assert bpy.ops.wrinkle.write_sample(**options) == {"FINISHED"}
    bpy.ops.ed.undo_push(message="written")


def version() -> int:
    """Which version of the sample counts on disk."""
    found = open_database(bpy.data.objects["sleeve"]).corrections.samples.get(HALF.name)
    return 0 if found is None else found.current


def shown() -> np.ndarray:
    bpy.context.view_layer.update()
    sleeve = bpy.data.objects["sleeve"]
    assert playback.status(sleeve).error == ""
    return evaluated_positions(sleeve)


def test_undo_and_redo_of_writing_back_reach_the_disk(arm: Arm) -> None:
    baked = shown()
    correct(0.02)
    first = shown()
    correct(0.01)
    second = shown()
    assert version() == 2 and np.abs(second - first).max() > 5e-3 and np.abs(first - baked).max() > 1e-2
    bpy.ops.ed.undo()
    assert version() == 1
    # The sculpted mesh is back, to go on with it.
    assert bpy.context.object.wrinkle_sample.garment is not None
    np.testing.assert_array_equal(shown(), first)
    for _ in range(3):
        bpy.ops.ed.undo()
    assert version() == 0
    np.testing.assert_array_equal(shown(), baked)
    for _ in range(4):
        bpy.ops.ed.redo()
    assert version() == 2
    np.testing.assert_array_equal(shown(), second)


def test_several_steps_at_once_go_back_to_what_was_before_all_of_them(arm: Arm) -> None:
    correct(0.02)
    correct(0.01)
    bpy.ops.ed.undo_history(item=1)
    assert version() == 0
    bpy.ops.ed.undo_history(item=5)
    assert version() == 2


def test_restoring_the_baked_sample_is_undone(arm: Arm) -> None:
    correct(0.02)
    corrected = shown()
    assert bpy.ops.wrinkle.restore_sample() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="restored")
    assert version() == 0
    bpy.ops.ed.undo()
    assert version() == 1
    np.testing.assert_array_equal(shown(), corrected)


def test_undo_of_something_else_leaves_the_corrections_alone(arm: Arm) -> None:
    correct(0.02)
    arm.armature.location.x = 0.5
    bpy.ops.ed.undo_push(message="moved")
    bpy.ops.ed.undo()
    assert version() == 1
    # Nor does it touch what somebody else has chosen meanwhile.
    open_database(bpy.data.objects["sleeve"]).restored(HALF)
    bpy.ops.ed.undo()
    assert version() == 0
    bpy.ops.ed.redo()
    # Redo goes from the version before to the correction, which is where the disk is.
    assert version() == 1


def test_a_folder_that_is_written_to_is_left_alone_and_that_is_said(arm: Arm) -> None:
    correct(0.02)
    with FolderLock(Path(arm.sleeve.wrinkles.database)):
        bpy.ops.ed.undo()
    assert version() == 1
    bpy.context.view_layer.objects.active = bpy.data.objects["sleeve"]
    assert "The correction could not be undone." in draw(panels.bake.WRINKLE_PT_samples).text


def test_a_version_that_somebody_else_chose_is_not_for_this_file_to_change() -> None:
    # Written once here, from 0 to 1: undone, redone.
    assert version_after((0, 1), None, 1) == 0
    assert version_after(None, (0, 1), 0) == 1
    # Written twice, both undone at once, or one of them.
    assert version_after((0, 2), None, 2) == 0
    assert version_after((0, 2), (0, 1), 2) == 1
    # Somebody else has chosen version 5 meanwhile.
    assert version_after((0, 1), None, 5) is None
    assert version_after((0, 2), (0, 1), 5) is None
    # Written here from that one to 6: undone, redone.
    assert version_after((0, 1), (5, 6), 5) == 6
    assert version_after((5, 6), (0, 1), 6) == 5


# --- the other side -----------------------------------------------------------------------------------------------


class Skinned:
    """Samples that are skinning alone."""

    def __init__(self, job: BakeJob):
        self._job = job

    def rest(self) -> SampleShape:
        return SampleShape(self._job.garment.positions, {})

    def batches(self, wanted: Sequence[Sample]) -> Iterator[dict[Sample, SampleShape]]:
        job = self._job
        for sample in wanted:
            pose = pose_of_angles(job.rig, job.header.joints, {sample.joint: job.plan.angles(sample)})
            yield {sample: SampleShape(skin_frame(job.rig, job.garment.weights, job.garment.positions, pose)[0], {})}


@pytest.fixture
def shirt(tmp_path: Path) -> bpy.types.Object:
    """A shirt whose elbows were baked, one of them as the mirror image of the other."""
    empty_scene()
    build_figure(doll(21, 8))
    assert bpy.ops.wrinkle.setup_garment(garment="shirt", body="body", subdivide=0) == {"FINISHED"}
    shirt = bpy.context.object
    settings = shirt.wrinkles
    settings.plan, settings.database = "PAPER", str(tmp_path / "shirt.wrinkles")
    for joint in settings.joints:
        joint.enabled = joint.name in ("elbow_L", "elbow_R")
    with sampling_stage(settings.armature, settings.body) as stage:
        job = stage_job(shirt, stage)
    assert job.plan.mirror is not None
    for _ in bake(job, Skinned(job), tmp_path / "shirt.wrinkles"):
        pass
    assert finish(job, tmp_path / "shirt.wrinkles")
    settings.active_joint = settings.joints.find("elbow_L")
    settings.ghost.angles = (np.radians(45.0), 0.0, 0.0)
    return shirt


def lifted(database: WrinkleDatabase, sample: Sample) -> float:
    """How far a sample lies over skinning, on the mean [m]."""
    pose = pose_of_angles(
        database.header.rig, database.header.joints, {sample.joint: database.header.plan.angles(sample)}
    )
    skinned = skin_frame(database.header.rig, database.header.garment.weights, database.rest, pose)[0]
    return float((database.positions(sample) - skinned)[:, 2].mean())


def test_a_correction_lies_mirrored_on_the_other_side(shirt: bpy.types.Object) -> None:
    assert "mirrors" in draw(panels.bake.WRINKLE_PT_samples).properties
    database, sample = chosen_sample(shirt)
    found = database.mirrored(sample)
    assert found is not None
    other, mirror = found
    correct(0.02)
    database = open_database(shirt)
    assert lifted(database, sample) == pytest.approx(0.02, abs=1e-4)
    image = mirror.reflect_garment(database.positions(sample))
    np.testing.assert_allclose(database.positions(other), image, atol=2.5e-4)
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo()
    database = open_database(bpy.data.objects["shirt"])
    assert database.corrections.path(sample.name) is None and database.corrections.path(other.name) is None


def test_one_side_alone_is_corrected_if_the_artist_wants_that(shirt: bpy.types.Object) -> None:
    database, sample = chosen_sample(shirt)
    found = database.mirrored(sample)
    assert found is not None
    correct(0.02, mirror=False)
    database = open_database(shirt)
    assert database.corrections.path(sample.name) is not None and database.corrections.path(found[0].name) is None
