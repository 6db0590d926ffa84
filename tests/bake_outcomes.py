"""How a bake ended, and whether all that is said of it is true: every number found again by other means."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from random_bakes import RandomBake
from wrinkle_synthesis.wrinkle_addon import storage
from wrinkle_synthesis.wrinkle_addon.bake import BakeJob, SimulatedSamples, bake
from wrinkle_synthesis.wrinkle_addon.garment import bind_to_surface
from wrinkle_synthesis.wrinkle_addon.rig import Pose
from wrinkle_synthesis.wrinkle_addon.topology import mesh_edges
from wrinkle_synthesis.wrinkle_addon.wearer import REST_EFFORT, ROUNDS

Array = np.ndarray


def outcome_of(drawn: RandomBake, number: int, folder: Path) -> dict | str:
    """Bake one sample and check all that is said of it; the last report, or the sentence that it ended in."""
    reports = {}
    try:
        job = drawn.job()
        source = SimulatedSamples(job, drawn.character, folder)
        count = max(1, len(drawn.plan.simulated))
        for event in bake(job, source, folder, shard=(number % count, count)):
            reports[event.name] = event.report
    except ValueError as error:
        check_sentence(drawn, str(error), reports)
        check_files(folder, set(reports))
        return str(error)
    check_files(folder, set(reports))
    name, report = list(reports.items())[-1]
    for each in reports.values():
        check_effort(drawn, each)
    sample = next((sample for sample in job.plan.samples if sample.name == name), None)
    pose = Pose.at_rest(job.rig) if sample is None else job.pose(sample)
    check_report(drawn, job, pose, source, report, job.settings.rest_tolerance if sample is None else None)
    return dict(report)


def check_sentence(drawn: RandomBake, sentence: str, reports: dict) -> None:
    """One line that names the garment or the body if it was refused, else the sample and the place."""
    assert "\n" not in sentence and sentence.endswith("."), sentence
    if not any(named in sentence for named in ("he garment '", "of the garment", "The body is")):
        what, place = sentence.split(": ", 1)
        assert what == "The rest pose" or what.removeprefix("Sample ") in {s.name for s in drawn.plan.samples}, sentence
        check_place(drawn, place)


def check_place(drawn: RandomBake, place: str) -> None:
    """A bone and a vertex are named."""
    assert any(bone in place for bone in drawn.character.rig.names) and "vertex" in place, place


def check_files(folder: Path, finished: set[str]) -> None:
    """The folder holds whole files of numbers, of what is finished alone."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    for path in files:
        if path.suffix == storage.ARRAY_SUFFIX:
            storage.read_arrays(path)  # Refuses what is cut off or holds values that are not numbers.
    names = {path.name.rsplit("-", 1)[0] for path in files if path.parent == folder}
    assert names <= finished | {"header", "manifest.json"}
    assert not [path.name for path in files if path.suffix not in (storage.ARRAY_SUFFIX, ".json")]


def check_effort(drawn: RandomBake, report: dict) -> None:
    """No more was done than the bounds allow, those of the rest pose at most."""
    assert report["iterations"] <= (1 + ROUNDS) * REST_EFFORT * drawn.settings.settle_iterations
    # Recorded in chunks of ten, so bounds are met to the next ten.
    assert report["linear_iterations"] <= report["iterations"] * (drawn.settings.solver.linear_iterations + 9)
    assert report["untanglings"] < ROUNDS


def check_report(
    drawn: RandomBake, job: BakeJob, pose: Pose, source: SimulatedSamples, report: dict, tolerance: float | None
) -> None:
    """Every number of a report is found again by other means."""
    positions, faces = source.wearer.positions[0], job.garment.faces
    assert np.isfinite(positions).all()
    assert np.isfinite([value for value in report.values() if isinstance(value, float)]).all()
    # Reports are rounded to four digits. Anchors of friction are read back from the body's triangles, a tenth of a
    # millimetre from where they were found beside them, which deep contact magnifies: 20.2 % in one bake of a hundred,
    # where planes, pairs and bounds are found again to the bit.
    found_again = source.wearer.simulation.relative_residual()[0]
    assert report["whole_residual"] == pytest.approx(found_again, rel=0.25, abs=1e-4)
    assert report["residual"] <= report["whole_residual"] + 1e-4
    tolerance = job.settings.settle_tolerance if tolerance is None else tolerance
    assert report["residual"] <= tolerance + 1e-4 if report["converged"] else report["residual"] >= tolerance - 1e-4
    assert ("restless" in report) == (not report["converged"])
    if "restless" in report:
        check_place(drawn, report["restless"])
    body = drawn.character.positions(pose)
    inside = deeper_than(0.001, positions, body, job.body.faces)
    assert report["inside"] + report["inside_overlap"] == pytest.approx(inside, abs=2)
    pairs = crossing_pairs(positions, faces)
    assert report["self_intersections"] + report["self_intersections_overlap"] == pairs


def deeper_than(depth: float, points: Array, body: Array, faces: Array) -> int:
    """How many points lie deeper than this in the body [m], by the solid angles of all its triangles."""
    a, b, c = (body[faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = (a * np.cross(b, c)).sum(2)
    spread = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    winding = (2.0 * np.arctan2(volume, spread)).sum(1) / (4.0 * np.pi)
    distance = np.abs(bind_to_surface(points, body, faces).distance)
    return int(((winding > 0.5) & (distance > depth)).sum())


def crossing_pairs(positions: Array, faces: Array) -> int:
    """How many pairs of triangles pass through each other, by trying every edge on every triangle."""
    edges, edge_of_side = mesh_edges(faces)
    low, high = positions[edges].min(1), positions[edges].max(1)
    near = np.ones((len(edges), len(faces)), bool)
    for k in range(3):
        corners = positions[faces][:, :, k]
        near &= (low[:, None, k] <= corners.max(1)) & (high[:, None, k] >= corners.min(1))
    edge, face = np.nonzero(near)
    own = (edges[edge][:, :, None] == faces[face][:, None]).any((1, 2))
    edge, face = edge[~own], face[~own]
    p, q = positions[edges[edge, 0]], positions[edges[edge, 1]]
    a, b, c = (positions[faces[face, k]] for k in range(3))

    def volume(u: Array, v: Array, w: Array, x: Array) -> Array:
        return ((v - u) * np.cross(w - u, x - u)).sum(1)

    apart = (volume(a, b, c, p) >= 0.0) != (volume(a, b, c, q) >= 0.0)
    turns = np.stack([volume(p, q, *side) >= 0.0 for side in ((a, b), (b, c), (c, a))])
    cut = apart & (turns.all(0) | ~turns.any(0))
    pairs = {
        (min(side // 3, other), max(side // 3, other))
        for e, other in zip(edge[cut], face[cut], strict=True)
        for side in np.flatnonzero(edge_of_side.ravel() == e)
    }
    return len(pairs)
