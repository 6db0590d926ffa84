"""Coulomb friction with memory, as an elastoplastic spring (W26, W27).

A touching vertex holds on to an anchor: the point of the body it stuck to. Its tangential displacement u from the
anchor stores energy like a spring while |u| stays below the slip length s, and like a constant force mu f_n beyond: a
Huber potential with the bound mu f_n frozen,

    D(u) = mu f_n u^2 / (2 s)      for u <= s      (sticking)
    D(u) = mu f_n (u - s / 2)      beyond          (slipping)

mu is the static coefficient while the vertex sticks and the smaller dynamic one while it slips. After a step the anchor
of a slipping vertex follows, so that the spring of static friction holds what slipping held: |u| = s mu_dynamic /
mu_static. Because the spring is as stiff as the contact is firm, a touch begins and ends without a jump.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

# Anchors are stored in float32, which is good to a few parts in ten thousand of a slip length.
STUCK_SHARE = wp.constant(wp.float64(0.999))


@wp.func
def friction_energy(length: wp.float64, bound: wp.float64, slip: wp.float64) -> wp.float64:
    """D(u) [J] for |u| [m], bound mu f_n [N] and slip length [m]."""
    half = wp.float64(0.5)
    if length <= slip:
        return half * bound * length * length / slip
    return bound * (length - half * slip)


@wp.func
def friction_slope(length: wp.float64, bound: wp.float64, slip: wp.float64) -> wp.float64:
    """D'(u) / u [N/m]: the force is this times the tangential displacement."""
    return bound / wp.max(length, slip)


@wp.func
def friction_hessian(drift: wp.vec3d, normal: wp.vec3d, bound: wp.float64, slip: wp.float64) -> wp.mat33d:
    """Second derivative by the vertex [N/m]; while slipping, nothing resists along the way of sliding.

    A spring at its bound counts as slipping: that is where anchors that follow keep it.
    """
    tangent = wp.identity(n=3, dtype=wp.float64) - wp.outer(normal, normal)
    length = wp.length(drift)
    if length <= STUCK_SHARE * slip:
        return (bound / slip) * tangent
    along = drift / length
    return (bound / length) * (tangent - wp.outer(along, along))


@wp.func
def tangential(displacement: wp.vec3d, normal: wp.vec3d) -> wp.vec3d:
    """The part of a displacement that lies in the contact plane."""
    return displacement - normal * wp.dot(displacement, normal)
