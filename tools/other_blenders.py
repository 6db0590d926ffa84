"""Run the tests under the other versions of Blender that the extension claims, each in an environment of its own; then
install the zip there and do the main job with it.

A version whose Python is not installed is left out, and that is said.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

from prepare import ROOT, build_environment, install_system_libraries, interpreter

VERSIONS = (("4.5", "python3.11", "bpy~=4.5.0"), ("5.2", "python3.13", "bpy~=5.2.0"))
"""Blender, the Python that its module is made for, and its newest release."""

TESTS = ("tests/blender", "tests/unit")

# Some builds of the module hang when the interpreter takes them down. -P keeps packages from being looked for here.
RUN_TESTS = "import os, sys, pytest; code = pytest.main(sys.argv[1:]); sys.stdout.flush(); os._exit(code)"


def main(tests: Sequence[str]) -> None:
    """Test under every version; with arguments, these tests instead of the usual ones."""
    install_system_libraries()
    failed = []
    for blender, python, module in VERSIONS:
        if not has_python(python):
            print(f"Blender {blender} is left out: its module needs {python}, which is not installed here.", flush=True)
            continue
        venv = ROOT / f".venv-{blender}"
        build_environment(python, venv, ["--editable", f"{ROOT}[analysis,test]", module])
        print(f"Testing under Blender {blender} ...", flush=True)
        run = [str(interpreter(venv)), "-P"]
        commands = [[*run, "-c", RUN_TESTS, "-m", "not long", *(tests or TESTS)]]
        if not tests:
            commands.append([*run, str(ROOT / "tools" / "main_job.py")])
        if sum(subprocess.run(command, cwd=ROOT, check=False).returncode != 0 for command in commands):
            failed.append(blender)
    if failed:
        sys.exit(f"other_blenders: something failed under Blender {', '.join(failed)}")


def has_python(python: str) -> bool:
    """Whether an interpreter runs; a version manager's shim may only look as if."""
    try:
        return subprocess.run([python, "-c", ""], capture_output=True, check=False).returncode == 0
    except OSError:
        return False


if __name__ == "__main__":
    main(sys.argv[1:])
