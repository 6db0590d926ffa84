"""A character of the scene as arrays: its rig, the body that Blender deforms, and the garment on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..cloth_model import FloatArray, IntArray
from ..garment import Body, Garment, SkinWeights, warp_directions
from ..place import Part, Place, PlacedError
from ..rig import Pose, Rig
from .armature import local_matrices, read_rig, rig_scale

MeshArrays = tuple[FloatArray, IntArray]


def rig_from_world(armature: bpy.types.Object, scene: bpy.types.Scene | None = None) -> FloatArray:
    """Matrix that takes world coordinates to rig space [m], shape [4, 4]."""
    to_rig = np.array(armature.matrix_world.inverted(), np.float64)
    to_rig[:3] *= rig_scale(armature, scene)
    return to_rig


def read_mesh(mesh: bpy.types.Mesh) -> MeshArrays:
    """Vertices, shape [vertex_count, 3], and triangles, shape [triangle_count, 3], in the mesh's own space."""
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions)
    mesh.calc_loop_triangles()
    faces = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", faces)
    return positions.reshape(-1, 3).astype(np.float64), faces.reshape(-1, 3)


def read_uvs(mesh: bpy.types.Mesh) -> FloatArray | None:
    """Active texture coordinates of the corners of :func:`read_mesh`'s triangles, shape [triangle_count, 3, 2]."""
    if mesh.uv_layers.active is None:
        return None
    uvs = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers.active.data.foreach_get("uv", uvs)
    mesh.calc_loop_triangles()
    corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("loops", corners)
    return uvs.reshape(-1, 2).astype(np.float64)[corners.reshape(-1, 3)]


def read_weights(ob: bpy.types.Object, mesh: bpy.types.Mesh, rig: Rig) -> FloatArray:
    """Bone weights of a mesh of the object, rows adding up to 1 or to 0, shape [vertex_count, bone_count]."""
    bone_of_group = {group.index: rig.index[group.name] for group in ob.vertex_groups if group.name in rig.index}
    weights = np.zeros((len(mesh.vertices), rig.bone_count))
    for vertex in mesh.vertices:
        for element in vertex.groups:
            bone = bone_of_group.get(element.group)
            if bone is not None:
                weights[vertex.index, bone] = element.weight
    total = weights.sum(1, keepdims=True)
    return weights / np.where(total > 0.0, total, 1.0)


def read_group(ob: bpy.types.Object, name: str) -> np.ndarray:
    """Weights of one vertex group, shape [vertex_count]; zeros for an empty name.

    Raises:
        ValueError: If there is no such group.
    """
    values = np.zeros(len(ob.data.vertices), np.float32)
    if not name:
        return values
    group = ob.vertex_groups.get(name)
    if group is None:
        raise ValueError(f"The garment '{ob.name}' has no vertex group '{name}'.")
    for vertex in ob.data.vertices:
        for element in vertex.groups:
            if element.group == group.index:
                values[vertex.index] = element.weight
    return values


def apply(matrix: NDArray[np.floating[Any]], positions: FloatArray) -> FloatArray:
    """Points under an affine matrix, shape [count, 3]."""
    return positions @ matrix[:3, :3].T + matrix[:3, 3]


@dataclass(frozen=True, eq=False)
class Character:
    """Rig, garment and body of one garment object, in rig space."""

    rig: Rig
    garment: Garment
    body: Body


def check_objects(garment: bpy.types.Object, body: bpy.types.Object | None, armature: bpy.types.Object | None) -> None:
    """Refuse objects of the wrong kind.

    Raises:
        ValueError: One sentence that says which, and what to choose.
    """
    if garment.type != "MESH":
        raise ValueError(f"The garment '{garment.name}' is no mesh; choose a mesh object.")
    if body is None:
        raise ValueError(f"No body is set for the garment '{garment.name}'; choose the mesh it is worn on.")
    if body.type != "MESH":
        raise ValueError(f"The body '{body.name}' is no mesh; choose a mesh object.")
    if not len(body.data.polygons):
        raise ValueError(f"The body '{body.name}' has no faces; choose the mesh that the garment is worn on.")
    if armature is None or armature.type != "ARMATURE":
        raise ValueError(f"The garment '{garment.name}' has no armature; choose the rig that moves the body.")


class SamplingStage:
    """Copies of an armature and a body in a scene of their own, posed at will and evaluated by Blender.

    The copy of the armature has no constraints, drivers or animation, so that any rig's deforming bones can be put
    anywhere; the body keeps its modifiers and shape keys, bound to the copy. The artist's scene is never touched, and
    :meth:`close` takes every copy away again. Used through :func:`sampling_stage`.
    """

    def __init__(self, armature: bpy.types.Object, body: bpy.types.Object):
        self.rig = read_rig(armature)
        self._scale = rig_scale(armature)
        self._made: list[bpy.types.ID] = []
        self._copies: dict[bpy.types.Object, bpy.types.Object] = {}
        try:
            self._scene = self._remember(bpy.data.scenes.new("Wrinkle Sampling"))
            self._scene.unit_settings.scale_length = bpy.context.scene.unit_settings.scale_length
            self._armature = self._copy_armature(armature)
            self._body = self._copy_body(body)
            self._name = body.name
            layer = self._scene.view_layers[0]
            layer.update()
            self._evaluated = self._body.evaluated_get(layer.depsgraph)
            to_rig = np.array(self._armature.matrix_world.inverted(), np.float64)
            to_rig[:3] *= self._scale
            self._to_rig = to_rig @ np.array(self._body.matrix_world, np.float64)
            self.body = self._read_body()
        except BaseException:
            self.close()
            raise

    def positions(self, pose: Pose) -> FloatArray:
        """The body in a pose, in rig space [m], shape [body_vertex_count, 3].

        Raises:
            ValueError: If the body has another number of vertices in this pose than at rest.
        """
        self._apply(pose)
        positions = self._read_positions()
        if len(positions) != len(self.body.positions):
            raise ValueError("The body has another number of vertices when it is posed; make its modifiers keep them.")
        return positions

    def close(self) -> None:
        """Remove every copy."""
        bpy.data.batch_remove([made for made in reversed(self._made) if _is_alive(made)])
        self._made.clear()

    def _remember(self, made):
        self._made.append(made)
        return made

    def _copy_armature(self, armature: bpy.types.Object) -> bpy.types.Object:
        copy = self._remember(armature.copy())
        copy.data = self._remember(armature.data.copy())
        copy.animation_data_clear()
        copy.data.animation_data_clear()
        copy.data.pose_position = "POSE"
        for bone in copy.pose.bones:
            for constraint in list(bone.constraints):
                bone.constraints.remove(constraint)
            bone.matrix_basis = Matrix.Identity(4)
        self._free(copy, armature.matrix_world)
        self._copies[armature] = copy
        # Parents first; the list is asked for in every pose.
        self._bones = sorted(copy.data.bones, key=lambda bone: len(bone.parent_recursive))
        return copy

    def _copy_body(self, body: bpy.types.Object) -> bpy.types.Object:
        copy = self._remember(body.copy())
        copy.data = self._remember(body.data.copy())
        if copy.data.shape_keys:
            self._remember(copy.data.shape_keys)
        self._free(copy, body.matrix_world)
        self._copies[body] = copy
        for modifier in copy.modifiers:
            for name in modifier.bl_rna.properties.keys():
                other = getattr(modifier, name)
                if isinstance(other, bpy.types.Object):
                    setattr(modifier, name, self._copy_of(other))
        if body.parent in self._copies and body.parent_type == "ARMATURE":
            # Deformed by its parent alone; the copy has none.
            copy.modifiers.new("Armature", "ARMATURE").object = self._copies[body.parent]
        self._rebind_drivers(copy)
        return copy

    def _copy_of(self, other: bpy.types.Object) -> bpy.types.Object:
        """The copy of an object that deforms the body; cages that follow the armature are copied with it."""
        if other in self._copies:
            return self._copies[other]
        if other.type == "MESH" and any(
            modifier.type == "ARMATURE" and modifier.object in self._copies for modifier in other.modifiers
        ):
            return self._copy_body(other)
        return other

    def _rebind_drivers(self, copy: bpy.types.Object) -> None:
        """Let drivers of the copy, such as those of corrective shapes, read the copied armature."""
        for owner in (copy, copy.data, copy.data.shape_keys):
            animation = getattr(owner, "animation_data", None)
            if animation is None:
                continue
            animation.action = None
            for curve in animation.drivers:
                for variable in curve.driver.variables:
                    for target in variable.targets:
                        if target.id in self._copies:
                            target.id = self._copies[target.id]

    def _free(self, copy: bpy.types.Object, matrix_world: Matrix) -> None:
        """Put a copy into the scene, without parent, where its original stands."""
        copy.parent = None
        for constraint in list(copy.constraints):
            copy.constraints.remove(constraint)
        copy.matrix_world = matrix_world
        copy.hide_viewport = False
        self._scene.collection.objects.link(copy)

    def _apply(self, pose: Pose) -> None:
        posed = pose.matrices.copy()
        posed[:, :3, 3] /= self._scale
        for name, matrices in local_matrices(self._armature, self.rig, self._bones, posed[None]).items():
            self._armature.pose.bones[name].matrix_basis = matrices[0]
        self._scene.view_layers[0].update()

    def _read_positions(self) -> FloatArray:
        mesh = self._evaluated.data
        positions = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.attributes["position"].data.foreach_get("vector", positions)
        return apply(self._to_rig, positions.reshape(-1, 3).astype(np.float64))

    def _read_body(self) -> Body:
        mesh = self._evaluated.data
        positions, faces = read_mesh(mesh)
        weights = read_weights(self._body, mesh, self.rig)
        if not weights.any():
            raise PlacedError(
                f"The body '{self._name}' has no vertex groups named like the deforming bones of its armature; "
                "give it weights first.",
                Place(Part.BODY),
            )
        return Body(apply(self._to_rig, positions), faces, weights)


@contextmanager
def sampling_stage(armature: bpy.types.Object, body: bpy.types.Object) -> Iterator[SamplingStage]:
    """A stage that is taken down again whatever happens."""
    stage = SamplingStage(armature, body)
    try:
        yield stage
    finally:
        stage.close()


def read_garment(
    ob: bpy.types.Object, rig: Rig, to_rig: FloatArray, pin_group: str = "", *, directed: bool = False
) -> Garment:
    """A garment object that was set up: its modelled shape and the weights it was given.

    Args:
        to_rig: Matrix from world coordinates to rig space, shape [4, 4].
        directed: Whether its fabric has a direction, which is then read from its UV map.

    Raises:
        ValueError: If vertices carry no weights, or the pin group is missing; one sentence.
    """
    positions, faces = read_mesh(ob.data)
    dense = read_weights(ob, ob.data, rig)
    bare = dense.sum(1) <= 0.0
    if bare.any():
        raise PlacedError(
            f"{int(bare.sum())} vertices of the garment '{ob.name}' have no bone weights; set it up again.",
            Place.of_vertices(Part.GARMENT, bare),
        )
    in_rig = apply(to_rig @ np.array(ob.matrix_world, np.float64), positions)
    uvs = read_uvs(ob.data) if directed else None
    warp = None if uvs is None else warp_directions(in_rig, faces, uvs)
    return Garment(ob.name, in_rig, faces, SkinWeights.from_dense(dense), read_group(ob, pin_group), warp)


def _is_alive(made: bpy.types.ID) -> bool:
    try:
        return made.name is not None
    except ReferenceError:
        return False
