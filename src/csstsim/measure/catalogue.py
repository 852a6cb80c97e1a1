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
from csstsim.measure.source_columns import (
    BAD_PIXELS,
    BLENDED,
    COLUMNS,
    KRON_FAILED,
    NEGATIVE_FLUX,
    NO_SHAPE,
    NOT_CENTRED,
    SATURATED,
    SHARP,
    TRUNCATED,
)
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

SHAPE_SNR = 5.0  # minimum S/N for a shape, of the PSF flux, or of the Kron flux with FAINT_SNR
FAINT_SNR = 2.5  # minimum S/N of the PSF flux for a shape, if that of the Kron flux is at least SHAPE_SNR
SURE_SNR = 5.0  # minimum S/N of a source that is no longer in what is left: fainter ones need more frames
STAR_POINT = 0.5  # minimum probability of a point
STAR_SNR = 5.0  # minimum S/N of sources that tell the fraction of stars
STAR_SPREAD = 0.01  # spread of a star from errors of PSF interpolation and centring, in addition to 2.5 x its noise


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


class _Calibration(NamedTuple):
    """What is known of a frame's pixels: the Calibrated frame, bits of `unusable` pixels, its PSF, its window."""

    calibrated: Calibrated
    unusable: IntArray
    model: PsfModel
    window: Window

    def counted(self, found: Sources) -> FloatArray:
        """Return calibrate.Calibrated.counted (n,) at the positions of sources."""
        return self.calibrated.counted(found.x, found.y)

    def psf(self, found: Sources) -> SourcePsfs:
        """Return the PSFs at the positions of sources."""
        return self.model.at(found.x + self.window.x0, found.y + self.window.y0)


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
    known = _Calibration(calibrated, unusable, model, window)
    read_noise = float(np.mean(list(calibrated.read_noise.values())))
    stars = bright_stars(calibrated.electrons, unusable, psf, read_scattered(psf), chip, window, read_noise)
    before = block_means(calibrated.electrons, calibrated.readout)
    frame = isophotes(calibrated.electrons, stars, unusable)
    stars.restore_to(frame.image)
    channels = channel_figures(calibrated, before, frame.image, frame.rms)
    families = profile_tables(psf, (window.x0, window.y0), window.shape, telescope.pixel_scale, FAMILIES)
    of_stars = _of_stars(frame, kernel)
    parts = [_measured(of_stars, _sources(of_stars, known), known, families[0])]
    stars.subtract_from(frame.image)
    rms = float(np.median(frame.rms[::4, ::4]))
    stars.add_noise_to(frame.rms)
    found, snr = peaks(frame, kernel, unusable)
    detections = combine(frame, found, snr, _fit(frame, found, known), kernel)
    table = _sources(detections, known)
    profiles = _profiles_of(detections, table, known, families)
    parts.append(_measured(detections, table, known, profiles, keep))
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    table |= _on_sky(table, wcs, observer, telescope.pixel_scale)
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
    known: _Calibration,
    profiles: ProfileTables,
    keep: Callable[[Residual], None] | None = None,
) -> dict[str, AnyArray]:
    """Return the columns {name: (n,)} of `combine.Detections`, measured on the frame without close neighbours.

    table: `_sources` of the frame with all of them.
    """
    sharp = table["flags"] & SHARP  # a part of a track, without the other parts, looks like a source
    unusable = known.unusable
    neighbours = Neighbours.of(found, table, known.psf(found), profiles)
    alone = np.flatnonzero(neighbours.colour < 0)
    part = found.rows(alone)
    rows = {name: column[alone] for name, column in table.items()}
    for name, values in total_light(part, rows, unusable, known.counted(part), profiles).items():
        table[name] = np.full(len(found.x), np.nan)  # of the others, below
        table[name][alone] = values

    def measure(rows: IntArray) -> dict[str, AnyArray]:
        part = found.rows(rows).again()
        columns = _sources(part, known)
        return columns | total_light(part, columns, unusable, known.counted(part), profiles)

    def model_of(rows: IntArray) -> LightModels:
        part = found.rows(rows)
        columns = {name: table[name][rows] for name in table}
        return light_models(part, columns, unusable, known.counted(part), profiles)

    measured_apart(found, table, neighbours, model_of, measure)
    if keep is not None:
        sure = np.flatnonzero(table["snr"] >= SURE_SNR)
        keep(residual(found.image, neighbours.left(sure, model_of), found.rms, unusable))
    return table | {"flags": table["flags"] | sharp}


def _profiles_of(
    found: Detections,
    table: Mapping[str, AnyArray],
    known: _Calibration,
    families: Sequence[ProfileTables],
) -> ProfileTables:
    """Return the profiles of the family that the frame's bright galaxies have; `table`: `_sources` of `found`."""
    rows = np.argsort(-found.snr, kind="stable")[:SOURCES_MAX]
    rows = rows[(found.snr[rows] > SNR_MIN) & (table["flags"][rows] & ~BLENDED == 0)]
    bright = {name: column[rows] for name, column in table.items()}
    part = found.rows(rows)
    return likelier_family(part, bright, known.unusable, known.counted(part), families)


def _on_sky(table: dict[str, AnyArray], wcs: ChipWCS, observer: Observer, pixel_scale: float) -> dict[str, FloatArray]:
    """Return the columns of directions and shapes on the sky, from those on pixels, which are taken out of the table.

    pixel_scale: arcsec.
    """
    apparent = wcs.pixel_to_world(table["x"], table["y"])
    ra, dec = icrs(*apparent, observer)
    g1, g2 = _sky_shapes(table.pop("e"), wcs.jacobian(ra, dec, seen=apparent))
    directions = {"ra_apparent": apparent[0], "dec_apparent": apparent[1], "ra": ra, "dec": dec}
    return directions | {"g1": g1, "g2": g2, "pos_err": table.pop("pos_err_px") * pixel_scale}


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


def _fit(frame: Frame | Detections, sources: Sources, known: _Calibration) -> PsfFits:
    """Return the fits of the PSF to sources on a frame's image."""
    counted = known.counted(sources)
    return fit_sources(frame.image, frame.rms, known.unusable, sources.x, sources.y, counted, known.psf(sources))


def _sources(found: Detections, known: _Calibration) -> dict[str, AnyArray]:
    """Return {name: (n,)}: the columns of sources on the frame as it is, neighbours included."""
    window = known.window
    counted = known.counted(found)
    fit = _fit(found, found, known)
    flux = fit.flux
    error = fit.flux_error
    kron = kron_flux(found, counted)
    snr = np.where(error > 0, np.nan_to_num(flux) / np.where(error > 0, error, 1.0), 0.0)
    row = np.clip(np.rint(found.y).astype(int), 0, window.ny - 1)
    column = np.clip(np.rint(found.x).astype(int), 0, window.nx - 1)
    psf = known.psf(found)
    bright = (snr >= SHAPE_SNR) | ((kron.flux >= SHAPE_SNR * kron.error) & (snr >= FAINT_SNR))
    shapes = _shapes(found, bright, counted, known.unusable, psf)
    aperture, aperture_error = aperture_flux(found, counted, known.model.enclosed(APERTURE)[psf.cell])
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
        "x": found.x + window.x0,
        "y": found.y + window.y0,
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
