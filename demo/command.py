"""The verbs of the command line, each in a process of its own, as an artist or a farm would run them."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..wrinkle_addon import cli

Listener = Callable[[str], None]
"""Gets the lines of progress that a verb prints."""


class DemoError(ValueError):
    """A verb of the demo failed; the message is its own sentence."""


class Verb:
    """A verb at work in another process.

    Args:
        arguments: The verb and its options; ``--json`` is added.
        log: File that everything it says is added to.
    """

    def __init__(self, arguments: Sequence[str | Path], log: Path):
        self._name = str(arguments[0])
        self._log = log
        self._out = tempfile.TemporaryFile("w+", encoding="utf-8")
        self._process = subprocess.Popen(
            [sys.executable, "-m", cli.__name__, *(str(argument) for argument in arguments), "--json"],
            stdout=self._out, stderr=subprocess.PIPE, encoding="utf-8", errors="replace",
        )  # fmt: skip

    def result(self, listen: Listener = lambda line: None) -> dict[str, Any]:
        """Wait for it; returns the JSON object that it prints last.

        Raises:
            DemoError: If it fails.
        """
        last = ""
        assert self._process.stderr is not None
        try:
            with self._log.open("a", encoding="utf-8") as log:
                for line in self._process.stderr:
                    log.write(line)
                    if line.strip():
                        last = line.strip()
                        listen(last)
            code = self._process.wait()
        finally:
            self.stop()
        self._out.seek(0)
        printed = self._out.read().splitlines()
        if code:
            raise DemoError(f"The verb {self._name} failed: {last.removeprefix('wrinkle: ')} (see {self._log})")
        return json.loads(printed[-1])

    def stop(self) -> None:
        """End it, if it still works."""
        if self._process.poll() is None:
            self._process.terminate()
            self._process.wait()


def run_verb(arguments: Sequence[str | Path], log: Path, listen: Listener = lambda line: None) -> dict[str, Any]:
    """Run a verb to its end; see :class:`Verb`."""
    return Verb(arguments, log).result(listen)
