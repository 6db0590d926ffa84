"""Stress and stiffness of every triangle: the membrane and its damping together."""

import warp as wp

from ..natural import natural
from .damping import damping_energy, damping_stress, damping_tangent
from .membrane import (
    Membrane,
    deformation_gradient,
    green_strain,
    mat32d,
    membrane_energy,
    membrane_stress,
    membrane_tangent,
    tensile_part,
)

wp.set_module_options({"enable_backward": False})


@wp.struct
class Damping:
    """Viscosity [N s/m], the strain at the beginning of the time step, and 1 / its length [1/s]; 0 damps nothing.

    The rate, of shape [1], is what a recorded step reads anew.
    """

    viscosity: wp.vec4d
    before: wp.array2d[wp.vec3d]
    rate: wp.array[wp.float64]


@wp.kernel
def deform_triangles(
    positions: wp.array2d[wp.vec3d],
    faces: wp.array2d[wp.int32],
    rest_inverse: wp.array[wp.mat22d],
    rest_area: wp.array[wp.float64],
    material: Membrane,
    damping: Damping,
    # outputs
    deformation: wp.array2d[mat32d],
    stress: wp.array2d[wp.vec3d],
    energy: wp.array2d[wp.float64],
):
    """Deformation gradient, stress [N/m] and energy [J] of every triangle."""
    world, i = wp.tid()
    triangle = natural(i)
    f = deformation_gradient(
        positions[world, natural(faces[triangle, 0])],
        positions[world, natural(faces[triangle, 1])],
        positions[world, natural(faces[triangle, 2])],
        rest_inverse[triangle],
    )
    strain = green_strain(f)
    s = membrane_stress(strain, material)
    density = membrane_energy(strain, material)
    rate = damping.rate[0]
    if rate > wp.float64(0.0):
        change = strain - damping.before[world, triangle]
        s += damping_stress(change, damping.viscosity, rate)
        density += damping_energy(change, damping.viscosity, rate)
    deformation[world, triangle] = f
    stress[world, triangle] = s
    energy[world, triangle] = rest_area[triangle] * density


@wp.kernel
def strain_triangles(deformation: wp.array2d[mat32d], strain: wp.array2d[wp.vec3d]):
    """Green strain (Exx, Eyy, 2 Exy) of every triangle."""
    world, triangle = wp.tid()
    strain[world, triangle] = green_strain(deformation[world, triangle])


@wp.kernel
def linearise_triangles(
    deformation: wp.array2d[mat32d],
    stress: wp.array2d[wp.vec3d],
    material: Membrane,
    damping: Damping,
    kept: wp.array[wp.float64],
    # outputs
    tangent: wp.array2d[wp.vec4d],
    held: wp.array2d[wp.vec3d],
):
    """Tangent stiffness of every triangle [N/m], and its stress with ``kept`` as the share of its compressive part.

    With all of it kept (1) :func:`~.membrane.membrane_hessian` is exact, with none (0) positive semi-definite.
    """
    world, i = wp.tid()
    triangle = natural(i)
    elastic = membrane_tangent(green_strain(deformation[world, triangle]), material)
    tangent[world, triangle] = elastic + damping_tangent(damping.viscosity, damping.rate[0])
    s = stress[world, triangle]
    tension = tensile_part(s)
    held[world, triangle] = tension + kept[world] * (s - tension)
