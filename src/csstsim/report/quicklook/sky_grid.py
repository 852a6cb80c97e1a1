"""The grid of right ascension and declination on a picture: choice of the WCS, lines and labels.

A Level-0 file's WCS is linear, but if FLDDIST is T, field distortion moves the light up to 214 px from it. If the file
was made with the shipped camera (CAMHASH), the distortion is known and is included in the grid. Otherwise the grid of
the header's WCS is drawn, with a remark.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from csstsim.base.sphere import wrap_180
from csstsim.base.types import FloatArray
from csstsim.io import wcs_keywords

if TYPE_CHECKING:
    from astropy.io.fits import Header
    from astropy.visualization.wcsaxes import WCSAxes
    from astropy.wcs import WCS, Sip

    from csstsim.instrument.pointing import Pointing

GRID_COLOUR = "#E0C060"
LINEAR = "grid: the header's linear WCS, without the field distortion of the light"


def exposure_wcs(header: Mapping[str, Any]) -> tuple[WCS | None, str]:
    """Return (astropy WCS of 0-based chip pixels or None, remark or '') from the keywords of a csstsim exposure.

    header: those of HDU 0 and 1 of a Level-0 file together; frames between the stages have the same names.
    """
    if header.get("FILETYPE", "SCIE") != "SCIE":
        return None, ""  # the direction in bias, dark and flat frames has no meaning
    if header.get("FLDDIST") is not True or "SIP" in str(header.get("CTYPE1")):
        return header_wcs(header), ""
    try:
        true = _distorted(header)
    except (KeyError, TypeError, ValueError):  # the header lacks a keyword or has a wrong value
        true = None
    return (header_wcs(header), LINEAR) if true is None else (header_wcs(true), "")


def _distorted(header: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the TAN-SIP header of the exposure if its camera is the shipped one, else None."""
    from csstsim.base.shipped import SHIPPED
    from csstsim.instrument.camera import load_camera
    from csstsim.optics.geometry.distortion import load_distortion
    from csstsim.optics.geometry.sip import sip_header
    from csstsim.optics.geometry.wcs import ChipWCS

    camera = load_camera(SHIPPED / "instrument")
    if header.get("CAMHASH") != camera.digest_for("level0"):
        return None
    aim = SimpleNamespace(ra=header["RA_OBJ"], dec=header["DEC_OBJ"], pa=header["POS_ANG0"])
    pointing = cast("Pointing", aim)  # of which a ChipWCS reads no more
    distortion = load_distortion(camera.folder / "distortion.fits")
    return sip_header(ChipWCS(camera.chips[int(header["DETECTOR"])], pointing, distortion))


def header_wcs(header: Mapping[str, Any] | Header, origin: tuple[int, int] = (0, 0)) -> WCS | None:
    """Return the astropy WCS of FITS keywords (mapping), or None if they give no celestial one.

    origin: the 0-based chip pixel of the array's first pixel; the WCS returned is in chip pixels.
    """
    from astropy.io.fits import Header
    from astropy.wcs import WCS, FITSFixedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        try:
            wcs = WCS(header if isinstance(header, Header) else Header(_main(header)))
        except (ValueError, KeyError, TypeError, AttributeError, MemoryError):  # inconsistent keywords
            return None
    if wcs.naxis != 2 or not wcs.has_celestial:
        return None
    wcs.wcs.crpix += origin
    if wcs.sip is not None:  # its polynomials have a CRPIX of their own
        wcs.sip = _moved(wcs.sip, wcs.wcs.crpix)
    return wcs


def _main(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords of the primary WCS (without a letter); parsing those of channels would only take time."""
    return {key: value for key, value in header.items() if wcs_keywords.WCS.fullmatch(key)}


def _moved(sip: Sip, crpix: FloatArray) -> Sip:
    from astropy.wcs import Sip

    return Sip(sip.a, sip.b, sip.ap, sip.bp, crpix)


def draw_grid(axes: WCSAxes, wcs: WCS, apparent: bool) -> None:
    """Draw the grid of `wcs` over WCSAxes in chip pixels; labels at the top and on the right."""
    lon, lat = overlay = axes.get_coords_overlay(wcs)
    overlay.grid(color=GRID_COLOUR, alpha=0.8, linewidth=0.8)
    lon_side, lat_side = _sides(wcs, axes)
    kind = " (apparent)" if apparent else ""
    for coordinate, side, name in ((lon, lon_side, "RA"), (lat, lat_side, "Dec")):
        coordinate.set_ticks_position(side)
        coordinate.set_ticklabel_position(side)
        coordinate.set_axislabel_position(side[0])
        coordinate.set_axislabel(name + kind)
        coordinate.set_ticklabel(exclude_overlapping=True, size=8)


def _sides(wcs: WCS, axes: WCSAxes) -> tuple[str, str]:
    """Return the sides for the labels of right ascension and of declination: those that more of their lines cross."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    x = (x0 + x1) / 2
    y = (y0 + y1) / 2
    corners, _ = wcs.all_pix2world([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], 0)
    if abs(wrap_180(np.diff(corners)).sum()) > 180.0:  # RA runs once around: a pole is inside
        return "tr", "r"
    ra, _ = wcs.all_pix2world([x, x + 1, x], [y, y, y + 1], 0)
    along_x, along_y = np.abs(wrap_180(ra[1:] - ra[0]))
    return ("t", "r") if along_x >= along_y else ("r", "t")
