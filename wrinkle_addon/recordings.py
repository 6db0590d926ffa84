"""Recorded animations of a mesh: point caches (PC2, MDD), folders of numbered files (.npy, .obj)."""

from __future__ import annotations

import re
import struct
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .pc2 import PointCache
from .rig import FloatArray
from .steps import Steps, finish
from .storage import StorageError

KINDS = "a .pc2 or .mdd file, or a folder of numbered .npy or .obj files"

Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From axes with y up, as .obj files have them, to Blender's."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Positions of one mesh over frames without a gap.

    Attributes:
        name: Where they come from, for messages.
        frames: Positions, on disk or in memory, shape [frame_count, vertex_count, 3].
        start: Scene frame of the first.
        to_object: Matrix from the file's axes to the object's own space, shape [4, 4].
    """

    name: str
    frames: NDArray[np.float32]
    start: float
    to_object: FloatArray

    @property
    def frame_count(self) -> int:
        return len(self.frames)

    @property
    def vertex_count(self) -> int:
        return self.frames.shape[1]


def open_recording(path: Path, start: float | None = None) -> Recording:
    """Open a recording; caches stay on disk, numbered files are put into one temporary file.

    Args:
        path: A .pc2 or .mdd file, or a folder of numbered files.
        start: Scene frame of the first sample; left out, as the file says, or 1.

    Raises:
        ValueError: If it cannot be read, is truncated, or its meshes differ in topology; one sentence.
    """
    kind = path.suffix.lower()
    if path.is_dir():
        frames, to_object = _read_folder(path)
        known = 1.0
    elif kind == ".pc2":
        cache = PointCache(path)
        frames, known, to_object = cache.frames, cache.start, np.eye(4)
    elif kind == ".mdd":
        frames, known, to_object = _read_mdd(path), 1.0, np.eye(4)
    elif not path.exists():
        raise StorageError(f"There is no recording '{path}'.")
    else:
        raise ValueError(f"'{path.name}' is no recording that can be read; give {KINDS}.")
    return Recording(path.name, frames, known if start is None else start, to_object)


def gather(frames: Iterable[NDArray[np.floating]], frame_count: int, name: str) -> Steps[NDArray[np.float32]]:
    """Frames that come one by one in a temporary file, so that no more than one need be in memory; a step each.

    Args:
        frames: Positions, shape [vertex_count, 3] each.
        frame_count: Frames that will come.
        name: Of the recording, for messages.

    Raises:
        ValueError: If the number of vertices changes.
    """
    gathered: NDArray[np.float32] | None = None
    for number, frame in enumerate(frames):
        if gathered is None:
            # The file goes with the array: it has no name.
            stream = tempfile.TemporaryFile()
            gathered = np.memmap(stream, np.float32, "w+", shape=(frame_count, len(frame), 3))
        if frame.shape != gathered.shape[1:]:
            raise ValueError(
                f"The mesh of '{name}' has {gathered.shape[1]} vertices at first and {len(frame)} in sample "
                f"{number + 1}; record it with one topology."
            )
        gathered[number] = frame
        yield (number + 1) / frame_count, f"frame {number + 1} of {frame_count}"
    if gathered is None:
        raise ValueError(f"The recording '{name}' holds no frame.")
    return gathered


def _read_mdd(path: Path) -> NDArray[np.float32]:
    """A Lightwave MDD cache: counts, times and positions, big-endian."""
    try:
        with open(path, "rb") as stream:
            header = stream.read(8)
        size = path.stat().st_size
    except OSError as error:
        raise StorageError(f"Cannot read the point cache '{path}': {error.strerror}.") from error
    if len(header) < 8:
        raise StorageError(f"'{path}' is not an MDD point cache.")
    frame_count, vertex_count = struct.unpack(">ii", header)
    if frame_count <= 0 or vertex_count <= 0:
        raise StorageError(f"'{path}' is not an MDD point cache.")
    if size < 8 + 4 * frame_count + 12 * vertex_count * frame_count:
        raise StorageError(f"The point cache '{path}' is truncated.")
    return np.memmap(path, ">f4", "r", 8 + 4 * frame_count, (frame_count, vertex_count, 3))


def _read_folder(folder: Path) -> tuple[NDArray[np.float32], FloatArray]:
    for suffix, read, axes in ((".npy", _read_npy, np.eye(4)), (".obj", _ObjReader(), Y_UP)):
        files = {}
        for path in folder.glob(f"*{suffix}"):
            numbers = re.findall(r"\d+", path.stem)
            if numbers:
                files[int(numbers[-1])] = path
        if not files:
            continue
        numbers = sorted(files)
        if numbers[-1] - numbers[0] + 1 != len(numbers):
            gap = next(a + 1 for a in numbers if a + 1 not in files)
            raise ValueError(f"The folder '{folder}' has no file number {gap}; a recording has every frame.")
        steps = gather((read(files[number]) for number in numbers), len(numbers), folder.name)
        return finish(steps, lambda share, text: None), axes
    raise ValueError(f"The folder '{folder}' holds no numbered .npy or .obj files.")


def _read_npy(path: Path) -> NDArray[np.floating]:
    try:
        frame = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise StorageError(f"The file '{path}' is damaged; record it again.") from error
    if not isinstance(frame, np.ndarray) or frame.ndim != 2 or frame.shape[1] != 3 or frame.dtype.kind != "f":
        raise ValueError(f"The file '{path}' does not hold positions of shape [vertex_count, 3].")
    return frame


class _ObjReader:
    """Reads positions of .obj files whose faces are all the same."""

    def __init__(self) -> None:
        self._faces: list[str] | None = None

    def __call__(self, path: Path) -> FloatArray:
        try:
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
            positions = [line.split()[1:4] for line in lines if line.startswith("v ")]
            frame = np.array(positions, np.float64).reshape(len(positions), 3)
        except (OSError, ValueError) as error:
            raise StorageError(f"The file '{path}' is damaged; record it again.") from error
        # Normals are numbered anew in every file.
        faces = [" ".join(corner.split("/")[0] for corner in line.split()) for line in lines if line.startswith("f ")]
        if self._faces is None:
            self._faces = faces
        if faces != self._faces:
            raise ValueError(f"The faces in '{path}' are not those of the first file; record it with one topology.")
        return frame
