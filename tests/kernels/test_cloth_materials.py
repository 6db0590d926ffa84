"""The energies that a fabric may choose instead of the plate: hinges with a rest angle, and a net of springs."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import Array, Faces, free_cloth, sheet
from wrinkle_synthesis.kernels.cloth import hinges, springs
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.fabrics import Material, Pair

# Central differences of smooth float64 functions with this step are good to about 1e-8 of their scale.
STEP = 1.0e-6
DIFFERENCE = 1.0e-6

CHOSEN: tuple[Material, ...] = ("hinges", "springs")


def lattice(columns: int, rows: int, side: float) -> tuple[Array, Faces]:
    """A sheet of equilateral triangles in the plane z = 0, its edges along x and 60 degrees to it."""
    positions, faces = sheet(columns, rows, columns * side, rows * side)
    # Each row is moved by half a side against the one before; the diagonals of the cells become the third direction.
    x, y = positions[:, 0] - 0.5 * positions[:, 1], 0.5 * np.sqrt(3.0) * positions[:, 1]
    return np.stack([x, y, 0.0 * x], 1), faces


def cloth(rest: Array, faces: Faces, fabric: Fabric, device: str) -> ClothSimulation:
    """The sheet without gravity, its warp along x."""
    warp = np.tile([1.0, 0.0, 0.0], (len(faces), 1))
    simulation = free_cloth(build_cloth_model(rest, faces, fabric, warp_directions=warp), device=device)
    simulation.set_gravity(np.zeros(3))
    return simulation


def crumpled(material: Material, device: str, bending: Pair = (1e-4, 4e-5)) -> tuple[ClothSimulation, Array]:
    """A crumpled sheet of this material, and its positions."""
    rng = np.random.default_rng(5)
    rest, faces = sheet(6, 5, 0.12, 0.1)
    rest[:, :2] += 0.003 * rng.normal(size=(len(rest), 2))
    fabric = Fabric(stretch=(150.0, 80.0), bending=bending, material=material, rest_bend=0.5, damping=0.02)
    rest[:, 2] = 0.005 * np.sin(60.0 * rest[:, 0])
    return cloth(rest, faces, fabric, device), rest * [0.97, 1.02, 1.0] + 0.004 * rng.normal(size=rest.shape)


@pytest.mark.parametrize("material", CHOSEN)
def test_force_and_exact_hessian_are_derivatives(device: str, material: Material) -> None:
    simulation, x = crumpled(material, device)
    assert_derivatives(simulation, x)


def test_force_and_exact_hessian_of_damping_are_derivatives(device: str) -> None:
    simulation, x = crumpled("plate", device, bending=1e-7)
    undamped = simulation.residual(x)
    simulation.start(0.8 * x + 0.1)
    with simulation._elasticity.damped(simulation._positions, 0.01):
        assert np.abs(simulation.residual(x) - undamped).max() > 0.01 * np.abs(undamped).max()
        assert_derivatives(simulation, x)
    assert np.array_equal(simulation.residual(x), undamped)


def assert_derivatives(simulation: ClothSimulation, x: Array) -> None:
    """The static force is minus the derivative of the energy, the Hessian that of the force."""
    forces, hessian = simulation.residual(x)[0], simulation.hessian(x).toarray()
    differences, slopes = np.zeros_like(x), np.zeros_like(hessian)
    for vertex, axis in np.ndindex(*x.shape):
        sides = []
        for step in (STEP, -STEP):
            moved = x.copy()
            moved[vertex, axis] += step
            simulation.start(moved)
            sides.append((simulation.energy()[0], simulation.residual()[0]))
        differences[vertex, axis] = -(sides[0][0] - sides[1][0]) / (2.0 * STEP)
        slopes[:, 3 * vertex + axis] = -((sides[0][1] - sides[1][1]) / (2.0 * STEP)).ravel()
    assert np.abs(forces - differences).max() < DIFFERENCE * np.abs(forces).max()
    # Blocks are stored in float32.
    assert np.abs(hessian - slopes).max() < DIFFERENCE * np.abs(hessian).max()


@pytest.mark.parametrize("material", CHOSEN)
def test_hessian_without_compression_is_positive_semidefinite(device: str, material: Material) -> None:
    simulation, x = crumpled(material, device)
    exact = np.linalg.eigvalsh(simulation.hessian(x).toarray())
    simulation.start(x)
    simulation._evaluate_gradient()
    simulation._system.assemble(simulation._positions, simulation._inverse_dt2, simulation._kept)
    projected = np.linalg.eigvalsh(simulation._system.to_scipy(0).toarray())
    assert exact[0] < -1e-4 * exact[-1]  # The case is a real one.
    assert projected[0] > -1e-6 * projected[-1]


@pytest.mark.parametrize("material", CHOSEN)
def test_no_force_at_rest_nor_where_it_is_moved_and_turned(device: str, material: Material) -> None:
    rest, faces = lattice(6, 6, 0.02)
    simulation = cloth(rest, faces, Fabric(material=material), device)
    turn = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))[0]
    for x in (rest, rest @ turn + 0.3):
        assert np.abs(simulation.residual(x)).max() < 1e-9


@pytest.mark.parametrize("material", CHOSEN)
def test_they_settle_like_the_plate(device: str, material: Material) -> None:
    """A strip that is held at one end comes to rest under its weight, bent but not torn."""
    rest, faces = sheet(16, 4, 0.08, 0.02)
    held = np.where(rest[:, 0] < 0.006, 1e4, 0.0)
    model = build_cloth_model(rest, faces, Fabric(material=material))
    simulation = free_cloth(model, pin_stiffness=held, device=device)
    simulation.place_pins(rest)
    simulation.start(rest)
    report = simulation.settle(0.1, 100)
    assert report.converged
    low = simulation.positions[0][:, 2].min()
    assert -0.08 < low < -0.01


# --- hinges -------------------------------------------------------------------------------------------------------


@wp.kernel
def evaluate_hinge(
    x: wp.array2d[wp.vec3d],
    angle: wp.array[wp.float64],
    gradient: wp.array2d[wp.vec3d],
    hessian: wp.array3d[wp.mat33d],
):
    n = wp.tid()
    angle[n] = hinges.hinge_angle(x[n, 0], x[n, 1], x[n, 2], x[n, 3])
    for i in range(4):
        gradient[n, i] = hinges.angle_gradient(x[n, 0], x[n, 1], x[n, 2], x[n, 3], i)
        for j in range(4):
            hessian[n, i, j] = hinges.angle_hessian(x[n, 0], x[n, 1], x[n, 2], x[n, 3], i, j)


def test_gradient_and_hessian_of_a_hinges_angle_are_its_derivatives(device: str) -> None:
    rng = np.random.default_rng(7)
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, 0.9, 0.0], [0.6, -0.8, 0.0]])
    x = x + 0.3 * rng.normal(size=(30, 4, 3))

    def evaluate(at: Array) -> tuple[Array, Array, Array]:
        angle = wp.zeros(len(at), dtype=wp.float64, device=device)
        gradient = wp.zeros((len(at), 4), dtype=wp.vec3d, device=device)
        hessian = wp.zeros((len(at), 4, 4), dtype=wp.mat33d, device=device)
        inputs, outputs = [wp.array(at, dtype=wp.vec3d, device=device)], [angle, gradient, hessian]
        wp.launch(evaluate_hinge, len(at), inputs, outputs, device=device)
        return angle.numpy(), gradient.numpy(), hessian.numpy()

    _, gradient, hessian = evaluate(x)
    for i, axis in np.ndindex(4, 3):
        move = np.zeros((4, 3))
        move[i, axis] = STEP
        above, below = evaluate(x + move), evaluate(x - move)
        assert np.allclose(gradient[:, i, axis], (above[0] - below[0]) / (2.0 * STEP), atol=1e-7)
        assert np.allclose(hessian[:, :, i, :, axis], (above[1] - below[1]) / (2.0 * STEP), atol=1e-6)


@pytest.mark.parametrize("direction", [0.0, 0.5, np.pi / 2.0])
def test_hinges_bend_into_a_cylinder_like_a_plate_on_equilateral_triangles(device: str, direction: float) -> None:
    rest, faces = lattice(40, 40, 0.01)
    radius, bending = 0.5, 1.0e-2
    simulation = cloth(rest, faces, Fabric(bending=bending, material="hinges"), device)
    along = np.array([np.cos(direction), np.sin(direction), 0.0])
    across = np.cross([0.0, 0.0, 1.0], along)
    angle = (rest @ along / radius)[:, None]
    rolled = (rest @ across)[:, None] * across + radius * (np.sin(angle) * along + np.cos(angle) * [0.0, 0.0, 1.0])
    simulation.start(rolled)
    bent = simulation._elasticity
    simulation.energy()
    energy = bent.elements[0].energy()[0]
    # Edges on the border are no hinges: one in some forty.
    assert energy == pytest.approx(0.5 * bending / radius**2 * simulation.model.rest_area.sum(), rel=0.04)


@pytest.mark.parametrize("across", [False, True], ids=["warp", "weft"])
def test_hinges_bend_along_warp_and_weft_with_their_own_stiffness(device: str, across: bool) -> None:
    rest, faces = sheet(30, 30, 0.3, 0.3)
    radius, bending = 0.5, (2.0e-2, 0.5e-2)
    simulation = cloth(rest, faces, Fabric(bending=bending, material="hinges"), device)
    angle = rest[:, 1 if across else 0] / radius
    rolled = np.stack([radius * np.sin(angle), rest[:, 0 if across else 1], radius * np.cos(angle)], 1)
    if across:
        rolled = rolled[:, [1, 0, 2]]
    simulation.start(rolled)
    simulation.energy()
    energy = simulation._elasticity.elements[0].energy()[0]
    # On rulings that are edges the mesh is exact, but for the last of thirty, which is no hinge.
    assert energy == pytest.approx(0.5 * bending[across] / radius**2 * 0.3**2 * 29.0 / 30.0, rel=1e-3)


def test_a_formed_garment_rests_as_it_was_modelled(device: str) -> None:
    rest, faces = sheet(8, 6, 0.08, 0.06)
    rest[:, 2] = 0.01 * np.sin(80.0 * rest[:, 0])
    formed, cut = (
        cloth(rest, faces, Fabric(material="hinges", rest_bend=share), device).residual(rest) for share in (1.0, 0.0)
    )
    assert np.abs(formed).max() < 1e-9
    assert np.abs(cut).max() > 1e-4


# --- springs ------------------------------------------------------------------------------------------------------


def test_springs_stretch_like_their_fabric_on_equilateral_triangles(device: str) -> None:
    """Both ways alike, where no bending spring is compressed; a lattice of springs has Poisson's ratio 1/3."""
    rest, faces = lattice(30, 30, 0.01)
    simulation = cloth(rest, faces, Fabric(stretch=90.0, material="springs"), device)
    strain = 1e-4
    simulation.start((1.0 + strain) * rest)
    expected = 90.0 / (1.0 - 1.0 / 3.0) * strain**2 * simulation.model.rest_area.sum()
    assert simulation.energy()[0] == pytest.approx(expected, rel=1e-6)


@wp.kernel
def evaluate_spring(
    length: wp.array[wp.float64],
    rest: wp.float64,
    stiffness: wp.float64,
    beam: wp.float64,
    turn: wp.float64,
    energy: wp.array[wp.float64],
    force: wp.array[wp.float64],
    slope: wp.array[wp.float64],
):
    i = wp.tid()
    found, push, hardness = springs.spring_law(length[i], rest, stiffness, beam, turn)
    energy[i] = found
    force[i] = push
    slope[i] = hardness


def law(length: Array, beam: float, turn: float, device: str) -> list[Array]:
    outputs = [wp.zeros(len(length), dtype=wp.float64, device=device) for _ in range(3)]
    inputs = [wp.array(length, dtype=wp.float64, device=device), 0.01, 80.0, beam, turn]
    wp.launch(evaluate_spring, len(length), inputs, outputs, device=device)
    return [output.numpy() for output in outputs]


@pytest.mark.parametrize("beam", [0.0, 3.0e-7], ids=["length", "bending"])
def test_force_and_stiffness_of_a_spring_are_derivatives(device: str, beam: float) -> None:
    turn, step = 0.2, 1.0e-8
    met = 0.01 * np.sin(turn) / turn
    length = np.linspace(0.0005, 0.012, 301)
    length = length[(np.abs(length - met) > 1e-6) & (np.abs(length - 0.01) > 1e-6)]  # Where the law has its kinks.
    _, force, slope = law(length, beam, turn, device)
    above, below = law(length + step, beam, turn, device), law(length - step, beam, turn, device)
    assert np.abs(force - (above[0] - below[0]) / (2.0 * step)).max() < 1e-6 * np.abs(force).max()
    assert np.abs(slope - (above[1] - below[1]) / (2.0 * step)).max() < 1e-5 * np.abs(slope).max()


def test_a_bending_spring_holds_the_energy_of_the_arc_it_buckles_into(device: str) -> None:
    beam, turn = 3.0e-7, 1e-3
    curvature = np.array([50.0, 150.0, 300.0])
    chord = 2.0 * np.sin(0.5 * curvature * 0.01) / curvature
    energy = law(chord, beam, turn, device)[0]
    # But for the little that it took to reach the buckling load.
    assert np.allclose(energy, 0.5 * beam * 0.01 * curvature**2, rtol=2e-4)


def test_a_bending_springs_force_goes_on_where_the_beam_takes_over(device: str) -> None:
    rest, faces = lattice(4, 4, 0.01)
    model = build_cloth_model(rest, faces, Fabric(material="springs"))
    assert model.springs is not None
    net = model.springs[0]
    bends = net.beam > 0.0
    assert bends.any() and (net.turn[bends] < np.pi - 1e-6).all()
    u, rest_length = net.turn[bends], net.rest_length[bends]
    beam = 4.0 * net.beam[bends] * u**2 / (rest_length**2 * (np.cos(u) - np.sin(u) / u))
    assert np.allclose(beam, net.stiffness[bends] * rest_length * (np.sin(u) / u - 1.0), rtol=1e-6)
    # Opposite corners of equilateral triangles are sqrt(3) sides apart.
    assert np.allclose(rest_length, np.sqrt(3.0) * 0.01)
