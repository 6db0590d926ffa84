"""What keeps Newton's method from going astray on its way to the equilibrium of cloth in contact.

Mass, as in a time step without velocity that grows; and leaving out the compressive stress, which makes the Hessian
indefinite on the way but without which the last part of it is slow. Both fade while full steps do not raise the
residual. Mass comes back faster than it fades, so that steps that go back and forth between two walls get smaller.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .cloth_model import FloatArray

FIRST_SPAN, SHORTEST_SPAN, LONGEST_SPAN = 1.0 / 15.0, 1.0 / 240.0, 1.0e3
"""The time step that gives mass [s], at first and at its bounds."""

RESTLESS_SPAN = 16.0
"""The longest one of a restless garment whose patience is over [s]: next to no mass, and yet near to one that helps."""

MASSLESS_SPAN = 10.0
"""A time step this long [s] has next to no inertia against the stiffness of any fabric."""

HEAVY_SPAN = 0.02
"""Below this time step [s] a garment is as heavy as helps."""

RESTLESS = 1.0
"""Residual above which a garment is not at rest [nodal weights]: what Wang et al. (2010) ask for."""

LONGEST_WAIT = 8
"""So many steps in vain on end, and with no patience left the compressive stress is left out again."""

MOST_PATIENCE, TRIED = 4, 5
"""How much contact that comes out of nothing a vertex bears at first, and after how many steps in vain less by one."""

MOST_GROWTH = 1.1
"""A step that lets the residual grow by more than this went too far."""


class SettleSafeguards:
    """The safeguards of every world, shape [world_count].

    Attributes:
        span: The time step whose inertia the system holds [s].
        share: Most of its step that a world takes.
    """

    def __init__(self, world_count: int):
        self.span: FloatArray = np.full(world_count, FIRST_SPAN)
        self.share: FloatArray = np.ones(world_count)
        self._trust: FloatArray = np.zeros(world_count)
        self._lowest: FloatArray = np.full(world_count, np.inf)
        self._waiting, self._in_vain = np.zeros(world_count, int), np.zeros(world_count, int)

    @property
    def kept(self) -> FloatArray:
        """Share of the compressive stress that stays in the Hessian; none as long as mass is what helps, or where it
        has led nowhere for long: with it, steps are longer than can be trusted."""
        wandering = (self._waiting >= LONGEST_WAIT) & (self.patience == 0)
        return np.where(self._massless & ~wandering, self._trust, 0.0)

    @property
    def patience(self) -> NDArray[np.int32]:
        """How much contact that comes out of nothing a vertex bears.

        On the way walls are met and lost, and every one counts. But where the residual does not fall, what springs upon
        a vertex is not met but found, now here and now there, where limbs of the body pass through each other.
        """
        return np.maximum(MOST_PATIENCE - self._in_vain // TRIED, 0).astype(np.int32)

    @property
    def _massless(self) -> NDArray[np.bool_]:
        return self.span >= MASSLESS_SPAN

    def judge(self, before: FloatArray, after: FloatArray, taken: FloatArray, touching: NDArray[np.bool_]) -> None:
        """Learn from a step.

        Args:
            before, after: The residual on both sides of it.
            taken: The share of the step that the line search left.
            touching: Whether the body is touched: its planes are found anew between steps, out of the line search's
                sight.
        """
        # Free cloth has no walls that spring up: where its residual grows, it is on its way.
        fruitless = (after >= self._lowest) & (after > RESTLESS) & touching
        self._waiting = np.where(fruitless, self._waiting + 1, 0)
        self._in_vain += fruitless
        self._lowest = np.minimum(after, self._lowest)
        far = (after > MOST_GROWTH * before) & touching
        well = (taken == self.share) & ~far
        grown = np.where(self._massless, np.minimum(self._trust + 0.2, 1.0), self._trust)
        self._trust = np.where(well, grown, 0.5 * self._trust)
        longest = np.where((after > RESTLESS) & (self.patience == 0), RESTLESS_SPAN, LONGEST_SPAN)
        longer, shorter = np.minimum(2.0 * self.span, longest), np.maximum(0.25 * self.span, SHORTEST_SPAN)
        self.span = np.where(well, longer, shorter)
        # No mass is heavy against a wall: what goes back and forth between two goes half the way back.
        self.share = np.where(far & (self.span < HEAVY_SPAN), 0.5, 1.0)
