"""Quadratic isometric bending (Bergou et al. 2006, Wardetzky et al. 2007; S48).

For an inner edge with its two triangles of rest areas A0 and A1, with k = (c03 + c04, c01 + c02, -c01 - c03,
-c02 - c04) from the cotangents of the rest angles, the energy is

    W = b/2 x^T Q x,    Q = 3 / (A0 + A1) k k^T          [J], b in N m

Q depends on the rest shape alone: it is a scalar matrix, built once (``wrinkle_addon/cloth_model.py``), and its
product with a scalar column acts on x, y and z alike. Its rest state is flat, like a cut piece of cloth.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def bending_gradient(
    vertex: wp.int32,
    world: wp.int32,
    positions: wp.array2d[wp.vec3d],
    row_start: wp.array[wp.int32],
    columns: wp.array[wp.int32],
    coefficients: wp.array[wp.float64],
) -> wp.vec3d:
    """Row ``vertex`` of b Q x [N]; half its dot product with x is the row's share of the energy."""
    total = wp.vec3d()
    for k in range(row_start[vertex], row_start[vertex + 1]):
        total += coefficients[k] * positions[world, columns[k]]
    return total
