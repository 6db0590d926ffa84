"""A folder that one window bakes into at a time."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path
from typing import IO

from .storage import StorageError, make_folder

LOCK = "bake.lock"
_BYTE = 1 << 30
"""Where Windows locks a byte: behind what the file holds, so that others can read who holds it."""


class FolderLock:
    """Held until it is closed, or until this process ends, however it ends: the system takes the lock back.

    Shards of one bake on many machines need none, as their files never collide; two windows with one file open do,
    since each would bake the other's settings away.

    Raises:
        StorageError: If another process holds it; one sentence that says which one, and what to do.
    """

    def __init__(self, folder: Path):
        make_folder(folder)
        self._path = folder / LOCK
        while True:
            self._stream: IO[str] = open(self._path, "a+", encoding="utf-8")
            try:
                _lock(self._stream)
            except OSError as error:
                self._stream.close()
                raise StorageError(
                    f"Another Blender is baking into '{folder}' ({self._holder()}); "
                    "wait until it is done, stop it there, or choose another folder."
                ) from error
            if self._is_current():
                break
            # Whoever held it has removed the file since it was opened here.
            self._stream.close()
        self._stream.truncate(0)
        self._stream.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        self._stream.flush()

    def close(self) -> None:
        """Let go; a second time does nothing."""
        if self._stream.closed:
            return
        if os.name != "nt":
            self._path.unlink(missing_ok=True)
        self._stream.close()
        if os.name == "nt":
            try:
                self._path.unlink(missing_ok=True)
            except PermissionError:
                pass  # Another one waits at it, and will remove it.

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _is_current(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self._stream.fileno()), os.stat(self._path))
        except FileNotFoundError:
            return False

    def _holder(self) -> str:
        try:
            return self._path.read_text(encoding="utf-8").strip() or "unknown"
        except OSError:
            return "unknown"


def is_locked(folder: Path) -> bool:
    """Whether a process holds the folder's lock just now."""
    try:
        with open(folder / LOCK, "r+", encoding="utf-8") as stream:
            _lock(stream)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


if sys.platform == "win32":
    import msvcrt

    def _lock(stream: IO[str]) -> None:
        os.lseek(stream.fileno(), _BYTE, os.SEEK_SET)
        msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(stream: IO[str]) -> None:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
