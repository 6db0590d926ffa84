"""A garment that is played: its database bound to a device, from a pose to positions on its mesh.

Players hold arrays and no Blender data, so undo leaves them valid.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property, partial
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
from .culling import FULL_DETAIL
from .inner_clearance import InnerClearance, InnerGarment
from .matching import check_mesh, glance_at, match_rig
from .preferences import device_name
from .skinning_rest import let_rest
from .write import make_writable, show_positions

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
        work: Acts that do not wait for each other.
        body: The body that the garment is to be kept clear of, in its object space; None for none.
    """

    work: tuple[Ahead, ...]
    body: NDArray[np.float32] | None

    def finish(self) -> None:
        """Come back when all is done; the last act, which is the least likely to have begun, first."""
        with ExitStack() as rest:
            for one in self.work:
                rest.callback(one.finish)


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
        strengths, follow = evaluated.wrinkles.strengths(), float(evaluated.wrinkles.follow)
        wanted = self._at_full_detail(garment, depsgraph) and garment.wrinkles.clear_of_body
        body = self._clearance.read(garment, depsgraph, pose, placement, wanted=wanted)
        acts = [partial(layer.wrinkles.synthesise, pose, self._positions, strengths, placement, follow)]
        if body is not None:
            acts.append(partial(self._clearance.move, body))
        self._begun = Begun(tuple(Ahead(act) for act in acts), body)

    def read(
        self,
        garment: bpy.types.Object,
        pose: Pose,
        depsgraph: bpy.types.Depsgraph,
        worn_over: InnerGarment | None,
        *,
        only_changes: bool = False,
    ) -> Turn | None:
        """Read what decides how the garment lies in a pose.

        Args:
            garment: The original garment object.
            pose: From :meth:`read_pose`.
            depsgraph: Whence placement, strengths (which may be animated) and frame come.
            worn_over: The garment under this one, as it is played in this frame; None if it is not.
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
                begun.finish()
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
        inner = self._inner_clearance.read(garment, depsgraph, worn_over) if full else None
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
