"""What a frame of the coarse simulation costs one CPU core: the demo's shirt on about 700 vertices, 5 steps a frame.

The character does a spin kick; the shirt collides with a proxy of the body of about 20,000 triangles, and with the body
itself. Beside it: the fine solver taking the same steps, and Blender's own Cloth on the same coarse mesh and body with
as many steps and no self-collision. All times are processor time, of all threads, so that other work on the machine
counts for little.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from measure import Report, milliseconds, read_options, times
from outfit import SHELL, Outfit, SkinnedBody, dress
from wrinkle_synthesis.wrinkle_addon.body_proxy import make_body_proxy
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation, SolverSettings
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.coarse_layers import CoarseLayer, CoarseSettings, model_of
from wrinkle_synthesis.wrinkle_addon.coarse_mesh import make_coarse_mesh
from wrinkle_synthesis.wrinkle_addon.coarse_simulation import ITERATIONS, MODULES, TOLERANCE, CoarseSimulation
from wrinkle_synthesis.wrinkle_addon.garment import Garment, bind_to_surface, skin_garment
from wrinkle_synthesis.wrinkle_addon.launch_graph import LaunchGraph
from wrinkle_synthesis.wrinkle_addon.wearer import worn_limbs

FRAME = 1.0 / 30.0
MOST_MS = 12.0
GARMENT_SIZE, REPLAYS, PASSES = 4_000, 40, 4
FINE_FRAMES, CLOTH_FRAMES = 4, 12


@dataclass(frozen=True, eq=False)
class Clip:
    """A garment's coarse mesh and what moves it.

    Attributes:
        outfit: The character, with the coarse mesh for its garment.
        body: The body in each frame [m], shape [frame_count, body_vertex_count, 3].
        skin: The coarse mesh carried there by plain skinning [m], shape [frame_count, vertex_count, 3].
    """

    outfit: Outfit
    body: np.ndarray
    skin: np.ndarray

    @property
    def layer(self) -> CoarseLayer:
        garment = self.outfit.garment
        limbs = worn_limbs(self.outfit.rig, garment, self.outfit.body)
        return CoarseLayer(garment.name, garment.positions, garment.faces, limbs=limbs)


def make_clip(*, quick: bool) -> Clip:
    outfit = dress([SHELL], 0) if quick else dress(["shirt"], GARMENT_SIZE)
    fine = outfit.garment
    mesh = make_coarse_mesh(fine.name, fine.positions, fine.faces, 200 if quick else 700)
    weights = skin_garment(mesh.positions, mesh.faces, outfit.body)
    pins = np.zeros(len(mesh.positions), np.float32)
    outfit = replace(outfit, garment=Garment(fine.name, mesh.positions, mesh.faces, weights, pins))
    poses = outfit.poses()[: 6 if quick else None]
    source = SkinnedBody(outfit)
    skin = [weights.carry(pose.deformations(outfit.rig), mesh.positions) for pose in poses]
    body = [source.positions(pose) for pose in poses]
    return Clip(outfit, np.array(body, np.float32), np.array(skin, np.float32))


def play(simulation: CoarseSimulation, body: np.ndarray, skin: np.ndarray) -> tuple[np.ndarray, float]:
    """Milliseconds of each frame, the fastest of a few passes, and the deepest that a vertex got into the body [mm].

    Every pass is the same to the bit; what differs is how much the caches are shared with other work.
    """
    spent, deepest = np.zeros((PASSES, len(body) - 1)), 0.0
    for number in range(PASSES):
        simulation.start(body[0], [skin[0]])
        for frame, (positions, carried) in enumerate(zip(body[1:], skin[1:], strict=True)):
            started = time.process_time()
            report = simulation.step(positions, [carried], FRAME)
            spent[number, frame] = 1e3 * (time.process_time() - started)
            deepest = max(deepest, 1e3 * report.deepest)
    return spent.min(0), deepest


def measure_stages(simulation: CoarseSimulation, body: np.ndarray, skin: np.ndarray) -> dict[str, float]:
    """Where a frame's time goes [ms]: parts of a step recorded and replayed alone, times the steps of a frame."""
    contact, system, motion = simulation._contact, simulation._system, simulation._motion
    positions, steps, clock = motion.positions, simulation._steps, simulation._clock[0]
    stages: dict[str, tuple[int, Callable[[], Any]]] = {
        "search of the body": (1, contact.find),
        "body's normals, input": (1, lambda: (simulation._given(body[-1], [skin[-1]]), contact.move_body(body[-1]))),
    }
    recorded = {
        "moving the body": lambda: contact.launch_move(clock),
        "contact": lambda: (
            contact.launch_freeze(motion, clock),
            contact.launch_expel(motion, clock),
            contact.launch_follow(),
        ),
        "forces": simulation._launch_gradient,
        "matrix": lambda: (
            system.assemble(positions, simulation._inverse_dt2, simulation._kept),
            system.precondition(positions),
        ),
        "conjugate gradients": lambda: (
            system.solution.zero_(),
            system.launch_solve(simulation._gradient, simulation._moving, TOLERANCE, ITERATIONS),
        ),
    }
    for name, act in recorded.items():
        stages[name] = steps, LaunchGraph(act, MODULES, simulation.device)
    spent = {}
    state = simulation.state()
    for name, (count, act) in stages.items():
        simulation.restore(state)
        started = time.process_time()
        for _ in range(REPLAYS):
            act()
        spent[name] = 1e3 * count * (time.process_time() - started) / REPLAYS
    simulation.restore(state)
    return spent


def measure_fine(clip: Clip, frames: int) -> float:
    """Milliseconds that the fine solver takes for a frame in as many steps of second order."""
    layer = clip.layer
    steps = layer.settings.steps
    fine = ClothSimulation(
        model_of(layer),
        clip.outfit.body.faces,
        clip.body[0],
        contact_settings=ContactSettings(self_thickness=0.0),
        solver_settings=SolverSettings(order=2),
        limbs=layer.limbs,
    )
    fine.start(clip.skin[0])
    fine.step(clip.body[0], FRAME / steps)
    started = time.process_time()
    for last, coming in zip(clip.body[:frames], clip.body[1 : frames + 1], strict=True):
        for step in range(1, steps + 1):
            share = step / steps
            fine.step((1.0 - share) * last + share * coming, FRAME / steps)
    return 1e3 * (time.process_time() - started) / frames


def measure_cloth(clip: Clip, frames: int) -> float:
    """Milliseconds that a frame of Blender's Cloth takes more than one of the character alone."""
    from stage import TUNED_DISTANCES, add_cloth, open_stage

    stage = open_stage(clip.outfit)
    cloth = add_cloth(stage, "cloth", quality=CoarseSettings().steps, distances=TUNED_DISTANCES)
    stage.body.modifiers.new("Collision", "COLLISION")
    stage.body.collision.thickness_outer = cloth.modifiers["Cloth"].collision_settings.distance_min

    def spent(shown: str | None) -> float:
        stage.show(shown)
        stage.play(1)
        started = time.process_time()
        for frame in range(2, 2 + frames):
            stage.play(frame)
        return 1e3 * (time.process_time() - started) / frames

    alone = spent(None)
    return spent("cloth") - alone


def faces_under(clip: Clip) -> np.ndarray:
    """Triangles of the body that the garment lies over."""
    garment, body = clip.outfit.garment, clip.outfit.body
    return np.unique(bind_to_surface(garment.positions, body.positions, body.faces).faces)


def main() -> None:
    report = Report("coarse", read_options(__doc__))
    quick, device = report.options.quick, report.options.device
    clip = make_clip(quick=quick)
    body = clip.outfit.body
    proxy = make_body_proxy(body.positions, body.faces, 2_000 if quick else 10_000)
    carried = np.array([proxy.carry(positions) for positions in clip.body])
    on_proxy = replace(clip.layer, limbs=worn_limbs(clip.outfit.rig, clip.outfit.garment, proxy.of_body(body)))
    simulation = CoarseSimulation([on_proxy], proxy.faces, proxy.carry(body.positions), device=device)
    frame, deepest = play(simulation, carried, clip.skin)
    stages = measure_stages(simulation, carried, clip.skin)
    whole, whole_deepest = play(
        CoarseSimulation([clip.layer], body.faces, body.positions, device=device), clip.body, clip.skin
    )
    near = np.abs(proxy.gaps(body.positions)[np.unique(body.faces[faces_under(clip)])])
    fine = measure_fine(clip, 1 if quick else FINE_FRAMES)
    cloth = measure_cloth(clip, 2 if quick else CLOTH_FRAMES)
    frame_ms = float(frame.mean())
    rows = [["", "a frame", "of ours"]]
    for name, spent in (
        (f"on a proxy of {len(proxy.faces)} triangles", frame_ms),
        (f"on the body of {len(body.faces)} triangles", float(whole.mean())),
        ("fine solver, the same steps", fine),
        ("Blender's Cloth, the same steps", cloth),
    ):
        rows.append([name, milliseconds(1e-3 * spent), times(spent / frame_ms)])
    count = clip.outfit.garment.vertex_count
    report.table(f"{count} vertices, {simulation._steps} steps a frame, processor time", rows)
    report.table("where it goes", [["", "a frame"], *([name, milliseconds(1e-3 * ms)] for name, ms in stages.items())])
    report.line(f"  deepest in the proxy {deepest:.1f} mm, on the body itself {whole_deepest:.1f} mm")
    report.line(
        f"  proxy and body under the garment: {1e3 * near.mean():.2f} mm apart, at most {1e3 * near.max():.1f} mm"
    )
    report.target("milliseconds a frame", frame_ms, MOST_MS, at_least=False)
    report.figures |= {
        "vertices": count,
        "body_triangles": len(proxy.faces),
        "frame_ms": frame_ms,
        "slowest_frame_ms": float(frame.max()),
        "whole_body_frame_ms": float(whole.mean()),
        "stage_ms": stages,
        "times_faster_than_fine": fine / frame_ms,
        "times_faster_than_blender_cloth": cloth / frame_ms,
        "deepest_mm": deepest,
        "whole_body_deepest_mm": whole_deepest,
        "proxy_mean_gap_mm": 1e3 * float(near.mean()),
        "proxy_most_gap_mm": 1e3 * float(near.max()),
    }
    report.finish()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender as a module does not always end with Python.
    os._exit(0)


if __name__ == "__main__":
    main()
