"""The command line: `wrinkle VERB ...`, or `blender --background FILE --command wrinkle VERB ...`.

Dispatches, prints and decides the exit code. Options lie in :mod:`.cli_parser`, verbs that open scenes in
:mod:`.blender.verbs`, the others in :mod:`.folder_verbs` and :mod:`.machine_verbs`.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from .cli_parser import build_parser

SUCCESS, FAILURE, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

FOLDER_VERBS, MACHINE_VERBS = ("merge", "verify", "info"), ("doctor", "kernels")
"""Verbs that need no Blender."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code (0 success, 1 failure, 2 bad input, 130 interrupted)."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    as_json = "--json" in arguments
    events = "--progress=json" in arguments or {"--progress", "json"} <= set(arguments)
    try:
        with _interruptible():
            options = build_parser().parse_args(arguments)
            _start_warp()
            result = run(options)
            if as_json:
                _flush_beneath()
                print(json.dumps(_for_machines(result), allow_nan=False), flush=True)
            elif "text" in result:
                print(result["text"], flush=True)
    except SystemExit as stop:
        # Help was asked for.
        return int(stop.code or SUCCESS)
    except KeyboardInterrupt:
        code, message = INTERRUPTED, "Interrupted."
    except ValueError as error:
        code, message = BAD_INPUT, str(error)
    except Exception as error:
        traceback.print_exc()
        code, message = FAILURE, f"{type(error).__name__}: {error}"
    else:
        return int(result.get("exit_code", SUCCESS))
    print(json.dumps({"event": "error", "message": message}) if events else f"wrinkle: {message}", file=sys.stderr)
    if as_json:
        _flush_beneath()
        print(json.dumps({"error": message}))
    sys.stdout.flush()
    sys.stderr.flush()
    return code


def run(options: argparse.Namespace) -> Mapping[str, Any]:
    """Run the verb that was parsed; what it needs is imported only now."""
    if options.verb == "demo":
        try:
            from ..demo.recipe import FULL, QUICK, WHOLE
            from ..demo.run import run_demo
        except ModuleNotFoundError as error:
            raise ValueError(
                f"The demo needs {error.name}, which is not here; run `make demo` in a clone of the project."
            ) from error
        return run_demo(options.out, WHOLE[options.whole] if options.whole else QUICK if options.quick else FULL)
    if options.verb in FOLDER_VERBS:
        from . import folder_verbs

        return getattr(folder_verbs, options.verb)(options)
    if options.verb in MACHINE_VERBS:
        from . import machine_verbs

        return getattr(machine_verbs, options.verb)(options)
    if options.verb == "flow" and (options.action == "info" or (options.action == "verify" and options.file is None)):
        from . import flow_verbs

        return getattr(flow_verbs, options.action)(options)
    from .blender import verbs

    return verbs.run(options.verb, options)


def _start_warp() -> None:
    """Start Warp without its greeting, nor its warning where there is no CUDA: the verb `doctor` lists the devices."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    # The warning is printed by the library below Python.
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        wp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


def _flush_beneath() -> None:
    """Let what Blender itself has printed come out, which may else do so after our last word."""
    ctypes.CDLL("ucrtbase" if os.name == "nt" else None).fflush(None)


def _for_machines(result: Mapping[str, Any]) -> dict[str, Any]:
    """A verb's result without what is for people and for the shell."""
    return {name: value for name, value in result.items() if name not in ("text", "exit_code")}


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let Ctrl-C and a request to end come as KeyboardInterrupt; Blender has a use of its own for the first."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.default_int_handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def console() -> None:
    """Entry point of the console script."""
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    # Some builds of the bpy module hang when the interpreter takes them down.
    os._exit(code)


if __name__ == "__main__":
    console()
