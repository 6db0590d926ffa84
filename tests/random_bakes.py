"""Bakes drawn at random, as wild as artists' files and wilder: one seed, one character in one garment, one sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from dolls import Array, Doll, tube_along, weights_by_distance
from skeletons import human, scaled
from wrinkle_synthesis.wrinkle_addon.bake import BakeJob
from wrinkle_synthesis.wrinkle_addon.fabrics import FABRICS
from wrinkle_synthesis.wrinkle_addon.garment import Body, Garment, bind_to_surface, skin_garment
from wrinkle_synthesis.wrinkle_addon.joints import find_joints, with_ranges
from wrinkle_synthesis.wrinkle_addon.plan import JointGrid, SamplePlan
from wrinkle_synthesis.wrinkle_addon.rig import Rig
from wrinkle_synthesis.wrinkle_addon.wearer import BakeSettings

PATHS = {
    "arm": ("hand_L", "forearm_L", "upperarm_L", "chest"),
    "leg": ("foot_L", "shin_L", "thigh_L", "pelvis"),
    "trunk": ("pelvis", "spine1", "spine2", "chest", "neck"),
}
RADII = {"arm": 0.04, "leg": 0.06, "trunk": 0.12}

# Degrees of freedom in degrees: what people can do, and a little more.
RANGES = {
    "elbow_L": ("arm", [[-20, 160]]),
    "shoulder_L": ("arm", [[-110, 110], [-150, 150], [-150, 150]]),
    "knee_L": ("leg", [[-20, 165]]),
    "hip_L": ("leg", [[-80, 80], [-135, 135], [-100, 100]]),
    "spine": ("trunk", [[-70, 70], [-50, 50], [-90, 90]]),
}


@dataclass(frozen=True, eq=False)
class RandomBake:
    """A job that bakes one node of one joint's grid; making it may raise the sentence that refuses the garment.

    Attributes:
        part: Limb that the garment is worn on.
        kind: The garment's shape.
        character: The body.
        plan: The one joint and its angles.
        settings: Of the bake.
    """

    part: str
    kind: str
    character: Doll
    plan: SamplePlan
    settings: BakeSettings

    def job(self) -> BakeJob:
        return BakeJob(self.character.rig, self.character.garment, self.character.body, self.plan, self.settings)


def random_bake(seed: int) -> RandomBake:
    """The bake of this seed, always the same."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(list(RANGES)))
    part, ranges = RANGES[name]
    kind = str(rng.choice(list(GARMENTS)))
    scale = float(rng.choice([0.4, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0]))
    rig, body = limb(part)
    positions, faces = GARMENTS[kind](rng, rig, part)
    positions = spoiled(rng, positions, faces)
    if scale != 1.0:
        rig, positions = scaled(rig, scale), scale * positions
        body = replace(body, positions=scale * body.positions)
    pins = (rng.random(len(positions)) < rng.choice([0.0, 0.05])).astype(np.float32)
    garment = Garment(kind, positions, faces, skin_garment(positions, faces, body), pins)
    joint = find_joints(human()).joints[name]
    assert joint is not None
    joint = with_ranges(joint, ranges)
    angles = [random_angles(rng, low, high) for low, high in ranges]
    plan = SamplePlan((JointGrid(joint, tuple(tuple(np.radians(values).tolist()) for values in angles)),))
    settings = BakeSettings(
        fabric=replace(
            FABRICS[str(rng.choice(list(FABRICS)))], material=rng.choice(["plate", "plate", "hinges", "springs"]).item()
        ),
        ease=(float(rng.uniform(-0.02, 0.15)), float(rng.uniform(-0.02, 0.15))),
        turn_step=float(np.radians(rng.choice([3.0, 6.0, 12.0]))),
        settle_iterations=int(rng.choice([20, 50, 50])),
    )
    return RandomBake(part, kind, Doll(rig, body, garment, (joint,)), plan, settings)


def random_angles(rng: np.random.Generator, low: float, high: float) -> list[float]:
    """0 and the end of a range, or one somewhere in it, or 0 alone [degrees]."""
    end = float(rng.choice([low, high])) * float(rng.choice([1.0, rng.uniform(0.1, 1.0), 1.0]))
    return sorted({0.0, end if rng.random() < 0.8 else 0.0})


@cache
def limb(part: str) -> tuple[Rig, Body]:
    """The whole skeleton, and a tube around a part of it."""
    rig = human()
    positions, faces = tube_along(path(rig, part), RADII[part], 61, 20)
    return rig, Body(positions, faces, weights_by_distance(rig, positions, 2.0 * RADII[part]))


def path(rig: Rig, part: str) -> list[Array]:
    return [rig.heads[rig.index[name]] for name in PATHS[part]]


# --- garments -----------------------------------------------------------------------------------------------------


def shell(rng: np.random.Generator, rig: Rig, part: str, gap: float, rings: int = 0) -> tuple[Array, Array]:
    """A tube around a share of the limb, a gap [m] away from its skin."""
    points = path(rig, part)
    cut = rng.uniform(0.0, 0.3)
    points[0] = points[0] + cut * (points[1] - points[0])
    return tube_along(points, RADII[part] + gap, rings or int(rng.integers(9, 40)), int(rng.integers(6, 22)))


def fitting(rng: np.random.Generator, rig: Rig, part: str) -> tuple[Array, Array]:
    return shell(rng, rig, part, rng.uniform(0.002, 0.03))


def inside(rng: np.random.Generator, rig: Rig, part: str) -> tuple[Array, Array]:
    """1 to 20 mm inside the body."""
    return shell(rng, rig, part, -rng.uniform(0.001, 0.02))


def large(rng: np.random.Generator, rig: Rig, part: str) -> tuple[Array, Array]:
    """Two to four times as wide as the limb."""
    return shell(rng, rig, part, RADII[part] * rng.uniform(1.0, 3.0))


def layered(rng: np.random.Generator, rig: Rig, part: str) -> tuple[Array, Array]:
    """Two tubes, one over the other, or through it."""
    inner, inner_faces = shell(rng, rig, part, rng.uniform(0.002, 0.015), 11)
    outer, outer_faces = shell(rng, rig, part, rng.uniform(0.002, 0.015), 11)
    return np.concatenate([inner, outer]), np.concatenate([inner_faces, outer_faces + len(inner)])


def kept(positions: Array, faces: Array, triangles: Array) -> tuple[Array, Array]:
    """A mesh of some of the triangles."""
    vertices, index = np.unique(faces[triangles], return_inverse=True)
    return positions[vertices], index.reshape(-1, 3).astype(np.int32)


def strip(rng: np.random.Generator, rig: Rig, part: str) -> tuple[Array, Array]:
    """A thin strip along the limb, one or two cells wide, that nothing holds."""
    positions, faces = shell(rng, rig, part, rng.uniform(0.0, 0.01), 25)
    around = len(positions) // 25
    columns = faces % around
    width = int(rng.integers(1, 3))
    return kept(positions, faces, (columns <= width).all(1) & (np.ptp(columns, axis=1) <= 1))


def cuff(rng: np.random.Generator, rig: Rig, part: str) -> tuple[Array, Array]:
    """A band around the limb, one or two cells wide."""
    positions, faces = shell(rng, rig, part, rng.uniform(-0.005, 0.01), 25)
    around = len(positions) // 25
    first, width = int(rng.integers(2, 20)), int(rng.integers(1, 3))
    rings = faces // around
    return kept(positions, faces, ((rings >= first) & (rings <= first + width)).all(1))


def scrap(rng: np.random.Generator, rig: Rig, part: str) -> tuple[Array, Array]:
    """One to five triangles."""
    positions, faces = shell(rng, rig, part, rng.uniform(0.0, 0.02), 25)
    first = int(rng.integers(0, len(faces) - 5))
    return kept(positions, faces, np.arange(first, first + int(rng.integers(1, 6))))


GARMENTS: dict[str, Callable[[np.random.Generator, Rig, str], tuple[Array, Array]]] = {
    "fitting": fitting,
    "inside": inside,
    "large": large,
    "layered": layered,
    "strip": strip,
    "cuff": cuff,
    "scrap": scrap,
}


# --- poor triangles -----------------------------------------------------------------------------------------------


def spoiled(rng: np.random.Generator, positions: Array, faces: Array) -> Array:
    """The positions, jittered by up to a third of the edges or left as they are, some triangles drawn to slivers."""
    edges = positions[faces[:, 1]] - positions[faces[:, 0]]
    size = float(np.median(np.linalg.norm(edges, axis=1)))
    positions = positions + size * rng.choice([0.0, 0.1, 0.3]) * rng.uniform(-1.0, 1.0, positions.shape)
    count = int(rng.choice([0, 0, 1, 5]))
    return with_slivers(positions, faces, rng.choice(len(faces), min(count, len(faces)), replace=False))


def with_slivers(positions: Array, faces: Array, triangles: Sequence[int] | Array, aspect: float = 50.0) -> Array:
    """The third corners of some triangles moved to their first edges, so that they are ``aspect`` times as long as
    high."""
    positions = positions.copy()
    for a, b, c in faces[triangles]:
        edge = positions[b] - positions[a]
        length = np.linalg.norm(edge)
        height = positions[c] - positions[a]
        height -= (height @ edge) / length**2 * edge
        positions[c] = positions[a] + 0.4 * edge + (length / aspect) * height / max(np.linalg.norm(height), 1e-12)
    return positions


def depth_inside(character: Doll) -> Array:
    """How deep the garment's vertices lie in the body as modelled [m]."""
    return -bind_to_surface(character.garment.positions, character.body.positions, character.body.faces).distance
