"""What would go wrong with a garment, before it does, and where: the verb ``check`` and the panel's list."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..bake import BakeJob
from ..database import MANIFEST, WrinkleDatabase
from ..garment import check_body, split_vertices, surface_problems
from ..place import Part, Place, PlacedError
from ..plan import SamplePlan
from ..self_overlap import describe_left_out
from ..symmetry import require_mirror
from .character import SamplingStage, check_objects, read_mesh, sampling_stage
from .coarse_layer import NONE, RestShapes, doubt_of
from .files import database_folder
from .matching import check_database
from .setup import JobOrder, Symmetry, read_worn, stored_joint
from .shape_marks import Marks, same_shapes, shape_marks


@dataclass(frozen=True)
class Finding:
    """One thing that there is to know.

    Attributes:
        text: One sentence that says what it is and what to do.
        place: Where to look, if there is such a place.
        stops: Whether it keeps the garment from being baked.
    """

    text: str
    place: Place | None = None
    stops: bool = True


@dataclass(frozen=True, eq=False)
class Found:
    """What was found on a garment.

    Attributes:
        source, marks: What it was found on.
        findings: Problems first.
        plan: The samples that would be baked; None if nothing can be.
    """

    source: tuple[object, ...]
    marks: Marks
    findings: list[Finding]
    plan: SamplePlan | None


_found: dict[int, Found] = {}
"""What was found last, by the session_uid of the garment."""


def found_on(garment: bpy.types.Object) -> Found | None:
    """What was found last; None if nothing was, or if the garment is no longer what it was found on."""
    found = _found.get(garment.session_uid)
    if found is None or found.source != _source_of(garment) or not same_shapes(found.marks, garment):
        return None
    return found


def findings_of(garment: bpy.types.Object) -> list[Finding] | None:
    """The findings of :func:`found_on`."""
    found = found_on(garment)
    return None if found is None else found.findings


def _source_of(garment: bpy.types.Object) -> tuple[object, ...]:
    """What findings are made from besides the character's shape, as far as a redraw of the panel has the time to look:
    settings, how many vertices and which bones there are, and when the database was last baked."""
    settings = garment.wrinkles
    objects = garment, settings.body, settings.armature, settings.coarse
    bones = () if settings.armature is None else tuple(settings.armature.data.bones.keys())
    joints = [
        (each.name, each.definition, tuple(each.low), tuple(each.high), each.step, each.enabled)
        for each in settings.joints
    ]
    plan = settings.plan, settings.budget, settings.use_symmetry, settings.pin_group, settings.coarse_layer
    counts = [len(ob.data.vertices) for ob in objects if ob is not None and ob.type == "MESH"]
    uids = [None if ob is None else ob.session_uid for ob in objects]
    return plan, settings.bake_settings(), settings.database, _baked_at(garment), uids, counts, bones, joints


def _baked_at(garment: bpy.types.Object) -> int | None:
    """When the garment's database was finished [ns]; None if it never was, or has no place yet."""
    try:
        return (database_folder(garment) / MANIFEST).stat().st_mtime_ns
    except (OSError, ValueError):
        return None


# --- the check ----------------------------------------------------------------------------------------------------


def inspect_garment(garment: bpy.types.Object, folder: Path | None = None) -> list[Finding]:
    """Go through the motions of a bake and of playing without simulating, at once.

    Args:
        garment: A garment that was set up.
        folder: Its database; left out, the one that it remembers.
    """
    return conclude_check(garment, CheckOrder.of(garment, folder).make())


@dataclass(frozen=True, eq=False)
class CheckOrder:
    """A garment, its character and its settings, to be checked; without Blender's data.

    Attributes:
        findings: What reading them has told already.
        source, marks: What they were read from.
        job: What would be baked; None if that cannot be, which the findings tell.
        folder: The garment's database; None if it has no place yet.
        shapes: The garment and its coarse mesh, if it has one.
    """

    findings: tuple[Finding, ...]
    source: tuple[object, ...]
    marks: Marks
    job: JobOrder | None = None
    folder: Path | None = None
    shapes: RestShapes | None = None

    @staticmethod
    def of(garment: bpy.types.Object, folder: Path | None = None) -> CheckOrder:
        """See :func:`inspect_garment`."""
        settings, findings = garment.wrinkles, list[Finding]()
        source, marks = _source_of(garment), shape_marks(garment)
        with _noting(findings):
            check_objects(garment, settings.body, settings.armature)
            if garment.data.is_editmode:
                raise PlacedError("Leave edit mode first: what is edited cannot be checked.", Place(Part.GARMENT))
        if findings:
            return CheckOrder(tuple(findings), source, marks)
        findings += _surface_findings(garment)
        job = shapes = None
        with _noting(findings), sampling_stage(settings.armature, settings.body) as stage:
            job = _read_job(garment, stage, findings)
        with _noting(findings):
            folder = folder or database_folder(garment)
        if settings.coarse_layer != NONE:
            with _noting(findings):
                shapes = RestShapes.read(garment)
        return CheckOrder(tuple(findings), source, marks, job, folder, shapes)

    def make(self) -> Checked:
        """Think it through, which takes a moment."""
        findings = list(self.findings)
        job = symmetry = database = None
        if self.job is not None:
            with _noting(findings):
                job = self.job.make()
                joints = [joint for joint, _ in self.job.joints]
                symmetry = Symmetry.find(job.rig, joints, job.garment, job.body, self.marks)
                findings += _job_notes(job, self.job.symmetric)
                database = None if self.folder is None else _look_at(self.folder, job)
        if self.shapes is not None:
            with _noting(findings):
                findings += _notes(doubt_of(self.shapes.name, self.shapes.match()))
        return Checked(self, findings, job, symmetry, database)


@dataclass(frozen=True, eq=False)
class Checked:
    """What was found without Blender.

    Attributes:
        findings: So far.
        job: What would be baked, if anything can be.
        symmetry: The character's; None if there is no job.
        database: What was baked for it, and what there is to say of that.
    """

    order: CheckOrder
    findings: list[Finding]
    job: BakeJob | None
    symmetry: Symmetry | None
    database: tuple[WrinkleDatabase | None, str] | None


def conclude_check(garment: bpy.types.Object, checked: Checked) -> list[Finding]:
    """Look at what only Blender can tell, and keep all that was found for the panel.

    What the garment remembers of its character's symmetry is renewed, where it is another by now.

    Raises:
        ValueError: If garment or settings are no longer what was checked; one sentence.
    """
    settings, findings = garment.wrinkles, list(checked.findings)
    if _source_of(garment) != checked.order.source:
        raise ValueError(f"The garment '{garment.name}' changed while it was checked; check it again.")
    if checked.job is not None:
        with _noting(findings), sampling_stage(settings.armature, settings.body) as stage:
            _check_extremes(stage, checked.job)
    if checked.symmetry is not None:
        checked.symmetry.remember(garment)
    if checked.database is not None:
        database, note = checked.database
        try:
            if database is not None:
                check_database(garment, database.header)
        except ValueError as error:
            note = str(error)
        findings += _notes(note)
    # Problems first.
    findings.sort(key=lambda finding: not finding.stops)
    plan = None if checked.job is None else checked.job.plan
    _found[garment.session_uid] = Found(checked.order.source, checked.order.marks, findings, plan)
    return findings


@contextmanager
def _noting(findings: list[Finding]) -> Iterator[None]:
    """What is refused meanwhile is a finding."""
    try:
        yield
    except ValueError as error:
        findings.append(Finding(str(error), getattr(error, "place", None)))


def _notes(text: str) -> Sequence[Finding]:
    return [Finding(text, stops=False)] if text else []


def _surface_findings(garment: bpy.types.Object) -> list[Finding]:
    """What is wrong with the mesh."""
    positions, faces = read_mesh(garment.data)
    findings = [Finding(str(error), error.place) for error in surface_problems(garment.name, positions, faces)]
    if len(split := split_vertices(positions, faces)):
        text = f"{len(split)} vertices of '{garment.name}' lie where others do and will come apart; merge by distance."
        findings.append(Finding(text, Place.of_vertices(Part.GARMENT, split), stops=False))
    return findings


def _read_job(garment: bpy.types.Object, stage: SamplingStage, findings: list[Finding]) -> JobOrder | None:
    """What would be baked, or what is wrong with the joints, the body and the garment's weights."""
    for stored in garment.wrinkles.joints:
        with _noting(findings):
            stored_joint(stored, stage.rig)
    with _noting(findings):
        check_body(stage.body)
    worn = read_worn(garment, stage)
    return None if any(finding.stops for finding in findings) else JobOrder.of(garment, stage, worn)


def _check_extremes(stage: SamplingStage, job: BakeJob) -> None:
    """Pose the body at the end of every range.

    Raises:
        PlacedError: If it falls apart there.
    """
    for sample in job.plan.samples:
        grid = job.plan.grid[sample.joint]
        if all(i in (0, n - 1) for i, n in zip(sample.index, grid.shape, strict=True)):
            if not np.isfinite(stage.positions(job.pose(sample))).all():
                raise PlacedError(
                    f"The body falls apart when joint {sample.joint} is turned to the end of its range.",
                    Place(Part.JOINT, names=(sample.joint,)),
                )


def _job_notes(job: BakeJob, symmetric: bool) -> list[Finding]:
    """How much would be baked and what is left out, and why both sides are simulated, if one could serve for both."""
    notes = [
        *_notes(f"{len(job.plan.samples) + 1} samples of {job.garment.vertex_count} vertices would be baked."),
        *_notes(describe_left_out(job.plan)),
    ]
    if symmetric and job.plan.mirror is None:
        try:
            require_mirror(job.rig, [grid.joint for grid in job.plan.grids], job.garment, job.body)
        except PlacedError as error:
            notes.append(Finding(f"Both sides are simulated. {error}", error.place, stops=False))
    return notes


def _look_at(folder: Path, job: BakeJob) -> tuple[WrinkleDatabase | None, str]:
    """The garment's database, and what there is to say of it, which a bake would mend."""
    if not (folder / MANIFEST).exists():
        return None, f"The database '{folder}' is not baked yet."
    try:
        database = WrinkleDatabase.open(folder, check_hashes=True)
    except ValueError as error:
        return None, str(error)
    if database.header.key == job.key:
        return database, f"The database '{folder}' is complete and up to date."
    note = f"The database '{folder}' was baked with other settings, weights or body; it plays as it was baked."
    return database, note


# --- taking the artist there --------------------------------------------------------------------------------------


def show_place(context: bpy.types.Context, garment: bpy.types.Object, place: Place) -> None:
    """Make the object active and select the vertices or bones, in the mode where they can be seen.

    Raises:
        ValueError: If what is to be shown is gone, or hidden from the view layer; one sentence.
    """
    settings = garment.wrinkles
    ob = {Part.GARMENT: garment, Part.BODY: settings.body}.get(place.part, settings.armature)
    if ob is None or ob.name not in context.view_layer.objects:
        raise ValueError(f"The {place.part.value} is not in this view layer; show it first.")
    if context.object is not None and context.object.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    ob.hide_set(False)
    for other in context.selected_objects:
        other.select_set(False)
    ob.select_set(True)
    context.view_layer.objects.active = ob
    if place.part is Part.JOINT:
        _select_bones(ob, _bones_of(settings, place.names[0]))
        settings.active_joint = settings.joints.find(place.names[0])
    elif place.names:
        _select_bones(ob, place.names)
    elif place.vertices:
        _select_vertices(ob, place.vertices)


def _bones_of(settings: Any, joint: str) -> Sequence[str]:
    stored = settings.joints[joint].joint()
    return (*stored.bones, *([stored.near] if stored.near else []))


def _select_bones(armature: bpy.types.Object, names: Sequence[str]) -> None:
    bpy.ops.object.mode_set(mode="POSE")
    for bone in armature.pose.bones:
        # Bones were selected on the armature's data until Blender 5.0.
        holder = bone if hasattr(bone, "select") else bone.bone
        holder.select = bone.name in names


def _select_vertices(ob: bpy.types.Object, vertices: Sequence[int]) -> None:
    mesh = ob.data
    # Under another selecting mode, edit mode would drop vertices whose edges or faces are not selected.
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_mode(type="VERT")
    bpy.ops.object.mode_set(mode="OBJECT")
    chosen = np.zeros(len(mesh.vertices), bool)
    chosen[[vertex for vertex in vertices if vertex < len(chosen)]] = True
    for elements in (mesh.edges, mesh.polygons):
        elements.foreach_set("select", np.zeros(len(elements), bool))
    mesh.vertices.foreach_set("select", chosen)
    bpy.ops.object.mode_set(mode="EDIT")
