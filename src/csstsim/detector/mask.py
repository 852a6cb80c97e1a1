"""Bits of the truth mask: which simulated effects changed the charge of a pixel."""

SATURATED = 1
BLED = 2
COSMIC_RAY = 4
HOT = 8
DEAD = 16
BAD_COLUMN = 32
CLIPPED = 64

BITS = {
    "SATURATED": SATURATED,
    "BLED": BLED,
    "COSMIC_RAY": COSMIC_RAY,
    "HOT": HOT,
    "DEAD": DEAD,
    "BAD_COLUMN": BAD_COLUMN,
    "CLIPPED": CLIPPED,
}

ABOUT = {
    SATURATED: "charge reached the full well and overflowed",
    BLED: "charge overflowed into it",
    COSMIC_RAY: "5 e- or more of a cosmic ray",
    HOT: "hot pixel",
    DEAD: "dead pixel",
    BAD_COLUMN: "in a bad column",
    CLIPPED: "outside the range of the digits",
}
