"""The lines that `csstsim release score` prints."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from csstsim.base.plural import number_of
from csstsim.studies.release.score.numbers import SNR_HEAD

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import Any


def lines(result: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines about a result (score.evaluate)."""
    yield f"{number_of(result['sources'], 'source')} against {number_of(result['objects'], 'true object')}" + (
        f"; by magnitude in {result['band']}" if result["band"] else ""
    )
    for kind, one in result["completeness"].items():
        yield (
            f"completeness of {kind} of S/N above {SNR_HEAD:g}: {_cell(one['completeness'], 3)} of {one['n']}"
            f" ({_cell(one['low'], 3)} to {_cell(one['high'], 3)}); merged {_cell(one['merged'], 3)}, "
            f"lost {_cell(one['lost'], 3)}"
        )
    pure = result["purity"]
    yield (
        f"purity: {_cell(pure['purity'], 3)}; by chance {_cell(pure['chance'], 3)} would be found real; "
        f"second sources of one object {_cell(pure['second'], 3)}"
    )
    for band, kinds in result["photometry"].items():
        for kind, one in kinds.items():
            yield _statistics(f"magnitude in {band}, {kind}", one, "mag", 4)
    for kind, axes in result["astrometry_mas"].items():
        for axis, one in axes.items():
            yield _statistics(f"position, {axis}, {kind}", one, "mas", 2)
    for axis, one in result.get("shapes", {}).items():
        yield (
            f"shape {axis}: slope {_cell(one['slope'], 3)} +- {_cell(one['slope_error'], 3)}, offset "
            f"{_cell(one['offset'], 4)} +- {_cell(one['offset_error'], 4)}, scatter {_cell(one['scatter'], 3)}, "
            f"of {one['n']}"
        )
    if (one := result.get("redshifts")) and one["n"]:
        yield (
            f"redshifts: bias {one['bias']:+.4f}, sigma_NMAD {one['nmad']:.4f}, beyond 0.15 {one['beyond 0.15']:.3f}, "
            f"of {one['n']} ({one['of']} objects have a source)"
        )


def _statistics(what: str, one: Mapping[str, Any], unit: str, digits: int) -> str:
    return (
        f"{what}: bias {_cell(one['mean'], digits)} +- {_cell(one['mean_error'], digits)} {unit}, scatter "
        f"{_cell(one['scatter'], digits)}, of {one['n']}, outliers {one['outliers']}"
    )


def _cell(value: float | None, digits: int) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"
