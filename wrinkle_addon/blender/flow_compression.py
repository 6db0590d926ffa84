"""Compressing a garment's recording in the open scene, step by step."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..flow_compress import Compressed, Goal, compress
from ..flow_file import SUFFIX, write_flow
from ..steps import Steps, beside, portion
from .files import check_output
from .flow_recording import RecordingChoice, read_source
from .handlers import suspended

READING = 0.3
"""Share of the time that reading is taken to need."""


def compression(garment: bpy.types.Object, choice: RecordingChoice, goal: Goal, out: Path) -> Steps[Compressed]:
    """Read a recording frame by frame, compress it beside the window's own thread, and write the flow.

    The file is there when the last step is done, or not at all. Nothing is played meanwhile.

    Raises:
        ValueError: One sentence, if the recording cannot be read or compressed, or the file not be written; what is
            known at once is said at once.
    """
    check_output(out, SUFFIX)
    if garment.data.is_editmode:
        raise ValueError("Leave edit mode first: what is edited cannot be recorded.")
    return _compression(garment, choice, goal, out)


def _compression(garment: bpy.types.Object, choice: RecordingChoice, goal: Goal, out: Path) -> Steps[Compressed]:
    with suspended():
        source = yield from portion(read_source(garment, choice), 0.0, READING)
        work = beside(lambda tell: compress(source, goal, curve=True, progress=tell))
        made = yield from portion(work, READING, 1.0)
        write_flow(out, made.header, made.rig, made.code)
    return made
