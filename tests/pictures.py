"""Silhouettes: renders compared by how much of each pixel they cover."""

from __future__ import annotations

import struct
import sys
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from small_character import Arm, build_arm, empty_scene
from wrinkle_synthesis.wrinkle_addon.rig import Pose

SIZE = 48
SAME = 0.005
"""Mean difference of two pictures of one shape: the database's tolerance moves edges by a hundredth of a pixel."""
DIFFERENT = 0.05
"""Mean difference that two poses, or wrinkles and skinning, have at least."""
EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"


def filmed_arm(database: Path) -> Arm:
    """The arm from its side, black on white, so that a picture is a silhouette."""
    scene = empty_scene()
    arm = build_arm("", database)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 0.8
    scene.camera.location, scene.camera.rotation_euler = (0.3, -2.0, 0.2), (np.pi / 2, 0.0, 0.0)
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.film_transparent = True
    write_pictures(scene)
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.eevee.taa_render_samples = 4
    scene.frame_start, scene.frame_end = 1, 4
    return arm


def write_pictures(scene: bpy.types.Scene) -> None:
    """Let a scene render into pictures of one layer."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_mode = "PNG", "RGBA"


def bending(arm: Arm, start: int = 1) -> list[Pose]:
    """Bend the elbow over frames 1 to 4; returns the poses."""
    return arm.animate([{"elbow_L": [angle]} for angle in (0.2, 0.7, 1.5, 1.1)], start)


def alpha(path: Path) -> np.ndarray:
    """How much of each pixel a picture covers, shape [SIZE, SIZE]."""
    image = bpy.data.images.load(str(path))
    pixels = np.array(image.pixels).reshape(SIZE, SIZE, 4)[:, :, 3]
    bpy.data.images.remove(image)
    return pixels


def render_still(path: Path, scene: bpy.types.Scene | None = None) -> np.ndarray:
    """A still of a scene's current frame."""
    scene = scene or bpy.context.scene
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True, scene=scene.name)
    return alpha(path)


def render_animation(folder: Path) -> list[np.ndarray]:
    """Pictures of frames 1 to 4."""
    bpy.context.scene.render.filepath = str(folder / "frame-####")
    bpy.ops.render.render(animation=True)
    return [alpha(folder / f"frame-{frame:04}.png") for frame in range(1, 5)]


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference over the pixels that either picture covers at all."""
    covered = (a > 0.0) | (b > 0.0)
    return float(np.abs(a - b)[covered].mean())


def plain_mesh(arm: Arm, positions: np.ndarray) -> bpy.types.Object:
    """An object like the sleeve, of these positions, that nothing plays or deforms."""
    mesh = bpy.data.meshes.new("expected")
    quads = [list(polygon.vertices) for polygon in arm.sleeve.data.polygons]
    mesh.from_pydata(positions.tolist(), [], quads)
    plain = bpy.data.objects.new("expected", mesh)
    bpy.context.scene.collection.objects.link(plain)
    return plain


def expected_picture(arm: Arm, positions: np.ndarray, path: Path, *, like: Sequence[str] = ()) -> np.ndarray:
    """The same view of a plain mesh of these positions, with modifiers of these types as they come."""
    plain = plain_mesh(arm, positions)
    for kind in like:
        plain.modifiers.new(kind, kind)
    arm.sleeve.hide_render = True
    try:
        return render_still(path)
    finally:
        arm.sleeve.hide_render = False
        bpy.data.objects.remove(plain)


# --- several view layers ------------------------------------------------------------------------------------------


def write_layers(scene: bpy.types.Scene) -> None:
    """Let a scene render all its view layers into one uncompressed file."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.exr_codec, settings.color_depth = "OPEN_EXR_MULTILAYER", "NONE", "32"
    if hasattr(settings, "use_exr_interleave"):
        settings.use_exr_interleave = True


def layer_alphas(path: Path) -> dict[str, np.ndarray]:
    """How much of each pixel every view layer covers; reads uncompressed OpenEXR, whose layers Python cannot reach."""
    data = path.read_bytes()
    place, channels = 8, []
    while data[place]:
        _, kind, size, start = _attribute(data, place)
        if kind == "chlist":
            channels = _channels(data[start : start + size])
        place = start + size
    place += 1
    (first,) = struct.unpack_from("<Q", data, place)
    row = SIZE * 4
    layers: dict[str, np.ndarray] = {}
    for number, channel in enumerate(channels):
        layer, _, rest = channel.partition(".")
        if rest in ("Combined.A", "A"):
            stride = 8 + row * len(channels)
            starts = [first + line * stride + 8 + number * row for line in range(SIZE)]
            layers[layer] = np.stack([np.frombuffer(data, "<f4", SIZE, start) for start in reversed(starts)])
    return layers


def _attribute(data: bytes, place: int) -> tuple[str, str, int, int]:
    """Name, type, size and start of the value of a header's attribute."""
    name = data[place : data.index(0, place)].decode()
    place += len(name) + 1
    kind = data[place : data.index(0, place)].decode()
    place += len(kind) + 1
    return name, kind, struct.unpack_from("<i", data, place)[0], place + 4


def _channels(data: bytes) -> list[str]:
    """Names in a list of channels, all of 32-bit floats."""
    names, place = [], 0
    while data[place]:
        end = data.index(0, place)
        names.append(data[place:end].decode())
        assert struct.unpack_from("<i", data, end + 1) == (2,)
        place = end + 17
    return names


# --- other processes ----------------------------------------------------------------------------------------------


def fresh_process(script: str, *arguments: object) -> list[str]:
    """The command line that runs a script in a Blender of its own; arguments come after "--"."""
    tail = ["--", *map(str, arguments)]
    if not Path(bpy.app.binary_path).stem.lower().startswith("blender"):
        return [sys.executable, "-c", script, *tail]
    settings = ["--background", "--factory-startup", "--python-use-system-env", "--python-exit-code", "9"]
    return [bpy.app.binary_path, *settings, "--python-expr", script, *tail]
