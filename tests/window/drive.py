"""What an artist does on the first day, with the mouse, in a real window: set up, bake, play, cancel, undo, render.

The character is one out of another program, as its importer leaves it.

Run by tools/window.py as ``blender figure.blend --python drive.py -- SHOTS``; ends Blender, with code 1 if something
was not as it should be. Lines that begin with "window:" are shown to whoever runs it.
"""

from __future__ import annotations

import importlib
import math
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from mouse import Hand, Steps

BEGAN = time.monotonic()
PACKAGE = "bl_ext.user_default.wrinkle_synthesis"
SHOTS = Path(sys.argv[sys.argv.index("--") + 1])
LONG = 600.0
"""What anything may take on a slow machine [s]."""

first_start = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.first_start").first_start
file_process = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.file_process")
playback = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.playback")
inspection = importlib.import_module(f"{PACKAGE}.wrinkle_addon.blender.inspection")


def the_first_day(hand: Hand) -> Steps:
    animate()
    yield from open_sidebar(hand)
    yield from hand.shoot("first_start")
    yield from wait_for(lambda: first_start.is_over, "kernels are compiled")
    assert not first_start.problem, first_start.problem
    say(f"kernels were compiled {time.monotonic() - BEGAN:.0f} s after Blender's start, behind a window in use")
    yield from set_up(hand)
    yield from bake(hand)
    yield from play(hand)
    yield from cancel_a_bake(hand)
    yield from undo(hand)
    yield from render(hand)
    yield from later_steps(hand)
    yield from preferences(hand)


def animate() -> None:
    """Keys on the left elbow."""
    scene, armature = bpy.context.scene, bpy.data.objects["Figure"]
    scene.frame_start, scene.frame_end = 1, 20
    bone = armature.pose.bones["mixamorig:LeftForeArm"]
    bone.rotation_mode = "XYZ"
    for frame, angle in ((1, 0.0), (20, -80.0)):
        bone.rotation_euler = (0.0, 0.0, math.radians(angle))
        bone.keyframe_insert("rotation_euler", frame=frame)


def open_sidebar(hand: Hand) -> Steps:
    """The 3D view as large as it goes, with our tab in front."""
    with bpy.context.temp_override(window=hand.window, area=hand.area):
        hand.area.spaces.active.show_region_ui = True
    yield 0.8
    hand.region("UI").active_panel_category = "Wrinkle"
    with bpy.context.temp_override(window=hand.window, area=hand.area, region=hand.region("WINDOW")):
        bpy.ops.view3d.view_axis(type="FRONT")
        bpy.ops.view3d.view_all()
    yield 0.8


def set_up(hand: Hand) -> Steps:
    """Body, then garment; then the button, and its dialog as it comes up."""
    shirt, body = bpy.data.objects["shirt"], bpy.data.objects["body"]
    for ob in bpy.data.objects:
        ob.select_set(ob in (shirt, body))
    bpy.context.view_layer.objects.active = shirt
    yield from hand.shoot("selected")
    # Fine folds would take minutes to bake.
    bpy.context.window_manager.operator_properties_last("wrinkle.setup_garment").subdivide = 0
    yield from hand.click("wrinkle.setup_garment")
    yield from hand.shoot("setup_dialog")
    middle = hand.window.width // 2, hand.window.height // 2
    hand.point(*middle)
    yield from hand.confirm()
    yield from wait_for(lambda: garment() is not None, "the garment is set up")
    settings = garment().wrinkles
    assert len(settings.joints) >= 4 and settings.body == body
    yield from hand.shoot("set_up")
    extent = elbow().high[0] - elbow().low[0]
    yield from hand.click("wrinkle.take_ranges")
    assert 0.0 < elbow().high[0] - elbow().low[0] < 0.8 * extent
    yield from hand.click("wrinkle.check_garment")
    yield from wait_for(lambda: inspection.findings_of(garment()) is not None, "the garment is checked")
    assert not any(finding.stops for finding in inspection.findings_of(garment()))
    yield from hand.shoot("checked")
    yield from hand.shoot("sidebar_checked", sidebar=True)


def garment() -> bpy.types.Object | None:
    """The garment that was set up, if one is."""
    return next((ob for ob in bpy.data.objects if ob.type == "MESH" and len(ob.wrinkles.joints)), None)


def elbow() -> bpy.types.PropertyGroup:
    """The joint that the animation bends."""
    return garment().wrinkles.joints["elbow_L"]


def bake(hand: Hand) -> Steps:
    """A quick bake, in the background."""
    settings = garment().wrinkles
    settings.plan, settings.budget = "BUDGET", 2
    for joint in settings.joints:
        joint.enabled = joint.name == "elbow_L"
    yield from hand.click("wrinkle.bake")
    yield from wait_for(lambda: file_process.running, "the bake begins")
    yield from wait_for(lambda: all(each.progress.done for each in file_process.running.values()), "a sample is baked")
    yield from hand.shoot("baking")
    yield from hand.shoot("sidebar_baking", sidebar=True)
    yield from wait_for(lambda: not file_process.running, "the bake ends")
    assert settings.enabled
    yield from until_played()
    say(f"the first wrinkled frame came {time.monotonic() - BEGAN:.0f} s after Blender's start, quick bake included")
    yield from hand.shoot("baked")


def play(hand: Hand) -> Steps:
    """The space bar plays the animation, and every frame is played here."""
    bpy.context.scene.frame_set(14)
    yield 1.0
    yield from until_played()
    assert wrinkles() > 1e-3 and not playback.status(garment()).error, playback.status(garment()).error
    assert inspection.findings_of(garment()) is None, "What was found was before the bake."
    yield from hand.shoot("played")
    yield from hand.shoot("sidebar_played", sidebar=True)
    frames: list[int] = []
    bpy.app.handlers.frame_change_post.append(lambda scene, depsgraph: frames.append(scene.frame_current))
    began = time.monotonic()
    yield from hand.press("space")
    yield from wait_for(lambda: len(frames) > 10, "the animation plays")
    say(f"playing drew {len(frames)} frames in {time.monotonic() - began:.0f} s, without a graphics card")
    yield from hand.press("space")


def until_played() -> Steps:
    """A database is bound behind the window; until then the garment is skinned."""
    yield from wait_for(lambda: playback.status(garment()).plays, "the database is bound")


def wrinkles() -> float:
    """How far the garment that is shown is from its skinned shape, at most [m]."""
    ob = garment()
    shown = positions(ob)
    modifier = ob.modifiers["Wrinkles"]
    modifier.show_viewport = False
    bpy.context.view_layer.update()
    skinned = positions(ob)
    modifier.show_viewport = True
    bpy.context.view_layer.update()
    return float(np.abs(shown - skinned).max())


def positions(ob: bpy.types.Object) -> np.ndarray:
    mesh = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    values = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", values)
    return values


def cancel_a_bake(hand: Hand) -> Steps:
    """Stop a bake by its button: its process ends, finished samples stay."""
    settings = garment().wrinkles
    settings.database = settings.database.replace(".wrinkles", "_other.wrinkles")
    settings.budget = 250
    for joint in settings.joints:
        joint.enabled = True
    yield from hand.click("wrinkle.bake")
    yield from wait_for(lambda: file_process.running, "the second bake begins")
    (process,) = file_process.running.values()
    yield from wait_for(lambda: process.progress.done, "one of its samples is baked")
    yield from hand.click("wrinkle.stop_process")
    yield from wait_for(lambda: process._process.poll() is not None, "its process ends")
    yield from wait_for(lambda: not file_process.running, "the window has noticed")
    assert list(Path(bpy.path.abspath(settings.database)).glob("rest-*"))
    yield from hand.shoot("cancelled")
    settings.database, settings.budget = settings.database.replace("_other", ""), 36
    yield 1.0
    yield from until_played()
    assert wrinkles() > 1e-3


def undo(hand: Hand) -> Steps:
    """Undo what was done by hand, and do it again; the garment goes on wrinkling."""
    bpy.ops.ed.undo_push(message="before")
    garment().wrinkles.armature.location.x = 0.5
    bpy.ops.ed.undo_push(message="Move")
    yield from hand.press("ctrl+z")
    yield 1.0
    assert garment().wrinkles.armature.location.x == 0.0
    assert wrinkles() > 1e-3 and not playback.status(garment()).error
    yield from hand.shoot("undone")
    yield from hand.press("ctrl+shift+z")
    yield 1.0
    assert garment().wrinkles.armature.location.x == 0.5
    yield from hand.press("ctrl+z")
    assert garment().wrinkles.armature.location.x == 0.0


def render(hand: Hand) -> Steps:
    """Render from the window, the interface locked; each picture is that of its frame."""
    scene = bpy.context.scene
    assert scene.render.use_lock_interface
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera, camera.data.type, camera.data.ortho_scale = camera, "ORTHO", 2.0
    camera.location, camera.rotation_euler = (0.0, -3.0, 1.4), (math.pi / 2, 0.0, 0.0)
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.render.resolution_x, scene.render.resolution_y = 96, 96
    scene.render.filepath = str(SHOTS / "render_")
    scene.frame_start, scene.frame_end = 8, 11
    bpy.context.preferences.view.render_display_type = "NONE"
    with bpy.context.temp_override(window=hand.window, area=hand.area):
        bpy.ops.render.render("INVOKE_DEFAULT", animation=True)
    yield 0.5
    yield from wait_for(lambda: not bpy.app.is_job_running("RENDER"), "the render from the window ends")
    yield 1.0
    for frame in (9, 11):
        scene.frame_set(frame)
        from_window = pixels(SHOTS / f"render_{frame:04}.png")
        scene.render.filepath = str(SHOTS / "still.png")
        bpy.ops.render.render(write_still=True)
        np.testing.assert_array_equal(from_window, pixels(SHOTS / "still.png"))
    yield from render_quickly(hand)
    for picture in (*SHOTS.glob("render_*"), SHOTS / "still.png"):
        picture.unlink()


def render_quickly(hand: Hand) -> Steps:
    """A still of less detail than the viewport's, which shows its own again when the render is over."""
    settings = garment().wrinkles
    full = positions(garment())
    settings.render_detail = settings.viewport_detail = "QUICK"
    quick = positions(garment())
    assert (quick != full).any(), "The push-out does nothing here, so nothing would be seen of it."
    settings.viewport_detail = "FULL"
    np.testing.assert_array_equal(positions(garment()), full)
    with bpy.context.temp_override(window=hand.window, area=hand.area):
        bpy.ops.render.render("INVOKE_DEFAULT")
    yield 0.5
    yield from wait_for(lambda: not bpy.app.is_job_running("RENDER"), "the still is rendered")
    yield 1.0
    np.testing.assert_array_equal(positions(garment()), full)
    settings.render_detail = "FULL"


def pixels(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    values = np.array(image.pixels)
    bpy.data.images.remove(image)
    return values


def later_steps(hand: Hand) -> Steps:
    """The steps that are closed at first, in another workspace: a 3D view keeps what was open in it."""
    open_panels(("Plan", "Fabric", "Bake", "Samples", "Coarse Layer", "Cache", "Export", "Report"))
    workspace = bpy.data.workspaces["Modeling"]
    workspace.object_mode = "OBJECT"
    hand.window.workspace = workspace
    yield 1.0
    yield from open_sidebar(hand)
    settings = garment().wrinkles
    settings.active_joint = settings.joints.find("elbow_L")
    # The end that is bent: the other is at rest, which is no sample of the joint.
    settings.ghost.angles[0] = max(elbow().low[0], elbow().high[0], key=abs)
    settings.ghost.shows = True
    bpy.context.scene.frame_set(1)
    yield from look_at(hand, "mixamorig:LeftForeArm")
    yield from hand.shoot("ghost")
    settings.coarse_layer = "SIMULATION"
    yield from hand.shoot("later_steps")
    yield from hand.shoot("sidebar_later_steps", sidebar=True)
    settings.coarse_layer = "NONE"


def look_at(hand: Hand, bone: str) -> Steps:
    """From above and near, beside the sidebar, nothing else in the way."""
    bpy.context.scene.camera.hide_set(True)
    with bpy.context.temp_override(window=hand.window, area=hand.area, region=hand.region("WINDOW")):
        bpy.ops.view3d.view_axis(type="TOP")
    yield 0.8
    armature = garment().wrinkles.armature
    view = hand.area.spaces.active.region_3d
    view.view_location = armature.matrix_world @ armature.pose.bones[bone].head
    view.view_location.x += 0.2
    view.view_distance = 1.3
    yield 0.8


def preferences(hand: Hand) -> Steps:
    """The page of the add-on, after its self-test."""
    assert bpy.ops.wrinkle.self_test() == {"FINISHED"}
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "Wrinkle"
    hand.area.type = "PREFERENCES"
    bpy.ops.preferences.addon_expand(module=PACKAGE)
    yield 1.0
    yield from hand.shoot("preferences")


def wait_for(condition: Callable[[], object], what: str) -> Steps:
    until = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < until, f"Not within {LONG:.0f} s: {what}."
        yield 0.1


def say(text: str) -> None:
    print(f"window: {text}", flush=True)


def tick(steps: Steps, hand: Hand) -> float:
    """Go on to the next wait, or leave Blender."""
    code = 0
    try:
        return next(steps)
    except StopIteration:
        pass
    except BaseException:
        traceback.print_exc()
        for _ in hand.shoot("failed"):
            pass
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    first_start.end()
    os._exit(code)


def open_panels(labels: tuple[str, ...]) -> None:
    """Let these panels start open and the others closed; Blender offers no other hand to it than the mouse's."""
    package = sys.modules[PACKAGE]
    package.unregister()
    first_start.__init__()
    pending = [bpy.types.Panel]
    while pending:
        panel = pending.pop()
        pending += panel.__subclasses__()
        if panel.__module__.startswith(PACKAGE) and hasattr(panel, "bl_label"):
            options = set(getattr(panel, "bl_options", ())) - {"DEFAULT_CLOSED"}
            panel.bl_options = options | (set() if panel.bl_label in labels else {"DEFAULT_CLOSED"})
    package.register()


def begin() -> None:
    bpy.context.preferences.view.show_splash = False
    hand = Hand(SHOTS)
    steps = the_first_day(hand)
    bpy.app.timers.register(lambda: tick(steps, hand), first_interval=0.0)


bpy.context.preferences.view.show_splash = False
open_panels(("Getting Ready", "Character", "Check", "Joints", "Plan", "Bake", "Play"))
bpy.app.timers.register(begin, first_interval=2.0)
