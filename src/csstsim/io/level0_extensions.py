"""A Level-0 file with one image extension per channel, which ds9 displays as a mosaic and ccdproc reduces.

CHAN01 ... CHAN16 (those that were read) have 1250 x 4700 px each, in the order in which the amplifier reads them. Each
has its GAIN, RDNOISE and DETBIA. The sections of io.sections and the file's WCS are given in the channel's pixels, and
mirrored if these are. So a viewer shows the right sky on each; the distortion is missing unless the file's WCS includes
it (`sip`). A program that reads IRAF's mosaics arranges the extensions by DETSEC.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from csstsim.io.level0_writing import channel_wcs
from csstsim.io.sections import sections
from csstsim.io.wcs_keywords import ANY_WCS, WCS

if TYPE_CHECKING:
    from astropy.io.fits import Card, HDUList, Header

    from csstsim.detector.channels import Block, ReadoutFrame
    from csstsim.io.level0 import Level0

# A channel's keyword in the header of IMAGE, without its number, and in the header of the channel's extension
CHANNEL_KEYWORDS = {"GAIN": "GAIN", "RON": "RDNOISE", "DETBIA": "DETBIA", "NLQ": "NLQ", "NLC": "NLC"}
_PER_CHANNEL = re.compile(rf"({'|'.join(CHANNEL_KEYWORDS)}|[DTBC]SEC)\d\d")
_SIP = re.compile(r"(AP?|BP?)_(\d)_(\d)")
# Keywords of the stored array, of its WCS, of all channels, and of the checksums
_OMITTED = re.compile(
    r"XTENSION|SIMPLE|BITPIX|NAXIS\d?|[PG]COUNT|EXT(NAME|VER|END)|NEXTEND|BSCALE|BZERO|CHECKSUM|DATASUM|COMMENT|HISTORY|"
    rf"LAYOUT|NCHAN|READ[XY][01]|{ANY_WCS.pattern}"
)


def extensions(file: Level0) -> HDUList:
    """Return an astropy HDUList of a level0.Level0: its keywords, then a CHANnn for each channel that was read."""
    from astropy.io import fits

    with fits.open(file.path) as hdus:
        primary = hdus[0].header
        image = hdus["IMAGE"].header
    readout = file.readout
    stored = file.readout.to_stored(file.frame(), "channels")
    wcs = {key: image[key] for key in image if WCS.fullmatch(key)}
    common = [
        card for card in image.cards if not (_OMITTED.fullmatch(card.keyword) or _PER_CHANNEL.fullmatch(card.keyword))
    ]
    mosaic = fits.HDUList([fits.PrimaryHDU(header=fits.Header(_without_structure(primary)))])
    mosaic[0].header["NEXTEND"] = len(readout.blocks)
    for block in readout.blocks:
        number = f"{block.channel:02d}"
        columns = slice(block.stored_x0, block.stored_x0 + readout.block_nx)
        hdu = fits.ImageHDU(stored[:, columns].copy(), fits.Header(common, copy=True), name=f"CHAN{number}")
        for name, keyword in CHANNEL_KEYWORDS.items():
            if name + number in image:
                hdu.header[keyword] = image[name + number], image.comments[name + number]
        hdu.header["CHANNEL"] = block.channel, "readout channel"
        for name, section in sections(readout, block, "channels", first=block.stored_x0).items():
            hdu.header[name] = section
        hdu.header.update(_pixel_wcs(wcs, readout, block))
        mosaic.append(hdu)
    return mosaic


def _without_structure(header: Header) -> list[Card]:
    return [card for card in header.cards if not _OMITTED.fullmatch(card.keyword) or card.keyword == "HISTORY"]


def _pixel_wcs(wcs: Mapping[str, Any], readout: ReadoutFrame, block: Block) -> dict[str, Any]:
    """Return the assembled frame's WCS {keyword: value}, with or without SIP polynomials, in a channel's pixels."""
    changed = channel_wcs(wcs, readout, block, "channels")
    changed["CRPIX1"] -= block.stored_x0
    (_, step_x), (_, step_y) = readout.stored_axis(block, "channels")
    for key, value in wcs.items():
        if term := _SIP.fullmatch(key):
            sign = step_x if term[1][0] == "A" else step_y
            changed[key] = value * sign * step_x ** int(term[2]) * step_y ** int(term[3])
    return changed
