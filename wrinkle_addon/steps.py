"""Long work in steps: it tells how far it is, whoever drives it may stop in between, and its result comes last."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeVar

Result = TypeVar("Result")

Progress = Callable[[float, str], None]
"""Told what share is done, and what is being done."""

Steps = Generator[tuple[float, str], None, Result]
"""What Progress is told, and the result."""


def finish(steps: Steps[Result], progress: Progress) -> Result:
    """Do all steps."""
    while True:
        try:
            share, text = next(steps)
        except StopIteration as end:
            return end.value
        progress(share, text)


def portion(steps: Steps[Result], start: float, end: float) -> Steps[Result]:
    """Steps as a part of something longer."""
    while True:
        try:
            share, text = next(steps)
        except StopIteration as ended:
            return ended.value
        yield start + (end - start) * share, text


def describe_left(share: float, passed: float) -> str:
    """How long it will take, after so many seconds; empty as long as that is no more than a guess."""
    if share <= 0.1 or passed <= 2.0:
        return ""
    left = passed * (1.0 - share) / share
    return f", about {left:.0f} s left" if left < 90.0 else f", about {left / 60.0:.0f} min left"
