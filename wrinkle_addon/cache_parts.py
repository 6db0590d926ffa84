"""A point cache that is made in parts: by several processes at once, or by one that was stopped and goes on.

Parts are point caches of their own in a folder beside the result, ``NAME.parts``. Each is whole or not there, so what
is missing is what no part holds; whoever finds a part missing may make it. Nothing waits for anybody, and a part that
two have made is the same twice.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .pc2 import PointCache, write_pc2
from .storage import StorageError

LONGEST = 50
"""Frames of a part at most: what a process that is stopped loses."""


@dataclass(frozen=True)
class CacheParts:
    """Parts of one result.

    Attributes:
        folder: Where they lie.
        key: Hash of all that decides their content; parts of another key are not seen.
        vertex_count: Vertices a frame.
    """

    folder: Path
    key: str
    vertex_count: int

    @staticmethod
    def beside(result: Path, key: str, vertex_count: int) -> CacheParts:
        """Parts of the result at this path."""
        return CacheParts(result.with_name(f"{result.name}.parts"), key, vertex_count)

    def missing(self, frames: range) -> list[range]:
        """The frames that no part holds, in stretches of at most ``LONGEST``."""
        held = np.zeros(len(frames), bool)
        for cache in self._caches():
            first = round(cache.start) - frames.start
            held[max(first, 0) : max(first + len(cache.frames), 0)] = True
        stretches: list[range] = []
        for frame, is_held in zip(frames, held, strict=True):
            if is_held:
                continue
            if stretches and frame == stretches[-1].stop and len(stretches[-1]) < LONGEST:
                stretches[-1] = range(stretches[-1].start, frame + 1)
            else:
                stretches.append(range(frame, frame + 1))
        return stretches

    def fill(self, frames: range, positions: Callable[[range], Iterable[NDArray[np.float32]]]) -> Iterator[range]:
        """Make the parts that are missing; yields each one's frames when it is there.

        Args:
            frames: Those that must be there in the end.
            positions: Gives the garment in each of some frames, shape [vertex_count, 3].
        """
        for stretch in self.missing(frames):
            path = self.folder / f"{self.key}_{stretch.start}_{stretch.stop - 1}.pc2"
            write_pc2(path, self.vertex_count, stretch.start, positions(stretch), len(stretch))
            yield stretch

    def join(self, frames: range, path: Path) -> None:
        """Write one cache of all frames; the parts stay.

        Raises:
            StorageError: If frames are missing, or the file cannot be written.
        """
        missing = self.missing(frames)
        if missing:
            raise StorageError(
                f"{sum(map(len, missing))} of {len(frames)} frames of '{path}' are still to be made, "
                f"the first is {missing[0].start}."
            )
        write_pc2(path, self.vertex_count, frames.start, self._read(frames), len(frames))

    def remove(self) -> None:
        """Remove the parts, those of other keys and what was left unfinished included."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _read(self, frames: range) -> Iterator[NDArray[np.float32]]:
        caches = self._caches()
        for frame in frames:
            yield next(
                cache.frames[place]
                for cache in caches
                if 0 <= (place := frame - round(cache.start)) < len(cache.frames)
            )

    def _caches(self) -> list[PointCache]:
        """All whole parts; a damaged one is as good as none."""
        found = []
        for path in sorted(self.folder.glob(f"{self.key}_*.pc2")):
            try:
                cache = PointCache(path)
            except StorageError:
                continue
            if cache.frames.shape[1] == self.vertex_count:
                found.append(cache)
        return found
