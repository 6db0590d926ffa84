"""When Blender says that something moved: every handler of the add-on."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import bpy
from bpy.app.handlers import persistent

from ..storage import StorageError
from . import coarse_playing, correction_undo, playback
from .made_behind import look, tag_garments
from .node_group import NO_FRAME, find_modifier, get_input, set_input
from .relative_paths import keep_paths, remap_paths
from .skinning_rest import let_skinning_rest, wake_skinning
from .write import show_skinned

RENDER_FAILED = 3
"""Exit code of a background process in which a garment could not be played."""

_saved_frames: dict[int, float] = {}
"""Frames that modifiers showed when saving began, by the session_uid of the garment."""


@contextmanager
def suspended() -> Iterator[None]:
    """No playing meanwhile: for whatever steps through frames or poses on its own account.

    The handlers are taken away, not told to do nothing: an interruption that comes while Blender calls one is lost.
    """
    playing = ((bpy.app.handlers.frame_change_post, play_frame), (bpy.app.handlers.depsgraph_update_post, play_changes))
    taken = [(handlers, handler) for handlers, handler in playing if handler in handlers]
    for handlers, handler in taken:
        handlers.remove(handler)
    end_animation()
    try:
        yield
    finally:
        for handlers, handler in taken:
            handlers.append(handler)


# --- playing ------------------------------------------------------------------------------------------------------


@persistent
def play_frame(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None) -> None:
    """Every frame and subframe of playback and of renders.

    In the background, a garment that cannot be played ends the process: Blender itself would go on rendering wrong
    frames and report success.
    """
    if depsgraph is None:
        return
    errors = playback.play_scene(scene, depsgraph)
    coarse_playing.look_ahead()
    if errors and bpy.app.background:
        for error in errors:
            print(f"wrinkle: {error}", file=sys.stderr)
        sys.stdout.flush()
        sys.stderr.flush()
        # Leaving by an exception takes Python down inside a render, where some versions hang.
        os._exit(RENDER_FAILED)
    if coarse_playing.has_wishes() and not bpy.app.timers.is_registered(_grant_wishes):
        bpy.app.timers.register(_grant_wishes, first_interval=0.0)


def _grant_wishes() -> None:
    """Build simulations between two frames, and go on with them from the frame that stands."""
    with suspended():
        coarse_playing.grant_wishes()
    scene = bpy.context.scene
    scene.frame_set(scene.frame_current)


@persistent
def play_changes(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Posing without a change of frame.

    Showing a garment is a change, too, and calls this again; then all is as it was, and nothing is done.
    """
    if not (_render.goes_on or bpy.app.is_job_running("RENDER")):
        playback.play_scene(scene, depsgraph, only_changes=True)


@dataclass
class Render:
    """Whether the background renders; what the viewport would show is not to come in between."""

    goes_on: bool = False


_render = Render()


@persistent
def begin_render(scene: bpy.types.Scene | None = None, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Frames are the render's from now on."""
    _render.goes_on = bpy.app.background


@persistent
def end_render(scene: bpy.types.Scene | None = None, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """The viewport shows its own detail again; a window's does by itself, to which what a render wrote is a change."""
    if _render.goes_on:
        _render.goes_on = False
        tag_garments()


@persistent
def begin_animation(scene: bpy.types.Scene | None = None, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """A window plays the animation from now on: a frame follows a frame, and all of them come by here."""
    let_skinning_rest(True)


@persistent
def end_animation(scene: bpy.types.Scene | None = None, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """The animation stands still; modifiers are as the artist left them."""
    let_skinning_rest(False)


# --- the file -----------------------------------------------------------------------------------------------------


@persistent
def forget_file(path: str, unused: object = None) -> None:
    """Another file was opened; a window shows its garments as saved, skinned, until something is tagged."""
    playback.forget_all()
    end_animation()
    _play_soon()


def _play_soon() -> None:
    if not bpy.app.background:
        # The window's first evaluation of a file comes after all handlers, and calls none.
        bpy.app.timers.register(tag_garments, first_interval=0.0)


@persistent
def remember_corrections(scene: bpy.types.Scene, unused: object = None) -> None:
    """Undo or redo is about to replace the file's data."""
    correction_undo.begin_undo()


@persistent
def doubt_file(scene: bpy.types.Scene, unused: object = None) -> None:
    """Undo or redo replaced the file's data."""
    correction_undo.follow_undo()
    playback.doubt_all()
    end_animation()


@persistent
def hide_played(path: str, unused: object = None) -> None:
    """Save garments as skinned, so that a file opened without the add-on never shows a frozen pose."""
    remap_paths(path)
    # Whoever opens the file finds all that was simulated; a frame that cannot be written is missed when it is played.
    with suppress(StorageError):
        coarse_playing.flush()
    _saved_frames.clear()
    for garment, modifier in _modifiers():
        wake_skinning(garment)
        _saved_frames[garment.session_uid] = get_input(modifier, "Frame")
        set_input(modifier, "Frame", NO_FRAME)


@persistent
def show_played(path: str, unused: object = None) -> None:
    """Go on after saving. Nothing was evaluated in between, so nothing needs to be now."""
    keep_paths(path)
    _show_again()


@persistent
def show_unsaved(path: str, unused: object = None) -> None:
    """Go on after saving failed."""
    keep_paths("")
    _show_again()


def _show_again() -> None:
    for garment, modifier in _modifiers():
        set_input(modifier, "Frame", _saved_frames.get(garment.session_uid, NO_FRAME))
    _saved_frames.clear()


def _modifiers() -> Iterator[tuple[bpy.types.Object, bpy.types.NodesModifier]]:
    """Garments of this file and their Wrinkles modifiers."""
    for ob in bpy.data.objects:
        if ob.type == "MESH" and ob.library is None and (modifier := find_modifier(ob)) is not None:
            yield ob, modifier


HANDLERS: dict[str, Callable[..., None]] = {
    "frame_change_post": play_frame,
    "depsgraph_update_post": play_changes,
    "render_init": begin_render,
    "render_complete": end_render,
    "render_cancel": end_render,
    "animation_playback_pre": begin_animation,
    "animation_playback_post": end_animation,
    "load_post": forget_file,
    "undo_pre": remember_corrections,
    "redo_pre": remember_corrections,
    "undo_post": doubt_file,
    "redo_post": doubt_file,
    "save_pre": hide_played,
    "save_post": show_played,
    "save_post_fail": show_unsaved,
}

classes = ()


def register() -> None:
    """Add the handlers, in place of those of an earlier registration."""
    _remove_handlers()
    for name, handler in HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)
    _play_soon()


def unregister() -> None:
    """Remove the handlers; garments go back to their skinned shape."""
    _remove_handlers()
    for timer in (tag_garments, look, _grant_wishes):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    playback.forget_all()
    # A registration that is taken back while Blender starts has no data to look at.
    if hasattr(bpy.data, "objects"):
        for garment, _ in _modifiers():
            show_skinned(garment)


def _remove_handlers() -> None:
    """Whichever import of this module they come from."""
    for name in HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        for handler in list(handlers):
            if handler.__module__.endswith("wrinkle_addon.blender.handlers"):
                handlers.remove(handler)
