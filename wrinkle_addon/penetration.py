"""Keeping a synthesised garment out of the body (Xu et al. 2014, section 5, eq 11 and 12; S28 to S30).

    binding = bind_clearance(rest, faces, body_rest, body_faces, limbs)     # once, in the rest pose
    push = PushOut(binding, device=device)
    push.clear(body, positions)                                             # each frame, in place

``rest`` is the settled garment, ``body`` the posed body. A frame is a function of these two alone. An outer garment is
kept outside an inner one in the same way: the inner one is its body, without limbs.

Four things differ from the paper's page. (a) A vertex is not tied to one body vertex: cloth slides, so it walks
over the body to the foot below it. (b) It is pushed along the body's smooth normal, so that a push changes its height
by just as much. (c) Pushes are spread over the garment before they are made: largest values around, then as many means,
which are nowhere less than what is needed. Folds keep their shape and ride outwards, where eq 11 would cut them off.
(d) Other limbs push as well, as the trunk does a sleeve; where two walls leave no room, they share what is lacking.
Nothing is blended again afterwards (eq 13): there is one mesh, not one an example.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.cloth.body_surface import vertex_normals as area_normals
from ..kernels.penetration import (
    BOXES,
    Clearance,
    LimbGrids,
    believable_lacks,
    find_lacks,
    find_near_limbs,
    heights_over_surface,
    largest_around,
    mean_around,
    push_between_limbs,
    push_out,
)
from ..kernels.posed_surface import PosedSurface
from .cloth_contact import Limbs
from .cloth_model import FloatArray, IntArray
from .garment import bind_to_surface, vertex_neighbours, vertex_normals
from .method import BLOCK_SIZE, SplitLaunch
from .surface import FacingSurface
from .topology import group, mesh_edges, triangles_beside

CELL = 0.02
"""Size of the cells in which a limb's closest triangle is looked up [m]."""

CELL_REACH = 0.04
"""Cells farther outside a limb than this know no triangle [m]: how far skin may stray from a rigid limb."""

FACING_REACH = 0.05
"""Skin that looks the way the garment does is preferred at rest, if it is at most this much farther [m]."""

FRAME_POINTS = 64
"""Body vertices that tell how a limb lies, at most."""

FOOT_TOLERANCE = 5.0e-5
"""Height at which the walk to a foot ends [m]."""


@dataclass(frozen=True)
class ClearanceSettings:
    """How a garment is kept clear of a body.

    Attributes:
        distance: Height over the skin that is enough [m]; less where the settled garment lies lower.
        spread: How far around a vertex the garment is pushed along with it [m].
        soft: Lack up to which pushing sets in gently, without a kink in time or space [m].
        deep: Lacks at which pushing begins to fade and has faded [m].
        overlap: Depths of a limb in another one at which they begin to be, and are, too deep to push cloth between [m].
    """

    distance: float = 0.003
    spread: float = 0.02
    soft: float = 0.001
    deep: tuple[float, float] = (0.06, 0.12)
    overlap: tuple[float, float] = (0.02, 0.035)

    def __post_init__(self) -> None:
        if not self.distance >= 0.0 or not self.spread >= 0.0:
            raise ValueError("The clearance and its spread must not be negative.")


@dataclass(frozen=True, eq=False)
class ClearanceBinding:
    """How a garment lay on a body at rest.

    Attributes:
        faces: Triangles of the garment, shape [triangle_count, 3].
        body_faces: Triangles of the body, shape [body_triangle_count, 3].
        body: The body at rest [m], shape [body_vertex_count, 3].
        start: Body triangle under each garment vertex, shape [vertex_count].
        height: Height of each vertex over the body [m], shape [vertex_count].
        limb: Limb of each body triangle, shape [body_triangle_count].
        edge: Mean length of the garment's edges [m].
        origin, shape, first, cells: Grids around the limbs, see :class:`..kernels.penetration.LimbGrids`; none if the
            body has no limbs.
    """

    faces: IntArray
    body_faces: IntArray
    body: FloatArray
    start: IntArray
    height: NDArray[np.float32]
    limb: IntArray
    edge: float
    origin: NDArray[np.float32]
    shape: IntArray
    first: IntArray
    cells: IntArray


def bind_clearance(
    rest: FloatArray, faces: IntArray, body: FloatArray, body_faces: IntArray, limbs: Limbs | None = None
) -> ClearanceBinding:
    """Bind a garment to the body under it, once.

    Args:
        rest: The settled garment [m], shape [vertex_count, 3].
        faces: Its triangles, shape [triangle_count, 3].
        body: The body in the same pose [m], shape [body_vertex_count, 3].
        body_faces: Its triangles, outward by their winding, shape [body_triangle_count, 3].
        limbs: The body's limbs and those that each vertex is worn on; left out, the body is one.
    """
    start = _triangles_below(rest, faces, body, body_faces, limbs)
    limb = np.zeros(len(body_faces), np.int32) if limbs is None else limbs.of_triangles
    origin, shape, first, cells = _limb_grids(body, body_faces, limb, 0 if limbs is None else int(limb.max()) + 1)
    ends = rest[mesh_edges(faces)[0]]
    edge = float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())
    surface = PosedBody(body_faces, len(body), limb, wp.get_device("cpu"))
    surface.move(body)
    height = wp.zeros(len(rest), dtype=wp.float32, device="cpu")
    points, below = wp.array(rest.astype(np.float32), dtype=wp.vec3), wp.array(start, dtype=wp.int32)
    wp.launch(heights_over_surface, len(rest), [points, below, surface.struct, FOOT_TOLERANCE], [height], device="cpu")
    return ClearanceBinding(faces, body_faces, body, start, height.numpy(), limb, edge, origin, shape, first, cells)


def _triangles_below(
    rest: FloatArray, faces: IntArray, body: FloatArray, body_faces: IntArray, limbs: Limbs | None
) -> IntArray:
    """The closest body triangle that each vertex is worn on, one that faces as the garment does if there is any."""
    normals = vertex_normals(rest, faces)
    worn = np.full(len(rest), 1) if limbs is None else limbs.of_vertices
    limb = np.zeros(len(body_faces), np.int32) if limbs is None else limbs.of_triangles
    start = np.zeros(len(rest), np.int32)
    for bits in np.unique(worn):
        members = np.flatnonzero(worn == bits)
        triangles = np.flatnonzero((bits >> limb) & 1)
        if not len(triangles):
            triangles = np.arange(len(body_faces))
        surface = FacingSurface(body, body_faces[triangles])
        start[members] = triangles[surface.closest(rest[members], normals[members], FACING_REACH)[0]]
    return start


def _limb_grids(
    body: FloatArray, body_faces: IntArray, limb: IntArray, limb_count: int
) -> tuple[NDArray[np.float32], IntArray, IntArray, IntArray]:
    """Origins, shapes, starts and cells of the grids around the limbs at rest."""
    origins, shapes, cells = np.zeros((limb_count, 3), np.float32), np.zeros((limb_count, 3), np.int32), []
    for number in range(limb_count):
        triangles = np.flatnonzero(limb == number)
        if not len(triangles):
            cells.append(np.zeros(0, np.int32))
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
    first = np.cumsum([0, *(len(part) for part in cells)])[:-1].astype(np.int32)
    return origins, shapes, first, np.concatenate([*cells, np.zeros(0, np.int32)])


class PosedBody:
    """A body on a device, in whatever pose it was moved to last.

    Attributes:
        struct: As kernels read it.
    """

    def __init__(self, faces: IntArray, vertex_count: int, limb: IntArray, device: wp.Device):
        self.vertex_count = vertex_count
        start, corners = group(faces.ravel(), vertex_count)
        self._device = device
        self._launch = SplitLaunch(vertex_count, device)
        self._corners = [wp.array(values, dtype=wp.int32, device=device) for values in (start, corners)]
        self._points = wp.zeros((1, vertex_count), dtype=wp.vec3, device=device)
        self._normals = wp.zeros((1, vertex_count), dtype=wp.vec3, device=device)
        self.struct = PosedSurface()
        self.struct.points = self._points.reshape((vertex_count,))
        self.struct.normals = self._normals.reshape((vertex_count,))
        self.struct.faces = wp.array(faces, dtype=wp.int32, device=device)
        self.struct.beside = wp.array(triangles_beside(faces), dtype=wp.int32, device=device)
        self.struct.limb = wp.array(limb, dtype=wp.int32, device=device)

    def move(self, positions: FloatArray | NDArray[np.float32] | wp.array) -> None:
        """Put the body here, shape [body_vertex_count, 3].

        Raises:
            ValueError: If it has another number of vertices.
        """
        if len(positions) != self.vertex_count:
            raise ValueError(f"The body has {len(positions)} vertices, but {self.vertex_count} at rest.")
        if isinstance(positions, np.ndarray):
            self.struct.points.assign(np.ascontiguousarray(positions, np.float32))
        else:
            wp.copy(self.struct.points, positions)
        self._launch.run(self._find_normals)

    def _find_normals(self, first: int, count: int) -> None:
        start, corners = self._corners
        part = slice(first, first + count)
        inputs = [self._points, self.struct.faces, start[first:], corners]
        wp.launch(area_normals, (1, count), inputs, [self._normals[:, part]], device=self._device)


class PushOut:
    """A garment kept out of a body, on one device. Clearing allocates next to nothing.

    Args:
        binding: How the garment lay on the body at rest.
        settings: How far out, and how.
        device: Warp device.

    Attributes:
        device: Where the garment's positions are.
        rings: How many neighbours far a push is spread.
    """

    def __init__(self, binding: ClearanceBinding, settings: ClearanceSettings | None = None, device: str = "cpu"):
        self.settings = settings or ClearanceSettings()
        self.device = wp.get_device(device)
        count = len(binding.start)
        self._body = PosedBody(binding.body_faces, len(binding.body), binding.limb, self.device)
        self._start, self._rest_height = self._upload(binding.start), self._upload(binding.height, wp.float32)
        self._neighbours = [self._upload(values) for values in vertex_neighbours(binding.faces, count)]
        self.rings = round(self.settings.spread / binding.edge)
        self._clearance = Clearance()
        self._clearance.most, self._clearance.soft = self.settings.distance, self.settings.soft
        self._clearance.deep = wp.vec2(*self.settings.deep)
        self._clearance.overlap = wp.vec2(*self.settings.overlap)
        self._frames = LimbFrames(binding)
        self._grids = LimbGrids()
        self._grids.origin = self._upload(binding.origin, wp.vec3)
        self._grids.shape = self._upload(binding.shape)
        self._grids.first = self._upload(binding.first)
        self._grids.cells = self._upload(binding.cells)
        self._grids.width = CELL
        self._grids.near = wp.zeros(int(BOXES) ** 3, dtype=wp.int32, device=self.device)
        self._grids.frames = wp.zeros((len(binding.first), 3), dtype=wp.vec4, device=self.device)
        self._face = wp.zeros(count, dtype=wp.int32, device=self.device)
        self._height, self._lack, self._other = (
            wp.zeros(count, dtype=wp.float32, device=self.device) for _ in range(3)
        )
        self._normal, self._moves = (wp.zeros(count, dtype=wp.vec3, device=self.device) for _ in range(2))
        self._block_size = BLOCK_SIZE if self.device.is_cpu else 1
        self._split = SplitLaunch(count, self.device, self._block_size)

    def _launch(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        self._split(kernel, [self._block_size, *inputs], outputs)

    def _upload(self, values: NDArray, dtype: type = wp.int32) -> wp.array:
        return wp.array(values, dtype=dtype, device=self.device)

    def set_distance(self, distance: float) -> None:
        """Another height that is enough [m]."""
        self.settings = replace(self.settings, distance=distance)
        self._clearance.most = distance

    def heights(self) -> NDArray[np.float32]:
        """Height of every vertex over the body when it was cleared last [m], rough far out, shape [vertex_count]."""
        return self._height.numpy()

    def clear(self, body: NDArray[np.floating] | wp.array, positions: wp.array, metre: float = 1.0) -> None:
        """Push a garment out of the body, in place.

        Args:
            body: The posed body, shape [body_vertex_count, 3].
            positions: The garment, array of vec3 on this device in the same space, shape [vertex_count].
            metre: Length of a metre in that space.

        Raises:
            ValueError: If the body has another number of vertices than at rest.
        """
        self._body.move(body)
        if len(self._grids.first):
            frames, self._grids.corner, self._grids.box = self._frames.read(body)
            self._grids.frames.assign(frames)
            near = self._grids.near
            wp.launch(find_near_limbs, near.shape, [self._grids], [near], device=self.device)
        self._clearance.metre = metre
        common = [self._body.struct, self._grids, self._clearance, FOOT_TOLERANCE]
        found = [self._face, self._height, self._normal]
        needs = [self._start, self._rest_height]
        self._launch(find_lacks, [positions, *needs, *common], [*found, self._lack])
        inputs = [positions, *self._neighbours, self._lack, self._clearance]
        self._launch(believable_lacks, inputs, [self._other])
        self._lack, self._other = self._other, self._lack
        # As many means as largest values: so none falls below what it was.
        for kernel in (largest_around, mean_around):
            for _ in range(self.rings):
                self._launch(kernel, [*self._neighbours, self._lack], [self._other])
                self._lack, self._other = self._other, self._lack
        self._launch(push_between_limbs, [positions, *needs, self._lack, *common], [*found, self._moves])
        inputs = [*self._neighbours, *needs, self._lack, *found, self._moves, *common]
        self._launch(push_out, inputs, [positions])


class LimbFrames:
    """How the limbs of a posed body lie: the rigid motion that fits each best (Kabsch 1976)."""

    def __init__(self, binding: ClearanceBinding):
        members = []
        for number in range(len(binding.first)):
            vertices = np.unique(binding.body_faces[binding.limb == number])
            if not len(vertices):
                vertices = np.arange(len(binding.body))
            members.append(vertices[np.linspace(0, len(vertices) - 1, FRAME_POINTS).astype(int)])
        self._members = np.array(members, np.int64).reshape(-1, FRAME_POINTS)
        rest = binding.body[self._members]
        self._centre = rest.mean(1)
        self._rest = rest - self._centre[:, None]

    def read(self, body: NDArray[np.floating] | wp.array) -> tuple[NDArray[np.float32], wp.vec3, wp.vec3]:
        """Where the limbs of a posed body lie.

        Returns:
            Rows of the matrices that take points of the pose to each limb at rest [m], shape [limb_count, 3, 4], a unit
            of length of the pose included. Lowest corner and size of the boxes that hold all limbs and what is near.
        """
        points: NDArray[np.floating] = body if isinstance(body, np.ndarray) else body.numpy()
        posed = points[self._members].astype(np.float64)
        low, high = posed.min(1), posed.max(1)
        centre = posed.mean(1)
        posed -= centre[:, None]
        u, _, vt = np.linalg.svd(np.swapaxes(self._rest, 1, 2) @ posed)
        u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
        scale = np.sqrt((self._rest**2).sum((1, 2)) / np.maximum((posed**2).sum((1, 2)), 1e-30))
        turn = scale[:, None, None] * (u @ vt)
        moved = self._centre - np.einsum("lij,lj->li", turn, centre)
        margin = 2.0 * CELL_REACH / scale[:, None]
        frames = np.concatenate([turn, moved[:, :, None]], 2).astype(np.float32)
        low, high = (low - margin).min(0), (high + margin).max(0)
        return frames, wp.vec3(*low), wp.vec3(*((high - low) / int(BOXES)))
