"""What a cloth simulation is told, goes on from, and reports."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .cloth_model import FloatArray, IntArray
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
    """How close to equilibrium a garment came.

    Attributes:
        residual: Root mean square of the force left on a vertex, in nodal weights, the worst of all worlds; without
            the share of vertices that may be trapped.
        whole_residual: The same of all vertices.
        iterations: Linearisations taken.
        linear_iterations: Conjugate gradient iterations taken.
        converged: Whether the residual fell below the tolerance asked for.
    """

    residual: float
    whole_residual: float
    iterations: int
    linear_iterations: int
    converged: bool
