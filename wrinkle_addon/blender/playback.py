"""Playing: the poses of a scene's armatures, through the garments' databases, onto the garments' meshes.

What is shown is a pure function of the evaluated scene. Players hold arrays and no Blender data, so undo leaves them
valid; they are found by the garment object's session_uid, which outlives undo and renaming.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..database import WrinkleDatabase
from ..folder_verbs import choose_device
from ..joint_wrinkles import BlendWeights, Formulation, JointEvaluator, JointWrinkles
from ..rig import FloatArray, Pose
from ..threads import Ahead
from .armature import PoseReader, rig_scale
from .clearance import BodyClearance, Worn
from .coarse_layer import CoarseBinding
from .culling import FULL_DETAIL, is_culled, is_shown
from .first_start import first_start
from .inner_clearance import InnerClearance, InnerGarment, garments_under
from .made_behind import NotReady, begin, take
from .matching import check_mesh, glance_at, match_rig
from .preferences import device_name
from .render_lock import lock_interface
from .skinning_rest import let_rest, wake_skinning
from .write import make_writable, show_positions, show_skinned

if TYPE_CHECKING:
    from .flow_playback import FlowFile


@dataclass(frozen=True)
class Source:
    """What a player is made from; another source needs another player."""

    database: str
    formulation: Formulation
    weights: BlendWeights
    device: str
    armature: int

    @staticmethod
    def of(garment: bpy.types.Object) -> Source:
        """The source that a garment's settings name.

        Raises:
            ValueError: If they name none; one sentence.
        """
        settings = garment.wrinkles
        if settings.armature is None:
            raise ValueError(f"The garment '{garment.name}' has no armature; set it up again.")
        if not settings.database:
            raise ValueError(f"The garment '{garment.name}' has no database; bake it, or choose one.")
        return Source(
            bpy.path.abspath(settings.database),
            Formulation[settings.formulation],
            BlendWeights[settings.weights],
            device_name(),
            settings.armature.session_uid,
        )

    def bind(self) -> Bound:
        """Read the database and bind it to the device, which takes some tenths of a second.

        Raises:
            ValueError: If it cannot be read; one sentence.
        """
        database = WrinkleDatabase.open(Path(self.database))
        method = JointWrinkles(database, self.formulation, self.weights)
        reports = {sample.name: stored.report for sample, stored in method.samples.items()}
        return Bound(self, database, method.bind(choose_device(self.device)), reports)


@dataclass(frozen=True, eq=False)
class Bound:
    """A source as it was read and bound, without anything of the scene; ``reports`` as of :class:`Player`."""

    source: Source
    database: WrinkleDatabase
    evaluator: JointEvaluator
    reports: Mapping[str, Mapping[str, Any]]

    def player(self, garment: bpy.types.Object) -> Player:
        return Player(garment, self)


@dataclass(frozen=True, eq=False)
class Turn:
    """A garment's turn in a frame.

    Attributes:
        compute: Writes its positions; of arrays alone, so that it may run on any thread.
        frame: The scene's, with its fraction.
        inputs: All that decides the result.
    """

    compute: Callable[[], None]
    frame: float
    inputs: tuple[object, ...]


@dataclass(frozen=True, eq=False)
class Begun:
    """What another thread does while a garment's coarse layer is simulated.

    Attributes:
        body: The body that the garment is to be kept clear of, in its object space; None for none.
    """

    work: Ahead
    body: NDArray[np.float32] | None


class Player:
    """One garment's database, bound to a device, and all arrays that playing needs.

    Args:
        garment: The garment object; it gets a mesh of its own if it shares one.
        bound: The source that its settings name.

    Attributes:
        coarse: The garment's coarse layer.
        reports: What the bake said of every sample, by its name.
        clamped: Joints that went beyond their samples in the last pose, and by how much [rad].

    Raises:
        ValueError: One sentence, if the database cannot be read, or is not of this garment and its rig.
    """

    source: Source | FlowFile

    def __init__(self, garment: bpy.types.Object, bound: Bound):
        self.source = bound.source
        self.database = bound.database
        self.coarse = CoarseBinding(self.database)
        self.doubt()
        self.check(garment)
        make_writable(garment)
        # Garments that share an armature and were baked for the same rest pose share its pose, too.
        self.rig_key = (bound.source.armature, self.database.header.rig.fingerprint())
        self.reports = bound.reports
        self._evaluator = bound.evaluator
        device = bound.evaluator.device
        self._positions = wp.zeros(self._evaluator.vertex_count, dtype=wp.vec3, device=device)
        self._clearance = BodyClearance(Worn.of_database(self.database), str(device))
        self._inner_clearance = InnerClearance(self.database, str(device))
        self._begun: Begun | None = None
        on_cpu = self._positions.device.is_cpu
        self._host = self._positions if on_cpu else wp.zeros_like(self._positions, device="cpu", pinned=True)
        self._host_view: NDArray[np.float32] = self._host.numpy()

    @cached_property
    def summary(self) -> str:
        """What is played, for the panel."""
        samples = len(self.database.header.plan.samples) + 1
        megabytes = self.database.stored_bytes / 1e6
        return f"{self._evaluator.vertex_count} vertices, {samples} samples, {megabytes:.1f} MB"

    @property
    def clamped(self) -> Mapping[str, FloatArray]:
        return self._evaluator.clamped

    @property
    def note(self) -> str:
        """Why the garment is not kept clear of its body or of an inner garment, if it should be; else empty."""
        return " ".join(filter(None, (self._clearance.note, self._inner_clearance.note)))

    @property
    def on_cpu(self) -> bool:
        """Whether other threads of the CPU help it; what a GPU does, nobody waits for anyway."""
        return self._positions.device.is_cpu

    @property
    def positions(self) -> NDArray[np.float32]:
        """The garment as played last, in its object space, shape [vertex_count, 3]."""
        return self._host_view

    def check(self, garment: bpy.types.Object) -> None:
        """Compare the garment's mesh and rig with the database, if there is reason to.

        Raises:
            ValueError: One sentence that says what changed since the bake.
        """
        glance = glance_at(garment)
        if glance == self._checked:
            return
        self.doubt()
        header = self.database.header
        armature = garment.wrinkles.armature
        check_mesh(garment, header.garment)
        self._scale = match_rig(armature, header)
        self._reader = PoseReader(armature, header.rig)
        self._to_bake = self._scale / rig_scale(armature)
        self._checked = glance

    def doubt(self) -> None:
        """Check and play again, whatever seems unchanged: the file's data was replaced."""
        self._checked = self._inputs = None
        self.coarse.doubt()

    def show_anew(self) -> None:
        """What was shown last no longer is."""
        self._inputs = None

    def read_pose(self, armature: bpy.types.Object) -> Pose:
        """The pose of the evaluated armature in the metres of the bake."""
        pose = self._reader.read(armature)
        pose.matrices[:, :3, 3] *= self._to_bake
        return pose

    def begin(self, garment: bpy.types.Object, pose: Pose, depsgraph: bpy.types.Depsgraph) -> None:
        """Begin on another thread with what waits for no simulation; :meth:`read` must be called then."""
        layer = self.coarse.waiting(depsgraph.scene.frame_current_final)
        if layer is None or not self.on_cpu:
            return
        evaluated = garment.evaluated_get(depsgraph)
        placement = self._placement(evaluated, garment.wrinkles.armature.evaluated_get(depsgraph))
        arguments = pose, self._positions, evaluated.wrinkles.strengths(), placement
        wanted = self._at_full_detail(garment, depsgraph) and garment.wrinkles.clear_of_body
        body = self._clearance.read(garment, depsgraph, pose, placement, wanted=wanted)

        def act() -> None:
            layer.wrinkles.synthesise(*arguments)
            if body is not None:
                self._clearance.move(body)

        self._begun = Begun(Ahead(act), body)

    def read(
        self, garment: bpy.types.Object, pose: Pose, depsgraph: bpy.types.Depsgraph, *, only_changes: bool = False
    ) -> Turn | None:
        """Read what decides how the garment lies in a pose.

        Args:
            garment: The original garment object.
            pose: From :meth:`read_pose`.
            depsgraph: Whence placement, strengths (which may be animated) and frame come.
            only_changes: Whether there is nothing to do if all of that is as it was.

        Returns:
            What writes its positions, for :meth:`show` to show; None if there is nothing to do.

        Raises:
            NotReady: If something that it needs is still being made, in a window.
        """
        begun, self._begun = self._begun, None
        try:
            layer = self.coarse.read(garment, depsgraph, self._evaluator, live=not only_changes)
        finally:
            # The arrays that it reads and writes are free again.
            if begun is not None:
                begun.work.finish()
        evaluated = garment.evaluated_get(depsgraph)
        placement = self._placement(evaluated, garment.wrinkles.armature.evaluated_get(depsgraph))
        strengths = evaluated.wrinkles.strengths()
        frame = depsgraph.scene.frame_current_final
        full = self._at_full_detail(garment, depsgraph)
        if begun is not None:
            body = begun.body
        else:
            wanted = full and garment.wrinkles.clear_of_body
            body = self._clearance.read(garment, depsgraph, pose, placement, wanted=wanted)
        coarse = None if layer is None else (layer.positions.tobytes(), layer.follow)
        inner = self._inner_clearance.read(garment, depsgraph, _inner_garment(garment, depsgraph)) if full else None
        around = tuple(None if points is None else points.tobytes() for points in (body, inner))
        decided = (strengths, frame, coarse, around, garment.wrinkles.clearance, full)
        inputs = (pose.matrices.tobytes(), placement.tobytes(), *decided)
        if only_changes and inputs == self._inputs:
            return None

        def compute() -> None:
            (layer or self._evaluator).evaluate(pose, self._positions, strengths, placement)
            if body is not None:
                self._clearance.clear(None if begun is not None else body, self._positions, placement)
            if inner is not None:
                self._inner_clearance.clear(inner, self._positions, placement)

        return Turn(compute, frame, inputs)

    def show(self, garment: bpy.types.Object, turn: Turn, depsgraph: bpy.types.Depsgraph) -> None:
        """Show the garment as a turn has computed it."""
        if self._host is not self._positions:
            wp.copy(self._host, self._positions)
            wp.synchronize_device(self._positions.device)
        show_positions(garment, self._host_view, turn.frame)
        let_rest(garment, garment.evaluated_get(depsgraph))
        self._inputs = turn.inputs

    def _at_full_detail(self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
        return garment.wrinkles.detail(depsgraph) == FULL_DETAIL

    def _placement(self, garment: bpy.types.Object, armature: bpy.types.Object) -> FloatArray:
        """Matrix from rig space [m] to the garment's object space, shape [4, 4]; both objects evaluated."""
        # A garment that is scaled to nothing is not seen, but must not fail.
        placement = np.array(garment.matrix_world.inverted_safe() @ armature.matrix_world, np.float64)
        placement[:, :3] /= self._scale
        return placement


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
    turns: list[tuple[bpy.types.Object, Status, Player, Turn]] = []
    for garment, known, player, pose in playing:
        with _falling_back(garment, known, errors):
            turn = player.read(garment, pose, depsgraph, only_changes=only_changes)
            known.plays = turn is None
            if turn is not None:
                turns.append((garment, known, player, turn))
    # The first one is this thread's own.
    begun = [Ahead(turn.compute, kept=k == 0 or not player.on_cpu) for k, (*_, player, turn) in enumerate(turns)]
    for (garment, known, player, turn), work in zip(turns, begun, strict=True):
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
