"""Pictures of the demo's character by Cycles on the CPU.

What is shown are point caches, so that skinning, synthesis and simulation are seen under the same light.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..wrinkle_addon.pc2 import PointCache
from .studio import aim, show_cache, to_stage


def render_frames(
    playback: Path,
    garment: str,
    caches: Mapping[str, Path],
    frames: Sequence[int],
    folder: Path,
    size: tuple[int, int],
    samples: int,
    close: bool = False,
) -> Iterator[Path]:
    """Render frames of a playback file with several caches in turn, skipping pictures that are there.

    Args:
        playback: A file of :func:`make_playback`.
        garment: The garment object's name.
        caches: Point caches by the name that their pictures get.
        frames: Which frames.
        folder: Where ``NAME-FRAME.png`` go.
        size: Width and height.
        samples: Rays a pixel, before noise is taken out.
        close: Whether the camera comes as near as each frame allows.

    Yields:
        Each picture's path, in the order of frames, then caches.
    """
    import bpy

    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(playback.resolve()))
    scene, shown = bpy.context.scene, bpy.data.objects[garment]
    use_cycles(scene, size, samples)
    folder.mkdir(parents=True, exist_ok=True)
    for frame in frames:
        scene.frame_set(frame)
        if close:
            come_close(scene, [PointCache(cache) for cache in caches.values()], frame)
        for name, cache in caches.items():
            path = folder / f"{name}-{frame:04d}.png"
            if not path.exists():
                show_cache(shown, cache)
                scene.frame_set(frame)
                partial = path.with_name(f".{path.name}")
                scene.render.filepath = str(partial.resolve())
                with quiet(), _interruptible_afterwards():
                    bpy.ops.render.render(write_still=True)
                partial.rename(path)
            yield path


def use_cycles(scene: Any, size: tuple[int, int], samples: int) -> None:
    """Render with Cycles from now on, in this size and with so many rays a pixel, noise taken out."""
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = True
    scene.cycles.denoising_prefilter, scene.cycles.denoising_quality = "FAST", "FAST"
    scene.cycles.max_bounces = 2
    scene.render.use_persistent_data = True
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "PNG"
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"


def come_close(scene: Any, caches: Sequence[PointCache], frame: int) -> None:
    """Move the camera so that the cloth of all caches just fills the picture of this frame."""
    stage = scene.camera.parent
    cloth = np.concatenate([cache.frames[round(frame - cache.start)] for cache in caches])
    aim(scene, to_stage(cloth - np.array(stage.location), stage.rotation_euler.z))


@contextmanager
def _interruptible_afterwards() -> Iterator[None]:
    """Let an interruption wait: inside a render it would end in the renderer, which takes the picture for done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked: list[int] = []
    before = {
        number: signal.signal(number, lambda got, _: asked.append(got)) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
    if asked:
        raise KeyboardInterrupt


@contextmanager
def quiet() -> Iterator[None]:
    """Keep the renderer's own lines off standard output."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
