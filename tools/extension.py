"""Build the Blender extension: fetch the pinned wheels, build one zip a platform, validate each."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parent.parent
STAGE = ROOT / "build" / "extension"
DIST = ROOT / "dist"
PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_11_0_arm64", "macosx_13_0_arm64", "macosx_14_0_arm64"),
}
PACKAGES = ("warp-lang", "safetensors")
"""What Blender's own Python lacks; SciPy and Matplotlib serve analysis only and stay out."""


def main() -> None:
    wheels = fetch_wheels()
    stage_source(wheels)
    DIST.mkdir(exist_ok=True)
    tool = Path(bpy.utils.resource_path("LOCAL")) / "scripts/addons_core/bl_pkg/cli/blender_ext.py"
    run(sys.executable, tool, "validate", STAGE)
    run(sys.executable, tool, "build", "--source-dir", STAGE, "--output-dir", DIST, "--split-platforms")
    for archive in sorted(DIST.glob("*.zip")):
        run(sys.executable, tool, "validate", archive)
        print(f"{archive.relative_to(ROOT)}: {archive.stat().st_size / 1e6:.0f} MB")


def pinned() -> dict[str, str]:
    """Versions of the bundled packages, from pyproject.toml."""
    dependencies = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    versions = dict(re.split("==", entry) for entry in dependencies if "==" in entry)
    return {package: versions[package] for package in PACKAGES}


def fetch_wheels() -> list[Path]:
    """Download one wheel a package and platform, for any Python from 3.11 on."""
    folder = ROOT / "build" / "wheels"
    folder.mkdir(parents=True, exist_ok=True)
    for tags in PLATFORMS.values():
        for package, version in pinned().items():
            platforms = [option for tag in tags for option in ("--platform", tag)]
            run(
                sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:",
                "--python-version", "3.11", *platforms, "--dest", folder, f"{package}=={version}",
            )  # fmt: skip
    wanted = tuple(f"{name.replace('-', '_')}-{version}-" for name, version in pinned().items())
    return sorted(path for path in folder.glob("*.whl") if path.name.startswith(wanted))


def stage_source(wheels: list[Path]) -> None:
    """Copy what is tracked into a folder of its own, with the wheels and a manifest that lists them."""
    shutil.rmtree(STAGE, ignore_errors=True)
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        target = STAGE / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, target)
    (STAGE / "wheels").mkdir()
    for wheel in wheels:
        shutil.copy2(wheel, STAGE / "wheels" / wheel.name)
    manifest = STAGE / "blender_manifest.toml"
    entries = "".join(f'  "./wheels/{wheel.name}",\n' for wheel in wheels)
    text, count = re.subn(r"^wheels = \[\]$", lambda _: f"wheels = [\n{entries}]", manifest.read_text(), flags=re.M)
    if count != 1:
        sys.exit("extension: the manifest has no empty list of wheels to fill in.")
    manifest.write_text(text)


def run(*command: object) -> None:
    if subprocess.run([str(part) for part in command], check=False).returncode:
        sys.exit(f"extension: this failed: {' '.join(map(str, command))}")


if __name__ == "__main__":
    main()
