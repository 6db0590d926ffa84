"""Host side of the garment's elasticity in every world: its membrane, and what its fabric has besides."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp

from ..kernels.cloth import assembly, hinges, membrane, springs, triangles
from .cloth_model import ClothModel, FabricPart, FloatArray
from .elastic_elements import Gathering, HingeRest, SpringRest
from .fabrics import Fabric
from .topology import by_fours


def membrane_of(fabric: Fabric) -> membrane.Membrane:
    """A fabric's membrane as kernels take it; that of a net of springs has no stiffness."""
    material = membrane.Membrane()
    if fabric.material != "springs":
        material.stiffness = wp.vec4d(*fabric.stiffness)
        material.limit = wp.vec3d(*fabric.strain_limits)
        material.growth = wp.vec3d(*fabric.growth)
    return material


def shape_gradients(rest_inverse: FloatArray) -> FloatArray:
    """Gradients of the linear shape functions of triangles' corners in material coordinates [1/m], [n, 3, 2]."""
    return np.concatenate([-rest_inverse.sum(1, keepdims=True), rest_inverse], 1)


def upload_garment(model: ClothModel, pin_stiffness: FloatArray, device: Any) -> assembly.Garment:
    """A model as kernels take it; ``pin_stiffness`` [N/m] holds each vertex to its pin target, shape [vertex_count]."""
    garment = assembly.Garment()
    garment.rest_inverse = wp.array(model.rest_inverse, dtype=wp.mat22d, device=device)
    for name in ("rest_area", "mass", "area"):
        setattr(garment, name, wp.array(getattr(model, name), dtype=wp.float64, device=device))
    for name in ("faces", "corner_start"):
        setattr(garment, name, wp.array(getattr(model, name), dtype=wp.int32, device=device))
    start, columns, coefficients = by_fours(model.bending_start, model.bending_columns, model.bending_coefficients)
    garment.bending_start = wp.array(start, dtype=wp.int32, device=device)
    garment.bending_columns = wp.array(columns, dtype=wp.vec4i, device=device)
    garment.bending_coefficients = wp.array(coefficients, dtype=wp.vec4d, device=device)
    garment.shape_gradients = wp.array(shape_gradients(model.rest_inverse), dtype=wp.vec2d, device=device)
    triangle, corner = np.divmod(model.corners, 3)
    garment.corners = wp.array(triangle << 2 | corner, dtype=wp.int32, device=device)
    garment.pin_stiffness = wp.array(pin_stiffness, dtype=wp.float64, device=device)
    return garment


class ElasticElements(Protocol):
    """Elements of a few vertices each that add to energy, gradient and Hessian."""

    def deform(self, positions: wp.array) -> None:
        """Find the elements' state and energy at these positions [m]."""
        ...

    def energy(self) -> FloatArray:
        """Energy as it was found last [J], shape [world_count]."""
        ...

    def add_gradient(self, gradient: wp.array) -> None:
        """Add the derivative of the energy by every vertex [N]."""
        ...

    def add_blocks(self, positions: wp.array, kept: wp.array, blocks: wp.array) -> None:
        """Add the Hessian at these positions [N/m], with each world's share ``kept`` of what makes it indefinite."""
        ...


@dataclass(frozen=True)
class _Part:
    """Triangles of one fabric: their membrane and damping, and their part of each array of :class:`Elasticity`.

    Attributes:
        rest: Faces, inverse of the rest edge matrix, rest area.
    """

    material: membrane.Membrane
    damping: triangles.Damping
    rest: tuple[wp.array, wp.array, wp.array]
    deformation: wp.array
    stress: wp.array
    tangent: wp.array
    held: wp.array
    energy: wp.array

    def launch(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=self.stress.shape, inputs=inputs, outputs=outputs, device=self.stress.device)


class Elasticity:
    """How the fabric resists being deformed.

    Attributes:
        deformation: Deformation gradient of every triangle, shape [world_count, triangle_count].
        stress: Its stress [N/m].
        tangent: Its stiffness at that strain [N/m].
        held: Its stress as far as the Hessian takes it into account [N/m].
        elements: Hinges or springs, if the fabric has any.
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
        self._damps = any(part.fabric.damping > 0.0 for part in model.parts)
        self._before = array(wp.vec3d) if self._damps else None
        self._rate = wp.zeros(1, dtype=wp.float64, device=self._device)
        self._parts = [self._make_part(part) for part in model.parts]
        self.elements: list[ElasticElements] = []
        if model.hinges is not None:
            self.elements.append(HingeBending(*model.hinges, world_count, self._device))
        if model.springs is not None:
            self.elements.append(SpringNet(*model.springs, world_count, self._device))

    def deform(self, positions: wp.array) -> None:
        """Find strain, stress and energy at these positions [m]."""
        for part in self._parts:
            found = [part.deformation, part.stress, part.energy]
            part.launch(triangles.deform_triangles, [positions, *part.rest, part.material, part.damping], found)
        for elements in self.elements:
            elements.deform(positions)

    @contextmanager
    def damped(self, positions: wp.array, dt: float) -> Iterator[None]:
        """Damp what goes on here, as a time step of ``dt`` [s] from these positions [m]."""
        self.remember_strain(positions)
        self.set_damping_rate(1.0 / dt)
        try:
            yield
        finally:
            self.set_damping_rate(0.0)

    def remember_strain(self, positions: wp.array) -> None:
        """Take the strain at these positions [m] for the one that a time step begins with."""
        if self._before is not None:
            self.deform(positions)
            for part in self._parts:
                part.launch(triangles.strain_triangles, [part.deformation], [part.damping.before])

    def set_damping_rate(self, rate: float) -> None:
        """1 / the length of the time step [1/s] that damping acts in; 0 for none."""
        if self._damps:
            self._rate.fill_(rate)

    def energy(self) -> FloatArray:
        """Energy as it was found last [J], shape [world_count]; within a step what it dissipates is part of it."""
        total = self._triangle_energy.numpy().sum(1)
        for elements in self.elements:
            total = total + elements.energy()
        return total

    def linearise(self, kept: wp.array) -> None:
        """Find tangent stiffness and held stress where the garment was deformed last.

        ``kept`` is the share of its compressive stress that each world takes into account, shape [world_count].
        """
        for part in self._parts:
            inputs = [part.deformation, part.stress, part.material, part.damping, kept]
            part.launch(triangles.linearise_triangles, inputs, [part.tangent, part.held])

    def _make_part(self, part: FabricPart) -> _Part:
        where, g = part.triangles, self._garment
        damping = triangles.Damping()
        damping.viscosity, damping.rate = wp.vec4d(*part.fabric.viscosity), self._rate
        if self._before is not None:
            damping.before = self._before[:, where]
        return _Part(
            material=membrane_of(part.fabric),
            damping=damping,
            rest=(g.faces[where], g.rest_inverse[where], g.rest_area[where]),
            deformation=self.deformation[:, where],
            stress=self.stress[:, where],
            tangent=self.tangent[:, where],
            held=self.held[:, where],
            energy=self._triangle_energy[:, where],
        )


class _Gathered:
    """What hinges and springs share: the lists by vertex and by block, and their energy."""

    def __init__(self, count: int, lists: Gathering, world_count: int, device: wp.Device):
        self._device = device
        self._shape = (world_count, count)
        self._by_vertex = self._upload(lists.corner_start, wp.int32), self._upload(lists.corners, wp.int32)
        self._by_block = self._upload(lists.block_start, wp.int32), self._upload(lists.blocks, wp.int32)
        self._energy = wp.zeros(self._shape, dtype=wp.float64, device=device)

    def energy(self) -> FloatArray:
        return self._energy.numpy().sum(1)

    def _upload(self, values: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(values, dtype=dtype, device=self._device)

    def _launch(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)


class HingeBending(_Gathered):
    """The nonlinear bending of :mod:`..kernels.cloth.hinges`."""

    def __init__(self, rest: HingeRest, lists: Gathering, world_count: int, device: wp.Device):
        super().__init__(len(rest.vertices), lists, world_count, device)
        self._hinges = hinges.Hinges()
        self._hinges.vertices = self._upload(rest.vertices, wp.int32)
        self._hinges.stiffness = self._upload(rest.stiffness, wp.float64)
        self._hinges.rest_angle = self._upload(rest.rest_angle, wp.float64)
        self._bend = wp.zeros(self._shape, dtype=wp.float64, device=device)
        self._slope = wp.zeros((*self._shape, 4), dtype=wp.vec3d, device=device)

    def deform(self, positions: wp.array) -> None:
        outputs = [self._bend, self._slope, self._energy]
        self._launch(hinges.bend_hinges, self._shape, [positions, self._hinges], outputs)

    def add_gradient(self, gradient: wp.array) -> None:
        inputs = [self._hinges, self._bend, self._slope, *self._by_vertex, gradient]
        self._launch(hinges.add_hinge_gradient, gradient.shape, inputs, [])

    def add_blocks(self, positions: wp.array, kept: wp.array, blocks: wp.array) -> None:
        inputs = [positions, self._hinges, self._bend, self._slope, kept, *self._by_block, blocks]
        self._launch(hinges.add_hinge_blocks, blocks.shape, inputs, [])


class SpringNet(_Gathered):
    """The springs of :mod:`..kernels.cloth.springs`."""

    def __init__(self, rest: SpringRest, lists: Gathering, world_count: int, device: wp.Device):
        super().__init__(len(rest.vertices), lists, world_count, device)
        self._springs = springs.Springs()
        self._springs.vertices = self._upload(rest.vertices, wp.int32)
        for name in ("rest_length", "stiffness", "beam", "turn"):
            setattr(self._springs, name, self._upload(getattr(rest, name), wp.float64))
        self._direction = wp.zeros(self._shape, dtype=wp.vec3d, device=device)
        self._state = wp.zeros(self._shape, dtype=wp.vec3d, device=device)

    def deform(self, positions: wp.array) -> None:
        outputs = [self._direction, self._state, self._energy]
        self._launch(springs.stretch_springs, self._shape, [positions, self._springs], outputs)

    def add_gradient(self, gradient: wp.array) -> None:
        inputs = [self._direction, self._state, *self._by_vertex, gradient]
        self._launch(springs.add_spring_gradient, gradient.shape, inputs, [])

    def add_blocks(self, positions: wp.array, kept: wp.array, blocks: wp.array) -> None:
        inputs = [self._direction, self._state, kept, *self._by_block, blocks]
        self._launch(springs.add_spring_blocks, blocks.shape, inputs, [])
