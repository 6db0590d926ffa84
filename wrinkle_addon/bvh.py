"""Motion-capture clips in Biovision's BVH format, read into a rig with poses, and written.

A BVH file says nothing about units, about which way is up or about what its zero pose looks like. The reader works all
three out from the skeleton: :class:`Clip` is always in metres, its gravity is known, and its rest pose is a standing
figure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from . import rotations
from .anatomy import Anatomy, find_anatomy
from .body_frame import limb_points, unit
from .rig import FloatArray, Pose, Rig

# Metres per unit of files seen in the wild: m, dm (MakeHuman), cm, mm, inch, and CMU's own 1/0.45 inch.
_UNITS = (1.0, 0.1, 0.01, 0.001, 0.0254, 0.0254 / 0.45)
_HUMAN_HEIGHT = 1.7
# A figure stands if its legs and the bends of all limbs are off by less than this in sum [rad]; an A-pose with elbows
# bent by 45 degrees is off by 2.
_STRAIGHT = math.pi
# A figure stands if its legs and the bends of all limbs are off by less than this in sum [rad]; an A-pose with elbows
# bent by 45 degrees is off by 2.
_STRAIGHT = math.pi
_REST_CANDIDATES = 12


@dataclass(frozen=True, eq=False)
class Clip:
    """A recorded motion: a rig, its pose in every frame, and the frame rate [1/s]."""

    rig: Rig
    poses: tuple[Pose, ...]
    fps: float


@dataclass(frozen=True)
class _Joint:
    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]
    end: tuple[float, float, float] | None


def read_bvh(path: str | Path, unit_m: float | None = None) -> Clip:
    """Read a BVH file of any skeleton, channel order, unit and up axis.

    Where the zero pose is no standing figure (some exporters lay every bone along one axis), the frame that stands
    straightest becomes the rest pose.

    Args:
        path: The file.
        unit_m: Metres per unit of the file; left out, the usual unit that makes the figure nearest to human size.

    Raises:
        ValueError: If the file is missing, malformed, or holds no motion; one sentence.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"There is no motion file {path}.")
    try:
        words = path.read_text(encoding="utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
        joints, motion = _parse_hierarchy(words)
        frame_time, table = _parse_motion(motion, sum(len(joint.channels) for joint in joints))
    except _Malformed as error:
        raise ValueError(f"{path.name} is no readable BVH file: {error}.") from error
    clip = Clip(*_rig_and_poses(joints, table, unit_m), fps=_tidy_rate(1.0 / frame_time))
    return _standing(clip)


class _Malformed(Exception):
    """What is wrong with a BVH file, as the second half of a sentence."""


def _parse_hierarchy(text: str) -> tuple[list[_Joint], str]:
    """The joints, parents first, and the rest of the text from MOTION on."""
    upper = text.upper()
    motion_at = upper.find("\nMOTION")
    if not upper.lstrip().startswith("HIERARCHY"):
        raise _Malformed("it does not begin with HIERARCHY")
    if motion_at < 0:
        raise _Malformed("it has no MOTION section")
    words = text[:motion_at].replace("{", " { ").replace("}", " } ").split()[1:]
    joints: list[_Joint] = []
    open_joints: list[int] = []
    at = 0
    in_end = False

    def numbers(start: int, count: int) -> tuple[float, ...]:
        try:
            values = tuple(float(word) for word in words[start : start + count])
        except ValueError:
            values = ()
        if len(values) != count or not all(math.isfinite(v) for v in values):
            raise _Malformed(f"it needs {count} numbers after {words[start - 1]} of joint {joints[-1].name}")
        return values

    while at < len(words):
        word = words[at].upper()
        if word in ("ROOT", "JOINT", "END"):
            brace = next((i for i in range(at, len(words)) if words[i] == "{"), None)
            if brace is None:
                raise _Malformed(f"the braces after {words[at]} are missing")
            in_end = word == "END"
            if not in_end:
                parent = open_joints[-1] if open_joints else -1
                name = " ".join(words[at + 1 : brace]) or f"joint{len(joints)}"
                joints.append(_Joint(name, parent, (0.0, 0.0, 0.0), (), None))
                open_joints.append(len(joints) - 1)
            elif not open_joints:
                raise _Malformed("an End Site stands outside every joint")
            at = brace + 1
        elif word == "OFFSET" and open_joints:
            x, y, z = numbers(at + 1, 3)
            last = open_joints[-1]
            joints[last] = replace(joints[last], **{"end" if in_end else "offset": (x, y, z)})
            at += 4
        elif word == "CHANNELS" and open_joints:
            count = int(words[at + 1]) if words[at + 1 : at + 2] and words[at + 1].isdigit() else 0
            channels = tuple(name.lower() for name in words[at + 2 : at + 2 + count])
            known = {axis + kind for axis in "xyz" for kind in ("position", "rotation")}
            if len(channels) != count or set(channels) - known:
                raise _Malformed(
                    f"joint {joints[open_joints[-1]].name} has channels that are no X, Y, Z of position or rotation"
                )
            joints[open_joints[-1]] = replace(joints[open_joints[-1]], channels=channels)
            at += 2 + count
        elif word == "}":
            if in_end:
                in_end = False
            elif open_joints:
                open_joints.pop()
            else:
                raise _Malformed("it closes more braces than it opens")
            at += 1
        else:
            raise _Malformed(f"the word {words[at]} in its hierarchy is not understood")
    if open_joints or in_end:
        raise _Malformed("its hierarchy is cut off")
    if not joints:
        raise _Malformed("its hierarchy has no joints")
    return _with_unique_names(joints), text[motion_at:]


def _with_unique_names(joints: list[_Joint]) -> list[_Joint]:
    seen: set[str] = set()
    unique: list[_Joint] = []
    for joint in joints:
        name, count = joint.name, 0
        while name in seen:
            count += 1
            name = f"{joint.name}.{count:03d}"
        seen.add(name)
        unique.append(replace(joint, name=name))
    return unique


def _parse_motion(text: str, channel_count: int) -> tuple[float, FloatArray]:
    """Frame time [s] and the channel values, shape [frame_count, channel_count]."""
    lines = [line for line in text.splitlines() if line.strip()][1:]
    stated: dict[str, float] = {}
    while lines and ":" in lines[0]:
        key, _, value = lines.pop(0).partition(":")
        try:
            stated[" ".join(key.lower().split())] = float(value)
        except ValueError as error:
            raise _Malformed(f"{key.strip()} is followed by no number") from error
    frame_time = stated.get("frame time", 0.0)
    if not (math.isfinite(frame_time) and frame_time > 0.0):
        raise _Malformed("it gives no Frame Time above zero")
    if not lines or stated.get("frames", 1.0) < 1.0:
        raise _Malformed("its motion is empty")
    rows = [line.split() for line in lines]
    if any(len(row) != channel_count for row in rows):
        # Some exporters wrap long rows; the numbers themselves must still fill whole frames.
        rows = _rewrapped([word for row in rows for word in row], channel_count)
    if len(rows) < stated.get("frames", 0.0):
        raise _Malformed(f"it announces {stated['frames']:.0f} frames and holds {len(rows)}")
    try:
        table = np.array(rows[: int(stated.get("frames", len(rows)))], np.float64)
    except ValueError as error:
        raise _Malformed("its motion holds a word that is no number") from error
    if not np.isfinite(table).all():
        raise _Malformed("its motion holds a value that is not a number")
    return frame_time, table


def _rewrapped(words: list[str], channel_count: int) -> list[list[str]]:
    if channel_count == 0 or len(words) % channel_count:
        raise _Malformed(f"its {len(words)} motion values do not fill frames of {channel_count} channels")
    return [words[i : i + channel_count] for i in range(0, len(words), channel_count)]


def _tidy_rate(fps: float) -> float:
    """The usual rate that a rounded frame time stands for."""
    for usual in (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 100.0, 120.0, 240.0, 24000 / 1001, 30000 / 1001, 60000 / 1001):
        if abs(fps - usual) < 2e-4 * usual:
            return usual
    return fps


# --- from joints to a rig -----------------------------------------------------------------------------------------


def _rig_and_poses(joints: list[_Joint], table: FloatArray, unit_m: float | None) -> tuple[Rig, tuple[Pose, ...]]:
    parents = np.array([joint.parent for joint in joints], np.int32)
    offsets = np.array([joint.offset for joint in joints])
    heads = offsets.copy()
    for i, parent in enumerate(parents):
        if parent >= 0:
            heads[i] += heads[parent]
    tails = _tails(joints, parents, heads)
    size = float(np.ptp(np.concatenate([heads, tails]), axis=0).max())
    if size <= 0.0:
        raise ValueError("The skeleton of the motion file has no size: all its offsets are zero.")
    scale = unit_m or min(_UNITS, key=lambda unit: abs(math.log(size * unit / _HUMAN_HEIGHT)))
    rest = np.tile(np.eye(4), (len(joints), 1, 1))
    rest[:, :3, :3] = [
        rotations.to_matrices(rotations.between([0.0, 1.0, 0.0], unit(t - h)))
        for h, t in zip(heads, tails, strict=True)
    ]
    rest[:, :3, 3] = heads * scale
    rig = Rig(
        names=tuple(joint.name for joint in joints),
        parents=parents,
        rest=rest,
        lengths=np.linalg.norm(tails - heads, axis=1) * scale,
        gravity=np.array([0.0, -1.0, 0.0]),
    )
    deformations = _deformations(joints, parents, heads, table)
    deformations[..., :3, 3] *= scale
    return rig, tuple(Pose(matrices) for matrices in deformations @ rig.rest)


def _tails(joints: list[_Joint], parents: np.ndarray, heads: FloatArray) -> FloatArray:
    """Where each bone points: to its only child, to the middle of its children, to its End Site."""
    tails = heads.copy()
    reach = max(float(np.ptp(heads, axis=0).max()), 1e-9)
    for i, joint in enumerate(joints):
        children = np.flatnonzero(parents == i)
        if len(children):
            tails[i] = heads[children].mean(0)
        elif joint.end is not None:
            tails[i] = heads[i] + joint.end
        if np.linalg.norm(tails[i] - heads[i]) < 1e-4 * reach:
            along = heads[i] - heads[parents[i]] if parents[i] >= 0 else np.array([0.0, 1.0, 0.0])
            along = along if np.linalg.norm(along) > 1e-4 * reach else np.array([0.0, 1.0, 0.0])
            tails[i] = heads[i] + 0.02 * reach * unit(along)
    return tails


def _deformations(joints: list[_Joint], parents: np.ndarray, heads: FloatArray, table: FloatArray) -> FloatArray:
    """Matrices that carry the zero pose into each frame, in units of the file, shape [frames, joints, 4, 4]."""
    count = len(table)
    posed = np.zeros((count, len(joints), 4, 4))
    at = 0
    for i, joint in enumerate(joints):
        values = table[:, at : at + len(joint.channels)]
        at += len(joint.channels)
        local = np.tile(np.eye(4), (count, 1, 1))
        turn = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
        for name, column in zip(joint.channels, values.T, strict=True):
            if name.endswith("rotation"):
                axis = np.eye(3)["xyz".index(name[0])]
                turn = rotations.multiply(turn, rotations.from_rotvec(np.radians(column)[:, None] * axis))
        local[:, :3, :3] = rotations.to_matrices(turn)
        local[:, :3, 3] = _translation(joint, values)
        posed[:, i] = local if parents[i] < 0 else posed[:, parents[i]] @ local
    to_rest = np.tile(np.eye(4), (len(joints), 1, 1))
    to_rest[:, :3, 3] = -heads
    return posed @ to_rest


def _translation(joint: _Joint, values: FloatArray) -> FloatArray:
    """Position of a joint on its parent, shape [frames, 3].

    Files disagree on whether position channels stand for the OFFSET or come on top of it; whichever keeps the joint
    nearer to its OFFSET is meant. A root's channels are its position.
    """
    offset = np.array(joint.offset)
    moved = np.tile(offset, (len(values), 1))
    columns = {name[0]: column for name, column in zip(joint.channels, values.T, strict=True) if "position" in name}
    if not columns:
        return moved
    given = np.stack([columns.get(axis, np.zeros(len(values))) for axis in "xyz"], axis=1)
    middle = np.median(given, axis=0)
    on_top = joint.parent >= 0 and np.linalg.norm(middle) < np.linalg.norm(middle - offset)
    for i, axis in enumerate("xyz"):
        if axis in columns:
            moved[:, i] = given[:, i] + (offset[i] if on_top else 0.0)
    return moved


# --- rest pose and gravity ----------------------------------------------------------------------------------------


def _standing(clip: Clip) -> Clip:
    """The clip with a standing rest pose, and with gravity along the axis on which the figure stands."""
    rig, body = clip.rig, find_anatomy(clip.rig)
    if _doubt(rig, body) > (0, _STRAIGHT):
        for i in np.unique(np.linspace(0, len(clip.poses) - 1, _REST_CANDIDATES).round().astype(int)):
            candidate = _rested_at(clip.rig, clip.poses[i])
            found = find_anatomy(candidate)
            if _doubt(candidate, found) < _doubt(rig, body):
                rig, body = candidate, found
    axis = np.argmax(np.abs(body.frame.up))
    gravity = np.zeros(3)
    gravity[axis] = -np.sign(body.frame.up[axis])
    return _with_upright_axes(Clip(replace(rig, gravity=gravity), clip.poses, clip.fps), body)


def _rested_at(rig: Rig, pose: Pose) -> Rig:
    """The rig with a pose as its rest pose."""
    rest = pose.matrices.copy()
    rest[:, :3, :3] = rotations.to_matrices(rotations.from_matrices(rest[:, :3, :3]))
    return replace(rig, rest=rest)


def _doubt(rig: Rig, body: Anatomy) -> tuple[float, float]:
    """How little a rest pose looks like the standing figure that its bones are named for; less is better.

    First the missing limbs and the names that the shape contradicts; then how far legs are from hanging, and the parts
    of all limbs from straight, in sum [rad].
    """
    slouch = 0.0
    for key, limb in body.limbs.items():
        first, middle, end = limb_points(rig, limb)
        slouch += float(np.arccos(np.clip(unit(middle - first) @ unit(end - middle), -1.0, 1.0)))
        if key.startswith("leg"):
            slouch += float(np.arccos(np.clip(-unit(middle - first) @ body.frame.up, -1.0, 1.0)))
    return 4.0 - len(body.limbs) + len(body.notes), slouch


def _with_upright_axes(clip: Clip, body: Anatomy) -> Clip:
    """Take off a turn of axes that stands in the root of every frame: a z-up rest pose played in a y-up world.

    A figure that keeps trunk and legs along +y throughout stands there; one that lies down or crawls does not.
    """
    y = np.array([0.0, 1.0, 0.0])
    legs = [limb for key, limb in body.limbs.items() if key.startswith("leg") and limb.end >= 0]
    if abs(clip.rig.gravity @ y) > 0.5 or body.pelvis < 0 or body.chest < 0 or not legs:
        return clip
    heads = np.stack([pose.matrices[:, :3, 3] for pose in clip.poses])
    lines = [heads[:, body.chest] - heads[:, body.pelvis], *(heads[:, leg.first] - heads[:, leg.end] for leg in legs)]
    if min(unit(line.mean(0)) @ y for line in lines) < np.cos(np.radians(45.0)):
        return clip
    turn = np.eye(4)
    turn[:3, :3] = rotations.to_matrices(rotations.between(y, -clip.rig.gravity))
    return replace(clip, poses=tuple(Pose(turn @ pose.matrices) for pose in clip.poses))


# --- writing ------------------------------------------------------------------------------------------------------


def write_bvh(path: str | Path, rig: Rig, poses: Sequence[Pose], fps: float) -> None:
    """Write poses of a rig as a BVH file in metres: six channels at roots and displaced bones, three elsewhere.

    Raises:
        ValueError: If there is no pose, or the frame rate is not above zero.
    """
    if not poses:
        raise ValueError("There is no pose to write.")
    if not fps > 0.0:
        raise ValueError("The frame rate of a motion must be above zero.")
    deformations = np.stack([pose.deformations(rig) for pose in poses])
    deformations[..., :3, :3] = rotations.to_matrices(rotations.from_matrices(deformations[..., :3, :3]))
    positions, angles = _channel_values(rig, deformations)
    moves = (rig.parents < 0) | (np.abs(positions - _offsets(rig)).max(axis=(0, 2)) > 1e-5)
    lines = ["HIERARCHY"]
    order: list[int] = []
    for root in np.flatnonzero(rig.parents < 0):
        _write_joint(lines, order, rig, int(root), moves, 0)
    lines += ["MOTION", f"Frames: {len(poses)}", f"Frame Time: {1.0 / fps:.9f}"]
    for frame in range(len(poses)):
        row = [
            np.concatenate([positions[frame, bone], angles[frame, bone]]) if moves[bone] else angles[frame, bone]
            for bone in order
        ]
        lines.append(" ".join(f"{value:.6f}" for value in np.concatenate(row)))
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _offsets(rig: Rig) -> FloatArray:
    """Heads relative to the parents' heads [m], shape [bone_count, 3]."""
    parents = np.where(rig.parents < 0, 0, rig.parents)
    return rig.heads - np.where((rig.parents < 0)[:, None], 0.0, rig.heads[parents])


def _channel_values(rig: Rig, deformations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions on the parent [m] and Z, X, Y angles [degrees], shape [frames, bones, 3] each."""
    posed = deformations.copy()
    posed[..., :3, 3] += np.einsum("fbij,bj->fbi", deformations[..., :3, :3], rig.heads)
    local = posed.copy()
    for bone, parent in enumerate(rig.parents):
        if parent >= 0:
            local[:, bone] = np.linalg.inv(posed[:, parent]) @ posed[:, bone]
    r = local[..., :3, :3]
    x = np.arcsin(np.clip(r[..., 2, 1], -1.0, 1.0))
    z = np.arctan2(-r[..., 0, 1], r[..., 1, 1])
    y = np.arctan2(-r[..., 2, 0], r[..., 2, 2])
    return local[..., :3, 3], np.degrees(np.stack([z, x, y], axis=-1))


def _write_joint(lines: list[str], order: list[int], rig: Rig, bone: int, moves: np.ndarray, depth: int) -> None:
    pad = "\t" * depth

    def offset(vector: FloatArray) -> str:
        return "OFFSET " + " ".join(f"{value:.6f}" for value in vector)

    order.append(bone)
    position = "6 Xposition Yposition Zposition " if moves[bone] else "3 "
    lines += [
        f"{pad}{'ROOT' if depth == 0 else 'JOINT'} {rig.names[bone]}",
        pad + "{",
        f"{pad}\t{offset(_offsets(rig)[bone])}",
        f"{pad}\tCHANNELS {position}Zrotation Xrotation Yrotation",
    ]
    children = rig.children(bone)
    for child in children:
        _write_joint(lines, order, rig, child, moves, depth + 1)
    if not children:
        end = offset(rig.tails[bone] - rig.heads[bone])
        lines += [f"{pad}\tEnd Site", pad + "\t{", f"{pad}\t\t{end}", pad + "\t}"]
    lines.append(pad + "}")
