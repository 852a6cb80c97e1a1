"""From shapes in two arms to m, c and alpha, and their errors.

With S_i the sum of shapes' component i over that of their responses, in the arms of +g and -g:

    m_i = (S_i(+g) - S_i(-g)) / (2 g) - 1,     c_i = (S_i(+g) + S_i(-g)) / 2

alpha is the slope of the galaxies' mean shapes on the ellipticity of the PSF at their places. Errors are delete-one
jackknives over blocks: rings of galaxies, or whole windows where an error is common to a window. A difference of two
Settings is jackknifed as one number, so noise that both share cancels in its error, too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from csstsim.base.types import BoolArray, ComplexArray, FloatArray, IntArray

NAMES = "m1", "m2", "c1", "c2", "alpha"


@dataclass(frozen=True, eq=False)
class Arms:
    """Shapes of n galaxies under +g and -g: e (2, n) complex and response (2, n, 2); used (2, n) bool."""

    e: ComplexArray
    response: FloatArray
    used: BoolArray

    @property
    def finite(self) -> BoolArray:
        """Bool (n,): galaxies with a shape in both arms."""
        finite: BoolArray = np.all(np.isfinite(self.e), axis=0)
        return finite


@dataclass(frozen=True, eq=False)
class Frame:
    """What galaxies have in common in all Settings.

    g: a component of the arms' shear; sign (n,) of the second, +1 or -1; psf (n,) complex ellipticity of the PSF;
    block (n,) numbers from 0.
    """

    g: float
    sign: FloatArray
    psf: ComplexArray
    block: IntArray


def sums(arms: Arms, frame: Frame, counted: BoolArray) -> FloatArray:
    """Return (blocks, 18) sums of the galaxies that count: bool (2, n), one row an arm."""
    columns = []
    for arm in range(2):
        good = counted[arm]
        e = np.where(good, arms.e[arm], 0)
        r = np.where(good[:, None], arms.response[arm], 0)
        columns += [e.real, e.imag, frame.sign * e.imag, r[:, 0], r[:, 1]]
    both: BoolArray = np.all(counted, axis=0)
    mean = np.where(both, (arms.e[0] + arms.e[1]) / 2, 0)
    psf = np.where(both, frame.psf, 0)
    columns += [both, psf.real, psf.imag, (np.conj(psf) * mean).real, np.abs(psf) ** 2]
    columns += [mean.real, mean.imag, np.where(both[:, None], arms.response.mean(axis=0), 0).mean(axis=1)]
    return np.stack([np.bincount(frame.block, column, frame.block.max() + 1) for column in columns], axis=1)


def estimates(total: FloatArray, g: float) -> FloatArray:
    """Return (..., 5) NAMES of sums (..., 18); NaN where no galaxy counts."""
    plus = total[..., :5]
    minus = total[..., 5:10]
    rest = total[..., 10:]
    with np.errstate(invalid="ignore", divide="ignore"):
        signed = [arm[..., [0, 2]] / arm[..., [3, 4]] for arm in (plus, minus)]
        m = (signed[0] - signed[1]) / (2 * g) - 1
        c = (plus[..., :2] / plus[..., 3:5] + minus[..., :2] / minus[..., 3:5]) / 2
        n, p1, p2, pe, pp, e1, e2, r = np.moveaxis(rest, -1, 0)
        spread = pp - (p1**2 + p2**2) / n
        alpha = (pe - (p1 * e1 + p2 * e2) / n) / np.where(spread > 0, spread, np.nan) / (r / n)
    return np.concatenate([m, c, alpha[..., None]], axis=-1)


def combined(
    terms: Sequence[tuple[Mapping[str, FloatArray], Mapping[str, float]]], g: float
) -> tuple[FloatArray, FloatArray]:
    """Return (value (5,), error (5,)) of a sum of NAMES of several Settings, by jackknife over the blocks.

    terms: [({name: (b, 18) sums}, {name: factor})]. Terms may have different numbers of blocks: those with fewer have
    the first ones. A block that a term lacks does not change it, so what is common to terms is counted as common. The
    error is NaN if a term has fewer than two blocks.
    """
    value: FloatArray = np.zeros(len(NAMES))
    spread = np.zeros((max(len(of) for blocks, _ in terms for of in blocks.values()), len(NAMES)))
    for blocks, factors in terms:
        again: FloatArray = np.zeros(len(NAMES))
        for name, factor in factors.items():
            total = blocks[name].sum(axis=0)
            value = value + factor * estimates(total, g)
            again = again + factor * estimates(total - blocks[name], g)
        number = len(again)
        spread[:number] += np.sqrt((number - 1) / number) * (again - again.mean(axis=0)) if number > 1 else np.nan
    return value, np.sqrt((spread**2).sum(axis=0))


def scatter(plus: ComplexArray, minus: ComplexArray) -> float:
    """Return the robust scatter (standard deviation) of half the difference of shapes of two arms (n,), of a component.

    It is 1.4826 times the median deviation, of both components together.
    """
    half = (plus - minus)[np.isfinite(plus) & np.isfinite(minus)] / 2
    parts = np.concatenate([half.real - np.median(half.real), half.imag - np.median(half.imag)])
    return float(1.4826 * np.median(np.abs(parts)))
