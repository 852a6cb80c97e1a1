"""Ghosts: reflection geometry and the light in them."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.optics.scatter.ghosts import Ghosts, make_ghosts
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered, scattered_light

GEOMETRY = {
    "gap": 20.0,
    "thickness": 14.6,
    "index": 1.46,
    "pupil_distance": 2000.0,
    "axis_x": 0.0,
    "axis_y": 0.0,
    "faintest": 0.05,
}


def ghosts(camera, **changes):
    params = {"geometry": GEOMETRY | changes, "reflectance": {"r": [0.1, 0.02, 0.01]}}
    return make_ghosts(params, "r", camera.telescope, 10.0)


def centre_chip(camera):
    """A chip centred on the boresight."""
    return replace(camera.chips[9], xc=0.0, yc=0.0)


def test_ways_sizes_and_light_by_hand(camera):
    """20 mm gap; 14.6 mm of index 1.46 are 10 mm of air; f/14."""
    g = ghosts(camera)
    assert g.way == pytest.approx([4000, 6000, 2000])  # px of 10 um: 40, 60, 20 mm
    assert g.radius == pytest.approx(g.way / 28)
    assert g.light == pytest.approx([1e-3, 0.002 * 0.99**2, 2e-4])
    assert g.level == pytest.approx(g.light / (np.pi * g.radius**2))


def test_on_the_axis_ghosts_are_concentric(camera):
    chip = centre_chip(camera)
    x, y = (chip.detector.nx - 1) / 2, (chip.detector.ny - 1) / 2
    assert ghosts(camera).centres(chip, x, y) == pytest.approx(np.full((3, 2), (x, y)))


def test_opposite_stars_have_opposite_ghosts_further_out(camera):
    chip = centre_chip(camera)
    middle = np.array([(chip.detector.nx - 1) / 2, (chip.detector.ny - 1) / 2])
    step = np.array([3000.0, -2000.0])
    there, opposite = (ghosts(camera).centres(chip, *(middle + s * step)) - middle for s in (1, -1))
    assert there == pytest.approx(-opposite)
    # The chief ray leans by step / 200,000 px and goes on for the added way
    assert there == pytest.approx(step * (1 + ghosts(camera).way[:, None] / 2e5))


def test_turned_chip_and_shifted_axis(camera):
    """The lean is the mosaic's: a chip turned by 90 degrees sees it turned back."""
    chip = replace(centre_chip(camera), rotation=90.0)
    middle = np.array([(chip.detector.nx - 1) / 2, (chip.detector.ny - 1) / 2])
    shift = ghosts(camera, axis_x=-100.0).centres(chip, *middle) - middle
    assert shift == pytest.approx(np.outer(ghosts(camera).way / 2e5, [0.0, -100.0]), abs=1e-9)  # mosaic +x is chip -y


def test_reach_holds_every_ghost_of_every_corner(camera):
    for chip in (camera.chips[6], camera.chips[13], camera.chips[25]):
        g = scattered_light(camera, camera.filters[chip.filter]).ghosts
        for corner in ((0, 0), (9215, 0), (0, 9231), (9215, 9231)):
            far = np.hypot(*(g.centres(chip, *corner) - corner).T) + g.radius
            assert far.max() <= g.reach(chip) + 1


def test_every_ghost_is_below_1e_6_of_the_peak(camera):
    """The paper: 1e-6 or lower; the peak pixel holds a fifth of a star's light or more."""
    for band in camera.filters.values():
        assert scattered_light(camera, band).ghosts.level.max() < 1e-6 * 0.2


def test_visible_from_a_flux_on(camera):
    g = ghosts(camera)
    limit = 0.05 / g.level.max()
    assert list(g.visible(np.array([0.0, 0.99 * limit, 1.01 * limit]))) == [False, False, True]


@pytest.mark.parametrize(
    "geometry, reflectance",
    [({"gap": 0}, [0.1] * 3), ({"index": None}, [0.1] * 3), ({}, [0.1, 0.2]), ({}, [0.1, 0.2, 1.2]), ({}, None)],
)
def test_bad_numbers_are_refused(camera, geometry, reflectance):
    with pytest.raises(InputError, match=r"ghosts\.yaml"):
        make_ghosts({"geometry": GEOMETRY | geometry, "reflectance": {"r": reflectance}}, "r", camera.telescope, 10.0)
    assert make_ghosts({}, "r", camera.telescope, 10.0) is None


def test_reach_is_that_of_the_corner_furthest_from_the_axis(camera):
    """An axis beyond one corner: the lean of the opposite one, whichever corner it is."""
    chip = centre_chip(camera)
    for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        g = ghosts(camera, axis_x=sx * 6000.0, axis_y=sy * 3000.0)
        lean = np.hypot(6000 + 4608, 3000 + 4616)
        assert g.reach(chip) == pytest.approx(6000 * lean / 2e5 + 6000 / 28, abs=0.1)


def test_lengths_are_millimetres_but_for_the_axis(camera):
    """Pixels of 5 um have twice the numbers; the axis is in pixels of the mosaic."""
    params = {"geometry": GEOMETRY | {"axis_x": 30.0, "axis_y": -7.0}, "reflectance": {"r": [0.1, 0.02, 0.01]}}
    g = make_ghosts(params, "r", camera.telescope, 5.0)
    assert g.way == pytest.approx([8000, 12000, 4000]) and g.pupil == pytest.approx(4e5)
    assert g.axis.tolist() == [30.0, -7.0] and g.faintest == 0.05
    with pytest.raises(InputError, match=r"ghosts.yaml: reflectance.i: bad reflectance"):
        make_ghosts(params, "i", camera.telescope, 10.0)


def test_a_psf_file_gives_wing_and_ghosts_back(camera):
    """Each value, through JSON; none, or one of them; and what is damaged."""
    given = scattered_light(camera, camera.filters["i"])
    found = read_scattered(SimpleNamespace(attributes=given.attributes(), path="a.h5"))
    for part in ("wing", "ghosts"):
        one, other = getattr(given, part).as_dict(), getattr(found, part).as_dict()
        assert one == other and list(one) == list(vars(getattr(given, part)))
    assert not np.array_equal(found.ghosts.way, found.ghosts.radius) and found.ghosts.light.shape == (3,)
    assert Scattered().attributes() == {}
    none = read_scattered(SimpleNamespace(attributes={"chip": 3}, path="a.h5"))
    assert none.wing is None and none.ghosts is None
    alone = read_scattered(SimpleNamespace(attributes=Scattered(ghosts=given.ghosts).attributes(), path="a.h5"))
    assert alone.wing is None and isinstance(alone.ghosts, Ghosts)
    short = json.loads(given.attributes()["ghosts"])
    del short["pupil"]
    for text in ("{", json.dumps(short), json.dumps(short | {"pupil": "far"}), "3"):
        with pytest.raises(InputError, match=r"a.h5: wing, ghosts: the PSF file is damaged"):
            read_scattered(SimpleNamespace(attributes={"ghosts": text}, path="a.h5"))


def test_ghosts_of_another_telescope_and_detector(camera):
    """Pixels of half the size: twice as many on every way. An f/7 beam: discs of twice the size on the same way."""
    params = {"geometry": GEOMETRY, "reflectance": {"r": [0.1, 0.02, 0.01]}}
    wide, small, fast = (
        make_ghosts(params, "r", telescope, um)
        for telescope, um in (
            (camera.telescope, 10.0), (camera.telescope, 5.0), (replace(camera.telescope, focal_length_m=14.0), 10.0)
        )
    )  # fmt: skip
    assert small.way == pytest.approx(2 * wide.way) and small.radius == pytest.approx(2 * wide.radius)
    assert small.pupil == pytest.approx(2 * wide.pupil) == 4e5
    assert fast.way == pytest.approx(wide.way) and fast.radius == pytest.approx(2 * wide.radius)
    assert fast.pupil == wide.pupil
