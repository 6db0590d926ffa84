"""Host side of what coarse layers touch: the body, searched once a frame, and each other (W45, W46, W48)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from ..kernels.cloth import assembly, body_surface, contact, facing, frame_steps, layers
from ..kernels.cloth.touched_walls import ContactPlanes
from .cloth_contact import (
    ContactSettings,
    Limbs,
    hold_pairs,
    law_of,
    list_incident,
    make_body,
    make_planes,
    reach_of,
)
from .cloth_model import ClothModel, FloatArray, IntArray
from .facing import Facing
from .launch_graph import LaunchGraph
from .threads import THREADS, run_side_by_side
from .topology import faces_around

NEAR = 0.02
"""How far above where contact begins a vertex that comes nearer still looks for its plane [m]."""
ALL_LIMBS = 2**31 - 1
SEARCH_MODULES = (body_surface, facing, frame_steps, layers)
"""Modules of kernels that a search launches."""
EXPELLED_DEPTH = 0.001
"""A vertex that ends a step deeper than this under where contact holds it is put back there [m] ..."""
EXPELLED_STEP = 0.01
"""... by no more than this in a step [m]."""


class CoarseContact:
    """Contact planes on a moving body, their friction, and pairs between garments worn over each other.

    Args:
        model: All garments, from the innermost to the outermost.
        settings: What all contact shares; ``self_thickness`` is the distance between garments.
        lift: How far off the skin each vertex's contact planes lie [m], shape [vertex_count].
        limbs: For each garment, which parts of the body it may touch; None lets it touch all.
        body_faces, body_positions: The body, shapes [m, 3] and [n, 3] [m].
        positions: Where the vertices are, float64 [m], shape [1, vertex_count].
        skin: The path of the skinned garment.

    Attributes:
        frozen: What the last search found, as the kernels read it.
        pair_energy, pair_force: Room for the energy [J] and the force [N] of each pair.
        anchor_face, anchor_weights: Where on the body friction holds on, shape [1, vertex_count * PLANES].
        candidate: Closest triangle of the body to each vertex, -1 where there is none, shape [vertex_count].
        found_from: Where each vertex was when that was last looked for [m], shape [1, vertex_count].
        ahead: What the force of contact lacks at the vertices themselves [N], shape [1, vertex_count].
        touching: Not 0 where the body touches or is about to, shape [vertex_count].
        gap: Signed distance of every vertex to where contact holds it [m], as the last step left it; [vertex_count].
        body: The body within the frame; ``points`` and ``normals`` are its paths from frame to frame.
    """

    def __init__(
        self,
        model: ClothModel,
        settings: ContactSettings,
        lift: FloatArray,
        limbs: Sequence[Limbs | None],
        body_faces: IntArray,
        body_positions: FloatArray,
        positions: wp.array,
        skin: frame_steps.Path,
    ):
        device = positions.device
        self.settings = settings
        self._device = device
        self._threads = THREADS if device.is_cpu else 1
        self._model = model
        self._positions, self._skin = positions, skin
        self._count = model.vertex_count
        self._lift = self._upload(lift, wp.float64)
        self._faces = self._upload(model.faces, wp.int32)
        self._area, self._mass = self._upload(model.area, wp.float64), self._upload(model.mass, wp.float64)
        self._around = [self._upload(values, wp.int32) for values in faces_around(model.faces, model.vertex_count)]
        self.body, self._body_meshes = make_body(body_faces, body_positions[None], device, winding=False)
        body_count = len(body_positions)
        self._body_around = [self._upload(values, wp.int32) for values in faces_around(body_faces, body_count)]
        self.points, self.normals = make_path(body_count, device), make_path(body_count, device)
        self._body_face_normals = self._zeros((1, len(body_faces)), wp.vec3)
        self._face_normals = self._zeros((1, len(model.faces)), wp.vec3)
        self._make_limbs(limbs, len(body_faces))
        self._reach = reach_of(settings)
        shape = (1, self._count * int(frame_steps.PLANES))
        self.planes, self.frozen = make_planes(settings, shape, device)
        self.frozen.slip = frame_steps.SPRING_SLIP
        self._laws = [law_of(settings, part.fabric) for part in model.parts]
        self.anchor_face, self.anchor_weights = self._zeros(shape, wp.int32), self._zeros(shape, wp.vec3)
        self.candidate = self._zeros(self._count, wp.int32)
        self.found_from = self._zeros((1, self._count), wp.vec3d)
        self._outward = self._zeros((1, self._count), wp.vec3)
        self._facing = Facing(model, self._faces, 1)
        self.gap = self._zeros(self._count, wp.float32)
        self._found = [wp.zeros_like(values) for values in (self.found_from, self.candidate, self.gap)]
        self.ahead, self.touching = self._zeros((1, self._count), wp.vec3d), self._zeros(self._count, wp.int32)
        self._none, self._all = self._zeros(1, wp.int32), wp.ones(1, dtype=wp.int32, device=device)
        self._make_pairs()
        acts = self._launch_back, self._launch_candidate_search, self._launch_pair_search
        recorded = (LaunchGraph(act, SEARCH_MODULES, device) for act in acts)
        self._going_back, self._candidate_search, self._pair_search = recorded

    def forget(self) -> None:
        """Let go of every friction anchor, and of what was near."""
        self.anchor_face.fill_(-1)
        self.anchor_weights.zero_()
        self.candidate.fill_(frame_steps.UNKNOWN)

    def move_body(self, positions: np.ndarray) -> None:
        """Let the body set out for the coming frame [m], shape [body_vertex_count, 3]."""
        self.points.coming.assign(positions)
        points, normals = (path.coming.reshape(self.body.points.shape) for path in (self.points, self.normals))
        self._launch_normals(points, self.body.faces, self._body_around, self._body_face_normals, normals)

    def arrive(self) -> None:
        """The body has come to the coming frame."""
        arrive(self.points)
        arrive(self.normals)

    def find(self) -> None:
        """Look for what is near at the beginning of a frame: once for all its steps.

        The skinned garment tells where a vertex's outside is, or the garment itself where it has turned away from it.
        Only :meth:`take_found` lets it count; until then nothing that outlives a frame is touched, but for what bounds
        the next search without a part in what it finds. So it may go on on another thread.
        """
        self._going_back()
        self._body_meshes[0].refit()
        searches: list[Callable[[], None]] = [self._candidate_search]
        if self._pair_count:
            searches.append(self._find_pairs)
        run_side_by_side(searches, self._threads)

    def prepare(self) -> None:
        """Record what :meth:`find` launches; see :meth:`LaunchGraph.prepare`."""
        self._going_back.prepare()
        self._candidate_search.prepare()
        if self._pair_count:
            self._pair_search.prepare()

    def take_found(self) -> None:
        """Let what was found last count from now on."""
        for kept, found in zip((self.found_from, self.candidate, self.gap), self._found, strict=True):
            wp.copy(kept, found)

    # What a step launches; all of it can be recorded.

    def launch_move(self, clock: wp.array) -> None:
        """Move the body to where it is at the end of the step."""
        self._launch(frame_steps.move_body, self.points.last.shape, [self.points, self.normals, clock, self.body], [])

    def launch_freeze(self, motion: frame_steps.Motion, clock: wp.array) -> None:
        """Freeze planes, friction and pairs where the garment is; without forces it flies to its target."""
        c, positions, target = self.frozen, motion.positions, motion.target
        self._launch_planes(motion, target, clock)
        inputs = [positions, target, self._area, self._laws[0], self.planes]
        self._launch(frame_steps.anticipate_contact, self._count, inputs, [self.ahead, self.touching])
        self._launch_anchors(self._none)
        inputs = [target, self.planes, self._mass, clock, wp.float64(self.settings.slip)]
        self._launch(frame_steps.linearise_friction, self._count, inputs, [c.anchor, c.friction_bound])
        if self._pair_count:
            inputs = [positions, c.pair_vertices, wp.float64(self.settings.pressure), self._pairs]
            found = [c.pair_weights, c.pair_normal, c.pair_strength]
            self._launch(layers.place_layer_pairs, self._pair_count, inputs, found)
            inputs = [positions.flatten(), c]
            self._launch(assembly.pair_forces, self._pair_count, inputs, [self.pair_energy, self.pair_force])

    def launch_expel(self, motion: frame_steps.Motion, clock: wp.array) -> None:
        """Put vertices that the body has run over back to where contact holds them."""
        self._launch_planes(motion, motion.positions, clock)
        lengths = [wp.float64(length) for length in (EXPELLED_DEPTH, self.settings.depth, EXPELLED_STEP)]
        self._launch(frame_steps.expel_vertices, self._count, [self.planes, *lengths, motion], [self.gap])

    def launch_follow(self) -> None:
        """Let friction's anchors follow the vertices that slip."""
        self._launch_anchors(self._all)

    def launch_measure(self) -> None:
        """Measure how far garments lie over each other, where :meth:`find` found them near each other."""
        if self._pair_count:
            inputs = [self._positions, self.frozen.pair_vertices, self._pairs]
            self._launch(layers.measure_layer_gaps, self._pair_count, inputs, [self._pair_gap])

    def _launch_planes(self, motion: frame_steps.Motion, target: wp.array, clock: wp.array) -> None:
        margin = wp.float64(self.settings.thickness + NEAR)
        skin = [margin, self.body, self.points, self._lift]
        inputs = [motion, target, self.gap, clock, *skin, self.candidate, self.planes]
        self._launch(frame_steps.follow_planes, self._count, inputs, [])

    def _launch_anchors(self, following: wp.array) -> None:
        c, width = self.frozen, int(frame_steps.PLANES)
        for part, law in zip(self._model.parts, self._laws, strict=True):
            rows = slice(width * part.vertices.start, width * part.vertices.stop)
            planes = ContactPlanes()
            for name in ContactPlanes.vars:
                setattr(planes, name, getattr(self.planes, name)[:, rows])
            inputs = [self._positions[:, part.vertices], self._area[part.vertices], self.body, planes, law, following]
            found = [values[:, rows] for values in (self.anchor_face, self.anchor_weights, c.anchor, c.friction_bound)]
            count = part.vertices.stop - part.vertices.start
            self._launch(contact.update_anchors, (1, count), inputs, found)

    # What was found

    def deepest(self) -> float:
        """How far the deepest vertex lies under the skin [m], 0 if none does."""
        gap = self.gap.numpy().astype(np.float64)
        return float(np.maximum(-(gap + self._lift.numpy()), 0.0).max())

    def crossed(self) -> int:
        """How many vertices of inner garments lay outside an outer one when :meth:`launch_measure` ran last."""
        return int((self._pair_gap.numpy() < 0.0).sum())

    def _launch_back(self) -> None:
        """Body and garments are where the last frame left them."""
        for here, path in ((self.body.points, self.points), (self.body.normals, self.normals)):
            wp.copy(here, path.last.reshape(here.shape))
        last = self._skin.last.reshape((1, self._count))
        self._launch_normals(last, self._faces, self._around, self._face_normals, self._outward)
        if self._pair_count:
            self._launch(layers.round_points, self._count, [self._positions], [self._points])

    def _launch_candidate_search(self) -> None:
        self._facing.set_outward(self._outward)
        self._facing.turn(self._positions)
        for kept, found in zip((self.found_from, self.candidate, self.gap), self._found, strict=True):
            wp.copy(found, kept)
        skin = [self._limbs, self.body, self.points, self._reach, self._lift]
        inputs = [self._positions, self._facing.directions, *skin]
        self._launch(frame_steps.find_candidates, self._count, inputs, self._found)

    def _launch_pair_search(self) -> None:
        inputs = [self._points, self._outward, self._faces, self._layer_ids, self._first_face, self.settings.radius]
        self._launch(layers.find_layer_pairs, self._pair_count, inputs, [self._pairs, self.frozen.pair_vertices])

    def _find_pairs(self) -> None:
        for mesh in self._layer_meshes:
            mesh.refit()
        self._pair_search()
        list_incident(self.frozen)

    def _make_pairs(self) -> None:
        c, parts = self.frozen, self._model.parts
        inner = [
            (np.arange(part.vertices.start, part.vertices.stop), outer)
            for number, part in enumerate(parts)
            for outer in range(number + 1, len(parts))
        ]
        vertex = np.concatenate([vertices for vertices, _ in inner] + [np.zeros(0, np.int64)]).astype(np.int32)
        layer = np.repeat([outer for _, outer in inner], [len(vertices) for vertices, _ in inner]).astype(np.int32)
        self._pair_count = len(vertex)
        capacity = max(self._pair_count, 1)
        hold_pairs(c, capacity, self._device)
        self.pair_energy, self.pair_force = self._zeros(capacity, wp.float64), self._zeros(capacity, wp.vec3)
        self._pair_gap = self._zeros(capacity, wp.float32)
        c.pair_total = wp.array([self._pair_count], dtype=wp.int32, device=self._device)
        c.incident_start, c.incident_count = (self._zeros(self._count, wp.int32) for _ in range(2))
        if not self._pair_count:
            return
        pairs = layers.LayerPairs()
        pairs.vertex, pairs.layer = self._upload(vertex, wp.int32), self._upload(layer, wp.int32)
        pairs.face = self._zeros(self._pair_count, wp.int32)
        pairs.closest = wp.full(self._pair_count, -1, dtype=wp.int32, device=self._device)
        pairs.area = self._upload(self._model.area[vertex], wp.float64)
        self._pairs = pairs
        self._points = self._zeros((1, self._count), wp.vec3)
        self._layer_meshes = [
            wp.Mesh(
                points=self._points[0][part.vertices],
                indices=self._upload((self._model.faces[part.triangles] - part.vertices.start).ravel(), wp.int32),
                # Coarse layers are small: what smaller leaves save in searches is more than they cost in refitting.
                bvh_leaf_size=1,
            )
            for part in parts
        ]
        self._layer_ids = wp.array([mesh.id for mesh in self._layer_meshes], dtype=wp.uint64, device=self._device)
        self._first_face = wp.array([part.triangles.start for part in parts], dtype=wp.int32, device=self._device)

    def _make_limbs(self, limbs: Sequence[Limbs | None], body_triangle_count: int) -> None:
        known = [one for one in limbs if one is not None]
        of_triangles = known[0].of_triangles if known else np.zeros(body_triangle_count, np.int32)
        self.body.limb = self._upload(of_triangles, wp.int32)
        counts = [part.vertices.stop - part.vertices.start for part in self._model.parts]
        of_vertices = [
            np.full(count, ALL_LIMBS) if one is None else one.of_vertices
            for one, count in zip(limbs, counts, strict=True)
        ]
        self._limbs = self._upload(np.concatenate(of_vertices), wp.int32)

    def _upload(self, values: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(values, dtype=dtype, device=self._device)

    def _zeros(self, shape: tuple[int, ...] | int, dtype: Any) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self._device)

    def _launch_normals(
        self, points: wp.array, faces: wp.array, around: list[wp.array], of_faces: wp.array, normals: wp.array
    ) -> None:
        """Unit normals of a surface's vertices; ``of_faces`` is room for those of its triangles."""
        self._launch(body_surface.face_normals, of_faces.shape, [points, faces], [of_faces])
        self._launch(body_surface.vertex_normals, points.shape, [of_faces, *around], [normals])

    def _launch(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)


def make_path(count: int, device: Any) -> frame_steps.Path:
    """Room for points that move from frame to frame."""
    path = frame_steps.Path()
    for name in ("earlier", "last", "coming"):
        setattr(path, name, wp.zeros(count, dtype=wp.vec3, device=device))
    return path


def arrive(path: frame_steps.Path) -> None:
    """The coming frame is the last one."""
    wp.copy(path.earlier, path.last)
    wp.copy(path.last, path.coming)
