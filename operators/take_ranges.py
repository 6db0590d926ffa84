"""Joint ranges from what the animation uses."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.garment_joints import take_ranges
from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.properties import active_garment
from .polls import has_garment


class WRINKLE_OT_take_ranges(bpy.types.Operator):
    """Sample only the angles that the armature's animation uses, plus a margin"""

    bl_idname = "wrinkle.take_ranges"
    bl_label = "Ranges from Animation"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    margin: bpy.props.FloatProperty(
        name="Margin", subtype="ANGLE", default=0.0872664626, min=0.0, description="Added at both ends of every range"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_garment(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        garment = active_garment(context)
        assert garment is not None
        try:
            with suspended():
                take_ranges(garment, _frames(context.scene, garment.wrinkles.armature), self.margin)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def _frames(scene: bpy.types.Scene, armature: bpy.types.Object) -> list[int]:
    """Frames of the armature's action; of the scene, if it has none."""
    animation = armature.animation_data
    if animation is not None and animation.action is not None:
        first, last = animation.action.frame_range
    else:
        first, last = scene.frame_start, scene.frame_end
    return list(range(int(first), int(last) + 1))


classes = (WRINKLE_OT_take_ranges,)
