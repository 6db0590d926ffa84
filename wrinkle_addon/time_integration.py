"""Backward differentiation: inertia of a time step as a pull towards where the garment would fly on its own.

With y' at the end of a step of length h taken as (c0 y + c1 y_n + c2 y_n-1) / h for positions and for velocities alike,
the acceleration there is (x - target) / span^2, which is the derivative of an energy: each step minimises it together
with all others.

    first order, backward Euler    c = (1, -1, 0)
    second order, BDF2             c = ((1 + 2 r) / (1 + r), -(1 + r), r^2 / (1 + r))      r = h / the step before

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section III.5 (variable step sizes).
"""

from __future__ import annotations

from dataclasses import dataclass

from .cloth_model import FloatArray


@dataclass(frozen=True, eq=False)
class EarlierStep:
    """Where a garment was one time step ago: positions [m], velocities [m/s], and the length of that step [s].

    Shapes [world_count, vertex_count, 3].
    """

    positions: FloatArray
    velocities: FloatArray
    dt: float


@dataclass(frozen=True, eq=False)
class StepInertia:
    """Inertia of one time step.

    Attributes:
        target: Where the garment goes if no force acts on it [m].
        span: Length of the backward Euler step with as much inertia [s].
        past: What the past adds to the difference of positions at the end [m].
    """

    target: FloatArray
    span: float
    past: FloatArray

    def velocities(self, positions: FloatArray) -> FloatArray:
        """Velocities at the end of the step [m/s] if it ends at these positions [m]."""
        return (positions + self.past) / self.span


@dataclass(frozen=True)
class StepCoefficients:
    """What a step of length h takes of the past: y' = (y + now y_n + before y_n-1) / span.

    Attributes:
        span: Length of the backward Euler step with as much inertia [s].
        now, before: Factors of the state at the step's beginning and one step earlier.
    """

    span: float
    now: float
    before: float


def step_coefficients(dt: float, earlier: float | None) -> StepCoefficients:
    """Of a step of ``dt`` [s] after one of ``earlier`` [s]: second order, or first order without an earlier one."""
    if earlier is None:
        return StepCoefficients(dt, -1.0, 0.0)
    ratio = dt / earlier
    newest = (1.0 + 2.0 * ratio) / (1.0 + ratio)
    return StepCoefficients(dt / newest, -(1.0 + ratio) / newest, ratio**2 / (1.0 + ratio) / newest)


def step_inertia(
    positions: FloatArray, velocities: FloatArray, dt: float, earlier: EarlierStep | None = None
) -> StepInertia:
    """Inertia of a step of ``dt`` [s] from these positions [m] and velocities [m/s].

    Second order with an earlier step to look back to, first order without.
    """
    if earlier is None:
        return StepInertia(positions + dt * velocities, dt, -positions)
    c = step_coefficients(dt, earlier.dt)
    past = c.now * positions + c.before * earlier.positions
    past_velocities = c.now * velocities + c.before * earlier.velocities
    return StepInertia(-past - c.span * past_velocities, c.span, past)
