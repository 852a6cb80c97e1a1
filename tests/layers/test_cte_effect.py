"""CTE_effect on a chip: both halves to their amplifiers, the trail in the overscan, windows, parameters."""

from dataclasses import replace

import numpy as np
import pytest
from mini import mini_camera
from readout_state import flat_state, small_camera

from csstsim.detector.channels import ReadoutFrame
from csstsim.errors import InputError
from csstsim.instrument.camera import load_camera
from csstsim.layers import cte_effect, prescan_overscan
from csstsim.rng import Streams

RNG = Streams(3, "1", 9, "cte_effect")
MANY = cte_effect.Param(density_scale=20)  # the small chip has 32 rows to a half


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return small_camera(tmp_path_factory.mktemp("mini"))


def with_spots(camera, **options):
    """A sky of 5 e- with one row of spots at the same distance from the middle in either half."""
    state = flat_state(camera, 5.0, **options)
    rows = np.arange(state.window.y0, state.window.y1)
    state.image[np.isin(rows, (22, 41))] = 20000
    return state


def test_charge_is_conserved_and_trails_away_from_the_amplifiers(small):
    state = with_spots(small)
    before = state.image.copy()
    state = cte_effect.apply(state, MANY, RNG)
    trailed = sum(trail.sum() for trail in state.trailed.parallel)
    assert [trail.shape for trail in state.trailed.parallel] == [(4, 256)] * 2
    assert before.sum() == state.image.sum() + trailed + state.header["cti_trapped"]
    assert state.header["cti_density"] == 20
    change = (state.image - before).mean(1)
    assert change[22] < -50 and change[41] < -50
    assert change[23] > 2 and change[40] > 2  # read after the spots
    assert change[21] < 0 and change[42] < 0  # read before them: sky only


def test_the_trail_lies_in_the_overscan_first_row_read_first(small):
    state = cte_effect.apply(with_spots(small), MANY, RNG)
    lower, upper = state.trailed.parallel
    state = prescan_overscan.apply(state, prescan_overscan.Param(), RNG)
    frame = ReadoutFrame.of(small.detector, None)
    assert state.trailed is None
    for block in frame.blocks:
        found, cols = state.image[block.parallel_overscan], block.image[1]
        assert np.array_equal(found, upper[::-1, cols] if block.half else lower[:, cols])
        near = found[-1] if block.half else found[0]  # mosaic row next to the half's last active row
        assert near.sum() > 0
    for block in frame.blocks:
        state.image[block.parallel_overscan] = 0
        state.image[block.active] = 0
    assert not state.image.any()


@pytest.mark.parametrize("window", [(40, 200, 10, 64), (0, 256, 33, 50), (5, 6, 0, 20)])
def test_a_window_has_the_traps_of_the_chip(small, window):
    """Where the rest of the chip holds the median charge of the window's half, both are the same bits."""
    x0, x1, y0, y1 = window
    whole = with_spots(small)
    whole.image[:y0], whole.image[y1:] = 5, 5
    part = cte_effect.apply(with_spots(small, window=window), MANY, RNG)
    whole = cte_effect.apply(whole, MANY, RNG)
    assert np.array_equal(part.image, whole.image[y0:y1, x0:x1])
    for half, (rows, trail) in enumerate(zip(((0, 32), (32, 64)), part.trailed.parallel, strict=True)):
        if y0 < rows[1] and y1 > rows[0]:
            assert np.array_equal(trail, whole.trailed.parallel[half][:, x0:x1])
        else:
            assert trail.shape == (4, x1 - x0) and not trail.any()


def test_traps_last_and_releases_do_not(small):
    """One transfer of full pixels catches the same electrons in each exposure; chips and seeds have their own traps."""

    def caught(rng):
        state = cte_effect.apply(flat_state(small, 1e5), MANY, rng)
        return state.image

    first = caught(RNG)
    assert np.array_equal(first, caught(Streams(3, "2", 9, "cte_effect")))
    for other in (Streams(3, "1", 8, "cte_effect"), Streams(4, "1", 9, "cte_effect")):
        assert not np.array_equal(first, caught(other))
    spots = [
        cte_effect.apply(with_spots(small), MANY, rng).image for rng in (RNG, RNG, Streams(3, "2", 9, "cte_effect"))
    ]
    assert np.array_equal(spots[0], spots[1])
    assert not np.array_equal(spots[0], spots[2])


def test_no_traps_no_change(small):
    state = with_spots(small)
    before = state.image.copy()
    state = cte_effect.apply(state, cte_effect.Param(density_scale=0), RNG)
    assert np.array_equal(state.image, before)
    assert state.header["cti_trapped"] == 0
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        cte_effect.Param(density_scale=-1)


def test_what_cannot_be_transferred_is_refused(small):
    state = flat_state(small)
    state.counted = np.ones(state.image.shape, np.int32)
    with pytest.raises(ValueError, match="poisson_and_dark must come before"):
        cte_effect.apply(state, cte_effect.Param(), RNG)
    state.counted, state.image[3, 3] = None, np.nan
    with pytest.raises(ValueError, match=r"1 pixel\(s\) is not finite"):
        cte_effect.apply(state, cte_effect.Param(), RNG)


def test_a_camera_without_traps(small):
    bare = replace(small, detector=replace(small.detector, traps=None))
    cte_effect.check(cte_effect.Param(), small, None)
    with pytest.raises(InputError, match=r"no cti\.yaml"):
        cte_effect.check(cte_effect.Param(), bare, None)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("[0.025, 0.105, 0.655]", "[0.025, 0.105]", "species"),
        ("[1.22, 14.02, 84.74]", "[1.22, 0, 84.74]", r"species\.timescale"),
        ("0.492", "-0.5", "beta"),
    ],
)
def test_wrong_traps_are_named(tmp_path, old, new, key):
    folder = mini_camera(tmp_path)
    path = folder / "cti.yaml"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=key):
        load_camera(folder)
    path.unlink()
    assert load_camera(folder).detector.traps is None
