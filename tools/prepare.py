"""Make this checkout ready to run: an environment in .venv with everything pinned, and Blender's system libraries.

Needs only Python itself. Runs again in a moment when nothing has changed.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import hashlib
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ((3, 11), (3, 13))
"""Versions that Blender's module exists for."""

LIBRARIES = {
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXext.so.6": "libxext6",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libgomp.so.1": "libgomp1",
}
"""What the bpy module links to on Linux, and the Debian package that holds it."""


def main() -> None:
    extras = sys.argv[1] if len(sys.argv) > 1 else "analysis,blender,test"
    python = find_python()
    install_system_libraries()
    build_environment(python, ROOT / ".venv", ["--editable", f"{ROOT}[{extras}]"])


def build_environment(python: str, venv: Path, requirements: list[str]) -> None:
    """A virtual environment with what is required, in pip's words."""
    stamp = venv / ".ready"
    wanted = hashlib.sha256((ROOT / "pyproject.toml").read_bytes() + f"{python}{requirements}".encode()).hexdigest()
    if stamp.exists() and stamp.read_text() == wanted:
        return
    print(f"Setting up {venv} with {python} ...", flush=True)
    shutil.rmtree(venv, ignore_errors=True)
    make_environment(python, venv)
    pip = [str(interpreter(venv)), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    run([*pip, "--upgrade", "pip", "setuptools>=77", "wheel"])
    run([*pip, "--no-build-isolation", *requirements])
    stamp.write_text(wanted)


def find_python() -> str:
    """The interpreter to build on: this one if Blender's module exists for it, else another one on the path."""
    if sys.version_info[:2] in PYTHONS:
        return sys.executable
    for major, minor in PYTHONS:
        found = shutil.which(f"python{major}.{minor}")
        if found:
            return found
    fail("Blender's Python module needs Python 3.11 or 3.13; install one of them and run make again.")


def make_environment(python: str, venv: Path) -> None:
    """A virtual environment; Debian keeps the means for it in a package of its own."""
    if subprocess.run([python, "-m", "venv", str(venv)], stdout=subprocess.DEVNULL, check=False).returncode == 0:
        return
    shutil.rmtree(venv, ignore_errors=True)
    install_packages([f"{Path(python).name}-venv", "python3-venv"][-1:])
    run([python, "-m", "venv", str(venv)])


def install_system_libraries() -> None:
    """See to the shared libraries that Blender's module links to; other systems than Linux bring theirs."""
    if platform.system() != "Linux":
        return
    missing = sorted({package for library, package in LIBRARIES.items() if not can_load(library)})
    if missing:
        install_packages(missing)


def can_load(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def install_packages(packages: list[str]) -> None:
    """Install Debian packages as root, or say how."""
    command = f"apt-get update && apt-get install --yes --no-install-recommends {' '.join(packages)}"
    if shutil.which("apt-get") is None:
        fail(f"These system packages are missing (by their Debian names): {' '.join(packages)}; install them first.")
    if os.geteuid() != 0:
        fail(f"System libraries are missing; install them with: sudo sh -c '{command}'")
    print(f"Installing {' '.join(packages)} ...", flush=True)
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    if subprocess.run(["sh", "-c", command], env=environment, stdout=subprocess.DEVNULL, check=False).returncode:
        fail(f"Could not install system libraries; try: {command}")


def interpreter(venv: Path) -> Path:
    return venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def run(command: list[str]) -> None:
    if subprocess.run(command, check=False).returncode:
        fail(f"This failed: {' '.join(command)}")


def fail(message: str) -> NoReturn:
    sys.exit(f"prepare: {message}")


if __name__ == "__main__":
    main()
