"""Fluxes of emission lines in extracted spectra: at known redshifts, and of lines that stand out by themselves.

The electrons e(X) within SIDE columns of a line, with their errors, are fitted by

    e(X) = sum_j F_j A t T(lambda_j) L_j(X) + S(X) (c_0 + c_1 u + c_2 u^2),        u = (X - X_0) / SIDE

j are the line and all others that reach there, F the fluxes in photons, A the aperture, t the time, T the order's
throughput, L_j the share of the line's light that the extraction puts into a column (measure.spectra.line_image: the
two-dimensional image of PSF and galaxy, with the pixels' weights), and S the sensitivity. Only F of the line itself is
kept, so lines that overlap share their errors. The errors of the columns are those of the extraction. A second fit has
k dL/dX of the line, too: its place is -k / F off that of its wavelength. `flux_true` is the fit of all electrons of
each column (`model`), with the profile P_j along the trace (measure.spectra.line_profile) in place of L_j.

Without a redshift, the spectrum less its running median is compared with P at every column. The MOST highest points of
a significance of at least FOUND are lines; where the spectrum is uneven, significance is in units of its own scatter.
Left out: lines wider than the object's image, such as quasars'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.base.units import C_A_S, H_J_S
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.line_columns import BLENDED, BLIND, COLUMNS, LINES, PART
from csstsim.measure.spectra.line_profile import OFFSETS, mixed
from csstsim.measure.spectra.spectral_model import ONE_REACH
from csstsim.measure.spectra.spectrum_columns import BESIDE, COSMIC, CUT, DIM, LOST, SATURATED

if TYPE_CHECKING:
    from csstsim.measure.spectra.column_sums import Weights
    from csstsim.measure.spectra.line_image import LineImage
    from csstsim.measure.spectra.spectral_model import SpectralModel

SIDE = 30.0  # columns beyond twice a line's full width, for the continuum
DETECTED = 3.0  # S/N
# significance of lines found without a redshift, and their number in a spectrum
FOUND = 5.0
MOST = 3
APART = 1.5  # full widths at half maximum: lines nearer than that are blended
SPURIOUS = SATURATED | COSMIC | LOST | CUT | BESIDE  # what looks like a line on such columns is none
MEDIAN = 41  # columns of the running median
# share of a line's light in usable columns: below WHOLE it is flagged, below LEAST left out
WHOLE = 0.8
LEAST = 0.5
TINY = 1e-12  # of the largest eigenvalue of a fit: a combination with less is not fitted
ERG_PER_CM2 = 1e3  # J / m2 in erg / cm2


@dataclass(frozen=True, eq=False)
class Line:
    """A line in a spectrum: `places` of its parts [px], mean `wavelength` [angstrom], `seen` and `light` (n,): the
    electrons of 1 photon / s / m2 as extracted, and all of them, `width` of a part [px], full at half maximum.
    """

    name: str
    places: FloatArray
    wavelength: float
    seen: FloatArray
    light: FloatArray
    width: float
    flags: int = 0

    def near(self, columns: FloatArray) -> BoolArray:
        """Return bool (n,): columns within APART widths of a part."""
        return np.any(np.abs(np.subtract.outer(columns, self.places)) < APART * self.width, axis=-1)


class LineFluxes:
    """Measures the lines of one spectrum after another (`add`), and returns them as a table (`table`)."""

    def __init__(self, redshift: FloatArray) -> None:
        """redshift (rows,): of the objects by row of the truth table; NaN: not known."""
        self.redshift = redshift
        self._found: list[dict[str, Any]] = []

    def add(
        self,
        one: ObjectTable,
        found: Mapping[str, AnyArray],
        along: FloatArray,
        model: SpectralModel,
        image: LineImage,
        weights: Weights,
    ) -> None:
        """Measure the lines of a spectrum.

        one: its row of the orders' table; found: {name: (n,)} of spectrum_columns.COLUMNS; along: profile (4, n) ALONG
        the trace; model: spectral_model.SpectralModel; image: the object's line_image.LineImage; weights:
        column_sums.Weights of its electrons.
        """
        spectrum = _Spectrum(one, found, along, model, image, weights)
        lines = spectrum.known(self.redshift[int(one["row"][0])])
        lines += spectrum.search(lines)
        for line in lines:
            values = spectrum.measured(line, lines)
            if values is not None and not (line.flags & BLIND and values["snr"] < FOUND):
                self._found.append({name: one[name][0] for name in ("id", "row", "order")} | values)

    def table(self) -> ObjectTable:
        """Return the ObjectTable of line_columns.COLUMNS."""
        return ObjectTable(
            {name: np.array([line[name] for line in self._found], dtype) for name, (dtype, _) in COLUMNS.items()}
        )


class _Spectrum:
    def __init__(
        self,
        one: ObjectTable,
        found: Mapping[str, AnyArray],
        along: FloatArray,
        model: SpectralModel,
        image: LineImage,
        weights: Weights,
    ) -> None:
        self.found = found
        self.along = along
        self.model = model
        self.image = image
        self.weights = weights
        self.column = found["column"].astype(float)
        self.error = found["electrons_err"].astype(float)
        self.good = (found["flags"] & (LOST | DIM) == 0) & np.isfinite(found["electrons"]) & (self.error > 0)
        self.start = float(one["x"][0] + one["p"][0])
        self.per = float(one["q"][0])
        self.sensitivity = found["sensitivity"].astype(float)
        self.passed = model.photons * np.gradient(model.cumulative[model.pair(one)], GRID)

    def known(self, redshift: float) -> list[Line]:
        """Return the Lines of LINES that lie in the spectrum at a redshift; none if it is NaN or not above 0."""
        if not redshift > 0:
            return []
        lines = [self._line(name, [(w * (1 + redshift), s) for w, s in parts]) for name, parts in LINES.items()]
        return [line for line in lines if line is not None]

    def _line(self, name: str, parts: Sequence[tuple[float, float]], flags: int = 0) -> Line | None:
        """Return the Line of parts (wavelength, share); None unless all lie on usable columns."""
        places = np.array([self.start + self.per * w for w, _ in parts])
        seen, light = np.zeros((2, len(self.column)))
        at = np.rint(places - self.column[0]).astype(int)
        if not ((at >= 0) & (at < len(self.column))).all() or not self.good[at].all():
            return None
        for place, (wavelength, share) in zip(places, parts, strict=True):
            through = share * np.interp(wavelength, GRID, self.passed)
            seen += through * self._seen(place, wavelength)
            light += through * self._shares(place, wavelength)
        wavelength = sum(w * s for w, s in parts)
        return Line(name, places, wavelength, seen, light, self._width(wavelength), flags)

    def _profile(self, wavelength: float) -> FloatArray:
        """Return the share of a line's light below OFFSETS, as SpectralModel.electrons: all of it within ONE_REACH."""
        band, share = mixed(wavelength, self.model.bands)
        profile = (1 - share) * self.along[band] + share * self.along[band + 1]
        ends = np.interp([-ONE_REACH - 0.5, ONE_REACH + 0.5], OFFSETS, profile)
        return np.clip((profile - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)

    def _shares(self, column: float, wavelength: float) -> FloatArray:
        """Return (n,): the share of a line's light in each column."""
        profile = self._profile(wavelength)
        offset = self.column - column
        return np.interp(offset + 0.5, OFFSETS, profile) - np.interp(offset - 0.5, OFFSETS, profile)

    def _seen(self, column: float, wavelength: float) -> FloatArray:
        """Return (n,): the share of a line's light that is extracted in each column."""
        here = float(np.interp(column, self.column, self.found["y"]))
        rows = self.weights.offset[0] + self.found["y"][0] - here
        return self.image.seen(wavelength, self.column - column, rows, self.weights.each)

    def _width(self, wavelength: float) -> float:
        steps = np.diff(self._profile(wavelength))
        return float(np.count_nonzero(steps > steps.max() / 2) * (OFFSETS[1] - OFFSETS[0]))

    def search(self, lines: Sequence[Line]) -> list[Line]:
        """Return Lines that are not among `lines`: the MOST highest points above the continuum."""
        found: list[Line] = []
        usable = np.flatnonzero(self.good)
        if len(usable) < MEDIAN:
            return []
        signal = self._significance(usable)
        signal[: usable[0] + MEDIAN // 2] = signal[usable[-1] - MEDIAN // 2 + 1 :] = 0.0  # no continuum on either side
        for known in lines:
            signal[known.near(self.column)] = 0.0
        while len(found) < MOST:
            k = int(np.argmax(signal))
            if not signal[k] >= FOUND:
                break
            line = self._line("", [((self._peak(signal, k) - self.start) / self.per, 1.0)], BLIND)
            if line is not None and not self._flags(line) & SPURIOUS:
                found.append(line)
            signal[max(k - MEDIAN // 2, 0) : k + MEDIAN // 2 + 1] = 0.0
        return found

    def _flags(self, line: Line) -> int:
        """Return the bits of the columns of a line's own light, with its own."""
        light = line.light > 0.05 * line.light.max()
        return int(np.bitwise_or.reduce(self.found["flags"][light].astype(int), initial=line.flags))

    def _significance(self, usable: IntArray) -> FloatArray:
        """Return (n,): S/N of a line on each column above the running median; 0 where columns cannot be used."""
        sensitivity = np.maximum(self.found["sensitivity"], 1e-30)
        shape = np.interp(self.column, self.column[usable], (self.found["electrons"] / sensitivity)[usable])
        around = np.lib.stride_tricks.sliding_window_view(np.pad(shape, MEDIAN // 2, mode="reflect"), MEDIAN)
        median = np.partition(around, MEDIAN // 2, axis=1)[:, MEDIAN // 2]
        above = np.where(self.good, (shape - median) * sensitivity, 0.0)
        weight = np.where(self.good, 1 / np.where(self.good, self.error, 1.0) ** 2, 0.0)
        middle = self.found["wavelength"][usable[len(usable) // 2]]
        offset = np.arange(-(MEDIAN // 2), MEDIAN // 2 + 1)
        profile = self._profile(middle)
        shares = np.interp(offset + 0.5, OFFSETS, profile) - np.interp(offset - 0.5, OFFSETS, profile)
        norm = np.sqrt(np.convolve(weight, shares[::-1] ** 2, "same"))
        out = np.convolve(above * weight, shares[::-1], "same") / np.where(norm > 0, norm, np.inf)
        spread = robust_sigma(out[usable])
        return np.where(self.good, out / max(spread, 1.0), 0.0)

    def _peak(self, signal: FloatArray, k: int) -> float:
        """Return the place [px] of the parabola's top through the significance at k and its neighbours."""
        if not 0 < k < len(signal) - 1:
            return self.column[k]
        before, here, after = signal[k - 1 : k + 2]
        bend = before - 2 * here + after
        return self.column[k] + (float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0)

    def measured(self, line: Line, lines: Sequence[Line]) -> dict[str, Any] | None:
        """Return {name: value} of line_columns.COLUMNS; None where too little of the line can be used."""
        middle = self.start + self.per * line.wavelength
        reach = SIDE + 2 * line.width + np.abs(line.places - middle).max()
        near = np.flatnonzero(self.good & (np.abs(self.column - middle) <= reach))
        share = line.light[near].sum() / max(line.light.sum(), 1e-300)
        others = [other for other in lines if other is not line and other.light[near].any()]
        u = ((self.column - middle) / reach)[near]
        even = self.sensitivity[near, None] * u[:, None] ** np.arange(3)
        if share < LEAST or len(near) <= 2 * (1 + len(others) + 3):
            return None
        matrix = np.column_stack([line.seen[near], *(other.seen[near] for other in others), even])
        light = self.found["electrons"][near]
        slope = np.gradient(line.seen)[near]
        sigma = self.error[near]
        fitted, error = _fit(matrix, np.stack([light, slope], axis=1), sigma)
        values = fitted[:, 0]
        rest, slope = ((one - matrix @ fit) / sigma for one, fit in zip((light, slope), fitted.T, strict=True))
        power = max(slope @ slope, 1e-300)  # k of the fit with the slope is that of what the others leave
        shift = -(slope @ rest) / power / values[0]
        off = 1 / np.sqrt(power) / abs(values[0])
        matrix = np.column_stack([line.light[near], *(other.light[near] for other in others), even])
        true = _fit(matrix, self.found["model"][near, None], sigma)[0][0, 0]
        blended = any(line.near(other.places).any() for other in others)
        flags = self._flags(line) | (BLENDED if blended else 0) | (PART if share < WHOLE else 0)
        erg = H_J_S * C_A_S / line.wavelength * ERG_PER_CM2
        flux = erg * values[0]
        limit = max(flux, 0.0) + DETECTED * erg * error[0] if flux < DETECTED * erg * error[0] else np.nan
        return {
            "line": line.name,
            "wavelength": line.wavelength,
            "column": middle,
            "flux": flux,
            "flux_err": erg * error[0],
            "snr": flux / (erg * error[0]),
            "limit": limit,
            "continuum": erg * values[1 + len(others)],
            "flux_true": erg * true,
            "flags": flags,
            "shift": shift,
            "shift_err": off,
        }


def _fit(matrix: FloatArray, data: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (values (k, m), errors (k,)) of a linear least-squares fit of (n, m) data with errors (n,)."""
    scale = np.abs(matrix).max(axis=0)
    scaled = matrix / np.where(scale > 0, scale, 1.0) / error[:, None]
    value, vector = np.linalg.eigh(scaled.T @ scaled)
    inverse = (vector * np.where(value > TINY * value[-1], 1 / np.maximum(value, 1e-300), 0.0)) @ vector.T
    per = np.where(scale > 0, scale, 1.0)
    return inverse @ (scaled.T @ (data / error[:, None])) / per[:, None], np.sqrt(np.diag(inverse)) / per


def judged(table: ObjectTable) -> dict[str, float | None]:
    """Return {name: number}: how a table of lines compares with its flux_true, JSON-like.

    Isolated lines have no flag. Their pull is (flux - flux_true) / flux_err; `limits` counts lines that are not
    detected, `limits_held` those whose flux_true is below the limit. None: there are too few lines to say.
    """
    known = np.isfinite(table["flux_true"])
    isolated = known & (table["flags"] == 0)
    pull = (table["flux"] - table["flux_true"])[isolated] / table["flux_err"][isolated].astype(float)
    limit = known & np.isfinite(table["limit"])
    return {
        "lines": len(table),
        "detected": int((table["snr"] >= DETECTED).sum()),
        "isolated": int(isolated.sum()),
        "pull_mean": float(pull.mean()) if len(pull) > 1 else None,
        "pull_width": float(pull.std(ddof=1)) if len(pull) > 1 else None,
        "limits": int(limit.sum()),
        "limits_held": int((table["flux_true"] <= table["limit"])[limit].sum()),
    }
