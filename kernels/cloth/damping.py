"""Damping of stretching and shearing, which leaves rigid motion alone.

Over a time step of length h from the Green strain E0 to E, the fabric's viscosity V = (v11, v12, v22, v33) [N s/m]
dissipates as much as if it had the potential (Rayleigh's dissipation function, times h)

    D = A / (2 h) (v11 dxx^2 + 2 v12 dxx dyy + v22 dyy^2 + v33 (2 dxy)^2)          [J],          d = E - E0

which the step minimises with all others: the form of the linear membrane, with V / h for its stiffness and the strain
since the step began for its strain. Its stress V d / h adds to the elastic one, its tangent V / h to the elastic one.
Proportional to the stiffness, V = b C with a time b [s], it damps each vibration of the membrane in proportion to the
square of its frequency. A motion that strains nothing has d = 0: momentum and angular momentum stay.
"""

import warp as wp

from .membrane import linear_stress

wp.set_module_options({"enable_backward": False})


@wp.func
def damping_energy(change: wp.vec3d, viscosity: wp.vec4d, rate: wp.float64) -> wp.float64:
    """D per rest area [J/m^2] for a change of strain (dxx, dyy, 2 dxy) and rate = 1 / h [1/s]."""
    return wp.float64(0.5) * rate * wp.dot(change, linear_stress(change, viscosity))


@wp.func
def damping_stress(change: wp.vec3d, viscosity: wp.vec4d, rate: wp.float64) -> wp.vec3d:
    """Its derivative by the strain (Sxx, Syy, Sxy) [N/m]."""
    return rate * linear_stress(change, viscosity)


@wp.func
def damping_tangent(viscosity: wp.vec4d, rate: wp.float64) -> wp.vec4d:
    """The derivative of that by the strain [N/m]."""
    return rate * viscosity
