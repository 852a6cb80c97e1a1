"""Peaks and isophotes become one list: each rule of measure.detection.combine by hand."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.measure.detection import combine
from csstsim.measure.detection.detect import Sources
from csstsim.measure.detection.mirrored import Smoothed
from csstsim.measure.light.photometry import PsfFits


class Stars(SimpleNamespace):
    def __len__(self):
        return len(self.x)


NO_STARS = Stars(x=np.zeros(0), y=np.zeros(0), flux=np.zeros(0))


def sources(x, segment, **more):
    n = len(x)
    columns = {f.name: np.arange(n) + 100.0 * k for k, f in enumerate(fields(Sources))}
    columns |= {"x": np.array(x, float), "y": np.zeros(n), "segment": np.array(segment, int)}
    columns |= {"area": np.full(n, 100.0), "window_failed": np.zeros(n, bool)}
    return Sources(**(columns | {name: np.array(values) for name, values in more.items()}))


def fits_of(flux, spread):
    """Return the PsfFits of peaks, spread known to 0.01."""
    n = len(flux)
    spread = np.array(spread, float)
    return PsfFits(np.array(flux, float), np.ones(n), np.ones(n), spread, np.full(n, 0.01), np.zeros(n, int))


def frame_of(extended, stars=NO_STARS, rms=2.0):
    return SimpleNamespace(
        extended=extended, stars=stars, image=np.zeros((64, 64), np.float32), rms=np.full((64, 64), rms, np.float32),
        segments=np.zeros((32, 32), np.int32),
    )  # fmt: skip


DARK = Smoothed(np.zeros((1, 64), np.float32), np.ones((1, 64), np.float32), 1.0, 1.0)


def distinct(x, *, own=(), local=(), narrow=(), broad=(), flux=None, segment=None, order=None, smoothed=DARK):
    n = len(x)
    own, narrow, broad = (np.isin(np.arange(n), some) for some in (own, narrow, broad))
    local = np.array(local) if len(local) else np.full(n, 100.0)
    flux = np.full(n, 1000.0) if flux is None else np.array(flux)
    return combine._is_source.py_func(
        np.array(x, float), np.zeros(n), np.ones(n, int) if segment is None else np.array(segment),
        np.arange(n) if order is None else np.array(order),
        combine._Evidence(own, np.full(n, 50.0), flux, local, narrow, broad), smoothed,
    ).tolist()  # fmt: skip


def test_peaks_off_isophotes_are_sources():
    assert distinct([0.0, 1.0], segment=[0, 0]) == [True, True]
    assert distinct([], segment=np.zeros(0, int)) == []


@pytest.mark.parametrize(
    ("x", "rule", "kept"),
    [
        (11.9, {"narrow": [1]}, True),  # near one: by the PSF's shape, 2% of its flux
        (11.9, {"broad": [1]}, False),
        (12.1, {"broad": [1]}, True),  # further off a wide one will do
        (11.9, {"narrow": [1], "local": [0, 20.1]}, True),
        (11.9, {"narrow": [1], "local": [0, 19.9]}, False),
        (12.1, {"narrow": [1], "local": [0, 19.9]}, True),
        (5.0, {}, False),
        (50.0, {}, False),
    ],
)
def test_other_peaks_of_an_isophote_stand_out_from_their_surroundings(x, rule, kept):
    assert distinct([0.0, x], own=[0], **rule) == [True, kept]


def test_a_peak_is_compared_with_all_that_are_kept_on_its_isophote_and_no_other():
    """The second is 2% of the first, not of the third, which is on another isophote; of two near ones each counts."""
    x, flux = [0.0, 6.0, 12.0], [1000.0, 9000.0, 1.0]
    assert distinct(x, own=[0, 1], segment=[1, 2, 1], narrow=[2], local=[0, 0, 21], flux=flux) == [True, True, True]
    assert distinct([0.0, 6.0, 11.0], own=[0, 1], narrow=[2], local=[0, 0, 100], flux=flux) == [True, True, False]
    assert distinct([0.0, 6.0, 11.0], own=[0], narrow=[2], local=[0, 0, 100], flux=flux) == [True, False, True]
    first = [9000.0, 1000.0, 1.0]  # the one that was kept before the last counts, too
    assert distinct([0.0, 6.0, 11.0], own=[0, 1], narrow=[2], local=[0, 0, 100], flux=first) == [True, True, False]
    assert distinct([0.0, 6.0], own=[1], broad=[0], order=[1, 0]) == [False, True]
    assert distinct([0.0, 6.0], own=[1], order=[0, 1]) == [False, True]  # as high as its main peak


@pytest.mark.parametrize(
    ("there", "mirrored", "flux", "kept"),
    [
        (100.0, 0.0, 1000.0, True),
        (100.0, 100.0, 1000.0, False),
        (0.0, 100.0, 1000.0, False),
        (100.0, 63.0, 1000.0, False),  # by 37: 2.9 sigma of 100 + 63 + 2
        (100.0, 60.0, 1000.0, True),  # by 40: 3.1 sigma
        (100.0, 40.0, 2950.0, True),  # by 60: 2% of 3000
        (100.0, 40.0, 3050.0, False),
    ],
)
def test_a_peak_that_the_other_side_of_a_source_lacks_is_a_source(there, mirrored, flux, kept):
    image = np.zeros((1, 64), np.float32)
    image[0, [26, 34]] = mirrored, there
    smoothed = Smoothed(image, np.ones((1, 64), np.float32), 0.3, 1.0)  # one pixel each
    assert distinct([30.0, 34.0], own=[0], local=[0, 0], flux=[flux, 1.0], smoothed=smoothed) == [True, kept]


def test_a_peak_is_compared_with_the_other_sides_of_all_sources_of_its_isophote():
    """As bright as what is opposite of it seen from either of two sources, whichever comes first."""
    image = np.zeros((1, 64), np.float32)
    image[0, [24, 34]] = 100.0  # about 29, a source; 34 is alone about the other, at 44
    smoothed = Smoothed(image, np.ones((1, 64), np.float32), 0.3, 1.0)
    for places in ([29.0, 44.0, 34.0], [44.0, 29.0, 34.0]):
        assert distinct(places, own=[0, 1], local=[0, 0, 0], smoothed=smoothed) == [True, True, False]
    assert distinct([29.0, 44.0, 34.0], own=[0, 1], segment=[2, 1, 1], smoothed=smoothed) == [True, True, True]


def test_sources_are_measured_again_on_the_image_as_it_is():
    """A Gaussian half a pixel from where a source was found; one 3 px away is another one."""
    y, x = np.mgrid[:64, :64]
    image = np.exp(-0.5 * ((x - 30.5) ** 2 + (y - 32.0) ** 2) / 4).astype(np.float32) * 1000
    found = sources([30.0, 33.5, 50.0], [0, 0, 0], a=np.full(3, 2.0), window=np.full(3, 1.0))
    columns = {f.name: getattr(found, f.name) for f in fields(Sources)} | {"y": np.full(3, 32.0)}
    listed = combine.Detections(
        **columns, extended=np.zeros(3, bool), snr=np.arange(3.0), image=image, rms=image, segments=image
    )
    again = listed.rows(np.array([2, 0, 1])).again()
    assert again.snr.tolist() == [2.0, 0.0, 1.0] and again.x[[0, 2]].tolist() == [50.0, 33.5]
    assert again.x[1] == pytest.approx(30.5, abs=0.01) and again.y[1] == pytest.approx(32.0, abs=0.01)
    assert again.half_light[1] == pytest.approx(2 * np.sqrt(2 * np.log(2)), rel=0.05)


@pytest.mark.parametrize(
    ("change", "extended"),
    [
        ({}, False),
        ({"flux": 1300.0 + 1}, True),  # a third beyond the points'
        ({"flux": 1299.0}, False),
        ({"spread": 0.036}, True),  # more than 0.01 and 2.5 errors
        ({"spread": 0.034}, False),
        ({"kept": False}, True),  # its peak is no source: nothing is explained
        ({"top": -1}, True),
    ],
)
def test_an_isophote_is_extended_where_points_do_not_explain_it(change, extended):
    """Light of 1000 of a point with a spread of 0.01 +- 0.01; noise 2 e- a pixel on 100 px."""
    isophotes = sources([20.0], [1], flux=[float(change.get("flux", 1000.0))])
    peaks = sources([20.0, 40.0], [1, 0])
    fit = fits_of([1000.0, 5e5], [change.get("spread", 0.01), 9.0])
    kept, top = np.array([change.get("kept", True), True]), np.array([change.get("top", 0)])
    assert combine._is_extended(frame_of(isophotes), peaks, fit, top, kept).tolist() == [extended]


@pytest.mark.parametrize(("excess", "extended"), [(1.05, True), (0.95, False)])
def test_light_beyond_the_points_is_more_than_its_noise(excess, extended):
    """Three sigma of 50 e- on 400 px of 2 e-: sqrt(f + 1600)."""
    flux = 10 + excess * 3 * np.sqrt(50 + 1600 + 80)
    isophotes = sources([20.0], [1], flux=[flux], area=[400.0])
    fit = fits_of([10.0], [0.0])
    found = combine._is_extended(frame_of(isophotes), sources([20.0], [1]), fit, np.array([0]), np.ones(1, bool))
    assert found.tolist() == [extended]


def test_an_isophote_on_a_bright_star_is_no_source():
    stars = Stars(x=np.array([20.0]), y=np.array([0.0]), flux=np.array([1e6]))
    isophotes = sources([22.0, 40.0], [1, 2], flux=[4e4, 4e4])
    found = combine._is_extended(
        frame_of(isophotes, stars), sources([], []), fits_of([], []), np.full(2, -1), np.zeros(0, bool)
    )
    assert found.tolist() == [False, True]


@pytest.mark.parametrize(("away", "snr", "moved"), [(0.65, 5.1, True), (0.55, 5.1, False), (0.65, 4.9, False)])
def test_an_extended_source_stands_at_its_peak_if_that_is_bright_and_apart(away, snr, moved):
    """Peaks that are kept come first, then isophotes with all of their own columns and segments."""
    isophotes = sources([20.0, 40.0, 60.0], [0, 0, 0], window=[7.0, 8.0, 9.0])
    peaks = sources(
        [10.0, 40.0 + away, 50.0, 70.0], [0, 2, 0, 5], window=[1.0, 2.0, 3.0, 4.0],
        window_failed=[False, True, False, False],
    )  # fmt: skip
    top, kept = np.array([-1, 1, -1]), np.array([True, False, True, True])
    found = combine._one_list(
        frame_of(isophotes), peaks, np.array([30.0, snr, 40.0, 35.0]), top, kept, np.array([True, True, False])
    )
    assert found.x.tolist() == [10.0, 50.0, 70.0, 20.0, 40.0 + away if moved else 40.0]
    assert found.window.tolist() == [1.0, 3.0, 4.0, 7.0, 2.0 if moved else 8.0]
    assert found.window_failed.tolist() == [False, False, False, False, moved]
    assert found.segment.tolist() == [0, 0, 5, 1, 2] and found.extended.tolist() == [False] * 3 + [True] * 2
    assert found.snr.tolist() == [30.0, 40.0, 35.0, 0.0, snr]
    assert found.half_light.tolist() == [500.0, 502.0, 503.0, 500.0, 501.0]
