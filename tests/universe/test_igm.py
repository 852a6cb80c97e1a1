"""Mean absorption by the intergalactic medium."""

import numpy as np
import pytest
from embedded_sky import shipped

from csstsim.universe.igm import Intergalactic


def test_lyman_forest_at_redshift_3():
    numbers = shipped()[0].numbers["galaxies"]["igm"]
    wave = np.array([2400.0, 4.0 * 1100.0, 4.0 * 1210.0, 4.0 * 1220.0])
    through = Intergalactic(wave, numbers).absorb(np.ones(4), 3.0)
    assert through[3] == 1.0  # redward of Lyman alpha: clear
    x = 2400 / 912.0  # below the Lyman limit: forest of three lines and continuum (Moller & Jakobsen 1990)
    forest = sum(0.0036 * a * (2400 / line) ** 3.46 for line, a in ((1215.67, 1), (1025.72, 0.47), (972.54, 0.34)))
    assert through[0] == pytest.approx(np.exp(-forest - 0.25 * x**3 * (4**0.46 - x**0.46)))
    assert through[2] == pytest.approx(np.exp(-0.0036 * (4 * 1210 / 1215.67) ** 3.46))
