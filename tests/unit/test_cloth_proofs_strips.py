"""Proofs of stretching and bending: strips that hang, stick out, sag between two hands and buckle sideways.

A row of pinned cells is no sharp clamp: curvature there is taken over half a cell on either side of their border. Where
a sharp one is needed, a strip twice as long is held along its middle, which its own symmetry keeps level.
"""

import itertools

import numpy as np
import pytest
from cloth_shapes import free_cloth, sheet
from wrinkle_synthesis.wrinkle_addon.cloth import STANDARD_GRAVITY, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model

G = STANDARD_GRAVITY
SETTINGS = SolverSettings(linear_tolerance=0.02, linear_iterations=1500)


# --- stretch ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [100.0, 10.0, 3.0], ids=["hardly", "a twentieth", "a seventh"])
def test_a_hanging_strip_stretches_under_its_own_weight(device, ratio):
    """``ratio`` is stiffness against weight, Y / (rho g L).

    The strip below s pulls rho g (L - s) for each width, which is Y l (l^2 - 1) / 2 at the stretch l.
    """
    length, density = 0.3, 0.15
    stiffness = ratio * density * G * length
    rest, faces = sheet(24, 2, length, 0.03)
    fabric = Fabric(stretch=stiffness, poisson=0.3, bending=1.0e-6, density=density, stiffening=0.0)
    held = np.where(rest[:, 0] < 1e-9, 1.0e5, 0.0)
    simulation = free_cloth(build_cloth_model(rest, faces, fabric), pin_stiffness=held, device=device)
    simulation.set_gravity([G, 0.0, 0.0])
    simulation.place_pins(rest)
    simulation.start(rest)
    assert simulation.settle(1e-4, 80).converged
    longer = simulation.positions[0][rest[:, 0] > length - 1e-9, 0].mean() - length
    s = (np.arange(2000) + 0.5) / 2000 * length
    stretch = np.ones_like(s)
    for _ in range(20):  # Newton's method; the pull is a cubic of the stretch.
        pull = 0.5 * stiffness * stretch * (stretch**2 - 1.0) - density * G * (length - s)
        stretch -= pull / (0.5 * stiffness * (3.0 * stretch**2 - 1.0))
    # The held end cannot draw in by Poisson's law over a length like half its width, a twentieth of the strip.
    assert longer == pytest.approx((stretch - 1.0).mean() * length, rel=0.01)


# --- bending ------------------------------------------------------------------------------------------------------


def heavy_elastica(length, stiffness, density):
    """Where the end of a clamped heavy strip hangs, (x, z) [m]: B theta'' = rho g (L - s) cos theta."""
    from scipy.integrate import solve_bvp

    s = np.linspace(0.0, length, 400)
    guess = np.stack([-1.2 * (1.0 - np.exp(-4.0 * s / length)), np.zeros_like(s), s, np.zeros_like(s)])

    def slope(s, y):
        return np.stack([y[1], density * G / stiffness * (length - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(start, end):
        return np.array([start[0], end[1], start[2], start[3]])

    solution = solve_bvp(slope, ends, s, guess, tol=1e-8, max_nodes=100000)
    assert solution.success
    return solution.y[2:, -1]


def two_sided_strip(columns, rows, length, width, fabric, device, pins=0.0):
    """A strip from -length to length along x, held along its middle; returns the simulation and the rest shape."""
    rest, faces = sheet(2 * columns, rows, 2.0 * length, width)
    rest -= np.array([length, 0.5 * width, 0.0])
    stiffness = np.where(np.abs(rest[:, 0]) < 1e-9, 1.0e5, pins)
    model = build_cloth_model(rest, faces, fabric)
    simulation = free_cloth(model, pin_stiffness=stiffness, solver_settings=SETTINGS, device=device)
    simulation.place_pins(rest)
    simulation.start(rest)
    return simulation, rest


@pytest.mark.parametrize("ratio", [1.0, 5.0, 50.0, 500.0])
def test_a_clamped_strip_hangs_like_the_heavy_elastica(device, ratio):
    """``ratio`` is weight against stiffness, rho g L^3 / B: from hardly bent to hanging straight down.

    The cantilever of Romero et al., Physical validation of simulators in Computer Graphics (ACM Transactions on
    Graphics 40, 2021); the shape it must have is solved for here, not taken from there.
    """
    length, density = 0.2, 0.15
    stiffness = density * G * length**3 / ratio
    fabric = Fabric(stretch=2000.0, poisson=0.0, bending=stiffness, density=density)
    simulation, rest = two_sided_strip(40, 2, length, 0.02, fabric, device)
    assert simulation.settle(0.01, 150).converged
    expected = heavy_elastica(length, stiffness, density)
    for side in (1.0, -1.0):
        end = simulation.positions[0][side * rest[:, 0] > length - 1e-9].mean(0) * [side, 1.0, 1.0]
        # Cells of a fortieth; the softest strip bends within four of them.
        assert np.linalg.norm(end[[0, 2]] - expected) < 0.01 * length


@pytest.mark.parametrize(("ratio", "meshes"), [(1.0, (20, 40)), (50.0, (20, 40, 80))])
def test_a_clamped_strip_comes_closer_to_the_elastica_on_a_finer_mesh(device, ratio, meshes):
    length, density = 0.2, 0.15
    stiffness = density * G * length**3 / ratio
    fabric = Fabric(stretch=2000.0, poisson=0.0, bending=stiffness, density=density)
    off = []
    for columns in meshes:
        simulation, rest = two_sided_strip(columns, 2, length, 0.02, fabric, device)
        assert simulation.settle(0.001, 150).converged
        end = simulation.positions[0][rest[:, 0] > length - 1e-9].mean(0)
        off.append(np.linalg.norm(end[[0, 2]] - heavy_elastica(length, stiffness, density)) / length)
    # Second order in theory; at least halved. The stiff strip does not come to rest on a finer mesh: its stiffest
    # motion against the softest is 10^7 to 1, more than stiffness in float32 bears.
    assert all(fine < 0.5 * coarse for coarse, fine in itertools.pairwise(off))


# --- sagging ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.5, 0.8, 0.95])
def test_a_heavy_strip_held_at_both_ends_hangs_in_a_catenary(device, share):
    """``share`` is the distance of the hands in lengths of the strip; z = a cosh(x / a), 2 a sinh(d / 2a) = L.

    Bending, rho g L^3 / B = 10^7, reaches a two-hundredth of the length; stretching a thousandth of its own weight.
    """
    from scipy.optimize import brentq

    length, density, columns = 0.4, 0.15, 80
    rest, faces = sheet(columns, 2, length, 0.02)
    s = rest[:, 0] / length
    distance = share * length
    fabric = Fabric(stretch=2000.0, poisson=0.0, bending=1.0e-8, density=density)
    ends = (s < 1e-9) | (s > 1.0 - 1e-9)
    simulation = free_cloth(
        build_cloth_model(rest, faces, fabric),
        pin_stiffness=np.where(ends, 1.0e5, 0.0),
        solver_settings=SETTINGS,
        device=device,
    )
    arc = np.sqrt(0.375 * distance * (length - distance))  # Sag of a shallow parabola of this length.
    start = np.stack([(s - 0.5) * distance, rest[:, 1], -4.0 * arc * s * (1.0 - s)], 1)
    simulation.place_pins(start)
    simulation.start(start)
    assert simulation.settle(0.01, 200).converged
    a = brentq(lambda a: 2.0 * a * np.sinh(distance / (2.0 * a)) - length, 0.02 * length, 50.0 * length)
    along = np.arcsinh((s - 0.5) * length / a)
    height = a * np.cosh(along) - a * np.cosh(0.5 * distance / a)
    catenary = np.stack([a * along, rest[:, 1], height], 1)
    # Every vertex, in lengths of the strip; cells of an eightieth.
    assert np.linalg.norm(simulation.positions[0] - catenary, axis=1).max() < 0.002 * length


# --- lateral buckling ---------------------------------------------------------------------------------------------

# Prandtl and Michell, 1899; Timoshenko and Gere, Theory of Elastic Stability, section 6.3: critical end load P L^2 and
# weight q L^3 of a narrow cantilever, in square roots of its flexural times its torsional stiffness.
PRANDTL = {"end load": 4.013, "own weight": 12.85}


def warping_restraint(load, width, poisson):
    """By how much a clamp raises the critical load [1]: it keeps the strip's end from warping out of its plane.

    Vlasov's equation C phi' - C1 phi''' for the torque of a strip of length 1: C = 2 (1 - nu) B w against uniform
    twist and C1 = (1 - nu^2) B w^3 / 12 against warping. The critical load makes the least eigenvalue vanish of

        C phi'^2 + C1 phi''^2 - M^2 phi^2 / ((1 - nu^2) B w).
    """
    from scipy import linalg

    count = 400
    h = 1.0 / count
    s = np.arange(count + 1) * h
    flexural, torsional, warping = (1.0 - poisson**2), 2.0 * (1.0 - poisson), (1.0 - poisson**2) * width**2 / 12.0
    unit = PRANDTL[load] * np.sqrt(flexural * torsional)
    moment = unit * ((1.0 - s) if load == "end load" else 0.5 * (1.0 - s) ** 2)
    first = np.diff(np.eye(count + 1), axis=0) / h
    # phi' is zero in the clamp, half an interval before the first difference.
    second = np.concatenate([2.0 * first[:1], np.diff(first, axis=0)]) / h
    weights = np.concatenate([[0.5 * h], np.full(count - 1, h)])
    stiffness = torsional * h * first.T @ first + warping * second.T @ (weights[:, None] * second)
    lost = np.diag(moment**2 / flexural * h)
    return linalg.eigh(lost[1:, 1:], stiffness[1:, 1:], eigvals_only=True)[-1] ** -0.5


class UprightStrip:
    """A strip on edge, gravity in its plane, held along its middle; what stiffness it has against leaving the plane.

    Loads are in units of Prandtl's and Michell's critical one.
    """

    def __init__(self, load, slenderness, poisson, device):
        self.load, self.length, self.width = load, 0.2, 0.2 / slenderness
        bending, self.density, soft = 1.0e-5, 0.15, 1.0e-9
        narrow = np.sqrt((1.0 - poisson**2) * 2.0 * (1.0 - poisson)) * bending * self.width
        self.critical = PRANDTL[load] * narrow / self.length ** (2 if load == "end load" else 3)
        columns = round(4.0 * slenderness)  # Square cells.
        fabric = Fabric(stretch=5000.0, poisson=poisson, bending=bending, density=self.density)
        rest, _faces = sheet(2 * columns, 4, 2.0 * self.length, self.width)
        x, y = rest[:, 0] - self.length, rest[:, 1] - 0.5 * self.width
        self.ends = (np.abs(x) > self.length - 1e-9) & (np.abs(y) < 1e-9)
        # A force that does not turn: a spring as soft as its far end is away.
        self.pull = np.array([0.0, -self.critical / soft, 0.0])
        pins = np.where(self.ends, soft, 0.0)
        self.simulation, self.rest = two_sided_strip(columns, 4, self.length, self.width, fabric, device, pins)
        free = np.flatnonzero(x > 1e-9)
        mirrored = np.array([np.argmin(np.abs(x + x[k]) + np.abs(y - y[k])) for k in free])
        # Only shapes that are the same on both sides keep the middle level, as a clamp would.
        self.shapes = np.zeros((len(rest), len(free)))
        self.shapes[free, np.arange(len(free))] = self.shapes[mirrored, np.arange(len(free))] = 1.0

    def bear(self, share):
        """Put this share of the critical load on."""
        hanging = share * self.critical / (self.density * self.width) if self.load == "own weight" else 0.0
        self.simulation.set_gravity([0.0, -hanging, 0.0])
        targets = self.rest.copy()
        if self.load == "end load":
            targets[self.ends] += share * self.pull
        self.simulation.place_pins(targets)

    def stiffness(self, share):
        """Against each of the shapes [N/m], in the plane's own equilibrium, by forces in float64."""
        self.bear(share)
        self.simulation.start(self.rest)
        self.simulation.settle(1e-6, 20)
        flat, out = self.simulation.positions[0] * [1.0, 1.0, 0.0], 1.0e-7
        columns = []
        for shape in self.shapes.T:
            force = self.simulation.residual(flat + out * shape[:, None] * [0.0, 0.0, 1.0])[0, :, 2]
            columns.append(self.shapes.T @ -force / out)
        return 0.5 * (np.array(columns) + np.array(columns).T)

    def buckling_load(self):
        """The load at which the stiffness vanishes, and the shape, shape [vertex_count]; stress grows as the load."""
        from scipy import linalg

        unloaded = self.stiffness(0.0)
        slope = (self.stiffness(0.5) - unloaded) / 0.5
        values, modes = linalg.eigh(-slope, unloaded)
        return 1.0 / values[-1], self.shapes @ modes[:, -1]


@pytest.mark.parametrize("load", list(PRANDTL))
@pytest.mark.parametrize("slenderness", [10.0, pytest.param(20.0, marks=pytest.mark.long)])
@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_a_strip_on_edge_buckles_sideways_at_prandtls_load(device, load, slenderness, poisson):
    """Flexural stiffness (1 - nu^2) B w, torsional 2 (1 - nu) B w."""
    strip = UprightStrip(load, slenderness, poisson, device)
    share, _shape = strip.buckling_load()
    expected = warping_restraint(load, 1.0 / slenderness, poisson)
    # Four cells across: linear triangles bend too little in their own plane, and carry part of it in shear.
    assert share == pytest.approx(expected, rel=0.02)


@pytest.mark.long
def test_a_strip_on_edge_comes_back_below_its_load_and_falls_over_above_it(device):
    """The same load found by what happens: pushed out of its plane, the strip settles."""
    strip = UprightStrip("own weight", 10.0, 0.0, device)
    critical, shape = strip.buckling_load()
    pushed = strip.rest + 0.002 * (shape / np.abs(shape).max())[:, None] * [0.0, 0.0, 1.0]
    for share, falls in ((0.95, False), (1.05, True)):
        strip.bear(share * critical)
        strip.simulation.start(pushed)
        strip.simulation.settle(5e-4, 200)
        out = np.abs(strip.simulation.positions[0, :, 2]).max()
        assert (out > 0.005) == falls
        assert falls or out < 0.001
