"""One interface for every way to turn a pose into a garment."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .rig import Pose
from .threads import THREADS, help_is_free, run_side_by_side

LEAST_SPLIT = 4_000
"""Vertices below which a launch on the CPU is not worth splitting over threads."""

BLOCK_SIZE = 512
"""Vertices that a CPU deals with at a time, so that what it knows of them stays in its nearest cache."""


PARTS_EACH = 3
"""Parts of a recorded launch for each thread: one that is done sooner takes another."""


class Method(ABC):
    """A trained method: immutable; :meth:`bind` makes it ready to run."""

    @property
    @abstractmethod
    def vertex_count(self) -> int: ...

    @abstractmethod
    def bind(self, device: str = "cpu") -> Evaluator:
        """Allocate all that evaluation needs on a Warp device, once."""


class Evaluator(ABC):
    """A method on a device. Evaluation allocates nothing and depends on nothing but the pose and the strengths.

    Attributes:
        clamped: For each joint whose angles left the sampled range in the last pose, by how much [rad], shape [dof].
    """

    clamped: dict[str, NDArray[np.float64]]

    @abstractmethod
    def evaluate(
        self,
        pose: Pose,
        out: wp.array,
        strength: Mapping[str, float] | float = 1.0,
        placement: NDArray[np.float64] | None = None,
    ) -> None:
        """Write the garment's positions.

        Args:
            pose: Bone matrices of the rig that the method was made for.
            out: Array of vec3 on the evaluator's device, shape [vertex_count].
            strength: Of the wrinkles, in all or by joint; 0 is plain skinning, 1 as simulated.
            placement: Affine matrix from rig space [m] to the space asked for, shape [4, 4]; rig space if left out.
        """

    def positions(self, pose: Pose, strength: Mapping[str, float] | float = 1.0) -> NDArray[np.float32]:
        """:meth:`evaluate` in rig space [m], into a new NumPy array of shape [vertex_count, 3]."""
        out = wp.zeros(self.vertex_count, dtype=wp.vec3, device=self.device)
        self.evaluate(pose, out, strength)
        return out.numpy()

    @property
    @abstractmethod
    def vertex_count(self) -> int: ...

    @property
    @abstractmethod
    def device(self) -> wp.Device: ...


class SplitLaunch:
    """Launches a kernel over blocks of vertices whose first argument is the first block of its part.

    On a CPU parts run on several threads.

    Args:
        vertex_count: As many vertices as there is work for.
        device: Warp device.
        block_size: Vertices of a block.
        block_count: Blocks, if they are not of vertices.
    """

    def __init__(self, vertex_count: int, device: wp.Device, block_size: int = 1, block_count: int | None = None):
        self._threads = max(1, min(THREADS, vertex_count // LEAST_SPLIT)) if device.is_cpu else 1
        self._block_count = block_count or -(-vertex_count // block_size)
        self._device = device

    def _parts(self, count: int) -> list[tuple[int, int]]:
        """First block and number of blocks of so many parts."""
        edges = [self._block_count * part // count for part in range(count + 1)]
        return [(a, b - a) for a, b in itertools.pairwise(edges) if b > a]

    def __call__(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        """Run the kernel over all blocks; ``inputs`` leave out the first block."""
        self.run(
            lambda first, count: wp.launch(
                kernel, dim=count, inputs=[first, *inputs], outputs=outputs, device=self._device
            )
        )

    def record(self, kernel: wp.Kernel, inputs: list, outputs: list) -> RecordedLaunch:
        """The launch of :meth:`__call__`, to be repeated at a fraction of what a first one costs."""
        return self.record_parts(
            lambda first, count: wp.launch(
                kernel, count, [first, *inputs], outputs, device=self._device, record_cmd=True
            )
        )

    def record_parts(self, record: Callable[[int, int], wp.Launch]) -> RecordedLaunch:
        """A launch of which the caller records every part: its first block and its number of blocks."""
        parts = self._parts(PARTS_EACH * self._threads if self._threads > 1 else 1)
        return RecordedLaunch(record(0, self._block_count), [record(*part) for part in parts], self._threads)

    def run(self, act: Callable[[int, int], object]) -> None:
        """Run an act on the first block and the number of blocks of every part."""
        run_side_by_side([partial(act, *part) for part in self._parts(self._threads)], self._threads)


class RecordedLaunch:
    """A launch that is repeated, with other arguments now and then: in parts if other threads are free to help.

    Args:
        whole: The launch.
        parts: The same in parts.
        threads: How many may run at a time.
    """

    def __init__(self, whole: wp.Launch, parts: list[wp.Launch], threads: int):
        self._whole, self._parts = _Retold([whole]), _Retold(parts)
        self._threads = threads

    def __call__(self, changed: Mapping[str, object] = MappingProxyType({})) -> None:
        """Run it; ``changed`` are new values of arguments by name, of those that the kernel has."""
        for launches in (self._whole, self._parts):
            launches.tell(changed)
        if self._threads > 1 and help_is_free():
            run_side_by_side(self._parts.ready(), self._threads)
        else:
            for launch in self._whole.ready():
                launch()


class _Retold:
    """Launches of one kernel, told of new arguments once they run."""

    def __init__(self, launches: list[wp.Launch]):
        self._launches = launches
        self._names = {argument.label for argument in launches[0].kernel.adj.args}
        self._news: dict[str, object] = {}

    def tell(self, changed: Mapping[str, object]) -> None:
        self._news.update(changed)

    def ready(self) -> list[Callable[[], None]]:
        for name in self._news.keys() & self._names:
            for launch in self._launches:
                launch.set_param_by_name(name, self._news[name])
        self._news.clear()
        return [launch.launch for launch in self._launches]
