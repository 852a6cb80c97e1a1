"""The numbers of a universe folder of one's own: what is missing, no number, or does not fit the spectra is refused."""

import copy
from functools import reduce
from operator import getitem

import healpy
import pytest
from embedded_sky import shipped

from csstsim.base.errors import InputError
from csstsim.base.healpix import NSIDE
from csstsim.campaign.sections import Lensing
from csstsim.catalog.truth_bricks import make_brick
from csstsim.universe.parameters import Universe


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("virial", None, r"virial: missing"),
        ("line_scatter", float("nan"), r"line_scatter: must be a number"),
        ("line_scatter", "x", r"line_scatter: must be a number"),
        ("dust.scatter", float("inf"), r"dust.scatter: must be a number"),
        ("dust.cubic", [0.345, float("nan"), 0.0, 0.0], r"dust.cubic\[1\]: must be a number"),
        ("dust.max", -1.0, r"dust.max: impossible"),
        ("dust", 1.0, r"dust: must be a mapping"),
        ("lines.strength", 0.9, r"lines.strength: galaxy_spectra.fits has other lines.*0.21"),
    ],
)
def test_wrong_numbers_are_refused(key, value, said):
    universe = shipped()[0]
    numbers = copy.deepcopy(universe.numbers)
    *way, last = key.split(".")
    inner = reduce(getitem, way, numbers["galaxies"])
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    with pytest.raises(InputError, match=rf"galaxies.yaml: {said}"):
        Universe(universe.folder, numbers).check()


def test_the_shipped_numbers_pass():
    shipped()[0].check()


def test_a_brick_with_too_many_stars_names_the_own_folder(tmp_path):
    universe, camera = shipped()
    numbers = copy.deepcopy(universe.numbers)
    numbers["stars"]["limits"][1] = 40.0
    pix = int(healpy.ang2pix(NSIDE, 266.4, -29.0, nest=True, lonlat=True))  # the Galactic centre
    with pytest.raises(InputError, match=rf"{tmp_path}/stars.yaml: limits: brick {pix} would hold .* stars"):
        make_brick(1, pix, Universe(tmp_path, numbers), camera, Lensing(), "none")
