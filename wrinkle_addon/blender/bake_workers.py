"""A bake shared among processes of this machine: their reports as one, their end together."""

from __future__ import annotations

import json
import math
import queue
import subprocess
import threading
from collections.abc import Callable, Iterator, Sequence

from ..bake import BakeEvent


def run_workers(commands: Sequence[Sequence[str]], report: Callable[[BakeEvent], None]) -> None:
    """Run bakes at the same time, to the end; if one fails or this one is interrupted, all of them end.

    Args:
        commands: Command lines that bake with ``--progress json``.
        report: Gets every worker's samples, counted over all of them.

    Raises:
        ValueError: With the first failing worker's own sentence.
    """
    workers = [
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, encoding="utf-8", errors="replace")
        for command in commands
    ]
    try:
        _follow(workers, report)
    finally:
        for worker in workers:
            worker.terminate()
        for worker in workers:
            worker.wait()


def _follow(workers: Sequence[subprocess.Popen[str]], report: Callable[[BakeEvent], None]) -> None:
    done, total, remaining = ([0] * len(workers) for _ in range(3))
    errors: dict[int, str] = {}
    for number, line in _lines(workers):
        if line is None:
            if workers[number].wait():
                code = workers[number].returncode
                raise ValueError(errors.get(number, f"A baking process ended with code {code}; bake again to go on."))
            continue
        if not line.startswith("{"):
            continue
        event = json.loads(line)
        if event["event"] == "error":
            errors[number] = event["message"]
            continue
        done[number], total[number] = event["done"], event["total"]
        remaining[number] = event["remaining"] or 0
        left = float(max(remaining)) or math.nan
        report(BakeEvent(event["name"], sum(done), sum(total), event["seconds"], left, event["report"]))


def _lines(workers: Sequence[subprocess.Popen[str]]) -> Iterator[tuple[int, str | None]]:
    """Lines of all workers' standard error as they come, and None once at each one's end."""
    lines: queue.Queue[tuple[int, str | None]] = queue.Queue()

    def pump(number: int, worker: subprocess.Popen[str]) -> None:
        assert worker.stderr is not None
        for line in worker.stderr:
            lines.put((number, line))
        lines.put((number, None))

    for number, worker in enumerate(workers):
        threading.Thread(target=pump, args=(number, worker), daemon=True).start()
    ended = 0
    while ended < len(workers):
        number, line = lines.get()
        ended += line is None
        yield number, line
