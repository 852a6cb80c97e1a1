"""Mean absorption by the intergalactic medium."""

import numpy as np
import pytest
from support.embedded_sky import shipped

from csstsim.universe.galaxies.igm import Intergalactic


def test_lyman_forest_at_redshift_3():
    numbers = shipped()[0].numbers["galaxies"]["igm"]
    wave = np.array([2400.0, 4.0 * 1100.0, 4.0 * 1210.0, 4.0 * 1220.0])
    through = Intergalactic(wave, numbers).absorb(np.ones(4), 3.0)
    assert through[3] == 1.0  # redward of Lyman alpha: clear
    x, lines = 2400 / 912.0, ((1215.67, 3.6e-3), (1025.72, 1.7e-3), (972.54, 1.2e-3), (949.74, 9.3e-4))
    forest = sum(a * (2400 / line) ** 3.46 for line, a in lines)
    limit = 0.25 * x**3 * (4**0.46 - x**0.46) + 9.4 * x**1.5 * (4**0.18 - x**0.18)
    limit += -0.7 * x**3 * (x**-1.32 - 4**-1.32) - 0.023 * (4**1.68 - x**1.68)
    assert through[0] == pytest.approx(np.exp(-forest - limit), rel=2e-3)  # ratios of lines in three digits
    assert through[2] == pytest.approx(np.exp(-0.0036 * (4 * 1210 / 1215.67) ** 3.46))
