"""Method 2: a recorded animation replayed as skinning plus principal components (Kim and Farbiz 2011).

It replays: what it shows is right where it was recorded, and on any other motion the same wrinkles go by on another
pose.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.flow import BonePose, add_flow, add_residuals
from .flow_file import Flow
from .flow_residuals import BoneFrames, ResidualSpace, Skinning
from .joint_wrinkles import HostArray, upload_skin
from .method import Evaluator, Method, SplitLaunch
from .rig import FloatArray, Pose


class Ends(enum.Enum):
    """What is shown before the first and after the last recorded frame."""

    HOLD = "hold"
    LOOP = "loop"


@dataclass(frozen=True)
class Timing:
    """Which part of a recording is shown when.

    Attributes:
        offset: Frames by which it is shown later.
        speed: Recorded frames a frame; below 0 backwards from its last frame.
        ends: What is shown beyond it.
    """

    offset: float = 0.0
    speed: float = 1.0
    ends: Ends = Ends.HOLD

    def sample(self, frame: float, start: float, count: int) -> tuple[float, float]:
        """Place in the recording, from 0 to count - 1, and by how many samples the frame lies outside of it.

        Args:
            frame: Scene frame, with its fraction.
            start: Scene frame of the first sample.
            count: Number of samples.
        """
        elapsed = self.speed * (frame - start - self.offset)
        place = elapsed if self.speed >= 0.0 else count - 1 + elapsed
        if self.ends is Ends.LOOP and count > 1:
            # The last sample is the first of the next round.
            return place % (count - 1) if not 0.0 <= place <= count - 1 else place, 0.0
        clamped = min(max(place, 0.0), count - 1.0)
        return clamped, abs(place - clamped)


class FlowMethod(Method):
    """A wrinkle flow, ready to be bound to a device."""

    def __init__(self, flow: Flow, timing: Timing | None = None):
        self.flow = flow
        self.timing = timing or Timing()

    @property
    def vertex_count(self) -> int:
        return self.flow.vertex_count

    def bind(self, device: str = "cpu") -> FlowEvaluator:
        return FlowEvaluator(self, wp.get_device(device))


class FlowEvaluator(Evaluator):
    """x~ = x^ + U z (F06), with the mean residual among U, and z interpolated between frames.

    Attributes:
        timing: Which part is shown when; may be changed between frames.
        outside: By how many samples the last frame lay outside the recording.
    """

    def __init__(self, method: FlowMethod, device: wp.Device):
        flow = method.flow
        self.timing = method.timing
        self.outside = 0.0
        self.clamped = {}
        self._flow = flow
        self._device = device
        self._skin = upload_skin(flow.rest, flow.weights, device)
        self._dual_quaternions = flow.header.skinning is Skinning.DUAL_QUATERNION
        self._in_bone_frames = flow.header.space is ResidualSpace.BONES
        bones = flow.rig.bone_count
        self._matrices = HostArray((3 * bones,), wp.vec4, device)
        self._turns = HostArray((bones,), wp.quat, device)
        self._duals = HostArray((bones,), wp.quat, device)
        self._placement = HostArray((3,), wp.vec4, device)
        self._coefficients = HostArray((len(flow.shapes),), wp.float32, device)
        self._pose = BonePose()
        self._pose.matrices = self._matrices.device
        self._pose.turns = self._turns.device
        self._pose.duals = self._duals.device
        self._launch = SplitLaunch(flow.vertex_count, device)
        if device.is_cpu:
            # One product of a matrix and a vector, which is what BLAS is for.
            self._basis = flow.shapes.reshape(len(flow.shapes), -1)
            self._residuals = wp.zeros(flow.vertex_count, dtype=wp.vec3, device=device)
            self._summed = self._residuals.numpy().reshape(-1)
        else:
            self._uploaded = wp.array(flow.shapes, dtype=wp.vec3, device=device)

    def positions(
        self, pose: Pose, strength: Mapping[str, float] | float = 1.0, *, frame: float | None = None
    ) -> NDArray[np.float32]:
        """:meth:`evaluate` in rig space [m], into a new NumPy array of shape [vertex_count, 3]."""
        out = wp.zeros(self.vertex_count, dtype=wp.vec3, device=self.device)
        self.evaluate(pose, out, strength, frame=frame)
        return out.numpy()

    @property
    def vertex_count(self) -> int:
        return self._flow.vertex_count

    @property
    def device(self) -> wp.Device:
        return self._device

    def evaluate(
        self,
        pose: Pose,
        out: wp.array,
        strength: Mapping[str, float] | float = 1.0,
        placement: FloatArray | None = None,
        *,
        frame: float | None = None,
    ) -> None:
        """See :meth:`.method.Evaluator.evaluate`.

        Args:
            strength: Of the residual: 0 is plain skinning, 1 as recorded. A recording knows no joints: of strengths by
                joint, the first counts.
            frame: Scene frame, with its fraction; left out, the first recorded one.
        """
        amount = next(iter(strength.values()), 1.0) if isinstance(strength, Mapping) else strength
        flow = self._flow
        place, self.outside = self.timing.sample(
            flow.header.start if frame is None else frame, flow.header.start, flow.frame_count
        )
        below = min(int(place), flow.frame_count - 1)
        above, t = min(below + 1, flow.frame_count - 1), np.float32(place - below)
        self._coefficients.host[:] = (1 - t) * flow.coefficients[below] + t * flow.coefficients[above]
        bones = BoneFrames.of(flow.rig, [pose])
        self._matrices.host[:] = bones.matrices[0]
        self._turns.host[:] = bones.turns[0]
        self._duals.host[:] = bones.duals[0]
        self._placement.host[:] = np.eye(4)[:3] if placement is None else placement[:3]
        for array in (self._matrices, self._turns, self._duals, self._placement):
            array.upload()
        inputs = [
            self._skin,
            self._pose,
            self._dual_quaternions,
            self._in_bone_frames,
            float(amount),
            self._placement.device,
        ]
        if self._device.is_cpu:
            np.dot(self._coefficients.host, self._basis, out=self._summed)
            self._launch(add_residuals, [*inputs, self._residuals], [out])
        else:
            self._coefficients.upload()
            self._launch(add_flow, [*inputs, self._uploaded, self._coefficients.device], [out])
