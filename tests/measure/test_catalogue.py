"""Galaxies, cosmic rays, saturation, empty and refused frames."""

from types import SimpleNamespace

import numpy as np
import pytest
from measure.slitless import below

from csstsim.base.errors import InputError
from csstsim.measure import catalogue, source_columns
from csstsim.measure.detection.bright_stars import MODEL_ERROR
from csstsim.measure.detection.combine import CORE_FRACTION, CORE_RADIUS, _main_peaks, _star_residuals, local_flux
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.photometry import HALF, psf_model

galsim = pytest.importorskip("galsim")


def nearest(table, x, y):
    return int(np.argmin(np.hypot(table["x"] - x, table["y"] - y)))


@pytest.fixture(scope="module")
def galaxies(fabricate):
    """16 exponential galaxies (half-light radius 4 px, q = 0.6, position angle 30 deg) rendered by GalSim."""
    n, flux, step = 600, 20000.0, 140
    shape = galsim.Exponential(half_light_radius=4.0, flux=flux).shear(q=0.6, beta=30 * galsim.degrees)
    profile = galsim.Convolve(shape, galsim.Gaussian(sigma=fabricate.SIGMA))
    stamp = profile.drawImage(nx=121, ny=121, scale=1.0).array
    image = np.zeros((n, n))
    positions = [(90 + step * i, 90 + step * j) for i in range(4) for j in range(4)]
    for x, y in positions:
        image[y - 60 : y + 61, x - 60 : x + 61] += stamp
    table = fabricate.measure(fabricate.add_noise(image, 30))
    return flux, table, np.array([nearest(table, x, y) for x, y in positions])


def test_kron_flux_of_an_exponential_galaxy(galaxies):
    flux, table, rows = galaxies
    recovered = table["flux_kron"][rows] / flux
    # Kron (1980): 2.5 radii hold all but some 6 %, whatever the profile; the isophotal limit of r1 costs a little
    assert 0.91 < np.median(recovered) < 0.99
    expected = table["flux_kron_err"][rows] / flux
    assert recovered.std() < 2.0 * np.median(expected)


def test_galaxies_are_not_stars_and_keep_their_shape(galaxies):
    _, table, rows = galaxies
    assert not table["star"][rows].any()
    # axis ratio q = 0.6, seen through a PSF that rounds it
    e1, e2 = np.median(table["hsm_e1"][rows]), np.median(table["hsm_e2"][rows])
    assert 0.3 < np.hypot(e1, e2) < 0.47  # (1 - q^2) / (1 + q^2) = 0.47
    assert np.degrees(0.5 * np.arctan2(e2, e1)) == pytest.approx(30.0, abs=3.0)
    # (1 - q) / (1 + q) = 0.25; 16 galaxies of one shape show the error, too (5 sigma of 32 pulls: 0.63)
    pull = np.concatenate([table["g1"][rows] - 0.125, table["g2"][rows] - 0.125 * 3**0.5]) / np.tile(
        table["g_err"][rows], 2
    )
    assert abs(pull.mean()) < 5.0 / np.sqrt(pull.size) and 0.5 < pull.std() < 1.6
    assert np.median(np.degrees(table["theta"][rows])) == pytest.approx(30.0, abs=3.0)
    assert (table["flux_psf"][rows] < 0.7 * table["flux_kron"][rows]).all()


def test_a_hit_pixel_is_no_source_and_a_saturated_core_is_flagged(fabricate):
    image = np.zeros((200, 200))
    fabricate.add_stars(image, [60.2, 140.1], [60.4, 139.8], [30000.0, 60000.0])
    noisy = fabricate.add_noise(image, 31)
    noisy[100, 100] += 3000.0  # one pixel: no light through the optics does that
    clean = fabricate.measure(noisy.copy())
    saturated = noisy > 5000.0
    assert saturated.sum() > 2
    noisy[saturated] = 5000.0
    table = fabricate.measure(noisy, saturated=saturated)
    star, core = (nearest(table, *position) for position in ((60.2, 60.4), (140.1, 139.8)))
    assert np.hypot(table["x"] - 100, table["y"] - 100).min() > 5
    assert table["flags"][star] == 0
    assert table["flags"][core] & source_columns.SATURATED
    # The fit without the saturated pixels keeps the flux: 2 % from the position, which the clipped core blurs
    assert table["flux_psf"][core] == pytest.approx(60000.0, rel=0.03)
    assert clean["flux_psf"][nearest(clean, 140.1, 139.8)] == pytest.approx(60000.0, rel=0.02)


@pytest.mark.parametrize("level", [0.0, 34.0])
def test_a_frame_without_sources_gives_an_empty_table_with_every_column(fabricate, level):
    table = fabricate.measure(np.full((100, 120), level))
    assert len(table) == 0
    assert list(table) == list(source_columns.COLUMNS)
    for name, (kind, _) in source_columns.COLUMNS.items():
        assert np.dtype(kind).kind == table[name].dtype.kind, name


def test_tables_survive_a_round_trip(fabricate, tmp_path):
    image = np.zeros((100, 100))
    fabricate.add_stars(image, [50.0], [50.0], [5000.0])
    for frame in (fabricate.add_noise(image, 32), np.zeros((100, 100))):
        table = fabricate.measure(frame)
        table.write(tmp_path / "table.parquet")
        back = type(table).read(tmp_path / "table.parquet")
        assert list(back) == list(table) and len(back) == len(table) and back.meta == table.meta


@pytest.mark.parametrize(("kind", "exposure"), [("slitless", "SCIE"), ("imaging", "BIAS"), ("imaging", "FLAT")])
def test_only_imaging_science_frames_are_measured(fabricate, kind, exposure):
    with pytest.raises(InputError, match="only imaging science frames"):
        fabricate.measure(np.zeros((50, 50)), kind=kind, exposure=exposure)


def test_negative_flux_has_no_magnitude():
    mag, error = catalogue.magnitude([100.0, 0.0, -3.0, np.nan], [10.0, 1.0, 1.0, 1.0], 30.0)
    assert mag[0] == pytest.approx(25.0) and np.isnan(mag[1:]).all() and np.isnan(error[1:]).all()
    assert error[0] == pytest.approx(0.1 * 2.5 / np.log(10))


def test_point_source_flux_inverts_snr():
    for snr in (0.1, 5.0, 300.0):
        flux = catalogue.point_source_flux(snr, 59.0, 12.4)
        assert catalogue.point_source_snr(flux, 59.0, 12.4) == pytest.approx(snr, rel=1e-12)


def test_psf_model_interpolates_the_pixel_integral(fabricate):
    """Against the closed form of a Gaussian integrated over pixels, at sub-pixel shifts."""
    from csstsim.measure.light.photometry import render_psf

    model = psf_model(fabricate.psf, (0, 0), (100, 700), cell_px=350)
    assert model.coefficients.shape[0] == 4
    assert model.cell([0, 349, 351, 5000, -3], [0, 0, 99, 99, 0]).tolist() == [0, 0, 3, 3, 0]
    size = 2 * HALF + 1
    for dx, dy in ((0.0, 0.0), (0.25, -0.25), (0.48, 0.1), (-0.37, 0.49)):
        stamp, exact = np.empty((size, size)), np.zeros((size, size))
        render_psf(model.coefficients[0], model.per_pixel, dx, dy, stamp)
        fabricate.add_stars(exact, [HALF + dx], [HALF + dy], [1.0], half=HALF)
        assert np.abs(stamp - exact).max() < 2e-3 * exact.max()
        assert (stamp * exact).sum() / (exact**2).sum() == pytest.approx(1.0, abs=1e-3)


def test_a_star_has_its_magnitude_and_an_error_of_its_position_on_the_sky(fabricate):
    """26.3 mag a photon a second, 150 s: of 60,000 electrons 19.8 mag. Its position is known to sigma / S/N, arcsec."""
    image = np.zeros((200, 200))
    fabricate.add_stars(image, [100.2], [99.6], [60_000.0])
    table = fabricate.measure(fabricate.add_noise(image, 33))
    row = nearest(table, 100.2, 99.6)
    assert table["mag_psf"][row] == pytest.approx(26.3 - 2.5 * np.log10(60_000.0 / 150.0), abs=0.02)
    assert table["zeropoint"][row] == pytest.approx(26.3 + 2.5 * np.log10(150.0))
    width = np.hypot(fabricate.SIGMA, 12**-0.5) * 0.074  # arcsec
    assert 0.9 * width < table["pos_err"][row] * table["snr"][row] < 2.0 * width


def test_a_local_flux_is_numpys_least_squares_fit_with_a_constant():
    """On a plane and a star, off the middle: linear least squares of kernel and constant, and its error."""
    rng = np.random.default_rng(3)
    kernel = np.outer([1.0, 3, 9, 4, 1], [1.0, 5, 8, 2, 1])
    image = (rng.normal(5.0, 2.0, (40, 50)) + 0.3 * np.arange(50)).astype(np.float32)
    image[10:15, 20:25] += 3 * kernel
    rms = rng.uniform(1.0, 3.0, (20, 25)).astype(np.float32)
    of_pixels = np.repeat(np.repeat(rms, BIN, 0), BIN, 1)
    x, y = np.array([22.4, 30.6]), np.array([11.6, 25.4])
    flux, error = local_flux(image, rms, x, y, kernel)
    for k, (i, j) in enumerate(((22, 12), (31, 25))):
        part = np.s_[j - 2 : j + 3, i - 2 : i + 3]
        design = np.stack([kernel.ravel(), np.ones(25)], axis=1)
        inverse = np.linalg.pinv(design)
        variance = of_pixels[part].astype(float) ** 2 + np.maximum(image[part], 0)
        assert flux[k] == pytest.approx(kernel.sum() * inverse[0] @ image[part].ravel(), rel=1e-5)
        assert error[k] == pytest.approx(kernel.sum() * np.sqrt(inverse[0] ** 2 @ variance.ravel()), rel=1e-5)


def test_what_is_left_of_a_bright_star_is_faint_and_near():
    class Stars(SimpleNamespace):
        def __len__(self):
            return len(self.x)

    stars = Stars(x=np.array([10.0, 100.0]), y=np.array([20.0, 20.0]), flux=np.array([1e4, 1e6]))
    x = np.array([10 + CORE_RADIUS - 0.1, 10 + CORE_RADIUS + 0.1, 10.0, 10.0, 100.0])
    y, flux = np.full(5, 20.0), np.array([1.0, 1.0, 0.99, 1.01, 60.0]) * np.array([1, 1, 1e4, 1e4, 1e4]) * CORE_FRACTION
    flux[4] = 40_000.0
    assert _star_residuals(stars, x, y, flux).tolist() == [True, False, True, False, True]
    none = Stars(x=x[:0], y=x[:0], flux=x[:0])
    assert _star_residuals(none, x, y, flux).tolist() == [False] * 5 and len(_star_residuals(stars, *[x[:0]] * 3)) == 0


def test_an_isophotes_own_peak_is_its_highest():
    peaks = SimpleNamespace(segment=np.array([2, 0, 2, 4, 2, 0, 4]))
    snr = np.array([5.0, 99.0, 8.0, 7.0, 6.0, 50.0, 7.0])
    assert _main_peaks(peaks, snr, 4).tolist() == [-1, 2, -1, 6]


def test_the_table_says_of_its_frame_what_it_was_given(fabricate):
    """Off the chip's corner; rows by falling S/N; sizes, apertures and words of a star of 40,000 electrons."""
    image = np.zeros((150, 220))
    fabricate.add_stars(image, [60.3, 160.0, 110.0], [40.0, 90.4, 120.0], [40_000.0, 90_000.0, 900.0])
    table = fabricate.measure(fabricate.add_noise(image, 34), origin=(1000, 3000))
    assert table["number"].tolist() == list(range(len(table))) and (np.diff(table["snr"]) <= 0).all()
    row = nearest(table, 1060.3, 3040.0)
    assert (table["x"][row], table["y"][row]) == (pytest.approx(1060.3, abs=0.02), pytest.approx(3040.0, abs=0.02))
    assert table["ra_apparent"][row] == pytest.approx(150 + table["x"][row] * 0.074 / 3600, abs=1e-12)
    assert table["dec_apparent"][row] == pytest.approx(table["y"][row] * 0.074 / 3600, abs=1e-12)
    assert (
        0
        < np.hypot(table["ra"][row] - table["ra_apparent"][row], table["dec"][row] - table["dec_apparent"][row])
        < 0.01
    )
    for kind, tolerance in (("psf", 0.02), ("aper", 0.03), ("kron", 0.06), ("total", 0.03)):
        assert table[f"flux_{kind}"][row] == pytest.approx(40_000.0, rel=tolerance)
        assert table[f"mag_{kind}"][row] == pytest.approx(
            table["zeropoint"][row] - 2.5 * np.log10(table[f"flux_{kind}"][row])
        )
        error = 2.5 / np.log(10) * table[f"flux_{kind}_err"][row] / table[f"flux_{kind}"][row]
        assert table[f"mag_{kind}_err"][row] == pytest.approx(error)
    assert table["snr"][row] == pytest.approx(table["flux_psf"][row] / table["flux_psf_err"][row], rel=1e-5)
    width = np.hypot(fabricate.SIGMA, 12**-0.5)
    assert table["fwhm"][row] == pytest.approx(2 * 1.1774 * width, rel=0.1) and table["star"][row]
    assert table["hsm_sigma"][row] == pytest.approx(table["psf_sigma"][row], rel=0.02)
    assert table["rms"][row] == pytest.approx(np.sqrt(fabricate.VARIANCE), rel=0.1)
    meta = table.meta
    assert meta["window"] == [1000, 1220, 3000, 3150] and meta["sources"] == len(table)
    assert (meta["obsid"], meta["chip"], meta["filter"], meta["exptime"]) == ("10100000001", 8, "g", 150.0)
    assert meta["background"] == pytest.approx(fabricate.SKY, abs=2.0)
    assert meta["rms"] == pytest.approx(np.sqrt(fabricate.VARIANCE), rel=0.05)
    assert meta["n_eff"] == pytest.approx(4 * np.pi * width**2, rel=0.03)
    five = 12.5 + np.sqrt(12.5**2 + 25 * meta["n_eff"] * meta["rms"] ** 2)
    assert meta["depth_5sigma"] == pytest.approx(meta["zeropoint"] - 2.5 * np.log10(five))
    assert set(table["obsid"]) == {"10100000001"} and set(table["chip"]) == {8} and set(table["filter"]) == {"g"}


def light_of(shape, *sources):
    """Return the image of round Gaussians (x, y, sigma, flux), integrated over pixels."""
    image = np.zeros(shape)
    for x, y, sigma, flux in sources:
        columns, rows = (
            np.diff(below(np.arange(n + 1) - 0.5 - at, sigma)) for n, at in zip(shape[::-1], (x, y), strict=True)
        )
        image += flux * np.outer(rows, columns)
    return image


def test_the_psf_of_a_source_is_that_of_its_position_on_the_chip(fabricate):
    """Two parts of a frame far from the chip's corner, each with its own width; at the corner it is wider than both."""

    def width(x, y):
        return 2.2 if y < 1000 else 0.9 if x < 3320 else 1.3

    class Widening(type(fabricate.psf)):
        def at(self, x, y):
            line = np.diff(below((np.arange(257) - 128) * 0.5, width(x, y)))
            return np.repeat(fabricate.LIGHT * np.outer(line, line)[None], 4, axis=0)

    x, y, flux = (159.7, 479.2), (20.2, 59.6), 12_000.0
    stars = [(a, b, width(3000 + a, 5000), fabricate.LIGHT * flux) for a, b in zip(x, y, strict=True)]
    galaxy = (320.3, 40.1, np.hypot(2.5, 1.3), fabricate.LIGHT * 2 * flux)
    image = fabricate.add_noise(light_of((80, 640), *stars, galaxy), 35)
    table = fabricate.measure(image, origin=(3000, 5000), psf=Widening())
    for a, b in zip(x, y, strict=True):
        row = nearest(table, 3000 + a, 5000 + b)
        assert table["flux_psf"][row] == pytest.approx(flux, rel=0.02) and table["star"][row]
        assert table["psf_sigma"][row] == pytest.approx(table["hsm_sigma"][row], rel=0.03)
    row = nearest(table, 3320.3, 5040.1)
    assert table["half_light"][row] == pytest.approx(np.sqrt(2 * np.log(2)) * 2.5 * 0.074, rel=0.08)


def test_errors_grow_where_light_was_lost(fabricate):
    """A quarter of the light counts in the columns from 100 on: errors of bright sources are nearly twice as large."""
    response = SimpleNamespace(at=lambda row, column: np.where(column < 100, np.float32(1), np.float32(0.25)))
    image = np.zeros((200, 200))
    pairs = {12_000.0: ((60.2, 139.7), (140.2, 59.7)), 60_000.0: ((30.2, 160.7), (160.2, 30.7))}  # of which one bright
    for flux, positions in pairs.items():
        fabricate.add_stars(image, *np.transpose(positions), np.full(2, flux))
    table = fabricate.measure(fabricate.add_noise(image, 36), response=response)
    for positions in pairs.values():
        whole, lost = (nearest(table, *position) for position in positions)
        for name in ("flux_psf_err", "flux_aper_err", "flux_kron_err", "flux_total_err", "flux_gaap_err", "pos_err"):
            assert 1.7 < table[name][lost] / table[name][whole] < 2.1, name


def test_the_light_of_a_bright_star_is_noise_of_the_sources_next_to_it(fabricate):
    """A wing of 2% of its light, sigma 8 px: in it the noise is that of sky, wing, and the error of the model."""
    parts = (0.95, 0.98), (8.0, 0.02)

    class Winged(type(fabricate.psf)):
        def at(self, x, y):
            lines = [(np.diff(below((np.arange(257) - 128) * 0.5, sigma)), share) for sigma, share in parts]
            return np.repeat(sum(share * np.outer(line, line) for line, share in lines)[None], 4, axis=0)

    def star(x, y, flux):
        return light_of((200, 200), *((x, y, sigma, share * flux) for sigma, share in parts))

    image = star(90.2, 100.3, 2e6) + star(104.2, 100.3, 6000.0) + star(30.3, 40.1, 6000.0)
    table = fabricate.measure(fabricate.add_noise(image, 37), psf=Winged())
    near, far, bright = (nearest(table, *at) for at in ((104.2, 100.3), (30.3, 40.1), (90.2, 100.3)))
    wing = star(90.2, 100.3, 2e6)[100, 104]
    wanted = np.sqrt(fabricate.VARIANCE + wing + (MODEL_ERROR * wing) ** 2)
    assert wanted > 1.15 * np.sqrt(fabricate.VARIANCE)
    assert table["rms"][near] == pytest.approx(wanted, rel=0.05)
    assert table["flux_psf"][bright] == pytest.approx(2e6, rel=0.01)
    for value in (table["rms"][far], table["rms"][bright], table.meta["rms"]):
        assert value == pytest.approx(np.sqrt(fabricate.VARIANCE), rel=0.06)
