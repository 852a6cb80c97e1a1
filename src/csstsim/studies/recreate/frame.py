"""What the header of a frame says of its exposure, and what is assumed where it is silent.

Frames of csstsim say all: exposure, window, seed, and in HISTORY the layers and the changed numbers of the camera. The
mission's files, of any cycle, have fewer keywords, and other names for some. Each assumption is a note, in words.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from csstsim.base.errors import InputError
from csstsim.campaign.survey_table import OBSID, PARTS, STATE, SURVEY
from csstsim.instrument.pointing import parse_utc
from csstsim.io.fits import image_header, open_fits, raw_cards, read_header

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Any

    from fitsio import FITS

    from csstsim.base.types import PathLike
    from csstsim.instrument.chip import Detector

OBSID_IF_NONE = "10100000001"
TIME_IF_NONE = "2027-11-20T01:08:00"
EXPTIME_IF_NONE = 150.0
SEED_IF_NONE = 1
ANGLE_IF_NONE = "POS_ANG0: position angle 0"  # the note
_STATE_KEYS = [f"{kind}0_{axis}" for kind in ("POSI", "VELO") for axis in "XYZ"]
# of orbits; others are placeholders
_RADIUS_MIN_KM = 6_378.0
_RADIUS_MAX_KM = 50_000.0
_NAME = re.compile(r"_(?P<start>\d{14})_(?P<end>\d{14})_(?P<obsid>\d{9,14})_(?P<chip>\d{2})_L0")
_MJD_ZERO = datetime(1858, 11, 17, tzinfo=UTC)
_ENTRY = re.compile(r" (layer|camera|value|injected) ")
_MAP = "maps."  # before the names of laboratory maps among the camera's entries
# of the boresight, the best first
_RA = "CRVAL1", "RA_PNT0", "RA_OBJ", "RA_PNT1"
_DEC = "CRVAL2", "DEC_PNT0", "DEC_OBJ", "DEC_PNT1"
ValueT = TypeVar("ValueT")


@dataclass
class FrameHeader:
    """The header of a frame (primary and image), read tolerantly; `notes` are the assumptions made so far."""

    path: Path
    keys: dict[str, Any]
    history: list[str]
    shape: tuple[int, int]  # of the image, (rows, columns)
    notes: list[str] = field(default_factory=list)

    def get(self, *names: str) -> Any:
        """Return the value of the first keyword that is there and not empty, or None."""
        return next((self.keys[n] for n in names if str(self.keys.get(n, "")).strip()), None)

    def number(self, *names: str) -> float | None:
        """Return the first keyword's value that is a finite number, or None."""
        for name in names:
            try:
                value = float(self.keys[name])
            except (KeyError, TypeError, ValueError):
                continue
            if np.isfinite(value):
                return value
        return None

    def _known(self, *names: str) -> list[float]:
        """Return the numbers of all these keywords, or none if one lacks."""
        found = [value for value in map(self.number, names) if value is not None]
        return found if len(found) == len(names) else []

    def assumed(self, keyword: str, value: ValueT, what: str) -> ValueT:
        """Note that `keyword` is missing and what is taken instead; return that."""
        self.notes.append(f"{keyword}: {what}")
        return value

    @property
    def ours(self) -> bool:
        """Whether csstsim made the frame."""
        return "SIMVER" in self.keys

    @property
    def chip(self) -> int:
        """Number of the chip. Raises InputError if neither header nor file name has it."""
        label = re.search(r"\d+", str(self.get("DETECTOR", "CHIPLAB", "CCDLABEL") or ""))
        name = _NAME.search(self.path.name)
        number = label[0] if label else name["chip"] if name else None
        if number is None:
            raise InputError("no chip number", file=self.path, key="DETECTOR", allowed="DETECTOR, CHIPLAB or CCDLABEL")
        return int(number)

    @property
    def obsid(self) -> str:
        """The exposure's number, 9 to 14 digits."""
        name = _NAME.search(self.path.name)
        found = [str(value) for value in (self.keys.get("OBSID"), name and name["obsid"]) if value is not None]
        good = next((value for value in found if OBSID.fullmatch(value)), None)
        return good or self.assumed("OBSID", OBSID_IF_NONE, f"number {OBSID_IF_NONE}")

    @property
    def exposure(self) -> dict[str, str | float]:
        """{column of a survey table: value} of the exposure. Raises InputError without a position."""
        ra = self.number(*_RA)
        dec = self.number(*_DEC)
        if ra is None or dec is None:
            raise InputError("no position of the boresight", file=self.path, key="CRVAL1, CRVAL2 or RA_PNT0, DEC_PNT0")
        found: dict[str, str | float] = {
            "obsid": self.obsid,
            "type": "SCIE",
            "ra": ra % 360.0,
            "dec": dec,
            "pa": self._angle(),
            "time": self._time(),
            "exptime": self._exptime(),
        }
        return found | self._state() | self._survey()

    def _angle(self) -> float:
        angle = self.number("POS_ANG0", "POS_ANG1")
        cd = self._known("CD1_1", "CD1_2")
        if angle is not None:
            return angle
        if cd and any(cd):
            return self.assumed(
                "POS_ANG0", float(np.degrees(np.arctan2(cd[1], cd[0]))), "position angle of the CD matrix"
            )
        self.notes.append(ANGLE_IF_NONE)
        return 0.0

    def _time(self) -> str:
        text = str(self.get("DATE-OBS") or "")
        try:
            parse_utc(text)
            return text
        except ValueError:
            pass
        mjd = self.number("EXPSTART")
        name = _NAME.search(self.path.name)
        if mjd is not None and mjd > 0:
            start = _MJD_ZERO + timedelta(days=mjd)
            return self.assumed("DATE-OBS", f"{start:%Y-%m-%dT%H:%M:%S.%f}", "the time of EXPSTART")
        if name:
            start = datetime.strptime(name["start"], "%Y%m%d%H%M%S")
            return self.assumed("DATE-OBS", f"{start:%Y-%m-%dT%H:%M:%S}", "the time in the file's name")
        return self.assumed("DATE-OBS", TIME_IF_NONE, TIME_IF_NONE)

    def _exptime(self) -> float:
        exptime = self.number("EXPTIME")
        if exptime is not None and exptime > 0:
            return exptime
        return self.assumed("EXPTIME", EXPTIME_IF_NONE, f"{EXPTIME_IF_NONE:g} s")

    def _state(self) -> dict[str, float]:
        state = self._known(*_STATE_KEYS)
        if state and _RADIUS_MIN_KM < np.linalg.norm(state[:3]) < _RADIUS_MAX_KM and any(state[3:]):
            return dict(zip(STATE, state, strict=True))
        self.notes.append("POSI0_*, VELO0_*: the spacecraft is where the built-in orbit puts it")
        return {}

    def _survey(self) -> dict[str, str]:
        part = str(self.get("SURVEY") or "WIDE").upper()
        if part not in PARTS:
            part = self.assumed("SURVEY", "WIDE", f"{part!r} is no known part of the survey, taken as WIDE")
        return {} if part == "WIDE" else {SURVEY: part}

    def window(self, detector: Detector) -> tuple[int, int, int, int] | None:
        """Return (x0, x1, y0, y1) of the pixels read, or None for the whole chip."""
        ends = self._known("READX0", "READX1", "READY0", "READY1")
        if not ends:
            return None
        x0, x1, y0, y1 = (int(end) for end in ends)
        found = x0 - 1, x1, y0 - 1, y1
        return None if found == (0, detector.nx, 0, detector.ny) else found

    def layers(self) -> list[dict[str, Any]] | None:
        """Return the list of layers that HISTORY names, or None."""
        found = [text.removeprefix("layer ") for kind, text in self._entries() if kind == "layer"]
        try:
            pairs = [(name, json.loads(text)) for name, _, text in (entry.partition(" ") for entry in found)]
        except (ValueError, RecursionError):
            pairs = []
        if not pairs:
            return self.assumed("HISTORY", None, "the layers of config/observations/science.yaml")
        return [{name: param} for name, param in pairs]

    def camera_changes(self) -> dict[str, float]:
        """Return {number of the camera: value} of HISTORY. Raises InputError for one that is no number."""
        found = {}
        for text, name, value in self._of_camera():
            if name.startswith(_MAP):
                continue
            try:
                found[name] = float(value)
            except ValueError:
                raise InputError("not a number of the camera", file=self.path, key="HISTORY", value=text) from None
        return found

    def camera_maps(self) -> dict[str, str]:
        """Return {name of a laboratory map: its file and DATASUM} of HISTORY."""
        return {name.removeprefix(_MAP): value for _, name, value in self._of_camera() if name.startswith(_MAP)}

    def _of_camera(self) -> Iterator[tuple[str, str, str]]:
        """Yield (text, name, value) of HISTORY's entries of the camera."""
        for text in (text for kind, text in self._entries() if kind == "camera"):
            name, _, value = text.removeprefix("camera ").partition(" = ")
            yield text, name, value

    def _entries(self) -> Iterator[tuple[str, str]]:
        """Yield (kind, text) of HISTORY: pieces of a long entry fill their cards, and go on in the next."""
        whole: list[str] = []
        for piece in self.history:
            if _ENTRY.match(piece) or not whole:
                whole.append(piece)
            else:
                whole[-1] = whole[-1].ljust(-(-len(whole[-1]) // 72) * 72) + piece
        for entry in whole:
            if match := _ENTRY.match(entry):
                yield match[1], entry.strip()


def read_frame(path: PathLike) -> FrameHeader:
    """Return the FrameHeader of a raw frame. Raises InputError without an image, and for exposures of no sky."""
    path = Path(path)
    with open_fits(path) as file:
        number = image_number(file, path)
        image = image_header(file[number], path)
        keys = read_header(file[0], path) | image
        history = [card[8:] for card in raw_cards(file[0], path) if card.startswith("HISTORY ")]
    shape = int(image["NAXIS2"]), int(image["NAXIS1"])
    frame = FrameHeader(path, keys, history, shape)
    kind = str(frame.get("FILETYPE") or "SCIE")
    if not kind.startswith(("SCI", "WIDE", "DEEP")):
        raise InputError("not an exposure of the sky", file=path, key="FILETYPE", value=kind, allowed="SCIE")
    return frame


def image_number(file: FITS, path: Path) -> int:
    """Return the number of the HDU with the image: IMAGE, or else the first of two dimensions. Raises InputError."""
    if "IMAGE" in file:
        return next(k for k, hdu in enumerate(file) if hdu.get_extname() == "IMAGE")
    for number, hdu in enumerate(file):
        if hdu.has_data() and hdu.get_exttype() == "IMAGE_HDU" and len(hdu.get_dims()) == 2:
            return number
    raise InputError("holds no image", file=path)
