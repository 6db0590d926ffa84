"""A garment's recorded animation out of the open scene, a file or an import, with the poses that belong to it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..flow_compress import FlowSource
from ..flow_weights import fit_weights, nearest_weights
from ..garment import SkinWeights, bind_to_surface, check_fit, skin_garment
from ..recordings import Recording, gather, open_recording
from ..rig import FloatArray, Pose, Rig
from ..steps import Steps, portion
from .armature import read_rig
from .character import apply, read_mesh, read_weights, rig_from_world, sampling_stage
from .clip import ClipFrame, read_clip

SCENE = "scene"
"""The recording that is the garment in the scene as its modifiers show it."""

IMPORTERS: dict[str, str] = {".abc": "Alembic", ".usd": "USD", ".usdc": "USD", ".usda": "USD"}

WEIGHTS = ("own", "nearest", "surface", "fit")


@dataclass(frozen=True)
class RecordingChoice:
    """What is to be compressed.

    Attributes:
        recording: SCENE, or path of a file or folder.
        frames: Scene frames of a recording that has none of its own.
        start: Scene frame of the first sample of a file; None for what the file says.
        weights: One of WEIGHTS.
    """

    recording: str
    frames: range
    start: float | None = None
    weights: str = "own"


def read_source(garment: bpy.types.Object, choice: RecordingChoice) -> Steps[FlowSource]:
    """A garment's recording and the poses of its armature, a frame a step.

    Raises:
        ValueError: If the recording is not of this garment, or nothing carries the garment; one sentence.
    """
    if choice.weights not in WEIGHTS:
        raise ValueError(f"There are no weights '{choice.weights}'; choose {', '.join(WEIGHTS)}.")
    armature = garment.wrinkles.armature
    rig = read_rig(armature)
    positions, faces = read_mesh(garment.data)
    if not len(faces):
        raise ValueError(f"The garment '{garment.name}' has no faces; choose a mesh with a surface.")
    rest = apply(rig_from_world(armature) @ np.array(garment.matrix_world, np.float64), positions)
    weights = _start_weights(garment, rig, rest, faces, choice.weights)
    posed = yield from portion(read_posed(garment, rig, choice), 0.0, 0.9)
    if choice.weights == "fit" and posed.recording.vertex_count == len(rest):
        yield 0.9, "fitting weights"
        weights = fit_weights(weights, rest, posed.recording, rig, posed.poses, posed.to_rig)
    return FlowSource(
        posed.recording,
        rig,
        posed.poses,
        posed.to_rig,
        garment.name,
        mesh_topology(garment.data),
        rest,
        weights,
        {"recording": posed.recording.name, "weights": choice.weights},
    )


@dataclass(frozen=True, eq=False)
class PosedRecording:
    """A recording, and per frame the rig's pose and the matrix from the garment's space to rig space [m]."""

    recording: Recording
    poses: list[Pose]
    to_rig: FloatArray


def read_posed(garment: bpy.types.Object, rig: Rig, choice: RecordingChoice) -> Steps[PosedRecording]:
    """A recording of a garment, and the poses of its armature in those frames.

    Raises:
        ValueError: If the recording cannot be read; one sentence.
    """
    recording = yield from portion(_read_recording(garment, choice), 0.0, 0.5)
    clips: list[ClipFrame] = []
    for clip in read_clip(garment, rig, [recording.start + number for number in range(recording.frame_count)]):
        clips.append(clip)
        yield 0.5 + 0.5 * len(clips) / recording.frame_count, f"pose {len(clips)} of {recording.frame_count}"
    to_rig = np.linalg.inv(np.stack([clip.rig_to_garment for clip in clips]))
    return PosedRecording(recording, [clip.pose for clip in clips], to_rig)


def mesh_topology(mesh: bpy.types.Mesh) -> str:
    """Hash of a mesh's faces, however they are cut into triangles."""
    corners, starts = np.empty(len(mesh.loops), np.int32), np.empty(len(mesh.polygons), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    mesh.polygons.foreach_get("loop_start", starts)
    return hashlib.sha256(np.concatenate([[len(mesh.vertices)], corners, starts]).astype("<i8").tobytes()).hexdigest()


def _start_weights(
    garment: bpy.types.Object, rig: Rig, rest: FloatArray, faces: NDArray[np.int32], kind: str
) -> SkinWeights:
    """The garment's own weights, or those of the body under it."""
    if kind in ("own", "fit"):
        dense = read_weights(garment, garment.data, rig)
        bare = int((dense.sum(1) <= 0.0).sum())
        if not bare:
            return SkinWeights.from_dense(dense)
        if kind == "own":
            raise ValueError(
                f"{bare} vertices of the garment '{garment.name}' have no bone weights; "
                "take those of the nearest body vertices."
            )
    if garment.wrinkles.body is None:
        raise ValueError(f"No body is set for the garment '{garment.name}'; choose the mesh it is worn on.")
    with sampling_stage(garment.wrinkles.armature, garment.wrinkles.body) as stage:
        body = stage.body
    check_fit(garment.name, rest, body, bind_to_surface(rest, body.positions, body.faces).distance)
    return skin_garment(rest, faces, body) if kind == "surface" else nearest_weights(rest, body)


def _read_recording(garment: bpy.types.Object, choice: RecordingChoice) -> Steps[Recording]:
    if choice.recording == SCENE:
        return (yield from _record(garment, garment, choice.frames, "the scene"))
    path = Path(choice.recording)
    if path.suffix.lower() in IMPORTERS:
        if not path.is_file():
            raise ValueError(f"There is no recording '{path}'.")
        with _imported(path, len(garment.data.vertices)) as actor:
            return (yield from _record(garment, actor, choice.frames, path.name))
    return open_recording(path, choice.start)


def _record(garment: bpy.types.Object, actor: bpy.types.Object, frames: range, name: str) -> Steps[Recording]:
    """An object as its modifiers show it, in the garment's space."""
    positions = yield from gather(_evaluated_frames(garment, actor, frames), len(frames), name)
    return Recording(name, positions, float(frames.start), np.eye(4))


def _evaluated_frames(
    garment: bpy.types.Object, actor: bpy.types.Object, frames: range
) -> Iterator[NDArray[np.floating]]:
    scene = bpy.context.scene
    before = scene.frame_current, scene.frame_subframe
    expected = len(garment.data.vertices)
    try:
        for frame in frames:
            scene.frame_set(frame)
            depsgraph = bpy.context.evaluated_depsgraph_get()
            evaluated = actor.evaluated_get(depsgraph)
            mesh = evaluated.data
            if len(mesh.vertices) != expected:
                raise ValueError(
                    f"'{actor.name}' has {len(mesh.vertices)} vertices in frame {frame}, the garment's mesh "
                    f"{expected}; switch off the modifiers that change its topology."
                )
            read = np.empty(3 * expected, np.float32)
            mesh.attributes["position"].data.foreach_get("vector", read)
            positions = read.reshape(-1, 3).astype(np.float64)
            if actor is not garment:
                own = np.array(garment.evaluated_get(depsgraph).matrix_world, np.float64)
                positions = apply(np.linalg.inv(own) @ np.array(evaluated.matrix_world, np.float64), positions)
            yield positions
    finally:
        scene.frame_set(before[0], subframe=before[1])


@contextmanager
def _imported(path: Path, vertex_count: int) -> Iterator[bpy.types.Object]:
    """The mesh of an Alembic or USD file that has the garment's number of vertices; gone afterwards."""
    kind = IMPORTERS[path.suffix.lower()]
    if not getattr(bpy.app.build_options, kind.lower(), False):
        raise ValueError(f"This Blender was built without {kind}; record a .pc2 file, or use an official build.")
    known = {ob.session_uid for ob in bpy.data.objects}
    caches = {cache.name for cache in bpy.data.cache_files}
    scene = bpy.context.scene
    span = scene.frame_start, scene.frame_end
    try:
        try:
            if kind == "Alembic":
                bpy.ops.wm.alembic_import(filepath=str(path.resolve()), set_frame_range=False, as_background_job=False)
            else:
                bpy.ops.wm.usd_import(filepath=str(path.resolve()), set_frame_range=False)
        except RuntimeError as error:
            raise ValueError(f"'{path.name}' could not be read: {' '.join(str(error).split())}") from error
        meshes = [ob for ob in bpy.data.objects if ob.session_uid not in known and ob.type == "MESH"]
        fitting = [ob for ob in meshes if len(ob.data.vertices) == vertex_count]
        if not fitting:
            counts = ", ".join(f"{ob.name} with {len(ob.data.vertices)}" for ob in meshes) or "none"
            raise ValueError(
                f"'{path.name}' has no mesh of {vertex_count} vertices, like the garment; its meshes: {counts}."
            )
        yield fitting[0]
    finally:
        scene.frame_start, scene.frame_end = span
        bpy.data.batch_remove([ob for ob in bpy.data.objects if ob.session_uid not in known])
        bpy.data.batch_remove([cache for cache in bpy.data.cache_files if cache.name not in caches])
