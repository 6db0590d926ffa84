"""Which way a garment faces the body where it has slid away from its skin: as it lies, not as that skin says."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import sheet, tube
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.facing import AROUND, TURNED_COSINE, Facing

UP = np.array([0.0, 0.0, 1.0])


def facing_of(positions, faces, outward, device):
    """Where the garment faces at these positions, its skin's outward directions being these."""
    model = build_cloth_model(positions, faces, Fabric())
    facing = Facing(model, wp.array(faces, dtype=wp.int32, device=device), 1)
    facing.set_outward(wp.array(np.broadcast_to(outward, positions.shape)[None], dtype=wp.vec3, device=device))
    assert np.allclose(facing.directions.numpy(), outward)
    facing.turn(wp.array(positions[None], dtype=wp.vec3d, device=device))
    return facing.directions.numpy()[0]


@pytest.mark.parametrize("degrees", [0.0, 55.0, 65.0, 120.0, 180.0])
def test_the_skin_counts_as_long_as_the_garment_faces_with_it(device, degrees):
    positions, faces = sheet(10, 10, 0.1, 0.1)
    outward = np.array([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))])
    turned = np.cos(np.radians(degrees)) < TURNED_COSINE
    # Directions are kept in float32.
    assert np.allclose(facing_of(positions, faces, outward, device), UP if turned else outward, atol=1e-6)


@pytest.mark.parametrize("cells", [60, 120])
def test_folds_narrower_than_what_is_averaged_turn_nothing(device, cells):
    """Pleats whose flanks hang over, on a mesh and one twice as fine: their own normals point down, the cloth up."""
    flat, faces = sheet(cells, cells // 3, 0.24, 0.08)
    pleat = AROUND / 2.0
    phase = 2.0 * np.pi * flat[:, 0] / pleat
    positions = flat + np.stack([-0.006 * np.sin(2.0 * phase), np.zeros(len(flat)), 0.01 * np.cos(phase)], 1)
    corners = positions[faces]
    down = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0.0
    assert down.mean() > 0.05
    inner = np.abs(flat[:, 0] - 0.12) < 0.12 - AROUND
    assert (facing_of(positions, faces, -UP, device)[inner, 2] > TURNED_COSINE).all()
    assert np.allclose(facing_of(positions, faces, UP, device)[inner], UP)


def test_a_garment_without_outward_directions_gets_none(device):
    positions, faces = sheet(4, 4, 0.1, 0.1)
    assert (facing_of(positions, faces, np.zeros(3), device) == 0.0).all()


def test_cloth_stays_outside_a_body_that_has_turned_half_round_beneath_it(device):
    """The skin that this sleeve was modelled on faces the other way now; the sleeve lies on the body all the same."""
    body, body_faces = tube(41, 40, 0.3, 0.05)
    sleeve, faces = tube(21, 40, 0.15, 0.054)
    simulation = ClothSimulation(build_cloth_model(sleeve, faces, Fabric()), body_faces, body, device=device)
    radial = sleeve * [0.0, 1.0, 1.0] / np.linalg.norm(sleeve[:, 1:], axis=1, keepdims=True)
    simulation.set_outward(-radial)
    simulation.start(sleeve)
    for _ in range(3):
        simulation.follow(body, simulation.positions[0])
    assert simulation.settle(0.3, 80).converged
    # A millimetre less than its radius: the body has 40 sides.
    assert np.linalg.norm(simulation.positions[0, :, 1:], axis=1).min() > 0.049
