"""The history of a coarse simulation on disk: one file a frame, read at random, filled from the first frame on.

A folder ``NAME.coarse/`` holds ``manifest.json``, which says what the simulation is of, and for every frame where the
layers lie, what drove them there and, every few frames, all it takes to go on from that frame. Files are written whole
or not at all, carry the key of what they are of, and one that is there is finished; a simulation that is stopped goes
on from the last frame that holds its state.

What the cache is of may change behind its back: a mesh, a setting, the frame rate, the motion. The first three are in
the manifest, the motion is in every frame: points of the rig, of the body and of the skinned layers, compared with
those of now. A frame depends on all frames before it, so one that has another motion ends the cache.

    cache = CoarseCache.open(folder)
    cache.check(spec)                               # says what changed
    cache.read_of(12, motion).positions["shirt"]    # [m]
    cache.positions(12.25)["shirt"]                 # between two frames, for motion blur
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import storage
from .storage import StorageError

FORMAT = 1
MANIFEST = "manifest.json"
SUFFIX = ".coarse"
STATE_EVERY = 25
"""Frames between two that can be gone on from."""
SAME_MOTION = 1.0e-4
"""Points that are this near to where they were have not moved [m]: what threads and processors leave open."""

_writer = ThreadPoolExecutor(1, "wrinkle-cache")
"""Waits for the disk, so that nobody else has to."""

Points = NDArray[np.float32]
Motion = Mapping[str, Points]
"""Points that tell one motion from another, by what they are of, each [count, 3] [m]."""


class NotSimulated(ValueError):
    """A frame that the cache does not hold, or holds of another motion; the message says which and what to do."""


@dataclass(frozen=True)
class CoarseSpec:
    """What a coarse simulation is of; all JSON values.

    Attributes:
        garments: Hash of each layer's mesh, pins and strengths by its name, the innermost first.
        body: Hash of the body's mesh.
        settings: How each layer is simulated, by its name.
        fps: Frames a second.
        solver: Version of the solvers.
    """

    garments: Mapping[str, str]
    body: str
    settings: Mapping[str, Mapping[str, Any]]
    fps: float
    solver: str

    def key(self, first: int) -> str:
        """Hash of all this and the frame that the simulation starts in."""
        return storage.content_key({**asdict(self), "order": list(self.garments), "first": first})

    def changes(self, now: CoarseSpec) -> list[str]:
        """What differs, in words that go before "changed"; empty if nothing does."""
        found = []
        if list(self.garments) != list(now.garments):
            found.append(f"the layers ({', '.join(self.garments)}, now {', '.join(now.garments)})")
        else:
            found += [f"the garment '{name}'" for name in now.garments if self.garments[name] != now.garments[name]]
            for name in now.garments:
                found += _setting_changes(self.settings[name], now.settings[name])
        if self.body != now.body:
            found.append("the body's mesh")
        if self.fps != now.fps:
            found.append(f"the frame rate ({self.fps:g}, now {now.fps:g})")
        if self.solver != now.solver:
            found.append("the solver")
        return list(dict.fromkeys(found))


def _setting_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    for name in sorted({*before, *now}):
        old, new = before.get(name), now.get(name)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            yield from _setting_changes(old, new)
        elif old != new:
            yield f"the setting {name.replace('_', ' ')} ({old}, now {new})"


@dataclass(frozen=True, eq=False)
class CoarseFrame:
    """One frame of a history.

    Attributes:
        positions: Where each layer lies [m], by its name.
        motion: What drove it.
        state: Arrays to go on from; empty in most frames.
        report: What there is to say of the step.
    """

    positions: Mapping[str, Points]
    motion: Motion
    state: Mapping[str, NDArray[Any]]
    report: Mapping[str, Any]


@dataclass(eq=False)
class CoarseCache:
    """A cache folder.

    Attributes:
        folder: Where it lies.
        spec: What it is of.
        first: The frame that the simulation starts in.
        last: The last frame that it holds without a gap; ``first`` - 1 if there is none.
    """

    folder: Path
    spec: CoarseSpec
    first: int
    last: int
    _newest: tuple[int, CoarseFrame] | None = None
    """The frame that was added last: played as it is simulated, a frame is read at once, by every garment."""
    _unwritten: bool = False
    """Whether nobody has begun to write it."""
    _writing: Future[None] | None = None
    """Comes to an end when it is in its file."""

    @staticmethod
    def open(folder: Path) -> CoarseCache:
        """The cache in a folder.

        Raises:
            NotSimulated: If there is none.
            StorageError: If it cannot be read.
        """
        if not (folder / MANIFEST).exists():
            raise NotSimulated(f"There is no coarse simulation in '{folder}'; simulate it first.")
        manifest = storage.read_json(folder / MANIFEST)
        try:
            if manifest["format"] != FORMAT:
                raise StorageError(
                    f"The coarse simulation in '{folder}' has the format {manifest['format']}, which this version does "
                    "not know; simulate it again."
                )
            spec = dict(manifest["spec"])
            order = spec.pop("order")
            garments = {name: spec["garments"][name] for name in order}
            cache = CoarseCache(folder, CoarseSpec(**{**spec, "garments": garments}), int(manifest["first"]), 0)
        except (KeyError, TypeError) as error:
            raise StorageError(f"The file '{folder / MANIFEST}' is damaged; simulate again.") from error
        cache.last = cache.first - 1
        cache.look()
        return cache

    @staticmethod
    def begin(folder: Path, spec: CoarseSpec, first: int) -> CoarseCache:
        """An empty cache in a folder, in place of an earlier one.

        Raises:
            StorageError: If it cannot be written.
        """
        storage.make_folder(folder)
        cache = CoarseCache(folder, spec, first, first - 1)
        manifest = {"format": FORMAT, "first": first, "spec": {**asdict(spec), "order": list(spec.garments)}}
        storage.write_json(folder / MANIFEST, manifest)
        for path in folder.glob(f"frame-*{storage.ARRAY_SUFFIX}"):
            path.unlink(missing_ok=True)
        return cache

    @cached_property
    def key(self) -> str:
        return self.spec.key(self.first)

    def look(self) -> None:
        """See how far the cache reaches by now; another process may be filling it."""
        while self._path(self.last + 1).exists():
            self.last += 1

    # --- reading --------------------------------------------------------------------------------------------------

    def check(self, spec: CoarseSpec) -> None:
        """Refuse a cache that is of something else.

        Raises:
            NotSimulated: One sentence that says what changed.
        """
        changes = self.spec.changes(spec)
        if changes:
            raise NotSimulated(
                f"The coarse simulation in '{self.folder}' was made before {_listed(changes)} changed; simulate again."
            )

    def read_of(self, frame: int, motion: Motion) -> CoarseFrame:
        """One frame, of a motion.

        Args:
            motion: That of now; what it leaves out is not compared.

        Raises:
            NotSimulated: If the cache does not hold it, or another motion drove it; one sentence.
        """
        found = self.read(frame)
        differing = moved(found.motion, motion)
        if differing:
            raise NotSimulated(
                f"The motion changed since the coarse simulation in '{self.folder}' was made: {differing} elsewhere in "
                f"frame {frame}; simulate again."
            )
        return found

    def read(self, frame: int) -> CoarseFrame:
        """One frame.

        Raises:
            NotSimulated: If the cache does not hold it.
            StorageError: If its file is damaged.
        """
        if frame > self.last:
            self.look()
        if not self.first <= frame <= self.last:
            held = f"holds frames {self.first} to {self.last}" if self.last >= self.first else "is empty"
            there = "up to" if frame > self.last else "from"
            raise NotSimulated(
                f"The coarse simulation in '{self.folder}' {held}, not frame {frame}; simulate {there} it."
            )
        if self._newest is not None and self._newest[0] == frame:
            return self._newest[1]
        arrays, metadata = storage.read_arrays(self._path(frame))
        found: dict[str, dict[str, NDArray[Any]]] = {"positions": {}, "motion": {}, "state": {}}
        for name, array in arrays.items():
            part, _, rest = name.partition("/")
            found[part][rest] = array
        return CoarseFrame(**found, report=metadata["report"])

    def positions(self, time: float) -> Mapping[str, Points]:
        """Where the layers lie [m], at a frame or, for motion blur, between two.

        Raises:
            NotSimulated: If the cache does not hold the frames around this time.
        """
        before = int(np.floor(time))
        share = np.float32(time - before)
        found = self.read(before).positions
        if share == 0.0:
            return found
        after = self.read(before + 1).positions
        return {name: points + share * (after[name] - points) for name, points in found.items()}

    def last_state(self, frame: int) -> int | None:
        """The last frame up to this one that can be gone on from; None if there is none."""
        for earlier in range(min(frame, self.last), self.first - 1, -1):
            if self.read(earlier).state:
                return earlier
        return None

    # --- writing --------------------------------------------------------------------------------------------------

    def write(self, frame: int, content: CoarseFrame) -> None:
        """Add the frame after the last one; :meth:`flush` puts it into its file, or :meth:`write_behind` begins to.

        Raises:
            StorageError: If the one before it cannot be written.
        """
        if frame != self.last + 1:
            raise ValueError(f"After frame {self.last} comes frame {self.last + 1}, not {frame}.")
        self.flush()
        self.last, self._newest, self._unwritten = frame, (frame, content), True

    def write_behind(self) -> None:
        """Begin to write the frame that was added last, on another thread, until :meth:`flush` comes back."""
        if self._unwritten and self._newest is not None:
            self._unwritten = False
            self._writing = _writer.submit(self._store, *self._newest)

    def flush(self) -> None:
        """Come back when every frame is in its file.

        Raises:
            StorageError: If the last one cannot be written; then it is not there.
        """
        self.write_behind()
        writing, self._writing = self._writing, None
        if writing is None:
            return
        try:
            writing.result()
        except StorageError:
            self.last, self._newest = self.last - 1, None
            raise

    def _store(self, frame: int, content: CoarseFrame) -> None:
        parts = {"positions": content.positions, "motion": content.motion, "state": content.state}
        arrays = {f"{part}/{name}": array for part, values in parts.items() for name, array in values.items()}
        storage.write_arrays(self._path(frame), arrays, {"frame": frame, "report": dict(content.report)})

    def cut(self, frame: int) -> None:
        """Forget this frame and all after it, the last first, so that what is left never has a gap."""
        self.flush()
        for gone in range(self.last, max(frame, self.first) - 1, -1):
            self._path(gone).unlink(missing_ok=True)
            self.last = gone - 1

    def _path(self, frame: int) -> Path:
        return self.folder / f"frame-{self.key}-{frame:06d}{storage.ARRAY_SUFFIX}"


def moved(before: Motion, now: Motion) -> str:
    """What has moved, with a verb, such as "the armature is"; empty if nothing has."""
    for name, points in now.items():
        known = before.get(name)
        if known is not None and (
            known.shape != points.shape or (len(points) and np.abs(known - points).max() > SAME_MOTION)
        ):
            return f"the {name} is"
    return ""


def _listed(items: list[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
