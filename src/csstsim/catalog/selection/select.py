"""Which objects reach a chip, their flux there and the size of their stamps (paper, section 4.1).

`select_objects` turns a catalogue into the table of one chip in one exposure. An object is rendered at its apparent
direction (catalog.astrometry.reduction), with the WCS of the image.

Shapes stay as in the catalogue. Aberration is conformal: it only stretches lengths, by up to 1.3e-4. The deflection of
light shears by 2e-8 at 90 deg from the Sun. Both are omitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.catalog.flags import BAD_VALUE, STRONG_LENSING, TRUNCATED_STAMP
from csstsim.catalog.hooks import dimming_of, fractions_of
from csstsim.catalog.light.object_spectra import ROW
from csstsim.catalog.light.photometry import rate_to_mag
from csstsim.catalog.selection.positions import objects_near, reaches_window, visible_time
from csstsim.catalog.selection.reach import (
    POINT_MAX,
    POINT_MIN,
    REACH_MAX,
    STAR_MIN,
    galaxy_radius,
    point_reach,
    wing_reach,
)
from csstsim.catalog.selection.renderable import unusable
from csstsim.catalog.selection.row_order import back, canonical_order
from csstsim.catalog.table import GALAXY, STAR, ObjectTable, lensed
from csstsim.universe.lensing.lensing import magnification

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.catalog.base import CatalogBase
    from csstsim.catalog.changing.motion import Interval
    from csstsim.instrument.chip import Window
    from csstsim.instrument.filter import Filter
    from csstsim.instrument.telescope import Telescope
    from csstsim.optics.geometry.wcs import ChipWCS
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.optics.scatter.scattered_light import Scattered


@dataclass(frozen=True)
class Noise:
    """The contributions to a pixel's noise, without objects."""

    sky: float  # electron / s / pixel
    dark: float  # electron / s / pixel
    read_noise: float  # electron

    def variance(self, exptime: float) -> float:
        """Return the variance of one pixel [electron^2]."""
        return (self.sky + self.dark) * exptime + self.read_noise**2


@dataclass(frozen=True)
class ChipView:
    """One chip in one exposure: its window, optics and noise, as selection needs them."""

    wcs: ChipWCS
    observer: Observer
    window: Window  # of the chip's pixels
    filter: Filter
    telescope: Telescope
    exptime: float  # s
    noise: Noise
    scattered: Scattered | None = None  # light in the PSF's wing and ghosts
    box: float = POINT_MAX  # half the side of the stored PSF [pixel]
    disperser: Disperser | None = None  # of a slitless chip, which disperses light away from x, y
    interval: Interval | None = None  # of the exposure; None: objects neither move nor vary

    @property
    def variance(self) -> float:
        """Variance of one pixel without objects [electron^2]."""
        return self.noise.variance(self.exptime)


def select_objects(
    catalog: CatalogBase, view: ChipView, mag_limit: float | None = None, rotated: bool = False
) -> ObjectTable:
    """Return the ObjectTable of the objects that reach the window of a chip, with the columns the renderer needs.

    mag_limit: fainter objects [mag in the filter] are omitted; rotated: turn intrinsic ellipticities by 90 degrees
    (the paper's twin campaign, in which nothing else differs).

    ra, dec become the apparent direction. Added columns: ra_orig, dec_orig (the catalogue's, J2000), ra_epoch,
    dec_epoch (ICRS at the epoch, to compare with measurements), x, y (0-based pixel), mag (this filter), flux0..3
    (electron / s, magnified), reach (pixel, half the side of the stamp), lost (fraction of a galaxy's flux that may
    lie beyond it), wing (pixel, radius at which noise hides the flux beyond the PSF's box; 0: it hides all of it),
    flags. mag_* are as observed, magnification included. Rows with an unusable value are flagged and have zero flux;
    they stay in the table if they lie on the window or their position is unknown. Behind a grating x, y is the position
    without the grating, flux0..3 and mag are those of the first order, and the column `catalog_row` is the object's row
    in the catalogue, for its spectrum (catalog.light.object_spectra). A table with rates gets the columns of
    catalog.changing.motion.trails, whose position is the object's. One with variable flux gets `dmag` (mag by which it
    is fainter than mag_*; it is in mag and flux0..3). `meta` gets `dropped` (counts by reason), `truth_hash`.
    """
    candidates = _candidates(catalog, view)
    bound = catalog.rate_bound(candidates.rows, view.filter, view.telescope)
    if bound is not None:  # spectra of objects that cannot reach the window are not summed
        electrons = bound * candidates.flux_factor * _magnification(candidates.table)[0] * candidates.seconds
        candidates = candidates.take(_could_reach(candidates.table, candidates.positions, electrons, view))
    table = _turned(candidates.table) if rotated else candidates.table
    mu, thin = _magnification(table)
    order = canonical_order(table)  # sums by chunks must not depend on the order of the rows
    flux = catalog.load_fluxes(candidates.rows[order], view.filter, view.telescope)[back(order)]
    flux = flux * (mu * candidates.flux_factor)[:, None]
    bad = unusable(table, flux)
    flux[bad] = 0.0
    rate = flux.sum(axis=1)
    mag = np.where(bad, np.nan, rate_to_mag(rate, view.filter, view.telescope))
    extent = _extent(table, bad, rate * candidates.seconds, view)
    touches = reaches_window(candidates.positions, np.where(bad, 0, extent.farthest), view.window, view.disperser)
    touches |= ~np.isfinite(table["ra"] + table["dec"])
    faint = mag > (np.inf if mag_limit is None else mag_limit)
    chosen = table.with_columns(
        ra_orig=table["ra"],
        dec_orig=table["dec"],
        **candidates.positions,
        mag=mag.astype(np.float32),
        **_magnified(table, catalog.region.bands, mu),
        **{f"flux{i}": flux[:, i] for i in range(flux.shape[1])},
        reach=extent.reach,
        lost=extent.lost,
        wing=extent.wing.astype(np.float32),
        flags=_flags(table, bad, extent.truncated, thin),
        **({} if view.disperser is None else {ROW: candidates.rows}),
        **({} if candidates.dmag is None else {"dmag": candidates.dmag.astype(np.float32)}),
    ).take(touches & ~faint)
    dropped = {"outside": len(catalog.table) - int(touches.sum()), "faint": int((touches & faint).sum())}
    chosen.meta = {"dropped": dropped, "truth_hash": catalog.truth_hash}
    return chosen


@dataclass(frozen=True)
class Candidates:
    """Objects that may reach a window, before their flux is known; n of them."""

    rows: IntArray  # (n,) of the catalogue
    table: ObjectTable  # of n rows, the catalogue's
    positions: dict[str, FloatArray]  # {name: (n,) values}, of `objects_near`
    seconds: FloatArray  # (n,) s, of `visible_time`
    dmag: (
        FloatArray | None
    )  # (n,) mag by which they are fainter in this exposure, if the catalogue has variable objects
    flux_factor: FloatArray  # (n,) the same as a factor; 1 without dmag

    def take(self, chosen: BoolArray) -> Candidates:
        """Return those of a mask (n,)."""
        return Candidates(
            self.rows[chosen],
            self.table.take(chosen),
            {name: v[chosen] for name, v in self.positions.items()},
            self.seconds[chosen],
            None if self.dmag is None else self.dmag[chosen],
            self.flux_factor[chosen],
        )


def _candidates(catalog: CatalogBase, view: ChipView) -> Candidates:
    """Return the Candidates of a catalogue by their positions alone."""
    disperser = view.disperser
    interval = view.interval
    dispersed = 0.0 if disperser is None else disperser.gratings.reach
    near = objects_near(catalog.table, view.wcs, view.observer, view.window, dispersed, interval)
    rows = near.rows
    table = catalog.table.take(rows)
    if disperser is None and (fractions := fractions_of(catalog, rows, view.filter)):
        table = table.with_columns(**fractions)
    dmag = None if interval is None else dimming_of(catalog, rows, interval, view.filter)
    flux_factor = np.ones(len(rows)) if dmag is None else 10 ** (-0.4 * dmag)
    seconds = visible_time(near.positions, view.exptime, view.telescope.pixel_scale)
    return Candidates(rows, table, near.positions, seconds, dmag, flux_factor)


def _flags(table: ObjectTable, bad: BoolArray, truncated: BoolArray, thin: BoolArray) -> IntArray:
    """Return (n,) int32, the catalogue's flags with those of unusable values, cut stamps and lenses that are strong."""
    flags = table["flags"] | np.where(bad, BAD_VALUE, 0) | np.where(truncated, TRUNCATED_STAMP, 0)
    strong = (table["obj_type"] != STAR) & ~thin & ~bad
    return (flags | np.where(strong, STRONG_LENSING, 0)).astype(np.int32)


def _could_reach(
    table: ObjectTable, positions: Mapping[str, FloatArray], electrons: FloatArray, view: ChipView
) -> BoolArray:
    """Return (n,) bool: whether objects of up to so many electrons could reach the window, or their flux is unknown.

    `_extent` is computed only for objects that are outside the window.
    """
    could = reaches_window(positions, np.zeros(len(electrons)), view.window, view.disperser)
    could |= ~np.isfinite(positions["x"] + electrons)
    rest = np.flatnonzero(~could)
    table = table.take(rest)
    electrons = electrons[rest]
    extent = _extent(table, unusable(table, electrons[:, None]), electrons, view)
    of_rest = {name: v[rest] for name, v in positions.items()}
    could[rest] = reaches_window(of_rest, extent.farthest, view.window, view.disperser)
    return could


def _magnified(table: ObjectTable, bands: Iterable[str], mu: FloatArray) -> dict[str, FloatArray]:
    """Return {mag_B: observed magnitudes}; NaN in a band for which the catalogue's table has none."""
    given = {f"mag_{band}": table.get(f"mag_{band}", np.full(len(mu), np.nan)) for band in bands}
    return {name: (values - 2.5 * np.log10(mu)).astype(np.float32) for name, values in given.items()}


def _turned(table: ObjectTable) -> ObjectTable:
    """Return the table with all shapes turned by 90 degrees: ellipticities, knots and images.

    Raises InputError for parts of objects, because a turn would not move them about their object.
    """
    if "part_of" in table and (table["part_of"] >= 0).any():
        raise InputError("cannot turn parts of objects", key="catalog.shapes", value="rotated90", allowed="normal")
    columns = {"e1": -table["e1"], "e2": -table["e2"]}
    if "knots" in table:
        columns["knots_turned"] = np.ones(len(table), np.int8)
    if "image_file" in table:
        pa = table["image_pa"] if "image_pa" in table else np.zeros(len(table), np.float32)
        columns["image_pa"] = pa + np.float32(90.0)
    return table.with_columns(**columns)


def _magnification(table: ObjectTable) -> tuple[FloatArray, BoolArray]:
    """Return (mu, thin): magnification of each object, 1 for stars, and whether the lens is weak enough."""
    mu, thin = magnification(*(table[name] for name in ("kappa", "gamma1", "gamma2")))
    return np.where(lensed(table["obj_type"]), mu, 1.0), thin


class Extent(NamedTuple):
    """The distances to which n objects are rendered [pixel].

    reach (n,): half the side of the stamp; lost (n,): fraction of a galaxy's flux that may lie beyond it; wing (n,):
    radius at which noise hides the flux beyond the PSF's box, 0: it hides all of it; ghosts (n,): distance of the
    visible ones; truncated (n,) bool: the stamp was cut.
    """

    reach: IntArray
    lost: FloatArray
    wing: FloatArray
    ghosts: FloatArray
    truncated: BoolArray

    @property
    def farthest(self) -> FloatArray:
        """(n,) the largest of all distances."""
        return np.maximum.reduce([self.reach, self.wing, self.ghosts])


def _extent(table: ObjectTable, bad: BoolArray, electrons: FloatArray, view: ChipView) -> Extent:
    wing_px, ghosts = _scattered_reach(electrons, view)
    extended = (table["obj_type"] == GALAXY) & ~bad
    reach, lost = _reach(table, extended, electrons, wing_px, view)
    sides = np.ceil(np.minimum(reach, REACH_MAX)).astype(np.int32)
    wing = np.where(wing_px > view.box, wing_px, 0.0)
    return Extent(sides, lost, wing, ghosts, reach > REACH_MAX)


def _scattered_reach(electrons: FloatArray, view: ChipView) -> tuple[FloatArray, FloatArray]:
    """Return the radius to which each object's wing is rendered, and the distance of its visible ghosts [pixel]."""
    scattered = view.scattered
    if scattered is None:
        return np.zeros_like(electrons), np.zeros_like(electrons)
    ghosts: FloatArray | float = 0.0
    if scattered.ghosts is not None:
        ghosts = scattered.ghosts.reach(view.wcs.chip) * scattered.ghosts.visible(electrons)
    return wing_reach(electrons, view.variance, scattered.wing), np.broadcast_to(ghosts, electrons.shape)


def _reach(
    table: ObjectTable, extended: BoolArray, electrons: FloatArray, wing_px: FloatArray, view: ChipView
) -> tuple[FloatArray, FloatArray]:
    """Return (reach [pixel], lost: fraction of a galaxy's flux that may lie beyond its stamp)."""
    reach = point_reach(electrons, view.variance, view.filter, view.telescope, view.box)
    reach = np.where(extended, reach, np.clip(np.maximum(wing_px, STAR_MIN), reach, view.box))
    lost = np.zeros(len(reach), np.float32)
    reach[electrons <= 0] = POINT_MIN
    if extended.any():
        profile, lost[extended] = galaxy_radius(
            table.take(extended), electrons[extended], view.variance, view.telescope.pixel_scale
        )
        reach[extended] += profile
    return reach, lost
