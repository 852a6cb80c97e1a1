"""A response that is the same in all pixels, for tests of the calibration."""

import numpy as np


class EvenResponse:
    """Stands for optics.throughput.response.Response of a window of `nx` columns."""

    def __init__(self, share, nx):
        self.share, self.nx = np.float32(share), nx

    def rows(self, first, last):
        return np.full((last - first, self.nx), self.share)

    def at(self, row, column):
        return np.full(len(row), self.share)
