"""Meshes that the cloth tests share: sheets, spheres, floors, sleeves and the arms inside them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from wrinkle_synthesis.wrinkle_addon.cloth import STANDARD_GRAVITY, ClothSimulation
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import ClothModel, Fabric, build_cloth_model

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

NO_TOUCH = ContactSettings(self_thickness=0.0)


def raised(positions: Array, height: float) -> Array:
    """The positions, moved up [m]."""
    return positions + np.array([0.0, 0.0, height])


def sheet(columns: int, rows: int, length: float, width: float) -> tuple[Array, Faces]:
    """A rectangle [m] in the plane z = 0 from the origin along x and y, of columns x rows cells with one diagonal."""
    x, y = np.meshgrid(np.linspace(0.0, length, columns + 1), np.linspace(0.0, width, rows + 1), indexing="ij")
    positions = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    faces = []
    for i in range(columns):
        for j in range(rows):
            a, b = i * (rows + 1) + j, (i + 1) * (rows + 1) + j
            faces += [[a, b, b + 1], [a, b + 1, a + 1]]
    return positions, np.array(faces, np.int32)


def floor(height: float = 0.0, size: float = 2.0, cells: int = 4) -> tuple[Array, Faces]:
    """A level square of body, facing up, centred on the z axis."""
    positions, faces = sheet(cells, cells, size, size)
    return positions - np.array([0.5 * size, 0.5 * size, -height]), faces


def sphere(radius: float, subdivisions: int = 3) -> tuple[Array, Faces]:
    """An icosphere about the origin, outward."""
    t = (1.0 + 5.0**0.5) / 2.0
    signs = [(-1, 1), (1, 1), (-1, -1), (1, -1)]
    points = [np.array([a, b * t, 0.0]) for a, b in signs]
    points += [np.array([0.0, a, b * t]) for a, b in signs]
    points += [np.array([b * t, 0.0, a]) for a, b in signs]
    points = np.array([p / np.linalg.norm(p) for p in points])
    # Every three neighbouring points make a face of the icosahedron.
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < 1.1
    faces = [
        [i, j, k]
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    faces = np.array([f if np.linalg.det(points[f]) > 0.0 else [f[0], f[2], f[1]] for f in faces], np.int32)
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        middle = len(points) + inverse.reshape(-1, 3)
        points = np.concatenate([points, points[unique].mean(1)])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        a, b, c = faces.T
        ab, bc, ca = middle.T
        faces = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]).astype(
            np.int32
        )
    return radius * points, faces


def tube(rings: int, around: int, length: float, radius: float) -> tuple[Array, Faces]:
    """An open tube about the x axis, outward, from -length / 2 to length / 2 [m]."""
    x = np.linspace(-0.5 * length, 0.5 * length, rings)
    # Every other ring is turned by half a cell, for triangles that are nearly equilateral.
    angle = 2.0 * np.pi * (np.arange(around)[None, :] + 0.5 * (np.arange(rings)[:, None] % 2)) / around
    positions = np.stack([np.broadcast_to(x[:, None], angle.shape), radius * np.cos(angle), radius * np.sin(angle)], 2)
    faces = []
    for i in range(rings - 1):
        for j in range(around):
            a, b = i * around + j, i * around + (j + 1) % around
            c, d = a + around, b + around
            faces += [[a, b, c], [b, d, c]] if i % 2 == 0 else [[a, d, c], [a, b, d]]
    return positions.reshape(-1, 3), np.array(faces, np.int32)


def closest_point(p: Array, triangle: Array) -> Array:
    """Closest point of one triangle by trying its inside and its three edges, in float64."""
    a, b, c = triangle
    candidates = []
    for start, end in ((a, b), (b, c), (c, a)):
        t = np.clip((p - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
        candidates.append(start + t * (end - start))
    normal = np.cross(b - a, c - a)
    inside = p - normal * ((p - a) @ normal) / (normal @ normal)
    if min(np.cross(v - u, inside - u) @ normal for u, v in ((b, c), (c, a), (a, b))) >= 0.0:
        candidates.append(inside)
    return min(candidates, key=lambda q: np.linalg.norm(p - q))


def bent(positions: Array, angle: float, along: Array, width: float) -> Array:
    """Positions turned about the y axis through the origin by their share of ``angle`` [rad].

    The share rises smoothly from 0 to 1 along the rest coordinate ``along`` [m], like skin weights at an elbow.
    """
    share = 1.0 / (1.0 + np.exp(-4.0 * along / width))[:, None]
    c, s = np.cos(angle), np.sin(angle)
    return (1.0 - share) * positions + share * (positions @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]))


class Sleeve:
    """A loose sleeve on an arm that bends; one end of the sleeve is pinned to the arm.

    Args:
        rings, around: Size of the sleeve's mesh.
        width: Length over which the elbow bends [m]; at 0.12 its crook stays open up to a right angle.
        settings: For the simulation.
    """

    def __init__(self, rings: int, around: int, width: float = 0.12, **settings: object):
        self.width = width
        self.body, self.body_faces = tube(61, 40, 0.6, 0.04)
        self.cloth, self.faces = tube(rings, around, 0.45, 0.055)
        self.angle = 0.0
        model = build_cloth_model(
            self.cloth,
            self.faces,
            Fabric(),
            length_directions=np.tile([1.0, 0.0, 0.0], (len(self.faces), 1)),
            ease=(0.0, 0.06),
        )
        pins = np.zeros(len(self.cloth))
        pins[:around] = 10.0
        self.simulation = ClothSimulation(model, self.body_faces, self.body, pin_stiffness=pins, **settings)
        self.simulation.place_pins(self.cloth)
        self.simulation.start(self.cloth)

    def bend(self, degrees: float, step: float = 3.0) -> None:
        """Bend the arm on to this angle in steps [degrees]; the sleeve follows."""
        end = np.radians(degrees)
        count = max(1, round(abs(end - self.angle) / np.radians(step)))
        for angle in np.linspace(self.angle, end, count + 1)[1:]:
            turn = angle - self.angle
            self.angle = angle
            carried = bent(self.simulation.positions[0], turn, self.cloth[:, 0], self.width)
            self.simulation.place_pins(bent(self.cloth, angle, self.cloth[:, 0], self.width))
            self.simulation.follow(bent(self.body, angle, self.body[:, 0], self.width), carried)


def free_cloth(model: ClothModel, **settings: object) -> ClothSimulation:
    """A garment far away from any body, which does not touch itself."""
    body, faces = floor(-100.0)
    settings = {"contact_settings": NO_TOUCH} | settings
    return ClothSimulation(model, faces, body, **settings)


def patch_on_floor(
    device: str, friction: float = 0.3, static: float | None = None, **settings: object
) -> tuple[ClothSimulation, Array, Array]:
    """A patch that lies on a level floor at rest; returns the simulation, the floor and where the patch lies [m]."""
    rest, faces = sheet(8, 8, 0.1, 0.1)
    rest[:, :2] -= 0.05
    body, body_faces = floor(0.0, 4.0)
    model = build_cloth_model(rest, faces, Fabric(friction=friction, static_friction=static))
    simulation = ClothSimulation(model, body_faces, body, contact_settings=NO_TOUCH, device=device, **settings)
    simulation.start(raised(rest, 0.0025))
    assert simulation.settle(1e-3).converged
    return simulation, body, simulation.positions[0]


def inclined(share: float, friction: float = 0.3) -> tuple[Array, float]:
    """Gravity as on a slope whose tangent is this share of the coefficient of friction, and the slope's angle."""
    angle = float(np.arctan(share * friction))
    return STANDARD_GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)]), angle


def turned(positions, angle):
    c, s = np.cos(angle), np.sin(angle)
    return positions @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
