"""A garment's recorded animation into a small file, and back onto the garment."""

from __future__ import annotations

import time
from pathlib import Path

import bpy

from ..wrinkle_addon.blender import playback
from ..wrinkle_addon.blender.flow_compression import compression
from ..wrinkle_addon.blender.flow_recording import SCENE, RecordingChoice
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.flow_compress import Compressed, Goal
from ..wrinkle_addon.flow_file import SUFFIX
from ..wrinkle_addon.steps import describe_left, finish


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
        """Step by step in the window, until it is done or Esc is pressed; to the end where there is none."""
        garment = active_garment(context)
        assert garment is not None
        try:
            out = Path(bpy.path.abspath(self.filepath))
            steps = compression(garment, self._choice(context), self._goal(), out)
            if bpy.app.background:
                return self._finish(garment, out, finish(steps, lambda share, text: None))
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._steps, self._out, self._garment = steps, out, garment.session_uid
        self._began = time.monotonic()
        self._timer = context.window_manager.event_timer_add(0.0, window=context.window)
        context.window_manager.progress_begin(0.0, 1.0)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC":
            self.cancel(context)
            self.report({"INFO"}, "Compressing stopped; no file was written.")
            return {"CANCELLED"}
        # Until it is done the scene's frames are gone through, so that nothing else may happen.
        if event.type != "TIMER":
            return {"RUNNING_MODAL"}
        try:
            share, text = next(self._steps)
        except StopIteration as end:
            self.cancel(context)
            garment = next((ob for ob in bpy.data.objects if ob.session_uid == self._garment), None)
            return {"FINISHED"} if garment is None else self._finish(garment, self._out, end.value)
        except ValueError as error:
            self.cancel(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        left = describe_left(share, time.monotonic() - self._began)
        context.workspace.status_text_set(f"Compressing the recording: {100 * share:.0f} %, {text}{left}. Esc stops.")
        context.window_manager.progress_update(share)
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Leave nothing running and nothing behind; also called when another file is opened."""
        self._steps.close()
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def _finish(self, garment: bpy.types.Object, out: Path, made: Compressed) -> set[str]:
        """Show what was compressed."""
        playback.forget(garment)
        garment.wrinkles.flow.path = bpy.path.relpath(str(out)) if bpy.data.filepath else str(out)
        garment.wrinkles.flow.replays = True
        garment.wrinkles.enabled = True
        self.report({"INFO"}, f"{out.stat().st_size / 1e6:.3g} MB written to {out}, error {made.rms_mm:.3g} mm.")
        if made.note:
            self.report({"WARNING"}, made.note)
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
