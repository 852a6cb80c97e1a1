"""The messages of an import: reasons of refused rows, columns that are not used, exposures that need attention."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.campaign.pointing_lists.quantities import COORDINATES, parse_key

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from csstsim.campaign.pointing_lists.mapping import Mapping
    from csstsim.campaign.pointing_lists.read_list import PointingList, RefusedRow
    from csstsim.instrument.pointing import Pointing

MAX_ITEMS = 8  # kinds of reasons, and names, that are printed


def count_reasons(refused: Iterable[RefusedRow]) -> Counter[str]:
    """Return the Counter of the kinds of reasons: the reasons without the values of single rows."""
    value = r" \(got .*?\)(?=;|$)|; line \d+ has it|(?<=out of range): \S+ \w+"
    return Counter(re.sub(r"-?\d+\.\d+ deg", "N deg", re.sub(value, "", row.reason)) for row in refused)


def log_refused(file: Path, kinds: Counter[str], log: Callable[[str], object]) -> None:
    """Print the number of rows for each kind of reason, the most frequent first."""
    log(f"{file}: {number_of(kinds.total(), 'row')} rejected")
    printed = kinds.most_common(MAX_ITEMS)
    for reason, count in printed:
        log(f"  {count}  {reason}")
    if len(kinds) > MAX_ITEMS:
        log(f"  {kinds.total() - sum(n for _, n in printed)}  of {len(kinds) - MAX_ITEMS} other kinds")


def log_not_used(mapping: Mapping, names: Sequence[str], log: Callable[[str], object]) -> None:
    """Print the columns of a list that are not used, with a hint if one is a quantity except for upper case."""
    sources = mapping.keys()
    used = [source.column for source in sources.values()]
    unused = [name for k, name in enumerate(names) if name not in used and f"col{k + 1}" not in used]
    if unused:
        quantities = [name for name in unused if _quantity(name.lower()) not in (None, *sources)]
        hint = f" (to use it: --map {quantities[0].lower()}={quantities[0]})" if quantities else ""
        log(f"not used: {_first(unused)}{hint}")


def _quantity(text: str) -> str | None:
    try:
        return parse_key(text).name
    except InputError:
        return None


def log_catalogue_directions(mapping: Mapping, table: PointingList, log: Callable[[str], object]) -> None:
    """Print a hint if columns are used as apparent directions, but have names of catalogue coordinates."""
    sources = mapping.keys()
    columns = [sources[name].column for pair in COORDINATES.values() for name in pair if name in sources]
    names = [table.names[table.column(column)] for column in columns if column is not None]
    names = [name for name in names if re.search("J2000|ICRS", name, re.IGNORECASE)]
    if names and mapping.directions == "apparent":
        log(
            f"{' and '.join(names)} are used as apparent directions. If they are ICRS directions, give --directions "
            "icrs: otherwise positions are wrong by up to 26 arcsec."
        )


def log_blocked(obsids: Sequence[str], log: Callable[[str], object]) -> None:
    """Print the exposures that are blocked by the Earth on the model orbit, and what to do."""
    if obsids:
        log(
            f"The Earth blocks {number_of(len(obsids), 'exposure')}: {_first(obsids)}. The list has no state of the "
            "spacecraft for them, and the state of the model orbit does not fit. The constant sky does not use the "
            "state. The stray-light model refuses these exposures: map sat_x ... sat_vz, or remove these rows."
        )


def log_overlaps(exposures: dict[str, Pointing], places: dict[str, str], log: Callable[[str], object]) -> None:
    """Print the exposures that start before the end of another one with a different boresight or type.

    exposures: {obsid: Pointing}; places: {obsid: place in the list, "line 7"}.
    """
    overlaps: list[str] = []
    previous: str | None = None  # the one that ends last
    for obsid, pointing in sorted(exposures.items(), key=lambda item: item[1].start):
        if previous and pointing.start < (other := exposures[previous]).end and _aim(pointing) != _aim(other):
            overlaps.append(f"{obsid} ({places[obsid]}) during {previous} ({places[previous]})")
        if previous is None or pointing.end > exposures[previous].end:
            previous = obsid
    if overlaps:
        verb = "begins" if len(overlaps) == 1 else "begin"
        log(f"{number_of(len(overlaps), 'exposure')} {verb} while the telescope points elsewhere: {_first(overlaps)}")


def _aim(pointing: Pointing) -> tuple[str, float, float, float]:
    return pointing.type, pointing.ra, pointing.dec, pointing.pa


def _first(names: Sequence[str]) -> str:
    """Return the first names as text, and the number of the others."""
    more = f" and {len(names) - MAX_ITEMS} more" if len(names) > MAX_ITEMS else ""
    return ", ".join(names[:MAX_ITEMS]) + more
