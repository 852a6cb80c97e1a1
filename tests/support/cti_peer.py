"""A spot in a column after arcticpy's transfer (csstsim.studies.bench.readout.arctic), for the tests.

docs/detector_cti.md says why `overscan_start` is set.
"""

import numpy as np

from csstsim.studies.bench.readout.arctic import arctic

SKY, SPOT, SPOT_ROWS, BEHIND = 40, 5000, 3, 198
COLUMN_ROWS = ((0, 3), (3, 11), (11, 51), (51, 201))  # the spot and three parts of its trail, rows from its first

# {row of the spot: electrons that it adds to COLUMN_ROWS once transferred}; arctic_spot with the paper's traps
TAILS = {
    147: (-26.11, 4.34, 9.38, 10.44),
    1000: (-176.63, 29.15, 63.08, 70.27),
    4000: (-705.97, 115.85, 251.63, 281.15),
}


def spot_column(row, spot=True):
    """Return a column (float32) of sky with a spot at `row`, or without it."""
    column = np.full(row + SPOT_ROWS + BEHIND, SKY, np.float32)
    if spot:
        column[row : row + SPOT_ROWS] = SPOT
    return column


def arctic_spot(row, density, timescale, well):
    """Return the electrons that a spot adds to COLUMN_ROWS."""
    change = 0.0
    for spot, sign in ((True, 1), (False, -1)):
        column = spot_column(row, spot)
        moved = arctic(column, density, timescale, well, overscan_start=row + SPOT_ROWS)
        change = change + sign * (moved - column)
    return [float(change[row + a : row + b].sum()) for a, b in COLUMN_ROWS]
