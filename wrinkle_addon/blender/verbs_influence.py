"""The verb that tells what each joint does to a garment: influence."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..anatomy import find_anatomy
from ..database import WrinkleDatabase
from ..folder_verbs import choose_device
from ..influence import (
    influence_by_region,
    inside_of_bend,
    joint_names,
    measure_influence,
    scaled_influence,
)
from ..joint_wrinkles import JointWrinkles
from ..plots import check_plots, plot_influence
from ..rig import FloatArray
from .files import check_output, save_character
from .influence_colours import paint_influence
from .matching import check_database
from .verb_options import find_database, find_garment, open_file
from .write import make_writable


def influence(options: argparse.Namespace) -> Mapping[str, Any]:
    """Measure influence; paint it on the garment of a copy of the file and plot it beside eq 4's weights on request."""
    device = choose_device(options.device)
    if options.out is not None:
        check_output(options.out, ".blend")
    if options.plots is not None:
        check_plots(options.plots)
    open_file(options)
    garment = find_garment(options)
    database = WrinkleDatabase.open(find_database(options, garment))
    check_database(garment, database.header)
    joints = joint_names(database.header, options.joints.split(",") if options.joints else ())
    method = JointWrinkles(database)
    measured = measure_influence(database.header, database.rest, method.samples, device)
    distance = method.distance_weights()
    found = {name: _describe(database, name, measured[name], distance[name]) for name in joints}
    result: dict[str, Any] = {"joints": found}
    if options.plots is not None:
        header = database.header
        axes = find_anatomy(header.rig).frame.matrix
        result["plots"] = [
            str(
                plot_influence(
                    database.rest, header.garment.faces, axes,
                    {"by distance (eq 4)": distance[name], "measured": scaled_influence(measured[name])},
                    f"Influence of {name}", options.plots / f"influence_{name}.png",
                )
            )
            for name in joints
        ]  # fmt: skip
    if options.out is not None:
        make_writable(garment)
        paint_influence(garment, {name: measured[name] for name in joints}, joints[0])
        save_character(options.out)
    return {**result, "text": "\n".join(_sentence(name, entry) for name, entry in found.items())}


def _describe(database: WrinkleDatabase, name: str, measured: FloatArray, distance: FloatArray) -> dict[str, Any]:
    header = database.header
    varied = measured.std() > 0.0 and distance.std() > 0.0
    return {
        "samples": len(list(header.plan.grid[name].nodes())) + 1,
        "largest_mm": float(measured.max() * 1e3),
        "regions_mm": influence_by_region(measured, header.regions),
        "inside_of_bend": inside_of_bend(measured, header.plan.grid[name].joint, header.rig, database.rest),
        "correlation_with_distance": float(np.corrcoef(measured, distance)[0, 1]) if varied else None,
    }


def _sentence(name: str, entry: Mapping[str, Any]) -> str:
    regions = ", ".join(f"{region} {value:.2f}" for region, value in entry["regions_mm"].items())
    bend = "" if entry["inside_of_bend"] is None else f"; inside of the bend {entry['inside_of_bend']:.1f} x outside"
    return f"{name}: mean change of detail in mm, {regions}{bend}"
