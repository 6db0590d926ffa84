"""What a garment remembers of its wrinkle flow."""

from __future__ import annotations

import bpy

from ..flow import Ends
from . import playback
from .flow_playback import FlowFile

_OVERRIDABLE = {"LIBRARY_OVERRIDABLE"}


def _played_anew(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    garment = settings.id_data
    playback.doubt(garment)
    garment.update_tag()


class FlowSettings(bpy.types.PropertyGroup):
    """Which recording a garment replays, and when."""

    replays: bpy.props.BoolProperty(
        name="Replay Recording",
        default=False,
        description="Replay a recorded animation of the garment instead of playing its database",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    path: bpy.props.StringProperty(
        name="Flow",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        description="File of the compressed recording",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    offset: bpy.props.FloatProperty(
        name="Offset",
        default=0.0,
        options={"ANIMATABLE"},
        description="Frames by which the recording is shown later",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    speed: bpy.props.FloatProperty(
        name="Speed",
        default=1.0,
        options={"ANIMATABLE"},
        description="Recorded frames a frame; below 0 backwards",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    ends: bpy.props.EnumProperty(
        name="Beyond the Ends",
        description="What shows before the recording begins and after it has ended",
        items=[
            (Ends.HOLD.name, "Hold", "The first or last recorded wrinkles stay"),
            (Ends.LOOP.name, "Loop", "The recording starts again; its last frame is its first"),
        ],
        default=Ends.HOLD.name,
        override=_OVERRIDABLE,
        update=_played_anew,
    )

    clear_of_body: bpy.props.BoolProperty(
        name="Clear of Body",
        default=False,
        description="Push the replayed garment out of its body, by the clearance of the garment; else it is where it "
        "was recorded",
        override=_OVERRIDABLE,
        update=_played_anew,
    )

    def source(self) -> FlowFile | None:
        """What to replay; None if the garment plays its database.

        Raises:
            ValueError: If there is nothing to replay; one sentence.
        """
        return FlowFile.of(self.id_data) if self.replays else None


classes = (FlowSettings,)
