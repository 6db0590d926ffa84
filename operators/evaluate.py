"""How far the played garment is from a simulated one, over some frames, as figures and pictures."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..wrinkle_addon.blender.evaluation_charts import draw_evaluation
from ..wrinkle_addon.blender.file_process import EVALUATE, FileProcess
from ..wrinkle_addon.blender.files import database_folder
from ..wrinkle_addon.blender.preferences import device_name
from ..wrinkle_addon.blender.properties import active_garment
from .behind_window import BehindWindow, work_through
from .polls import has_samples, is_idle

PROPOSED = 8
"""Frames that are compared where the artist chooses no other number: each takes about as long as a sample."""


class WRINKLE_OT_evaluate(BehindWindow, bpy.types.Operator):
    """Compare the played garment with a simulated or a recorded one, and draw error and curvature over the frames"""

    bl_idname = "wrinkle.evaluate"
    bl_label = "Evaluate"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    _charts: Iterator[str] | None = None
    stopping = "Evaluating stopped; an earlier evaluation is kept."

    reference: bpy.props.EnumProperty(
        name="Compare With",
        items=[
            ("settle", "Equilibrium", "The garment at rest in the pose of every frame: the best that can be played"),
            ("simulate", "Simulation", "The garment simulated in full, with all its motion; goes through every frame"),
            ("cache", "Point Cache", "A recorded animation of the garment, in a .pc2 file"),
        ],
        description="What counts as right",
    )
    cache: bpy.props.StringProperty(
        name="Cache", subtype="FILE_PATH", description="The .pc2 file of the recorded garment"
    )
    frame_start: bpy.props.IntProperty(name="From", description="First frame; left out, the scene's")
    frame_end: bpy.props.IntProperty(name="To", description="Last frame; left out, the scene's")
    frame_step: bpy.props.IntProperty(
        name="Step", default=1, min=1, description="Frames from one that is compared to the next"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_samples(cls, context) and is_idle(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        scene = context.scene
        if not self.properties.is_property_set("frame_start"):
            self.frame_start, self.frame_end = scene.frame_start, scene.frame_end
            self.frame_step = max((scene.frame_end - scene.frame_start + 1) // PROPOSED, 1)
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "reference")
        if self.reference == "cache":
            layout.prop(self, "cache")
        for name in ("frame_start", "frame_end", "frame_step"):
            layout.prop(self, name)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Behind the window; to the end where there is none."""
        garment = active_garment(context)
        assert garment is not None
        try:
            process = FileProcess(garment, EVALUATE, self._arguments(context, garment), doing="Evaluating")
            if not bpy.app.background:
                return self.start(context, garment, process)
            with process:
                work_through(process)
                while (answer := self.done(context, garment, process)) == {"RUNNING_MODAL"}:
                    pass
                return answer
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def done(self, context: bpy.types.Context, garment: bpy.types.Object, process: FileProcess) -> set[str]:
        """A chart a tick."""
        if self._charts is None:
            self._charts, self._images = draw_evaluation(context, garment), []
        image = next(self._charts, None)
        if image is not None:
            self._images.append(image)
            return {"RUNNING_MODAL"}
        error = process.result["rmse_mm"]["ours"]
        self.report({"INFO"}, f"{error:.2f} mm RMS; {', '.join(self._images)} are images for the Image Editor.")
        return {"FINISHED"}

    def _arguments(self, context: bpy.types.Context, garment: bpy.types.Object) -> list[str]:
        """For the command line.

        Raises:
            ValueError: If there is nothing to compare; one sentence.
        """
        chosen = self if self.properties.is_property_set("frame_start") else context.scene
        if chosen.frame_end < chosen.frame_start:
            raise ValueError("The frame range is empty; give a first frame that is not after the last.")
        if self.reference == "cache" and not self.cache:
            raise ValueError("Choose the .pc2 file that the garment is compared with.")
        reference = bpy.path.abspath(self.cache) if self.reference == "cache" else self.reference
        return [
            f"--frames={chosen.frame_start}:{chosen.frame_end}:{self.frame_step}", f"--reference={reference}",
            "--database", str(database_folder(garment)), "--device", device_name(), "--keep",
        ]  # fmt: skip


classes = (WRINKLE_OT_evaluate,)
