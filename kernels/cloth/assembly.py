"""Total energy, gradient and Hessian of the garment, gathered vertex by vertex and row by row.

Every sum has a fixed order and no atomics on floats, so a run repeats to the bit. The Hessian is a block matrix on
the one-ring of each vertex (3x3 blocks), plus scalars where only bending reaches, plus the self-contacts, which are
applied from their planes and never assembled.
"""

import warp as wp

from .bending import bending_gradient
from .contact import PLANES, contact_curvature, contact_energy, contact_force
from .friction import friction_energy, friction_hessian, friction_slope, tangential
from .membrane import mat32d, membrane_gradient, membrane_hessian, shape_gradient, tensile_part
from .self_contact import SLOTS, slot_separation

wp.set_module_options({"enable_backward": False})


@wp.struct
class Garment:
    """What never changes: topology, rest state and material. See ``wrinkle_addon/cloth_model.py``."""

    faces: wp.array2d[wp.int32]
    rest_inverse: wp.array[wp.mat22d]
    rest_area: wp.array[wp.float64]
    stiffness: wp.vec4d
    mass: wp.array[wp.float64]
    area: wp.array[wp.float64]
    corner_start: wp.array[wp.int32]
    corners: wp.array[wp.int32]
    bending_start: wp.array[wp.int32]
    bending_columns: wp.array[wp.int32]
    bending_coefficients: wp.array[wp.float64]
    pin_stiffness: wp.array[wp.float64]


@wp.struct
class Contact:
    """Frozen contact state of one linearisation.

    Arrays are [world_count, vertex_count], with vertex_count * PLANES or * SLOTS for planes and slots.
    """

    thickness: wp.float64
    pressure: wp.float64
    depth: wp.float64
    slip: wp.float64
    face: wp.array2d[wp.int32]
    point: wp.array2d[wp.vec3d]
    normal: wp.array2d[wp.vec3d]
    anchor: wp.array2d[wp.vec3d]
    friction_bound: wp.array2d[wp.float64]
    self_thickness: wp.float64
    self_pressure: wp.float64
    slot_count: wp.array2d[wp.int32]
    slot_triangle: wp.array2d[wp.int32]
    slot_weights: wp.array2d[wp.vec3]
    slot_normal: wp.array2d[wp.vec3]
    incident_start: wp.array[wp.int32]
    incident_count: wp.array[wp.int32]
    incident: wp.array[wp.int32]


@wp.func
def slot_force(
    positions: wp.array2d[wp.vec3d], garment: Garment, contact: Contact, world: wp.int32, vertex: wp.int32, slot: wp.int32
) -> wp.vec3d:
    """Force of one self-contact on its vertex [N]; its triangle takes the opposite."""
    face = contact.slot_triangle[world, slot]
    separation = slot_separation(positions, garment.faces, world, vertex, face, contact.slot_weights[world, slot])
    n = wp.vec3d(contact.slot_normal[world, slot])
    strength = contact.self_pressure * garment.area[vertex]
    return n * contact_force(wp.dot(separation, n), contact.self_thickness, strength, contact.self_thickness)


@wp.kernel
def vertex_energies(
    positions: wp.array2d[wp.vec3d],
    garment: Garment,
    contact: Contact,
    gravity: wp.array[wp.vec3d],
    inertia_target: wp.array2d[wp.vec3d],
    inverse_dt2: wp.array[wp.float64],
    pin_target: wp.array2d[wp.vec3d],
    # outputs
    energy: wp.array2d[wp.float64],
):
    """Energy of every vertex [J]: inertia, gravity, pins, its row of bending, contact, friction, self-contact."""
    world, vertex = wp.tid()
    half = wp.float64(0.5)
    x = positions[world, vertex]
    mass = garment.mass[vertex]
    moved = x - inertia_target[world, vertex]
    total = half * mass * inverse_dt2[world] * wp.dot(moved, moved) - mass * wp.dot(gravity[world], x)
    pulled = x - pin_target[world, vertex]
    total += half * garment.pin_stiffness[vertex] * wp.dot(pulled, pulled)
    total += half * wp.dot(
        x,
        bending_gradient(
            vertex,
            world,
            positions,
            garment.bending_start,
            garment.bending_columns,
            garment.bending_coefficients,
        ),
    )
    strength = contact.pressure * garment.area[vertex]
    for k in range(PLANES):
        plane = vertex * PLANES + k
        if contact.face[world, plane] >= 0:
            gap = wp.dot(x - contact.point[world, plane], contact.normal[world, plane])
            total += contact_energy(gap, contact.thickness, strength, contact.depth)
    bound = contact.friction_bound[world, vertex]
    if bound > wp.float64(0.0):
        drift = tangential(x - contact.anchor[world, vertex], contact.normal[world, vertex * PLANES])
        total += friction_energy(wp.length(drift), bound, contact.slip)
    self_strength = contact.self_pressure * garment.area[vertex]
    for k in range(contact.slot_count[world, vertex]):
        slot = vertex * SLOTS + k
        separation = slot_separation(
            positions,
            garment.faces,
            world,
            vertex,
            contact.slot_triangle[world, slot],
            contact.slot_weights[world, slot],
        )
        gap = wp.dot(separation, wp.vec3d(contact.slot_normal[world, slot]))
        total += contact_energy(gap, contact.self_thickness, self_strength, contact.self_thickness)
    energy[world, vertex] = total


@wp.kernel
def slot_forces(
    positions: wp.array2d[wp.vec3d],
    garment: Garment,
    contact: Contact,
    # outputs
    force: wp.array2d[wp.vec3],
):
    """Force of every self-contact on its vertex [N]."""
    world, vertex = wp.tid()
    for k in range(contact.slot_count[world, vertex]):
        slot = vertex * SLOTS + k
        force[world, slot] = wp.vec3(slot_force(positions, garment, contact, world, vertex, slot))


@wp.func
def gather_slots(
    force: wp.array2d[wp.vec3], contact: Contact, vertex_count: wp.int32, world: wp.int32, vertex: wp.int32
) -> wp.vec3:
    """Sum of a per-slot vector on one vertex: its own slots, minus its share as a corner of others' triangles."""
    total = wp.vec3()
    for k in range(contact.slot_count[world, vertex]):
        total += force[world, vertex * SLOTS + k]
    owner = world * vertex_count + vertex
    start = contact.incident_start[owner]
    for k in range(start, start + contact.incident_count[owner]):
        slot = contact.incident[k] // 3
        w = contact.slot_weights[world, slot]
        total -= w[contact.incident[k] % 3] * force[world, slot]
    return total


@wp.kernel
def gradient(
    positions: wp.array2d[wp.vec3d],
    garment: Garment,
    contact: Contact,
    gravity: wp.array[wp.vec3d],
    inertia_target: wp.array2d[wp.vec3d],
    inverse_dt2: wp.array[wp.float64],
    pin_target: wp.array2d[wp.vec3d],
    deformation: wp.array2d[mat32d],
    stress: wp.array2d[wp.vec3d],
    force: wp.array2d[wp.vec3],
    # outputs
    result: wp.array2d[wp.vec3d],
):
    """Derivative of the total energy by every vertex [N]; ``force`` comes from :func:`slot_forces`."""
    world, vertex = wp.tid()
    x = positions[world, vertex]
    mass = garment.mass[vertex]
    total = (mass * inverse_dt2[world]) * (x - inertia_target[world, vertex]) - mass * gravity[world]
    total += garment.pin_stiffness[vertex] * (x - pin_target[world, vertex])
    total += bending_gradient(
        vertex, world, positions, garment.bending_start, garment.bending_columns, garment.bending_coefficients
    )
    for k in range(garment.corner_start[vertex], garment.corner_start[vertex + 1]):
        triangle = garment.corners[k] // 3
        g = shape_gradient(garment.rest_inverse[triangle], garment.corners[k] % 3)
        total += garment.rest_area[triangle] * membrane_gradient(
            deformation[world, triangle], stress[world, triangle], g
        )
    strength = contact.pressure * garment.area[vertex]
    for k in range(PLANES):
        plane = vertex * PLANES + k
        if contact.face[world, plane] >= 0:
            n = contact.normal[world, plane]
            gap = wp.dot(x - contact.point[world, plane], n)
            total -= n * contact_force(gap, contact.thickness, strength, contact.depth)
    bound = contact.friction_bound[world, vertex]
    if bound > wp.float64(0.0):
        drift = tangential(x - contact.anchor[world, vertex], contact.normal[world, vertex * PLANES])
        total += friction_slope(wp.length(drift), bound, contact.slip) * drift
    total -= wp.vec3d(gather_slots(force, contact, contact.slot_count.shape[1], world, vertex))
    result[world, vertex] = total


@wp.kernel
def assemble_blocks(
    garment: Garment,
    deformation: wp.array2d[mat32d],
    stress: wp.array2d[wp.vec3d],
    exact: wp.bool,
    contribution_start: wp.array[wp.int32],
    contributions: wp.array[wp.int32],
    block_bending: wp.array[wp.float64],
    # outputs
    blocks: wp.array2d[wp.mat33],
):
    """Membrane and bending Hessian on the one-ring [N/m]; contributions are triangle * 9 + row * 3 + column.

    ``exact`` keeps compressive stress, for derivatives at equilibrium; Newton's method leaves it out.
    """
    world, entry = wp.tid()
    total = block_bending[entry] * wp.identity(n=3, dtype=wp.float64)
    for k in range(contribution_start[entry], contribution_start[entry + 1]):
        code = contributions[k]
        triangle = code // 9
        gi = shape_gradient(garment.rest_inverse[triangle], (code // 3) % 3)
        gj = shape_gradient(garment.rest_inverse[triangle], code % 3)
        s = stress[world, triangle]
        if not exact:
            s = tensile_part(s)
        total += garment.rest_area[triangle] * membrane_hessian(
            deformation[world, triangle], s, garment.stiffness, gi, gj
        )
    blocks[world, entry] = wp.mat33(total)


@wp.kernel
def assemble_diagonal(
    positions: wp.array2d[wp.vec3d],
    garment: Garment,
    contact: Contact,
    inverse_dt2: wp.array[wp.float64],
    diagonal_entry: wp.array[wp.int32],
    # in and out
    blocks: wp.array2d[wp.mat33],
    # outputs
    slot_stiffness: wp.array2d[wp.float32],
):
    """Add inertia, pins, contact and friction to the diagonal blocks, and find each self-contact's stiffness [N/m]."""
    world, vertex = wp.tid()
    identity = wp.identity(n=3, dtype=wp.float64)
    x = positions[world, vertex]
    total = (garment.mass[vertex] * inverse_dt2[world] + garment.pin_stiffness[vertex]) * identity
    strength = contact.pressure * garment.area[vertex]
    for k in range(PLANES):
        plane = vertex * PLANES + k
        if contact.face[world, plane] >= 0:
            n = contact.normal[world, plane]
            gap = wp.dot(x - contact.point[world, plane], n)
            total += contact_curvature(gap, contact.thickness, strength, contact.depth) * wp.outer(n, n)
    bound = contact.friction_bound[world, vertex]
    if bound > wp.float64(0.0):
        n = contact.normal[world, vertex * PLANES]
        drift = tangential(x - contact.anchor[world, vertex], n)
        total += friction_hessian(drift, n, bound, contact.slip)
    self_strength = contact.self_pressure * garment.area[vertex]
    for k in range(contact.slot_count[world, vertex]):
        slot = vertex * SLOTS + k
        separation = slot_separation(
            positions,
            garment.faces,
            world,
            vertex,
            contact.slot_triangle[world, slot],
            contact.slot_weights[world, slot],
        )
        gap = wp.dot(separation, wp.vec3d(contact.slot_normal[world, slot]))
        slot_stiffness[world, slot] = wp.float32(contact_curvature(gap, contact.self_thickness, self_strength, contact.self_thickness))
    entry = diagonal_entry[vertex]
    blocks[world, entry] = blocks[world, entry] + wp.mat33(total)


@wp.kernel
def precondition_diagonal(
    contact: Contact,
    slot_stiffness: wp.array2d[wp.float32],
    diagonal_entry: wp.array[wp.int32],
    blocks: wp.array2d[wp.mat33],
    # outputs
    inverse: wp.array2d[wp.mat33],
):
    """Inverse of each vertex's own block, self-contacts included [m/N]: the block Jacobi preconditioner."""
    world, vertex = wp.tid()
    total = blocks[world, diagonal_entry[vertex]]
    for k in range(contact.slot_count[world, vertex]):
        slot = vertex * SLOTS + k
        n = contact.slot_normal[world, slot]
        total += slot_stiffness[world, slot] * wp.outer(n, n)
    owner = world * contact.slot_count.shape[1] + vertex
    start = contact.incident_start[owner]
    for k in range(start, start + contact.incident_count[owner]):
        slot = contact.incident[k] // 3
        w = contact.slot_weights[world, slot][contact.incident[k] % 3]
        n = contact.slot_normal[world, slot]
        total += (w * w * slot_stiffness[world, slot]) * wp.outer(n, n)
    inverse[world, vertex] = wp.inverse(total)
