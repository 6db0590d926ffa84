"""Single samples in the viewport: the ghost of one, and a mesh that one was opened as."""

from __future__ import annotations

import bpy


def _redraw(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


class GhostSettings(bpy.types.PropertyGroup):
    """Which sample of the chosen joint is shown as a ghost."""

    shows: bpy.props.BoolProperty(
        name="Show Ghost",
        description="Draw the sample that lies nearest to the angles below, over the scene",
        options=set(),
        update=_redraw,
    )
    mirrors: bpy.props.BoolProperty(
        name="Mirror",
        default=True,
        options=set(),
        description="Write a corrected sample back to the other side, too, where the bake mirrored it",
    )
    angles: bpy.props.FloatVectorProperty(
        name="Angles",
        size=3,
        subtype="EULER",
        unit="ROTATION",
        description="Of the chosen joint, relative to rest",
        options=set(),
        update=_redraw,
    )


class SampleMesh(bpy.types.PropertyGroup):
    """On an object that a sample was opened as: ``garment`` is set there and nowhere else."""

    garment: bpy.props.PointerProperty(type=bpy.types.Object, name="Garment")
    joint: bpy.props.StringProperty(name="Joint", description="The joint that the sample turns")
    index: bpy.props.IntVectorProperty(size=3, description="Node of the joint's grid; a hinge has the first alone")
    key: bpy.props.StringProperty(description="Of the bake that the sample comes from")


classes = (GhostSettings, SampleMesh)


def register() -> None:
    bpy.types.Object.wrinkle_sample = bpy.props.PointerProperty(type=SampleMesh)


def unregister() -> None:
    del bpy.types.Object.wrinkle_sample
