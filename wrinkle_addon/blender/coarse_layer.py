"""A garment's coarse layer in the scene: the mesh whose motion the garment takes on, under its own wrinkles.

Any mesh that moves can be the coarse layer: Blender's cloth, a Surface Deform rig, an Alembic cache, plain skinning.
Garment and coarse mesh are matched as modelled, in the rest pose; where the coarse mesh goes, the garment goes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..aligned_wrinkles import AlignedWrinkles
from ..coarse_cache import CoarseCache, NotSimulated
from ..correspondence import Correspondence, find_correspondence
from ..database import WrinkleDatabase
from ..joint_wrinkles import HostArray, JointEvaluator
from ..rig import FloatArray, IntArray, Pose
from .character import apply, read_mesh
from .coarse_playing import PlayedCache, played_cache
from .coarse_scene import SIMULATION, cache_folder
from .made_behind import begin, take
from .node_group import add_modifier, find_modifier, get_input, set_input

NONE, MESH = "NONE", "MESH"
"""What a garment's coarse layer is, besides SIMULATION: nothing but its skin, or a mesh of the scene."""


def tie_coarse(garment: bpy.types.Object) -> None:
    """Let Blender evaluate the coarse mesh, and the body if it is simulated, wherever it evaluates the garment.

    A mesh that is hidden, from a render for example, is not evaluated else; Blender then hands out its modelled shape.
    """
    settings = garment.wrinkles
    coarse = settings.coarse if settings.coarse_layer != NONE else None
    body = settings.body if settings.coarse_layer == SIMULATION else None
    if coarse is None and find_modifier(garment) is None:
        return
    modifier = add_modifier(garment)
    for name, wanted in (("Coarse", coarse), ("Body", body)):
        if get_input(modifier, name) != wanted:
            set_input(modifier, name, wanted)
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


@dataclass(frozen=True, eq=False)
class RestShapes:
    """A garment and its coarse mesh as modelled, both in the garment's object space, shape [vertex_count, 3] each.

    Attributes:
        name: The coarse mesh's.
    """

    name: str
    positions: FloatArray
    faces: IntArray
    coarse_positions: FloatArray
    coarse_faces: IntArray

    @staticmethod
    def read(garment: bpy.types.Object) -> RestShapes:
        """Raises ValueError, with one sentence, if the garment has no coarse mesh that moves without it."""
        coarse = chosen_coarse(garment)
        _refuse_loops(garment, coarse)
        place = np.array(garment.wrinkles.coarse_place, np.float64).reshape(4, 4)
        positions, faces = read_mesh(coarse.data)
        return RestShapes(coarse.name, *read_mesh(garment.data), apply(place, positions), faces)

    def match(self) -> Correspondence:
        """Which coarse triangle each vertex of the garment rides on.

        Raises:
            ValueError: If the coarse mesh cannot carry the garment; one sentence that says what to do.
        """
        return find_correspondence(self.name, self.positions, self.faces, self.coarse_positions, self.coarse_faces)

    def fingerprint(self) -> str:
        """Tells changed shapes; triangles change with their vertices or their number."""
        arrays = self.positions, self.faces, self.coarse_positions, self.coarse_faces
        return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def match_coarse(garment: bpy.types.Object) -> Correspondence:
    """Which coarse triangle each vertex of the garment rides on.

    Raises:
        ValueError: If the coarse mesh cannot carry the garment; one sentence that says what to do.
    """
    return RestShapes.read(garment).match()


class CoarseLayer:
    """A garment tied to its coarse mesh, and all arrays that it takes to follow it.

    Args:
        shapes: The garment and its coarse mesh as modelled.
        database, evaluator: What the garment is synthesised by.

    Attributes:
        note: A sentence on what is doubtful; empty if nothing is.
        follow: How much of its motion the garment takes on, as last read.

    Raises:
        ValueError: If the coarse mesh cannot carry the garment; one sentence that says what to do.
    """

    def __init__(self, shapes: RestShapes, database: WrinkleDatabase, evaluator: JointEvaluator):
        match = shapes.match()
        self.note = doubt_of(shapes.name, match)
        self.wrinkles = AlignedWrinkles(database, evaluator, match, shapes.positions, shapes.faces)
        self.follow = 1.0
        self._layer = HostArray((match.coarse_count,), wp.vec3, evaluator.device)

    @property
    def positions(self) -> NDArray[np.float32]:
        """The coarse mesh as last read, in the garment's object space, shape [coarse_count, 3]."""
        return self._layer.host

    def read(self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> None:
        """Read the coarse mesh in the depsgraph's frame: as Blender moves it.

        Args:
            garment: The original garment object.

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
        self._place(garment.evaluated_get(depsgraph), positions, np.array(evaluated.matrix_world, np.float64))

    def read_simulated(
        self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph, simulated: PlayedCache, *, live: bool
    ) -> None:
        """Read the coarse mesh in the depsgraph's frame: as our own simulation moves it.

        Args:
            live: Whether a frame that lies in no cache yet may be simulated.

        Raises:
            NotSimulated: If the cache does not hold this frame of this motion; one sentence.
        """
        try:
            positions = simulated.positions(garment, depsgraph)
        except NotSimulated:
            if not live:
                raise
            simulated.fill(garment, depsgraph)
            positions = simulated.positions(garment, depsgraph)
        from_metres = np.eye(4)
        from_metres[:3, :3] /= depsgraph.scene.unit_settings.scale_length
        self._place(garment.evaluated_get(depsgraph), positions, from_metres)

    def _place(self, worn: bpy.types.Object, positions: NDArray[np.float32], world: FloatArray) -> None:
        # NumPy's own inverse would wake a second thread, which then spins for longer than a frame may take.
        place = np.array(worn.matrix_world.inverted_safe(), np.float64) @ world
        self._layer.host[:] = positions @ place[:3, :3].T.astype(np.float32) + place[:3, 3].astype(np.float32)
        self._layer.upload()
        self.follow = float(worn.wrinkles.follow)

    def evaluate(self, pose: Pose, out: wp.array, strengths: Mapping[str, float], placement: FloatArray) -> None:
        """Synthesise the garment in line with the coarse mesh as last read; see :class:`AlignedWrinkles`."""
        self.wrinkles.evaluate(pose, self._layer.device, out, strengths, placement, self.follow)


def doubt_of(coarse: str, match: Correspondence) -> str:
    """A sentence on vertices whose place on the coarse mesh of this name is doubtful; empty if there are none."""
    if not len(match.doubtful):
        return ""
    return (
        f"{len(match.doubtful)} vertices of the garment may ride on the wrong part of the coarse mesh '{coarse}'; "
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

    def __init__(self, database: WrinkleDatabase):
        self._database = database
        self._layer: CoarseLayer | None = None
        self._bound: Future[CoarseLayer] | None = None
        self._simulated: PlayedCache | None = None
        self._failed = ""
        self._missing = ""
        self._source: _Source | None = None
        self._fingerprint = ""
        self._doubted = False

    def doubt(self) -> None:
        """Look at meshes and caches again: the file's data was replaced."""
        self._doubted = True

    def waiting(self, frame: float) -> CoarseLayer | None:
        """The layer as bound last, if a frame has to wait for its simulation."""
        return None if self._simulated is None or self._simulated.holds(frame) else self._layer

    @property
    def note(self) -> str:
        """What is missing or doubtful, for the panel; empty if nothing is."""
        if self._missing or self._layer is None:
            return self._missing
        if self._simulated is not None and self._simulated.restarted:
            return f"{self._simulated.restarted} The simulation begins anew here."
        return self._layer.note

    def read(
        self,
        garment: bpy.types.Object,
        depsgraph: bpy.types.Depsgraph,
        evaluator: JointEvaluator,
        *,
        live: bool = False,
        strict: bool = False,
    ) -> CoarseLayer | None:
        """The garment's coarse layer as it lies in the depsgraph's frame; None if it has none.

        In a window a garment whose simulation has no such frame goes without, and ``note`` says why.

        Args:
            garment: The original garment object.
            evaluator: What it is synthesised by, always the same.
            live: Whether a frame that is not simulated may be, now that the animation has come there.
            strict: Refuse a frame that the simulation does not have in a window, too.

        Raises:
            NotReady: If the garment is still being bound to it, in a window.
            NotSimulated: In the background or if strict, if the simulation has no such frame.
            ValueError: If the layer cannot be bound, told once found and then again without another try; one sentence.
        """
        self._missing = ""
        tie_coarse(garment)
        if garment.wrinkles.coarse_layer == NONE:
            self._layer, self._bound, self._source, self._failed = None, None, None, ""
            return None
        layer = self._bind(garment, depsgraph, evaluator)
        if garment.wrinkles.coarse_layer == MESH:
            layer.read(garment, depsgraph)
            return layer
        assert self._simulated is not None
        live = live and depsgraph.mode == "VIEWPORT" and not in_background()
        try:
            layer.read_simulated(garment, depsgraph, self._simulated, live=live)
        except NotSimulated as missing:
            if strict or in_background():
                raise
            self._missing = str(missing)
            return None
        return layer

    def _bind(
        self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph, evaluator: JointEvaluator
    ) -> CoarseLayer:
        try:
            source = _Source.of(garment)
            simulates = garment.wrinkles.coarse_layer != MESH
            self._simulated = played_cache(cache_folder(garment)) if simulates else None
        except ValueError:
            self._doubted = True
            raise
        if self._doubted and self._simulated is not None:
            self._simulated.doubt()
        if source != self._source or self._doubted:
            self._begin(garment, depsgraph, evaluator, source)
        self._doubted = False
        if self._layer is None and not self._failed:
            assert self._bound is not None
            try:
                self._layer = take(self._bound, depsgraph)
            except ValueError as error:
                self._failed = str(error)
        if self._layer is None:
            raise ValueError(self._failed)
        return self._layer

    def _begin(
        self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph, evaluator: JointEvaluator, source: _Source
    ) -> None:
        """Bind the layer anew, unless it is as it was and did not fail."""
        again, self._source = source != self._source or bool(self._failed), source
        try:
            shapes = RestShapes.read(garment)
        except ValueError as error:
            self._layer, self._failed = None, str(error)
            return
        if again or shapes.fingerprint() != self._fingerprint:
            self._layer, self._failed, self._fingerprint = None, "", shapes.fingerprint()
            self._bound = begin(partial(CoarseLayer, shapes, self._database, evaluator), depsgraph)


def coarse_key(garment: bpy.types.Object) -> str:
    """Tells one simulation that a garment follows from another; empty if it follows none, or one that is not there."""
    if garment.wrinkles.coarse_layer != SIMULATION:
        return ""
    try:
        return CoarseCache.open(cache_folder(garment)).key
    except NotSimulated:
        return ""


def in_background() -> bool:
    """Whether nobody looks on, so that a garment without its coarse layer must not be taken for a finished one."""
    return bpy.app.background
