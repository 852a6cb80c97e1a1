"""Each reason for which an object is not rendered: the row that has it, at the limits and beyond, and no other."""

import numpy as np
import pytest
from support.csst import BANDS

from csstsim.catalog.flags import STRONG_LENSING
from csstsim.catalog.selection.renderable import NO_LIGHT, STRONGLY_LENSED, reasons, unusable, why_not_rendered
from csstsim.catalog.table import ObjectTable

STAR, GALAXY, QUASAR = 0, 1, 2
SOUND = {"obj_type": GALAXY, "ra": 10.0, "dec": -90.0, "size_disk": 3600.0, "size_bulge": 3600.0, "bulge_frac": 0.5}
KNOTS = {"knots": 0, "knots_frac": 0.0}
PLACE, KIND = "ra, dec is not a position", "obj_type is not one of star, galaxy, quasar, asteroid, satellite"
SHARE, SHAPE = "a galaxy whose bulge_frac is not within 0..1", "a galaxy whose |e1, e2| is not below 1"
LENS, INDEX = "kappa, gamma1 or gamma2 is not finite", "is not within 0.3..6.2"
TOGETHER = "a galaxy whose knots_frac and bulge_frac are not within 0..1 together"
POINT, PICTURED = {"obj_type": QUASAR, "bulge_frac": 7.0}, {"image_file": "a.fits", "bulge_frac": 0.0}


def table(*rows, **default):
    names = sorted({name for row in rows for name in row} | set(default))
    every = SOUND | default
    columns = {name: np.array([(every | row).get(name, 0.0) for row in rows]) for name in {*names, *SOUND}}
    return ObjectTable.complete({"id": np.arange(len(rows))} | columns, BANDS)


@pytest.mark.parametrize("row", [
    {}, {"dec": 90.0}, {"bulge_frac": 0.0, "size_bulge": np.nan}, {"bulge_frac": 1.0, "size_disk": -1.0},
    {"e1": 0.999}, {"e1": 0.7, "e2": -0.7}, {"kappa": 0.5, "gamma1": 0.3, "gamma2": 0.39}, {"kappa": -3.0},
    {"obj_type": STAR, "kappa": np.nan, "size_disk": 0.0, "e1": 9.0, "bulge_frac": np.nan},
    {"obj_type": 3, "kappa": 0.1}, {"obj_type": 4}, {"obj_type": QUASAR, "size_disk": np.nan, "e1": np.nan},
    {"knots": 10_000, "knots_frac": 0.5}, {"knots": 3, "knots_frac": 0.0}, {"knots": 1, "knots_frac": 0.25},
    {"image_file": "a.fits", "bulge_frac": 0.0, "image_pa": -720.0},
    {"n_disk": 0.3, "n_bulge": 6.2}, {"n_disk": 99.0, "bulge_frac": 1.0, "n_bulge": 2.0},
    {"n_disk": 2.0, "n_bulge": np.nan, "bulge_frac": 0.0}, {"obj_type": STAR, "n_disk": 99.0, "n_bulge": 99.0},
])  # fmt: skip
def test_sound_objects_have_no_reason(row):
    default = {"n_disk": 1.0, "n_bulge": 4.0} if "n_disk" in row else {}
    default |= {"image_file": ""} if "image_file" in row else {}
    found = reasons(table(row, {}, **default))
    assert [reason for reason, mask in found.items() if mask.any()] == []


@pytest.mark.parametrize("row, reason", [
    ({"ra": np.nan}, PLACE), ({"ra": np.inf}, PLACE), ({"dec": -90.001}, PLACE), ({"dec": 90.001}, PLACE),
    ({"obj_type": 5}, KIND), ({"obj_type": -1}, KIND),
    ({"bulge_frac": -1e-3}, SHARE), ({"bulge_frac": np.nan}, SHARE),
    ({"e1": 1.0}, SHAPE), ({"e1": 0.8, "e2": -0.7}, SHAPE), ({"e2": np.nan}, SHAPE),
    ({"kappa": np.nan}, LENS), ({"gamma1": np.inf}, LENS), ({"gamma2": np.nan, "obj_type": QUASAR}, LENS),
    ({"kappa": 1.0}, STRONGLY_LENSED), ({"gamma2": 1.0, "obj_type": QUASAR}, STRONGLY_LENSED),
    ({"kappa": 0.5, "gamma1": 0.3, "gamma2": 0.41}, STRONGLY_LENSED),
    ({"size_disk": 0.0}, "a galaxy without size_disk (or size)"),
    ({"size_disk": np.nan}, "a galaxy without size_disk (or size)"),
    ({"size_bulge": -0.1}, "a galaxy without size_bulge (or size)"),
    ({"size_disk": 3601.0}, "a galaxy whose size_disk is above 3600 arcsec"),
    ({"size_bulge": 3601.0, "bulge_frac": 1e-3}, "a galaxy whose size_bulge is above 3600 arcsec"),
    ({"n_disk": 0.29}, f"a galaxy whose n_disk {INDEX}"), ({"n_disk": 6.21}, f"a galaxy whose n_disk {INDEX}"),
    ({"n_bulge": 0.29}, f"a galaxy whose n_bulge {INDEX}"), ({"n_bulge": np.nan}, f"a galaxy whose n_bulge {INDEX}"),
    (KNOTS | {"knots": 4, "knots_frac": 0.51}, TOGETHER), (KNOTS | {"knots": 4, "knots_frac": -0.01}, TOGETHER),
    (KNOTS | {"knots": 4, "knots_frac": np.nan}, TOGETHER),
    (KNOTS | {"knots": -1}, "a negative number of knots"),
    (KNOTS | {"knots": 10_001}, "a galaxy of more than 10000 knots"),
    (KNOTS | {"knots_frac": 0.1}, "a galaxy with knots_frac but no knots"),
    (KNOTS | {"knots": 1, "obj_type": STAR}, "a star or quasar with knots"),
    (KNOTS | {"knots_frac": 0.1, "obj_type": QUASAR}, "a star or quasar with knots"),
    (KNOTS | PICTURED | {"knots": 2, "knots_frac": 0.1}, "a galaxy with knots and an image"),
    (PICTURED | {"obj_type": STAR}, "a star or quasar with an image"),
    (PICTURED | {"bulge_frac": 0.1}, "a galaxy with an image and a bulge"),
    (PICTURED | {"image_pa": np.nan}, "a galaxy whose image_pa or image_scale is not a number"),
    (PICTURED | {"image_scale": np.inf}, "a galaxy whose image_pa or image_scale is not a number"),
])  # fmt: skip
def test_each_fault_has_its_reason_and_no_other_row_has_it(row, reason):
    columns = {"image_file": ""} if "image_file" in row else {}
    columns |= {"n_disk": 1.0, "n_bulge": 4.0} if {"n_disk", "n_bulge"} & set(row) else {}
    found = reasons(table({}, row, **columns))
    [(said, mask)] = [(said, mask) for said, mask in found.items() if mask.any()]
    assert said.startswith(reason) and mask.tolist() == [False, True]


def test_shapes_of_points_do_not_matter():
    rows = [{"obj_type": kind, "bulge_frac": 7.0, "e1": 3.0, "size_disk": np.nan} for kind in (STAR, QUASAR, 3, 4)]
    assert not np.any(list(reasons(table(*rows)).values()))


def test_what_has_no_sound_light_is_unusable_and_strong_lenses_have_a_flag_of_their_own():
    flux = np.ones((6, 4))
    flux[1, 2], flux[2, 3], flux[3] = np.nan, -1e-6, 0.0
    some = table({}, {}, {}, {}, {"kappa": 2.0}, {"size_disk": 0.0})
    assert unusable(some, flux).tolist() == [False, True, True, False, False, True]


def test_objects_that_are_not_drawn_are_counted_once():
    """Under their first reason; those without any have no light; drawn ones do not count."""
    both = {"ra": np.nan, "e1": 2.0}
    some = table(both, {"e1": 2.0}, {"e1": 2.0}, {}, {}, {"kappa": 2.0}, {"e2": 3.0})
    flags = np.zeros(7, np.int32)
    flags[4] = STRONG_LENSING
    dark = np.array([True, True, True, True, True, True, False])
    found = why_not_rendered(some.with_columns(flags=flags), dark)
    assert sorted(found.values()) == [1, 1, 2, 2] and sum(found.values()) == 6
    assert found[next(reason for reason in found if reason.startswith(PLACE))] == 1
    assert found[SHAPE] == 2 and found[STRONGLY_LENSED] == 2 and found[NO_LIGHT] == 1
    assert dark.sum() == 6  # the mask of the caller stays
