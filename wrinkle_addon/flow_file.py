"""A wrinkle flow on disk: one file in safetensors layout that holds all that replaying needs.

    rest          rest positions on a lattice
    weights       bone weights, one channel a bone
    shapes        the mean residual and the components
    coefficients  of every frame
    rig           rest matrices, lengths, parents and gravity of the bones that carry the garment

Weights, shapes and coefficients are integers in an adaptive code (:mod:`.adaptive_code`), rest positions in byte planes
under LZMA, which every Python brings along. The metadata say how to read them, what they were made for, the error that
they promise, and the hash of all of it.
"""

from __future__ import annotations

import hashlib
import lzma
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import storage
from .adaptive_code import LARGEST_RATIO, Surroundings, decode_integers, encode_integers
from .flow_residuals import ResidualSpace, Skinning
from .garment import SkinWeights
from .rig import FloatArray, IntArray, Rig
from .storage import StorageError
from .vertex_hierarchy import VertexHierarchy

FORMAT = 2
SUFFIX = ".flow"

REST_UNIT = 5.0e-5
"""Lattice of the rest positions [m]; the residuals know of its rounding."""

WEIGHT_UNIT = 1.0 / 128.0
"""Step of bone weights; the residuals know of its rounding, too."""

LARGEST_COUNTS = {"vertices": 4_000_000, "frames": 1_000_000, "components": 20_000}
"""What a file may ask for; beyond it, it is taken for damaged."""

_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "lc": 0, "lp": 0, "pb": 0}]
_PACKED = ("rest", "weights", "shapes", "coefficients")


@dataclass(frozen=True, eq=False)
class FlowCode:
    """The integers of a flow, as the file holds them.

    Attributes:
        origin: Rest position of the lattice's corner [m], shape [3].
        hierarchy: Of the garment, which knows its lattice coordinates.
        bone_weights: Of every bone of the rig, shape [vertex_count, bone_count].
        shapes: Mean and components, shape [vertex_count, 3 * (component_count + 1)].
        shape_step: What a unit of these is worth [m].
        coefficients: Differences from frame to frame, shape [frame_count, component_count].
        coefficient_steps: What a unit of these is worth, shape [component_count].
    """

    origin: FloatArray
    hierarchy: VertexHierarchy
    bone_weights: IntArray
    shapes: IntArray
    shape_step: float
    coefficients: IntArray
    coefficient_steps: FloatArray

    @cached_property
    def packed(self) -> dict[str, bytes]:
        """The four arrays of integers as the file has them."""
        around = self.hierarchy.surroundings
        return {
            "rest": pack(np.diff(self.hierarchy.lattice, axis=0, prepend=0)),
            "weights": encode_integers(self.bone_weights, around),
            "shapes": encode_integers(self.shapes, around),
            "coefficients": encode_integers(self.coefficients, Surroundings.in_a_row(len(self.coefficients))),
        }

    @property
    def size(self) -> int:
        """Bytes of the four packed arrays."""
        return sum(map(len, self.packed.values()))


@dataclass(frozen=True)
class FlowHeader:
    """What a flow was made for and what it promises.

    Attributes:
        garment: Name of the garment's object.
        topology: Hash of the garment's triangles.
        start: Scene frame of the first recorded one.
        skinning, space: How residuals were taken.
        rms_mm, max_mm: Errors that no replay at recorded frames goes beyond, over the clip and of any vertex [mm].
        about: What else is worth telling: the recording's name, the weights' source.
        curve: Bytes and root mean square error [mm] of other flows of this recording, as estimated; coarse first.
    """

    garment: str
    topology: str
    start: float
    skinning: Skinning
    space: ResidualSpace
    rms_mm: float
    max_mm: float
    about: Mapping[str, Any]
    curve: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Flow:
    """A wrinkle flow, decoded.

    Attributes:
        header: What it was made for.
        rig: The bones that carry the garment.
        rest: The garment at rest in rig space [m], shape [vertex_count, 3].
        weights: What carries it.
        shapes: Mean and components [m], shape [component_count + 1, vertex_count, 3].
        coefficients: Of every frame, 1 for the mean first, shape [frame_count, component_count + 1].
        stored_bytes: Size of its file; 0 for one that has none.
    """

    header: FlowHeader
    rig: Rig
    rest: FloatArray
    weights: SkinWeights
    shapes: NDArray[np.float32]
    coefficients: NDArray[np.float32]
    stored_bytes: int = 0

    @property
    def frame_count(self) -> int:
        return len(self.coefficients)

    @property
    def component_count(self) -> int:
        return len(self.shapes) - 1

    @property
    def vertex_count(self) -> int:
        return len(self.rest)


# --- integers and what they stand for -----------------------------------------------------------------------------


def encode_rest(rest: FloatArray) -> tuple[FloatArray, IntArray]:
    """Origin and lattice coordinates of rest positions [m], shape [vertex_count, 3].

    Raises:
        ValueError: If the garment is larger than the lattice reaches.
    """
    origin = rest.min(0)
    lattice = np.round((rest - origin) / REST_UNIT)
    if lattice.max() >= 2**20:
        raise ValueError("The garment is more than 50 m across; set the scene's unit scale.")
    return origin, lattice.astype(np.int32)


def decode_rest(origin: FloatArray, lattice: NDArray[np.integer]) -> FloatArray:
    return origin + REST_UNIT * lattice


def decode_weights(hierarchy: VertexHierarchy, codes: IntArray) -> SkinWeights:
    """Skin weights of coded bone weights.

    Raises:
        ValueError: If a vertex has none.
    """
    dense = hierarchy.restore(codes, WEIGHT_UNIT, finer=1.0)
    # Expectations leave traces of bones that are none.
    dense[dense < 0.75 * WEIGHT_UNIT] = 0.0
    return SkinWeights.from_dense(dense)


def decode_flow(header: FlowHeader, rig: Rig, code: FlowCode) -> Flow:
    """What the integers stand for.

    Raises:
        ValueError: If they stand for no garment.
    """
    lattice, hierarchy = code.hierarchy.lattice, code.hierarchy
    count = code.shapes.shape[1] // 3
    shapes = hierarchy.restore(code.shapes, code.shape_step).reshape(len(lattice), count, 3)
    sums = np.cumsum(code.coefficients, axis=0, dtype=np.int64) * code.coefficient_steps
    return Flow(
        header,
        rig,
        decode_rest(code.origin, lattice),
        decode_weights(hierarchy, code.bone_weights),
        np.ascontiguousarray(shapes.transpose(1, 0, 2)),
        np.concatenate([np.ones((len(sums), 1)), sums], 1).astype(np.float32),
    )


def pack(values: IntArray) -> bytes:
    """Integers as LZMA of their byte planes, least significant first, small ones of either sign being small."""
    flat = np.ascontiguousarray(values).reshape(-1).astype(np.int64)
    folded = ((flat << 1) ^ (flat >> 63)).astype(np.uint32)
    planes = max(1, (int(folded.max(initial=0)).bit_length() + 7) // 8)
    data = b"".join((folded >> (8 * plane)).astype(np.uint8).tobytes() for plane in range(planes))
    return bytes([planes]) + lzma.compress(data, lzma.FORMAT_RAW, filters=_FILTERS)


def unpack(data: bytes, shape: tuple[int, ...]) -> IntArray:
    """Integers of :func:`pack`.

    Raises:
        ValueError: If the data are damaged or hold another number of them.
    """
    count = math.prod(shape)
    if not data or not 1 <= data[0] <= 4 or count > 1_000_000 + LARGEST_RATIO * len(data):
        raise ValueError("no byte planes")
    decoder = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=_FILTERS)
    try:
        # Never more than the metadata ask for, whatever the data hold.
        plain = decoder.decompress(data[1:], max_length=data[0] * count + 1)
    except lzma.LZMAError as error:
        raise ValueError("damaged") from error
    if len(plain) != data[0] * count:
        raise ValueError("another number of integers")
    folded = np.zeros(count, np.uint32)
    for plane, part in enumerate(np.frombuffer(plain, np.uint8).reshape(data[0], count)):
        folded |= part.astype(np.uint32) << np.uint32(8 * plane)
    return ((folded >> 1).astype(np.int32) ^ -(folded & 1).astype(np.int32)).reshape(shape)


# --- the file -----------------------------------------------------------------------------------------------------


def write_flow(path: Path, header: FlowHeader, rig: Rig, code: FlowCode) -> int:
    """Write a flow, atomically; returns its size in bytes.

    Raises:
        StorageError: If it cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {name: np.frombuffer(data, np.uint8) for name, data in code.packed.items()} | {
        "rig_parents": rig.parents.astype(np.int32),
        "rig_rest": rig.rest,
        "rig_lengths": rig.lengths,
        "rig_gravity": rig.gravity,
        "origin": code.origin,
        "coefficient_steps": code.coefficient_steps,
    }
    metadata = {
        "format": FORMAT,
        "garment": header.garment,
        "topology": header.topology,
        "start": header.start,
        "skinning": header.skinning.value,
        "space": header.space.value,
        "rms_mm": header.rms_mm,
        "max_mm": header.max_mm,
        "about": dict(header.about),
        "curve": [[size, error] for size, error in header.curve],
        "bones": list(rig.names),
        "vertices": len(code.hierarchy.lattice),
        "frames": len(code.coefficients),
        "components": len(code.coefficient_steps),
        "shape_step": code.shape_step,
    }
    metadata["hash"] = _hash(arrays, metadata)
    storage.write_arrays(path, arrays, metadata)
    return path.stat().st_size


def read_flow(path: Path) -> Flow:
    """Open and decode a flow.

    Raises:
        StorageError: If it is missing, truncated, damaged, of another version or no flow; one sentence.
    """
    arrays, data = storage.read_arrays(path)
    if not isinstance(data, dict) or "shape_step" not in data or "hash" not in data:
        raise StorageError(f"The file '{path}' is no wrinkle flow.")
    if data.get("format") != FORMAT:
        raise StorageError(
            f"The flow '{path}' has format {data.get('format')}, this version reads {FORMAT}; compress it again."
        )
    if data.pop("hash") != _hash(arrays, data):
        raise StorageError(f"The flow '{path}' is damaged: it is not what was written; restore or remake it.")
    try:
        flow = _decode(arrays, data)
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, np.linalg.LinAlgError) as error:
        raise StorageError(f"The file '{path}' holds no flow that can be replayed; compress it again.") from error
    return replace(flow, stored_bytes=path.stat().st_size)


def _decode(arrays: Mapping[str, NDArray[Any]], data: Mapping[str, Any]) -> Flow:
    vertices, frames, components = (int(data[name]) for name in ("vertices", "frames", "components"))
    for name, value in (("vertices", vertices), ("frames", frames), ("components", components)):
        if not (name != "components") <= value <= LARGEST_COUNTS[name]:
            raise ValueError(f"{value} {name}")
    rig = Rig(
        tuple(str(name) for name in data["bones"]),
        arrays["rig_parents"],
        arrays["rig_rest"],
        arrays["rig_lengths"],
        arrays["rig_gravity"],
    )
    steps, origin, step = arrays["coefficient_steps"], arrays["origin"], float(data["shape_step"])
    if steps.shape != (components,) or origin.shape != (3,) or not 0.0 < step < 1.0 or rig.gravity.shape != (3,):
        raise ValueError("steps")
    packed = {name: arrays[name].astype(np.uint8, casting="safe").tobytes() for name in _PACKED}
    hierarchy = VertexHierarchy(np.cumsum(unpack(packed["rest"], (vertices, 3)), axis=0, dtype=np.int32))
    code = FlowCode(
        origin,
        hierarchy,
        decode_integers(packed["weights"], rig.bone_count, hierarchy.surroundings),
        decode_integers(packed["shapes"], 3 * (components + 1), hierarchy.surroundings),
        step,
        decode_integers(packed["coefficients"], components, Surroundings.in_a_row(frames)),
        steps,
    )
    header = FlowHeader(
        str(data["garment"]),
        str(data["topology"]),
        _number(data["start"]),
        Skinning(data["skinning"]),
        ResidualSpace(data["space"]),
        _number(data["rms_mm"]),
        _number(data["max_mm"]),
        dict(data["about"]),
        tuple((int(size), _number(error)) for size, error in data["curve"]),
    )
    flow = decode_flow(header, rig, code)
    if not np.isfinite(flow.shapes).all() or not np.isfinite(flow.coefficients).all():
        raise ValueError("not finite")
    return flow


def _number(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError("not finite")
    return number


def _hash(arrays: Mapping[str, NDArray[Any]], metadata: Mapping[str, Any]) -> str:
    digest = hashlib.sha256(storage.canonical_json(metadata).encode())
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
