"""The checksums of FITS: sums of 32-bit words, and their text (FITS standard 4.0, section 4.4.2.7 and appendix J)."""

import sys

import numpy as np

from csstsim.base.types import IntArray

BLOCK = 2880  # bytes: header and data fill whole blocks
LITTLE = sys.byteorder == "little"
CHUNK = 1 << 18  # pixels converted at a time, so that they stay in the cache


def sum_of_words(words: IntArray) -> int:
    """Return the sum of 32-bit words (uint32 array)."""
    return int(words.sum(dtype=np.uint64))


def sum_of_bytes(raw: IntArray) -> int:
    """Return the sum of the big-endian 32-bit words in bytes (uint8 array); zeros complete the last word."""
    raw = np.concatenate([raw, np.zeros(-raw.size % 4, np.uint8)]) if raw.size % 4 else raw
    words = raw.view(np.uint32)
    return sum_of_words(words.byteswap() if LITTLE else words)


def folded(total: int) -> int:
    """Return a sum as a 32-bit ones' complement number: carries are added back."""
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total


def encoded(value: int) -> str:
    """Return 16 letters and digits whose four words sum to `value` (appendix J), rotated by one byte."""
    punctuation = {*range(0x3A, 0x41), *range(0x5B, 0x61)}
    text = bytearray(16)
    for i, byte in enumerate(value.to_bytes(4, "big")):
        letters = [byte // 4 + 0x30] * 4
        letters[0] += byte % 4
        while punctuation & set(letters):
            for j in (0, 2):
                if punctuation & set(letters[j : j + 2]):
                    letters[j] += 1
                    letters[j + 1] -= 1
        text[i::4] = bytes(letters)
    return (text[-1:] + text[:-1]).decode()
