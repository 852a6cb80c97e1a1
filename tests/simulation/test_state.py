"""The state of a job: its electrons are those of both planes."""

import numpy as np
from readout_state import flat_state


def test_electrons_are_expected_and_counted(camera):
    """A million pixels of 0.1 electron: single precision would lose a hundred of them."""
    state = flat_state(camera, 0.1, window=(0, 1000, 0, 1000))
    assert abs(state.electrons() - 1e6 * float(np.float32(0.1))) < 1e-3
    state.counted = np.full(state.image.shape, 3, np.int32)
    assert abs(state.electrons() - 1e6 * (3 + float(np.float32(0.1)))) < 1e-3


def test_counted_electrons_are_a_plane_to_whoever_asks(camera):
    """Rays come as lists of pixels, into a plane or none; what a layer sees or takes is their sum."""
    pixel, electrons = np.array([3, 4, 90]), np.array([7, 1, 2], np.int32)
    for before in (None, 5):
        state = flat_state(camera, window=(0, 20, 0, 10))
        wanted = np.full(state.image.shape, before or 0, np.int32)
        wanted.reshape(-1)[pixel] += [7, 2, 2]
        state.counted = None if before is None else np.full(state.image.shape, before, np.int32)
        state.add_counted(pixel, electrons)
        state.add_counted(pixel[1:2], electrons[:1] // 7)
        assert state.electrons() == wanted.sum() and np.array_equal(state.counted, wanted)
        assert state.counted is state.counted
        assert state.take_counted() is not None and state.counted is None
