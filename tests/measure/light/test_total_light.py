"""Total fluxes and fluxes for colours, on galaxies rendered by GalSim behind the fabricated frames' Gaussian PSF."""

from types import SimpleNamespace

import numpy as np
import pytest
from measure.galaxy_images import MIDDLE, PIXEL, RMS, SIDE, rendered, sources_of_rows
from measure.slitless import below
from scipy.integrate import quad

from csstsim.base.rng import stream
from csstsim.catalog.profiles.sersic import brightness
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light import profile_tables as tables_module
from csstsim.measure.light.profile_tables import BULGES, GAAP_FWHM, profile_tables
from csstsim.measure.light.total_light import _nearest_ratio, light_models, total_light


@pytest.fixture(scope="module")
def tables(fabricate):
    return profile_tables(fabricate.psf, (0, 0), (SIDE, SIDE), PIXEL, (BULGES,))[0]


def fit(
    images, tables, *, ratio=0.8, dx=0.2, dy=-0.3, half_light=4.0, unusable=None, flux_psf=np.nan, segments=None,
    function=total_light,
):  # fmt: skip
    """Return the columns of images of one source each, of segment 1. segments: at full size."""
    parts = []
    for image in images:
        one = {"x": MIDDLE + dx, "y": MIDDLE + dy, "half_light": half_light}
        found = SimpleNamespace(
            image=image.astype(np.float32), rms=np.full(image.shape, RMS, np.float32),
            segments=(np.zeros(image.shape, np.int32) if segments is None else segments)[::BIN, ::BIN],
            segment=np.ones(1, np.int64),
            **{name: np.array([value]) for name, value in one.items()},
        )  # fmt: skip
        e = np.array([(1 - ratio**2) / (1 + ratio**2) + 0j])
        table = {"flux_psf": np.array([flux_psf]), "flux_psf_err": np.array([30.0]), "e": e, "g_err": np.zeros(1)}
        table |= {"x": found.x, "y": found.y}
        bad = np.zeros(image.shape, np.uint8) if unusable is None else unusable
        parts.append(function(found, table, bad, np.ones(1), tables))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def models_of(*arguments):
    return light_models(*arguments)._asdict()


def noisy(image, flux, count, seed):
    rng = stream(seed, "galaxies")
    return [rng.normal(flux * image, np.sqrt(RMS**2 + flux * np.maximum(image, 0.0))) for _ in range(count)]


def flux_of(snr, size):
    """Return the flux of S/N `snr` in optimal photometry of a disc (validation.compare)."""
    noise = (13.0 + 9.0 * size**2) * RMS**2
    return 0.5 * snr * (snr + np.sqrt(snr**2 + 4.0 * noise))


@pytest.mark.parametrize("index", [0.5, 1.0, 4.0])
@pytest.mark.parametrize(("size", "ratio"), [(1.5, 0.8), (4.0, 1.0), (4.0, 0.3), (9.0, 0.6), (18.0, 0.8)])
def test_a_bright_galaxy_has_all_its_light(fabricate, tables, index, size, ratio):
    image = rendered(fabricate, index, size, ratio)
    light = fit([1e5 * image], tables, ratio=ratio, half_light=size)
    assert light["flux_total"][0] == pytest.approx(1e5, rel=0.02)
    assert light["half_light"][0] == pytest.approx(size * PIXEL, rel=0.1)
    assert light["point"][0] < 1e-6


@pytest.mark.parametrize("bulge", [0.1, 0.3, 0.6])
def test_a_disc_with_a_bulge_has_all_its_light(fabricate, tables, bulge):
    light = fit([1e5 * rendered(fabricate, 1.0, 7.0, bulge=bulge)], tables, half_light=6.0)
    assert light["flux_total"][0] == pytest.approx(1e5, rel=0.015)


@pytest.mark.parametrize(("index", "size"), [(1.0, 4.0), (4.0, 4.0), (1.0, 12.0)])
def test_the_flux_for_colours_is_that_in_a_gaussian_aperture(fabricate, tables, index, size):
    """Against the integral of the round profile before the PSF."""
    sigma = GAAP_FWHM / PIXEL / 2.354820045 / size
    fraction = quad(lambda r: 2 * np.pi * r * brightness(r, index) * np.exp(-0.5 * (r / sigma) ** 2), 0, 30, limit=200)[
        0
    ]
    light = fit([1e6 * rendered(fabricate, index, size, 1.0)], tables, ratio=1.0, half_light=size)
    assert light["flux_gaap"][0] == pytest.approx(1e6 * fraction, rel=0.015)


@pytest.mark.parametrize(("index", "size"), [(1.0, 0.0), (0.5, 3.0), (1.0, 6.0), (4.0, 8.0)])
def test_the_model_for_neighbours_is_the_light_of_the_source(fabricate, tables, index, size):
    """Electrons by radius within 4% of the flux of a round source; darkness has no model."""
    image = rendered(fabricate, index, size, 1.0, dx=0.0, dy=0.0)
    found = fit([2e5 * image], tables, ratio=1.0, half_light=max(size, 1.0), dx=0, dy=0, function=models_of)
    assert found["point"].tolist() == [size == 0] and found["flux"][0] == pytest.approx(2e5, rel=0.04)
    y, x = np.mgrid[:SIDE, :SIDE] - MIDDLE
    model = found["flux"][0] * np.interp(x**2 + y**2, tables.nodes, found["profile"][0])
    for radius in (2.0, 4.0, 8.0, 16.0, 30.0):
        inside = np.hypot(x, y) < radius
        assert model[inside].sum() == pytest.approx(2e5 * image[inside].sum(), abs=8e3)
    dark = fit([0 * image - 1.0], tables, half_light=4.0, function=models_of)
    assert dark["flux"].tolist() == [0.0]


@pytest.mark.parametrize("flux", [300.0, 3e3, 1e6])
def test_a_point_has_its_psf_flux(fabricate, tables, flux):
    image = flux * rendered(fabricate, 1.0, 0.0)
    light = fit([image], tables, half_light=1.2, flux_psf=1.003 * flux)
    assert light["flux_total"][0] == pytest.approx(1.003 * flux, rel=0.005)
    assert light["flux_gaap"][0] == pytest.approx(1.003 * flux, rel=0.005)
    alone = fit([image], tables, half_light=1.2)  # without a PSF flux that of the profile's fit
    assert alone["flux_total"][0] == pytest.approx(flux, rel=0.005)
    assert light["point"][0] > 0.6


@pytest.mark.parametrize(("snr", "index", "bias"), [(10, 1, 0.08), (20, 1, 0.04), (40, 1, 0.02), (40, 4, 0.04)])
def test_faint_galaxies_are_unbiased_with_errors_that_hold(fabricate, tables, snr, index, bias):
    """Sizes 0.15 to 0.5 arcsec. The tolerances are the chance of the sample and what docs/measure.md states."""
    fluxes, pulls = [], []
    for k, size in enumerate((2.0, 3.0, 4.5, 6.5)):
        flux = flux_of(snr, size)
        images = noisy(rendered(fabricate, index, size, 0.7), flux, 60, 100 * k + snr + index)
        light = fit(images, tables, ratio=0.7, half_light=0.8 * size)
        fluxes.append(light["flux_total"] / flux)
        pulls.append((light["flux_total"] - flux) / light["flux_total_err"])
    magnitudes, pulls = -2.5 * np.log10(np.concatenate(fluxes)), np.concatenate(pulls)
    assert abs(np.median(magnitudes)) < bias
    assert 0.6 < 1.4826 * np.median(np.abs(pulls - np.median(pulls))) < 1.2


def test_pixels_of_others_and_bad_ones_are_left_out(fabricate, tables):
    image = 1e5 * rendered(fabricate, 1.0, 5.0)
    unusable = np.zeros(image.shape, np.uint8)
    unusable[:, 86:] = 1
    image[:, 86:] = 1e6
    image[70, 40:70] = np.nan
    light = fit([image], tables, half_light=5.0, unusable=unusable)
    assert light["flux_total"][0] == pytest.approx(1e5, rel=0.04)


def test_isophotes_of_other_sources_are_left_out_and_its_own_is_not(fabricate, tables):
    image = 1e5 * rendered(fabricate, 1.0, 5.0)
    segments = np.zeros(image.shape, np.int32)
    segments[70:92, 70:92] = 1
    segments[60:110, 96:] = 2
    image[60:110, 96:] += 500.0
    light = fit([image], tables, half_light=5.0, segments=segments)
    assert light["flux_total"][0] == pytest.approx(1e5, rel=0.02)


def test_errors_hold_where_the_light_of_the_source_is_the_noise(fabricate, tables):
    image, flux = rendered(fabricate, 1.0, 2.5), 1e5
    light = fit(noisy(image, flux, 80, 5), tables, half_light=2.5)
    true = fit([1e7 * image], tables, half_light=2.5)["flux_gaap"][0] / 1e7 * flux
    assert 0.75 < np.std((light["flux_gaap"] - true) / light["flux_gaap_err"]) < 1.25
    assert np.mean(light["flux_gaap"]) == pytest.approx(true, rel=0.01)


def test_no_usable_pixel_no_flux(tables):
    image = np.ones((SIDE, SIDE))
    light = fit([image], tables, unusable=np.ones(image.shape, np.uint8))
    assert all(np.isnan(values[0]) for values in light.values())
    light = fit([np.full(image.shape, np.nan)], tables)
    assert all(np.isnan(values[0]) for values in light.values())
    light = fit([image], tables, dx=np.nan)
    assert all(np.isnan(values[0]) for values in light.values())


def test_no_source_no_row(tables):
    found = SimpleNamespace(
        image=np.zeros((9, 9), np.float32), rms=np.ones((9, 9), np.float32), segments=np.zeros((9, 9), np.int32),
        segment=np.zeros(0, np.int64), x=np.zeros(0), y=np.zeros(0), half_light=np.zeros(0),
    )  # fmt: skip
    table = {name: np.zeros(0) for name in ("x", "y", "flux_psf", "flux_psf_err", "g_err")} | {
        "e": np.zeros(0, complex)
    }
    light = total_light(found, table, np.zeros((9, 9), np.uint8), np.ones(0), tables)
    assert all(values.shape == (0,) for values in light.values())


@pytest.mark.parametrize("flux", [0.0, -500.0])
def test_a_flux_that_is_not_positive_is_finite(fabricate, tables, flux):
    light = fit([flux * rendered(fabricate, 1.0, 3.0)], tables)
    assert light["flux_total"][0] <= 0.0
    assert 0.0 < light["flux_total_err"][0] < 2000.0


def test_a_source_at_the_edge_is_measured_on_the_pixels_there_are(fabricate, tables):
    image = 1e5 * rendered(fabricate, 1.0, 4.0)
    light = fit([image[76:]], tables, dy=-0.3 - 76)
    assert light["flux_total"][0] == pytest.approx(1e5, rel=0.05)
    far = fit([image], tables, dx=400.0)
    assert np.isnan(far["flux_total"][0])


def test_a_galaxy_larger_than_the_tables_reach_is_finite(fabricate, tables):
    light = fit([1e6 * rendered(fabricate, 1.0, 60.0)], tables, half_light=60.0)
    assert 0.5e6 < light["flux_total"][0] < 2e6


@pytest.mark.parametrize(
    ("ratio", "index"),  # the borders are geometric means of 1, 0.8, 0.6, 0.45, 0.3 and 0.2
    [(1, 0), (0.9, 0), (0.89, 1), (0.7, 1), (0.69, 2), (0.525, 2), (0.515, 3), (0.37, 3), (0.365, 4), (0.24, 5)],
)  # fmt: skip
def test_the_nearest_axis_ratio(ratio, index):
    e = np.exp(0.7j) * (1 - ratio**2) / (1 + ratio**2)
    assert _nearest_ratio(np.array([e]), np.zeros(1)).tolist() == [index]


def test_noise_of_a_shape_does_not_make_it_long():
    """Distortions of 0.6: without noise 0.50, with 0.09 of shear 0.535; none left, round; no shape, 0.7."""
    e, error = np.array([0.6, 0.6j, -0.6, np.nan, 0.6]), np.array([0.0, 0.09, 0.9, 0.1, np.nan])
    assert _nearest_ratio(e, error).tolist() == [3, 2, 0, 1, 1]


def test_without_light_only_the_prior_is_known(tables):
    """27% points, sizes about 0.25 arcsec."""
    light = fit([np.zeros((SIDE, SIDE))], tables)
    assert light["point"][0] == pytest.approx(0.27, rel=1e-6)
    assert light["half_light"][0] == pytest.approx(0.25, rel=0.01)
    assert light["flux_total"][0] == light["flux_gaap"][0] == 0.0 and light["flux_total_err"][0] > 20


def test_the_error_of_a_point_is_that_of_its_psf_flux(fabricate, tables):
    light = fit([1e5 * rendered(fabricate, 1.0, 0.0)], tables, half_light=1.2, flux_psf=1e5)
    assert light["point"][0] > 0.999
    assert light["flux_total_err"][0] == pytest.approx(30, rel=0.02) == light["flux_gaap_err"][0]


def fit_of_rows(image, rows, tables, rms, origin=(0, 0)):
    return total_light(*sources_of_rows(image, rows, rms, origin), tables)


def test_each_source_is_fitted_with_its_own_noise_shape_and_counted_light(fabricate, tables):
    """Three on a frame that is not square, each as alone on a frame with the noise of its own pixel."""
    places = (80, 80), (240, 80), (400, 80)
    image = np.zeros((160, 480))
    for (x, y), size, ratio in zip(places, (3.0, 5.0, 2.0), (0.8, 0.3, 1.0), strict=True):
        part = rendered(fabricate, 1.0, size, ratio, dx=0.0, dy=0.0)
        image[y - 80 : y + 80, x - 80 : x + 80] += 2e4 * part[:160, :160]
    rms = np.repeat([4.0, 8.0, 16.0], 160 // BIN) + np.zeros((160 // BIN, 1))
    rows = [(80, 80, 0.8, 1.0, 3.0), (240, 80, 0.3, 0.25, 5.0), (400, 80, 1.0, 0.5, 2.0)]
    together = fit_of_rows(image, rows, tables, rms)
    for k, row in enumerate(rows):
        alone = fit_of_rows(image, [row], tables, np.full(image.shape, 4.0 * 2**k))
        for name, values in together.items():
            assert values[k] == pytest.approx(alone[name][0], rel=1e-9), (name, k)
    assert np.diff(together["flux_total_err"]).all()


def test_the_psf_of_a_part_is_that_of_its_position_on_the_chip(fabricate, monkeypatch):
    """Two by two parts of a frame that begins at 3000, 5000; one galaxy in each, behind the PSF of its own part."""
    monkeypatch.setattr(tables_module, "PART_PX", 160)

    def width(x, y):
        return 0.7 + 0.5 * (x > 3160) + 1.0 * (y > 5160)

    class Widening(type(fabricate.psf)):
        def at(self, x, y):
            line = np.diff(below((np.arange(257) - 128) * 0.5, width(x, y)))
            return np.repeat(np.outer(line, line)[None], 4, axis=0)

    (tables,) = profile_tables(Widening(), (3000, 5000), (320, 320), PIXEL, (BULGES,))
    places, image = [(80, 80), (240, 80), (80, 240), (240, 240)], np.zeros((320, 320))
    for x, y in places:
        sigma = np.hypot(3.0, width(3000 + x, 5000 + y))
        columns, rows = (np.diff(below(np.arange(321) - 0.5 - at, sigma)) for at in (x, y))
        image += 1e5 * np.outer(rows, columns)
    rms = np.full(image.shape, RMS)
    light = fit_of_rows(image, [(x, y, 1.0, 1.0, 4.0) for x, y in places], tables, rms, (3000, 5000))
    assert light["flux_total"] == pytest.approx(np.full(4, 1e5), rel=0.02)
    assert light["half_light"] == pytest.approx(np.full(4, np.sqrt(2 * np.log(2)) * 3.0 * PIXEL), rel=0.03)
