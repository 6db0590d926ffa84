"""Contact of the garment with itself: vertex against triangle (W28).

A vertex owns up to ``SLOTS`` contacts. A contact is a frozen plane between the vertex and a point of the triangle,
on the side where the vertex stands; the thickness is a length of its own, not a share of an edge, and pairs that are
as close as that in the rest shape are left out. Each contact pushes four vertices; the three of the triangle collect
their share through a list of incident contacts, in a fixed order, so that sums come out the same to the bit.
"""

import warp as wp

from .contact import closest_point_on_triangle, triangle_point

wp.set_module_options({"enable_backward": False})

SLOTS = wp.constant(8)


@wp.kernel
def to_single(positions: wp.array2d[wp.vec3d], single: wp.array2d[wp.vec3]):
    """Positions as float32, for the bounding volume tree."""
    world, vertex = wp.tid()
    single[world, vertex] = wp.vec3(positions[world, vertex])


@wp.kernel
def find_self_contacts(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    meshes: wp.array[wp.uint64],
    thickness: wp.float32,
    # outputs
    count: wp.array2d[wp.int32],
    triangle: wp.array2d[wp.int32],
    weights: wp.array2d[wp.vec3],
    normal: wp.array2d[wp.vec3],
):
    """List, for every vertex, the triangles closer than the thickness [m]; slots are vertex * SLOTS + k."""
    world, vertex = wp.tid()
    p = points[world, vertex]
    rest = rest_points[0, vertex]
    reach = wp.vec3(thickness, thickness, thickness)
    query = wp.mesh_query_aabb(meshes[world], p - reach, p + reach)
    candidate = wp.int32(0)
    found = wp.int32(0)
    while wp.mesh_query_aabb_next(query, candidate):
        i = faces[candidate, 0]
        j = faces[candidate, 1]
        k = faces[candidate, 2]
        if i != vertex and j != vertex and k != vertex and found < SLOTS:
            w = closest_point_on_triangle(p, points[world, i], points[world, j], points[world, k])
            away = p - triangle_point(points, faces, world, candidate, w)
            distance = wp.length(away)
            if distance < thickness and distance > 1.0e-7:
                r = closest_point_on_triangle(rest, rest_points[0, i], rest_points[0, j], rest_points[0, k])
                apart = wp.length(rest - triangle_point(rest_points, faces, 0, candidate, r))
                if apart > thickness:
                    slot = vertex * SLOTS + found
                    triangle[world, slot] = candidate
                    weights[world, slot] = w
                    normal[world, slot] = away / distance
                    found += 1
    count[world, vertex] = found


@wp.kernel
def count_incident(
    faces: wp.array2d[wp.int32],
    count: wp.array2d[wp.int32],
    triangle: wp.array2d[wp.int32],
    vertex_count: wp.int32,
    # outputs
    incident: wp.array[wp.int32],
):
    """How many contacts press on each vertex as a corner of their triangle; entry world * vertex_count + vertex."""
    world, vertex = wp.tid()
    for k in range(count[world, vertex]):
        face = triangle[world, vertex * SLOTS + k]
        for corner in range(3):
            wp.atomic_add(incident, world * vertex_count + faces[face, corner], 1)


@wp.kernel
def fill_incident(
    faces: wp.array2d[wp.int32],
    count: wp.array2d[wp.int32],
    triangle: wp.array2d[wp.int32],
    vertex_count: wp.int32,
    incident_start: wp.array[wp.int32],
    # outputs
    filled: wp.array[wp.int32],
    incident: wp.array[wp.int32],
):
    """Write the lists that :func:`count_incident` counted: entries slot * 3 + corner, in any order."""
    world, vertex = wp.tid()
    for k in range(count[world, vertex]):
        slot = vertex * SLOTS + k
        for corner in range(3):
            owner = world * vertex_count + faces[triangle[world, slot], corner]
            place = incident_start[owner] + wp.atomic_add(filled, owner, 1)
            incident[place] = slot * 3 + corner


@wp.kernel
def sort_incident(incident_start: wp.array[wp.int32], filled: wp.array[wp.int32], incident: wp.array[wp.int32]):
    """Sort each vertex's list, so that sums over it have one order."""
    owner = wp.tid()
    start = incident_start[owner]
    for k in range(start + 1, start + filled[owner]):
        entry = incident[k]
        place = k
        while place > start and incident[place - 1] > entry:
            incident[place] = incident[place - 1]
            place -= 1
        incident[place] = entry


@wp.func
def slot_separation(
    positions: wp.array2d[wp.vec3d],
    faces: wp.array2d[wp.int32],
    world: wp.int32,
    vertex: wp.int32,
    face: wp.int32,
    w: wp.vec3,
) -> wp.vec3d:
    """Vector from the contact's point on the triangle to its vertex [m]."""
    return (
        positions[world, vertex]
        - wp.float64(w[0]) * positions[world, faces[face, 0]]
        - wp.float64(w[1]) * positions[world, faces[face, 1]]
        - wp.float64(w[2]) * positions[world, faces[face, 2]]
    )
