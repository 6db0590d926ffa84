"""How small a recorded garment becomes as a wrinkle flow, and how fast it is replayed at 46,000 vertices.

Sizes are of one recording at one error: beside a point cache, Alembic and shape keys of the same frames, and beside
principal components of posed residuals in plain half precision, as in the paper. The recording is the one that is given
(`--scene`, `--recording`), such as a full simulation; left out, travelling folds by a formula, which tell nothing of
real cloth. A replayed frame is frame_set with all its handlers, and reading the evaluated garment.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measure import (
    COPIED_BYTES,
    Contestant,
    Options,
    Report,
    memory_bandwidth,
    milliseconds,
    read_options,
    side_by_side,
    times,
    undisturbed,
)
from outfit import SHELL, dress
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.flow import FlowMethod
from wrinkle_synthesis.wrinkle_addon.flow_components import Components, find_components
from wrinkle_synthesis.wrinkle_addon.flow_compress import FlowSource, Goal, compress
from wrinkle_synthesis.wrinkle_addon.flow_file import write_flow
from wrinkle_synthesis.wrinkle_addon.flow_residuals import Residuals, ResidualSpace
from wrinkle_synthesis.wrinkle_addon.pc2 import HEADER, write_pc2
from wrinkle_synthesis.wrinkle_addon.recordings import Recording
from wrinkle_synthesis.wrinkle_addon.rig import FloatArray

VERTICES, COMPONENTS, FRAMES, PASSES = 46_500, 35, 20, 6
ERROR_MM, LEAST_TIMES, MOST_MS, MOST_TIMES_BANDWIDTH = 0.5, 30.0, 5.0, 2.0
CURVE_MM = (4.0, 2.0, 1.0, 0.5, 0.25)
NAMES = {"flow": "wrinkle flow", "cache": "point cache (PC2)", "skinned": "skinned garment", "none": "body alone"}


def main() -> None:
    report = Report("flow", read_options(__doc__, picture=True, recording=True))
    with tempfile.TemporaryDirectory() as name:
        measure_sizes(report, Path(name))
        measure_frames(report, Path(name))
    report.finish()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(0)


# --- sizes --------------------------------------------------------------------------------------------------------


def measure_sizes(report: Report, folder: Path) -> None:
    import bpy

    source, garment = recorded(report.options)
    made = compress(source, Goal(rms_mm=ERROR_MM))
    frames, vertices = source.recording.frame_count, source.recording.vertex_count
    sizes = {"flow": write_flow(folder / "clip.flow", made.header, made.rig, made.code)}
    sizes["pc2"] = HEADER.size + 12 * vertices * frames
    found = paper_components(source)
    needed = paper_count(found, ERROR_MM)
    sizes["paper"] = paper_bytes(needed, vertices, frames)
    cache = folder / "clip.pc2"
    start = round(source.recording.start)
    positions = (np.asarray(frame, np.float32) for frame in source.recording.frames)
    write_pc2(cache, vertices, start, positions, frames)
    if bpy.app.build_options.alembic:
        from wrinkle_synthesis.wrinkle_addon.blender.exporters import export_garment

        export_garment(garment, cache, range(start, start + frames), folder / "clip.abc", folder)
        sizes["alembic"] = (folder / "clip.abc").stat().st_size
    sizes["shape_keys"] = shape_key_bytes(garment, source.recording, folder / "keys.blend")
    names = {
        "flow": f"wrinkle flow, {made.flow.component_count} components",
        "paper": f"the paper's, half precision, {needed} components",
        "pc2": "point cache (PC2)",
        "alembic": "Alembic",
        "shape_keys": "shape keys in a compressed .blend file",
    }
    rows = [["", "MB", "of ours"]]
    rows += [[names[key], f"{size / 1e6:.3g}", times(size / sizes["flow"])] for key, size in sizes.items()]
    kind = source.recording.name
    report.table(f"{kind}: {vertices} vertices, {frames} frames, at {ERROR_MM} mm RMS", rows)
    report.line(
        f"  measured: {made.rms_mm:.3g} mm RMS, {made.max_mm:.3g} mm at most; skinning {made.skinning_mm:.3g} mm"
    )
    if report.options.recording is not None:
        ratio = sizes["pc2"] / sizes["flow"]
        report.target("times smaller than PC2", ratio, LEAST_TIMES, at_least=True)
    report.figures |= {
        "recording": kind,
        "recorded_vertices": vertices,
        "recorded_frames": frames,
        "components": made.flow.component_count,
        "paper_components": needed,
        "rmse_mm": made.rms_mm,
        "max_mm": made.max_mm,
        "skinning_mm": made.skinning_mm,
        **{f"{key}_bytes": size for key, size in sizes.items()},
        **{f"times_smaller_than_{key}": size / sizes["flow"] for key, size in sizes.items() if key != "flow"},
    }
    if report.options.picture is not None:
        from flow_picture import draw_shapes
        from wrinkle_synthesis.wrinkle_addon.blender.character import read_mesh

        path = report.options.picture
        draw(source, found, report, path)
        draw_shapes(source, made, read_mesh(garment.data)[1], path.with_name(f"{path.stem}_shapes{path.suffix}"))


def recorded(options: Options) -> tuple[FlowSource, Any]:
    """The recording that is given, or one of formulas, and its garment object."""
    import bpy
    import wrinkle_synthesis

    if not hasattr(bpy.types.Object, "wrinkles"):
        wrinkle_synthesis.register()
    from wrinkle_synthesis.wrinkle_addon.blender.flow_recording import RecordingChoice, read_source
    from wrinkle_synthesis.wrinkle_addon.blender.handlers import suspended
    from wrinkle_synthesis.wrinkle_addon.steps import finish

    if options.scene is not None and options.recording is not None:
        bpy.ops.wm.open_mainfile(filepath=str(options.scene), load_ui=False)
        garment = next(ob for ob in bpy.data.objects if ob.type == "MESH" and ob.wrinkles.armature is not None)
        with suspended():
            steps = read_source(garment, RecordingChoice(str(options.recording), range(0)))
            return finish(steps, lambda share, text: None), garment
    from stage import open_stage

    stage = open_stage(dress([SHELL], 0) if options.quick else dress(["shirt"], 12_000))
    return formula_source(stage), stage.garments["skinned"]


def formula_source(stage: Any) -> FlowSource:
    """The stage's garment, skinned, with folds that travel over it by a formula."""
    from wrinkle_synthesis.wrinkle_addon.blender.flow_recording import mesh_topology

    outfit, poses = stage.outfit, stage.outfit.poses()
    ob = stage.add_garment("skinned")
    garment = outfit.garment
    frames = np.zeros((len(poses), garment.vertex_count, 3), np.float32)
    for number, pose in enumerate(poses):
        folds = travelling_folds(garment.positions, garment.normals, number / 24.0)
        turned = rotations.rotate(garment.weights.turn(pose.turns(outfit.rig)), folds)
        frames[number] = garment.weights.carry(pose.deformations(outfit.rig), garment.positions) + turned
    to_rig = np.tile(np.eye(4), (len(poses), 1, 1))
    recording = Recording("folds by a formula", frames, 1.0, np.eye(4))
    topology = mesh_topology(ob.data)
    return FlowSource(recording, outfit.rig, poses, to_rig, ob.name, topology, garment.positions, garment.weights)


def travelling_folds(positions: FloatArray, normals: FloatArray, seconds: float) -> FloatArray:
    """Offsets of up to 10 mm along the normals [m], shape [vertex_count, 3]."""
    waves = np.zeros(len(positions))
    for number in range(12):
        direction = np.array([np.cos(number), np.sin(2.0 * number), np.sin(number)])
        waves += np.sin((20.0 + 6.0 * number) * positions @ direction + (1.0 + 0.7 * number) * seconds) / (1.0 + number)
    return 0.004 * waves[:, None] * normals


def paper_components(source: FlowSource) -> Components:
    """Principal components of posed residuals, as the paper takes them."""
    residuals = Residuals(
        source.recording,
        source.rig,
        source.poses,
        source.to_rig,
        source.rest,
        source.weights,
        space=ResidualSpace.POSED,
    )
    return find_components(residuals, source.recording.frame_count - 1, (0.5e-3 * min(CURVE_MM)) ** 2)


def paper_count(found: Components, error_mm: float) -> int:
    """Components that leave no more than an error."""
    return next((k for k in range(found.count + 1) if found.lost(k) <= (1e-3 * error_mm) ** 2), found.count)


def paper_bytes(components: int, vertices: int, frames: int) -> int:
    """O(3nk + km) in half precision, with the mean (F05)."""
    return 2 * (3 * vertices * (components + 1) + frames * components)


def shape_key_bytes(garment: Any, recording: Recording, path: Path) -> int:
    """Size of a compressed .blend file with one shape key a frame."""
    import bpy

    ob = bpy.data.objects.new("keys", garment.data.copy())
    ob.shape_key_add(name="Basis")
    for number, frame in enumerate(recording.frames):
        key = ob.shape_key_add(name=f"{number}")
        key.points.foreach_set("co", np.ascontiguousarray(frame, np.float32).ravel())
    bpy.data.libraries.write(str(path), {ob.data}, compress=True)
    keyed = ob.data
    bpy.data.objects.remove(ob)
    bpy.data.meshes.remove(keyed)
    return path.stat().st_size


def draw(source: FlowSource, found: Components, report: Report, path: Path) -> None:
    """Size against error: ours, the paper's, and what holds every position."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    frames, vertices = source.recording.frame_count, source.recording.vertex_count
    figure, axes = pyplot.subplots(figsize=(7, 5.0))
    ours = [compress(source, Goal(rms_mm=error)) for error in CURVE_MM]
    axes.loglog([made.code.size / 1e6 for made in ours], [made.rms_mm for made in ours], "o-", label="wrinkle flow")
    counts = [paper_count(found, error) for error in CURVE_MM]
    sizes = [paper_bytes(count, vertices, frames) / 1e6 for count in counts]
    errors = [1e3 * np.sqrt(found.lost(count)) for count in counts]
    axes.loglog(sizes, errors, "s-", label="components in half precision (the paper's)")
    for key, name, line in (("pc2", "PC2", ":"), ("alembic", "Alembic", "--"), ("shape_keys", "shape keys", "-.")):
        if f"{key}_bytes" in report.figures:
            axes.axvline(report.figures[f"{key}_bytes"] / 1e6, linestyle=line, color="#555555", label=name)
    axes.set(xlabel="size (MB)", ylabel="RMS error (mm)", title=f"{vertices} vertices, {frames} frames")
    axes.set_yticks(CURVE_MM, [f"{error:g}" for error in CURVE_MM], minor=False)
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncol=3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


# --- frames -------------------------------------------------------------------------------------------------------


def measure_frames(report: Report, folder: Path) -> None:
    """Whole frames in Blender, and the evaluator alone beside the bytes that it must read."""
    import bpy
    from stage import Stage, add_point_cache, open_stage

    quick = report.options.quick
    stage: Stage = open_stage(dress([SHELL], 0) if quick else dress(["shirt", "trousers"], VERTICES))
    source = formula_source(stage)
    made = compress(source, Goal(components=COMPONENTS))
    write_flow(folder / "frames.flow", made.header, made.rig, made.code)
    ob = stage.add_garment("flow")
    ob.wrinkles.armature, ob.wrinkles.body = stage.armature, stage.body
    ob.wrinkles.flow.path, ob.wrinkles.flow.replays, ob.wrinkles.enabled = str(folder / "frames.flow"), True, True
    add_point_cache(stage, "cache", "flow", folder / "cache.pc2", range(1, stage.frame_count + 1))
    contestants = {
        key: Contestant(stage.play, lambda key=key: stage.show(key if key != "none" else None)) for key in NAMES
    }
    evaluator = FlowMethod(made.flow).bind(report.options.device)
    alone, bandwidth = evaluation(evaluator, source, made.flow.rig.names), memory_bandwidth(report.options.device, 2)
    contestants |= {"alone": Contestant(alone), "copy": Contestant(bandwidth)}
    seconds = side_by_side(contestants, frames_of(stage, quick), 1 if quick else PASSES)
    time = {key: undisturbed(values) for key, values in seconds.items()}
    rows = [["", "frame", "frames/s", "garment's part"]]
    for key, what in NAMES.items():
        part = milliseconds(time[key] - time["none"])
        rows.append([what, milliseconds(time[key]), f"{1.0 / time[key]:.0f}", part])
    count = source.recording.vertex_count
    report.table(f"{count} vertices, {made.flow.component_count} components, {bpy.app.version_string}", rows)
    touched = made.flow.shapes.nbytes + count * (12 + 12 + 8 * made.flow.weights.bones.shape[1])
    limit = touched / (2 * COPIED_BYTES / time["copy"])
    report.line(
        f"  evaluator alone {milliseconds(time['alone'])}; {touched / 1e6:.3g} MB at the speed of a copy take "
        f"{milliseconds(limit)}"
    )
    garment = 1e3 * (time["flow"] - time["none"])
    report.target("garment's part of a frame [ms]", garment, MOST_MS, at_least=False)
    if evaluator.device.is_cuda:
        report.target("evaluator over the memory limit", time["alone"] / limit, MOST_TIMES_BANDWIDTH, at_least=False)
    report.figures |= {
        "vertices": count,
        "frame_ms": 1e3 * time["flow"],
        "garment_ms": garment,
        "evaluator_ms": 1e3 * time["alone"],
        "ratio_to_bandwidth": time["alone"] / limit,
        "point_cache_frame_ms": 1e3 * time["cache"],
        "skinned_frame_ms": 1e3 * time["skinned"],
        "body_frame_ms": 1e3 * time["none"],
    }


def frames_of(stage: Any, quick: bool) -> list[int]:
    return stage.frames(2 if quick else FRAMES)


def evaluation(evaluator: Any, source: FlowSource, bones: Sequence[str]) -> Any:
    """An act that evaluates one frame, without Blender."""
    import warp as wp
    from wrinkle_synthesis.wrinkle_addon.rig import Pose

    rows = np.array([source.rig.index[name] for name in bones])
    poses = [Pose(pose.matrices[rows]) for pose in source.poses]
    out = wp.zeros(evaluator.vertex_count, dtype=wp.vec3, device=evaluator.device)

    def act(frame: int) -> None:
        evaluator.evaluate(poses[frame - 1], out, frame=float(frame))
        wp.synchronize_device(evaluator.device)

    return act


if __name__ == "__main__":
    main()
