"""A case of :mod:`sleeve` in this project's solver, in Newton's VBD and in Blender's own Cloth.

Each is a generator of the cloth's positions [m] after every frame, the same fabric put into its own words.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sleeve import CONTACT, FABRIC, Case, Faces, FloatArray, Motion
from wrinkle_synthesis.wrinkle_addon.cloth import STANDARD_GRAVITY, ClothSimulation
from wrinkle_synthesis.wrinkle_addon.cloth_model import ClothModel, build_cloth_model
from wrinkle_synthesis.wrinkle_addon.pc2 import write_pc2
from wrinkle_synthesis.wrinkle_addon.reference import SimulationSettings
from wrinkle_synthesis.wrinkle_addon.topology import mesh_edges

FRAME_RATE = 30

Frames = Iterator[FloatArray]

PIN_STIFFNESS = 1.0e4
WALK = 1.0 / 20.0
"""Time of the motion between two shapes that settling walks through [s]: 3 degrees of the elbow."""
RESIDUAL = 0.1
"""What settling goes down to, in nodal weights."""
STEPS_HERE = SimulationSettings().substeps
"""Time steps a frame."""

NEWTON_STEPS, NEWTON_ITERATIONS = 5, 10
"""Time steps a frame, and iterations a step: Newton's own default."""
NEWTON_CARRIER = 100.0
"""Mass of a particle of what is carried [kg], ten million times that of one of the cloth."""
BLENDER_STEPS = 15
"""Time steps a frame. Blender's bending takes explicit steps: with 10 the level strip trembles for ever."""
BLENDER_MASS = 0.3
"""Blender's default mass of a vertex [kg], which its air damping is made for; only stiffness per mass matters."""


def model_of(case: Case) -> ClothModel:
    return build_cloth_model(case.rest, case.faces, FABRIC)


# --- this project -------------------------------------------------------------------------------------------------


def simulation_of(case: Case, device: str) -> ClothSimulation:
    body, faces = case.body(0.0), case.body_faces
    if not len(faces):
        # Far away.
        body, faces = np.array([[0.0, 0.0, -100.0], [1.0, 0.0, -100.0], [0.0, 1.0, -100.0]]), np.array([[0, 1, 2]])
    simulation = ClothSimulation(
        model_of(case), faces, body, pin_stiffness=PIN_STIFFNESS * case.pinned, contact_settings=CONTACT, device=device
    )
    simulation.set_gravity([0.0, 0.0, -case.gravity])
    simulation.place_pins(case.carried(0.0))
    simulation.start(case.carried(0.0))
    return simulation


def equilibrium(case: Case, device: str) -> FloatArray:
    """Where the cloth rests at the start of a case [m], to a residual that is small even where its weight is."""
    simulation = simulation_of(case, device)
    simulation.settle(1e-3 * case.gravity / STANDARD_GRAVITY, 500)
    return simulation.positions[0]


def settle_here(case: Case, device: str) -> Frames:
    """As a bake does: settle, walk with the body, settle. What comes after that are time steps from rest."""
    simulation = simulation_of(case, device)
    simulation.settle(RESIDUAL, 100)
    times = np.arange(0.0, case.duration + 0.5 * WALK, WALK)
    for before, time in itertools.pairwise(times):
        moved = case.carried(time) - case.carried(before)
        if moved.any():
            simulation.place_pins(case.carried(time))
            simulation.follow(case.body(time), simulation.positions[0] + moved)
    simulation.settle(RESIDUAL, 100)
    yield simulation.positions[0]
    while True:
        for _ in range(STEPS_HERE):
            simulation.step(simulation.body_positions[0], 1.0 / FRAME_RATE / STEPS_HERE)
        yield simulation.positions[0]


def step_here(case: Case, device: str) -> Frames:
    """Time steps with inertia."""
    simulation = simulation_of(case, device)
    dt = 1.0 / FRAME_RATE / STEPS_HERE
    step = 0
    while True:
        for _ in range(STEPS_HERE):
            step += 1
            simulation.place_pins(case.carried(step * dt))
            simulation.step(case.body(step * dt) if len(case.body_faces) else simulation.body_positions[0], dt)
        yield simulation.positions[0]


# --- Newton -------------------------------------------------------------------------------------------------------


def step_in_newton(case: Case, device: str) -> Frames:
    """What is carried, the arm and the pins, takes part as very heavy cloth without stiffness, thrown along its way.

    Newton's rigid shapes cannot bend, and particles that it holds still know no velocity, which friction needs.
    """
    import newton
    import warp as wp

    count = len(case.rest)
    # Lame's constants of a membrane, from Young's modulus and Poisson's ratio in the plane.
    stretch, _, _, shear = FABRIC.stiffness
    # Newton damps C = 2 E + I, so a quarter of the viscosity.
    cloth = {"tri_ke": shear, "tri_ka": stretch - 2.0 * shear, "tri_kd": 0.25 * stretch * FABRIC.damping}
    nothing = dict.fromkeys(cloth, 0.0)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -case.gravity))
    for positions, faces, membrane in ((case.rest, case.faces, cloth), (case.body(0.0), case.body_faces, nothing)):
        if len(faces):
            builder.add_cloth_mesh(
                pos=wp.vec3(0.0),
                rot=wp.quat_identity(),
                scale=1.0,
                vel=wp.vec3(0.0),
                vertices=[wp.vec3(*p) for p in positions],
                indices=faces.ravel().tolist(),
                density=FABRIC.density,
                edge_ke=0.0,
                edge_kd=0.0,
                particle_radius=0.5 * CONTACT.thickness,
                **membrane,
            )
    carried = np.concatenate([case.pinned, np.ones(len(case.body(0.0)), bool)])
    for particle in np.flatnonzero(carried):
        builder.particle_mass[particle] = NEWTON_CARRIER
    builder.color(include_bending=True)
    model = builder.finalize(device=device)
    model.edge_bending_properties = wp.array(
        newton_hinges(case, model.edge_indices.numpy(), model.edge_rest_length.numpy()), device=device
    )
    # Half way into the contact its force is that of the one here.
    model.soft_contact_ke = 0.5 * CONTACT.pressure * model_of(case).area.mean() / CONTACT.thickness
    model.soft_contact_kd, model.soft_contact_mu = 0.0, FABRIC.friction
    solver = newton.solvers.SolverVBD(
        model=model,
        iterations=NEWTON_ITERATIONS,
        particle_enable_self_contact=True,
        particle_self_contact_margin=CONTACT.thickness,
        particle_self_contact_gap=CONTACT.thickness,
    )
    now, then, control = model.state(), model.state(), model.control()
    now.particle_q.assign(np.concatenate([case.carried(0.0), case.body(0.0)]))
    dt = 1.0 / FRAME_RATE / NEWTON_STEPS
    weightless = np.where(carried[:, None], [0.0, 0.0, NEWTON_CARRIER * case.gravity], 0.0)
    for step in itertools.count(1):
        places, speeds = now.particle_q.numpy(), now.particle_qd.numpy()
        goal = np.concatenate([case.carried(step * dt), case.body(step * dt)])
        speeds[carried] = (goal - places)[carried] / dt
        now.particle_qd.assign(speeds)
        now.particle_f.assign(weightless)
        solver.step(now, then, control, None, dt)
        now, then = then, now
        if step % NEWTON_STEPS == 0:
            yield now.particle_q.numpy()[:count].astype(np.float64)


def newton_hinges(case: Case, edges: Faces, lengths: NDArray[np.float32]) -> NDArray[np.float32]:
    """Newton's stiffness of every edge, which it multiplies by the edge's length [N], and damping: [edge_count, 2]."""
    hinges = model_of(case).hinges
    assert hinges is not None
    rest, _ = hinges
    keys = {tuple(sorted(ends)): k for ends, k in zip(rest.vertices[:, :2].tolist(), rest.stiffness, strict=True)}
    stiffness = [keys.get(tuple(sorted(ends)), 0.0) for ends in edges[:, 2:].tolist()]
    return np.stack([np.array(stiffness) / lengths, np.zeros(len(edges))], 1).astype(np.float32)


# --- Blender ------------------------------------------------------------------------------------------------------

BLENDER_SECOND = math.sqrt(1000.0)
"""Blender's Cloth multiplies gravity by 0.001, as if a frame took 1 / sqrt(1000) s; stiffness is per that squared."""


def step_in_blender(case: Case, device: str) -> Frames:
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.gravity = (0.0, 0.0, -case.gravity)
    scene.render.fps = FRAME_RATE
    with tempfile.TemporaryDirectory() as folder:
        if len(case.body_faces):
            arm = add_moving("arm", case.body, case.body_faces, case.duration, Path(folder))
            arm.modifiers.new("Collision", "COLLISION")
            # Blender keeps 8/9 of the sum of both distances, and of twice the one from itself.
            arm.collision.thickness_outer = 9.0 / 16.0 * CONTACT.thickness
            arm.collision.cloth_friction = 100.0 * FABRIC.friction
        cloth = add_moving("cloth", case.carried, case.faces, case.duration, Path(folder))
        add_cloth(cloth, case)
        frame = 1
        scene.frame_set(frame)
        while True:
            frame += 1
            scene.frame_set(frame)
            mesh = cloth.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
            positions = np.empty(3 * len(mesh.vertices), np.float32)
            mesh.attributes["position"].data.foreach_get("vector", positions)
            yield positions.reshape(-1, 3).astype(np.float64)


def add_moving(name: str, motion: Motion, faces: Faces, duration: float, folder: Path):
    """An object that moves so from frame 1 on."""
    import bpy

    start = motion(0.0)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(start.tolist(), [], faces.tolist())
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(ob)
    count = round(duration * FRAME_RATE) + 2
    frames = (motion(k / FRAME_RATE).astype(np.float32) for k in range(count))
    write_pc2(folder / f"{name}.pc2", len(start), 1, frames, count)
    cache = ob.modifiers.new("Cache", "MESH_CACHE")
    cache.cache_format, cache.filepath, cache.frame_start = "PC2", str(folder / f"{name}.pc2"), 1
    return ob


def add_cloth(ob, case: Case) -> None:
    """Blender's Cloth with the fabric in its units."""
    group = ob.vertex_groups.new(name="pinned")
    group.add(np.flatnonzero(case.pinned).tolist(), 1.0, "REPLACE")
    modifier = ob.modifiers.new("Cloth", "CLOTH")
    settings, collisions = modifier.settings, modifier.collision_settings
    settings.vertex_group_mass = "pinned"
    settings.quality, settings.time_scale = BLENDER_STEPS, BLENDER_SECOND / FRAME_RATE
    settings.mass = BLENDER_MASS
    stiffness, damping, bending = blender_units(case)
    settings.tension_stiffness = settings.compression_stiffness = stiffness
    settings.tension_damping = settings.compression_damping = damping
    settings.bending_stiffness, settings.bending_damping = bending, 0.0
    collisions.collision_quality = 2
    collisions.use_self_collision = bool(len(case.body_faces))
    collisions.distance_min = collisions.self_distance_min = 9.0 / 16.0 * CONTACT.thickness
    collisions.self_friction = 0.0
    modifier.point_cache.frame_start, modifier.point_cache.frame_end = 1, 100_000


def blender_units(case: Case) -> tuple[float, float, float]:
    """Stiffness of springs, their damping, and bending stiffness, each as Blender's settings have it.

    A net of equilateral triangles with springs of stiffness k [N/m] has Young's modulus 2 k / sqrt(3) [N/m]. Blender's
    k is the setting over the mean length of all springs. Its bending turns two triangles about their edge with the
    moment 0.1 s l h / 3 per angle, for the setting s, the edge's length l and the triangles' height h.
    """
    model = model_of(case)
    ends = mesh_edges(case.faces)[0]
    length = np.linalg.norm(case.rest[ends[:, 1]] - case.rest[ends[:, 0]], axis=1)
    # Its unit of force: its mass over its second squared.
    force = BLENDER_MASS / model.mass.mean() / BLENDER_SECOND**2
    spring = force * 0.5 * math.sqrt(3.0) * max(np.atleast_1d(FABRIC.stretch))
    assert model.hinges is not None
    moment = force * model.hinges[0].stiffness
    height = 2.0 * model.rest_area.mean() / length.mean()
    bending = 30.0 * moment.mean() / (length.mean() * height)
    return spring * length.mean(), spring * FABRIC.damping * BLENDER_SECOND, bending
