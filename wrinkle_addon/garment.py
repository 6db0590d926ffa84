"""The garment and the body under it, as arrays in rig space, and what binds one to the other."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ..kernels.surface import closest_surface_points
from .cloth_model import FloatArray, IntArray
from .place import Part, Place, PlacedError
from .rig import Joint, Rig
from .topology import border_edges, distinct_pairs, mesh_edges, row_starts

INFLUENCES = 6
"""Bones that carry a garment vertex, at most."""

BODY_SIZES = (0.3, 4.0)
"""Sizes of a body that are taken for metres [m]."""


@dataclass(frozen=True, eq=False)
class SkinWeights:
    """Which bones carry each vertex, the heaviest first.

    Attributes:
        bones: Bone indices, shape [vertex_count, INFLUENCES]; 0 where the weight is 0.
        weights: Weights that add up to 1 for every vertex, shape [vertex_count, INFLUENCES].
    """

    bones: IntArray
    weights: NDArray[np.float32]

    @staticmethod
    def from_dense(dense: ArrayLike) -> SkinWeights:
        """The heaviest influences of a dense matrix of shape [vertex_count, bone_count].

        Raises:
            ValueError: If a vertex has no weight at all.
        """
        dense = np.asarray(dense, np.float64)
        if dense.shape[1] < INFLUENCES:
            dense = np.pad(dense, ((0, 0), (0, INFLUENCES - dense.shape[1])))
        order = np.argsort(-dense, axis=1, kind="stable")[:, :INFLUENCES]
        weights = np.take_along_axis(dense, order, 1)
        total = weights.sum(1, keepdims=True)
        if (total <= 0.0).any():
            raise ValueError(f"{int((total <= 0.0).sum())} vertices are carried by no bone.")
        weights = weights / total
        return SkinWeights(np.where(weights > 0.0, order, 0).astype(np.int32), weights.astype(np.float32))

    def to_dense(self, bone_count: int) -> FloatArray:
        dense = np.zeros((len(self.bones), bone_count))
        np.add.at(dense, (np.arange(len(self.bones))[:, None], self.bones), self.weights)
        return dense

    def blend(self, matrices: FloatArray) -> FloatArray:
        """Weighted sum of bone matrices for every vertex, shape [bone_count, ...] to [vertex_count, ...]."""
        weights = self.weights.astype(np.float64)
        total = weights[:, 0].reshape(-1, *[1] * (matrices.ndim - 1)) * matrices[self.bones[:, 0]]
        for k in range(1, INFLUENCES):
            total += weights[:, k].reshape(-1, *[1] * (matrices.ndim - 1)) * matrices[self.bones[:, k]]
        return total

    def carry(self, deformations: FloatArray, positions: ArrayLike) -> FloatArray:
        """Linear blend skinning of positions [m], shape [vertex_count, 3], by bone matrices [bone_count, 4, 4]."""
        blended = self.blend(deformations)
        return np.einsum("vij,vj->vi", blended[:, :3, :3], np.asarray(positions, np.float64)) + blended[:, :3, 3]

    def turn(self, turns: FloatArray) -> FloatArray:
        """Q of the default formulation: normalised weighted quaternions, aligned to each vertex's first bone.

        Args:
            turns: Bone turns (w, x, y, z), shape [bone_count, 4].
        """
        first = turns[self.bones[:, 0]]
        total = np.zeros((len(self.bones), 4))
        for k in range(INFLUENCES):
            q = turns[self.bones[:, k]]
            sign = np.where((q * first).sum(1, keepdims=True) < 0.0, -1.0, 1.0)
            total += self.weights[:, k : k + 1] * sign * q
        return total / np.linalg.norm(total, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Body:
    """The body mesh in the rig's rest pose.

    Attributes:
        positions: Vertices in rig space [m], shape [vertex_count, 3].
        faces: Triangles, outward by their winding, shape [triangle_count, 3].
        weights: Dense bone weights, rows adding up to 1 (or 0 where no deforming bone reaches),
            shape [vertex_count, bone_count].
    """

    positions: FloatArray
    faces: IntArray
    weights: FloatArray

    def carry(self, deformations: FloatArray) -> FloatArray:
        """Linear blend skinning by bone matrices, shape [bone_count, 4, 4]; what no bone carries stays where it is.

        Returns:
            The posed vertices [m], shape [vertex_count, 3].
        """
        still = 1.0 - self.weights.sum(1)
        blended = np.tensordot(self.weights, deformations[:, :3], 1) + still[:, None, None] * np.eye(4)[:3]
        return np.einsum("vij,vj->vi", blended[:, :, :3], self.positions) + blended[:, :, 3]

    def fingerprint(self) -> str:
        """Hash of topology, rest shape (rounded to 10 micrometres) and weights (to 1e-4)."""
        return _hash(self.faces, np.round(self.positions * 1e5), np.round(self.weights * 1e4))


@dataclass(frozen=True, eq=False)
class Garment:
    """The garment as modelled, in the rig's rest pose.

    Attributes:
        name: Name of its object.
        positions: Vertices in rig space [m], shape [vertex_count, 3].
        faces: Triangles, outward by their winding, shape [triangle_count, 3].
        weights: What carries it along with the rig.
        pins: How firmly each vertex is held to the skin, from 0 to 1, shape [vertex_count].
        warp: Direction of the fabric's warp on each triangle, unit vectors or zero where it is not known, shape
            [triangle_count, 3]; None where it is known nowhere. See :func:`warp_directions`.
    """

    name: str
    positions: FloatArray
    faces: IntArray
    weights: SkinWeights
    pins: NDArray[np.float32]
    warp: FloatArray | None = None

    @property
    def vertex_count(self) -> int:
        return len(self.positions)

    @cached_property
    def normals(self) -> FloatArray:
        """Vertex normals as modelled, shape [vertex_count, 3]."""
        return vertex_normals(self.positions, self.faces)

    def fingerprint(self) -> str:
        """Hash of topology, modelled shape (rounded to 10 micrometres), weights, pins and warp (to 1e-3)."""
        return _hash(
            self.faces,
            np.round(self.positions * 1e5),
            self.weights.bones,
            np.round(self.weights.weights * 1e4),
            np.round(self.pins * 1e3),
            *([] if self.warp is None else [np.round(self.warp * 1e3)]),
        )

    def topology(self) -> str:
        """Hash of the triangles alone."""
        return _hash(self.faces)


def _hash(*arrays: NDArray) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).astype("<i8").tobytes())
    return digest.hexdigest()


def vertex_normals(positions: FloatArray, faces: IntArray) -> FloatArray:
    """Area-weighted unit vertex normals, shape [vertex_count, 3]."""
    corners = positions[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(face_normals[:, k], 3), len(positions)) for k in range(3)], 1
    )
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def warp_directions(positions: FloatArray, faces: IntArray, uvs: FloatArray) -> FloatArray | None:
    """Where V grows on each triangle: the warp of a garment whose texture coordinates are its flat pattern.

    Args:
        positions: Vertices [m], shape [vertex_count, 3].
        faces: Triangles, shape [triangle_count, 3].
        uvs: Texture coordinates of every corner, shape [triangle_count, 3, 2].

    Returns:
        Unit vectors, zero where the coordinates span no area, shape [triangle_count, 3]; None if they span none at all.
    """
    edges = positions[faces[:, 1:]] - positions[faces[:, :1]]
    u, v = np.moveaxis(uvs[:, 1:] - uvs[:, :1], 2, 0)
    span = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    known = np.abs(span) > 1e-9 * np.abs(span).max(initial=0.0)
    if not known.any():
        return None
    along = np.sign(span)[:, None] * (u[:, :1] * edges[:, 1] - u[:, 1:] * edges[:, 0])
    size = np.linalg.norm(along, axis=1)
    known &= size > 0.0
    return np.where(known[:, None], along / np.where(known, size, 1.0)[:, None], 0.0)


def check_surface(name: str, positions: FloatArray, faces: IntArray) -> None:
    """Refuse a garment mesh that cannot be simulated.

    Raises:
        PlacedError: One sentence that says what is wrong and what to do.
    """
    for problem in surface_problems(name, positions, faces):
        raise problem


def surface_problems(name: str, positions: FloatArray, faces: IntArray) -> Iterator[PlacedError]:
    """Everything that keeps a garment mesh from being simulated, the worst first."""
    if not len(faces):
        yield PlacedError(f"The garment '{name}' has no faces; choose a mesh with a surface.", Place(Part.GARMENT))
        return
    if not np.isfinite(positions).all():
        bad = (~np.isfinite(positions)).any(1)
        yield PlacedError(
            f"{int(bad.sum())} vertices of the garment '{name}' have positions that are not numbers; repair the mesh.",
            Place.of_vertices(Part.GARMENT, bad),
        )
        return
    used = np.zeros(len(positions), bool)
    used[faces] = True
    if not used.all():
        yield PlacedError(
            f"The garment '{name}' has {int((~used).sum())} loose vertices that belong to no face; "
            "delete loose geometry.",
            Place.of_vertices(Part.GARMENT, ~used),
        )
    edges, edge_of_side = mesh_edges(faces)
    counts = np.bincount(edge_of_side.ravel())
    if (counts > 2).any():
        yield PlacedError(
            f"The garment '{name}' has {int((counts > 2).sum())} edges with more than two faces; "
            "select non-manifold edges and split or delete the extra faces.",
            Place.of_vertices(Part.GARMENT, edges[counts > 2]),
        )
    corners = positions[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    flat = area < 1e-6 * np.median(area)
    if flat.any():
        yield PlacedError(
            f"The garment '{name}' has {int(flat.sum())} faces without area; "
            "merge vertices by distance or dissolve them.",
            Place.of_vertices(Part.GARMENT, faces[flat]),
        )


def split_vertices(positions: FloatArray, faces: IntArray) -> IntArray:
    """Vertices on open edges that lie where another one lies: there the mesh only looks sewn, and will come apart."""
    open_vertices = np.unique(border_edges(faces))
    rounded = np.round(positions[open_vertices] * 1e6)
    _, place, there = np.unique(rounded, axis=0, return_inverse=True, return_counts=True)
    return open_vertices[there[place.ravel()] > 1]


def check_body(body: Body) -> None:
    """Refuse a body that no garment can be worn on.

    Raises:
        ValueError: One sentence that says what is wrong and what to do.
    """
    if not len(body.faces):
        raise ValueError("The body has no faces; choose the mesh that the garment is worn on.")
    lost = (~np.isfinite(body.positions)).any(1)
    if lost.any():
        raise PlacedError(
            f"{int(lost.sum())} vertices of the body have positions that are not numbers; repair the mesh.",
            Place.of_vertices(Part.BODY, lost),
        )
    size = float(np.ptp(body.positions, axis=0).max())
    if not BODY_SIZES[0] < size < BODY_SIZES[1]:
        raise PlacedError(
            f"The body is {size:.3g} m tall; "
            "set the scene's unit scale, or the armature's, so that it has its true size.",
            Place(Part.BODY),
        )


def check_fit(name: str, positions: FloatArray, body: Body, distance: NDArray[np.float32]) -> None:
    """Refuse a garment that is not worn: far from the body, or deep inside it.

    Args:
        distance: Signed distance of each vertex to the body [m], negative inside, shape [vertex_count].

    Raises:
        ValueError: One sentence that says what is wrong and what to do.
    """
    far = float(np.median(distance))
    if far > 0.15:
        raise PlacedError(
            f"The garment '{name}' is {far:.2f} m away from the body; put it on the body in the rig's rest pose.",
            Place.of_vertices(Part.GARMENT, distance > 0.15),
        )
    deep = distance < -0.03
    if deep.mean() > 0.2:
        raise PlacedError(
            f"{100 * deep.mean():.0f} % of the garment '{name}' lies more than 30 mm inside the body; "
            "fit it to the body in the rig's rest pose first.",
            Place.of_vertices(Part.GARMENT, deep),
        )


@dataclass(frozen=True, eq=False)
class SurfaceBinding:
    """Where points lie on a surface.

    Attributes:
        faces: Closest triangle, shape [point_count].
        weights: Barycentric coordinates on it, shape [point_count, 3].
        distance: Signed distance [m], negative behind the surface, shape [point_count].
    """

    faces: IntArray
    weights: NDArray[np.float32]
    distance: NDArray[np.float32]


def bind_to_surface(points: FloatArray, positions: FloatArray, faces: IntArray) -> SurfaceBinding:
    """Closest points of a triangle mesh; the sign of the distance comes from its interpolated vertex normals."""
    face, weights, distance = _closest_points(points, positions, faces)
    corners = faces[face]
    closest = np.einsum("pc,pcd->pd", weights, positions[corners])
    normals = np.einsum("pc,pcd->pd", weights, vertex_normals(positions, faces)[corners])
    behind = ((points - closest) * normals).sum(1) < 0.0
    return SurfaceBinding(face, weights, np.where(behind, -1.0, 1.0).astype(np.float32) * distance)


def distances_to_surface(points: FloatArray, positions: FloatArray, faces: IntArray) -> NDArray[np.float32]:
    """How far points are from a triangle mesh [m], on whichever side, shape [point_count]."""
    return _closest_points(points, positions, faces)[2]


def _closest_points(
    points: FloatArray, positions: FloatArray, faces: IntArray
) -> tuple[IntArray, NDArray[np.float32], NDArray[np.float32]]:
    """Triangles, barycentric weights of their corners, and distances [m]."""
    mesh = wp.Mesh(
        points=wp.array(positions.astype(np.float32), dtype=wp.vec3, device="cpu"),
        indices=wp.array(np.ascontiguousarray(faces).ravel().astype(np.int32), dtype=wp.int32, device="cpu"),
    )
    count = len(points)
    face = wp.zeros(count, dtype=wp.int32, device="cpu")
    weights = wp.zeros(count, dtype=wp.vec3, device="cpu")
    distance = wp.zeros(count, dtype=wp.float32, device="cpu")
    queried = wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu")
    wp.launch(
        closest_surface_points, dim=count, inputs=[queried, mesh.id], outputs=[face, weights, distance], device="cpu"
    )
    return face.numpy(), weights.numpy(), distance.numpy()


def skin_garment(positions: FloatArray, faces: IntArray, body: Body, *, smoothing: int = 20) -> SkinWeights:
    """Weights of the nearest body surface point, smoothed over the garment.

    Args:
        smoothing: Rounds of averaging with the neighbours; without it, folds of the body leave steps in the skin.

    Raises:
        ValueError: If the body under a part of the garment is carried by no bone.
    """
    binding = bind_to_surface(positions, body.positions, body.faces)
    dense = np.einsum("pc,pcb->pb", binding.weights.astype(np.float64), body.weights[body.faces[binding.faces]])
    total = dense.sum(1, keepdims=True)
    if (total < 1e-3).any():
        raise PlacedError(
            f"{int((total < 1e-3).sum())} vertices of the garment lie over parts of the body that no deforming bone "
            "moves; give the body weights there.",
            Place.of_vertices(Part.GARMENT, total[:, 0] < 1e-3),
        )
    dense = dense / total
    neighbours = vertex_neighbours(faces, len(positions))
    # Most bones carry nothing of a garment, and zeros stay zeros.
    carrying = dense.any(0)
    shares = dense[:, carrying]
    for _ in range(smoothing):
        shares = 0.5 * shares + 0.5 * neighbour_mean(shares, neighbours)
    dense[:, carrying] = shares
    dense[dense < 0.01] = 0.0
    return SkinWeights.from_dense(dense)


def neighbour_mean(values: FloatArray, neighbours: tuple[IntArray, IntArray]) -> FloatArray:
    """Mean over each vertex's neighbours, as :func:`vertex_neighbours` tells them, shape [vertex_count, ...]."""
    start, others = neighbours
    sums = np.add.reduceat(values[others], start[:-1], axis=0)
    return sums / np.diff(start).reshape(-1, *[1] * (values.ndim - 1))


def vertex_neighbours(faces: IntArray, vertex_count: int) -> tuple[IntArray, IntArray]:
    """Neighbours of each vertex along edges: (start, neighbours), ascending. Every vertex must belong to a face."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    both, _ = distinct_pairs(*np.concatenate([directed, directed[:, ::-1]]).T)
    return row_starts(both[:, 0], vertex_count), both[:, 1]


# --- regions ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Regions:
    """The garment cut into parts that belong to one body segment each (W64, W65).

    Attributes:
        segments: Names of the segments; the first is the trunk below all joints.
        frames: For each segment, the bone whose rigid motion it follows.
        bone_segment: Segment of each bone, shape [bone_count].
        vertex_segment: Segment of each garment vertex, shape [vertex_count].
        joints: For each joint name, the segments on its near and on its far side.
    """

    segments: tuple[str, ...]
    frames: tuple[int, ...]
    bone_segment: IntArray
    vertex_segment: IntArray
    joints: Mapping[str, tuple[int, int]]

    def joints_of(self, segment: int) -> list[str]:
        """Joints that border a segment."""
        return [name for name, sides in self.joints.items() if segment in sides]


def find_regions(rig: Rig, joints: Sequence[Joint], weights: SkinWeights) -> Regions:
    """Cut the skeleton at the joints, and give each garment vertex to the segment that carries most of it."""
    segments, frames = ["root"], [0]
    starts: dict[int, int] = {}
    for joint in joints:
        first = joint.bones[len(joint.bones) // 2] if joint.is_chain else joint.far
        starts[rig.index[first]] = len(segments)
        segments.append(joint.name)
        frames.append(rig.index[joint.far])
    bone_segment = np.zeros(rig.bone_count, np.int32)
    for bone in range(rig.bone_count):
        parent = rig.parents[bone]
        bone_segment[bone] = starts.get(bone, bone_segment[parent] if parent >= 0 else 0)
    # The trunk follows the bone that the joints nearest to the root are measured against.
    near = [rig.index[joint.near] for joint in joints if joint.near and bone_segment[rig.index[joint.near]] == 0]
    frames[0] = min(near, default=0)
    share = np.zeros((len(weights.bones), len(segments)))
    np.add.at(share, (np.arange(len(share))[:, None], bone_segment[weights.bones]), weights.weights)
    sides = {
        joint.name: (int(bone_segment[rig.index[joint.near]]) if joint.near else 0, number)
        for number, joint in enumerate(joints, 1)
    }
    return Regions(tuple(segments), tuple(frames), bone_segment, share.argmax(1).astype(np.int32), sides)


def distances_to_segments(positions: FloatArray, faces: IntArray, regions: Regions) -> FloatArray:
    """Distance of every vertex to every segment of the garment [m], infinite to an empty one (W67).

    Shape [vertex_count, segment_count]. A segment is the set of triangles all of whose corners belong to it.
    """
    distances = np.full((len(positions), len(regions.segments)), np.inf)
    for segment in range(len(regions.segments)):
        inside = (regions.vertex_segment[faces] == segment).all(1)
        if inside.any():
            distances[:, segment] = distances_to_surface(positions, positions, faces[inside])
        distances[regions.vertex_segment == segment, segment] = 0.0
    return distances
