"""Columns and bits of the catalogue from measurements that are given: each flag, S/N, shapes and stars by its rule."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.instrument.chip import Window
from csstsim.measure import catalogue
from csstsim.measure.calibration.bad_pixels import BAD, FULL, RAY
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.apertures import KronFlux
from csstsim.measure.light.moments import AdaptiveShapes, CorrectedShapes, MeasuredShapes
from csstsim.measure.light.photometry import PsfFits
from csstsim.measure.source_columns import (
    BAD_PIXELS,
    BLENDED,
    KRON_FAILED,
    NEGATIVE_FLUX,
    NO_SHAPE,
    NOT_CENTRED,
    SATURATED,
    SHARP,
    TRUNCATED,
)

WINDOW = Window(1000, 1020, 3000, 3010)


@pytest.fixture
def columns(monkeypatch):
    """Function of changes to ten good sources: the columns of catalogue._sources, and what was asked for."""

    def made(**changes):
        n = 10
        given = {
            "flux": np.full(n, 100.0), "error": np.full(n, 10.0), "spread": np.zeros(n),
            "spread_error": np.full(n, 0.01), "why": np.zeros(n, int), "kron": np.full(n, 120.0),
            "kron_error": np.full(n, 12.0),
            "failed": np.zeros(n, bool),
            "sep_flag": np.zeros(n, int), "window_failed": np.zeros(n, bool), "track": np.zeros(n, bool),
            "hsm_sigma": np.ones(n),
        }  # fmt: skip
        for name, values in changes.items():
            for k, value in values.items():
                given[name][k] = value
        found = SimpleNamespace(
            x=np.linspace(-3.0, 24.0, n), y=np.linspace(12.0, -2.0, n), a=np.arange(n) + 0.5, b=np.arange(n) + 0.25,
            theta=np.arange(n) / 10, half_light=np.arange(n) + 2.0, sep_flag=given["sep_flag"],
            window_failed=given["window_failed"], window=np.ones(n), extended=np.zeros(n, bool), snr=np.full(n, 9.0),
            image=np.zeros(WINDOW.shape, np.float32), rms=np.arange(50, dtype=np.float32).reshape(5, 10),
        )  # fmt: skip
        asked = {}

        def shapes(found, bright, *rest):
            asked["bright"] = bright.tolist()
            return {"hsm_sigma": given["hsm_sigma"]}

        def errors(*arguments):
            asked["light"] = arguments[6].tolist()
            return np.full(n, 0.1)

        fit = PsfFits(
            given["flux"], given["error"], np.full(n, 1.5), given["spread"], given["spread_error"], given["why"]
        )
        cells = lambda x, y: np.where((x < 1010) & (y < 3010), 0, 1)  # noqa: E731
        model = SimpleNamespace(
            at=lambda x, y: SimpleNamespace(cell=cells(x, y)),
            enclosed=lambda radius: np.array([0.5, 0.25]) * radius,
        )
        monkeypatch.setattr(catalogue, "_fit", lambda *arguments: fit)
        kron = KronFlux(given["kron"], given["kron_error"], given["failed"])
        monkeypatch.setattr(catalogue, "kron_flux", lambda *arguments: kron)
        monkeypatch.setattr(catalogue, "aperture_flux", lambda found, counted, fraction: (fraction, 2 * fraction))
        monkeypatch.setattr(catalogue, "_shapes", shapes)
        monkeypatch.setattr(catalogue, "tracks", lambda *arguments: given["track"])
        monkeypatch.setattr(catalogue, "position_errors", errors)
        calibrated = SimpleNamespace(counted=lambda x, y: np.ones(n))
        return catalogue._sources(found, catalogue._Calibration(calibrated, None, model, WINDOW)), asked

    return made


@pytest.mark.parametrize(
    ("change", "bit"),
    [
        ({"sep_flag": 1}, BLENDED), ({"sep_flag": 2}, TRUNCATED), ({"sep_flag": 4}, 0),
        ({"why": FULL}, SATURATED), ({"why": BAD}, BAD_PIXELS),
        ({"why": RAY}, BAD_PIXELS),
        ({"why": FULL | RAY}, SATURATED | BAD_PIXELS), ({"flux": -1.0}, NEGATIVE_FLUX),
        ({"flux": 0.0}, NEGATIVE_FLUX), ({"flux": np.nan}, NEGATIVE_FLUX),
        ({"kron": -1.0}, NEGATIVE_FLUX), ({"failed": True}, KRON_FAILED),
        ({"window_failed": True}, NOT_CENTRED), ({"track": True}, SHARP),
        ({"spread": -0.061}, SHARP), ({"spread": -0.059}, 0), ({"spread": 0.5}, 0),
        ({"hsm_sigma": np.nan}, NO_SHAPE),
    ],
)  # fmt: skip
def test_each_flag_is_that_of_its_own_source(columns, change, bit):
    table, _ = columns(**{name: {3: value} for name, value in change.items()})
    assert table["flags"].tolist() == [0, 0, 0, bit, 0, 0, 0, 0, 0, 0]


def test_positions_noise_and_apertures_are_those_of_the_chip_and_of_the_cell(columns):
    """Noise of the bin of the nearest pixel; the fraction of a point within 4 px in the source's own cell."""
    table, _ = columns()
    assert table["x"].tolist() == np.linspace(997.0, 1024.0, 10).tolist()
    assert table["y"] == pytest.approx(np.linspace(3012.0, 2998.0, 10))
    column = np.clip(np.rint(np.linspace(-3.0, 24.0, 10)), 0, 19)
    row = np.clip(np.rint(np.linspace(12.0, -2.0, 10)), 0, 9)
    assert table["rms"].tolist() == (10 * (row // BIN) + column // BIN).tolist()
    inside = (table["x"] < 1010) & (table["y"] < 3010)
    assert 0 < inside.sum() < 10
    assert table["flux_aper"].tolist() == np.where(inside, 2.0, 1.0).tolist()
    assert table["flux_aper_err"].tolist() == np.where(inside, 4.0, 2.0).tolist()
    assert table["fwhm"].tolist() == (2 * np.arange(10) + 4.0).tolist() and set(table["chi2"]) == {1.5}
    for name, first in (("a", 0.5), ("b", 0.25), ("theta", 0.0)):
        assert table[name][0] == first, name


def test_signal_to_noise_and_who_has_a_shape(columns):
    """S/N 5 of the PSF, or of the Kron flux with 2.5 of the PSF; 0 without error or flux."""
    table, asked = columns(
        flux={0: 50.0, 1: 49.9, 2: 25.0, 3: 24.9, 4: np.nan, 5: -80.0, 6: 100.0},
        error={6: 0.0}, kron={1: 59.0, 2: 60.0, 3: 60.0, 4: 600.0, 5: 600.0, 6: 1.0},
    )  # fmt: skip
    assert table["snr"][:7] == pytest.approx([5.0, 4.99, 2.5, 2.49, 0.0, -8.0, 0.0])
    assert asked["bright"] == [True, False, True, False, False, False, False, True, True, True]
    assert asked["light"][4:7] == [10.0, 10.0, 100.0] and asked["light"][0] == 50.0  # at least its own error


def test_stars_are_probable_points_or_where_that_is_not_known_no_wider_than_the_psf(columns):
    table, _ = columns(spread={1: 0.034, 2: 0.036})
    assert table["star"][:3].tolist() == [True, True, False]
    given = {
        "star": np.array([True, True, False, False]), "point": np.array([0.49, np.nan, 0.5, np.nan]),
        "snr": np.full(4, 4.9), "mag_psf": np.full(4, 24.0), "flags": np.zeros(4, int),
    }  # fmt: skip
    assert catalogue._stars(given)["star"].tolist() == [False, True, True, False]


@pytest.mark.parametrize(
    ("snr", "flag", "counts"), [(5.0, 0, True), (4.9, 0, False), (9.0, 256, True), (9.0, 128, False)]
)
def test_sound_detections_tell_the_fraction_of_stars(snr, flag, counts):
    """Of fifty galaxies and a source that may be either."""
    given = {
        "star": np.zeros(51, bool), "point": np.append(np.zeros(50), 0.5), "snr": np.append(np.full(50, snr), 1.0),
        "mag_psf": np.full(51, 24.1), "flags": np.append(np.full(50, flag), 0),
    }  # fmt: skip
    assert (catalogue._stars(given)["point"][50] < 0.1) == counts


def test_errors_of_shapes_are_those_of_shears(monkeypatch):
    """Errors of distortions over 1 + sqrt(1 - e^2): 1.8 at 0.6, 2 of a round one."""
    zero = np.zeros(2)
    source = AdaptiveShapes(np.array([1.3, 2.3]), np.array([0.1, 0.3]), np.array([0.2, 0.4]), zero)
    psf = AdaptiveShapes(np.array([1.1, 1.2]), np.array([0.01, 0.03]), np.array([0.02, 0.04]), zero)
    seen = {}

    def shapes(pixels, segment, x, y, size, *rest):
        seen["size"] = size.tolist()
        return MeasuredShapes(zero, zero, source, zero, psf)

    monkeypatch.setattr(catalogue, "measure_shapes", shapes)
    corrected = CorrectedShapes(np.array([0.0, 0.6j]), np.array([0.2, 0.18]), np.array([0.4, 0.5]))
    monkeypatch.setattr(catalogue, "without_psf", lambda measured: corrected)
    found = SimpleNamespace(
        image=None, rms=None, segments=None, segment=None, x=None, y=None, a=np.array([4.0, 9.0]), b=np.ones(2)
    )
    table = catalogue._shapes(found, None, None, None, None)
    assert table["g_err"].tolist() == pytest.approx([0.1, 0.1]) and seen["size"] == [2.0, 3.0]
    wanted = {
        "hsm_sigma": [1.3, 2.3], "hsm_e1": [0.1, 0.3], "hsm_e2": [0.2, 0.4], "psf_sigma": [1.1, 1.2],
        "psf_e1": [0.01, 0.03], "psf_e2": [0.02, 0.04], "resolution": [0.4, 0.5],
    }  # fmt: skip
    for name, values in wanted.items():
        assert table[name].tolist() == values, name
