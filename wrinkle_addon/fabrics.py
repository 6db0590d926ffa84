"""What garments are made of, and measured fabrics to choose from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

Pair = float | tuple[float, float]
"""One number for warp and weft alike, or one for each."""

Material = Literal["plate", "hinges", "springs"]
"""A membrane that bends like a plate (quadratic, the default) or over hinges (nonlinear), or a net of springs."""


@dataclass(frozen=True)
class Fabric:
    """What the garment is made of.

    Warp is the direction of the fabric's length: where a texture's V grows, or along the limb on a garment without
    texture coordinates. Weft crosses it at a right angle.

    Attributes:
        stretch: Stiffness against stretching [N/m], for warp and weft alike or one for each.
        poisson: How much a stretched strip narrows and a bent one curls across, from 0 up to 1, as yarns that come
            straight crimp those across them; of warp and weft the geometric mean.
        shear: Stiffness against shearing [N/m]; None is that of a sheet that is alike in all directions. Woven cloth
            shears more easily.
        limit: Stretch of warp and weft past which they stiffen, as a share of their length. Denims give 4.7 to 5.7
            percent under the full load of a tensile test, 490 N/m (Journal of Textiles 2016, 4614168, table 5). The
            default lies above the 6 percent that folding alone brings about where a sleeve of the default stiffness,
            which is softer, is bent.
        shear_limit: Angle of shear past which it stiffens [rad].
        stiffening: How fast they stiffen past it: growth of the stiffness per strain, as a share of what it was; shear
            by the geometric mean. That of a T-shirt's interlock, stretched by 17 percent, is 119 along the warp and
            20 along the weft, in the geometric mean 49 (Wang et al. 2011, see FABRICS).
        bending: Bending stiffness, moment per width and curvature [N m], for warp and weft alike or one for each.
        density: Mass per area [kg/m^2].
        friction: Coulomb coefficient against the body while sliding (W26, S49).
        static_friction: Coulomb coefficient up to which a resting contact holds (W27); None is that of sliding.
        damping: Viscosity against stretching and shearing, as the time over which it takes as much force as stiffness
            does [s]; only motion knows it.
        material: The energies: those of Xu et al. ("plate", S48), hinges instead of the plate, or the springs of Wang
            et al. (W21, W22), which know no limit, no Poisson's ratio but 1/3 and no shear of their own.
        rest_bend: Share of the modelled surface's own angles at which hinges rest: 0 for cloth cut flat, 1 for cloth
            formed like the garment.
    """

    stretch: Pair = 120.0
    poisson: float = 0.3
    shear: float | None = None
    limit: float = 0.08
    shear_limit: float = 0.3
    stiffening: Pair = 50.0
    bending: Pair = 6.0e-5
    density: float = 0.15
    friction: float = 0.3
    static_friction: float | None = None
    damping: float = 0.0
    material: Material = "plate"
    rest_bend: float = 0.0

    def __post_init__(self) -> None:
        for name in ("stretch", "shear", "bending", "density"):
            value = getattr(self, name)
            if value is not None and not min(both(value)) > 0.0:
                raise ValueError(f"The fabric's {name} must be greater than 0, not {value}.")
        if not 0.0 <= self.poisson < 1.0:
            raise ValueError(f"The fabric's Poisson ratio must lie in [0, 1), not be {self.poisson}.")
        if self.material not in get_args(Material):
            names = ", ".join(get_args(Material))
            raise ValueError(f"The fabric's material is one of {names}, not {self.material}.")
        for name in ("limit", "shear_limit", "stiffening", "friction", "damping"):
            if min(both(getattr(self, name))) < 0.0:
                raise ValueError(f"The fabric's {name} must not be negative, not {getattr(self, name)}.")

        if self.holding_friction < self.friction:
            raise ValueError("The fabric's static friction must not be smaller than its friction while sliding.")

    @property
    def holding_friction(self) -> float:
        """Coulomb coefficient of a resting contact."""
        return self.friction if self.static_friction is None else self.static_friction

    @property
    def directed(self) -> bool:
        """Whether it matters which way the warp lies."""
        return self.shear is not None or any(
            warp != weft for warp, weft in map(both, (self.stretch, self.stiffening, self.bending))
        )

    @property
    def stiffness(self) -> tuple[float, float, float, float]:
        """(c11, c12, c22, c33) of :mod:`..kernels.cloth.membrane` [N/m], warp first."""
        warp, weft = both(self.stretch)
        mean = math.sqrt(warp * weft)
        plane = 1.0 - self.poisson**2
        shear = mean / (2.0 * (1.0 + self.poisson)) if self.shear is None else self.shear
        return warp / plane, self.poisson * mean / plane, weft / plane, shear

    @property
    def strain_limits(self) -> tuple[float, float, float]:
        """The limits as Green strains (Exx, Eyy, 2 Exy)."""
        stretch = self.limit + 0.5 * self.limit**2
        return stretch, stretch, math.sin(self.shear_limit)

    @property
    def growth(self) -> tuple[float, float, float]:
        """(g1, g2, g3) of :mod:`..kernels.cloth.membrane` [N/m], warp first."""
        (warp, weft), (c11, _, c22, c33) = both(self.stiffening), self.stiffness
        return warp * c11, weft * c22, math.sqrt(warp * weft) * c33

    @property
    def viscosity(self) -> tuple[float, float, float, float]:
        """(v11, v12, v22, v33) of :mod:`..kernels.cloth.damping` [N s/m], warp first."""
        c11, c12, c22, c33 = self.stiffness
        return self.damping * c11, self.damping * c12, self.damping * c22, self.damping * c33

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


PULLED = 0.5 * ((1.0 + 1.0 / 6.0) ** 2 - 1.0)
"""Green strain of the stretched samples of Wang et al. 2011."""


def _measured(
    density: float, rest: Sequence[float], pulled: tuple[float, float], bending: tuple[float, float]
) -> Fabric:
    """A fabric of the database of Wang et al. 2011, from the numbers in its file.

    ARCSim, which the files are made for, reads them so: twice c11, c12 and c22 and once c33 are the stiffness of the
    membrane here, linear in between rest and the stretched sample; a quarter of the bending stiffness is that of a
    plate, bent across the edges whose direction the file names. Its second axis, along which V grows, is the warp.

    Args:
        density: [kg/m^2].
        rest: (c11, c12, c22, c33) without strain [N/m].
        pulled: c11 and c22 of the samples stretched by a sixth along the first and along the second axis [N/m].
        bending: Of the flattest samples whose edges lie along the first and along the second axis [N m].
    """
    c11, c12, c22, c33 = rest
    # What was measured of knits is so small a c12 that noise makes it negative.
    poisson = max(c12, 0.0) / math.sqrt(c11 * c22)
    plane = 2.0 * (1.0 - poisson**2)
    # Where the stiffness that stress is divided by grows linearly, the slope of the stress grows twice as fast.
    growth = [2.0 * (far / near - 1.0) / PULLED for near, far in zip((c22, c11), pulled[::-1], strict=True)]
    return Fabric(
        stretch=(round(plane * c22, 1), round(plane * c11, 1)),
        poisson=round(poisson, 3),
        shear=round(c33, 1),
        limit=0.0,
        stiffening=(round(growth[0], 1), round(growth[1], 1)),
        bending=(bending[0] / 4.0, bending[1] / 4.0),
        density=density,
    )


FULL_LOAD = 490.0
"""Full load of a tensile test by Kawabata's system, 500 gf/cm [N/m]."""

Ogden = Sequence[tuple[float, float]]
"""(mu, alpha) of Clyde et al. 2017: the sum of mu (1 + E^2)^(alpha - 1) multiplies stiffness at the Green strain E."""


def _woven(
    density: float, thickness: float, moduli: tuple[float, float, float, float], straightening: tuple[Ogden, Ogden]
) -> Fabric:
    """A fabric of Clyde et al. 2017, from their fit to its tensile, shear and bending tests.

    It is stretched until its yarns come straight, and stiff from then on: the limit here is where a parabola comes
    nearest to both curves up to the full load, which it reaches at the same strain as they do.

    Args:
        density: [kg/m^2].
        thickness: [m].
        moduli: (a11, a12, a22, G12) without strain [Pa], warp first; their shear is that of Exy and not of 2 Exy.
        straightening: How the warp's and the weft's stress grows.
    """
    a11, a12, a22, g12 = moduli
    poisson = a12 / math.sqrt(a11 * a22)
    plane = 1.0 - poisson**2
    limit = 0.01
    start = limit + 0.5 * limit**2
    stiffening = []
    for modulus, curve in zip((a11, a22), straightening, strict=True):
        stiffness = modulus * thickness
        strain = _strain_under(FULL_LOAD, stiffness, curve)
        stiffening.append(2.0 * (FULL_LOAD - stiffness * strain) / (stiffness * (strain - start) ** 2))
    bending = thickness**3 / 12.0
    return Fabric(
        stretch=(round(plane * a11 * thickness, 1), round(plane * a22 * thickness, 1)),
        poisson=round(poisson, 3),
        shear=round(0.5 * g12 * thickness, 1),
        limit=limit,
        stiffening=(round(stiffening[0], 1), round(stiffening[1], 1)),
        bending=(bending * a11, bending * a22),
        density=density,
    )


def _strain_under(load: float, stiffness: float, curve: Ogden) -> float:
    """Green strain of a fabric held at its sides under the load [N/m], by bisection."""
    low, high = 0.0, 1.0
    while high - low > 1e-9:
        strain = 0.5 * (low + high)
        stress = stiffness * strain * sum(mu * (1.0 + strain**2) ** (alpha - 1.0) for mu, alpha in curve)
        low, high = (strain, high) if stress < load else (low, strain)
    return high


FABRICS: Mapping[str, Fabric] = {
    "standard": Fabric(),
    "thin": Fabric(stretch=30.0, stiffening=0.0, bending=1.0e-5, density=0.1),
    "cotton": _measured(
        0.220, (2016.55456, 9.170511, 2034.97644, 104.759674), (2109.51684, 2152.73852), (125.409805e-6, 125.409805e-6)
    ),
    "denim": _measured(
        0.324, (205.352005, 10.234077, 1013.88629, 53.387184), (232.027634, 1051.55712), (64.196457e-6, 96.951576e-6)
    ),
    "jersey": _measured(
        0.187, (16.593832, -14.695990, 34.477123, 36.860302), (46.364765, 405.872833), (23.191698e-6, 14.267624e-6)
    ),
    "polyester": _measured(
        0.128, (2002.08618, 0.345588, 2027.48559, 19.189022), (2107.22753, 2150.47680), (51.713814e-6, 31.282822e-6)
    ),
    "silk": _woven(
        density=0.083,
        thickness=0.239e-3,
        moduli=(4.3e6, 4.971e6, 9.942e6, 0.57e6),
        straightening=(((61.769, -2.23), (-60.769, -115.578)), ((13.46, -2.612), (-12.46, -195.533))),
    ),
}
"""Fabrics by name.

standard: What this project's pictures are made of; softer to stretch than most fabrics, which settles sooner.
thin: Xu et al. 2014, section 7 (S49).
cotton, denim, jersey, polyester: Wang, O'Brien and Ramamoorthi 2011, "Data-driven elastic models for cloth: modeling
and measurement", from the files of their database: royal-target (trousers, 65 % cotton, 35 % polyester),
11oz-black-denim (jeans, 99 % cotton, 1 % spandex), gray-interlock (T-shirt, 60 % cotton, 40 % polyester),
white-dots-on-blk (tablecloth, 100 % polyester). Denim's bending, 1.6e-5 N m along the warp, agrees with denims measured
by another method, 1.4e-5 to 2.2e-5 N m (Journal of Textiles 2016, 4614168, table 5).
silk: Clyde, Teran and Tamstorf 2017, "Modeling and data-driven parameter estimation for woven fabrics", as the material
file of NeuralClothSim has it (Kairanda et al. 2024). Its moduli are without a unit there. In MPa its cotton is as stiff
to stretch along the warp as the cotton above, 3936 and 4033 N/m, and silk bears the full load at strains of 4.1 and 4.3
percent.
Friction was measured of none of them; it is the standard's.
"""


def find_fabric(name: str) -> Fabric:
    """The fabric of this name.

    Raises:
        ValueError: If there is none; the sentence lists those there are.
    """
    if name not in FABRICS:
        raise ValueError(f"There is no fabric '{name}'; choose one of {', '.join(FABRICS)}.")
    return FABRICS[name]
