"""Self-contact through Verlet lists finds what a search of all pairs finds, to the bit, however old the lists are."""

import numpy as np
import pytest
import warp as wp
from cloth_shapes import raised, sheet, sphere
from wrinkle_synthesis.kernels.cloth import self_contact, verlet_lists
from wrinkle_synthesis.wrinkle_addon.cloth import ClothSimulation
from wrinkle_synthesis.wrinkle_addon.cloth_contact import ContactSettings
from wrinkle_synthesis.wrinkle_addon.cloth_model import Fabric, build_cloth_model

THICKNESS = 0.003
REACH = self_contact.REACH_THICKNESSES * THICKNESS
REST_REACH = self_contact.REST_THICKNESSES * THICKNESS


@wp.kernel
def try_all_triangles(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    faces: wp.array2d[wp.int32],
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    rest_reach: wp.float32,
    touches: wp.array3d[wp.int32],
):
    world, vertex, face = wp.tid()
    # Without bound on the distance, only neighbours in the rest shape are left out.
    if verlet_lists.vertex_may_touch(points, rest_points, faces, world, vertex, face, wp.inf, rest_reach):
        near, _w = self_contact.triangle_pair(points, faces, world, vertex, face, outward, reach)
        touches[world, vertex, face] = wp.int32(near)


@wp.kernel
def try_all_edges(
    points: wp.array2d[wp.vec3],
    rest_points: wp.array2d[wp.vec3],
    edges: wp.array2d[wp.int32],
    outward: wp.array2d[wp.vec3],
    reach: wp.float32,
    rest_reach: wp.float32,
    touches: wp.array3d[wp.int32],
):
    world, edge, other = wp.tid()
    if other > edge and verlet_lists.edges_may_touch(
        points, rest_points, edges, world, edge, other, wp.inf, rest_reach
    ):
        _where, share = self_contact.edge_pair(points, edges, world, edge, other, outward, reach)
        touches[world, edge, other] = wp.int32(share > 0.0)


class Layers:
    """Two crumpled layers near each other in every world, whose lists are kept from one place to the next."""

    def __init__(self, device, worlds, seed=1):
        self.rng = np.random.default_rng(seed)
        layer, faces = sheet(7, 7, 0.03, 0.03)
        rest = np.concatenate([layer, raised(layer, 0.05)])
        self.faces = np.concatenate([faces, faces + len(layer)])
        self.model = build_cloth_model(rest, self.faces, Fabric())
        crumpled = np.concatenate([layer, raised(layer, 0.002)])
        self.start = crumpled + 5e-4 * self.rng.normal(size=(worlds, *rest.shape))
        self.device, self.worlds = device, worlds
        self.outward = self.rng.normal(size=self.start.shape)
        self.outward /= np.linalg.norm(self.outward, axis=2, keepdims=True)
        self.simulation = self.new_simulation()
        self.lists = self.simulation._contact._lists
        self.renewed = []
        search = self.lists._list

        def search_and_note():
            self.renewed.append([marks.numpy().copy() for marks in self.lists._by_kind(self.lists._renewed)])
            search()

        self.lists._list = search_and_note

    def new_simulation(self):
        body, body_faces = sphere(0.1, 0)
        settings = ContactSettings(self_thickness=THICKNESS)
        simulation = ClothSimulation(
            self.model,
            body_faces,
            raised(body, 5.0),
            contact_settings=settings,
            world_count=self.worlds,
            device=self.device,
        )
        simulation.set_outward(self.outward)
        return simulation

    def pairs(self, positions, simulation=None):
        """Everything about the pairs that the kernels read."""
        simulation = simulation or self.simulation
        simulation.start(positions)
        simulation._contact.find(simulation._positions, simulation._moving)
        c = simulation._contact.frozen
        total = c.pair_total.numpy()[0]
        arrays = [a.numpy()[:total] for a in (c.pair_vertices, c.pair_weights, c.pair_normal, c.pair_strength)]
        return [*arrays, c.incident_count.numpy(), c.incident.numpy()[: 4 * total]]

    def all_pairs(self):
        """Vertices of all pairs at the present place, found by trying every vertex, triangle and edge."""
        lists, contact = self.lists, self.simulation._contact
        vertices = self.start.shape[1]
        found = []
        for kernel, parts, owners in (
            (try_all_triangles, contact._faces, vertices),
            (try_all_edges, lists.edges, len(lists.edges)),
        ):
            touches = wp.zeros((self.worlds, owners, len(parts)), dtype=wp.int32, device=self.device)
            inputs = [lists.points, lists._rest_points, parts, contact._outward, REACH, REST_REACH, touches]
            wp.launch(kernel, touches.shape, inputs, device=self.device)
            world, owner, part = np.nonzero(touches.numpy())
            own = owner[:, None] if parts is contact._faces else lists.edges.numpy()[owner]
            found.append(world[:, None] * vertices + np.concatenate([own, parts.numpy()[part]], 1))
        return np.concatenate(found)


def same(first, second):
    return all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def crumple(rng, positions, size):
    return size * rng.normal(size=positions.shape)


def drift(rng, positions, size):
    return np.cross(size * rng.normal(size=3) / 0.03, positions) + size * rng.normal(size=3)


def poke(rng, positions, size):
    distance = np.linalg.norm(positions - positions[rng.integers(len(positions))], axis=1)
    return np.where(distance < 0.006, 1.0, 0.0)[:, None] * size * rng.normal(size=3)


@pytest.mark.parametrize("size", [2e-5, 3e-4, 2e-3, 2e-2], ids=["tiny", "small", "large", "huge"])
@pytest.mark.parametrize("moves", [(crumple, drift), (poke, crumple), (poke, poke)], ids=lambda m: m[0].__name__)
def test_pairs_after_any_moves_are_those_of_trying_everything(device, moves, size):
    layers = Layers(device, 2)
    positions, totals = layers.start, set()
    for _ in range(12):
        pairs = layers.pairs(positions)
        assert np.array_equal(pairs[0], layers.all_pairs())
        assert same(pairs, layers.pairs(positions, layers.new_simulation()))
        totals.add(len(pairs[0]))
        moved = [move(layers.rng, x, size) for move, x in zip(moves, positions, strict=True)]
        # What spreads is gathered again.
        positions = positions + np.array(moved)
        positions = np.where(np.abs(positions - layers.start) < 0.02, positions, layers.start)
    assert len(totals) > 1 and min(totals) > 0


def test_only_rows_near_what_has_moved_by_half_the_margin_are_renewed(device):
    layers = Layers(device, 2)
    lists = layers.lists
    positions = layers.start.copy()
    layers.pairs(positions)
    assert all(marks.all() for marks in layers.renewed[0])
    for share, moved in ((0.4, 0), (0.49, 0), (-0.49, 0), (0.51, 1), (0.9, 0), (1.1, 1)):
        # By its distance from where it is listed, not by the length of its way.
        positions[1, 5, 0] = layers.start[1, 5, 0] + share * lists._margin
        layers.renewed.clear()
        layers.pairs(positions)
        assert lists._moved.numpy().sum() == moved
        # Rows that lack room are renewed once more, those around the vertex first.
        renewed = layers.renewed[0][0]
        assert not renewed[0].any() and renewed[1, 5] == moved
        distance = np.linalg.norm(positions[1] - positions[1, 5], axis=1)
        # Its triangles reach as far as their neighbours, 6 mm, and those reach on.
        assert not renewed[1][distance > 0.008 + np.sqrt(3.0) * lists._reaches[0]].any()


def test_a_pair_that_comes_from_the_end_of_the_margin_is_found(device):
    """All vertices of the upper layer fall by just less than half the margin, those of the lower one rise as much."""
    layers = Layers(device, 1)
    lists = layers.lists
    upper = np.arange(layers.start.shape[1]) >= layers.start.shape[1] // 2
    flat = layers.model.rest_positions * [1.0, 1.0, 0.0]
    flat[:, :2] += upper[:, None] * [0.0011, 0.0007]
    half = 0.5 * lists._margin - 2e-5
    apart = REACH - 1e-6 + 2.0 * half
    assert not len(layers.pairs(flat + np.outer(upper, [0.0, 0.0, apart]))[0])
    near = flat + np.outer(upper, [0.0, 0.0, apart - half]) + np.outer(~upper, [0.0, 0.0, half])
    pairs = layers.pairs(near)
    assert not lists._moved.numpy().any()
    assert len(pairs[0]) > 100
    assert np.array_equal(pairs[0], layers.all_pairs())
