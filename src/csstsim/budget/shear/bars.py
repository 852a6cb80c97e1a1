"""The bars of the budget: what the shapes of all fields say of each effect, the sum of the bars, and their cost."""

import numpy as np

from csstsim.budget.shear.plan import ALL, BASE
from csstsim.budget.shear.response import NAMES, Arms, Frame, combined, scatter, sums
from csstsim.budget.shear.run import names, setting_of

SUM, REST = "sum of the bars", "all at once less the sum"
WINDOWS = 8  # fewest for a jackknife over windows; with fewer, errors that are common to a window are left out
KINDS = "base", "bar", "sum", "all", "rest"


def bars(plan, paths):
    """Return [row] of one sample: its base, its bars, their sum, the run with all effects, and what they differ by.

    A row: estimator, effect, kind (KINDS), about, each of NAMES with NAME_err, galaxies, seconds (CPU, of a galaxy:
    both Settings of a bar), scatter and scatter_two (half the difference of the arms, one seed and two), gain.
    """
    if not paths:
        return []
    shapes = _Shapes(plan, paths)
    return [row for kind in plan.estimators for row in _rows(plan, shapes, kind)]


class _Shapes:
    """The shapes of all fields, joined."""

    def __init__(self, plan, paths):
        self.plan = plan
        self.fields = [dict(np.load(path)) for path in paths]
        rings = np.cumsum([0] + [len(np.unique(field["ring"])) for field in self.fields])
        self.ring = np.concatenate([start + field["ring"] for start, field in zip(rings, self.fields, strict=False)])
        self.window = np.repeat(np.arange(len(self.fields)), [len(field["ring"]) for field in self.fields])
        self.sign = np.concatenate([np.full(len(field["ring"]), field["sign"]) for field in self.fields])
        self.psf = np.concatenate([field["psf"] for field in self.fields])

    def arms(self, name, kind):
        """Return the Arms of a Setting and an estimator."""
        e, response = (
            np.concatenate([field[f"{name}|{kind}|{key}"] for field in self.fields], axis=1)
            for key in ("e", "response")
        )
        return Arms(e, response, np.concatenate([field[f"{name}|used"] for field in self.fields], axis=1))

    def seconds(self, *settings):
        """Return CPU seconds of a galaxy in these Settings."""
        return sum(float(field[f"{name}|seconds"]) for name in settings for field in self.fields) / len(self.ring)

    def frame(self, common):
        """Return the response.Frame, in blocks of rings, or of windows if errors are common to each of many windows."""
        windows = common and len(self.fields) >= WINDOWS
        return Frame(self.plan.shear, self.sign, self.psf, self.window if windows else self.ring)

    def scatters(self, name, kind):
        """Return the scatter of half the difference of the arms of field 0, with one seed and with two."""
        first = self.fields[0]
        e = first[f"{name}|{kind}|e"]
        return scatter(*e), scatter(e[0], first[f"{name}|{kind}|other"])


def _rows(plan, shapes, kind):
    arms = {name: shapes.arms(name, kind) for name in names(plan)}
    rows = [_row(plan, shapes, kind, arms, "base", BASE, {BASE: 1.0}, "all that follows left out")]
    for name in plan.bars:
        effect = plan.effects[name]
        factors = _difference(plan, [name])
        rows.append(_row(plan, shapes, kind, arms, "bar", name, factors, effect.about, effect.common))
    if plan.summed:
        common = any(plan.effects[name].common for name in plan.summed)
        added = _difference(plan, plan.summed)
        whole = {ALL: 1.0, BASE: -1.0}
        rest = {name: whole.get(name, 0.0) - added.get(name, 0.0) for name in {**added, **whole}}
        for row_kind, label, factors in (("sum", SUM, added), ("all", ALL, whole), ("rest", REST, rest)):
            rows.append(_row(plan, shapes, kind, arms, row_kind, label, factors, _ABOUT[row_kind], common))
    return rows


def _difference(plan, effects):
    """Return {Setting: factor}, whose combination is the sum of the effects' bars."""
    factors = {}
    for name in effects:
        for effect, factor in ((name, 1.0), (plan.effects[name].against, -1.0)):
            setting = setting_of(plan, effect)
            factors[setting] = factors.get(setting, 0.0) + factor
    return factors


_ABOUT = {
    "sum": "sum of the bars that are marked +", "all": "all of these effects at once",
    "rest": "all at once less the sum",
}  # fmt: skip


def _row(plan, shapes, kind, arms, row_kind, label, factors, about, common=False):
    factors = {name: factor for name, factor in factors.items() if factor} or {BASE: 0.0}
    frame = shapes.frame(common)
    every = np.all([arms[name].finite for name in factors], axis=0)
    blocks = {name: sums(arms[name], frame, every & arms[name].used) for name in factors}
    value, error = combined(blocks, factors, plan.shear)
    row = {
        "estimator": kind, "effect": label, "kind": row_kind, "about": about, "galaxies": int(every.sum()),
        "seconds": shapes.seconds(*factors),
    }  # fmt: skip
    row |= {name: float(v) for name, v in zip(NAMES, value, strict=True)}
    row |= {f"{name}_err": float(v) for name, v in zip(NAMES, error, strict=True)}
    one, two = shapes.scatters(next(iter(factors)), kind) if row_kind in ("base", "bar") else (np.nan, np.nan)
    return row | {"scatter": one, "scatter_two": two, "gain": two / one if one > 0 else np.nan}
