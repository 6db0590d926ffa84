"""Detail transfer's kernels against float64 references."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from cloth_shapes import tube
from wrinkle_synthesis.kernels.blend import join_all_offsets
from wrinkle_synthesis.kernels.transfer import FULL_WEIGHT, LANES, blend_meshes
from wrinkle_synthesis.wrinkle_addon.coarse_mesh import make_coarse_mesh
from wrinkle_synthesis.wrinkle_addon.correspondence import find_correspondence
from wrinkle_synthesis.wrinkle_addon.detail_transfer import (
    SMOOTHING_STEP,
    DetailTransfer,
    TransferSettings,
    cotangent_weights,
    in_whole_shares,
    smoothed_weights,
)

MESHES, SMOOTHING = 5, 12


@pytest.fixture(scope="module")
def sleeve():
    """A sleeve, its coarse mesh, and how the two correspond."""
    positions, faces = tube(40, 30, 0.4, 0.06)
    coarse = make_coarse_mesh("Sleeve", positions, faces, 60)
    return positions, faces, coarse, find_correspondence("Coarse", positions, faces, coarse.positions, coarse.faces)


@pytest.fixture(scope="module")
def moved(sleeve):
    """Several crumpled sleeves, and a coarse layer that has moved."""
    positions, _, coarse, _ = sleeve
    rng = np.random.default_rng(1)
    meshes = positions + 5e-3 * rng.normal(size=(MESHES, *positions.shape))
    return meshes, coarse.positions + 0.02 * np.sin(7.0 * coarse.positions + rng.normal(size=3))


def dense(start, columns, weights, width):
    matrix = np.zeros((len(start) - 1, width))
    matrix[np.repeat(np.arange(len(matrix)), np.diff(start)), columns] = weights
    return matrix


def prolongation(match):
    """a_uv, shape [fine_count, coarse_count]."""
    matrix = np.zeros((match.fine_count, match.coarse_count))
    np.add.at(matrix, (np.arange(match.fine_count)[:, None], match.corners), match.weights)
    return matrix


def smoothing(positions, faces, iterations):
    """Laplacian smoothing over the fine mesh as a dense matrix."""
    mean = dense(*cotangent_weights(positions, faces), len(positions))
    step = np.eye(len(positions)) + SMOOTHING_STEP * (mean - np.eye(len(positions)))
    return np.linalg.matrix_power(step, iterations)


def carried(match, coarse):
    """Each fine vertex at its place on the moved coarse mesh."""
    a, b, c = (coarse[match.corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along_b, along_c, height = match.places.astype(np.float64).T[:, :, None]
    return a + along_b * (b - a) + along_c * (c - a) + height * normal


def align(device, sleeve, moved, settings):
    positions, faces, _, match = sleeve
    meshes, coarse = (wp.array(points.astype(np.float32), dtype=wp.vec3, device=device) for points in moved)
    transfer = DetailTransfer(match, positions, faces, settings, device=device)
    for number in range(len(meshes)):
        transfer.align(coarse, meshes[number])
    return meshes.numpy()


def test_equations_5_and_6_as_published(device, sleeve, moved):
    match = sleeve[3]
    meshes, coarse = moved
    weights = prolongation(match)
    offsets = coarse - (weights.T @ meshes) / weights.sum(0)[:, None]
    expected = meshes + weights @ offsets
    found = align(device, sleeve, moved, TransferSettings(smoothing=0, as_published=True))
    # Positions are float32, and corners that a vertex hardly weighs on are left out: 0.1 of the thinnest wrinkle seen.
    assert np.abs(found - expected).max() < 1e-5


def test_offsets_from_places_on_the_coarse_mesh_are_smoothed_over_the_garment(device, sleeve, moved):
    positions, faces, _, match = sleeve
    meshes, coarse = moved
    start, members, shares = match.members()
    averaging = dense(start, members, shares, match.fine_count)
    offsets = averaging @ (carried(match, coarse) - meshes)
    expected = meshes + smoothing(positions, faces, SMOOTHING) @ prolongation(match) @ offsets
    found = align(device, sleeve, moved, TransferSettings(smoothing=SMOOTHING))
    # Weights below 1e-4 are left out: of offsets that differ by 40 mm at most, a hundredth of a millimetre or two.
    assert np.abs(found - expected).max() < 3e-5


def test_stored_weights_are_the_smoothed_ones_and_add_up_to_1(sleeve):
    positions, faces, _, match = sleeve
    start, columns, weights = smoothed_weights(match, positions, faces, SMOOTHING)
    exact = smoothing(positions, faces, SMOOTHING) @ prolongation(match)
    stored = dense(start, columns, weights, match.coarse_count)
    assert np.abs(stored - exact).max() < 5e-4
    np.testing.assert_allclose(stored.sum(1), 1.0, atol=1e-6)
    assert (np.diff(columns)[np.diff(np.repeat(np.arange(match.fine_count), np.diff(start))) == 0] > 0).all()


def test_a_coarse_layer_may_have_more_vertices_than_16_bits_hold(device, sleeve, moved):
    positions, faces, coarse, match = sleeve
    # Vertices that nothing rides on come first.
    more = 1 << 16
    borders = np.concatenate([np.zeros(more, bool), match.coarse_on_border])
    many = replace(match, corners=match.corners + more, coarse_on_border=borders)
    layer = np.concatenate([np.zeros((more, 3)), moved[1]])
    settings = TransferSettings(smoothing=1)
    found = align(device, (positions, faces, coarse, many), (moved[0][:1], layer), settings)
    np.testing.assert_array_equal(found, align(device, sleeve, (moved[0][:1], moved[1]), settings))
    joined = []
    for each in (many, match):
        transfer = DetailTransfer(each, positions, faces, settings, device=device)
        meshes = wp.array(moved[0].astype(np.float32), dtype=wp.vec3, device=device)
        joined.append(wp.zeros(len(positions), dtype=wp.vec3, device=device))
        transfer.join(meshes, joined[-1])
    np.testing.assert_array_equal(joined[0].numpy(), joined[1].numpy())


def test_weights_in_whole_shares_keep_their_sums():
    rng = np.random.default_rng(3)
    start = np.concatenate([[0], np.cumsum(rng.integers(0, 30, 200))]).astype(np.int32)
    rows = np.repeat(np.arange(200), np.diff(start))
    weights = rng.random(start[-1])
    sums = np.bincount(rows, weights, 200)
    # Some follow the coarse layer wholly, some by halves, and some not at all.
    weights = (weights / sums[rows] * rng.choice([0.0, 0.5, 1.0], 200)[rows]).astype(np.float32)
    shares = in_whole_shares(start, weights).astype(np.float64)
    full = int(FULL_WEIGHT)
    assert np.abs(shares - full * weights).max() < 1.0
    assert np.abs(np.bincount(rows, shares, 200) - full * np.bincount(rows, weights, 200)).max() < 0.51
    np.testing.assert_array_equal(in_whole_shares(np.array([0, 1], np.int32), np.ones(1, np.float32)), [full])


def test_aligning_twice_gives_the_same_bits(device, sleeve, moved):
    first = align(device, sleeve, moved, TransferSettings())
    np.testing.assert_array_equal(align(device, sleeve, moved, TransferSettings()), first)


def test_blending_is_the_weighted_mean(device, moved):
    meshes = moved[0]
    shares = np.random.default_rng(2).dirichlet(np.ones(MESHES), meshes.shape[1]).T
    out = wp.zeros(meshes.shape[1], dtype=wp.vec3, device=device)
    inputs = [wp.array(meshes, dtype=wp.vec3, device=device), wp.array(shares, dtype=wp.float32, device=device)]
    wp.launch(blend_meshes, out.shape, inputs, [out], device=device)
    # Positions of half a metre in float32.
    assert np.abs(out.numpy() - (shares[..., None] * meshes).sum(0)).max() < 1e-6


@pytest.mark.parametrize("strength", [1.0, 0.4])
def test_offsets_that_are_joined_are_aligned_each_by_itself(device, sleeve, moved, strength):
    positions, faces, _, match = sleeve
    transfer = DetailTransfer(match, positions, faces, device=device)
    # Of lanes that are read at once, one more is begun.
    first, *others = moved[0][: LANES + 2]
    layer = wp.array(moved[1].astype(np.float32), dtype=wp.vec3, device=device)
    aligned = [wp.array(mesh.astype(np.float32), dtype=wp.vec3, device=device) for mesh in (first, *others)]
    for mesh in aligned:
        transfer.align(layer, mesh, strength)
    skinned, *apart = (mesh.numpy() for mesh in aligned)
    joined = wp.zeros(len(first), dtype=wp.vec3, device=device)
    offsets = wp.array(np.stack(apart) - skinned, dtype=wp.vec3, device=device)
    wp.launch(join_all_offsets, joined.shape, [offsets], [joined], device=device)

    meshes = wp.array(
        np.stack([first, *(mesh - first for mesh in others)]).astype(np.float32), dtype=wp.vec3, device=device
    )
    out = wp.zeros(len(first), dtype=wp.vec3, device=device)
    transfer.join(meshes, out, strength)
    transfer.attach(layer, out, strength)
    # Positions of half a metre in float32, of which offsets are differences.
    assert np.abs(out.numpy() - (skinned + joined.numpy())).max() < 1e-6
