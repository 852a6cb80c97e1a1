"""Point sources of known flux: completeness, flux and position of the measured catalogue."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.measure import source_columns

CRAFT = observer(61577.858, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))  # as conftest has it


def matched(star_field):
    x, y, flux, snr, table = star_field
    distance, row = cKDTree(np.column_stack([table["x"], table["y"]])).query(np.column_stack([x, y]))
    return flux, snr, distance < 2.5, row, table


def test_stars_above_snr_5_are_found(star_field):
    _, snr, found, _, _ = matched(star_field)
    assert found[snr > 5].mean() > 0.99  # 2900 stars
    edge = (snr > 5) & (snr < 6)
    assert edge.sum() > 80 and found[edge].mean() > 0.95


def test_false_detections_are_few_and_faint(star_field):
    x, y, _, _, table = star_field
    distance, _ = cKDTree(np.column_stack([x, y])).query(np.column_stack([table["x"], table["y"]]))
    false = distance > 4.0
    # 85 a megapixel of pure noise (measure.detection.detect); here most of the pixels are under stars
    assert false.sum() < 120
    assert np.sort(table["snr"][false])[-3:].max() < 6.0


def test_aperture_flux_is_that_of_all_the_light(star_field):
    """As of the PSF: 4 px hold 99.99% of this Gaussian; of lone stars, whose circles have no other's light."""
    x, y, *_ = star_field
    flux, snr, found, row, table = matched(star_field)
    distance, _ = cKDTree(np.column_stack([x, y])).query(np.column_stack([x, y]), k=2)
    use = found & (snr > 20) & (distance[:, 1] > 12)
    assert use.sum() > 100
    pull = (table["flux_aper"][row[use]] - flux[use]) / table["flux_aper_err"][row[use]]
    assert abs(np.median(pull)) < 5 * 1.25 / np.sqrt(use.sum()) + 0.1
    assert 0.85 < 1.4826 * np.median(abs(pull - np.median(pull))) < 1.15
    assert (
        np.median(table["flux_aper_err"][row[use]] / table["flux_psf_err"][row[use]]) > 1.0
    )  # weights of the PSF are the best


def test_positions_on_the_sky_and_magnitudes(star_field):
    *_, flux, snr, table = star_field
    _, _, found, row, _ = matched(star_field)
    use = found & (snr > 30)
    expected = 26.3 + 2.5 * np.log10(150.0) - 2.5 * np.log10(flux[use])
    assert np.median(table["mag_psf"][row[use]] - expected) == pytest.approx(0.0, abs=5e-3)  # mag
    assert np.allclose(table["ra_apparent"], 150.0 + table["x"] * 0.074 / 3600.0)
    back = apparent(table["ra"], table["dec"], CRAFT)
    assert np.abs(np.subtract(back, (table["ra_apparent"], table["dec_apparent"]))).max() < 1e-9 / 3600.0
    assert 1.0 < np.abs(table["dec"] - table["dec_apparent"]).min() * 3600.0 < 26.0
    kron = np.median(table["flux_kron"][row[use]] / flux[use])
    assert 0.97 < kron < 1.01  # 3.5 px hold 99.8 % of this Gaussian


def test_the_depth_is_that_of_a_star_of_five_times_its_noise(star_field):
    """True S/N of the stars against their magnitude, at 5: by a line through those of 4 to 6; 0.05 mag."""
    *_, flux, snr, table = star_field
    near = np.abs(snr - 5.0) < 1.0
    magnitude = 26.3 + 2.5 * np.log10(150.0) - 2.5 * np.log10(flux[near])
    slope, at_five = np.polyfit(snr[near] - 5.0, magnitude, 1)
    assert near.sum() > 100 and slope < 0
    assert table.meta["depth_5sigma"] == pytest.approx(at_five, abs=0.05)


def test_stars_are_called_stars_and_shapes_are_round(star_field):
    _, snr, found, row, table = matched(star_field)
    use = row[found & (snr > 10)]
    assert table["star"][use].mean() > 0.97
    assert np.mean((table["flags"][use] & source_columns.SHARP) > 0) < 0.002
    bright = row[found & (snr > 100)]
    for e in ("e1", "e2"):
        assert abs(np.median(table[f"hsm_{e}"][bright])) < 0.01
        assert np.abs(table[f"psf_{e}"]).max() < 1e-3
    # The PSF and a pixel, smoothed with 1 px: measured and modelled alike, so that nothing is left to resolve
    assert np.median(table["hsm_sigma"][bright]) == pytest.approx(np.sqrt(0.95**2 + 1 / 12 + 1.0), rel=5e-3)
    assert np.ptp(table["psf_sigma"]) < 2e-3 and abs(np.median(table["resolution"][bright])) < 0.01
    assert np.isnan(table["g1"][bright]).mean() > 0.95
    assert np.mean((table["flags"][use] & source_columns.NO_SHAPE) > 0) < 0.02
    # the noise map is 1-2 % high: sources below the threshold are in it
    assert np.median(table["chi2"][bright]) == pytest.approx(1.0, abs=0.04)


def test_numbers_follow_brightness_and_metadata_is_json_like(star_field):
    import json

    table = star_field[-1]
    assert (np.diff(table["snr"]) <= 0).all()
    assert (table["number"] == np.arange(len(table))).all()
    meta = json.loads(json.dumps(table.meta))
    assert meta["window"] == [300, 1500, 500, 1700] and meta["filter"] == "g"
    assert meta["rms"] == pytest.approx(np.sqrt(59.0), rel=0.03)
    assert meta["n_eff"] == pytest.approx(4 * np.pi * (0.95**2 + 1 / 12), rel=0.02)
