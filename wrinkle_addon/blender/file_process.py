"""A verb on a copy of the open file, in a process of its own: the window stays free, the scene is never touched."""

from __future__ import annotations

import atexit
import json
import queue
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import bpy

from ..attendance import GO_ON, PAUSE
from ..folder_lock import FolderLock, is_locked
from .command import own_command
from .relative_paths import absolute_paths

BAKE, SIMULATE, SYNTHESIZE, EVALUATE, COMPRESS = "bake", "simulate", "synthesize", "evaluate", "flow compress"
"""Verbs that are run behind the window."""

PREFIX = "wrinkle-process-"
"""Of the folders that copies lie in, among what is temporary."""
LEFT_BEHIND = 60.0
"""A folder of this age that nobody has locked by now was left by a Blender that crashed [s]."""

PATIENCE = 5.0
"""Time that a process gets to end by itself before it is killed [s]."""


class Progress(Protocol):
    """How far a process is.

    Attributes:
        share: Of the work, from 0 to 1.
        text: How much is done, and how long the rest takes if that is known.
        last: What was finished last; may be empty.
    """

    @property
    def share(self) -> float: ...

    @property
    def text(self) -> str: ...

    @property
    def last(self) -> str: ...

    def after(self, event: Mapping[str, Any]) -> Progress:
        """This, and what the process has reported since."""
        ...


@dataclass(frozen=True)
class StepProgress:
    """How far a process is that reports shares of its work; see :class:`Progress`."""

    share: float = 0.0
    text: str = "Starting"
    last: str = ""

    def after(self, event: Mapping[str, Any]) -> StepProgress:
        return StepProgress(event["share"], f"{100 * event['share']:.0f} %", event["text"])


class FileProcess:
    """Runs a verb on a temporary copy of the open file, in another Blender. The copy never stays.

    Use it as a context, or see to :meth:`close`.

    Args:
        garment: The garment that it is about.
        verb: With its action, such as "flow compress".
        arguments: Of the verb, next to the file and the garment.
        doing: What it does, in two words, for the status bar.
        progress: How far it is before it has begun.
        lock: A folder that one window at a time writes into.

    Attributes:
        progress: As of the last :meth:`poll`.
        paused: Whether it was told to wait.
        stopped: Whether it was told to end.

    Raises:
        ValueError: If another Blender writes into the folder, or the copy cannot be saved; one sentence.
    """

    def __init__(
        self,
        garment: bpy.types.Object,
        verb: str,
        arguments: Sequence[str],
        *,
        doing: str,
        progress: Progress | None = None,
        lock: Path | None = None,
    ):
        self.verb, self.doing = verb, doing
        self.progress: Progress = progress or StepProgress()
        self.paused = self.stopped = False
        self._killed_at = 0.0
        self._error = self._last_line = ""
        self._lock = None if lock is None else FolderLock(lock)
        sweep()
        self._folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        self._own = FolderLock(self._folder)
        self._process: subprocess.Popen[str] | None = None
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._said_all = False
        atexit.register(self.close)
        try:
            copy = self._save_copy()
            self._process = self._start(
                own_command(
                    *verb.split(), str(copy), "--garment", garment.name, *arguments,
                    "--json", "--progress", "json", "--attended",
                )
            )  # fmt: skip
        except BaseException:
            self.close()
            raise
        threading.Thread(target=self._read, args=(self._process,), daemon=True).start()

    def _save_copy(self) -> Path:
        copy = self._folder / "copy.blend"
        try:
            with absolute_paths(), _no_preview():
                bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True, check_existing=False)
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"A copy of the file could not be saved: {reason}") from error
        return copy

    def _start(self, command: Sequence[str]) -> subprocess.Popen[str]:
        # A result may be longer than what a pipe holds that nobody reads yet.
        with open(self._result_path, "w", encoding="utf-8") as result:
            return subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=result,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
            )

    def __enter__(self) -> FileProcess:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def poll(self, timeout: float = 0.0) -> bool:
        """Take in what the process has reported; says whether it is still running. Never waits longer than told.

        Args:
            timeout: How long to wait for a first report [s].

        Raises:
            ValueError: If it failed, with the process's own sentence; not if it was stopped.
        """
        assert self._process is not None
        if self.stopped and time.monotonic() > self._killed_at:
            self._process.kill()
        try:
            line = self._lines.get(timeout=timeout) if timeout else self._lines.get_nowait()
            while line is not None:
                self._take(line)
                line = self._lines.get_nowait()
            self._said_all = True
        except queue.Empty:
            pass
        if not self._said_all or (code := self._process.poll()) is None:
            return True
        if code and not self.stopped:
            last = f" ({self._last_line})" if self._last_line else ""
            raise ValueError(self._error or f"The process behind the window ended with code {code}{last}; try again.")
        return False

    @property
    def result(self) -> Mapping[str, Any]:
        """What the verb gave, once it has ended well."""
        lines = [line for line in self._result_path.read_text("utf-8", "replace").splitlines() if line.startswith("{")]
        return json.loads(lines[-1]) if lines else {}

    @property
    def _result_path(self) -> Path:
        return self._folder / "result.txt"

    def wait(self, show: Callable[[Progress], object], tick: float) -> None:
        """Wait until it has ended, and show every change of its progress.

        Raises:
            ValueError: As of :meth:`poll`.
        """
        shown = self.progress
        while self.poll(tick):
            if self.progress != shown:
                shown = self.progress
                show(shown)

    def pause(self) -> None:
        """Let the process finish what it works on, and wait, if it is a verb that can."""
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

    def stop(self) -> None:
        """Let the process end, without waiting for it; :meth:`poll` tells when it has."""
        if self._process is not None and not self.stopped:
            self._process.terminate()
            self.stopped, self._killed_at = True, time.monotonic() + PATIENCE

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
        self._own.close()
        shutil.rmtree(self._folder, ignore_errors=True)
        if self._lock is not None:
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
        if event["event"] == "error":
            self._error = event["message"]
        else:
            self.progress = self.progress.after(event)


@contextmanager
def _no_preview() -> Iterator[None]:
    """Save without a picture for the file browser, which takes a window longer to draw than all else of saving."""
    preferences = bpy.context.preferences
    kind, dirty = preferences.filepaths.file_preview_type, preferences.is_dirty
    preferences.filepaths.file_preview_type = "NONE"
    try:
        yield
    finally:
        preferences.filepaths.file_preview_type, preferences.is_dirty = kind, dirty


def sweep() -> None:
    """Remove what Blenders that crashed have left."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        try:
            old = time.time() - folder.stat().st_mtime > LEFT_BEHIND
        except OSError:
            continue  # Another one has just removed it.
        if old and not is_locked(folder):
            shutil.rmtree(folder, ignore_errors=True)


running: dict[int, FileProcess] = {}
"""Processes started from the window, by the session_uid of their garment; at most one at a time."""


def process_of(garment: bpy.types.Object, verb: str) -> FileProcess | None:
    """The process of this verb that is at work on a garment."""
    process = running.get(garment.session_uid)
    return process if process is not None and process.verb == verb else None
