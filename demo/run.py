"""The demo, end to end: a dressed character, its bake, a clip played with wrinkles, references, pictures, a report.

Everything is done as an artist would do it, by the verbs of the command line. Each stage leaves its result in the
output folder, and another run goes on after the last one that is there.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from . import packages
from .command import Listener, Verb, run_verb
from .keyframes import find_clip
from .motion import in_place, part, repeated, resampled, write_clip
from .picture import compose, make_film
from .progress import Progress
from .recipe import Recipe
from .rendering import quiet, render_frames
from .report import describe_machine, write_report
from .results import Results
from .samples import make_sample_clip
from .scene import FRAMES_PER_SECOND, PIN_GROUP, build_character
from .studio import make_live, make_playback, make_skinned

FILM_REPEATS = 3
SHEET_COLUMNS = 4
Entry = TypeVar("Entry")


def run_demo(out: Path, recipe: Recipe) -> dict[str, Any]:
    """Run the demo, or go on with it.

    Args:
        out: Folder for the results.
        recipe: What to make in it.

    Returns:
        The report, and ``text``, where to look.

    Raises:
        ValueError: One sentence, if a stage fails; what is done stays.
    """
    return Demo(Path(out), recipe).run()


class Demo:
    """One demo at work; each stage is a method that returns what the report shall hold of it, and a note.

    Attributes:
        columns: Captions of what is pictured side by side, by the names of the point caches.
        stages: Names and methods, in order.
    """

    columns: Mapping[str, str] = {
        "skinning": "Skinning alone", "synthesis": "Wrinkle Synthesis", "simulation": "Full simulation",
    }  # fmt: skip

    def __init__(self, out: Path, recipe: Recipe):
        self.out, self.recipe = out, recipe
        self.results = Results(out, recipe.choices)
        self.progress = Progress(recipe.expected)
        self.stages: dict[str, Callable[[], dict[str, Any]]] = {
            "character": self.make_character,
            "set-up": self.set_up,
            "bake": self.bake,
            "synthesis": self.synthesize,
            "references": self.make_references,
            "errors": self.measure,
            "samples": self.picture_samples,
            "pictures": self.picture,
            "film": self.film,
        }
        self._scene, self._log = out / "scene.blend", out / "log.txt"
        self._caches = {name: out / f"{name}.pc2" for name in self.columns}

    def run(self) -> dict[str, Any]:
        """All stages that are not done yet; returns the report."""
        report: dict[str, Any] = {}
        for stage, work in self.stages.items():
            self.progress.begin(stage)
            with self.results.timed(stage):
                found = work()
            self.progress.end(found.pop("note", ""))
            report |= found
        return self.finish(report)

    # --- stages ---------------------------------------------------------------------------------------------------

    def make_character(self) -> dict[str, Any]:
        """The character's .blend file and the clip, from the pinned packages."""
        recipe = self.recipe

        def make() -> dict[str, Any]:
            for package in (packages.BODY, packages.MOTION):
                packages.package_folder(package)
            with quiet():
                build_character(self.out / "character.blend", recipe.sex, recipe.garments, recipe.vertex_count)
            whole = resampled(repeated(find_clip(recipe.clip), recipe.repeats), FRAMES_PER_SECOND)
            clip = part(in_place(whole) if recipe.stay else whole, *recipe.played)
            write_clip(clip, self.out / "clip.bvh", FRAMES_PER_SECOND)
            return {}

        return self.results.keep("character", make)

    def set_up(self) -> dict[str, Any]:
        """`animate`, `setup` and `plan`."""

        def make() -> dict[str, Any]:
            animated = self._animate()
            self.progress.update(0.3)
            setup = self._set_up_garment(self.recipe.garment, self.out / "animated.blend", animated["frames"])
            self.progress.update(0.8)
            return {"frames": animated["frames"], "setup": setup, "plan": self._run("plan", self._scene)}

        made = self.results.keep("set-up", make)
        setup, plan = made["setup"], made["plan"]
        note = f"{setup['vertices']} vertices, {len(setup['sampled'])} joints, {plan['simulated']} samples to simulate"
        return {**made, "note": note}

    def _animate(self) -> dict[str, Any]:
        out = self.out
        return self._run(
            "animate", out / "character.blend", "--motion", out / "clip.bvh", "--out", out / "animated.blend"
        )

    def _set_up_garment(self, garment: str, source: Path, frame_count: int) -> dict[str, Any]:
        """`setup` of a garment of one file, into the scene."""
        recipe = self.recipe
        chosen = ("--full",)
        if recipe.samples is not None:
            chosen = ("--samples", str(recipe.samples), "--ranges", f"1:{frame_count}")
        followed = ("--coarse", f"make:{recipe.coarse}") if recipe.coarse else ()
        return self._run(
            "setup", source, "--garment", garment, "--body", "body",
            "--subdivide", "0", "--pins", PIN_GROUP, *followed, *chosen, "--out", self._scene,
        )  # fmt: skip

    def bake(self) -> dict[str, Any]:
        """`bake`, which goes on by itself, and `info`."""
        total = self.results.read("set-up")["plan"]["simulated"]
        database = self._bake_garment("bake", self.recipe.garment, total)
        return {
            "database": database,
            "note": f"{database['samples']} samples, {database['sample_bytes'] / 1e6:.1f} MB",
        }

    def _bake_garment(
        self, name: str, garment: str, total: int, start: float = 0.0, end: float = 1.0
    ) -> dict[str, Any]:
        """Bake a garment's samples, as a part of the stage, and keep what `info` tells by this name."""

        def listen(line: str) -> None:
            event = json.loads(line) if line.startswith("{") else {}
            if event.get("event") == "sample":
                done = min(event["done"], total)
                self.progress.update(start + (end - start) * done / total, f"sample {done} of {total}")

        def make() -> dict[str, Any]:
            told = ("--workers", str(self.recipe.processes), "--progress", "json")
            self._run("bake", self._scene, "--garment", garment, *told, listen=listen)
            return self._run("info", self.out / f"{garment}.wrinkles")

        return self.results.keep(name, make)

    def synthesize(self) -> dict[str, Any]:
        """`synthesize` with wrinkles and without, and the file that plays them live."""
        skinned = self.out / "skinned.blend"

        def make() -> dict[str, Any]:
            with quiet():
                make_skinned(self._scene, self.recipe.garment, skinned)
            self._run("synthesize", skinned, "--out", self._caches[next(iter(self.columns))])
            skinned.unlink()
            self.progress.update(0.5)
            made = self._run("synthesize", self._scene, "--out", self._caches["synthesis"])
            return {"clamped_deg": made["clamped_deg"]}

        return self.results.keep("synthesis", make)

    def make_references(self) -> dict[str, Any]:
        """`simulate --fine` and `evaluate --reference settle`, side by side."""
        step = self.recipe.settled_step
        settled_count, simulated_count = -(-self._frame_count // step), len(self._simulated)

        def make() -> dict[str, Any]:
            simulation = Verb(self._full_simulation, self._log)
            try:
                settled = self._run(
                    "evaluate", self._scene, "--frames", f"1:{self._frame_count}:{step}",
                    "--plots", self.out / "plots" / "settle", listen=self._frames_told(settled_count, 0.0, 0.5),
                )  # fmt: skip
                simulation.result(self._frames_told(simulated_count, 0.5, 1.0))
            finally:
                simulation.stop()
            return settled

        settled = self.results.keep("settle", make)
        return {"settle": settled, "note": f"RMS {_errors(settled)} against the equilibrium"}

    def measure(self) -> dict[str, Any]:
        """`evaluate` against the recorded simulation."""

        def make() -> dict[str, Any]:
            return self._run(
                "evaluate", self._scene, "--reference", self._caches["simulation"], "--frames", _span(self._simulated),
                "--plots", self.out / "plots" / "simulate", listen=self._frames_told(len(self._simulated), 0.0, 1.0),
            )  # fmt: skip

        simulated = self.results.keep("simulate", make)
        return {"simulate": simulated, "note": f"RMS {_errors(simulated)} against the simulation"}

    def picture_samples(self) -> dict[str, Any]:
        """Samples from all over the plan, each with the joint and the node that it stands for."""
        recipe, folder = self.recipe, self.out / "samples"
        database = self.out / f"{recipe.garment}.wrinkles"

        def make() -> dict[str, Any]:
            folder.mkdir(exist_ok=True)
            clip, cache, playback = folder / "clip.blend", folder / "samples.pc2", folder / "playback.blend"
            with quiet():
                names = make_sample_clip(self._scene, recipe.garment, database, recipe.pictured_samples, clip)
            self._run("synthesize", clip, "--database", database, "--out", cache)
            with quiet():
                make_playback(clip, recipe.garment, cache, playback)
            shown, size = {"sample": cache}, recipe.film_size
            frames = range(1, len(names) + 1)
            made = render_frames(playback, recipe.garment, shown, frames, folder, size, recipe.film_rays, close=True)
            pictures = self._counted(made, len(names))
            compose(
                _rows(pictures, SHEET_COLUMNS),
                [""] * SHEET_COLUMNS,
                _rows(names, SHEET_COLUMNS),
                self.out / "samples.png",
            )
            return {"pictured_samples": names}

        return self.results.keep("samples", make)

    def picture(self) -> dict[str, Any]:
        """Side by side, the frames in which skinning is furthest from the simulation."""
        recipe = self.recipe
        rows = hardest_frames(self.results.read("simulate")["frames"], recipe.rows)

        def make() -> dict[str, Any]:
            with quiet():
                for make_file, name in ((make_live, "wrinkles.blend"), (make_playback, "playback.blend")):
                    make_file(self._scene, recipe.garment, self._caches["synthesis"], self.out / name)
            return self._picture_side_by_side(rows)

        return self.results.keep("pictures", make)

    def _picture_side_by_side(self, frames: Sequence[int]) -> dict[str, Any]:
        """Frames of the playback, as near as each allows."""
        recipe = self.recipe
        pictures = self._render(frames, "stills", recipe.picture_size, recipe.picture_rays, close=True)
        corners = [[f"frame {frame}", "", ""] for frame in frames]
        compose(pictures, list(self.columns.values()), corners, self.out / "side_by_side.png")
        return {"pictured_frames": list(frames)}

    def film(self) -> dict[str, Any]:
        """The same three, over the simulated span."""
        recipe, folder = self.recipe, self.out / "film"

        def make() -> dict[str, Any]:
            frames, captions = self._simulated[:: recipe.film_step], list(self.columns.values())
            rows = self._render(frames, folder.name, recipe.film_size, recipe.film_rays)
            sheets = [
                compose([row], captions, [[""] * len(captions)], folder / f"sheet-{frame:04d}.png")
                for frame, row in zip(frames, rows, strict=True)
            ]
            speed = max(1, round(FRAMES_PER_SECOND * recipe.film_speed / recipe.film_step))
            make_film(sheets, self.out / "film.mp4", speed, FILM_REPEATS)
            return {}

        return self.results.keep("film", make)

    def finish(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """Write the report."""
        whole = {
            "recipe": self.recipe.choices,
            "machine": describe_machine(self._run("doctor")),
            "times": self.results.times,
            **report,
        }
        _, as_text = write_report(self.out, whole)
        text = f"See {as_text}, and side_by_side.png, film.mp4, wrinkles.blend and playback.blend beside it."
        return {**whole, "text": text}

    # --- what stages share ----------------------------------------------------------------------------------------

    @property
    def _frame_count(self) -> int:
        return self.results.read("set-up")["frames"]

    @property
    def _simulated(self) -> range:
        """Frames of the full simulation."""
        first, last = self.recipe.simulated
        return range(first, min(last or self._frame_count, self._frame_count) + 1)

    @property
    def _full_simulation(self) -> list[str | Path]:
        """The verb that records it."""
        frames = ("--frames", _span(self._simulated))
        return ["simulate", self._scene, "--fine", *frames, "--out", self._caches["simulation"]]

    def _run(self, *arguments: str | Path, listen: Listener = lambda line: None) -> dict[str, Any]:
        return run_verb(arguments, self._log, listen)

    def _frames_told(self, count: int, start: float, end: float) -> Listener:
        """Counts the frames that a verb tells of, as a part of the stage."""
        done = 0

        def listen(line: str) -> None:
            nonlocal done
            if line.startswith("frame "):
                done += 1
                self.progress.update(min(start + (end - start) * done / count, 1.0), f"frame {done} of {count}")

        return listen

    def _render(
        self, frames: Sequence[int], folder: str, size: tuple[int, int], rays: int, close: bool = False
    ) -> list[list[Path]]:
        """Pictures of frames, a row each, a column for each cache."""
        count = len(frames) * len(self.columns)
        playback, garment = self.out / "playback.blend", self.recipe.garment
        made = render_frames(playback, garment, self._caches, frames, self.out / folder, size, rays, close)
        return _rows(self._counted(made, count), len(self.columns))

    def _counted(self, pictures: Iterable[Path], count: int) -> list[Path]:
        """Pictures as they are made, told as parts of the stage."""
        made: list[Path] = []
        for picture in pictures:
            made.append(picture)
            self.progress.update(len(made) / count, f"picture {len(made)} of {count}")
        return made


def _rows(entries: Sequence[Entry], columns: int) -> list[list[Entry]]:
    return [list(entries[k : k + columns]) for k in range(0, len(entries), columns)]


def hardest_frames(frames: Sequence[Mapping[str, Any]], count: int) -> list[int]:
    """Frames in which skinning is furthest from the reference, well apart from each other, in order."""
    apart = max(1, len(frames) // (2 * count))
    chosen: list[int] = []
    for entry in sorted(frames, key=lambda entry: -entry["rmse_mm"]["skinning"]):
        if len(chosen) < count and all(abs(entry["frame"] - other) >= apart for other in chosen):
            chosen.append(int(entry["frame"]))
    return sorted(chosen)


def _span(frames: range) -> str:
    return f"{frames[0]}:{frames[-1]}"


def _errors(result: Mapping[str, Any]) -> str:
    return f"{result['rmse_mm']['ours']:.1f} mm (skinning {result['rmse_mm']['skinning']:.1f})"
