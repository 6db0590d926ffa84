"""Contact of the garment with itself: vertex against triangle (W28) and edge against edge.

A pair is a frozen plane between two points of the garment, on the side where the first one stands. It pushes four
vertices, each by its signed weight: 1, -w0, -w1, -w2 for a vertex and a triangle, 1 - s, s, t - 1, -t for two edges.
Whatever works with pairs knows only these four. The thickness is a length of its own, not a share of an edge.

A vertex has a pair with every triangle within reach, so that nothing jumps when the nearest one changes; neighbours in
the rest shape are left out. Two edges have a pair where their closest points lie between their ends; its strength
fades towards the ends and where the edges become parallel, where vertices and triangles do the same work. Vertices
collect their share through lists of incident pairs, in a fixed order, so that sums come out the same to the bit.

Layers that are pressed into one another where the body leaves no room are pushed through each other to and fro. A pair
whose sides change, or that is all at once near, gives less each time, as walls of the body do (``touched_walls``).
"""

import warp as wp

from .body_surface import closest_point_on_triangle, triangle_point
from .touched_walls import sudden_share

wp.set_module_options({"enable_backward": False})

# Vertices closer than this many thicknesses in the rest shape never touch: a sheet that folds back on itself at the
# thickness runs through half a circle first, pi / 2 thicknesses long.
REST_THICKNESSES = 1.6
# Pairs are listed out to here, so that a step is held back by what it runs into.
REACH_THICKNESSES = 1.2
# Edges count in full from 30 degrees between them.
CROSSED_SINE2 = wp.constant(wp.float32(0.25))
# A pair that begins closer than this many thicknesses came out of nothing.
NEAR_THICKNESSES = wp.constant(0.8)


@wp.struct
class KnownPairs:
    """The pairs of one linearisation before, in rows by owner: a vertex, or an edge.

    Attributes:
        start, count: Where each owner's row begins and how many pairs it has, [world_count * owner_count].
        sudden: How often a pair of each owner has come out of nothing, -1 if it was not looked for yet.
        vertices, normal: The four vertices of a pair and its normal.
        share: Share of its full strength that it had.
    """

    start: wp.array[wp.int32]
    count: wp.array[wp.int32]
    sudden: wp.array[wp.int32]
    vertices: wp.array[wp.vec4i]
    normal: wp.array[wp.vec3]
    share: wp.array[wp.float32]


@wp.func
def pair_share(
    known: KnownPairs, owner: wp.int32, vertices: wp.vec4i, normal: wp.vec3, near: wp.bool, patience: wp.int32
):
    """Share of its full strength that a pair has, and whether it has come out of nothing: its sides have changed, or it
    was none and is ``near`` now.
    """
    if known.sudden[owner] < 0:
        return wp.float32(1.0), wp.bool(False)
    new = near
    for k in range(known.start[owner], known.start[owner] + known.count[owner]):
        if known.vertices[k] == vertices:
            if wp.dot(known.normal[k], normal) >= 0.0:
                return known.share[k], wp.bool(False)
            new = wp.bool(True)
    if not new:
        return wp.float32(1.0), wp.bool(False)
    return sudden_share(known.sudden[owner] + 1, patience), wp.bool(True)


@wp.func
def triangle_pair(
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    world: wp.int32,
    vertex: wp.int32,
    face: wp.int32,
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
):
    """Barycentric coordinates of the triangle's closest point, and whether vertex and triangle make a pair.

    Where two limbs cut into each other, so must the cloth on them: a vertex that faces a triangle from behind, on
    limbs that face each other, is let through. Layers of one limb, such as folds, face the same way and always touch.
    """
    p = points[world, vertex]
    w = closest_point_on_triangle(
        p, points[world, faces[face, 0]], points[world, faces[face, 1]], points[world, faces[face, 2]]
    )
    away = p - triangle_point(points, faces, world, face, w)
    distance = wp.length(away)
    # Closer than 0.1 micrometres there is no telling the sides apart.
    if distance >= reach or distance < 1.0e-7:
        return False, w
    facing = triangle_point(outward, faces, world, face, w)
    if wp.dot(outward[world, vertex], facing) < 0.0 and wp.dot(away, facing) < 0.0:
        return False, w
    return True, w


@wp.kernel
def find_triangle_pairs(
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    row_start: wp.array[wp.int32],
    row_count: wp.array[wp.int32],
    candidates: wp.array[wp.int32],
    # outputs
    pair_count: wp.array[wp.int32],
    partner: wp.array[wp.int32],
):
    """How many of its candidates are within ``reach`` [m] of each vertex, and which, from its row's start on."""
    world, vertex = wp.tid()
    owner = world * points.shape[1] + vertex
    start = row_start[owner]
    found = wp.int32(0)
    for place in range(start, start + row_count[owner]):
        face = candidates[place]
        near, _w = triangle_pair(points, faces, world, vertex, face, outward, reach)
        if near:
            partner[start + found] = face
            found += 1
    pair_count[owner] = found


@wp.kernel
def fill_triangle_pairs(
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    row_start: wp.array[wp.int32],
    partner: wp.array[wp.int32],
    pair_start: wp.array[wp.int32],
    pair_count: wp.array[wp.int32],
    area: wp.array[wp.float64],
    pressure: wp.float64,
    thickness: wp.float32,
    known: KnownPairs,
    patience: wp.array[wp.int32],
    # outputs
    vertices: wp.array[wp.vec4i],
    weights: wp.array[wp.vec4],
    normal: wp.array[wp.vec3],
    strength: wp.array[wp.float32],
    shares: wp.array[wp.float32],
    sudden: wp.array[wp.int32],
):
    """Write the pairs that :func:`find_triangle_pairs` found.

    ``strength`` is their force at no distance [N], ``shares`` and ``sudden`` what :class:`KnownPairs` holds next.
    """
    world, vertex = wp.tid()
    first = world * points.shape[1]
    owner = first + vertex
    any_new = wp.bool(False)
    for k in range(pair_count[owner]):
        face = partner[row_start[owner] + k]
        pair = pair_start[owner] + k
        _near, w = triangle_pair(points, faces, world, vertex, face, outward, reach)
        vertices[pair] = wp.vec4i(owner, first + faces[face, 0], first + faces[face, 1], first + faces[face, 2])
        weights[pair] = wp.vec4(1.0, -w[0], -w[1], -w[2])
        away = points[world, vertex] - triangle_point(points, faces, world, face, w)
        normal[pair] = wp.normalize(away)
        near = wp.length(away) < NEAR_THICKNESSES * thickness
        held, new = pair_share(known, owner, vertices[pair], normal[pair], near, patience[world])
        any_new = any_new or new
        shares[pair] = held
        strength[pair] = held * wp.float32(pressure * area[vertex])
    sudden[owner] = wp.max(known.sudden[owner], 0) + wp.where(any_new, 1, 0)


@wp.func
def closest_points_of_edges(p: wp.vec3, q: wp.vec3, a: wp.vec3, b: wp.vec3) -> wp.vec2:
    """Parameters (s, t) in [0, 1] of the closest points of the segments pq and ab (Ericson 2005, section 5.1.9)."""
    d1 = q - p
    d2 = b - a
    r = p - a
    along1 = wp.dot(d1, d1)
    along2 = wp.dot(d2, d2)
    f = wp.dot(d2, r)
    c = wp.dot(d1, r)
    d12 = wp.dot(d1, d2)
    crossed = along1 * along2 - d12 * d12
    s = wp.float32(0.0)
    # Edges this parallel have no one place where they are closest.
    if crossed > 1.0e-6 * along1 * along2:
        s = wp.clamp((d12 * f - c * along2) / crossed, 0.0, 1.0)
    t = (d12 * s + f) / along2
    if t < 0.0:
        t = wp.float32(0.0)
        s = wp.clamp(-c / along1, 0.0, 1.0)
    elif t > 1.0:
        t = wp.float32(1.0)
        s = wp.clamp((d12 - c) / along1, 0.0, 1.0)
    return wp.vec2(s, t)


@wp.func
def edge_point(
    points: wp.array2d[wp.vec3], edges: wp.array2d[wp.int32], world: wp.int32, edge: wp.int32, s: wp.float32
) -> wp.vec3:
    """Point at parameter s of an edge."""
    return (1.0 - s) * points[world, edges[edge, 0]] + s * points[world, edges[edge, 1]]


@wp.func
def edge_pair(
    points: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    world: wp.int32,
    edge: wp.int32,
    other: wp.int32,
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
):
    """Parameters of the closest points of two edges and the pair's share of its full strength; 0 if it is none.

    As with triangles, edges on limbs that face each other are let through where each lies behind the other.
    """
    i = edges[edge, 0]
    j = edges[edge, 1]
    k = edges[other, 0]
    m = edges[other, 1]
    where = closest_points_of_edges(points[world, i], points[world, j], points[world, k], points[world, m])
    s = where[0]
    t = where[1]
    if s <= 0.0 or s >= 1.0 or t <= 0.0 or t >= 1.0:
        return where, wp.float32(0.0)
    away = edge_point(points, edges, world, edge, s) - edge_point(points, edges, world, other, t)
    distance = wp.length(away)
    if distance >= reach or distance < 1.0e-7:
        return where, wp.float32(0.0)
    own_side = edge_point(outward, edges, world, edge, s)
    other_side = edge_point(outward, edges, world, other, t)
    if wp.dot(own_side, other_side) < 0.0 and wp.dot(away, other_side - own_side) < 0.0:
        return where, wp.float32(0.0)
    d1 = wp.normalize(points[world, j] - points[world, i])
    d2 = wp.normalize(points[world, m] - points[world, k])
    crossed = wp.length_sq(wp.cross(d1, d2)) / CROSSED_SINE2
    return where, 16.0 * s * (1.0 - s) * t * (1.0 - t) * wp.min(crossed, 1.0)


@wp.kernel
def find_edge_pairs(
    points: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    row_start: wp.array[wp.int32],
    row_count: wp.array[wp.int32],
    candidates: wp.array[wp.int32],
    # outputs
    pair_count: wp.array[wp.int32],
    partner: wp.array[wp.int32],
):
    """How many of its candidates are within ``reach`` [m] of each edge, and which, from its row's start on."""
    world, edge = wp.tid()
    owner = world * edges.shape[0] + edge
    start = row_start[owner]
    found = wp.int32(0)
    for place in range(start, start + row_count[owner]):
        other = candidates[place]
        _where, share = edge_pair(points, edges, world, edge, other, outward, reach)
        if share > 0.0:
            partner[start + found] = other
            found += 1
    pair_count[owner] = found


@wp.kernel
def fill_edge_pairs(
    points: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    row_start: wp.array[wp.int32],
    partner: wp.array[wp.int32],
    pair_start: wp.array[wp.int32],
    pair_count: wp.array[wp.int32],
    area: wp.array[wp.float64],
    pressure: wp.float64,
    thickness: wp.float32,
    known: KnownPairs,
    patience: wp.array[wp.int32],
    # outputs
    vertices: wp.array[wp.vec4i],
    weights: wp.array[wp.vec4],
    normal: wp.array[wp.vec3],
    strength: wp.array[wp.float32],
    shares: wp.array[wp.float32],
    sudden: wp.array[wp.int32],
):
    """Write the pairs that :func:`find_edge_pairs` found."""
    world, edge = wp.tid()
    owner = world * edges.shape[0] + edge
    first = world * points.shape[1]
    any_new = wp.bool(False)
    for index in range(pair_count[owner]):
        other = partner[row_start[owner] + index]
        pair = pair_start[owner] + index
        where, share = edge_pair(points, edges, world, edge, other, outward, reach)
        s = where[0]
        t = where[1]
        vertices[pair] = wp.vec4i(
            first + edges[edge, 0], first + edges[edge, 1], first + edges[other, 0], first + edges[other, 1]
        )
        weights[pair] = wp.vec4(1.0 - s, s, t - 1.0, -t)
        away = edge_point(points, edges, world, edge, s) - edge_point(points, edges, world, other, t)
        normal[pair] = wp.normalize(away)
        near = wp.length(away) < NEAR_THICKNESSES * thickness
        held, new = pair_share(known, owner, vertices[pair], normal[pair], near, patience[world])
        any_new = any_new or new
        shares[pair] = held
        strength[pair] = held * share * wp.float32(pressure * wp.float64(0.5) * (area[edge] + area[other]))
    sudden[owner] = wp.max(known.sudden[owner], 0) + wp.where(any_new, 1, 0)


@wp.kernel
def count_incident(
    total: wp.array[wp.int32],
    vertices: wp.array[wp.vec4i],
    # outputs
    incident_count: wp.array[wp.int32],
):
    """How many pairs push each vertex; entry world * vertex_count + vertex."""
    pair = wp.tid()
    if pair < total[0]:
        for corner in range(4):
            wp.atomic_add(incident_count, vertices[pair][corner], 1)


@wp.kernel
def fill_incident(
    total: wp.array[wp.int32],
    vertices: wp.array[wp.vec4i],
    incident_start: wp.array[wp.int32],
    # outputs
    incident_count: wp.array[wp.int32],
    incident: wp.array[wp.int32],
):
    """Write the lists that :func:`count_incident` counted: entries pair * 4 + corner, in any order."""
    pair = wp.tid()
    if pair < total[0]:
        for corner in range(4):
            pushed = vertices[pair][corner]
            place = incident_start[pushed] + wp.atomic_add(incident_count, pushed, 1)
            incident[place] = pair * 4 + corner


@wp.kernel
def sort_incident(incident_start: wp.array[wp.int32], incident_count: wp.array[wp.int32], incident: wp.array[wp.int32]):
    """Sort each vertex's list, so that sums over it have one order."""
    owner = wp.tid()
    start = incident_start[owner]
    for k in range(start + 1, start + incident_count[owner]):
        entry = incident[k]
        place = k
        while place > start and incident[place - 1] > entry:
            incident[place] = incident[place - 1]
            place -= 1
        incident[place] = entry


@wp.func
def pair_separation(positions: wp.array[wp.vec3d], vertices: wp.vec4i, weights: wp.vec4) -> wp.vec3d:
    """Vector from a pair's second point to its first one [m]."""
    return (
        wp.float64(weights[0]) * positions[vertices[0]]
        + wp.float64(weights[1]) * positions[vertices[1]]
        + wp.float64(weights[2]) * positions[vertices[2]]
        + wp.float64(weights[3]) * positions[vertices[3]]
    )
