"""Figures 2 and 9 of Wang et al. (2010), drawn again from what a demo has left in its folder.

    python -m wrinkle_synthesis.demo.figures demo-out --out figures

The demo's garment is given a coarse mesh and follows its simulation; synthesis alone, after the transfer and after the
push-out are set beside the demo's full simulation, by pictures and by sums of mean curvature.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..wrinkle_addon.evaluate import correlation
from ..wrinkle_addon.joint_wrinkles import Formulation
from ..wrinkle_addon.pc2 import PointCache
from ..wrinkle_addon.surface import SurfaceMeasures
from .picture import compose
from .rendering import come_close, quiet, use_cycles
from .results import Results
from .studio import make_playback, open_garment, paint_vertices, show_shape

Shapes = NDArray[np.float32]

FULL, SYNTHESIS, TRANSFER, FINAL = "full simulation", "synthesis alone", "after the transfer", "final"
SKINNING, NEAREST = "skinning", "nearest samples"
COLOURS = {FULL: "#2c5fb3", SYNTHESIS: "#2f9e44", FINAL: "#c0392b", SKINNING: "#999999"}
"""The paper's, and one for what it does not draw."""
SIZE, RAYS = (400, 440), 16
BRIGHTEST = 60.0
"""Mean curvature that is drawn brightest [1/m]."""


@dataclass(frozen=True, eq=False)
class Stages:
    """The garment in its object space [m], frame by frame, at each stage of the method and as simulated in full.

    Attributes:
        frames: Of the scene.
        shapes: By stage, shape [frame_count, vertex_count, 3].
        coarse: The coarse simulation, shape [frame_count, coarse_count, 3].
        faces, coarse_faces: Triangles of both.
    """

    frames: range
    shapes: dict[str, Shapes]
    coarse: Shapes
    faces: NDArray[np.int32]
    coarse_faces: NDArray[np.int32]


def play_stages(folder: Path, name: str, cache: Path) -> Stages:
    """Play a demo's clip through every stage.

    Args:
        folder: Of the demo.
        name: Of its garment.
        cache: Where the coarse simulation goes.
    """
    from ..wrinkle_addon.blender.character import apply, read_mesh
    from ..wrinkle_addon.blender.clip_synthesis import ClipSynthesis
    from ..wrinkle_addon.blender.coarse_setup import make_coarse
    from ..wrinkle_addon.blender.simulate_coarse import bake_coarse
    from ..wrinkle_addon.coarse_cache import CoarseCache

    recorded = PointCache(folder / "simulation.pc2")
    frames = range(int(recorded.start), int(recorded.start) + len(recorded.frames))
    garment = open_garment(folder / "scene.blend", name)
    settings = garment.wrinkles

    def played(formulation: Formulation | None = None) -> Shapes:
        return np.stack(list(ClipSynthesis(garment, folder / f"{name}.wrinkles", formulation).positions(frames)))

    settings.clear_of_body, settings.strength = False, 0.0
    shapes = {FULL: np.array(recorded.frames), SKINNING: played()}
    settings.strength = 1.0
    shapes |= {NEAREST: played(Formulation.NEAREST), SYNTHESIS: played()}
    settings.coarse_cache = str(cache.resolve())
    make_coarse(garment)
    for _ in bake_coarse(garment, frames[0], frames[-1], "cpu").frames:
        pass
    shapes[TRANSFER] = played()
    settings.clear_of_body = True
    shapes[FINAL] = played()
    simulated = CoarseCache.open(cache)
    to_garment = np.linalg.inv(np.array(garment.matrix_world, np.float64))
    coarse = [apply(to_garment, simulated.read(frame).positions[name].astype(np.float64)) for frame in frames]
    faces = (read_mesh(thing.data)[1].astype(np.int32) for thing in (garment, settings.coarse))
    return Stages(frames, shapes, np.stack(coarse).astype(np.float32), *faces)


# --- figure 9 -----------------------------------------------------------------------------------------------------


def curvature_sums(measures: SurfaceMeasures, shapes: Mapping[str, Shapes]) -> dict[str, NDArray[np.float64]]:
    """Sums of mean curvature over a garment [1/m] by stage, shape [frame_count] (W101)."""
    return {
        stage: np.array([measures.mean_curvature(shape.astype(np.float64)).sum(dtype=np.float64) for shape in frames])
        for stage, frames in shapes.items()
    }


def compare_sums(sums: Mapping[str, NDArray[np.float64]]) -> dict[str, dict[str, float | None]]:
    """How each stage's sums stand to the full simulation's.

    Returns:
        By stage: ``ratio`` of the sums over all frames, ``correlation`` over the frames, None where nothing varies,
        ``fluctuation``, the standard deviation over the frames to the full simulation's (W102).
    """
    full = sums[FULL]
    return {
        stage: {
            "ratio": float(values.sum() / full.sum()),
            "correlation": correlation(values.tolist(), full.tolist()),
            "fluctuation": float(values.std() / full.std()),
        }
        for stage, values in sums.items()
    }


def root_mean_square_mm(shapes: Shapes, reference: Shapes) -> float:
    """Root mean square distance of vertices [mm]; both shapes [vertex_count, 3] in metres, of one frame or of many."""
    return float(1e3 * np.sqrt(((shapes - reference) ** 2).sum(-1).mean()))


def draw_sums(frames: range, sums: Mapping[str, NDArray[np.float64]], path: Path) -> None:
    """Figure 9."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 4))
    for stage, colour in COLOURS.items():
        style = ":" if stage == SKINNING else "-"
        axes.plot(frames, 1e-3 * sums[stage], style, label=stage, color=colour)
    axes.set(xlabel="frame", ylabel="sum of mean curvature (1/mm)", ylim=(0.0, None))
    axes.legend(ncols=len(COLOURS), loc="lower center")
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


# --- figure 2 -----------------------------------------------------------------------------------------------------


def draw_shapes(stages: Stages, folder: Path, name: str, frame: int, out: Path) -> None:
    """Figure 2: full simulation, coarse simulation and ours in one frame, as cloth and by mean curvature (W100)."""
    import bpy

    recorded = folder / "simulation.pc2"
    with quiet():
        make_playback(folder / "scene.blend", name, recorded, out / "playback.blend")
    garment, scene = bpy.data.objects[name], bpy.context.scene
    use_cycles(scene, SIZE, RAYS)
    scene.frame_set(frame)
    come_close(scene, [PointCache(recorded)], frame)
    number = stages.frames.index(frame)
    columns = {
        FULL: (stages.shapes[FULL][number], stages.faces),
        "coarse simulation": (stages.coarse[number], stages.coarse_faces),
        "ours": (stages.shapes[FINAL][number], stages.faces),
    }
    rows: list[list[Path]] = [[], []]
    for column, (positions, faces) in enumerate(columns.values()):
        show_shape(garment, positions, faces)
        rows[0].append(_render(out / f"cloth-{column}.png"))
        curvature = SurfaceMeasures(faces, len(positions)).mean_curvature(positions.astype(np.float64))
        paint_vertices(garment, curvature_colours(curvature))
        rows[1].append(_render(out / f"curvature-{column}.png"))
    corners = [[f"frame {frame}", "", ""], [f"0 to {BRIGHTEST:.0f} 1/m", "", ""]]
    compose(rows, list(columns), corners, out / "figure_2.jpg")


def curvature_colours(curvature: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear colours from dark over red to white, shape [vertex_count, 4]."""
    from matplotlib import colormaps

    shown = np.asarray(colormaps["inferno"](np.clip(curvature / BRIGHTEST, 0.0, 1.0)), np.float32)
    shown[:, :3] **= 2.2
    return shown


def _render(path: Path) -> Path:
    import bpy

    bpy.context.scene.render.filepath = str(path.resolve())
    with quiet():
        bpy.ops.render.render(write_still=True)
    return path


# --- both ---------------------------------------------------------------------------------------------------------


def draw_figures(folder: Path, out: Path, frame: int | None = None) -> dict[str, Any]:
    """Draw both figures into ``out``, with ``figures.json``; returns what that holds.

    Args:
        folder: Of a demo that has been through its references.
        out: Where they go.
        frame: Of figure 2; left out, the one that the full simulation wrinkles most.
    """
    name = Results.recipe_of(folder)["garment"]
    out.mkdir(parents=True, exist_ok=True)
    stages = play_stages(folder, name, out / "coarse")
    sums = curvature_sums(SurfaceMeasures(stages.faces, stages.shapes[FULL].shape[1]), stages.shapes)
    draw_sums(stages.frames, sums, out / "figure_9.png")
    frame = stages.frames[int(sums[FULL].argmax())] if frame is None else frame
    draw_shapes(stages, folder, name, frame, out)
    report = {
        "garment": name,
        "vertices": stages.shapes[FULL].shape[1],
        "coarse_vertices": stages.coarse.shape[1],
        "frames": [stages.frames[0], stages.frames[-1]],
        "pictured_frame": frame,
        "stages": compare_sums(sums),
        "rmse_mm": {stage: root_mean_square_mm(shapes, stages.shapes[FULL]) for stage, shapes in stages.shapes.items()},
        "curvature_sums": {stage: np.round(values, 1).tolist() for stage, values in sums.items()},
    }
    (out / "figures.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return report


def build_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="Figures 2 and 9 of Wang et al. (2010).")
    parser.add_argument("folder", type=Path, help="folder of a demo")
    parser.add_argument("--out", type=Path, default=Path("figures"), help="folder for the figures")
    parser.add_argument("--frame", type=int, help="of figure 2; left out, the one that is wrinkled most")
    return parser


def main() -> None:
    options = build_parser().parse_args()
    report = draw_figures(options.folder, options.out, options.frame)
    for stage, found in report["stages"].items():
        measures = ", ".join(f"{measure} {value:.2f}" for measure, value in found.items())
        print(f"{stage:20} {measures}, {report['rmse_mm'][stage]:.1f} mm RMS")
    sys.stdout.flush()
    # Blender as a module does not always end with Python.
    os._exit(0)


if __name__ == "__main__":
    main()
