"""The verbs `joints` and `animate` on files."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..bvh import read_bvh
from ..joints import find_joints, joints_to_json
from ..motion import retarget
from .armature import apply_motion, read_rig
from .files import check_output, choose_armature, open_character, save_character


def joints_of_file(path: str | Path, armature_name: str | None = None) -> dict[str, object]:
    """The nine joints found in a .blend, .glb, .gltf, .fbx or .bvh file, as JSON (see :func:`joints_to_json`).

    Raises:
        ValueError: If the file cannot be read, or it is not clear which armature is meant; one sentence.
    """
    if Path(path).suffix.lower() == ".bvh":
        return joints_to_json(find_joints(read_bvh(path).rig))
    open_character(path)
    return joints_to_json(find_joints(read_rig(choose_armature(armature_name))))


def animate_file(
    in_path: str | Path, armature_name: str | None, clip_path: str | Path, out_path: str | Path
) -> dict[str, object]:
    """Play a BVH clip on the character of a file, and save it as a .blend with the clip's frame rate and range.

    Returns:
        "armature", "frames", "fps", "joints" (those that follow the clip) and "notes" (sentences on what was silenced).

    Raises:
        ValueError: If a file cannot be read or written, or clip and character have no joint in common; one sentence.
    """
    clip = read_bvh(clip_path)
    check_output(Path(out_path), ".blend")
    open_character(in_path)
    armature = choose_armature(armature_name)
    rig = read_rig(armature)
    moving, moved = find_joints(clip.rig), find_joints(rig)
    poses = retarget(clip.rig, moving.found, clip.poses, rig, moved.found)
    notes = apply_motion(armature, rig, poses, name=Path(clip_path).stem)
    for scene in armature.users_scene:
        set_playback(scene, len(poses), clip.fps)
    save_character(Path(out_path))
    return {
        "armature": armature.name,
        "frames": len(poses),
        "fps": clip.fps,
        "joints": sorted({joint.name for joint in moving.found} & {joint.name for joint in moved.found}),
        "notes": [*moved.notes, *notes],
    }


def set_playback(scene: bpy.types.Scene, frame_count: int, fps: float) -> None:
    """Frames 1 to ``frame_count`` at a frame rate that may be a fraction (29.97)."""
    scene.render.fps = max(1, round(fps))
    scene.render.fps_base = scene.render.fps / fps
    scene.frame_start, scene.frame_end = 1, frame_count
    scene.frame_set(1)
