"""Search in a column's packets of charge (detector.charge_transfer.cti) without visiting each packet: the next packet
that reaches a level, and the n-th below it.

Blocks and super-blocks store bounds on their charge, so that those entirely above or below the level are skipped. In
other blocks packets are visited one by one or, near the sky level, eight at once: a byte of each packet holds its
charge above `base`, from 0 to 127, and one subtraction compares eight of them with a level. All numbers are integers,
and the results are those of a plain loop.
"""

from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import IntArray

# log2 of the packets in a block and in a super-block
_BLOCK = 5
_SUPER = 9
# Rows of the table: bounds (maximum, minimum) of the charge in blocks, and in super-blocks
_MAXIMUM, _MINIMUM, _MAXIMUM_SUPER, _MINIMUM_SUPER = range(4)
_BELOW_SKY = 32  # electrons from `base` to the mean of the blocks' minimum charge
_BYTE_MAX = 127
_ONES = np.uint64(0x0101010101010101)
_TOPS = np.uint64(0x8080808080808080)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
_U1 = np.uint64(1)
_U7 = np.uint64(7)
_U56 = np.uint64(56)


class Search(NamedTuple):
    """Arrays for the search among n packets. Functions take them one by one.

    numba needs atomic operations at each use of a tuple of arrays.
    """

    table: IntArray  # int32, rows _MAXIMUM ... _MINIMUM_SUPER, a column for each block or super-block
    words: IntArray  # (n / 8,) uint64: `small`, eight bytes in a word
    small: IntArray  # (n,) uint8: the packets' bytes, in the memory of `words`


@numba.njit(cache=True)
def padded(n: int) -> int:
    """Return the length of the arrays for n packets: a whole number of super-blocks."""
    return (((n - 1) >> _SUPER) + 1) << _SUPER


@numba.njit(cache=True)
def search_arrays(n: int) -> Search:
    """Return the Search among n packets, n from `padded`: arrays (4, n / 32), (n / 8,) and (n,)."""
    words = np.empty(n >> 3, np.uint64)
    return Search(np.empty((4, n >> _BLOCK), np.int32), words, words.view(np.uint8))


@numba.njit(cache=True)
def set_up(charge: IntArray, table: IntArray, small: IntArray) -> int:
    """Prepare the search among `charge` (int32 [e-], of padded length, -1 after the last packet); return `base`."""
    maximum = table[_MAXIMUM]
    minimum = table[_MINIMUM]
    table[_MAXIMUM_SUPER], table[_MINIMUM_SUPER] = -1, np.iinfo(np.int32).max
    total = 0
    charged_blocks = 0
    for block in range(len(maximum)):
        maximum_charge = minimum_charge = charge[block << _BLOCK]
        for k in range(block << _BLOCK, (block + 1) << _BLOCK):
            maximum_charge = max(maximum_charge, charge[k])
            minimum_charge = min(minimum_charge, charge[k])
        maximum[block] = maximum_charge
        minimum[block] = minimum_charge
    for block in range(len(maximum)):  # a separate loop, so that the compiler can vectorise the one above
        minimum_charge = minimum[block]
        group = block >> (_SUPER - _BLOCK)
        table[_MAXIMUM_SUPER, group] = max(table[_MAXIMUM_SUPER, group], maximum[block])
        table[_MINIMUM_SUPER, group] = min(table[_MINIMUM_SUPER, group], minimum_charge)
        total += max(minimum_charge, 0)
        charged_blocks += minimum_charge > 0
    base = max(total // max(charged_blocks, 1) - _BELOW_SKY, 0)
    for k in range(len(charge)):
        small[k] = min(max(charge[k] - base, 0), _BYTE_MAX)
    return base


@numba.njit(inline="always")
def add(charge: IntArray, table: IntArray, small: IntArray, base: int, k: int, electrons: int) -> None:
    """Add `electrons` to packet k; the bounds stay valid, but may not be the tightest."""
    value = charge[k] + electrons
    charge[k] = value
    small[k] = min(max(value - base, 0), _BYTE_MAX)
    block = k >> _BLOCK
    group = k >> _SUPER
    if value < table[_MINIMUM, block]:
        table[_MINIMUM, block] = value
        table[_MINIMUM_SUPER, group] = min(table[_MINIMUM_SUPER, group], value)
    elif value > table[_MAXIMUM, block]:
        table[_MAXIMUM, block] = value
        table[_MAXIMUM_SUPER, group] = max(table[_MAXIMUM_SUPER, group], value)


@numba.njit(inline="always")
def first_reaching(charge: IntArray, table: IntArray, words: IntArray, base: int, k: int, level: int) -> int:
    """Return the index of the first packet at or after k with at least `level` electrons (>= 1), or the end."""
    end = len(charge)
    while k < end:
        block = k >> _BLOCK
        group = k >> _SUPER
        stop = (block + 1) << _BLOCK
        if table[_MAXIMUM, block] < level:
            k = (group + 1) << _SUPER if table[_MAXIMUM_SUPER, group] < level else stop
        elif 1 <= level - base <= _BYTE_MAX:
            while k < stop:
                reaching = _reaching(words[k >> 3], level - base, k)
                if reaching:
                    return ((k >> 3) << 3) + _byte_number(reaching)
                k = ((k >> 3) + 1) << 3
        else:
            while k < stop:
                if charge[k] >= level:
                    return k
                k += 1
    return end


@numba.njit(inline="always")
def nth_below(charge: IntArray, table: IntArray, words: IntArray, base: int, k: int, level: int, n: int) -> int:
    """Return the index of the n-th packet (n from 1) at or after k with fewer than `level` electrons, or the end."""
    end = len(charge)
    while k < end:
        block = k >> _BLOCK
        group = k >> _SUPER
        stop = (block + 1) << _BLOCK
        if table[_MINIMUM, block] >= level:
            k = (group + 1) << _SUPER if table[_MINIMUM_SUPER, group] >= level else stop
        elif table[_MAXIMUM, block] < level:
            if table[_MAXIMUM_SUPER, group] < level:
                stop = (group + 1) << _SUPER
            if n <= stop - k:
                return k + n - 1
            n -= stop - k
            k = stop
        elif 1 <= level - base <= _BYTE_MAX:
            while k < stop:
                below = _reaching(words[k >> 3], level - base, k) ^ (_TOPS & _from(k))
                count = np.int64(((below >> _U7) * _ONES) >> _U56)
                if n <= count:
                    for _ in range(n - 1):
                        below &= below - _U1
                    return ((k >> 3) << 3) + _byte_number(below)
                n -= count  # type: ignore[assignment] # an int64 is an int to numba
                k = ((k >> 3) + 1) << 3
        else:
            while k < stop:
                n -= charge[k] < level
                if n == 0:
                    return k
                k += 1
    return end


@numba.njit(inline="always")
def _from(k: int) -> np.uint64:
    """Return a mask of the bytes of packet k and of those after it in its word."""
    return _ALL << np.uint64((k & 7) << 3)


@numba.njit(inline="always")
def _reaching(eight: np.uint64, level: int, k: int) -> np.uint64:
    """Return a word with the top bit set in each byte, from that of k on, that is at least `level` (1 to 127)."""
    return ((eight | _TOPS) - np.uint64(level) * _ONES) & (_TOPS & _from(k))


@numba.njit(inline="always")
def _byte_number(bits: np.uint64) -> int:
    """Return the number of the byte with the lowest of the set top bits: (lowest bit - 1) fills the bytes below it."""
    lowest = bits & (~bits + _U1)
    number = (((lowest - _U1) >> _U7 & _ONES) * _ONES) >> _U56
    return np.int64(number)  # type: ignore[return-value] # an int64 is an int to numba
