"""Headers of frames to be recreated: their keywords, and the HISTORY that csstsim writes."""

from pathlib import Path

from csstsim.io.fits_writing import remark
from csstsim.studies.recreate.frame import FrameHeader

PLACES = {"CRVAL1": 11.0, "CRVAL2": 21.0, "RA_PNT0": 12.0, "DEC_PNT0": 22.0, "RA_OBJ": 13.0, "DEC_OBJ": 23.0,
          "RA_PNT1": 14.0, "DEC_PNT1": 24.0}  # fmt: skip


def header(history=(), name="x.fits", **keys):
    return FrameHeader(Path(name), keys, list(history), (16, 64))


def pieces(*lines):
    """The HISTORY of a file: texts on cards of 72 characters."""
    cards = "".join(remark("HISTORY", f" {line}") for line in lines)
    return [cards[i + 8 : i + 80] for i in range(0, len(cards), 80)]
