"""Keeping a played garment clear of its body object, as Blender shows it in each frame."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..database import WrinkleDatabase
from ..garment import Body, Garment, SkinWeights, check_body
from ..penetration import ClearanceBinding, PushOut, bind_clearance
from ..rig import FloatArray, Pose, Rig
from ..wearer import worn_limbs
from .character import apply, read_mesh, read_weights
from .made_behind import begin, take


@dataclass(frozen=True, eq=False)
class Worn:
    """What is kept clear of its body.

    Attributes:
        rig: The bones that the garment is played by.
        garment: The garment as modelled.
        rest: As it lies on the body at rest [m], shape [vertex_count, 3].
        whole: Whether the rig has all bones of the body, so that it can be skinned here.
    """

    rig: Rig
    garment: Garment
    rest: FloatArray
    whole: bool = True

    @staticmethod
    def of_database(database: WrinkleDatabase) -> Worn:
        return Worn(database.header.rig, database.header.garment, database.rest)


@dataclass(frozen=True, eq=False)
class _Bound:
    """A garment bound to a body: that body at rest, how bones move it, and the push out of it."""

    rest: Body
    skin: SkinWeights
    push: PushOut

    @staticmethod
    def of(worn: Worn, rest: Body, device: str) -> _Bound:
        skin = SkinWeights.from_dense(_carried(rest.weights))
        return _Bound(rest, skin, PushOut(bind_to_body(worn, rest), device=device))


class BodyClearance:
    """One garment's push out of its body. What keeps it from pushing is told, and the garment plays as it is.

    Where the body is hidden, or shown with another mesh than its own (subdivided, or its covered skin masked out of the
    render), its own mesh is skinned here and stands for it, if the rig has all its bones.

    Args:
        worn: The garment.
        device: Warp device of its positions.

    Attributes:
        note: One sentence, if the garment should be kept clear in the frame read last and is not, or of the body's
            plain skinning alone; else empty.
    """

    def __init__(self, worn: Worn, device: str):
        self._worn = worn
        self._device = device
        # The body that the garment is bound to, as glanced at, and what came of it, or why nothing did.
        self._glance: object = None
        self._bound: Future[_Bound] | str = ""
        self._push: PushOut | None = None
        self.note = ""

    def read(
        self,
        garment: bpy.types.Object,
        depsgraph: bpy.types.Depsgraph,
        pose: Pose,
        placement: FloatArray,
        *,
        wanted: bool,
    ) -> NDArray[np.float32] | None:
        """The body of this frame in the garment's object space, shape [body_vertex_count, 3]; None to leave it be.

        Args:
            garment: The original garment object.
            depsgraph: The evaluated scene.
            pose: Of the armature in this frame.
            placement: Matrix from rig space [m] to the garment's object space, shape [4, 4].
            wanted: Whether the garment is to be kept clear at all.

        Raises:
            NotReady: If the garment is still being bound to it, in a window.
        """
        self.note = ""
        if not wanted:
            return None
        try:
            return self._read(garment, depsgraph, pose, placement)
        except ValueError as error:
            self.note = f"{error} The garment '{garment.name}' plays without being kept clear of it."
            return None

    def _read(
        self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph, pose: Pose, placement: FloatArray
    ) -> NDArray[np.float32]:
        body = check_body_object(garment.wrinkles.body)
        bound = self._bind(garment, depsgraph, placement)
        self._push = bound.push
        self._push.set_distance(garment.wrinkles.clearance)
        shown = _shown_body(body, depsgraph)
        if shown is not None and len(shown.data.vertices) == len(body.data.vertices):
            points = np.empty(3 * len(shown.data.vertices), np.float32)
            shown.data.attributes["position"].data.foreach_get("vector", points)
            to_garment = garment.evaluated_get(depsgraph).matrix_world.inverted_safe() @ shown.matrix_world
            place = np.array(to_garment, np.float32)
            if np.array_equal(place, np.eye(4)):
                return points.reshape(-1, 3)
            return points.reshape(-1, 3) @ place[:3, :3].T + place[:3, 3]
        how = "is hidden" if shown is None else "is shown with another mesh than its own"
        if not self._worn.whole:
            raise ValueError(f"The body '{body.name}' {how}.")
        self.note = f"The body '{body.name}' {how}; the garment '{garment.name}' is kept clear of its plain skinning."
        deformations = pose.deformations(self._worn.rig)
        moved = bound.skin.carry(placement @ deformations, bound.rest.positions)
        return moved.astype(np.float32)

    def _bind(self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph, placement: FloatArray) -> _Bound:
        """See to it that the garment is bound to this body; once for each, as it takes some tenths of a second."""
        body = garment.wrinkles.body
        glance = body.session_uid, body.data.session_uid, len(body.data.vertices)
        if self._glance != glance:
            self._glance = glance
            # As placed in this frame, like the placement: a render does not move the originals.
            worn, skin = (ob.evaluated_get(depsgraph).matrix_world for ob in (garment, body))
            to_garment = np.array(worn.inverted_safe() @ skin, np.float64)
            try:
                rest = rest_body(body, self._worn.rig, np.linalg.inv(placement) @ to_garment)
                self._bound = begin(partial(_Bound.of, self._worn, rest, self._device), depsgraph)
            except ValueError as error:
                self._bound = str(error)
        if isinstance(self._bound, str):
            raise ValueError(self._bound)
        return take(self._bound, depsgraph)

    def move(self, body: NDArray[np.float32]) -> None:
        """Be ready for what :meth:`read` gave; on any thread."""
        assert self._push is not None
        self._push.move(body)

    def clear(self, body: NDArray[np.float32] | None, positions: wp.array, placement: FloatArray) -> None:
        """Push a garment out of what :meth:`read` gave, in place.

        Args:
            body: What it gave; None after :meth:`move`.
            positions: The garment in its object space, array of vec3, shape [vertex_count].
            placement: Matrix from rig space [m] to that space, shape [4, 4].
        """
        assert self._push is not None
        metre = metre_of(placement)
        # A garment that is scaled to nothing is not seen.
        if metre > 0.0:
            self._push.clear(body, positions, metre)


def metre_of(placement: FloatArray) -> float:
    """Length of a metre in the space that a matrix from rig space [m] leads to, shape [4, 4]."""
    return abs(float(np.linalg.det(placement[:3, :3]))) ** (1.0 / 3.0)


def bind_to_body(worn: Worn, body: Body) -> ClearanceBinding:
    """Bind a garment to the body at rest."""
    limbs = worn_limbs(worn.rig, worn.garment, body)
    return bind_clearance(worn.rest, worn.garment.faces, body.positions, body.faces, limbs)


def check_body_object(body: bpy.types.Object | None) -> bpy.types.Object:
    """The body object, if a garment can be kept clear of it.

    Raises:
        ValueError: One sentence, if not.
    """
    if body is None:
        raise ValueError("No body is set.")
    if body.type != "MESH":
        raise ValueError(f"The body '{body.name}' is no mesh.")
    if body.data.is_editmode:
        raise ValueError(f"The body '{body.name}' is being edited.")
    return body


def _shown_body(body: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bpy.types.Object | None:
    """The evaluated body, or None where Blender does not evaluate it."""
    shown = depsgraph.objects.get(body.name)
    by_eye = depsgraph.mode == "VIEWPORT" and body.hide_get(view_layer=depsgraph.view_layer) and not body.hide_viewport
    # Blender does not move what is hidden, except by the eye in the outliner, but says that it is evaluated.
    if not by_eye and (shown is None or shown.original != body):
        return None
    return body.evaluated_get(depsgraph)


def _carried(weights: FloatArray) -> FloatArray:
    """Bone weights of which those vertices that no bone reaches go with the first bone."""
    free = weights.sum(1) <= 0.0
    weights = weights.copy()
    weights[free, 0] = 1.0
    return weights


def rest_body(body: bpy.types.Object, rig: Rig, to_rig: FloatArray) -> Body:
    """The body as it rests: its own mesh with the shape keys that nothing animates, under no modifier.

    Args:
        to_rig: Matrix from the body's object space to rig space [m], shape [4, 4].

    Raises:
        ValueError: One sentence, if it is none that a garment is worn on.
    """
    positions, faces = read_mesh(body.data)
    shaped = apply(to_rig, positions + _constant_shape(body))
    rest = Body(shaped, faces, read_weights(body, body.data, rig))
    check_body(rest)
    return rest


def _constant_shape(body: bpy.types.Object) -> FloatArray | float:
    """What shape keys that nothing animates add to a mesh, in its own space, shape [vertex_count, 3]."""
    keys = body.data.shape_keys
    if keys is None or not keys.use_relative:
        return 0.0
    if keys.animation_data is not None and keys.animation_data.action is not None:
        return 0.0
    driven = {curve.data_path for curve in keys.animation_data.drivers} if keys.animation_data else set()
    total = np.zeros((len(body.data.vertices), 3))
    for block in keys.key_blocks:
        if block.mute or block.value == 0.0 or block.path_from_id("value") in driven:
            continue
        total += block.value * (_key_shape(block) - _key_shape(block.relative_key))
    return total


def _key_shape(block: bpy.types.ShapeKey) -> FloatArray:
    shape = np.empty(3 * len(block.data), np.float32)
    block.data.foreach_get("co", shape)
    return shape.reshape(-1, 3).astype(np.float64)
