"""One side's joint as the other side's."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.garment_joints import mirror_joint
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.symmetry import other_side
from .polls import has_garment


class WRINKLE_OT_mirror_joint(bpy.types.Operator):
    """Give the joint of the other side the range, the step and the strength of this one"""

    bl_idname = "wrinkle.mirror_joint"
    bl_label = "Mirror Joint"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not has_garment(cls, context):
            return False
        garment = active_garment(context)
        assert garment is not None
        joints, active = garment.wrinkles.joints, garment.wrinkles.active_joint
        if not 0 <= active < len(joints):
            cls.poll_message_set("Choose a joint in the list")
            return False
        partner = other_side(joints[active].name)
        if partner == joints[active].name or partner not in joints:
            cls.poll_message_set("This joint has no partner on the other side")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        settings = garment.wrinkles
        try:
            mirror_joint(settings, settings.joints[settings.active_joint].name)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


classes = (WRINKLE_OT_mirror_joint,)
