"""The bars of the budget: what the shapes of all fields say of each effect, the sum of the bars, and their cost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.budget.shear.plan import ALL, BASE
from csstsim.budget.shear.response import NAMES, Arms, Frame, combined, scatter, sums
from csstsim.budget.shear.run import setting_of

if TYPE_CHECKING:
    from csstsim.budget.shear.plan import ShearPlan

SUM = "sum of the bars"
REST = "all at once less the sum"
WINDOWS = 8  # fewest for a jackknife over windows; with fewer, errors that are common to a window are left out
KINDS = "base", "bar", "sum", "all", "rest"


def bars(plan: ShearPlan, paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Return [row] of one sample: its base, its bars, their sum, the run with all effects, and what they differ by.

    A row: estimator, effect, kind (KINDS), about, each of NAMES with NAME_err, windows and galaxies (of a sum: those of
    the bar that has the fewest), seconds (CPU, of a galaxy: both Settings of a bar), scatter and scatter_two (half the
    difference of the arms, one seed and two), gain. paths: of all windows, or of the first ones.
    """
    if not paths:
        return []
    shapes = _Shapes(plan, paths)
    return [row for kind in plan.estimators for row in _rows(plan, shapes, kind)]


class _Shapes:
    """The shapes of all fields, joined."""

    def __init__(self, plan: ShearPlan, paths: Sequence[Path]) -> None:
        self.plan = plan
        self.fields = [dict(np.load(path)) for path in paths]
        rings = np.cumsum([0] + [len(np.unique(field["ring"])) for field in self.fields])
        self.ring = np.concatenate([start + field["ring"] for start, field in zip(rings, self.fields, strict=False)])
        self.window = np.repeat(np.arange(len(self.fields)), [len(field["ring"]) for field in self.fields])
        self.sign = np.concatenate([np.full(len(field["ring"]), field["sign"]) for field in self.fields])
        self.psf = np.concatenate([field["psf"] for field in self.fields])

    def windows(self, name: str, settings: Iterable[str], kind: str) -> int:
        """Return the number of first windows that have an effect's bar, BASE or ALL: its Settings by an estimator."""
        needed = [f"{setting}|{kind}|e" for setting in settings]
        has = [all(key in field for key in needed) for field in self.fields[: self.plan.windows(name)]]
        return has.index(False) if False in has else len(has)

    def arms(self, name: str, kind: str, windows: int) -> Arms:
        """Return the Arms of a Setting and an estimator, in the first windows."""
        fields = self.fields[:windows]
        e, response = (
            np.concatenate([field[f"{name}|{kind}|{key}"] for field in fields], axis=1) for key in ("e", "response")
        )
        return Arms(e, response, np.concatenate([field[f"{name}|used"] for field in fields], axis=1))

    def seconds(self, settings: Iterable[str], windows: int) -> float:
        """Return CPU seconds of a galaxy in these Settings."""
        fields = self.fields[:windows]
        spent = sum(float(field[f"{name}|seconds"]) for name in settings for field in fields)
        return spent / sum(len(field["ring"]) for field in fields)

    def frame(self, common: bool, windows: int) -> Frame:
        """Return the response.Frame of the first windows, in blocks of windows if common, else of rings."""
        some = slice(np.count_nonzero(self.window < windows))
        block = self.window if common else self.ring
        return Frame(self.plan.shear, self.sign[some], self.psf[some], block[some])

    def scatters(self, name: str, kind: str) -> tuple[float, float]:
        """Return the scatter of half the difference of the arms of field 0, with one seed and with two."""
        first = self.fields[0]
        e = first[f"{name}|{kind}|e"]
        return scatter(*e), scatter(e[0], first[f"{name}|{kind}|other"])


def _rows(plan: ShearPlan, shapes: _Shapes, kind: str) -> list[dict[str, Any]]:
    term = partial(_term, plan, shapes, kind)
    rows = [_row(shapes, kind, "base", BASE, "all that follows left out", [term(BASE)])]
    for name in plan.bars:
        effect = plan.effects[name]
        rows.append(_row(shapes, kind, "bar", name, effect.about, [term(name)], effect.common))
    if plan.summed:
        common = any(plan.effects[name].common for name in plan.summed)
        added = [term(name) for name in plan.summed]
        whole = [term(ALL)]
        rest = whole + [({setting: -factor for setting, factor in of.items()}, windows) for of, windows in added]
        for row_kind, label, terms in (("sum", SUM, added), ("all", ALL, whole), ("rest", REST, rest)):
            rows.append(_row(shapes, kind, row_kind, label, _ABOUT[row_kind], terms, common))
    return rows


def _term(plan: ShearPlan, shapes: _Shapes, kind: str, name: str) -> tuple[dict[str, float], int]:
    """Return ({Setting: factor}, windows) of an effect's bar, of BASE, or of ALL less BASE."""
    if name == BASE:
        factors = {BASE: 1.0}
    else:
        setting = setting_of(plan, name)
        against = setting_of(plan, BASE if name == ALL else plan.effects[name].against)
        factors = {BASE: 0.0} if setting == against else {setting: 1.0, against: -1.0}
    return factors, shapes.windows(name, factors, kind)


_ABOUT = {
    "sum": "sum of the bars that are marked +",
    "all": "all of these effects at once",
    "rest": "all at once less the sum",
}


def _row(
    shapes: _Shapes,
    kind: str,
    row_kind: str,
    label: str,
    about: str,
    terms: Sequence[tuple[dict[str, float], int]],
    common: bool = False,
) -> dict[str, Any]:
    common = common and min(windows for _, windows in terms) >= WINDOWS
    parts = []
    galaxies = []
    for factors, windows in terms:
        arms = {name: shapes.arms(name, kind, windows) for name in factors}
        frame = shapes.frame(common, windows)
        every = np.all([of.finite for of in arms.values()], axis=0)
        parts.append(({name: sums(of, frame, every & of.used) for name, of in arms.items()}, factors))
        galaxies.append(int(every.sum()))
    value, error = combined(parts, shapes.plan.shear)
    row = {
        "estimator": kind,
        "effect": label,
        "kind": row_kind,
        "about": about,
        "windows": min(windows for _, windows in terms),
        "galaxies": min(galaxies),
        "seconds": sum(shapes.seconds(*term) for term in terms),
    }
    row |= {name: float(v) for name, v in zip(NAMES, value, strict=True)}
    row |= {f"{name}_err": float(v) for name, v in zip(NAMES, error, strict=True)}
    one, two = shapes.scatters(next(iter(terms[0][0])), kind) if row_kind in ("base", "bar") else (np.nan, np.nan)
    return row | {"scatter": one, "scatter_two": two, "gain": two / one if one > 0 else np.nan}
