"""Coarse simulations as they are played: caches read at random, and filled while a window plays the animation.

Building a simulation takes copies of the character, which cannot be made while Blender evaluates. So a frame that asks
for one leaves a wish, and the handlers grant it between two frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from weakref import WeakValueDictionary

import bpy

from ..coarse_bake import CoarseHistory
from ..coarse_cache import CoarseCache, NotSimulated, Points
from ..folder_verbs import choose_device
from .coarse_scene import (
    build_history,
    frame_rate,
    read_motion,
    read_scene,
    read_spec,
    simulated_garments,
)
from .file_process import SIMULATE, running
from .preferences import device_name

Garments = Sequence[bpy.types.Object]

_played: WeakValueDictionary[Path, PlayedCache] = WeakValueDictionary()
_wishes: dict[Path, list[str]] = {}
"""Names of the garments whose simulation is to be built, by the folder of its cache."""


def played_cache(folder: Path) -> PlayedCache:
    """What this session knows of a cache folder; garments that are simulated together share it."""
    known = _played.get(folder)
    if known is None:
        known = _played[folder] = PlayedCache(folder)
    return known


class PlayedCache:
    """One cache folder as this session knows it; see :func:`played_cache`.

    Attributes:
        cache: As it was opened or begun; None if it was neither.
        restarted: Why the simulation began anew in the frame that was read last, as a sentence; empty if it did not.
    """

    def __init__(self, folder: Path):
        self.restarted = ""
        self._folder = folder
        self.cache: CoarseCache | None = None
        self._history: CoarseHistory | None = None
        self._failed = ""
        # The frame that was simulated in this evaluation of the scene.
        self._advanced: int | None = None
        # The frame rate for which the cache was compared with the scene; None if it must be again.
        self._checked: float | None = None

    def doubt(self) -> None:
        """Compare the cache with the scene again: something of it changed."""
        self._checked, self._failed = None, ""
        if self._history is None:
            self.cache = None

    def renew(self) -> None:
        """Read the cache anew: somebody else has filled it."""
        self.cache = self._history = None
        self.doubt()

    def holds(self, frame: float) -> bool:
        """Whether a frame lies in the cache, as far as is known."""
        return self.cache is not None and self.cache.first <= frame <= self.cache.last

    def positions(self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Points:
        """Where a garment's coarse layer lies in the depsgraph's frame, in world axes [m].

        Raises:
            NotSimulated: If the cache does not hold this frame of this motion; one sentence.
        """
        scene = depsgraph.scene
        garments = simulated_garments(garment, scene)
        if self.cache is None:
            self.cache, self._checked = CoarseCache.open(self._folder), None
        if self._checked != frame_rate(scene):
            self.cache.check(read_spec(garments, scene))
            self._checked = frame_rate(scene)
        time = scene.frame_current_final
        if time != int(time):
            return self.cache.positions(time)[garment.name]
        frame = int(time)
        if not self.holds(frame):
            self.cache.look()
        # What was simulated a moment ago has the motion that it was simulated with; what is not there, has none.
        known = frame == self._advanced or not self.holds(frame)
        found = self.cache.read(frame) if known else self.cache.read_of(frame, read_motion(garment, depsgraph))
        self.restarted = found.report["reason"]
        return found.positions[garment.name]

    def fill(self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> None:
        """Simulate the depsgraph's frame, if it is the scene's first one or the simulation has come up to it.

        Raises:
            NotSimulated: If the simulation must be built first, which it is then, or cannot be; one sentence.
        """
        if any(process.verb == SIMULATE for process in running.values()):
            # Who fills a cache goes through its frames alone.
            return
        scene = depsgraph.scene
        frame = scene.frame_current
        garments = simulated_garments(garment, scene)
        if frame == scene.frame_start:
            self._begin(garments, scene)
        if self.cache is None or self._checked is None or scene.frame_subframe:
            return
        if self._history is None:
            if frame in (self.cache.first, self.cache.last + 1):
                self._wish(garments)
        elif self._history.follows(frame):
            self._history.advance(read_scene(garments, depsgraph))
            self._advanced = frame

    def look_ahead(self) -> None:
        """After a frame that was simulated: what the next one begins with, and its file, on other threads.

        Python runs on one thread at a time: a frame would wait for the file that is written meanwhile.
        """
        if self._advanced is not None and self._history is not None:
            self._history.simulation.look_ahead()
            self._history.cache.write_behind()
        self._advanced = None

    def _begin(self, garments: Garments, scene: bpy.types.Scene) -> None:
        """See to a cache of what the scene shows, from its first frame on."""
        spec = read_spec(garments, scene)
        self._checked = frame_rate(scene)
        if self.cache is not None and self.cache.spec == spec and self.cache.first == scene.frame_start:
            return
        same = self._history is not None and self._history.cache.spec == spec
        if self.cache is not None:
            self.cache.flush()  # Else its last frame might be written into the emptied folder.
        self.cache = CoarseCache.begin(self._folder, spec, scene.frame_start)
        if self._history is not None and same:
            self._history.turn_to(self.cache)
        else:
            self._history = None

    def _wish(self, garments: Garments) -> None:
        if self._failed:
            raise NotSimulated(self._failed)
        _wishes[self._folder] = [ob.name for ob in garments]
        raise NotSimulated("The coarse simulation is being made ready; play on from here.")

    def make_ready(self, garments: Garments) -> None:
        """Build the simulation that goes on where the cache ends; not while Blender evaluates."""
        assert self.cache is not None
        try:
            self._history = build_history(garments, self.cache, choose_device(device_name()))
        except ValueError as error:
            self._failed = str(error)


def look_ahead() -> None:
    """Once a frame is played and nobody waits: see :meth:`PlayedCache.look_ahead`."""
    for played in _played.values():
        played.look_ahead()


def flush() -> None:
    """Come back when every frame that was simulated is in its file.

    Raises:
        StorageError: If one cannot be written; then it is not there.
    """
    for played in _played.values():
        if played.cache is not None:
            played.cache.flush()


def has_wishes() -> bool:
    """Whether a simulation waits to be built."""
    return bool(_wishes)


def grant_wishes() -> None:
    """Build the simulations that frames have asked for."""
    wishes = dict(_wishes)
    _wishes.clear()
    for folder, names in wishes.items():
        garments = [ob for name in names if (ob := bpy.data.objects.get(name)) is not None]
        if folder in _played and len(garments) == len(names):
            _played[folder].make_ready(garments)
