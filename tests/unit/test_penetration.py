"""A garment is pushed out of its body: as far as it must, folds and all, and nothing is thrown about."""

import numpy as np
import pytest
import warp as wp
from wrinkle_synthesis.kernels.limb_pushes import way_out_of_both
from wrinkle_synthesis.wrinkle_addon import method
from wrinkle_synthesis.wrinkle_addon.cloth_contact import Limbs
from wrinkle_synthesis.wrinkle_addon.garment import vertex_neighbours, vertex_normals
from wrinkle_synthesis.wrinkle_addon.penetration import ClearanceSettings, PushOut, bind_clearance
from wrinkle_synthesis.wrinkle_addon.topology import rows_of

CLEARANCE, SOFT = ClearanceSettings().distance, ClearanceSettings().soft
RADIUS, LENGTH = 0.05, 0.4


def grid_faces(rings, around):
    """Triangles of a tube of rings, outward for rings that go up along +z and around counter-clockwise."""
    faces = []
    for ring in range(rings - 1):
        for k in range(around):
            a, b = ring * around + k, ring * around + (k + 1) % around
            faces += [[a, b, a + around], [b, b + around, a + around]]
    return np.array(faces, np.int32)


def tube(radius, rings=41, around=48, length=LENGTH, angle=0.0):
    """A cylinder along +z: vertices [m] and triangles; ``radius`` may be given for every vertex."""
    z, phi = np.meshgrid(np.linspace(0.0, length, rings), 2.0 * np.pi * np.arange(around) / around, indexing="ij")
    phi = phi.ravel() + angle
    r = np.broadcast_to(radius, phi.shape)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z.ravel()], 1), grid_faces(rings, around)


def ball(radius, rings=33, around=64):
    """A sphere open at its poles."""
    theta, phi = np.meshgrid(
        np.linspace(0.9 * np.pi, 0.1 * np.pi, rings), 2.0 * np.pi * np.arange(around) / around, indexing="ij"
    )
    theta, phi = theta.ravel(), phi.ravel()
    directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)
    return radius * directions, grid_faces(rings, around)


def cleared(push, body, positions, **more):
    """The garment after the push [m], float64."""
    out = wp.array(np.asarray(positions, np.float32), dtype=wp.vec3, device=push.device)
    push.clear(body, out, **more)
    return out.numpy().astype(np.float64)


def radii(points):
    return np.linalg.norm(points[:, :2], axis=1)


class Worn:
    """A sleeve of 20 mm more radius on a cylinder (S30), bound where it rests."""

    def __init__(self, device="cpu", settings=None):
        self.body, self.body_faces = tube(RADIUS, 61, 64, LENGTH + 0.2, 0.01)
        self.body = self.body - [0.0, 0.0, 0.1]
        self.rest, self.faces = tube(RADIUS + 0.02)
        self.binding = bind_clearance(self.rest, self.faces, self.body, self.body_faces)
        self.push = PushOut(self.binding, settings, device)

    def clear(self, positions, **more):
        return cleared(self.push, self.body, positions, **more)


@pytest.fixture(scope="module")
def worn():
    return Worn()


def test_a_settled_garment_stays_where_it_lies(worn):
    # Lower than the clearance, too: it is the settled height that counts then.
    low, faces = tube(RADIUS + 0.001)
    binding = bind_clearance(low, faces, worn.body, worn.body_faces)
    # Positions are single precision.
    assert np.abs(cleared(PushOut(binding), worn.body, low) - low).max() < 1e-6
    assert np.abs(worn.clear(worn.rest) - worn.rest).max() < 1e-6


@pytest.mark.parametrize("depth", [0.002, 0.01, 0.03])
def test_out_of_a_cylinder_by_the_clearance(worn, device, depth):
    sunk, _ = tube(RADIUS - depth)
    out = cleared(PushOut(worn.binding, device=device), worn.body, sunk)
    # Half of the softness is left out of every push; the body's facets lie 0.06 mm inside the cylinder.
    assert radii(out) == pytest.approx(RADIUS + CLEARANCE - 0.5 * SOFT, abs=1e-4)
    # It goes along the normal: nowhere else.
    assert np.abs(out[:, 2] - sunk[:, 2]).max() < 1e-5


def test_out_of_a_sphere_by_the_clearance():
    body, body_faces = ball(0.1)
    rest, faces = ball(0.11, 31, 60)
    push = PushOut(bind_clearance(rest, faces, body, body_faces))
    out = cleared(push, body, rest * (0.085 / 0.11))
    # Triangles of 10 mm lie 0.13 mm inside the sphere.
    assert np.linalg.norm(out, axis=1) == pytest.approx(0.1 + CLEARANCE - 0.5 * SOFT, abs=2e-4)


def test_heights_are_those_of_the_smooth_surface(worn):
    rng = np.random.default_rng(1)
    heights = rng.uniform(-0.02, 0.015, len(worn.rest))
    points, _ = tube(RADIUS + heights)
    cleared(worn.push, worn.body, points)
    found = worn.push.heights()
    # Height along the interpolated normal, by brute force over all triangles in double precision.
    near = rng.choice(len(points), 40, replace=False)
    expected = [phong_height(points[v], worn.body, worn.body_faces) for v in near]
    near, expected = np.array(near), np.array(expected)
    needs = expected < CLEARANCE
    assert found[near[needs]] == pytest.approx(expected[needs], abs=5e-6)
    # Where nothing is lacking the distance is given: 0.008 mm more or less here.
    assert found[near[~needs]] == pytest.approx(expected[~needs], abs=2e-5)


def phong_height(p, body, faces):
    """Signed height of least magnitude at which x(u, v) + h n(u, v) = p with n of unit length, over all triangles."""
    a, b, c = body[faces].transpose(1, 0, 2)
    na, nb, nc = vertex_normals(body, faces)[faces].transpose(1, 0, 2)
    s = np.tile([1 / 3, 1 / 3, 0.0], (len(faces), 1))
    for _ in range(12):
        u, v, h = s.T[:, :, None]
        n = na + u * (nb - na) + v * (nc - na)
        miss = a + u * (b - a) + v * (c - a) + h * n - p
        jacobian = np.stack([b - a + h * (nb - na), c - a + h * (nc - na), n], 2)
        s = s - np.linalg.solve(jacobian, miss[:, :, None])[:, :, 0]
    u, v, h = s.T
    n = na + u[:, None] * (nb - na) + v[:, None] * (nc - na)
    inside = (u > -1e-6) & (v > -1e-6) & (u + v < 1 + 1e-6)
    heights = (h * np.linalg.norm(n, axis=1))[inside]
    return heights[np.abs(heights).argmin()]


def test_pushes_are_those_of_the_reference(worn):
    """Eq 12, then spread: as many largest values as means."""
    rng = np.random.default_rng(2)
    points, _ = tube(RADIUS + 0.004 + 0.01 * np.sin(np.arange(len(worn.rest)) * 0.05) + rng.normal(0, 3e-4, 1))
    out = worn.clear(points)
    lack = np.clip(CLEARANCE - worn.push.heights().astype(np.float64), 0.0, None)
    push = np.where(lack < SOFT, 0.5 * lack**2 / SOFT, lack - 0.5 * SOFT)
    start, neighbours = vertex_neighbours(worn.faces, len(points))
    rows = rows_of(start)
    around = [neighbours[start[v] : start[v + 1]] for v in range(len(points))]
    apart = np.linalg.norm(points[neighbours] - points[rows], axis=1)
    push = np.minimum(push, [max(push[a] + apart[start[v] : start[v + 1]]) for v, a in enumerate(around)])
    needed = push.copy()
    assert worn.push.rings == 2
    for _ in range(worn.push.rings):
        push = np.array([max(push[v], push[a].max()) for v, a in enumerate(around)])
    for _ in range(worn.push.rings):
        push = np.array([0.5 * push[v] + 0.5 * push[a].mean() for v, a in enumerate(around)])
    assert (push >= needed - 1e-12).all() and 0.0 < push.max() < 0.02
    assert np.linalg.norm(out - points, axis=1) == pytest.approx(push, abs=2e-6)


def test_no_vertex_is_left_inside_whatever_the_folds(worn):
    rng = np.random.default_rng(3)
    z, phi = worn.rest[:, 2], np.arctan2(worn.rest[:, 1], worn.rest[:, 0])
    waves = sum(0.004 * np.sin(m * phi + k * z + rng.uniform(0, 6)) for m, k in ((3, 40), (6, 10), (9, 60)))
    points, _ = tube(RADIUS + waves)
    assert (radii(points) < RADIUS - 0.001).mean() > 0.3
    assert radii(worn.clear(points)).min() > RADIUS + 0.5 * CLEARANCE


def test_folds_ride_outwards_with_their_crests(worn):
    """Folds of 40 mm, 10 mm high, half of them inside: eq 11 alone would cut them off at the skin."""
    fold = 0.005 * np.sin(2.0 * np.pi * worn.rest[:, 2] / 0.04)
    points, _ = tube(RADIUS + fold)
    out = radii(worn.clear(points)).reshape(41, 48)[8:-8]
    kept, cut = np.ptp(out, axis=0), np.ptp(np.maximum(points[:, 0].reshape(41, 48)[8:-8, :1], RADIUS + CLEARANCE))
    assert kept.min() > 0.85 * 0.01
    assert cut < 0.35 * 0.01


def test_a_push_sets_in_steadily(worn):
    """The body swells by 0.1 mm a step: no vertex ever moves by much more, nor by jerks."""
    points, _ = tube(RADIUS + 0.006 + 0.002 * np.cos(3.0 * np.arctan2(worn.rest[:, 1], worn.rest[:, 0])))
    swollen = [worn.body * [1.0 + s, 1.0 + s, 1.0] for s in np.arange(0.0, 0.24, 0.002)]
    track = np.stack([cleared(worn.push, body, points) for body in swollen])
    speed = np.linalg.norm(np.diff(track, axis=0), axis=2)
    jerk = np.linalg.norm(np.diff(track, 2, axis=0), axis=2)
    assert 0.9e-4 < speed.max() < 1.2e-4
    # Over the softness of 1 mm, ten steps, the speed rises from none to all.
    assert jerk.max() < 2.5e-5


def test_a_vertex_beyond_the_end_of_the_body_is_left_alone():
    body, body_faces = tube(RADIUS, 21, 64, 0.2, 0.01)
    rest, faces = tube(RADIUS + 0.01)
    push = PushOut(bind_clearance(rest, faces, body, body_faces))
    narrow, _ = tube(0.8 * RADIUS)
    moved = np.linalg.norm(cleared(push, body, narrow) - narrow, axis=1)
    assert moved[narrow[:, 2] < 0.19].min() > 0.01
    # A spread of 20 mm, and where trust begins to fade beside the end, another 20 mm.
    assert moved[narrow[:, 2] > 0.25].max() < 1e-6


def test_a_flat_face_in_the_body_harms_nothing(worn):
    body = worn.body.copy()
    body[worn.body_faces[100]] = body[worn.body_faces[100, 0]]
    out = cleared(worn.push, body, worn.rest)
    assert np.isfinite(out).all()
    assert np.linalg.norm(out - worn.rest, axis=1).max() < 0.01


def bent(points, turn, radius, middle):
    """What stands along +z bent towards +x by an angle on an arc about this height."""
    x, y, z = points.T
    z = z - middle + 0.5 * turn * radius
    angle = np.clip(z / radius, 0.0, turn)
    before, after = np.minimum(z, 0.0), np.maximum(z - turn * radius, 0.0)
    along_x = radius * (1.0 - np.cos(angle)) + after * np.sin(angle)
    along_z = before + radius * np.sin(angle) + after * np.cos(angle)
    return np.stack([along_x + x * np.cos(angle), y, along_z - x * np.sin(angle)], 1)


@pytest.mark.parametrize("slid", [-0.06, -0.04, 0.04, 0.06])
def test_nothing_outside_is_thrown_through_a_thin_limb_that_bends(slid):
    """A sleeve 5 mm off a limb 30 mm thin, bent like an elbow, slid along it: what was the skin under it is far, and
    where that was at rest now is the limb's other side.
    """
    thin = [0.3, 1.3, 1.0]
    body, body_faces = tube(RADIUS, 91, 64, 0.6, 0.01)
    rest, faces = tube(RADIUS + 0.017, 41, 64, 0.3)
    body, rest = body * thin, (rest + [0.0, 0.0, 0.15]) * thin
    limbs = Limbs(np.zeros(len(body_faces), np.int32), np.ones(len(rest), np.int32))
    push = PushOut(bind_clearance(rest, faces, body, body_faces, limbs))
    cloth = bent(rest + [0.0, 0.0, slid], 1.0, 0.1, 0.3)
    out = cleared(push, bent(body, 1.0, 0.1, 0.3), cloth)
    assert np.linalg.norm(out - cloth, axis=1).max() < 1e-3


# --- two limbs ----------------------------------------------------------------------------------------------------


class TwoLimbs:
    """Two cylinders side by side, far apart at rest, each in a sleeve of its own; the right one moves.

    The left one may be ``jointed``: two limbs, one above the other.
    """

    def __init__(self, settings=None, jointed=False):
        one, one_faces = tube(RADIUS, 61, 64, LENGTH, 0.01)
        cloth, cloth_faces = tube(RADIUS + 0.005, 41, 64, 0.3, 0.03)
        cloth += [0.0, 0.0, 0.05]
        self.apart = np.array([0.4, 0.0, 0.0])
        self.body = np.concatenate([one, one + self.apart])
        self.body_faces = np.concatenate([one_faces, one_faces + len(one)])
        self.rest = np.concatenate([cloth, cloth + self.apart])
        self.faces = np.concatenate([cloth_faces, cloth_faces + len(cloth)])
        self.count, self.right = len(cloth), np.arange(len(one), 2 * len(one))
        limb = np.repeat([0, 1], len(one_faces)).astype(np.int32)
        worn = np.repeat([1, 2], len(cloth)).astype(np.int32)
        if jointed:
            limb[: len(one_faces)][one[one_faces].mean(1)[:, 2] > 0.2] = 2
            worn[: len(cloth)][cloth[:, 2] > 0.2] = 4
        limbs = Limbs(limb, worn)
        self.push = PushOut(bind_clearance(self.rest, self.faces, self.body, self.body_faces, limbs), settings)

    def posed(self, gap):
        """Body and garment with this gap between the cylinders [m]."""
        shift = [2.0 * RADIUS + gap - 0.4, 0.0, 0.0]
        body, cloth = self.body.copy(), self.rest.copy()
        body[self.right] += shift
        cloth[self.count :] += shift
        return body, cloth

    def at(self, gap):
        """The garment with this gap between the cylinders [m], and after the push."""
        body, cloth = self.posed(gap)
        return cloth, cleared(self.push, body, cloth)


@pytest.fixture(scope="module")
def two_limbs():
    return TwoLimbs()


def test_far_limbs_leave_each_other_alone(two_limbs):
    cloth, out = two_limbs.at(0.05)
    assert np.abs(out - cloth).max() < 1e-6


def test_cloth_keeps_out_of_another_limb(two_limbs):
    # A gap of 8 mm: the sleeves, 5 mm off their own limbs, stand where the other sleeve is, but within both clearances
    # of 3 mm there is room.
    _, out = two_limbs.at(0.008)
    left, right = out[: two_limbs.count], out[two_limbs.count :] - [2.0 * RADIUS + 0.008, 0.0, 0.0]
    for own, other in ((left, left - [2.0 * RADIUS + 0.008, 0.0, 0.0]), (right, right + [2.0 * RADIUS + 0.008, 0, 0])):
        assert radii(own).min() > RADIUS + CLEARANCE - SOFT
        assert radii(other).min() > RADIUS + CLEARANCE - SOFT


def test_limbs_that_leave_no_room_share_what_is_lacking(two_limbs):
    # Overlapping by 10 mm: whatever is done is wrong; it ends half way, and nothing is thrown.
    cloth, out = two_limbs.at(-0.01)
    moved = np.linalg.norm(out - cloth, axis=1)
    assert 0.008 < moved.max() < 0.02
    facing = np.argmax(cloth[: two_limbs.count, 0])
    assert out[facing, 0] == pytest.approx(RADIUS - 0.005, abs=0.003)


def test_nothing_is_thrown_however_deep_limbs_are_in_each_other(two_limbs):
    for gap in np.linspace(-0.09, 0.0, 10):
        cloth, out = two_limbs.at(gap)
        # No limb here is pushed out of by more than where pushing has faded, and the clearance.
        assert np.linalg.norm(out - cloth, axis=1).max() < ClearanceSettings().overlap[1] + CLEARANCE


def depths(points, gap):
    """How deep points lie in the left and in the right cylinder [m], and how far they are from where these meet."""
    middle = RADIUS + 0.5 * gap
    end = np.sqrt(RADIUS**2 - middle**2)
    far = np.minimum(*(np.hypot(points[:, 0] - middle, points[:, 1] - side) for side in (end, -end)))
    return RADIUS - radii(points), RADIUS - radii(points - [2.0 * middle, 0.0, 0.0]), far


@pytest.mark.parametrize("gap", [-0.006, -0.01, -0.02])
def test_cloth_between_limbs_comes_out_where_they_meet(two_limbs, gap):
    _, left_inside = TwoLimbs(ClearanceSettings(crease=(0.0, 1e-9))).at(gap)
    _, out = two_limbs.at(gap)
    near, far = ClearanceSettings().crease
    left, right, away = depths(left_inside, gap)
    in_both = (left > 0.001) & (right > 0.001)
    # One step towards the crease of curved walls ends within a tenth of the way.
    to_crease = in_both & (away < 0.9 * near)
    assert to_crease.any()
    assert np.minimum(*depths(out[to_crease], gap)[:2]).max() < 0.001
    # What lies deep between them, or in neither, stays.
    stays = (away > 1.1 * far) | ((left < 0.0) & (right < 0.0))
    assert np.array_equal(out[stays], left_inside[stays])


@pytest.mark.parametrize("jointed", [False, True])
def test_cloth_comes_out_steadily_as_limbs_meet(jointed):
    limbs, step = TwoLimbs(jointed=jointed), 1e-4
    tracks = np.array([limbs.at(gap)[1] for gap in np.arange(-0.012, 0.004, step)])
    moved = np.linalg.norm(np.diff(tracks, axis=0), axis=2)
    # A crease goes some times as fast as the limbs that make it, faster still the shallower they overlap.
    assert moved.max() < 8.0 * step


def test_cloth_that_limbs_squeeze_goes_steadily_as_they_slide(two_limbs):
    # Walls that face each other meet nowhere near, however closely they do.
    step, tracks = 2.5e-5, []
    for aside in np.arange(0.002, 0.0035, step):
        body, cloth = two_limbs.posed(-0.006)
        body[two_limbs.right, 1] += aside
        cloth[two_limbs.count :, 1] += aside
        tracks.append(cleared(two_limbs.push, body, cloth))
    assert np.linalg.norm(np.diff(tracks, axis=0), axis=2).max() < 8.0 * step


def test_where_a_limb_has_a_joint_cloth_lies_as_on_a_whole_one(two_limbs):
    jointed = TwoLimbs(jointed=True)
    for gap in (-0.006, -0.01, -0.02):
        away = np.linalg.norm(jointed.at(gap)[1] - two_limbs.at(gap)[1], axis=1)
        assert away.max() < 0.001


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1)])
def test_limbs_that_touch_face_to_face_push_both(order):
    # A wide sleeve on one cylinder, into which two others dip that come to touch each other.
    one, one_faces = tube(RADIUS, 61, 64, LENGTH, 0.01)
    cloth, faces = tube(RADIUS + 0.06, 41, 96, 0.3, 0.03)
    cloth += [0.0, 0.0, 0.05]
    at_rest = np.concatenate([one, one + [0.4, 0.0, 0.0], one - [0.4, 0.0, 0.0]])
    body_faces = np.concatenate([one_faces + k * len(one) for k in range(3)])
    limbs = Limbs(np.repeat(order, len(one_faces)).astype(np.int32), np.full(len(cloth), 1, np.int32))
    push = PushOut(bind_clearance(cloth, faces, at_rest, body_faces, limbs))
    step, tracks = 1e-4, []
    for gap in np.arange(-0.0015, 0.0015, step):
        aside = np.array([RADIUS + 0.5 * gap, 0.11, 0.0])
        mirrored = aside * [-1.0, 1.0, 1.0]
        tracks.append(cleared(push, np.concatenate([one, one + aside, one + mirrored]), cloth))
    assert np.linalg.norm(np.diff(tracks, axis=0), axis=2).max() < 8.0 * step


def test_flat_faces_between_limbs_harm_nothing(two_limbs):
    body, cloth = two_limbs.posed(-0.006)
    facing = np.flatnonzero(np.abs(body[:, 0] - RADIUS) < 0.005)
    for vertex in np.random.default_rng(4).permutation(facing)[:60]:
        flat = body.copy()
        flat[vertex] = body[vertex + 1]
        assert np.isfinite(cleared(two_limbs.push, flat, cloth)).all()


@wp.kernel
def ways_out(
    lacks: wp.array[wp.float32],
    normals: wp.array[wp.vec3],
    other_lacks: wp.array[wp.float32],
    other_normals: wp.array[wp.vec3],
    ways: wp.array[wp.vec3],
):
    i = wp.tid()
    ways[i] = way_out_of_both(lacks[i], normals[i], other_lacks[i], other_normals[i])


def test_the_way_out_of_two_planes_is_the_shortest():
    rng = np.random.default_rng(5)
    count = 5000
    lacks = rng.uniform(-1.0, 1.0, (2, count))
    normals = rng.normal(size=(2, count, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    found = wp.zeros(count, dtype=wp.vec3, device="cpu")
    inputs = [wp.array(values.astype(np.float32), device="cpu") for values in (lacks[0], lacks[1])]
    vectors = [wp.array(values.astype(np.float32), dtype=wp.vec3, device="cpu") for values in normals]
    wp.launch(ways_out, count, [inputs[0], vectors[0], inputs[1], vectors[1]], [found], device="cpu")
    # All that can be shortest: nothing, out of either alone, out of both at once.
    cosine = (normals[0] * normals[1]).sum(1)
    first = (lacks[0] - cosine * lacks[1]) / (1.0 - cosine**2)
    second = (lacks[1] - cosine * lacks[0]) / (1.0 - cosine**2)
    both = first[:, None] * normals[0] + second[:, None] * normals[1]
    ways = np.stack([np.zeros((count, 3)), lacks[0][:, None] * normals[0], lacks[1][:, None] * normals[1], both])
    enough = (np.einsum("wvi,pvi->wpv", ways, normals) > lacks - 1e-9).all(1)
    lengths = np.where(enough, np.linalg.norm(ways, axis=2), np.inf).min(0)
    moved = found.numpy().astype(np.float64)
    # Where planes nearly face each other, the way is long and as exact as their angle is in float32.
    near = lengths < 10.0
    assert near.mean() > 0.9
    assert np.abs(np.linalg.norm(moved, axis=1) - lengths)[near].max() < 1e-3
    assert ((moved * normals).sum(2) > lacks - 1e-3)[:, near].all()


# --- a garment over another one -----------------------------------------------------------------------------------


def test_an_outer_garment_is_kept_outside_an_inner_one(worn):
    rest, faces = tube(RADIUS + 0.03, angle=0.02)
    push = PushOut(bind_clearance(rest, faces, worn.rest, worn.faces))
    # The inner garment has folds that stand out through the outer one.
    bulge = 0.02 + 0.012 * np.sin(4.0 * np.arctan2(worn.rest[:, 1], worn.rest[:, 0]) + 30.0 * worn.rest[:, 2])
    inner, _ = tube(RADIUS + bulge)
    outer, _ = tube(RADIUS + 0.025, angle=0.02)
    out = cleared(push, inner, outer)
    over = bind_clearance(out, faces, inner, worn.faces).height
    assert (bind_clearance(outer, faces, inner, worn.faces).height < -0.001).mean() > 0.2
    inside = (out[:, 2] > 0.01) & (out[:, 2] < LENGTH - 0.01)
    assert over[inside].min() > 0.0


# --- how it runs --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.004, -0.01])
def test_any_unit_of_length_gives_the_same(two_limbs, gap):
    body, cloth = two_limbs.posed(gap)
    out = cleared(two_limbs.push, body, cloth)
    in_centimetres = cleared(two_limbs.push, 100.0 * body, 100.0 * cloth, metre=100.0)
    assert in_centimetres == pytest.approx(100.0 * out, abs=1e-2)


def test_any_number_of_threads_gives_the_same_bits(two_limbs, monkeypatch):
    single = two_limbs.at(0.002)[1]
    monkeypatch.setattr(method, "LEAST_SPLIT", 100)
    monkeypatch.setattr(method, "THREADS", 3)
    assert np.array_equal(TwoLimbs().at(0.002)[1], single)


def test_a_frame_does_not_depend_on_the_one_before(two_limbs):
    first = two_limbs.at(0.002)[1]
    two_limbs.at(-0.02)
    assert np.array_equal(two_limbs.at(0.002)[1], first)


@pytest.mark.parametrize(
    "settings", [{"distance": -0.001}, {"spread": -0.01}, {"crease": (0.01, 0.01)}, {"deep": (0.1, 0.05)}]
)
def test_settings_without_a_meaning_are_refused(settings):
    with pytest.raises(ValueError, match=r"\.$"):
        ClearanceSettings(**settings)


@pytest.mark.parametrize("members", ["the body", "a limb"])
@pytest.mark.parametrize("place", [0.0, 0.3])
def test_limbs_without_size_harm_nothing(two_limbs, members, place):
    body = two_limbs.body.copy()
    body[slice(None) if members == "the body" else slice(len(body) // 2)] = place
    out = cleared(two_limbs.push, body, two_limbs.rest)
    assert np.isfinite(out).all() and np.abs(out - two_limbs.rest).max() < 1.0


def test_a_body_with_other_vertices_is_refused(worn):
    with pytest.raises(ValueError, match=r"The body has 10 vertices, but \d+ at rest\."):
        cleared(worn.push, worn.body[:10], worn.rest)
