"""Work in steps: it tells how far it is, can be left at any step, and gives its result, or its error, at the end."""

import pytest
from wrinkle_synthesis.wrinkle_addon.steps import Steps, describe_left, finish, portion


def counted(count: int) -> Steps[int]:
    for number in range(count):
        yield (number + 1) / count, f"step {number}"
    return count


def test_finishing_tells_every_step_and_gives_the_result():
    told = []
    assert finish(counted(4), lambda share, text: told.append((share, text))) == 4
    assert told == [(0.25, "step 0"), (0.5, "step 1"), (0.75, "step 2"), (1.0, "step 3")]


def test_a_portion_of_something_longer_tells_its_share_of_it():
    told = []
    assert finish(portion(counted(2), 0.5, 0.9), lambda share, text: told.append(share)) == 2
    assert told == pytest.approx([0.7, 0.9])


def test_the_time_left_is_told_once_it_is_more_than_a_guess():
    assert describe_left(0.05, 100.0) == describe_left(0.5, 1.0) == ""
    assert describe_left(0.5, 10.0) == ", about 10 s left"
    assert describe_left(0.25, 100.0) == ", about 5 min left"
