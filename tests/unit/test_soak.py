"""Bakes wilder than any artist's file: each ends in numbers that are true, or in one sentence that says where.

A seed that fails runs alone: ``pytest tests/unit/test_soak.py -k "seed_17"``.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from bake_outcomes import outcome_of
from random_bakes import GARMENTS, RANGES, random_bake


def seeds(*values: int) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("seed", values, ids=[f"seed_{seed}" for seed in values])


@seeds(*range(4))
def test_a_random_bake_ends_in_true_numbers_or_in_one_sentence(seed: int, tmp_path: Path):
    outcome_of(random_bake(seed), seed, tmp_path)


@pytest.mark.long
@seeds(*range(4, 104))
def test_a_hundred_random_bakes_end_in_true_numbers_or_in_one_sentence(seed: int, tmp_path: Path):
    outcome_of(random_bake(seed), seed, tmp_path)


@pytest.mark.long
def test_nearly_all_random_bakes_are_of_garments_that_are_not_refused_unworn():
    """Else they would say little; every kind of garment and every joint is among them."""
    worn = []
    for seed in range(4, 104):
        drawn = random_bake(seed)
        try:
            drawn.job()
        except ValueError:
            continue
        worn.append((drawn.kind, drawn.plan.grids[0].joint.name))
    assert len(worn) >= 90
    assert {kind for kind, _ in worn} == set(GARMENTS) and {joint for _, joint in worn} == set(RANGES)
