"""The list of emission lines against atomic physics; flags that share a column have bits of their own."""

import numpy as np
import pytest

from csstsim.measure.spectra import line_columns, spectrum_columns
from csstsim.measure.spectra.line_columns import LINES

RYDBERG = 109677.583  # 1 / cm, of hydrogen


@pytest.mark.parametrize(
    ("name", "low", "high"), [("Lya", 1, 2), ("Ha", 2, 3), ("Hb", 2, 4), ("Hg", 2, 5), ("Hd", 2, 6)]
)
def test_lines_of_hydrogen_are_rydbergs(name, low, high):
    """In vacuum, fine structure aside."""
    ((wavelength, fraction),) = LINES[name]
    assert wavelength == pytest.approx(1e8 / RYDBERG / (low**-2 - high**-2), rel=2e-5) and fraction == 1.0


@pytest.mark.parametrize(
    ("name", "ratio", "apart"),  # of the redder to the bluer line; 1 / cm between them
    [("[OIII]", 3.0, 193.0), ("[NII]", 3.0, 82.0), ("[SII]", 1 / 1.3, 31.8)],
)
def test_doublets_have_their_ratio_and_splitting(name, ratio, apart):
    (blue, first), (red, second) = LINES[name]
    assert first + second == pytest.approx(1.0) and second / first == pytest.approx(ratio, rel=2e-3)
    assert 1e8 / blue - 1e8 / red == pytest.approx(apart, rel=0.01)


def test_other_lines_are_where_they_are_in_air():
    """Air wavelengths of the handbooks, with the index of air by Edlen's formula; in the ultraviolet, vacuum."""
    air = {"[OII]": 3727.4, "[NeIII]": 3868.8, "[SIII]9071": 9068.6, "[SIII]9533": 9530.6}
    for name, wavelength in air.items():
        square = (1e4 / wavelength) ** 2
        index = 1 + 1e-8 * (8342.13 + 2406030 / (130 - square) + 15997 / (38.9 - square))
        assert LINES[name][0][0] == pytest.approx(wavelength * index, abs=0.6), name
    for name, wavelength in {"CIV": 1549.5, "CIII]": 1908.7, "MgII": 2799.1}.items():
        assert LINES[name][0][0] == pytest.approx(wavelength, abs=0.5)
    assert len(LINES) == 15 and all(
        sum(fraction for _, fraction in lines) == pytest.approx(1) for lines in LINES.values()
    )


def test_flags_of_lines_and_spectra_are_bits_of_their_own():
    bits = [*spectrum_columns.FLAGS, *line_columns.FLAGS]
    assert len(set(bits)) == len(bits) == 14 and all(bit > 0 and bit & (bit - 1) == 0 for bit in bits)
    assert max(bits) <= np.iinfo(line_columns.COLUMNS["flags"][0]).max
    assert max(spectrum_columns.FLAGS) <= np.iinfo(spectrum_columns.COLUMNS["flags"][0]).max
