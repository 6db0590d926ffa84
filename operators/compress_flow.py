"""A garment's recorded animation into a small file, and back onto the garment."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..wrinkle_addon.blender.files import check_output
from ..wrinkle_addon.blender.flow_recording import SCENE, RecordingChoice, read_source
from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.flow_compress import Goal, compress
from ..wrinkle_addon.flow_file import SUFFIX, write_flow


class WRINKLE_OT_compress_flow(bpy.types.Operator):
    """Compress a recorded animation of the garment, and replay it from now on"""

    bl_idname = "wrinkle.compress_flow"
    bl_label = "Compress Recording"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", description="The .flow file to write")
    filter_glob: bpy.props.StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"})
    recording: bpy.props.StringProperty(
        name="Recording",
        description="A .pc2, .mdd, .abc or .usd file, or a folder of numbered .npy or .obj files; left out, the "
        "garment in the scene as its modifiers show it",
    )
    frame_start: bpy.props.IntProperty(name="From", description="First frame, of the scene's garment")
    frame_end: bpy.props.IntProperty(name="To", description="Last frame, of the scene's garment")
    goal: bpy.props.EnumProperty(
        name="Goal",
        items=[
            ("RMS", "Error", "Smallest file whose root mean square error keeps to a bound"),
            ("MAX", "Largest Error", "Smallest file in which no vertex goes beyond an error"),
            ("COMPONENTS", "Components", "A number of principal components"),
            ("SIZE", "Size", "Least error for a file size"),
        ],
    )
    error: bpy.props.FloatProperty(name="Error", default=0.5, min=0.001, description="Millimetres")
    components: bpy.props.IntProperty(name="Components", default=30, min=1)
    size: bpy.props.IntProperty(name="Size", default=1000, min=1, description="Kilobytes")
    weights: bpy.props.EnumProperty(
        name="Weights",
        items=[
            ("own", "Own", "The garment's own vertex groups"),
            ("nearest", "Nearest Vertex", "Of the nearest body vertices, as in the paper"),
            ("surface", "Nearest Surface", "Of the nearest points of the body, smoothed"),
            ("fit", "Fitted", "Those that explain the recording best"),
        ],
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_garment(context) is not None

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        if not self.properties.is_property_set("frame_start"):
            self.frame_start, self.frame_end = context.scene.frame_start, context.scene.frame_end
        if not self.filepath:
            self.filepath = bpy.path.abspath(f"//{bpy.path.clean_name(garment.name)}{SUFFIX}")
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        manager = context.window_manager
        manager.progress_begin(0.0, 1.0)
        try:
            out = Path(bpy.path.abspath(self.filepath))
            check_output(out, SUFFIX)
            if garment.data.is_editmode:
                raise ValueError("Leave edit mode first: what is edited cannot be recorded.")
            with suspended():
                source = read_source(
                    garment, self._choice(context), lambda share, text: manager.progress_update(0.2 * share)
                )
                made = compress(
                    source, self._goal(), progress=lambda share, text: manager.progress_update(0.2 + 0.8 * share)
                )
            size = write_flow(out, made.header, made.rig, made.code)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            manager.progress_end()
        garment.wrinkles.flow.path = bpy.path.relpath(str(out)) if bpy.data.filepath else str(out)
        garment.wrinkles.flow.replays = True
        garment.wrinkles.enabled = True
        self.report({"INFO"}, f"{size / 1e6:.3g} MB written to {out}, error {made.rms_mm:.3g} mm.")
        return {"FINISHED"}

    def _choice(self, context: bpy.types.Context) -> RecordingChoice:
        first, last = self.frame_start, self.frame_end
        if not self.properties.is_property_set("frame_start"):
            first, last = context.scene.frame_start, context.scene.frame_end
        if last < first:
            raise ValueError("The frame range is empty; give a first frame that is not after the last.")
        recording = bpy.path.abspath(self.recording) if self.recording else SCENE
        return RecordingChoice(recording, range(first, last + 1), weights=self.weights)

    def _goal(self) -> Goal:
        return {
            "RMS": Goal(rms_mm=self.error),
            "MAX": Goal(max_mm=self.error),
            "COMPONENTS": Goal(components=self.components),
            "SIZE": Goal(size=1000 * self.size),
        }[self.goal]


classes = (WRINKLE_OT_compress_flow,)
