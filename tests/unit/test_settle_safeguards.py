"""What settling's safeguards learn from the steps that it takes."""

import numpy as np
from wrinkle_synthesis.wrinkle_addon.settle_safeguards import LONGEST_WAIT, MOST_PATIENCE, TRIED, SettleSafeguards


def go_on(safeguards, steps, touching):
    """Whole steps whose residual stays at 2 nodal weights."""
    residual = np.full(2, 2.0)
    for _ in range(steps):
        safeguards.judge(residual, residual, safeguards.share.copy(), np.array(touching))


def test_walls_lose_their_patience_where_the_body_is_touched_in_vain_and_never_in_free_cloth():
    safeguards = SettleSafeguards(2)
    go_on(safeguards, 1 + TRIED * MOST_PATIENCE, [True, False])
    assert list(safeguards.patience) == [0, MOST_PATIENCE]


def test_the_compressive_stress_stays_for_free_cloth_on_its_way():
    safeguards = SettleSafeguards(2)
    go_on(safeguards, 1 + TRIED * MOST_PATIENCE + LONGEST_WAIT, [True, False])
    assert list(safeguards.kept) == [0.0, 1.0]
