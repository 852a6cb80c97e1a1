"""The lines that `csstsim release score` prints."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from csstsim.base.plural import number_of
from csstsim.studies.release.score.statistics import SNR_BRIGHT

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import Any


def summary_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines about a result (score.evaluate)."""
    yield f"{number_of(result['sources'], 'source')} against {number_of(result['objects'], 'true object')}" + (
        f"; by magnitude in {result['band']}" if result["band"] else ""
    )
    for kind, row in result["completeness"].items():
        yield (
            f"completeness of {kind} of S/N above {SNR_BRIGHT:g}: {_format(row['completeness'], 3)} of {row['n']}"
            f" ({_format(row['low'], 3)} to {_format(row['high'], 3)}); merged {_format(row['merged'], 3)}, "
            f"lost {_format(row['lost'], 3)}"
        )
    pure = result["purity"]
    yield (
        f"purity: {_format(pure['purity'], 3)}; by chance {_format(pure['chance'], 3)} would be found real; "
        f"second sources of one object {_format(pure['second'], 3)}"
    )
    for band, kinds in result["photometry"].items():
        for kind, row in kinds.items():
            yield _statistics(f"magnitude in {band}, {kind}", row, "mag", 4)
    for kind, axes in result["astrometry_mas"].items():
        for axis, row in axes.items():
            yield _statistics(f"position, {axis}, {kind}", row, "mas", 2)
    for axis, row in result.get("shapes", {}).items():
        yield (
            f"shape {axis}: slope {_format(row['slope'], 3)} +- {_format(row['slope_error'], 3)}, offset "
            f"{_format(row['offset'], 4)} +- {_format(row['offset_error'], 4)}, scatter {_format(row['scatter'], 3)}, "
            f"of {row['n']}"
        )
    if (row := result.get("redshifts")) and row["n"]:
        yield (
            f"redshifts: bias {row['bias']:+.4f}, sigma_NMAD {row['nmad']:.4f}, beyond 0.15 {row['beyond 0.15']:.3f}, "
            f"of {row['n']} ({row['of']} objects have a source)"
        )


def _statistics(what: str, row: Mapping[str, Any], unit: str, digits: int) -> str:
    return (
        f"{what}: bias {_format(row['mean'], digits)} +- {_format(row['mean_error'], digits)} {unit}, scatter "
        f"{_format(row['scatter'], digits)}, of {row['n']}, outliers {row['outliers']}"
    )


def _format(value: float | None, digits: int) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"
