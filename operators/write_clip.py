"""The finished garment in a file that needs no add-on."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..wrinkle_addon.blender.clip_synthesis import CACHE, ClipSynthesis, check_result, write_clip
from ..wrinkle_addon.blender.file_process import SYNTHESIZE, FileProcess
from ..wrinkle_addon.blender.files import database_folder
from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.mesh_cache import play_cache
from ..wrinkle_addon.blender.preferences import device_name
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.cache_parts import CacheParts
from ..wrinkle_addon.folder_verbs import choose_device
from .behind_window import BehindWindow
from .polls import has_database, is_idle


class WRINKLE_OT_write_clip(BehindWindow, bpy.types.Operator):
    """Write the wrinkled garment over a range of frames as a point cache, as Alembic or as USD"""

    bl_idname = "wrinkle.write_clip"
    bl_label = "Write Garment"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    stopping = "Writing stopped; no file was written."

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", description="A .pc2, .abc, .usd, .usdc or .usda file")
    filter_glob: bpy.props.StringProperty(default="*.pc2;*.abc;*.usd;*.usdc;*.usda", options={"HIDDEN"})
    frame_start: bpy.props.IntProperty(name="From", description="First frame")
    frame_end: bpy.props.IntProperty(name="To", description="Last frame")
    suffix: bpy.props.StringProperty(default=CACHE, options={"HIDDEN"}, description="Of the file that is proposed")
    play: bpy.props.BoolProperty(
        name="Play the Cache",
        default=False,
        description="Let the garment play the point cache with Blender's Mesh Cache modifier from now on",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_database(cls, context) and is_idle(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        if not self.properties.is_property_set("frame_start"):
            self.frame_start, self.frame_end = context.scene.frame_start, context.scene.frame_end
        if not self.filepath:
            self.filepath = bpy.path.abspath(f"//{bpy.path.clean_name(garment.name)}{self.suffix}")
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Behind the window; to the end where there is none."""
        garment = active_garment(context)
        assert garment is not None
        try:
            self._out, self._frames = out, frames = self._checked(context, garment)
            if not bpy.app.background:
                arguments = [
                    f"--frames={frames.start}:{frames.stop - 1}", "--database", str(database_folder(garment)),
                    "--device", device_name(), f"--out={out}",
                ]  # fmt: skip
                return self.start(context, garment, FileProcess(garment, SYNTHESIZE, arguments, doing="Writing"))
            with suspended():
                synthesis = ClipSynthesis(garment, database_folder(garment), device=choose_device(device_name()))
                # The file may have changed since it was saved, so parts of other runs are none of ours.
                write_clip(synthesis, frames, out, None, lambda made: None)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self._play(garment)

    def _checked(self, context: bpy.types.Context, garment: bpy.types.Object) -> tuple[Path, range]:
        """What is written, and of which frames.

        Raises:
            ValueError: If that cannot be; one sentence.
        """
        chosen = self if self.properties.is_property_set("frame_start") else context.scene
        out, frames = Path(bpy.path.abspath(self.filepath)), range(chosen.frame_start, chosen.frame_end + 1)
        check_result(out)
        if garment.data.is_editmode:
            raise ValueError("Leave edit mode first: what is edited cannot be written.")
        if not frames:
            raise ValueError("The frame range is empty; give a first frame that is not after the last.")
        if self.play and out.suffix.lower() != CACHE:
            raise ValueError(f"Blender's Mesh Cache modifier plays a {CACHE} file; write one.")
        return out, frames

    def done(self, context: bpy.types.Context, garment: bpy.types.Object, process: FileProcess) -> set[str]:
        return self._play(garment)

    def dropped(self, context: bpy.types.Context) -> None:
        # Another run has another copy of the file, for which these are no parts.
        CacheParts.beside(self._out, "", 0).remove()

    def _play(self, garment: bpy.types.Object) -> set[str]:
        """Show what was written, if that is wanted."""
        if self.play:
            play_cache(garment, self._out, self._frames.start)
        garment.update_tag()
        self.report({"INFO"}, f"{len(self._frames)} frames written to {self._out}.")
        return {"FINISHED"}


classes = (WRINKLE_OT_write_clip,)
