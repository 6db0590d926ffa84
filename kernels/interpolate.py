"""Interpolation between the samples around a joint's angles.

Positions, as in Wang et al. 2010, are interpolated along arcs: eq 1 about the joint, eq 2 and 3 about an axis (W60-W63,
W69). Offsets over skinning are interpolated multilinearly, see :mod:`.blend`.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

CORNERS = wp.constant(8)
"""Grid nodes around a point of a joint with three degrees of freedom."""

LEAST_LENGTH = wp.constant(1.0e-6)
"""Arms shorter than this [m] have no direction (X01)."""


@wp.func
def turn_between(e0: wp.vec3, e1: wp.vec3, axis: wp.vec3, angle: wp.float32, t: wp.float32) -> wp.vec3:
    """e0 turned by t * angle about the unit axis, its length going linearly to that of e1."""
    length0 = wp.length(e0)
    length = (1.0 - t) * length0 + t * wp.length(e1)
    return (length / length0) * wp.quat_rotate(wp.quat_from_axis_angle(axis, t * angle), e0)


@wp.func
def interpolate_about_point(p0: wp.vec3, p1: wp.vec3, centre: wp.vec3, t: wp.float32) -> wp.vec3:
    """Eq 1: from p0 to p1 on a circle about the centre, in the plane of both, the radius going linearly (W60).

    Where the plane is not defined (X01), because an arm has no length or both are parallel or opposite, linearly.
    """
    e0 = p0 - centre
    e1 = p1 - centre
    normal = wp.cross(e0, e1)
    sine = wp.length(normal)
    if sine <= 1.0e-5 * wp.length(e0) * wp.length(e1) or wp.length(e0) < LEAST_LENGTH:
        return (1.0 - t) * p0 + t * p1
    angle = wp.atan2(sine, wp.dot(e0, e1))
    return centre + turn_between(e0, e1, normal / sine, angle, t)


@wp.func
def interpolate_about_axis(p0: wp.vec3, p1: wp.vec3, origin: wp.vec3, axis: wp.vec3, t: wp.float32) -> wp.vec3:
    """Eq 2 and 3: a screw motion about a unit axis through the origin (W62, W63).

    The printed R(n, t theta) takes theta between the two arms; its sign about the axis is meant with it.
    """
    q0 = origin + axis * wp.dot(p0 - origin, axis)
    q1 = origin + axis * wp.dot(p1 - origin, axis)
    e0 = p0 - q0
    e1 = p1 - q1
    if wp.length(e0) < LEAST_LENGTH or wp.length(e1) < LEAST_LENGTH:
        return (1.0 - t) * p0 + t * p1
    angle = wp.atan2(wp.dot(axis, wp.cross(e0, e1)), wp.dot(e0, e1))
    return (1.0 - t) * q0 + t * q1 + turn_between(e0, e1, axis, angle, t)
