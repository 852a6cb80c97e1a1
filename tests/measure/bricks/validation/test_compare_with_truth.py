"""Statistics of merged sources and of trials, by hand: rows to the amplifier, blends, sizes, magnitudes, colours."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.csst import PIXEL

from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.measure.bricks.validation import compare
from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame, blended
from csstsim.measure.bricks.validation.trials import magnitude_at_fraction, trials


def truth_of(**columns):
    n = len(columns["x"])
    full = {
        "id": np.arange(n), "obj_type": np.full(n, STAR), "electrons": np.full(n, 1e5), "mag_r": np.full(n, 20.0),
        "blended": np.zeros(n, bool), "half_light": np.zeros(n),
        "half_light_px": np.zeros(n), "crowd": np.zeros(n),
    }  # fmt: skip
    return ObjectTable({name: np.asarray(values) for name, values in (full | columns).items()})


def test_rows_to_the_amplifier_and_charge_left_behind():
    """A chip of 20 rows: rows 0 and 19 are read first, 9 and 10 last. A trail lies away from either amplifier."""
    y = np.array([0.0, 9.0, 10.0, 19.0])
    truth = truth_of(x=np.full(4, 5.0), y=y)
    trail = np.array([0.1, 0.1, -0.1, -0.1])  # px, away from the amplifier
    measured = ObjectTable(
        {"x": np.full(4, 5.2), "y": y + trail, "flux_psf": np.full(4, 1e5), "flags": np.zeros(4, int)},
        {"filter": "r", "n_eff": 9.0, "rms": 7.0},
    )
    table = trials(truth, MeasuredFrame(truth, measured, seam=10, pixel=PIXEL))
    assert table["transfers"].tolist() == [0.0, 9.0, 9.0, 0.0]
    assert table["deferred_mas"] == pytest.approx(np.full(4, 7.4)) and table["across_mas"] == pytest.approx(14.8)


@pytest.mark.parametrize(("distance", "share", "spoilt"), [
    (5.0, 0.05, False), (5.0, 0.2, True), (35.0, 0.2, False), (35.0, 50.0, False), (35.0, 150.0, True),
    (45.0, 150.0, False),
])  # fmt: skip
def test_a_neighbour_matters_by_its_distance_and_light(distance, share, spoilt):
    x, y = np.array([100.0, 100.0 + distance]), np.array([50.0, 50.0])
    assert blended(x, y, np.array([1000.0, 1000.0 * share]))[0] == spoilt


def test_a_galaxys_half_light_radius_is_of_both_components():
    galaxy, star = truth_of(x=[1.0], y=[1.0]), truth_of(x=[1.0], y=[1.0])
    shape = {"size_disk": np.array([1.0]), "size_bulge": np.array([3.0]), "bulge_frac": np.array([0.25])}
    galaxy = galaxy.with_columns(obj_type=np.array([GALAXY]), **shape)
    assert compare.half_light(galaxy) == pytest.approx([1.5])
    assert compare.half_light(star.with_columns(**shape)) == pytest.approx([0.0])


def test_number_counts_are_of_sources_in_the_band():
    """Of ten bright objects one has no source and one a source without a detection in the band: 20% fewer."""
    truth = truth_of(x=np.arange(10.0), y=np.zeros(10))
    match = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, -1])
    sources = ObjectTable({
        "star": np.ones(9), "mag_r": np.full(9, 20.0), "total_mag_r": np.full(9, 20.0), "flux_r": np.full(9, 100.0),
        "flux_err_r": np.full(9, 0.1), "n_r": np.array([1] * 8 + [0]),
    })  # fmt: skip
    real, infos = np.ones(9, bool), [{"zeropoint": 31.5, "n_eff": 9.0, "rms": 7.7}]
    assert compare.counts("r", truth, sources, match, real, [19, 21], infos)["excess"] == pytest.approx(-0.2)
    real[0] = False  # nobody's, though one matches it: counted as false besides
    assert compare.counts("r", truth, sources, match, real, [19, 21], infos)["excess"] == pytest.approx(-0.1)


def test_a_spread_by_hand():
    """Deviations from the median 4 are 3, 2, 0, 4 and 12: their median is 3."""
    assert compare.spread(np.array([16.0, 1.0, 8.0, 2.0, 4.0])) == {
        "median": 4.0, "error": pytest.approx(1.2533 * 3 * 1.4826 / 5**0.5), "sigma": pytest.approx(3 * 1.4826), "n": 5,
    }  # fmt: skip
    assert compare.spread(np.array([2.5])) == {"median": 2.5, "error": None, "sigma": None, "n": 1}
    assert compare.spread(np.zeros(0)) == {"median": None, "error": None, "sigma": None, "n": 0}


INFOS = [{"zeropoint": z, "n_eff": n, "rms": r} for z, n, r in ((30.0, 9.0, 5.0), (31.0, 4.0, 4.0), (33.0, 40.0, 9.0))]


def test_the_true_signal_to_noise_is_that_of_the_median_exposure():
    """1600 electrons on 9 px, or on 45 of a galaxy of 2 px, of noise 5."""
    mag = 31.0 - 2.5 * np.log10(1600.0)
    truth = truth_of(x=[0, 1], y=[0, 0], mag_r=[mag, mag], half_light_px=[0.0, 2.0])
    assert compare.area_ratio(truth, 9.0) == pytest.approx([1.0, 5.0])
    assert compare.true_snr("r", truth, INFOS) == pytest.approx([1600 / 1825**0.5, 1600 / 2725**0.5])


def test_magnitudes_by_hand():
    """Stars by PSF and galaxies by total magnitudes; the S/N is of the true light on the pixels of the object."""
    rows = [  # kind, S/N, out - in of PSF, total, Kron; blended, saturated, matched
        (STAR, 100.0, 0.1, 9.0, 9.0, 0, 0, 1), (STAR, 100.0, 5.0, 9.0, 9.0, 1, 0, 1), (STAR, 100.0, 5, 9, 9, 0, 4, 1),
        (STAR, 100.0, 5.0, 9.0, 9.0, 0, 0, 0), (STAR, 19.9, 0.7, 9.0, 9.0, 0, 3, 1), (STAR, 501.0, 0.8, 9, 9, 0, 0, 1),
        (GALAXY, 9.9, 9.0, 1.0, 9.0, 0, 0, 1), (GALAXY, 10.1, 9.0, 2.0, 9.0, 0, 0, 1),
        (GALAXY, 19.9, 9.0, 4.0, 9.0, 0, 0, 1), (GALAXY, 20.1, 9.0, 6.0, 0.5, 0, 0, 1),
        (GALAXY, 60.1, 9.0, 8.0, 1.5, 0, 0, 1), (GALAXY, 499.0, 9.0, 16.0, np.nan, 0, 0, 1),
        (GALAXY, 501.0, 9.0, 32.0, 9.0, 0, 0, 1), (GALAXY, 50.0, 9.0, np.nan, 9.0, 0, 0, 1),
        (GALAXY, 50.0, 9.0, 7.0, 9.0, 1, 0, 1),
    ]  # fmt: skip
    kind, snr, psf, total, kron, near, flags, held = (np.array(v) for v in zip(*rows, strict=True))
    n, galaxy = len(rows), kind == GALAXY
    given = 20.0 + 0.1 * np.arange(n)
    truth = truth_of(x=np.arange(n), y=np.zeros(n), obj_type=kind, mag_r=given, blended=near.astype(bool),
                     half_light_px=np.where(galaxy, 2.0, 0.0))  # fmt: skip
    error = 10 ** (-0.4 * (given - 23.9)) / snr / np.where(galaxy, 5.0, 1.0) ** 0.5  # galaxies lie on 45 px, not 9
    order = np.arange(n)[::-1]  # sources in another order
    sources = {
        "mag_r": given + psf, "total_mag_r": given + total, "kron_mag_r": given + kron, "flux_err_r": error,
        "flags": flags,
    }  # fmt: skip
    sources = ObjectTable({name: values[order] for name, values in sources.items()})
    arrays, numbers = compare.magnitudes("r", truth, sources, np.where(held, order, -1), INFOS)
    assert arrays["star"][0] == pytest.approx([20.0, 20.4, 20.5])
    assert arrays["star"][1] == pytest.approx([0.1, 0.7, 0.8])
    assert arrays["galaxy"][1] == pytest.approx([1, 2, 4, 6, 8, 16, 32])
    assert (numbers["star"]["n"], numbers["star"]["median"]) == (1, pytest.approx(0.1))
    assert (numbers["galaxy"]["n"], numbers["galaxy"]["median"]) == (3, pytest.approx(8.0))
    assert (numbers["galaxy_kron"]["n"], numbers["galaxy_kron"]["median"]) == (2, pytest.approx(1.0))
    bins = [(part["snr"], part["n"], part["median"]) for part in numbers["galaxy_bins"]]
    assert bins == [([10, 20], 2, pytest.approx(3)), ([20, 60], 1, pytest.approx(6)), ([60, 500], 2, pytest.approx(12))]


def test_number_counts_have_blends_among_all_and_false_sources_by_their_measured_light():
    """Three isolated objects, all with a source; a blend; one too faint. Of two false sources one is bright."""
    truth = truth_of(
        x=np.arange(5.0), y=np.zeros(5), mag_r=[20.0, 20.5, 21.2, 20.1, 28.0], blended=[False] * 3 + [True, False]
    )
    sources = ObjectTable({
        "star": np.ones(6), "mag_r": np.array([20.1, 20.6, 21.1, 20.2, 22.5, np.nan]), "total_mag_r": np.full(6, 25.0),
        "flux_r": np.array([1.0, 1.0, 1.0, 1.0, 21.0, 19.0]), "flux_err_r": np.ones(6), "n_r": np.ones(6, int),
    })  # fmt: skip
    real = np.array([1, 1, 1, 1, 0, 0], bool)
    infos = [{"zeropoint": 31.5, "n_eff": 9.0, "rms": 7.7}]
    found = compare.counts("r", truth, sources, np.array([0, 1, 2, 3, -1]), real, [20, 21, 22, 23, 30], infos)
    assert found == {
        "edges": [20, 21, 22, 23, 30], "in": [3, 1, 0, 1], "out": [3, 1, 1, 0], "n": 3,
        "excess": pytest.approx(1 / 4),
    }  # fmt: skip


def test_lost_in_the_merge_are_those_an_exposure_had():
    truth = truth_of(x=np.arange(7.0), y=np.zeros(7), id=np.arange(10, 17), obj_type=[STAR] * 4 + [GALAXY] * 3)
    match = np.array([0, -1, -1, 3, -1, 5, -1])
    held = [np.array([10, 11, 12]), np.array([12, 13, 15])]
    assert compare.lost(truth, match, held) == {"stars": (0.5, 4), "galaxies": (0.0, 1)}
    assert compare.lost(truth, match, []) == {"stars": (None, 0), "galaxies": (None, 0)}


def test_residuals_of_places_are_to_the_east_and_north():
    """At declination 60 a step of right ascension is half as long."""
    n = 7
    ra, dec = 359.9999 + 0.00005 * np.arange(n), np.full(n, 60.0)
    truth = truth_of(x=np.arange(n), y=np.zeros(n), ra_epoch=ra % 360, dec_epoch=dec,
                     obj_type=[STAR, STAR, GALAXY, STAR, STAR, STAR, STAR],
                     blended=[False, False, False, True, False, False, False])  # fmt: skip
    sources = ObjectTable({
        "ra": (ra + 1e-3 / 3600 * np.arange(1, n + 1)) % 360, "dec": dec - 3e-3 / 3600 * np.arange(1, n + 1),
        "flux_g": np.array([30.0, np.nan, 30, 30, 30, 15, 30]), "flux_err_g": np.ones(n),
        "flux_r": np.array([1.0, 21.0, 30, 30, 30, 19, 30]), "flux_err_r": np.ones(n),
        "flags": np.array([1, 0, 0, 0, 4, 0, 0]),
    })  # fmt: skip
    match = np.array([0, 1, 2, 3, 4, 5, -1])
    east, north = compare.astrometry(truth, sources, match, ("g", "r"))
    assert east == pytest.approx([0.5, 1.0], abs=1e-4) and north == pytest.approx([-3.0, -6.0], abs=1e-4)
    assert len(compare.astrometry(truth, sources, match, ("g", "r"), 10.0)[0]) == 3
    assert len(compare.astrometry(truth, sources, match, ("r",), 25.0)[0]) == 0


def coloured(kinds):
    """Truth and sources of stars and galaxies in g, r and i: S/N and magnitudes of the PSF and of the aperture."""
    n = len(kinds)
    truth = truth_of(x=np.arange(n), y=np.zeros(n), obj_type=kinds, mag_g=np.full(n, 22.0), mag_r=np.full(n, 21.0),
                     mag_i=np.full(n, 20.75))  # fmt: skip
    sources = {"flags": np.zeros(n, int)}
    for band, off in (("g", 0.3), ("r", 0.1), ("i", -0.1)):
        for prefix, more in (("", 0.0), ("gaap_", off)):
            sources[f"{prefix}mag_{band}"] = truth[f"mag_{band}"] + off + more
            sources[f"{prefix}flux_{band}"] = np.full(n, 100.0)
            sources[f"{prefix}flux_err_{band}"] = np.full(n, 2.0)
    return truth, sources


def test_colours_of_stars_are_of_the_psf_and_of_galaxies_of_the_aperture():
    truth, sources = coloured([STAR, GALAXY, STAR, GALAXY, STAR, STAR])
    sources["flux_err_i"][2], sources["gaap_flux_err_r"][3] = 10.0, 11.0  # S/N 10 is not above 10
    sources["gaap_flux_err_g"][0] = 99.0  # a star's aperture does not matter
    truth["blended"][4], sources["flags"][5] = True, 4
    found = compare.colours(truth, ObjectTable(sources), np.arange(6), ("g", "r", "i"))
    assert found["input"] == pytest.approx(np.array([[1.0, 1.0], [0.25, 0.25]]))
    assert found["output"] == pytest.approx(np.array([[1.2, 1.4], [0.45, 0.65]]))
    assert found["bands"] == ("g", "r", "i") and found["galaxy"].tolist() == [False, True]
    assert compare.colours(truth, ObjectTable(sources), np.arange(6), ("g", "r", "i"), kind="star")["output"].shape == (
        2, 1,
    )  # fmt: skip
    assert compare.colours(truth, ObjectTable(sources), np.arange(6), ("g", "r"))["input"].shape == (2, 0)
    assert compare.colour_bands("abcd") == ("b", "c", "d") and compare.colour_bands("abc") == ("a", "b", "c")
    assert compare.colour_bands("nugrizy") == ("u", "g", "r") and compare.colour_bands("ab") == ("a", "b")


def test_galaxies_colours_are_binned_by_the_lower_signal_to_noise():
    truth, sources = coloured([GALAXY] * 7 + [STAR])
    for band, snr in (("g", (10, 19, 25, 9, 50, 50, 50, 50)), ("r", (90, 90, 20, 90, 90, 90, 501, 50))):
        sources[f"gaap_flux_{band}"], sources[f"gaap_flux_err_{band}"] = 2.0 * np.array(snr), np.full(8, 2.0)
    truth["blended"][4], sources["flags"][5] = True, 4
    sources["gaap_mag_g"] += np.array([0.1, 0.3, 0.5, 0, 0, 0, 0.7, 0])
    found = compare.galaxy_colours(truth, ObjectTable(sources), np.arange(8), ("g", "r", "i"))
    rows = [(part["bands"], part["snr"], part["n"], part["median"]) for part in found]
    assert rows[:2] == [
        (["g", "r"], [10, 20], 2, pytest.approx(0.6)), (["g", "r"], [20, 500], 2, pytest.approx(1.0)),
    ]  # fmt: skip
    assert rows[2] == (["r", "i"], [10, 20], 0, None) and rows[3][2:] == (5, pytest.approx(0.4))


def test_trials_of_a_star_and_a_galaxy_by_hand():
    """Every column of a star on 10 px and a galaxy on 55, of noise 2, found 0.1 and 0.3 px off."""
    truth = truth_of(
        x=[100.0, 200.0], y=[30.0, 40.0], electrons=[3600.0, 5000.0], mag_r=[21.0, 20.5], obj_type=[STAR, GALAXY],
        half_light_px=[0.0, np.sqrt(5.0)], crowd=[17.0, 25.0], ra_epoch=[10.0, 11.0], dec_epoch=[60.0, 60.0],
        ra=[10.1, 11.1], dec=[60.1, 60.1], e1=[0.0, 0.3], e2=[0.0, -0.2], g1=[0.0, 0.05], g2=[0.0, 0.1],
    )  # fmt: skip
    mas = 1 / 3.6e6
    measured = ObjectTable(
        {
            "x": np.array([100.1, 199.7]), "y": np.array([30.2, 40.4]), "flux_psf": np.array([3780.0, 4000.0]),
            "flux_psf_err": np.array([60.0, 100.0]), "flags": np.array([0, 32]), "snr": np.array([60.0, 40.0]),
            "ra": np.array([10.0 + 8 * mas, 11.0]), "dec": np.array([60.0 - 6 * mas, 60.0]),
            "pos_err": np.array([0.005, 0.01]), "hsm_sigma": np.array([1.53, 3.0]), "psf_sigma": np.full(2, 1.5),
            "hsm_e1": np.array([0.03, 0.1]), "hsm_e2": np.array([-0.01, 0.1]), "psf_e1": np.array([0.01, 0.0]),
            "psf_e2": np.array([0.02, 0.0]), "mag_psf": np.array([21.05, 20.7]), "mag_psf_err": np.array([0.02, 0.03]),
            "g1": np.array([0.4, 0.33]), "g2": np.array([0.4, -0.12]), "resolution": np.array([0.9, 0.8]),
        },
        {"filter": "r", "n_eff": 9.0, "rms": 2.0},
    )  # fmt: skip
    seen = {}

    def pixel_to_world(x, y):
        seen["at"] = x.tolist(), y.tolist()
        return np.array([10.1, 11.1]) + 2 * PIXEL / 3600 * np.array([1.0, 2.0]), np.array([60.1, 60.1 + PIXEL / 3600])

    facts = SimpleNamespace(full_well=399.0, wcs=SimpleNamespace(pixel_to_world=pixel_to_world))
    frame = MeasuredFrame(truth, measured, seam=1000, pixel=PIXEL, facts=facts)
    table = trials(truth, frame)
    snr = np.array([3600 / np.sqrt(3600 + 9 * 4), 5000 / np.sqrt(5000 + 54 * 4)])
    true = (0.3 - 0.2j + 0.05 + 0.1j) / (1 + (0.05 - 0.1j) * (0.3 - 0.2j))
    cosine = np.cos(np.radians(60.1))
    nan = np.nan
    expected = {
        "galaxy": [0, 1], "snr": snr, "mag": [21.0, 20.5], "found": [1, 1], "sound": [1, 1], "clean": [1, 0],
        "full": [1, 0], "x": [100.0, 200.0], "y": [30.0, 40.0], "transfers": [30.0, 40.0],
        "lonely": [0.3 * 3600 / snr[0] > 17, 0.3 * 5000 / snr[1] > 25], "light": [1.05, 0.8], "pull": [3.0, -10.0],
        "across_mas": [7.4, -22.2], "deferred_mas": [14.8, 29.6], "psf_size": [0.02, 1.0], "psf_e1": [0.02, 0.1],
        "psf_e2": [-0.03, 0.1], "mag_off": [0.05, 0.2], "mag_err": [0.02, 0.03], "east_mas": [4.0, 0.0],
        "north_mas": [-6.0, 0.0], "place_err": [5.0, 10.0], "true_g1": [nan, true.real], "true_g2": [nan, true.imag],
        "g1": [nan, 0.33], "g2": [nan, -0.12], "header_east": [2 * cosine, 4 * cosine], "header_north": [0.0, 1.0],
    }  # fmt: skip
    assert set(expected) == set(table.names)
    for name, values in expected.items():
        assert table[name] == pytest.approx(np.array(values, float), rel=1e-6, abs=1e-4, nan_ok=True), name
    assert seen["at"] == ([100.1, 199.7], [30.2, 40.4])
    dull = replace(frame, facts=replace_well(facts, 401.0))
    assert not trials(truth, dull)["full"].any()  # 3600 x 2 / 9 electrons at the peak, twice the well
    lost = replace(frame, measured=measured.take([1]))
    table = trials(truth, replace(lost, facts=None))
    assert table["found"].tolist() == [False, True] and np.isnan(table["pull"][0]) and table["pull"][1] == -10
    assert np.isnan(table["header_east"]).all() and not table["sound"][0] and not table["full"].any()


def replace_well(facts, full_well):
    return SimpleNamespace(full_well=full_well, wcs=facts.wcs)


@pytest.mark.parametrize(("flags", "sound", "clean", "shape"), [
    (1, 1, 1, 0), (2, 1, 1, 0), (4, 0, 0, 0), (8, 1, 1, 0), (16, 1, 1, 1), (32, 1, 0, 1), (64, 1, 0, 1),
    (128, 1, 0, 0), (256, 1, 0, 1),
])  # fmt: skip
def test_which_flags_spoil_a_trial(flags, sound, clean, shape):
    none = np.zeros(1)
    truth = truth_of(x=[5.0], y=[5.0], obj_type=[GALAXY], ra_epoch=none, dec_epoch=none, e1=none, e2=none, g1=none,
                     g2=none)  # fmt: skip
    names = "x", "y", "flux_psf", "flux_psf_err", "ra", "dec", "pos_err", "hsm_sigma", "psf_sigma", "hsm_e1", "hsm_e2"
    columns = {name: np.full(1, 5.0) for name in (*names, "psf_e1", "psf_e2", "g1", "g2", "resolution")}
    measured = ObjectTable(columns | {"flags": np.array([flags])}, {"filter": "r", "n_eff": 9.0, "rms": 7.0})
    table = trials(truth, MeasuredFrame(truth, measured, seam=10, pixel=PIXEL))
    assert (table["sound"][0], table["clean"][0], np.isfinite(table["g1"][0])) == (sound, clean, shape)


def test_the_magnitude_at_which_half_are_found():
    """Bins of a quarter magnitude with all, 0.8 and 0.3 found: half between their middles, 0.6 of the way."""
    mag = np.repeat([20.1, 20.3, 20.6, 20.9], [20, 20, 20, 5])
    found = np.concatenate([np.ones(20), np.arange(20) < 16, np.arange(20) < 6, np.ones(5)]).astype(bool)
    assert magnitude_at_fraction(mag, found) == pytest.approx(20.375 + 0.25 * 0.6)
    assert (
        magnitude_at_fraction(mag, np.ones(65, bool)) is None
        and magnitude_at_fraction(np.array([np.nan]), np.ones(1, bool)) is None
    )
    assert magnitude_at_fraction(np.append(mag, np.nan), np.append(found, False), fraction=0.9) == pytest.approx(
        20.125 + 0.25 * 0.5
    )
