"""Layers that have passed through each other come apart, in a bounded number of passes, and stay apart."""

import numpy as np
import pytest
from cloth_shapes import NO_TOUCH, Sleeve, floor, raised, sheet, sphere, tube
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.surface import BodyVolume, SurfaceMeasures
from wrinkle_synthesis.wrinkle_addon.untangling import MAX_PASSES, untangle

STEP = 0.001


def two_layers(gap=0.008):
    """Two fine sheets above each other, the first below: positions, faces."""
    layer, faces = sheet(20, 20, 0.1, 0.1)
    layer = layer - [0.05, 0.05, 0.0]
    return np.concatenate([layer, raised(layer, gap)]), np.concatenate([faces, faces + len(layer)])


def pushed_through():
    """The middle of the upper layer pushed 16 mm down, through the lower one."""
    positions, faces = two_layers()
    upper = np.arange(len(positions)) >= len(positions) // 2
    distance = np.linalg.norm(positions[:, :2] - 0.0013, axis=1)
    positions[:, 2] -= np.where(upper, 0.016 * np.exp(-((distance / 0.02) ** 2)), 0.0)
    return positions, faces


def corner_through():
    """A corner of the upper layer turned down through the lower one: the contour ends at the border."""
    positions, faces = two_layers()
    upper = np.arange(len(positions)) >= len(positions) // 2
    beyond = np.maximum(positions[:, 0] + 0.9 * positions[:, 1] - 0.03, 0.0)
    positions[:, 2] -= np.where(upper, 0.5 * beyond, 0.0)
    return positions, faces


def folded_sleeve():
    """A tube, one wall of which is pressed through the other from side to side."""
    positions, faces = tube(30, 32, 0.3, 0.04)
    dent = np.exp(-((positions[:, 0] / 0.03) ** 2)) * np.maximum(positions[:, 2], 0.0) / 0.04
    positions[:, 2] -= dent * 0.088
    return positions + 1e-4 * np.random.default_rng(1).normal(size=positions.shape), faces


@pytest.mark.parametrize("tangle", [pushed_through, corner_through, folded_sleeve])
def test_layers_that_pass_through_each_other_come_apart(tangle):
    positions, faces = tangle()
    surface = SurfaceMeasures(faces, len(positions))
    assert len(surface.self_intersections(positions)) > 20
    apart, pierced = untangle(positions, surface, STEP)
    assert len(pierced) <= MAX_PASSES + 1 and pierced[-1] == 0
    assert len(surface.self_intersections(apart)) == 0
    # Only what was tangled has moved, and by about as far as it had gone through.
    moved = np.linalg.norm(apart - positions, axis=1)
    assert moved.max() < 0.04
    assert (moved > 0.0).mean() < 0.5


@pytest.mark.parametrize("tangle", [pushed_through, folded_sleeve])
def test_layers_that_came_apart_settle_apart(device, tangle):
    positions, faces = tangle()
    rest = tube(30, 32, 0.3, 0.04)[0] if tangle is folded_sleeve else two_layers()[0]
    model = build_cloth_model(rest, faces, Fabric())
    body, body_faces = floor(-0.05) if tangle is folded_sleeve else floor(-0.01)
    simulation = ClothSimulation(model, body_faces, body, device=device)
    simulation.start(positions)
    assert simulation.untangle() > 20  # Edges that pierced triangles.
    simulation.settle(1.0, 40)
    for _ in range(3):
        if not simulation.untangle():
            break
        simulation.settle(1.0, 40)
    assert len(SurfaceMeasures(faces, len(rest)).self_intersections(simulation.positions[0])) == 0


def test_time_steps_draw_layers_apart_and_throw_nothing(device):
    positions, faces = pushed_through()
    model = build_cloth_model(two_layers()[0], faces, Fabric())
    body, body_faces = floor(-0.01)
    simulation = ClothSimulation(model, body_faces, body, device=device)
    simulation.start(positions)
    surface, fastest = SurfaceMeasures(faces, len(positions)), 0.0
    for _ in range(6):
        simulation.step(body, 1.0 / 120.0)
        fastest = max(fastest, np.linalg.norm(simulation.state().velocities[0], axis=1).max())
        assert len(surface.self_intersections(simulation.positions[0])) == 0
    # Apart by 16 mm in a step would be 2 m/s; the sheets fall and their dent springs back at 0.5 m/s.
    assert fastest < 1.0


def test_meetings_do_not_depend_on_where_the_garment_was_looked_at_before():
    _, faces = two_layers()
    count = int(faces.max()) + 1
    kept = SurfaceMeasures(faces, count)
    for tangle in (two_layers, pushed_through, corner_through, two_layers, pushed_through):
        positions, _ = tangle()
        for placed in (positions, 3.0 - positions[:, [1, 2, 0]]):
            found, expected = kept.self_crossings(placed), SurfaceMeasures(faces, count).self_crossings(placed)
            assert all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))
            assert (len(found[0]) > 0) == (tangle is not two_layers)


def test_untangling_repeats_to_the_bit():
    positions, faces = pushed_through()
    surface = SurfaceMeasures(faces, len(positions))
    assert np.array_equal(untangle(positions, surface, STEP)[0], untangle(positions, surface, STEP)[0])


def test_what_is_not_tangled_is_left_as_it_is(device):
    positions, faces = two_layers()
    surface = SurfaceMeasures(faces, len(positions))
    apart, pierced = untangle(positions, surface, STEP)
    assert pierced.tolist() == [0] and np.array_equal(apart, positions)
    model = build_cloth_model(positions, faces, Fabric())
    body, body_faces = floor(-1.0)
    through, _ = pushed_through()
    # Nor is a garment that is told to pass through itself.
    simulation = ClothSimulation(model, body_faces, body, contact_settings=NO_TOUCH, device=device)
    simulation.start(through)
    assert simulation.untangle() == 0
    assert np.array_equal(simulation.positions[0], through)


def test_a_tangle_that_cannot_come_apart_is_given_up_and_not_made_worse():
    """Two sheets across each other: their contour is straight from border to border, as short as it can be."""
    layer, faces = sheet(10, 10, 0.1, 0.1)
    layer = layer - [0.05, 0.05, 0.0] + 1e-5 * np.random.default_rng(2).normal(size=layer.shape)
    across = layer[:, [0, 2, 1]] + [0.0021, 0.0013, 0.0]
    positions = np.concatenate([layer, across])
    surface = SurfaceMeasures(np.concatenate([faces, faces + len(layer)]), len(positions))
    before = len(surface.self_crossings(positions)[0])
    apart, pierced = untangle(positions, surface, STEP)
    assert len(pierced) <= MAX_PASSES + 1
    assert len(surface.self_crossings(apart)[0]) <= before == pierced[0]


def test_layers_are_left_alone_where_the_body_cuts_into_itself():
    one, body_faces = sphere(0.1, 3)
    body = np.concatenate([one - [0.06, 0.0, 0.0], one + [0.06, 0.0, 0.0]])
    volume = BodyVolume(body, np.concatenate([body_faces, body_faces + len(one)]))
    left, faces = sphere(0.103, 3)
    cloth = np.concatenate([left - [0.06, 0.0, 0.0], left + [0.06, 0.0, 0.0]])
    # Deep in the lens that both balls share, so that the contour is covered all along.
    cloth *= [1.0, 0.8, 0.8]
    surface = SurfaceMeasures(np.concatenate([faces, faces + len(left)]), len(cloth))
    assert len(surface.self_crossings(cloth)[0]) > 20
    apart, pierced = untangle(cloth, surface, STEP, volume)
    assert pierced.tolist() == [0] and np.array_equal(apart, cloth)


def test_a_sleeve_whose_crook_closes_has_no_layer_through_another(device):
    """The folds in the crook are pressed together at 90 degrees; carried along by the skin they would pass."""
    sleeve = Sleeve(50, 32, width=0.08, device=device)
    sleeve.simulation.settle(1.0)
    sleeve.bend(90.0)
    sleeve.simulation.settle(1.0)
    for _ in range(3):
        if not sleeve.simulation.untangle():
            break
        sleeve.simulation.settle(1.0)
    surface = SurfaceMeasures(sleeve.faces, len(sleeve.cloth))
    assert len(surface.self_intersections(sleeve.simulation.positions[0])) == 0
