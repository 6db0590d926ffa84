"""Wang et al.'s synthesis and ours written out plainly in float64: what the kernels must reproduce."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase, skin_frame
from wrinkle_synthesis.wrinkle_addon.joint_wrinkles import JointWrinkles, find_cell
from wrinkle_synthesis.wrinkle_addon.plan import Sample
from wrinkle_synthesis.wrinkle_addon.rig import Pose, joint_angles, pose_of_angles

Array = np.ndarray


def turned(axis: Array, angle: Array, vectors: Array) -> Array:
    """Rodrigues' formula, one unit axis and angle a vector."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (axis * vectors).sum(1, keepdims=True)
    return c * vectors + s * np.cross(axis, vectors) + (1 - c) * along * axis


def about_point(p0: Array, p1: Array, centre: Array, t: float) -> Array:
    """Eq 1, linear where an arm has no length or both are parallel (X01)."""
    e0, e1 = p0 - centre, p1 - centre
    l0, l1 = (np.linalg.norm(e, axis=1) for e in (e0, e1))
    normal = np.cross(e0, e1)
    sine = np.linalg.norm(normal, axis=1)
    good = (sine > 1e-5 * l0 * l1) & (l0 >= 1e-6)
    axis = normal / np.where(good, sine, 1.0)[:, None]
    angle = np.arctan2(sine, (e0 * e1).sum(1))
    arc = centre + (((1 - t) * l0 + t * l1) / np.where(good, l0, 1.0))[:, None] * turned(axis, t * angle, e0)
    return np.where(good[:, None], arc, (1 - t) * p0 + t * p1)


def about_axis(p0: Array, p1: Array, origin: Array, axis: Array, t: float) -> Array:
    """Eq 2 and 3."""
    q0, q1 = (origin + ((p - origin) @ axis)[:, None] * axis for p in (p0, p1))
    e0, e1 = p0 - q0, p1 - q1
    l0, l1 = (np.linalg.norm(e, axis=1) for e in (e0, e1))
    good = (l0 >= 1e-6) & (l1 >= 1e-6)
    angle = np.arctan2(np.cross(e0, e1) @ axis, (e0 * e1).sum(1))
    axes = np.broadcast_to(axis, e0.shape)
    arc = (1 - t) * q0 + t * q1
    arc = arc + (((1 - t) * l0 + t * l1) / np.where(good, l0, 1.0))[:, None] * turned(axes, t * angle, e0)
    return np.where(good[:, None], arc, (1 - t) * p0 + t * p1)


def offsets_over_skinning(method: JointWrinkles, pose: Pose, strength: Mapping[str, float] | None = None) -> Array:
    """p = x + Q d, where d joins phi_J delta_J of all joints, multilinear over each joint's grid."""
    database, header = method.database, method.header
    skinned, turns = skin_frame(header.rig, header.garment.weights, database.rest, pose)
    offsets = []
    for name, angles in joint_angles(header.rig, header.joints, pose).items():
        grid = header.plan.grid[name]
        cell = find_cell(grid, angles)
        offset = np.zeros_like(skinned)
        factor = (strength or {}).get(name, 1.0)
        for bits in np.ndindex(*[2] * len(angles)):
            node = tuple(cell.upper[k] if bit else cell.lower[k] for k, bit in enumerate(bits))
            weight = np.prod([cell.fraction[k] if bit else 1 - cell.fraction[k] for k, bit in enumerate(bits)])
            if node != grid.rest:
                stored = database.sample(Sample(name, node))
                window = method.window(name)[stored.vertices].astype(float)[:, None]
                offset[stored.vertices] += factor * weight * window * stored.offsets
        offsets.append(offset)
    return skinned + rotations.rotate(turns, joined(np.stack(offsets)))


def joined(offsets: Array) -> Array:
    """The plain sum of offsets, shape [joint_count, n, 3], but no longer than the longest of them along it."""
    total = offsets.sum(0)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    direction = total / np.where(length > 0.0, length, 1.0)
    along = np.abs((offsets * direction).sum(2))
    return direction * np.minimum(length[:, 0], along.max(0))[:, None]


def papers_form(method: JointWrinkles, pose: Pose) -> Array:
    """Eq 1 to 3 nested over each joint's grid, eq 4 in the rigid frames of the regions."""
    database, header = method.database, method.header
    regions, weights = header.regions, method.joint_weights()
    skinned, _ = skin_frame(header.rig, header.garment.weights, database.rest, pose)
    deformations = pose.deformations(header.rig)
    total, used = np.zeros_like(skinned), np.zeros(len(skinned))
    for name, angles in joint_angles(header.rig, header.joints, pose).items():
        grid = header.plan.grid[name]
        joint, cell = grid.joint, find_cell(grid, angles)
        mesh = interpolated_mesh(method, database, name, cell)
        clamped = grid.at(cell.lower) + cell.fraction * (grid.at(cell.upper) - grid.at(cell.lower))
        alone = pose_of_angles(header.rig, [joint], {name: clamped}).deformations(header.rig)
        for segment, bone in enumerate(regions.frames):
            members = regions.vertex_segment == segment
            rigid = deformations[bone] @ np.linalg.inv(alone[bone])
            placed = mesh[members] @ rigid[:3, :3].T + rigid[:3, 3]
            total[members] += weights[name][members, None] * placed
        used += weights[name]
    return total + (1 - used)[:, None] * skinned


def interpolated_mesh(method: JointWrinkles, database: WrinkleDatabase, name: str, cell) -> Array:
    """A joint's wrinkle mesh between its samples."""
    header = method.header
    grid = header.plan.grid[name]
    joint, centre = grid.joint, grid.joint.pivot(header.rig)

    def mesh(*upper: bool) -> Array:
        node = tuple(b if u else a for a, b, u in zip(cell.lower, cell.upper, upper, strict=True))
        return database.rest if node == grid.rest else database.positions(Sample(name, node))

    t = cell.fraction
    if joint.is_hinge:
        if method.hinges_about_axis:
            return about_axis(mesh(False), mesh(True), centre, joint.axes[0], t[0])
        return about_point(mesh(False), mesh(True), centre, t[0])

    def twisted(first: bool, second: bool) -> Array:
        node = (0, cell.upper[1] if first else cell.lower[1], cell.upper[2] if second else cell.lower[2])
        angles = grid.at(node)
        axis = rotations.rotate(joint.turn([0.0, angles[1], angles[2]]), joint.axes[0])
        return about_axis(mesh(False, first, second), mesh(True, first, second), centre, axis, t[0])

    rows = [about_point(twisted(False, second), twisted(True, second), centre, t[1]) for second in (False, True)]
    return about_point(rows[0], rows[1], centre, t[2])
