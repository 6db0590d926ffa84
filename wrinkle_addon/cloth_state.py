"""What a cloth simulation is told, goes on from, and reports."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .cloth_model import FloatArray, IntArray
from .divergence import first_lost
from .time_integration import EarlierStep


@dataclass(frozen=True)
class SolverSettings:
    """How time passes and where iterations stop.

    Attributes:
        order: Order of the time steps: 1 for backward Euler, which damps, or 2 for BDF2, which follows swift motion.
        linear_tolerance: Share of its first residual at which a linear system counts as solved (inexact Newton).
        linear_iterations: Bound on the iterations of one linear system.
        newton_iterations: Linearisations of one step.
        line_search_halvings: How often a step that does not lower the energy is halved.
        longest_step: How far one linearisation moves a vertex at most [m].
    """

    order: int = 1
    linear_tolerance: float = 0.1
    linear_iterations: int = 150
    newton_iterations: int = 2
    line_search_halvings: int = 6
    longest_step: float = 0.02

    def __post_init__(self) -> None:
        if self.order not in (1, 2):
            raise ValueError(f"Time steps are of order 1 (backward Euler) or 2 (BDF2), not {self.order}.")


@dataclass(frozen=True, eq=False)
class ClothState:
    """What a simulation goes on from: positions [m], velocities [m/s], and the friction anchors on the body.

    Shapes [world_count, vertex_count, 3] and [world_count, vertex_count]; anchor_faces holds -1 where nothing sticks.
    ``earlier`` is what steps of second order look back to, None when the next one is a first.
    """

    positions: FloatArray
    velocities: FloatArray
    anchor_faces: IntArray
    anchor_weights: NDArray[np.float32]
    earlier: EarlierStep | None = None


@dataclass(frozen=True)
class SettleReport:
    """How close to equilibrium the garment of each world came; all of shape [world_count].

    Attributes:
        residual: Root mean square of the force left on a vertex, in nodal weights, without the share of vertices that
            may be trapped; infinite for a world that was left out.
        whole_residual: The same of all vertices.
        iterations: Linearisations taken.
        linear_iterations: Conjugate gradient iterations taken.
        converged: Whether the residual fell below the tolerance asked for.
    """

    residual: FloatArray
    whole_residual: FloatArray
    iterations: IntArray
    linear_iterations: IntArray
    converged: NDArray[np.bool_]


def per_world(values: ArrayLike, name: str, world_count: int, count: int) -> FloatArray:
    """Vectors of every world, shape [world_count, count, 3], of those or of one [count, 3] for all.

    Raises:
        ValueError: One sentence with this name, if the shape is another or a value is no number.
    """
    array = np.asarray(values, np.float64)
    if array.ndim == 2:
        array = np.broadcast_to(array, (world_count, *array.shape))
    if array.shape != (world_count, count, 3):
        raise ValueError(
            f"{name} must have the shape [{count}, 3] or [{world_count}, {count}, 3], not {list(np.shape(values))}."
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{name} hold values that are not numbers, first at vertex {first_lost(array)}.")
    return np.ascontiguousarray(array)
