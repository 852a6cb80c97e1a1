"""A gate compares a measured value with a threshold: it passes, fails, or is not evaluated.

A gate is one record, in the GATES of its family's file in this folder. The record's class says how the value is
compared: AtMost, AtLeast, FractionAtMost or Between. `register` collects the families.

A gate's result is {name, band, value, threshold, n, error, margin, passed} (ABOUT); the result of one exposure also has
{exposure, chip}, that of one readout channel {channel}. A gate is not evaluated without a threshold, without a value,
or from fewer than MIN_SOURCES sources; n is None if the value does not depend on sources. margin: the value over the
largest allowed one, which includes chance; above 1 the gate fails.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from csstsim.campaign.thresholds import ValidateConfig

GateResult: TypeAlias = dict[str, Any]
Scope: TypeAlias = Literal["frame", "band", "colour", "brick", "spectra", "twins"]

# Columns of a table of results
ABOUT = {
    "brick": (np.int32, "HEALPix pixel of NSIDE 256, nested"),
    "name": (np.str_, "what is evaluated"),
    "band": (np.str_, 'in lower case; "all": of all bands'),
    "value": (np.float64, "the number that is evaluated; null: there is none"),
    "threshold": (np.float64, 'maximum or minimum; of a width "low to high"; null: none is given'),
    "n": (np.int64, "sources it is from; null: it does not depend on sources"),
    "error": (np.float64, "one sigma of the value; null: not known, or none"),
    "margin": (np.float64, "the number over the largest allowed one, chance included: above 1 the gate fails"),
    "passed": (np.bool_, "null: it could not be evaluated"),
    "exposure": (np.str_, "obsid, of a gate of one exposure"),
    "chip": (np.int16, "its chip"),
    "channel": (np.int16, "readout channel, of a gate of one"),
}
MIN_SOURCES = 20
SIGMAS = 2.0  # of chance that are allowed
SIGMAS_OF_MANY = 4.0  # ... for bins, widths and exposures: of a release's thousands some exceed three by chance
MAX_MARGIN = 999.0
WIDTH_ERROR = 1.17  # times 1 / sqrt(n): relative error of a width from the median deviation of n values


class Measured(NamedTuple):
    """The value that a gate tests: from n sources (None: it depends on none), with its standard error.

    value: None if there is none; channel: the readout channel, None for the whole frame.
    """

    value: float | None
    n: int | None = None
    sigma: float = 0.0
    channel: int | None = None


@dataclass(frozen=True)
class Gate(ABC):
    """A gate; a class derived from it defines how the value is compared with the threshold.

    Parameters
    ----------
    name
        As printed, with the unit in brackets.
    scope
        What the gate is evaluated for, and the data that `measure` receives. "frame": one exposure of one chip
        (data.FrameData). "band": a band of a brick, with its entry in `bands` of the brick's result. "colour": a
        pair of neighbouring bands and a bin of S/N (compare.galaxy_colours). "brick": a brick (data.BrickData).
        "spectra": a spectroscopic exposure of a chip (stages.parts.spectra_checks). "twins": twin campaigns
        (shear.calibration).
    threshold
        The key of the campaign's `validation` that sets the threshold, or a number that no campaign can change.
    unit
        Unit of value and threshold; empty for a ratio.
    tests
        What is measured, in words: the column "statistic" of docs/validation.md.
    measure
        Function of the scope's data. It returns what it measured: nothing where there is no such gate, or several
        values, of which the one closest to failing counts.
    sigmas
        So many standard errors of the value are allowed beyond the threshold.
    bin
        Index of the gate's threshold, where the campaign's key has one for each bin.
    """

    name: str
    _: KW_ONLY
    scope: Scope
    threshold: str | float
    unit: str = ""
    tests: str
    measure: Callable[[Any], Iterable[Measured]]
    sigmas: float = 0.0
    bin: int | None = None

    def threshold_in(self, thresholds: ValidateConfig) -> Any:
        """Return the threshold that a campaign sets: a number, (low, high) of Between, or None."""
        if not isinstance(self.threshold, str):
            return self.threshold
        threshold = getattr(thresholds, self.threshold)
        return threshold if self.bin is None or threshold is None else threshold[self.bin]

    def evaluate(self, data: Any, thresholds: ValidateConfig, band: str, **where: Any) -> list[GateResult]:
        """Return the gate's result in a list, which is empty if nothing was measured.

        data: of the gate's scope; where: {exposure, chip} of a frame.
        """
        threshold = self.threshold_in(thresholds)
        results = [self.result(measured, threshold, band, **where) for measured in self.measure(data)]
        return [max(results, key=lambda result: result["margin"] or 0.0)] if results else []

    def result(self, measured: Measured, threshold: Any, band: str, **where: Any) -> GateResult:
        """Return the result of one value."""
        n = measured.n
        known = measured.value is not None and threshold is not None and (n is None or n >= MIN_SOURCES)
        margin = _margin(*self._value_and_allowed(measured, threshold)) if known else None
        return {
            "name": self.name,
            "band": band,
            "value": measured.value,
            "threshold": self._shown(threshold),
            "n": n,
            "error": self._error(measured),
            "margin": margin,
            "passed": None if margin is None else margin <= 1.0,
            **where,
            **({"channel": measured.channel} if measured.channel else {}),
        }

    @abstractmethod
    def _value_and_allowed(self, measured: Measured, threshold: Any) -> tuple[float, float]:
        """Return the value's size and the largest allowed one, which includes chance."""

    def _error(self, measured: Measured) -> float | None:
        """Return the standard error of the value, None if it is not known."""
        return measured.sigma or None

    def _shown(self, threshold: Any) -> float | str | None:
        """Return the threshold as the result states it."""
        return threshold


class AtMost(Gate):
    """The gate of a value of either sign whose size is at most the threshold."""

    def _value_and_allowed(self, measured: Measured, threshold: float) -> tuple[float, float]:
        assert measured.value is not None  # who asks has checked
        return abs(measured.value), threshold + self.sigmas * measured.sigma


class FractionAtMost(AtMost):
    """The gate of a fraction of n that is at most the threshold; its error is that of a fraction at the threshold."""

    def result(self, measured: Measured, threshold: float | None, band: str, **where: Any) -> GateResult:
        """Return the result of one value."""
        sigma = np.sqrt(threshold / measured.n) if threshold and measured.n else 0.0
        return super().result(measured._replace(sigma=sigma), threshold, band, **where)


class AtLeast(Gate):
    """The gate of a fraction of n that is at least the threshold; its margin compares the missing fractions.

    A fraction whose true value is at the threshold may fall short by chance.
    """

    def _value_and_allowed(self, measured: Measured, threshold: float) -> tuple[float, float]:
        assert measured.value is not None and measured.n is not None
        chance = self.sigmas * np.sqrt(threshold * (1 - threshold) / measured.n)
        return 1 - measured.value, 1 - threshold + chance

    def _error(self, measured: Measured) -> float | None:
        value, n = measured.value, measured.n
        return float(np.sqrt(max(value * (1 - value), 1 / n) / n)) if n and value is not None else None


class Between(Gate):
    """The gate of a width of n values that lies within (low, high)."""

    def _value_and_allowed(self, measured: Measured, threshold: tuple[float, float]) -> tuple[float, float]:
        assert measured.value is not None and measured.n is not None
        low, high = threshold
        chance = self.sigmas * WIDTH_ERROR / np.sqrt(measured.n)
        if measured.value > low:
            return measured.value, high * (1 + chance)
        return low * (1 - chance), measured.value

    def _error(self, measured: Measured) -> float | None:
        value, n = measured.value, measured.n
        return float(value * WIDTH_ERROR / np.sqrt(n)) if n and value is not None else None

    def _shown(self, threshold: tuple[float, float] | None) -> str | None:
        return None if threshold is None else f"{threshold[0]:g} to {threshold[1]:g}"


def _margin(size: float, allowed: float) -> float:
    """Return size over allowed, at most MAX_MARGIN, which it also is if `allowed` is zero or less; 0 without size."""
    if size <= 0:
        return 0.0
    return float(min(size / allowed, MAX_MARGIN)) if allowed > 0 else MAX_MARGIN
