"""What garments are made of."""

from __future__ import annotations

import math
from dataclasses import dataclass

Pair = float | tuple[float, float]
"""One number for warp and weft alike, or one for each."""


@dataclass(frozen=True)
class Fabric:
    """What the garment is made of.

    Warp is the direction of the fabric's length: where a texture's V grows, or along the limb on a garment without
    texture coordinates. Weft crosses it at a right angle.

    Attributes:
        stretch: Stiffness against stretching [N/m], for warp and weft alike or one for each.
        poisson: How much a stretched strip narrows and a bent one curls across, from 0 up to 0.5; of warp and weft
            the geometric mean.
        shear: Stiffness against shearing [N/m]; None is that of a sheet that is alike in all directions. Woven cloth
            shears more easily.
        bending: Bending stiffness, moment per width and curvature [N m], for warp and weft alike or one for each.
        density: Mass per area [kg/m^2].
        friction: Coulomb coefficient against the body, static and dynamic (S49).
    """

    stretch: Pair = 120.0
    poisson: float = 0.3
    shear: float | None = None
    bending: Pair = 6.0e-5
    density: float = 0.15
    friction: float = 0.3

    def __post_init__(self) -> None:
        for name in ("stretch", "shear", "bending", "density"):
            value = getattr(self, name)
            if value is not None and not min(both(value)) > 0.0:
                raise ValueError(f"The fabric's {name} must be greater than 0, not {value}.")
        if not 0.0 <= self.poisson < 0.5:
            raise ValueError(f"The fabric's Poisson ratio must lie in [0, 0.5), not be {self.poisson}.")
        if self.friction < 0.0:
            raise ValueError(f"The fabric's friction must not be negative, not {self.friction}.")

    @property
    def directed(self) -> bool:
        """Whether it matters which way the warp lies."""
        return self.shear is not None or any(warp != weft for warp, weft in (both(self.stretch), both(self.bending)))

    @property
    def stiffness(self) -> tuple[float, float, float, float]:
        """(c11, c12, c22, c33) of :mod:`..kernels.cloth.membrane` [N/m], warp first."""
        warp, weft = both(self.stretch)
        mean = math.sqrt(warp * weft)
        plane = 1.0 - self.poisson**2
        shear = mean / (2.0 * (1.0 + self.poisson)) if self.shear is None else self.shear
        return warp / plane, self.poisson * mean / plane, weft / plane, shear

    @property
    def plate(self) -> tuple[float, float, float, float]:
        """(D11, D12, D22, D33) of :mod:`..kernels.cloth.bending` [N m], warp first.

        Twisting is as stiff as makes bending in any direction the square of the mean of both roots, as Huber takes it
        for orthotropic plates.
        """
        warp, weft = both(self.bending)
        mean = math.sqrt(warp * weft)
        return warp, self.poisson * mean, weft, (1.0 - self.poisson) * mean


def both(value: Pair) -> tuple[float, float]:
    """The values for warp and weft."""
    return value if isinstance(value, tuple) else (value, value)
