"""The readout frame made in the image's own memory is the one made anew, for windows on every side of every seam."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.embedding import embedded

NX, NY = 32, 84
CHIP = {
    "nx": NX, "ny": NY, "channels_x": 8, "channels_y": 2, "channel_nx": 4, "channel_ny": 42,
    "prescan": 2, "overscan": 3, "parallel_overscan": 2,
}  # fmt: skip


def frame_of(x, y, **changes):
    return ReadoutFrame(window=(*sorted(x), *sorted(y)), **(CHIP | changes))


def numbered(shape, dtype):
    return (1 + np.arange(shape[0] * shape[1]).reshape(shape) % 250).astype(dtype)


def sides(most):
    return st.lists(st.integers(0, most), min_size=2, max_size=2, unique=True)


@settings(max_examples=200, deadline=None)
@given(sides(NX), sides(NY), st.sampled_from([np.float32, np.uint8]), st.integers(0, 2))
def test_same_frame_in_the_same_memory(x, y, dtype, scan):
    readout = frame_of(x, y, prescan=scan, parallel_overscan=2 * scan)
    window = max(y) - min(y), max(x) - min(x)
    wanted = readout.embed(numbered(window, dtype))
    planes = [numbered(window, dtype).copy()]
    found = embedded(planes, readout)
    assert found.dtype == dtype and np.array_equal(found, wanted) and found.base is None


def test_no_second_plane_is_made():
    """The memory of a frame of 100,000 columns is the image's, grown; only its scans are added."""
    import tracemalloc

    readout = frame_of((0, 100_000), (0, NY), nx=100_000, channel_nx=12_500)
    planes = [np.ones((NY, 100_000), np.float32)]
    size = planes[0].nbytes
    tracemalloc.start()
    try:
        embedded(planes, readout)
        assert tracemalloc.get_traced_memory()[1] < 1.5 * size  # of the frame; a copy has both
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("keep", [lambda image: image, lambda image: image[1:], lambda image: image.reshape(-1)])
def test_an_image_that_others_use_stays_as_it_is(keep):
    readout = frame_of((0, NX), (0, NY))
    planes = [numbered((NY, NX), np.float32).copy()]
    used = keep(planes[0])
    before = used.copy()
    assert np.array_equal(embedded(planes, readout), readout.embed(numbered((NY, NX), np.float32)))
    assert np.array_equal(used, before)
