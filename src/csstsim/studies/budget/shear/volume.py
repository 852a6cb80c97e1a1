"""The cost of smaller errors: galaxies and CPU-hours for a required sigma(m), from the measured errors.

Errors fall as the root of the number of galaxies, so a bar with an error s from n galaxies of t CPU seconds each needs
n (s / required)^2 galaxies.
"""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any, NamedTuple

from csstsim.studies.budget.shear.printed import hours as printed_hours
from csstsim.studies.budget.shear.printed import of_row

GOALS = 3e-4, 1e-4  # of sigma(m)
LEGEND = (
    "m1, m2: of the base, or what an effect adds; CPU-h: spent; h for 3e-04: CPU-hours for a sigma(m) of 3e-4;",
    "gain: how much smaller the scatter of the arms' difference is with one seed for both arms than with two",
)
HOUR = 3600.0


def sigma_m(row: Mapping[str, Any]) -> float:
    """Return the error of m of a row of bars: the larger of its two components."""
    return max(row["m1_err"], row["m2_err"])


class Volume(NamedTuple):
    """The number of galaxies and the CPU-hours that a bar needs."""

    galaxies: float
    hours: float


def volume(row: Mapping[str, Any], goal: float) -> Volume:
    """Return the Volume for an error of m of `goal`."""
    galaxies = row["galaxies"] * (sigma_m(row) / goal) ** 2
    return Volume(galaxies, galaxies * row["seconds"] / HOUR)


def _head(heads: str) -> str:
    words = f"{'sample':10}{'estimator':10}{'effect':26}{'windows':>8}{'galaxies':>9}{'m1 [1e-4]':>19}{'m2 [1e-4]':>19}"
    return f"{words}{'sigma(m)':>10}{'CPU-h':>9}{heads}{'gain':>6}"


def report(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a table: each bar's m in 1e-4, sigma(m), its cost, and the cost of GOALS."""
    heads = "".join(f"{f'h for {goal:.0e}':>12}" for goal in GOALS)
    lines = [_head(heads)]
    for row in rows:
        if row["kind"] not in ("base", "bar"):
            continue
        spent = row["galaxies"] * row["seconds"] / HOUR
        hours = "".join(f"{printed_hours(volume(row, goal).hours):>12}" for goal in GOALS)
        heading = f"{row['sample']:10}{row['estimator']:10}{row['effect']:26}{row['windows']:8d}{row['galaxies']:9d}"
        numbers = f"{of_row(row, 'm1'):>19}{of_row(row, 'm2'):>19}{sigma_m(row):10.1e}{printed_hours(spent):>9}"
        lines.append(f"{heading}{numbers}{hours}{row['gain']:6.1f}")
    lines += LEGEND
    bars = [row for row in rows if row["kind"] == "bar" and row["estimator"] == rows[0]["estimator"]]
    measured = [row for row in bars if isfinite(sigma_m(row))]
    left = len(bars) - len(measured)
    unmeasured = f", and {left} that measured too few galaxies" if left else ""
    for goal in GOALS:
        hours = printed_hours(sum(volume(row, goal).hours for row in measured)) if measured else "unknown"
        lines.append(
            f"all bars by {rows[0]['estimator']} to {goal:.0e}: {hours} CPU-hours: "
            f"the {len(measured)} rows of effects, without the base's own{unmeasured}"
        )
    return lines
