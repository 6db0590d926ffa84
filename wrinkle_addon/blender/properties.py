"""What a garment object remembers: who wears it, its joints, how it is baked and played."""

from __future__ import annotations

import json
from collections.abc import Sequence

import bpy
import numpy as np

from ..coarse_cache import SUFFIX
from ..coarse_simulation import CoarseSettings
from ..fabrics import FABRICS, Fabric, find_fabric
from ..joint_wrinkles import BlendWeights, Formulation
from ..penetration import ClearanceSettings
from ..rig import Joint
from ..wearer import BakeSettings
from . import playback
from .coarse_layer import MESH, NONE, choose_coarse, tie_coarse
from .coarse_scene import SIMULATION
from .culling import FULL_DETAIL
from .flow_properties import FlowSettings
from .node_group import PRESENT, add_modifier, set_mask
from .sample_properties import GhostSettings
from .write import show_skinned

_OVERRIDABLE = {"LIBRARY_OVERRIDABLE"}
"""Kept when a linked character is made local in part: without it, a reopened override reads the linked armature."""

PLANS = (
    ("PAPER", "Full", "Hinges every 15 degrees, balls every 30: some 300 samples for an upper body"),
    ("BUDGET", "Budget", "The finest plan that keeps to a number of simulated samples"),
)

COARSE_LAYERS = (
    (NONE, "None", "The garment moves as its armature does"),
    (MESH, "Mesh", "Any mesh that moves: a cloth simulation, a Surface Deform rig, a cache, a skinned mesh"),
    (SIMULATION, "Simulation", "A simulation of the coarse mesh, from its cache"),
)

OWN_FABRIC = "OWN"


def _played_anew(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Play with what the artist has just changed, without waiting for another frame."""
    garment = settings.id_data
    playback.doubt(garment)
    garment.update_tag()


def _switched(settings: GarmentSettings, context: bpy.types.Context) -> None:
    if not settings.enabled:
        show_skinned(settings.id_data)
    _played_anew(settings, context)


def _layered(settings: GarmentSettings, context: bpy.types.Context) -> None:
    if settings.coarse_layer == SIMULATION and not settings.coarse_cache and settings.armature is not None:
        settings.coarse_cache = f"//{bpy.path.clean_name(settings.armature.name)}{SUFFIX}"
    tie_coarse(settings.id_data)
    _played_anew(settings, context)


def _coarse_chosen(settings: GarmentSettings, context: bpy.types.Context) -> None:
    choose_coarse(settings.id_data)
    playback.forget(settings.id_data)
    settings.id_data.update_tag()


def _may_be_coarse(settings: GarmentSettings, ob: bpy.types.Object) -> bool:
    return ob.type == "MESH" and ob != settings.id_data


def _may_be_inner(settings: GarmentSettings, ob: bpy.types.Object) -> bool:
    return ob.type == "MESH" and ob != settings.id_data and ob.wrinkles.armature == settings.armature


def _masked(settings: GarmentSettings, context: bpy.types.Context) -> None:
    set_mask(add_modifier(settings.id_data), settings.mask)
    settings.id_data.update_tag()


def defined_joint(name: str, definition: str, low: Sequence[float], high: Sequence[float]) -> Joint:
    """A joint of what is stored of it: JSON, and the lowest and highest angles [rad], of which it uses its own."""
    data = json.loads(definition)
    dof = data["dof"]
    return Joint(
        name=name,
        bones=tuple(data["bones"]),
        near=data["near"],
        dof=dof,
        axes=np.array(data["axes"], np.float64),
        limits=np.stack([np.array(low[:dof]), np.array(high[:dof])], 1).astype(np.float64),
        shares=np.array(data["shares"], np.float64),
    )


class JointSettings(bpy.types.PropertyGroup):
    """One joint of a garment."""

    name: bpy.props.StringProperty(name="Joint", description="Such as elbow_L or spine")
    enabled: bpy.props.BoolProperty(name="Sample", default=True, description="Bake samples of this joint")
    strength: bpy.props.FloatProperty(
        name="Strength",
        default=1.0,
        min=0.0,
        soft_max=2.0,
        options={"ANIMATABLE"},
        description="Of its wrinkles",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    definition: bpy.props.StringProperty(options={"HIDDEN"})
    low: bpy.props.FloatVectorProperty(
        name="From", size=3, subtype="EULER", unit="ROTATION", max=0.0, description="Lowest angles, relative to rest"
    )
    high: bpy.props.FloatVectorProperty(
        name="To", size=3, subtype="EULER", unit="ROTATION", min=0.0, description="Highest angles, relative to rest"
    )

    step: bpy.props.FloatProperty(
        name="Step",
        default=0.0,
        min=0.0,
        soft_max=np.pi / 2,
        subtype="ANGLE",
        options=set(),
        description="Widest gap between two sampled angles of the full plan; 0 for the paper's own, "
        "15 degrees for a hinge and 30 for a ball",
    )

    def store(self, joint: Joint) -> None:
        """Remember a joint."""
        self.name = joint.name
        self.definition = json.dumps(
            {
                "bones": joint.bones,
                "near": joint.near,
                "dof": joint.dof,
                "axes": joint.axes.tolist(),
                "shares": joint.shares.tolist(),
            }
        )
        for axis in range(joint.dof):
            self.low[axis], self.high[axis] = (float(angle) for angle in joint.limits[axis])

    def joint(self) -> Joint:
        """The joint, with its range as it stands now."""
        return defined_joint(self.name, self.definition, tuple(self.low), tuple(self.high))


_DETAILS = [
    (FULL_DETAIL, "Full", "Wrinkles, kept clear of the body"),
    ("QUICK", "Without Push-Out", "Wrinkles, which may go into the body"),
]


class GarmentSettings(bpy.types.PropertyGroup):
    """Settings of one garment object; ``armature`` is set on garments that take part."""

    armature: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Armature", override=_OVERRIDABLE, description="The rig that moves body and garment"
    )
    body: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Body", override=_OVERRIDABLE, description="The mesh that the garment is worn on"
    )
    original: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Original", description="The garment that this finer copy was made from"
    )
    original_hidden: bpy.props.BoolVectorProperty(
        size=2, options={"HIDDEN"}, description="Whether the original was hidden in viewport and render"
    )
    before: bpy.props.PointerProperty(
        type=bpy.types.Object, options={"HIDDEN"}, description="The garment as it was before it was set up"
    )
    database: bpy.props.StringProperty(
        name="Database",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        description="Folder of the baked samples",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    enabled: bpy.props.BoolProperty(
        name="Wrinkles",
        default=False,
        description="Play the database on every pose",
        override=_OVERRIDABLE,
        update=_switched,
    )
    strength: bpy.props.FloatProperty(
        name="Strength",
        default=1.0,
        min=0.0,
        soft_max=2.0,
        options={"ANIMATABLE"},
        description="Of all wrinkles",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    mask: bpy.props.StringProperty(
        name="Mask",
        description="Vertex group by which wrinkles show; everywhere if left out",
        override=_OVERRIDABLE,
        update=_masked,
    )
    formulation: bpy.props.EnumProperty(
        name="Formulation",
        description="How the samples of several joints meet in one pose",
        items=[
            (Formulation.OFFSETS.name, "Offsets", "Offsets over skinning, added up over the joints"),
            (Formulation.PAPER.name, "Paper", "Positions along arcs, averaged by distance (Wang et al. 2010)"),
        ],
        default=Formulation.OFFSETS.name,
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    coarse_layer: bpy.props.EnumProperty(
        name="Coarse Layer",
        items=COARSE_LAYERS,
        default=NONE,
        description="What the garment follows where it moves as a whole",
        options=set(),
        override=_OVERRIDABLE,
        update=_layered,
    )
    coarse: bpy.props.PointerProperty(
        type=bpy.types.Object,
        name="Coarse Mesh",
        description="As modelled, it lies on the garment; choose it where both stand as they were modelled",
        poll=_may_be_coarse,
        override=_OVERRIDABLE,
        update=_coarse_chosen,
    )
    coarse_place: bpy.props.FloatVectorProperty(
        size=16, options={"HIDDEN"}, override=_OVERRIDABLE, description="The coarse mesh in the garment's space"
    )
    coarse_cache: bpy.props.StringProperty(
        name="Cache",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        description="Folder of the simulated frames; garments of one character that name the same one collide",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    coarse_order: bpy.props.IntProperty(
        name="Layer",
        default=0,
        min=0,
        description="0 is worn next to the skin, higher numbers over lower ones",
        options=set(),
        update=_played_anew,
    )
    coarse_steps: bpy.props.IntProperty(
        name="Steps",
        default=CoarseSettings().steps,
        min=1,
        soft_max=10,
        description="Time steps a frame",
        options=set(),
        update=_played_anew,
    )
    coarse_buffer: bpy.props.FloatProperty(
        name="Buffer",
        default=CoarseSettings().buffer,
        min=1e-4,
        soft_max=0.02,
        precision=4,
        description="Distance from the body that leaves room for wrinkles, m",
        options=set(),
        update=_played_anew,
    )
    coarse_damping: bpy.props.FloatProperty(
        name="Damping",
        default=CoarseSettings().damping,
        min=0.0,
        soft_max=10.0,
        description="How fast motion relative to the skinned garment fades, 1/s",
        options=set(),
        update=_played_anew,
    )
    coarse_pre_roll: bpy.props.FloatProperty(
        name="Pre-Roll",
        default=CoarseSettings().pre_roll,
        min=0.0,
        soft_max=2.0,
        subtype="TIME_ABSOLUTE",
        description="Time in the first pose before the motion begins",
        options=set(),
        update=_played_anew,
    )
    coarse_proxy: bpy.props.IntProperty(
        name="Body Proxy",
        default=0,
        min=0,
        soft_max=20_000,
        options=set(),
        description="Vertices of a coarser body to collide with, such as 10,000; 0 for the body itself. "
        "The innermost layer's counts",
        update=_played_anew,
    )
    follow: bpy.props.FloatProperty(
        name="Follow",
        default=1.0,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        options={"ANIMATABLE"},
        description="How much of the coarse layer's motion the garment takes on",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    weights: bpy.props.EnumProperty(
        name="Blend Weights",
        description="How far over the garment each joint reaches",
        items=[
            (BlendWeights.DISTANCE.name, "By Distance", "Each joint reaches as far as its regions are near"),
            (BlendWeights.MEASURED.name, "Measured", "Each joint reaches as far as its samples change the cloth"),
        ],
        default=BlendWeights.DISTANCE.name,
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    clear_of_body: bpy.props.BoolProperty(
        name="Clear of Body",
        default=True,
        description="Push the garment out of its body in every frame",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    clearance: bpy.props.FloatProperty(
        name="Clearance",
        default=ClearanceSettings().distance,
        min=0.0,
        soft_max=0.02,
        step=0.1,
        precision=4,
        description="Height over the skin that the garment keeps where it did not lie lower at rest, m",
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    viewport_detail: bpy.props.EnumProperty(
        name="In Viewport",
        items=_DETAILS,
        default=FULL_DETAIL,
        description="What is left out in the viewport to play faster",
        options=set(),
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    render_detail: bpy.props.EnumProperty(
        name="In Renders",
        items=_DETAILS,
        default=FULL_DETAIL,
        description="What is left out in renders, of a character that is far away; written files have it all",
        options=set(),
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    worn_over: bpy.props.PointerProperty(
        type=bpy.types.Object,
        name="Worn Over",
        description="Another garment of the character with wrinkles, which this one is kept outside of",
        poll=_may_be_inner,
        override=_OVERRIDABLE,
        update=_played_anew,
    )
    flow: bpy.props.PointerProperty(type=FlowSettings, override=_OVERRIDABLE)
    ghost: bpy.props.PointerProperty(type=GhostSettings)
    joints: bpy.props.CollectionProperty(type=JointSettings, override=_OVERRIDABLE)
    skinning_rests: bpy.props.BoolProperty(
        options={"HIDDEN"}, description="The Armature modifier is off as long as the animation plays"
    )
    mirror_signs: bpy.props.StringProperty(
        options={"HIDDEN"}, description="Factors of the angles of mirrored joints, if the character is symmetric; JSON"
    )
    asymmetry: bpy.props.StringProperty(
        options={"HIDDEN"}, description="A sentence on where the character is not symmetric; empty if it is"
    )
    symmetry_marks: bpy.props.StringProperty(
        options={"HIDDEN"}, description="The shapes that symmetry was looked for on; JSON"
    )
    corrections: bpy.props.StringProperty(
        options={"HIDDEN"}, description="Versions of samples that were chosen in this file, which undo follows; JSON"
    )
    notes: bpy.props.StringProperty(description="Sentences on joints that were not found, one a line")
    active_joint: bpy.props.IntProperty(name="Joint", description="The joint that is chosen in the list")
    plan: bpy.props.EnumProperty(
        name="Plan", items=PLANS, default="PAPER", description="Which angles of the joints are sampled"
    )
    budget: bpy.props.IntProperty(
        name="Samples", default=36, min=1, description="Most samples to simulate; mirror images come for free"
    )
    use_symmetry: bpy.props.BoolProperty(
        name="Symmetry", default=True, description="Simulate one side only where body, garment and rig are symmetric"
    )
    ease_girth: bpy.props.FloatProperty(
        name="Ease Girth",
        default=3.0,
        min=-20.0,
        max=50.0,
        subtype="PERCENTAGE",
        description="Extra cloth around limbs",
    )
    ease_length: bpy.props.FloatProperty(
        name="Ease Length",
        default=4.0,
        min=-20.0,
        max=50.0,
        subtype="PERCENTAGE",
        description="Extra cloth along limbs",
    )
    fabric: bpy.props.EnumProperty(
        name="Fabric",
        items=[
            (OWN_FABRIC, "Own", "Of the stiffness and density below"),
            *((name, name.capitalize(), "Measured, or published with its measurements") for name in FABRICS),
        ],
        default=OWN_FABRIC,
        description="What the garment is made of",
    )
    stretch: bpy.props.FloatProperty(
        name="Stretch", default=Fabric().stretch, min=1.0, description="Stiffness against stretching, N/m"
    )
    bending: bpy.props.FloatProperty(
        name="Bending", default=Fabric().bending, min=1e-8, precision=7, description="Bending stiffness, N m"
    )
    density: bpy.props.FloatProperty(
        name="Density", default=Fabric().density, min=1e-3, description="Mass per area, kg/m²"
    )
    friction: bpy.props.FloatProperty(
        name="Friction", default=Fabric().friction, min=0.0, soft_max=1.0, description="Against the body"
    )
    pin_group: bpy.props.StringProperty(name="Pins", description="Vertex group held to the skin, such as a waistband")

    def bake_settings(self) -> BakeSettings:
        """How samples of this garment are simulated."""
        return BakeSettings(
            fabric=self._chosen_fabric(), ease=(_decimal(self.ease_girth) / 100, _decimal(self.ease_length) / 100)
        )

    def coarse_settings(self) -> CoarseSettings:
        """How the coarse mesh of this garment is simulated."""
        return CoarseSettings(
            fabric=self._chosen_fabric(),
            steps=self.coarse_steps,
            buffer=_decimal(self.coarse_buffer),
            damping=_decimal(self.coarse_damping),
            pre_roll=_decimal(self.coarse_pre_roll),
        )

    def _chosen_fabric(self) -> Fabric:
        if self.fabric != OWN_FABRIC:
            return find_fabric(self.fabric)
        # Properties are single precision; the decimal that the artist typed is what goes into the database's key.
        return Fabric(
            stretch=_decimal(self.stretch),
            bending=_decimal(self.bending),
            density=_decimal(self.density),
            friction=_decimal(self.friction),
        )

    def detail(self, depsgraph: bpy.types.Depsgraph) -> str:
        """What is shown of it in the viewport or in a render."""
        return self.render_detail if depsgraph.mode == "RENDER" else self.viewport_detail

    def strengths(self) -> dict[str, float]:
        """Strength of every joint, the garment's own included."""
        return {joint.name: joint.strength * self.strength for joint in self.joints}


def _decimal(value: float) -> float:
    """The shortest decimal of a single precision value."""
    return float(f"{value:.6g}")


def active_garment(context: bpy.types.Context) -> bpy.types.Object | None:
    """The garment that the artist is working on: the active object, or the first one worn by the active armature."""
    active = context.object
    if active is None:
        return None
    if active.type == "MESH" and active.wrinkles.armature is not None:
        return active
    if active.wrinkle_sample.garment is not None:
        return active.wrinkle_sample.garment
    worn = (ob for ob in context.scene.objects if ob.type == "MESH" and ob.wrinkles.armature == active)
    return next(worn, None) if active.type == "ARMATURE" else None


classes = (JointSettings, GarmentSettings)


def register() -> None:
    bpy.types.Object.wrinkles = bpy.props.PointerProperty(type=GarmentSettings, override=_OVERRIDABLE)
    setattr(bpy.types.NodeTree, PRESENT, bpy.props.BoolProperty(default=True, options={"HIDDEN"}))


def unregister() -> None:
    del bpy.types.Object.wrinkles
    delattr(bpy.types.NodeTree, PRESENT)
