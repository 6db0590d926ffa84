"""The main job as an artist without the project's clone would do it: from a zip, on files, without the internet.

Run in an environment with Blender's module, it installs the zip there and does the job with what was installed:
alone, all of it; with the path of a .blend file, it makes the character; with a zip and that file, it does the rest.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

EXTENSION = "bl_ext.user_default.wrinkle_synthesis"


def verbs(folder: str) -> list[list[str]]:
    """The job's command lines, from a file with a body and a shirt to a point cache.

    Args:
        folder: Where figure.blend lies, as those who run the job see it.
    """
    ready, database = f"{folder}/ready.blend", f"{folder}/shirt.wrinkles"
    chosen = ["--subdivide", "0", "--joints", "elbow_L", "--samples", "2"]
    return [
        ["doctor"],
        ["setup", f"{folder}/figure.blend", "--garment", "shirt", "--body", "body", *chosen, "--out", ready],
        ["check", ready],
        ["bake", ready],
        ["verify", database],
        ["synthesize", ready, "--frames", "1:3", "--out", f"{folder}/shirt.pc2"],
    ]


def write_figure(path: Path) -> None:
    """A file with a body in a shirt that is not set up: the tests' character, as if out of another program."""
    sys.path.insert(0, str(ROOT / "tests"))
    import bpy
    from dolls import doll  # pyright: ignore[reportMissingImports]
    from figures import build_figure, leave_as_imported  # pyright: ignore[reportMissingImports]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    build_figure(doll(31, 12))
    leave_as_imported()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


def install_and_run(archive: Path, figure: Path) -> None:
    """Install into Blender's module, whose environment may hold our dependencies: none but the zip's are used."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["BLENDER_USER_RESOURCES"] = f"{folder}/blender"
        # Neither SciPy nor Matplotlib, which the zip has not; Warp and safetensors must come out of the zip.
        for absent in ("scipy", "matplotlib", "wrinkle_synthesis"):
            sys.modules[absent] = None  # pyright: ignore[reportArgumentType]
        import bpy

        python = f"python{sys.version_info.major}.{sys.version_info.minor}"
        site = Path(bpy.utils.user_resource("EXTENSIONS")) / ".local" / "lib" / python / "site-packages"
        # Python takes no notice of a folder that comes into being behind its back.
        site.mkdir(parents=True)
        sys.path.insert(0, str(site))
        bpy.ops.extensions.package_install_files(
            filepath=str(archive), repo="user_default", enable_on_install=True, overwrite=True
        )
        cli = importlib.import_module(f"{EXTENSION}.wrinkle_addon.cli")
        (Path(folder) / "figure.blend").write_bytes(figure.read_bytes())
        for verb in verbs(folder):
            print(f"wrinkle {verb[0]}", flush=True)
            if cli.main(verb):
                raise SystemExit(f"main_job: failed: wrinkle {' '.join(verb)}")
        for package in ("warp", "safetensors"):
            file = sys.modules[package].__file__ or ""
            if not file.startswith(str(site)):
                raise SystemExit(f"main_job: {package} is that of {file}, not the zip's")
        bpy.ops.preferences.addon_disable(module=EXTENSION)
        print(f"Blender {bpy.app.version_string}: installed from {archive.name}, and the main job done.", flush=True)


def try_here() -> None:
    """Install the zip into this environment's Blender module, and do the job there; ends this process if it fails."""
    archive = linux_archive()
    with tempfile.TemporaryDirectory() as folder:
        figure = Path(folder) / "figure.blend"
        for arguments in ([figure], [archive, figure]):
            line = [sys.executable, "-P", __file__, *map(str, arguments)]
            if subprocess.run(line, cwd=folder, check=False).returncode:
                raise SystemExit(f"main_job: this failed: {' '.join(line)}")


def linux_archive() -> Path:
    """The zip for this machine that `make extension` has built."""
    found = sorted((ROOT / "dist").glob("*linux_x64.zip"))
    if not found:
        raise SystemExit("main_job: there is no zip for Linux in dist; run make extension first.")
    return found[-1]


if __name__ == "__main__":
    if len(sys.argv) == 1:
        try_here()
    elif len(sys.argv) == 2:
        write_figure(Path(sys.argv[1]))
    else:
        install_and_run(Path(sys.argv[1]), Path(sys.argv[2]))
    sys.stdout.flush()
    # Some builds of the module hang when the interpreter takes them down.
    os._exit(0)
