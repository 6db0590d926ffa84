"""The verbs that make a character ready: setup, joints, animate, check."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from typing import Any

import bpy

from ..coarse_mesh import VERTEX_COUNT
from ..fabrics import find_fabric
from ..joints import describe_joint, joints_to_json
from .character import sampling_stage
from .coarse_layer import MESH
from .coarse_scene import SIMULATION
from .coarse_setup import choose, make_coarse
from .files import check_output, save_character
from .garment_joints import add_joint, choose_joints, remove_joint, set_range, take_named_ranges
from .inspection import inspect_garment
from .rig_files import animate_file, joints_of_file
from .setup import setup_garment, stage_job
from .verb_options import find_database, find_garment, find_object, open_file, open_path

QUICK_SAMPLES = 36
"""Simulated samples of the quick plan, at most."""

NO_JOINTS = "  No joint that was found moves this garment; add one: wrinkle joints FILE --add NAME=BONE --out FILE."


def setup(options: argparse.Namespace) -> Mapping[str, Any]:
    check_output(options.out, ".blend")
    open_file(options)
    armature = find_object(options.armature, "armature") if options.armature else None
    body = find_object(options.body, "body")
    result = setup_garment(find_object(options.garment, "garment"), body, armature, options.subdivide)
    settings = result.garment.wrinkles
    if options.ease:
        settings.ease_girth, settings.ease_length = _pair(options.ease)
    if options.fabric:
        find_fabric(options.fabric)
        settings.fabric = options.fabric
    if options.pins is not None:
        settings.pin_group = options.pins
    if options.joints:
        choose_joints(settings, options.joints.split(","))
    if options.ranges:
        take_named_ranges(result.garment, options.ranges, math.radians(options.margin))
    choose_plan(settings, options)
    doubt = _choose_coarse(result.garment, options.coarse) if options.coarse else ""
    plan = None
    if result.joints:
        with sampling_stage(settings.armature, settings.body) as stage:
            plan = stage_job(result.garment, stage).plan
    save_character(options.out)
    vertices = len(result.garment.data.vertices)
    text = [f"{result.garment.name}: {vertices} vertices, {len(plan.samples) + 1 if plan else 0} samples"]
    text += [f"  {grid.joint.name}: {', '.join(grid.joint.bones)}" for grid in plan.grids] if plan else [NO_JOINTS]
    text += [f"  {name} was not found: {why.reason}" for name, why in result.search.missing.items()]
    notes = [*result.notes, *([doubt] if doubt else [])]
    text += notes
    return {
        "garment": result.garment.name,
        "vertices": vertices,
        "joints": joints_to_json(result.search),
        "sampled": [grid.joint.name for grid in plan.grids] if plan else [],
        "coarse": settings.coarse.name if settings.coarse else None,
        "notes": notes,
        "symmetric": plan is not None and plan.mirror is not None,
        "file": str(options.out),
        "text": "\n".join(text),
    }


def _choose_coarse(garment: bpy.types.Object, text: str) -> str:
    """Let the garment follow the mesh that is named, or one made from it; a sentence on what is doubtful."""
    name, _, count = text.partition(":")
    if bpy.data.objects.get(text) is not None or name not in ("make", "simulate"):
        return choose(garment, find_object(text, "coarse mesh"), MESH)
    if name == "simulate":
        return choose(garment, find_object(count, "coarse mesh"), SIMULATION)
    if count and not count.isdecimal():
        raise ValueError(f"A coarse mesh is made with make:COUNT, such as make:700, not '{text}'.")
    make_coarse(garment, int(count) if count else VERTEX_COUNT)
    return ""


def _pair(text: str) -> tuple[float, float]:
    try:
        girth, length = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"Ease is given as GIRTH,LENGTH in percent, not '{text}'.") from None
    return girth, length


def choose_plan(settings: Any, options: argparse.Namespace) -> None:
    """Let the garment remember the plan that is asked for, if one is."""
    if options.full:
        settings.plan = "PAPER"
    if options.samples is not None and options.samples < 1:
        raise ValueError(f"A plan needs at least one sample, not {options.samples}.")
    if options.quick or options.samples is not None:
        settings.plan, settings.budget = "BUDGET", QUICK_SAMPLES if options.samples is None else options.samples


# --- joints -------------------------------------------------------------------------------------------------------


def joints(options: argparse.Namespace) -> Mapping[str, Any]:
    """The joints found in a file; or those of a garment, after the changes asked for."""
    changes = options.add or options.add_hinge or options.remove or options.range or options.ranges or options.sample
    if options.garment is None and not changes:
        found = joints_of_file(options.file or open_path(), options.armature)
        return {**found, "text": json.dumps(found, indent=1)}
    if options.out is not None:
        check_output(options.out, ".blend")
    elif changes:
        raise ValueError("Name the .blend file to save the changed joints in with --out.")
    open_file(options)
    garment = find_garment(options)
    _change_joints(garment, options)
    if options.out is not None:
        save_character(options.out)
    result = {
        stored.name: {**describe_joint(stored.joint()), "sampled": stored.enabled} for stored in garment.wrinkles.joints
    }
    return {**result, "text": json.dumps(result, indent=1)}


def _change_joints(garment: bpy.types.Object, options: argparse.Namespace) -> None:
    settings = garment.wrinkles
    for name in options.remove:
        remove_joint(settings, name)
    for text, dof in [(text, 3) for text in options.add] + [(text, 1) for text in options.add_hinge]:
        name, _, bones = text.partition("=")
        add_joint(garment, name, bones.split(",") if bones else (), dof)
    if options.ranges:
        take_named_ranges(garment, options.ranges, math.radians(options.margin))
    for text in options.range:
        name, _, ranges = text.partition("=")
        set_range(settings, name, _degrees(text, ranges))
    if options.sample:
        choose_joints(settings, options.sample.split(","))


def _degrees(text: str, ranges: str) -> list[tuple[float, float]]:
    try:
        pairs = [tuple(float(angle) for angle in pair.split(":")) for pair in ranges.split(",")]
        return [(low, high) for low, high in pairs]
    except ValueError:
        raise ValueError(
            f"A range is given as JOINT=LOW:HIGH in degrees, for a ball three of them, not '{text}'."
        ) from None


def animate(options: argparse.Namespace) -> Mapping[str, Any]:
    result = animate_file(options.file or open_path(), options.armature, options.motion, options.out)
    notes = result["notes"]
    assert isinstance(notes, list)
    text = f"{result['armature']}: {result['frames']} frames at {result['fps']:g} fps"
    return {**result, "text": "\n".join([text, *notes])}


# --- looking ahead ------------------------------------------------------------------------------------------------


def check(options: argparse.Namespace) -> Mapping[str, Any]:
    """Everything that would stop a bake or playing, found by going through the motions without simulating."""
    open_file(options)
    garment = find_garment(options)
    findings = inspect_garment(garment, find_database(options, garment))
    problems = [finding.text for finding in findings if finding.stops]
    notes = [finding.text for finding in findings if not finding.stops]
    return {
        "ok": not problems,
        "problems": problems,
        "notes": notes,
        "text": "\n".join([*problems, *notes]),
        "exit_code": 2 if problems else 0,
    }
