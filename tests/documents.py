"""What the documents tell a reader to type: command lines, Python, messages."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`([^`]+)`")
DOOR = "--command wrinkle "
PROGRAMS = ("wrinkle", "make", "python", "pip", "blender", "git", "sh", "bash")
PLACEHOLDERS = ("FILE", "VERB", "\N{HORIZONTAL ELLIPSIS}")
"""Stand in a command for what a reader puts there."""


@dataclass(frozen=True)
class Command:
    """A command line of a page.

    Attributes:
        page: Its name.
        line: As it is printed there.
        arguments: What comes after "wrinkle"; a file that Blender opened before is put after the verb.
    """

    page: str
    line: str
    arguments: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page}: {self.line}"


def commands() -> Iterator[Command]:
    """Every fenced line that begins with ``wrinkle``, or comes in through Blender's own door."""
    for page in PAGES:
        for kind, block in fences(page):
            for line in block.splitlines() if not kind else ():
                if line.startswith("wrinkle "):
                    yield Command(page.name, line, tuple(shlex.split(line, comments=True)[1:]))
                elif line.startswith("blender ") and DOOR in line:
                    words = shlex.split(line, comments=True)
                    place = words.index("--command")
                    yield Command(page.name, line, (words[place + 2], words[2], *words[place + 3 :]))


def typed_lines() -> Iterator[tuple[str, str]]:
    """Page and line of all that a reader may type: every line of a fenced block without a language, and whatever in the
    text begins with a program's name, unless words are left out of it."""
    for page in PAGES:
        for kind, block in fences(page):
            yield from ((page.name, line) for line in block.splitlines() if line and not kind)
        for line in CODE.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
            words = line.split()
            if words[0] in PROGRAMS and len(words) > 1 and not set(words) & set(PLACEHOLDERS):
                yield page.name, line


def snippets() -> Iterator[tuple[str, str]]:
    """Page and text of every fenced piece of Python."""
    for page in PAGES:
        yield from ((page.name, block) for kind, block in fences(page) if kind == "python")


def fences(page: Path) -> list[tuple[str, str]]:
    """Language and text of a page's fenced blocks."""
    return FENCE.findall(page.read_text(encoding="utf-8"))


def messages(page: Path) -> list[str]:
    """What stands as code in the first column of a page's tables."""
    rows = [line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    return [found.group(1) for row in rows if (found := CODE.match(row, 2))]
