"""Filling the cache of a coarse simulation: over a range of frames, or one frame after the other as they are played.

history = CoarseHistory(simulation, cache)
for step in bake_history(history, scene_frames, last=120):
    step.frame, step.kept, step.report
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol

import numpy as np

from .coarse_cache import STATE_EVERY, CoarseCache, CoarseFrame, Motion, NotSimulated, Points, moved


@dataclass(frozen=True, eq=False)
class SceneFrame:
    """What drives a simulation in one frame, all in one space.

    Attributes:
        frame: Of the scene.
        body: The body [m], shape [body_vertex_count, 3].
        carried: Each layer carried by plain skinning [m], by its name.
        motion: Points that tell this motion from another one.
    """

    frame: int
    body: Points
    carried: Mapping[str, Points]
    motion: Motion


class Simulation(Protocol):
    """What :class:`.coarse_simulation.CoarseSimulation` offers."""

    def start(self, body_positions: Any, carried: Sequence[Any]) -> Any: ...

    def step(self, body_positions: Any, carried: Sequence[Any], dt: float) -> Any: ...

    def look_ahead(self) -> None: ...

    @property
    def positions(self) -> Sequence[Points]: ...

    def state(self) -> Any: ...

    def restore(self, state: Any) -> None: ...


class CoarseHistory:
    """A simulation, the cache that it fills, and the frame that it stands at.

    Args:
        simulation: Of the layers that the cache is of, in their order.
        cache: The cache.
        state_type: Dataclass of arrays that the simulation goes on from.
        carry: What the simulation takes for the body [m], from the scene's; the same if left out.

    Attributes:
        frame: Where the simulation stands; None before it has begun.
    """

    def __init__(
        self,
        simulation: Simulation,
        cache: CoarseCache,
        state_type: type,
        carry: Callable[[Points], Points] | None = None,
    ):
        self.simulation = simulation
        self.cache = cache
        self.frame: int | None = None
        self._state_type = state_type
        self._carry = carry

    def turn_to(self, cache: CoarseCache) -> None:
        """Fill another cache of the same layers from its first frame on."""
        self.cache, self.frame = cache, None

    def follows(self, frame: int) -> bool:
        """Whether the simulation can go to a frame at once: it is the first, or comes after one that is known whole."""
        return frame == self.cache.first or self._stands_before(frame) or self._has_state(frame - 1)

    def advance(self, scene: SceneFrame, *, keep_state: bool = False) -> Mapping[str, Any]:
        """Simulate a frame that :meth:`follows`, and put it into the cache in place of what lies there and after it.

        Its file is written by the cache's next ``write_behind`` or ``flush``.

        Args:
            scene: What drives it.
            keep_state: Store all it takes to go on from here, whatever the frame.

        Returns:
            What there is to say of the step.

        Raises:
            StorageError: If the frame before it cannot be written.
        """
        report = self.step(scene)
        offset = scene.frame - self.cache.first
        state = self.simulation.state() if keep_state or offset % STATE_EVERY == 0 else None
        arrays = {one.name: np.asarray(getattr(state, one.name)) for one in fields(state)} if state is not None else {}
        positions = dict(zip(self.cache.spec.garments, self.simulation.positions, strict=True))
        self.cache.cut(scene.frame)
        self.cache.write(scene.frame, CoarseFrame(positions, scene.motion, arrays, report))
        return report

    def step(self, scene: SceneFrame) -> Mapping[str, Any]:
        """Simulate a frame without a word to the cache."""
        carried = [scene.carried[name] for name in self.cache.spec.garments]
        body = self._carry(scene.body) if self._carry is not None else scene.body
        if scene.frame == self.cache.first:
            report = self.simulation.start(body, carried)
        else:
            if not self._stands_before(scene.frame):
                self.go_back(scene.frame - 1)
            report = self.simulation.step(body, carried, 1.0 / self.cache.spec.fps)
        self.frame = scene.frame
        return asdict(report)

    def go_back(self, frame: int) -> None:
        """Stand at a frame whose state is known.

        Raises:
            NotSimulated: If it is not.
        """
        state = self.cache.read(frame).state
        if not state:
            raise NotSimulated(f"The coarse simulation cannot go on from frame {frame}; simulate again up to there.")
        self.simulation.restore(self._state_type(**state))
        self.frame = frame

    def _stands_before(self, frame: int) -> bool:
        # What was simulated is lost if it could not be written.
        return self.frame == frame - 1 <= self.cache.last

    def _has_state(self, frame: int) -> bool:
        cache = self.cache
        return cache.first <= frame <= cache.last and bool(cache.read(frame).state)


@dataclass(frozen=True)
class BakedFrame:
    """One frame of a bake.

    Attributes:
        frame: Of the scene.
        kept: Whether it lay in the cache already.
        moved: What has moved since it was simulated, if that is why it was simulated again; else empty.
        report: What there is to say of the step.
    """

    frame: int
    kept: bool
    moved: str
    report: Mapping[str, Any]


def bake_history(history: CoarseHistory, scenes: Iterable[SceneFrame], last: int) -> Generator[BakedFrame, None, None]:
    """Fill a cache from its first frame on; frames that lie there and still have their motion are kept.

    Args:
        history: The simulation and its cache.
        scenes: The scene frame by frame, from the cache's first one on.
        last: The last frame; its state is stored, so that a later bake goes on from there.
    """
    cache = history.cache
    recent: list[SceneFrame] = []
    for scene in scenes:
        differing = ""
        if scene.frame <= cache.last:
            known = cache.read(scene.frame)
            differing = moved(known.motion, scene.motion)
            if not differing:
                # What comes after the last frame whose state is known must be gone through again to go on.
                recent = [] if known.state else [*recent, scene]
                yield BakedFrame(scene.frame, True, "", known.report)
                continue
            cache.cut(scene.frame)
        if recent:
            history.go_back(recent[0].frame - 1)
            for passed in recent:
                history.step(passed)
            recent = []
        report = history.advance(scene, keep_state=scene.frame == last)
        history.simulation.look_ahead()
        # What is said to be done is.
        cache.flush()
        yield BakedFrame(scene.frame, False, differing, report)
