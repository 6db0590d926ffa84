"""Make a garment's coarse mesh in one click."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.coarse_setup import CoarseMade, CoarseOrder, place_coarse
from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.coarse_mesh import LEAST_COUNT, VERTEX_COUNT
from .polls import has_garment
from .thread_behind_window import ThreadBehindWindow


class WRINKLE_OT_make_coarse_mesh(ThreadBehindWindow, bpy.types.Operator):
    """Make a coarse mesh from the garment, skinned as it is, for the garment to follow"""

    bl_idname = "wrinkle.make_coarse_mesh"
    bl_label = "Make Coarse Mesh"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    doing = "Making the coarse mesh"

    vertex_count: bpy.props.IntProperty(
        name="Vertices",
        default=VERTEX_COUNT,
        min=LEAST_COUNT,
        soft_max=5000,
        description="About how many the coarse mesh has; what is simulated takes time with each",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_garment(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """At once."""
        garment = active_garment(context)
        assert garment is not None
        try:
            return self.made(garment, CoarseOrder.of(garment, self.vertex_count).make())
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Behind the window, for as long as it takes."""
        garment = active_garment(context)
        assert garment is not None
        try:
            return self.start(context, garment, CoarseOrder.of(garment, self.vertex_count).make)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def made(self, garment: bpy.types.Object, made: CoarseMade) -> set[str]:
        with suspended():
            coarse = place_coarse(garment, made)
        self.report({"INFO"}, f"{coarse.name} has {len(coarse.data.vertices)} vertices")
        return {"FINISHED"}


classes = (WRINKLE_OT_make_coarse_mesh,)
