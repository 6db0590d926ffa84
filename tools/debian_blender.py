"""A Blender with a window on any Linux machine: Debian's own, in a root folder of its own, its screen in memory.

Built once with debootstrap (about 2 GB, some minutes, as root) and kept in the user's cache folder; no machine needs
a desktop, a graphics card or a newer C library for it.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT_VARIABLE = "WRINKLE_BLENDER_ROOT"
SUITE, BLENDER = "sid", "5.2"
"""The suite of Debian that has this Blender."""

PACKAGES = (
    # Blender, and the modules of Python without which NumPy and the extensions are missing.
    *("blender", "python3-numpy", "python3-cattr", "python3-requests", "python3-zstandard", "python3-pytest"),
    # A screen in memory, drawn on by the processor, with a hand for the mouse and a camera.
    *("xvfb", "xauth", "xdotool", "imagemagick-7.q16"),
    *("libgl1-mesa-dri", "libegl-mesa0", "libegl1", "libglx-mesa0", "libgl1"),
)
PROBE = "import pytest, numpy, cattr, requests, zstandard"


class Unavailable(RuntimeError):
    """There is no such Blender here, and none can be built; one sentence."""


def blender_root(*, build: bool = True) -> Path:
    """The root folder, built if there is none: $WRINKLE_BLENDER_ROOT, or one in the user's cache folder.

    Args:
        build: Whether to build it; else what there is not is unavailable.

    Raises:
        Unavailable: If it can be neither used nor built here.
    """
    if platform.system() != "Linux":
        raise Unavailable("the window is tested on Linux only")
    if os.geteuid() != 0:
        raise Unavailable("entering a root folder of its own needs root")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    root = Path(os.environ.get(ROOT_VARIABLE) or cache / "wrinkle_synthesis" / f"blender-{BLENDER}")
    if not (root / "usr/bin/blender").exists():
        if not build:
            raise Unavailable(f"there is no Blender {BLENDER} in {root}; make window builds it")
        _bootstrap(root)
    if enter(root, ["python3", "-c", PROBE], quiet=True).returncode:
        _install(root, PACKAGES)
    found = enter(root, ["blender", "--version"], quiet=True).stdout.split()
    if found[:1] != ["Blender"] or not found[1].startswith(BLENDER):
        raise Unavailable(f"the root folder {root} holds {' '.join(found[:2]) or 'no Blender'}, not {BLENDER}")
    return root


def enter(
    root: Path,
    command: Sequence[object],
    *,
    environment: Mapping[str, str] | None = None,
    folder: str = "/",
    timeout: float = 600.0,
    quiet: bool = False,
    offline: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Run a command inside the root folder, with nothing of this process's environment.

    Args:
        folder: Where it starts, seen from inside.
        timeout: After which it is killed [s].
        quiet: Keep what it prints for the caller instead of showing it.
        offline: Without any network, where the kernel lets us take it away.
    """
    variables = {
        "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
        "HOME": "/root",
        "LANG": "C.UTF-8",
        "LIBGL_ALWAYS_SOFTWARE": "1",
        "XDG_RUNTIME_DIR": "/tmp/runtime",
        **(environment or {}),
    }
    inside = ["env", "--chdir", folder, *(str(part) for part in command)]
    away = ["unshare", "--net"] if offline and _can_go_offline() else []
    arguments = [*away, "chroot", str(root), "timeout", str(timeout), *inside]
    return subprocess.run(
        arguments,
        env=variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE if quiet else None,
        stderr=subprocess.STDOUT if quiet else None,
        text=True,
        check=False,
    )


def with_screen(command: Sequence[object]) -> list[object]:
    """A command line that runs another one on a screen in memory."""
    return ["xvfb-run", "--auto-servernum", "--server-args=-screen 0 1280x1700x24 +extension GLX", *command]


def _can_go_offline() -> bool:
    return subprocess.run(["unshare", "--net", "true"], capture_output=True, check=False).returncode == 0


def _bootstrap(root: Path) -> None:
    """Debian's smallest system, then Blender in it."""
    if shutil.which("debootstrap") is None:
        raise Unavailable("Debian's debootstrap is not installed")
    print(f"Building a root folder with Blender {BLENDER} in {root} ...", flush=True)
    building = root.with_name(f"{root.name}.building")
    shutil.rmtree(building, ignore_errors=True)
    building.parent.mkdir(parents=True, exist_ok=True)
    command = ["debootstrap", "--variant=minbase", "--include=ca-certificates", SUITE, str(building)]
    if subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode:
        raise Unavailable("Debian's packages cannot be fetched")
    shutil.copy("/etc/resolv.conf", building / "etc/resolv.conf")
    # A mirror may be frozen at some date.
    (building / "etc/apt/apt.conf.d/00frozen").write_text('Acquire::Check-Valid-Until "false";\n')
    _install(building, PACKAGES)
    building.replace(root)


def _install(root: Path, packages: Sequence[str]) -> None:
    apt = ["env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "--quiet", "--yes"]
    for command in ([*apt, "update"], [*apt, "install", "--no-install-recommends", *packages]):
        outcome = enter(root, command, timeout=1800.0, quiet=True)
        if outcome.returncode:
            raise Unavailable(f"Debian's packages cannot be installed: {outcome.stdout.strip()[-300:]}")
    runtime = root / "tmp/runtime"
    runtime.mkdir(mode=0o700, exist_ok=True)
