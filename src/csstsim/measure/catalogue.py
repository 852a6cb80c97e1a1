"""Measure one imaging science frame: calibrated electrons in, catalogue out.

Combines detection, photometry, WCS and astrometry. A pixel position gives an apparent direction; `ra`, `dec` are that
direction with aberration and light deflection at the spacecraft removed: ICRS at the epoch, with the source's own
proper motion and parallax still included. Fluxes are electrons of the exposure; magnitudes are AB, with the filter's
zero point (no atmosphere).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.types import AnyArray, BoolArray, ComplexArray, FloatArray, Floats, IntArray
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.table import ObjectTable
from csstsim.measure.calibration.bad_pixels import BAD, FULL, RAY, fill_bad_pixels
from csstsim.measure.calibration.channel_figures import block_means, channel_figures
from csstsim.measure.detection.bright_stars import bright_stars
from csstsim.measure.detection.combine import Detections, combine
from csstsim.measure.detection.detect import isophotes, peaks, star_sources
from csstsim.measure.detection.maps import BIN
from csstsim.measure.detection.residual import Residual, residual
from csstsim.measure.detection.tracks import tracks
from csstsim.measure.light.apertures import APERTURE, aperture_flux, kron_flux
from csstsim.measure.light.centroid import position_errors
from csstsim.measure.light.family import SNR_MIN, SOURCES_MAX, likelier_family
from csstsim.measure.light.moments import measure_shapes, on_sky, reduced, without_psf
from csstsim.measure.light.neighbours import Neighbours, measured_apart
from csstsim.measure.light.photometry import fit_sources, psf_model
from csstsim.measure.light.pixels import Pixels
from csstsim.measure.light.profile_tables import FAMILIES, profile_tables
from csstsim.measure.light.star_fractions import with_star_fractions
from csstsim.measure.light.total_light import light_models, total_light
from csstsim.optics.scatter.scattered_light import read_scattered

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.instrument.chip import Chip, Window
    from csstsim.instrument.filter import Filter
    from csstsim.instrument.pointing import Pointing
    from csstsim.instrument.telescope import Telescope
    from csstsim.measure.calibration.calibrate import Calibrated
    from csstsim.measure.detection.detect import Frame, Sources
    from csstsim.measure.light.photometry import PsfFits, PsfModel, SourcePsfs
    from csstsim.measure.light.profile_tables import ProfileTables
    from csstsim.measure.light.total_light import LightModels
    from csstsim.optics.geometry.wcs import ChipWCS
    from csstsim.optics.psf.psf_file import PsfSet

# Bits of `flags`.
BLENDED = 1
TRUNCATED = 2
SATURATED = 4
NEGATIVE_FLUX = 8
KRON_FAILED = 16
NOT_CENTRED = 32
SHARP = 64
BAD_PIXELS = 128
NO_SHAPE = 256
FLAGS = {
    BLENDED: "deblended from another source",
    TRUNCATED: "reaches the edge of the frame",
    SATURATED: "saturated pixels within 3 px; they are left out of the fit",
    NEGATIVE_FLUX: "PSF or Kron flux is not positive: its magnitude is NaN",
    KRON_FAILED: "no Kron radius: the smallest aperture was used",
    NOT_CENTRED: "windowed position failed: x, y are the isophotal barycentre",
    SHARP: "sharper than the PSF by 5 sigma, or a line narrower than it: cosmic ray or defect",
    BAD_PIXELS: "defects or cosmic rays within 3 px; they are left out of the fit",
    NO_SHAPE: "S/N below 5, or no adaptive moments: hsm_sigma, hsm_e1, hsm_e2, resolution, g1, g2, g_err are NaN",
}
SHAPE_SNR = 5.0  # minimum S/N for a shape, of the PSF flux, or of the Kron flux with FAINT_SNR
FAINT_SNR = 2.5  # minimum S/N of the PSF flux for a shape, if that of the Kron flux is at least SHAPE_SNR
SURE_SNR = 5.0  # minimum S/N of a source that is no longer in what is left: fainter ones need more frames
STAR_POINT = 0.5  # minimum probability of a point
STAR_SNR = 5.0  # minimum S/N of sources that tell the fraction of stars
STAR_SPREAD = 0.01  # spread of a star from errors of PSF interpolation and centring, in addition to 2.5 x its noise

# Type and meaning of each column; pixel centres are at whole numbers, the chip's first at 0
COLUMNS = {
    "obsid": (str, "exposure"),
    "chip": (np.int16, "chip"),
    "filter": (str, "filter"),
    "number": (np.int32, "row: 0 is the highest S/N"),
    "x": (np.float64, "px, column on the whole chip, from 0"),
    "y": (np.float64, "px, row on the whole chip, from 0"),
    "ra": (np.float64, "deg, ICRS at the epoch of the exposure: aberration and light deflection undone"),
    "dec": (np.float64, "deg, the same"),
    "ra_apparent": (np.float64, "deg, apparent direction, that of the image's WCS"),
    "dec_apparent": (np.float64, "deg, the same"),
    "pos_err": (np.float32, "arcsec on an axis"),
    "flux_psf": (np.float64, "electrons of the exposure, fit of the PSF"),
    "flux_psf_err": (np.float64, "its error"),
    "mag_psf": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_psf_err": (np.float64, "its error"),
    "flux_aper": (np.float64, "electrons within 4 px over the fraction of a point's flux there: the total of a point"),
    "flux_aper_err": (np.float64, "its error"),
    "mag_aper": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_aper_err": (np.float64, "its error"),
    "flux_kron": (np.float64, "electrons in the Kron ellipse, not corrected for the flux beyond it"),
    "flux_kron_err": (np.float64, "its error"),
    "mag_kron": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_kron_err": (np.float64, "its error"),
    "flux_total": (
        np.float64,
        "electrons of the exposure: total flux of a fitted profile (measure.light.total_light)",
    ),
    "flux_total_err": (np.float64, "its error, size and profile free"),
    "mag_total": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_total_err": (np.float64, "its error"),
    "flux_gaap": (
        np.float64,
        "electrons in a Gaussian aperture, FWHM 1 arcsec, before the PSF: for colours",
    ),
    "flux_gaap_err": (np.float64, "its error"),
    "mag_gaap": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_gaap_err": (np.float64, "its error"),
    "half_light": (np.float32, "arcsec, half-light radius sqrt(a b) of the fitted profile before the PSF"),
    "point": (
        np.float32,
        "probability of a point, from the fit of profiles and the fraction of points at its magnitude; star: 0.5 on",
    ),
    "snr": (np.float32, "flux_psf / flux_psf_err; 0 where there is no error"),
    "fwhm": (np.float32, "px, twice the half-light radius"),
    "a": (np.float32, "px, major axis of the isophote's moments, rms"),
    "b": (np.float32, "px, minor axis"),
    "theta": (np.float32, "rad, of the major axis from +x to +y"),
    "hsm_sigma": (np.float32, "px, adaptive moments: det(M)^(1/4)"),
    "hsm_e1": (np.float32, "distortion (a2 - b2) / (a2 + b2) on pixel axes, along x"),
    "hsm_e2": (np.float32, "the same, at 45 deg towards +y"),
    "psf_sigma": (np.float32, "px, adaptive moments of the PSF model at the source"),
    "psf_e1": (np.float32, "distortion of the PSF model at the source"),
    "psf_e2": (np.float32, "the same"),
    "resolution": (np.float32, "0 for a star, 1 for a galaxy much larger than the PSF"),
    "g1": (np.float32, "ellipticity (a - b) / (a + b) without the PSF, axis 1 along +RA (east)"),
    "g2": (np.float32, "the same, axis 2 at 45 deg towards north"),
    "g_err": (np.float32, "error of g1, g2, on an axis"),
    "chi2": (np.float32, "reduced, of the PSF's fit"),
    "spread": (np.float32, "size beyond the PSF (measure.light.photometry): 0 for a star"),
    "spread_err": (np.float32, "its error"),
    "star": (
        bool,
        "`point` is at least 0.5; where it is not known, no wider than the PSF within 2.5 sigma of `spread`",
    ),
    "zeropoint": (np.float64, "AB magnitude of 1 electron"),
    "rms": (np.float32, "electrons, noise of the background at the source"),
    "flags": (np.int32, "bits, see below"),
}


class FrameFacts(NamedTuple):
    """The exposure and chip of a frame, and the window of the chip that it covers."""

    obsid: str
    chip: Chip
    filter: Filter
    telescope: Telescope
    pointing: Pointing
    window: Window

    @classmethod
    def of(cls, job: Job) -> FrameFacts:
        """Return the FrameFacts of a job."""
        exposure = job.exposure
        return cls(job.obsid, job.chip, exposure.filter, exposure.telescope, job.pointing, job.window)


def measure_frame(
    calibrated: Calibrated,
    psf: PsfSet,
    wcs: ChipWCS,
    observer: Observer,
    facts: FrameFacts,
    keep: Callable[[Residual], None] | None = None,
) -> ObjectTable:
    """Measure the sources of one frame.

    The background is subtracted from `calibrated.electrons` in place.

    Parameters
    ----------
    calibrated : Calibrated
        Electrons of the frame's window (measure.calibration.calibrate).
    psf : PsfSet
        Of the chip.
    wcs : ChipWCS
        Of the exposure and chip.
    observer : Observer
        The spacecraft (catalog.astrometry.ephemeris).
    facts : FrameFacts
        The exposure and chip of the frame.
    keep : callable, optional
        It is called with what is left of the frame without the models of its sources (measure.detection.residual).

    Returns
    -------
    ObjectTable
        The columns are `COLUMNS`, rows by decreasing S/N. Columns from adaptive moments (light.moments) are NaN where
        these failed; g1, g2, g_err also where the source is not resolved. g1, g2 compare with the truth's e1, e2
        sheared by its g1, g2. `meta` holds the facts of the frame: background and rms in electrons, n_eff px,
        depth_5sigma AB, window, channels (measure.calibration.channel_figures).

    Raises
    ------
    InputError
        For anything but an imaging science frame.
    """
    obsid, chip, filter, telescope, pointing, window = facts
    if chip.kind != "imaging" or pointing.type != "SCIE":
        raise InputError(
            "only imaging science frames are measured",
            key=f"{obsid} chip {chip.id}",
            value=f"{pointing.type} behind {filter.name}",
        )
    zeropoint = filter.zeropoint(telescope) + 2.5 * np.log10(pointing.exptime)
    model = psf_model(psf, (window.x0, window.y0), window.shape)
    level = float(np.median(calibrated.electrons[::8, ::8]))
    kernel = model.kernel()
    unusable = fill_bad_pixels(calibrated, model)
    read_noise = float(np.mean(list(calibrated.read_noise.values())))
    stars = bright_stars(calibrated.electrons, unusable, psf, read_scattered(psf), chip, window, read_noise)
    before = block_means(calibrated.electrons, calibrated.readout)
    frame = isophotes(calibrated.electrons, stars, unusable)
    stars.restore_to(frame.image)
    channels = channel_figures(calibrated, before, frame.image, frame.rms)
    families = profile_tables(psf, (window.x0, window.y0), window.shape, telescope.pixel_scale, FAMILIES)
    of_stars = _of_stars(frame, kernel)
    counted = calibrated.counted(of_stars.x, of_stars.y)
    table = _sources(of_stars, counted, unusable, model, window)
    parts = [_measured(of_stars, table, calibrated, unusable, model, window, families[0])]
    stars.subtract_from(frame.image)
    rms = float(np.median(frame.rms[::4, ::4]))
    stars.add_noise_to(frame.rms)
    found, snr = peaks(frame, kernel, unusable)
    counted = calibrated.counted(found.x, found.y)
    detections = combine(frame, found, snr, _fit(frame, found, counted, unusable, model, window), kernel)
    counted = calibrated.counted(detections.x, detections.y)
    table = _sources(detections, counted, unusable, model, window)
    profiles = _profiles_of(detections, table, counted, unusable, families)
    parts.append(_measured(detections, table, calibrated, unusable, model, window, profiles, keep))
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    table["ra_apparent"], table["dec_apparent"] = wcs.pixel_to_world(table["x"], table["y"])
    table["ra"], table["dec"] = icrs(table["ra_apparent"], table["dec_apparent"], observer)
    apparent = table["ra_apparent"], table["dec_apparent"]
    table["g1"], table["g2"] = _sky_shapes(table.pop("e"), wcs.jacobian(table["ra"], table["dec"], seen=apparent))
    table["pos_err"] = table.pop("pos_err_px") * telescope.pixel_scale
    for kind in ("psf", "aper", "kron", "total", "gaap"):
        magnitudes = magnitude(table[f"flux_{kind}"], table[f"flux_{kind}_err"], zeropoint)
        table[f"mag_{kind}"], table[f"mag_{kind}_err"] = magnitudes
    table |= _stars(table)
    n = len(table["x"])
    table |= {"zeropoint": np.full(n, zeropoint), "chip": np.full(n, chip.id)}
    table |= {"obsid": np.full(n, obsid), "filter": np.full(n, filter.name)}
    order = np.lexsort((table["x"], table["y"], -table["snr"]))
    table["number"] = np.argsort(order)
    columns: dict[str, AnyArray] = {
        name: np.asarray(table[name])[order].astype(kind) for name, (kind, _) in COLUMNS.items()
    }
    n_eff = float(np.median(model.n_eff))
    info = {
        "obsid": obsid,
        "chip": chip.id,
        "filter": filter.name,
        "exptime": pointing.exptime,
        "zeropoint": float(zeropoint),
        "background": level,
        "rms": rms,
        "n_eff": n_eff,
        "depth_5sigma": float(zeropoint - 2.5 * np.log10(point_source_flux(5.0, rms**2, n_eff))),
        "profiles": profiles.family.name,
        "sources": n,
        "window": [window.x0, window.x1, window.y0, window.y1],
        "channels": channels,
    }
    return ObjectTable(columns, info)


def _measured(
    found: Detections,
    table: dict[str, AnyArray],
    calibrated: Calibrated,
    unusable: IntArray,
    model: PsfModel,
    window: Window,
    profiles: ProfileTables,
    keep: Callable[[Residual], None] | None = None,
) -> dict[str, AnyArray]:
    """Return the columns {name: (n,)} of `combine.Detections`, measured on the frame without close neighbours.

    table: `_sources` of the frame with all of them.
    """
    sharp = table["flags"] & SHARP  # a part of a track, without the other parts, looks like a source
    psf = model.at(found.x + window.x0, found.y + window.y0)
    neighbours = Neighbours.of(found, table, psf, profiles)
    alone = np.flatnonzero(neighbours.colour < 0)
    counted = calibrated.counted(found.x[alone], found.y[alone])
    rows = {name: column[alone] for name, column in table.items()}
    for name, values in total_light(found.rows(alone), rows, unusable, counted, profiles).items():
        table[name] = np.full(len(found.x), np.nan)  # of the others, below
        table[name][alone] = values

    def measure(rows: IntArray) -> dict[str, AnyArray]:
        part = found.rows(rows).again()
        counted = calibrated.counted(part.x, part.y)
        columns = _sources(part, counted, unusable, model, window)
        return columns | total_light(part, columns, unusable, counted, profiles)

    def model_of(rows: IntArray) -> LightModels:
        part = found.rows(rows)
        counted = calibrated.counted(part.x, part.y)
        return light_models(part, {name: table[name][rows] for name in table}, unusable, counted, profiles)

    measured_apart(found, table, neighbours, model_of, measure)
    if keep is not None:
        sure = np.flatnonzero(table["snr"] >= SURE_SNR)
        keep(residual(found.image, neighbours.left(sure, model_of), found.rms, unusable))
    return table | {"flags": table["flags"] | sharp}


def _profiles_of(
    found: Detections,
    table: Mapping[str, AnyArray],
    counted: FloatArray,
    unusable: IntArray,
    families: Sequence[ProfileTables],
) -> ProfileTables:
    """Return the profiles of the family that the frame's bright galaxies have; `table`: `_sources` of `found`."""
    rows = np.argsort(-found.snr, kind="stable")[:SOURCES_MAX]
    rows = rows[(found.snr[rows] > SNR_MIN) & (table["flags"][rows] & ~BLENDED == 0)]
    bright = {name: column[rows] for name, column in table.items()}
    return likelier_family(found.rows(rows), bright, unusable, counted[rows], families)


def _stars(table: Mapping[str, AnyArray]) -> dict[str, AnyArray]:
    """Return the columns point and star of all sources of a frame."""
    known = (table["snr"] >= STAR_SNR) & ((table["flags"] & ~(BLENDED | NO_SHAPE)) == 0)
    point = with_star_fractions(table["point"], table["mag_psf"], known)
    return {"point": point, "star": np.where(np.isfinite(point), point >= STAR_POINT, table["star"])}


def _of_stars(frame: Frame, kernel: FloatArray) -> Detections:
    """Return the combine.Detections of the bright stars of a detect.Frame, to whose image their light was added."""
    sources = star_sources(frame, kernel)
    n = len(frame.stars)
    return Detections(
        **vars(sources),
        extended=np.zeros(n, bool),
        snr=np.full(n, np.inf),
        image=frame.image,
        rms=frame.rms,
        segments=frame.segments,
    )


def _fit(
    frame: Frame | Detections,
    sources: Sources,
    counted: FloatArray,
    unusable: IntArray,
    model: PsfModel,
    window: Window,
) -> PsfFits:
    psf = model.at(sources.x + window.x0, sources.y + window.y0)
    return fit_sources(frame.image, frame.rms, unusable, sources.x, sources.y, counted, psf)


def _sources(
    found: Detections, counted: FloatArray, unusable: IntArray, model: PsfModel, window: Window
) -> dict[str, AnyArray]:
    x = found.x + window.x0
    y = found.y + window.y0
    fit = _fit(found, found, counted, unusable, model, window)
    flux = fit.flux
    error = fit.flux_error
    kron = kron_flux(found, counted)
    snr = np.where(error > 0, np.nan_to_num(flux) / np.where(error > 0, error, 1.0), 0.0)
    row = np.clip(np.rint(found.y).astype(int), 0, window.ny - 1)
    column = np.clip(np.rint(found.x).astype(int), 0, window.nx - 1)
    psf = model.at(x, y)
    bright = (snr >= SHAPE_SNR) | ((kron.flux >= SHAPE_SNR * kron.error) & (snr >= FAINT_SNR))
    shapes = _shapes(found, bright, counted, unusable, psf)
    aperture, aperture_error = aperture_flux(found, counted, model.enclosed(APERTURE)[psf.cell])
    track = tracks(found.image, found.rms, found.x, found.y, found.snr)
    model_flux = np.maximum(np.nan_to_num(flux), np.nan_to_num(error))
    position_error = position_errors(
        found.image, found.rms, found.x, found.y, found.window, found.extended, model_flux, counted, psf
    )
    flags = (
        BLENDED * ((found.sep_flag & 1) != 0)
        | TRUNCATED * ((found.sep_flag & 2) != 0)
        | SATURATED * ((fit.unusable & FULL) > 0)
        | BAD_PIXELS * ((fit.unusable & (BAD | RAY)) > 0)
        | NEGATIVE_FLUX * ~((flux > 0) & (kron.flux > 0))
        | KRON_FAILED * kron.failed
        | NOT_CENTRED * found.window_failed
        | SHARP * ((fit.spread < -STAR_SPREAD - 5.0 * fit.spread_error) | track)
        | NO_SHAPE * np.isnan(shapes["hsm_sigma"])
    )
    return shapes | {
        "x": x,
        "y": y,
        "flux_psf": flux,
        "flux_psf_err": error,
        "flux_kron": kron.flux,
        "flux_kron_err": kron.error,
        "flux_aper": aperture,
        "flux_aper_err": aperture_error,
        "snr": snr,
        "fwhm": 2.0 * found.half_light,
        "a": found.a,
        "b": found.b,
        "theta": found.theta,
        "chi2": fit.chi2,
        "spread": fit.spread,
        "spread_err": fit.spread_error,
        "rms": found.rms[row // BIN, column // BIN],
        "star": fit.spread < STAR_SPREAD + 2.5 * fit.spread_error,
        "flags": flags,
        "pos_err_px": position_error,
    }


def _shapes(
    found: Detections, bright: BoolArray, counted: FloatArray, unusable: IntArray, psf: SourcePsfs
) -> dict[str, AnyArray]:
    """Return the columns of shapes of `bright` sources; `e` is the complex distortion on pixel axes without the PSF."""
    pixels = Pixels(found.image, found.rms, unusable, found.segments)
    size = np.sqrt(found.a * found.b)
    shapes = measure_shapes(pixels, found.segment, found.x, found.y, size, bright, counted, psf)
    corrected = without_psf(shapes)
    return {
        "hsm_sigma": shapes.source.sigma,
        "hsm_e1": shapes.source.e1,
        "hsm_e2": shapes.source.e2,
        "psf_sigma": shapes.psf.sigma,
        "psf_e1": shapes.psf.e1,
        "psf_e2": shapes.psf.e2,
        "resolution": corrected.resolution,
        "e": corrected.e,
        "g_err": corrected.error / (1.0 + np.sqrt(1.0 - np.abs(corrected.e) ** 2)),
    }


def _sky_shapes(e: ComplexArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    g = reduced(on_sky(e, jacobian))
    return g.real, g.imag


def magnitude(flux: ArrayLike, error: ArrayLike, zeropoint: float) -> tuple[FloatArray, FloatArray]:
    """Return AB magnitude and error of a flux and its error, electron; NaN where the flux is not positive."""
    good = np.asarray(flux) > 0
    safe = np.where(good, flux, 1.0)
    mag = np.where(good, zeropoint - 2.5 * np.log10(safe), np.nan)
    return mag, np.where(good, 2.5 / np.log(10.0) * np.asarray(error) / safe, np.nan)


def point_source_snr(flux: Floats, variance: Floats, n_eff: Floats) -> FloatArray:
    """Return the S/N of optimal photometry: flux / sqrt(flux + n_eff variance).

    `flux` electron, `variance` of the background and read noise electron^2 / px, `n_eff` = 1 / sum(p^2) px.
    """
    return np.asarray(flux) / np.sqrt(np.maximum(flux, 0.0) + n_eff * variance)


def point_source_flux(snr: Floats, variance: Floats, n_eff: Floats) -> Floats:
    """Return the flux (electron) of a point source of the given S/N: the inverse of `point_source_snr`.

    >>> float(point_source_flux(5.0, 0.0, 16.0))  # without background, with its Poisson noise alone: snr^2
    25.0
    >>> flux = point_source_flux(5.0, 40.0, 16.0)
    >>> round(float(point_source_snr(flux, 40.0, 16.0)), 9)
    5.0
    """
    return 0.5 * snr * (snr + np.sqrt(snr**2 + 4.0 * n_eff * variance))
