"""Host side of contact: finds what the garment touches, on the body and on itself, and remembers where it sticks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.cloth import assembly, body_surface, contact, contact_planes, self_contact, touched_walls
from .cloth_model import ClothModel, FloatArray, IntArray
from .fabrics import Fabric
from .facing import Facing
from .topology import faces_around, mesh_edges, triangles_beside
from .verlet_lists import VerletLists

ENDLESS = 2**30
"""Patience with contact that comes out of nothing, where all of it is borne."""


@dataclass(frozen=True)
class ContactSettings:
    """How the garment touches the body and itself.

    Attributes:
        thickness: Distance from the body at which contact begins [m].
        pressure: Pressure that holds the garment off when it is pressed down to the surface itself [Pa]. Tight elastic
            garments press with up to 5 kPa; the folds of a bent limb with more.
        depth: Depth inside the body beyond which the force stops growing [m].
        slip: How far a vertex gives before static friction lets go [m].
        radius: How far around a vertex the body is looked for [m].
        least_cosine: A body triangle touches a vertex only if the cosine between its normal and the vertex's outward
            direction is larger than this; keeps the cloth of one limb from clinging to another.
        self_thickness: Distance at which the garment touches itself [m], 0 to let it pass.
    """

    thickness: float = 0.003
    pressure: float = 2.0e4
    depth: float = 0.01
    slip: float = 0.0005
    radius: float = 0.04
    least_cosine: float = -0.2
    self_thickness: float = 0.003

    def __post_init__(self) -> None:
        for name in ("thickness", "pressure", "depth", "slip", "radius"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"The contact's {name} must be greater than 0, not {getattr(self, name)}.")
        if not self.self_thickness >= 0.0:
            raise ValueError(f"The contact's self_thickness must not be negative, but is {self.self_thickness}.")


@dataclass(frozen=True, eq=False)
class Limbs:
    """Which parts of the body each part of the garment is worn on, and may touch.

    Attributes:
        of_triangles: Limb of each body triangle, 0 to 30, shape [body_triangle_count].
        of_vertices: Limbs that each garment vertex touches, one bit a limb, shape [vertex_count].
    """

    of_triangles: IntArray
    of_vertices: IntArray


def make_body(
    faces: IntArray, positions: FloatArray, device: Any, *, winding: bool = True
) -> tuple[body_surface.BodySurface, list[wp.Mesh]]:
    """The bodies of all worlds as kernels take them, [world_count, body_vertex_count, 3], and their trees of boxes.

    ``winding`` says whether the trees can tell the inside of a body by its winding number.
    """
    body = body_surface.BodySurface()
    body.faces = wp.array(faces, dtype=wp.int32, device=device)
    body.beside = wp.array(triangles_beside(faces), dtype=wp.int32, device=device)
    body.points = wp.array(positions.astype(np.float32), dtype=wp.vec3, device=device)
    body.normals = wp.zeros(body.points.shape, dtype=wp.vec3, device=device)
    indices = body.faces.flatten()
    meshes = [
        wp.Mesh(points=body.points[world], indices=indices, support_winding_number=winding)
        for world in range(len(positions))
    ]
    body.meshes = wp.array([mesh.id for mesh in meshes], dtype=wp.uint64, device=device)
    return body, meshes


def reach_of(settings: ContactSettings) -> touched_walls.ContactReach:
    """How far contact is looked for."""
    reach = touched_walls.ContactReach()
    reach.radius, reach.thickness = settings.radius, settings.thickness
    reach.depth, reach.least_cosine = settings.thickness + settings.depth, settings.least_cosine
    return reach


def law_of(settings: ContactSettings, fabric: Fabric) -> contact.ContactLaw:
    """How hard contact pushes a fabric and how friction holds it."""
    law = contact.ContactLaw()
    for name in ("thickness", "depth", "slip", "pressure"):
        setattr(law, name, wp.float64(getattr(settings, name)))
    law.friction, law.holding = wp.float64(fabric.friction), wp.float64(fabric.holding_friction)
    return law


def make_planes(
    settings: ContactSettings, shape: tuple[int, int], device: Any
) -> tuple[touched_walls.ContactPlanes, assembly.Contact]:
    """Room for contact planes, [world_count, vertex_count * PLANES], and the frozen contact that reads them."""

    def zeros(dtype: Any) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=device)

    planes, c = touched_walls.ContactPlanes(), assembly.Contact()
    planes.face, planes.weights, planes.hollow = zeros(wp.int32), zeros(wp.vec3), zeros(wp.vec3)
    planes.point, planes.normal, planes.share = zeros(wp.vec3d), zeros(wp.vec3d), zeros(wp.float32)
    planes.share.fill_(1.0)
    for name in ("thickness", "pressure", "depth", "slip", "self_thickness"):
        setattr(c, name, wp.float64(getattr(settings, name)))
    c.face, c.point, c.normal, c.hollow = planes.face, planes.point, planes.normal, planes.hollow
    c.share = planes.share
    c.anchor, c.friction_bound = zeros(wp.vec3d), zeros(wp.float64)
    return planes, c


def hold_pairs(contact: assembly.Contact, capacity: int, device: Any) -> None:
    """Make room for this many pairs of the garment with itself."""
    contact.pair_vertices = wp.zeros(capacity, dtype=wp.vec4i, device=device)
    contact.pair_weights = wp.zeros(capacity, dtype=wp.vec4, device=device)
    contact.pair_normal = wp.zeros(capacity, dtype=wp.vec3, device=device)
    contact.pair_strength = wp.zeros(capacity, dtype=wp.float32, device=device)
    contact.incident = wp.zeros(4 * capacity, dtype=wp.int32, device=device)


def list_incident(contact: assembly.Contact) -> None:
    """For every vertex, the pairs that push it."""
    capacity, device = len(contact.pair_strength), contact.pair_strength.device
    pairs = [contact.pair_total, contact.pair_vertices]
    start, count = contact.incident_start, contact.incident_count
    count.zero_()
    wp.launch(self_contact.count_incident, dim=capacity, inputs=pairs, outputs=[count], device=device)
    wp.utils.array_scan(count, start, inclusive=False)
    count.zero_()
    found = [count, contact.incident]
    wp.launch(self_contact.fill_incident, dim=capacity, inputs=[*pairs, start], outputs=found, device=device)
    wp.launch(self_contact.sort_incident, dim=len(count), inputs=[start, count, contact.incident], device=device)


class ContactSearch:
    """Contact planes, friction anchors and self-contact pairs of every world.

    Attributes:
        frozen: What the last :meth:`find` found, as the kernels read it.
        pair_energy, pair_force: Room for the energy [J] and the force [N] of each self-contact pair.
        anchor_face, anchor_weights: Where on the body each plane's friction holds on, shape [world_count,
            vertex_count * PLANES]; face -1 where nothing sticks.
    """

    def __init__(
        self,
        model: ClothModel,
        settings: ContactSettings,
        area: wp.array,
        faces: wp.array,
        body_faces: IntArray,
        body_positions: FloatArray,
        limbs: Limbs | None = None,
    ):
        self.settings = settings
        self._device = area.device
        self._area, self._faces = area, faces
        self._fabric = model.fabric
        self._shape = (len(body_positions), model.vertex_count)
        self._make_body(body_faces, body_positions)
        limbs = limbs or Limbs(np.zeros(len(body_faces), np.int32), np.full(model.vertex_count, 1, np.int32))
        self._body.limb = wp.array(limbs.of_triangles, dtype=wp.int32, device=self._device)
        self._limbs = wp.array(limbs.of_vertices, dtype=wp.int32, device=self._device)
        self._make_planes()
        self._facing = Facing(model, faces, len(body_positions))
        self._make_pairs(model)
        self.forget()
        self.move_body(body_positions)

    def move_body(self, positions: FloatArray) -> None:
        """Put the body here [m], shape [world_count, body_vertex_count, 3]; friction anchors go with it.

        Which walls were touched is forgotten: that memory is only for linearisations around one place.
        """
        if positions.shape[1] != self._body.points.shape[1]:
            raise ValueError(f"The body has {self._body.points.shape[1]} vertices, not {positions.shape[1]}.")
        self._body.points.assign(positions.astype(np.float32))
        for mesh in self._body_meshes:
            mesh.refit()
        self._forget_walls()
        points, faces, normals = self._body.points, self._body.faces, self._body_face_normals
        self._launch(body_surface.face_normals, normals.shape, [points, faces], [normals])
        inputs = [normals, self._body_around_start, self._body_around]
        self._launch(body_surface.vertex_normals, points.shape, inputs, [self._body.normals])

    @property
    def body_positions(self) -> NDArray[np.float32]:
        """The body as it was put [m], shape [world_count, body_vertex_count, 3]; a copy."""
        return self._body.points.numpy().copy()

    def set_outward(self, directions: FloatArray) -> None:
        """Outward unit vectors of the garment's vertices, shape [world_count, vertex_count, 3]."""
        self.look_everywhere()
        self._outward.assign(directions.astype(np.float32))
        self._facing.set_outward(self._outward)

    def turn(self, positions: wp.array) -> None:
        """Face the body as the garment lies at these positions (float64 [m]); itself it meets as its skins do."""
        self.look_everywhere()
        self._forget_pairs()
        self._facing.turn(positions)

    def look_everywhere(self) -> None:
        """Let the next search look around every vertex, also where it last found free space."""
        self._free.radius.zero_()

    def forget(self) -> None:
        """Let go of every friction anchor and every touched wall."""
        self.anchor_face.fill_(-1)
        self.anchor_weights.zero_()
        self._forget_walls()

    def find(
        self,
        positions: wp.array,
        following: wp.array,
        remembering: wp.array | None = None,
        patience: wp.array | None = None,
    ) -> None:
        """Freeze contact at these positions (float64 [m]): planes, friction anchors and bounds, pairs.

        ``following``, shape [world_count], says in which worlds anchors change as :meth:`follow` tells;
        ``remembering`` in which what is touched now is kept in mind for the next search, none if left out. Contact
        that comes out of nothing is borne ``patience`` times, shape [world_count], and then gives way; if left out it
        never does.
        """
        self._find_planes(positions, remembering, patience)
        self.follow(positions, following)
        if self.settings.self_thickness > 0.0:
            self._find_pairs(positions, patience)
            if remembering is not None:
                self._know_pairs()

    def follow(self, positions: wp.array, following: wp.array) -> None:
        """Place friction anchors for the planes that were found last.

        Where ``following`` is not 0, they follow the vertices that slip, and new contacts stick; elsewhere they stay.
        """
        c = self.frozen
        self._launch(
            contact.update_anchors,
            self._shape,
            [positions, self._area, self._body, self._planes, self._law, following],
            [self.anchor_face, self.anchor_weights, c.anchor, c.friction_bound],
        )

    def touches(self) -> NDArray[np.bool_]:
        """In which worlds the garment lay within a thickness of the body at the last search that remembered."""
        return (self._touched.face.numpy() >= 0).any(1)

    def expel(self, positions: wp.array, limit: float) -> None:
        """Put vertices deeper in the body than ``limit`` [m] on its skin, unless a fold's other side is there."""
        self._find_planes(positions)
        depths = [wp.float64(limit), wp.float64(self.settings.depth)]
        self._launch(contact.expel_vertices, self._shape, [self._planes, *depths, positions], [])

    def hold(self, gradient: wp.array) -> None:
        """Place the anchors of the planes found last so that friction balances a gradient [N] taken without it."""
        self._launch(
            contact.hold_anchors,
            self._shape,
            [gradient, self._body, self._planes, self.frozen.friction_bound, self._law.slip],
            [self.anchor_face, self.anchor_weights],
        )

    def _forget_walls(self) -> None:
        self._touched.face.fill_(-1)
        self._touched.sudden.fill_(-1)
        self.look_everywhere()

    def _forget_pairs(self) -> None:
        self._known["count"].zero_()
        self._known["sudden"].fill_(-1)

    def clearance(self, positions: wp.array) -> NDArray[np.float32]:
        """Signed distance of every vertex to the body [m], negative inside, 1e6 far away."""
        self.look_everywhere()
        self._find_planes(positions)
        gap = wp.zeros(self._shape, dtype=wp.float32, device=self._device)
        self._launch(contact.measure_depth, self._shape, [positions, self._planes], [gap])
        return gap.numpy()

    def _find_planes(
        self, positions: wp.array, remembering: wp.array | None = None, patience: wp.array | None = None
    ) -> None:
        remembering = self._none if remembering is None else remembering
        inputs = [positions, self._facing.directions, self._limbs, self._body, self._body_reach, remembering]
        inputs.append(self._endless if patience is None else patience)
        found = [self._touched, self._free, self._planes]
        self._launch(contact_planes.find_contact_planes, self._shape, inputs, found)

    def _find_pairs(self, positions: wp.array, patience: wp.array | None) -> None:
        """List the pairs of vertices and triangles and of edges within reach."""
        c, lists = self.frozen, self._lists
        lists.update(positions)
        if len(self._partner) < len(lists.candidates):
            self._partner = self._zeros(len(lists.candidates), wp.int32)
        # Vertices own the pairs with triangles, edges those with later edges.
        vertices, edges = slice(lists.points.size), slice(lists.points.size, None)
        edges_shape = (self._shape[0], len(lists.edges))
        common = [self._outward, self._reach]
        near = [lists.points, self._faces, *common, lists.start[vertices]]
        crossing = [lists.points, lists.edges, *common, lists.start[edges]]
        for kernel, shape, inputs, owners in (
            (self_contact.find_triangle_pairs, self._shape, near, vertices),
            (self_contact.find_edge_pairs, edges_shape, crossing, edges),
        ):
            rows = [lists.count[owners], lists.candidates]
            self._launch(kernel, shape, [*inputs, *rows], [self._pair_count[owners], self._partner])
        wp.utils.array_scan(self._pair_count, self._pair_end, inclusive=True)
        wp.utils.array_scan(self._pair_count, self._pair_start, inclusive=False)
        wp.copy(c.pair_total, self._pair_end, 0, len(self._pair_end) - 1, 1)
        total = int(c.pair_total.numpy()[0])
        if total > len(c.pair_strength):
            self._hold_pairs(total + total // 2)
        found = [c.pair_vertices, c.pair_weights, c.pair_normal, c.pair_strength]
        for kernel, shape, inputs, owners, area in (
            (self_contact.fill_triangle_pairs, self._shape, near, vertices, self._area),
            (self_contact.fill_edge_pairs, edges_shape, crossing, edges, self._edge_area),
        ):
            rows = [self._partner, self._pair_start[owners], self._pair_count[owners]]
            law = [
                area,
                wp.float64(self.settings.pressure),
                self.settings.self_thickness,
                self._known_of(owners),
                self._endless if patience is None else patience,
            ]
            self._launch(kernel, shape, [*inputs, *rows, *law], [*found, self._pair_share, self._pair_sudden[owners]])
        list_incident(c)

    def _known_of(self, owners: slice) -> self_contact.KnownPairs:
        """The pairs of one linearisation before that belong to these owners."""
        known = self_contact.KnownPairs()
        for name in ("start", "count", "sudden"):
            setattr(known, name, self._known[name][owners])
        for name in ("vertices", "normal", "share"):
            setattr(known, name, self._known[name])
        return known

    def _know_pairs(self) -> None:
        """Keep in mind the pairs found last."""
        c = self.frozen
        found = {"start": self._pair_start, "count": self._pair_count, "sudden": self._pair_sudden}
        found |= {"vertices": c.pair_vertices, "normal": c.pair_normal, "share": self._pair_share}
        for name, values in found.items():
            if len(self._known[name]) == len(values):
                wp.copy(self._known[name], values)
            else:
                self._known[name] = wp.clone(values)

    def _make_body(self, faces: IntArray, positions: FloatArray) -> None:
        start, around = faces_around(faces, positions.shape[1])
        self._body_around_start = wp.array(start, dtype=wp.int32, device=self._device)
        self._body_around = wp.array(around, dtype=wp.int32, device=self._device)
        self._body_face_normals = wp.zeros((len(positions), len(faces)), dtype=wp.vec3, device=self._device)
        self._body, self._body_meshes = make_body(faces, positions, self._device)

    def _make_planes(self) -> None:
        shape = (self._shape[0], self._shape[1] * touched_walls.PLANES)
        settings = self.settings
        self._body_reach = reach_of(settings)
        self._law = law_of(settings, self._fabric)
        self._planes, self.frozen = make_planes(settings, shape, self._device)
        self._free = contact_planes.FreeSpace()
        self._free.centre, self._free.radius = self._zeros(self._shape, wp.vec3d), self._zeros(self._shape, wp.float32)
        self._outward, self._none = self._zeros(self._shape, wp.vec3), self._zeros(self._shape[0], wp.int32)
        self._endless = wp.full(self._shape[0], ENDLESS, dtype=wp.int32, device=self._device)
        touched = self._touched = touched_walls.TouchedWalls()
        touched.face, touched.weights = self._zeros(shape, wp.int32), self._zeros(shape, wp.vec3)
        touched.point, touched.normal = self._zeros(shape, wp.vec3d), self._zeros(shape, wp.vec3d)
        touched.share = self._zeros(shape, wp.float32)
        touched.position, touched.sudden = self._zeros(self._shape, wp.vec3d), self._zeros(self._shape, wp.int32)
        self.anchor_face, self.anchor_weights = self._zeros(shape, wp.int32), self._zeros(shape, wp.vec3)

    def _make_pairs(self, model: ClothModel) -> None:
        worlds, vertices = self._shape
        c = self.frozen
        c.pair_total = self._zeros(1, wp.int32)
        c.incident_start, c.incident_count = (self._zeros(worlds * vertices, wp.int32) for _ in range(2))
        self._hold_pairs(worlds * vertices)
        edges, edge_of_side = mesh_edges(model.faces)
        area = np.bincount(edge_of_side.ravel(), np.repeat(model.rest_area / 3.0, 3), len(edges))
        self._edge_area = wp.array(area, dtype=wp.float64, device=self._device)
        thickness = self.settings.self_thickness
        self._reach = self_contact.REACH_THICKNESSES * thickness
        rest_reach = self_contact.REST_THICKNESSES * thickness
        self._lists = VerletLists(model, self._faces, worlds, self._reach, rest_reach)
        self._partner = self._zeros(0, wp.int32)
        owners = len(self._lists.count)
        self._pair_count, self._pair_start, self._pair_end, self._pair_sudden = (
            self._zeros(owners, wp.int32) for _ in range(4)
        )
        self._known = {name: self._zeros(owners, wp.int32) for name in ("start", "count", "sudden")}
        self._known |= {"vertices": self._zeros(0, wp.vec4i), "normal": self._zeros(0, wp.vec3)}
        self._known["share"] = self._zeros(0, wp.float32)

    def _hold_pairs(self, capacity: int) -> None:
        """Make room for this many self-contact pairs."""
        hold_pairs(self.frozen, capacity, self._device)
        self._pair_share = self._zeros(capacity, wp.float32)
        self.pair_energy, self.pair_force = self._zeros(capacity, wp.float64), self._zeros(capacity, wp.vec3)

    def _zeros(self, shape: tuple[int, ...] | int, dtype: type) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self._device)

    def _launch(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)
