"""The bars of the budget: the bias of each effect from the shapes of all fields, the sum of the bars, their cost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.studies.budget.shear.plan import ALL, BASE
from csstsim.studies.budget.shear.response import NAMES, Arms, SharedColumns, Term, combined, scatter, sums
from csstsim.studies.budget.shear.run import setting_of

if TYPE_CHECKING:
    from csstsim.studies.budget.shear.plan import ShearPlan

SUM = "sum of the bars"
REMAINDER = "all at once less the sum"
WINDOWS_MIN = 8  # for a jackknife over windows; with fewer, errors that are common to a window are not included
KINDS = "base", "bar", "sum", "all", "rest"


def bars(plan: ShearPlan, paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Return [row] of one sample: its base, its bars, their sum, the run with all effects, and their difference.

    A row has estimator, effect, kind (KINDS), about, each of NAMES with NAME_err, windows and galaxies (of a sum: those
    of the bar with the fewest), seconds (CPU, of a galaxy: both Settings of a bar), scatter and scatter_two (of half
    the difference of the arms, with one seed and with two), gain. paths: of all windows, or of the first ones.
    """
    if not paths:
        return []
    shapes = _Shapes(plan, paths)
    return [row for kind in plan.estimators for row in _rows(plan, shapes, kind)]


class _Settings(NamedTuple):
    """A linear combination of Settings: {Setting: factor}, and the number of first windows that have them."""

    factors: dict[str, float]
    windows: int

    def negative(self) -> _Settings:
        """Return the combination with opposite factors."""
        return self._replace(factors={setting: -factor for setting, factor in self.factors.items()})


class _Scatter(NamedTuple):
    """The scatter of half the difference of the arms, with one seed for both arms and with two."""

    one_seed: float
    two_seeds: float


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
        """Return the number of first windows in which an estimator has all Settings of an effect's bar, BASE or ALL."""
        keys = [f"{setting}|{kind}|e" for setting in settings]
        has_all = [all(key in field for key in keys) for field in self.fields[: self.plan.windows(name)]]
        return has_all.index(False) if False in has_all else len(has_all)

    def arms(self, name: str, kind: str, windows: int) -> Arms:
        """Return the Arms of a Setting and an estimator, in the first windows."""
        fields = self.fields[:windows]
        e = np.concatenate([field[f"{name}|{kind}|e"] for field in fields], axis=1)
        response = np.concatenate([field[f"{name}|{kind}|response"] for field in fields], axis=1)
        used = np.concatenate([field[f"{name}|used"] for field in fields], axis=1)
        return Arms(e, response, used)

    def seconds(self, settings: Iterable[str], windows: int) -> float:
        """Return CPU seconds per galaxy in these Settings."""
        fields = self.fields[:windows]
        total = sum(float(field[f"{name}|seconds"]) for name in settings for field in fields)
        return total / sum(len(field["ring"]) for field in fields)

    def shared_columns(self, common: bool, windows: int) -> SharedColumns:
        """Return the response.SharedColumns of the first windows; blocks are windows if common, else rings."""
        rows = slice(np.count_nonzero(self.window < windows))
        block = self.window if common else self.ring
        return SharedColumns(self.sign[rows], self.psf[rows], block[rows])

    def scatters(self, name: str, kind: str) -> _Scatter:
        """Return the _Scatter of field 0."""
        first, *_ = self.fields
        plus, minus = first[f"{name}|{kind}|e"]
        return _Scatter(scatter(plus, minus), scatter(plus, first[f"{name}|{kind}|other"]))


def _rows(plan: ShearPlan, shapes: _Shapes, kind: str) -> list[dict[str, Any]]:
    term = partial(_term, plan, shapes, kind)
    rows = [_row(shapes, kind, "base", BASE, "all that follows left out", [term(BASE)])]
    for name in plan.bars:
        effect = plan.effects[name]
        rows.append(_row(shapes, kind, "bar", name, effect.about, [term(name)], effect.common))
    if plan.summed:
        common = any(plan.effects[name].common for name in plan.summed)
        added = [term(name) for name in plan.summed]
        all_terms = [term(ALL)]
        remainder = all_terms + [of_bar.negative() for of_bar in added]
        for row_kind, label, terms in (("sum", SUM, added), ("all", ALL, all_terms), ("rest", REMAINDER, remainder)):
            rows.append(_row(shapes, kind, row_kind, label, _DESCRIPTIONS[row_kind], terms, common))
    return rows


def _term(plan: ShearPlan, shapes: _Shapes, kind: str, name: str) -> _Settings:
    """Return the _Settings of an effect's bar, of BASE, or of ALL less BASE."""
    if name == BASE:
        factors = {BASE: 1.0}
    else:
        setting = setting_of(plan, name)
        against = setting_of(plan, BASE if name == ALL else plan.effects[name].against)
        factors = {BASE: 0.0} if setting == against else {setting: 1.0, against: -1.0}
    return _Settings(factors, shapes.windows(name, factors, kind))


_DESCRIPTIONS = {
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
    terms: Sequence[_Settings],
    common: bool = False,
) -> dict[str, Any]:
    windows = min(term.windows for term in terms)
    common = common and windows >= WINDOWS_MIN
    parts = []
    galaxies = []
    for term in terms:
        arms = {name: shapes.arms(name, kind, term.windows) for name in term.factors}
        shared = shapes.shared_columns(common, term.windows)
        finite = np.all([both.finite for both in arms.values()], axis=0)
        blocks = {name: sums(both, shared, finite & both.used) for name, both in arms.items()}
        parts.append(Term(blocks, term.factors))
        galaxies.append(int(finite.sum()))
    value, error = combined(parts, shapes.plan.shear)
    row = {
        "estimator": kind,
        "effect": label,
        "kind": row_kind,
        "about": about,
        "windows": windows,
        "galaxies": min(galaxies),
        "seconds": sum(shapes.seconds(term.factors, term.windows) for term in terms),
    }
    row |= {name: float(number) for name, number in zip(NAMES, value, strict=True)}
    row |= {f"{name}_err": float(number) for name, number in zip(NAMES, error, strict=True)}
    arm_scatter = _Scatter(np.nan, np.nan)
    if row_kind in ("base", "bar"):
        [term] = terms
        arm_scatter = shapes.scatters(next(iter(term.factors)), kind)
    gain = arm_scatter.two_seeds / arm_scatter.one_seed if arm_scatter.one_seed > 0 else np.nan
    return row | {"scatter": arm_scatter.one_seed, "scatter_two": arm_scatter.two_seeds, "gain": gain}
