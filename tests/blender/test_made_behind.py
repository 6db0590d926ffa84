"""A window never stands still for a database: it is bound in a thread, and the garment shows its skin until it is."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from modal_operators import ESCAPE, MOUSE, TIMER, Window, operator_of, tick_until_done
from small_character import TOLERANCE, Arm, Bumps, build_arm, empty_scene, evaluated_positions
from wrinkle_synthesis.operators import check_garment, make_coarse_mesh
from wrinkle_synthesis.operators.check_garment import WRINKLE_OT_check_garment
from wrinkle_synthesis.operators.make_coarse_mesh import WRINKLE_OT_make_coarse_mesh
from wrinkle_synthesis.wrinkle_addon.blender import made_behind, playback
from wrinkle_synthesis.wrinkle_addon.blender.inspection import findings_of
from wrinkle_synthesis.wrinkle_addon.blender.node_group import find_modifier
from wrinkle_synthesis.wrinkle_addon.rig import Pose

PATIENCE = 60.0
"""How long a busy machine may take to bind the small arm [s]."""


@pytest.fixture
def arm(database: Path, bumps: Bumps, monkeypatch: pytest.MonkeyPatch) -> Arm:
    """An arm in a Blender that goes on as one with a window does."""
    empty_scene()
    arm = build_arm("", database)
    monkeypatch.setattr(made_behind, "_waits", lambda depsgraph: depsgraph.mode == "RENDER")
    playback.forget_all()
    return arm


@pytest.fixture
def held() -> Iterator[threading.Event]:
    """Nothing is made before this is set."""
    go_on = threading.Event()
    made_behind._maker.submit(go_on.wait)
    yield go_on
    go_on.set()


def bend(arm: Arm, angle: float) -> Pose:
    """Pose the arm, and let Blender and its handlers take it in."""
    pose = arm.bend(angle)
    bpy.context.view_layer.update()
    return pose


def is_skinned(arm: Arm) -> bool:
    modifier = find_modifier(arm.sleeve)
    if modifier is None:
        return True
    positions, modifier.show_viewport = evaluated_positions(arm.sleeve), False
    skinned, modifier.show_viewport = evaluated_positions(arm.sleeve), True
    return bool((positions == skinned).all())


def wait(arm: Arm) -> int:
    """Until the sleeve plays, as Blender's timers would; how often something had to be waited for."""
    until, rounds = time.monotonic() + PATIENCE, 0
    while playback.status(arm.sleeve).waits:
        rounds += 1
        while not all(made.done() for made in made_behind._making):
            assert time.monotonic() < until
            time.sleep(0.01)
        made_behind.look()
        bpy.context.view_layer.update()
    assert made_behind.look() is None
    return rounds


def test_the_garment_is_skinned_until_its_database_is_bound(arm: Arm, bumps: Bumps, held: threading.Event) -> None:
    bend(arm, 1.0)
    status = playback.status(arm.sleeve)
    assert status.waits and not status.plays and not status.error and is_skinned(arm)
    bend(arm, 0.5)
    assert len(made_behind._making) == 1, "One database is bound once."
    pose = bend(arm, 1.0)
    held.set()
    assert wait(arm) >= 1
    assert playback.status(arm.sleeve).plays and not playback.status(arm.sleeve).error
    np.testing.assert_allclose(evaluated_positions(arm.sleeve), arm.to_object_space(bumps.shape(pose)), atol=TOLERANCE)


def test_what_is_shown_has_the_bits_that_a_background_process_writes(
    arm: Arm, held: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_coarse(arm)
    bend(arm, 1.0)
    held.set()
    # The database, then the coarse mesh if that is not bound at once.
    assert wait(arm) >= 1
    in_window = evaluated_positions(arm.sleeve)
    monkeypatch.setattr(made_behind, "_waits", lambda depsgraph: True)
    playback.forget_all()
    bend(arm, 1.0)
    assert not playback.status(arm.sleeve).waits
    np.testing.assert_array_equal(evaluated_positions(arm.sleeve), in_window)


def make_coarse(arm: Arm) -> None:
    bpy.context.view_layer.objects.active = arm.sleeve
    assert bpy.ops.wrinkle.make_coarse_mesh(vertex_count=60) == {"FINISHED"}
    arm.sleeve.wrinkles.coarse_layer = "MESH"


def test_a_render_waits(arm: Arm, held: threading.Event) -> None:
    bend(arm, 1.0)
    assert playback.status(arm.sleeve).waits
    bpy.context.scene.render.engine = "BLENDER_WORKBENCH"
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 8
    bpy.context.scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    bpy.context.scene.collection.objects.link(bpy.context.scene.camera)
    threading.Timer(0.2, held.set).start()
    bpy.ops.render.render()
    assert playback.status(arm.sleeve).plays


def test_what_cannot_be_bound_is_told_as_a_sentence_as_ever(arm: Arm, tmp_path: Path) -> None:
    arm.sleeve.wrinkles.database = str(tmp_path / "none.wrinkles")
    bend(arm, 1.0)
    wait(arm)
    assert str(tmp_path) in playback.status(arm.sleeve).error and is_skinned(arm)


def test_what_was_begun_for_another_file_is_dropped(arm: Arm, held: threading.Event) -> None:
    bend(arm, 1.0)
    playback.forget_all()
    held.set()
    arm.sleeve.wrinkles.enabled = False
    while not all(made.done() for made in made_behind._making):
        time.sleep(0.01)
    made_behind.look()
    bpy.context.view_layer.update()
    assert playback.status(arm.sleeve).player is None and is_skinned(arm)


# --- the check ----------------------------------------------------------------------------------------------------


def check_behind(arm: Arm, window: Window, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    bpy.context.view_layer.objects.active = arm.sleeve
    operator = operator_of(WRINKLE_OT_check_garment, check_garment, window, monkeypatch)
    assert operator.invoke(window, None) == {"RUNNING_MODAL"}
    return operator


@pytest.mark.parametrize("problem", ["", "gone bone", "edit mode"])
def test_a_garment_is_checked_behind_the_window_as_at_once(
    arm: Arm, held: threading.Event, monkeypatch: pytest.MonkeyPatch, problem: str
) -> None:
    if problem == "gone bone":
        joint = arm.sleeve.wrinkles.joints[0]
        joint.definition = joint.definition.replace(arm.rig.names[-1], "none")
    bpy.context.view_layer.objects.active = arm.sleeve
    if problem == "edit mode":
        bpy.ops.object.mode_set(mode="EDIT")
    window = Window()
    operator = check_behind(arm, window, monkeypatch)
    assert operator.modal(window, TIMER) == {"PASS_THROUGH"} and findings_of(arm.sleeve) is None
    held.set()
    assert tick_until_done(operator, window) == {"FINISHED"} and window.timers == 0
    behind = findings_of(arm.sleeve)
    assert behind is not None and any(finding.stops for finding in behind) == bool(problem)
    assert bpy.ops.wrinkle.check_garment() == {"FINISHED"}
    assert findings_of(arm.sleeve) == behind


def test_a_garment_that_changes_while_it_is_checked_is_to_be_checked_again(
    arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = Window()
    operator = check_behind(arm, window, monkeypatch)
    arm.sleeve.wrinkles.body = None
    assert tick_until_done(operator, window) == {"CANCELLED"}
    assert "changed while it was checked" in window.told[-1] and findings_of(arm.sleeve) is None


# --- the coarse mesh ----------------------------------------------------------------------------------------------


def test_a_coarse_mesh_is_made_behind_the_window(
    arm: Arm, held: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_coarse(arm)
    at_once = np.array([vertex.co for vertex in arm.sleeve.wrinkles.coarse.data.vertices])
    arm.sleeve.wrinkles.enabled = False
    window = Window()
    operator = operator_of(WRINKLE_OT_make_coarse_mesh, make_coarse_mesh, window, monkeypatch, vertex_count=60)
    assert operator.invoke(window, None) == {"RUNNING_MODAL"}
    for event in (MOUSE, TIMER):
        assert operator.modal(window, event) == {"PASS_THROUGH"} and window.timers == 1
    held.set()
    assert tick_until_done(operator, window) == {"FINISHED"}, window.told
    assert window.timers == 0 and arm.sleeve.wrinkles.coarse_layer == "SIMULATION"
    np.testing.assert_array_equal([vertex.co for vertex in arm.sleeve.wrinkles.coarse.data.vertices], at_once)


def test_making_a_coarse_mesh_can_be_stopped_and_notices_another_garment(
    arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm.sleeve.wrinkles.enabled = False
    bpy.context.view_layer.objects.active = arm.sleeve
    window = Window()
    operator = operator_of(WRINKLE_OT_make_coarse_mesh, make_coarse_mesh, window, monkeypatch, vertex_count=60)
    operator.invoke(window, None)
    assert operator.modal(window, ESCAPE) == {"CANCELLED"} and window.timers == 0
    operator.invoke(window, None)
    arm.sleeve.data.vertices.add(1)
    assert tick_until_done(operator, window) == {"CANCELLED"}
    assert "changed while its coarse mesh was made" in window.told[-1]
    assert arm.sleeve.wrinkles.coarse is None and "sleeve.coarse" not in bpy.data.objects
