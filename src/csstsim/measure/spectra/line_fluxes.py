"""Fluxes of emission lines in extracted spectra: at known redshifts, and of significant lines without one.

The electrons e(X) within SIDE columns of a line, with their errors, are fitted by

    e(X) = sum_j F_j A t T(lambda_j) L_j(X) + S(X) (c_0 + c_1 u + c_2 u^2),        u = (X - X_0) / SIDE

j are the line and all others that reach these columns, F the fluxes in photons, A the aperture, t the time, T the
order's throughput, L_j the fraction of the line's flux that is extracted in a column (measure.spectra.line_image: the
two-dimensional image of PSF and galaxy, with the pixels' weights), and S the sensitivity. Only F of the line itself is
used, with an error that includes the overlap with other lines. The errors of the columns are those of the extraction. A
second fit also has a term k dL/dX of the line: its position differs from that of its wavelength by -k / F. `flux_true`
is the fit of all electrons of each column (`model`), with the profile P_j along the trace
(measure.spectra.line_profile) instead of L_j.

Without a redshift, the spectrum minus its running median is compared with P at every column. The LINES_MAX highest
points with a significance of at least SIGNIFICANCE_MIN are lines; where the spectrum is uneven, significance is in
units of its scatter. Left out: lines wider than the object's image, such as quasars'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.base.units import C_A_S, H_J_S
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.line_columns import BLENDED, BLIND, COLUMNS, LINES, PART
from csstsim.measure.spectra.line_profile import OFFSETS, band_position
from csstsim.measure.spectra.spectral_model import ONE_REACH
from csstsim.measure.spectra.spectrum_columns import BESIDE, COSMIC, CUT, DIM, LOST, SATURATED

if TYPE_CHECKING:
    from csstsim.measure.spectra.column_sums import Weights
    from csstsim.measure.spectra.line_image import LineImage
    from csstsim.measure.spectra.spectral_model import SpectralModel

SIDE = 30.0  # columns beyond twice a line's full width, for the continuum
DETECTED = 3.0  # S/N
# of lines found without a redshift: minimum significance, and maximum number in a spectrum
SIGNIFICANCE_MIN = 5.0
LINES_MAX = 3
BLENDED_WIDTHS = 1.5  # full widths at half maximum: closer lines are blended
SPURIOUS = SATURATED | COSMIC | LOST | CUT | BESIDE  # on such columns, a peak is not a line
MEDIAN = 41  # columns of the running median
# fraction of a line's flux in usable columns below which it is flagged, and left out
FRACTION_FLAGGED = 0.8
FRACTION_MIN = 0.5
TINY = 1e-12  # of the largest eigenvalue of a fit: a combination of terms with a smaller one is not fitted
ERG_PER_CM2 = 1e3  # J / m2 in erg / cm2


@dataclass(frozen=True, eq=False)
class Line:
    """A line in a spectrum of n columns.

    `positions` of its parts [px]; mean `wavelength` [angstrom]; `extracted`, `total` (n,): electrons of 1 photon / s /
    m2 that are extracted, and all of them; `width`: full width at half maximum of a part [px].
    """

    name: str
    positions: FloatArray
    wavelength: float
    extracted: FloatArray
    total: FloatArray
    width: float
    flags: int = 0

    def near(self, columns: FloatArray) -> BoolArray:
        """Return bool (n,): columns within BLENDED_WIDTHS of a part."""
        return np.any(np.abs(np.subtract.outer(columns, self.positions)) < BLENDED_WIDTHS * self.width, axis=-1)


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
            if values is not None and not (line.flags & BLIND and values["snr"] < SIGNIFICANCE_MIN):
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
        self.column_0 = float(one["x"][0] + one["p"][0])
        self.column_slope = float(one["q"][0])
        self.sensitivity = found["sensitivity"].astype(float)
        self.transmitted = model.photons * np.gradient(model.cumulative[model.pair(one)], GRID)

    def known(self, redshift: float) -> list[Line]:
        """Return the Lines of LINES that lie in the spectrum at a redshift; none if it is NaN or not above 0."""
        if not redshift > 0:
            return []
        lines = [self._line(name, [(w * (1 + redshift), s) for w, s in parts]) for name, parts in LINES.items()]
        return [line for line in lines if line is not None]

    def _line(self, name: str, parts: Sequence[tuple[float, float]], flags: int = 0) -> Line | None:
        """Return the Line of parts (wavelength, fraction); None unless all are on usable columns."""
        positions = np.array([self.column_0 + self.column_slope * w for w, _ in parts])
        extracted, total = np.zeros((2, len(self.column)))
        column_index = np.rint(positions - self.column[0]).astype(int)
        if not ((column_index >= 0) & (column_index < len(self.column))).all() or not self.good[column_index].all():
            return None
        for position, (wavelength, fraction) in zip(positions, parts, strict=True):
            transmission = fraction * np.interp(wavelength, GRID, self.transmitted)
            extracted += transmission * self._extracted(position, wavelength)
            total += transmission * self._fractions(position, wavelength)
        wavelength = sum(w * s for w, s in parts)
        return Line(name, positions, wavelength, extracted, total, self._width(wavelength), flags)

    def _profile(self, wavelength: float) -> FloatArray:
        """Return the fraction of a line's flux below OFFSETS: all of it is within ONE_REACH (spectral_model)."""
        band, fraction = band_position(wavelength, self.model.bands)
        profile = (1 - fraction) * self.along[band] + fraction * self.along[band + 1]
        ends = np.interp([-ONE_REACH - 0.5, ONE_REACH + 0.5], OFFSETS, profile)
        return np.clip((profile - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)

    def _fractions(self, column: float, wavelength: float) -> FloatArray:
        """Return (n,): the fraction of a line's flux in each column."""
        profile = self._profile(wavelength)
        offset = self.column - column
        return np.interp(offset + 0.5, OFFSETS, profile) - np.interp(offset - 0.5, OFFSETS, profile)

    def _extracted(self, column: float, wavelength: float) -> FloatArray:
        """Return (n,): the fraction of a line's flux that is extracted in each column."""
        row_of_line = float(np.interp(column, self.column, self.found["y"]))
        rows = self.weights.offset[0] + self.found["y"][0] - row_of_line
        return self.image.extracted(wavelength, self.column - column, rows, self.weights.weight)

    def _width(self, wavelength: float) -> float:
        steps = np.diff(self._profile(wavelength))
        return float(np.count_nonzero(steps > steps.max() / 2) * (OFFSETS[1] - OFFSETS[0]))

    def search(self, lines: Sequence[Line]) -> list[Line]:
        """Return the Lines of the LINES_MAX highest points above the continuum that are not among `lines`."""
        new_lines: list[Line] = []
        usable = np.flatnonzero(self.good)
        if len(usable) < MEDIAN:
            return []
        signal = self._significance(usable)
        signal[: usable[0] + MEDIAN // 2] = signal[usable[-1] - MEDIAN // 2 + 1 :] = 0.0  # no continuum on either side
        for known in lines:
            signal[known.near(self.column)] = 0.0
        while len(new_lines) < LINES_MAX:
            k = int(np.argmax(signal))
            if not signal[k] >= SIGNIFICANCE_MIN:
                break
            line = self._line("", [((self._peak(signal, k) - self.column_0) / self.column_slope, 1.0)], BLIND)
            if line is not None and not self._flags(line) & SPURIOUS:
                new_lines.append(line)
            signal[max(k - MEDIAN // 2, 0) : k + MEDIAN // 2 + 1] = 0.0
        return new_lines

    def _flags(self, line: Line) -> int:
        """Return the flags of the columns with the flux of a line, and those of the line."""
        with_flux = line.total > 0.05 * line.total.max()
        return int(np.bitwise_or.reduce(self.found["flags"][with_flux].astype(int), initial=line.flags))

    def _significance(self, usable: IntArray) -> FloatArray:
        """Return (n,): S/N of a line on each column above the running median; 0 where columns cannot be used."""
        sensitivity = np.maximum(self.found["sensitivity"], 1e-30)
        shape = np.interp(self.column, self.column[usable], (self.found["electrons"] / sensitivity)[usable])
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(shape, MEDIAN // 2, mode="reflect"), MEDIAN)
        median = np.partition(windows, MEDIAN // 2, axis=1)[:, MEDIAN // 2]
        excess = np.where(self.good, (shape - median) * sensitivity, 0.0)
        weight = np.where(self.good, 1 / np.where(self.good, self.error, 1.0) ** 2, 0.0)
        middle = self.found["wavelength"][usable[len(usable) // 2]]
        offset = np.arange(-(MEDIAN // 2), MEDIAN // 2 + 1)
        profile = self._profile(middle)
        fractions = np.interp(offset + 0.5, OFFSETS, profile) - np.interp(offset - 0.5, OFFSETS, profile)
        norm = np.sqrt(np.convolve(weight, fractions[::-1] ** 2, "same"))
        out = np.convolve(excess * weight, fractions[::-1], "same") / np.where(norm > 0, norm, np.inf)
        scatter = robust_sigma(out[usable])
        return np.where(self.good, out / max(scatter, 1.0), 0.0)

    def _peak(self, signal: FloatArray, k: int) -> float:
        """Return the position [px] of the maximum of the parabola through the significance at k and its neighbours."""
        if not 0 < k < len(signal) - 1:
            return self.column[k]
        before, at_peak, after = signal[k - 1 : k + 2]
        curvature = before - 2 * at_peak + after
        if not curvature < 0:
            return self.column[k]
        return self.column[k] + float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))

    def measured(self, line: Line, lines: Sequence[Line]) -> dict[str, Any] | None:
        """Return {name: value} of line_columns.COLUMNS; None if too little of the line can be used."""
        middle = self.column_0 + self.column_slope * line.wavelength
        reach = SIDE + 2 * line.width + np.abs(line.positions - middle).max()
        near = np.flatnonzero(self.good & (np.abs(self.column - middle) <= reach))
        fraction = line.total[near].sum() / max(line.total.sum(), 1e-300)
        other_lines = [other for other in lines if other is not line and other.total[near].any()]
        u = ((self.column - middle) / reach)[near]
        continuum = self.sensitivity[near, None] * u[:, None] ** np.arange(3)
        if fraction < FRACTION_MIN or len(near) <= 2 * (1 + len(other_lines) + 3):
            return None
        matrix = np.column_stack([line.extracted[near], *(other.extracted[near] for other in other_lines), continuum])
        electrons = self.found["electrons"][near]
        slope = np.gradient(line.extracted)[near]
        sigma = self.error[near]
        fit = _fit(matrix, np.stack([electrons, slope], axis=1), sigma)
        values = fit.values[:, 0]
        error = fit.errors
        residual = (electrons - matrix @ fit.values[:, 0]) / sigma
        slope = (slope - matrix @ fit.values[:, 1]) / sigma
        power = max(slope @ slope, 1e-300)  # k is fitted to the residuals of both (partial regression)
        shift = -(slope @ residual) / power / values[0]
        shift_error = 1 / np.sqrt(power) / abs(values[0])
        matrix = np.column_stack([line.total[near], *(other.total[near] for other in other_lines), continuum])
        flux_true = _fit(matrix, self.found["model"][near, None], sigma).values[0, 0]
        blended = any(line.near(other.positions).any() for other in other_lines)
        flags = self._flags(line) | (BLENDED if blended else 0) | (PART if fraction < FRACTION_FLAGGED else 0)
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
            "continuum": erg * values[1 + len(other_lines)],
            "flux_true": erg * flux_true,
            "flags": flags,
            "shift": shift,
            "shift_err": shift_error,
        }


class _LinearFit(NamedTuple):
    """Values (k, m) and errors (k,) of k terms fitted to m sets of data."""

    values: FloatArray
    errors: FloatArray


def _fit(matrix: FloatArray, data: FloatArray, error: FloatArray) -> _LinearFit:
    """Return the linear least-squares fit of terms `matrix` (n, k) to data (n, m) with errors (n,)."""
    scale = np.abs(matrix).max(axis=0)
    scaled = matrix / np.where(scale > 0, scale, 1.0) / error[:, None]
    value, vector = np.linalg.eigh(scaled.T @ scaled)
    inverse = (vector * np.where(value > TINY * value[-1], 1 / np.maximum(value, 1e-300), 0.0)) @ vector.T
    column_scale = np.where(scale > 0, scale, 1.0)
    values = inverse @ (scaled.T @ (data / error[:, None])) / column_scale[:, None]
    return _LinearFit(values, np.sqrt(np.diag(inverse)) / column_scale)


def compared_with_truth(table: ObjectTable) -> dict[str, float | None]:
    """Return {name: number}: comparison of a table of lines with its flux_true, JSON-like.

    Isolated lines have no flag. Their pull is (flux - flux_true) / flux_err; `limits` counts lines that are not
    detected, `limits_held` those whose flux_true is below the limit. None: too few lines.
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


def detectable(table: ObjectTable) -> int:
    """Return how many lines of a table have a flux_true of at least DETECTED errors: so many should be detected.

    Noise moves some lines above the threshold and others below it.
    """
    return int((table["flux_true"] >= DETECTED * table["flux_err"]).sum())  # NaN, not known: is not
