"""Compressing a garment's recording in the open scene."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..flow_compress import Compressed, Goal, compress
from ..flow_file import SUFFIX, write_flow
from ..flow_residuals import ResidualSpace, Skinning
from ..steps import Progress, finish
from .files import check_output
from .flow_recording import RecordingChoice, read_source
from .handlers import suspended
from .write import show_skinned

READING = 0.3
"""Share of the time that reading is taken to need."""


def compress_garment(
    garment: bpy.types.Object,
    choice: RecordingChoice,
    goal: Goal,
    out: Path,
    progress: Progress,
    *,
    skinning: Skinning = Skinning.LINEAR,
    space: ResidualSpace = ResidualSpace.BONES,
) -> Compressed:
    """Read a recording, compress it, and write the flow: whole, or not at all. Nothing is played meanwhile.

    Raises:
        ValueError: One sentence, if the recording cannot be read or compressed, or the file not be written.
    """
    check_output(out, SUFFIX)
    check_recorded(garment)
    with suspended():
        # In the frame that was played last it is shown as played.
        show_skinned(garment)
        source = finish(read_source(garment, choice), lambda share, text: progress(READING * share, text))
        made = compress(
            source,
            goal,
            skinning,
            space,
            curve=True,
            progress=lambda share, text: progress(READING + (1.0 - READING) * share, text),
        )
        write_flow(out, made.header, made.rig, made.code)
    garment.update_tag()
    return made


def check_recorded(garment: bpy.types.Object) -> None:
    """See before any work that a garment can be recorded.

    Raises:
        ValueError: If it is in edit mode; one sentence.
    """
    if garment.data.is_editmode:
        raise ValueError("Leave edit mode first: what is edited cannot be recorded.")
