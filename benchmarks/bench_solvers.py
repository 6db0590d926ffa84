"""A sleeve on an arm that bends, in this project's solver, in Newton's VBD and in Blender's own Cloth.

All carry the same mesh of the same fabric through the same motion and are timed until they rest, by processor time on
one core. This project's solver takes part twice: as a bake has it, which walks through equilibria, and in time steps
like the others. Solvers that are not installed are left out. First each shows how stiff the fabric comes out in its
hands: on a sleeve that hangs, and on a level strip.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np
import sleeve
import sleeve_solvers
from measure import Report, milliseconds, read_options, times
from sleeve import FABRIC, Case, FloatArray
from sleeve_solvers import FRAME_RATE, Frames

REST = 0.001
"""What moves more slowly than this, in the root mean square over its vertices, is at rest [m/s]: 0.03 mm a frame, which
shows on no film, and a hundredth of what it does while the arm bends."""
WINDOW = 5
"""Frames over which that is measured, from where it was to where it is: jitter that leads nowhere does not count."""
RESIDUAL = sleeve_solvers.RESIDUAL
"""The residual that all are compared at, in nodal weights: what settling goes down to. As force is mass times
acceleration, that of solvers which keep theirs to themselves is read from three frames of what they show."""
PATIENCE = 1.25
"""What does not rest so long after the motion is taken as it is then [s]."""
QUICK_FRAMES = 6


@dataclass(frozen=True)
class Solver:
    """One that takes part.

    Attributes:
        name: For reading.
        module: What must be installed, None for nothing.
        frames: Its shapes, frame by frame.
        strip_frames: Frames that it is given to bring strips to rest; 0 settles them at once.
        stepping: Whether it starts at the beginning of the motion; if not, its first shape is the end of it.
    """

    name: str
    module: str | None
    frames: Callable[[Case, str], Frames]
    strip_frames: int
    stepping: bool = True


SOLVERS = {
    "settled": Solver("ours, settled", None, sleeve_solvers.settle_here, 0, stepping=False),
    "stepped": Solver("ours, time steps", None, sleeve_solvers.step_here, 0),
    "blender": Solver("Blender's Cloth", "bpy", sleeve_solvers.step_in_blender, 450),
    "newton": Solver("Newton's VBD", "newton", sleeve_solvers.step_in_newton, 30),
}


@dataclass(frozen=True, eq=False)
class Run:
    """One solver's way to rest.

    Attributes:
        shapes: Positions after each frame [m], shape [frame, vertex_count, 3].
        seconds: Processor time up to each of them [s].
        end: The frame in which it came to rest, or the last one that tells.
        speed: How fast it still moves from there on [m/s].
        residuals: What force is left on its vertices in each frame, in the root mean square [nodal weights].
    """

    shapes: FloatArray
    seconds: FloatArray
    end: int
    speed: float
    residuals: FloatArray

    @property
    def rested(self) -> bool:
        return self.speed < REST

    @property
    def balanced(self) -> int | None:
        """The frame from which on the residual stays below what all are compared at, if there is one."""
        above = np.flatnonzero(self.residuals >= RESIDUAL)
        first = int(above[-1]) + 1 if len(above) else 0
        return first if first < len(self.residuals) else None


def run(solver: Solver, case: Case, device: str, most: int) -> Run:
    """Let a solver carry a case to rest, but for no more than this many frames."""
    shapes, seconds = [], []
    first = round(case.duration * FRAME_RATE) if solver.stepping else -1
    speed = np.inf
    started = time.process_time()
    for number, positions in enumerate(solver.frames(case, device)):
        shapes.append(positions)
        seconds.append(time.process_time() - started)
        if number >= WINDOW:
            speed = mean_distance(shapes[-1], shapes[-1 - WINDOW]) * FRAME_RATE / WINDOW
        if (number >= first + WINDOW and speed < REST) or number + 1 >= most:
            break
    end = max(len(shapes) - 1 - WINDOW, 0)
    return Run(np.array(shapes), np.array(seconds), end, float(speed), residuals_of(np.array(shapes), first))


def residuals_of(shapes: FloatArray, first: int) -> FloatArray:
    """Of every frame but the last the root mean square acceleration over gravity; up to the first it has no bound."""
    force = np.diff(shapes, 2, axis=0) * FRAME_RATE**2 / sleeve.STANDARD_GRAVITY
    residuals = np.sqrt((force**2).sum(2).mean(1))
    # The first frame is that of a solver which has come to rest by then.
    residuals = np.concatenate([residuals[:1], residuals])
    residuals[: first + 1] = np.inf
    return residuals


def mean_distance(shape: FloatArray, other: FloatArray) -> float:
    """Root mean square distance of the vertices [m]."""
    return float(np.sqrt(((shape - other) ** 2).sum(1).mean()))


def measure_strips(solvers: Mapping[str, Solver], report: Report) -> None:
    """How far a hanging sleeve stretches and the end of a level strip sinks, beside what they should."""
    hanging, level = sleeve.make_hanging(30), sleeve.make_cantilever(20, 6, 0.04)
    length = np.ptp(hanging.rest[:, 2])
    stretch = FABRIC.density * hanging.gravity * length**2 / (2.0 * float(np.max(FABRIC.stretch)))
    rows = [["", "hanging sleeve", "level strip"], ["linear theory", f"{1e3 * stretch:.3f} mm", ""]]
    for key, solver in solvers.items():
        if solver.stepping and not solver.strip_frames:
            continue
        depths = []
        for case in (hanging, level):
            if solver.strip_frames:
                count = 2 if report.options.quick else solver.strip_frames
                *_, shape = itertools.islice(solver.frames(case, report.options.device), count)
            else:
                shape = sleeve_solvers.equilibrium(case, report.options.device)
            depths.append(float((case.rest - shape)[-5:, 2].mean()))
        after = f" after {solver.strip_frames / FRAME_RATE:.0f} s" if solver.strip_frames else ""
        rows.append([solver.name + after, *(f"{1e3 * depth:.3f} mm" for depth in depths)])
        report.figures |= {f"{key}_hanging_mm": 1e3 * depths[0], f"{key}_level_mm": 1e3 * depths[1]}
    report.table("stretched and bent by its own weight", rows)


def report_runs(runs: Mapping[str, Run], case: Case, report: Report) -> None:
    """The table of what each took and where each ended."""
    ours = runs["settled"]
    rows: dict[str, list[str]] = {}
    for key, one in runs.items():
        shape, end = one.shapes[one.end], one.end
        took, measured = one.seconds[end], sleeve.measure(case, shape)
        reached = int(np.searchsorted(one.seconds, ours.seconds[ours.end], side="right"))
        behind = mean_distance(one.shapes[max(reached - 1, 0)], shape)
        own = not SOLVERS[key].stepping
        cells = {
            "time to rest": milliseconds(took) if one.rested else f"not in {took:.0f} s",
            "of ours": times(took / ours.seconds[ours.end]),
            f"time to {RESIDUAL} nodal weights": f"not in {one.seconds[-1]:.0f} s",
            "of ours ": "",
            "simulated": "" if own else f"{(end + 1) / FRAME_RATE:.2f} s",
            "still moving": f"{1e3 * one.speed:.2g} mm/s",
            "simulated in our time": "" if own else f"{reached / FRAME_RATE:.2f} s",
            "  then from its own end": "" if own else f"{1e3 * behind:.1f} mm",
            "distance from ours": f"{1e3 * mean_distance(shape, ours.shapes[ours.end]):.1f} mm",
            "folds, inside of the elbow": f"{measured.inside_folds:.1f}",
            "  wavelength": f"{1e3 * measured.inside_wave:.0f} mm",
            "  height": f"{1e3 * measured.relief:.1f} mm",
            "folds, whole sleeve": f"{measured.folds:.1f}",
            "  wavelength ": f"{1e3 * measured.wave:.0f} mm",
            "strain, mean": f"{measured.mean_strain:.1%}",
            "strain, most": f"{measured.most_strain:.1%}",
            "vertices in the body": f"{measured.inside_body}",
            "self-intersections": f"{measured.self_intersections}",
        }
        if one.balanced is not None and ours.balanced is not None:
            balanced = one.seconds[one.balanced]
            cells[f"time to {RESIDUAL} nodal weights"] = milliseconds(balanced)
            cells["of ours "] = times(balanced / ours.seconds[ours.balanced])
            report.figures[f"{key}_balanced_seconds"] = balanced
        for name, cell in cells.items():
            rows.setdefault(name, [name]).append(cell)
        report.figures |= {f"{key}_{name}": value for name, value in asdict(measured).items()}
        report.figures |= {
            f"{key}_seconds": took,
            f"{key}_times_ours": took / ours.seconds[ours.end],
            f"{key}_rested": one.rested,
            f"{key}_speed_mm_s": 1e3 * one.speed,
            f"{key}_behind_mm": 1e3 * behind,
        }
    title = f"sleeve of {len(case.rest)} vertices, elbow bent to {sleeve.DEGREES:.0f} degrees"
    report.table(title, [["", *(SOLVERS[key].name for key in runs)], *rows.values()])


def main() -> None:
    report = Report("solvers", read_options(__doc__, picture=True))
    quick, device = report.options.quick, report.options.device
    solvers = {}
    for key, solver in SOLVERS.items():
        if solver.module is None or importlib.util.find_spec(solver.module) is not None:
            solvers[key] = solver
        else:
            report.line(f"  {solver.name} is left out: {solver.module} is not installed.")
    # Kernels compile here, before the clock runs.
    measure_strips(solvers, report)
    case = sleeve.make_sleeve(20, 12) if quick else sleeve.make_sleeve(sleeve.RINGS, sleeve.AROUND)
    most = QUICK_FRAMES if quick else round((case.duration + PATIENCE) * FRAME_RATE)
    runs = {key: run(solver, case, device, most) for key, solver in solvers.items()}
    report_runs(runs, case, report)
    if report.options.picture is not None:
        from sleeve_picture import draw

        draw(case, {SOLVERS[key].name: one.shapes[one.end] for key, one in runs.items()}, report.options.picture)
    report.finish()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(0)


if __name__ == "__main__":
    main()
