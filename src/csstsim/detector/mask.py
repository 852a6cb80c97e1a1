"""Bits of the truth mask: what happened to the charge of a pixel, known because it was made to happen."""

SATURATED = 1  # charge reached the full well and overflowed
BLED = 2  # charge overflowed into it
COSMIC_RAY = 4
HOT = 8
DEAD = 16
BAD_COLUMN = 32
CLIPPED = 64  # beyond what the digits can say

BITS = {
    "SATURATED": SATURATED, "BLED": BLED, "COSMIC_RAY": COSMIC_RAY, "HOT": HOT, "DEAD": DEAD, "BAD_COLUMN": BAD_COLUMN,
    "CLIPPED": CLIPPED,
}  # fmt: skip
