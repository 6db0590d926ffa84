"""Keeping a synthesised garment out of the body (Xu et al. 2014, section 5, eq 11 and 12; S28 to S30).

    binding = bind_clearance(rest, faces, body_rest, body_faces, limbs)     # once, in the rest pose
    push = PushOut(binding, device=device)
    push.clear(body, positions)                                             # each frame, in place

``rest`` is the settled garment, ``body`` the posed body. A frame is a function of these two alone. An outer garment is
kept outside an inner one in the same way: the inner one is its body, without limbs.

Four things differ from the paper's page. (a) A vertex is not tied to one body vertex: cloth slides, so it walks
over the body to the foot below it, or to a nearer one that its neighbours know of. (b) It is pushed along the body's
smooth normal, so that a push changes its height by just as much. (c) Pushes are spread over the garment before they
are made: largest values around, then as many means, which are nowhere less than what is needed. Folds keep their shape
and ride outwards, where eq 11 would cut them off. (d) Other limbs push as well, as the trunk does a sleeve; where two
walls leave no room, they share what is lacking, and near the crease where they meet cloth is moved out to that.
Nothing is blended again afterwards (eq 13): there is one mesh, not one an example.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.cloth import body_surface
from ..kernels.limb_pushes import push_between_limbs, push_out
from ..kernels.penetration import Clearance, find_lacks, heights_over_surface, mend_feet
from ..kernels.posed_surface import PosedSurface, SkinVertex, pose_vertices, vec_triangle
from ..kernels.spreading import RING, Neighbours, believable_lacks, largest_around, mean_around, vec_ring
from .cloth_contact import Limbs
from .cloth_model import FloatArray, IntArray
from .garment import vertex_neighbours, vertex_normals
from .limb_grids import GridShapes, PosedLimbs, make_grids
from .method import BLOCK_SIZE, RecordedLaunch, SplitLaunch
from .surface import FacingSurface
from .topology import faces_around, mesh_edges, triangles_beside

FACING_REACH = 0.05
"""Skin that looks the way the garment does is preferred at rest, if it is at most this much farther [m]."""

CLUSTER_CELL = 0.005
"""Size of the cells in whose order vertices are dealt with [m]."""

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
        crease: Distances from where two limbs meet at which cloth in both begins to be, and is, left inside [m].
    """

    distance: float = 0.003
    spread: float = 0.02
    soft: float = 0.001
    deep: tuple[float, float] = (0.06, 0.12)
    overlap: tuple[float, float] = (0.02, 0.035)
    crease: tuple[float, float] = (0.008, 0.016)

    def __post_init__(self) -> None:
        if not self.distance >= 0.0 or not self.spread >= 0.0:
            raise ValueError("The clearance and its spread must not be negative.")
        for begin, end in (self.deep, self.overlap, self.crease):
            if not 0.0 <= begin < end:
                raise ValueError("What begins to fade at a lack, depth or distance must have faded at a larger one.")


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
        grids: Grids around the limbs at rest.
    """

    faces: IntArray
    body_faces: IntArray
    body: FloatArray
    start: IntArray
    height: NDArray[np.float32]
    limb: IntArray
    edge: float
    grids: GridShapes


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
    grids = make_grids(body, body_faces, limb, 0 if limbs is None else int(limb.max()) + 1)
    ends = rest[mesh_edges(faces)[0]]
    edge = float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())
    surface = PosedBody(body_faces, len(body), limb, wp.get_device("cpu"))
    surface.move(body)
    height = wp.zeros(len(rest), dtype=wp.float32, device="cpu")
    points, below = wp.array(rest.astype(np.float32), dtype=wp.vec3), wp.array(start, dtype=wp.int32)
    wp.launch(heights_over_surface, len(rest), [points, below, surface.struct, FOOT_TOLERANCE], [height], device="cpu")
    return ClearanceBinding(faces, body_faces, body, start, height.numpy(), limb, edge, grids)


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


class PosedBody:
    """A body on a device, in whatever pose it was moved to last.

    Attributes:
        points: Where its vertices are, in any unit of length, array of vec3, shape [vertex_count].
        struct: As kernels read it.
    """

    def __init__(self, faces: IntArray, vertex_count: int, limb: IntArray, device: wp.Device):
        self.vertex_count = vertex_count
        start, around = (wp.array(values, device=device) for values in faces_around(faces, vertex_count))
        self.points = wp.zeros(vertex_count, dtype=wp.vec3, device=device)
        self.struct = PosedSurface()
        self.struct.vertices = wp.zeros(vertex_count, dtype=SkinVertex, device=device)
        triangles = np.stack([*faces.T, *triangles_beside(faces).T, limb, np.zeros(len(faces))], 1)
        self.struct.triangles = wp.array(triangles.astype(np.int32), dtype=vec_triangle, device=device)

        corners = wp.array(faces, dtype=wp.int32, device=device)
        of_faces = wp.zeros((1, len(faces)), dtype=wp.vec3, device=device)
        points = self.points.reshape((1, vertex_count))

        def face_part(first: int, count: int) -> wp.Launch:
            part = slice(first, first + count)
            inputs, outputs = [points, corners[part]], [of_faces[:, part]]
            return wp.launch(body_surface.face_normals, (1, count), inputs, outputs, device=device, record_cmd=True)

        posed = [self.points, of_faces.flatten(), start, around], [self.struct.vertices]
        self._pose = [
            SplitLaunch(len(faces), device).record_parts(face_part),
            SplitLaunch(vertex_count, device).record(pose_vertices, *posed),
        ]

    def move(self, positions: FloatArray | NDArray[np.float32] | wp.array) -> None:
        """Put the body here, shape [body_vertex_count, 3].

        Raises:
            ValueError: If it has another number of vertices.
        """
        if len(positions) != self.vertex_count:
            raise ValueError(f"The body has {len(positions)} vertices, but {self.vertex_count} at rest.")
        if isinstance(positions, np.ndarray):
            self.points.assign(np.ascontiguousarray(positions, np.float32))
        else:
            wp.copy(self.points, positions)
        for launch in self._pose:
            launch()


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
        self._limbs = PosedLimbs(binding.grids, binding.body, binding.body_faces, binding.limb, self._body.points)
        self.rings = round(self.settings.spread / binding.edge)
        self._clearance = Clearance()
        self._clearance.most, self._clearance.soft = self.settings.distance, self.settings.soft
        self._clearance.deep = wp.vec2(*self.settings.deep)
        self._clearance.overlap = wp.vec2(*self.settings.overlap)
        self._clearance.crease = wp.vec2(*self.settings.crease)
        self._height = wp.zeros(count, dtype=wp.float32, device=self.device)
        self._stages = self._record(binding)

    def _record(self, binding: ClearanceBinding) -> list[RecordedLaunch]:
        """What clearing launches, in turn; what changes from frame to frame is still to be said."""
        count = len(binding.start)
        block_size = BLOCK_SIZE if self.device.is_cpu else 1
        split = SplitLaunch(count, self.device, block_size)

        def room(dtype: type, size: int = count) -> wp.array:
            return wp.zeros(size, dtype=dtype, device=self.device)

        def stage(kernel: wp.Kernel, inputs: list, outputs: list) -> RecordedLaunch:
            return split.record(kernel, [block_size, *inputs], outputs)

        neighbours = make_neighbours(binding.faces, count, self.device)
        positions, moves = room(wp.vec3), room(wp.vec3)
        lack, other = (room(wp.float32, count + 1) for _ in range(2))
        order = wp.array(neighbourly_order(binding.body[binding.body_faces[binding.start, 0]]), device=self.device)
        start = wp.array(binding.start, dtype=wp.int32, device=self.device)
        needs = [start, wp.array(binding.height, dtype=wp.float32, device=self.device)]
        common = [self._body.struct, self._limbs.struct, self._clearance, FOOT_TOLERANCE]
        walked = [room(wp.int32), room(wp.float32), room(wp.vec3), other]
        found = [room(wp.int32), self._height, room(wp.vec3)]
        stages = [
            stage(find_lacks, [order, positions, *needs, *common], walked),
            stage(mend_feet, [neighbours, positions, *needs, *walked, *common], [*found, lack]),
            stage(believable_lacks, [positions, neighbours, lack, 1.0], [other]),
        ]
        lack, other = other, lack
        # As many means as largest values: so none falls below what it was.
        for kernel in (largest_around, mean_around):
            for _ in range(self.rings):
                stages.append(stage(kernel, [neighbours, lack], [other]))
                lack, other = other, lack
        stages.append(stage(push_between_limbs, [order, positions, *needs, lack, *common], [*found, moves, other]))
        stages.append(stage(push_out, [neighbours, *needs, lack, *found, moves, other, *common], [positions]))
        return stages

    def set_distance(self, distance: float) -> None:
        """Another height that is enough [m]."""
        self.settings = replace(self.settings, distance=distance)
        self._clearance.most = distance

    def heights(self) -> NDArray[np.float32]:
        """Height of every vertex over the body when it was cleared last [m], rough far out, shape [vertex_count]."""
        return self._height.numpy()

    def move(self, body: NDArray[np.floating] | wp.array) -> None:
        """Put the body here, shape [body_vertex_count, 3]; the garment need not be known yet.

        Raises:
            ValueError: If it has another number of vertices than at rest.
        """
        self._body.move(body)
        self._limbs.move()

    def clear(self, body: NDArray[np.floating] | wp.array | None, positions: wp.array, metre: float = 1.0) -> None:
        """Push a garment out of the body, in place.

        Args:
            body: The posed body, shape [body_vertex_count, 3]; None if it was moved there already.
            positions: The garment, array of vec3 on this device in the same space, shape [vertex_count].
            metre: Length of a metre in that space.

        Raises:
            ValueError: If the body has another number of vertices than at rest.
        """
        if body is not None:
            self.move(body)
        self._clearance.metre = metre
        changed = {"positions": positions, "clearance": self._clearance, "metre": metre}
        for stage in self._stages:
            stage(changed)


def make_neighbours(faces: IntArray, vertex_count: int, device: wp.Device) -> Neighbours:
    """Neighbours of a garment's vertices as kernels read them."""
    start, entries = vertex_neighbours(faces, vertex_count)
    number = np.diff(start)
    rings = np.full((vertex_count, RING), vertex_count, np.int32)
    for k in range(RING):
        rings[number > k, k] = entries[start[:-1][number > k] + k]
    neighbours = Neighbours()
    neighbours.begin = wp.array(start, dtype=wp.int32, device=device)
    neighbours.all = wp.array(entries, dtype=wp.int32, device=device)
    neighbours.ring = wp.array(rings, dtype=vec_ring, device=device)
    return neighbours


def neighbourly_order(points: FloatArray) -> IntArray:
    """Points in an order in which near ones follow each other (Morton 1966), shape [point_count]."""
    cells = ((points - points.min(0)) / CLUSTER_CELL).astype(np.int64)
    key = np.zeros(len(points), np.int64)
    for bit in range(int(cells.max()).bit_length()):
        for axis in range(3):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable").astype(np.int32)
