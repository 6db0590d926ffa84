"""What a coarse simulation is told, goes on from, and reports."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .cloth_contact import Limbs
from .cloth_model import ClothModel, FloatArray, IntArray, build_cloth_model
from .fabrics import Fabric


@dataclass(frozen=True)
class CoarseSettings:
    """How a coarse layer is simulated. Of layers that are simulated together the most careful choices hold for all.

    Attributes:
        fabric: What it is made of.
        steps: Time steps a frame, at any frame rate (W49).
        buffer: Distance that it keeps from the body [m] (W48): room for the wrinkles that come on top.
        friction: Coulomb coefficient against the body; None is the fabric's.
        damping: How fast motion relative to the skinned garment fades [1/s].
        pre_roll: Time that passes at the first frame, after settling and before the motion begins [s].
        teleport: Speed of the body's vertices, in the median, from which a frame is no motion but a jump [m/s].
    """

    fabric: Fabric = field(default_factory=Fabric)
    steps: int = 5
    buffer: float = 0.005
    friction: float | None = None
    damping: float = 1.0
    pre_roll: float = 0.5
    teleport: float = 20.0

    def __post_init__(self) -> None:
        for name in ("steps", "buffer", "teleport"):
            if not getattr(self, name) > 0:
                raise ValueError(f"The coarse simulation's {name} must be greater than 0, not {getattr(self, name)}.")
        for name in ("damping", "pre_roll"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(
                    f"The coarse simulation's {name.replace('_', '-')} must not be negative, "
                    f"but is {getattr(self, name)}."
                )

    @property
    def worn_fabric(self) -> Fabric:
        """The fabric with the friction that it has here."""
        if self.friction is None:
            return self.fabric
        return replace(self.fabric, friction=self.friction, static_friction=None)


@dataclass(frozen=True, eq=False)
class CoarseLayer:
    """One garment's coarse mesh.

    Attributes:
        name: The garment's, for what is said about it.
        positions: At rest [m], shape [n, 3].
        faces: Triangles, shape [m, 3].
        settings: How it is simulated.
        pins: How firmly each vertex is pulled to the skinned garment, from 0 to 1, shape [n]; None pulls none.
        strength: Share by which each vertex may leave the skinned garment, from 0 to 1, shape [n]; None lets all.
        model: The garment as a material body, where it is not simply cut like ``positions``.
        limbs: Which parts of the body it may touch; None lets it touch all.
    """

    name: str
    positions: FloatArray
    faces: IntArray
    settings: CoarseSettings = field(default_factory=CoarseSettings)
    pins: ArrayLike | None = None
    strength: ArrayLike | None = None
    model: ClothModel | None = None
    limbs: Limbs | None = None


@dataclass(frozen=True)
class CoarseReport:
    """What happened in a frame.

    Attributes:
        restarted: Whether the simulation began anew from a settled state.
        reason: Why, in one sentence; empty where nobody needs to be told.
        deepest: How far the deepest vertex lies under the skin [m], 0 if none does; what rides on the skinned garment
            does not count.
        crossed: Vertices of inner garments outside an outer one.
    """

    restarted: bool
    reason: str
    deepest: float
    crossed: int


@dataclass(frozen=True, eq=False)
class CoarseState:
    """All that a simulation goes on from, to the bit: arrays only.

    Attributes:
        positions, velocities, before, velocities_before: Of all vertices, float64, shape [1, n, 3].
        anchor_faces, anchor_weights: Where friction holds on, shape [1, 2 n] and [1, 2 n, 3].
        candidates: What of the body is closest to each vertex, shape [n].
        found_from: Where the vertices were when that was looked for [m], shape [1, n, 3].
        heights: How far they are above where contact holds them [m], shape [n].
        body, skin: Where the body and the skinned garments were in the last two frames [m], shape [2, count, 3].
        last_step: Length of the last time step [s], 0 where the next one is a first, shape [1].
    """

    positions: FloatArray
    velocities: FloatArray
    before: FloatArray
    velocities_before: FloatArray
    anchor_faces: IntArray
    anchor_weights: NDArray[np.float32]
    candidates: IntArray
    found_from: FloatArray
    heights: NDArray[np.float32]
    body: NDArray[np.float32]
    skin: NDArray[np.float32]
    last_step: FloatArray


def model_of(layer: CoarseLayer) -> ClothModel:
    """A layer as a material body.

    Raises:
        ValueError: If it has no surface that can be simulated.
    """
    if layer.model is not None:
        return layer.model
    faces = np.asarray(layer.faces, np.int32)
    if not len(faces):
        raise ValueError(f"The coarse mesh of '{layer.name}' has no faces; choose a mesh with a surface.")
    loose = len(layer.positions) - len(np.unique(faces))
    if loose:
        raise ValueError(f"The coarse mesh of '{layer.name}' has {loose} loose vertices; delete loose geometry.")
    try:
        return build_cloth_model(np.asarray(layer.positions, np.float64), faces, layer.settings.worn_fabric)
    except ValueError as error:
        raise ValueError(f"The coarse mesh of '{layer.name}' cannot be simulated: {error}") from error


def shares_of(layer: CoarseLayer, name: str, otherwise: float) -> FloatArray:
    """A layer's vertex mask, checked."""
    given = getattr(layer, name)
    if given is None:
        return np.full(len(layer.positions), otherwise)
    values = np.asarray(given, np.float64)
    # Masks that were interpolated go beyond by their rounding.
    if values.shape != (len(layer.positions),) or not ((values > -1.0e-6) & (values < 1.0 + 1.0e-6)).all():
        raise ValueError(
            f"The {name} of '{layer.name}' must be {len(layer.positions)} numbers from 0 to 1, one for each vertex."
        )
    return np.clip(values, 0.0, 1.0)
