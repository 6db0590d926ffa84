"""A sample that was opened as a mesh, back into the database."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.samples import find_opened, write_sample


class WRINKLE_OT_write_sample(bpy.types.Operator):
    """Write the changed mesh back: every pose near the sample's changes with it; the baked sample is kept"""

    bl_idname = "wrinkle.write_sample"
    bl_label = "Write Back"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    keep: bpy.props.BoolProperty(
        name="Keep the Mesh", default=False, description="Leave the opened sample in the scene, to go on with it"
    )

    mirror: bpy.props.BoolProperty(
        name="Mirror",
        default=True,
        description="Also write its mirror image to the other side, where the bake mirrored the sample",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if find_opened(context) is None:
            cls.poll_message_set("Open a sample as a mesh first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        opened = find_opened(context)
        assert opened is not None
        if context.object is not None and context.object.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        garment = opened.wrinkle_sample.garment
        try:
            samples = write_sample(opened, context.evaluated_depsgraph_get(), mirror=self.mirror)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not self.keep:
            mesh = opened.data
            bpy.data.objects.remove(opened)
            bpy.data.meshes.remove(mesh)
        if garment.name in context.view_layer.objects:
            garment.hide_set(False)
            if not self.keep:
                garment.select_set(True)
                context.view_layer.objects.active = garment
        names = " and ".join(sample.name for sample in samples)
        self.report({"INFO"}, f"Corrected: {names}. Restore Baked Sample takes it back.")
        return {"FINISHED"}


classes = (WRINKLE_OT_write_sample,)
