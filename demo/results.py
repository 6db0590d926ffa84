"""The demo's output folder: what stages leave there, so that another run goes on after the last one."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class Results:
    """Results of stages as JSON files in a folder, and the time that each took over all runs.

    Args:
        folder: The output folder; it is made.
        recipe: What is made in it.

    Raises:
        ValueError: If the folder holds results of another recipe.
    """

    def __init__(self, folder: Path, recipe: Mapping[str, Any]):
        self.folder = folder
        self._stages = folder / "stages"
        self._stages.mkdir(parents=True, exist_ok=True)
        chosen, path = json.loads(json.dumps(recipe)), self._stages / "recipe.json"
        if path.exists() and _read(path) != chosen:
            raise ValueError(f"The folder '{folder}' holds another demo; name an empty one, or remove it.")
        _write(path, chosen)

    @staticmethod
    def recipe_of(folder: Path) -> dict[str, Any]:
        """What is made in a folder.

        Raises:
            ValueError: If no demo has been there; one sentence.
        """
        path = folder / "stages" / "recipe.json"
        if not path.exists():
            raise ValueError(f"The folder '{folder}' holds no demo; name one that a demo was written to.")
        return _read(path)

    def path(self, name: str) -> Path:
        """Path of a file in the folder."""
        return self.folder / name

    def read(self, stage: str) -> dict[str, Any]:
        """What a finished stage left."""
        return _read(self._stages / f"{stage}.json")

    def keep(self, stage: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """What a stage left in an earlier run; else made now, and kept."""
        path = self._stages / f"{stage}.json"
        if not path.exists():
            _write(path, make())
        return _read(path)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time that passes to that of a stage, also if it is interrupted."""
        started, busy = time.perf_counter(), _processor_time()
        try:
            yield
        finally:
            times = self.times
            before = times.get(stage, {"seconds": 0.0, "processor_seconds": 0.0})
            times[stage] = {
                "seconds": round(before["seconds"] + time.perf_counter() - started, 2),
                "processor_seconds": round(before["processor_seconds"] + _processor_time() - busy, 2),
            }
            _write(self._stages / "times.json", times)

    @property
    def times(self) -> dict[str, dict[str, float]]:
        """Time that each stage took over all runs, by the clock and of all processors together [s]."""
        path = self._stages / "times.json"
        return _read(path) if path.exists() else {}


def _processor_time() -> float:
    """Processor time of this process and of those that it waited for [s]."""
    return sum(os.times()[:4])


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def _write(path: Path, value: Mapping[str, Any]) -> None:
    partial = path.with_name(f".{path.name}")
    partial.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    partial.replace(path)
