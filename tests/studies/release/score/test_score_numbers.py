"""Numbers of a score, of objects and sources set by hand: who counts, in which bin, with which sign and error."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from release.score_field import offset_positions
from scipy.stats import linregress

from csstsim.base.errors import InputError
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable
from csstsim.inject.recovery.bins import fraction
from csstsim.studies.release.score import figures, statistics
from csstsim.studies.release.score.catalogue import Catalogue, read_catalogue, read_table
from csstsim.studies.release.score.field import Field, read_field, read_frames
from csstsim.studies.release.score.match import Match, brightness, match_sources
from csstsim.studies.release.score.missing import without_missing
from csstsim.studies.release.score.page import _sections, write_page
from csstsim.studies.release.score.quantities import ABOUT, KINDS, Key, parse_key, to_first_unit
from csstsim.studies.release.score.score import _column_map, _json_value, evaluate, score
from csstsim.studies.release.score.summary import summary_lines

RA, DEC = 150.0, 60.0
NAN = np.nan


def truth_of(east, north=None, **columns):
    """Stars of magnitude 20 in r and S/N 100 at offsets [arcsec]."""
    n = len(east)
    ra, dec = offset_positions(
        RA, DEC, np.asarray(east, float), np.zeros(n) if north is None else np.asarray(north, float)
    )
    given = {"ra": ra, "dec": dec, "id": np.arange(n), "obj_type": np.full(n, STAR, np.int8), "size": np.zeros(n)}
    given |= {name: np.zeros(n) for name in ("z", "e1", "e2")} | {"mag_r": np.full(n, 20.0), "snr_r": np.full(n, 100.0)}
    return ObjectTable(given | {name: np.asarray(values) for name, values in columns.items()})


def match_of(row, merged=None, second=()):
    row = np.asarray(row)
    return Match(row, np.zeros(len(row), bool) if merged is None else np.asarray(merged), np.asarray(second, bool), 0)


# --- who is matched with whom


@pytest.mark.parametrize(
    ("size", "distance", "radius", "found"),
    [(0.0, 0.29, 0.3, 1), (0.0, 0.31, 0.3, 0), (1.0, 0.49, 0.3, 1), (1.0, 0.51, 0.3, 0), (0.5, 0.29, 0.3, 1),
     (NAN, 0.29, 0.3, 1), (0.0, 0.6, 0.7, 1), (1.0, 0.6, 0.7, 1)],
)  # fmt: skip
def test_a_source_is_within_the_radius_or_half_the_size(size, distance, radius, found):
    truth, source = truth_of([0.0], size=[size]), truth_of([0.0], [distance])
    assert match_sources(truth, source, radius=radius).found.sum() == found


@pytest.mark.parametrize(("off", "found"), [(2.9, True), (-2.9, True), (3.1, False), (-3.1, False), (NAN, True)])
def test_magnitudes_three_apart_are_no_pair(off, found):
    """Six others set the zero point, 0.5; a source without a magnitude is matched by position alone."""
    east = 6.0 * np.arange(7)
    truth = truth_of(east)
    sources = truth_of(east, mag_r=np.append(np.full(6, 20.5), 20.5 + off))
    one = match_sources(truth, sources, "r")
    assert one.zero_point == 0.5 and one.found[:6].all() and one.found[6] == found


def test_a_zero_point_is_of_five_pairs_that_are_the_closest():
    """Of four it is none; sources farther from their object than others, or without a magnitude, do not count."""
    truth = truth_of(6.0 * np.arange(6))
    sources = truth_of(
        np.append(6.0 * np.arange(6), 6.0 * np.arange(6)), np.append(np.full(6, 0.1), np.full(6, -0.2)),
        mag_r=[21.0, 21.1, 21.2, 21.3, 21.4, NAN] + [15.0] * 6,
    )  # fmt: skip
    assert match_sources(truth, sources, "r").zero_point == pytest.approx(1.2)
    few = sources.take([0, 1, 2, 3, 5, 6, 7, 8, 9, 11])
    assert match_sources(truth, few, "r").zero_point == 0.0
    assert match_sources(truth, sources).zero_point == 0.0


def test_hidden_objects_lie_in_the_source_of_a_brighter_one():
    """Hidden: fainter and within 0.5 arcsec of the source, or its half-light radius; not the brighter, not the far."""
    #        owner, hidden, brighter, far | large owner, hidden, far | lost
    north = [0.0, 0.45, 0.4, 0.55, 20.0, 20.75, 20.85, 40.0]
    mag = [20.0, 20.0, 19.9, 23.0, 20.0, 21.0, 21.0, 22.0]
    size = [0.0, 0.0, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0]
    truth = truth_of(np.zeros(8), north, mag_r=mag, size=size)
    made = match_sources(truth, truth.take([0, 4]))
    assert made.source_row.tolist() == [0, -1, -1, -1, 1, -1, -1, -1]
    assert made.merged.tolist() == [False, True, False, False, False, True, False, False]
    # Where the source lies counts, not its object: 0.55 from the object is 0.45 from the source
    assert match_sources(truth.take([0, 3]), truth_of([0.0], [0.1])).merged.tolist() == [False, True]


@pytest.mark.parametrize(("band", "hidden"), [("r", True), ("g", False)])
def test_an_object_is_hidden_by_one_that_is_brighter_in_the_band(band, hidden):
    """The second is fainter in r and brighter in g, and brightest of all in g."""
    truth = truth_of([0.0, 0.45], mag_r=[20.0, 21.0], mag_g=[22.0, 19.0])
    sources = truth_of([0.0], mag_r=[20.0], mag_g=[22.0])
    made = match_sources(truth, sources, band)
    assert made.source_row.tolist() == [0, -1] and made.merged.tolist() == [False, hidden]


def test_second_sources_lie_within_reach_of_an_object_that_has_another():
    truth = truth_of([0.0, 10.0, 20.0])
    sources = truth_of([0.0, 0.2, 0.4, 10.1, 30.0], mag_r=[20.0] * 5)
    made = match_sources(truth, sources)
    assert made.source_row.tolist() == [0, 3, -1] and made.second.tolist() == [False, True, False, False, False]
    assert made.real(5).tolist() == [True, False, False, True, False] and made.found.tolist() == [True, True, False]


def test_brightness_is_of_the_band_or_the_brightest_one():
    truth = {"ra": np.zeros(4), "mag_g": np.array([20.0, 22.0, NAN, NAN]), "mag_r": np.array([21.0, NAN, 23.0, NAN])}
    assert brightness(truth).tolist() == [20.0, 22.0, 23.0, np.inf]
    assert brightness(truth, "r").tolist() == [21.0, 22.0, 23.0, np.inf]
    assert brightness({"ra": np.zeros(2)}).tolist() == [np.inf, np.inf]


# --- who counts


def test_objects_alone_have_no_neighbour_of_a_tenth_of_their_light():
    """Pairs at 0.95 arcsec, 2.4 and 2.6 mag apart; the third is 1.05 arcsec apart, the last object without others."""
    east = [0.0, 0.95, 50.0, 50.95, 100.0, 101.05, 200.0]
    mag = [20.0, 22.4, 22.6, 20.0, 20.0, 20.0, 25.0]
    assert statistics.isolated(truth_of(east, mag_r=mag), "r").tolist() == [False, False, False, True, True, True, True]
    assert statistics.isolated(truth_of([0.0]), "r").tolist() == [True]


def test_completeness_of_bright_objects_is_above_ten():
    kind = [STAR] * 4 + [GALAXY] * 5 + [QUASAR]
    snr = np.array([10.0, 10.1, 50, 50, 5, 20, 20, 20, 20, 30])
    row = [0, 1, -1, 2, 3, -1, -1, 4, -1, 5]
    merged = np.isin(np.arange(10), [2, 5, 6])
    made = statistics.completeness_of_bright(
        truth_of(np.zeros(10), obj_type=np.array(kind, np.int8)), match_of(row, merged), snr
    )
    assert list(made) == ["all", "points", "galaxies"]
    for name, (n, found, hidden) in {"all": (8, 4, 3), "points": (4, 3, 1), "galaxies": (4, 1, 2)}.items():
        p, low, high = fraction(found, n)
        assert made[name] == pytest.approx(
            {
                "n": n,
                "completeness": p,
                "low": low,
                "high": high,
                "merged": hidden / n,
                "lost": 1 - (found + hidden) / n,
            }
        )
    none = statistics.completeness_of_bright(truth_of([0.0]), match_of([0]), np.array([1.0]))["all"]
    assert none["n"] == 0 and all(np.isnan(none[name]) for name in ("completeness", "merged", "lost"))


def test_bins_of_completeness_and_purity_are_half_a_magnitude_wide():
    mag = np.array([20.0, 20.49, 20.5, 21.99, NAN, -0.2])
    truth = truth_of(np.zeros(6), obj_type=np.array([0, 1, 1, 2, 1, 1], np.int8))
    match = match_of(
        [3, -1, 1, -1, 0, -1], [False, True, False, False, False, True], [False, False, True, False, False]
    )
    made = statistics.completeness(truth, match, mag)
    full = lambda low, n, found, merged: {"low": low, "high": low + 0.5, "n": n, "found": found, "merged": merged}  # noqa: E731
    assert made == {
        "all": [full(-0.5, 1, 0, 1), full(20.0, 2, 1, 1), full(20.5, 1, 1, 0), full(21.5, 1, 0, 0)],
        "points": [full(20.0, 1, 1, 0), full(21.5, 1, 0, 0)],
        "galaxies": [full(-0.5, 1, 0, 1), full(20.0, 1, 0, 1), full(20.5, 1, 1, 0)],
    }
    assert statistics.purity(match, np.array([18.2, 18.9, 18.6, 18.4, 18.5]), 5) == [
        {"low": 18.0, "high": 18.5, "n": 2, "real": 2, "second": 0},
        {"low": 18.5, "high": 19.0, "n": 3, "real": 1, "second": 1},
    ]
    assert len(statistics.bin_edges(np.array([NAN]))) == 0 and statistics.bin_edges(np.array([20.5])).tolist() == [
        20.5,
        21.0,
    ]
    assert len(statistics.bin_edges(np.array([-1e6, 1e6]))) == 401


def test_magnitudes_are_sources_less_truth_of_bright_objects_alone():
    """By kind; the source of each object lies elsewhere in the catalogue. Arrays have faint ones, too."""
    n = 20
    truth = truth_of(np.zeros(n), obj_type=np.array([STAR, GALAXY] * 10, np.int8), mag_r=20 + 0.1 * np.arange(n))
    row = n - 1 - np.arange(n)
    row[4] = -1
    off = np.where(np.arange(n) % 2, -0.3, 0.2) + 0.01 * (np.arange(n) // 2)
    seen = np.zeros(n)
    seen[n - 1 - np.arange(n)] = truth["mag_r"] + off
    seen[n - 1 - 7] = NAN
    clean, snr = np.arange(n) != 2, np.where(np.arange(n) < 19, 10.1, 10.0)
    made, arrays = statistics.photometry(truth, {"mag_r": seen}, match_of(row), clean, "r", snr)
    stars, galaxies = off[[0, 6, 8, 10, 12, 14, 16, 18]], off[[1, 3, 5, 9, 11, 13, 15, 17]]
    for name, values in (("points", stars), ("galaxies", galaxies)):
        assert made[name]["n"] == 8 and made[name]["mean"] == pytest.approx(values.mean())
        assert made[name]["scatter"] == pytest.approx(values.std(ddof=1))
    kept = [k for k in range(n) if k not in (2, 4, 7)]
    assert np.allclose(arrays["mag"], truth["mag_r"][kept]) and np.allclose(arrays["off"], off[kept])
    assert arrays["galaxy"].tolist() == [k % 2 == 1 for k in kept]


def test_positions_are_source_minus_truth_on_the_sky():
    """At 60 deg of declination: east is shorter than right ascension. S/N above 20, alone, by kind."""
    n = 14
    truth = truth_of(3.0 * np.arange(n), obj_type=np.array([STAR, GALAXY] * 7, np.int8))
    east, north = np.where(np.arange(n) % 2, 0.03, -0.01), np.where(np.arange(n) % 2, 0.02, 0.05)
    at = offset_positions(RA, DEC, 3.0 * np.arange(n) + east, north)
    row = (np.arange(n) + 3) % n
    sources = {name: np.roll(values, 3) for name, values in zip(("ra", "dec"), at, strict=True)}
    clean, snr = np.arange(n) != 2, np.where(np.arange(n) == 3, 20.0, 20.1)
    made, arrays = statistics.positions(truth, sources, match_of(row), clean, snr)
    assert [made[kind]["east"]["n"] for kind in ("points", "galaxies")] == [6, 6]
    for kind, wanted in (("points", (-10.0, 50.0)), ("galaxies", (30.0, 20.0))):
        assert [made[kind][axis]["mean"] for axis in ("east", "north")] == pytest.approx(wanted, abs=0.05)
    assert np.allclose(arrays["east"], np.where(arrays["galaxy"], 30, -10), atol=0.05) and len(arrays["north"]) == 12


def test_shapes_are_of_resolved_galaxies_and_their_errors_are_those_of_a_line():
    n = 12
    rng = np.random.default_rng(2)
    true = rng.normal(0, 0.2, (2, n + 5))
    seen = np.array([[0.9], [1.2]]) * true + np.array([[0.02], [-0.03]]) + rng.normal(0, 0.03, true.shape)
    size, snr = np.full(n + 5, 0.4), np.full(n + 5, 10.1)
    kind = np.full(n + 5, GALAXY, np.int8)
    size[n], snr[n + 1], kind[n + 2] = 0.1, 10.0, STAR
    clean, row = np.arange(n + 5) != n + 3, np.arange(n + 5)[::-1].copy()
    row[n + 4] = -1
    truth = truth_of(np.zeros(n + 5), obj_type=kind, size=size, e1=true[0], e2=true[1])
    sources = {"e1": seen[0, ::-1].copy(), "e2": seen[1, ::-1].copy()}
    sources["e2"][row[0]] = NAN
    made, arrays = statistics.shapes(truth, sources, match_of(row), clean, snr)
    for k, (axis, rows) in enumerate((("e1", slice(n)), ("e2", slice(1, n)))):
        x, y = true[k, rows], seen[k, rows]
        line = linregress(x, y)
        scatter = np.sqrt(np.sum((y - line.slope * x - line.intercept) ** 2) / (len(x) - 2))
        assert made[axis] == pytest.approx({
            "n": len(x), "slope": line.slope, "slope_error": line.stderr, "offset": line.intercept,
            "offset_error": line.intercept_stderr, "scatter": scatter,
        })  # fmt: skip
        assert np.array_equal(arrays[axis], (x, y))
    few, _ = statistics.shapes(truth.take([0, 1]), sources, match_of(row[:2]), clean[:2], snr[:2])
    assert few["e1"]["n"] == 2 and np.isnan(few["e1"]["slope"])


def test_redshifts_are_of_what_is_no_star_and_found():
    """Errors over 1 + z of 0, 0.02, -0.03, 0.2 and -0.16; one is not known, one not found, a star has none."""
    true = np.array([1.0, 0.5, 2.0, 0.0, 0.25, 0.6, 0.4, 3.0])
    error = np.array([0.0, 0.02, -0.03, 9.0, 0.2, NAN, 9.0, -0.16])
    row = np.array([7, 6, 5, 4, 3, 2, -1, 0])
    seen = np.zeros(8)
    seen[row[row >= 0]] = (true + error * (1 + true))[row >= 0]
    made, arrays = statistics.redshifts(truth_of(np.zeros(8), z=true), {"z": seen}, match_of(row))
    off = np.array([0.0, 0.02, -0.03, 0.2, -0.16])
    assert made == pytest.approx({
        "n": 5, "of": 6, "bias": 0.0, "nmad": 1.4826 * 0.03, "beyond 0.15": 0.4, "beyond 0.01": 0.8,
    })  # fmt: skip
    rows = [0, 1, 2, 4, 7]
    assert np.allclose(arrays["true"], true[rows]) and np.allclose(arrays["seen"], true[rows] + off * (1 + true[rows]))
    assert statistics.redshifts(truth_of([0.0]), {"z": seen}, match_of([0]))[0] == {"n": 0, "of": 0}


def test_half_are_found_at_the_last_bin_that_has_half():
    bins = [{"low": 20.0, "high": 20.5, "n": 4, "found": 2}, {"low": 20.5, "high": 21.0, "n": 5, "found": 0}]
    assert statistics.half_found_magnitude(bins) == pytest.approx(20.25)  # exactly half counts as found
    rising = [{"low": 18.0 + k, "high": 18.5 + k, "n": 10, "found": found} for k, found in enumerate((2, 9, 1))]
    assert statistics.half_found_magnitude(rising) == pytest.approx(19.25 + 0.5)


# --- values that are none


@pytest.mark.parametrize(
    ("name", "none", "values"),
    [
        ("mag_r", [90.0, -90.0], [89.9, -89.9]), ("z", [-1.0, 90.0], [-0.99, 89.9, 0.0]),
        ("e1", [9.0, -9.0], [8.9, -8.9]), ("e2", [-9.0, 99.0], [8.9]), ("q", [-0.1, 9.0], [0.0, 8.9]),
        ("a", [-0.1, 99.0, 9999.0], [0.0, 98.0, 100.0]), ("b", [-0.1, 999.0], [0.0, 90.0]),
        ("pa", [360.5, -361.0], [360.0, -360.0, 99.0]), ("dec", [-99.0, 99.0], [-89.0, 90.0]),
        ("ra", [], [99.0, 359.0]),
    ],
)  # fmt: skip
def test_impossible_values_are_missing(name, none, values):
    given = np.array([*values, *none, NAN])
    out, notes = without_missing({name: given})
    assert np.array_equal(out[name], [*values, *[NAN] * len(none), NAN], equal_nan=True)
    assert len(notes) == bool(none)
    if none:
        assert notes[0].startswith(f"{len(none)} ") and f"no values, as {none[0]:g}: not known" in notes[0]


# --- keys and units


def test_keys_have_a_band_and_a_unit():
    assert parse_key("flux_nuv_njy", ("g", "nuv")) == Key("flux_B", "nuv", "njy")
    assert parse_key("mag_g", ("g",)).full_name == "mag_g" and parse_key("ra_hour", ()) == Key("ra", "", "hour")
    assert parse_key("e2_chi", ()) == Key("e2", "", "chi") and set(ABOUT) == set(KINDS)
    for wrong in ("mag_g_njy", "ra_njy", "z_deg", "flux_g_deg", "mag_B", "e1_deg", "q_g"):
        with pytest.raises(InputError, match="unknown quantity") as error:
            parse_key(wrong, ("g", "r"))
        assert "B: g, r" in str(error.value) and "angle: deg, hour, rad; flux: ujy, njy, mjy, jy" in str(error.value)


@pytest.mark.parametrize(
    ("key", "stated", "value", "wanted"),
    [
        ("ra_hour", None, 2.0, 30.0), ("pa_rad", None, np.pi / 2, 90.0), ("dec", "rad", np.pi / 4, 45.0),
        ("ra", "hourangle", 1.5, 22.5), ("ra", "deg", 7.0, 7.0), ("ra_hour", "hourangle", 1.0, 15.0),
        ("flux_r", None, 3.0, 3.0), ("flux_r_njy", None, 3000.0, 3.0), ("flux_r_mjy", None, 0.003, 3.0),
        ("flux_r_jy", None, 3e-6, 3.0), ("flux_r", "nJy", 3000.0, 3.0), ("flux_r_ujy", "uJy", 3.0, 3.0),
        ("e1_chi", None, 0.3, 0.3), ("a", "arcsec", 4.0, 4.0), ("mag_r", "mag", 21.0, 21.0),
    ],
)  # fmt: skip
def test_units_become_degrees_and_microjanskys(key, stated, value, wanted):
    from astropy.units import Unit

    unit = stated and Unit(stated)
    assert to_first_unit(np.array([value]), parse_key(key, ("r",)), unit, "C")[0] == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("key", "stated", "words"),
    [("flux_r", "electron", "does not fit flux_r"), ("ra", "arcsec", "does not fit ra"), ("mag_r", "mag(ST)", "are AB"),
     ("mag_r", "VEGAMAG", "are AB"), ("flux_r_njy", "uJy", "the file has the unit uJy, the key njy")],
)  # fmt: skip
def test_units_that_do_not_fit_are_refused(key, stated, words):
    from astropy.units import Unit

    unit = stated if "mag" in stated.lower() else Unit(stated)
    with pytest.raises(InputError, match=words):
        to_first_unit(np.zeros(1), parse_key(key, ("r",)), unit, "C")


# --- the whole


def two_bands():
    """A Field of r (ten objects in a square of 100 arcsec) and g (its west half), one object beyond both."""
    corners = [[-50, -50, 50, 50], [-50, 50, 50, -50]]
    frames = [
        {
            "file": name, "filter": filter_, "kind": "imaging",
            "corners": np.transpose(offset_positions(RA, DEC, *at)).tolist(),
        }
        for name, filter_, at in (
            ("r.fits", "r", np.array(corners, float)), ("g.fits", "g", np.array([[-50, -50, 1, 1], corners[1]], float)),
        )
    ]  # fmt: skip
    east = np.append(np.arange(10) * 8.0 - 40, 300.0)
    mag = 20 + 0.1 * np.arange(11)
    snr = np.where(np.arange(11) == 9, 9.0, 40.0), np.where(np.arange(11) < 6, 30.0, NAN)
    snr[1][1] = 9.5
    return Field("two", truth_of(
        east, obj_type=np.array([STAR, GALAXY] * 5 + [STAR], np.int8), mag_r=mag, mag_g=mag - 1.5,
        snr_r=snr[0], snr_g=snr[1],
    ), frames)  # fmt: skip


def catalogue_of(known, rows, north=0.0, **columns):
    rows = np.asarray(rows)
    at = {name: np.asarray(known.objects[name])[rows] for name in ("ra", "dec")}
    at["dec"] = at["dec"] + np.asarray(north) / 3600
    return Catalogue(
        at | {name: np.asarray(values, float) for name, values in columns.items()}, {"ra": "RA"}, ["a note"]
    )


def test_a_result_is_of_the_frames_of_its_band():
    """Two sources of one object, one of none, one beyond the frames; the band is the mapped one of most sources."""
    known = two_bands()
    rows, north = [0, 0, 1, 2, 4, 9, 3, 10], [0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 20.0, 0.0]
    true = np.asarray(known.objects["mag_r"])[rows]
    found = catalogue_of(known, rows, north, mag_r=true, mag_g=np.where(np.arange(8) < 3, true - 1.5, NAN))
    made, arrays = evaluate(known, found, file="/a/mine.csv")
    assert (made["band"], made["objects"], made["sources"], made["pack"]) == ("r", 10, 7, "two")
    assert made["catalogue"] == "mine.csv" and made["columns"] == {"ra": "RA"} and made["radius_arcsec"] == 0.3
    assert made["notes"] == ["a note", "1 of 8 sources lie outside the frames: left out"]
    counts = {kind: (one["n"], one["completeness"]) for kind, one in made["completeness"].items()}
    assert counts == {"all": (9, 4 / 9), "points": (5, 3 / 5), "galaxies": (4, 1 / 4)}
    assert made["purity"]["purity"] == 5 / 7 and made["purity"]["second"] == 1 / 7
    assert list(made["photometry"]) == ["r", "g"] and len(arrays["photometry"]["g"]["mag"]) == 2
    assert made["photometry"]["g"]["galaxies"]["n"] == 0 and made["photometry"]["g"]["points"]["n"] == 1  # S/N in g
    assert sum(one["found"] for one in made["completeness_by_magnitude"]["all"]) == 5
    assert sum(one["n"] for one in made["purity_by_magnitude"]) == 7 and made["zero_point"] == 0.0
    assert set(made["half_found"]) == {"all", "points", "galaxies"}
    west, _ = evaluate(known, found, "g")
    assert (west["band"], west["objects"], west["sources"]) == ("g", 6, 6)
    assert west["completeness"]["all"]["n"] == 5 and west["completeness"]["galaxies"]["completeness"] == 0.0
    # A band without a magnitude of the catalogue: its frames and its S/N, and matching by position alone
    del found.columns["mag_g"]
    bare, arrays = evaluate(known, found, "g")
    assert bare["band"] == "g" and bare["zero_point"] is None and "purity_by_magnitude" not in bare
    assert bare["completeness"] == west["completeness"] and list(bare["photometry"]) == ["r"]
    with pytest.raises(InputError, match="not a band of this pack"):
        evaluate(known, found, "z")


def test_bins_and_isolation_are_of_the_band_of_the_matches():
    """A pair 0.9 arcsec apart: 3 mag in r, the same magnitude in g, where both are brighter."""
    known = two_bands()
    east = np.array([-30.0, -29.1])
    objects = truth_of(east, mag_r=[21.2, 24.2], mag_g=[20.1, 20.2], snr_g=[50.0, 50.0])
    known = Field("pair", objects, known.frames)
    found = catalogue_of(known, [0, 1], mag_r=objects["mag_r"], mag_g=objects["mag_g"])
    for band, lows, alone in (("r", [21.0, 24.0], 1), ("g", [20.0], 0)):
        made, arrays = evaluate(known, found, band)
        assert [one["low"] for one in made["completeness_by_magnitude"]["all"]] == lows, band
        assert made["photometry"]["r"]["points"]["n"] == alone and len(arrays["positions"]["east"]) == alone, band


@pytest.mark.parametrize(("off", "matches"), [(None, 4), (0.0, 4), (2.9, 4), (5.0, 0)])
def test_chance_is_of_positions_and_magnitudes_as_matches_are(off, matches):
    """Four sources that a shift by 10 arcsec brings onto objects; too few for a zero point."""
    known = two_bands()
    columns = {} if off is None else {"mag_r": np.asarray(known.objects["mag_r"])[1:5] + off}
    made, _ = evaluate(known, catalogue_of(known, [1, 2, 3, 4], 10.0, **columns))
    assert made["purity"]["chance"] == matches / 16 and made["purity"]["chance_tried"] == 16


def test_without_a_magnitude_the_best_band_says_the_signal_to_noise():
    known = two_bands()
    made, _ = evaluate(known, catalogue_of(known, [0, 1]))
    assert made["band"] is None and made["zero_point"] is None
    assert made["completeness"]["all"]["n"] == 9  # of the last 9 in r, nothing in g
    assert [one["low"] for one in made["completeness_by_magnitude"]["all"]] == [18.5, 19.0]  # as in g, the brightest
    assert known.covers(known.objects["ra"], known.objects["dec"], "g").tolist() == [True] * 6 + [False] * 5


def test_purity_without_chance(monkeypatch):
    known = two_bands()
    monkeypatch.setattr("csstsim.studies.release.score.score.chance_matches", lambda *given: (0.2, 77))
    made, _ = evaluate(known, catalogue_of(known, [0, 1, 2, 3], [0, 0, 0, 20.0]))
    assert made["purity"] == pytest.approx(
        {"purity": 0.75, "second": 0.0, "chance": 0.2, "chance_tried": 77, "corrected": 0.55 / 0.8}
    )
    monkeypatch.setattr("csstsim.studies.release.score.score.chance_matches", lambda *given: (1.0, 77))
    assert np.isnan(evaluate(known, catalogue_of(known, [0]))[0]["purity"]["corrected"])
    mixed = evaluate(known, catalogue_of(known, [0, 1, 2, 3], [0, 0, 0, 20.0]))[0]["purity"]
    assert mixed["purity"] == 0.75 and np.isnan(mixed["corrected"])


def test_the_radius_reaches_matches_and_chance():
    """Sources 0.6 arcsec off: matched within 0.7 only, as are shifted ones (chance) that lie as near."""
    known = two_bands()
    found = catalogue_of(known, [0, 1, 2, 3, 4], 0.6)
    assert evaluate(known, found)[0]["completeness"]["all"]["completeness"] == 0.0
    wide, _ = evaluate(known, found, radius=0.7)
    assert wide["completeness"]["all"]["completeness"] == 5 / 9 and wide["radius_arcsec"] == 0.7
    two_off = catalogue_of(known, [1, 2, 3, 4, 5], 9.5)  # shifted by 10 to the south: 0.5 off
    assert evaluate(known, two_off)[0]["purity"]["chance"] == 0.0
    assert evaluate(known, two_off, radius=0.7)[0]["purity"]["chance"] == 5 / 20


def test_maps_are_key_and_column():
    assert _column_map([" ra = RA", "mag_r=A=B"]) == {"ra": "RA", "mag_r": "A=B"}
    for wrong in (["ra"], ["ra="], ["=RA"]):
        with pytest.raises(InputError, match="not KEY=COLUMN"):
            _column_map(wrong)
    with pytest.raises(InputError, match="given twice"):
        _column_map(["ra=A", "ra=B"])
    value = _json_value({"a": [NAN, np.float64(1.5), (np.int64(2), np.inf)], "b": {"c": -np.inf, "d": None, "e": "x"}})
    assert value == {"a": [None, 1.5, [2, None]], "b": {"c": None, "d": None, "e": "x"}}
    assert type(value["a"][2][0]) is int


# --- reading


def test_a_catalogue_of_ldac_is_its_table_of_objects(tmp_path):
    from astropy.io import fits

    head = fits.BinTableHDU.from_columns([fits.Column("Field Header Card", "8A", array=["a"])], name="LDAC_IMHEAD")
    columns = [fits.Column("ra", "D", array=[1.0, 2.0]), fits.Column("dec", "D", array=[3.0, 4.0])]
    other = fits.BinTableHDU.from_columns([fits.Column("ra", "D", array=[9.0])], name="OTHER")
    fits.HDUList([fits.PrimaryHDU(), head, fits.BinTableHDU.from_columns(columns, name="LDAC_OBJECTS"), other]).writeto(
        tmp_path / "a.fits"
    )
    assert read_catalogue(tmp_path / "a.fits", {}, ())["dec"].tolist() == [3.0, 4.0]
    fits.HDUList([fits.PrimaryHDU(), head]).writeto(tmp_path / "b.fits")
    with pytest.raises(InputError, match="without a table"):
        read_table(tmp_path / "b.fits")


def test_what_is_masked_or_text_in_a_catalogue(tmp_path):
    (tmp_path / "a.csv").write_text("ra,dec,mag_r,z,name\n1.0,2.0,,0.5,a\n3.0,4.0,21.0,,b\n,5.0,22.0,0.1,c\n")
    found = read_catalogue(tmp_path / "a.csv", {"z": "z"}, ("r",))
    assert found["ra"].tolist() == [1.0, 3.0] and len(found) == 2
    assert np.array_equal(found["mag_r"], [NAN, 21.0], equal_nan=True)
    assert np.array_equal(found["z"], [0.5, NAN], equal_nan=True)
    assert found.columns_used == {"ra": "ra", "dec": "dec", "mag_r": "mag_r", "z": "z"}
    assert found.notes == [
        "z: from column z", "ra: from column ra", "dec: from column dec", "mag_r: from column mag_r",
        "columns not used: name", "neither e1 and e2 nor a, b and pa are mapped: shapes are not evaluated",
        "1 rows have no position: left out",
    ]  # fmt: skip
    with pytest.raises(InputError, match="must be numbers, one in a row"):
        read_catalogue(tmp_path / "a.csv", {"z": "name"}, ("r",))
    with pytest.raises(InputError, match="given twice"):
        read_catalogue(tmp_path / "a.csv", {"ra": "ra", "ra_hour": "dec"}, ("r",))


def test_upper_case_names_and_fluxes_are_taken_and_magnitudes_before_them(tmp_path):
    (tmp_path / "a.csv").write_text("FLUX_G,flux_r,RA,Dec,MAG_R,q,PA\n10,5,1,2,21,0.5,30\n-1,5,1,2,22,0.25,0\n")
    found = read_catalogue(tmp_path / "a.csv", {"q": "q"}, ("g", "r"))
    assert np.allclose(found["mag_g"], [23.9 - 2.5, NAN], equal_nan=True) and found["mag_r"].tolist() == [21.0, 22.0]
    # North through east: 30 deg from north is 60 deg from east; 0 is along north
    assert np.allclose(found["e1"], [(1 / 3) * np.cos(np.radians(120)), -0.6])
    assert np.allclose(found["e2"], [(1 / 3) * np.sin(np.radians(120)), 0.0])
    assert "columns not used: flux_r" in found.notes and not any("shapes" in note for note in found.notes)


@pytest.mark.parametrize(("ra", "dec"), [(-360.5, 0.0), (720.5, 0.0), (10.0, 90.5), (10.0, -90.5)])
def test_impossible_positions(tmp_path, ra, dec):
    (tmp_path / "a.csv").write_text(f"ra,dec\n-360,90\n720,-90\n{ra},{dec}\n")
    with pytest.raises(InputError, match="row 3 is not a position on the sky"):
        read_catalogue(tmp_path / "a.csv", {}, ())


@pytest.mark.parametrize(
    "change", [{"corners": [[1, 2], [3, 4]]}, {"corners": [1, 2, 3]}, {"corners": [[1, 2, 3]] * 4}, {"filter": ""},
               {"kind": ""}, {"corners": "no"}, {"filter": None}],
)  # fmt: skip
def test_frames_that_are_none(tmp_path, change):
    frame = {"file": "a", "filter": "r", "kind": "imaging", "corners": [[0, 0], [0, 1], [1, 1]]}
    (tmp_path / "f.json").write_text(json.dumps({"name": "n", "frames": [frame]}))
    assert read_frames(tmp_path / "f.json") == ("n", [frame])
    (tmp_path / "f.json").write_text(json.dumps({"name": "n", "frames": [frame, frame | change]}))
    with pytest.raises(InputError, match="not a list of frames"):
        read_frames(tmp_path / "f.json")


def test_bands_are_those_of_images_in_the_order_of_frames():
    frames = [{"filter": f, "kind": kind} for f, kind in (("GI", "slitless"), ("Y", "imaging"), ("g", "imaging"))]
    assert Field("", None, [*frames, frames[1]]).bands == ("y", "g")


# --- lines, page and figures

NUMBER = {"n": 7, "mean": 0.12344, "mean_error": 0.0125, "scatter": 0.0456, "scatter_error": 0.006, "outliers": 2}
NOTHING = {"n": 1, "mean": NAN, "mean_error": NAN, "scatter": NAN, "scatter_error": NAN, "outliers": 0}
RESULT = {
    "pack": "field", "catalogue": "mine.cat", "band": "r", "notes": ["a <note>"], "objects": 30, "sources": 1,
    "radius_arcsec": 0.45,
    "completeness": {
        kind: {"n": n, "completeness": 0.9, "low": 0.85, "high": 0.94, "merged": 0.06, "lost": 0.04}
        for kind, n in (("all", 25), ("points", 11), ("galaxies", 14))
    },
    "completeness_by_magnitude": {
        "all": [{"low": 20.0, "high": 20.5, "n": 10, "found": 8, "merged": 1},
                {"low": 22.0, "high": 22.5, "n": 5, "found": 1, "merged": 0},
                {"low": 26.0, "high": 26.5, "n": 9, "found": 0, "merged": 0}],
        "points": [{"low": 20.0, "high": 20.5, "n": 4, "found": 4, "merged": 0}],
        "galaxies": [{"low": 20.0, "high": 20.5, "n": 6, "found": 4, "merged": 1}],
    },
    "purity_by_magnitude": [{"low": 21.0, "high": 21.5, "n": 20, "real": 15, "second": 3}],
    "purity": {"purity": 0.75, "chance": 0.125, "chance_tried": 40, "second": 0.0625, "corrected": 0.7142},
    "half_found": {"all": 24.25, "points": None, "galaxies": 23.5},
    "photometry": {"r": {"points": NUMBER, "galaxies": NOTHING}},
    "astrometry_mas": {"points": {"east": NUMBER, "north": NUMBER | {"mean": -3.456}},
                       "galaxies": {"east": NOTHING, "north": NOTHING}},
    "shapes": {"e1": {"n": 9, "slope": 0.9876, "slope_error": 0.0123, "offset": -0.00123, "offset_error": 0.00045,
                      "scatter": 0.0333}},
    "redshifts": {"n": 5, "of": 6, "bias": 0.00234, "nmad": 0.0456, "beyond 0.15": 0.125, "beyond 0.01": 0.75},
}  # fmt: skip


def test_the_lines_of_a_result():
    completeness = "0.900 of {} (0.850 to 0.940); merged 0.060, lost 0.040"
    assert list(summary_lines(RESULT)) == [
        "1 source against 30 true objects; by magnitude in r",
        f"completeness of all of S/N above 10: {completeness.format(25)}",
        f"completeness of points of S/N above 10: {completeness.format(11)}",
        f"completeness of galaxies of S/N above 10: {completeness.format(14)}",
        "purity: 0.750; by chance 0.125 would be found real; second sources of one object 0.062",
        "magnitude in r, points: bias 0.1234 +- 0.0125 mag, scatter 0.0456, of 7, outliers 2",
        "magnitude in r, galaxies: bias - +- - mag, scatter -, of 1, outliers 0",
        "position, east, points: bias 0.12 +- 0.01 mas, scatter 0.05, of 7, outliers 2",
        "position, north, points: bias -3.46 +- 0.01 mas, scatter 0.05, of 7, outliers 2",
        "position, east, galaxies: bias - +- - mas, scatter -, of 1, outliers 0",
        "position, north, galaxies: bias - +- - mas, scatter -, of 1, outliers 0",
        "shape e1: slope 0.988 +- 0.012, offset -0.0012 +- 0.0004, scatter 0.033, of 9",
        "redshifts: bias +0.0023, sigma_NMAD 0.0456, beyond 0.15 0.125, of 5 (6 objects have a source)",
    ]
    rest = RESULT | {"band": None, "redshifts": {"n": 0, "of": 2}}
    lines = list(summary_lines(rest))
    assert lines[0] == "1 source against 30 true objects" and "redshifts" not in lines[-1]


ARRAYS = {
    "photometry": {"r": {"mag": np.linspace(20.0, 20.4, 12), "off": np.linspace(-0.1, 0.12, 12),
                         "galaxy": np.arange(12) % 2 == 0}},
    "positions": {"east": np.linspace(-5.0, 9.0, 15), "north": np.linspace(30.0, 2.0, 15), "galaxy": np.arange(15) < 6},
    "shapes": {"e1": (np.array([0.1, 0.2]), np.array([0.3, 0.4])), "e2": (np.array([-0.1]), np.array([-0.2]))},
    "redshifts": {"true": np.array([0.5, 2.0]), "seen": np.array([0.6, 1.0])},
}  # fmt: skip


def test_the_sections_of_a_page(monkeypatch, tmp_path):
    titles = ["Completeness", "Purity", "Photometry in r", "Positions", "Shapes", "Redshifts"]
    assert [title for title, *_ in figures._panels(RESULT, ARRAYS)] == titles
    monkeypatch.setattr(
        "csstsim.studies.release.score.page.figures",
        lambda *given: (figures.ScoreFigure(title, b"\x89PNG", f"of {title}") for title in titles),
    )
    monkeypatch.setattr("csstsim.studies.release.score.page.chart", lambda png: png)
    summary, *rest = _sections(RESULT, ARRAYS)
    assert [section.title for section in rest] == titles and rest[2].name == "photometry-in-r"
    first, kinds, purity, note = summary.body
    assert first.words == (
        "1 sources, 30 true objects in the frames. Objects and sources are matched by position within 0.45 arcsec, or "
        "half a galaxy's radius, and by magnitude in r."
    )
    assert list(kinds.head) == [
        "objects", "of S/N above 10", "completeness", "68% from", "to", "merged", "lost", "half found at [mag]",
    ]  # fmt: skip
    assert kinds.rows[1:] == [
        ["points", 11, 0.9, 0.85, 0.94, 0.06, 0.04, None], ["galaxies", 14, 0.9, 0.85, 0.94, 0.06, 0.04, 23.5],
    ]  # fmt: skip
    assert list(purity.head) == ["purity", "real by chance", "purity without chance", "second sources"]
    assert purity.rows == [[0.75, 0.125, 0.7142, 0.0625]] and note.words == "a <note>"
    tables = {section.title: section.body[1:] for section in rest}
    assert tables["Completeness"] == tables["Purity"] == []
    [magnitudes], [spots], [e1], [z] = (tables[name] for name in titles[2:])
    assert list(magnitudes.head)[:6] == ["objects", "unit", "n", "mean", "mean error", "scatter"]
    assert magnitudes.rows == [["points", "mag", 7, 0.12344, 0.0125, 0.0456, 0.006, 2],
                               ["galaxies", "mag", 1, None, None, None, None, 0]]  # fmt: skip
    assert [row[:5] for row in spots.rows[:2]] == [
        ["points", "east", "mas", 7, 0.12344], ["points", "north", "mas", 7, -3.456],
    ]  # fmt: skip
    assert e1.rows == [["e1", 9, 0.9876, 0.0123, -0.00123, 0.00045, 0.0333]]
    assert z.head == tuple(RESULT["redshifts"]) and z.rows == [tuple(RESULT["redshifts"].values())]
    write_page(tmp_path / "page.html", RESULT, ARRAYS)
    text = (tmp_path / "page.html").read_text()
    assert "mine.cat against the truth of field" in text and "a &lt;note&gt;" in text


def test_figures_that_have_nothing_are_left_out():
    nothing = RESULT | {"band": None, "purity_by_magnitude": []}
    empty = {"photometry": {"r": {"mag": []}}, "positions": {"east": []}, "shapes": {"e1": ([], [])}}
    [(title, _, caption)] = figures._panels(nothing, empty)
    assert title == "Completeness" and "68% bounds" in caption


def axes_of(draw, *given):
    axes = Figure().subplots()
    draw(axes, *given)
    return axes


def bars(axes):
    """Return [(x, y, lower end, upper end)] of the points of vertical error bars."""
    found = []
    for container in axes.containers:
        line, _, (segments, *_) = container.lines
        for (x, y), segment in zip(line.get_xydata(), segments.get_segments(), strict=True):
            found.append([x, y, *np.sort(segment[:, 1])])
    return found


def test_the_figure_of_completeness_has_fractions_bounds_and_merged_ones():
    axes = axes_of(figures._completeness, RESULT, " in r")
    wanted = [[20.25, *fraction(8, 10)], [22.25, *fraction(1, 5)], [26.25, *fraction(0, 9)], [20.25, *fraction(4, 6)]]
    assert np.allclose(bars(axes), wanted)  # the point of four objects has no bar
    dashed = [line.get_xydata().tolist() for line in axes.lines if line.get_linestyle() == "--"]
    assert dashed[0] == [[20.25, 0.9], [22.25, 0.2], [26.25, 0.0]] and dashed[2] == [[20.25, 5 / 6]]
    assert axes.get_xlim()[1] == 23.5 and axes.get_xlabel() == "true magnitude in r [AB]"


def test_the_figure_of_purity_has_second_sources_and_chance():
    axes = axes_of(figures._purity, RESULT)
    assert np.allclose(bars(axes), [[21.25, *fraction(15, 20)]])
    dashed, chance = (line for line in axes.lines if line.get_linestyle() == "--" or len(line.get_xdata()) == 2)
    assert dashed.get_xydata().tolist() == [[21.25, 0.9]] and list(chance.get_ydata()) == [0.125, 0.125]


def test_the_figures_of_magnitudes_and_positions_have_means_and_scatter():
    cloud = ARRAYS["photometry"]["r"]
    axes = axes_of(figures._photometry, cloud, "r")
    wanted = []
    for kind in (~cloud["galaxy"], cloud["galaxy"]):
        off = cloud["off"][kind]
        wanted.append([cloud["mag"][kind].mean(), off.mean(), *(off.mean() + off.std(ddof=1) * np.array([-1, 1]))])
    assert np.allclose(bars(axes), wanted)
    most = max(abs(y) + 1.5 * (high - y) for _, y, _, high in wanted)
    assert axes.get_ylim() == pytest.approx((-1.1 * most, 1.1 * most))
    axes = axes_of(figures._positions, ARRAYS["positions"])
    points, galaxies = (line for line in axes.lines if line.get_marker() == ".")
    assert points.get_xydata()[:, 0].tolist() == ARRAYS["positions"]["east"][6:].tolist()
    assert galaxies.get_xydata()[:, 1].tolist() == ARRAYS["positions"]["north"][:6].tolist()
    east, north = ARRAYS["positions"]["east"][6:], ARRAYS["positions"]["north"][6:]
    across, along = (one.get_segments()[0] for one in axes.containers[0].lines[2])
    assert np.allclose(across[:, 0], east.mean() + east.std(ddof=1) * np.array([-1, 1]))
    assert np.allclose(along[:, 1], north.mean() + north.std(ddof=1) * np.array([-1, 1]))
    most = max(abs(v.mean()) + 3 * v.std(ddof=1) for part in (slice(6), slice(6, None))
               for v in (ARRAYS["positions"]["east"][part], ARRAYS["positions"]["north"][part]))  # fmt: skip
    assert axes.get_xlim() == pytest.approx((-most, most)) == axes.get_ylim()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("east [mas]", "north [mas]")


def test_the_figures_of_shapes_and_redshifts_are_seen_against_true():
    axes = axes_of(figures._shapes, ARRAYS["shapes"])
    assert [line.get_xydata().tolist() for line in axes.lines[:2]] == [[[0.1, 0.3], [0.2, 0.4]], [[-0.1, -0.2]]]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["e1", "e2"]
    axes = axes_of(figures._redshifts, ARRAYS["redshifts"])
    cloud, line, low, high = (line.get_xydata() for line in axes.lines)
    assert cloud.tolist() == [[0.5, 0.6], [2.0, 1.0]] and line[1].tolist() == [2.1, 2.1]
    assert low[1] == pytest.approx([2.1, 2.1 - 0.15 * 3.1]) and high[0] == pytest.approx([0.0, 0.15])
    assert len(figures._thinned(0)) == 0 and figures._thinned(3).tolist() == [0, 1, 2]
    many = figures._thinned(10_001)
    assert len(many) == 4000 and many[0] == 0 and many[-1] == 10_000


def test_the_files_of_a_score(monkeypatch, tmp_path):
    """The truth's own folder, an output folder that does not exist yet, and what is logged."""
    known = two_bands()
    (tmp_path / "truth").mkdir()
    known.objects.write(tmp_path / "truth" / "objects.parquet", {})
    (tmp_path / "truth" / "frames.json").write_text(json.dumps({"name": "two", "frames": known.frames}))
    assert read_field(tmp_path / "truth").bands == ("r", "g")
    monkeypatch.setattr("csstsim.studies.release.score.page.figures", lambda *given: ())
    at = zip(*(known.objects[name][:10] for name in ("ra", "dec", "mag_r")), strict=True)
    rows = [f"{ra:.9f},{dec + 0.4 / 3600:.9f},{mag}\n" for ra, dec, mag in at]
    (tmp_path / "a.csv").write_text("".join(["RA,DEC,R\n", *rows]))
    said = []
    made = score(tmp_path / "a.csv", tmp_path / "truth", tmp_path / "out" / "here", said.append, ["mag_r=R"], "r", 0.5)
    assert made["completeness"]["all"]["completeness"] == 1.0 and made["radius_arcsec"] == 0.5
    kept = json.loads((tmp_path / "out" / "here" / "score.json").read_text())
    assert kept == json.loads(json.dumps(_json_value(made))) and kept["purity"]["purity"] == 1.0
    assert kept["photometry"]["r"]["points"]["mean"] == pytest.approx(0, abs=1e-9)
    assert said[: len(made["notes"])] == made["notes"] and said[len(made["notes"]) : -1] == list(summary_lines(made))
    assert said[-1].endswith("score.html, and score.json beside it")
