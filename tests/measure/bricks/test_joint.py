"""Sources that only all frames together show, and forced photometry, on fabricated residuals of a known PSF."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.csst import BANDS
from support.measured_table import ARCSEC, table

from csstsim.base import healpix
from csstsim.base.rng import stream
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.forced import forced_fluxes, forced_photometry
from csstsim.measure.bricks.joint import FALSE_ALARM, _add_chi2, _Band, joint_peaks, thresholds
from csstsim.measure.bricks.joint_frame import JointFrame
from csstsim.measure.bricks.merge import DETECTION_COLUMNS, _photometry, merge_brick
from csstsim.measure.detection.residual import BLANK, STEP, ZERO, Residual
from csstsim.measure.light.photometry import psf_model

SCALE = 0.074
N = 700
RA, DEC = 150.0, 2.0  # of the middle of all frames, in the middle of a brick
NOISE = 5.0  # electrons
DETECTABLE = 3.0 * NOISE * math.sqrt(4.0 * math.pi) * 0.99  # electrons: S/N 3 in one frame


@pytest.fixture(scope="module")
def model(fabricate):
    return psf_model(fabricate.psf, (0, 0), (N, N))


def turned(angle, shift):
    """A frame's map from the sky to its pixels: turned, and shifted by parts of a pixel."""
    c, s = math.cos(angle), math.sin(angle)

    def to_pixel(ra, dec):
        u = (np.asarray(ra) - RA) * math.cos(math.radians(DEC)) * 3600.0 / SCALE
        v = (np.asarray(dec) - DEC) * 3600.0 / SCALE
        return c * u - s * v + N / 2 + shift, s * u + c * v + N / 2 - shift

    return to_pixel


def frames(fabricate, model, seed, ra=(), dec=(), flux=0.0, bands="ggrrii", only=None):
    """One JointFrame a letter, of noise of NOISE electrons and stars of `flux`; only: in the frame of this number."""
    out = []
    for k, band in enumerate(bands):
        to_pixel = turned(0.7 * k, 0.13 * k)
        image = np.zeros((N, N))
        if only in (None, k) and len(ra):
            x, y = to_pixel(np.asarray(ra), np.asarray(dec))
            fabricate.add_stars(image, x, y, np.full(len(ra), flux))
        values = (image + stream(seed, "noise", k).normal(0.0, NOISE, image.shape)) / NOISE / STEP
        steps = (ZERO + np.rint(values)).astype(np.uint8)
        noise = np.full((N // 32 + 1, N // 32 + 1), NOISE, np.float32)
        out.append(JointFrame(f"{k}", 8, band, Residual(steps, noise), model, to_pixel, 23.9, SCALE, 6e4))
    return out


def places(count, seed):
    """Positions a few arcsec apart that all frames contain."""
    rng = stream(seed, "places")
    line = (np.arange(count) - (count - 1) / 2) * 3.0
    x, y = (one.ravel() + rng.uniform(-0.1, 0.1, count**2) for one in np.meshgrid(line, line))
    return RA + x * ARCSEC / math.cos(math.radians(DEC)), DEC + y * ARCSEC


@pytest.fixture(scope="module")
def pix():
    return int(healpix.brick_of(RA, DEC))


def test_noise_exceeds_the_thresholds_as_often_as_they_say():
    """A million sums of squares of positive numbers, for one to seven bands. 5 sigma."""
    limits = thresholds(7, 1e-3)
    noise = np.maximum(stream(3, "noise").normal(size=(1_000_000, 7)), 0.0) ** 2
    for n in range(1, 8):
        assert (noise[:, :n].sum(axis=1) > limits[n]).sum() == pytest.approx(1000, abs=5 * math.sqrt(1000))
    assert (np.diff(limits) > 0).all() and thresholds(1, FALSE_ALARM)[1] == pytest.approx(25.0, abs=0.1)


def test_only_positive_sums_of_a_band_count():
    """A band's sum over the root of its weight, squared; bands that do not cover a pixel change nothing."""
    chi2, bands = np.zeros((1, 3), np.float32), np.zeros((1, 3), np.int8)
    for total in ([6.0, -8.0, 0.0], [10.0, 2.0, 0.0]):
        weight = np.array([[4.0, 4.0, 0.0]], np.float32)
        _add_chi2(chi2, bands, _Band(np.array([total], np.float32), weight))
    assert chi2.tolist() == [[9.0 + 25.0, 1.0, 0.0]] and bands.tolist() == [[2, 2, 0]]


def test_noise_alone_has_hardly_a_peak(fabricate, model, pix):
    """0.75 square arc minutes of six frames; the docs say one peak in 30."""
    peaks = joint_peaks(pix, frames(fabricate, model, 1))
    assert len(peaks.ra) <= 1


def test_sources_too_faint_for_each_frame_are_found(fabricate, model, pix):
    """S/N 3 in each of six frames, 7.3 in all; the stated errors of positions are those of faint galaxies."""
    ra, dec = places(9, 2)
    peaks = joint_peaks(pix, frames(fabricate, model, 2, ra, dec, DETECTABLE))
    scale = np.array([math.cos(math.radians(DEC)), 1.0]) / ARCSEC
    offset = (np.stack([peaks.ra, peaks.dec])[:, :, None] - np.stack([ra, dec])[:, None]) * scale[:, None, None]
    distance = np.hypot(*offset)
    nearest = distance.min(axis=1)
    assert (distance.min(axis=0) < 0.2).mean() > 0.9
    assert (nearest > 0.2).sum() <= 1
    pulls = nearest[nearest < 0.2] / peaks.pos_err[nearest < 0.2]
    assert 0.2 < np.median(pulls) / math.sqrt(2 * math.log(2)) < 1.0  # stated for galaxies, which are wider


def test_a_cosmic_ray_is_in_one_frame_only(fabricate, model, pix):
    ra, dec = places(5, 4)
    peaks = joint_peaks(pix, frames(fabricate, model, 4, ra, dec, 4.0 * DETECTABLE, only=2))
    assert len(peaks.ra) <= 1


def test_nothing_is_found_beside_what_is_hidden(fabricate, model, pix):
    """A light that the models left around hidden cores, known in half of the frames."""
    ra, dec = places(3, 5)
    some = frames(fabricate, model, 5, ra, dec, 3.0 * DETECTABLE)
    for frame in some[:3]:
        x, y = frame.to_pixel(ra, dec)
        for column, row in zip(np.rint(x).astype(int), np.rint(y).astype(int), strict=True):
            frame.residual.steps[row - 4 : row + 5, column - 4 : column + 5] = BLANK
    assert len(joint_peaks(pix, some).ra) <= 1


def test_a_star_outside_the_frame_leaves_no_peaks(fabricate, model, pix):
    """Its wing, 0.5 of the noise at the edge and smooth over 100 px, is a part of the sky."""
    some = frames(fabricate, model, 6)
    wing = 0.5 * np.exp(-np.arange(N) / 100.0) / STEP
    for frame in some:
        frame.residual.steps[:] = np.rint(frame.residual.steps + wing).astype(np.uint8)
    assert len(joint_peaks(pix, some).ra) <= 1


def test_forced_fluxes_have_no_bias_and_the_stated_errors(fabricate, model):
    """400 stars of S/N 3, both fluxes: mean and scatter of pulls to 4 sigma; quantising to 8 bits included."""
    rng = stream(7, "stars")
    line = 25 + 32 * np.arange(20)
    x, y = (one.ravel() + rng.uniform(-0.5, 0.5, 400) for one in np.meshgrid(line, line))
    image = np.zeros((N, N))
    fabricate.add_stars(image, x, y, np.full(400, DETECTABLE))
    values = (image + rng.normal(0.0, NOISE, image.shape)) / NOISE / STEP
    noise = np.full((N // 32 + 1, N // 32 + 1), NOISE, np.float32)
    steps = (ZERO + np.rint(values)).astype(np.uint8)
    frame = JointFrame("1", 8, "g", Residual(steps, noise), model, turned(0.0, 0.0), 23.9, SCALE, 6e4)
    fluxes = forced_fluxes(frame, x, y)
    assert (fluxes.noise < fluxes.flux_psf_err).all() and np.ptp(fluxes.noise) < 0.05 * fluxes.noise.mean()
    for kind in ("psf", "gaap"):
        flux, error = (getattr(fluxes, f"flux_{kind}{end}") for end in ("", "_err"))
        pull = (flux - DETECTABLE) / error
        assert abs(pull.mean()) < 4 / math.sqrt(400)
        assert pull.std() == pytest.approx(1.0, abs=4 / math.sqrt(800))


def test_the_aperture_is_that_before_the_psf(fabricate, model):
    """A round Gaussian galaxy: its flux times a^2 / (a^2 + s^2), of the aperture a and the galaxy s alone; 0.5%."""
    galaxy, a = 2.5, 1.0 / SCALE / 2.354820045
    image = np.zeros((N, N))
    axis = np.arange(N) - 350.3
    width = math.hypot(galaxy, math.hypot(fabricate.SIGMA, 12**-0.5))
    line = np.exp(-0.5 * (axis / width) ** 2) / (width * math.sqrt(2.0 * math.pi))
    image += 500.0 * np.outer(line, line)
    steps = (ZERO + np.rint(image / STEP)).astype(np.uint8)
    noise = np.ones((N // 32 + 1, N // 32 + 1), np.float32)
    frame = JointFrame("1", 8, "g", Residual(steps, noise), model, turned(0.0, 0.0), 23.9, SCALE, 6e4)
    flux = forced_fluxes(frame, np.array([350.3]), np.array([350.3])).flux_gaap[0]
    assert flux == pytest.approx(500.0 * a**2 / (a**2 + galaxy**2), rel=0.005)


def test_no_flux_where_the_frame_is_not_known(fabricate, model):
    frame = frames(fabricate, model, 8, bands="g")[0]
    frame.residual.steps[300:340, 300:340] = BLANK
    x, y = np.array([320.0, 100.0, -0.4]), np.array([320.0, 100.0, 350.0])
    fluxes = forced_fluxes(frame, x, y)
    assert np.isfinite(fluxes.flux_psf).tolist() == np.isfinite(fluxes.flux_psf_err).tolist() == [False, True, True]
    assert np.isfinite(fluxes.flux_gaap).tolist() == [False, True, False]  # half of the aperture is beyond the edge


def test_a_blank_pixel_takes_no_light_from_the_aperture(fabricate, model):
    """A star of 600 electrons without noise; a pixel 4 px off its middle and a corner of the aperture are not known."""
    image = np.zeros((N, N))
    fabricate.add_stars(image, [350.3], [350.4], [600.0])
    steps = (ZERO + np.rint(image / STEP / 5.0)).astype(np.uint8)
    steps[350, 354] = steps[360:370, 360:370] = BLANK
    noise = np.full((N // 32 + 1, N // 32 + 1), 5.0, np.float32)
    frame = JointFrame("1", 8, "g", Residual(steps, noise), model, turned(0.0, 0.0), 23.9, SCALE, 6e4)
    fluxes = forced_fluxes(frame, np.array([350.3]), np.array([350.4]))
    assert fluxes.flux_gaap[0] == pytest.approx(600.0, rel=0.02) == pytest.approx(fluxes.flux_psf[0], rel=0.02)
    sides = steps.copy()
    sides[:, 355:] = sides[:, :346] = BLANK  # a third of the aperture, none of the core
    beside = forced_fluxes(replace(frame, residual=Residual(sides, noise)), np.array([350.3]), np.array([350.4]))
    assert np.isfinite(beside.flux_psf).all() and np.isnan(beside.flux_gaap).all()
    steps[350, 352] = BLANK  # within its core
    fluxes = forced_fluxes(frame, np.array([350.3]), np.array([350.4]))
    assert np.isnan(fluxes).all()


def test_means_of_many_faint_visits_have_no_bias(fabricate, model, pix):
    """81 stars of S/N 2.4 in each of 12 frames, none detected; weights that follow the flux make it low. 4 sigma."""
    ra, dec = places(9, 12)
    flux = 0.8 * DETECTABLE
    some = frames(fabricate, model, 12, ra, dec, flux, bands="g" * 12)
    sources = ObjectTable({"ra": ra, "dec": dec, "motion": np.zeros(len(ra), int)})
    none = ObjectTable({"source": np.zeros(0, int), "obsid": np.zeros(0, str), "chip": np.zeros(0, int)})
    forced = forced_photometry(some, sources, none)
    nothing = ObjectTable(
        {name: np.zeros(0, kind) for name, kind in DETECTION_COLUMNS.items()} | {"source": none["source"]}
    )
    columns = _photometry(nothing, forced, BANDS, len(ra))
    for name in ("flux_g", "gaap_flux_g"):
        error = columns[name.replace("flux", "flux_err")].mean()
        assert columns[name].mean() == pytest.approx(flux, abs=4 * error / 9)
    assert (columns["n_forced_g"] == 12).all()


def test_a_brick_with_its_frames(fabricate, model, pix):
    """A faint detection is confirmed, a source without one is added, the others have their forced fluxes."""
    ra, dec = places(3, 9)
    some = frames(fabricate, model, 9, ra, dec, 1.3 * DETECTABLE)
    detected = table(ra[:1], dec[:1], obsid="0", snr=4.0, zeropoint=23.9, flux=200.0)
    alone, _ = merge_brick(pix, [detected], BANDS)
    assert len(alone) == 0 and alone.meta["left_out"] == 1
    sources, detections = merge_brick(pix, [detected], BANDS, joint=some)
    assert len(sources) == 9 and sources.meta["joint"] == 8 and len(detections) == 1
    known = sources["n_detections"] == 1
    assert known.sum() == 1 and np.isnan(sources["star"][~known]).all() and np.isfinite(sources["star"][known]).all()
    assert (sources["n_g"][known], sources["n_forced_g"][known], sources["n_forced_r"][known]) == (1, 1, 2)
    assert (sources["n_forced_g"][~known] == 2).all() and (sources["n_forced_z"] == 0).all()
    for band in "gri":
        pull = (sources[f"flux_{band}"] - 1.3 * DETECTABLE) / sources[f"flux_err_{band}"]
        assert (np.abs(pull[~known]) < 4.5).all()
    assert np.isnan(sources["flux_z"]).all() and np.isnan(sources["total_flux_g"][~known]).all()
    assert (np.diff(sources["_healpix_29"]) > 0).all() and (sources["epoch"][~known] == 6e4).all()
    assert (sources["source_id"] == pix * 2**20 + np.arange(9)).all()


def test_frames_beside_the_brick_and_none(fabricate, model, pix):
    far = frames(fabricate, model, 10, bands="g")
    other = int(healpix.brick_of(RA + 1.0, DEC))
    sources, _ = merge_brick(other, [], BANDS, joint=far)
    assert len(sources) == 0 and sources.meta["joint"] == 0


def test_one_source_in_one_brick_on_a_border(fabricate, model):
    """Frames over the corner of four bricks: each faint source is in exactly one of them."""
    ra, dec = places(5, 11)
    ra0, dec0 = (float(one[0]) for one in healpix.brick_corners(int(healpix.brick_of(RA, DEC))))
    shifted = []
    for frame in frames(fabricate, model, 11, ra, dec, 2.0 * DETECTABLE):
        moved = frame.to_pixel

        def to_pixel(r, d, moved=moved):
            east = (np.asarray(r) - ra0) * math.cos(math.radians(dec0)) / math.cos(math.radians(DEC))
            return moved(RA + east, DEC + np.asarray(d) - dec0)

        shifted.append(JointFrame(**{**vars(frame), "to_pixel": to_pixel}))
    around = {int(healpix.brick_of(ra0 + a * 0.02, dec0 + b * 0.02)) for a in (-1, 0, 1) for b in (-1, 0, 1)}
    found = [len(merge_brick(pix, [], BANDS, joint=shifted)[0]) for pix in around]
    assert sum(found) == pytest.approx(25, abs=1) and max(found) < 25


def test_a_peak_beyond_the_border_confirms_a_detection(fabricate, model):
    """A faint detection at a corner of bricks, whose light is 60 mas away, in another brick."""
    border_ra, border_dec = (one[0] for one in healpix.brick_corners(int(healpix.brick_of(RA, DEC))))
    corner = np.array([border_ra]), np.array([border_dec])
    step = 0.03 * ARCSEC
    for sign in (-1.0, 1.0):
        mean, light = (corner[1] + sign * step, corner[1] - sign * step)
        pix, other = (int(healpix.brick_of(corner[0], dec)[0]) for dec in (mean, light))
        assert pix != other
        some = frames(fabricate, model, 13, [RA], [DEC], 2.0 * DETECTABLE)
        moved = [
            replace(
                frame,
                to_pixel=lambda r, d, to=frame.to_pixel, light=light: to(
                    RA + np.asarray(r) - corner[0][0], DEC + np.asarray(d) - light[0]
                ),
            )
            for frame in some
        ]
        detected = table(corner[0], mean, obsid="0", snr=4.0, zeropoint=23.9, flux=200.0)
        found = [len(merge_brick(number, [detected], BANDS, joint=moved)[0]) for number in (pix, other)]
        assert found == [1, 0]
