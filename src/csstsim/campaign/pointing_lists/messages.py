"""What an import says of a list: why rows were refused, which columns it left, which exposures need care."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.campaign.pointing_lists.quantities import PLACES, parse_key

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from csstsim.campaign.pointing_lists.mapping import Mapping
    from csstsim.campaign.pointing_lists.read_list import PointingList
    from csstsim.instrument.pointing import Pointing

MOST = 8  # kinds of reasons, and names, that are printed


def kinds_of(refused: Iterable[tuple[str, str, str]]) -> Counter[str]:
    """Return the Counter of reasons, values left out."""
    value = r" \(got .*?\)(?=;|$)|; line \d+ has it|(?<=out of range): \S+ \w+"
    return Counter(re.sub(r"-?\d+\.\d+ deg", "N deg", re.sub(value, "", reason)) for _, _, reason in refused)


def say_refused(file: Path, kinds: Counter[str], say: Callable[[str], object]) -> None:
    """Print how many rows each reason has, the most frequent first."""
    say(f"{file}: {number_of(kinds.total(), 'row')} rejected")
    for reason, count in kinds.most_common(MOST):
        say(f"  {count}  {reason}")
    if len(kinds) > MOST:
        say(f"  {kinds.total() - sum(n for _, n in kinds.most_common(MOST))}  of {len(kinds) - MOST} other kinds")


def say_not_used(given: Mapping, names: Sequence[str], say: Callable[[str], object]) -> None:
    """Print which columns of a list are not used, and which of them are quantities but for upper case."""
    known = given.keys()
    used = [source.column for source in known.values()]
    left = [name for k, name in enumerate(names) if name not in used and f"col{k + 1}" not in used]
    if left:
        meant = [name for name in left if _quantity(name.lower()) not in (None, *known)]
        hint = f" (to use it: --map {meant[0].lower()}={meant[0]})" if meant else ""
        say(f"not used: {_some_of(left)}{hint}")


def _quantity(text: str) -> str | None:
    try:
        return parse_key(text).name
    except InputError:
        return None


def say_catalogue_places(given: Mapping, table: PointingList, say: Callable[[str], object]) -> None:
    """Print a hint if columns of directions that are taken as apparent have the names of a catalogue's."""
    known = given.keys()
    columns = [known[name].column for pair in PLACES.values() for name in pair if name in known]
    names = [table.names[table.column(column)] for column in columns if column is not None]
    names = [name for name in names if re.search("J2000|ICRS", name, re.IGNORECASE)]
    if names and given.directions == "apparent":
        say(
            f"{' and '.join(names)} are taken as apparent directions. If they are those of a catalogue, give "
            "--directions icrs: places are up to 26 arcsec off without it."
        )


def say_blocked(obsids: Sequence[str], say: Callable[[str], object]) -> None:
    """Print which exposures have the Earth in the way of the model orbit, and what to do."""
    if obsids:
        say(
            f"Earth in the way of {number_of(len(obsids), 'exposure')}: {_some_of(obsids)}. The list has no state of "
            "the spacecraft there, and the model orbit is elsewhere. With the constant sky this does not matter. The "
            "stray-light model refuses them: map sat_x ... sat_vz, or leave these rows out."
        )


def say_overlaps(exposures: dict[str, Pointing], places: dict[str, str], say: Callable[[str], object]) -> None:
    """Print which exposures begin before another at a different place has ended: one telescope cannot take both.

    exposures: {obsid: Pointing}; places: {obsid: where in the list it stands}.
    """
    found: list[str] = []
    before: str | None = None
    for obsid, one in sorted(exposures.items(), key=lambda item: item[1].start):
        if before and one.start < (other := exposures[before]).end and _aim(one) != _aim(other):
            found.append(f"{obsid} ({places[obsid]}) during {before} ({places[before]})")
        if before is None or one.end > exposures[before].end:
            before = obsid
    if found:
        verb = "begins" if len(found) == 1 else "begin"
        say(f"{number_of(len(found), 'exposure')} {verb} while the telescope points elsewhere: {_some_of(found)}")


def _aim(pointing: Pointing) -> tuple[str, float, float, float]:
    return pointing.type, pointing.ra, pointing.dec, pointing.pa


def _some_of(names: Sequence[str]) -> str:
    """Return the first names in a line, and how many more there are."""
    return ", ".join(names[:MOST]) + (f" and {len(names) - MOST} more" if len(names) > MOST else "")
