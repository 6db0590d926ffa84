"""Which way each vertex of a garment faces the body: as the skin does that it was modelled on, or as it lies now.

Skin that twists under a garment leaves it behind. On a shoulder turned in by 90 degrees and raised, a shirt lies up to
20 cm from where its skin has gone, and faces the other way there: what that skin calls outside is no guide any more to
which side of the body the cloth is on. The mean normal of the cloth around is; folds cancel out of it.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels.cloth import facing
from .cloth_model import ClothModel
from .garment import vertex_neighbours
from .topology import faces_around, mesh_edges

AROUND = 0.04
"""Distance over which the garment's normals are averaged [m], wider than its folds."""

TURNED_COSINE = 0.5
"""Below this cosine between the two, the garment's own normal counts and the skin's outward direction no more."""

MOST_ROUNDS = 80


class Facing:
    """Outward directions for the contact with the body, of every world.

    Attributes:
        directions: Unit vectors, shape [world_count, vertex_count]; zero where no outward direction was given.
    """

    def __init__(self, model: ClothModel, faces: wp.array, world_count: int):
        self._faces, self._device = faces, faces.device
        self._around = [self._upload(part) for part in faces_around(model.faces, model.vertex_count)]
        self._neighbours = [self._upload(part) for part in vertex_neighbours(model.faces, model.vertex_count)]
        ends = model.rest_positions[mesh_edges(model.faces)[0]]
        edge = float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())
        # A mean over a vertex and its six neighbours carries to 6/7 of a square of the edge, each time again.
        self._rounds = int(np.clip(np.ceil(7.0 / 6.0 * (AROUND / edge) ** 2), 1, MOST_ROUNDS))
        shape = (world_count, model.vertex_count)
        self.directions, self._outward, self._normals, self._mean = (
            wp.zeros(shape, dtype=wp.vec3, device=self._device) for _ in range(4)
        )

    def set_outward(self, outward: wp.array) -> None:
        """Face as the skin does."""
        wp.copy(self._outward, outward)
        wp.copy(self.directions, outward)

    def turn(self, positions: wp.array) -> None:
        """Where the garment at these positions (float64 [m]) has turned away from the skin, face as it lies."""
        self._launch(facing.garment_normals, [positions, self._faces, *self._around], [self._normals])
        for _ in range(self._rounds):
            self._launch(facing.mean_normals, [self._normals, *self._neighbours], [self._mean])
            self._normals, self._mean = self._mean, self._normals
        inputs = [self._outward, self._normals, TURNED_COSINE]
        self._launch(facing.face_as_it_lies, inputs, [self.directions])

    def _upload(self, values: np.ndarray) -> wp.array:
        return wp.array(values, dtype=wp.int32, device=self._device)

    def _launch(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=self.directions.shape, inputs=inputs, outputs=outputs, device=self._device)
