"""Stretching of a triangle: Saint Venant-Kirchhoff membrane on linear triangles.

With the deformation gradient F = D_s D_m^-1 (3x2, material axes warp and weft) and the Green strain
E = (F^T F - I) / 2, the energy of a triangle of rest area A is

    W = A/2 (c11 Exx^2 + 2 c12 Exx Eyy + c22 Eyy^2 + c33 (2 Exy)^2)
        + A/6 (g1 <Exx>^3 + g2 <Eyy>^3 + g3 <2 Exy>^3)                       [J]

with the stiffness c = (c11, c12, c22, c33) in N/m. The first line is the energy of Xu et al. 2014 section 6 (S48).

The second one stiffens it, so that fabric does not stretch like rubber: <E> is what a strain goes past its limit, of
warp and weft in extension, of shear either way, and there the stiffness grows by g [N/m] per strain, as yarns come
straight and lock. As Volino et al. 2009 have it ("A simple approach to nonlinear tensile stiffness for accurate cloth
simulation"), each component of the strain has a stress-strain curve of its own; this one is a line that bends upwards
as a parabola. W is twice continuously differentiable and convex in E, so that the tensile part of the stress leaves
its Hessian positive semi-definite.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})  # Derivatives are written out by hand below.

mat32d = wp.types.matrix(shape=(3, 2), dtype=wp.float64)


@wp.func
def deformation_gradient(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, rest_inverse: wp.mat22d) -> mat32d:
    """F = D_s D_m^-1."""
    a = x1 - x0
    b = x2 - x0
    warp_column = a * rest_inverse[0, 0] + b * rest_inverse[1, 0]
    weft_column = a * rest_inverse[0, 1] + b * rest_inverse[1, 1]
    return wp.matrix_from_cols(warp_column, weft_column)


@wp.func
def green_strain(f: mat32d) -> wp.vec3d:
    """(Exx, Eyy, 2 Exy) of the Green strain."""
    u = wp.vec3d(f[0, 0], f[1, 0], f[2, 0])
    v = wp.vec3d(f[0, 1], f[1, 1], f[2, 1])
    half = wp.float64(0.5)
    one = wp.float64(1.0)
    return wp.vec3d(half * (wp.dot(u, u) - one), half * (wp.dot(v, v) - one), wp.dot(u, v))


@wp.struct
class Membrane:
    """Stiffness c [N/m], the strains (Exx, Eyy, 2 Exy) past which it grows, and its growth g per strain [N/m]."""

    stiffness: wp.vec4d
    limit: wp.vec3d
    growth: wp.vec3d


@wp.func
def excess(strain: wp.vec3d, limit: wp.vec3d) -> wp.vec3d:
    """What each strain goes past its limit; that of shear keeps its sign."""
    zero = wp.float64(0.0)
    return wp.vec3d(
        wp.max(strain[0] - limit[0], zero),
        wp.max(strain[1] - limit[1], zero),
        strain[2] - wp.clamp(strain[2], -limit[2], limit[2]),
    )


@wp.func
def linear_stress(strain: wp.vec3d, stiffness: wp.vec4d) -> wp.vec3d:
    """Stress (Sxx, Syy, Sxy) of the first line alone [N/m]."""
    return wp.vec3d(
        stiffness[0] * strain[0] + stiffness[1] * strain[1],
        stiffness[1] * strain[0] + stiffness[2] * strain[1],
        stiffness[3] * strain[2],
    )


@wp.func
def membrane_energy(strain: wp.vec3d, material: Membrane) -> wp.float64:
    """Energy density [J/m^2]."""
    past = excess(strain, material.limit)
    cubes = wp.vec3d(past[0] * past[0] * past[0], past[1] * past[1] * past[1], wp.abs(past[2] * past[2] * past[2]))
    linear = wp.float64(0.5) * wp.dot(strain, linear_stress(strain, material.stiffness))
    return linear + wp.dot(material.growth, cubes) / wp.float64(6.0)


@wp.func
def membrane_stress(strain: wp.vec3d, material: Membrane) -> wp.vec3d:
    """Second Piola-Kirchhoff stress (Sxx, Syy, Sxy) [N/m], the derivative of the energy density by the strain."""
    past = excess(strain, material.limit)
    squares = wp.vec3d(past[0] * past[0], past[1] * past[1], past[2] * wp.abs(past[2]))
    return linear_stress(strain, material.stiffness) + wp.float64(0.5) * wp.cw_mul(material.growth, squares)


@wp.func
def membrane_tangent(strain: wp.vec3d, material: Membrane) -> wp.vec4d:
    """(c11, c12, c22, c33) at this strain [N/m], the derivative of the stress by the strain."""
    more = wp.cw_mul(material.growth, excess(strain, material.limit))
    return material.stiffness + wp.vec4d(more[0], wp.float64(0.0), more[1], wp.abs(more[2]))


@wp.func
def membrane_gradient(f: mat32d, stress: wp.vec3d, g: wp.vec2d) -> wp.vec3d:
    """Derivative of the energy density by the corner whose shape gradient is g [N/m^2]: F S g."""
    return f * wp.vec2d(stress[0] * g[0] + stress[2] * g[1], stress[2] * g[0] + stress[1] * g[1])


@wp.func
def tensile_part(stress: wp.vec3d) -> wp.vec3d:
    """The stress with its negative principal values set to zero.

    Compression makes the geometric stiffness indefinite; without it every Hessian block sum is positive
    semi-definite, which Newton's method needs to go downhill.
    """
    half = wp.float64(0.5)
    mean = half * (stress[0] + stress[1])
    difference = half * (stress[0] - stress[1])
    radius = wp.sqrt(difference * difference + stress[2] * stress[2])
    high = wp.max(mean + radius, wp.float64(0.0))
    low = wp.max(mean - radius, wp.float64(0.0))
    cosine = wp.float64(1.0)
    sine = wp.float64(0.0)
    if radius > wp.float64(1.0e-12):
        cosine = difference / radius
        sine = stress[2] / radius
    mean = half * (high + low)
    radius = half * (high - low)
    return wp.vec3d(mean + radius * cosine, mean - radius * cosine, radius * sine)


@wp.func
def membrane_hessian(f: mat32d, stress: wp.vec3d, tangent: wp.vec4d, gi: wp.vec2d, gj: wp.vec2d) -> wp.mat33d:
    """Second derivative of the energy density by corners i and j [N/m^3].

    Takes ``tangent = membrane_tangent(...)``. The exact Hessian for ``stress = membrane_stress(...)``, a positive
    semi-definite one for its tensile part.
    """
    u = wp.vec3d(f[0, 0], f[1, 0], f[2, 0])
    v = wp.vec3d(f[0, 1], f[1, 1], f[2, 1])
    # Derivatives of (Exx, Eyy, 2 Exy) by a corner: (g0 u, g1 v, g1 u + g0 v). So in the basis of u and v:
    shear_v = tangent[3] * gi[0]
    shear_u = tangent[3] * gi[1]
    m00 = tangent[0] * gi[0] * gj[0] + shear_u * gj[1]
    m01 = tangent[1] * gi[0] * gj[1] + shear_u * gj[0]
    m10 = tangent[1] * gi[1] * gj[0] + shear_v * gj[1]
    m11 = tangent[2] * gi[1] * gj[1] + shear_v * gj[0]
    geometric = gi[0] * (stress[0] * gj[0] + stress[2] * gj[1]) + gi[1] * (stress[2] * gj[0] + stress[1] * gj[1])
    h = wp.outer(u, m00 * u + m01 * v) + wp.outer(v, m10 * u + m11 * v)
    h[0, 0] += geometric
    h[1, 1] += geometric
    h[2, 2] += geometric
    return h
