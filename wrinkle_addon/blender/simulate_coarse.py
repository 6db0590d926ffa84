"""Baking the coarse layers of a character: their simulation over a range of frames, into the cache."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..coarse_bake import BakedFrame, bake_history
from ..coarse_cache import CoarseCache, NotSimulated
from .coarse_layer import match_coarse, tie_coarse
from .coarse_scene import (
    SIMULATION,
    build_history,
    cache_folder,
    read_spec,
    scene_frames,
    simulated_garments,
)


@dataclass(frozen=True)
class CoarseBake:
    """A bake that is ready to go.

    Attributes:
        folder: Of the cache.
        garments: Names of what is simulated together, the innermost first.
        reason: Why what lay in the cache is thrown away, as a sentence; empty if it goes on from there.
        first, last: Frames that it goes through; the first one may lie before the one asked for.
        frames: Does the work; whoever drains it may stop at any frame.
    """

    folder: Path
    garments: tuple[str, ...]
    reason: str
    first: int
    last: int
    frames: Generator[BakedFrame, None, None]


def bake_coarse(garment: bpy.types.Object, first: int, last: int, device: str) -> CoarseBake:
    """Prepare to simulate a garment, and what is simulated with it, over a range of frames.

    A cache that is of the same garments, body, settings and frame rate is gone on with: frames that still have their
    motion are kept. It is begun anew where it starts after ``first``.

    Raises:
        ValueError: If the garment follows no simulation, or something cannot be simulated; one sentence.
    """
    if garment.wrinkles.coarse_layer != SIMULATION:
        raise ValueError(
            f"The garment '{garment.name}' does not follow a simulation; choose Simulation as its coarse layer, or set "
            "it up with --coarse make."
        )
    scene = bpy.context.scene
    folder = cache_folder(garment)
    match_coarse(garment)
    garments = simulated_garments(garment, scene)
    for ob in garments:
        tie_coarse(ob)
    spec, reason = read_spec(garments, scene), ""
    try:
        cache = CoarseCache.open(folder)
        cache.check(spec)
        if cache.first > first:
            reason = f"The coarse simulation began at frame {cache.first}, after frame {first}; it is simulated again."
    except NotSimulated as changed:
        cache, reason = None, str(changed) if folder.exists() else ""
    if cache is None or reason:
        cache = CoarseCache.begin(folder, spec, first)
    history = build_history(garments, cache, device)
    frames = bake_history(history, scene_frames(garments, cache.first, last), last)
    return CoarseBake(folder, tuple(ob.name for ob in garments), reason, cache.first, last, frames)
