"""The five sequences of Wang et al. (2010), each beside the full simulation (figures 1 and 8, W103).

    python -m wrinkle_synthesis.demo.sequences stretching kicking --out sequences

A man in a long shirt over trousers stretches, kicks and runs; a woman in a short shirt over cropped trousers dances and
points. Each sequence is a demo of its own: every garment is baked by itself, follows a coarse layer of its own, and is
kept outside the one that it is worn over. Another run goes on after the last one.
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

from ..wrinkle_addon.evaluate import OURS
from ..wrinkle_addon.pc2 import PointCache
from .figures import FULL, SKINNING
from .outfit import COARSE, WHOLE, join, join_caches, make_playing, measure_outfit, read_outfit, wear_over
from .picture import compose
from .recipe import FULL as USUAL
from .recipe import Recipe
from .rendering import quiet
from .run import Demo, hardest_frames
from .studio import make_playback

MAN = replace(
    USUAL,
    garment="shirt",
    worn_over="trousers",
    vertex_count=5_000,
    samples=24,
    coarse=700,
    stay=True,
    rows=1,
    picture_size=(360, 480),
    picture_rays=10,
    expected={
        "character": 15.0,
        "set-up": 20.0,
        "bake": 300.0,
        "coarse simulation": 15.0,
        "synthesis": 30.0,
        "full simulation": 150.0,
        "errors": 30.0,
        "pictures": 60.0,
    },
)
# Smaller garments: their edges are as long.
WOMAN = replace(MAN, sex="female", garment="tshirt", worn_over="cropped", vertex_count=3_500)
SEQUENCES = {
    "stretching": replace(MAN, clip="stretch"),
    # Hips and knees turn further than in any other.
    "kicking": replace(MAN, clip="kick", samples=36, played=(1, 40)),
    "running": replace(MAN, clip="run", repeats=2, played=(1, 40)),
    "dancing": replace(WOMAN, clip="dance_a", played=(1, 40)),
    "pointing": replace(WOMAN, clip="point"),
}


class SequenceDemo(Demo):
    """A demo of a whole outfit over coarse simulations, compared with the full one and with nothing else.

    All point caches are of the outfit as one mesh.
    """

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
        self._skinned, self._joined = out / "skinning.pc2", out / "outfit.blend"

    def set_up(self) -> dict[str, Any]:
        """`animate`; `setup` and `plan` of every garment; the file in which all are one mesh."""

        def make() -> dict[str, Any]:
            source, frame_count = self.out / "animated.blend", self._animate()["frames"]
            garments = {}
            for garment in self.recipe.garments:
                setup = self._set_up_garment(garment, source, frame_count)
                garments[garment] = {"setup": setup, "plan": self._run("plan", self._scene, "--garment", garment)}
                source = self._scene
            with quiet():
                join(self._scene, self.recipe.garments, self._joined)
                wear_over(self._scene, self.recipe.garments)
            return {"frames": frame_count, "garments": garments}

        return self.results.keep("set-up", make)

    def bake(self) -> dict[str, Any]:
        """`bake` of every garment by itself."""
        garments, databases = self.results.read("set-up")["garments"], {}
        for number, (garment, made) in enumerate(garments.items()):
            share = number / len(garments), (number + 1) / len(garments)
            databases[garment] = self._bake_garment(f"bake-{garment}", garment, made["plan"]["simulated"], *share)
        return {"databases": databases}

    def simulate_coarse(self) -> dict[str, Any]:
        """`simulate`, of the coarse layers together."""
        verb = ("simulate", self._scene, "--garment", self.recipe.garment)
        return {"coarse": self.results.keep("coarse", lambda: self._run(*verb))}

    def synthesize(self) -> dict[str, Any]:
        """`synthesize` by skinning alone, over the coarse layers without wrinkles, and with all."""

        def make() -> dict[str, Any]:
            self._play(self._skinned, wrinkles=False, coarse=False)
            self.progress.update(0.3)
            self._play(self._caches["coarse"], wrinkles=False, coarse=True)
            self.progress.update(0.6)
            self._play(self._caches["synthesis"], wrinkles=True, coarse=True)
            return {}

        return self.results.keep("synthesis", make)

    def _play(self, cache: Path, *, wrinkles: bool, coarse: bool) -> None:
        """`synthesize` of every garment, into one cache, unless it is there."""
        if cache.exists():
            return
        garments, playing = self.recipe.garments, self.out / "playing.blend"
        parts = [cache.with_name(f"{cache.stem}-{garment}.pc2") for garment in garments]
        with quiet():
            make_playing(self._scene, garments, playing, wrinkles=wrinkles, coarse=coarse)
        for garment, part in zip(garments, parts, strict=True):
            self._run("synthesize", playing, "--garment", garment, "--out", part)
        playing.unlink()
        join_caches(parts, cache)

    def simulate(self) -> dict[str, Any]:
        """`simulate --fine` of the outfit as one mesh."""
        listen = self._frames_told(len(self._simulated), 0.0, 1.0)
        verb = ("simulate", self._joined, "--fine", "--out", self._caches["simulation"])
        self.results.keep("full", lambda: self._run(*verb, listen=listen))
        return {}

    def measure(self) -> dict[str, Any]:
        """Everything against the full simulation."""
        garments = self.results.read("set-up")["garments"]
        counts = {garment: made["setup"]["vertices"] for garment, made in garments.items()}
        caches = {
            SKINNING: self._skinned,
            COARSE: self._caches["coarse"],
            OURS: self._caches["synthesis"],
            FULL: self._caches["simulation"],
        }

        def make() -> dict[str, Any]:
            with quiet():
                outfit = read_outfit(self._joined, counts, self._simulated)
            return measure_outfit(outfit, {name: np.array(PointCache(path).frames) for name, path in caches.items()})

        return {"measured": self.results.keep("measured", make)}

    def picture(self) -> dict[str, Any]:
        """Side by side, the frames in which skinning is furthest from the simulation."""
        frames = hardest_frames(self.results.read("measured")[WHOLE]["frames"], self.recipe.rows)

        def make() -> dict[str, Any]:
            with quiet():
                make_playback(
                    self._joined, self.recipe.garment, self._caches["simulation"], self.out / "playback.blend"
                )
            return self._picture_side_by_side(frames)

        return self.results.keep("pictures", make)

    def finish(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """Write what was measured into ``sequence.json``."""
        whole = {"recipe": self.recipe.choices, "times": self.results.times, **report}
        text = json.dumps(whole, indent=1, allow_nan=False)
        (self.out / "sequence.json").write_text(text + "\n", encoding="utf-8")
        return whole


# --- all of them --------------------------------------------------------------------------------------------------


def run_sequence(name: str, out: Path, recipe: Recipe | None = None) -> dict[str, Any]:
    """Run a sequence into a folder of its own, or go on with it.

    Args:
        name: One of :data:`SEQUENCES`.
        out: Folder that the sequence's own is made in.
        recipe: What to make; left out, the sequence's own.

    Raises:
        ValueError: One sentence, if there is no such sequence, or a stage fails; what is done stays.
    """
    if name not in SEQUENCES:
        raise ValueError(f"The sequences are {', '.join(SEQUENCES)}; there is no {name!r}.")
    return SequenceDemo(out / name, recipe or SEQUENCES[name]).run()


def tabulate(reports: Mapping[str, Mapping[str, Any]]) -> str:
    """A row of Markdown for each garment of each sequence, and one for its outfit.

    Errors are RMS to the full simulation. In brackets: the coarse simulation's curvature, what lies inside the body
    where it cuts into itself, the full simulation's own pairs of triangles that pass through each other in a frame, of
    the outfit those of two garments alone.
    """
    lines = [
        "| | garment | vertices | samples | skinning | coarse | ours | curvature | correlation | inside | passing |",
        "|" + "---|" * 11,
    ]
    for name, report in reports.items():
        for garment, found in report["measured"].items():
            errors, curvature = found["rmse_mm"], found["curvature"]
            correlation = curvature[OURS]["correlation"]
            passing = found["between"] if garment == WHOLE else found["passing"]
            samples = report["databases"][garment]["samples"] if garment != WHOLE else ""
            cells = (
                name,
                garment,
                f"{found['vertices']:,}",
                f"{samples}",
                *(f"{errors[made]:.1f} mm" for made in (SKINNING, COARSE, OURS)),
                f"{curvature[OURS]['ratio']:.2f} ({curvature[COARSE]['ratio']:.2f})",
                "" if correlation is None else f"{correlation:.2f}",
                f"{100 * found['inside'][OURS]:.2f} ({100 * found['inside_overlap'][OURS]:.2f}) %",
                f"{passing[OURS]:.0f} ({passing[FULL]:.0f})",
            )
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw_sheet(folders: Mapping[str, Path], reports: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """The frame of each sequence in which skinning is furthest from the full simulation, a row each."""
    columns = SequenceDemo.columns
    rows, corners = [], []
    for name, folder in folders.items():
        # The furthest is among the pictured ones, which are the hardest that lie apart.
        (frame,) = hardest_frames(reports[name]["measured"][WHOLE]["frames"], 1)
        rows.append([folder / "stills" / f"{column}-{frame:04d}.png" for column in columns])
        corners.append([f"{name}, frame {frame}", "", ""])
    compose(rows, list(columns.values()), corners, path)


def build_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="The five sequences of Wang et al. (2010).")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(SEQUENCES)}; left out, all five")
    parser.add_argument("--out", type=Path, default=Path("sequences"), help="folder for the results")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    options = build_parser().parse_args(arguments)
    reports = {}
    for name in options.names or SEQUENCES:
        try:
            reports[name] = run_sequence(name, options.out)
        except ValueError as error:
            print(f"sequences: {error}", file=sys.stderr)
            return 2
    draw_sheet({name: options.out / name for name in reports}, reports, options.out / "sequences.jpg")
    print(tabulate(reports))
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(code)
