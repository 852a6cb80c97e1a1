"""Light curves: how much fainter an object is in an exposure than its catalogue says.

A change is a sine (columns var_period, var_amplitude, var_phase), a named curve of a file, or both. The curves' file is
a table (.csv, .ecsv, .fits or .parquet) with a row for each point: `curve` (name), `mjd` (UTC), `dmag` [mag, positive:
fainter]. Columns dmag_<band> hold for that band or grating instead of `dmag`. Between points a curve is linear in
magnitude; before the first point and after the last one it keeps their value. Flux is averaged over the exposure.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.units import DAY_S

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from csstsim.base.types import AnyArray, FloatArray, IntArray, PathLike
    from csstsim.catalog.changing.motion import Interval
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.filter import Filter

_AT, _WEIGHT = np.polynomial.legendre.leggauss(5)  # over the exposure, or over each panel of it
# mag: the limit of var_amplitude, and an object that vanishes
_BRIGHTEST = -30.0
_FAINTEST = 1e3
_LAST = 1e6  # MJD: a Julian date is above
_LN_MAG = 0.4 * np.log(10.0)
_PANELS = 8  # of a period; within one, five points give the mean flux to 1e-7
_CYCLES = 200.0  # in an exposure: with more, the mean of whole cycles is used, right to 1e-3 of the amplitude


def dimming(
    table: ObjectTable, rows: IntArray, interval: Interval, filter: Filter, curves: LightCurves | None = None
) -> FloatArray | None:
    """Return (len(rows),) mag by which rows of a table are fainter in an exposure; None if the table has no changes.

    interval: catalog.changing.motion.Interval; curves: LightCurves, or None.
    """
    has_sines = "var_amplitude" in table
    has_curves = curves is not None and "light_curve" in table
    if not (has_sines or has_curves):
        return None
    change = np.zeros(len(rows))
    amplitude = np.zeros(len(rows))
    curve_names = np.full(len(rows), "")
    if has_sines:
        amplitude = table["var_amplitude"][rows].astype(float)
    if has_curves:
        curve_names = table["light_curve"][rows].astype(str)
    variable = np.flatnonzero((amplitude != 0) | (curve_names != ""))
    if not len(variable):
        return change
    amplitude = amplitude[variable]
    curve_names = curve_names[variable]
    period, phase = (_column(table, column, rows[variable]) for column in ("var_period", "var_phase"))
    sines = _Sines(np.where(amplitude != 0, period, np.inf), amplitude, phase)
    mags = np.zeros(len(variable))
    used = np.unique(curve_names)
    breaks = {curve: curves.breaks(curve, interval, filter.name) for curve in used if curve and curves}
    cycles = interval.exptime / DAY_S / sines.period
    fast = (cycles * _PANELS > 1) | [len(breaks.get(curve, "")) > 0 for curve in curve_names]
    for curve in used:
        slow = np.flatnonzero((curve_names == curve) & ~fast)
        mags[slow] = _mean(sines.take(slow), curve, curves, filter, _panels(interval, np.zeros(0), 1))
    for row in np.flatnonzero(fast):
        sine = sines.take([row])
        curve = curve_names[row]
        if cycles[row] > _CYCLES:
            mags[row], sine = sine.mean()[0], sine.constant()
        count = int(np.ceil(_PANELS * interval.exptime / DAY_S / sine.period[0] * np.sqrt(1 + abs(sine.amplitude[0]))))
        panels = _panels(interval, breaks.get(curve, np.zeros(0)), max(count, 1))
        mags[row] += _mean(sine, curve, curves, filter, panels)[0]
    change[variable] = mags
    return change


class _Sines(NamedTuple):
    """Periodic changes: period [day], amplitude [mag] and phase [turns] at MJD 0, (n,) each."""

    period: FloatArray
    amplitude: FloatArray
    phase: FloatArray

    def take(self, rows: IntArray | list[np.intp]) -> _Sines:
        return _Sines(self.period[rows], self.amplitude[rows], self.phase[rows])

    def constant(self) -> _Sines:
        return _Sines(np.full_like(self.period, np.inf), np.zeros_like(self.amplitude), self.phase)

    def at(self, mjd: FloatArray) -> FloatArray:
        """Return (n, len(mjd)) mag."""
        turns = mjd / self.period[:, None] + self.phase[:, None]
        return self.amplitude[:, None] * np.sin(2 * np.pi * (turns % 1.0))

    def mean(self) -> FloatArray:
        """Return (n,) the magnitude of the mean flux of whole cycles: that of I0(0.4 ln 10 A), a Bessel function."""
        from scipy.special import ive

        x = _LN_MAG * np.abs(self.amplitude)
        return -(np.log(ive(0, x)) + x) / _LN_MAG


def _panels(interval: Interval, breaks: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return (times [MJD], weights) of Gauss' rule in `count` panels of an exposure, divided also at breaks [MJD]."""
    within = (breaks - interval.start) * DAY_S / interval.exptime
    edges = np.unique(np.concatenate([np.linspace(0.0, 1.0, count + 1), within]))
    width = np.diff(edges)[:, None]
    at = edges[:-1, None] + width * (0.5 + 0.5 * _AT)
    return interval.start + interval.exptime * at.ravel() / DAY_S, (0.5 * width * _WEIGHT).ravel()


def _mean(
    sines: _Sines, curve: str, curves: LightCurves | None, filter: Filter, panels: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return (n,) the magnitudes of the mean flux of sines, and of one curve with them ("": none)."""
    times, weights = panels
    return mean_mag(sines.at(times) + (curves.at(curve, times, filter.name) if curve and curves else 0.0), weights)


def mean_mag(mags: FloatArray, weights: FloatArray) -> FloatArray:
    """Return (n,) the magnitudes of the mean flux of magnitudes (n, m) with weights (m,) whose sum is 1."""
    best = mags.min(axis=1, keepdims=True)
    return best[:, 0] - 2.5 * np.log10((10 ** (-0.4 * (mags - best)) * weights).sum(axis=1))


def _column(table: ObjectTable, name: str, rows: IntArray) -> FloatArray:
    return table[name][rows].astype(float) if name in table else np.zeros(len(rows))


class LightCurves:
    """The curves of a table {name: (n,) values}; `where` names it in errors.

    bands: names of the camera's bands and gratings, or None: any. Raises InputError.
    """

    def __init__(self, columns: Mapping[str, AnyArray], where: PathLike, bands: Collection[str] | None = None) -> None:
        for name in ("curve", "mjd"):
            if name not in columns:
                raise InputError("a column is missing", file=where, key=name, allowed="curve, mjd, dmag or dmag_<band>")
        self.where = where
        self._kinds = [n for n in columns if n == "dmag" or n.startswith("dmag_")]
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

    def _check_kinds(self, bands: Collection[str] | None) -> None:
        """Raise InputError for columns dmag_<band> of one band twice, or of a band that the camera does not have."""
        lower = [kind.lower() for kind in self._kinds]
        twice = next((kind for kind in self._kinds if lower.count(kind.lower()) > 1), None)
        if twice:
            raise InputError("two columns for one band", file=self.where, key=twice, value=", ".join(self._kinds))
        known = ["dmag", *(f"dmag_{band.lower()}" for band in bands or ())]
        unknown = [] if bands is None else [kind for kind in self._kinds if kind.lower() not in known]
        if unknown:
            raise InputError("of no band of the camera", file=self.where, key=unknown[0], allowed=", ".join(known))

    def check(self, names: AnyArray) -> None:
        """Raise InputError for the first of `names` (n,) that is not a curve; "" means no curve."""
        unknown = sorted({str(name) for name in names} - {""} - set(self._curves))
        if unknown:
            examples = ", ".join(sorted(self._curves)[:5])
            raise InputError("no such curve", file=self.where, key="light_curve", value=unknown[0], allowed=examples)

    def at(self, name: str, mjd: FloatArray, band: str) -> FloatArray:
        """Return the change [mag] of a curve at times (m,) in a band or grating. Raises InputError if it has none."""
        return np.interp(mjd, *self._curve(name, band))

    def breaks(self, name: str, interval: Interval, band: str) -> FloatArray:
        """Return the MJD within an exposure between which a curve is linear and changes by at most a magnitude."""
        times, mags = self._curve(name, band)
        ends = np.array([interval.start, interval.start + interval.exptime / DAY_S])
        knots = np.unique([*ends, *times[(times > ends[0]) & (times < ends[1])]])
        steps = np.ceil(np.abs(np.diff(np.interp(knots, times, mags)))).astype(int).clip(1)
        cuts = [np.linspace(a, b, n + 1)[:-1] for (a, b), n in zip(pairwise(knots), steps, strict=True)]
        return np.concatenate(cuts)[1:]

    def _curve(self, name: str, band: str) -> tuple[FloatArray, FloatArray]:
        """Return (times [MJD], changes [mag]) of a curve in a band or grating. Raises InputError if it has none."""
        times, values = self._curves[str(name)]
        kind = next((k for k in self._kinds if k.lower() == f"dmag_{band.lower()}"), "dmag")
        if kind not in values:
            raise InputError(
                f"the curves have no column for {band}",
                file=self.where,
                key=f"dmag_{band.lower()}",
                allowed="dmag for all other bands",
            )
        return times, values[kind]


def _numbers(columns: Mapping[str, AnyArray], name: str, where: PathLike) -> FloatArray:
    try:
        values = np.asarray(columns[name], dtype=float)
    except (TypeError, ValueError):
        raise InputError("must be numbers", file=where, key=name) from None
    low, high = (0.0, _LAST) if name == "mjd" else (_BRIGHTEST, _FAINTEST)
    with np.errstate(invalid="ignore"):
        bad = ~((values >= low) & (values <= high))
    if bad.any():
        row = np.flatnonzero(bad)[0]
        raise InputError(
            "blank, not finite or out of range",
            file=where,
            key=f"{name}, row {row + 1}",
            value=float(values[row]),
            allowed=f"{low:g} to {high:g}",
        )
    return values
