"""Which objects reach a chip, how bright they are there and how large a stamp they need (paper, section 4.1).

`bricks_for` finds the truth bricks around a footprint; `select_objects` turns a catalogue into the table of one
chip in one exposure. Footprints are in the ICRS at the epoch (job.Job.footprint), with aberration removed; an object
is drawn at its apparent direction (catalog.astrometry.reduction), with the WCS of the image.

Shapes stay as in the catalogue. Aberration is conformal: it only stretches lengths, by up to 1.3e-4. The deflection of
light shears by 2e-8 at 90 deg from the Sun. Both are left out.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.healpix import NSIDE
from csstsim.base.sphere import grown, ra_dec, unit_vectors
from csstsim.catalog.astrometry.reduction import apparent, at_epoch
from csstsim.catalog.base import Region
from csstsim.catalog.changing.columns import moves
from csstsim.catalog.changing.motion import crosses, trails
from csstsim.catalog.flags import BAD_VALUE, STRONG_LENSING, TRUNCATED_STAMP
from csstsim.catalog.light.object_spectra import ROW
from csstsim.catalog.light.photometry import rate_to_mag
from csstsim.catalog.selection.drawable import unusable
from csstsim.catalog.selection.reach import (
    POINT_MAX,
    POINT_MIN,
    REACH_MAX,
    STAR_MIN,
    galaxy_radius,
    point_reach,
    wing_reach,
)
from csstsim.catalog.selection.row_order import back, canonical_order
from csstsim.catalog.table import GALAXY, STAR
from csstsim.universe.lensing.lensing import magnification

TRAIL_PX = 64.0  # of a trail: light from further along it does not add up
SAMPLES = 129  # of a trail, to see where its dispersed light lands
DISTORTION_PX = 200  # at the field's edge (paper, section 5.2)
# Stars may move 147" (4.1" a year until 2036) within this margin; wings of bright stars beyond it are not drawn.
BRICK_MARGIN_PX = DISTORTION_PX + REACH_MAX


@dataclass(frozen=True)
class Noise:
    """The contributions to a pixel's noise, without objects."""

    sky: float  # electron / s / pixel
    dark: float  # electron / s / pixel
    read_noise: float  # electron

    def variance(self, exptime):
        """Return the variance of one pixel [electron^2]."""
        return (self.sky + self.dark) * exptime + self.read_noise**2


def bricks_for(footprint_ra, footprint_dec, margin_deg):
    """Return the sorted NSIDE-256 nested pixels that touch a convex footprint grown by a margin.

    Corners in order round the polygon [deg]; RA wrap and poles need no care. Bricks that only come close may be
    included; none that touches is missing.
    """
    return _bricks(*_grown(footprint_ra, footprint_dec, margin_deg))


def region_for(footprint_ra, footprint_dec, margin_deg, bands):
    """Return the `Region` that a catalogue must cover: footprint with margin, its bricks, the camera's bands."""
    ra, dec = _grown(footprint_ra, footprint_dec, margin_deg)
    return Region(tuple(ra.tolist()), tuple(dec.tolist()), tuple(_bricks(ra, dec).tolist()), tuple(bands))


def _bricks(ra, dec):
    import hpgeom  # not healpy, which takes more than a second to import

    return np.sort(hpgeom.query_polygon(NSIDE, ra, dec, inclusive=True, fact=16))


def _grown(ra, dec, margin_deg):
    """Return the corners [deg] of a footprint grown by a margin."""
    return ra_dec(grown(unit_vectors(ra, dec), np.radians(margin_deg)))


def select_objects(
    catalog, wcs, observer, window, filter, telescope, exptime, noise, mag_limit=None, rotated=False, scattered=None,
    box=POINT_MAX, disperser=None, interval=None,
):  # fmt: skip
    """Return the ObjectTable of the objects that reach `window` of a chip, with the columns the renderer needs.

    catalog: a CatalogBase; wcs: optics.geometry.wcs.ChipWCS; observer: ephemeris.Observer; window:
    instrument.chip.Window; exptime in s; noise: Noise; rotated: turn intrinsic ellipticities by 90 degrees (the paper's
    twin campaign, in which nothing else differs); scattered: Scattered (optics.scatter) or None; box: half the side
    of the stored PSF [pixel]; disperser: optics.gratings.dispersion.Disperser of a spectroscopic chip, whose light
    lands elsewhere, or None; interval: catalog.changing.motion.Interval of the exposure, which objects that move or
    vary need (None: they stay as the catalogue has them).

    ra, dec become the apparent direction. Added columns: ra_orig, dec_orig (the catalogue's, J2000), ra_epoch,
    dec_epoch (ICRS at the epoch, to compare with measurements), x, y (0-based pixel), mag (this filter), flux0..3
    (electron / s, magnified), reach (pixel, half the side of the stamp), lost (fraction of a galaxy's light that may
    lie beyond it), wing (pixel, radius at which noise hides the light beyond the PSF's box; 0: it hides all of it),
    flags. mag_* are as observed, magnification included. Rows with an unusable value are kept, flagged and without
    light, if they lie on the window or their place is unknown. Behind a grating x, y is where light would fall without
    it, flux0..3 and mag are those of the first order, and the column `catalog_row` is the object's row in the
    catalogue, for its spectrum (catalog.light.object_spectra). A table with rates gets the columns of
    catalog.changing.motion.trails, whose place is the object's, one with light that varies `dmag` (mag by which it is
    fainter than mag_*; it is in mag and flux0..3). `meta` gets `dropped` (counts by reason), `truth_hash`.
    """
    everything = catalog.table
    dispersed = 0.0 if disperser is None else disperser.gratings.reach
    rows, places = near(everything, wcs, observer, window, dispersed, interval)
    table = everything.take(rows)
    if disperser is None and (shares := catalog.component_shares(rows, filter)):
        table = table.with_columns(**shares)
    seconds = seconds_seen(places, exptime, telescope.pixel_scale)
    dmag = None if interval is None else catalog.dimming(rows, interval, filter)
    dimmed = np.ones(len(rows)) if dmag is None else 10 ** (-0.4 * dmag)
    optics = noise.variance(exptime), scattered, box, wcs.chip, filter, telescope
    bound = catalog.rate_bound(rows, filter, telescope)
    if bound is not None:  # spectra of objects that cannot reach the window are not summed
        most = bound * dimmed * _magnification(table)[0] * seconds
        could = _could_reach(table, places, most, window, disperser, optics)
        rows, table, places = rows[could], table.take(could), {name: v[could] for name, v in places.items()}
        seconds, dimmed, dmag = seconds[could], dimmed[could], None if dmag is None else dmag[could]
    if rotated:
        table = _turned(table)
    (mu, thin), star = _magnification(table), table["obj_type"] == STAR
    order = canonical_order(table)  # sums by chunks must not depend on the order of the rows
    flux = catalog.load_fluxes(rows[order], filter, telescope)[back(order)] * (mu * dimmed)[:, None]
    bad = unusable(table, flux)
    flux[bad] = 0.0
    rate = flux.sum(axis=1)
    mag = np.where(bad, np.nan, rate_to_mag(rate, filter, telescope))
    reach, lost, wing, ghosts, truncated = _extent(table, bad, rate * seconds, *optics)
    flags = table["flags"] | np.where(bad, BAD_VALUE, 0) | np.where(truncated, TRUNCATED_STAMP, 0)
    flags |= np.where(~star & ~thin & ~bad, STRONG_LENSING, 0)
    far = np.where(bad, 0, np.maximum.reduce([reach, wing, ghosts]))
    touches = _lands(places, far, window, disperser) | ~np.isfinite(table["ra"] + table["dec"])
    faint = mag > (np.inf if mag_limit is None else mag_limit)
    chosen = table.with_columns(
        ra_orig=table["ra"], dec_orig=table["dec"], **places, mag=mag.astype(np.float32),
        **_magnified(table, catalog.region.bands, mu),
        **{f"flux{i}": flux[:, i] for i in range(flux.shape[1])}, reach=reach, lost=lost,
        wing=wing.astype(np.float32), flags=flags.astype(np.int32), **({} if disperser is None else {ROW: rows}),
        **({} if dmag is None else {"dmag": dmag.astype(np.float32)}),
    ).take(touches & ~faint)  # fmt: skip
    outside = len(everything) - int(touches.sum())
    chosen.meta = {
        "dropped": {"outside": outside, "faint": int((touches & faint).sum())},
        "truth_hash": catalog.truth_hash,
    }
    return chosen


def near(table, wcs, observer, window, dispersed=0.0, interval=None):
    """Return the rows that could reach the window, or whose place is unknown, and {name: values} of their places.

    dispersed: how far a grating may send light [pixel]. Places: ra, dec, ra_epoch, dec_epoch [deg], x, y [pixel], as
    `select_objects` describes them, and with an interval those of catalog.changing.motion.trails, if the table has
    rates.
    """
    located = np.flatnonzero(np.isfinite(table["ra"]) & np.isfinite(table["dec"]))
    star = table["obj_type"][located] == STAR  # nothing else moves, whatever the catalogue says
    motion = {name: np.where(star, table[name][located], 0.0) for name in ("pmra", "pmdec", "parallax", "rv")}
    epoch = at_epoch(table["ra"][located], table["dec"][located], observer, **motion)
    seen = apparent(*epoch, observer)
    places = np.full((6, len(table)), np.nan)
    places[:, located] = *seen, *epoch, *wcs.world_to_pixel(*seen)
    nowhere = np.isnan(places[0])
    places = dict(zip(("ra", "dec", "ra_epoch", "dec_epoch", "x", "y"), places, strict=True))
    reach = REACH_MAX + dispersed
    seen = _touches(places["x"], places["y"], reach, window) | nowhere
    if interval is not None and "rate_ra" in table:
        moving = np.flatnonzero(moves(table) & ~nowhere)
        found = trails(table.take(moving), wcs, observer, window, interval, reach + DISTORTION_PX)
        for name, values in found.items():
            places.setdefault(name, np.full(len(table), 0.0 if name == "trail_length" else np.nan))[moving] = values
        seen[moving] = np.isfinite(found["x"])
    rows = np.flatnonzero(seen)
    return rows, {name: values[rows] for name, values in places.items()}


def seconds_seen(places, exptime, pixel_scale):
    """Return (n,) the time [s] whose light decides how far objects are visible: of a fast one, that near one place."""
    if "trail_length" not in places:
        return np.full(len(places["x"]), float(exptime))
    time, length = places["trail_end"] - places["trail_start"], places["trail_length"] / pixel_scale
    with np.errstate(invalid="ignore"):
        return np.where(length > 0, time * np.minimum(1.0, TRAIL_PX / np.where(length > 0, length, 1.0)), exptime)


def _touches(x, y, reach, window):
    """Whether the square [x +- reach] meets a pixel of the window; False for NaN."""
    in_x = (x + reach >= window.x0 - 0.5) & (x - reach < window.x1 - 0.5)
    return in_x & (y + reach >= window.y0 - 0.5) & (y - reach < window.y1 - 0.5)


def _lands(places, far, window, disperser):
    """Whether light within `far` (n,) px of where it lands meets the window; False for NaN."""
    x, y = places["x"], places["y"]
    if "trail_length" in places and (trailed := places["trail_length"] > 0).any():
        still = {name: places[name] for name in ("x", "y")}
        if disperser is None:
            return np.where(trailed, crosses(places, far, window), _lands(still, far, window, None))
        ends = [[places[f"trail_{axis}{k}"] for axis in "xy"] for k in (0, 1)]
        along = [{a: p + s * (q - p) for a, p, q in zip("xy", *ends, strict=True)} for s in np.linspace(0, 1, SAMPLES)]
        return np.where(
            trailed,
            np.any([_lands(at, far, window, disperser) for at in along], axis=0),
            _lands(still, far, window, disperser),
        )
    if disperser is None:
        return _touches(x, y, far, window)
    visits = disperser.visits(x, y, far)
    x0, x1, y0, y1 = np.moveaxis(disperser.boxes(visits, x, y), -1, 0)
    grown = far[visits[:, :1]]
    meets = (x1 + grown >= window.x0 - 0.5) & (x0 - grown < window.x1 - 0.5)
    meets &= (y1 + grown >= window.y0 - 0.5) & (y0 - grown < window.y1 - 0.5)
    lands = np.zeros(len(x), bool)
    lands[visits[meets.any(axis=1), 0]] = True
    return lands


def _could_reach(table, places, electrons, window, disperser, optics):
    """Return (n,) bool: whether objects of up to so many electrons could reach the window, or are of unknown light.

    optics: the last arguments of `_extent`, which is asked only for objects that are not on the window anyway.
    """
    could = _lands(places, np.zeros(len(electrons)), window, disperser) | ~np.isfinite(places["x"] + electrons)
    rest = np.flatnonzero(~could)
    table, electrons = table.take(rest), electrons[rest]
    reach, _, wing, ghosts, _ = _extent(table, unusable(table, electrons[:, None]), electrons, *optics)
    far = np.maximum.reduce([reach, wing, ghosts])
    could[rest] = _lands({name: v[rest] for name, v in places.items()}, far, window, disperser)
    return could


def _magnified(table, bands, mu):
    """Return {mag_B: observed magnitudes}; NaN in a band for which the catalogue's table has none."""
    given = {f"mag_{band}": table.get(f"mag_{band}", np.full(len(mu), np.nan)) for band in bands}
    return {name: (values - 2.5 * np.log10(mu)).astype(np.float32) for name, values in given.items()}


def _turned(table):
    """Return the table with all shapes turned by 90 degrees: ellipticities, knots and images.

    Raises InputError for parts of objects, whose places are no shape of theirs.
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


def _magnification(table):
    """Return (mu, thin): magnification of each object, 1 for stars, and whether the lens is weak enough."""
    mu, thin = magnification(*(table[name] for name in ("kappa", "gamma1", "gamma2")))
    return np.where(table["obj_type"] == STAR, 1.0, mu), thin


def _extent(table, bad, electrons, variance, scattered, box, chip, filter, telescope):
    """Return how far light goes [pixel]: reach, lost, wing (see `select_objects`), ghosts, and whether it was cut."""
    wing_px, ghosts = _scattered_reach(scattered, electrons, variance, chip)
    extended = (table["obj_type"] == GALAXY) & ~bad
    reach, lost = _reach(table, extended, electrons, variance, wing_px, box, filter, telescope)
    truncated = reach > REACH_MAX
    reach = np.ceil(np.minimum(reach, REACH_MAX)).astype(np.int32)
    wing = np.where(wing_px > box, wing_px, 0.0)
    return reach, lost, wing, ghosts, truncated


def _scattered_reach(scattered, electrons, variance, chip):
    """Return the radius to which each object's wing is drawn, and the distance of its visible ghosts [pixel]."""
    if scattered is None:
        return np.zeros_like(electrons), np.zeros_like(electrons)
    ghosts = 0.0 if scattered.ghosts is None else scattered.ghosts.reach(chip) * scattered.ghosts.visible(electrons)
    return wing_reach(electrons, variance, scattered.wing), np.broadcast_to(ghosts, electrons.shape)


def _reach(table, extended, electrons, variance, wing_px, box, filter, telescope):
    """Return (reach [pixel], lost: fraction of a galaxy's light that may lie beyond its stamp)."""
    reach = point_reach(electrons, variance, filter, telescope, box)
    reach = np.where(extended, reach, np.clip(np.maximum(wing_px, STAR_MIN), reach, box))
    lost = np.zeros(len(reach), np.float32)
    reach[electrons <= 0] = POINT_MIN
    if extended.any():
        profile, lost[extended] = galaxy_radius(
            table.take(extended), electrons[extended], variance, telescope.pixel_scale
        )
        reach[extended] += profile
    return reach, lost
