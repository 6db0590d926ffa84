"""The ghost of a sample, drawn over the 3D view: nothing of it enters the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ..database import WrinkleDatabase
from ..garment import vertex_normals
from ..plan import Sample
from ..rig import FloatArray, IntArray
from .samples import chosen_sample, sample_positions

COLOUR = (0.25, 0.6, 1.0, 0.55)
TOWARDS_LIGHT = np.array([0.4, -0.5, 0.77])
"""In the armature's own axes: from the front, a little from the left, and from above."""


@dataclass(frozen=True, eq=False)
class Ghost:
    """A sample ready to be drawn.

    Attributes:
        source: What it was made from; another source needs another ghost.
        positions: In the armature's own space, shape [vertex_count, 3].
        colours: Shaded, with their opacity, shape [vertex_count, 4].
        faces: Triangles, shape [triangle_count, 3].
    """

    source: tuple[WrinkleDatabase, Sample]
    positions: FloatArray
    colours: FloatArray
    faces: IntArray


def make_ghost(garment: bpy.types.Object, database: WrinkleDatabase, sample: Sample) -> Ghost:
    """Shade a sample, so that its folds are seen.

    Raises:
        ValueError: If the rig is not what was baked; one sentence.
    """
    positions, faces = sample_positions(garment, database, sample), database.header.garment.faces
    # Both sides of the cloth are seen.
    light = 0.25 + 0.75 * np.abs(vertex_normals(positions, faces) @ TOWARDS_LIGHT)
    colours = np.broadcast_to(COLOUR, (len(positions), 4)).copy()
    colours[:, :3] *= light[:, None]
    return Ghost((database, sample), positions, colours, faces)


_drawn: dict[int, tuple[Ghost, Any]] = {}
"""Ghosts and what the graphics card holds of them, by the session_uid of the garment."""


def _draw() -> None:
    for garment in bpy.context.visible_objects:
        if garment.type == "MESH" and garment.wrinkles.ghost.shows and garment.wrinkles.armature is not None:
            try:
                _draw_ghost(garment)
            except ValueError:
                continue  # The panel says why there is none.


def _draw_ghost(garment: bpy.types.Object) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    source = chosen_sample(garment)
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    known = _drawn.get(garment.session_uid)
    if known is None or known[0].source != source:
        ghost = make_ghost(garment, *source)
        content = {"pos": ghost.positions.astype(np.float32), "color": ghost.colours.astype(np.float32)}
        known = ghost, batch_for_shader(shader, "TRIS", content, indices=ghost.faces)
        _drawn[garment.session_uid] = known
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    with gpu.matrix.push_pop():
        gpu.matrix.multiply_matrix(garment.wrinkles.armature.matrix_world)
        known[1].draw(shader)
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


classes = ()
_handle: Any = None


def register() -> None:
    global _handle  # noqa: PLW0603 - Blender hands it out once and wants it back
    if not bpy.app.background:
        _handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    global _handle  # noqa: PLW0603
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
        _handle = None
    _drawn.clear()
