"""Names of Level-0 files, in the forms that public files and pipelines of the survey have used.

C9    CSST_MSC_MS_WIDE_{start}_{end}_{obsid}_{chip}_L0_V01   Cycle 9 (DEEP: of deep fields); truth: the same name
C5.2  CSST_MSC_MS_SCI_{start}_{end}_{obsid}_{chip}_L0_1      truth: MSC_{obsid}_chip_{chip}_filt_{filter}
C5.1  the same                                               truth: as C5.2, but of obsid - 90000000
C3    MSC_MS_{start}_{obsid}_{chip}_raw                      truth: MSC_{start}_{obsid - 100000000}_{chip}

Start and end are YYYYMMDDhhmmss in UTC, of C3 without the century. Source of the older forms: the survey's early
Level-1 pipeline, whose file manager describes them (github.com/csster/csst, csst/msc/data_manager.py).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from csstsim.campaign.job import Job

NEWEST = "C9"  # of the forms; the default

_PATTERNS = {
    "kind": "[A-Z]+",
    "t": r"\d{14}",
    "t_end": r"\d{14}",
    "t_short": r"\d{12}",
    "obsid": r"\d{9,14}",
    "chip": r"\d{2}",
}


class NameParts(NamedTuple):
    """The parts of a file name that all forms have; type: of the exposure, as SCIE; chip: its number."""

    type: str
    obsid: str
    chip: int


@dataclass(frozen=True)
class NameForm:
    """One form of file names.

    template, truth: names, without suffix, of the Level-0 file and of its truth as an ASCII catalogue; kinds: the code
    of each exposure type; deep: the code of science exposures of the deep survey, if it differs.
    """

    template: str
    truth: str
    kinds: dict[str, str]
    deep: str = ""

    @property
    def ending(self) -> str:
        """The part of the name that follows {obsid}_{chip}_."""
        return self.template.partition("{chip}_")[2]

    @property
    def beginning(self) -> str:
        """A regular expression of the part of the name that precedes _{obsid}."""
        return self.template.partition("_{obsid}")[0].format(**_PATTERNS)

    def stem(self, job: Job) -> str:
        """Return the name of a job's Level-0 file without suffix. job: campaign.job.Job."""
        pointing = job.pointing
        kind = self.deep if self.deep and pointing.survey == "DEEP" else self.kinds[pointing.type]
        start = f"{pointing.start:%Y%m%d%H%M%S}"
        end = f"{pointing.end:%Y%m%d%H%M%S}"
        chip = f"{job.chip.id:02d}"
        return self.template.format(kind=kind, t=start, t_end=end, t_short=start[2:], obsid=job.obsid, chip=chip)

    def catalogue(self, stem: str, filter: str) -> str | None:
        """Return the name of the truth as text of a Level-0 file, both without suffix; None for another form."""
        if not (match := self._pattern().fullmatch(stem)):
            return None
        fields = match.groupdict()
        number = int(fields["obsid"])
        band = filter.lower()
        fields |= {"stem": stem, "band": band, "number": number - 90_000_000, "short": f"{number - 100_000_000:07d}"}
        return self.truth.format(**fields)

    def read(self, stem: str) -> NameParts | None:
        """Return the parts of a Level-0 file's name without suffix, or None."""
        match = self._pattern().fullmatch(stem)
        kind = match and {code: kind for kind, code in [*self.kinds.items(), ("SCIE", self.deep)]}.get(match["kind"])
        return NameParts(kind, match["obsid"], int(match["chip"])) if match and kind else None

    def _pattern(self) -> re.Pattern[str]:
        return re.compile(self.template.format(**{name: f"(?P<{name}>{text})" for name, text in _PATTERNS.items()}))


_CALIBRATION = {kind: kind for kind in ("BIAS", "DARK", "FLAT")}  # the releases have science exposures only
_C5 = "CSST_MSC_MS_{kind}_{t}_{t_end}_{obsid}_{chip}_L0_1"
FORMS = {
    "C9": NameForm(
        "CSST_MSC_MS_{kind}_{t}_{t_end}_{obsid}_{chip}_L0_V01", "{stem}", {"SCIE": "WIDE"} | _CALIBRATION, "DEEP"
    ),
    "C5.2": NameForm(_C5, "MSC_{obsid}_chip_{chip}_filt_{band}", {"SCIE": "SCI"} | _CALIBRATION),
    "C5.1": NameForm(_C5, "MSC_{number}_chip_{chip}_filt_{band}", {"SCIE": "SCI"} | _CALIBRATION),
    "C3": NameForm(
        "MSC_{kind}_{t_short}_{obsid}_{chip}_raw",
        "MSC_{t_short}_{short}_{chip}",
        {"SCIE": "MS", "BIAS": "CLB", "DARK": "CLD", "FLAT": "CLF"},
    ),
}


def read_name(stem: str) -> NameParts | None:
    """Return the parts of a Level-0 file's name without suffix, of any form, or None."""
    return next((parts for form in FORMS.values() if (parts := form.read(stem))), None)
