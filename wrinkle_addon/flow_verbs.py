"""What can be told of a wrinkle flow without a scene."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from .flow_file import Flow, read_flow
from .pc2 import HEADER


def info(options: argparse.Namespace) -> Mapping[str, Any]:
    """What a flow holds, weighs and promises."""
    flow = read_flow(options.flow)
    return {**describe(flow), "text": "\n".join(_lines(flow))}


def verify(options: argparse.Namespace) -> Mapping[str, Any]:
    """That a flow is whole and undamaged: it is decoded, and its hash compared."""
    flow = read_flow(options.flow)
    return {"ok": True, **describe(flow), "text": f"{options.flow} is complete and undamaged."}


def describe(flow: Flow) -> dict[str, Any]:
    """What there is to say of a flow."""
    header = flow.header
    as_cache = HEADER.size + 12 * flow.vertex_count * flow.frame_count
    return {
        "garment": header.garment,
        "vertices": flow.vertex_count,
        "first_frame": header.start,
        "frames": flow.frame_count,
        "components": flow.component_count,
        "bones": list(flow.rig.names),
        "skinning": header.skinning.value,
        "space": header.space.value,
        "rms_mm": header.rms_mm,
        "max_mm": header.max_mm,
        "bytes": flow.stored_bytes,
        "pc2_bytes": as_cache,
        "times_smaller_than_pc2": round(as_cache / max(flow.stored_bytes, 1), 2),
        "bytes_read_a_frame": flow.shapes.nbytes,
        **{name: value for name, value in header.about.items() if name in ("recording", "weights")},
    }


def _lines(flow: Flow) -> list[str]:
    told = describe(flow)
    last = told["first_frame"] + told["frames"] - 1
    return [
        f"{told['garment']}: {told['vertices']} vertices, frames {told['first_frame']:g} to {last:g}, "
        f"{told['components']} components",
        f"  {told['bytes'] / 1e6:.3g} MB, {told['times_smaller_than_pc2']:g} times smaller than a PC2 cache",
        f"  error at most {told['rms_mm']:g} mm RMS, {told['max_mm']:g} mm of any vertex",
        f"  {told['skinning'].replace('_', ' ')} skinning by {len(told['bones'])} bones, residuals seen from "
        f"{'the bones' if told['space'] == 'bones' else 'the posed garment'}",
        "  It replays what was recorded; it does not react to other motion.",
    ]
