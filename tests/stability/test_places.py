"""Positions of objects: a pixel's corner, the chip's edge, 1 and 3000 px outside, a node of the PSF, a pole."""

import numpy as np
import pytest
from exposure import FIDELITIES, inside, stamp_bounds

from csstsim.catalog.flags import OFF_CHIP
from csstsim.catalog.table import GALAXY, STAR
from csstsim.instrument.chip import Window

pytestmark = pytest.mark.thorough

CORNER = Window(0, 200, 0, 160)  # of the chip
LAST = Window(9016, 9216, 9072, 9232)


@pytest.mark.parametrize("fidelity", [*FIDELITIES, "reference"])
@pytest.mark.parametrize("kind", [STAR, GALAXY])
def test_corners_and_middles_of_pixels(expose, psf_r, fidelity, kind):
    """Light is the box's at any place in a pixel; on a corner the four pixels around share alike up to the PSF."""
    at = np.array([(0.0, 0.0), (0.5, 0.5), (-0.5, 0.5), (0.5, 0.0), (0.5 - 1e-12, -0.5 + 1e-12), (1e-300, -1e-17)])
    for dx, dy in at:
        got = expose(4200 + dx, 5150 + dy, fidelity, obj_type=[kind], size_disk=[0.2])
        wanted = 1e4 * psf_r.at(4200 + dx, 5150 + dy).sum() / 4
        off = 5 * np.sqrt(wanted) if got.counted is not None else 1e-3 * wanted
        assert got.table["drawn"][0] == pytest.approx(wanted, abs=off)


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize(
    ("window", "x", "y"), [(CORNER, -0.5, -0.5), (CORNER, -0.5, 80.0), (LAST, 9215.5, 9231.5), (LAST, 9100.0, 9231.5)]
)
def test_half_or_a_quarter_on_the_chip(expose, psf_r, fidelity, window, x, y):
    """A round galaxy on the chip's edge leaves half its light there, in a corner a quarter: PSF and sky leave 3%."""
    got = expose(x, y, fidelity, window=window, obj_type=[GALAXY], size_disk=[0.3], electrons=1e5)
    whole = 1e5 * psf_r.at(x, y).sum() / 4
    share = inside(got.scene, 0, stamp_bounds(x, y, 10**6, window))
    assert share == pytest.approx(0.5 if 0 < y < 9000 or 0 < x < 9200 else 0.25, rel=1e-2)
    assert got.table["drawn"][0] == pytest.approx(share * whole, rel=0.03)


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("far", [1.0, 30.0, 3000.0])
def test_outside_the_chip(expose, psf_r, fidelity, far):
    """A star 1 px outside leaves some light, 3000 px outside none without wings; a huge galaxy as much as its rays."""
    for x, y in ((-0.5 - far, 80.0), (100.0, -0.5 - far)):
        got = expose(x, y, fidelity, window=CORNER, electrons=1e6)
        if far > 1000:
            assert len(got.table) == 0 and not got.light.any()
        else:
            assert 0 < got.table["fraction"][0] < 0.5
        got = expose(x, y, fidelity, window=CORNER, electrons=1e6, obj_type=[GALAXY], size_disk=[60.0])
        if len(got.table) == 0 or got.table["flags"][0] & OFF_CHIP:
            assert far > 1000  # beyond the largest stamp
            continue
        reach = got.table["reach"][0] if got.table["method"][0] == "stamp" else 10**6
        wanted = 1e6 * inside(got.scene, 0, stamp_bounds(x, y, reach, CORNER)) * psf_r.at(x, y).sum() / 4
        assert got.table["drawn"][0] == pytest.approx(wanted, rel=1e-2, abs=5 * np.sqrt(wanted))


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_the_wing_of_a_star_off_the_chip(expose, fidelity):
    """A star of 1e10 electrons lights a chip it is not on, evenly; from beyond 2048 px nothing is drawn."""
    assert len(expose(-3000.0, 80.0, fidelity, window=CORNER, electrons=1e10, wings=True).table) == 0
    got = expose(-2000.0, 80.0, fidelity, window=CORNER, electrons=1e10, wings=True)
    assert got.table["method"][0] == "stamp" and 0 < got.table["fraction"][0] < 1e-3
    assert got.light.std() < 0.5 * got.light.mean()


@pytest.mark.parametrize("fidelity", [*FIDELITIES, "reference"])
def test_exactly_on_a_psf_node(expose, psf_r, fidelity):
    """Where distance to a node is 0, weights are 1 and 0, not 0 / 0; nothing jumps next to it."""
    x, y = psf_r.nodes_xy[0]
    window = Window(round(x) - 60, round(x) + 61, round(y) - 60, round(y) + 61)
    node, weight, outside = psf_r.weights(np.array([x]), np.array([y]))
    assert weight[0].max() == 1.0 and node[0, weight[0].argmax()] == 0 and not outside[0]
    on, beside = (expose(x + d, y, fidelity, window=window) for d in (0.0, 1e-9))
    assert np.abs(on.light - beside.light).max() <= (0.01 if on.counted is None else 3)  # of 1e4 electrons


def test_places_no_chip_knows(expose):
    """The other side of the sky and the poles: outside, and counted as such."""
    spoilt = [("ra", 0, 240.0), ("dec", 0, 40.0), ("dec", 1, 90.0), ("dec", 2, -90.0), ("ra", 3, 1e6)]
    table = expose(np.full(5, 4200.0), 5150.0, spoilt=spoilt).table
    assert list(table["id"]) == [4]
