"""Mean curvature of a triangle mesh at its vertices (W100, W101)."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def mean_curvature(
    positions: wp.array[wp.vec3],
    faces: wp.array2d[wp.int32],
    corner_start: wp.array[wp.int32],
    corners: wp.array[wp.int32],
    # outputs
    curvature: wp.array[wp.float32],
):
    """|H| [1/m] by the cotangent formula on the barycentric area; ``corners`` lists face * 3 + corner a vertex.

    H = |sum over edges of (cot a + cot b)(x_i - x_j)| / (4 A) (Meyer et al. 2003). Corners without area are left out.
    """
    vertex = wp.tid()
    x = positions[vertex]
    total = wp.vec3()
    area = wp.float32(0.0)
    for k in range(corner_start[vertex], corner_start[vertex + 1]):
        face = corners[k] // 3
        corner = corners[k] % 3
        p = positions[faces[face, (corner + 1) % 3]]
        q = positions[faces[face, (corner + 2) % 3]]
        doubled = wp.length(wp.cross(p - x, q - x))
        if doubled > 1.0e-14:
            # The edge to p lies opposite the angle at q, and the other way about.
            total += (wp.dot(x - q, p - q) / doubled) * (x - p) + (wp.dot(x - p, q - p) / doubled) * (x - q)
            area += doubled / 6.0
    curvature[vertex] = 0.0
    if area > 0.0:
        curvature[vertex] = wp.length(total) / (4.0 * area)
