"""Grids around a body's limbs at rest, and where they lie in a pose; see :mod:`..kernels.limb_grids`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.limb_grids import GridCell, LimbGrid, LimbGrids, fit_limbs
from .cloth_model import FloatArray, IntArray
from .garment import bind_to_surface
from .topology import triangles_beside

CELL = 0.02
"""Size of the cells in which a limb's closest triangle is looked up [m]."""

CELL_REACH = 0.04
"""Cells farther outside a limb than this know no triangle [m]: how far skin may stray from a rigid limb."""

FRAME_POINTS = 64
"""Body vertices that tell how a limb lies, at most."""


@dataclass(frozen=True, eq=False)
class GridShapes:
    """Grids around the limbs at rest; none if the body has no limbs.

    Attributes:
        origin: Lowest corner of each grid [m], shape [limb_count, 3].
        extents: Cells along the axes of each grid, and where its cells begin, shape [limb_count, 4].
        cells, gaps: Triangle and gap of every cell; see :class:`..kernels.limb_grids.GridCell`.
    """

    origin: NDArray[np.float32]
    extents: IntArray
    cells: IntArray
    gaps: NDArray[np.float32]


def make_grids(body: FloatArray, body_faces: IntArray, limb: IntArray, limb_count: int) -> GridShapes:
    """Grids around the limbs of a body.

    Args:
        body: The body at rest [m], shape [body_vertex_count, 3].
        body_faces: Its triangles, shape [body_triangle_count, 3].
        limb: Limb of each triangle.
    """
    origins, shapes = np.zeros((limb_count, 3), np.float32), np.zeros((limb_count, 3), np.int32)
    cells, gaps = [np.zeros(0, np.int32)], [np.zeros(0, np.float32)]
    for number in range(limb_count):
        triangles = np.flatnonzero(limb == number)
        if not len(triangles):
            continue
        points = body[body_faces[triangles]].reshape(-1, 3)
        origins[number] = points.min(0) - CELL_REACH
        shapes[number] = np.ceil((points.max(0) + CELL_REACH - origins[number]) / CELL)
        index = np.stack(np.meshgrid(*(np.arange(n) for n in shapes[number]), indexing="ij"), 3).reshape(-1, 3)
        found = bind_to_surface(origins[number] + CELL * (index + 0.5), body, body_faces[triangles])
        # What lies outside beyond the limb's end is the next limb's.
        rim = ((found.weights < 1e-6) & (triangles_beside(body_faces[triangles])[found.faces] < 0)).any(1)
        near = (np.abs(found.distance) < CELL_REACH) & ~(rim & (found.distance > 0.0))
        cells.append(np.where(near, triangles[found.faces], -1).astype(np.int32))
        gaps.append(_gaps(near.reshape(shapes[number])).ravel())
    first = np.cumsum([0, *shapes.prod(1)])[:-1].astype(np.int32)
    return GridShapes(origins, np.concatenate([shapes, first[:, None]], 1), np.concatenate(cells), np.concatenate(gaps))


def _gaps(full: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance of every cell's centre from the closest one that is full [cells], shape as given."""
    squared = np.where(full, 0.0, np.inf)
    for axis, count in enumerate(full.shape):
        lines = np.moveaxis(squared, axis, -1)
        away = (np.arange(count)[:, None] - np.arange(count)) ** 2
        nearest = np.stack([(lines + away[i]).min(-1) for i in range(count)], -1)
        squared = np.moveaxis(nearest, -1, axis)
    return np.sqrt(squared).astype(np.float32)


class PosedLimbs:
    """The grids around a body's limbs on a device, in whatever pose the body was moved to last.

    A limb lies where the rigid motion that fits it best takes it (Kabsch 1976).

    Args:
        grids: The grids at rest.
        body, body_faces, limb: The body at rest [m], its triangles and their limbs.
        points: Where its vertices are in a pose, shape [body_vertex_count]; read by every :meth:`move`.

    Attributes:
        struct: As kernels read them.
    """

    def __init__(self, grids: GridShapes, body: FloatArray, body_faces: IntArray, limb: IntArray, points: wp.array):
        device, count = points.device, len(grids.extents)
        members = []
        for number in range(count):
            vertices = np.unique(body_faces[limb == number])
            if not len(vertices):
                vertices = np.arange(len(body))
            members.append(vertices[np.linspace(0, len(vertices) - 1, FRAME_POINTS).astype(int)])
        chosen = np.array(members, np.int32).reshape(-1, FRAME_POINTS)
        rest = body[chosen]
        centre = rest.mean(1)

        def upload(values: NDArray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        limbs = np.zeros(count, LimbGrid.numpy_dtype())
        limbs["extent"] = grids.extents
        cells = np.zeros(len(grids.cells), GridCell.numpy_dtype())
        cells["triangle"], cells["gap"] = grids.cells, grids.gaps
        self.struct = LimbGrids()
        self.struct.limbs, self.struct.cells = upload(limbs, LimbGrid), upload(cells, GridCell)
        centred, corner = upload(rest - centre[:, None], wp.vec3), upload(centre - grids.origin, wp.vec3)
        inputs = [points, upload(chosen, wp.int32), centred, corner, CELL]
        self._fit = wp.launch(fit_limbs, count, inputs, [self.struct.limbs], device=device, record_cmd=True)

    def move(self) -> None:
        """Put the limbs where they lie on the body as it is now."""
        if len(self.struct.limbs):
            self._fit.launch()
