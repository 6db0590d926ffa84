"""The demo's garments: shirts and trousers cut on the form of MakeHuman's close-fitting shell.

A garment cut straight from the shell is body paint. Here each part of the shell (trunk, neck, arm; seat, leg) is
rolled over by a large ball, which spans every hollow as cloth does; the cloth then stands off by its ease, passes
softly from part to part, and is cut open at collar, cuffs and hem (:mod:`.cutting`). That is the rest shape: slack,
smooth, free of anatomy and of folds. Eases are distances from the shell, which stands about 5 mm off the skin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ..wrinkle_addon.remesh import Edges
from .character import Character
from .cutting import BallCut, Ease, Form, Opening, PlaneCut, cut

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

GARMENTS = ("shirt", "tshirt", "trousers", "cropped")
UP = np.array([0.0, 0.0, 1.0])

# Radii of the balls that span hollows [m].
TORSO_BALL, YOKE_BALL, ARM_BALL, LEG_BALL = 0.35, 0.05, 0.1, 0.3
# A sleeve is this share longer than the arm, so that it can slide and fold; a short one covers this share of the upper
# arm. A hem lies this far below the hip joint and a trouser leg ends this far above the ankle [m], a cropped one after
# this share of the way from the knee.
SLEEVE_SURPLUS, SHORT_SLEEVE, HEM_DROP, ANKLE_GAP, CROPPED_LEG = 0.06, 0.62, 0.03, 0.03, 0.35
# A neckline is cut by a ball, as any plane would graze some shoulders: its centre lies this far in front of and above
# the neck's joint [m], its radius is this share of the shoulder joint's distance from the middle.
NECK_BALL_OFFSET, NECK_BALL_SHARE = np.array([0.0, -0.05, 0.075]), 0.63
# Ribbed bands of this width hold a garment to the skin around its openings [m]: a shirt all around, as loose cuffs
# would slide up to the elbows of a raised arm, the others at the topmost one.
BAND = 0.025


@dataclass(frozen=True, eq=False)
class Garment:
    """A garment at rest on its character.

    Attributes:
        name: One of GARMENTS.
        vertices: Rest positions [m], shape [vertex_count, 3].
        triangles: Facing away from the body, shape [triangle_count, 3].
        mirror: For each vertex the one mirrored in x = 0, shape [vertex_count].
    """

    name: str
    vertices: FloatArray
    triangles: IntArray
    mirror: IntArray

    @property
    def held(self) -> FloatArray:
        """How firmly its bands hold each vertex: 1 at an opening, 0 a band's width away, shape [vertex_count]."""
        loops = _open_loops(self.triangles, len(self.vertices))
        if self.name != "shirt":
            loops = [max(loops, key=lambda loop: self.vertices[loop, 2].mean())]
        distance, _ = KDTree(self.vertices[np.concatenate(loops)]).query(self.vertices)
        return np.clip(1.0 - distance / BAND, 0.0, 1.0)


def _open_loops(triangles: IntArray, vertex_count: int) -> list[IntArray]:
    """The vertices around each opening."""
    edges = Edges.of(triangles)
    start, end = edges.ends[edges.is_border].T
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(vertex_count, vertex_count))
    _, loop = connected_components(graph, directed=False)
    rim = np.union1d(start, end)
    return [rim[loop[rim] == number] for number in np.unique(loop[rim])]


def make_garment(character: Character, name: str = "shirt", vertex_count: int = 12_000) -> Garment:
    """Cut a garment for a character.

    Raises:
        ValueError: If there is no such garment, or it cannot be meshed with so few vertices.
    """
    if name not in GARMENTS:
        raise ValueError(f"The demo has the garments {', '.join(GARMENTS)}, not {name!r}.")
    if name in ("trousers", "cropped"):
        return Garment(name, *cut(*_trousers(character, cropped=name == "cropped"), vertex_count))
    return Garment(name, *cut(*_shirt(character, long_sleeves=name == "shirt"), vertex_count))


def _shirt(character: Character, long_sleeves: bool) -> tuple[list[Form], list[Opening]]:
    marks, figure = character.landmarks, _Figure.of(character)
    shoulder, elbow, wrist = marks["l-shoulder"], marks["l-elbow"], marks["l-hand"]
    hem = marks["l-upper-leg"] - HEM_DROP * UP
    neck = marks["neck"] + NECK_BALL_OFFSET
    neckline = BallCut((0, 1), neck, NECK_BALL_SHARE * shoulder[0])
    if long_sleeves:
        surplus = SLEEVE_SURPLUS * (np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow))
        cuff = PlaneCut((2,), wrist + surplus * _unit(wrist - elbow), _unit(wrist - elbow))
        sleeve_ease = _along(shoulder, wrist, {0.0: 0.013, 0.5: 0.012, 0.95: 0.008, 1.06: 0.012})
    else:
        cuff = PlaneCut((2,), shoulder + SHORT_SLEEVE * (elbow - shoulder), _unit(elbow - shoulder))
        sleeve_ease = _along(shoulder, elbow, {0.0: 0.012, 1.0: 0.016})

    height, arms = figure.centres[:, 2], figure.beyond("l-shoulder") + figure.beyond("r-shoulder")
    trunk = ~figure.is_skin & (arms < 0.6)
    # A large ball over the whole trunk would roof the slope from neck to shoulder, a small one leaves the back's
    # furrow: the torso is spanned below that slope, and a yoke follows it.
    torso = trunk & (height > hem[2] - 0.12) & (height < marks["neck"][2] - 0.025)
    yoke = trunk & (height > shoulder[2] - 0.12)
    # The skin goes on where the shell ends at the wrist; the sleeve must clear the root of the thumb.
    arm = (figure.beyond("l-shoulder") > 0.4) & ~(figure.is_skin & (figure.beyond("l-hand") < 0.5))
    arm &= cuff.distance(figure.centres) < 0.05
    collar_ease = _around(neck, {neckline.radius: 0.001, neckline.radius + 0.15: 0.018})
    # Room for trousers beneath.
    hang_ease = {hem[2]: 0.018, marks["spine-3"][2]: 0.011}
    forms = [
        figure.form(torso, TORSO_BALL, lambda p: np.minimum(collar_ease(p), _interpolate(p[..., 2], hang_ease))),
        figure.form(yoke, YOKE_BALL, lambda p: np.minimum(collar_ease(p), 0.009), fillet=0.02),
        figure.form(arm, ARM_BALL, sleeve_ease, fillet=0.03, paired=True),
    ]
    return forms, [PlaneCut((0,), hem, -UP), neckline, cuff]


def _trousers(character: Character, cropped: bool) -> tuple[list[Form], list[Opening]]:
    marks, figure = character.landmarks, _Figure.of(character)
    hip, knee, ankle = (marks[name][2] for name in ("l-upper-leg", "l-knee", "l-ankle"))
    waist = 0.5 * (marks["spine-4"] + marks["spine-3"])
    height, arms = figure.centres[:, 2], figure.beyond("l-shoulder") + figure.beyond("r-shoulder")
    crotch = figure.crotch()

    seat = ~figure.is_skin & (arms < 0.5) & (height > crotch) & (height < waist[2] + 0.12)
    leg = ~figure.is_skin & (figure.beyond("l-upper-leg") > 0.3) & (height > ankle - 0.01)
    # Each gives way to the other where they overlap, so that no ledge is left around the thighs.
    seat_ease = {crotch: -0.015, crotch + 0.06: 0.0, hip: 0.005, waist[2]: 0.004}
    leg_ease = {ankle: 0.013, knee: 0.016, crotch: 0.013, hip: 0.004, hip + 0.1: -0.005}
    inseam_ease = {0.0: 0.003, 0.08: 0.016}
    forms = [
        figure.form(seat, TORSO_BALL, lambda p: _interpolate(p[..., 2], seat_ease)),
        figure.form(
            leg,
            LEG_BALL,
            lambda p: np.minimum(_interpolate(p[..., 2], leg_ease), _interpolate(np.abs(p[..., 0]), inseam_ease)),
            fillet=0.04,
            paired=True,
        ),
    ]
    end = knee + CROPPED_LEG * (ankle - knee) if cropped else ankle + ANKLE_GAP
    return forms, [PlaneCut((0,), waist, UP), PlaneCut((1,), np.array([0.0, 0.0, end]), -UP)]


@dataclass(frozen=True, eq=False)
class _Figure:
    """Shell and skin of a character as one soup of quads, with what tells them apart.

    Attributes:
        vertices: Positions [m], shape [n, 3].
        quads: Facing outwards, shape [m, 4].
        centres: Middle of each quad [m], shape [m, 3].
        is_skin: Whether a quad belongs to the skin, not to the shell, shape [m].
        character: The character.
    """

    vertices: FloatArray
    quads: IntArray
    centres: FloatArray
    is_skin: BoolArray
    character: Character

    @staticmethod
    def of(character: Character) -> _Figure:
        shell, skin = character.shell, character.body
        vertices = np.concatenate([shell.vertices, skin.vertices])
        quads = np.concatenate([shell.quads, skin.quads + len(shell.vertices)])
        return _Figure(vertices, quads, vertices[quads].mean(1), np.arange(len(quads)) >= len(shell.quads), character)

    def beyond(self, landmark: str) -> FloatArray:
        """How much of each quad follows the bone that starts at a landmark and all bones after it, shape [m]."""
        rig = self.character.rig
        first = int(np.argmin(np.linalg.norm(rig.heads - self.character.landmarks[landmark], axis=1)))
        bones = [bone for bone in range(rig.bone_count) if bone == first or rig.is_ancestor(first, bone)]
        weights = np.concatenate([self.character.shell_weights, self.character.weights])[:, bones].sum(1)
        return weights[self.quads].mean(1)

    def crotch(self) -> float:
        """Height of the crotch [m]."""
        shell = self.character.shell.vertices
        return float(shell[np.abs(shell[:, 0]) < 1e-6, 2].min())

    def form(self, quads: BoolArray, ball: float, ease: Ease, fillet: float = 0.0, paired: bool = False) -> Form:
        used, index = np.unique(self.quads[quads], return_inverse=True)
        triangles = index.reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        return Form(self.vertices[used], triangles, ball, ease, fillet, paired)


def _along(start: FloatArray, end: FloatArray, eases: Mapping[float, float]) -> Ease:
    """Ease [m] by the share of the way from one point to another."""
    axis = (end - start) / ((end - start) @ (end - start))
    return lambda points: _interpolate((points - start) @ axis, eases)


def _around(centre: FloatArray, eases: Mapping[float, float]) -> Ease:
    """Ease [m] by the distance [m] from a point."""
    return lambda points: _interpolate(np.linalg.norm(points - centre, axis=-1), eases)


def _interpolate(values: FloatArray, table: Mapping[float, float]) -> FloatArray:
    places = sorted(table)
    return np.interp(values, places, [table[place] for place in places])


def _unit(vector: FloatArray) -> FloatArray:
    return vector / np.linalg.norm(vector)
