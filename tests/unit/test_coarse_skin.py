"""Which skin a coarse simulation holds a vertex off while the body moves: the nearest, the right side of it, always."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import closest_point, floor, raised, sheet, sphere
from wrinkle_synthesis.kernels.cloth import frame_steps
from wrinkle_synthesis.kernels.cloth.contact_planes import BodySurface
from wrinkle_synthesis.wrinkle_addon import coarse_simulation
from wrinkle_synthesis.wrinkle_addon.cloth_contact import make_body
from wrinkle_synthesis.wrinkle_addon.coarse_simulation import CoarseLayer, CoarseSettings, CoarseSimulation

FRAME = 1.0 / 30.0


@wp.kernel
def walk(body: BodySurface, points: wp.array[wp.vec3], starts: wp.array[wp.int32], found: wp.array[wp.int32]):
    i = wp.tid()
    face, _w = frame_steps.walk_to_closest(body, points[i], starts[i])
    found[i] = face


def test_the_followed_triangle_is_the_closest_one_though_the_way_leads_past_corners(device):
    """Around a ball every walk goes all the way: nowhere but at the closest place is the surface nearest around."""
    positions, faces = sphere(0.1, 2)
    body, _meshes = make_body(faces, positions[None], device)
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(200, 3))
    points = 0.12 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    centres = positions[faces].mean(1)
    # From a triangle some two edges away, farther than a vertex slides in a step.
    beside = points + 0.02 * rng.normal(size=points.shape)
    starts = np.linalg.norm(centres[None] - beside[:, None], axis=2).argmin(1).astype(np.int32)
    found = wp.zeros(len(points), dtype=wp.int32, device=device)
    given = [wp.array(points, dtype=wp.vec3, device=device), wp.array(starts, dtype=wp.int32, device=device)]
    wp.launch(walk, dim=len(points), inputs=[body, *given], outputs=[found], device=device)
    for point, face in zip(points, found.numpy(), strict=True):
        away = [np.linalg.norm(point - closest_point(point, triangle)) for triangle in positions[faces]]
        # Two triangles that share the closest place are one as good as the other.
        assert away[face] < min(away) + 1e-6


def cloth(size=0.2, cells=6):
    positions, faces = sheet(cells, cells, size, size)
    return positions - [0.5 * size, 0.5 * size, 0.0], faces


def test_skin_that_is_seen_from_the_side_takes_nothing_in(device, monkeypatch):
    """What falls past the edge of a shelf comes under the shelf without having passed through it."""
    monkeypatch.setattr(coarse_simulation, "SETTLE_STEPS", 0)
    shelf, shelf_faces = floor(0.0, 0.4)
    ground, ground_faces = floor(-0.1)
    body = np.concatenate([shelf, ground]), np.concatenate([shelf_faces, ground_faces + len(shelf)])
    patch, faces = cloth()
    # 3 cm beside the shelf, 1 cm above it, and so fast that it is by the ground at the end of the frame.
    start = raised(patch + [0.33, 0.0, 0.0], 0.01)
    settings = CoarseSettings(damping=0.0, pre_roll=0.0)
    simulation = CoarseSimulation([CoarseLayer("Shirt", start, faces, settings)], body[1], body[0], device=device)
    simulation.start(body[0], [start])
    simulation._motion.velocities.assign(np.broadcast_to([0.0, 0.0, -2.4], simulation._motion.velocities.shape + (3,)))
    for _ in range(3):
        report = simulation.step(body[0], [start], FRAME)
        assert report.deepest == 0.0
    # It lies where it fell.
    assert np.abs(simulation.positions[0] - start)[:, :2].max() < 0.002
    assert np.abs(simulation.positions[0][:, 2] - (-0.1 + 0.005)).max() < 0.002


@pytest.mark.parametrize("frames", [1, 5])
def test_what_touches_skin_goes_on_touching_it_when_the_skinned_garment_turns(device, frames):
    """In a groin the skinned garment folds over and faces the body; the cloth itself still lies on the thigh."""
    ground = floor(0.0)
    patch, faces = cloth()
    lies = raised(patch, 0.005)
    turned = lies * [1.0, -1.0, 1.0]
    settings = CoarseSettings(damping=0.0, pre_roll=0.2)
    simulation = CoarseSimulation([CoarseLayer("Shirt", lies, faces, settings)], ground[1], ground[0], device=device)
    simulation.start(ground[0], [lies])
    for _ in range(1 + frames):
        simulation.step(ground[0], [turned], FRAME)
    assert simulation.positions[0][:, 2].min() > 0.0045
