"""Proofs of wrinkling: the wavelength of a taut sheet and of a film on a soft foundation, against their scaling laws.

Cerda and Mahadevan, Geometry and Physics of Wrinkling (Physical Review Letters 90, 2003): a sheet of bending stiffness
B with an elastic foundation K per area wrinkles at

    lambda = 2 pi (B / K)^(1/4)

and tension T along wrinkles of length L is such a foundation, K = T (pi / L)^2, so that

    lambda = 2 sqrt(pi) (B / T)^(1/4) L^(1/2).
"""

import numpy as np
import pytest
from cloth_shapes import free_cloth, sheet
from wrinkle_synthesis.wrinkle_addon.cloth import SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model

SETTINGS = SolverSettings(linear_tolerance=0.02, linear_iterations=1500)


def mean_wavelength(place, height):
    """Twice the mean distance of zero crossings along a line [m], without the first and the last wave."""
    cross = np.flatnonzero(height[:-1] * height[1:] < 0.0)
    share = height[cross] / (height[cross] - height[cross + 1])
    zeros = place[cross] + share * (place[cross + 1] - place[cross])
    assert len(zeros) > 8
    return 2.0 * np.diff(zeros)[1:-1].mean()


def bumpy(positions, still, height, seed):
    """The positions with some noise out of the plane [m], none where ``still``: somewhere it has to begin."""
    noise = height * np.random.default_rng(seed).normal(size=len(positions))
    return positions + np.where(still, 0.0, noise)[:, None] * [0.0, 0.0, 1.0]


def slope(x, y):
    """Exponent of a power law through the points."""
    return np.polyfit(np.log(x), np.log(y), 1)[0]


# --- a film on a foundation ---------------------------------------------------------------------------------------


def film_wavelength(bending, foundation, device, cells=200):
    """Of a film [m] on springs of ``foundation`` [N/m^3], compressed to 1.1 times what it bears flat, 2 sqrt(B K)."""
    length, stretch = 0.4, 100.0
    rest, faces = sheet(cells, 3, length, 0.01)
    model = build_cloth_model(rest, faces, Fabric(stretch=stretch, poisson=0.0, bending=bending, density=1.0e-3))
    ends = (rest[:, 0] < 1e-9) | (rest[:, 0] > length - 1e-9)
    springs = np.where(ends, 1.0e4, foundation * model.area)
    simulation = free_cloth(model, pin_stiffness=springs, solver_settings=SETTINGS, device=device)
    simulation.set_gravity(np.zeros(3))
    pressed = rest * [1.0 - 1.1 * 2.0 * np.sqrt(bending * foundation) / stretch, 1.0, 1.0]
    simulation.place_pins(pressed)
    simulation.start(bumpy(pressed, ends, 1.0e-4, seed=0))
    simulation.settle(0.01, 100)
    side = np.abs(rest[:, 1]) < 1e-9
    x = simulation.positions[0][side]
    return mean_wavelength(x[:, 0], x[:, 2])


def test_a_compressed_film_wrinkles_by_its_foundation(device):
    """Over a range of 64 in B / K, a factor of nearly three in the wavelength."""
    ratios, waves = [], []
    for bending, foundation in ((1.0e-5, 6.4e4), (1.0e-5, 1.6e4), (1.0e-5, 4.0e3), (8.0e-5, 8.0e3)):
        expected = 2.0 * np.pi * (bending / foundation) ** 0.25
        waves.append(film_wavelength(bending, foundation, device))
        ratios.append(bending / foundation)
        # Ends that hold the film down, and whole half waves between them: one of a dozen waves more or less.
        assert waves[-1] == pytest.approx(expected, rel=0.1)
    assert slope(ratios, waves) == pytest.approx(0.25, abs=0.025)


# --- a taut sheet -------------------------------------------------------------------------------------------------


class TautSheet:
    """A wide sheet held at all four edges, pulled along x with a tension and pressed together along y.

    It stays flat up to the pressure 2 B q^2 + 2 B (pi / L)^2 for each length, q = 2 pi / lambda: the least of
    B (q^2 + p^2)^2 / q^2 + T p^2 / q^2 with p = pi / L. Held edges are hinges: springs hold no angle.

    Args:
        bending: B [N m].
        tension: T [N/m].
        length: L [m], along the wrinkles.
        across: Cells along y, over two fifths of a metre.
        along: Cells along x.
    """

    WIDTH = 0.4

    def __init__(self, bending, tension, device, length=0.2, across=120, along=14):
        self.length = length
        self.expected = 2.0 * np.sqrt(np.pi) * (bending / tension) ** 0.25 * np.sqrt(length)
        stretch = 400.0 * tension
        rest, faces = sheet(along, across, length, self.WIDTH)
        self.rest = rest - np.array([0.0, 0.5 * self.WIDTH, 0.0])
        self.edge = (rest[:, 0] < 1e-9) | (rest[:, 0] > length - 1e-9)
        self.middle = np.abs(rest[:, 0] - 0.5 * length) < 1e-9
        self.edge |= np.abs(self.rest[:, 1]) > 0.5 * self.WIDTH - 1e-9
        fabric = Fabric(stretch=stretch, poisson=0.0, bending=bending, density=1.0e-3)
        self.simulation = free_cloth(
            build_cloth_model(self.rest, faces, fabric),
            pin_stiffness=np.where(self.edge, 1.0e5, 0.0),
            solver_settings=SETTINGS,
            device=device,
        )
        self.simulation.set_gravity(np.zeros(3))
        wave, hinge = 2.0 * np.pi / self.expected, np.pi / length
        self.borne = 2.0 * bending * (wave**2 + hinge**2) / stretch

    def held(self, share):
        """Flat, pressed together by this share of what it bears [m]; T / Y = 1 / 400 is Y l (l^2 - 1) / 2 at this l."""
        return self.rest * [1.0 + 1.0 / 400.0 - 1.5 / 400.0**2, 1.0 - share * self.borne, 1.0]

    def critical(self):
        """The share at which the flat sheet's Hessian becomes singular, and the wavelength of its mode [m]."""
        from scipy.sparse import linalg

        out = 3 * np.flatnonzero(~self.edge) + 2
        stiffness = []
        for share in (0.0, 1.0):
            self.simulation.place_pins(self.held(share))
            stiffness.append(self.simulation.hessian(self.held(share))[out][:, out].tocsc())
        values, modes = linalg.eigsh(stiffness[0] - stiffness[1], k=1, M=stiffness[0], which="LA", v0=np.ones(len(out)))
        height = np.zeros(len(self.rest))
        height[~self.edge] = modes[:, 0]
        return 1.0 / values[0], mean_wavelength(self.rest[self.middle, 1], height[self.middle])

    def wavelength(self, seed=0):
        """Of the wrinkles across the middle [m], a fifth beyond what the sheet bears."""
        held = self.held(1.2)
        self.simulation.place_pins(held)
        self.simulation.start(bumpy(held, self.edge, 2.0e-4, seed))
        assert self.simulation.settle(0.05, 200).converged
        x = self.simulation.positions[0][self.middle]
        return mean_wavelength(x[:, 1], x[:, 2])


def test_a_taut_sheet_wrinkles_by_bending_over_tension(device):
    """Over a range of 16 in B / T, a factor of two in the wavelength."""
    ratios, waves = [], []
    for bending, tension in ((1.0e-5, 40.0), (1.0e-5, 10.0), (4.0e-5, 10.0)):
        taut = TautSheet(bending, tension, device)
        # The first mode: only whole half waves between the held sides keep it from the law.
        assert taut.critical()[1] == pytest.approx(taut.expected, rel=0.05)
        waves.append(taut.wavelength())
        ratios.append(bending / tension)
        # Whole half waves between the held sides, and patterns of one wave more or less that rest as well.
        assert waves[-1] == pytest.approx(taut.expected, rel=0.15)
    assert slope(ratios, waves) == pytest.approx(0.25, abs=0.04)


def test_a_taut_sheet_wrinkles_by_the_root_of_its_length(device):
    lengths = [0.1, 0.2, 0.4]
    waves = []
    for length in lengths:
        taut = TautSheet(1.0e-5, 20.0, device, length)
        assert taut.critical()[1] == pytest.approx(taut.expected, rel=0.05)
        waves.append(taut.wavelength())
        assert waves[-1] == pytest.approx(taut.expected, rel=0.15)
    assert slope(lengths, waves) == pytest.approx(0.5, abs=0.08)


@pytest.mark.long
def test_a_finer_mesh_wrinkles_at_the_same_wavelength(device):
    """Six, twelve and eighteen cells to a wave, averaged over three beginnings."""
    means = []
    for across, along in ((48, 8), (96, 14), (144, 20)):
        taut = TautSheet(1.0e-5, 10.0, device, 0.2, across, along)
        means.append(np.mean([taut.wavelength(seed) for seed in range(3)]) / taut.expected)
    # Each beginning may end one wave of eight away from the next.
    assert means == pytest.approx([1.0, 1.0, 1.0], abs=0.125)


def test_a_finer_mesh_comes_closer_to_the_pressure_that_a_taut_sheet_bears(device):
    shares = []
    for across, along in ((48, 8), (96, 16), (144, 24)):
        taut = TautSheet(1.0e-5, 10.0, device, 0.2, across, along)
        share, wave = taut.critical()
        # Whole half waves between the held sides: sixteen of them, or one more or less.
        assert wave == pytest.approx(taut.expected, rel=0.07)
        shares.append(share)
    off = np.abs(np.array(shares) - 1.0)
    assert off[2] < 0.02
    assert off[0] > 2.0 * off[1] > 2.0 * off[2]


# --- a stretched sheet --------------------------------------------------------------------------------------------


class StretchedSheet:
    """A sheet that is pulled by its clamped short ends, which keep their width: the middle is pressed together.

    The experiment of Cerda, Ravi-Chandar and Mahadevan, Wrinkling of an elastic sheet under tension (Nature 419, 2002).
    All measures are taken on the sheet at rest.
    """

    LENGTH, WIDTH, ALONG, ACROSS = 0.2, 0.1, 40, 60

    def __init__(self, strain, device):
        stretch, self.bending = 100.0, 1.0e-7
        self.tension = stretch * (strain + 0.5 * strain**2)
        rest, faces = sheet(self.ALONG, self.ACROSS, self.LENGTH, self.WIDTH)
        self.rest = rest - np.array([0.5 * self.LENGTH, 0.5 * self.WIDTH, 0.0])
        self.ends = np.abs(self.rest[:, 0]) > 0.5 * self.LENGTH - 1e-9
        fabric = Fabric(stretch=stretch, poisson=0.45, bending=self.bending, stiffening=0.0)
        self.simulation = free_cloth(
            build_cloth_model(self.rest, faces, fabric),
            pin_stiffness=np.where(self.ends, 1.0e6, 0.0),
            solver_settings=SETTINGS,
            device=device,
        )
        self.simulation.set_gravity(np.zeros(3))
        held = self.rest * [1.0 + strain, 1.0, 1.0]
        self.simulation.place_pins(held)
        self.simulation.start(held)
        assert self.simulation.settle(0.02, 100).converged

    def first_mode(self):
        """The greatest bending stiffness at which it wrinkles [N m], and its heights, shape [ALONG + 1, ACROSS + 1]."""
        from scipy.sparse import linalg

        out = 3 * np.flatnonzero(~self.ends) + 2
        stretched, resting = (
            self.simulation.hessian(x)[out][:, out].tocsc() for x in (self.simulation.positions[0], self.rest)
        )
        values, modes = linalg.eigsh(
            resting - stretched,
            k=1,
            M=resting,
            which="LA",
            v0=1.0 + np.arange(len(out)) % 7,
            ncv=60,
            tol=1e-4,  # pyright: ignore[reportArgumentType]
        )
        height = np.zeros(len(self.rest))
        height[~self.ends] = modes[:, 0]
        return values[0] * self.bending, height.reshape(self.ALONG + 1, self.ACROSS + 1)

    def wavelength(self, height):
        """Of the two waves next to the centre [m]."""
        across, y = height[self.ALONG // 2], np.linspace(-0.5, 0.5, self.ACROSS + 1) * self.WIDTH
        cross = np.flatnonzero(across[:-1] * across[1:] < 0.0)
        zeros = y[cross] + across[cross] / (across[cross] - across[cross + 1]) * (y[1] - y[0])
        first = np.searchsorted(zeros, 0.0) - 2
        return 0.5 * (zeros[first + 4] - zeros[first])

    def crest_length(self, height):
        """Length of the half sine that is as steep for its height as the highest wrinkle [m]."""
        crest = height[:, np.abs(height[self.ALONG // 2]).argmax()]
        steepness = np.sqrt((np.diff(crest) ** 2).sum() / (crest**2).sum()) * self.ALONG / self.LENGTH
        return np.pi / steepness


@pytest.mark.parametrize("strain", [0.02, pytest.param(0.05, marks=pytest.mark.long)])
def test_a_stretched_sheet_wrinkles_by_the_length_of_its_wrinkles(device, strain):
    """Wrinkles are as long as what is pressed together, not as the sheet: the law holds for that length."""
    stretched = StretchedSheet(strain, device)
    bending, height = stretched.first_mode()
    wave, crest = stretched.wavelength(height), stretched.crest_length(height)
    scale = 2.0 * np.sqrt(np.pi) * (bending / stretched.tension) ** 0.25
    # A crest is no pure sine.
    assert wave == pytest.approx(scale * np.sqrt(crest), rel=0.03)
    assert wave < 0.8 * scale * np.sqrt(stretched.LENGTH)


# --- a sheared sheet ----------------------------------------------------------------------------------------------


def sheared_wavelength(bending, shear, device, cells=20, across=False, height=0.1):
    """Across the folds of a wide sheet between two bars that shear it, and what the law says, both in metres.

    Folds run at 45 degrees from bar to bar, with the tension of a sheet that bears no pressure: Y shear / 2 along
    sqrt(2) times the height.

    Args:
        across: Turn the cells' diagonals across the folds instead of along them.
        height: From bar to bar [m].
    """
    width, stretch = 6.0 * height, 1000.0
    rest, faces = sheet(6 * cells, cells, width, height)
    if across:
        rest[:, 1], faces = height - rest[:, 1], faces[:, [0, 2, 1]]
    bars = (rest[:, 1] < 1e-9) | (rest[:, 1] > height - 1e-9)
    fabric = Fabric(stretch=stretch, poisson=0.0, bending=bending, density=1.0e-3)
    simulation = free_cloth(
        build_cloth_model(rest, faces, fabric),
        pin_stiffness=np.where(bars, 1.0e6, 0.0),
        solver_settings=SETTINGS,
        device=device,
    )
    simulation.set_gravity(np.zeros(3))
    held = rest + shear * rest[:, 1:2] * [1.0, 0.0, 0.0]
    simulation.place_pins(held)
    simulation.start(bumpy(held, bars, 1.0e-4, seed=0))
    assert simulation.settle(1.0, 150).converged
    middle = np.abs(rest[:, 1] - 0.5 * height) < 1e-9
    x = simulation.positions[0][middle]
    # Only where the folds reach from bar to bar.
    x = x[np.abs(x[:, 0] - 0.5 * width) < 0.5 * width - height]
    expected = 2.0 * np.sqrt(np.pi) * (bending / (0.5 * stretch * shear)) ** 0.25 * np.sqrt(np.sqrt(2.0) * height)
    return mean_wavelength(x[:, 0], x[:, 2]) / np.sqrt(2.0), expected


def test_a_sheared_sheet_wrinkles_by_bending_over_tension(device):
    wave, expected = sheared_wavelength(2.0e-5, 0.02, device)
    # The law takes the tension as even and the folds as sines; bars that hold the cloth flat make them shorter.
    assert wave == pytest.approx(expected, rel=0.15)


@pytest.mark.long
def test_a_sheared_sheet_wrinkles_by_the_roots_of_bending_and_height(device):
    """Over a range of ten in the bending stiffness, and of four in the height."""
    soft, stiff, high = waves = [
        sheared_wavelength(bending, 0.02, device, cells, height=height)
        for bending, height, cells in ((2.0e-6, 0.1, 24), (2.0e-5, 0.1, 20), (8.0e-5, 0.4, 24))
    ]
    for wave, expected in waves:
        assert wave == pytest.approx(expected, rel=0.15)
    # Whole folds between the ends: a dozen of them.
    assert np.log(stiff[0] / soft[0]) / np.log(10.0) == pytest.approx(0.25, abs=0.03)
    assert np.log(high[0] / stiff[0]) / np.log(4.0) - 0.25 == pytest.approx(0.5, abs=0.05)


@pytest.mark.long
def test_a_sheared_sheet_comes_closer_to_its_folds_on_a_finer_mesh_whichever_way_the_triangles_lie(device):
    """Folds cannot follow diagonals that cross them: they come out too long, the less so the finer the mesh."""
    along, expected = sheared_wavelength(2.0e-5, 0.02, device, 30)
    off = [sheared_wavelength(2.0e-5, 0.02, device, cells, across=True)[0] / along - 1.0 for cells in (20, 30)]

    assert along == pytest.approx(expected, rel=0.15)
    assert 0.0 < off[1] < off[0]
