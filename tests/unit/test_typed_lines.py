"""Every command line in the documents is run or checked by somebody; one that nobody knows of fails here.

Those of our own program are run by tests/blender/test_documents.py, but for the demo's, which has tests of its own.
"""

from __future__ import annotations

import ast
import importlib
import re
import shlex
import shutil
import subprocess
import tomllib
from collections.abc import Callable, Sequence
from functools import cache

import pytest
from documents import DOOR, PAGES, ROOT, typed_lines
from wrinkle_synthesis.wrinkle_addon.cli_parser import build_parser

RUN_BY = {
    "make check": (".ci/run", "make check"),
    "make window": (".ci/run", "make window"),
    "make docs": (".ci/run", "make docs"),
    "make test": ("Makefile", "check: lint test"),
    "make lint": ("Makefile", "check: lint test"),
    "make setup": ("Makefile", "test: setup"),
    "make extension": ("Makefile", "window: extension"),
    "make long": ("Makefile", "tools/other_blenders.py"),
    "make bench": ("tests/unit/test_benchmarks.py", "bench_{name}.py"),
    "make demo": ("tests/unit/test_demo_run.py", "run_demo("),
    "python -m wrinkle_synthesis.demo.figures": ("tests/unit/test_demo_run.py", "draw_figures("),
    "python -m wrinkle_synthesis.demo.sequences": ("tests/unit/test_demo_sequences.py", "main("),
    "blender --offline-mode --command extension install-file": ("tools/window.py", '"install-file"'),
    "pip install": ("tools/prepare.py", '"pip", "install"'),
}
"""For each beginning of a line the file that runs what it does, and what stands there."""


@pytest.mark.parametrize(("page", "line"), sorted(set(typed_lines())))
def test_every_line_that_can_be_typed_is_known_and_right(page: str, line: str) -> None:
    program, *words = shlex.split(line, comments=True)
    assert program in CHECKS, f"Nobody runs '{line}' of {page}; a block that is no command needs a language."
    CHECKS[program](words)
    if program != "wrinkle" and DOOR not in line:
        told = [place for beginning, place in RUN_BY.items() if f"{line} ".startswith(f"{beginning} ")]
        assert told, f"Nobody runs '{line}' of {page}."
        for file, text in told:
            assert text in (ROOT / file).read_text(encoding="utf-8"), file


def check_verb(words: Sequence[str]) -> None:
    """The verb, and its action if there is one; test_documents.py parses whole lines and looks for every option."""
    parser = build_parser()
    for word in words:
        if word.startswith("-") or parser._subparsers is None:
            break
        (verbs,) = parser._subparsers._group_actions
        assert isinstance(verbs.choices, dict) and word in verbs.choices
        parser = verbs.choices[word]


def check_target(words: Sequence[str]) -> None:
    """What make would do: our own program's lines parse, and every script and test is there."""
    if shutil.which("make") is None:
        pytest.skip("make is not installed.")
    asked = subprocess.run(["make", "--dry-run", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    assert asked.returncode == 0, asked.stderr
    for variable, _, value in (word.partition("=") for word in words if "=" in word):
        assert f"$({variable})" in (ROOT / "Makefile").read_text(encoding="utf-8") and value in asked.stdout, variable
    for recipe in asked.stdout.splitlines():
        program, *arguments = shlex.split(recipe)
        if program.endswith("/wrinkle"):
            build_parser().parse_args(arguments)
        for file in (word.rstrip(";") for word in arguments):
            assert not file.endswith(".py") or list(ROOT.glob(file)), file


def check_module(words: Sequence[str]) -> None:
    option, module, *arguments = words
    assert option == "-m"
    importlib.import_module(module).build_parser().parse_args(arguments)


def check_extra(words: Sequence[str]) -> None:
    """Of this project."""
    ((extra,),) = (re.findall(r"^\.\[(\w+)\]$", word) for word in words[1:])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert extra in project["optional-dependencies"]


def check_blender(words: Sequence[str]) -> None:
    """A line of Blender's own is word for word one that the window's test runs, but for the zip's name."""
    if "wrinkle" not in words:
        script = ast.parse((ROOT / "tools" / "window.py").read_text(encoding="utf-8"))
        strings = {node.value for node in ast.walk(script) if isinstance(node, ast.Constant)}
        assert {word for word in words if not word.endswith(".zip")} <= strings


CHECKS: dict[str, Callable[[Sequence[str]], None]] = {
    "wrinkle": check_verb,
    "make": check_target,
    "python": check_module,
    "pip": check_extra,
    "blender": check_blender,
}


def test_files_of_the_project_that_are_named_are_there() -> None:
    for page in PAGES:
        for name in re.findall(r"`([\w*/]+\.py)[` ]", page.read_text(encoding="utf-8")):
            assert any(f"/{name}" in f"/{path}" for path in sources()) or list(ROOT.glob(f"**/{name}")), (page, name)


@cache
def sources() -> tuple[str, ...]:
    folders = ("wrinkle_addon", "operators", "kernels", "demo", "tests", "tools", "benchmarks")
    return tuple(str(path.relative_to(ROOT)) for folder in folders for path in (ROOT / folder).rglob("*.py"))
