"""Tables of a smooth function of a positive number, read without a logarithm: 2^BITS equal steps to each octave.

The nodes are 2^e (1 + m / 2^BITS). The bits of a float64 are e and m, so a shift gives the place in the table and the
bits below it how far to go to the next node. Linear between nodes: off by at most 2^(-2 BITS) / 8 x^2 f''(x), 4e-6 to
3e-5 of what a profile or a wing is there. Below the first and beyond the last node the value is theirs.

A compiled loop fills a line of float64 numbers, looks at it as int64 (`line.view(np.int64)`), and calls `read`.
"""

import numba
import numpy as np

BITS = 7
_SHIFT = np.int64(52 - BITS)
_BELOW = np.int64((1 << (52 - BITS)) - 1)
_STEP = 2.0 ** -(52 - BITS)


def nodes(low, high):
    """Return the nodes from 2^low to 2^high (integers)."""
    mantissa = 1 + np.arange(1 << BITS) / (1 << BITS)
    return np.append(np.ldexp(mantissa, np.arange(low, high)[:, None]).ravel(), 2.0**high)


def first_of(low):
    """Return the number of the node 2^low among all float64's, which `read` takes off."""
    return (low + 1023) << BITS


@numba.njit(inline="always")
def read(table, first, bits):
    """Return the table's value at the float64 whose bits these are; `first` of first_of, `table` on its nodes."""
    i = (bits >> _SHIFT) - first
    if i < 0:
        return table[0]
    if i >= len(table) - 1:
        return table[len(table) - 1]
    value = table[i]
    return value + (bits & _BELOW) * _STEP * (table[i + 1] - value)
