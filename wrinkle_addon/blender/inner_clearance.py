"""Keeping a played garment outside the garment that it is worn over, as that is shown in the same frame."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..database import WrinkleDatabase
from ..garment import Body
from ..penetration import ClearanceBinding, PushOut, bind_clearance
from ..rig import FloatArray
from ..wearer import worn_limbs
from .character import apply
from .clearance import metre_of
from .made_behind import begin, take


@dataclass(frozen=True, eq=False)
class InnerGarment:
    """What a garment is worn over, in one frame.

    Attributes:
        database: It is played from.
        positions: In its object space, shape [vertex_count, 3].
        world: Its object's matrix, shape [4, 4].
    """

    database: WrinkleDatabase
    positions: NDArray[np.float32]
    world: FloatArray


def garments_under(garment: bpy.types.Object) -> list[bpy.types.Object]:
    """The garments that one is worn over, from the outermost to the innermost.

    Raises:
        ValueError: One sentence, if it is worn over itself.
    """
    under: list[bpy.types.Object] = []
    inner = garment.wrinkles.worn_over
    while inner is not None:
        if inner == garment or inner in under:
            raise ValueError(
                f"The garment '{garment.name}' is worn over '{inner.name}', which is worn over itself; "
                "let one of them be worn over nothing."
            )
        under.append(inner)
        inner = inner.wrinkles.worn_over
    return under


class InnerClearance:
    """One garment's push out of the one that it is worn over. What keeps it from pushing is told.

    Args:
        database: The outer garment's.
        device: Warp device of its positions.

    Attributes:
        note: One sentence, if the garment should be kept outside another one in the frame read last and is not.
    """

    def __init__(self, database: WrinkleDatabase, device: str):
        self._database = database
        self._device = device
        self._inner: WrinkleDatabase | None = None
        self._bound: Future[PushOut] | None = None
        self._push: PushOut | None = None
        self.note = ""

    def read(
        self, garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph, inner: InnerGarment | None
    ) -> NDArray[np.float32] | None:
        """The inner garment in the outer one's object space, shape [inner_vertex_count, 3]; None to leave it be.

        Args:
            garment: The outer, original garment object.
            inner: What it is worn over, if that plays wrinkles.

        Raises:
            NotReady: If the one is still being bound to the other, in a window.
        """
        self.note = ""
        worn_over = garment.wrinkles.worn_over
        if worn_over is None:
            return None
        try:
            garments_under(garment)
            if inner is None:
                raise ValueError(f"The garment '{worn_over.name}' plays no wrinkles.")
            if inner.database.header.rig.fingerprint() != self._database.header.rig.fingerprint():
                raise ValueError(f"The garment '{worn_over.name}' was baked on another rig.")
        except ValueError as error:
            self.note = f"{error} The garment '{garment.name}' plays without being kept outside it."
            return None
        if self._bound is None or self._inner is not inner.database:
            self._inner = inner.database
            self._bound = begin(partial(_push_out_of, self._database, inner.database, self._device), depsgraph)
        self._push = take(self._bound, depsgraph)
        self._push.set_distance(garment.wrinkles.clearance)
        # By Blender: NumPy's own inverse would wake a second thread, which then spins for longer than a frame may take.
        world = garment.evaluated_get(depsgraph).matrix_world
        to_garment = np.array(world.inverted_safe(), np.float64) @ inner.world
        if np.array_equal(to_garment, np.eye(4)):
            return inner.positions
        return apply(to_garment, inner.positions.astype(np.float64)).astype(np.float32)

    def clear(self, inner: NDArray[np.float32], positions: wp.array, placement: FloatArray) -> None:
        """Push a garment out of what :meth:`read` gave, in place; arguments as in :meth:`.BodyClearance.clear`."""
        assert self._push is not None
        metre = metre_of(placement)
        if metre > 0.0:
            self._push.clear(inner, positions, metre)


def _push_out_of(outer: WrinkleDatabase, inner: WrinkleDatabase, device: str) -> PushOut:
    return PushOut(bind_to_garment(outer, inner), device=device)


def bind_to_garment(outer: WrinkleDatabase, inner: WrinkleDatabase) -> ClearanceBinding:
    """Bind a database's garment to another one's, both as they were modelled on one rig.

    Each settled without the other, so that at rest one may lie in the other; as modelled they are worn.
    """
    header, worn = outer.header, inner.header.garment
    surface = Body(worn.positions, worn.faces, worn.weights.to_dense(header.rig.bone_count))
    limbs = worn_limbs(header.rig, header.garment, surface)
    return bind_clearance(header.garment.positions, header.garment.faces, surface.positions, surface.faces, limbs)
