"""Make a garment's coarse mesh in one click."""

from __future__ import annotations

import bpy

from ..wrinkle_addon.blender.coarse_setup import CoarseMade, CoarseOrder, place_coarse
from ..wrinkle_addon.blender.handlers import suspended
from ..wrinkle_addon.blender.made_behind import submit
from ..wrinkle_addon.blender.properties import active_garment
from ..wrinkle_addon.coarse_mesh import LEAST_COUNT, VERTEX_COUNT
from .polls import has_garment

TICK = 0.1
"""Time between two looks at what is being made [s]."""


class WRINKLE_OT_make_coarse_mesh(bpy.types.Operator):
    """Make a coarse mesh from the garment, skinned as it is, for the garment to follow"""

    bl_idname = "wrinkle.make_coarse_mesh"
    bl_label = "Make Coarse Mesh"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

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
            return self._place(garment, CoarseOrder.of(garment, self.vertex_count).make())
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Behind the window, for as long as it takes."""
        garment = active_garment(context)
        assert garment is not None
        try:
            self._made = submit(CoarseOrder.of(garment, self.vertex_count).make)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._garment = garment.session_uid
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set("Making the coarse mesh. Esc stops.")
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        garment = next((ob for ob in bpy.data.objects if ob.session_uid == self._garment), None)
        if event.type == "ESC" or garment is None:
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "TIMER" or not self._made.done():
            return {"PASS_THROUGH"}
        self.cancel(context)
        try:
            return self._place(garment, self._made.result())
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Leave no timer behind; also called when another file is opened."""
        context.window_manager.event_timer_remove(self._timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def _place(self, garment: bpy.types.Object, made: CoarseMade) -> set[str]:
        with suspended():
            coarse = place_coarse(garment, made)
        self.report({"INFO"}, f"{coarse.name} has {len(coarse.data.vertices)} vertices")
        return {"FINISHED"}


classes = (WRINKLE_OT_make_coarse_mesh,)
