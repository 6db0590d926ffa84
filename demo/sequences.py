"""The five sequences of Wang et al. (2010), each beside the full simulation (figures 1 and 8, W103).

    python -m wrinkle_synthesis.demo.sequences stretching kicking --out sequences

A man stretches in a long shirt and kicks and runs in trousers; a woman dances and points in a short shirt. Each
sequence is a demo of its own, with a coarse layer under the wrinkles; another run goes on after the last one.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..wrinkle_addon.database import WrinkleDatabase
from ..wrinkle_addon.pc2 import PointCache
from ..wrinkle_addon.surface import SurfaceMeasures
from .figures import FULL, compare_sums, curvature_sums, root_mean_square_mm
from .garment import GARMENTS
from .picture import compose
from .recipe import FULL as USUAL
from .recipe import Recipe
from .run import Demo, hardest_frames

COARSE, OURS = "coarse simulation", "ours"

MAN = replace(
    USUAL,
    garment="trousers",
    vertex_count=5_000,
    samples=24,
    coarse=700,
    stay=True,
    rows=2,
    picture_size=(360, 400),
    picture_rays=10,
    expected={
        "character": 10.0,
        "set-up": 10.0,
        "bake": 300.0,
        "coarse simulation": 15.0,
        "synthesis": 10.0,
        "full simulation": 100.0,
        "errors": 10.0,
        "pictures": 90.0,
    },
)
# A short shirt has less cloth: its edges are as long as the trousers'.
WOMAN = replace(MAN, sex="female", garment="tshirt", vertex_count=3_500)
SEQUENCES = {
    "stretching": replace(MAN, garment="shirt", clip="stretch"),
    # Hips and knees turn further than in any other.
    "kicking": replace(MAN, clip="kick", samples=36, played=(1, 40)),
    "running": replace(MAN, clip="run", repeats=2, played=(1, 40)),
    "dancing": replace(WOMAN, clip="dance_a", played=(1, 40)),
    "pointing": replace(WOMAN, clip="point"),
}


class SequenceDemo(Demo):
    """A demo whose garment follows a coarse simulation, compared with the full one and with nothing else."""

    columns: Mapping[str, str] = {
        "coarse": "Coarse simulation", "synthesis": "Wrinkle Synthesis", "simulation": "Full simulation",
    }  # fmt: skip

    def __init__(self, out: Path, recipe: Recipe):
        super().__init__(out, recipe)
        self.stages = {
            "character": self.make_character,
            "set-up": self.set_up,
            "bake": self.bake,
            "coarse simulation": self.simulate_coarse,
            "synthesis": self.synthesize,
            "full simulation": self.simulate,
            "errors": self.measure,
            "pictures": self.picture,
        }

    def simulate_coarse(self) -> dict[str, Any]:
        """`simulate`, of the coarse layer."""
        return {"coarse": self.results.keep("coarse", lambda: self._run("simulate", self._scene))}

    def simulate(self) -> dict[str, Any]:
        """`simulate --fine`."""
        listen = self._frames_told(len(self._simulated), 0.0, 1.0)
        self.results.keep("full", lambda: self._run(*self._full_simulation, listen=listen))
        return {}

    def measure(self) -> dict[str, Any]:
        """`evaluate` against the recorded simulation, and what it does not tell."""
        database = self.out / f"{self.recipe.garment}.wrinkles"
        return {**super().measure(), "surfaces": self.results.keep("surfaces", lambda: self._compare(database))}

    def _compare(self, database: Path) -> dict[str, Any]:
        garment = WrinkleDatabase.open(database).header.garment
        names = {COARSE: "coarse", OURS: "synthesis", FULL: "simulation"}
        first, last = self._simulated[0], self._simulated[-1]
        shapes = {}
        for name, cache in names.items():
            recorded = PointCache(self._caches[cache])
            shapes[name] = np.array(recorded.frames[first - round(recorded.start) : last + 1 - round(recorded.start)])
        surface = SurfaceMeasures(garment.faces, garment.vertex_count)
        crossings = {
            name: [len(surface.self_intersections(shape.astype(np.float64))) for shape in frames]
            for name, frames in shapes.items()
        }
        return {
            "vertices": garment.vertex_count,
            "rmse_mm": {name: root_mean_square_mm(frames, shapes[FULL]) for name, frames in shapes.items()},
            "curvature": compare_sums(curvature_sums(surface, shapes)),
            "self_intersections": {
                name: {"mean": float(np.mean(counts)), "worst": max(counts)} for name, counts in crossings.items()
            },
        }

    def finish(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """Write what was measured into ``sequence.json``."""
        whole = {"recipe": self.recipe.choices, "times": self.results.times, **report}
        text = json.dumps(whole, indent=1, allow_nan=False)
        (self.out / "sequence.json").write_text(text + "\n", encoding="utf-8")
        return whole


# --- all of them --------------------------------------------------------------------------------------------------


def run_sequence(name: str, out: Path, garment: str | None = None, recipe: Recipe | None = None) -> dict[str, Any]:
    """Run a sequence into a folder of its own, or go on with it.

    Args:
        name: One of :data:`SEQUENCES`.
        out: Folder that the sequence's own is made in.
        garment: What is worn instead of what the sequence shows.
        recipe: What to make; left out, the sequence's own.

    Raises:
        ValueError: One sentence, if there is no such sequence, or a stage fails; what is done stays.
    """
    if name not in SEQUENCES:
        raise ValueError(f"The sequences are {', '.join(SEQUENCES)}; there is no {name!r}.")
    chosen = recipe or SEQUENCES[name]
    chosen = replace(chosen, garment=garment or chosen.garment)
    return SequenceDemo(out / f"{name}-{chosen.garment}", chosen).run()


def tabulate(reports: Mapping[str, Mapping[str, Any]]) -> str:
    """A row of Markdown for each sequence.

    Errors are RMS to the full simulation. In brackets: the coarse simulation's curvature, what lies inside the body
    where it cuts into itself, the full simulation's own pairs of triangles that pass through each other in a frame.
    """
    lines = [
        "| | garment | vertices | samples | skinning | coarse | ours | curvature | correlation | inside | passing |",
        "|" + "---|" * 11,
    ]
    for name, report in reports.items():
        played, surfaces = report["simulate"], report["surfaces"]
        curvature, passing = surfaces["curvature"], surfaces["self_intersections"]
        cells = (
            name,
            report["recipe"]["garment"],
            f"{surfaces['vertices']:,}",
            f"{report['database']['samples']}",
            f"{played['rmse_mm']['skinning']:.1f} mm",
            f"{surfaces['rmse_mm'][COARSE]:.1f} mm",
            f"{played['rmse_mm'][OURS]:.1f} mm",
            f"{played['curvature_ratio']:.2f} ({curvature[COARSE]['ratio']:.2f})",
            f"{curvature[OURS]['correlation']:.2f}",
            f"{100 * played['inside_share']:.2f} ({100 * played['inside_overlap_share']:.2f}) %",
            f"{passing[OURS]['mean']:.0f} ({passing[FULL]['mean']:.0f})",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw_sheet(folders: Mapping[str, Path], reports: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """The frame of each sequence in which skinning is furthest from the full simulation, a row each."""
    columns = SequenceDemo.columns
    rows, corners = [], []
    for name, folder in folders.items():
        # The furthest is among the pictured ones, which are the hardest that lie apart.
        (frame,) = hardest_frames(reports[name]["simulate"]["frames"], 1)
        rows.append([folder / "stills" / f"{column}-{frame:04d}.png" for column in columns])
        corners.append([f"{name}, frame {frame}", "", ""])
    compose(rows, list(columns.values()), corners, path)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="The five sequences of Wang et al. (2010).")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(SEQUENCES)}; left out, all five")
    parser.add_argument("--out", type=Path, default=Path("sequences"), help="folder for the results")
    parser.add_argument("--garment", choices=GARMENTS, help="left out, what the sequence shows")
    options = parser.parse_args(arguments)
    reports, folders = {}, {}
    for name in options.names or SEQUENCES:
        try:
            reports[name] = run_sequence(name, options.out, options.garment)
        except ValueError as error:
            print(f"sequences: {error}", file=sys.stderr)
            return 2
        folders[name] = options.out / f"{name}-{reports[name]['recipe']['garment']}"
    draw_sheet(folders, reports, options.out / "sequences.jpg")
    print(tabulate(reports))
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(code)
