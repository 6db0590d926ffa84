"""Each energy of the cloth: its force is its derivative, its stiffness the derivative of the force."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import sheet
from wrinkle_synthesis.kernels.cloth import bending, contact, friction, membrane
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.elasticity import shape_gradients, upload_garment

# Central differences of smooth float64 functions with this step are good to about 1e-8 of their scale.
STEP = 1.0e-5
DIFFERENCE = 1.0e-6

STIFFNESS = (130.0, 40.0, 90.0, 35.0)
THICKNESS, STRENGTH, DEPTH = 0.003, 0.05, 0.01
BOUND, SLIP = 0.02, 0.0005


def derivative(function, x, step=STEP):
    """Central differences of ``function`` by every entry of x, added as trailing axes."""
    columns = []
    for index in np.ndindex(*x.shape[1:]):
        move = np.zeros(x.shape[1:])
        move[index] = step
        columns.append((function(x + move) - function(x - move)) / (2.0 * step))
    return np.stack(columns, -1).reshape(*columns[0].shape, *x.shape[1:])


def assert_derivative(exact, differences, tolerance=DIFFERENCE):
    assert np.abs(exact - differences).max() <= tolerance * np.abs(differences).max()


# --- membrane -----------------------------------------------------------------------------------------------------


@wp.kernel
def evaluate_membrane(
    corners: wp.array2d[wp.vec3d],
    rest_inverse: wp.array[wp.mat22d],
    shapes: wp.array2d[wp.vec2d],
    material: membrane.Membrane,
    tension_only: wp.bool,
    energy: wp.array[wp.float64],
    gradient: wp.array2d[wp.vec3d],
    hessian: wp.array3d[wp.mat33d],
):
    i = wp.tid()
    f = membrane.deformation_gradient(corners[i, 0], corners[i, 1], corners[i, 2], rest_inverse[i])
    strain = membrane.green_strain(f)
    stress = membrane.membrane_stress(strain, material)
    energy[i] = membrane.membrane_energy(strain, material)
    for a in range(3):
        gradient[i, a] = membrane.membrane_gradient(f, stress, shapes[i, a])
    if tension_only:
        stress = membrane.tensile_part(stress)
    for a in range(3):
        for b in range(3):
            tangent = membrane.membrane_tangent(strain, material)
            hessian[i, a, b] = membrane.membrane_hessian(f, stress, tangent, shapes[i, a], shapes[i, b])


@pytest.fixture(params=[0.0, 600.0], ids=["linear", "stiffening"])
def triangles(device, request):
    """Random strained triangles about 1 m large, and a function that evaluates the membrane on them."""
    material = membrane.Membrane()
    material.stiffness = wp.vec4d(*STIFFNESS)
    material.limit = wp.vec3d(0.05, 0.02, 0.1)
    material.growth = wp.vec3d(1.0, 0.5, 0.03) * wp.float64(request.param)
    rng = np.random.default_rng(1)
    count = 40
    rest = np.array([[0.0, 0.0], [1.0, 0.1], [0.2, 0.9]]) + 0.2 * rng.normal(size=(count, 3, 2))
    rest_inverse = np.linalg.inv(np.stack([rest[:, 1] - rest[:, 0], rest[:, 2] - rest[:, 0]], 2))
    frame = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    stretch = rng.uniform(0.6, 1.4, size=(count, 1, 1))  # From clear compression to clear stretch.
    corners = np.concatenate([stretch * rest, 0.2 * rng.normal(size=(count, 3, 1))], 2) @ frame

    def evaluate(x, tension_only=False):
        energy = wp.zeros(count, dtype=wp.float64, device=device)
        gradient = wp.zeros((count, 3), dtype=wp.vec3d, device=device)
        hessian = wp.zeros((count, 3, 3), dtype=wp.mat33d, device=device)
        arrays = (x, wp.vec3d), (rest_inverse, wp.mat22d), (shape_gradients(rest_inverse), wp.vec2d)
        inputs = [wp.array(values, dtype=kind, device=device) for values, kind in arrays]
        outputs = [energy, gradient, hessian]
        wp.launch(evaluate_membrane, count, [*inputs, material, tension_only], outputs, device=device)
        return energy.numpy(), gradient.numpy(), hessian.numpy().transpose(0, 1, 3, 2, 4)

    return corners, evaluate


def test_membrane_force_is_the_derivative_of_its_energy(triangles):
    corners, evaluate = triangles
    assert_derivative(evaluate(corners)[1], derivative(lambda x: evaluate(x)[0], corners))


def test_membrane_hessian_is_the_derivative_of_its_force(triangles):
    corners, evaluate = triangles
    assert_derivative(evaluate(corners)[2], derivative(lambda x: evaluate(x)[1], corners))


def test_membrane_hessian_of_the_tensile_part_is_positive_semidefinite(triangles):
    corners, evaluate = triangles
    exact = evaluate(corners)[2].reshape(-1, 9, 9)
    projected = evaluate(corners, tension_only=True)[2].reshape(-1, 9, 9)
    assert np.linalg.eigvalsh(exact).min() < -1.0  # The case is a real one: compression is unstable.
    assert np.linalg.eigvalsh(projected).min() > -1e-10 * np.abs(projected).max()


def test_membrane_hessian_of_a_stretched_triangle_is_left_as_it_is(triangles):
    corners, evaluate = triangles
    rest = np.linalg.eigvalsh(evaluate(corners)[2].reshape(-1, 9, 9)).min(1)
    stretched = 3.0 * corners
    assert rest.min() < 0.0
    exact, projected = evaluate(stretched)[2], evaluate(stretched, tension_only=True)[2]
    assert np.abs(exact - projected).max() < 1e-12 * np.abs(exact).max()


# --- bending ------------------------------------------------------------------------------------------------------


@wp.kernel
def evaluate_bending(
    positions: wp.array2d[wp.vec3d],
    row_start: wp.array[wp.int32],
    columns: wp.array[wp.vec4i],
    coefficients: wp.array[wp.vec4d],
    gradient: wp.array2d[wp.vec3d],
):
    world, vertex = wp.tid()
    gradient[world, vertex] = bending.bending_gradient(vertex, world, positions, row_start, columns, coefficients)


def quadratic_fit_energy(rest, faces, x, stiffness, poisson):
    """Plate energy of the quadratic surfaces through every triangle of a flat sheet and its three neighbours [J]."""
    opposite = {}
    for face in faces:
        for start, end, other in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            opposite[face[start], face[end]] = face[other]
    total = 0.0
    for i, j, k in faces:
        patch = [i, j, k, *(opposite.get(edge) for edge in ((j, i), (k, j), (i, k)))]
        if None in patch:
            continue
        u, v = (rest[patch] - rest[i])[:, :2].T
        terms = np.stack([np.ones(6), u, v, 0.5 * u * u, 0.5 * v * v, u * v], 1)
        xx, yy, xy = np.linalg.solve(terms, x[patch])[3:]
        area = 0.5 * np.linalg.norm(np.cross(rest[j] - rest[i], rest[k] - rest[i]))
        square = xx @ xx + yy @ yy + 2.0 * xy @ xy
        total += 0.5 * stiffness * area * ((1.0 - poisson) * square + poisson * (xx + yy) @ (xx + yy))
    return total


def test_bending_force_is_the_derivative_of_the_energy_of_a_plate(device):
    rng = np.random.default_rng(2)
    rest, faces = sheet(7, 7, 0.35, 0.35)
    rest[:, :2] += 0.01 * rng.normal(size=(len(rest), 2))
    fabric = Fabric(bending=2.0e-3, poisson=0.3)
    model = build_cloth_model(rest, faces, fabric)
    # Only the middle moves, so that no triangle on the border, which has fewer neighbours, is bent.
    middle = np.flatnonzero((np.abs(rest[:, :2] - 0.175) < 0.04).all(1))
    assert len(middle) >= 3

    def place(moved):
        x = rest.copy()
        x[middle] += moved
        return x

    moved = 0.05 * rng.normal(size=(len(middle), 3))
    gradient = wp.zeros((1, len(rest)), dtype=wp.vec3d, device=device)
    garment = upload_garment(model, np.zeros(len(rest)), device)
    rows = [garment.bending_start, garment.bending_columns, garment.bending_coefficients]
    inputs = [wp.array(place(moved)[None], dtype=wp.vec3d, device=device), *rows]
    wp.launch(evaluate_bending, (1, len(rest)), inputs, [gradient], device=device)

    def energy(moves):
        return np.array(
            [quadratic_fit_energy(rest, faces, place(move), fabric.bending, fabric.poisson) for move in moves]
        )

    assert_derivative(gradient.numpy()[:, middle], derivative(energy, moved[None]))


def test_bending_resists_no_affine_motion_of_a_flat_sheet(device):
    rest, faces = sheet(6, 5, 0.3, 0.2)
    model = build_cloth_model(rest, faces, Fabric(bending=1.0))
    matrix = np.zeros((len(rest), len(rest)))
    rows = np.repeat(np.arange(len(rest)), np.diff(model.bending_start))
    matrix[rows, model.bending_columns] = model.bending_coefficients
    scale = np.abs(matrix).max()
    assert np.allclose(matrix, matrix.T, atol=1e-12 * scale)
    assert np.linalg.eigvalsh(matrix).min() > -1e-12 * scale
    assert np.abs(matrix @ np.column_stack([np.ones(len(rest)), rest[:, :2]])).max() < 1e-10 * scale


# --- contact ------------------------------------------------------------------------------------------------------


@wp.kernel
def evaluate_contact(
    gap: wp.array[wp.float64],
    energy: wp.array[wp.float64],
    force: wp.array[wp.float64],
    curvature: wp.array[wp.float64],
):
    i = wp.tid()
    thickness, strength, depth = wp.float64(THICKNESS), wp.float64(STRENGTH), wp.float64(DEPTH)
    energy[i] = contact.contact_energy(gap[i], thickness, strength, depth)
    force[i] = contact.contact_force(gap[i], thickness, strength, depth)
    curvature[i] = contact.contact_curvature(gap[i], thickness, strength, depth)


def contact_at(gap, device):
    outputs = [wp.zeros(len(gap), dtype=wp.float64, device=device) for _ in range(3)]
    wp.launch(evaluate_contact, len(gap), [wp.array(gap, dtype=wp.float64, device=device)], outputs, device=device)
    return [output.numpy() for output in outputs]


def test_contact_force_and_stiffness_are_derivatives(device):
    # Through the thickness, the surface and the depth limit; off its kinks by more than the step.
    gap = np.linspace(-0.02, 0.004, 241)
    gap = gap[(np.abs(gap - THICKNESS) > 1e-6) & (np.abs(gap + DEPTH) > 1e-6)]
    step = 1.0e-7
    _energy, force, curvature = contact_at(gap, device)
    above, below = contact_at(gap + step, device), contact_at(gap - step, device)
    assert_derivative(-force, (above[0] - below[0]) / (2.0 * step))
    within = gap > -DEPTH
    assert_derivative(curvature[within], -((above[1] - below[1]) / (2.0 * step))[within])


def test_contact_starts_without_a_jump_and_its_force_is_bounded_deep_inside(device):
    _energy, force, curvature = contact_at(np.array([THICKNESS, 0.0, -DEPTH, -10.0 * DEPTH]), device)
    energies = contact_at(np.array([-DEPTH - 1e-9, -DEPTH + 1e-9]), device)[0]
    assert force[0] == 0.0 and curvature[0] == 0.0
    assert force[1] == pytest.approx(STRENGTH)
    assert force[3] == force[2] and curvature[3] == curvature[2] > 0.0
    assert energies[0] - energies[1] == pytest.approx(2e-9 * force[2], rel=1e-4)


# --- friction -----------------------------------------------------------------------------------------------------


@wp.kernel
def evaluate_friction(
    displacement: wp.array[wp.vec3d],
    normal: wp.array[wp.vec3d],
    energy: wp.array[wp.float64],
    gradient: wp.array[wp.vec3d],
    hessian: wp.array[wp.mat33d],
):
    i = wp.tid()
    bound, slip = wp.float64(BOUND), wp.float64(SLIP)
    drift = friction.tangential(displacement[i], normal[i])
    energy[i] = friction.friction_energy(wp.length(drift), bound, slip)
    gradient[i] = friction.friction_slope(wp.length(drift), bound, slip) * drift
    hessian[i] = friction.friction_hessian(drift, normal[i], bound, slip)


@pytest.mark.parametrize("share", [0.5, 3.0], ids=["sticking", "slipping"])
def test_friction_force_and_stiffness_are_derivatives(device, share):
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(20, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = np.cross(normal, rng.normal(size=(20, 3)))
    tangent *= share * SLIP / np.linalg.norm(tangent, axis=1, keepdims=True)
    displacement = tangent + 0.001 * normal

    def evaluate(x):
        dtypes = (wp.float64, wp.vec3d, wp.mat33d)
        outputs = [wp.zeros(len(x), dtype=dtype, device=device) for dtype in dtypes]
        inputs = [wp.array(values, dtype=wp.vec3d, device=device) for values in (x, normal)]
        wp.launch(evaluate_friction, len(x), inputs, outputs, device=device)
        return [output.numpy() for output in outputs]

    step = 1.0e-3 * SLIP
    _energy, gradient, hessian = evaluate(displacement)
    assert_derivative(gradient, derivative(lambda x: evaluate(x)[0], displacement, step))
    assert_derivative(hessian, derivative(lambda x: evaluate(x)[1], displacement, step))
    assert np.linalg.eigvalsh(hessian).min() > -1e-9 * np.abs(hessian).max()
    # Never more than Coulomb's bound, and never along the normal.
    size = np.linalg.norm(gradient, axis=1)
    assert np.allclose(size, BOUND * min(share, 1.0), rtol=1e-9)
    assert np.abs((gradient * normal).sum(1)).max() < 1e-12
