"""Time steps within a frame, all on the device: where things are in between, inertia, and what a step ends with.

A frame takes a few steps. Between two frames, what is given (the body, the skinned garment) moves along a cubic that
begins with its mean velocity over the frame before and this one and ends with that of this one: it jumps less than on
a line, and does not shoot over the mark where a motion stops dead. Numbers that differ from step to step
lie in one small array, the clock: the launches of a step are recorded once and replayed.
"""

import warp as wp

from ..natural import natural
from .body_surface import closest_point_of_face, face_direction
from .contact import ContactLaw, contact_curvature
from .contact_planes import (
    NOWHERE,
    PLANES,
    BodySurface,
    ContactPlanes,
    ContactReach,
    find_skin,
    hold_plane,
    is_worn,
    side_of_skin,
)
from .friction import tangential

wp.set_module_options({"enable_backward": False})

# Entries of the clock: a step's coefficients of the past (``wrinkle_addon/time_integration.py``), its length [s], and
# the shares of the frame at which it begins and ends.
SPAN = wp.constant(0)
NOW = wp.constant(1)
BEFORE = wp.constant(2)
LENGTH = wp.constant(3)
START = wp.constant(4)
END = wp.constant(5)
CLOCK_SIZE = 6

# Shares of the contact's thickness: how lightly a vertex touches that is about to arrive, and how far away one that was
# touching must be going to be to be let go.
LIGHT_TOUCH = wp.constant(wp.float64(0.1))
LEAVING = wp.constant(wp.float64(0.5))

# Slip length [m] below which friction is a spring, in frozen contact: all there is.
SPRING_SLIP = wp.constant(wp.float64(1.0))

# Rounding of the distance to what was closest.
CLOSEST = wp.constant(wp.float32(1.0 + 1.0e-4))

# What a vertex is closest to that was never looked for, and the shortest way [m] that can lead through skin.
UNKNOWN = wp.constant(-2)
SHORTEST_WAY = wp.constant(wp.float32(1.0e-6))

# Triangles that a closest point moves over at most in a step, and those around a vertex that are looked at.
WALK_STEPS = wp.constant(16)
MOST_AROUND = wp.constant(12)

# How much deeper than it moved a vertex may lie under skin that it was above [m], since skin bends as it moves.
SIDE_ERROR = wp.constant(wp.float32(0.002))


@wp.struct
class Path:
    """Where points were one frame before the last one, at the last one, and where they are at the coming one [m]."""

    earlier: wp.array[wp.vec3]
    last: wp.array[wp.vec3]
    coming: wp.array[wp.vec3]


@wp.func
def path_point(path: Path, i: wp.int32, share: wp.float64) -> wp.vec3d:
    """Where a point is [m] when this share of the frame has passed."""
    point = natural(i)
    last = wp.vec3d(path.last[point])
    coming = wp.vec3d(path.coming[point])
    speed = wp.float64(0.5) * (coming - wp.vec3d(path.earlier[point]))
    gain = coming - last - speed
    return last + share * (speed + share * (wp.float64(2.0) - share) * gain)


@wp.struct
class Motion:
    """State of the garment, and what drives it; all of shape [1, vertex_count] or [vertex_count].

    Attributes:
        positions, velocities: Now [m], [m/s].
        before, velocities_before: One step earlier.
        past: What the past adds to the difference of positions at the step's end [m].
        target: Where the garment goes if no force acts on it [m].
        pin_target: What ``pin_stiffness`` (of the garment) pulls to [m].
        pins: Stiffness of the artist's pins [N/m].
        drag: Mass times the rate at which motion relative to the skin fades [kg/s].
        held: Not 0 where a vertex rides on the skin.
    """

    positions: wp.array2d[wp.vec3d]
    velocities: wp.array2d[wp.vec3d]
    before: wp.array2d[wp.vec3d]
    velocities_before: wp.array2d[wp.vec3d]
    past: wp.array2d[wp.vec3d]
    target: wp.array2d[wp.vec3d]
    pin_target: wp.array2d[wp.vec3d]
    pins: wp.array[wp.float64]
    drag: wp.array[wp.float64]
    held: wp.array[wp.int32]


@wp.kernel
def move_body(points: Path, normals: Path, clock: wp.array[wp.float64], body: BodySurface):
    """Put the body where it is at the end of the step; its normals turn evenly from frame to frame."""
    i = natural(wp.tid())
    share = clock[END]
    body.points[0, i] = wp.vec3(path_point(points, i, share))
    s = wp.float32(share)
    body.normals[0, i] = wp.normalize((1.0 - s) * normals.last[i] + s * normals.coming[i])


@wp.kernel
def begin_step(
    skin: Path,
    clock: wp.array[wp.float64],
    # in and out
    motion: Motion,
    pin_stiffness: wp.array[wp.float64],
    inverse_dt2: wp.array[wp.float64],
    first: wp.array2d[wp.vec3],
):
    """Inertia, pins and drag of a step, where it is linearised, and how far from there the solver begins [m].

    Drag against the skin's motion and the pins are one pull to one place. Linearised is where the garment would be
    carried by the skin: strained and pressed as it is now, so that one linearisation is stable however stiff it is
    (Choi and Ko 2002). The solver begins with free flight. (Forces as in the last step would be nearer, but what the
    solver has not resolved would then grow from step to step.)
    """
    vertex = natural(wp.tid())
    span = clock[SPAN]
    x = motion.positions[0, vertex]
    v = motion.velocities[0, vertex]
    past = clock[NOW] * x + clock[BEFORE] * motion.before[0, vertex]
    target = -past - span * (clock[NOW] * v + clock[BEFORE] * motion.velocities_before[0, vertex])
    here = path_point(skin, vertex, clock[END])
    speed = (here - path_point(skin, vertex, clock[START])) / clock[LENGTH]
    pin = motion.pins[vertex]
    drag = motion.drag[vertex] / span
    motion.pin_target[0, vertex] = here
    if drag > wp.float64(0.0):
        motion.pin_target[0, vertex] = (pin * here + drag * (span * speed - past)) / (pin + drag)
    pin_stiffness[vertex] = pin + drag
    motion.before[0, vertex] = x
    motion.velocities_before[0, vertex] = v
    motion.past[0, vertex] = past
    motion.target[0, vertex] = target
    carried = x + speed * clock[LENGTH]
    if motion.held[vertex] != 0:
        carried = here
    motion.positions[0, vertex] = carried
    first[0, vertex] = wp.vec3()
    if motion.held[vertex] == 0:
        first[0, vertex] = wp.vec3(target - carried)
    if vertex == 0:
        inverse_dt2[0] = wp.float64(1.0) / (span * span)


@wp.kernel
def move_vertices(
    solution: wp.array2d[wp.vec3],
    longest: wp.float64,
    # in and out
    positions: wp.array2d[wp.vec3d],
):
    """Take the step that the linear system asks for, no vertex farther than ``longest`` [m]."""
    vertex = natural(wp.tid())
    step = wp.vec3d(solution[0, vertex])
    positions[0, vertex] = positions[0, vertex] + step * wp.min(
        wp.float64(1.0), longest / wp.max(wp.length(step), wp.float64(1.0e-12))
    )


@wp.kernel
def end_step(clock: wp.array[wp.float64], touching: wp.array[wp.int32], planes: ContactPlanes, motion: Motion):
    """Velocities at the end of the step.

    A blow of the body makes a corner in a vertex's path. Looked back over by the second order, it would bounce off with
    half its speed; along the contact's normal what touches goes on as from a step of the first order.
    """
    vertex = natural(wp.tid())
    x = motion.positions[0, vertex]
    v = (x + motion.past[0, vertex]) / clock[SPAN]
    if touching[vertex] != 0:
        n = planes.normal[0, vertex * PLANES]
        speed = wp.dot(x - motion.before[0, vertex], n) / clock[LENGTH]
        v = v + n * (speed - wp.dot(v, n))
        v_before = motion.velocities_before[0, vertex]
        motion.velocities_before[0, vertex] = v_before + n * (speed - wp.dot(v_before, n))
    motion.velocities[0, vertex] = v


@wp.kernel
def find_candidates(
    positions: wp.array2d[wp.vec3d],
    outward: wp.array2d[wp.vec3],
    limbs: wp.array[wp.int32],
    body: BodySurface,
    points: Path,
    reach: ContactReach,
    lift: wp.array[wp.float64],
    # in and out
    found_from: wp.array2d[wp.vec3d],
    candidate: wp.array[wp.int32],
    height: wp.array[wp.float32],
):
    """The body's closest triangle that each vertex can touch, -1 where there is none: once a frame (W45).

    Nothing farther away than what was closest in the frame before needs to be looked at; and what was touched then can
    still be, whichever way it faces now. Other skin that the vertex lies under counts only where it came through it
    since then: the closest skin of an arm that swept over cloth hanging from the trunk is that of its far side, to
    which the cloth would be drawn through the arm. ``found_from`` is where the vertices were when the body was at its
    path's beginning [m], ``height`` how far above where contact holds them; both are left as they are now.
    """
    vertex = natural(wp.tid())
    p = wp.vec3(positions[0, vertex])
    start = wp.vec3(found_from[0, vertex])
    found_from[0, vertex] = positions[0, vertex]
    held = candidate[vertex]
    unknown = held == UNKNOWN
    near = ContactReach()
    near.radius = reach.radius
    near.least_cosine = reach.least_cosine
    if held >= 0:
        facing = face_direction(body.points, body.faces, 0, held)
        worn = is_worn(body.limb[held], limbs[vertex], facing, outward[0, vertex], reach.least_cosine)
        if worn or height[vertex] < reach.thickness:
            _w, away = approach(body, p, held)
            near.radius = wp.min(reach.radius, CLOSEST * away)
        else:
            held = -1
    found, w, _passed = find_skin(body, near, 0, p, limbs[vertex], outward[0, vertex])
    if found >= 0 and found != held:
        _closest, _direction, gap = side_of_skin(body, 0, p, found, w)
        if gap < 0.0 and not unknown:
            found = skin_passed(body, points, found, start, p)
            if found >= 0:
                facing = face_direction(body.points, body.faces, 0, found)
                if not is_worn(body.limb[found], limbs[vertex], facing, outward[0, vertex], reach.least_cosine):
                    found = -1
        if found >= 0:
            height[vertex] = gap - wp.float32(lift[vertex])
    candidate[vertex] = wp.where(found >= 0, found, wp.max(held, -1))


@wp.func
def skin_passed(body: BodySurface, points: Path, near: wp.int32, start: wp.vec3, end: wp.vec3) -> wp.int32:
    """The first triangle through which a vertex went inwards on its way from ``start`` to ``end`` [m], -1 if none.

    The way is the one that it took relative to the triangle ``near`` its end, which moved meanwhile.
    """
    drift = wp.vec3()
    for k in range(3):
        corner = body.faces[near, k]
        drift += (points.last[corner] - points.earlier[corner]) / 3.0
    begun = start + drift
    length = wp.length(end - begun)
    if length < SHORTEST_WAY:
        return -1
    ray = wp.mesh_query_ray(body.meshes[0], begun, (end - begun) / length, length)
    if not ray.result or ray.sign <= 0.0:
        return -1
    return ray.face


@wp.func
def walk_to_closest(body: BodySurface, p: wp.vec3, start: wp.int32):
    """The triangle whose closest point to p is nearest, from triangle to triangle, and that point's coordinates."""
    face = start
    w, distance = approach(body, p, face)
    for _ in range(WALK_STEPS):
        # A point on an edge or at a corner may be nearer beyond.
        across = wp.int32(-1)
        corner = wp.where(w[0] == 1.0, 0, wp.where(w[1] == 1.0, 1, wp.where(w[2] == 1.0, 2, -1)))
        if corner >= 0:
            across = nearer_around(body, p, face, body.faces[face, corner], distance)
        elif wp.min(w) <= 0.0:
            across = body.beside[face, wp.where(w[0] <= 0.0, 0, wp.where(w[1] <= 0.0, 1, 2))]
        if across < 0:
            break
        found, away = approach(body, p, across)
        if away >= distance:
            break
        face = across
        w = found
        distance = away
    return face, w


@wp.func
def nearer_around(body: BodySurface, p: wp.vec3, start: wp.int32, pivot: wp.int32, distance: wp.float32) -> wp.int32:
    """The first triangle around the vertex ``pivot``, from ``start`` on, nearer to p than this [m]; -1 if none is."""
    face = start
    for _ in range(MOST_AROUND):
        corner = wp.where(body.faces[face, 0] == pivot, 0, wp.where(body.faces[face, 1] == pivot, 1, 2))
        face = body.beside[face, (corner + 1) % 3]
        if face < 0 or face == start:
            break
        _w, away = approach(body, p, face)
        if away < distance:
            return face
    return -1


@wp.func
def approach(body: BodySurface, p: wp.vec3, face: wp.int32):
    """Coordinates of the closest point of a triangle of the body to p, and how far away it is [m]."""
    w, away = closest_point_of_face(body.points, body.faces, 0, face, p)
    return w, away


@wp.func
def drift_of_skin(points: Path, body: BodySurface, face: wp.int32, w: wp.vec3, clock: wp.array[wp.float64]) -> wp.vec3d:
    """How far a place of the body goes in a step [m]."""
    total = wp.vec3d()
    for k in range(3):
        corner = body.faces[natural(face), k]
        total += wp.float64(w[k]) * (path_point(points, corner, clock[END]) - path_point(points, corner, clock[START]))
    return total


@wp.kernel
def follow_planes(
    motion: Motion,
    target: wp.array2d[wp.vec3d],
    height: wp.array[wp.float32],
    clock: wp.array[wp.float64],
    margin: wp.float64,
    body: BodySurface,
    points: Path,
    lift: wp.array[wp.float64],
    # in and out
    candidate: wp.array[wp.int32],
    planes: ContactPlanes,
):
    """Contact planes of the moving body from each vertex's candidate, lifted off the skin by ``lift`` [m] (W48).

    There is none where a vertex, on its way from its position to its target, stays more than ``margin`` [m] above it;
    nor where one that the last step left above skin (``height`` [m]) would now be deeper under it than it moved against
    it: then it sees that skin from the side or through a limb, has lost its own, and looks for it at the next frame.
    """
    vertex = natural(wp.tid())
    first = vertex * PLANES
    planes.face[0, first] = -1
    planes.face[0, first + 1] = -1
    if candidate[vertex] < 0:
        return
    x = motion.positions[0, vertex]
    face, w = walk_to_closest(body, wp.vec3(x), candidate[vertex])
    candidate[vertex] = face
    closest, direction, gap = side_of_skin(body, 0, wp.vec3(x), face, w)
    closing = wp.max(wp.dot(x - target[0, vertex], wp.vec3d(direction)), wp.float64(0.0))
    if wp.float64(gap) - closing >= lift[vertex] + margin:
        return
    if gap < -SIDE_ERROR and height[vertex] + wp.float32(lift[vertex]) >= 0.0:
        moved = x - motion.before[0, vertex] - drift_of_skin(points, body, face, w, clock)
        if gap < -SIDE_ERROR - wp.max(-wp.dot(wp.vec3(moved), direction), 0.0):
            candidate[vertex] = UNKNOWN
            return
    hold_plane(planes, body, 0, first, x, face, w, closest, direction, gap)
    planes.point[0, first] = planes.point[0, first] + lift[vertex] * planes.normal[0, first]


@wp.kernel
def anticipate_contact(
    positions: wp.array2d[wp.vec3d],
    target: wp.array2d[wp.vec3d],
    area: wp.array[wp.float64],
    law: ContactLaw,
    # in and out
    planes: ContactPlanes,
    # outputs
    ahead: wp.array2d[wp.vec3d],
    touching: wp.array[wp.int32],
):
    """Linearise contact where a vertex is going to be, not where it is: else it would meet the body only once inside.

    Moves each plane to where the force's tangent is taken and tells the force by which that tangent differs at the
    vertex itself [N]. A vertex that arrives takes it at a light touch, at which contact is stiff against all but
    itself, and so stops on the surface within one step; one that flies away is let go. ``target`` is where it flies.
    """
    vertex = natural(wp.tid())
    plane = vertex * PLANES
    ahead[0, vertex] = wp.vec3d()
    touching[vertex] = 0
    if planes.face[0, plane] < 0:
        return
    n = planes.normal[0, plane]
    press = law.thickness - wp.dot(positions[0, vertex] - planes.point[0, plane], n)
    coming = press - wp.dot(target[0, vertex] - positions[0, vertex], n)
    touch = LIGHT_TOUCH * law.thickness
    taken = wp.clamp(wp.max(press, coming), wp.float64(0.0), wp.clamp(press, touch, law.thickness))
    if coming < -LEAVING * law.thickness:
        taken = wp.float64(0.0)
    if taken > wp.float64(0.0):
        touching[vertex] = 1
    gap = law.thickness - taken
    stiffness = contact_curvature(gap, law.thickness, law.pressure * area[vertex], law.depth)
    ahead[0, vertex] = (stiffness * (press - taken)) * n
    planes.point[0, plane] = positions[0, vertex] - gap * n


@wp.kernel
def linearise_friction(
    target: wp.array2d[wp.vec3d],
    planes: ContactPlanes,
    mass: wp.array[wp.float64],
    clock: wp.array[wp.float64],
    slip: wp.float64,
    # in and out
    anchor: wp.array2d[wp.vec3d],
    bound: wp.array2d[wp.float64],
):
    """Make friction a spring that holds its bound [N] where the vertex flies (``target`` [m]).

    What slides feels a constant force, a spring to far away; but within one linear system a constant force would throw
    back what is lighter than it, so that is held by a spring to its anchor. Both are springs shorter than
    :data:`SPRING_SLIP`, over which the bound is counted.
    """
    vertex = natural(wp.tid())
    plane = vertex * PLANES
    if bound[0, plane] <= wp.float64(0.0):
        return
    drift = tangential(target[0, vertex] - anchor[0, plane], planes.normal[0, plane])
    length = wp.length(drift)
    thrown = bound[0, plane] * clock[SPAN] * clock[SPAN] / mass[vertex]
    if length > slip and thrown < wp.float64(0.5) * length:
        anchor[0, plane] = target[0, vertex] - (SPRING_SLIP / length) * drift
    else:
        bound[0, plane] = SPRING_SLIP * bound[0, plane] / wp.max(length, slip)


@wp.kernel
def add_force(force: wp.array2d[wp.vec3d], gradient: wp.array2d[wp.vec3d]):
    """Take a force on every vertex into the gradient [N]."""
    vertex = natural(wp.tid())
    gradient[0, vertex] = gradient[0, vertex] - force[0, vertex]


@wp.kernel
def expel_vertices(
    planes: ContactPlanes,
    limit: wp.float64,
    deepest: wp.float64,
    longest: wp.float64,
    # in and out
    motion: Motion,
    # outputs
    gap: wp.array[wp.float32],
):
    """Move vertices that lie deeper than ``limit`` [m], but not than ``deepest``, by at most ``longest`` towards where
    contact holds them; how far from there they then lie [m], 1e6 where no body is near.

    The past moves along: a correction of place is no velocity. What is held stays where it is and does not count.
    """
    vertex = natural(wp.tid())
    plane = vertex * PLANES
    gap[vertex] = NOWHERE
    if planes.face[0, plane] < 0 or motion.held[vertex] != 0:
        return
    n = planes.normal[0, plane]
    height = wp.dot(motion.positions[0, vertex] - planes.point[0, plane], n)
    if height < -limit and height > -deepest:
        rise = wp.min(-height, longest)
        motion.positions[0, vertex] = motion.positions[0, vertex] + rise * n
        motion.before[0, vertex] = motion.before[0, vertex] + rise * n
        height += rise
    gap[vertex] = wp.float32(height)


@wp.kernel
def show_positions(
    skin: Path,
    strength: wp.array[wp.float64],
    motion: Motion,
    # outputs
    shown: wp.array[wp.vec3],
):
    """What the frame shows [m]: each vertex as far from the skinned garment as its strength lets it."""
    vertex = natural(wp.tid())
    s = strength[vertex]
    shown[vertex] = wp.vec3(s * motion.positions[0, vertex] + (wp.float64(1.0) - s) * wp.vec3d(skin.coming[vertex]))
