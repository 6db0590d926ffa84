"""A garment played over a clip into files that need no add-on: PC2, Alembic, USD."""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..cache_parts import CacheParts
from ..database import WrinkleDatabase
from ..joint_wrinkles import BlendWeights, Formulation, JointWrinkles
from ..storage import content_key, file_hash
from .clearance import BodyClearance, Worn
from .clip import ClipReader, step_frames
from .coarse_layer import CoarseBinding, coarse_key
from .exporters import EXPORTERS, check_exporter, export_garment
from .files import check_output
from .inner_clearance import InnerClearance, InnerGarment, garments_under
from .matching import check_database

CACHE = ".pc2"


def check_result(path: Path) -> None:
    """See before any work that a finished clip can be written to this file.

    Raises:
        ValueError: If it is of no kind that there is, or its folder cannot be written to; one sentence.
    """
    check_output(path, CACHE, *EXPORTERS)
    if path.suffix.lower() in EXPORTERS:
        check_exporter(path)


class ClipSynthesis:
    """A garment and its database, ready for any frame of the scene.

    Args:
        garment: A garment that was set up.
        database: Folder of its database.
        formulation, weights: Those to play with; left out, the garment's own.
        device: Warp device.

    Attributes:
        clamped_deg: By how much joints went beyond their samples in the frames played so far [degrees].
        notes: Why the garment was not kept clear of its body or of what it is worn over, and in how many frames so far.

    Raises:
        ValueError: One sentence, if the database cannot be read, or is not of this garment and its rig.
    """

    def __init__(
        self,
        garment: bpy.types.Object,
        database: Path,
        formulation: Formulation | None = None,
        weights: BlendWeights | None = None,
        device: str = "cpu",
    ):
        settings = garment.wrinkles
        self.garment = garment
        self.clamped_deg: dict[str, float] = {}
        self._database = WrinkleDatabase.open(database)
        scale = check_database(garment, self._database.header)
        self._reader = ClipReader(garment, self._database.header.rig, scale)
        self._formulation = formulation or Formulation[settings.formulation]
        self._weights = weights or BlendWeights[settings.weights]
        self._evaluator = JointWrinkles(self._database, self._formulation, self._weights).bind(device)
        self._clearance = BodyClearance(Worn.of_database(self._database), device)
        self._coarse = CoarseBinding(self._database)
        self._inner_clearance = InnerClearance(self._database, device)
        self._inner = self._make_inner(device)
        self._positions = wp.zeros(self._evaluator.vertex_count, dtype=wp.vec3, device=self._evaluator.device)
        self.notes: dict[str, int] = {}

    def _make_inner(self, device: str) -> ClipSynthesis | None:
        """What the garment is worn over, if that plays wrinkles."""
        under = garments_under(self.garment)
        if not under or not under[0].wrinkles.enabled or under[0].wrinkles.flow.replays:
            return None
        return ClipSynthesis(under[0], Path(bpy.path.abspath(under[0].wrinkles.database)), device=device)

    @property
    def vertex_count(self) -> int:
        return self._evaluator.vertex_count

    def positions(self, frames: range) -> Iterator[NDArray[np.float32]]:
        """The garment in its object space in every frame, shape [vertex_count, 3] each."""
        # A loop lets go of the stepping at an error; a generator expression would hold it until the traceback is gone.
        for frame in step_frames(frames):
            yield self._at(frame)

    def _at(self, frame: float) -> NDArray[np.float32]:
        """The garment in the frame that the scene is at."""
        clip = self._reader.read(frame)
        # Strengths may be animated.
        strengths = self.garment.wrinkles.strengths()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        layer = self._coarse.read(self.garment, depsgraph, self._evaluator, strict=True)
        (layer or self._evaluator).evaluate(clip.pose, self._positions, strengths, clip.rig_to_garment)
        wanted = self.garment.wrinkles.clear_of_body
        body = self._clearance.read(self.garment, depsgraph, clip.pose, clip.rig_to_garment, wanted=wanted)
        if body is not None:
            self._clearance.clear(body, self._positions, clip.rig_to_garment)
        inner = self._inner_clearance.read(self.garment, depsgraph, self._inner_garment(frame, depsgraph))
        if inner is not None:
            self._inner_clearance.clear(inner, self._positions, clip.rig_to_garment)
        for note in filter(None, (self._clearance.note, self._inner_clearance.note)):
            self.notes[note] = self.notes.get(note, 0) + 1
        for name, beyond in self._evaluator.clamped.items():
            angle = math.degrees(float(np.abs(beyond).max()))
            self.clamped_deg[name] = max(self.clamped_deg.get(name, 0.0), angle)
        return self._positions.numpy().copy()

    def _inner_garment(self, frame: float, depsgraph: bpy.types.Depsgraph) -> InnerGarment | None:
        """What the garment is worn over, in the frame that the scene is at; None if that plays no wrinkles."""
        if self._inner is None:
            return None
        world = np.array(self._inner.garment.evaluated_get(depsgraph).matrix_world, np.float64)
        return InnerGarment(self._inner._database, self._inner._at(frame), world)

    def file_key(self) -> str:
        """Hash of the open file, of those linked into it, and of all else that decides what is written."""
        linked = (Path(bpy.path.abspath(library.filepath)) for library in bpy.data.libraries)
        files = [Path(bpy.data.filepath), *sorted(path for path in linked if path.is_file())]
        return content_key(
            {
                "files": [file_hash(path) for path in files],
                "garment": self.garment.name,
                "database": [self._database.header.key, self._database.corrections.fingerprint],
                "formulation": self._formulation.value,
                "weights": self._weights.value,
                "coarse": coarse_key(self.garment),
                "worn_over": "" if self._inner is None else self._inner.file_key(),
            }
        )


def write_clip(
    synthesis: ClipSynthesis, frames: range, out: Path, key: str | None, report: Callable[[range], None]
) -> None:
    """Write a finished clip: what parts there are, what is missing, all of it joined; the parts go.

    Args:
        synthesis: The garment.
        frames: The whole clip.
        out: The .pc2, .abc or .usd file.
        key: That parts made before have; None for parts of this run alone, which stay in no case.
        report: Told of the frames of every part that was made now.

    Raises:
        ValueError: One sentence, if the file cannot be written.
    """
    parts = CacheParts.beside(out, key or secrets.token_hex(8), synthesis.vertex_count)
    done = False
    try:
        _write(synthesis, parts, frames, out, report)
        done = True
    finally:
        if done or key is None:
            parts.remove()


def _write(
    synthesis: ClipSynthesis, parts: CacheParts, frames: range, out: Path, report: Callable[[range], None]
) -> None:
    for made in parts.fill(frames, synthesis.positions):
        report(made)
    if out.suffix.lower() == CACHE:
        parts.join(frames, out)
        return
    whole = parts.folder / f"whole_{parts.key}{CACHE}"
    parts.join(frames, whole)
    export_garment(synthesis.garment, whole, frames, out, parts.folder)


def write_parts(synthesis: ClipSynthesis, frames: range, out: Path, key: str, report: Callable[[range], None]) -> None:
    """Make the parts of a clip that hold these frames, unless they are there; arguments as in :func:`write_clip`."""
    for made in CacheParts.beside(out, key, synthesis.vertex_count).fill(frames, synthesis.positions):
        report(made)
