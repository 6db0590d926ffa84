"""The documents tell what there is: commands parse, verbs are told of, messages and names are the source's."""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest
from documents import PAGES, ROOT, Command, commands, messages
from wrinkle_synthesis.wrinkle_addon.cli_parser import build_parser

TROUBLESHOOTING, PANEL = ROOT / "docs" / "troubleshooting.md", ROOT / "docs" / "panel.md"
SOURCES = ("operators", "wrinkle_addon")
FIELD = "\N{NULL}"
"""Stands for a value in what an f-string says."""
LEFT_OUT = "\N{HORIZONTAL ELLIPSIS}"
"""Stands for one in the documents."""


@pytest.mark.parametrize("command", list(commands()), ids=str)
def test_every_command_parses(command: Command):
    build_parser().parse_args(command.arguments)


def test_there_is_a_command_for_every_verb_that_a_user_runs():
    told = {command.arguments[0] for command in commands()}
    assert {*verbs(build_parser())} <= told
    flow = {command.arguments[1] for command in commands() if command.arguments[0] == "flow"}
    assert {*verbs(verbs(build_parser())["flow"])} <= flow


def test_options_that_are_mentioned_exist():
    options = set(options_of(build_parser()))
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        mentioned = set(re.findall(r"`(?:\w+ )*(--[a-z][a-z-]*)[^`]*`", text))
        assert mentioned - BLENDERS <= options, page.name


BLENDERS = {"--background", "--command", "--enable-autoexec"}
"""Options of Blender's own, which the pages name."""


@pytest.mark.parametrize("message", messages(TROUBLESHOOTING))
def test_every_message_is_one_of_the_sources(message: str):
    parts = [part for part in message.split(LEFT_OUT) if part.strip(" '")]
    pattern = re.compile(".*".join(re.escape(part) for part in parts), re.DOTALL)
    assert any(pattern.search(said) for said in sentences()), message


def test_every_name_of_the_panel_is_the_sources():
    """Bold is what stands on a button, beside a setting or over a panel."""
    names = set(re.findall(r"\*\*([^*]+)\*\*", PANEL.read_text(encoding="utf-8")))
    assert names <= {*sentences(), "Wrinkle"}


def test_pages_speak_of_the_project_alone():
    for page in PAGES:
        # Folders in examples are a farm's own.
        assert not re.search(r"/(root|tmp|home|work)/", page.read_text(encoding="utf-8")), page.name


def verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers below a parser, by their verbs."""
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {name: verb for action in actions for name, verb in action.choices.items()}


def options_of(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Every option of a parser and of those below it."""
    for action in parser._actions:
        yield from action.option_strings
    for verb in verbs(parser).values():
        yield from options_of(verb)


@cache
def sentences() -> tuple[str, ...]:
    """Every string in the source, values left open."""
    return tuple(
        said
        for folder in SOURCES
        for path in sorted((ROOT / folder).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if (said := spoken(node))
    )


def spoken(node: ast.AST) -> str:
    """A string or f-string of the source; empty for anything else."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(spoken(part) or FIELD for part in node.values)
    return ""
