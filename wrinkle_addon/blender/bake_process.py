"""A bake of the open file in a process of its own, so that the window stays free and the scene is never touched."""

from __future__ import annotations

import atexit
import json
import queue
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ..attendance import GO_ON, PAUSE
from ..folder_lock import FolderLock
from ..plan import duration_text
from .command import own_command
from .files import database_folder
from .preferences import device_name

PATIENCE = 5.0
"""Time that a process gets to end by itself before it is killed [s]."""


@dataclass(frozen=True)
class BakeProgress:
    """How far a bake is.

    Attributes:
        done, total: Samples; total is 0 before the first is done.
        name: The sample that was finished last.
        remaining: Estimated time left [s], None as long as there is no estimate.
        residual: How far that sample is from equilibrium [nodal weights], None if its source did not say.
        restless: Samples that did not come to rest so far.
    """

    done: int = 0
    total: int = 0
    name: str = ""
    remaining: float | None = None
    residual: float | None = None
    restless: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        if not self.total:
            return "Starting"
        left = "" if self.remaining is None else f", {duration_text(self.remaining)} left"
        return f"{self.done} of {self.total} samples{left}"

    @property
    def last_sample(self) -> str:
        """The sample that was finished last, and how it came out."""
        if not self.name or self.residual is None:
            return self.name
        return f"{self.name}, residual {self.residual:.2g}"

    def after(self, event: Mapping[str, Any]) -> BakeProgress:
        """This, and what the process has reported since."""
        report = event["report"]
        restless = self.restless if report.get("converged", True) else (*self.restless, event["name"])
        return BakeProgress(
            event["done"], event["total"], event["name"], event["remaining"], report.get("residual"), restless
        )


class BakeProcess:
    """Bakes one garment from a temporary copy of the file, in another Blender.

    Finished samples stay in the database's folder whatever happens; the copy never stays. Use it as a context, or see
    to :meth:`close`.

    Attributes:
        progress: As of the last :meth:`poll`.
        paused: Whether it was told to wait with the next sample.

    Raises:
        ValueError: If the garment has no folder to bake into, another Blender bakes into it, or the copy cannot be
            saved; one sentence.
    """

    def __init__(self, garment: bpy.types.Object):
        self.progress = BakeProgress()
        self.paused = False
        self._error = ""
        self._last_line = ""
        database = database_folder(garment)
        self._lock = FolderLock(database)
        self._folder = Path(tempfile.mkdtemp(prefix="wrinkle-bake-"))
        self._process: subprocess.Popen[str] | None = None
        atexit.register(self.close)
        try:
            copy = self._folder / "copy.blend"
            bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True, check_existing=False)
            self._process = subprocess.Popen(
                own_command(
                    "bake", str(copy), "--garment", garment.name, "--database", str(database),
                    "--device", device_name(), "--progress", "json", "--attended",
                ),
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
            )  # fmt: skip
        except RuntimeError as error:
            self.close()
            reason = " ".join(str(error).split())
            raise ValueError(f"A copy of the file could not be saved for baking: {reason}") from error
        except BaseException:
            self.close()
            raise
        self._lines: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, args=(self._process,), daemon=True).start()

    def __enter__(self) -> BakeProcess:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def poll(self, timeout: float = 0.0) -> bool:
        """Take in what the process has reported; says whether it is still running.

        Args:
            timeout: How long to wait for a first report [s].

        Raises:
            ValueError: If the bake failed, with the process's own sentence.
        """
        assert self._process is not None
        try:
            line = self._lines.get(timeout=timeout) if timeout else self._lines.get_nowait()
            while line is not None:
                self._take(line)
                line = self._lines.get_nowait()
        except queue.Empty:
            return True
        code = self._process.wait()
        if code:
            last = f" ({self._last_line})" if self._last_line else ""
            raise ValueError(self._error or f"The baking process ended with code {code}{last}; bake again to go on.")
        return False

    def pause(self) -> None:
        """Let the process finish the sample that it works on, and wait."""
        self._tell(PAUSE)
        self.paused = True

    def go_on(self) -> None:
        """Let the process go on after a pause."""
        self._tell(GO_ON)
        self.paused = False

    def _tell(self, word: str) -> None:
        assert self._process is not None and self._process.stdin is not None
        try:
            self._process.stdin.write(f"{word}\n")
            self._process.stdin.flush()
        except OSError:
            pass  # It has ended; the next poll says how.

    def close(self) -> None:
        """End the process if it runs, and remove the copy of the file."""
        atexit.unregister(self.close)
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)
        self._lock.close()

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        for line in process.stderr:
            self._lines.put(line)
        self._lines.put(None)

    def _take(self, line: str) -> None:
        """One line of the process's standard error: an event as JSON, or anything else that was printed."""
        if not line.startswith("{"):
            self._last_line = line.strip() or self._last_line
            return
        event = json.loads(line)
        if event["event"] == "sample":
            self.progress = self.progress.after(event)
        elif event["event"] == "error":
            self._error = event["message"]


running: dict[int, BakeProcess] = {}
"""Bakes started from the window, by the session_uid of their garment; taking one out stops it."""
