"""Left-right symmetry of a character: what lets one side's samples serve for the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .cloth_model import FloatArray, IntArray
from .garment import Body, Garment, bind_to_surface
from .place import Part, Place, PlacedError
from .rig import Joint, Rig, pose_of_angles

VERTEX_TOLERANCE = 1e-4
BODY_TOLERANCE = 2e-3
WARP_TOLERANCE = 0.05
"""How far a mirrored warp may lie from its image, as a sine."""
REMEDY = "symmetrize it in edit mode and set the garment up again"
"""What to do about an asymmetry, as the rest of a sentence."""


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

    A body that is left out is taken for symmetric.
    """
    try:
        return require_mirror(rig, joints, garment, body)
    except PlacedError:
        return None


def require_mirror(rig: Rig, joints: Sequence[Joint], garment: Garment, body: Body | None) -> Mirror:
    """The character's plane of symmetry, halfway between the far bones of the first pair of joints named alike but for
    their side.

    Raises:
        PlacedError: If there is none, with where rig, body or garment are not symmetric.
    """
    by_name = {joint.name: joint for joint in joints}
    partners = {joint.name: _partner(joint, by_name) for joint in joints}
    point, normal = _plane(rig, joints, partners)
    signs = {joint.name: _mirror_signs(rig, joint, partners[joint.name], point, normal) for joint in joints}
    if body is not None:
        _check_body(body, point, normal)
    vertices = _mirror_vertices(garment, point, normal)
    _check_warp(garment, vertices, normal)
    return Mirror(point, normal, vertices, {name: partner.name for name, partner in partners.items()}, signs)


def _partner(joint: Joint, by_name: Mapping[str, Joint]) -> Joint:
    other = other_side(joint.name)
    if other not in by_name:
        raise PlacedError(
            f"Joint {joint.name} is sampled without {other}; sample both, or switch symmetry off.",
            Place(Part.JOINT, names=(joint.name,)),
        )
    return by_name[other]


def _plane(rig: Rig, joints: Sequence[Joint], partners: Mapping[str, Joint]) -> tuple[FloatArray, FloatArray]:
    """A point of the plane [m], shape [3], and its unit normal, shape [3]."""
    pairs = [(joint, partners[joint.name]) for joint in joints if partners[joint.name] is not joint]
    if not pairs:
        raise PlacedError(
            "No joint that is sampled has a left and a right, so there is nothing to mirror; switch symmetry off.",
            Place(Part.ARMATURE),
        )
    left, right = (rig.heads[rig.index[joint.far]] for joint in pairs[0])
    gap = left - right
    if np.linalg.norm(gap) < 1e-3:
        raise _rig_error(*pairs[0], "they lie in one place")
    point, normal = 0.5 * (left + right), gap / np.linalg.norm(gap)
    # Symmetric rigs are modelled along an axis; the exact one keeps mirror images exact.
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) > 1.0 - 1e-6:
        normal = np.eye(3)[axis]
    return point, normal


def _check_body(body: Body, point: FloatArray, normal: FloatArray) -> None:
    reflected = reflect(body.positions, point, normal)
    distance = np.abs(bind_to_surface(reflected, body.positions, body.faces).distance)
    if (off := distance > BODY_TOLERANCE).any():
        raise PlacedError(
            f"The body is not symmetric: {off.sum()} of its vertices lie up to {1e3 * distance.max():.1f} mm off the "
            f"other side's mirror image; {REMEDY}.",
            Place.of_vertices(Part.BODY, off),
        )


def _check_warp(garment: Garment, vertices: IntArray, normal: FloatArray) -> None:
    """Refuse fabric that does not lie mirrored in mirrored triangles, as one that is cut on the bias."""
    if garment.warp is None:
        return
    place = {tuple(corners): triangle for triangle, corners in enumerate(np.sort(garment.faces, 1))}
    images = garment.warp[[place[tuple(corners)] for corners in np.sort(vertices[garment.faces], 1)]]
    mirrored = reflect(garment.warp, np.zeros(3), normal)
    # A warp has no sense of direction: lines are compared, not arrows.
    apart = np.linalg.norm(np.cross(mirrored, images), axis=1) > WARP_TOLERANCE
    if (off := apart | (mirrored.any(1) != images.any(1))).any():
        raise PlacedError(
            f"The fabric of the garment '{garment.name}' is not symmetric: {off.sum()} triangles are not cut as their "
            "mirror images; mirror its UV map, or choose a fabric without a direction.",
            Place.of_vertices(Part.GARMENT, garment.faces[off]),
        )


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


def _mirror_signs(rig: Rig, joint: Joint, partner: Joint, point: FloatArray, normal: FloatArray) -> FloatArray:
    """Factors of the angles under reflection; refuses two joints that are not mirror images."""
    if joint.dof != partner.dof or len(joint.bones) != len(partner.bones):
        raise _rig_error(joint, partner, "one has more bones or turns another way")
    images = reflect(joint.pivot(rig), point, normal)
    if (off := np.linalg.norm(images - partner.pivot(rig))) > 1e-3:
        raise _rig_error(joint, partner, f"a pivot lies {1e3 * off:.1f} mm off its mirror image")
    # A rotation axis is an axial vector: it keeps its part along the plane's normal and loses the sign of the rest.
    axes = -reflect(joint.axes, np.zeros(3), normal)
    cosines = (axes * partner.axes).sum(1)
    if (least := float(np.abs(cosines).min())) < 0.9999:
        raise _rig_error(joint, partner, f"an axis is turned {np.degrees(np.arccos(least)):.1f}° off its mirror image")
    signs = np.sign(cosines)
    # The proof: a posed joint and its partner at mirrored angles put their far bones at mirrored places.
    angles = 0.3 * np.arange(1, joint.dof + 1)
    mine = pose_of_angles(rig, [joint], {joint.name: angles}).matrices[rig.index[joint.far]]
    theirs = pose_of_angles(rig, [partner], {partner.name: signs * angles}).matrices[rig.index[partner.far]]
    tip = np.array([0.0, float(rig.lengths[rig.index[joint.far]]), 0.0, 1.0])
    image = reflect((mine @ tip)[:3], point, normal)
    if (off := np.linalg.norm(image - (theirs @ tip)[:3])) >= 2e-3:
        raise _rig_error(joint, partner, f"turned alike, a bone ends {1e3 * off:.1f} mm off its mirror image")
    return signs


def _rig_error(joint: Joint, partner: Joint, cause: str) -> PlacedError:
    who = f"joint {joint.name}" if joint is partner else f"joints {joint.name} and {partner.name}"
    return PlacedError(f"The rig is not symmetric at {who}: {cause}; {REMEDY}.", Place(Part.JOINT, names=(joint.name,)))


def _mirror_vertices(garment: Garment, point: FloatArray, normal: FloatArray) -> IntArray:
    """Every vertex's mirror image across a plane, shape [vertex_count]; refuses a mesh that is not symmetric."""
    positions, faces = garment.positions, garment.faces
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
    off = (mirror < 0) | (mirror[mirror] != np.arange(len(mirror)))
    if off.any():
        raise PlacedError(
            f"The garment '{garment.name}' is not symmetric: {off.sum()} of its vertices have no mirror image within "
            f"{1e3 * VERTEX_TOLERANCE:.1f} mm; {REMEDY}.",
            Place.of_vertices(Part.GARMENT, off),
        )
    mine = {tuple(corners) for corners in np.sort(faces, 1).tolist()}
    alone = np.array([tuple(corners) not in mine for corners in np.sort(mirror[faces], 1).tolist()])
    if alone.any():
        raise PlacedError(
            f"The garment '{garment.name}' is not symmetric: {alone.sum()} of its triangles have no mirror image; "
            f"{REMEDY}.",
            Place.of_vertices(Part.GARMENT, faces[alone]),
        )
    return mirror.astype(np.int32)
