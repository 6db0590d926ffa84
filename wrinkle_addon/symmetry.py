"""Left-right symmetry of a character: what lets one side's samples serve for the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .cloth_model import FloatArray, IntArray
from .garment import Body, Garment, bind_to_surface
from .rig import Joint, Rig, pose_of_angles

VERTEX_TOLERANCE = 1e-4
BODY_TOLERANCE = 2e-3
WARP_TOLERANCE = 0.05
"""How far a mirrored warp may lie from its image, as a sine."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """A plane across which rig, body and garment are their own mirror images.

    Attributes:
        point: A point of the plane [m], shape [3].
        normal: Its unit normal, shape [3].
        vertices: Mirror image of each garment vertex, shape [vertex_count].
        joints: Mirror image of each joint.
        signs: Factors that turn a joint's angles into those of its mirror image, shape [dof].
    """

    point: FloatArray
    normal: FloatArray
    vertices: IntArray
    joints: Mapping[str, str]
    signs: Mapping[str, FloatArray]

    def reflect(self, positions: ArrayLike) -> FloatArray:
        """Mirror images of points [m], shape [..., 3]."""
        return reflect(np.asarray(positions, np.float64), self.point, self.normal)

    def reflect_garment(self, positions: ArrayLike) -> FloatArray:
        """The garment as its mirror image would lie, in vertex order [m], shape [vertex_count, 3]."""
        return self.reflect(positions)[self.vertices]


def reflect(points: FloatArray, point: FloatArray, normal: FloatArray) -> FloatArray:
    """Mirror images of points across a plane, shape [..., 3]."""
    return points - 2.0 * ((points - point) @ normal)[..., None] * normal


def find_mirror(rig: Rig, joints: Sequence[Joint], garment: Garment, body: Body | None) -> Mirror | None:
    """The character's plane of symmetry, or None where rig, body or garment are not symmetric.

    A body that is left out is taken for symmetric. The plane stands halfway between the far bones of the first pair of
    joints named alike but for their side.
    """
    by_name = {joint.name: joint for joint in joints}
    pairs = [(joint, by_name[other]) for joint in joints if (other := other_side(joint.name)) in by_name]
    if not pairs:
        return None
    left, right = (rig.heads[rig.index[joint.far]] for joint in pairs[0])
    gap = left - right
    if np.linalg.norm(gap) < 1e-3:
        return None
    point, normal = 0.5 * (left + right), gap / np.linalg.norm(gap)
    # Symmetric rigs are modelled along an axis; the exact one keeps mirror images exact.
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) > 1.0 - 1e-6:
        normal = np.eye(3)[axis]
    signs: dict[str, FloatArray] = {}
    for joint in joints:
        partner = by_name.get(other_side(joint.name), joint)
        found = _mirror_signs(rig, joint, partner, point, normal)
        if found is None:
            return None
        signs[joint.name] = found
    if body is not None:
        reflected = reflect(body.positions, point, normal)
        if np.abs(bind_to_surface(reflected, body.positions, body.faces).distance).max() > BODY_TOLERANCE:
            return None
    vertices = mirror_vertices(garment.positions, garment.faces, point, normal)
    if vertices is None or not warp_is_symmetric(garment, vertices, normal):
        return None
    names = {joint.name: by_name.get(other_side(joint.name), joint).name for joint in joints}
    return Mirror(point, normal, vertices, names, signs)


def warp_is_symmetric(garment: Garment, vertices: IntArray, normal: FloatArray) -> bool:
    """Whether the fabric of mirrored triangles lies mirrored, too; a fabric cut on the bias may not."""
    if garment.warp is None:
        return True
    place = {tuple(corners): triangle for triangle, corners in enumerate(np.sort(garment.faces, 1))}
    images = garment.warp[[place[tuple(corners)] for corners in np.sort(vertices[garment.faces], 1)]]
    mirrored = reflect(garment.warp, np.zeros(3), normal)
    # A warp has no sense of direction: lines are compared, not arrows.
    apart = np.linalg.norm(np.cross(mirrored, images), axis=1)
    both_known = mirrored.any(1) == images.any(1)
    return bool((apart <= WARP_TOLERANCE).all() and both_known.all())


def symmetric_limits(joints: Sequence[Joint], mirror: Mirror) -> list[Joint]:
    """The joints with ranges that hold their own and their mirror image's, so that one side's samples serve both."""
    limits = {joint.name: joint.limits for joint in joints}
    result = []
    for joint in joints:
        signs = mirror.signs[joint.name][:, None]
        image = np.sort(signs * limits[mirror.joints[joint.name]], axis=1)
        low, high = np.minimum(joint.limits[:, 0], image[:, 0]), np.maximum(joint.limits[:, 1], image[:, 1])
        result.append(replace(joint, limits=np.stack([low, high], 1)))
    return result


def other_side(name: str) -> str:
    """The joint's name on the other side of the body; a joint of the middle keeps its own."""
    return {"_L": name[:-2] + "_R", "_R": name[:-2] + "_L"}.get(name[-2:], name)


def _mirror_signs(rig: Rig, joint: Joint, partner: Joint, point: FloatArray, normal: FloatArray) -> FloatArray | None:
    """Factors of the angles under reflection, or None when the two joints are not mirror images."""
    if joint.dof != partner.dof or len(joint.bones) != len(partner.bones):
        return None
    images = reflect(joint.pivot(rig), point, normal)
    if np.linalg.norm(images - partner.pivot(rig)) > 1e-3:
        return None
    # A rotation axis is an axial vector: it keeps its part along the plane's normal and loses the sign of the rest.
    axes = -reflect(joint.axes, np.zeros(3), normal)
    cosines = (axes * partner.axes).sum(1)
    if (np.abs(cosines) < 0.9999).any():
        return None
    signs = np.sign(cosines)
    # The proof: a posed joint and its partner at mirrored angles put their far bones at mirrored places.
    angles = 0.3 * np.arange(1, joint.dof + 1)
    mine = pose_of_angles(rig, [joint], {joint.name: angles}).matrices[rig.index[joint.far]]
    theirs = pose_of_angles(rig, [partner], {partner.name: signs * angles}).matrices[rig.index[partner.far]]
    tip = np.array([0.0, float(rig.lengths[rig.index[joint.far]]), 0.0, 1.0])
    image = reflect((mine @ tip)[:3], point, normal)
    return signs if np.linalg.norm(image - (theirs @ tip)[:3]) < 2e-3 else None


def mirror_vertices(positions: FloatArray, faces: IntArray, point: FloatArray, normal: FloatArray) -> IntArray | None:
    """Every vertex's mirror image across a plane, shape [vertex_count], or None if the mesh is not symmetric."""
    images = reflect(positions, point, normal)
    mirror = np.full(len(positions), -1, np.int64)
    # Vertices and images pair up by rounded coordinates, unless one falls on the edge of a cell; two grids, half a
    # cell apart, have their edges in different places.
    for shift in (0.0, 0.5):
        cell = 4.0 * VERTEX_TOLERANCE
        keys = np.floor(np.concatenate([positions, images]) / cell + shift).astype(np.int64)
        codes = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
        own, theirs = codes[: len(positions)], codes[len(positions) :]
        order = np.argsort(own, kind="stable")
        candidate = order[np.minimum(np.searchsorted(own[order], theirs), len(order) - 1)]
        close = np.linalg.norm(positions[candidate] - images, axis=1) < VERTEX_TOLERANCE
        mirror = np.where((mirror < 0) & close, candidate, mirror)
    if (mirror < 0).any() or (mirror[mirror] != np.arange(len(mirror))).any():
        return None
    mine = np.unique(np.sort(faces, 1), axis=0)
    theirs = np.unique(np.sort(mirror[faces], 1), axis=0)
    return mirror.astype(np.int32) if np.array_equal(mine, theirs) else None
