"""The fabrics to choose from."""

import numpy as np
import pytest
from wrinkle_synthesis.wrinkle_addon.fabrics import FABRICS, Fabric, both, find_fabric


@pytest.mark.parametrize("name", FABRICS)
def test_every_fabric_resists_every_strain(name: str) -> None:
    fabric = find_fabric(name)
    c11, c12, c22, c33 = fabric.stiffness
    assert c11 > 0.0 and c11 * c22 > c12**2 and c33 > 0.0
    d11, d12, d22, d33 = fabric.plate
    assert d11 > 0.0 and d11 * d22 > d12**2 and d33 > 0.0
    # Cloth that is worn weighs 50 to 500 grams a square metre and bends more easily than paper.
    assert 0.05 < fabric.density < 0.5
    assert max(both(fabric.bending)) < 1e-4


def test_a_measured_fabric_has_the_stress_of_its_measurement() -> None:
    """Interlock, stretched by a sixth along its weft without giving along its warp: S = 2 c11 E with c11 = 46.4 N/m."""
    fabric = find_fabric("jersey")
    strain = 0.5 * ((7.0 / 6.0) ** 2 - 1.0)
    stress = fabric.stiffness[2] * strain + 0.5 * fabric.growth[1] * strain**2
    assert stress == pytest.approx(2.0 * 46.364765 * strain, rel=0.005)  # Rounded to a tenth.


@pytest.mark.parametrize(
    ("axis", "strain", "load"), [(0, 0.041219, 490.0), (2, 0.043370, 490.0), (0, 0.0224, 100.0), (2, 0.0210, 100.0)]
)
def test_silk_has_the_stress_of_its_measurement(axis: int, strain: float, load: float) -> None:
    """The full load exactly, on the way there within the 13 N/m that a parabola misses the measured curve by."""
    fabric = find_fabric("silk")
    excess = strain - fabric.strain_limits[axis // 2]
    stress = fabric.stiffness[axis] * strain + 0.5 * fabric.growth[axis // 2] * excess**2
    assert stress == pytest.approx(load, rel=1e-3, abs=0.0 if load == 490.0 else 13.0)


def test_a_fabric_alike_in_all_directions_is_isotropic() -> None:
    c11, c12, c22, c33 = Fabric(stretch=100.0, poisson=0.25).stiffness
    assert c11 == c22
    assert c33 == pytest.approx(0.5 * (c11 - c12))
    assert not Fabric().directed


@pytest.mark.parametrize("values", [{"shear": 9.0}, {"stretch": (9.0, 5.0)}, {"bending": (2e-5, 1e-5)}])
def test_a_fabric_with_a_direction_says_so(values: dict) -> None:
    assert Fabric(**values).directed


def test_bending_is_the_same_along_both_axes_of_a_fabric_alike_in_all_directions() -> None:
    d11, d12, d22, d33 = Fabric(bending=2e-5, poisson=0.3).plate
    assert np.allclose([d11, d22, d12 + d33], 2e-5)


def test_an_unknown_fabric_is_refused() -> None:
    known = "standard, thin, cotton, denim, jersey, polyester, silk"
    with pytest.raises(ValueError, match=f"no fabric 'felt'; choose one of {known}."):
        find_fabric("felt")


@pytest.mark.parametrize(
    "values",
    [{"limit": -0.1}, {"shear_limit": -0.1}, {"stiffening": (5.0, -1.0)}, {"damping": -1.0}, {"material": "mud"}],
)
def test_what_no_fabric_is_is_refused(values: dict) -> None:
    with pytest.raises(ValueError, match=f"The fabric's {next(iter(values))} "):
        Fabric(**values)
