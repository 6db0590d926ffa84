"""Step four: the bake, and its samples one by one."""

from __future__ import annotations

import bpy

from ..bake_process import BakeProgress
from ..correction_undo import problems
from ..file_process import BAKE, FileProcess, process_of
from ..samples import chosen_sample
from .layout import GarmentPanel, axis_names, draw_process, garment_of, say, settings_column, translated


class WRINKLE_PT_bake(GarmentPanel, bpy.types.Panel):
    """Bake the samples in another process; finished ones are kept, whatever happens"""

    bl_label = "Bake"
    bl_options = set()  # noqa: RUF012 - Blender wants a plain set

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, settings) = self.layout, garment_of(context)
        layout.prop(settings, "database", text="")
        if settings.database.startswith("//") and not bpy.data.filepath:
            say(context, layout, "The database lies beside the file: save the file first.", icon="ERROR")
        process = process_of(garment, BAKE)
        if process is None:
            layout.operator("wrinkle.bake", icon="RENDER_ANIMATION")
        else:
            _draw_bake(layout, process)


def _draw_bake(layout: bpy.types.UILayout, process: FileProcess) -> None:
    draw_process(layout, process)
    if process.paused:
        layout.label(text="Waits when the sample in work is done", icon="INFO")
    if isinstance(process.progress, BakeProgress) and process.progress.restless:
        count = len(process.progress.restless)
        layout.label(text=translated("{count} did not come to rest").format(count=count), icon="INFO")


class WRINKLE_PT_samples(GarmentPanel, bpy.types.Panel):
    """Look at the samples of the joint chosen above, and correct them by hand"""

    bl_label = "Samples"
    bl_parent_id = "WRINKLE_PT_bake"

    def draw(self, context: bpy.types.Context) -> None:
        layout, (garment, settings) = self.layout, garment_of(context)
        ghost = settings.ghost
        layout.prop(ghost, "shows", icon="GHOST_ENABLED")
        if not 0 <= settings.active_joint < len(settings.joints):
            say(context, layout, "Choose a joint in the list of joints.", icon="INFO")
            return
        joint = settings.joints[settings.active_joint]
        column = settings_column(layout)
        column.label(text=joint.name, icon="BONE_DATA", translate=False)
        for axis, name in enumerate(axis_names(joint)):
            column.prop(ghost, "angles", index=axis, text=name)
        try:
            database, sample = chosen_sample(garment)
        except ValueError as error:
            say(context, layout, str(error), icon="INFO")
        else:
            corrected = database.corrections.path(sample.name) is not None
            layout.label(text=sample.name, icon="SCULPTMODE_HLT" if corrected else "MESH_DATA", translate=False)
        column = layout.column(align=True)
        column.operator("wrinkle.open_sample", icon="SCULPTMODE_HLT")
        row = column.row(align=True)
        row.operator("wrinkle.write_sample", icon="FILE_TICK").mirror = ghost.mirrors
        if settings.use_symmetry and settings.mirror_signs:
            row.prop(ghost, "mirrors", text="", icon="MOD_MIRROR")
        column.operator("wrinkle.restore_sample", icon="LOOP_BACK")
        if (problem := problems.get(garment.session_uid)) is not None:
            say(context, layout, problem, icon="ERROR")


classes = (WRINKLE_PT_bake, WRINKLE_PT_samples)
