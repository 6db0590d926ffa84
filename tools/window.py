"""Try the extension as an artist has it: from its zip, in a real Blender with a window, without the internet.

Where no such Blender can be set up, that is said and nothing is tried. Screenshots lie in build/window afterwards. With
the argument "day" only the zip is installed and the window clicked through, in a Blender that was set up before.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path

from debian_blender import Unavailable, blender_root, enter, with_screen
from main_job import ROOT, linux_archive, verbs

INSIDE = "/srv/wrinkle"
"""Where everything lies, seen from inside the root folder."""

SHOTS = ROOT / "build" / "window"
FRESH = {"BLENDER_USER_RESOURCES": f"{INSIDE}/user", "WARP_CACHE_PATH": f"{INSIDE}/kernels"}
"""Settings and kernels of somebody who has just installed Blender."""

RENDERS = "tests/blender/test_playback_render.py"
PIXEL_TESTS = {
    "Cycles and Workbench": ("-m", "not long", RENDERS, "tests/blender/test_render_scenes.py"),
    "EEVEE": ("-k", "an_animation_render and EEVEE", RENDERS),
}


BLENDER = ("blender", "--offline-mode")

LONGEST = 1800.0
"""What a step may take on a busy machine [s]."""


def main(*, day_only: bool) -> None:
    try:
        root = blender_root(build=not day_only)
    except Unavailable as reason:
        print(f"window: LEFT OUT, nothing was tried in a window: {reason}.", flush=True)
        return
    archive = _lay_out(root)
    install = ["--command", "extension", "install-file", "-r", "user_default", "-e", f"{INSIDE}/{archive}"]
    _step(root, "the zip is installed", [*BLENDER, *install])
    if not day_only:
        _in_the_background(root)
        _first_frames(root)
    _first_day(root)


def _in_the_background(root: Path) -> None:
    """The main job on the command line, and renders by their pixels."""
    for verb in verbs(INSIDE):
        _step(root, f"wrinkle {verb[0]}", [*BLENDER, "--background", "--command", "wrinkle", *verb])
    pixels = ["--factory-startup", "--background", "--python", f"{INSIDE}/source/tools/run_pytest.py", "--"]
    for engine, tests in PIXEL_TESTS.items():
        command = with_screen([*BLENDER, *pixels, f"{INSIDE}/packages", *tests])
        _step(root, f"renders of {engine} are right by their pixels", command)


def _first_frames(root: Path) -> None:
    """How long a baked file takes to its first wrinkled frame, at the very first start and from the second on."""
    _forget_kernels(root)
    for start in ("first", "second"):
        command = _window("ready.blend", "first_frame.py", time.time())
        _step(root, f"a baked file wrinkles at the {start} start", command)


def _first_day(root: Path) -> None:
    """From the first start on, whose kernels are not compiled yet, in a window; nothing was baked yet either."""
    _forget_kernels(root)
    shutil.rmtree(root / INSIDE.strip("/") / "shirt.wrinkles", ignore_errors=True)
    try:
        _step(root, "the window is clicked through", _window("figure.blend", "drive.py", f"{INSIDE}/shots"))
    finally:
        shutil.rmtree(SHOTS, ignore_errors=True)
        shutil.copytree(root / INSIDE.strip("/") / "shots", SHOTS)
        print(f"window: screenshots are in {SHOTS.relative_to(ROOT)}.", flush=True)


def _window(file: str, script: str, argument: object) -> list[object]:
    """A command line that opens a file in a window, where a script drives it."""
    size = ["--window-geometry", "0", "0", "1280", "1700"]
    driven = ["--python-exit-code", "1", f"{INSIDE}/{file}", "--python", f"{INSIDE}/source/tests/window/{script}"]
    return with_screen([*BLENDER, *size, *driven, "--", argument])


def _forget_kernels(root: Path) -> None:
    shutil.rmtree(root / FRESH["WARP_CACHE_PATH"].strip("/"), ignore_errors=True)


def _lay_out(root: Path) -> str:
    """Empty the folder inside, put the zip, the character and the tests there; gives the zip's name."""
    folder = root / INSIDE.strip("/")
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "shots").mkdir(parents=True)
    archive = linux_archive()
    shutil.copy(archive, folder)
    _unpack_wheels(archive, folder / "packages")
    figure = [sys.executable, "-P", ROOT / "tools" / "main_job.py", folder / "figure.blend"]
    if subprocess.run(list(map(str, figure)), cwd=folder, check=False, stdout=subprocess.DEVNULL).returncode:
        sys.exit("window: the character could not be made.")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            target = folder / "source" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
    return archive.name


def _unpack_wheels(archive: Path, folder: Path) -> None:
    """What the zip brings along, where it can be imported from without installing it."""
    with zipfile.ZipFile(archive) as extension:
        for name in extension.namelist():
            if name.endswith(".whl"):
                zipfile.ZipFile(io.BytesIO(extension.read(name))).extractall(folder)


def _step(root: Path, what: str, command: Sequence[object]) -> None:
    began = time.monotonic()
    outcome = enter(root, command, environment=FRESH, folder=INSIDE, timeout=LONGEST, offline=True, quiet=True)
    if outcome.returncode:
        print(outcome.stdout)
        sys.exit(f"window: not so: {what} (code {outcome.returncode}).")
    print(f"window: {what}, {time.monotonic() - began:.0f} s", flush=True)
    for line in outcome.stdout.splitlines():
        if line.startswith("window: "):
            print(line, flush=True)


if __name__ == "__main__":
    main(day_only=sys.argv[1:] == ["day"])
