"""Integers in bytes: they come back whatever they are, take what they are worth, and nothing hostile runs away."""

import numpy as np
import pytest
from wrinkle_synthesis.wrinkle_addon.adaptive_code import (
    LARGEST,
    LARGEST_RATIO,
    Surroundings,
    decode_integers,
    encode_integers,
)


def back_and_forth(integers: np.ndarray, around: Surroundings | None = None) -> np.ndarray:
    around = around or Surroundings.in_a_row(len(integers))
    return decode_integers(encode_integers(integers, around), integers.shape[1], around)


@pytest.mark.parametrize("largest", [0, 1, 19, 20, 21, 22, 30_000, LARGEST - 1])
def test_integers_of_any_size_come_back(largest: int):
    values = np.random.default_rng(3).integers(-largest, largest + 1, (70, 11)).astype(np.int32)
    values[0, :2] = -largest, largest
    assert np.array_equal(back_and_forth(values), values)


def test_places_may_come_in_any_order_and_none_may_have_neighbours():
    random = np.random.default_rng(4)
    order = random.permutation(50).astype(np.int32)
    neighbours = np.full((50, 3), -1, np.int32)
    # Each knows up to two of those before it.
    for place in range(3, 50):
        neighbours[order[place], :2] = order[random.integers(0, place, 2)]
    values = random.integers(-3, 4, (50, 6)).astype(np.int32)
    assert np.array_equal(back_and_forth(values, Surroundings(order, neighbours)), values)


def test_nothing_is_coded_in_next_to_nothing():
    assert back_and_forth(np.zeros((0, 0), np.int32)).shape == (0, 0)
    assert back_and_forth(np.zeros((5, 0), np.int32)).shape == (5, 0)
    assert len(encode_integers(np.zeros((1000, 100), np.int32), Surroundings.in_a_row(1000))) < 100


def test_what_is_unlikely_takes_little_more_than_its_information():
    random = np.random.default_rng(5)
    values = (random.random((400, 200)) < 0.1).astype(np.int32) * random.choice([-1, 1], (400, 200)).astype(np.int32)
    # A coin that falls so one time in ten, and a sign then.
    bits = values.size * (-0.1 * np.log2(0.1) - 0.9 * np.log2(0.9) + 0.1)
    # Nothing around tells of these, and what is learned from is not whole yet at first.
    assert len(encode_integers(values, Surroundings.in_a_row(400))) < 1.04 * bits / 8


def test_large_integers_beside_large_ones_take_less_than_scattered_ones():
    random = np.random.default_rng(6)
    values = np.zeros((1000, 20), np.int32)
    values[:200] = random.integers(-20, 21, (200, 20))
    apart = random.permutation(values)
    around = Surroundings.in_a_row(1000)
    assert len(encode_integers(values, around)) < 0.9 * len(encode_integers(apart.reshape(values.shape), around))


def test_integers_out_of_range_are_refused():
    with pytest.raises(ValueError, match="not below"):
        encode_integers(np.array([[-LARGEST]]), Surroundings.in_a_row(1))


def test_damaged_data_give_other_integers_but_never_fail():
    values = np.random.default_rng(7).integers(-9, 9, (60, 30)).astype(np.int32)
    around = Surroundings.in_a_row(60)
    data = encode_integers(values, around)
    for hostile in (data[:20], data[:6], b"\xff" * 40, b"\0" * 40, data[::-1]):
        assert decode_integers(hostile, 30, around).shape == (60, 30)


def test_a_few_bytes_cannot_ask_for_much_memory():
    around = Surroundings.in_a_row(1000)
    with pytest.raises(ValueError):
        decode_integers(bytes(10), 2 * LARGEST_RATIO, around)
    with pytest.raises(ValueError):
        decode_integers(b"", 1, around)
