"""Grids around limbs: they lie where the rigid motion takes them that fits a pose best."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import tube
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from wrinkle_synthesis.wrinkle_addon.limb_grids import CELL, PosedLimbs, make_grids


def best_fit(rest: NDArray, posed: NDArray) -> tuple[NDArray, NDArray]:
    """Turn, with its scale, and shift that take points of a pose closest to their places at rest."""
    centre, mean = rest.mean(0), posed.mean(0)
    turn = Rotation.align_vectors(rest - centre, posed - mean)[0].as_matrix()
    turn *= np.linalg.norm(rest - centre) / np.linalg.norm(posed - mean)
    return turn, centre - turn @ mean


@pytest.mark.parametrize("unit", [1.0, 100.0])
@pytest.mark.parametrize("away", [0.0, 50.0])
@pytest.mark.parametrize("bent", [0.0, 0.02])
def test_a_limb_lies_where_the_rigid_motion_that_fits_best_takes_it(
    device: str, unit: float, away: float, bent: float
) -> None:
    rng = np.random.default_rng(1)
    limbs = [tube(16, 8, 0.4, 0.05), tube(12, 6, 0.2, 0.03)]
    body = np.concatenate([limbs[0][0], limbs[1][0] + [0.0, 0.3, 0.0]])
    faces = np.concatenate([limbs[0][1], limbs[1][1] + len(limbs[0][0])]).astype(np.int32)
    of_triangles = np.repeat([0, 1], [len(each) for _, each in limbs]).astype(np.int32)
    grids = make_grids(body, faces, of_triangles, 2)
    points = wp.zeros(len(body), dtype=wp.vec3, device=device)
    posed_limbs = PosedLimbs(grids, body, faces, of_triangles, points)
    for _ in range(40):
        posed = body + bent * rng.normal(size=body.shape)
        for members in (of_triangles == 0, of_triangles == 1):
            vertices = np.unique(faces[members])
            posed[vertices] = posed[vertices] @ Rotation.random(random_state=rng).as_matrix().T + rng.normal(size=3)
        posed = unit * (posed + away)
        points.assign(posed.astype(np.float32))
        posed_limbs.move()
        found = posed_limbs.struct.limbs.numpy()
        for number in range(2):
            vertices = np.unique(faces[of_triangles == number])
            chosen = vertices[np.linspace(0, len(vertices) - 1, 64).astype(int)]
            turn, shift = best_fit(body[chosen], posed[chosen])
            cells = (posed[vertices] @ turn.T + shift - grids.origin[number]) / CELL
            frame = found[number]["frame"].astype(np.float64)
            # A hundredth of a cell: in single precision 50 m are known to 4 um, and directions to a millionth.
            np.testing.assert_allclose(posed[vertices] @ frame[:, :3].T + frame[:, 3], cells, atol=0.01)


def test_a_limb_is_not_turned_inside_out(device: str) -> None:
    points, faces = tube(16, 8, 0.4, 0.05)
    of_triangles = np.zeros(len(faces), np.int32)
    posed = wp.array(points * [1.0, 1.0, -1.0], dtype=wp.vec3, device=device)
    limbs = PosedLimbs(make_grids(points, faces, of_triangles, 1), points, faces, of_triangles, posed)
    limbs.move()
    assert np.linalg.det(limbs.struct.limbs.numpy()[0]["frame"][:, :3]) > 0.0
