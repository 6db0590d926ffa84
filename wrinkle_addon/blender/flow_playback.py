"""A wrinkle flow on a garment: replayed in the handler, the modifier and the panel of the wrinkle database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import bpy
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..flow import Ends, FlowEvaluator, FlowMethod, Timing
from ..flow_file import Flow, read_flow
from ..folder_verbs import choose_device
from ..garment import Garment
from ..rig import FloatArray, Pose
from .armature import PoseReader, rig_scale
from .character import read_mesh
from .clearance import BodyClearance, Worn
from .flow_recording import mesh_topology
from .inner_clearance import InnerGarment
from .matching import RECORDING, glance_at, match_rig
from .player import Player, Turn
from .preferences import device_name
from .write import make_writable


@dataclass(frozen=True)
class FlowFile:
    """What a flow's player is made from; see :class:`.player.Source`."""

    path: str
    device: str
    armature: int

    @staticmethod
    def of(garment: bpy.types.Object) -> FlowFile:
        """The flow that a garment's settings name.

        Raises:
            ValueError: If they name none; one sentence.
        """
        settings = garment.wrinkles
        if settings.armature is None:
            raise ValueError(f"The garment '{garment.name}' has no armature; set it up again.")
        if not settings.flow.path:
            raise ValueError(f"The garment '{garment.name}' has no flow; compress a recording, or choose one.")
        return FlowFile(bpy.path.abspath(settings.flow.path), device_name(), settings.armature.session_uid)

    def bind(self) -> BoundFlow:
        """Read the flow and bind it to the device.

        Raises:
            ValueError: If it cannot be read; one sentence.
        """
        flow = read_flow(Path(self.path))
        return BoundFlow(self, flow, FlowMethod(flow).bind(choose_device(self.device)))


@dataclass(frozen=True, eq=False)
class BoundFlow:
    """A flow as it was read and bound, without anything of the scene."""

    source: FlowFile
    flow: Flow
    evaluator: FlowEvaluator

    def player(self, garment: bpy.types.Object) -> FlowPlayer:
        return FlowPlayer(garment, self)


class FlowPlayer(Player):
    """One garment's flow, bound to a device, and all arrays that replaying needs; its note tells of the last frame.

    Raises:
        ValueError: One sentence, if the flow cannot be read, or is not of this garment and its rig.
    """

    def __init__(self, garment: bpy.types.Object, bound: BoundFlow):
        self.source = bound.source
        self.flow = bound.flow
        self._outside = ""
        self.doubt()
        self.check(garment)
        make_writable(garment)
        self.rig_key = (bound.source.armature, self.flow.rig.fingerprint())
        self._evaluator = bound.evaluator
        device = bound.evaluator.device
        self._clearance = BodyClearance(self._worn(garment), str(device))
        self._positions = wp.zeros(self.flow.vertex_count, dtype=wp.vec3, device=device)
        on_cpu = self._positions.device.is_cpu
        self._host = self._positions if on_cpu else wp.zeros_like(self._positions, device="cpu", pinned=True)
        self._host_view: NDArray[np.float32] = self._host.numpy()

    @cached_property
    def summary(self) -> str:
        """What is replayed, for the panel."""
        flow = self.flow
        return (
            f"{flow.vertex_count} vertices, {flow.frame_count} frames, {flow.component_count} components, "
            f"{flow.stored_bytes / 1e6:.2f} MB, error {flow.header.rms_mm:.3g} mm"
        )

    @property
    def note(self) -> str:
        return " ".join(filter(None, (self._outside, self._clearance.note)))

    @property
    def clamped(self) -> Mapping[str, FloatArray]:
        return {}

    def check(self, garment: bpy.types.Object) -> None:
        """Compare the garment's mesh and rig with the flow, if there is reason to.

        Raises:
            ValueError: One sentence that says what changed since the recording.
        """
        glance = glance_at(garment)
        if glance == self._checked:
            return
        self.doubt()
        check_flow_mesh(garment, self.flow.header.topology, self.flow.vertex_count)
        armature = garment.wrinkles.armature
        self._scale = match_rig(armature, self.flow, RECORDING)
        self._reader = PoseReader(armature, self.flow.rig)
        self._to_bake = self._scale / rig_scale(armature)
        self._checked = glance

    def _worn(self, garment: bpy.types.Object) -> Worn:
        """The garment as it is kept clear of its body; its faces are the recorded ones, which was checked."""
        flow, (_, faces) = self.flow, read_mesh(garment.data)
        held = np.zeros(flow.vertex_count, np.float32)
        return Worn(flow.rig, Garment(garment.name, flow.rest, faces, flow.weights, held), flow.rest, whole=False)

    def doubt(self) -> None:
        self._checked = self._inputs = None

    def begin(self, garment: bpy.types.Object, pose: Pose, depsgraph: bpy.types.Depsgraph) -> None:
        """A flow waits for nothing."""

    def read(
        self,
        garment: bpy.types.Object,
        pose: Pose,
        depsgraph: bpy.types.Depsgraph,
        worn_over: InnerGarment | None,
        *,
        only_changes: bool = False,
    ) -> Turn | None:
        """Read what decides the garment in a pose and in the scene's frame; see :meth:`.player.Player.read`."""
        evaluated = garment.evaluated_get(depsgraph)
        placement = self._placement(evaluated, garment.wrinkles.armature.evaluated_get(depsgraph))
        strength = evaluated.wrinkles.strength
        timing = timing_of(evaluated)
        frame = depsgraph.scene.frame_current_final
        wanted = garment.wrinkles.flow.clear_of_body
        body = self._clearance.read(garment, depsgraph, pose, placement, wanted=wanted)
        around = None if body is None else (body.tobytes(), garment.wrinkles.clearance)
        inputs = (pose.matrices.tobytes(), placement.tobytes(), strength, timing, frame, around)
        if only_changes and inputs == self._inputs:
            return None

        def compute() -> None:
            self._evaluator.timing = timing
            self._evaluator.evaluate(pose, self._positions, strength, placement, frame=frame)
            self._outside = describe_outside(self._evaluator.outside)
            if body is not None:
                self._clearance.clear(body, self._positions, placement)

        return Turn(compute, frame, inputs)


def timing_of(garment: bpy.types.Object) -> Timing:
    """Which part of its flow a garment shows when; its settings may be animated, so ask the evaluated object."""
    settings = garment.wrinkles.flow
    return Timing(settings.offset, settings.speed, Ends[settings.ends])


def describe_outside(samples: float) -> str:
    """What to say of a frame that lies outside of the recording by some samples; empty inside."""
    return f"{samples:g} frames outside of the recording: its end is held" if samples else ""


def check_flow_mesh(garment: bpy.types.Object, topology: str, vertex_count: int) -> None:
    """Refuse a garment of another topology than the recorded one.

    Raises:
        ValueError: One sentence that says what differs, and what to do.
    """
    mesh = garment.data
    if len(mesh.vertices) != vertex_count or mesh_topology(mesh) != topology:
        raise ValueError(
            f"The garment '{garment.name}' is not the recorded mesh: it has {len(mesh.vertices)} vertices, the flow "
            f"{vertex_count}, or other faces; undo the change, choose its own flow, or compress a recording of it."
        )
