"""The command line: `wrinkle VERB ...`, or `blender --background FILE --command wrinkle VERB ...`.

Parses, dispatches, prints and decides the exit code; what opens scenes lies in :mod:`.blender.verbs`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

SUCCESS, FAILURE, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

Verb = Callable[[argparse.Namespace], Mapping[str, Any]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code (0 success, 1 failure, 2 bad input, 130 interrupted)."""
    parser = build_parser()
    try:
        options = parser.parse_args(sys.argv[1:] if arguments is None else list(arguments))
    except SystemExit as stop:
        return int(stop.code or 0)
    try:
        result = options.run(options)
    except KeyboardInterrupt:
        return _fail(options, "Interrupted.", INTERRUPTED)
    except ValueError as error:
        return _fail(options, str(error), BAD_INPUT)
    except Exception as error:
        traceback.print_exc()
        return _fail(options, f"{type(error).__name__}: {error}", FAILURE)
    if options.json:
        print(json.dumps(result, allow_nan=False), flush=True)
    elif "text" in result:
        print(result["text"], flush=True)
    return int(result.get("exit_code", SUCCESS))


def console() -> None:
    """Entry point of the console script."""
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    # Some builds of the bpy module hang when the interpreter takes them down.
    os._exit(code)


def _fail(options: argparse.Namespace, message: str, code: int) -> int:
    if getattr(options, "progress", "text") == "json":
        print(json.dumps({"event": "error", "message": message}), file=sys.stderr, flush=True)
    else:
        print(f"wrinkle: {message}", file=sys.stderr, flush=True)
    if options.json:
        print(json.dumps({"error": message}), flush=True)
    return code


def _bpy_verb(name: str) -> Verb:
    """A verb of :mod:`.blender.verbs`, imported only when it is run."""

    def run(options: argparse.Namespace) -> Mapping[str, Any]:
        from .blender import verbs

        return verbs.run(name, options)

    return run


def _folder_verb(name: str) -> Verb:
    """A verb of :mod:`.folder_verbs`, which needs no Blender."""

    def run(options: argparse.Namespace) -> Mapping[str, Any]:
        from . import folder_verbs

        return getattr(folder_verbs, name)(options)

    return run


def _demo(options: argparse.Namespace) -> Mapping[str, Any]:
    from ..demo.run import run_demo

    return run_demo(options.out, quick=options.quick)


def build_parser() -> argparse.ArgumentParser:
    """Every verb with its options."""
    parser = argparse.ArgumentParser(prog="wrinkle", description="Clothes that wrinkle with every pose.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def add(name: str, run: Verb, text: str, *, file: bool = False, garment: bool = False) -> argparse.ArgumentParser:
        verb = verbs.add_parser(name, help=text, description=text)
        verb.add_argument("--json", action="store_true", help="print one JSON object last on stdout")
        if file:
            verb.add_argument("file", nargs="?", type=Path, help="the .blend file; inside Blender, the open one")
        if garment:
            verb.add_argument("--garment", help="garment object; left out, the only one that was set up")
            verb.add_argument("--database", type=Path, help="database folder; left out, the one stored in the file")
        verb.set_defaults(run=run)
        return verb

    def add_device(verb: argparse.ArgumentParser) -> None:
        verb.add_argument("--device", default="auto", help="Warp device: auto, cpu, cuda:0")

    def add_frames(verb: argparse.ArgumentParser) -> None:
        verb.add_argument("--frames", help="FIRST:LAST or FIRST:LAST:STEP; left out, the scene's range")

    demo = add("demo", _demo, "the main job on a real human body: bake, play a clip, pictures, film, report")
    demo.add_argument("--out", type=Path, default=Path("demo-out"), help="folder for the results")
    demo.add_argument("--quick", action="store_true", help="at most 6 samples at 4,000 vertices")

    setup = add("setup", _bpy_verb("setup"), "make a garment ready: weights, joints, settings", file=True)
    setup.add_argument("--garment", required=True)
    setup.add_argument("--body", required=True)
    setup.add_argument("--armature", help="left out, the one that moves the body")
    setup.add_argument("--subdivide", type=int, help="levels; left out, until at least 10,000 vertices")
    setup.add_argument("--ranges", metavar="FIRST:LAST", help="take joint ranges from these frames of the animation")
    setup.add_argument("--margin", type=float, default=5.0, help="degrees added to ranges taken from the animation")
    setup.add_argument("--joints", help="joints to sample, separated by commas; left out, all that move the garment")
    setup.add_argument("--samples", type=int, help="most samples to simulate; left out, the paper's full plan")
    setup.add_argument("--quick", action="store_true", help="the quick plan: at most 36 simulated samples")
    setup.add_argument("--ease", metavar="GIRTH,LENGTH", help="extra cloth in percent, such as 3,4")
    setup.add_argument("--pins", help="vertex group of the garment that is held to the skin")
    setup.add_argument("--out", type=Path, required=True, help="the .blend file to write")

    joints = add("joints", _bpy_verb("joints"), "the joints found in a .blend, .glb, .fbx or .bvh file", file=True)
    joints.add_argument("--armature")

    animate = add("animate", _bpy_verb("animate"), "play a BVH clip on the character", file=True)
    animate.add_argument("--armature")
    animate.add_argument("--motion", type=Path, required=True)
    animate.add_argument("--out", type=Path, required=True)

    add("check", _bpy_verb("check"), "what would go wrong, before it does", file=True, garment=True)
    add("plan", _bpy_verb("plan"), "samples, bytes and expected time", file=True, garment=True)

    bake = add("bake", _bpy_verb("bake"), "bake, or go on baking", file=True, garment=True)
    bake.add_argument("--shard", help="I/N: only the I-th of N parts, I from 0 to N-1")
    bake.add_argument("--workers", type=int, default=1, help="processes that share the bake on this machine")
    bake.add_argument("--progress", choices=("text", "json"), default="text")
    add_device(bake)

    synthesize = add("synthesize", _bpy_verb("synthesize"), "play the method into a PC2 point cache", file=True, garment=True)
    synthesize.add_argument("--out", type=Path, required=True)
    synthesize.add_argument("--formulation", choices=("offsets", "paper", "nearest"), help="left out, the stored one")
    add_frames(synthesize)
    add_device(synthesize)

    simulate = add("simulate", _bpy_verb("simulate"), "simulate the clip into a PC2 point cache", file=True, garment=True)
    simulate.add_argument("--fine", action="store_true", help="the full simulation of the garment itself")
    simulate.add_argument("--substeps", type=int, default=4, help="steps a frame")
    simulate.add_argument("--pre-roll", type=float, default=0.3, help="seconds in the first pose before the clip")
    simulate.add_argument("--out", type=Path, required=True)
    add_frames(simulate)
    add_device(simulate)

    evaluate = add("evaluate", _bpy_verb("evaluate"), "errors against a reference", file=True, garment=True)
    evaluate.add_argument("--reference", default="settle", help="settle, simulate, or a CACHE.pc2 of the garment")
    evaluate.add_argument("--plots", type=Path, help="folder for plots")
    add_frames(evaluate)
    add_device(evaluate)

    for name, text in (
        ("merge", "write the manifest of a database whose samples were baked in shards"),
        ("verify", "what is missing or damaged in a database"),
        ("info", "what a database holds"),
    ):
        verb = add(name, _folder_verb(name), text)
        verb.add_argument("folder", type=Path, nargs="?", help="the database folder")
        verb.add_argument("--database", type=Path, help="the same, as an option")

    doctor = add("doctor", _folder_verb("doctor"), "versions, devices, what works here")
    add_device(doctor)
    return parser


if __name__ == "__main__":
    console()
