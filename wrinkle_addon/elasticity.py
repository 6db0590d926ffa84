"""Host side of the garment's elasticity: the membrane of :mod:`..kernels.cloth.membrane` in every world."""

from __future__ import annotations

from typing import Any

import warp as wp

from ..kernels.cloth import assembly, membrane
from .cloth_model import ClothModel, FloatArray
from .fabrics import Fabric


def membrane_of(fabric: Fabric) -> membrane.Membrane:
    """A fabric's membrane as kernels take it."""
    material = membrane.Membrane()
    material.stiffness = wp.vec4d(*fabric.stiffness)
    material.limit = wp.vec3d(*fabric.strain_limits)
    material.growth = wp.vec3d(*fabric.growth)
    return material


class Elasticity:
    """How the fabric resists being deformed, triangle by triangle.

    Attributes:
        deformation: Deformation gradient of every triangle, shape [world_count, triangle_count].
        stress: Its stress [N/m].
        tangent: Its stiffness at that strain [N/m].
        held: Its stress as far as the Hessian takes it into account [N/m].
    """

    def __init__(self, model: ClothModel, garment: assembly.Garment, world_count: int):
        self._garment = garment
        self._device = garment.mass.device
        shape = (world_count, model.triangle_count)

        def array(dtype: Any) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=self._device)

        self.deformation, self.stress = array(membrane.mat32d), array(wp.vec3d)
        self.tangent, self.held = array(wp.vec4d), array(wp.vec3d)
        self._triangle_energy = array(wp.float64)

    def deform(self, positions: wp.array) -> None:
        """Find strain, stress and energy at these positions [m]."""
        g = self._garment
        self._launch(
            membrane.deform_triangles,
            [positions, g.faces, g.rest_inverse, g.rest_area, g.membrane],
            [self.deformation, self.stress, self._triangle_energy],
        )

    def energy(self) -> FloatArray:
        """Energy as it was found last [J], shape [world_count]."""
        return self._triangle_energy.numpy().sum(1)

    def linearise(self, kept: wp.array) -> None:
        """Find tangent stiffness and held stress where the garment was deformed last.

        ``kept`` is the share of its compressive stress that each world takes into account, shape [world_count].
        """
        self._launch(
            membrane.linearise_triangles,
            [self.deformation, self.stress, self._garment.membrane, kept],
            [self.tangent, self.held],
        )

    def _launch(self, kernel: Any, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=self.stress.shape, inputs=inputs, outputs=outputs, device=self._device)
