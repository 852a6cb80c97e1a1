"""m, c and alpha and their errors, from shapes in two arms.

With S_i the sum of the shapes' component i over the sum of their responses, in the arms of +g and -g:

    m_i = (S_i(+g) - S_i(-g)) / (2 g) - 1,     c_i = (S_i(+g) + S_i(-g)) / 2

alpha is the slope of the galaxies' mean shapes against the ellipticity of the PSF at their positions. Errors are from a
delete-one jackknife over blocks: rings of galaxies, or windows where an error is common to a window. The difference of
two Settings is jackknifed as one quantity, so noise that both share also cancels in its error.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from csstsim.base.arrays.robust_sigma import sigma_of_deviations
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
class SharedColumns:
    """Properties of galaxies that are the same in all Settings.

    sign (n,): of the second component of the arms' shear, +1 or -1; psf (n,): complex ellipticity of the PSF; block
    (n,): numbers from 0.
    """

    sign: FloatArray
    psf: ComplexArray
    block: IntArray


class ArmSums(NamedTuple):
    """Sums over the counted galaxies of an arm, each (...,): shapes, signed shapes and responses by component."""

    e1: FloatArray
    e2: FloatArray
    signed_e2: FloatArray  # times SharedColumns.sign
    response1: FloatArray
    response2: FloatArray


class PairSums(NamedTuple):
    """Sums over the galaxies counted in both arms, each (...,); e: mean shape of both arms, psf: its ellipticity."""

    number: FloatArray
    psf1: FloatArray
    psf2: FloatArray
    psf_times_e: FloatArray
    psf_squared: FloatArray
    e1: FloatArray
    e2: FloatArray
    response: FloatArray


class Term(NamedTuple):
    """A term of a bar: {name: (b, 18) sums} of its Settings, in b blocks, and {name: factor} of their estimates."""

    blocks: Mapping[str, FloatArray]
    factors: Mapping[str, float]


def sums(arms: Arms, shared: SharedColumns, counted: BoolArray) -> FloatArray:
    """Return (blocks, 18) sums of the counted galaxies; counted: bool (2, n), one row for each arm.

    The columns are ArmSums of the arm of +g, those of the arm of -g, and PairSums.
    """
    columns: list[FloatArray | BoolArray] = []
    for arm in range(2):
        counts = counted[arm]
        e = np.where(counts, arms.e[arm], 0)
        response = np.where(counts[:, None], arms.response[arm], 0)
        columns += ArmSums(e.real, e.imag, shared.sign * e.imag, response[:, 0], response[:, 1])
    both: BoolArray = np.all(counted, axis=0)
    plus, minus = arms.e
    mean = np.where(both, (plus + minus) / 2, 0)
    psf = np.where(both, shared.psf, 0)
    columns += PairSums(
        number=both.astype(float),
        psf1=psf.real,
        psf2=psf.imag,
        psf_times_e=(np.conj(psf) * mean).real,
        psf_squared=np.abs(psf) ** 2,
        e1=mean.real,
        e2=mean.imag,
        response=np.where(both[:, None], arms.response.mean(axis=0), 0).mean(axis=1),
    )
    return np.stack([np.bincount(shared.block, column, shared.block.max() + 1) for column in columns], axis=1)


def estimates(total: FloatArray, g: float) -> FloatArray:
    """Return (..., 5) NAMES of sums (..., 18); NaN where no galaxy is counted."""
    columns = np.moveaxis(total, -1, 0)
    plus = ArmSums(*columns[:5])
    minus = ArmSums(*columns[5:10])
    pair = PairSums(*columns[10:])
    with np.errstate(invalid="ignore", divide="ignore"):
        m1 = (plus.e1 / plus.response1 - minus.e1 / minus.response1) / (2 * g) - 1
        m2 = (plus.signed_e2 / plus.response2 - minus.signed_e2 / minus.response2) / (2 * g) - 1
        c1 = (plus.e1 / plus.response1 + minus.e1 / minus.response1) / 2
        c2 = (plus.e2 / plus.response2 + minus.e2 / minus.response2) / 2
        spread = pair.psf_squared - (pair.psf1**2 + pair.psf2**2) / pair.number
        slope = pair.psf_times_e - (pair.psf1 * pair.e1 + pair.psf2 * pair.e2) / pair.number
        alpha = slope / np.where(spread > 0, spread, np.nan) / (pair.response / pair.number)
    return np.stack([m1, m2, c1, c2, alpha], axis=-1)


def combined(terms: Sequence[Term], g: float) -> tuple[FloatArray, FloatArray]:
    """Return (value (5,), error (5,)) of a sum of NAMES of several Settings, by jackknife over the blocks.

    Terms may have different numbers of blocks; shorter ones have the first blocks. Leaving out a block that a term does
    not have does not change that term, so the jackknife accounts for blocks that terms share. The error is NaN if a
    term has fewer than two blocks.
    """
    value: FloatArray = np.zeros(len(NAMES))
    blocks = max(len(sums_of_setting) for term in terms for sums_of_setting in term.blocks.values())
    spread = np.zeros((blocks, len(NAMES)))
    for term in terms:
        without_one: FloatArray = np.zeros(len(NAMES))  # the term's estimates without each of its blocks
        for name, factor in term.factors.items():
            total = term.blocks[name].sum(axis=0)
            value = value + factor * estimates(total, g)
            without_one = without_one + factor * estimates(total - term.blocks[name], g)
        number = len(without_one)
        deviation = without_one - without_one.mean(axis=0)
        spread[:number] += np.sqrt((number - 1) / number) * deviation if number > 1 else np.nan
    return value, np.sqrt((spread**2).sum(axis=0))


def scatter(plus: ComplexArray, minus: ComplexArray) -> float:
    """Return the robust standard deviation of half the difference of the shapes (n,) of two arms, per component.

    It is the robust sigma of both components together.
    """
    half = (plus - minus)[np.isfinite(plus) & np.isfinite(minus)] / 2
    parts = np.concatenate([half.real - np.median(half.real), half.imag - np.median(half.imag)])
    return float(sigma_of_deviations(np.abs(parts)))
