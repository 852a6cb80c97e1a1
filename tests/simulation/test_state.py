"""The state of a job: its electrons are those of both planes."""

import numpy as np
from readout_state import flat_state


def test_electrons_are_expected_and_counted(camera):
    """A million pixels of 0.1 electron: single precision would lose a hundred of them."""
    state = flat_state(camera, 0.1, window=(0, 1000, 0, 1000))
    assert abs(state.electrons() - 1e6 * float(np.float32(0.1))) < 1e-3
    state.counted = np.full(state.image.shape, 3, np.int32)
    assert abs(state.electrons() - 1e6 * (3 + float(np.float32(0.1)))) < 1e-3
