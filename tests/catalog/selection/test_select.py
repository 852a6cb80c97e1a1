"""Selection of a chip's objects: which, how bright, how large, which flags; none vanishes."""

from dataclasses import replace

import healpy
import numpy as np
import pytest
from astropy.table import Table
from support.csst import BANDS, MARGIN
from support.embedded_sky import DENSITY, embedded_catalog

from csstsim.base.errors import InputError
from csstsim.base.units import ab_photon_density
from csstsim.campaign.sections import Lensing
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.changing.motion import Interval
from csstsim.catalog.flags import BAD_VALUE, STRONG_LENSING, TRUNCATED_STAMP
from csstsim.catalog.light.photometry import rate_to_mag, subband_fluxes
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.selection.bricks import region_for
from csstsim.catalog.selection.positions import objects_near, reaches_window, visible_time
from csstsim.catalog.selection.select import ChipView, Noise, select_objects
from csstsim.catalog.table import ObjectTable, columns_with
from csstsim.catalog.truth_bricks import ID_BITS
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.scatter.scattered_light import scattered_light

CHIP, WINDOW = 9, Window(4000, 4600, 3000, 3500)  # r band
NOISE = Noise(sky=0.207, dark=0.02, read_noise=5.0)
ADDED = (
    "ra_orig",
    "dec_orig",
    "ra_epoch",
    "dec_epoch",
    "x",
    "y",
    "mag",
    "flux0",
    "flux1",
    "flux2",
    "flux3",
    "reach",
    "flags",
)


class Flat(CatalogBase):
    """Objects handed over in options, each of flat f_nu at AB magnitude `ab`."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        self.objs.extend(self.options["objects"])

    def load_sed(self, obj):
        return Table({"WAVELENGTH": GRID, "FLUX": ab_photon_density(GRID, obj.ab)})

    def load_norm_filt(self, obj):
        return None


def view_of(camera, wcs, craft, window=WINDOW, **more):
    return ChipView(wcs, craft, window, camera.filters["r"], camera.telescope, 150.0, NOISE, **more)


@pytest.fixture
def pick(camera, make_pointing, observe):
    """Select from Flat objects placed at pixels of a pointing; (x, y) in the objects' place of ra, dec."""

    def run(objects, window=WINDOW, mag_limit=None, scattered=None, interval=None, **pointing):
        pointing = make_pointing(**pointing)
        wcs, craft = ChipWCS(camera.chips[CHIP], pointing), observe(pointing)
        placed = []
        for x, y, values in objects:
            ra, dec = icrs(*wcs.pixel_to_world(x, y), craft)
            placed.append(MockObject(**({"ra": float(ra), "dec": float(dec)} | values)))
        catalog = Flat({"objects": placed}, Region((), (), (), BANDS))
        seen = view_of(camera, wcs, craft, window, scattered=scattered, interval=interval)
        return select_objects(catalog, seen, mag_limit)

    return run


def star(ab=22.0, **values):
    return {"type": "star", "ab": ab} | values


def galaxy(ab=22.0, **values):
    return {"type": "galaxy", "ab": ab, "size_disk": 0.4, "size_bulge": 0.3, "bulge_frac": 0.1} | values


def test_empty_catalogue_gives_an_empty_table_with_all_columns(pick):
    table = pick([])
    assert (
        len(table) == 0
        and table.names[: len(columns_with(BANDS))] == tuple(columns_with(BANDS))
        and set(ADDED) <= set(table)
    )
    assert table.meta["dropped"] == {"outside": 0, "faint": 0}


@pytest.mark.parametrize(("ra", "dec"), [(60.0, -40.0), (0.0, 5.0), (359.9999, -10.0), (10.0, 90.0), (200.0, -89.99)])
def test_one_star_anywhere_on_the_sky(pick, camera, ra, dec):
    table = pick([(4100.25, 3100.5, star(20.0, id=3))], ra=ra, dec=dec)
    assert len(table) == 1 and table["id"][0] == 3 and table["flags"][0] == 0
    assert (table["x"][0], table["y"][0]) == pytest.approx((4100.25, 3100.5), abs=1e-6)  # pixel
    assert table["mag"][0] == pytest.approx(20.0, abs=1e-5)
    rate = sum(table[f"flux{i}"][0] for i in range(4))
    assert rate_to_mag(rate, camera.filters["r"], camera.telescope) == pytest.approx(20.0, abs=1e-6)


def test_stamps_decide_who_is_in(pick):
    faint, bright = 32, 64  # pixel: reach of a faint and of a bright star
    x0 = WINDOW.x0 - 0.5
    table = pick([
        (x0 - faint + 0.1, 3200, star(27, id=1)), (x0 - faint - 0.1, 3200, star(27, id=2)),
        (x0 - bright + 0.1, 3200, star(15, id=3)), (x0 - bright - 0.1, 3200, star(15, id=4)),
        (x0 - 500, 3200, galaxy(14, id=5, size_disk=8.0)), (x0 - 500, 3200, galaxy(24, id=6)),
        (x0 + 10, WINDOW.y1 + 2000, galaxy(10, id=7, size_disk=60.0)),
        (x0 + 10, WINDOW.y1 + 2100, galaxy(10, id=8, size_disk=60.0)),
    ])  # fmt: skip
    assert list(table["id"]) == [1, 3, 5, 7]
    assert table.meta["dropped"] == {"outside": 4, "faint": 0}
    assert table["flags"][3] & TRUNCATED_STAMP and table["reach"][3] == 2048


def test_wings_and_ghosts_bring_bright_stars_from_outside(pick, camera):
    """A star of mag 15 by its wing of some 600 px, of mag 10 from anywhere near, the ghosts of one of mag 13 anyhow."""
    whole = scattered_light(camera, camera.filters["r"])
    x0 = WINDOW.x0 - 0.5
    stars = [
        (x0 - 300, 3200, star(15, id=1)), (x0 - 800, 3200, star(15, id=2)), (x0 - 2000, 3200, star(10, id=3)),
        (x0 - 2100, 3200, star(5, id=4)), (x0 + 10, 3200, star(24, id=5)), (x0 - 700, 3200, star(14.9, id=6)),
        (x0 - 80, 3200, galaxy(16, id=7)),
    ]  # fmt: skip
    table = pick(stars, scattered=whole)
    assert list(table["id"]) == [1, 3, 5, 6, 7]
    wing = dict(zip(table["id"], table["wing"], strict=True))
    assert wing[5] == 0 and 400 < wing[1] < 800 and 2500 < wing[3] < 4000 and wing[7] > 100
    assert list(table["reach"][:2]) == [64, 64] and 16 < table["reach"][2] < 64
    assert not (table["flags"] & TRUNCATED_STAMP).any()
    ghostless = pick(stars, scattered=replace(whole, ghosts=None))
    assert list(ghostless["id"]) == [1, 3, 5, 7]
    huge = pick([(4100, 3200, star(-5, id=8))], scattered=whole)
    assert huge["wing"][0] > 1e4 and not huge["flags"][0] & TRUNCATED_STAMP  # a wing has no end


def test_object_behind_the_sky_is_outside(pick):
    table = pick([(0, 0, star(15, ra=240.0, dec=40.0))])
    assert len(table) == 0 and table.meta["dropped"]["outside"] == 1


def test_stars_move_and_nothing_else_does(pick):
    """27.48 years at 200 mas / yr eastward and -100 northward, on the sky and in pixels; NaN is no motion."""
    moving = {"pmra": 200.0, "pmdec": -100.0, "parallax": 0.0, "rv": 0.0}
    unknown = {"pmra": np.nan, "pmdec": np.nan, "parallax": -1.0, "rv": np.nan}
    quasar = star(20.0) | moving | {"type": "quasar"}
    table = pick([(4300, 3250, v) for v in (star(20.0) | moving, galaxy() | moving, quasar, star(20.0) | unknown)])
    assert len(table) == 4 and len(set(table["ra_orig"])) == len(set(table["dec_orig"])) == 1
    assert table["x"][1:] == pytest.approx(4300, abs=1e-6) and table["y"][1:] == pytest.approx(3250, abs=1e-6)
    moved = np.hypot(table["x"][0] - 4300, table["y"][0] - 3250) * 0.074
    assert moved == pytest.approx(27.482 * np.hypot(0.2, 0.1), rel=2e-4)  # arcsec; the boost stretches by 1e-4
    east = (table["ra_epoch"] - table["ra_orig"]) * np.cos(np.radians(table["dec_orig"])) * 3600
    north = (table["dec_epoch"] - table["dec_orig"]) * 3600
    assert (east[0], north[0]) == pytest.approx((5.4964, -2.7482), rel=1e-3)
    assert np.abs([east[1:], north[1:]]).max() < 1e-9
    shift = np.hypot(
        (table["ra"] - table["ra_epoch"]) * np.cos(np.radians(table["dec"])), table["dec"] - table["dec_epoch"]
    )
    assert shift.min() * 3600 > 1.0 and shift.max() * 3600 < 26.2


def test_magnitude_limit_is_the_chips_own_band(pick):
    table = pick([(4100, 3100, star(ab, id=k)) for k, ab in enumerate((24.0, 25.9, 26.1))], mag_limit=26.0)
    assert list(table["id"]) == [0, 1] and table.meta["dropped"] == {"outside": 0, "faint": 1}


def test_lensing_magnifies_galaxies_only(pick):
    field = {"kappa": 0.1, "gamma1": 0.05, "mag_g": 23.0}
    table = pick(
        [(4100, 3100, galaxy(22, **field)), (4200, 3100, star(22, **field)), (4300, 3100, galaxy(22, kappa=1.2))]
    )
    mu = 1 / (0.9**2 - 0.05**2)
    assert table["mag"][0] == pytest.approx(22 - 2.5 * np.log10(mu), abs=1e-5)
    assert table["mag_g"][0] == pytest.approx(23 - 2.5 * np.log10(mu), abs=1e-5) and table["mag_g"][1] == 23.0
    assert table["mag"][1] == pytest.approx(22.0, abs=1e-5)
    assert list(table["flags"]) == [0, 0, STRONG_LENSING] and np.isfinite(table["flux0"]).all()


@pytest.mark.parametrize(
    "wrong",
    [{"ab": np.nan}, {"ab": -np.inf}, {"size_disk": np.nan}, {"size_disk": -1.0}, {"bulge_frac": 2.0}, {"e1": 1.0},
     {"e2": np.nan}, {"kappa": np.nan}, {"gamma1": np.inf}, {"ra": np.nan}, {"dec": np.inf}, {"dec": 91.0},
     {"obj_type": 7}],
)  # fmt: skip
def test_bad_values_are_flagged_dark_and_kept(pick, wrong):
    """Warnings are errors here, so no NaN goes through arithmetic unseen either."""
    values = galaxy() | wrong
    values = {k: v for k, v in values.items() if not (k == "type" and "obj_type" in wrong)}
    values |= {"dec": wrong["dec"], "ra": 60.0} if wrong.get("dec") == 91.0 else {}
    table = pick([(4100, 3100, values), (4200, 3100, star(20.0))])
    kept = table["flags"] == BAD_VALUE
    assert kept.sum() == (0 if wrong.get("dec") == 91.0 else 1)  # a place that is not on the sky is not on the window
    assert (table["flags"][~kept] == 0).all() and (~kept).sum() == 1
    assert all(not table[f"flux{i}"][kept].any() for i in range(4))
    assert len(table) + sum(table.meta["dropped"].values()) == 2


def test_unknown_sizes_do_not_matter_where_they_are_not_used(pick):
    table = pick(
        [(4100, 3100, galaxy(size_bulge=np.nan, bulge_frac=0.0)), (4100, 3100, star(size_disk=np.nan, e1=2.0))]
    )
    assert list(table["flags"]) == [0, 0]


@pytest.fixture(scope="module")
def sky(camera, make_pointing, observe, tmp_path_factory):
    """A window of the embedded universe around RA 0: catalogue, WCS, observer."""
    pointing = make_pointing(ra=0.0, dec=-5.0)
    wcs, craft = ChipWCS(camera.chips[CHIP], pointing), observe(pointing)
    field = Lensing(field="constant", kappa=0.05, gamma1=0.03)
    region = region_for(*icrs(*wcs.footprint(WINDOW), craft), MARGIN, BANDS)
    return embedded_catalog(tmp_path_factory.mktemp("truth"), region, field), wcs, craft


def test_embedded_window_holds_the_sky_it_should(camera, sky):
    catalog, wcs, craft = sky
    table = select_objects(catalog, view_of(camera, wcs, craft))
    inside = WINDOW.contains(table["x"], table["y"])
    area = WINDOW.nx * WINDOW.ny * (0.074 / 60) ** 2  # arcmin2
    assert abs((inside & (table["obj_type"] == 1)).sum() - DENSITY * area) < 5 * np.sqrt(DENSITY * area)
    assert (~inside).any() and len(np.unique(table["id"])) == len(table)
    np.testing.assert_array_equal(
        healpy.ang2pix(256, table["ra_orig"], table["dec_orig"], nest=True, lonlat=True), table["id"] >> ID_BITS
    )
    np.testing.assert_allclose(table["mag"], table["mag_r"], atol=2e-3)  # mag
    assert len(table) + sum(table.meta["dropped"].values()) == len(catalog.table)
    again = select_objects(catalog, view_of(camera, wcs, craft))
    assert again == table


def test_selection_agrees_with_brute_force(camera, sky):
    """Every object whose stamp meets the window is in, found again from the table of a window that holds it whole."""
    catalog, wcs, craft = sky
    wide = select_objects(catalog, view_of(camera, wcs, craft, Window(2500, 6000, 1500, 5000)))
    meets = (np.abs(wide["x"] - 4299.5) <= 300 + wide["reach"]) & (np.abs(wide["y"] - 3249.5) <= 250 + wide["reach"])
    narrow = select_objects(catalog, view_of(camera, wcs, craft))
    assert set(wide["id"][meets]) <= set(narrow["id"])
    far = set(narrow["id"]) - set(wide["id"][meets])
    assert not far & set(wide["id"])


@pytest.mark.parametrize("band", BANDS)
def test_embedded_spectra_reproduce_the_magnitudes(camera, sky, band):
    catalog, *_ = sky
    stars = np.flatnonzero(catalog.table["obj_type"] == 0)
    galaxies = np.flatnonzero(catalog.table["obj_type"] == 1)
    rows = np.concatenate([stars[:: len(stars) // 60], galaxies[:: len(galaxies) // 120]])
    filter_ = next(f for name, f in camera.filters.items() if name.lower() == band)
    direct = subband_fluxes(catalog.load_seds(rows), filter_, camera.telescope)
    mag = rate_to_mag(direct.sum(axis=1), filter_, camera.telescope)
    table = catalog.table.take(rows)[f"mag_{band}"]
    seen = table < 35  # beyond, a spectrum the Lyman limit has put out
    np.testing.assert_allclose(mag[seen], table[seen], atol=2e-3)  # mag
    fast = catalog.load_fluxes(rows, filter_, camera.telescope)
    np.testing.assert_allclose(fast[seen], direct[seen], atol=2e-3 * direct[seen].sum(axis=1).max(initial=0), rtol=6e-3)


def test_embedded_load_sed_is_the_papers_table(sky):
    catalog, *_ = sky
    for row in (0, len(catalog.table) - 1):  # a star, a galaxy
        sed = catalog.load_sed(catalog.objs[row])
        assert sed.colnames == ["WAVELENGTH", "FLUX"] and len(sed) == 18001
        assert (sed["WAVELENGTH"][0], sed["WAVELENGTH"][-1]) == (2000.0, 11000.0)
        np.testing.assert_array_equal(sed["FLUX"], catalog.load_seds([row])[0])
        assert catalog.load_norm_filt(catalog.objs[row]) is None


def test_what_magnitudes_rule_out_would_not_have_been_there(camera, sky):
    """With `rate_bound` the same rows, from half as many spectra; and no rate is above its bound."""
    catalog, wcs, craft = sky
    seen = view_of(camera, wcs, craft)
    summed = []
    with pytest.MonkeyPatch.context() as patch:
        load = catalog.load_fluxes
        patch.setattr(catalog, "load_fluxes", lambda rows, *how: summed.append(len(rows)) or load(rows, *how))
        quick = select_objects(catalog, seen)
        rows = np.arange(len(catalog.table))
        for name, most in {"r": 1.06, "GU": 6.0, "GV": 1.7, "GI": 1.4}.items():  # most: median of bound / electrons
            how = rows, camera.filters[name], camera.telescope
            bound, true = catalog.rate_bound(*how), load(*how).sum(axis=1)
            assert (true <= bound + 1e-6).all() and np.median(bound / np.maximum(true, 1e-9)) < most  # electron / s
        patch.setattr(catalog, "rate_bound", lambda *_: None)
        every = select_objects(catalog, seen)
    assert summed[0] < 0.5 * summed[1]
    assert quick.meta["dropped"] == every.meta["dropped"]
    for name in every.names:
        if name.startswith("flux"):  # the mean dust of all is taken first, hence other last bits
            assert quick[name] == pytest.approx(every[name], rel=1e-7)
        else:
            assert np.array_equal(quick[name], every[name], equal_nan=every[name].dtype.kind == "f")


def test_the_variance_of_a_pixel_is_of_all_that_it_counts():
    assert Noise(sky=0.2, dark=0.02, read_noise=5.0).variance(100.0) == pytest.approx(0.2 * 100 + 0.02 * 100 + 25)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_light_lands_on_a_window_from_edge_to_edge(axis):
    """Half a pixel before its first pixel counts as on it, half a pixel behind its last one does not."""
    window = Window(10, 20, 10, 20)
    ends = np.array([9.49, 9.5, 19.49, 19.5, 6.49, 6.5, 22.49, 22.5, np.nan])
    far = np.array([0, 0, 0, 0, 3, 3, 3, 3, 9.0])
    places = {"x": np.full(9, 15.0), "y": np.full(9, 15.0)} | {axis: ends}
    assert reaches_window(places, far, window, None).tolist() == [
        False,
        True,
        True,
        False,
        False,
        True,
        True,
        False,
        False,
    ]


class Slit:
    """Light of a position is in a box 100 px to the right, and in one 40 px to the left if x is above 30."""

    def visits(self, x, y, far):
        rows = np.concatenate([np.arange(len(x)), np.flatnonzero(x > 30)])
        return np.stack([rows, np.repeat([0, 1], [len(x), len(rows) - len(x)]), 0 * rows], axis=1)

    def boxes(self, visits, x, y):
        at = visits[:, 0]
        shift = np.where(visits[:, 1] == 0, 100.0, -40.0)
        box = [x[at] + shift, x[at] + shift + 10.0, y[at] + 2.0, y[at] + 4.0]
        return np.stack([np.stack(box, axis=1), np.full((len(at), 4), np.nan)], axis=1)


def test_dispersed_light_lands_where_its_boxes_do():
    """Window of 0..10: each side of a box with and without reach; the other order's box is NaN."""
    window, far = Window(0, 10, 0, 10), np.array([0.0, 0, 0, 0, 0, 3, 0, 0, 3, 0, 3])
    x = np.array([-110.4, -110.6, -90.6, -90.4, 40.0, 46.0, 46.0, -100.0, -100.0, -100.0, -100.0])
    y = np.array([5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 60.0, -4.6, -4.6, 7.6, 7.6])
    wanted = [True, False, True, False, True, True, False, False, True, False, True]
    assert reaches_window({"x": x, "y": y}, far, window, Slit()).tolist() == wanted


def test_a_trail_lands_by_its_places_along_it():
    """Imaged: where it crosses the window; dispersed: where the boxes of any of its places do; still ones as ever."""
    window, ends = Window(0, 10, 0, 10), {"x0": [-50.0, -50, 0, -300], "y0": [5.0, 50, 0, 5]}
    ends |= {"x1": [50.0, 50, 0, -150], "y1": [5.0, 50, 0, 5]}
    places = {f"trail_{name}": np.array(v) for name, v in ends.items()}
    places |= {"x": np.array([500.0, 500, 5, 500]), "y": np.full(4, 5.0), "trail_length": np.array([7.4, 7.4, 0, 11.1])}
    far = np.zeros(4)
    assert reaches_window(places, far, window, None).tolist() == [True, False, True, False]
    assert reaches_window(places, np.full(4, 45.0), window, None).tolist() == [True, True, True, False]
    passing = {name: np.array([value]) for name, value in (
        ("trail_x0", -300.0), ("trail_y0", 5.0), ("trail_x1", 100.0), ("trail_y1", 5.0), ("x", 500.0), ("y", 500.0),
        ("trail_length", 29.6),
    )}  # fmt: skip
    assert (
        reaches_window(passing, np.zeros(1), window, Slit())[0]
        and reaches_window(places, far, window, Slit()).tolist()[2:] == [False] * 2
    )


def test_the_time_that_decides_is_that_near_one_place():
    """64 px of a trail at most; of what stays the whole exposure."""
    still = {"x": np.zeros(3)}
    assert visible_time(still, 150.0, 0.074).tolist() == [150.0] * 3
    places = {"x": np.zeros(4), "trail_start": np.array([10.0, 10.0, 0.0, np.nan])}
    places |= {"trail_end": np.array([50.0, 50.0, 9.0, np.nan])}
    places |= {"trail_length": np.array([32 * 0.074, 256 * 0.074, 0.0, np.nan])}
    assert visible_time(places, 150.0, 0.074) == pytest.approx([40.0, 10.0, 150.0, 150.0])


def test_who_could_reach_a_window_by_place_alone(camera, make_pointing, observe):
    """Within 2048 px of it, with a grating's reach further; places that are none are kept; stars alone move."""
    pointing = make_pointing()
    wcs, craft = ChipWCS(camera.chips[CHIP], pointing), observe(pointing)
    offsets = np.array([-2048.4, -2048.6, -3047.0, -3050.0])
    x, y = WINDOW.x0 + offsets, np.full(4, 3100.0)
    ra, dec = icrs(*wcs.pixel_to_world(x, y), craft)
    table = ObjectTable.complete(
        {"id": np.arange(5), "obj_type": 1, "ra": [*ra, np.nan], "dec": [*dec, 0.0], "pmra": 1e5}, BANDS
    )
    rows, positions = objects_near(table, wcs, craft, WINDOW)
    assert rows.tolist() == [0, 4] and positions["x"][0] == pytest.approx(x[0], abs=1e-5)
    assert np.isnan([values[1] for values in positions.values()]).all()
    assert objects_near(table, wcs, craft, WINDOW, dispersed=1000.0).rows.tolist() == [0, 1, 2, 4]
    rows, positions = objects_near(table, wcs, craft, WINDOW, interval=Interval(pointing.mjd, 150.0))
    assert rows.tolist() == [0, 4] and "trail_length" not in positions
    moving = table.with_columns(
        rate_ra=np.array([0.0, 0, 0, 500.0, 0]), rate_dec=np.zeros(5), trail_width=np.zeros(5),
        rate_mjd=np.full(5, pointing.mjd - 0.5 / 24),
    )  # fmt: skip
    moving["dec"][3], moving["ra"][3] = dec[0], ra[0] - 0.07 / np.cos(np.radians(dec[0]))
    rows, positions = objects_near(moving, wcs, craft, WINDOW, interval=Interval(pointing.mjd, 150.0))
    assert rows.tolist() == [0, 3, 4] and positions["trail_length"][0] == 0.0
    assert positions["trail_length"][1] == pytest.approx(500 * 150 / 3600) and np.isfinite(positions["trail_x1"][1])


def test_what_moves_is_looked_for_as_far_as_a_grating_reaches(camera, make_pointing, observe):
    """A slow object 2900 px beside the window, as a still one: near it if a grating sends light 1000 px away."""
    pointing = make_pointing()
    wcs, craft = ChipWCS(camera.chips[CHIP], pointing), observe(pointing)
    ra, dec = icrs(*wcs.pixel_to_world(np.full(2, WINDOW.x0 - 2900.0), np.full(2, 3250.0)), craft)
    columns = {"id": np.arange(2), "obj_type": 0, "ra": ra, "dec": dec, "rate_mjd": np.full(2, pointing.mjd)}
    columns |= {"rate_ra": np.array([30.0, 0.0]), "rate_dec": np.zeros(2), "trail_width": np.zeros(2)}
    table, interval = ObjectTable.complete(columns, BANDS), Interval(pointing.mjd, 150.0)
    for dispersed, wanted in ((1000.0, [0, 1]), (0.0, [])):
        assert objects_near(table, wcs, craft, WINDOW, dispersed, interval).rows.tolist() == wanted


def test_a_trail_reaches_as_far_as_a_still_star_of_the_light_near_a_point(pick, camera):
    """600 px in the exposure: in stamp and wing a star fainter by 64 / 600, whatever is left of it elsewhere."""
    interval = Interval(61217.858, 150.0)
    moves = {"rate_ra": 600 * 0.074 * 24.0, "rate_dec": 0.0, "rate_mjd": interval.middle, "trail_width": 0.0}
    stars = [star(9, id=1) | moves, star(9 + 2.5 * np.log10(600 / 64), id=2), star(9, id=3)]
    scattered = scattered_light(camera, camera.filters["r"])
    table = pick([(4300, 3250, values) for values in stars], interval=interval, scattered=scattered)
    assert table["id"].tolist() == [1, 2, 3] and table["mag"][0] == table["mag"][2]
    for name in ("reach", "wing"):
        trailed, fainter, still = table[name]
        assert trailed == pytest.approx(fainter, rel=1e-3) and still > 0, name
    assert table["wing"][2] > 1.2 * table["wing"][0] > 0


def test_light_that_varies_is_dimmer_and_says_so(pick):
    """A sine at its faintest: 0.3 mag in light and magnitude; what the catalogue says of its bands stays."""
    interval = Interval(61217.858, 150.0)
    phase = 0.25 - (interval.middle / 10.0) % 1.0
    varies = {"var_period": 10.0, "var_amplitude": 0.3, "var_phase": phase, "mag_g": 21.0}
    objects = [(4100, 3100, star(20.0, id=1) | varies), (4200, 3100, star(20.0, id=2, mag_g=21.0))]
    table, plain = pick(objects, interval=interval), pick(objects)
    assert table["dmag"] == pytest.approx([0.3, 0.0], abs=1e-6) and "dmag" not in plain
    assert table["mag"] == pytest.approx([20.3, 20.0], abs=1e-5) and plain["mag"] == pytest.approx(20.0, abs=1e-5)
    for k in range(4):
        assert table[f"flux{k}"] == pytest.approx(plain[f"flux{k}"] * [10**-0.12, 1.0], rel=1e-6)
    assert table["mag_g"].tolist() == [21.0, 21.0]


def test_flags_of_catalogue_and_selection_are_joined(pick):
    """A cut stamp, a strong lens, a value that is bad, each with a flag that the catalogue gave."""
    table = pick([
        (4100, 3100, galaxy(10, id=1, size_disk=60.0, flags=4)), (4200, 3100, galaxy(22, id=2, kappa=2.0, flags=1)),
        (4200, 3150, galaxy(22, id=3, e1=2.0)), (4250, 3150, star(22, id=4, kappa=2.0, flags=16)),
    ])  # fmt: skip
    assert table["flags"].tolist() == [4 | TRUNCATED_STAMP, 1 | STRONG_LENSING, BAD_VALUE, 16]
    assert table["flags"].dtype == np.int32


def test_faint_objects_are_counted_apart_from_those_outside(pick):
    """An object at the limit is in; those beyond the window are outside, however faint."""
    objects = [(4100, 3100, star(25.0, id=1)), (4100, 3100, star(27.0, id=2)), (100, 100, star(27.0, id=3)),
               (100, 100, star(20.0, id=4)), (4300, 3300, star(27.0, id=5))]  # fmt: skip
    table = pick(objects, mag_limit=26.0)
    assert table["id"].tolist() == [1] and table.meta["dropped"] == {"outside": 2, "faint": 2}
    assert len(table.meta["truth_hash"]) == 16
    assert len(pick(objects)) == 3


def test_light_of_each_object_is_in_its_own_row(pick, camera):
    """Ids that fall, so that sums are made in another order: magnitude and light belong to the id."""
    ids = [9, 2, 7, 4]
    table = pick([(4100 + 20 * k, 3100, star(18.0 + number / 2, id=number)) for k, number in enumerate(ids)])
    assert table["id"].tolist() == ids and table["x"] == pytest.approx(4100 + 20.0 * np.arange(4), abs=1e-4)
    assert table["mag"] == pytest.approx(18.0 + np.array(ids) / 2, abs=1e-5)


class Bounded(Flat):
    """Objects that say by how much they are fainter (`dmag`), with a bound of their light unless `bound` is false."""

    def rate_bound(self, rows, filter, telescope):
        return 1.01 * self.load_fluxes(rows, filter, telescope).sum(axis=1) if self.options["bound"] else None

    def dimming(self, rows, interval, filter):
        return self.table["user_dmag"][rows]

    def component_shares(self, rows, filter):
        numbers = self.table["id"][rows] / 100
        return {"bulge_frac": numbers.astype(np.float32), "knots_frac": np.zeros(len(rows), np.float32)}


def bounded(camera, make_pointing, observe, objects, bound=True):
    pointing = make_pointing()
    wcs, craft = ChipWCS(camera.chips[CHIP], pointing), observe(pointing)
    placed = []
    for x, y, values in objects:
        ra, dec = icrs(*wcs.pixel_to_world(x, y), craft)
        placed.append(MockObject(**({"ra": float(ra), "dec": float(dec), "dmag": 0.0} | values)))
    catalog = Bounded({"objects": placed, "bound": bound}, Region((), (), (), BANDS))
    return select_objects(catalog, view_of(camera, wcs, craft, interval=Interval(pointing.mjd, 150.0)))


def test_a_bound_of_the_light_is_before_lenses_and_changes(camera, make_pointing, observe):
    """Faint points 50 px beside the window whose stamps reach it because they brighten, or are magnified by 5 mag."""
    x0 = WINDOW.x0 - 50.0
    objects = [
        (x0, 3200, star(27, id=1)), (x0, 3210, star(27, id=2, dmag=-7.0)), (x0, 3220, star(27, id=3, kappa=0.9)),
        (x0, 3230, {"type": "quasar", "ab": 27, "id": 4, "kappa": 0.9}), (x0, 3240, star(20, id=5, dmag=7.0)),
        (x0, 3250, star(20, id=6)), (x0, 3260, {"type": "quasar", "ab": 27, "id": 7}),
    ]  # fmt: skip
    tables = [bounded(camera, make_pointing, observe, objects, bound) for bound in (True, False)]
    assert tables[0]["id"].tolist() == [2, 4, 6] and tables[0] == tables[1]


def test_fractions_of_components_are_those_of_the_band(camera, make_pointing, observe):
    """Of each row of the catalogue its own, whichever of them are near."""
    objects = [(4100, 3100, galaxy(20, id=10)), (0, 0, galaxy(20, id=20)), (4200, 3100, galaxy(20, id=30))]
    table = bounded(camera, make_pointing, observe, objects)
    assert table["id"].tolist() == [10, 30] and table["bulge_frac"] == pytest.approx([0.1, 0.3])


def test_what_a_class_returns_is_checked(camera, make_pointing, observe):
    """A number for all rows, from `dimming` or `component_shares`, is one line with class and method."""
    for method in ("dimming", "component_shares"):
        with pytest.MonkeyPatch.context() as patch, pytest.raises(InputError, match=rf"Bounded\.{method}: "):
            patch.setattr(Bounded, method, lambda *given: 0.3)
            bounded(camera, make_pointing, observe, [(4100, 3100, galaxy(20, id=10))])
