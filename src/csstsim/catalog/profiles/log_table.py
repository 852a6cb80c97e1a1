"""Tables of a smooth function of a positive number, read without a logarithm: 2^BITS equal steps to each octave.

The nodes are 2^e (1 + m / 2^BITS). A float64 stores e and m in its bits, so a shift gives the index in the table and
the bits below it the fraction of the way to the next node. Values are linear between nodes, with an error of at most
2^(-2 BITS) / 8 x^2 f''(x), which is 4e-6 to 3e-5 of the value for profiles and wings. Outside the table the value is
that of the first or last node.

A compiled loop fills a line of float64 numbers, views it as int64 (`line.view(np.int64)`), and calls `read`.
"""

import numba
import numpy as np

from csstsim.base.types import FloatArray

BITS = 7
_SHIFT = np.int64(52 - BITS)
_BELOW = np.int64((1 << (52 - BITS)) - 1)
_STEP = 2.0 ** -(52 - BITS)


def nodes(low: int, high: int) -> FloatArray:
    """Return the nodes from 2^low to 2^high (integers)."""
    mantissa = 1 + np.arange(1 << BITS) / (1 << BITS)
    return np.append(np.ldexp(mantissa, np.arange(low, high)[:, None]).ravel(), 2.0**high)


def first_of(low: int) -> int:
    """Return the index of the node 2^low, counted over all positive float64, which `read` subtracts."""
    return (low + 1023) << BITS


@numba.njit(inline="always")
def read(table: FloatArray, first: int, bits: int) -> float:
    """Return the table's value at a float64 given as its bits; first: from first_of; table: values on the nodes."""
    i = (bits >> _SHIFT) - first
    if i < 0:
        return table[0]
    if i >= len(table) - 1:
        return table[len(table) - 1]
    value = table[i]
    return value + (bits & _BELOW) * _STEP * (table[i + 1] - value)
