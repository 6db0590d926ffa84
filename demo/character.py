"""The demo's person: a MakeHuman body of chosen sex, age and build with its rig and skin weights, as arrays.

The files are MakeHuman's base mesh hm08, its macro targets and two of MPFB's rigs (CC0), see :mod:`.packages`. They
are y-up, facing +z, in decimetres; everything here is z-up, facing -y, in metres, with the soles at z = 0.
"""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..wrinkle_addon import rotations
from ..wrinkle_addon.rig import Rig
from . import packages

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

BODY_VERTEX_COUNT = 13_380
METRES_PER_UNIT = 0.1
ADULT_AGES = (25.0, 90.0)
RIGS = ("cmu_mb", "game_engine")


@dataclass(frozen=True)
class Build:
    """Who the person is.

    Attributes:
        sex: "male" or "female".
        age: Years, from 25 ("young" in MakeHuman) to 90 ("old").
        muscle: From 0 (least) over 0.5 (average) to 1 (most).
        weight: From 0 (thin) over 0.5 (average) to 1 (heavy).
    """

    sex: str = "male"
    age: float = 25.0
    muscle: float = 0.5
    weight: float = 0.5

    def __post_init__(self) -> None:
        if self.sex not in ("male", "female"):
            raise ValueError(f"The demo's body is male or female, not {self.sex!r}.")
        if not ADULT_AGES[0] <= self.age <= ADULT_AGES[1]:
            raise ValueError(f"The demo's body is 25 to 90 years old, not {self.age:g}.")
        if not (0.0 <= self.muscle <= 1.0 and 0.0 <= self.weight <= 1.0):
            raise ValueError("Muscle and weight of the demo's body run from 0 to 1.")


@dataclass(frozen=True, eq=False)
class QuadMesh:
    """A mesh of quads.

    Attributes:
        vertices: Positions [m], shape [vertex_count, 3].
        quads: Vertex indices, counter-clockwise seen from outside, shape [quad_count, 4].
        uvs: Texture coordinates of every corner, shape [quad_count, 4, 2].
    """

    vertices: FloatArray
    quads: IntArray
    uvs: FloatArray

    @cached_property
    def triangles(self) -> IntArray:
        """Every quad split along its first diagonal, shape [2 quad_count, 3]."""
        return self.quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Character:
    """A rigged person.

    Attributes:
        body: The skin, 13,380 vertices.
        weights: Skin weights of the body, rows adding up to 1, shape [13380, bone_count].
        rig: The skeleton; the columns of the weights are its bones.
        shell: MakeHuman's close-fitting shell of trunk and limbs ("helper-tights"), the form garments are built on.
        shell_weights: Skin weights of the shell, shape [shell vertex count, bone_count].
        landmarks: Joint centres [m] by MakeHuman's names ("l-elbow", "neck", ...), each of shape [3].
    """

    body: QuadMesh
    weights: FloatArray
    rig: Rig
    shell: QuadMesh
    shell_weights: FloatArray
    landmarks: dict[str, FloatArray]


def load_character(build: Build | None = None, rig: str = "cmu_mb") -> Character:
    """Build the person from the cached package, downloading it on first use.

    Raises:
        ValueError: If there is no such rig.
        PackageError: If the package cannot be had.
    """
    if rig not in RIGS:
        raise ValueError(f"The demo has the rigs {' and '.join(RIGS)}, not {rig!r}.")
    folder = packages.package_folder(packages.BODY)
    base = _read_base(folder / "3dobjs" / "base.obj")
    groups = _read_groups(folder / "mesh_metadata" / "basemesh_vertex_groups.json")
    vertices = _to_blender_axes(base.vertices + _macro_offsets(folder, build or Build(), len(base.vertices)))
    vertices[:, 2] -= vertices[:BODY_VERTEX_COUNT, 2].min()

    skeleton = _read_rig(folder / "rigs" / "standard" / f"rig.{rig}.json", vertices, groups)
    weights = _read_weights(folder / "rigs" / "standard" / f"weights.{rig}.json", skeleton, len(vertices))
    # The files' weights differ from left to right by up to 0.26, though mesh and rig are symmetric.
    mirror = _read_mirror(folder / "mesh_metadata" / "hm08.mirror")
    weights = 0.5 * (weights + weights[mirror][:, mirrored_bones(skeleton)])
    body, shell = groups["body"], groups["helper-tights"]
    return Character(
        body=_part(base, vertices, body),
        weights=weights[body],
        rig=skeleton,
        shell=_part(base, vertices, shell),
        shell_weights=weights[shell],
        landmarks={
            name.removeprefix("joint-"): vertices[members].mean(0)
            for name, members in groups.items()
            if name.startswith("joint-")
        },
    )


def _to_blender_axes(points: FloatArray) -> FloatArray:
    return METRES_PER_UNIT * np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def _read_base(path: Path) -> QuadMesh:
    vertices: list[list[str]] = []
    uvs: list[list[str]] = []
    corners: list[list[str]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        match line.split():
            case ["v", *values]:
                vertices.append(values[:3])
            case ["vt", *values]:
                uvs.append(values[:2])
            case ["f", *values]:
                corners.append([index for corner in values for index in corner.split("/")[:2]])
    indices = np.array(corners, np.int64).reshape(-1, 4, 2) - 1
    return QuadMesh(np.array(vertices, np.float64), indices[..., 0], np.array(uvs, np.float64)[indices[..., 1]])


def _read_groups(path: Path) -> dict[str, IntArray]:
    ranges = json.loads(path.read_text(encoding="utf-8"))
    return {
        name: np.concatenate([np.arange(first, last + 1, dtype=np.int64) for first, last in spans])
        for name, spans in ranges.items()
    }


def _part(base: QuadMesh, vertices: FloatArray, members: IntArray) -> QuadMesh:
    """The faces between the given vertices, renumbered."""
    number = np.full(len(vertices), -1, np.int64)
    number[members] = np.arange(len(members))
    quads = number[base.quads]
    kept = (quads >= 0).all(1)
    return QuadMesh(vertices[members], quads[kept], base.uvs[kept])


def _macro_offsets(folder: Path, build: Build, vertex_count: int) -> FloatArray:
    """Sum of MakeHuman's macro targets for the build, in the files' own axes and units, shape [vertex_count, 3]."""
    old = (build.age - ADULT_AGES[0]) / (ADULT_AGES[1] - ADULT_AGES[0])
    offsets = np.zeros((vertex_count, 3))
    for age, age_share in (("young", 1.0 - old), ("old", old)):
        shares = {f"caucasian-{build.sex}-{age}": age_share}
        for muscle, muscle_share in _level_shares(build.muscle).items():
            for weight, weight_share in _level_shares(build.weight).items():
                name = f"universal-{build.sex}-{age}-{muscle}muscle-{weight}weight"
                shares[name] = age_share * muscle_share * weight_share
        for name, share in shares.items():
            if share > 0.0:
                offsets += share * _read_target(folder / "targets" / "macrodetails" / f"{name}.target.gz", vertex_count)
    return offsets


def _level_shares(value: float) -> dict[str, float]:
    """Linear interpolation over MakeHuman's three levels."""
    return {
        "min": max(0.0, 1.0 - 2.0 * value),
        "average": 1.0 - abs(2.0 * value - 1.0),
        "max": max(0.0, 2.0 * value - 1.0),
    }


def _read_target(path: Path, vertex_count: int) -> FloatArray:
    with gzip.open(path, "rt", encoding="utf-8") as stream:
        rows = [line.split() for line in stream if line.strip() and not line.startswith("#")]
    table = np.array(rows, np.float64).reshape(-1, 4)
    offsets = np.zeros((vertex_count, 3))
    offsets[table[:, 0].astype(np.int64)] = table[:, 1:]
    return offsets


def _read_rig(path: Path, vertices: FloatArray, groups: dict[str, IntArray]) -> Rig:
    """MPFB's rig on the morphed mesh: bone ends are means of joint cubes or of named vertices, never file positions."""

    def place(end: dict) -> FloatArray:
        match end["strategy"]:
            case "CUBE":
                return vertices[groups[end["cube_name"]]].mean(0)
            case "MEAN":
                return vertices[end["vertex_indices"]].mean(0)
            case "VERTEX":
                return vertices[end["vertex_index"]]
        raise ValueError(f"The rig {path.name} places bones by {end['strategy']!r}, which is not known here.")

    bones = json.loads(path.read_text(encoding="utf-8"))
    names = _parents_first({name: bone["parent"] for name, bone in bones.items()})
    heads = np.stack([place(bones[name]["head"]) for name in names])
    tails = np.stack([place(bones[name]["tail"]) for name in names])
    rest = np.tile(np.eye(4), (len(names), 1, 1))
    for i, name in enumerate(names):
        rest[i, :3, :3] = bone_axes(tails[i] - heads[i], bones[name]["roll"])
    rest[:, :3, 3] = heads
    return Rig(
        names=tuple(names),
        parents=np.array([names.index(p) if (p := bones[name]["parent"]) else -1 for name in names], np.int32),
        rest=rest,
        lengths=np.linalg.norm(tails - heads, axis=1),
        gravity=np.array([0.0, 0.0, -1.0]),
    )


def _parents_first(parents: dict[str, str]) -> list[str]:
    names: list[str] = []
    while len(names) < len(parents):
        names += [name for name, parent in parents.items() if name not in names and (not parent or parent in names)]
    return names


def _read_weights(path: Path, rig: Rig, vertex_count: int) -> FloatArray:
    weights = np.zeros((vertex_count, rig.bone_count))
    for name, pairs in json.loads(path.read_text(encoding="utf-8"))["weights"].items():
        if pairs and name in rig.index:
            table = np.array(pairs, np.float64)
            weights[table[:, 0].astype(np.int64), rig.index[name]] = table[:, 1]
    total = weights.sum(1, keepdims=True)
    return weights / np.where(total > 0.0, total, 1.0)


def _read_mirror(path: Path) -> IntArray:
    """For each vertex of the base mesh its mirror image, shape [vertex_count]."""
    rows = [line.split()[:2] for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    table = np.array(rows, np.int64)
    mirror = np.empty(len(table), np.int64)
    mirror[table[:, 0]] = table[:, 1]
    return mirror


def mirrored_bones(rig: Rig) -> IntArray:
    """For each bone the one that lies mirrored in x = 0, shape [bone_count]."""
    places = np.concatenate([rig.heads, rig.tails], axis=1)
    images = places * np.tile([-1.0, 1.0, 1.0], 2)
    return np.linalg.norm(images[:, None] - places, axis=2).argmin(1)


def bone_axes(direction: ArrayLike, roll: float) -> FloatArray:
    """Axes of a bone in its armature from its direction and roll [rad] as Blender defines them, columns x, y, z.

    The bone is its armature's y axis turned the shortest way onto ``direction``, then about itself by ``roll``
    (Blender's ``vec_roll_to_mat3``); a bone along -y, where the shortest way is free, turns about z.
    """
    y = np.asarray(direction, np.float64)
    y = y / np.linalg.norm(y)
    if 1.0 + y[1] < 1e-9:
        shortest = np.diag([-1.0, -1.0, 1.0])
    else:
        shortest = rotations.to_matrices(rotations.between([0.0, 1.0, 0.0], y))
    return rotations.to_matrices(rotations.from_rotvec(roll * y)) @ shortest
