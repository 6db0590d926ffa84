"""Total energy, gradient and Hessian of the garment, gathered vertex by vertex and row by row.

Every sum has a fixed order and no atomics on floats, so a run repeats to the bit. The Hessian is a block matrix on
the one-ring of each vertex (3x3 blocks), plus scalars where only bending reaches, plus the self-contacts, which are
applied from their planes and never assembled.
"""

import warp as wp

from ..natural import natural
from .bending import bending_gradient
from .contact import contact_curvature, contact_energy, contact_force
from .friction import friction_energy, friction_hessian, friction_slope, tangential
from .membrane import mat32d, membrane_gradient, membrane_hessian
from .self_contact import pair_separation
from .touched_walls import PLANES

wp.set_module_options({"enable_backward": False})


@wp.struct
class Garment:
    """What never changes: topology and rest state. See ``wrinkle_addon/cloth_model.py``.

    ``shape_gradients`` [1/m] are those of the linear shape functions of every triangle's corners in material
    coordinates; ``corners`` lists triangle << 2 | corner around each vertex, since a division takes longer than a term.
    Rows of the bending matrix are four entries at a time.
    """

    faces: wp.array2d[wp.int32]
    rest_inverse: wp.array[wp.mat22d]
    shape_gradients: wp.array2d[wp.vec2d]
    rest_area: wp.array[wp.float64]
    mass: wp.array[wp.float64]
    area: wp.array[wp.float64]
    corner_start: wp.array[wp.int32]
    corners: wp.array[wp.int32]
    bending_start: wp.array[wp.int32]
    bending_columns: wp.array[wp.vec4i]
    bending_coefficients: wp.array[wp.vec4d]
    pin_stiffness: wp.array[wp.float64]


@wp.struct
class Contact:
    """Frozen contact state of one linearisation.

    Planes of the body are [world_count, vertex_count * PLANES], each with its own friction and ``share`` of the full
    pressure. Pairs of the garment with itself lie in one list for all worlds, the first ``pair_total``; each pushes
    four vertices by signed weights, see ``self_contact``. A vertex is known there as world * vertex_count + vertex.
    """

    thickness: wp.float64
    pressure: wp.float64
    depth: wp.float64
    slip: wp.float64
    face: wp.array2d[wp.int32]
    point: wp.array2d[wp.vec3d]
    normal: wp.array2d[wp.vec3d]
    hollow: wp.array2d[wp.vec3]
    share: wp.array2d[wp.float32]
    anchor: wp.array2d[wp.vec3d]
    friction_bound: wp.array2d[wp.float64]
    self_thickness: wp.float64
    pair_total: wp.array[wp.int32]
    pair_vertices: wp.array[wp.vec4i]
    pair_weights: wp.array[wp.vec4]
    pair_normal: wp.array[wp.vec3]
    pair_strength: wp.array[wp.float32]
    incident_start: wp.array[wp.int32]
    incident_count: wp.array[wp.int32]
    incident: wp.array[wp.int32]


@wp.func
def pair_gap(positions: wp.array[wp.vec3d], contact: Contact, pair: wp.int32) -> wp.float64:
    """Distance [m] of a pair's two points along its normal."""
    separation = pair_separation(positions, contact.pair_vertices[pair], contact.pair_weights[pair])
    return wp.dot(separation, wp.vec3d(contact.pair_normal[pair]))


@wp.kernel
def vertex_energies(
    positions: wp.array2d[wp.vec3d],
    garment: Garment,
    contact: Contact,
    gravity: wp.array[wp.vec3d],
    inertia_target: wp.array2d[wp.vec3d],
    inverse_dt2: wp.array[wp.float64],
    pin_target: wp.array2d[wp.vec3d],
    pair_energy: wp.array[wp.float64],
    # outputs
    energy: wp.array2d[wp.float64],
):
    """Energy of every vertex [J]: inertia, gravity, pins, its row of bending, contact, friction, self-contact.

    ``pair_energy`` comes from :func:`pair_forces`; a pair's energy is its first vertex's.
    """
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
    full = contact.pressure * garment.area[vertex]
    for k in range(PLANES):
        plane = vertex * PLANES + k
        if contact.face[world, plane] >= 0:
            strength = full * wp.float64(contact.share[world, plane])
            gap = wp.dot(x - contact.point[world, plane], contact.normal[world, plane])
            total += contact_energy(gap, contact.thickness, strength, contact.depth)
            drift = tangential(x - contact.anchor[world, plane], contact.normal[world, plane])
            total += friction_energy(wp.length(drift), contact.friction_bound[world, plane], contact.slip)
    owner = world * positions.shape[1] + vertex
    first = contact.incident_start[owner]
    for k in range(first, first + contact.incident_count[owner]):
        if contact.incident[k] & 3 == 0:
            total += pair_energy[contact.incident[k] >> 2]
    energy[world, vertex] = total


@wp.kernel
def pair_forces(
    positions: wp.array[wp.vec3d],
    contact: Contact,
    # outputs
    energy: wp.array[wp.float64],
    force: wp.array[wp.vec3],
):
    """Energy of every pair [J] and its force on its first point [N]; ``positions`` of all worlds in one row."""
    pair = wp.tid()
    if pair >= contact.pair_total[0]:
        return
    gap = pair_gap(positions, contact, pair)
    strength = wp.float64(contact.pair_strength[pair])
    energy[pair] = contact_energy(gap, contact.self_thickness, strength, contact.self_thickness)
    push = contact_force(gap, contact.self_thickness, strength, contact.self_thickness)
    force[pair] = wp.float32(push) * contact.pair_normal[pair]


@wp.func
def gather_pairs(force: wp.array[wp.vec3], contact: Contact, owner: wp.int32) -> wp.vec3:
    """Sum of a per-pair vector on one vertex, its weight in each."""
    total = wp.vec3()
    start = contact.incident_start[owner]
    for k in range(start, start + contact.incident_count[owner]):
        incident = natural(contact.incident[natural(k)])
        total += contact.pair_weights[incident >> 2][incident & 3] * force[incident >> 2]
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
    pair_force: wp.array[wp.vec3],
    # outputs
    result: wp.array2d[wp.vec3d],
):
    """Derivative of the total energy by every vertex [N]; ``pair_force`` comes from :func:`pair_forces`."""
    world, i = wp.tid()
    vertex = natural(i)
    x = positions[world, vertex]
    mass = garment.mass[vertex]
    total = (mass * inverse_dt2[world]) * (x - inertia_target[world, vertex]) - mass * gravity[world]
    total += garment.pin_stiffness[vertex] * (x - pin_target[world, vertex])
    total += bending_gradient(
        vertex, world, positions, garment.bending_start, garment.bending_columns, garment.bending_coefficients
    )
    for k in range(garment.corner_start[vertex], garment.corner_start[vertex + 1]):
        code = natural(garment.corners[natural(k)])
        triangle = code >> 2
        g = garment.shape_gradients[triangle, code & 3]
        total += garment.rest_area[triangle] * membrane_gradient(
            deformation[world, triangle], stress[world, triangle], g
        )
    full = contact.pressure * garment.area[vertex]
    for k in range(PLANES):
        plane = vertex * PLANES + k
        if contact.face[world, plane] >= 0:
            strength = full * wp.float64(contact.share[world, plane])
            n = contact.normal[world, plane]
            gap = wp.dot(x - contact.point[world, plane], n)
            total -= n * contact_force(gap, contact.thickness, strength, contact.depth)
            drift = tangential(x - contact.anchor[world, plane], n)
            total += friction_slope(wp.length(drift), contact.friction_bound[world, plane], contact.slip) * drift
    total -= wp.vec3d(gather_pairs(pair_force, contact, world * positions.shape[1] + vertex))
    result[world, vertex] = total


@wp.kernel
def assemble_blocks(
    garment: Garment,
    deformation: wp.array2d[mat32d],
    tangent: wp.array2d[wp.vec4d],
    held: wp.array2d[wp.vec3d],
    contribution_start: wp.array[wp.int32],
    contributions: wp.array[wp.int32],
    block_bending: wp.array[wp.float64],
    mirrored: wp.array[wp.vec2i],
    # outputs
    blocks: wp.array2d[wp.mat33],
):
    """Membrane and bending Hessian between neighbours [N/m]; contributions are triangle << 4 | row << 2 | column.

    ``tangent`` and ``held`` come from :func:`~.triangles.linearise_triangles`; ``mirrored`` are the blocks above the
    diagonal, each with the one that mirrors it.
    """
    world, pair = wp.tid()
    entry = natural(mirrored[pair][0])
    total = block_bending[entry] * wp.identity(n=3, dtype=wp.float64)
    for k in range(contribution_start[entry], contribution_start[entry + 1]):
        code = natural(contributions[natural(k)])
        triangle = code >> 4
        gi = garment.shape_gradients[triangle, (code >> 2) & 3]
        gj = garment.shape_gradients[triangle, code & 3]
        total += garment.rest_area[triangle] * membrane_hessian(
            deformation[world, triangle], held[world, triangle], tangent[world, triangle], gi, gj
        )
    block = wp.mat33(total)
    blocks[world, entry] = block
    blocks[world, mirrored[pair][1]] = wp.transpose(block)


@wp.kernel
def assemble_own_blocks(
    row_start: wp.array[wp.int32],
    diagonal_entry: wp.array[wp.int32],
    own_bending: wp.array[wp.float64],
    # in and out
    blocks: wp.array2d[wp.mat33],
):
    """Membrane and bending Hessian of each vertex with itself [N/m], which leaves no force if all move alike.

    ``own_bending`` is the sum of ``block_bending`` over the vertex's row: what bending outside the row takes up.
    """
    world, vertex = wp.tid()
    own = natural(diagonal_entry[vertex])
    others = wp.mat33d()
    for k in range(row_start[vertex], row_start[vertex + 1]):
        if k != own:
            others += wp.mat33d(blocks[world, natural(k)])
    # The others are rounded, each for itself.
    others = wp.float64(0.5) * (others + wp.transpose(others))
    blocks[world, own] = wp.mat33(own_bending[vertex] * wp.identity(n=3, dtype=wp.float64) - others)


@wp.kernel
def assemble_diagonal(
    positions: wp.array2d[wp.vec3d],
    garment: Garment,
    contact: Contact,
    inverse_dt2: wp.array[wp.float64],
    diagonal_entry: wp.array[wp.int32],
    # in and out
    blocks: wp.array2d[wp.mat33],
):
    """Add inertia, pins, contact and friction to the diagonal blocks."""
    world, i = wp.tid()
    vertex = natural(i)
    x = positions[world, vertex]
    total = (garment.mass[vertex] * inverse_dt2[world] + garment.pin_stiffness[vertex]) * wp.identity(
        n=3, dtype=wp.float64
    )
    full = contact.pressure * garment.area[vertex]
    for k in range(PLANES):
        plane = vertex * PLANES + k
        if contact.face[world, plane] >= 0:
            strength = full * wp.float64(contact.share[world, plane])
            n = contact.normal[world, plane]
            gap = wp.dot(x - contact.point[world, plane], n)
            total += contact_curvature(gap, contact.thickness, strength, contact.depth) * wp.outer(n, n)
            bend = wp.vec3d(contact.hollow[world, plane])
            total += contact_force(gap, contact.thickness, strength, contact.depth) * wp.outer(bend, bend)
            drift = tangential(x - contact.anchor[world, plane], n)
            total += friction_hessian(drift, n, contact.friction_bound[world, plane], contact.slip)
    entry = natural(diagonal_entry[vertex])
    blocks[world, entry] = blocks[world, entry] + wp.mat33(total)


@wp.kernel
def pair_stiffnesses(positions: wp.array[wp.vec3d], contact: Contact, stiffness: wp.array[wp.float32]):
    """Stiffness of every pair along its normal [N/m]; ``positions`` of all worlds in one row."""
    pair = wp.tid()
    if pair < contact.pair_total[0]:
        gap = pair_gap(positions, contact, pair)
        strength = wp.float64(contact.pair_strength[pair])
        stiffness[pair] = wp.float32(contact_curvature(gap, contact.self_thickness, strength, contact.self_thickness))


@wp.kernel
def precondition_diagonal(
    contact: Contact,
    pair_stiffness: wp.array[wp.float32],
    diagonal_entry: wp.array[wp.int32],
    blocks: wp.array2d[wp.mat33],
    # outputs
    diagonal: wp.array2d[wp.mat33],
    inverse: wp.array2d[wp.mat33],
):
    """Each vertex's own block, pairs included [N/m], and its inverse: the block Jacobi preconditioner."""
    world, vertex = wp.tid()
    total = blocks[world, diagonal_entry[vertex]]
    owner = world * inverse.shape[1] + vertex
    start = contact.incident_start[owner]
    for k in range(start, start + contact.incident_count[owner]):
        incident = natural(contact.incident[natural(k)])
        pair = incident >> 2
        w = contact.pair_weights[pair][incident & 3]
        n = contact.pair_normal[pair]
        total += (w * w * pair_stiffness[pair]) * wp.outer(n, n)
    diagonal[world, vertex] = total
    # The determinant of a sliver's stiffness, 1e13 N/m and more, has no room in float32.
    inverse[world, vertex] = wp.mat33(wp.inverse(wp.mat33d(total)))
