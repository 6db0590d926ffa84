"""A garment's bake behind the window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import bpy

from ..plan import duration_text
from .file_process import BAKE, FileProcess
from .files import database_folder
from .preferences import device_name


@dataclass(frozen=True)
class BakeProgress:
    """How far a bake is; see :class:`.file_process.Progress`.

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
    def share(self) -> float:
        return self.done / max(self.total, 1)

    @property
    def text(self) -> str:
        if not self.total:
            return "Starting"
        left = "" if self.remaining is None else f", {duration_text(self.remaining)} left"
        return f"{self.done} of {self.total} samples{left}"

    @property
    def last(self) -> str:
        """The sample that was finished last, and how it came out."""
        if not self.name or self.residual is None:
            return self.name
        return f"{self.name}, residual {self.residual:.2g}"

    def after(self, event: Mapping[str, Any]) -> BakeProgress:
        report = event["report"]
        restless = self.restless if report.get("converged", True) else (*self.restless, event["name"])
        return BakeProgress(
            event["done"], event["total"], event["name"], event["remaining"], report.get("residual"), restless
        )


class BakeProcess(FileProcess):
    """Bakes one garment; finished samples stay in the database's folder whatever happens.

    Raises:
        ValueError: Also if the garment has no folder to bake into; one sentence.
    """

    def __init__(self, garment: bpy.types.Object):
        database = database_folder(garment)
        arguments = ("--database", str(database), "--device", device_name())
        super().__init__(garment, BAKE, arguments, doing="Baking wrinkles", progress=BakeProgress(), lock=database)
