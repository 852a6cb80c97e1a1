"""What each reduction in error costs: galaxies and CPU-hours for a wanted sigma(m), from the errors that were measured.

Errors fall as the root of the number of galaxies, so a bar measured to s with n galaxies, each of which cost t CPU
seconds, needs n (s / wanted)^2 of them.
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
    """What a bar needs: a number of galaxies, and CPU-hours."""

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
    """Return the lines of a table: each bar's m in 1e-4, sigma(m), what it cost, and what GOALS cost."""
    heads = "".join(f"{f'h for {goal:.0e}':>12}" for goal in GOALS)
    lines = [_head(heads)]
    for row in rows:
        if row["kind"] not in ("base", "bar"):
            continue
        now = row["galaxies"] * row["seconds"] / HOUR
        hours = "".join(f"{printed_hours(volume(row, goal).hours):>12}" for goal in GOALS)
        words = f"{row['sample']:10}{row['estimator']:10}{row['effect']:26}{row['windows']:8d}{row['galaxies']:9d}"
        numbers = f"{of_row(row, 'm1'):>19}{of_row(row, 'm2'):>19}{sigma_m(row):10.1e}{printed_hours(now):>9}"
        lines.append(f"{words}{numbers}{hours}{row['gain']:6.1f}")
    lines += LEGEND
    bars = [row for row in rows if row["kind"] == "bar" and row["estimator"] == rows[0]["estimator"]]
    known = [row for row in bars if isfinite(sigma_m(row))]
    less = f", and {len(bars) - len(known)} that measured too few galaxies" if len(known) < len(bars) else ""
    for goal in GOALS:
        hours = printed_hours(sum(volume(row, goal).hours for row in known)) if known else "unknown"
        lines.append(
            f"all bars by {rows[0]['estimator']} to {goal:.0e}: {hours} CPU-hours: "
            f"the {len(known)} rows of effects, without the base's own{less}"
        )
    return lines
