"""A character's coarse layers as arrays: what a coarse simulation is of, and what drives it, frame by frame.

All garments on one armature that follow a simulation and name the same cache folder are simulated together. Everything
is in world axes, in metres.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..bake import SOLVER_VERSION
from ..body_proxy import BodyProxy, make_body_proxy
from ..cloth_model import build_cloth_model
from ..coarse_bake import CoarseHistory, SceneFrame
from ..coarse_cache import CoarseCache, CoarseSpec, Motion, Points
from ..coarse_simulation import CoarseLayer, CoarseSimulation, CoarseState
from ..coarse_version import source_version
from ..wearer import limb_directions, worn_limbs
from .character import read_garment, read_group, read_mesh, rig_from_world, sampling_stage

SIMULATION = "SIMULATION"
"""A garment's coarse layer is our own simulation of its coarse mesh."""
BODY_POINTS = 256
"""Vertices of the body, at most, by which its motion is told from another one."""
BONE_ARM = 0.1
"""How far from a bone's head the points lie by which its turn is told [m]."""


def simulated_garments(garment: bpy.types.Object, scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The garments that are simulated together with one, itself included, from the innermost to the outermost."""
    own = garment.wrinkles
    together = [
        ob
        for ob in scene.objects
        if ob.type == "MESH"
        and ob.wrinkles.armature == own.armature
        and ob.wrinkles.coarse_layer == SIMULATION
        and ob.wrinkles.coarse_cache == own.coarse_cache
        and ob.wrinkles.coarse is not None
    ]
    return sorted(together, key=lambda ob: (ob.wrinkles.coarse_order, ob.name))


def cache_folder(garment: bpy.types.Object) -> Path:
    """Folder of the cache that a garment names.

    Raises:
        ValueError: If none is set, or it is relative to a file that was never saved.
    """
    path = garment.wrinkles.coarse_cache
    if not path:
        raise ValueError(f"The garment '{garment.name}' has no folder for its coarse simulation; choose one.")
    if path.startswith("//") and not bpy.data.filepath:
        raise ValueError("The coarse simulation lies beside the file, and the file was never saved; save it first.")
    return Path(bpy.path.abspath(path))


# --- what a simulation is of --------------------------------------------------------------------------------------


def read_spec(garments: Sequence[bpy.types.Object], scene: bpy.types.Scene) -> CoarseSpec:
    """What a simulation of these garments would be of, as the scene is now."""
    return CoarseSpec(
        garments={ob.name: _garment_hash(ob) for ob in garments},
        body=_hash(*read_mesh(garments[0].wrinkles.body.data)),
        settings={ob.name: {**_settings(ob), "body_proxy": _proxy_size(garments)} for ob in garments},
        fps=frame_rate(scene),
        solver=f"{SOLVER_VERSION}.{source_version()}",
    )


def frame_rate(scene: bpy.types.Scene) -> float:
    """Frames a second."""
    return float(f"{scene.render.fps / scene.render.fps_base:.6g}")


def _settings(garment: bpy.types.Object) -> dict[str, object]:
    settings = garment.wrinkles
    return {**asdict(settings.coarse_settings()), "ease": list(settings.bake_settings().ease)}


def _proxy_size(garments: Sequence[bpy.types.Object]) -> int:
    """Vertices of the body that garments collide with: the innermost one's choice; 0 for the body itself."""
    return int(garments[0].wrinkles.coarse_proxy)


def _garment_hash(garment: bpy.types.Object) -> str:
    """Of the coarse mesh, its size and its pins."""
    coarse = garment.wrinkles.coarse
    size = np.array([float(f"{axis:.5g}") for axis in coarse.matrix_world.to_scale()])
    return _hash(*read_mesh(coarse.data), size, read_group(coarse, _pins(garment)))


def _pins(garment: bpy.types.Object) -> str:
    """The garment's pins as far as its coarse mesh has them."""
    name = garment.wrinkles.pin_group
    return name if name in garment.wrinkles.coarse.vertex_groups else ""


def _hash(*arrays: NDArray) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]


def build_history(garments: Sequence[bpy.types.Object], cache: CoarseCache, device: str) -> CoarseHistory:
    """The simulation that fills a cache. Makes a stage of the character for a moment: not while Blender evaluates.

    Raises:
        ValueError: If something cannot be simulated; one sentence.
    """
    settings = garments[0].wrinkles
    to_rig = rig_from_world(settings.armature)
    with sampling_stage(settings.armature, settings.body) as stage:
        size, body = _proxy_size(garments), stage.body
        proxy = make_body_proxy(body.positions, body.faces, size) if size else None
        if proxy is not None:
            body = proxy.of_body(body)
        layers = []
        for ob in garments:
            coarse, chosen, baked = ob.wrinkles.coarse, ob.wrinkles.coarse_settings(), ob.wrinkles.bake_settings()
            read = read_garment(coarse, stage.rig, to_rig, _pins(ob), directed=baked.fabric.directed)
            model = build_cloth_model(
                read.positions,
                read.faces,
                chosen.worn_fabric,
                length_directions=limb_directions(stage.rig, read),
                warp_directions=read.warp,
                ease=baked.ease,
            )
            limbs = worn_limbs(stage.rig, read, body)
            layers.append(CoarseLayer(ob.name, read.positions, read.faces, chosen, read.pins, model=model, limbs=limbs))
        simulation = CoarseSimulation(layers, body.faces, body.positions, device=device)
    carry = _carrier(proxy, len(stage.body.positions)) if proxy is not None else None
    return CoarseHistory(simulation, cache, CoarseState, carry)


def _carrier(proxy: BodyProxy, count: int) -> Callable[[Points], Points]:
    """What takes a body of this many vertices to its proxy; refuses another body as the simulation itself would."""

    def carry(body: Points) -> Points:
        if len(body) != count:
            raise ValueError(
                f"The body has {count} vertices, but {len(body)} in this frame; "
                "it must keep its mesh over the whole motion."
            )
        return proxy.carry(body)

    return carry


# --- what drives it -----------------------------------------------------------------------------------------------


def read_scene(garments: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> SceneFrame:
    """The body and the skinned layers in the depsgraph's frame.

    Raises:
        ValueError: If a garment is hidden, or the body or a coarse mesh is not there; one sentence.
    """
    for ob in garments:
        if not ob.visible_get():
            raise ValueError(f"The garment '{ob.name}' is hidden; show it to simulate, or switch its coarse layer off.")
    body = read_points(garments[0].wrinkles.body, depsgraph)
    motion: dict[str, Points] = {"body": body[:: -(-len(body) // BODY_POINTS)].copy()}
    motion.update(_armature_motion(garments[0], depsgraph))
    for ob in garments:
        motion.update(_skinned_motion(ob, depsgraph))
    carried = {ob.name: motion[_skinned(ob)] for ob in garments}
    return SceneFrame(depsgraph.scene.frame_current, body, carried, motion)


def _skinned(garment: bpy.types.Object) -> str:
    return f"skinned garment '{garment.name}'"


def read_motion(garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Motion:
    """Points by which the motion of a garment's rig, and its own as Blender skins it, are told from another one."""
    return {**_armature_motion(garment, depsgraph), **_skinned_motion(garment, depsgraph)}


def _armature_motion(garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Motion:
    armature = garment.wrinkles.armature.evaluated_get(depsgraph)
    bones = armature.pose.bones
    matrices = np.empty(16 * len(bones), np.float32)
    bones.foreach_get("matrix", matrices)
    deforming = np.empty(len(bones), np.bool_)
    armature.data.bones.foreach_get("use_deform", deforming)
    axes = matrices.reshape(-1, 4, 4)[deforming].astype(np.float64)
    arm = BONE_ARM / _units(depsgraph)
    points = np.concatenate([axes[:, 3, :3], *(axes[:, 3, :3] + arm * axes[:, k, :3] for k in (0, 1))])
    return {"armature": _in_world(armature, points, depsgraph)}


def _skinned_motion(garment: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Motion:
    return {_skinned(garment): read_points(garment.wrinkles.coarse, depsgraph)}


def read_points(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Points:
    """Vertices of an evaluated mesh object in world axes [m], shape [vertex_count, 3].

    Raises:
        ValueError: If it was not evaluated.
    """
    evaluated = ob.evaluated_get(depsgraph)
    if not evaluated.is_evaluated:
        raise ValueError(f"'{ob.name}' is not part of the scene; put it there.")
    mesh = evaluated.data
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions)
    return _in_world(evaluated, positions.reshape(-1, 3), depsgraph)


def _in_world(evaluated: bpy.types.Object, points: NDArray, depsgraph: bpy.types.Depsgraph) -> Points:
    matrix = np.array(evaluated.matrix_world, np.float64) * _units(depsgraph)
    if np.array_equal(matrix, np.eye(4)):
        return points.astype(np.float32)
    return (points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)


def _units(depsgraph: bpy.types.Depsgraph) -> float:
    return float(depsgraph.scene.unit_settings.scale_length)


def scene_frames(garments: Sequence[bpy.types.Object], first: int, last: int) -> Iterator[SceneFrame]:
    """Step the scene through frames; the frame that it was at comes back afterwards."""
    scene = bpy.context.scene
    before = scene.frame_current, scene.frame_subframe
    try:
        for frame in range(first, last + 1):
            scene.frame_set(frame)
            yield read_scene(garments, bpy.context.evaluated_depsgraph_get())
    finally:
        scene.frame_set(before[0], subframe=before[1])
