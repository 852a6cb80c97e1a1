"""What each reduction in error costs: galaxies and CPU-hours for a wanted sigma(m), from the errors that were measured.

Errors fall as the root of the number of galaxies, so a bar measured to s with n galaxies, each of which cost t CPU
seconds, needs n (s / wanted)^2 of them.
"""

import numpy as np

GOALS = 3e-4, 1e-4  # of sigma(m)
HOUR = 3600.0


def sigma_m(row):
    """Return the error of m of a row of bars: the larger of its two components."""
    return max(row["m1_err"], row["m2_err"])


def volume(row, goal):
    """Return (galaxies, CPU-hours) for an error of m of `goal`."""
    galaxies = row["galaxies"] * (sigma_m(row) / goal) ** 2
    return galaxies, galaxies * row["seconds"] / HOUR


def report(rows):
    """Return the lines of a table: each bar's sigma(m), what it cost, and what GOALS cost."""
    heads = "".join(f"{f'h for {goal:.0e}':>12}" for goal in GOALS)
    lines = [f"{'sample':10}{'estimator':10}{'effect':26}{'galaxies':>9}{'sigma(m)':>10}{'CPU-h':>8}{heads}{'gain':>6}"]
    for row in rows:
        if row["kind"] not in ("base", "bar"):
            continue
        now = row["galaxies"] * row["seconds"] / HOUR
        hours = "".join(f"{volume(row, goal)[1]:12.2f}" for goal in GOALS)
        lines.append(
            f"{row['sample']:10}{row['estimator']:10}{row['effect']:26}{row['galaxies']:9d}{sigma_m(row):10.1e}{now:8.3f}"
            f"{hours}{row['gain']:6.1f}"
        )
    bars = [row for row in rows if row["kind"] == "bar" and row["estimator"] == rows[0]["estimator"]]
    for goal in GOALS:
        hours = np.nansum([volume(row, goal)[1] for row in bars])
        lines.append(f"all bars by {rows[0]['estimator']} to {goal:.0e}: {hours:.1f} CPU-hours")
    return lines
