"""Setting a garment up: a fine copy of it with weights, its joints found, settings stored on the object."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from ..bake import BakeJob
from ..garment import (
    Body,
    Garment,
    SkinWeights,
    bind_to_surface,
    check_body,
    check_fit,
    check_surface,
    skin_garment,
    split_vertices,
)
from ..joints import JointSearch, find_joints
from ..place import Part, Place, PlacedError
from ..plan import SamplePlan, budget_plan, paper_plan
from ..rig import Joint, Rig
from ..self_overlap import leave_out_overlaps
from ..symmetry import find_mirror, require_mirror, symmetric_limits
from ..wearer import BakeSettings
from .character import SamplingStage, apply, check_objects, read_garment, read_mesh, rig_from_world, sampling_stage
from .plan_preview import signs_text
from .removal import remember_garment
from .shape_marks import Marks, shape_marks

LEAST_VERTICES = 10_000
MOST_SUBDIVISIONS = 4
SUFFIX = ".wrinkles"


@dataclass(frozen=True, eq=False)
class SetupResult:
    """What setting up made and found.

    Attributes:
        garment: The object that will wrinkle.
        search: The joints found, and what was considered for the others.
        notes: Sentences on what was deceiving or is doubtful.
        joints: The joints that move this garment, which will be sampled.
    """

    garment: bpy.types.Object
    search: JointSearch
    joints: tuple[str, ...]
    notes: tuple[str, ...]


def find_armature(garment: bpy.types.Object, body: bpy.types.Object) -> bpy.types.Object | None:
    """The armature that moves the body, else the garment: of an Armature modifier, or the parent."""
    for ob in (body, garment):
        for modifier in ob.modifiers:
            if modifier.type == "ARMATURE" and modifier.object:
                return modifier.object
        if ob.parent and ob.parent.type == "ARMATURE":
            return ob.parent
    return None


def setup_garment(
    garment: bpy.types.Object,
    body: bpy.types.Object,
    armature: bpy.types.Object | None = None,
    subdivide: int | None = None,
) -> SetupResult:
    """Make a garment ready to be baked.

    A garment of fewer than 10,000 vertices gets a finer copy, ``NAME.wrinkles``, beside it, and is hidden; a fine one
    is used as it is. Weights come from the body, smoothed over the garment.

    Args:
        garment: The garment, worn by the body in the rig's rest pose.
        body: The body.
        armature: The rig; left out, the one that moves the body.
        subdivide: Levels of subdivision; left out, as many as it takes.

    Raises:
        ValueError: One sentence that says what cannot be used and why.
    """
    if garment == body:
        raise ValueError("Garment and body are the same object; choose two.")
    armature = armature or find_armature(garment, body)
    check_objects(garment, body, armature)
    assert armature is not None
    with sampling_stage(armature, body) as stage:
        check_body(stage.body)
        mesh = rest_mesh(garment, subdivide)
        try:
            # The artist's own mesh first: its faults are told in its own numbers.
            check_surface(garment.name, *read_mesh(garment.data))
            positions, faces = read_mesh(mesh)
            check_surface(garment.name, positions, faces)
            to_rig = rig_from_world(armature) @ np.array(garment.matrix_world, np.float64)
            worn = apply(to_rig, positions)
            distance = bind_to_surface(worn, stage.body.positions, stage.body.faces).distance
            check_fit(garment.name, worn, stage.body, distance)
            weights = skin_garment(worn, faces, stage.body)
        except BaseException:
            bpy.data.meshes.remove(mesh)
            raise
        rig, body_mesh = stage.rig, stage.body
    if mesh_differs(garment, mesh):
        fine = place_copy(garment, mesh)
    else:
        fine = garment
        fine.wrinkles.before = remember_garment(garment)
        bpy.data.meshes.remove(mesh)
    write_weights(fine, rig, weights)
    bind_to_armature(fine, armature)
    search = find_joints(rig)
    settings = fine.wrinkles
    settings.armature, settings.body = armature, body
    settings.original = garment if fine is not garment else None
    used = [joint for joint in search.found if moves(joint, rig, weights)]
    settings.joints.clear()
    for joint in used:
        settings.joints.add().store(joint)
    worn_garment = Garment(fine.name, worn, faces, weights, np.zeros(len(worn), np.float32))
    Symmetry.find(rig, used, worn_garment, body_mesh, shape_marks(fine)).remember(fine)
    if not settings.database:
        settings.database = f"//{bpy.path.clean_name(garment.name)}.wrinkles"
    split = len(split_vertices(positions, faces))
    sewn = f"{split} vertices of '{garment.name}' lie where others do and will come apart; merge vertices by distance."
    return SetupResult(fine, search, tuple(joint.name for joint in used), (*search.notes, *([sewn] if split else [])))


@dataclass(frozen=True)
class Symmetry:
    """What a garment remembers of its character's symmetry.

    Attributes:
        signs: How the angles of its joints mirror; empty if they do not.
        asymmetry: Why not; empty if they do.
        marks: The shapes that it was found on.
    """

    signs: str
    asymmetry: str
    marks: Marks

    @staticmethod
    def find(rig: Rig, joints: Sequence[Joint], worn: Garment, body: Body, marks: Marks) -> Symmetry:
        try:
            return Symmetry(signs_text(require_mirror(rig, joints, worn, body)), "", marks)
        except PlacedError as error:
            return Symmetry("", str(error), marks)

    def remember(self, garment: bpy.types.Object) -> None:
        settings, marks = garment.wrinkles, json.dumps(self.marks)
        # What is as it was is not written, so that looking changes nothing.
        found = self.signs, self.asymmetry, marks
        if (settings.mirror_signs, settings.asymmetry, settings.symmetry_marks) != found:
            settings.mirror_signs, settings.asymmetry, settings.symmetry_marks = found


def rest_mesh(garment: bpy.types.Object, subdivide: int | None) -> bpy.types.Mesh:
    """A new mesh of the garment's rest shape: all modifiers before its Armature modifier, then subdivided.

    Raises:
        ValueError: If the garment cannot be made fine enough.
    """
    copy = garment.copy()
    copy.data = garment.data.copy()
    scene = bpy.data.scenes.new("Wrinkle Setup")
    made = [copy.data, copy, scene]
    try:
        scene.collection.objects.link(copy)
        found = False
        for modifier in list(copy.modifiers):
            found = found or modifier.type == "ARMATURE" or modifier.name == "Wrinkles"
            if found:
                copy.modifiers.remove(modifier)
        levels = subdivide if subdivide is not None else _levels(len(copy.data.vertices))
        if levels:
            subdivision = copy.modifiers.new("Subdivision", "SUBSURF")
            subdivision.levels = subdivision.render_levels = levels
        layer = scene.view_layers[0]
        layer.update()
        return bpy.data.meshes.new_from_object(copy.evaluated_get(layer.depsgraph))
    finally:
        bpy.data.batch_remove(made[::-1])


def _levels(vertex_count: int) -> int:
    """Subdivisions until there are enough vertices; each makes about four of one."""
    levels = 0
    while vertex_count < LEAST_VERTICES and levels < MOST_SUBDIVISIONS:
        vertex_count *= 4
        levels += 1
    return levels


def mesh_differs(garment: bpy.types.Object, mesh: bpy.types.Mesh) -> bool:
    """Whether the garment needs a copy: it was subdivided, or modifiers before its armature shape it."""
    if len(garment.data.vertices) != len(mesh.vertices) or garment.data.users > 1 or garment.data.library:
        return True
    return bool(np.abs(read_mesh(garment.data)[0] - read_mesh(mesh)[0]).max() > 1e-6)


def place_copy(garment: bpy.types.Object, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """A new object of a finer mesh beside the garment, which is hidden; an earlier copy is replaced."""
    name = garment.name + SUFFIX
    hidden = garment.hide_viewport, garment.hide_render
    earlier = bpy.data.objects.get(name)
    if earlier is not None and earlier.wrinkles.original == garment:
        hidden = tuple(earlier.wrinkles.original_hidden)
        bpy.data.objects.remove(earlier)
    copy = garment.copy()
    copy.name, mesh.name = name, name
    copy.data = mesh
    copy.animation_data_clear()
    for collection in garment.users_collection:
        collection.objects.link(copy)
    keep_from = next((i for i, m in enumerate(copy.modifiers) if m.type == "ARMATURE"), len(copy.modifiers))
    for modifier in list(copy.modifiers)[:keep_from]:
        copy.modifiers.remove(modifier)
    copy.wrinkles.original_hidden = hidden
    garment.hide_render = True
    garment.hide_viewport = True
    return copy


def write_weights(ob: bpy.types.Object, rig: Rig, weights: SkinWeights) -> None:
    """Replace the object's groups of the rig's bones by these weights; other groups stay."""
    dense = weights.to_dense(rig.bone_count)
    for bone, name in enumerate(rig.names):
        group = ob.vertex_groups.get(name)
        if group is not None:
            ob.vertex_groups.remove(group)
        vertices = np.flatnonzero(dense[:, bone] > 0.0)
        if len(vertices):
            group = ob.vertex_groups.new(name=name)
            for vertex in vertices:
                group.add([int(vertex)], float(dense[vertex, bone]), "REPLACE")


def bind_to_armature(ob: bpy.types.Object, armature: bpy.types.Object) -> None:
    """See to one Armature modifier of this armature, by vertex groups, first in the stack."""
    modifiers = [modifier for modifier in ob.modifiers if modifier.type == "ARMATURE"]
    for extra in modifiers[1:]:
        ob.modifiers.remove(extra)
    modifier = modifiers[0] if modifiers else ob.modifiers.new("Armature", "ARMATURE")
    modifier.object = armature
    modifier.use_vertex_groups, modifier.use_bone_envelopes = True, False
    modifier.use_deform_preserve_volume = False
    modifier.vertex_group = ""
    ob.modifiers.move(list(ob.modifiers).index(modifier), 0)


def moves(joint: Joint, rig: Rig, weights: SkinWeights, least: float = 0.02) -> bool:
    """Whether a joint has cloth on both of its sides: at least this share of the garment's vertices."""
    far = rig.index[joint.far]
    beyond = np.array([bone == far or rig.is_ancestor(far, bone) for bone in range(rig.bone_count)])
    carried = weights.to_dense(rig.bone_count) @ beyond
    return bool((carried > 0.5).mean() >= least and (carried < 0.5).mean() >= least)


# --- from settings to a job ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class JobOrder:
    """What a garment's settings ask for, and the character that they ask it for; without Blender's data.

    Attributes:
        joints: Those of the garment, and whether each is to be sampled.
        budget: Most samples to simulate; None for the paper's plan, with the steps that the artist set [rad].
        symmetric: Whether one side's samples are to serve for the other, where they can.
    """

    rig: Rig
    garment: Garment
    body: Body
    joints: tuple[tuple[Joint, bool], ...]
    budget: int | None
    steps: Mapping[str, float]
    symmetric: bool
    settings: BakeSettings

    @staticmethod
    def of(garment: bpy.types.Object, stage: SamplingStage, worn: Garment) -> JobOrder:
        """
        Args:
            stage: A stage of the garment's armature and body.
            worn: The garment as :func:`read_worn` reads it.

        Raises:
            ValueError: One sentence, if something in the scene does not fit any more.
        """
        settings = garment.wrinkles
        return JobOrder(
            stage.rig,
            worn,
            stage.body,
            tuple((stored_joint(each, stage.rig), each.enabled) for each in settings.joints),
            settings.budget if settings.plan == "BUDGET" else None,
            {joint.name: float(joint.step) for joint in settings.joints if joint.step > 0.0},
            settings.use_symmetry,
            settings.bake_settings(),
        )

    def make(self) -> BakeJob:
        """The bake.

        Raises:
            ValueError: One sentence, if the garment cannot be simulated so.
        """
        joints = [joint for joint, enabled in self.joints if enabled]
        if not joints:
            raise ValueError(
                f"No joint of the garment '{self.garment.name}' is chosen for sampling; add or choose one."
            )
        job = BakeJob(self.rig, self.garment, self.body, self._plan(joints), self.settings)
        plan = leave_out_overlaps(job.plan, self.rig, self.garment, self.body)
        return replace(job, plan=plan) if plan.left_out else job

    def _plan(self, joints: list[Joint]) -> SamplePlan:
        mirror = find_mirror(self.rig, joints, self.garment, self.body) if self.symmetric else None
        if mirror is not None:
            joints = symmetric_limits(joints, mirror)
        if self.budget is not None:
            return budget_plan(joints, self.budget, mirror)
        return paper_plan(joints, mirror, self.steps)


def stage_job(garment: bpy.types.Object, stage: SamplingStage) -> BakeJob:
    """The bake that a garment's settings ask for; see :class:`JobOrder`."""
    return JobOrder.of(garment, stage, read_worn(garment, stage)).make()


def read_worn(garment: bpy.types.Object, stage: SamplingStage) -> Garment:
    """The garment as its settings have it: pins, and the fabric's direction if that counts.

    Raises:
        ValueError: As of :func:`read_garment`.
    """
    settings = garment.wrinkles
    directed = settings.bake_settings().fabric.directed
    return read_garment(garment, stage.rig, rig_from_world(settings.armature), settings.pin_group, directed=directed)


def stored_joint(stored: Any, rig: Rig) -> Joint:
    """A joint of a garment, as its rig still has it.

    Raises:
        PlacedError: If a bone of it is gone.
    """
    joint = stored.joint()
    gone = [name for name in (*joint.bones, *([joint.near] if joint.near else [])) if name not in rig.index]
    if gone:
        raise PlacedError(
            f"Joint {joint.name} uses the bone {gone[0]}, which the armature no longer has; set the garment up again.",
            Place(Part.JOINT, names=(joint.name,)),
        )
    return joint
