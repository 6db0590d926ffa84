"""What the demo makes: everything that can be chosen about it, in two sizes."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any


@dataclass(frozen=True)
class Recipe:
    """Choices of one demo.

    Attributes:
        sex, garment, vertex_count: The character, what it wears, and about how many vertices each garment has.
        clip: A motion-capture clip of :mod:`.motion`, or one of :mod:`.keyframes`.
        samples: Most samples to simulate; None is the paper's whole plan, over all that the joints can do.
        pictured_samples: So many samples are pictured, too, in rows of four.
        processes: Bakes that run side by side.
        settled_step: Every how many frames the garment is settled for comparison.
        simulated: First and last frame of the full simulation; 0 is the clip's end.
        rows: Frames of the side-by-side picture.
        picture_size, picture_rays: Its pictures, in pixels and rays a pixel.
        film_step: Every how many frames of the simulated span are filmed.
        film_size, film_rays: The film's pictures.
        film_speed: Share of the true speed at which the film plays.
        expected: Seconds that each stage is expected to take on two cores, in order.
        repeats: How often the clip is played, one after the other.
        played: First and last frame of that; 0 is its end.
        stay: Whether the character stays in place.
        coarse: Vertices of the coarse layer that each garment follows; 0 is none.
        worn_over: What the garment is worn over; empty for nothing but the body.
    """

    sex: str
    garment: str
    vertex_count: int
    clip: str
    samples: int | None
    pictured_samples: int
    processes: int
    settled_step: int
    simulated: tuple[int, int]
    rows: int
    picture_size: tuple[int, int]
    picture_rays: int
    film_step: int
    film_size: tuple[int, int]
    film_rays: int
    film_speed: float
    expected: dict[str, float]
    repeats: int = 1
    played: tuple[int, int] = (1, 0)
    stay: bool = False
    coarse: int = 0
    worn_over: str = ""

    @property
    def garments(self) -> tuple[str, ...]:
        """All that is worn, the outermost first."""
        return (self.garment, self.worn_over) if self.worn_over else (self.garment,)

    @property
    def choices(self) -> dict[str, Any]:
        """All that decides the results."""
        return {name: value for name, value in asdict(self).items() if name not in ("expected", "processes")}


FULL = Recipe(
    sex="male",
    garment="shirt",
    vertex_count=12_000,
    clip="punch",
    samples=36,
    pictured_samples=4,
    processes=2,
    settled_step=10,
    simulated=(1, 0),
    rows=3,
    picture_size=(540, 600),
    picture_rays=16,
    film_step=2,
    film_size=(360, 400),
    film_rays=6,
    film_speed=0.75,
    expected={
        "character": 15.0,
        "set-up": 10.0,
        "bake": 600.0,
        "synthesis": 5.0,
        "references": 300.0,
        "errors": 12.0,
        "samples": 15.0,
        "pictures": 90.0,
        "film": 240.0,
    },
)
QUICK = Recipe(
    sex="male",
    garment="shirt",
    vertex_count=4_000,
    clip="punch",
    samples=6,
    pictured_samples=4,
    processes=2,
    settled_step=25,
    simulated=(18, 30),
    rows=2,
    picture_size=(288, 320),
    picture_rays=8,
    film_step=3,
    film_size=(234, 260),
    film_rays=4,
    film_speed=0.3,
    expected={
        "character": 8.0,
        "set-up": 6.0,
        "bake": 40.0,
        "synthesis": 4.0,
        "references": 55.0,
        "errors": 5.0,
        "samples": 5.0,
        "pictures": 20.0,
        "film": 18.0,
    },
)


WHOLE_SHIRT = replace(
    FULL,
    samples=None,
    pictured_samples=12,
    expected={
        "character": 15.0,
        "set-up": 10.0,
        "bake": 1500.0,
        "synthesis": 5.0,
        "references": 300.0,
        "errors": 12.0,
        "samples": 100.0,
        "pictures": 90.0,
        "film": 240.0,
    },
)
WHOLE_TROUSERS = replace(WHOLE_SHIRT, sex="female", garment="trousers", clip="kick")
WHOLE = {recipe.garment: recipe for recipe in (WHOLE_SHIRT, WHOLE_TROUSERS)}
