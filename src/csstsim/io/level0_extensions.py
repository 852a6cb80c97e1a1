"""A Level-0 file with one image extension per channel, which ds9 displays as a mosaic and ccdproc reduces.

CHAN01 ... CHAN16 (those that were read) are 1250 x 4700 px each, as the amplifier reads them. Each has the sections of
io.sections in its own pixels, its GAIN, RDNOISE and DETBIA, and the file's WCS in its own pixels, mirrored where they
are. So a viewer shows the right sky on each, up to the distortion unless the file's WCS includes it (`sip`). Any
program that knows IRAF's mosaics places them side by side by DETSEC.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from csstsim.io.level0_writing import channel_wcs
from csstsim.io.sections import sections

if TYPE_CHECKING:
    from astropy.io.fits import Card, HDUList, Header

    from csstsim.detector.channels import Block, ReadoutFrame
    from csstsim.io.level0 import Level0

# A channel's keyword in IMAGE's header (with its number), and its name in the channel's extension
OF_CHANNEL = {"GAIN": "GAIN", "RON": "RDNOISE", "DETBIA": "DETBIA", "NLQ": "NLQ", "NLC": "NLC"}
_LISTED = re.compile(rf"({'|'.join(OF_CHANNEL)}|[DTBC]SEC)\d\d")
_WCS = re.compile(
    r"WCSAXES|(CTYPE|CUNIT|CRVAL|CRPIX)[12]|CD[12]_[12]|LONPOLE|LATPOLE|RADESYS|(A|B|AP|BP)_(ORDER|\d_\d)"
)
_SIP = re.compile(r"(AP?|BP?)_(\d)_(\d)")
# Keywords of the stored array, its WCS, all its channels, and the checksums
_LEFT_OUT = re.compile(
    r"XTENSION|SIMPLE|BITPIX|NAXIS\d?|[PG]COUNT|EXT(NAME|VER|END)|NEXTEND|BSCALE|BZERO|CHECKSUM|DATASUM|COMMENT|HISTORY|"
    rf"LAYOUT|NCHAN|READ[XY][01]|({_WCS.pattern}|WCSNAME)[A-P]?"
)


def extensions(file: Level0) -> HDUList:
    """Return an astropy HDUList of a level0.Level0: its keywords, then a CHANnn for each channel that was read."""
    from astropy.io import fits

    with fits.open(file.path) as hdus:
        primary = hdus[0].header
        image = hdus["IMAGE"].header
    readout = file.readout
    stored = file.readout.to_stored(file.frame(), "channels")
    wcs = {key: image[key] for key in image if _WCS.fullmatch(key)}
    kept = [card for card in image.cards if not (_LEFT_OUT.fullmatch(card.keyword) or _LISTED.fullmatch(card.keyword))]
    out = fits.HDUList([fits.PrimaryHDU(header=fits.Header(_but_structure(primary)))])
    out[0].header["NEXTEND"] = len(readout.blocks)
    for block in readout.blocks:
        n = f"{block.channel:02d}"
        columns = slice(block.stored_x0, block.stored_x0 + readout.block_nx)
        hdu = fits.ImageHDU(stored[:, columns].copy(), fits.Header(kept, copy=True), name=f"CHAN{n}")
        for name, own in OF_CHANNEL.items():
            if name + n in image:
                hdu.header[own] = image[name + n], image.comments[name + n]
        hdu.header["CHANNEL"] = block.channel, "readout channel"
        for name, section in sections(readout, block, "channels", first=block.stored_x0).items():
            hdu.header[name] = section
        hdu.header.update(_own_wcs(wcs, readout, block))
        out.append(hdu)
    return out


def _but_structure(header: Header) -> list[Card]:
    return [card for card in header.cards if not _LEFT_OUT.fullmatch(card.keyword) or card.keyword == "HISTORY"]


def _own_wcs(wcs: Mapping[str, Any], readout: ReadoutFrame, block: Block) -> dict[str, Any]:
    """Return the assembled frame's WCS {keyword: value}, with or without SIP polynomials, in a channel's own pixels."""
    own = channel_wcs(wcs, readout, block, "channels")
    own["CRPIX1"] -= block.stored_x0
    step_x, step_y = (step for _, step in readout.stored_axis(block, "channels"))
    for key, value in wcs.items():
        if term := _SIP.fullmatch(key):
            along = step_x if term[1][0] == "A" else step_y
            own[key] = value * along * step_x ** int(term[2]) * step_y ** int(term[3])
    return own
