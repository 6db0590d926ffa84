"""What the cloth solvers are compared on: a sleeve on an arm that bends, strips that hang, and what is measured there.

All of it is arrays; who simulates them is a matter of :mod:`sleeve_solvers`.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from wrinkle_synthesis.wrinkle_addon.cloth import STANDARD_GRAVITY
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import build_cloth_model
from wrinkle_synthesis.wrinkle_addon.fabrics import Fabric
from wrinkle_synthesis.wrinkle_addon.surface import BodyVolume, SurfaceMeasures

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from cloth_shapes import bent, tube

FloatArray = NDArray[np.float64]
Faces = NDArray[np.int32]
Motion = Callable[[float], FloatArray]

FABRIC = Fabric(
    stretch=100.0,
    poisson=1.0 / 3.0,
    stiffening=0.0,
    bending=1.0e-5,
    density=0.15,
    friction=0.3,
    damping=0.01,
    material="hinges",
    rest_bend=1.0,
)
"""What all solvers have words for: a net of springs has a Poisson's ratio of 1/3 and never stiffens, and its hinges
rest at the angles of the shape that they were made on."""
CONTACT = ContactSettings()

LENGTH, RADIUS = 0.45, 0.05
RINGS, AROUND = 59, 35
"""Triangles that are equilateral at rest, as a net of springs needs them to be alike in all directions."""
ARM_LENGTH, ARM_RADIUS = 0.6, 0.04
ELBOW = 0.12
"""Length over which the elbow bends [m]; its crook stays open up to a right angle."""
DEGREES = 60.0
STILL, BEND = 0.25, 1.0
"""The arm is still for so long, then bends [s]."""


@dataclass(frozen=True, eq=False)
class Case:
    """What one simulation is given.

    Attributes:
        rest: The shape in which the cloth holds no stress [m], shape [vertex_count, 3].
        faces: Its triangles.
        pinned: Vertices that are carried, shape [vertex_count].
        carried: All vertices as they would be carried at a time [s]; the cloth starts from them at 0.
        body_faces: Triangles of the body, outward; without any there is no body.
        body: The body's positions at a time [s].
        duration: When carried and body come to a stop [s].
        gravity: Downwards [m/s^2].
    """

    rest: FloatArray
    faces: Faces
    pinned: NDArray[np.bool_]
    carried: Motion
    body_faces: Faces
    body: Motion
    duration: float
    gravity: float = STANDARD_GRAVITY


def make_sleeve(rings: int, around: int) -> Case:
    """A loose sleeve, pinned to the upper arm at one end."""
    body, body_faces = tube(41, 28, ARM_LENGTH, ARM_RADIUS)
    start, faces = tube(rings, around, LENGTH, RADIUS)

    def carry(positions: FloatArray, time: float) -> FloatArray:
        angle = np.radians(DEGREES) * np.clip((time - STILL) / BEND, 0.0, 1.0)
        return bent(positions, angle, positions[:, 0], ELBOW)

    return Case(
        rest=start,
        faces=faces,
        pinned=np.arange(len(start)) < around,
        carried=lambda time: carry(start, time),
        body_faces=body_faces,
        body=lambda time: carry(body, time),
        duration=STILL + BEND,
    )


def make_hanging(rings: int) -> Case:
    """A sleeve of so many rings that hangs from its first one, clear of everything."""
    rest, faces = tube(rings, AROUND, LENGTH * (rings - 1) / (RINGS - 1), RADIUS)
    # Its axis turned from along x to down z.
    upright = np.stack([rest[:, 2], rest[:, 1], -rest[:, 0]], 1)
    return _free(upright, faces, np.arange(len(rest)) < AROUND, STANDARD_GRAVITY)


def make_cantilever(columns: int, rows: int, gravity: float) -> Case:
    """A level strip of the sleeve's own cells, clamped over the first column and left to its weight [m/s^2]."""
    cell, width = LENGTH / (RINGS - 1), 2.0 * np.pi * RADIUS / AROUND
    x, y = np.meshgrid(cell * np.arange(columns + 1), width * np.arange(rows + 1), indexing="ij")
    y = y + 0.5 * width * (np.arange(columns + 1)[:, None] % 2)
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    faces = []
    for i in range(columns):
        for j in range(rows):
            a, c = i * (rows + 1) + j, (i + 1) * (rows + 1) + j
            faces += [[a, c, a + 1], [a + 1, c, c + 1]] if i % 2 == 0 else [[a, c, c + 1], [a, c + 1, a + 1]]
    return _free(flat, np.array(faces, np.int32), flat[:, 0] < 1.5 * cell, gravity)


def _free(rest: FloatArray, faces: Faces, pinned: NDArray[np.bool_], gravity: float) -> Case:
    """Cloth that starts at rest, with no body and nothing carried."""
    nobody = np.zeros((0, 3))
    return Case(rest, faces, pinned, lambda time: rest, nobody.astype(np.int32), lambda time: nobody, 0.0, gravity)


# --- measures -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shape:
    """What is measured of a shape of the sleeve.

    Attributes:
        inside_folds, inside_wave: Folds of a line along the inside of the elbow, and their dominant wavelength [m].
        folds, wave: The same of lines along the whole sleeve, all around.
        relief: Root mean square height of the folds on the inside of the elbow [m].
        mean_strain, most_strain: Mean size of the principal strains, and the largest stretch.
        inside_body: Vertices inside the body; deepest is how far [m].
        self_intersections: Pairs of its triangles that pass through each other.
    """

    inside_folds: float
    inside_wave: float
    folds: float
    wave: float
    relief: float
    mean_strain: float
    most_strain: float
    inside_body: int
    deepest: float
    self_intersections: int


FOLD = 0.001
"""What stands out by less than this is not counted as a fold [m]."""
LONGEST = 0.12
"""Waves longer than this belong to how the sleeve hangs, not to its folds [m]."""


def measure(case: Case, positions: FloatArray) -> Shape:
    """Measure a shape of the sleeve at the end of the motion."""
    offset, along, side = radial_offsets(case, positions)
    crook = np.abs(along - along.mean()) < 0.75 * ELBOW
    inside = side > np.cos(np.radians(45.0))
    strain = principal_strains(case, positions)
    body = BodyVolume(case.body(np.inf), case.body_faces)
    depth = body.depth(positions)[0]
    spacing = float(along[1] - along[0])
    inner = folds_of(offset[crook][:, inside], spacing)
    whole = folds_of(offset, spacing)
    return Shape(
        inside_folds=inner[0],
        inside_wave=inner[1],
        relief=inner[2],
        folds=whole[0],
        wave=whole[1],
        mean_strain=float(np.abs(strain).mean()),
        most_strain=float(strain.max()),
        inside_body=int((depth > 0.0).sum()),
        deepest=float(depth.max()),
        self_intersections=len(SurfaceMeasures(case.faces, len(positions)).self_intersections(positions)),
    )


def radial_offsets(case: Case, positions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How far the cloth stands off the carried sleeve, along lines of it.

    Returns:
        offset: [m], shape [ring, line].
        along: Length of the cloth up to each ring [m].
        side: Cosine between each line's side of the arm and the inside of the elbow, shape [line].
    """
    around = int(case.pinned.sum())
    carried, axis_points = case.carried(np.inf), case.rest * [1.0, 0.0, 0.0]
    axis = bent(axis_points, np.radians(DEGREES), axis_points[:, 0], ELBOW)
    outward = carried - axis
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    offset = ((positions - carried) * outward).sum(1).reshape(-1, around)
    # Every other ring is turned by half a cell: its lines lie between two of its vertices.
    odd = offset[1::2]
    offset[1::2] = 0.5 * (odd + np.roll(odd, 1, axis=1))
    rest = case.rest.reshape(-1, around, 3)
    return offset, rest[:, 0, 0], rest[0, :, 2] / RADIUS


def folds_of(offset: FloatArray, spacing: float) -> tuple[float, float, float]:
    """Folds of lines [m], shape [place, line], with this spacing [m].

    Returns the mean number of ridges that stand out by more than :data:`FOLD`, the wavelength at the peak of the lines'
    mean power spectrum [m] and their root mean square height [m], all without what is longer than :data:`LONGEST`.
    """
    place = np.arange(len(offset))
    # A line's own drift: waves too long to be folds.
    degree = max(1, round(2.0 * len(offset) * spacing / LONGEST))
    trend = np.polynomial.chebyshev.Chebyshev.fit
    waves = np.stack([line - trend(place, line, degree)(place) for line in offset.T], 1)
    count = 16 * len(offset)
    power = (np.abs(np.fft.rfft(waves * np.hanning(len(offset))[:, None], count, axis=0)) ** 2).mean(1)
    frequency = np.fft.rfftfreq(count, spacing)
    folds = frequency > 1.0 / LONGEST
    peak = frequency[folds][power[folds].argmax()]
    return float(np.mean([ridges(line) for line in waves.T])), float(1.0 / peak), float(waves.std())


def ridges(line: FloatArray) -> int:
    """Ridges between valleys that lie deeper by more than :data:`FOLD` [m] on both sides."""
    count, rising, extreme = 0, False, line[0]
    for height in line[1:]:
        if rising == (height > extreme):
            extreme = height
        elif abs(height - extreme) > FOLD:
            count += rising
            rising, extreme = not rising, height
    return count


def principal_strains(case: Case, positions: FloatArray) -> FloatArray:
    """Stretches of every triangle less 1, shape [triangle_count, 2]."""
    inverse = build_cloth_model(case.rest, case.faces, FABRIC).rest_inverse
    corners = positions[case.faces]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], 2)
    return np.linalg.svd(edges @ inverse, compute_uv=False) - 1.0
