"""Garments worn over each other: what is worn underneath stays underneath (Wang et al. 2010, section 3.2; W46).

The order is known. A vertex of an inner garment collides if it is outside the outer garment and projects inside the
outer triangle that is closest to it. Such a vertex and such a triangle are a pair as of :mod:`.self_contact`, along the
triangle's inward normal, so that both garments feel it, in one linear system. Every inner vertex has one pair with each
garment over it, which pushes with no strength while it does not collide.
"""

import warp as wp

from .body_surface import closest_point_of_face, face_direction, plane_weights

wp.set_module_options({"enable_backward": False})

# Share of a triangle's size by which a vertex may slide off it within a frame.
SLACK = wp.constant(0.1)
# Of a distance [m].
ROUNDING = wp.constant(1.0e-5)


@wp.struct
class LayerPairs:
    """One entry for every inner vertex and outer garment.

    Attributes:
        vertex: The inner vertex.
        layer: The outer garment.
        face: Its closest triangle, -1 where the vertex does not project inside.
        closest: Its closest triangle when that was looked for last, -1 where there was none.
        area: That the vertex stands for [m^2].
    """

    vertex: wp.array[wp.int32]
    layer: wp.array[wp.int32]
    face: wp.array[wp.int32]
    closest: wp.array[wp.int32]
    area: wp.array[wp.float64]


@wp.kernel
def round_points(positions: wp.array2d[wp.vec3d], points: wp.array2d[wp.vec3]):
    """Positions in single precision, for the search."""
    vertex = wp.tid()
    points[0, vertex] = wp.vec3(positions[0, vertex])


@wp.kernel
def find_layer_pairs(
    points: wp.array2d[wp.vec3],
    outward: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    meshes: wp.array[wp.uint64],
    first_face: wp.array[wp.int32],
    radius: wp.float32,
    # in and out
    pairs: LayerPairs,
    # outputs
    vertices: wp.array[wp.vec4i],
):
    """The outer triangle that each inner vertex lies under or over, within ``radius`` [m], facing as the vertex does.

    ``meshes`` are the garments, whose triangles begin at ``first_face`` among all. Nothing farther away than what was
    closest in the search before needs to be looked at.
    """
    pair = wp.tid()
    vertex = pairs.vertex[pair]
    layer = pairs.layer[pair]
    p = points[0, vertex]
    pairs.face[pair] = -1
    vertices[pair] = wp.vec4i(vertex, vertex, vertex, vertex)
    held = pairs.closest[pair]
    near = radius
    if held >= 0:
        _w, away = closest_point_of_face(points, faces, 0, held, p)
        near = wp.min(radius, away + ROUNDING)
    query = wp.mesh_query_point_no_sign(meshes[layer], p, near)
    if not query.result and near < radius:
        # Far from the origin the query may find what it held a little farther away than it was found here.
        query = wp.mesh_query_point_no_sign(meshes[layer], p, radius)
    if not query.result:
        pairs.closest[pair] = -1
        return
    face = first_face[layer] + query.face
    pairs.closest[pair] = face
    w = plane_weights(p, points[0, faces[face, 0]], points[0, faces[face, 1]], points[0, faces[face, 2]])
    if wp.min(w) < 0.0 or wp.dot(face_direction(points, faces, 0, face), outward[0, vertex]) <= 0.0:
        return
    pairs.face[pair] = face
    vertices[pair] = wp.vec4i(vertex, faces[face, 0], faces[face, 1], faces[face, 2])


@wp.kernel
def place_layer_pairs(
    positions: wp.array2d[wp.vec3d],
    vertices: wp.array[wp.vec4i],
    pressure: wp.float64,
    # in and out
    pairs: LayerPairs,
    # outputs
    weights: wp.array[wp.vec4],
    normal: wp.array[wp.vec3],
    strength: wp.array[wp.float32],
):
    """Freeze the pairs at these positions [m]; ``pressure`` [Pa] holds the two apart at no distance."""
    pair = wp.tid()
    strength[pair] = 0.0
    weights[pair] = wp.vec4()
    if pairs.face[pair] < 0:
        return
    v = vertices[pair]
    x = positions[0, v[0]]
    # As seen from the vertex, which keeps the full precision of its position.
    a = wp.vec3(positions[0, v[1]] - x)
    b = wp.vec3(positions[0, v[2]] - x)
    c = wp.vec3(positions[0, v[3]] - x)
    w = plane_weights(wp.vec3(), a, b, c)
    if wp.min(w) < -SLACK:
        return
    weights[pair] = wp.vec4(1.0, -w[0], -w[1], -w[2])
    normal[pair] = -wp.normalize(wp.cross(b - a, c - a))
    strength[pair] = wp.float32(pressure * pairs.area[pair])


@wp.kernel
def measure_layer_gaps(
    positions: wp.array2d[wp.vec3d],
    vertices: wp.array[wp.vec4i],
    pairs: LayerPairs,
    # outputs
    gap: wp.array[wp.float32],
):
    """How far each pair's vertex lies under its triangle [m], negative outside; 1e6 where there is no pair."""
    pair = wp.tid()
    gap[pair] = 1.0e6
    if pairs.face[pair] < 0:
        return
    v = vertices[pair]
    x = positions[0, v[0]]
    a = wp.vec3(positions[0, v[1]] - x)
    b = wp.vec3(positions[0, v[2]] - x)
    c = wp.vec3(positions[0, v[3]] - x)
    gap[pair] = wp.dot(a, wp.normalize(wp.cross(b - a, c - a)))
