"""Several garments on the demo's character, from the outermost to the innermost: worn over each other, and as one.

As one mesh they are simulated in full, so that cloth which touches itself is garments that touch each other, and are
measured and pictured. A point cache of the outfit holds them in their order.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..wrinkle_addon.evaluate import OURS
from ..wrinkle_addon.pc2 import PointCache, write_pc2
from ..wrinkle_addon.surface import BodyVolume, SurfaceMeasures
from .figures import FULL, Shapes, compare_sums, curvature_sums, root_mean_square_mm
from .studio import open_garment, save

COARSE = "coarse simulation"
WHOLE = "outfit"
"""What is measured of all garments together goes by this name."""
INSIDE = 0.001
"""Depth from which a vertex counts as inside the body [m]."""


def wear_over(scene_path: Path, garments: Sequence[str]) -> None:
    """Let each garment of a file be worn over the next one, as it is played and in its coarse layer."""
    import bpy

    open_garment(scene_path, garments[0])
    worn = [bpy.data.objects[name] for name in garments]
    for order, (inner, outer) in enumerate(itertools.pairwise(reversed(worn)), 1):
        outer.wrinkles.worn_over, outer.wrinkles.coarse_order = inner, order
    save(scene_path)


def join(scene_path: Path, garments: Sequence[str], path: Path) -> None:
    """Save a copy of a scene in which all garments are one mesh, by the first one's name and with its settings."""
    import bpy

    first = open_garment(scene_path, garments[0])
    joined = [bpy.data.objects[name] for name in garments]
    with bpy.context.temp_override(active_object=first, selected_editable_objects=joined):
        bpy.ops.object.join()
    save(path)


def make_playing(scene_path: Path, garments: Sequence[str], path: Path, *, wrinkles: bool, coarse: bool) -> None:
    """Save a copy of a scene that plays garments with or without wrinkles, over coarse layers or by skinning alone.

    By skinning alone, nothing keeps them out of the body and of each other.
    """
    import bpy

    open_garment(scene_path, garments[0])
    for name in garments:
        settings = bpy.data.objects[name].wrinkles
        settings.strength = float(wrinkles)
        if not coarse:
            settings.coarse_layer, settings.clear_of_body, settings.worn_over = "NONE", False, None
        # What is worn over it asks for it as it is played.
        settings.enabled = True
    save(path)


def join_caches(parts: Sequence[Path], path: Path) -> None:
    """Write the point caches of all garments as one, and remove them."""
    caches = [PointCache(part) for part in parts]
    whole = np.concatenate([cache.frames for cache in caches], axis=1)
    write_pc2(path, whole.shape[1], caches[0].start, whole, len(whole))
    for part in parts:
        part.unlink()


# --- measuring ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Outfit:
    """An outfit's mesh and its body in every frame.

    Attributes:
        frames: Of the scene.
        faces: Triangles, shape [triangle_count, 3].
        counts: Vertices of each garment by its name, in order.
        body: The body in the outfit's space [m], shape [frame_count, body_vertex_count, 3].
        body_faces: Its triangles.
    """

    frames: Sequence[int]
    faces: NDArray[np.int32]
    counts: Mapping[str, int]
    body: Shapes
    body_faces: NDArray[np.int32]

    @property
    def parts(self) -> dict[str, slice]:
        """The vertices of each garment, and of all of them."""
        ends = np.cumsum(list(self.counts.values())).tolist()
        garments = {name: slice(end - count, end) for (name, count), end in zip(self.counts.items(), ends, strict=True)}
        return {**garments, WHOLE: slice(0, ends[-1])}

    def faces_of(self, part: slice) -> NDArray[np.int32]:
        """Triangles between these vertices, in their own numbers."""
        return self.faces[((self.faces >= part.start) & (self.faces < part.stop)).all(1)] - np.int32(part.start)

    def inside(self, shapes: Shapes) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which vertices lie inside the body, and which of them where it cuts into itself; [frame_count, vertex_count].

        Args:
            shapes: The outfit in every frame [m], shape [frame_count, vertex_count, 3].
        """
        deep, overlap = [], []
        for body, shape in zip(self.body, shapes, strict=True):
            depth, covered = BodyVolume(body.astype(np.float64), self.body_faces).depth(shape.astype(np.float64))
            deep.append(depth > INSIDE)
            overlap.append(deep[-1] & covered)
        return np.stack(deep), np.stack(overlap)


def read_outfit(joined: Path, counts: Mapping[str, int], frames: Sequence[int]) -> Outfit:
    """An outfit from a file of :func:`join`, and its body as Blender poses it in these frames."""
    import bpy

    from ..wrinkle_addon.blender.character import apply, read_mesh
    from ..wrinkle_addon.blender.clip import step_frames
    from ..wrinkle_addon.blender.coarse_scene import read_points

    worn = open_garment(joined, next(iter(counts)))
    body, bodies = worn.wrinkles.body, []
    for _ in step_frames(frames):
        depsgraph = bpy.context.evaluated_depsgraph_get()
        to_outfit = np.linalg.inv(np.array(worn.evaluated_get(depsgraph).matrix_world, np.float64))
        bodies.append(apply(to_outfit, read_points(body, depsgraph).astype(np.float64)).astype(np.float32))
    return Outfit(frames, read_mesh(worn.data)[1], counts, np.stack(bodies), read_mesh(body.data)[1])


def measure_outfit(outfit: Outfit, shapes: Mapping[str, Shapes]) -> dict[str, dict[str, Any]]:
    """Compare an outfit with its full simulation, each garment and all of them together.

    Args:
        outfit: Mesh and body.
        shapes: SKINNING, COARSE, OURS and FULL, each in the outfit's space [m], [frame_count, vertex_count, 3].

    Returns:
        By garment, and by :data:`WHOLE`: ``vertices``; ``rmse_mm`` to the full simulation; ``curvature`` as
        :func:`.figures.compare_sums` tells it; ``inside``, the share of vertices more than 1 mm inside the body, and
        ``inside_overlap``, those of them where the body cuts into itself; ``passing``, pairs of triangles that pass
        through each other, mean of the frames. Of the whole besides ``between``, those of two garments, and
        ``frames``, the errors in each frame.
    """
    inside = {name: outfit.inside(shapes[name]) for name in (OURS, FULL)}
    found: dict[str, dict[str, Any]] = {}
    for name, vertices in outfit.parts.items():
        part = {made: frames[:, vertices] for made, frames in shapes.items()}
        surface = SurfaceMeasures(outfit.faces_of(vertices), part[FULL].shape[1])
        found[name] = {
            "vertices": part[FULL].shape[1],
            "rmse_mm": {made: root_mean_square_mm(frames, part[FULL]) for made, frames in part.items()},
            "curvature": compare_sums(curvature_sums(surface, part)),
            "inside": {made: float(deep[:, vertices].mean()) for made, (deep, _) in inside.items()},
            "inside_overlap": {made: float(overlap[:, vertices].mean()) for made, (_, overlap) in inside.items()},
            "passing": {made: _passing(surface, part[made]) for made in (COARSE, OURS, FULL)},
        }
    own = [found[garment]["passing"] for garment in outfit.counts]
    found[WHOLE] |= {
        "between": {made: pairs - sum(each[made] for each in own) for made, pairs in found[WHOLE]["passing"].items()},
        "frames": [
            {
                "frame": frame,
                "rmse_mm": {made: root_mean_square_mm(each[k], shapes[FULL][k]) for made, each in shapes.items()},
            }
            for k, frame in enumerate(outfit.frames)
        ],
    }
    return found


def _passing(surface: SurfaceMeasures, shapes: Shapes) -> float:
    return float(np.mean([len(surface.self_intersections(shape.astype(np.float64))) for shape in shapes]))
