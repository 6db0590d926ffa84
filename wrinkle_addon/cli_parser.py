"""Every verb of the command line with its options."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from .fabrics import FABRICS

AddVerb = Callable[..., "Parser"]


class UsageError(ValueError):
    """A command line that names no verb, or a verb's options wrongly."""


class Parser(argparse.ArgumentParser):
    """A parser that says what is wrong in one sentence."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message[:1].upper()}{message[1:]}; see '{self.prog} --help'.")


def build_parser() -> Parser:
    """The parser; the verb's name comes out as the option "verb".

    Parsing raises :class:`UsageError` with one sentence.
    """
    parser = Parser(prog="wrinkle", description="Clothes that wrinkle with every pose.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def add(name: str, text: str, *shared: Parser) -> Parser:
        verb = verbs.add_parser(name, help=text, description=text, parents=shared)
        verb.add_argument("--json", action="store_true", help="print one JSON object last on stdout")
        return verb

    demo = add("demo", "the main job on a real human body: bake, play a clip, pictures, film, report")
    demo.add_argument("--out", type=Path, default=Path("demo-out"), help="folder for the results")
    size = demo.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="at most 6 samples at 4,000 vertices")
    size.add_argument("--whole", choices=("shirt", "trousers"), help="the paper's whole plan for this garment; an hour")
    _add_character_verbs(add)
    _add_bake_verbs(add)
    _add_clip_verbs(add)
    _add_folder_verbs(add)
    _add_flow_verbs(add)
    doctor = add("doctor", "versions, devices, what works here", _device())
    doctor.add_argument("--self-test", action="store_true", help="also bake and play a small sleeve")
    kernels = add("kernels", "compile all kernels now, which else happens on their first use", _device())
    kernels.add_argument("--progress", choices=("text", "json"), default="text")
    return parser


# --- the verbs ----------------------------------------------------------------------------------------------------


def _add_character_verbs(add: AddVerb) -> None:
    setup = add("setup", "make a garment ready: weights, joints, settings", _file(), _plan(), _ranges())
    setup.add_argument("--garment", required=True)
    setup.add_argument("--body", required=True)
    setup.add_argument("--armature", help="left out, the one that moves the body")
    setup.add_argument("--subdivide", type=int, help="levels; left out, until at least 10,000 vertices")
    setup.add_argument("--joints", help="joints to sample, separated by commas; left out, all that move the garment")
    setup.add_argument("--ease", metavar="GIRTH,LENGTH", help="extra cloth in percent, such as 3,4")
    setup.add_argument("--fabric", metavar="NAME", help=f"what it is made of: {', '.join(FABRICS)}")
    setup.add_argument("--pins", help="vertex group of the garment that is held to the skin")
    setup.add_argument(
        "--coarse", metavar="OBJECT|simulate:OBJECT|make[:COUNT]",
        help="let the garment follow this mesh, a simulation of it, or one of a coarse mesh made now, of 700 vertices",
    )  # fmt: skip
    setup.add_argument("--out", type=Path, required=True, help="the .blend file to write")

    joints = add(
        "joints",
        "the joints found in a .blend, .glb, .fbx or .bvh file; with --garment or a change, those of a garment",
        _file(),
        _ranges(),
    )
    joints.add_argument("--armature", help="left out, the only one")
    joints.add_argument("--garment", help="a garment that was set up; left out with a change, the only one")
    joints.add_argument(
        "--add", action="append", default=[], metavar="NAME[=BONE,...]",
        help="add a ball joint, or give one other bones; a wrist_L, an ankle_R or the neck finds its bones itself",
    )  # fmt: skip
    joints.add_argument(
        "--add-hinge", action="append", default=[], metavar="NAME[=BONE,...]", help="the same for a hinge"
    )
    joints.add_argument("--remove", action="append", default=[], metavar="NAME")
    joints.add_argument(
        "--range", action="append", default=[], metavar="NAME=LOW:HIGH[,LOW:HIGH,LOW:HIGH]",
        help="degrees from the rest pose; a ball has twist and two swings",
    )  # fmt: skip
    joints.add_argument("--sample", metavar="NAME,...", help="sample these joints and no others")
    joints.add_argument("--out", type=Path, help="the .blend file to write the changes to")

    animate = add("animate", "play a BVH clip on the character", _file())
    animate.add_argument("--armature", help="left out, the only one")
    animate.add_argument("--motion", type=Path, required=True, help="the .bvh file")
    animate.add_argument("--out", type=Path, required=True, help="the .blend file to write")


def _add_bake_verbs(add: AddVerb) -> None:
    add("check", "what would go wrong, before it does", _file(), _garment())

    plan = add("plan", "samples, bytes and expected time; of another plan on request", _file(), _garment(), _plan())
    plan.add_argument("--out", type=Path, help="the .blend file to write, with this plan chosen")

    bake = add("bake", "bake, or go on baking", _file(), _garment(), _device(), _told())
    bake.add_argument("--shard", metavar="I/N", help="only the I-th of N parts, I from 0 to N-1")
    bake.add_argument(
        "--batch", type=int, metavar="N", help="samples simulated side by side at most; left out, 1, on a GPU 16"
    )
    bake.add_argument("--workers", type=int, default=1, help="processes that share the bake on this machine")


def _add_clip_verbs(add: AddVerb) -> None:
    clip = (_file(), _garment(), _frames(), _device(), _told())

    synthesize = add("synthesize", "play the method into a point cache, an Alembic or a USD file", *clip)
    synthesize.add_argument("--formulation", choices=("offsets", "paper", "nearest"), help="left out, the stored one")
    _add_weights(synthesize)
    synthesize.add_argument(
        "--part",
        metavar="FIRST:LAST",
        help="only these of the frames; the run without it makes the rest and joins",
    )
    synthesize.add_argument(
        "--blend",
        type=Path,
        help="also write this .blend file, where a Mesh Cache modifier plays the .pc2 file",
    )
    synthesize.add_argument(
        "--out", type=Path, required=True, help="the .pc2, .abc, .usd, .usdc or .usda file to write"
    )

    simulate = add("simulate", "simulate the coarse layer over the clip into its cache, or the garment in full", *clip)
    simulate.add_argument("--fine", action="store_true", help="the full simulation, into a PC2 point cache")
    simulate.add_argument("--substeps", type=int, default=4, help="with --fine: steps a frame")
    simulate.add_argument(
        "--pre-roll", type=float, default=0.3, help="with --fine: seconds in the first pose before the clip"
    )
    simulate.add_argument("--out", type=Path, help="with --fine: the .pc2 file to write")

    evaluate = add("evaluate", "errors against a reference", *clip)
    evaluate.add_argument("--reference", default="settle", help="settle, simulate, or a CACHE.pc2 of the garment")
    evaluate.add_argument("--losses", action="store_true", help="with settle: tell which part of the method loses what")
    evaluate.add_argument("--plots", type=Path, help="folder for plots")
    evaluate.add_argument("--keep", action="store_true", help="leave the result beside the database, for the panel")
    _add_weights(evaluate)

    influence = add("influence", "how much each joint changes the wrinkles", _file(), _garment(), _device())
    influence.add_argument("--joints", metavar="NAME,...", help="these joints; left out, all that were sampled")
    influence.add_argument("--plots", type=Path, help="folder for plots beside the weights by distance")
    influence.add_argument("--out", type=Path, help="the .blend file to write, with the garment coloured")


def _add_weights(verb: Parser) -> None:
    verb.add_argument(
        "--weights", choices=("distance", "measured"), help="by which joints meet; left out, those stored"
    )


def _add_folder_verbs(add: AddVerb) -> None:
    for name, text in (
        ("merge", "write the manifest of a database whose samples were baked in shards"),
        ("verify", "what is missing or damaged in a database"),
        ("info", "what a database holds"),
    ):
        verb = add(name, text)
        verb.add_argument("folder", type=Path, nargs="?", help="the database folder")
        verb.add_argument("--database", type=Path, help="the same, as an option")


def _add_flow_verbs(add: AddVerb) -> None:
    flow = add("flow", "a recorded animation of a garment, made small and replayed")
    actions = flow.add_subparsers(dest="action", required=True, metavar="ACTION")

    def action(name: str, text: str, *shared: Parser) -> Parser:
        parser = actions.add_parser(name, help=text, description=text, parents=shared)
        parser.add_argument("--json", action="store_true", help="print one JSON object last on stdout")
        return parser

    def add_recording(parser: Parser) -> None:
        parser.add_argument(
            "--recording",
            metavar="scene|FILE|FOLDER",
            help="a .pc2, .mdd, .abc or .usd file, numbered .npy or .obj files, or the scene's garment",
        )

    compress = action("compress", "compress a recording", _file(), _worn(), _frames(), _told())
    add_recording(compress)
    compress.add_argument("--start", type=float, help="scene frame of a file's first sample; left out, as it says")
    goal = compress.add_mutually_exclusive_group()
    goal.add_argument("--error", type=float, metavar="MM", help="root mean square error to keep to; 0.5 if left out")
    goal.add_argument("--components", type=int, help="number of principal components")
    goal.add_argument("--size", type=int, metavar="BYTES", help="size to keep to")
    compress.add_argument("--max-error", type=float, metavar="MM", help="error that no vertex goes beyond in any frame")
    compress.add_argument("--weights", choices=("own", "nearest", "surface", "fit"), default="own")
    compress.add_argument("--skinning", choices=("linear", "dual_quaternion"), default="linear")
    compress.add_argument("--space", choices=("bones", "posed"), default="bones", help="whence residuals are seen")
    compress.add_argument("--plots", type=Path, help="folder for a plot of size against error")
    compress.add_argument("--blend", type=Path, help="also write this .blend file, where the garment replays the flow")
    compress.add_argument("--out", type=Path, required=True, help="the .flow file to write")

    play = action(
        "play", "replay a flow into a point cache, or in a .blend file", _file(), _worn(), _frames(), _device()
    )
    play.add_argument("--flow", type=Path, required=True, help="the .flow file")
    play.add_argument("--offset", type=float, default=0.0, help="frames by which it is shown later")
    play.add_argument("--speed", type=float, default=1.0, help="recorded frames a frame; below 0 backwards")
    play.add_argument("--ends", choices=("hold", "loop"), default="hold", help="what is shown beyond the recording")
    play.add_argument("--strength", type=float, default=1.0, help="0 is skinning alone, 1 as recorded")
    play.add_argument("--blend", type=Path, help="the .blend file to write, where the garment replays the flow")
    play.add_argument("--out", type=Path, help="the .pc2 file to write")

    action("info", "what a flow holds and promises").add_argument("flow", type=Path)
    verify = action("verify", "that a flow is undamaged; with a .blend file, that it keeps its promise", _worn())
    verify.add_argument("flow", type=Path)
    verify.add_argument("file", nargs="?", type=Path, help="the .blend file of the recording")
    add_recording(verify)


# --- options that verbs share -------------------------------------------------------------------------------------


def _shared() -> Parser:
    return Parser(add_help=False)


def _file() -> Parser:
    shared = _shared()
    shared.add_argument("file", nargs="?", type=Path, help="the .blend file; inside Blender, the open one")
    return shared


def _garment() -> Parser:
    shared = _shared()
    shared.add_argument("--garment", help="garment object; left out, the only one that was set up")
    shared.add_argument("--database", type=Path, help="database folder; left out, the one stored in the file")
    return shared


def _worn() -> Parser:
    shared = _shared()
    shared.add_argument("--garment", help="garment object; left out, the only one that was set up")
    shared.add_argument("--body", help="the mesh that it is worn on, if it was not set up")
    shared.add_argument("--armature", help="the rig that moves both, if it was not set up; left out, the only one")
    return shared


def _plan() -> Parser:
    shared = _shared()
    plan = shared.add_mutually_exclusive_group()
    plan.add_argument("--full", action="store_true", help="the paper's plan: hinges every 15 degrees, balls every 30")
    plan.add_argument("--quick", action="store_true", help="the quick plan: at most 36 simulated samples")
    plan.add_argument("--samples", type=int, help="the best plan with at most this many simulated samples")
    return shared


def _ranges() -> Parser:
    shared = _shared()
    shared.add_argument(
        "--ranges", metavar="FIRST:LAST|ACTION", help="take joint ranges from these frames, or from this action"
    )
    shared.add_argument("--margin", type=float, default=5.0, help="degrees added to ranges that are taken")
    return shared


def _frames() -> Parser:
    shared = _shared()
    shared.add_argument("--frames", help="FIRST:LAST or FIRST:LAST:STEP; left out, the scene's range")
    return shared


def _device() -> Parser:
    shared = _shared()
    shared.add_argument("--device", default="auto", help="Warp device: auto, cpu, cuda:0")
    return shared


def _told() -> Parser:
    shared = _shared()
    shared.add_argument("--progress", choices=("text", "json"), default="text")
    shared.add_argument(
        "--attended",
        action="store_true",
        help="end when standard input closes; a bake pauses and goes on as it says",
    )
    return shared
