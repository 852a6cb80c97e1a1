"""PSFs of frames that are not csstsim's: a model of PSFEx, or FITS stamps, one or many.

Stamps: an image (one stamp for the whole frame), or a cube (n, side, side) with a table extension of columns X and Y,
the positions of the stamps (FITS pixels, the first at 1). PSFSAMP [pixel] in the image's header is the sampling step
[default: 1]. Stamps contain the pixel's response, as those of PSFEx do. Between positions, the four nearest stamps are
averaged, weighted with the inverse square of their distance.

A PSF is refused if the pixels of a star would not sum to its flux, wherever in a pixel its centre is. The response of
the pixel makes the sum independent of the centre. Of a model of PSFEx, only the middle of its field is checked.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError, first_line
from csstsim.base.types import AnyArray, FloatArray
from csstsim.inject.others.with_astropy import opened

if TYPE_CHECKING:
    import galsim
    import galsim.des
    import galsim.interpolant
    from astropy.io.fits import HDUList

    from csstsim.base.types import PathLike

NEAREST = 4
POSITION_MAX = 1e9  # px: the squares of distances stay finite
FLUX_ERROR = 0.02  # maximum relative error of the sum of a star's pixels
NEGATIVE = 0.05  # maximum fraction of the flux in negative samples, as of images of galaxies
PHASES = 0.0, 1 / 3, 2 / 3  # px, of centres along x and y at which the flux is checked
STEP_SAFE = 4.0  # px: the interpolation of wider samples is smooth on the scale of a pixel, and not checked
PSFEX = "PSF_DATA"  # the extension of its models (PSFEx manual, section 6)
STEP = "PSFSAMP"


@dataclass(frozen=True, eq=False)
class Stamps:
    """Stamps (n, side, side), each of sum 1, of `step` pixels a sample, at x, y (n,) px from 0."""

    stamps: FloatArray
    x: FloatArray
    y: FloatArray
    step: float

    def at(self, x: float, y: float) -> galsim.GSObject:
        """Return the galsim profile at a position [px, from 0]; its unit is a pixel, its flux 1."""
        import galsim

        distance2 = (self.x - x) ** 2 + (self.y - y) ** 2
        nearest = np.argsort(distance2, kind="stable")[:NEAREST]
        weight = 1.0 / np.maximum(distance2[nearest], 1e-12)
        stamp = np.tensordot(weight / weight.sum(), self.stamps[nearest], axes=1)
        return galsim.InterpolatedImage(galsim.Image(stamp), scale=self.step, flux=1.0, x_interpolant=galsim.Quintic())


@dataclass(frozen=True, eq=False)
class Psfex:
    """A model of PSFEx."""

    model: galsim.des.DES_PSFEx

    def at(self, x: float, y: float) -> galsim.GSObject:
        """As Stamps.at."""
        import galsim

        stamp = galsim.Image(self.model.getPSFArray(galsim.PositionD(x + 1.0, y + 1.0)))
        return galsim.InterpolatedImage(stamp, scale=self.model.sample_scale, flux=1.0, x_interpolant=_smooth())


def _smooth() -> galsim.Lanczos:
    import galsim

    return galsim.Lanczos(3)


def read_psf(path: PathLike, band: str = "") -> Psfex | Stamps:
    """Return the Psfex or Stamps of a file. Raises InputError, also if it states another filter than `band`."""
    path = Path(path)
    with opened(path, "--psf") as file:
        stated = next((str(h.header["FILTER"]).strip() for h in file if str(h.header.get("FILTER", "")).strip()), "")
        if stated and band and stated.lower() != band.lower():
            raise InputError("a PSF of another filter", file=path, key="FILTER", value=stated, allowed=band)
        if any(hdu.name == PSFEX for hdu in file):
            return _psfex(path)
        return _stamps(path, file)


def _psfex(path: Path) -> Psfex:
    import galsim.des

    try:
        model = galsim.des.DES_PSFEx(str(path))
        middle = np.asarray(model.getPSFArray(galsim.PositionD(model.x_zero, model.y_zero)), float)
    except Exception as exc:  # of many types
        raise InputError(f"not a model of PSFEx that can be read: {first_line(exc)}", file=path) from None
    _normalised(path, "PSF_SAMP", middle[None], float(model.sample_scale), _smooth())
    return Psfex(model)


def _stamps(path: Path, file: HDUList) -> Stamps:
    import galsim

    hdu = next((h for h in file if h.is_image and h.header.get("NAXIS", 0) in (2, 3) and h.data is not None), None)
    if hdu is None:
        raise InputError("contains neither a model of PSFEx nor stamps", file=path, key="--psf")
    stamps = np.asarray(hdu.data, float)
    step = hdu.header.get(STEP, 1.0)
    stamps = stamps[None] if stamps.ndim == 2 else stamps
    if not (isinstance(step, int | float) and 0 < step < np.inf):
        raise InputError("not a sampling step", file=path, key=STEP, value=step, allowed="above 0 px")
    positions = next((h.data for h in file if not h.is_image and {"X", "Y"} <= set(h.columns.names)), None)
    x: FloatArray = np.zeros(1)
    y: FloatArray = np.zeros(1)
    if len(stamps) > 1:
        if positions is None or len(positions) != len(stamps):
            raise InputError("stamps without a position for each", file=path, key="X, Y", value=len(stamps))
        x, y = _positions(path, positions["X"], positions["Y"])
    return Stamps(_normalised(path, STEP, stamps, float(step), galsim.Quintic()), x, y, float(step))


def _normalised(
    path: Path, key: str, stamps: FloatArray, step: float, interpolant: galsim.interpolant.Interpolant
) -> FloatArray:
    """Return stamps (n, rows, columns) of sum 1. Raises InputError if a star's pixels would not sum to its flux.

    key: of the sampling step [px]; interpolant: with which the stamps are rendered.
    """
    sums = stamps.sum(axis=(1, 2))
    if not (np.isfinite(sums) & (sums > 0)).all():
        raise InputError("a stamp has no flux, or values that are not numbers", file=path)
    negative = -np.minimum(stamps, 0).sum(axis=(1, 2)) / np.maximum(stamps, 0).sum(axis=(1, 2))
    if (worst := float(negative.max())) > NEGATIVE:
        value = f"{worst:.1%} of the flux"
        raise InputError(
            "too much flux in negative samples of a stamp",
            file=path,
            key="--psf",
            value=value,
            allowed=f"at most {NEGATIVE:.0%}: subtract the background, and mask other objects",
        )
    stamps = stamps / sums[:, None, None]
    if step < STEP_SAFE:
        along_y, along_x = (_pixels_of_samples(side, step, interpolant) for side in stamps.shape[1:])
        fluxes = np.einsum("nyx,py,qx->npq", stamps, along_y, along_x, optimize=True)
        error = float(np.abs(fluxes - 1).max())
        if error > FLUX_ERROR:
            raise InputError(
                f"the flux of a star would be wrong by {100 * error:.3g}%: the stamps are narrower than a pixel, do "
                "not contain the pixel's response, or end where they are bright",
                file=path,
                key=key,
                value=step,
                allowed=f"stamps whose pixels sum to the flux within {FLUX_ERROR:.0%}",
            )
    return stamps


def _pixels_of_samples(side: int, step: float, interpolant: galsim.interpolant.Interpolant) -> FloatArray:
    """Return (phases, side): the sum over all pixels of what one sample adds to them, for each of PHASES."""
    reach = int(np.ceil(interpolant.xrange * step)) + 1
    at = (np.arange(side) - (side - 1) / 2) * step + np.array(PHASES)[:, None]
    distance = np.floor(at)[..., None] + np.arange(-reach, reach + 1) - at[..., None]
    return interpolant.xval((distance / step).ravel()).reshape(distance.shape).sum(axis=-1) / step


def _positions(path: Path, x: AnyArray, y: AnyArray) -> tuple[FloatArray, FloatArray]:
    """Return the positions [px, from 0] of stamps, of columns that count from 1. Raises InputError."""
    for row, pair in enumerate(zip(x, y, strict=True), 1):
        if not all(np.ndim(v) == 0 and isinstance(v, np.number) and abs(v) < POSITION_MAX for v in pair):
            value = ", ".join(map(str, pair))
            allowed = f"numbers of FITS pixels, within {POSITION_MAX:g}"
            raise InputError("not a stamp's position", file=path, key=f"X, Y, row {row}", value=value, allowed=allowed)
    return np.asarray(x, float) - 1.0, np.asarray(y, float) - 1.0
