"""The demo's garments are modelled clothes: even, open where they should be, slack, and nowhere in the body."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from wrinkle_synthesis.demo import packages
from wrinkle_synthesis.demo.character import Build, Character, load_character
from wrinkle_synthesis.demo.garment import Garment, make_garment
from wrinkle_synthesis.demo.implicit import signed_distance, with_holes_filled
from wrinkle_synthesis.wrinkle_addon.remesh import Edges, normals
from wrinkle_synthesis.wrinkle_addon.surface import SurfaceMeasures

VERTEX_COUNT = 4_000
OPENINGS = {"shirt": 4, "tshirt": 4, "trousers": 3, "cropped": 3}


@pytest.fixture(scope="module", autouse=True)
def cached() -> None:
    try:
        packages.package_folder(packages.BODY)
    except packages.PackageError as error:
        pytest.skip(str(error))


@cache
def dressed(sex: str, name: str) -> tuple[Character, Garment]:
    character = load_character(Build(sex))
    return character, make_garment(character, name, VERTEX_COUNT)


@pytest.fixture(
    params=[("male", "shirt"), ("female", "shirt"), ("male", "tshirt"), ("female", "trousers"), ("female", "cropped")],
    ids="-".join,
)
def pair(request: pytest.FixtureRequest) -> tuple[Character, Garment]:
    return dressed(*request.param)


def border_loops(garment: Garment) -> list[np.ndarray]:
    """Vertices of each border, in no order."""
    edges = Edges.of(garment.triangles)
    ends = edges.ends[edges.is_border]
    # Every border vertex has two border edges: no border touches itself or another.
    assert (np.bincount(ends.ravel())[np.unique(ends)] == 2).all()
    label = {int(v): int(v) for v in np.unique(ends)}
    for _ in range(len(ends)):
        before = dict(label)
        for a, b in ends.tolist():
            label[a] = label[b] = min(label[a], label[b])
        if label == before:
            break
    return [np.array([v for v, name in label.items() if name == loop]) for loop in set(label.values())]


def test_it_has_the_wanted_count(pair: tuple[Character, Garment]) -> None:
    assert len(pair[1].vertices) == pytest.approx(VERTEX_COUNT, rel=0.02)


def test_it_is_one_surface_with_its_openings(pair: tuple[Character, Garment]) -> None:
    garment = pair[1]
    edges = Edges.of(garment.triangles)
    openings = OPENINGS[garment.name]
    assert len(border_loops(garment)) == openings
    # A sphere with so many holes.
    assert len(garment.vertices) - len(edges.ends) + len(garment.triangles) == 2 - openings
    directed = garment.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)


def test_its_triangles_are_even(pair: tuple[Character, Garment]) -> None:
    garment = pair[1]
    lengths = Edges.of(garment.triangles).lengths(garment.vertices)
    assert lengths.min() > 0.35 * np.median(lengths) and lengths.max() < 1.6 * np.median(lengths)
    corners = garment.vertices[garment.triangles]
    squares = sum(((corners[:, i] - corners[:, i - 1]) ** 2).sum(1) for i in range(3))
    quality = 2.0 * np.sqrt(3.0) * np.linalg.norm(normals(garment.vertices, garment.triangles), axis=1) / squares
    assert quality.min() > 0.4 and np.median(quality) > 0.98


def test_it_is_its_own_mirror_image(pair: tuple[Character, Garment]) -> None:
    garment = pair[1]
    np.testing.assert_array_equal(garment.vertices[garment.mirror], garment.vertices * [-1.0, 1.0, 1.0])
    flipped = {frozenset(t) for t in garment.mirror[garment.triangles].tolist()}
    assert flipped == {frozenset(t) for t in garment.triangles.tolist()}


def test_it_stands_off_the_body_everywhere(pair: tuple[Character, Garment]) -> None:
    character, garment = pair
    body = with_holes_filled(character.body.vertices, character.body.triangles)
    clearance = signed_distance(*body, garment.vertices)
    assert clearance.min() > 0.002
    assert 0.012 < np.median(clearance) < 0.022
    middles = signed_distance(*body, garment.vertices[garment.triangles].mean(1))
    assert middles.min() > 0.001


def test_its_bands_hold_it_at_its_openings(pair: tuple[Character, Garment]) -> None:
    garment = pair[1]
    held = garment.held
    assert held.min() == 0.0 and (held > 0.0).mean() < 0.25
    assert np.array_equal(held, held[garment.mirror])
    loops = sorted(border_loops(garment), key=lambda loop: garment.vertices[loop, 2].mean())
    for loop in loops:
        holds = garment.name == "shirt" or loop is loops[-1]
        assert (held[loop] == holds).all()


def test_it_faces_away_from_the_body(pair: tuple[Character, Garment]) -> None:
    character, garment = pair
    body = with_holes_filled(character.body.vertices, character.body.triangles)
    faces = normals(garment.vertices, garment.triangles)
    out = garment.vertices[garment.triangles].mean(1)
    step = 0.002 * faces / np.linalg.norm(faces, axis=1, keepdims=True)
    farther = signed_distance(*body, out + step) - signed_distance(*body, out)
    # Between two limbs, outwards may lead to the other limb.
    assert (farther > 0.0).mean() > 0.97


def test_it_does_not_intersect_itself(pair: tuple[Character, Garment]) -> None:
    garment = pair[1]
    measures = SurfaceMeasures(garment.triangles.astype(np.int32), len(garment.vertices))
    assert len(measures.self_intersections(garment.vertices)) == 0


@pytest.mark.parametrize("sex", ["male", "female"])
def test_a_sleeve_is_longer_than_the_arm(sex: str) -> None:
    character, shirt = dressed(sex, "shirt")
    elbow, wrist = (character.landmarks[name] for name in ("l-elbow", "l-hand"))
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    sleeve = shirt.vertices[shirt.vertices[:, 0] > wrist[0] - 0.05]
    past = ((sleeve - wrist) @ along).max()
    arm = np.linalg.norm(elbow - character.landmarks["l-shoulder"]) + np.linalg.norm(wrist - elbow)
    assert 0.05 < past / arm < 0.08


def outline(garment: Garment, height: float, half_width: float) -> np.ndarray:
    """Where the garment crosses a height, seen from above, as segments [m], shape [n, 2, 2]."""
    above = garment.vertices[:, 2] - height
    segments = []
    for triangle in garment.triangles[np.ptp(np.sign(above[garment.triangles]), axis=1) == 2.0]:
        ends = []
        for a, b in zip(triangle, np.roll(triangle, 1), strict=True):
            if above[a] * above[b] < 0.0:
                t = above[a] / (above[a] - above[b])
                ends.append(((1.0 - t) * garment.vertices[a] + t * garment.vertices[b])[:2])
        segments.append(ends)
    found = np.array(segments)
    return found[np.abs(found[..., 0]).max(1) < half_width]


@pytest.mark.parametrize(
    ("sex", "place"),
    [
        ("female", lambda m: m["spine-1"][2] - 0.07),
        ("male", lambda m: m["spine-1"][2] - 0.03),
        ("male", lambda m: m["spine-3"][2]),
    ],
    ids=["between breasts", "between pectorals", "navel"],
)
def test_cloth_spans_the_bodys_hollows(sex: str, place: Callable[[dict], float]) -> None:
    character, garment = dressed(sex, "shirt")
    segments = outline(garment, place(character.landmarks), character.landmarks["l-shoulder"][0] + 0.02)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    angles = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    support = (segments.reshape(-1, 2) @ np.stack([np.cos(angles), np.sin(angles)])).max(0)
    # Cauchy: a convex outline is as long as its mean width times pi.
    hull = support.mean() * 2.0 * np.pi
    assert length < 1.01 * hull


def test_an_unknown_garment_is_named() -> None:
    with pytest.raises(ValueError, match="'toga'"):
        make_garment(dressed("male", "shirt")[0], "toga")


def test_too_few_vertices_are_refused_in_one_sentence() -> None:
    with pytest.raises(ValueError, match="could not be meshed evenly with 150 vertices"):
        make_garment(dressed("male", "shirt")[0], "shirt", 150)
