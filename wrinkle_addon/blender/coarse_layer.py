"""A garment's coarse layer in the scene: the mesh whose motion the garment takes on, under its own wrinkles.

Any mesh that moves can be the coarse layer: Blender's cloth, a Surface Deform rig, an Alembic cache, plain skinning.
Garment and coarse mesh are matched as modelled, in the rest pose; where the coarse mesh goes, the garment goes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import bpy
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..aligned_wrinkles import AlignedWrinkles
from ..correspondence import Correspondence, find_correspondence
from ..database import WrinkleDatabase
from ..joint_wrinkles import HostArray, JointEvaluator
from ..rig import FloatArray, Pose
from .character import MeshArrays, apply, read_mesh
from .node_group import add_modifier, find_modifier, get_input, set_input

NONE, MESH = "NONE", "MESH"
"""What a garment's coarse layer is: nothing but its skin, or a mesh of the scene."""


def tie_coarse(garment: bpy.types.Object) -> None:
    """Let Blender evaluate the coarse mesh wherever it evaluates the garment, in renders that do not show it, too."""
    settings = garment.wrinkles
    wanted = settings.coarse if settings.coarse_layer != NONE else None
    if wanted is None and find_modifier(garment) is None:
        return
    modifier = add_modifier(garment)
    if get_input(modifier, "Coarse") != wanted:
        set_input(modifier, "Coarse", wanted)
        garment.update_tag()


def choose_coarse(garment: bpy.types.Object) -> None:
    """Remember where the coarse mesh stands beside the garment, now that the artist has chosen it."""
    settings = garment.wrinkles
    if settings.coarse is not None:
        place = garment.matrix_world.inverted_safe() @ settings.coarse.matrix_world
        settings.coarse_place = [value for row in place for value in row]
    tie_coarse(garment)


def chosen_coarse(garment: bpy.types.Object) -> bpy.types.Object:
    """The coarse mesh of a garment that is to have one.

    Raises:
        ValueError: If there is none, or one that cannot be; one sentence that says what to do.
    """
    coarse = garment.wrinkles.coarse
    if coarse is None:
        raise ValueError(
            f"The coarse mesh of the garment '{garment.name}' is missing; choose one, or switch its coarse layer off."
        )
    if coarse == garment:
        raise ValueError(f"The garment '{garment.name}' cannot be its own coarse mesh; choose another one.")
    if coarse.type != "MESH":
        raise ValueError(f"The coarse mesh '{coarse.name}' is no mesh; choose a mesh object.")
    if coarse.data.is_editmode:
        raise ValueError(f"The coarse mesh '{coarse.name}' is being edited; leave its edit mode.")
    return coarse


def _refuse_loops(garment: bpy.types.Object, coarse: bpy.types.Object) -> None:
    """Refuse a coarse mesh that moves by what the garment does."""
    users = bpy.data.user_map()
    pending: list[bpy.types.ID] = [garment]
    seen: set[bpy.types.ID] = {garment}
    while pending:
        for user in users.get(pending.pop(), ()):
            # A scene and its folders hold objects; they do not move by them.
            if user not in seen and isinstance(user, bpy.types.Object | bpy.types.Key | bpy.types.Mesh):
                seen.add(user)
                pending.append(user)
    if coarse in seen:
        raise ValueError(
            f"The coarse mesh '{coarse.name}' depends on the garment '{garment.name}' itself; "
            "choose a mesh that moves without it."
        )


def rest_shapes(garment: bpy.types.Object, coarse: bpy.types.Object) -> tuple[MeshArrays, MeshArrays]:
    """The garment and its coarse mesh as modelled, both in the garment's object space."""
    place = np.array(garment.wrinkles.coarse_place, np.float64).reshape(4, 4)
    positions, faces = read_mesh(coarse.data)
    return read_mesh(garment.data), (apply(place, positions), faces)


def match_coarse(garment: bpy.types.Object) -> Correspondence:
    """Which coarse triangle each vertex of the garment rides on.

    Raises:
        ValueError: If the coarse mesh cannot carry the garment; one sentence that says what to do.
    """
    coarse = chosen_coarse(garment)
    _refuse_loops(garment, coarse)
    (positions, faces), (coarse_positions, coarse_faces) = rest_shapes(garment, coarse)
    return find_correspondence(coarse.name, positions, faces, coarse_positions, coarse_faces)


class CoarseLayer:
    """A garment tied to its coarse mesh, and all arrays that it takes to follow it.

    Args:
        garment: The garment object; its settings name the coarse mesh.
        database, evaluator: What the garment is synthesised by.

    Attributes:
        note: A sentence on what is doubtful; empty if nothing is.

    Raises:
        ValueError: If the coarse mesh cannot carry the garment; one sentence that says what to do.
    """

    def __init__(self, garment: bpy.types.Object, database: WrinkleDatabase, evaluator: JointEvaluator):
        match = match_coarse(garment)
        positions, faces = read_mesh(garment.data)
        self.note = doubt_of(garment.wrinkles.coarse.name, match)
        self.wrinkles = AlignedWrinkles(database, evaluator, match, positions, faces)
        self._layer = HostArray((match.coarse_count,), wp.vec3, evaluator.device)

    @property
    def positions(self) -> NDArray[np.float32]:
        """The coarse mesh as last read, in the garment's object space, shape [coarse_count, 3]."""
        return self._layer.host

    def read(self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[bytes, float]:
        """Read the coarse mesh in the depsgraph's frame, and how much of its motion the garment takes on.

        Args:
            garment: The original garment object.

        Returns:
            What was read, to compare with what is read another time.

        Raises:
            ValueError: If it is not there, or is another mesh than it was as modelled; one sentence.
        """
        coarse = chosen_coarse(garment)
        evaluated = coarse.evaluated_get(depsgraph)
        if not evaluated.is_evaluated:
            raise ValueError(f"The coarse mesh '{coarse.name}' is not part of the scene; put it there.")
        positions = read_positions(evaluated.data)
        if len(positions) != len(self.positions):
            raise ValueError(
                f"The coarse mesh '{coarse.name}' has {len(positions)} vertices in this frame and "
                f"{len(self.positions)} as modelled; switch off what adds or removes vertices."
            )
        if not np.isfinite(positions).all():
            raise ValueError(f"The coarse mesh '{coarse.name}' has positions that are not numbers in this frame.")
        worn = garment.evaluated_get(depsgraph)
        place = np.array(worn.matrix_world.inverted_safe() @ evaluated.matrix_world, np.float32)
        self._layer.host[:] = positions @ place[:3, :3].T + place[:3, 3]
        self._layer.upload()
        self._follow = worn.wrinkles.follow
        return self.positions.tobytes(), self._follow

    def evaluate(self, pose: Pose, out: wp.array, strengths: Mapping[str, float], placement: FloatArray) -> None:
        """Synthesise the garment in line with the coarse mesh as last read; see :class:`AlignedWrinkles`."""
        self.wrinkles.evaluate(pose, self._layer.device, out, strengths, placement, self._follow)


def doubt_of(name: str, match: Correspondence) -> str:
    """A sentence on vertices whose place on the coarse mesh of this name is doubtful; empty if there are none."""
    if not len(match.doubtful):
        return ""
    return (
        f"{len(match.doubtful)} vertices of the garment may ride on the wrong part of the coarse mesh '{name}'; "
        "look where its layers come close."
    )


def read_positions(mesh: bpy.types.Mesh) -> NDArray[np.float32]:
    """Vertices of an evaluated mesh, shape [vertex_count, 3]."""
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions)
    return positions.reshape(-1, 3)


# --- bound once ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Source:
    """What a layer is bound from, at a glance; another one needs another layer."""

    coarse: int
    mesh: int
    counts: tuple[int, int]
    place: tuple[float, ...]

    @staticmethod
    def of(garment: bpy.types.Object) -> _Source:
        coarse = chosen_coarse(garment)
        mesh = coarse.data
        counts = len(mesh.vertices), len(mesh.loops)
        return _Source(coarse.session_uid, mesh.session_uid, counts, tuple(garment.wrinkles.coarse_place))


class CoarseBinding:
    """The coarse layer that a garment's settings name, bound anew only when they or the meshes change."""

    def __init__(self):
        self._layer: CoarseLayer | None = None
        self._failed = ""
        self._source: _Source | None = None
        self._fingerprint = ""
        self._doubted = False

    def doubt(self) -> None:
        """Look at the meshes again: the file's data was replaced."""
        self._doubted = True

    @property
    def note(self) -> str:
        """What is doubtful about the layer, for the panel."""
        return self._layer.note if self._layer is not None else ""

    def layer(
        self, garment: bpy.types.Object, database: WrinkleDatabase, evaluator: JointEvaluator
    ) -> CoarseLayer | None:
        """The garment's coarse layer; None if it has none.

        Args:
            garment: The garment object.
            database, evaluator: What it is synthesised by, always the same.

        Raises:
            ValueError: If it cannot be bound, told once found and then again without another try; one sentence.
        """
        tie_coarse(garment)
        if garment.wrinkles.coarse_layer == NONE:
            self._layer, self._source, self._failed = None, None, ""
            return None
        try:
            source = _Source.of(garment)
        except ValueError:
            self._doubted = True
            raise
        changed = self._doubted and (self._failed or _fingerprint(garment) != self._fingerprint)
        if source != self._source or changed:
            self._source, self._fingerprint = source, _fingerprint(garment)
            self._layer, self._failed = None, ""
            try:
                self._layer = CoarseLayer(garment, database, evaluator)
            except ValueError as error:
                self._failed = str(error)
        self._doubted = False
        if self._failed:
            raise ValueError(self._failed)
        return self._layer


def _fingerprint(garment: bpy.types.Object) -> str:
    """Tells changed shapes; triangles change with their vertices or their number."""
    shapes = rest_shapes(garment, chosen_coarse(garment))
    return hashlib.sha256(b"".join(array.tobytes() for shape in shapes for array in shape)).hexdigest()
