"""The wrinkle database on disk: a folder of immutable files and a manifest.

    header-KEY.safetensors      rig, joints, plan, garment and regions: all that synthesis needs to know
    rest-KEY.safetensors        the garment settled in the rest pose
    JOINT-I-J-K-KEY.safetensors one sample: offsets over skinning of the vertices that the joint moves
    manifest.json               names and hashes of all of them; written last

KEY hashes everything a sample depends on, so a file that is present and valid is done, whoever wrote it. A sample
s_J(a) is stored as Q^T (s - x): its distance from the settled rest garment carried by the skin to the sample's pose,
in the frame that the skin turned with it (no paper's form; smaller, and free of seams; docs/database_format.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import rotations, storage
from .corrections import BAKED, Corrections
from .folder_lock import FolderLock, is_locked
from .garment import Garment, Regions, SkinWeights
from .plan import JointGrid, Sample, SamplePlan
from .rig import FloatArray, IntArray, Joint, Pose, Rig, pose_of_angles
from .storage import StorageError
from .symmetry import Mirror, find_mirror

FORMAT = 1
MANIFEST = "manifest.json"

LEAST_OFFSET = 1.0e-4
"""A vertex is stored with a sample if it is displaced by more than this [m]."""

HALF_ERROR = 5.0e-5
"""Offsets are stored as float16 if none loses more than this [m]."""


@dataclass(frozen=True, eq=False)
class DatabaseHeader:
    """What synthesis needs to know of a character and its garment.

    Attributes:
        key: Hash of everything that the samples depend on.
        rig, plan, garment, regions: The character; the plan's mirror is not stored.
        settings: How the samples were made.
    """

    key: str
    rig: Rig
    plan: SamplePlan
    garment: Garment
    regions: Regions
    settings: Mapping[str, Any]

    @property
    def joints(self) -> tuple[Joint, ...]:
        return tuple(grid.joint for grid in self.plan.grids)

    def write(self, folder: Path) -> None:
        rig, garment, regions = self.rig, self.garment, self.regions
        metadata = {
            "format": FORMAT,
            "key": self.key,
            "garment": garment.name,
            "bones": list(rig.names),
            "grids": [_grid_to_json(grid) for grid in self.plan.grids],
            "segments": list(regions.segments),
            "segment_frames": [int(frame) for frame in regions.frames],
            "segment_joints": {name: list(sides) for name, sides in regions.joints.items()},
            "settings": dict(self.settings),
        }
        arrays = {
            "rig_parents": rig.parents,
            "rig_rest": rig.rest,
            "rig_lengths": rig.lengths,
            "rig_gravity": rig.gravity,
            "positions": garment.positions,
            "faces": garment.faces,
            "skin_bones": garment.weights.bones,
            "skin_weights": garment.weights.weights,
            "pins": garment.pins,
            **({} if garment.warp is None else {"warp": garment.warp}),
            "bone_segment": regions.bone_segment,
            "vertex_segment": regions.vertex_segment,
        }
        storage.write_arrays(header_path(folder, self.key), arrays, metadata)

    @staticmethod
    def read(folder: Path, key: str) -> DatabaseHeader:
        path = header_path(folder, key)
        arrays, data = storage.read_arrays(path)
        try:
            if data["format"] != FORMAT:
                raise StorageError(
                    f"The database '{folder}' has format {data['format']}, this version reads {FORMAT}; bake again."
                )
            rig = Rig(
                tuple(data["bones"]),
                arrays["rig_parents"],
                arrays["rig_rest"],
                arrays["rig_lengths"],
                arrays["rig_gravity"],
            )
            weights = SkinWeights(arrays["skin_bones"], arrays["skin_weights"])
            if weights.bones.min() < 0 or weights.bones.max() >= rig.bone_count:
                raise StorageError(f"The file '{path}' names bones that its rig does not have; remake it.")
            garment = Garment(
                data["garment"], arrays["positions"], arrays["faces"], weights, arrays["pins"], arrays.get("warp")
            )
            if garment.faces.min() < 0 or garment.faces.max() >= garment.vertex_count:
                raise StorageError(f"The file '{path}' has faces with vertices that are not there; remake it.")
            regions = Regions(
                tuple(data["segments"]),
                tuple(data["segment_frames"]),
                arrays["bone_segment"],
                arrays["vertex_segment"],
                {name: (sides[0], sides[1]) for name, sides in data["segment_joints"].items()},
            )
            plan = SamplePlan(tuple(_grid_from_json(grid) for grid in data["grids"]))
        except (KeyError, IndexError, TypeError) as error:
            raise StorageError(f"The file '{path}' is not a database header of this version; bake again.") from error
        return DatabaseHeader(data["key"], rig, plan, garment, regions, data.get("settings", {}))


def _grid_to_json(grid: JointGrid) -> dict[str, Any]:
    joint = grid.joint
    return {
        "name": joint.name,
        "bones": list(joint.bones),
        "near": joint.near,
        "dof": joint.dof,
        "axes": joint.axes.tolist(),
        "limits": joint.limits.tolist(),
        "shares": joint.shares.tolist(),
        "angles": [list(values) for values in grid.angles],
    }


def _grid_from_json(data: Mapping[str, Any]) -> JointGrid:
    joint = Joint(
        name=data["name"],
        bones=tuple(data["bones"]),
        near=data["near"],
        dof=data["dof"],
        axes=np.array(data["axes"], np.float64),
        limits=np.array(data["limits"], np.float64),
        shares=np.array(data["shares"], np.float64),
    )
    return JointGrid(joint, tuple(tuple(values) for values in data["angles"]))


def header_path(folder: Path, key: str) -> Path:
    return folder / f"header-{key}{storage.ARRAY_SUFFIX}"


def rest_path(folder: Path, key: str) -> Path:
    return folder / f"rest-{key}{storage.ARRAY_SUFFIX}"


def sample_path(folder: Path, key: str, sample: Sample) -> Path:
    return folder / f"{sample.name}-{key}{storage.ARRAY_SUFFIX}"


def sample_frame(header: DatabaseHeader, rest: FloatArray, sample: Sample) -> tuple[FloatArray, FloatArray]:
    """The settled rest garment carried by the skin to a sample's pose, and how the skin turned it.

    Args:
        rest: The settled rest garment [m], shape [vertex_count, 3].

    Returns:
        Positions x_J [m], shape [vertex_count, 3], and quaternions Q_J (w, x, y, z), shape [vertex_count, 4].
    """
    angles = header.plan.angles(sample)
    pose = pose_of_angles(header.rig, header.joints, {sample.joint: angles})
    return skin_frame(header.rig, header.garment.weights, rest, pose)


def carried_over(
    header: DatabaseHeader, rest: FloatArray, sample: Sample, other: Sample, positions: FloatArray
) -> FloatArray:
    """The garment in another sample's pose with the wrinkles of this one [m], shape [vertex_count, 3].

    Args:
        rest: The settled rest garment [m], shape [vertex_count, 3].
        positions: The garment in this sample's pose [m], shape [vertex_count, 3].
    """
    skinned, turns = sample_frame(header, rest, sample)
    offsets = rotations.rotate(rotations.conjugate(turns), positions - skinned)
    skinned, turns = sample_frame(header, rest, other)
    return skinned + rotations.rotate(turns, offsets)


def skin_frame(rig: Rig, weights: SkinWeights, rest: FloatArray, pose: Pose) -> tuple[FloatArray, FloatArray]:
    """x(v) [m] and Q(v) (w, x, y, z) of the default formulation in any pose, shapes [vertex_count, 3] and [.., 4]."""
    return weights.carry(pose.deformations(rig), rest), weights.turn(pose.turns(rig))


def write_sample(
    folder: Path,
    header: DatabaseHeader,
    rest: FloatArray,
    sample: Sample,
    positions: FloatArray,
    report: Mapping[str, Any],
) -> None:
    """Store one sample given by the garment's positions in its pose [m], shape [vertex_count, 3]."""
    _write_offsets(sample_path(folder, header.key, sample), header, rest, sample, positions, report)


def _write_offsets(
    path: Path,
    header: DatabaseHeader,
    rest: FloatArray,
    sample: Sample,
    positions: FloatArray,
    report: Mapping[str, Any],
) -> None:
    skinned, turns = sample_frame(header, rest, sample)
    offsets = rotations.rotate(rotations.conjugate(turns), positions - skinned)
    moved = np.flatnonzero(np.linalg.norm(offsets, axis=1) > LEAST_OFFSET)
    kept = offsets[moved]
    half = kept.astype(np.float16)
    exact_enough = not len(kept) or float(np.linalg.norm(half.astype(np.float64) - kept, axis=1).max()) <= HALF_ERROR
    arrays = {
        "vertices": moved.astype(np.int32),
        "offsets": half if exact_enough else kept.astype(np.float32),
    }
    metadata = {
        "format": FORMAT,
        "key": header.key,
        "joint": sample.joint,
        "index": list(sample.index),
        "angles": header.plan.angles(sample).tolist(),
        "report": dict(report),
    }
    storage.write_arrays(path, arrays, metadata)


def write_rest(folder: Path, header: DatabaseHeader, positions: FloatArray, report: Mapping[str, Any]) -> None:
    """Store the settled rest garment [m], shape [vertex_count, 3]."""
    metadata = {"format": FORMAT, "key": header.key, "report": dict(report)}
    storage.write_arrays(rest_path(folder, header.key), {"positions": positions.astype(np.float64)}, metadata)


@dataclass(frozen=True, eq=False)
class SampleOffsets:
    """A stored sample.

    Attributes:
        vertices: Vertices that it moves, ascending, shape [moved_count].
        offsets: Their offsets over skinning [m], shape [moved_count, 3].
        report: What its source said of it.
    """

    vertices: IntArray
    offsets: NDArray[np.float32]
    report: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class WrinkleDatabase:
    """A complete database, opened for reading.

    Attributes:
        folder: Where it lies.
        header: The character.
        rest: The settled rest garment [m], shape [vertex_count, 3].
        corrections: Samples that count as corrected by hand, not as baked.
    """

    folder: Path
    header: DatabaseHeader
    rest: FloatArray
    corrections: Corrections

    @staticmethod
    def open(folder: Path | str, *, check_hashes: bool = False) -> WrinkleDatabase:
        """Open a finished database, checking that every file it names is there.

        Args:
            check_hashes: Also compare every file with its recorded hash.

        Raises:
            StorageError: One sentence that says what is missing, damaged or of another version.
        """
        folder = Path(folder)
        manifest = read_manifest(folder)
        problems = find_problems(folder, manifest, check_hashes=check_hashes)
        if problems:
            more = f" and {len(problems) - 1} more" if len(problems) > 1 else ""
            raise StorageError(f"The database '{folder}' is incomplete: {problems[0]}{more}; bake it again to mend it.")
        header = DatabaseHeader.read(folder, manifest["key"])
        arrays, _ = storage.read_arrays(rest_path(folder, header.key))
        rest = arrays.get("positions")
        if rest is None or rest.shape != header.garment.positions.shape:
            raise StorageError(f"The rest garment in '{folder}' has another number of vertices; bake again.")
        return WrinkleDatabase(folder, header, rest.astype(np.float64), Corrections.read(folder, header.key))

    def sample(self, sample: Sample) -> SampleOffsets:
        """Read one sample.

        Raises:
            StorageError: If its file is missing, damaged, or from another garment.
        """
        path = self.corrections.path(sample.name) or sample_path(self.folder, self.header.key, sample)
        arrays, metadata = storage.read_arrays(path)
        vertices, offsets = arrays.get("vertices"), arrays.get("offsets")
        count = self.header.garment.vertex_count
        if (
            vertices is None
            or offsets is None
            or vertices.dtype != np.int32
            or offsets.shape != (len(vertices), 3)
            or metadata.get("key") != self.header.key
            or (len(vertices) and (vertices.min() < 0 or vertices.max() >= count))
        ):
            raise StorageError(f"The file '{path}' does not hold a sample of this garment; bake it again.")
        return SampleOffsets(vertices, offsets.astype(np.float32), metadata.get("report", {}))

    def samples(self) -> Iterator[tuple[Sample, SampleOffsets]]:
        for sample in self.header.plan.samples:
            yield sample, self.sample(sample)

    def positions(self, sample: Sample) -> FloatArray:
        """The garment of a sample, in its pose [m], shape [vertex_count, 3]."""
        skinned, turns = sample_frame(self.header, self.rest, sample)
        stored = self.sample(sample)
        offsets = np.zeros_like(skinned)
        offsets[stored.vertices] = stored.offsets
        return skinned + rotations.rotate(turns, offsets)

    def corrected(self, sample: Sample, positions: FloatArray) -> WrinkleDatabase:
        """Store one more version of a sample, which counts from now on; the baked one stays.

        Args:
            positions: The garment in the sample's pose [m], shape [vertex_count, 3].

        Raises:
            StorageError: If another process writes to the folder, or it cannot be written to.
        """
        with FolderLock(self.folder):
            known = Corrections.read(self.folder, self.header.key)
            path = known.next_path(sample.name)
            report = {**self.sample(sample).report, "corrected": True}
            _write_offsets(path, self.header, self.rest, sample, positions, report)
            return replace(self, corrections=known.with_next(sample.name))

    def mirrored(self, sample: Sample) -> tuple[Sample, Mirror] | None:
        """The sample of which one is the mirror image, or that is its own, and the mirror; None if the bake had none.

        Raises:
            StorageError: If one of the two cannot be read.
        """
        header = self.header
        mirror = find_mirror(header.rig, header.joints, header.garment, None)
        other = SamplePlan(header.plan.grids, mirror).reflected(sample)
        if mirror is None or other is None or other == sample:
            return None
        # The bake has looked at the body, too.
        images = {each.name: self.sample(each).report.get("mirrored") for each in (sample, other)}
        return (other, mirror) if images[sample.name] == other.name or images[other.name] == sample.name else None

    def restored(self, sample: Sample, version: int = BAKED) -> WrinkleDatabase:
        """Let an earlier version of a sample count again, by default the baked one.

        Raises:
            ValueError: If there is no such version.
        """
        with FolderLock(self.folder):
            known = Corrections.read(self.folder, self.header.key)
            return replace(self, corrections=known.with_version(sample.name, version))

    @cached_property
    def stored_bytes(self) -> int:
        """Size of the whole folder's database files."""
        manifest = read_manifest(self.folder)
        return sum((self.folder / name).stat().st_size for name in manifest["files"])


def expected_files(folder: Path, key: str, plan: SamplePlan) -> list[Path]:
    """Every file of a finished database but the manifest."""
    samples = [sample_path(folder, key, sample) for sample in plan.samples]
    return [header_path(folder, key), rest_path(folder, key), *samples]


def write_manifest(folder: Path, header: DatabaseHeader) -> None:
    """Record that the database is complete: the names and hashes of its files. Nothing else is written.

    Raises:
        StorageError: If a file is still missing; the message names how many, and the first.
    """
    files = expected_files(folder, header.key, header.plan)
    missing = [path.name for path in files if not path.exists()]
    if missing:
        raise StorageError(
            f"{len(missing)} of {len(files)} files of the database '{folder}' are still to be baked: {missing[0]}."
        )
    manifest = {
        "format": FORMAT,
        "key": header.key,
        "units": {"length": "metre", "angle": "radian"},
        "garment": {"name": header.garment.name, "vertex_count": header.garment.vertex_count},
        "settings": dict(header.settings),
        "plan": {grid.joint.name: [list(values) for values in grid.angles] for grid in header.plan.grids},
        "files": {path.name: storage.file_hash(path) for path in files},
    }
    storage.write_json(folder / MANIFEST, manifest)


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a finished database.

    Raises:
        StorageError: If the folder is missing or holds no manifest of this format.
    """
    if not folder.is_dir():
        raise StorageError(f"There is no database '{folder}'; bake it first.")
    if not (folder / MANIFEST).exists():
        if is_locked(folder):
            raise StorageError(f"The database '{folder}' is just being baked; wait until that is done.")
        raise StorageError(f"The database '{folder}' is not finished; run the bake again, it goes on where it stopped.")
    manifest = storage.read_json(folder / MANIFEST)
    if not isinstance(manifest, dict) or not isinstance(manifest.get("files"), dict):
        raise StorageError(f"The manifest of '{folder}' is damaged; bake again, finished samples are kept.")
    if manifest.get("format") != FORMAT:
        raise StorageError(
            f"The database '{folder}' has format {manifest.get('format')}, this version reads {FORMAT}; bake again."
        )
    return manifest


def find_problems(folder: Path, manifest: Mapping[str, Any], *, check_hashes: bool = True) -> list[str]:
    """What is missing or damaged, one phrase a file: the work still to do."""
    problems = []
    for name, digest in manifest["files"].items():
        path = folder / name
        if not path.exists():
            problems.append(f"{name} is missing")
        elif check_hashes and storage.file_hash(path) != digest:
            problems.append(f"{name} is damaged")
    return problems + Corrections.read(folder, str(manifest.get("key", ""))).problems(check_hashes=check_hashes)
