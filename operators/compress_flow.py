"""A garment's recorded animation into a small file, and back onto the garment."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..wrinkle_addon.blender import playback
from ..wrinkle_addon.blender.file_process import COMPRESS, FileProcess
from ..wrinkle_addon.blender.files import check_output
from ..wrinkle_addon.blender.flow_compression import check_recorded, compress_garment
from ..wrinkle_addon.blender.flow_recording import SCENE, RecordingChoice
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.flow_compress import Goal
from ..wrinkle_addon.flow_file import SUFFIX
from .behind_window import BehindWindow
from .polls import has_garment, is_idle


class WRINKLE_OT_compress_flow(BehindWindow, bpy.types.Operator):
    """Compress a recorded animation of the garment, and replay it from now on"""

    bl_idname = "wrinkle.compress_flow"
    bl_label = "Compress Recording"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    stopping = "Compressing stopped; no file was written."

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
        description="What decides the size of the file",
        items=[
            ("RMS", "Error", "Smallest file whose root mean square error keeps to a bound"),
            ("MAX", "Largest Error", "Smallest file in which no vertex goes beyond an error"),
            ("COMPONENTS", "Components", "A number of principal components"),
            ("SIZE", "Size", "Least error for a file size"),
        ],
    )
    error: bpy.props.FloatProperty(name="Error", default=0.5, min=0.001, description="Bound that is kept to, mm")
    components: bpy.props.IntProperty(
        name="Components", default=30, min=1, description="Shapes that every frame is mixed of"
    )
    size: bpy.props.IntProperty(name="Size", default=1000, min=1, description="Kilobytes")
    weights: bpy.props.EnumProperty(
        name="Weights",
        description="By which the bones carry the garment; what they leave over is what is compressed",
        items=[
            ("own", "Own", "The garment's own vertex groups"),
            ("nearest", "Nearest Vertex", "Of the nearest body vertices, as in the paper"),
            ("surface", "Nearest Surface", "Of the nearest points of the body, smoothed"),
            ("fit", "Fitted", "Those that explain the recording best"),
        ],
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_garment(cls, context) and is_idle(cls)

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
        """Behind the window; to the end where there is none."""
        garment = active_garment(context)
        assert garment is not None
        try:
            out = self._out = Path(bpy.path.abspath(self.filepath))
            check_output(out, SUFFIX)
            check_recorded(garment)
            if not bpy.app.background:
                return self.start(
                    context, garment, FileProcess(garment, COMPRESS, self._arguments(context), doing="Compressing")
                )
            made = compress_garment(garment, self._choice(context), self._goal(), out, lambda share, text: None)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self._replay(garment, made.rms_mm, [made.note] if made.note else [])

    def done(self, context: bpy.types.Context, garment: bpy.types.Object, process: FileProcess) -> set[str]:
        return self._replay(garment, process.result["measured_rms_mm"], process.result["notes"])

    def _replay(self, garment: bpy.types.Object, rms_mm: float, notes: list[str]) -> set[str]:
        """Show what was compressed."""
        out = self._out
        playback.forget(garment)
        garment.wrinkles.flow.path = bpy.path.relpath(str(out)) if bpy.data.filepath else str(out)
        garment.wrinkles.flow.replays = True
        garment.wrinkles.enabled = True
        self.report({"INFO"}, f"{out.stat().st_size / 1e6:.3g} MB written to {out}, error {rms_mm:.3g} mm.")
        for note in notes:
            self.report({"WARNING"}, note)
        return {"FINISHED"}

    def _arguments(self, context: bpy.types.Context) -> list[str]:
        """What :meth:`execute` does, for the command line."""
        choice = self._choice(context)
        goal = {
            "RMS": f"--error={self.error}",
            "MAX": f"--max-error={self.error}",
            "COMPONENTS": f"--components={self.components}",
            "SIZE": f"--size={1000 * self.size}",
        }[self.goal]
        frames = f"--frames={choice.frames.start}:{choice.frames.stop - 1}"
        recording = f"--recording={choice.recording}"
        return [recording, frames, goal, f"--weights={choice.weights}", f"--out={self._out}"]

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
