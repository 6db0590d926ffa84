"""Small integers as bits of just the length that they are worth: an adaptive binary range coder.

Each integer is a row of decisions (is it 0? is it 1? ... which sign?), and each decision narrows an interval by how
likely it was taken to be. How likely is learned on the way, apart for different sizes of what is known already around
the integer: what it was expected from, and the channels before at the same place. Reader and writer run the same code
on the same whole numbers, so they never disagree.

Source: range coding after Martin, "Range encoding" (1979), of binary decisions, with contexts of magnitudes as image
coders have them.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

SIZES = wp.constant(40)
"""Classes of what is known around an integer."""

STEPS = wp.constant(20)
"""Integers up to this are told step by step, larger ones by their number of digits."""

DIGITS = wp.constant(28)
"""Digits after the first that a larger integer has at most."""

INTERVAL_BYTES = 6
WHOLE = wp.constant(wp.int64((1 << 48) - 1))
"""The interval at first: 48 bits, of which the ends share none."""

ONE_BYTE = wp.constant(wp.int64(1 << 40))

SLOTS = 40 * 20 + 28 + 2 + 9
"""Decisions that are told apart: steps by class, digits, and signs by those of two neighbours."""

PATIENCE = wp.constant(250)
"""Decisions after which an old one counts as much as a new one; what is likely is never nearer to sure than this."""


@wp.struct
class BitCoder:
    """The state of a coder.

    Attributes:
        data: Bytes that are read, or written.
        interval: Low end, high end, what was read of the data, and the next byte's place, shape [4].
        chances: How likely each decision is a yes, in 1/65536, shape [SLOTS].
        seen: How often it was met, shape [SLOTS].
        reads: Whether decisions come out of the data.
    """

    data: wp.array[wp.uint8]
    interval: wp.array[wp.int64]
    chances: wp.array[wp.int32]
    seen: wp.array[wp.int32]
    reads: wp.bool


@wp.func
def coded(coder: BitCoder, decision: wp.bool, slot: wp.int32) -> wp.bool:
    """One decision, written, or read whatever is given."""
    low = wp.int64(coder.interval[0])
    high = wp.int64(coder.interval[1])
    chance = wp.int32(coder.chances[slot])
    middle = low + ((high - low) >> wp.int64(16)) * wp.int64(chance)
    yes = wp.bool(decision)
    if coder.reads:
        yes = coder.interval[2] <= middle
    target = wp.int32(0)
    if yes:
        high = middle
        target = 65536
    else:
        low = middle + wp.int64(1)
    while (low ^ high) < ONE_BYTE:
        shift_byte(coder, high)
        low = (low << wp.int64(8)) & WHOLE
        high = ((high << wp.int64(8)) & WHOLE) | wp.int64(255)
    coder.interval[0] = low
    coder.interval[1] = high
    met = wp.int32(coder.seen[slot])
    # Rounds towards what it was, so that a chance never becomes 0 or 1.
    coder.chances[slot] = chance + (target - chance) * 2 / (2 * met + 3)
    coder.seen[slot] = wp.min(met + 1, PATIENCE)
    return yes


@wp.func
def shift_byte(coder: BitCoder, high: wp.int64):
    """Both ends agree on their first byte: write it, or read on."""
    place = wp.int32(coder.interval[3])
    coder.interval[3] = wp.int64(place + 1)
    byte = wp.int64(0)
    if place < coder.data.shape[0]:
        if coder.reads:
            byte = wp.int64(coder.data[place])
        else:
            coder.data[place] = wp.uint8(high >> wp.int64(40))
    coder.interval[2] = ((coder.interval[2] << wp.int64(8)) & WHOLE) | byte


@wp.func
def coded_digits(coder: BitCoder, value: wp.int32) -> wp.int32:
    """A number from 0 on: how many digits it has when 1 is added, then those after the first (Elias gamma)."""
    count = wp.int32(0)
    while count < DIGITS:
        if not coded(coder, ((value + 1) >> (count + 1)) > 0, SIZES * STEPS + count):
            break
        count += 1
    number = wp.int32(1)
    for k in range(count):
        digit = ((value + 1) >> (count - 1 - k)) & 1
        number = 2 * number
        if coded(coder, digit == 1, SIZES * STEPS + DIGITS + wp.min(k, 1)):
            number += 1
    return number - 1


@wp.func
def size_class(size: wp.int32) -> wp.int32:
    """From 0 to SIZES - 1, by eights at first, then four classes for each doubling."""
    if size < 8:
        return size
    doublings = wp.int32(0)
    left = wp.int32(size)
    while left >= 16:
        left = left >> 1
        doublings += 1
    return wp.min(8 + 4 * doublings + ((left - 8) >> 1), SIZES - 1)


@wp.kernel
def code_integers(
    coder: BitCoder,
    order: wp.array[wp.int32],
    neighbours: wp.array2d[wp.int32],
    near: wp.array[wp.int32],
    far: wp.array[wp.int32],
    # inputs when written, outputs when read
    integers: wp.array2d[wp.int32],
):
    """Integers [channel_count, row_count], channel by channel, the rows in the given order; one thread does it all.

    Args:
        neighbours: Rows before each one in that order by which its size is guessed, -1 for none.
        near, far: Scratch: sizes in the channels before, over a few and over a dozen, in 1/16; zeros at first.
    """
    for channel in range(integers.shape[0]):
        for place in range(order.shape[0]):
            row = order[place]
            around = wp.int32(0)
            found = wp.int32(0)
            signs = wp.int32(0)
            for k in range(neighbours.shape[1]):
                neighbour = neighbours[row, k]
                if neighbour >= 0:
                    other = integers[channel, neighbour]
                    around += 16 * wp.min(wp.abs(other), 64)
                    found += 1
                    if k < 2:
                        signs = 3 * signs + wp.sign(other) + 1
            around = around / wp.max(found, 1)
            first = size_class((around + near[row] + far[row]) >> 2) * STEPS
            value = wp.int32(integers[channel, row])
            size = wp.int32(0)
            while size < STEPS:
                if not coded(coder, wp.abs(value) > size, first + size):
                    break
                size += 1
            if size == STEPS:
                size += coded_digits(coder, wp.abs(value) - STEPS)
            integers[channel, row] = size
            if size > 0:
                if coded(coder, value < 0, SIZES * STEPS + DIGITS + 2 + signs):
                    integers[channel, row] = -size
            size = 16 * wp.min(size, 64)
            near[row] = near[row] + (size - near[row]) / 3
            far[row] = far[row] + (size - far[row]) / 12
