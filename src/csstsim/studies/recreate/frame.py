"""The exposure, window, layers and camera parameters in the header of a frame, with assumptions for missing keywords.

Frames of csstsim have all of these, the layers and the changed camera parameters in HISTORY. Files of the mission, of
any cycle, have fewer keywords, some under other names. Each assumption is noted in words.
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
from csstsim.campaign.survey_table import COMPONENTS, OBSID, STATE, SURVEY
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
# of orbits: other values are placeholders
_RADIUS_MIN_KM = 6_378.0
_RADIUS_MAX_KM = 50_000.0
_NAME = re.compile(r"_(?P<start>\d{14})_(?P<end>\d{14})_(?P<obsid>\d{9,14})_(?P<chip>\d{2})_L0")
_MJD_ZERO = datetime(1858, 11, 17, tzinfo=UTC)
_ENTRY = re.compile(r" (layer|camera|value|injected) ")
_INJECTED = re.compile(r"injected (\d+) objects? of ")
_MAP_PREFIX = "maps."  # before the names of laboratory maps among the camera's entries
# keywords of the boresight, in order of preference
_RA = "CRVAL1", "RA_PNT0", "RA_OBJ", "RA_PNT1"
_DEC = "CRVAL2", "DEC_PNT0", "DEC_OBJ", "DEC_PNT1"
ValueT = TypeVar("ValueT")


@dataclass
class FrameHeader:
    """The header of a frame (primary and image); keywords may be missing or empty. notes: assumptions made so far."""

    path: Path
    keys: dict[str, Any]
    history: list[str]
    shape: tuple[int, int]  # of the image, (rows, columns)
    notes: list[str] = field(default_factory=list)

    def get(self, *names: str) -> Any:
        """Return the value of the first keyword that exists and is not empty, or None."""
        return next((self.keys[name] for name in names if str(self.keys.get(name, "")).strip()), None)

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

    def _numbers(self, *names: str) -> list[float]:
        """Return the numbers of all these keywords, or an empty list if one is missing."""
        values = [value for value in map(self.number, names) if value is not None]
        return values if len(values) == len(names) else []

    def assume(self, keyword: str, value: ValueT, what: str) -> ValueT:
        """Return the value used for a missing keyword, after adding `what`, its description, to the notes."""
        self.notes.append(f"{keyword}: {what}")
        return value

    @property
    def by_csstsim(self) -> bool:
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
        candidates = [str(value) for value in (self.keys.get("OBSID"), name and name["obsid"]) if value is not None]
        valid = next((value for value in candidates if OBSID.fullmatch(value)), None)
        return valid or self.assume("OBSID", OBSID_IF_NONE, f"number {OBSID_IF_NONE}")

    @property
    def exposure(self) -> dict[str, str | float]:
        """{column of a survey table: value} of the exposure. Raises InputError without a position."""
        ra = self.number(*_RA)
        dec = self.number(*_DEC)
        if ra is None or dec is None:
            raise InputError("no position of the boresight", file=self.path, key="CRVAL1, CRVAL2 or RA_PNT0, DEC_PNT0")
        columns: dict[str, str | float] = {
            "obsid": self.obsid,
            "type": "SCIE",
            "ra": ra % 360.0,
            "dec": dec,
            "pa": self._angle(),
            "time": self._time(),
            "exptime": self._exptime(),
        }
        return columns | self._state() | self._survey()

    def _angle(self) -> float:
        angle = self.number("POS_ANG0", "POS_ANG1")
        cd = self._numbers("CD1_1", "CD1_2")
        if angle is not None:
            return angle
        if cd and any(cd):
            return self.assume(
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
            return self.assume("DATE-OBS", f"{start:%Y-%m-%dT%H:%M:%S.%f}", "the time of EXPSTART")
        if name:
            start = datetime.strptime(name["start"], "%Y%m%d%H%M%S")
            return self.assume("DATE-OBS", f"{start:%Y-%m-%dT%H:%M:%S}", "the time in the file's name")
        return self.assume("DATE-OBS", TIME_IF_NONE, TIME_IF_NONE)

    def _exptime(self) -> float:
        exptime = self.number("EXPTIME")
        if exptime is not None and exptime > 0:
            return exptime
        return self.assume("EXPTIME", EXPTIME_IF_NONE, f"{EXPTIME_IF_NONE:g} s")

    def _state(self) -> dict[str, float]:
        state = self._numbers(*_STATE_KEYS)
        if state and _RADIUS_MIN_KM < np.linalg.norm(state[:3]) < _RADIUS_MAX_KM and any(state[3:]):
            return dict(zip(STATE, state, strict=True))
        self.notes.append("POSI0_*, VELO0_*: the spacecraft is where the built-in orbit puts it")
        return {}

    def _survey(self) -> dict[str, str]:
        component = str(self.get("SURVEY") or "WIDE").upper()
        if component not in COMPONENTS:
            component = self.assume("SURVEY", "WIDE", f"{component!r} is no known part of the survey, taken as WIDE")
        return {} if component == "WIDE" else {SURVEY: component}

    def window(self, detector: Detector) -> tuple[int, int, int, int] | None:
        """Return (x0, x1, y0, y1) of the pixels read, or None for the whole chip."""
        ends = self._numbers("READX0", "READX1", "READY0", "READY1")
        if not ends:
            return None
        x0, x1, y0, y1 = (int(end) for end in ends)
        window = x0 - 1, x1, y0 - 1, y1
        return None if window == (0, detector.nx, 0, detector.ny) else window

    def layers(self) -> list[dict[str, Any]] | None:
        """Return the list of layers that HISTORY names, or None."""
        entries = [text.removeprefix("layer ") for kind, text in self._entries() if kind == "layer"]
        try:
            pairs = [(name, json.loads(text)) for name, _, text in (entry.partition(" ") for entry in entries)]
        except (ValueError, RecursionError):
            pairs = []
        if not pairs:
            return self.assume("HISTORY", None, "the layers of config/observations/science.yaml")
        return [{name: param} for name, param in pairs]

    def camera_changes(self) -> dict[str, float]:
        """Return {camera parameter: value} of HISTORY. Raises InputError for a value that is not a number."""
        changes = {}
        for name, value in self._camera_entries():
            if name.startswith(_MAP_PREFIX):
                continue
            try:
                changes[name] = float(value)
            except ValueError:
                text = f"camera {name} = {value}"
                raise InputError("not a camera parameter", file=self.path, key="HISTORY", value=text) from None
        return changes

    def camera_maps(self) -> dict[str, str]:
        """Return {name of a laboratory map: its file and DATASUM} of HISTORY."""
        maps = [(name, value) for name, value in self._camera_entries() if name.startswith(_MAP_PREFIX)]
        return {name.removeprefix(_MAP_PREFIX): value for name, value in maps}

    def injected(self) -> int:
        """Return the number of objects that HISTORY states as injected (`csstsim inject`)."""
        found = (_INJECTED.match(text) for kind, text in self._entries() if kind == "injected")
        return sum(int(match[1]) for match in found if match)

    def _camera_entries(self) -> Iterator[tuple[str, str]]:
        """Yield (name, value) of the entries of HISTORY on the camera."""
        for text in (text for kind, text in self._entries() if kind == "camera"):
            name, _, value = text.removeprefix("camera ").partition(" = ")
            yield name, value

    def _entries(self) -> Iterator[tuple[str, str]]:
        """Yield (kind, text) of the entries of HISTORY: a long entry fills its card and continues in the next."""
        entries: list[str] = []
        for piece in self.history:
            if _ENTRY.match(piece) or not entries:
                entries.append(piece)
            else:
                entries[-1] = entries[-1].ljust(-(-len(entries[-1]) // 72) * 72) + piece
        for entry in entries:
            if match := _ENTRY.match(entry):
                yield match[1], entry.strip()


def read_frame(path: PathLike) -> FrameHeader:
    """Return the FrameHeader of a raw frame. Raises InputError without an image, and for calibration exposures."""
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
