"""Real bright stars among the objects of a brick."""

import healpy
import numpy as np
import pytest
from support.embedded_sky import brick, key, shipped
from support.mini_campaign import write_campaign

from csstsim.base.errors import InputError
from csstsim.base.healpix import NSIDE
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.sections import CatalogConfig
from csstsim.catalog.table import STAR
from csstsim.catalog.truth_bricks import brick_meta, make_brick, read_brick, write_brick
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.universe.stars.bright_stars import bright_stars

PIX = 100000
RA, DEC = healpy.pix2ang(NSIDE, PIX, nest=True, lonlat=True)
LIST = np.array(
    [[RA, DEC, 4.5, 4850.0], [RA + 90, DEC, 1.0, 5000.0], [RA + 0.05, DEC, 2.0, 9500.0], [RA, DEC, 4.0, 3300.0]]
)


def test_stars_are_added_at_the_end_and_change_nothing_else():
    plain, with_stars = brick(PIX), make_brick(pix=PIX, bright_stars=LIST, **key())
    count = len(plain)
    assert len(with_stars) == count + 3
    assert with_stars.take(slice(0, count)) == plain
    new = with_stars.take(slice(count, None))
    assert (new["obj_type"] == STAR).all() and (new["av"] == 0).all() and (new["parallax"] == 0).all()
    assert new["ra"] == pytest.approx(LIST[[0, 2, 3], 0], abs=2e-7)  # 0.4 mas between positions
    assert new["dec"] == pytest.approx(LIST[[0, 2, 3], 1], abs=2e-7)
    assert new["logg"].tolist() == [2.5, 4.0, 2.5]
    assert (np.diff(with_stars["id"]) == 1).all()


def test_magnitudes_are_those_of_v():
    """V lies between g and r, whose AB magnitudes differ from it by the colour alone: a photon count at 5500 A."""
    universe, _ = shipped()
    found = bright_stars(PIX, LIST, universe.star_seds, universe.numbers["stars"])
    assert (found["feh"] == 0).all()  # as the Sun
    wave = np.linspace(5300.0, 5700.0, 801)
    surface = universe.star_seds.surface(found["teff"], found["logg"], found["feh"], wave)
    light = surface.mean(axis=1) * found["sed_scale"]
    vega = 1e4 * 3636e-23 / (6.62607015e-27 * 5500.0)  # photon / s / m2 / angstrom of V = 0 (Bessell et al. 1998)
    assert -2.5 * np.log10(light / vega) == pytest.approx(LIST[[0, 2, 3], 2], abs=0.03)
    table = make_brick(pix=PIX, bright_stars=LIST, **key())
    new = table.take(slice(len(table) - 3, None))
    hot = 1
    assert abs(new["mag_g"][hot] - 2.0) < 0.2 and abs(new["mag_r"][hot] - 2.0) < 0.25
    assert (new["mag_g"][[0, 2]] > LIST[[0, 3], 2]).all() and (new["mag_r"][[0, 2]] < LIST[[0, 3], 2]).all()


def test_a_brick_without_bright_stars_is_the_same():
    assert make_brick(pix=PIX, bright_stars=LIST[1:2], **key()) == brick(PIX)


def test_a_brick_of_another_list_is_refused(tmp_path):
    path = tmp_path / "brick.parquet"
    write_brick(path, PIX, bright_stars=LIST, **key())
    assert len(read_brick(path, brick_meta(pix=PIX, bright_stars=LIST, **key()))) == len(brick(PIX)) + 3
    for other in (None, LIST[:2]):
        with pytest.raises(InputError, match="made for another configuration"):
            read_brick(path, brick_meta(pix=PIX, bright_stars=other, **key()))


def test_faults():
    universe, _ = shipped()
    without = {name: value for name, value in universe.numbers["stars"].items() if name != "bright"}
    with pytest.raises(InputError, match="missing or wrong"):
        bright_stars(PIX, LIST, universe.star_seds, without)
    with pytest.raises(ValueError, match="in your own catalogue"):
        CatalogConfig(kind="support.mini_campaign:Stars", bright_stars=True)


@pytest.mark.parametrize(
    ("asked", "there"), [({}, True), ({"bright_stars": True}, True), ({"bright_stars": False}, False)]
)
def test_they_are_in_the_field_unless_a_campaign_says_no(tmp_path, asked, there):
    run = OpenCampaign(write_campaign(tmp_path, catalog=asked))
    if there:
        assert np.array_equal(run.bright_stars, sky_numbers(run.camera.sky).stars)  # the list of the stray light
    else:
        assert run.bright_stars is None


def test_a_catalogue_of_ones_own_has_none_of_them(tmp_path):
    run = OpenCampaign(write_campaign(tmp_path, catalog={"kind": "support.mini_campaign:Stars"}))
    assert run.bright_stars is None
