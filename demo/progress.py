"""Progress of the demo: one line for each stage, with the time left of the whole."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import TextIO

LINE_WIDTH = 110
PLAIN_SECONDS = 15.0
RESUMED_SECONDS = 1.0
"""A stage that took less was done in an earlier run [s]."""


class Progress:
    """Tells how far the stages are, and keeps their times.

    The time left is that of the stage at work, by its own pace once it has one, and of the stages to come as expected,
    corrected by how the finished ones compare with what was expected of them.

    Args:
        expected: Seconds that each stage is expected to take, in order.
        stream: Where lines go; left out, standard error.

    Attributes:
        seconds: Time that each finished stage took [s].
    """

    def __init__(self, expected: Mapping[str, float], stream: TextIO | None = None):
        self._expected = dict(expected)
        self._stream = stream or sys.stderr
        self._stage = ""
        self._started = self._said = 0.0
        self.seconds: dict[str, float] = {}

    def begin(self, stage: str) -> None:
        self._stage, self._started, self._said = stage, time.perf_counter(), 0.0
        self.update(0.0)

    def update(self, share: float, note: str = "") -> None:
        """Say how much of the stage is done, from 0 to 1."""
        now = time.perf_counter()
        left = time_left(self._expected, self.seconds, self._stage, now - self._started, share)
        text = f"[{len(self.seconds) + 1}/{len(self._expected)}] {self._stage} {100 * share:3.0f} %"
        text += f"  {note}" if note else ""
        text += f"  about {duration(left)} left in all"
        if self._stream.isatty():
            print(f"\r{text[:LINE_WIDTH]:{LINE_WIDTH}}", end="", file=self._stream, flush=True)
        elif now - self._said > PLAIN_SECONDS:
            print(text, file=self._stream, flush=True)
            self._said = now

    def end(self, note: str = "") -> None:
        self.seconds[self._stage] = time.perf_counter() - self._started
        text = f"[{len(self.seconds)}/{len(self._expected)}] {self._stage}: {duration(self.seconds[self._stage])}"
        text += f", {note}" if note else ""
        # Over what stands in the line already.
        print(f"\r{text:{LINE_WIDTH}}" if self._stream.isatty() else text, file=self._stream, flush=True)


def time_left(
    expected: Mapping[str, float], finished: Mapping[str, float], stage: str, elapsed: float, share: float
) -> float:
    """Estimated time left [s].

    Args:
        expected: Seconds expected of each stage, in order.
        finished: Seconds that finished stages took.
        stage: The stage at work.
        elapsed: Seconds it has been at work.
        share: How much of it is done, from 0 to 1.
    """
    # Stages that an earlier run had done say nothing of the pace.
    worked = {name: seconds for name, seconds in finished.items() if seconds > RESUMED_SECONDS}
    pace = sum(worked.values()) / sum(expected[name] for name in worked) if worked else 1.0
    by_plan = max(pace * expected[stage] - elapsed, 0.0)
    by_pace = elapsed * (1.0 - share) / share if share > 0.0 else by_plan
    # A stage's own pace counts the more, the further it is.
    current = share * by_pace + (1.0 - share) * max(by_plan, min(by_pace, expected[stage] * pace))
    names = list(expected)
    return current + pace * sum(expected[name] for name in names[names.index(stage) + 1 :])


def duration(seconds: float) -> str:
    """As people say it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min"
