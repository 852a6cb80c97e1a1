"""Objects rendered by GalSim into an image of any telescope, with the image's WCS and a given PSF.

Positions are ICRS. Shapes follow the local map of the WCS from the sky to pixels. Each object has its own Poisson
noise, from a stream of its id and the frame. Of the detector, only a stated SATURATE is simulated.
"""

from __future__ import annotations

from numbers import Real
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.digest import digest, file_digest
from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.plural import number_of
from csstsim.base.process.progress import progress
from csstsim.base.rng import stream
from csstsim.catalog.changing.columns import moves
from csstsim.catalog.galaxy_shapes.components import components, has_image, has_knots
from csstsim.catalog.object_table import object_table
from csstsim.catalog.table import GALAXY, ObjectTable, lensed
from csstsim.inject.others.frame import read_foreign
from csstsim.inject.others.psf_models import read_psf
from csstsim.inject.others.with_astropy import opened
from csstsim.inject.request import record
from csstsim.io.paths import TRUTH
from csstsim.render.scene import shape_matrix
from csstsim.universe.lensing.lensing import magnification

if TYPE_CHECKING:
    from pathlib import Path

    import galsim
    from astropy.io.fits.hdu.base import _BaseHDU

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, Floats
    from csstsim.inject.others.frame import ForeignFrame
    from csstsim.inject.others.psf_models import Psfex, Stamps
    from csstsim.inject.request import Injector, Request
    from csstsim.inject.rewritten import Record

BAND = "here"  # the name of the only band of an image
ZEROPOINTS = 0.0, 50.0  # AB magnitude of 1 electron/s: the range of telescopes
ELECTRONS_MAX = 1e18  # electrons of an object: Poisson noise is drawn as a 64-bit integer
STAMP_MAX = 1024  # px, maximum side of an object's stamp
_LENS = "kappa", "gamma1", "gamma2"
_BEYOND = 3  # samples of a PSF beyond its stamp that its interpolation reaches (psf_models)


def prepared(frame: Path, request: Request) -> Injector:
    """Return the Injector of a frame of another telescope, after checking it. Raises InputError."""
    image = read_foreign(frame)
    if request.light_curves:
        raise InputError(
            "light curves are for frames of csstsim",
            file=frame,
            key="--light-curves",
            value=request.light_curves,
            allowed="the magnitude at this image's time, in the table",
        )
    if request.psf is None:
        raise InputError("a frame of others needs its PSF", file=frame, key="--psf")
    psf = read_psf(request.psf, image.band)
    zeropoint = image.zeropoint if request.zeropoint is None else request.zeropoint
    if zeropoint is None:
        raise InputError("no zero point; give that of 1 electron/s", file=frame, key="--zeropoint")
    is_number = isinstance(zeropoint, Real) and not isinstance(zeropoint, bool)
    if not (is_number and ZEROPOINTS[0] <= zeropoint <= ZEROPOINTS[1]):
        key = "PHOTFLAM, PHOTPLAM" if request.zeropoint is None else "zeropoint"
        allowed = f"{ZEROPOINTS[0]:g} to {ZEROPOINTS[1]:g}, the AB magnitude of 1 electron/s"
        value = float(zeropoint) if isinstance(zeropoint, np.floating) else zeropoint
        raise InputError("no zero point", file=frame, key=key, value=value, allowed=allowed)
    objects = _objects(request, image, zeropoint)
    frame_digest = digest([file_digest(frame), frame.name])  # copies under other names stand for other exposures
    return lambda frame, target, log: _make(image, psf, objects, request, target, frame_digest)


def _objects(request: Request, image: ForeignFrame, zeropoint: float) -> ObjectTable:
    """Return the ObjectTable of the request, with `mag`, magnified, and `electrons` in the image. Raises InputError."""
    columns = dict(request.columns)
    band = image.band
    names = [name for name in columns if name == "mag" or name.startswith("mag_")]
    chosen = next(
        (name for name in names if name in ("mag", f"mag_{band.lower()}")), names[0] if len(names) == 1 else None
    )
    if chosen is None:
        raise InputError(
            "which magnitude is the image's?",
            file=request.table,
            key="mag",
            value=", ".join(names),
            allowed=f"mag, mag_{band.lower() or 'BAND'}, or one magnitude alone",
        )
    magnitudes = columns[chosen]
    columns = {name: values for name, values in columns.items() if name not in names} | {f"mag_{BAND}": magnitudes}
    try:
        objects = object_table(columns, (BAND,), request.table)
    except InputError as exc:
        if exc.key != f"mag_{BAND}":
            raise
        raise InputError(exc.message, file=exc.file, key=chosen, value=exc.value, allowed=exc.allowed) from None
    varies = np.zeros(len(objects), bool) if "var_amplitude" not in objects else objects["var_amplitude"] > 0
    refused = {
        "knots": has_knots(objects),
        "image_file": has_image(objects),
        "rate_ra, rate_dec": moves(objects),
        "var_amplitude": varies,
        "light_curve": objects["light_curve"] != "" if "light_curve" in objects else np.zeros(len(objects), bool),
    }
    for name, rows in refused.items():
        if rows.any():
            raise InputError(
                "only rendered in frames of csstsim",
                file=request.table,
                key=f"{name}, row {np.flatnonzero(rows)[0] + 1}",
                allowed="stars, disks and bulges that stay as they are",
            )
    field = [objects[name] for name in _LENS]
    behind = lensed(objects["obj_type"])
    mu, is_thin = magnification(*field)
    if (strong := behind & ~is_thin).any():
        row = np.flatnonzero(strong)[0]
        raise InputError(
            "strongly lensed, which is not rendered",
            file=request.table,
            key=f"{', '.join(_LENS)}, row {row + 1}",
            value=", ".join(f"{values[row]:g}" for values in field),
            allowed="kappa below 1, and a shear below 1 - kappa",
        )
    mu = np.where(behind, mu, 1.0)
    mag = objects[f"mag_{BAND}"] - 2.5 * np.log10(mu)
    electrons = image.exptime * 10 ** (0.4 * (zeropoint - mag))
    if (too_bright := electrons > ELECTRONS_MAX).any():
        row = np.flatnonzero(too_bright)[0]
        raise InputError(
            f"more than {ELECTRONS_MAX:g} electrons, with the zero point {zeropoint:g} and {image.exptime:g} s",
            file=request.table,
            key=f"{chosen}, row {row + 1}",
            value=float(magnitudes[row]),
            allowed="fainter objects",
        )
    return objects.with_columns(mag=mag, electrons=electrons)


def _make(
    image: ForeignFrame, psf: Psfex | Stamps, objects: ObjectTable, request: Request, target: Path, frame_digest: str
) -> str:
    x, y = image.wcs.pixels(objects["ra"], objects["dec"])
    nearby = np.isfinite(x + y) & (np.abs(x - image.image.shape[1] / 2) < image.image.shape[1] / 2 + STAMP_MAX / 2)
    nearby &= np.abs(y - image.image.shape[0] / 2) < image.image.shape[0] / 2 + STAMP_MAX / 2
    objects = objects.take(nearby).with_columns(x=x[nearby], y=y[nearby])
    electrons = objects["electrons"]
    counts = np.zeros(image.image.shape)
    drawn, visible = render_objects(counts, psf, image, objects, electrons, request.realisation, frame_digest)
    truth = ObjectTable(
        {
            "id": objects["id"],
            "ra": objects["ra"],
            "dec": objects["dec"],
            "xImage": objects["x"] + 1.0,
            "yImage": objects["y"] + 1.0,
            "mag": objects["mag"],
            "obj_type": objects["obj_type"],
            "electrons": electrons,
            "drawn": drawn,
            **{name: objects[name] for name in ("size_disk", "size_bulge", "bulge_frac", "e1", "e2", "kappa")},
        }
    ).take(visible)
    target.parent.mkdir(parents=True, exist_ok=True)
    truth.write(
        target.with_suffix(TRUTH),
        {"level0": target.name, "injected": request.name, "realisation": str(request.realisation)},
    )
    saturated = _write(image, counts, target, record(request, len(truth)))
    outside = len(nearby) - len(truth)
    more = f"; {number_of(image.others, 'more image')} of the file left unchanged" if image.others else ""
    empty = "" if image.has_value().all() else " or on pixels without a value"
    return (
        f"{number_of(len(truth), 'object')} injected, {outside} outside the frame{empty}, {drawn.sum():.6g} electrons; "
        f"{saturated} pixels are full{more}"
    )


def render_objects(
    counts: FloatArray,
    psf: Psfex | Stamps,
    image: ForeignFrame,
    objects: ObjectTable,
    electrons: FloatArray,
    realisation: int,
    frame_digest: str,
) -> tuple[FloatArray, BoolArray]:
    """Add the electrons of objects, Poisson noise included, to `counts` (ny, nx) of a frame; return (drawn, visible).

    objects: ObjectTable with x, y [px from 0]; electrons (n,): nominal; frame_digest: of the frame and its name.
    drawn: (n,) electrons in pixels with a value; visible: (n,) bool, whether the stamp overlaps such pixels.
    """
    import galsim

    galsim.errors.raise_fft_size_error = True  # otherwise GalSim only warns, and then uses all memory

    ny, nx = counts.shape
    matrices = shape_matrix(objects.with_columns(ra_orig=objects["ra"], dec_orig=objects["dec"]), image.wcs)
    parts = components(objects)
    has_value = image.has_value()
    drawn = np.zeros(len(objects))
    visible = np.zeros(len(objects), bool)
    for i in progress(range(len(objects)), "objects"):
        x = float(objects["x"][i])
        y = float(objects["y"][i])
        profile = psf.at(x, y)
        width = _side(profile)
        if objects["obj_type"][i] == GALAXY:
            profile = galsim.Convolve([_galaxy(parts, i, matrices[i]), profile])
        profile = profile.withFlux(float(electrons[i]))
        side = min(max(profile.getGoodImageSize(1.0), width), STAMP_MAX)
        x0 = round(x) - side // 2
        y0 = round(y) - side // 2
        bounds = galsim.BoundsI(x0, x0 + side - 1, y0, y0 + side - 1)
        on_image = bounds & galsim.BoundsI(0, nx - 1, 0, ny - 1)
        if not on_image.isDefined():
            continue
        pixels = slice(on_image.ymin, on_image.ymax + 1), slice(on_image.xmin, on_image.xmax + 1)
        if not has_value[pixels].any():
            continue
        stamp = galsim.Image(on_image, dtype=float)
        try:
            profile.drawImage(stamp, method="no_pixel", center=galsim.PositionD(x, y), scale=1.0)
        except galsim.GalSimFFTSizeError:
            size = max(float(sizes[i]) for _, _, sizes in parts)
            raise InputError(
                "a galaxy is too large to be rendered into an image of another telescope",
                file=image.path,
                key=f"size, id {objects['id'][i]}",
                value=size,
                allowed="a smaller half-light radius [arcsec], or a smaller Sersic index",
            ) from None
        mean = stamp.array
        rng = stream(realisation, "inject", frame_digest, int(objects["id"][i]))
        noisy = rng.poisson(np.maximum(mean, 0)) + np.minimum(mean, 0)
        counts[pixels] += noisy
        drawn[i] = noisy[has_value[pixels]].sum()
        visible[i] = True
    return drawn, visible


def _side(psf: galsim.InterpolatedImage) -> int:
    """Return the side [px] that holds all of a PSF's stamp, wherever in a pixel it is centred."""
    return int(np.ceil((max(psf.image.array.shape) + 2 * _BEYOND) * psf.image.scale)) + 2


def _galaxy(parts: tuple[tuple[FloatArray, Floats, FloatArray], ...], i: int, matrix: FloatArray) -> galsim.GSObject:
    """Return the profile of a galaxy in pixels, of flux 1."""
    import galsim

    profiles = [
        flux[i] * galsim.Sersic(n=float(np.broadcast_to(index, flux.shape)[i]), half_light_radius=float(size[i]))
        for flux, index, size in parts
        if flux[i] > 0
    ]
    return galsim.Add(profiles).transform(*matrix.ravel().tolist()).withFlux(1.0)


def _set(hdu: _BaseHDU, data: AnyArray) -> None:
    """Set the values of an HDU without scaling: astropy has converted scaled integers to floats."""
    if data.dtype.kind == "f":
        for keyword in ("BSCALE", "BZERO"):
            hdu.header.remove(keyword, ignore_missing=True)
    hdu.data = data


def _summed(image: ForeignFrame, counts: FloatArray, changed: BoolArray) -> tuple[AnyArray, BoolArray]:
    """Return (pixels with the added electrons, in the type of the image; full: which of the changed pixels are full).

    A sum ends at SATURATE and at the limits of the type, and next to BLANK. Pixels that were full keep their values.
    """
    pixels = image.image.copy()
    sums = pixels + counts / image.electrons
    maximum = image.full
    if pixels.dtype.kind in "iu":
        limits = np.iinfo(pixels.dtype)
        maximum = int(min(maximum, limits.max))
        sums = np.maximum(np.rint(sums), limits.min)
        if image.blank is not None:
            maximum -= maximum == image.blank > limits.min
            sums += (sums == image.blank) * np.where(pixels > image.blank, 1, -1)
    full = changed & ((sums >= maximum) | (pixels >= maximum))
    added = changed & ~full
    pixels[added] = sums[added]
    pixels[full] = np.maximum(pixels[full], maximum)
    return pixels, full


def _write(image: ForeignFrame, counts: FloatArray, target: Path, record: Record) -> int:
    """Write the copy; return the number of pixels with added electrons that are full."""
    changed = (counts != 0) & image.has_value()
    pixels, full = _summed(image, counts, changed)
    with opened(image.path) as file, atomic_path(target) as temporary:
        has_checksum = any("CHECKSUM" in hdu.header for hdu in file)
        hdu = file[image.number]
        _set(hdu, pixels)
        if image.blank is None:
            hdu.header.remove("BLANK", ignore_missing=True)  # floats say NaN
        if image.error is not None:
            noise = np.maximum(counts, 0) / image.electrons**2
            error = np.sqrt(image.error.astype(float) ** 2 + noise)
            _set(file[image.error_number], np.where(changed, error, image.error).astype(image.error.dtype))
        for keyword, card_value, comment in record["cards"]:
            file[0].header[keyword] = card_value, comment
        for text in record["history"]:
            file[0].header.add_history(f"injected {text}")
        file.writeto(temporary, overwrite=True, output_verify="silentfix+ignore", checksum=has_checksum)
    return int(full.sum())
