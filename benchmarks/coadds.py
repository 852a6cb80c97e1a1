"""Three dithered exposures stacked by their own WCS, by SWarp and by reproject: are stars single, sharp, and as deep?

    python benchmarks/coadds.py

The commands of a user: aim with three dithers, chip, calibrate. The catalogue is stars of 19 to 21 mag in the western
half of the field, 1.5 arcsec or more apart. The calibrated images go to SWarp and to reproject as they are. For each
star, a Gaussian fitted to 11 x 11 px gives position and width, in each exposure and in the coadd. Depth is the rms of
apertures on empty sky.

    width      the median over stars of the coadd's FWHM, divided by that of the exposures
    positions  rms of the coadd's stars about the truth, without their mean
    depth      rms of apertures in the coadd, divided by that of inverse-variance weights of the exposures' own

SWarp interpolates with Lanczos functions of order 4. reproject interpolates with a cubic spline, onto the pixels of the
first exposure, which stay as they are. A WCS of apparent directions would show each
star three times, 0.3 and 0.9 arcsec apart.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from evidence.record import Record

import numpy as np
import yaml
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from scipy.ndimage import uniform_filter
from scipy.optimize import curve_fit
from scipy.spatial import cKDTree

ROOT = Path(__file__).parents[1]
RA, DEC, CHIP = 60.1172, -40.033, 7  # deg; an i chip
DITHERS = (0, 0), (10, 5), (-8, 12)  # arcsec
STARS, RADIUS, APART = 300, 0.8, 1.5  # number; arcmin around the position; arcsec
HALF = 5  # px around a star
APERTURE = 8  # px, side
EMPTY = 100  # px, distance of an aperture from the nearest star: farther than wings that noise would show
SCALE = 0.074  # arcsec
FWHM = np.sqrt(8 * np.log(2))


@dataclass(frozen=True)
class Image:
    """An image in e-/s with its errors (0 where it has no weight) and WCS."""

    pixels: np.ndarray
    error: np.ndarray
    wcs: WCS
    header: fits.Header


def csstsim(folder: Path, *words: object) -> None:
    """Run a command of csstsim in a folder."""
    line = [Path(sys.executable).with_name("csstsim"), "-q", *map(str, words)]
    subprocess.run(line, cwd=folder, check=True, stdout=subprocess.DEVNULL)


def exposures(folder: Path, count: int) -> list[Path]:
    """Simulate and calibrate the dithers; return the calibrated images."""
    csstsim(folder.parent, "init", folder.name)
    rng = np.random.default_rng(1)
    kept = np.zeros((0, 2))
    while len(kept) < count:
        new = rng.uniform((-RADIUS, -RADIUS), (0.0, RADIUS)) * 60
        if not len(kept) or np.hypot(*(kept - new).T).min() > APART:
            kept = np.vstack([kept, new])
    east, north = kept.T / 3600
    stars = Table({"ra": RA + east / np.cos(np.radians(DEC)), "dec": DEC + north, "mag_i": rng.uniform(19, 21, count)})
    stars.write(folder / "stars.ecsv")
    dithers = [word for dither in DITHERS for word in ("--dither", *dither)]
    csstsim(folder, "aim", RA, DEC, "--filter", "i", *dithers, "--output", "dithers.csv")
    file = folder / "campaign.yaml"
    config = yaml.safe_load(file.read_text())
    kind = "csstsim.catalog.own_table:TableCatalog"
    config |= {"survey_table": "dithers.csv", "catalog": {"kind": kind, "options": {"file": "stars.ecsv"}}}
    config["select"] = {"types": ["SCIE"], "chips": [CHIP], "region": {"ra": RA, "dec": DEC, "radius": RADIUS}}
    file.write_text(yaml.safe_dump(config))
    for k in range(len(DITHERS)):
        job = "--obsid", 10100000001 + k, "--chip", CHIP
        csstsim(folder, "chip", file.name, *job)
        csstsim(folder, "calibrate", file.name, *job)
    return sorted((folder / "results" / "calibrated").glob("*.fits"))


def opened(file: Path) -> Image:
    """Return a calibrated image; pixels that are flagged have no weight."""
    with fits.open(file) as hdus:
        science, error, quality = (hdus[name].data for name in ("SCI", "ERR", "DQ"))
        header = hdus["SCI"].header
    return Image(science.astype(float), np.where(quality == 0, error.astype(float), 0.0), WCS(header), header)


def weights(error: np.ndarray) -> np.ndarray:
    """Return the weights of pixels: of the sky's noise, alike in all pixels that have some."""
    return np.where(error > 0, np.median(error[error > 0]) ** -2, 0.0)


def by_swarp(images: list[Image], folder: Path) -> Image:
    """Return the coadd of SWarp."""
    folder.mkdir()
    names = [f"{k}.fits" for k in range(len(images))]
    for image, name in zip(images, names, strict=True):
        fits.writeto(folder / name, image.pixels.astype(np.float32), image.header)
        fits.writeto(folder / name.replace(".", ".weight."), weights(image.error).astype(np.float32), image.header)
    settings = {
        "WEIGHT_TYPE": "MAP_WEIGHT", "RESCALE_WEIGHTS": "N", "COMBINE_TYPE": "WEIGHTED", "SUBTRACT_BACK": "N",
        "RESAMPLING_TYPE": "LANCZOS4", "PIXELSCALE_TYPE": "MANUAL", "PIXEL_SCALE": SCALE, "PROJECTION_TYPE": "TAN",
        "FSCALE_KEYWORD": "NONE", "GAIN_KEYWORD": "NONE", "WRITE_XML": "N", "VERBOSE_TYPE": "QUIET", "NTHREADS": 1,
    }  # fmt: skip
    options = [word for key, value in settings.items() for word in (f"-{key}", str(value))]
    subprocess.run(["SWarp", *names, *options], cwd=folder, check=True)
    pixels, header = fits.getdata(folder / "coadd.fits", header=True)
    weight = fits.getdata(folder / "coadd.weight.fits")
    return Image(pixels, np.where(weight > 0, weight, np.inf) ** -0.5, WCS(header), header)


def by_reproject(images: list[Image], _: Path) -> Image:
    """Return the coadd of reproject, with a cubic spline, on the pixels of the first exposure."""
    from reproject import reproject_interp
    from reproject.mosaicking import reproject_and_coadd

    first = images[0]
    pixels, weight = reproject_and_coadd(
        [(image.pixels, image.wcs) for image in images], first.wcs, shape_out=first.pixels.shape,
        input_weights=[weights(image.error) for image in images], reproject_function=reproject_interp, order="bicubic",
    )  # fmt: skip
    return Image(pixels, np.where(weight > 0, weight, np.inf) ** -0.5, first.wcs, first.header)


def gauss(at, flux, x, y, sigma, level):
    """Return a round Gaussian at pixels (2, n)."""
    return level + flux * np.exp(-((at[0] - x) ** 2 + (at[1] - y) ** 2) / (2 * sigma**2))


def fitted(image: Image, ra: np.ndarray, dec: np.ndarray) -> np.ndarray:
    """Return (n, 3): FWHM [px] and offsets in x and y [px] of stars; NaN for those without 11 x 11 good pixels."""
    steps = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1][::-1].reshape(2, -1)
    found = np.full((len(ra), 3), np.nan)
    for k, (x, y) in enumerate(np.transpose(image.wcs.all_world2pix(ra, dec, 0))):
        i, j = round(x), round(y)
        part = slice(j - HALF, j + HALF + 1), slice(i - HALF, i + HALF + 1)
        stamp, error = image.pixels[part], image.error[part]
        if stamp.shape != (2 * HALF + 1,) * 2 or not ((error > 0) & np.isfinite(error)).all():
            continue
        start = stamp.max(), x - i, y - j, 1.0, 0.0
        best, _ = curve_fit(gauss, steps, stamp.ravel(), start)
        found[k] = FWHM * abs(best[3]), best[1] + i - x, best[2] + j - y
    return found


def sky_rms(image: Image, ra: np.ndarray, dec: np.ndarray) -> tuple[float, float]:
    """Return the rms of apertures on empty sky [e-/s], and its relative error."""
    total = uniform_filter(np.nan_to_num(image.pixels), APERTURE, mode="constant") * APERTURE**2
    good = uniform_filter(((image.error > 0) & np.isfinite(image.error)).astype(float), APERTURE + 2) > 0.999
    stars = cKDTree(np.transpose(image.wcs.all_world2pix(ra, dec, 0)))
    y, x = (grid[::APERTURE, ::APERTURE].ravel() for grid in np.indices(total.shape))
    empty = good[y, x] & (stars.query(np.transpose([x, y]))[0] > EMPTY)
    values = total[y, x][empty]
    return float(values.std()), float(0.5 / len(values)) ** 0.5


def main(record: Record) -> None:
    """Simulate, stack and measure."""
    with tempfile.TemporaryDirectory() as place:
        images = [opened(file) for file in exposures(Path(place) / "field", 20 if record.toy else STARS)]
        truth = Table.read(Path(place) / "field" / "stars.ecsv")
        ra, dec = np.asarray(truth["ra"]), np.asarray(truth["dec"])
        singles = np.array([fitted(image, ra, dec) for image in images])
        single = np.nanmedian(singles[..., 0])
        noise = np.array([sky_rms(image, ra, dec)[0] for image in images])
        record.value("fwhm", single * SCALE, "FWHM of a star in an exposure, median", unit="arcsec")
        rows = []
        for name, make in (("SWarp", by_swarp), ("reproject", by_reproject)):
            if not (shutil.which(name) or find_spec(name)):
                record.skip(name, "is not installed")
                continue
            coadd = make(images, Path(place) / name)
            stars = fitted(coadd, ra, dec)
            used = np.isfinite(stars[:, 0]) & np.isfinite(singles[..., 0]).all(axis=0)
            ratio = stars[used, 0] / singles[:, used, 0].mean(axis=0)
            width, width_err = np.median(ratio), 1.25 * ratio.std() / np.sqrt(used.sum())
            spread = 1e3 * SCALE * stars[used, 1:].std(axis=0).mean()
            rms, relative = sky_rms(coadd, ra, dec)
            weight = noise**-2.0
            expected = np.sqrt((weight**2 * noise**2).sum()) / weight.sum()
            key = name.lower()
            depth, depth_err = rms / expected, rms / expected * relative
            width_says = f"{name}: FWHM of the coadd over that of the exposures"
            record.value(f"{key}_width", width, width_says, error=width_err, below=1.03)
            record.value(f"{key}_position", spread, f"{name}: rms of positions about the truth", unit="mas", below=3.0)
            depth_says = f"{name}: rms of apertures over the expected one"
            record.value(f"{key}_depth", depth, depth_says, error=depth_err, below=1.03)
            width_cell, depth_cell = f"{width:.3f} ± {width_err:.3f}", f"{depth:.3f} ± {depth_err:.3f}"
            rows.append([name, int(used.sum()), width_cell, f"{spread:.1f}", depth_cell])
        heading = ["coadd by", "stars", "FWHM over an exposure's", "rms of positions, mas", "noise over the expected"]
        record.table("coadds", heading, rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        main(record)
