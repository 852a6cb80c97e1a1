"""Light curves: how much fainter an object is in an exposure than its catalogue says.

A change is a sine (columns var_period, var_amplitude, var_phase), a named curve of a file, or both. The curves' file is
a table (.csv, .ecsv, .fits or .parquet) with a row for each point: `curve` (name), `mjd` (UTC), `dmag` [mag, positive:
fainter]. Columns dmag_<band> hold for that band or grating instead of `dmag`. Between points a curve is linear in
magnitude; before the first point and after the last one it keeps their value. Light is averaged over the exposure.
"""

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.units import DAY_S

_AT, _WEIGHT = np.polynomial.legendre.leggauss(5)  # over the exposure
_LARGEST = 1e3  # mag


def dimming(table, rows, interval, filter, curves=None):
    """Return (len(rows),) mag by which rows of a table are fainter in an exposure; None if none of them may change.

    interval: catalog.changing.motion.Interval; curves: LightCurves, or None.
    """
    sines, named = "var_amplitude" in table, curves is not None and "light_curve" in table
    if not (sines or named):
        return None
    change = np.zeros(len(rows))
    moving = np.zeros(len(rows), bool)
    if sines:
        moving |= table["var_amplitude"][rows] != 0
    if named:
        moving |= table["light_curve"][rows] != ""
    some = np.flatnonzero(moving)
    if not len(some):
        return change
    at = interval.start + interval.exptime * (0.5 + 0.5 * _AT) / DAY_S
    mags = np.zeros((len(some), len(at)))
    if sines:
        period, size, phase = (_of(table, name, rows[some]) for name in ("var_period", "var_amplitude", "var_phase"))
        lit = size != 0
        turns = at / np.where(lit, period, 1.0)[:, None] + phase[:, None]
        mags += np.where(lit, size, 0.0)[:, None] * np.sin(2 * np.pi * (turns % 1.0))
    if named:
        names = table["light_curve"][rows[some]]
        for name in np.unique(names[names != ""]):
            mags[names == name] += curves.at(name, at, filter.name)
    change[some] = mean_mag(mags, 0.5 * _WEIGHT)
    return change


def mean_mag(mags, weights):
    """Return (n,) the magnitudes of the mean light of magnitudes (n, m) with weights (m,) whose sum is 1."""
    best = mags.min(axis=1, keepdims=True)
    return best[:, 0] - 2.5 * np.log10((10 ** (-0.4 * (mags - best)) * weights).sum(axis=1))


def _of(table, name, rows):
    return table[name][rows].astype(float) if name in table else np.zeros(len(rows))


class LightCurves:
    """The curves of a table {name: (n,) values}; `where` names it in errors.

    bands: names of the camera's bands and gratings, or None: any. Raises InputError.
    """

    def __init__(self, columns, where, bands=None):
        for name in ("curve", "mjd"):
            if name not in columns:
                raise InputError("a column is missing", file=where, key=name, allowed="curve, mjd, dmag or dmag_<band>")
        self.where, self._kinds = where, [n for n in columns if n == "dmag" or n.startswith("dmag_")]
        if not self._kinds:
            raise InputError("a column is missing", file=where, key="dmag", allowed="dmag, dmag_<band>")
        self._check_kinds(bands)
        mjd = _numbers(columns, "mjd", where)
        values = {kind: _numbers(columns, kind, where) for kind in self._kinds}
        order = np.lexsort((mjd, np.asarray(columns["curve"]).astype(str)))
        names = np.asarray(columns["curve"]).astype(str)[order]
        if not len(names):
            raise InputError("the table of light curves has no rows", file=where)
        starts = np.flatnonzero(np.r_[True, names[1:] != names[:-1]])
        self._curves = {}
        for first, last in zip(starts, [*starts[1:], len(names)], strict=True):
            part = order[first:last]
            if (np.diff(mjd[part]) <= 0).any():
                raise InputError(f"curve {names[first]} has a time twice", file=where, key="mjd")
            self._curves[str(names[first])] = mjd[part], {kind: values[kind][part] for kind in self._kinds}

    def _check_kinds(self, bands):
        """Raise InputError for columns dmag_<band> of one band twice, or of a band that the camera does not have."""
        lower = [kind.lower() for kind in self._kinds]
        twice = next((kind for kind in self._kinds if lower.count(kind.lower()) > 1), None)
        if twice:
            raise InputError("two columns for one band", file=self.where, key=twice, value=", ".join(self._kinds))
        known = ["dmag", *(f"dmag_{band.lower()}" for band in bands or ())]
        unknown = [] if bands is None else [kind for kind in self._kinds if kind.lower() not in known]
        if unknown:
            raise InputError("of no band of the camera", file=self.where, key=unknown[0], allowed=", ".join(known))

    def check(self, names):
        """Raise InputError for the first of `names` (n,) that is no curve; "" stands for no curve."""
        unknown = sorted({str(name) for name in names} - {""} - set(self._curves))
        if unknown:
            some = ", ".join(sorted(self._curves)[:5])
            raise InputError("no such curve", file=self.where, key="light_curve", value=unknown[0], allowed=some)

    def at(self, name, mjd, band):
        """Return the change [mag] of a curve at times (m,) in a band or grating. Raises InputError if it has none."""
        times, values = self._curves[str(name)]
        kind = next((k for k in self._kinds if k.lower() == f"dmag_{band.lower()}"), "dmag")
        if kind not in values:
            raise InputError(
                f"the curves have no column for {band}", file=self.where, key=f"dmag_{band.lower()}",
                allowed="dmag for all other bands",
            )  # fmt: skip
        return np.interp(mjd, times, values[kind])


def _numbers(columns, name, where):
    try:
        values = np.asarray(columns[name], dtype=float)
    except (TypeError, ValueError):
        raise InputError("must be numbers", file=where, key=name) from None
    bad = ~np.isfinite(values) | ((np.abs(values) > _LARGEST) & (name != "mjd"))
    if bad.any():
        raise InputError(
            f"row {np.flatnonzero(bad)[0] + 1} is blank, not finite or above 1000 mag", file=where, key=name
        )
    return values
