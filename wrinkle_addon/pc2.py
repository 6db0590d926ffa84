"""PC2 point caches, as Blender's Mesh Cache modifier reads them: a header and float32 positions, little-endian."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .storage import StorageError, make_folder, temporary_name

HEADER = struct.Struct("<12siiffi")
MAGIC = b"POINTCACHE2\0"
VERSION = 1


def write_pc2(path: Path, vertex_count: int, start: float, frames: Iterable[NDArray[np.float32]], count: int) -> None:
    """Write a cache frame by frame, atomically.

    Args:
        path: The file.
        vertex_count: Vertices a frame.
        start: Frame of the first sample.
        frames: Positions in object space, shape [vertex_count, 3] each.
        count: Number of frames that will come.

    Raises:
        StorageError: If the file cannot be written, or another number of frames or vertices came.
    """
    make_folder(path.parent)
    temporary = temporary_name(path)
    written = 0
    try:
        with open(temporary, "xb") as stream:
            stream.write(HEADER.pack(MAGIC, VERSION, vertex_count, start, 1.0, count))
            for frame in frames:
                if frame.shape != (vertex_count, 3):
                    raise StorageError(f"A frame of '{path}' has {len(frame)} vertices, not {vertex_count}.")
                stream.write(np.ascontiguousarray(frame, "<f4").tobytes())
                written += 1
            stream.flush()
            os.fsync(stream.fileno())
        if written != count:
            raise StorageError(f"'{path}' got {written} frames, not {count}.")
        os.replace(temporary, path)
    except OSError as error:
        raise StorageError(
            f"Cannot write '{path}': {error.strerror}; free some space or choose another place."
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


class PointCache:
    """A PC2 file opened for reading, memory-mapped.

    Attributes:
        start: Frame of the first sample.
        frames: Positions in object space, shape [frame_count, vertex_count, 3].

    Raises:
        StorageError: If the file is missing, no PC2 file, or shorter than its header says.
    """

    def __init__(self, path: Path):
        try:
            with open(path, "rb") as stream:
                header = stream.read(HEADER.size)
        except OSError as error:
            raise StorageError(f"Cannot read the point cache '{path}': {error.strerror}.") from error
        if len(header) < HEADER.size or not header.startswith(MAGIC[:11]):
            raise StorageError(f"'{path}' is not a PC2 point cache.")
        _, version, vertex_count, start, rate, count = HEADER.unpack(header)
        if version != VERSION or vertex_count <= 0 or count <= 0:
            raise StorageError(f"The point cache '{path}' has a version or size that cannot be read.")
        if rate != 1.0:
            raise StorageError(
                f"The point cache '{path}' holds {rate} samples a frame; save it with one sample a frame."
            )
        if path.stat().st_size < HEADER.size + 12 * vertex_count * count:
            raise StorageError(f"The point cache '{path}' is truncated.")
        self.start = float(start)
        self.frames = np.memmap(path, "<f4", "r", HEADER.size, (count, vertex_count, 3))
