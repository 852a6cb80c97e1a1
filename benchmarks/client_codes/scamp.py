"""SCAMP on the frames of a pointing, against a reference catalogue of the mock's stars.

The reference has ICRS places at the epoch of the exposures, with proper motion and parallax: what a survey would take
from Gaia. Aberration is in the frames and not in the reference, so SCAMP's solution must take it up: its shift of 20",
and its gradient over a chip, which is linear to 0.1 mas. The solution then maps pixels to ICRS.
"""

import re
import warnings

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS, FITSFixedWarning

from client_codes.frames import EPOCH, program
from csstsim.catalog.astrometry.reduction import icrs

DEGREE = 4  # of the polynomials
SNR = 20, 200  # of the stars that are judged
FITTED = 10, 400  # S/N of the stars that SCAMP fits: in NUV, some 400 of those judged leave the corners of a chip loose
REFERENCE_ERROR = 1e-4  # arcsec: none is needed but 0, which SCAMP refuses
NEAR = 0.1  # arcsec between a measured star and one of the reference
SCALE = 0.074  # arcsec of a pixel
GRID = 25  # points along a chip's side, at which the fit is compared


def reference(folder, stars):
    """Write the reference catalogue, FITS_LDAC, of stars {name: array} as frames.stars has them; return its name."""
    kept = (stars["snr"] > FITTED[0]) & (stars["snr"] < FITTED[1])
    n, error = int(kept.sum()), REFERENCE_ERROR / 3600
    columns = {
        "X_WORLD": stars["ra"][kept], "Y_WORLD": stars["dec"][kept], "ERRA_WORLD": np.full(n, error),
        "ERRB_WORLD": np.full(n, error), "ERRTHETA_WORLD": np.zeros(n), "MAG": stars["mag"][kept],
        "MAGERR": np.full(n, 0.01), "OBSDATE": np.full(n, EPOCH),
    }  # fmt: skip
    units = {"X_WORLD": "deg", "Y_WORLD": "deg", "ERRA_WORLD": "deg", "ERRB_WORLD": "deg", "MAG": "mag"}
    table = fits.BinTableHDU.from_columns(
        [fits.Column(name, "D", array=values, unit=units.get(name)) for name, values in columns.items()],
        name="LDAC_OBJECTS",
    )
    card = fits.Header([("SIMPLE", True), ("BITPIX", 0), ("NAXIS", 0)]).tostring()
    about = fits.BinTableHDU.from_columns(
        [fits.Column("Field Header Card", f"{len(card)}A", array=np.array([card]))], name="LDAC_IMHEAD"
    )
    about.header["TDIM1"] = f"(80, {len(card) // 80})"
    fits.HDUList([fits.PrimaryHDU(), about, table]).writeto(folder / "reference.cat", overwrite=True)
    return "reference.cat"


def run_scamp(frames, stars):
    """Run SCAMP on the frames' catalogues; return what it printed."""
    folder = frames[0].stem.parent
    settings = {
        "ASTREF_CATALOG": "FILE", "ASTREFCAT_NAME": reference(folder, stars), "MATCH": "Y", "POSITION_MAXERR": 1.0,
        "POSANGLE_MAXERR": 0.5, "PIXSCALE_MAXERR": 1.02, "MATCH_FLIPPED": "N", "CROSSID_RADIUS": 1.5,
        "MOSAIC_TYPE": "LOOSE", "STABILITY_TYPE": "INSTRUMENT", "ASTRINSTRU_KEY": "FILTER,CHIP",
        "DISTORT_DEGREES": DEGREE, "SN_THRESHOLDS": f"{FITTED[0]},{FITTED[1]}", "ASTREF_WEIGHT": 1.0,
        "ASTRCLIP_NSIGMA": 3.0,
        "SOLVE_PHOTOM": "N", "PROJECTION_TYPE": "TPV", "CHECKPLOT_TYPE": "NONE", "CHECKPLOT_DEV": "NULL",
        "CHECKIMAGE_TYPE": "NONE", "WRITE_XML": "N", "VERBOSE_TYPE": "NORMAL", "FWHM_THRESHOLDS": "0.5,4.0",
        "ELLIPTICITY_MAX": 0.5, "NTHREADS": 1,
    }  # fmt: skip
    said = program(folder, ["scamp", *(frame.catalogue.name for frame in frames)], "scamp", settings)
    (folder / "scamp.log").write_text(said)
    return said


def reported(said):
    """Return {"internal", "external": (rms by axis [mas] of all, of the brightest, number)} of what SCAMP printed.

    Internal: of a star's places in each exposure about their mean; external: of that mean about the reference. SCAMP
    reports groups of fields that overlap; here their variances are averaged, weighted with their numbers.
    """
    number = r"([\d.]+)\""
    line = re.compile(rf"Group\s+\d+:\s+{number}\s+{number}\s+\S+\s+(\d+)\s+{number}\s+{number}\s+\S+\s+(\d+)")
    found = {}
    for name in ("internal", "external"):
        part = re.split(rf"Astrometric stats \({name}\)", said)[-1].partition("-----")[0]
        rows = np.array(line.findall(part), float)
        groups = ((rows[:, k : k + 2], rows[:, k + 2]) for k in (0, 3))
        all_, bright = (1e3 * np.sqrt((sizes**2 * n[:, None]).sum(0) / max(n.sum(), 1)) for sizes, n in groups)
        found[name] = (*(", ".join(f"{v:.2f}" for v in values) for values in (all_, bright)), int(rows[:, 2].sum()))
    return found


def mean_places(judged):
    """Return (east, north, number) of stars' mean places in all exposures of a chip less the truth [mas].

    judged: as `judge` returns, of each exposure. Stars that are not in all of them are left out.
    """
    star, dx, dy = (np.concatenate([each[name] for each in judged]) for name in ("star", "dx", "dy"))
    _, first, count = np.unique(star, return_inverse=True, return_counts=True)
    whole = count == len(judged)
    east, north = (np.bincount(first, weights=values)[whole] / len(judged) for values in (dx, dy))
    return east, north, int(whole.sum())


def clipped_rms(values, clip=3.0):
    """Return the rms of values without those beyond `clip` times it, repeated until none is: as SCAMP clips."""
    kept = values
    while True:
        rms = float(np.sqrt(np.mean(np.square(kept))))
        inside = kept[abs(kept) <= clip * rms]
        if len(inside) == len(kept):
            return rms
        kept = inside


def fitted(frame):
    """Return SCAMP's WCS of a frame."""
    return read_head(frame.head)


def read_head(path):
    """Return the WCS of a header file of SCAMP; one that says TAN and has polynomials is TPV."""
    header = fits.Header()
    for line in path.read_text(encoding="utf-8").splitlines():
        if re.match("[A-Z]", line) and not line.startswith(("HISTORY", "COMMENT", "END")):
            header.append(fits.Card.fromstring(line.ljust(80)))
    if "PV1_0" in header:
        header["CTYPE1"], header["CTYPE2"] = "RA---TPV", "DEC--TPV"
    return quiet_wcs(header)


def quiet_wcs(header):
    """Return the WCS of a header, without astropy's remarks on its dates."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        return WCS(header)


def judge(frame, stars):
    """Return what a frame's fit is worth: {"dx", "dy", "star", "snr", "off"}.

    dx, dy [mas]: east and north, a star where SCAMP puts it less the truth; star: its index in `stars`; off: distance
    of SCAMP's WCS from the true one on a grid [px].
    """
    wcs, table = fitted(frame), fits.getdata(frame.catalogue, 2)
    table = table[(table["SNR_WIN"] > SNR[0]) & (table["SNR_WIN"] < SNR[1])]
    names = "dx", "dy", "star", "snr"
    return dict(zip(names, residuals(wcs, table, stars), strict=True)) | {"off": distance(wcs, frame.job)}


def residuals(wcs, table, stars):
    """Return (east, north [mas], index of the star, S/N) of a catalogue's sources that are near a star."""
    found = SkyCoord(*wcs.all_pix2world(table["XWIN_IMAGE"], table["YWIN_IMAGE"], 1), unit="deg")
    true = SkyCoord(stars["ra"], stars["dec"], unit="deg")
    index, apart, _ = found.match_to_catalog_sky(true)
    near = apart.arcsec < NEAR
    east, north = true[index[near]].spherical_offsets_to(found[near])
    return east.to_value("mas"), north.to_value("mas"), index[near], table["SNR_WIN"][near]


def distance(wcs, job):
    """Return the distance [px] of a WCS from the true map of pixels to ICRS, at GRID x GRID points of a frame."""
    window = job.window
    nx, ny = window.x1 - window.x0, window.y1 - window.y0
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, nx - 1, GRID), np.linspace(0, ny - 1, GRID)))
    sky = icrs(*job.wcs.pixel_to_world(x + window.x0, y + window.y0), job.observer)
    place = SkyCoord(*wcs.all_pix2world(x, y, 0), unit="deg")
    return SkyCoord(*sky, unit="deg").separation(place).arcsec.reshape(GRID, GRID) / SCALE
