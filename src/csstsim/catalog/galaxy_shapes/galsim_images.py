"""GalSim objects that a catalogue's class gives for its galaxies (CatalogBase.galsim_object), turned into images.

GalSim renders an object once, on pixels a quarter as wide as the chip's, and csstsim uses this image. Its x points
east and its y north, so that GalSim's g1, g2 are the catalogue's e1, e2; its flux does not count.

The truth states the accuracy of the image. `user_galsim_lost` is the fraction of the flux beyond it: below 1e-3,
except for objects with extended wings. `user_galsim_blur` is the sigma [arcsec] of a Gaussian that blurs objects too
sharp for GalSim's transform, such as points and Sersic profiles of high index: 0, or 0.0074, which adds
1.1e-4 arcsec^2 to the mean square radius. Images are files in a folder, with names that depend on the object.
"""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.errors import InputError, first_line
from csstsim.base.files.atomic import atomic_path

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from galsim import GSObject

    from csstsim.base.types import FloatArray, PathLike

SCALE = 0.0185  # arcsec per pixel
# pixels: the maximum side of an image, of a transform
SIDE = 2049
TRANSFORM = 4096
BLUR = 0.4 * SCALE
# (sigma of the blur, fraction of flux that may fold back into the image), tried in this order
ATTEMPTS = (0.0, 1e-3), (BLUR, 1e-3), (BLUR, 5e-3), (BLUR, 2e-2)


def galsim_columns(
    profiles: Iterable[tuple[str, GSObject | None]], columns: Mapping[str, Sequence[Any]], folder: PathLike
) -> dict[str, list[Any]]:
    """Return {column: list} of the images of GalSim objects; rows of None keep what `columns` {name: list} has.

    profiles: (where, for messages, and a galsim.GSObject or None) of each row; folder: of the images' files.
    """
    profiles = list(profiles)
    blank = {"image_file": "", "image_scale": 0.0, "galsim_lost": np.nan, "galsim_blur": np.nan}
    made = {name: list(columns.get(name, [None] * len(profiles))) for name in blank}
    for row, (where, profile) in enumerate(profiles):
        if profile is not None:
            for name, value in image_of(profile, folder, where).items():
                made[name][row] = value
    return {name: [blank[name] if given is None else given for given in values] for name, values in made.items()}


def image_of(profile: GSObject, folder: PathLike, where: str) -> dict[str, str | float]:
    """Return {column: value} of a GalSim object's image, which is written to `folder` unless the file exists.

    Raises InputError, which begins with `where`, for another object than a galsim.GSObject, or one that GalSim cannot
    render.
    """
    from astropy.io import fits

    if not hasattr(profile, "drawImage") or getattr(profile, "flux", 0) <= 0:
        allowed = "a galsim.GSObject with flux above 0, or None"
        raise InputError(
            "returned an object that cannot be rendered", key=where, value=type(profile).__name__, allowed=allowed
        )
    profile = profile.withFlux(1.0)
    path = Path(folder) / f"{hashlib.sha256(pickle.dumps(profile)).hexdigest()[:20]}.fits"
    if not path.is_file():
        image = _rendered(profile, where)
        file = fits.PrimaryHDU(image.pixels[:, ::-1].astype(np.float32))  # columns of an image increase to the west
        file.header["SCALE"] = (image.scale, "arcsec per pixel")
        file.header["LOST"] = (max(1.0 - float(image.pixels.sum()), 0.0), "fraction of the flux beyond the image")
        file.header["BLUR"] = (image.blur, "arcsec, sigma")
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            file.writeto(temporary, overwrite=True)
    header = fits.getheader(path)
    return {
        "image_file": str(path),
        "image_scale": header["SCALE"],
        "galsim_lost": header["LOST"],
        "galsim_blur": header["BLUR"],
    }


class _Image(NamedTuple):
    """The flux in each pixel (ny, nx), y upwards; the scale [arcsec per pixel] and the sigma of the blur [arcsec]."""

    pixels: FloatArray
    scale: float
    blur: float


def _rendered(profile: GSObject, where: str) -> _Image:
    """Return the image of a GalSim object."""
    import galsim

    galsim.errors.raise_fft_size_error = True  # otherwise GalSim only warns, and then uses all memory
    for blur, folded in ATTEMPTS:
        sharp = galsim.Convolve([profile, galsim.Gaussian(sigma=blur)]) if blur else profile
        sharp = sharp.withGSParams(folding_threshold=folded, maxk_threshold=1e-3, maximum_fft_size=TRANSFORM)
        try:
            side = sharp.getGoodImageSize(SCALE)
            scale = SCALE * max(1.0, side / SIDE)
            side = min(side, SIDE) | 1
            return _Image(sharp.drawImage(nx=side, ny=side, scale=scale, dtype=float).array, scale, blur)
        except (galsim.GalSimError, MemoryError) as exc:
            reason = exc
    raise InputError(f"GalSim cannot render it: {first_line(reason)}", key=where) from reason
