"""Integers over places and channels as bytes, each told by its size from those that are known around it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.adaptive_coding import DIGITS, INTERVAL_BYTES, SLOTS, WHOLE, BitCoder, code_integers
from .rig import IntArray

LARGEST = 1 << DIGITS
"""Integers stay below this, of either sign."""

LARGEST_RATIO = 2_000
"""Integers a byte that they are packed in, at most, beside a first million: a small file cannot ask for much."""

LONGEST_CODE = 80
"""Bytes that an integer takes at most, however unlikely it seemed."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Which integers tell of others.

    Attributes:
        order: Places, each once, shape [count].
        neighbours: Of each place, those before it in that order that are near, -1 for none, shape [count, any].
    """

    order: NDArray[np.int32]
    neighbours: NDArray[np.int32]

    @staticmethod
    def in_a_row(count: int) -> Surroundings:
        """Places one after another, such as frames."""
        return Surroundings(np.arange(count, dtype=np.int32), np.arange(-1, count - 1, dtype=np.int32)[:, None])


def encode_integers(integers: IntArray, surroundings: Surroundings) -> bytes:
    """Code integers, shape [place_count, channel_count].

    Raises:
        ValueError: If one is out of range.
    """
    if integers.size and np.abs(integers.astype(np.int64)).max() >= LARGEST:
        raise ValueError(f"An integer is not below {LARGEST}.")
    # Almost all take a small part of it.
    for room in (integers.size // 2 + 1024, LONGEST_CODE * integers.size + 1024):
        coder = _coder(np.zeros(room, np.uint8), reads=False)
        _run(coder, np.ascontiguousarray(integers.T, np.int32), surroundings)
        low, _, _, place = coder.interval.numpy().tolist()
        if place + INTERVAL_BYTES <= room:
            return coder.data.numpy()[:place].tobytes() + low.to_bytes(INTERVAL_BYTES, "big")
    raise AssertionError("No integer takes more.")


def decode_integers(data: bytes, channel_count: int, surroundings: Surroundings) -> IntArray:
    """Integers of :func:`encode_integers`.

    Raises:
        ValueError: If the data are too few for so many.
    """
    count = len(surroundings.order)
    if len(data) < INTERVAL_BYTES or math.prod((count, channel_count)) > 1_000_000 + LARGEST_RATIO * len(data):
        raise ValueError("too few bytes")
    integers = np.zeros((channel_count, count), np.int32)
    _run(_coder(np.frombuffer(data, np.uint8).copy(), reads=True), integers, surroundings)
    return integers.T


def _coder(data: NDArray[np.uint8], *, reads: bool) -> BitCoder:
    coder = BitCoder()
    interval = [0, int(WHOLE.value), 0, 0]
    if reads:
        interval[2:] = int.from_bytes(data[:INTERVAL_BYTES].tobytes(), "big"), INTERVAL_BYTES
    coder.data = wp.array(data, dtype=wp.uint8, device="cpu")
    coder.interval = wp.array(interval, dtype=wp.int64, device="cpu")
    coder.chances = wp.full(SLOTS, 32768, dtype=wp.int32, device="cpu")
    coder.seen = wp.zeros(SLOTS, dtype=wp.int32, device="cpu")
    coder.reads = reads
    return coder


def _run(coder: BitCoder, integers: NDArray[np.int32], surroundings: Surroundings) -> None:
    """Read or write integers of shape [channel_count, place_count], in place."""
    count = len(surroundings.order)
    scratch = [wp.zeros(count, dtype=wp.int32, device="cpu") for _ in range(2)]
    known = [wp.array(array, device="cpu") for array in (surroundings.order, surroundings.neighbours)]
    wp.launch(
        code_integers,
        dim=1,
        inputs=[coder, *known, *scratch],
        outputs=[wp.array(integers, dtype=wp.int32, device="cpu", copy=False)],
        device="cpu",
    )
