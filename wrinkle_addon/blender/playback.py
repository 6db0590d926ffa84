"""Playing: the poses of a scene's armatures, through the garments' databases, onto the garments' meshes.

What is shown is a pure function of the evaluated scene. Players are found by the garment object's session_uid, which
outlives undo and renaming.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..rig import Pose
from ..threads import Ahead
from .culling import is_culled, is_shown
from .first_start import first_start
from .inner_clearance import InnerGarment, garments_under
from .made_behind import NotReady, begin, take
from .player import Player, Source, Turn
from .render_lock import lock_interface
from .skinning_rest import wake_skinning
from .write import show_skinned

if TYPE_CHECKING:
    from .flow_playback import FlowFile


# --- the players of this session ----------------------------------------------------------------------------------


@dataclass
class Status:
    """How a garment is played.

    Attributes:
        player: None as long as there is none.
        bound: What the player is being made of, and the source that it is read from.
        failed: A source that no player could be made from, and why; not tried again until something changes.
        error: One sentence, if the garment shows its skinned shape because of it; else empty.
        plays: Whether the player shows it in the frame played last.
        waits: Whether a window showed it skinned in that frame because something is still being made ready.
    """

    player: Player | None = None
    bound: tuple[Source | FlowFile, Future] | None = None
    failed: tuple[Source | FlowFile, str] | None = None
    error: str = ""
    plays: bool = False
    waits: bool = False


_statuses: dict[int, Status] = {}
"""By the session_uid of the garment object."""


def status(garment: bpy.types.Object) -> Status:
    """How the garment is played."""
    return _statuses.get(garment.session_uid) or Status()


def _inner_garment(garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> InnerGarment | None:
    """What a garment is worn over, as it is played in this frame; None if it is not."""
    inner = garment.wrinkles.worn_over
    known = Status() if inner is None else status(inner)
    if inner is None or not known.plays or not isinstance(known.player, Player):
        return None
    world = np.array(inner.evaluated_get(depsgraph).matrix_world, np.float64)
    return InnerGarment(known.player.database, known.player.positions, world)


def _layer_number(garment: bpy.types.Object) -> int:
    """How many garments one is worn over: those are played before it."""
    try:
        return len(garments_under(garment))
    except ValueError:
        return 0


def play_scene(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, *, only_changes: bool = False) -> list[str]:
    """Play every garment of a scene that is switched on; one that fails shows its skinned shape.

    Args:
        depsgraph: The evaluated scene; all garments on one armature share one reading of its pose.
        only_changes: Leave out garments whose pose, placement, strengths and frame are as they were.

    Returns:
        One sentence for every garment that failed.
    """
    if not first_start.is_over:
        return []
    errors: list[str] = []
    poses: dict[object, Pose] = {}
    garments = [ob for ob in _objects(scene) if ob.type == "MESH" and ob.wrinkles.enabled]
    for known in _statuses.values():
        known.plays = known.waits = False
    playing: list[_Playing] = []
    for garment in sorted(garments, key=_layer_number):
        known = _statuses.setdefault(garment.session_uid, Status())
        with _falling_back(garment, known, errors):
            if (player := _ready_player(garment, known, depsgraph)) is None:
                continue
            if player.rig_key not in poses:
                poses[player.rig_key] = player.read_pose(garment.wrinkles.armature.evaluated_get(depsgraph))
            pose = poses[player.rig_key]
            if not only_changes:
                player.begin(garment, pose, depsgraph)
            playing.append((garment, known, player, pose))
    # An outer garment is pushed out of an inner one as that is shown; else none waits for another.
    for _, together in groupby(playing, lambda one: _layer_number(one[0])):
        _play_together(list(together), depsgraph, errors, only_changes)
    if len(_statuses) > len(garments):
        _forget_removed()
    return errors


_Playing = tuple[bpy.types.Object, Status, Player, Pose]


def _play_together(
    playing: list[_Playing], depsgraph: bpy.types.Depsgraph, errors: list[str], only_changes: bool
) -> None:
    """Play garments that do not wait for each other: what is computed, on any thread, all else on this one."""
    begun: list[tuple[bpy.types.Object, Status, Player, Turn, Ahead]] = []
    for garment, known, player, pose in playing:
        with _falling_back(garment, known, errors):
            inner = _inner_garment(garment, depsgraph)
            turn = player.read(garment, pose, depsgraph, inner, only_changes=only_changes)
            known.plays = turn is None
            if turn is not None:
                # The last one is this thread's own.
                kept = garment is playing[-1][0] or not player.on_cpu
                begun.append((garment, known, player, turn, Ahead(turn.compute, kept=kept)))
    for garment, known, player, turn, work in reversed(begun):
        with _falling_back(garment, known, errors):
            work.finish()
            player.show(garment, turn, depsgraph)
            known.plays = True


@contextmanager
def _falling_back(garment: bpy.types.Object, known: Status, errors: list[str]) -> Iterator[None]:
    """Let a garment show its skinned shape if this fails, and note why, or until what it needs is made."""
    try:
        yield
        known.error = ""
    except NotReady:
        known.waits, known.error = True, ""
        if known.player is not None:
            known.player.show_anew()
        _fall_back(garment)
    except Exception as error:
        if not isinstance(error, ValueError):
            traceback.print_exc()
        known.error = _sentence(error)
        errors.append(known.error)
        _fall_back(garment)


def _objects(scene: bpy.types.Scene | None) -> Iterator[bpy.types.Object]:
    """Objects of a scene and of the scenes in its background."""
    while scene is not None:
        yield from scene.objects
        scene = scene.background_set


def _ready_player(garment: bpy.types.Object, known: Status, depsgraph: bpy.types.Depsgraph) -> Player | None:
    """A garment's player, ready to play it in this frame; None if none is to show it."""
    if garment.data.is_editmode:
        # The artist edits the skinned garment; whatever comes out of edit mode is looked at again.
        _doubt(known)
        show_skinned(garment)
        return None
    if not garment.evaluated_get(depsgraph).is_evaluated:
        return None
    if not is_shown(garment, depsgraph) or is_culled(garment, depsgraph):
        wake_skinning(garment)
        return None
    source = garment.wrinkles.flow.source() or Source.of(garment)
    armature = garment.wrinkles.armature.evaluated_get(depsgraph)
    if not armature.is_evaluated:
        raise ValueError(
            f"The armature '{armature.name}' of the garment '{garment.name}' is not in the scene "
            f"'{depsgraph.scene.name}'; put it there."
        )
    player = _player(garment, source, known, depsgraph)
    player.check(garment)
    return player


def _player(
    garment: bpy.types.Object, source: Source | FlowFile, known: Status, depsgraph: bpy.types.Depsgraph
) -> Player:
    if known.player is not None and known.player.source == source:
        return known.player
    if known.failed is not None and known.failed[0] == source:
        raise ValueError(known.failed[1])
    known.player = known.failed = None
    try:
        if known.bound is None or known.bound[0] != source:
            known.bound = source, begin(source.bind, depsgraph)
        player = take(known.bound[1], depsgraph).player(garment)
    except NotReady:
        raise
    except Exception as error:
        known.bound, known.failed = None, (source, _sentence(error))
        raise
    known.player, known.bound = player, None
    lock_interface(garment)
    return player


def _sentence(error: Exception) -> str:
    return str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"


def _fall_back(garment: bpy.types.Object) -> None:
    if garment.library is None:
        show_skinned(garment)


def _doubt(known: Status) -> None:
    known.failed = None
    if known.player is not None:
        known.player.doubt()


def doubt(garment: bpy.types.Object) -> None:
    """Something about the garment changed by hand: what failed is tried again, what is shown is looked at again."""
    _doubt(status(garment))


def doubt_all() -> None:
    """After undo or redo: players stay, but trust nothing that they know of the file."""
    for known in _statuses.values():
        _doubt(known)


def forget(garment: bpy.types.Object) -> None:
    """Drop the garment's player, so that the next frame opens its database anew."""
    _statuses.pop(garment.session_uid, None)


def forget_all() -> None:
    """Drop every player: another file was opened."""
    _statuses.clear()


def _forget_removed() -> None:
    """Drop players of garments that are gone; those that are switched off may come back any moment."""
    alive = {ob.session_uid for ob in bpy.data.objects}
    for uid in _statuses.keys() - alive:
        del _statuses[uid]
