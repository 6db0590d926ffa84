"""Quadratic bending: the curvature energy of a plate whose lengths stay as they are (S48).

Over an inner edge the surface turns by k . x with k = (c03 + c04, c01 + c02, -c01 - c03, -c02 - c04) from the
cotangents of the rest angles (Bergou et al. 2006). The curvature K of a triangle is the one whose quadratic surface
turns as far over its three edges (the quadratic fit of Grinspun et al. 2006), and its energy that of an orthotropic
plate in warp and weft:

    W = A/2 (D11 |Kxx|^2 + 2 D12 Kxx . Kyy + D22 |Kyy|^2 + 2 D33 |Kxy|^2) = 1/2 x^T Q x          [J]

with the stiffness D = (D11, D12, D22, D33) in N m. With b1 along the warp, b2 along the weft, Poisson's ratio v,
D12 = v sqrt(b1 b2) and D33 = (1 - v) sqrt(b1 b2) a cylinder of curvature c, bent in a direction that is turned by t
from the warp, holds c^2 / 2 (sqrt(b1) cos^2 t + sqrt(b2) sin^2 t)^2 per area on any mesh. (The sum over single hinges,
3 / (A0 + A1) |k . x|^2, which is more common, holds 3 to 9 times as much, as mesh and direction have it.) Only on a
grid whose diagonals alternate do neighbouring vertices give way in turn, and it is half as stiff.

Q depends on the rest shape alone: it is a scalar matrix, built once (``wrinkle_addon/plate_bending.py``), and its
product with a scalar column acts on x, y and z alike. Its rest state is flat, like a cut piece of cloth.
"""

import warp as wp

from ..natural import natural

wp.set_module_options({"enable_backward": False})


@wp.func
def bending_gradient(
    vertex: wp.int32,
    world: wp.int32,
    positions: wp.array2d[wp.vec3d],
    row_start: wp.array[wp.int32],
    columns: wp.array[wp.vec4i],
    coefficients: wp.array[wp.vec4d],
) -> wp.vec3d:
    """Row ``vertex`` of Q x [N], four entries at once; half its dot product with x is the row's share of the energy."""
    total = wp.vec3d()
    for k in range(row_start[vertex], row_start[vertex + 1]):
        c = columns[natural(k)]
        q = coefficients[natural(k)]
        total += (q[0] * positions[world, natural(c[0])] + q[1] * positions[world, natural(c[1])]) + (
            q[2] * positions[world, natural(c[2])] + q[3] * positions[world, natural(c[3])]
        )
    return total
