"""A catalogue's score: the truth itself is perfect, and what was done to it comes out as it was put in."""

import json

import numpy as np
import pytest
from release.score_field import field, offset_positions, table

from csstsim.base.errors import InputError
from csstsim.studies.release.score.catalogue import read_catalogue, read_table
from csstsim.studies.release.score.field import Field
from csstsim.studies.release.score.match import MAG_SPREAD, RADIUS, SHIFT, chance_matches, match_sources, moved
from csstsim.studies.release.score.score import evaluate
from csstsim.studies.release.score.statistics import half_found_magnitude

EXACT = 1e-9  # mag, mas, of means that have no scatter


def scored(known, catalogue, tmp_path, maps=None, name="c.ecsv", **options):
    """Return the numbers of an astropy Table against a Field, through its file."""
    catalogue.write(tmp_path / name, overwrite=True)
    maps = ({"z": "z"} if "z" in catalogue.colnames else {}) | (maps or {})
    return evaluate(known, read_catalogue(tmp_path / name, maps, known.bands), **options)[0]


def numbers(result, what="r"):
    return [result["photometry"][what][kind] for kind in ("points", "galaxies")]


@pytest.mark.parametrize("ra, dec", [(150.0, 2.0), (0.0, -30.0), (359.999, 60.0), (40.0, 90.0), (40.0, -89.999)])
def test_the_truth_itself_is_perfect_anywhere(tmp_path, ra, dec):
    known = field(ra, dec)
    made = scored(known, table(known.objects), tmp_path)
    assert made["objects"] == made["sources"] == len(known.objects)
    for kind in ("all", "points", "galaxies"):
        assert made["completeness"][kind]["completeness"] == 1.0 and made["completeness"][kind]["merged"] == 0.0
    assert made["purity"]["purity"] == 1.0 and made["purity"]["second"] == 0.0 == made["purity"]["chance"]
    assert all(abs(one["mean"]) < EXACT and one["scatter"] < EXACT and one["n"] > 100 for one in numbers(made))
    for axes in made["astrometry_mas"].values():
        assert all(abs(one["mean"]) < 1e-6 and one["scatter"] < 1e-6 for one in axes.values())  # mas
    for one in made["shapes"].values():
        assert abs(one["slope"] - 1) < EXACT and abs(one["offset"]) < EXACT and one["n"] > 200
    assert made["redshifts"]["bias"] == 0.0 == made["redshifts"]["nmad"]
    assert made["redshifts"]["n"] == (known.objects["z"] > 0).sum()


def test_an_offset_of_magnitudes_is_the_bias_and_the_zero_point(tmp_path):
    known = field()
    for offset in (0.25, -26.0):  # a small one, and a catalogue without a zero point
        made = scored(known, table(known.objects, mag_r=known.objects["mag_r"] + offset), tmp_path)
        assert made["completeness"]["all"]["completeness"] == 1.0
        assert all(abs(one["mean"] - offset) < 1e-6 for one in numbers(made))
        assert abs(made["zero_point"] - offset) < 1e-6


@pytest.mark.parametrize("ra, dec", [(10.0, 60.0), (0.0, -89.99), (0.0, 0.0)])
def test_a_shift_is_the_bias_of_positions(tmp_path, ra, dec):
    known = field(ra, dec)
    ra, dec = moved(known.objects["ra"], known.objects["dec"], 0.05, -0.02)  # arcsec
    made = scored(known, table(known.objects, ra=ra, dec=dec), tmp_path)
    for axes in made["astrometry_mas"].values():
        assert abs(axes["east"]["mean"] - 50.0) < 0.01 and abs(axes["north"]["mean"] + 20.0) < 0.01  # mas


def test_the_order_of_rows_is_nothing(tmp_path):
    known = field(close=True)
    rows = np.random.default_rng(1).permutation(len(known.objects))
    one, other = scored(known, table(known.objects), tmp_path), scored(known, table(known.objects, rows), tmp_path)
    for made in (one, other):
        made["catalogue"] = ""
    assert other["completeness"] == one["completeness"] and other["purity"] == one["purity"]
    for a, b in zip(numbers(one), numbers(other), strict=True):
        assert a == pytest.approx(b, nan_ok=True)


def test_each_source_twice_is_half_pure_with_the_other_half_second(tmp_path):
    known = field()
    made = scored(known, table(known.objects, np.repeat(np.arange(len(known.objects)), 2)), tmp_path)
    assert made["completeness"]["all"]["completeness"] == 1.0
    assert made["purity"]["purity"] == 0.5 == made["purity"]["second"]


def test_missing_and_false_sources_are_counted(tmp_path):
    known = field()
    n = len(known.objects)
    kept = np.arange(n) % 4 > 0
    false = moved(known.objects["ra"], known.objects["dec"], 3.0, 3.0)  # between the objects of the grid
    rows = np.concatenate([np.flatnonzero(kept), np.arange(n)[:50]])
    changed = table(known.objects, rows)
    changed["ra"][-50:], changed["dec"][-50:] = false[0][:50], false[1][:50]
    made = scored(known, changed, tmp_path)
    assert made["completeness"]["all"]["completeness"] == kept.mean()
    assert made["purity"]["purity"] == kept.sum() / (kept.sum() + 50)
    assert made["completeness"]["all"]["lost"] == pytest.approx(1 - kept.mean())


def test_faint_neighbours_without_a_source_are_merged_not_lost(tmp_path):
    known = field(close=True)
    bright = np.flatnonzero(
        known.objects["id"] < (known.objects["obj_type"] >= 0).sum() - (known.objects["id"] >= 441).sum()
    )
    made = scored(known, table(known.objects, bright), tmp_path)
    fraction = 1 - len(bright) / len(known.objects)
    assert made["completeness"]["all"]["merged"] == pytest.approx(fraction) and fraction > 0.3
    assert made["completeness"]["all"]["lost"] == pytest.approx(0.0, abs=1e-12)
    # alone are the stars and, with neighbours 3 mag fainter, the galaxies
    assert numbers(made)[0]["n"] > 100


def test_shapes_with_a_slope_and_an_offset(tmp_path):
    known = field()
    changed = table(known.objects, e1=0.9 * known.objects["e1"] + 0.01, e2=1.1 * known.objects["e2"] - 0.02)
    made = scored(known, changed, tmp_path)["shapes"]
    assert made["e1"]["slope"] == pytest.approx(0.9) and made["e1"]["offset"] == pytest.approx(0.01)
    assert made["e2"]["slope"] == pytest.approx(1.1) and made["e2"]["offset"] == pytest.approx(-0.02)


def test_axes_and_angle_are_the_same_shapes(tmp_path):
    known = field()
    e = known.objects["e1"] + 1j * known.objects["e2"]
    q, pa = (1 - np.abs(e)) / (1 + np.abs(e)), 90.0 - np.degrees(np.angle(e)) / 2
    changed = table(known.objects, A=3.0 * np.ones(len(e)), B=3.0 * q, THETA=np.radians(pa))
    del changed["e1"], changed["e2"]
    made = scored(known, changed, tmp_path, {"a": "A", "b": "B", "pa_rad": "THETA"})["shapes"]
    assert all(abs(one["slope"] - 1) < 1e-6 and abs(one["offset"]) < 1e-6 for one in made.values())
    chi = 2 * np.abs(e) / (1 + np.abs(e) ** 2) * np.exp(1j * np.angle(e))
    made = scored(known, table(known.objects, e1=chi.real, e2=chi.imag), tmp_path, {"e1_chi": "e1", "e2_chi": "e2"})
    assert all(abs(one["slope"] - 1) < 1e-6 for one in made["shapes"].values())


def test_redshifts_with_a_bias_and_outliers(tmp_path):
    known = field()
    z = known.objects["z"].copy()
    galaxies = np.flatnonzero(z > 0)
    z[galaxies] += 0.002 * (1 + z[galaxies])
    z[galaxies[::10]] += 1.0 * (1 + known.objects["z"][galaxies[::10]])
    made = scored(known, table(known.objects, z=z), tmp_path)["redshifts"]
    assert made["bias"] == pytest.approx(0.002, abs=1e-9) and made["nmad"] < 1e-9
    assert made["beyond 0.15"] == pytest.approx(len(galaxies[::10]) / len(galaxies))


def test_matches_by_chance_of_a_catalogue_at_random():
    known, rng = field(), np.random.default_rng(3)
    n, half = 20_000, 55.0
    at = offset_positions(150.0, 2.0, rng.uniform(-half, half, n), rng.uniform(-half, half, n))
    fraction, tried = chance_matches(known.objects, {"ra": at[0], "dec": at[1]}, known.covers)
    # Sources outnumber objects: each object within reach of some source takes one of them
    objects = known.objects.take(known.objects["ra"] > 0)
    assert tried > 3 * n and fraction < len(objects) / n * 1.01
    few = {"ra": at[0][:2000], "dec": at[1][:2000]}
    fraction, _ = chance_matches(known.objects, few, known.covers)
    expected = np.pi * 0.3**2 / 6.0**2  # reach of 0.3 arcsec, an object in 36 arcsec2
    assert abs(fraction - expected) < 4 * np.sqrt(expected / 8000)
    assert SHIFT > 6.0


@pytest.mark.parametrize("radius", [RADIUS, 0.7])
def test_another_unit_is_looked_for_within_the_radius_of_the_matches(tmp_path, radius):
    """Positions in hours that are off by 0.6 arcsec, too: with a radius of 0.7 they would match."""
    known = field(0.0, 0.0)
    made = table(known.objects)
    made["ra"] = ((np.asarray(made["ra"]) + 180) % 360 - 180) / 15
    made["dec"] = np.asarray(made["dec"]) + 0.6 / 3600
    if radius == RADIUS:
        assert scored(known, made, tmp_path, radius=radius)["completeness"]["all"]["completeness"] < 0.01
        return
    with pytest.raises(InputError, match="if the positions were ra_hour"):
        scored(known, made, tmp_path, radius=radius)


def test_magnitudes_choose_among_near_objects():
    truth = {"ra": np.array([10.0, 10.0]), "dec": np.array([0.0, 0.1 / 3600]), "size": np.zeros(2),
             "mag_r": np.array([18.0, 24.0])}  # fmt: skip
    swapped = {"ra": truth["ra"], "dec": truth["dec"], "mag_r": np.array([24.0, 18.0])}
    assert match_sources(truth, swapped).source_row.tolist() == [0, 1]
    assert match_sources(truth, swapped, "r").source_row.tolist() == [1, 0]
    off = {"ra": truth["ra"][:1], "dec": truth["dec"][:1], "mag_r": np.array([28.0])}
    assert not match_sources({k: v[:1] for k, v in truth.items()}, off, "r").found.any()


@pytest.mark.parametrize("size", [0.0, 3.0])
@pytest.mark.parametrize(("nearer", "fainter", "row"), [(0.3, 0.8, 0), (0.3, 0.7, 1), (0.6, 0.5, 1), (0.7, 0.5, 0)])
def test_positions_and_magnitudes_count_by_their_squares(nearer, fainter, row, size):
    """A source at 0.8 of the reach with the right magnitude, another nearer and fainter: the smaller sum wins.

    The reach is the radius, or of a large galaxy half of its half-light radius.
    """
    truth = {"ra": np.array([10.0]), "dec": np.zeros(1), "size": np.array([size]), "mag_r": np.array([20.0])}
    distance = np.array([0.8, nearer]) * max(RADIUS, size / 2) / 3600
    sources = {"ra": 10.0 + distance, "dec": np.zeros(2), "mag_r": 20.0 + np.array([0.0, fainter]) * MAG_SPREAD}
    assert (nearer**2 + fainter**2 < 0.8**2) == (row == 1)
    assert match_sources(truth, sources, "r").source_row.tolist() == [row]


def test_one_source_and_none(tmp_path):
    known = field()
    made = scored(known, table(known.objects, [5]), tmp_path)
    assert made["sources"] == 1 and made["purity"]["purity"] == 1.0
    assert np.isnan(numbers(made)[0]["mean"]) and np.isnan(made["shapes"]["e1"]["slope"])
    made = scored(known, table(known.objects, []), tmp_path)
    assert made["completeness"]["all"]["completeness"] == 0.0 and np.isnan(made["purity"]["purity"])


def test_rows_without_a_position_or_a_magnitude(tmp_path):
    known = field()
    changed = table(known.objects)
    changed["ra"][:7], changed["mag_r"][7:20], changed["mag_r"][20:30] = np.nan, 99.0, np.nan
    made = scored(known, changed, tmp_path)
    assert made["sources"] == len(known.objects) - 7
    assert "7 rows have no position: left out" in made["notes"]
    assert any(note.startswith("13 magnitudes in r") for note in made["notes"])
    assert made["purity"]["purity"] == 1.0 and all(abs(one["mean"]) < EXACT for one in numbers(made))


def test_units_by_key_and_by_file(tmp_path):
    known = field(40.0, -20.0)
    hours = table(known.objects, RA=known.objects["ra"] / 15, D=np.radians(known.objects["dec"]))
    hours["F"] = 10 ** (-0.4 * (known.objects["mag_r"] - 31.4))  # nJy
    for name in ("ra", "dec", "mag_r"):
        del hours[name]
    maps = {"ra_hour": "RA", "dec_rad": "D", "flux_r_njy": "F"}
    made = scored(known, hours, tmp_path, maps)
    assert made["completeness"]["all"]["completeness"] == 1.0 and all(abs(one["mean"]) < 1e-6 for one in numbers(made))
    hours["RA"].unit, hours["D"].unit, hours["F"].unit = "hourangle", "rad", "nJy"
    made = scored(known, hours, tmp_path, {"ra": "RA", "dec": "D", "flux_r": "F"})
    assert made["purity"]["purity"] == 1.0
    with pytest.raises(InputError, match=r"the file has the unit .*, the key rad"):
        scored(known, hours, tmp_path, {"ra_rad": "RA", "dec": "D"})


def test_wrong_units_are_reported(tmp_path):
    known = field(40.0, -20.0)
    with pytest.raises(InputError, match="no source lies in the field"):
        scored(known, table(known.objects, ra=known.objects["ra"] / 15), tmp_path)
    with pytest.raises(InputError, match="not a position on the sky"):
        scored(known, table(known.objects, dec=known.objects["dec"] * 3600), tmp_path)
    with pytest.raises(InputError, match="no such column"):
        scored(known, table(known.objects), tmp_path, {"ra": "ALPHA"})
    with pytest.raises(InputError, match="unknown quantity"):
        scored(known, table(known.objects), tmp_path, {"mag_q": "mag_r"})
    with pytest.raises(InputError, match="not mapped"):
        only = table(known.objects)
        del only["dec"]
        scored(known, only, tmp_path)


@pytest.mark.parametrize("none", [-99.0, 99.0, -999.0, 9999.0, -9.99e3])
def test_numbers_that_stand_for_nothing_are_no_values(tmp_path, none):
    """A third of the rows has them: the rest is as perfect as before, and a line counts them."""
    known = field()
    made = table(known.objects)
    whole = scored(known, made, tmp_path)
    for name in ("mag_r", "z", "e1"):
        made[name][::3] = none
    made["z"][1::3] = -1.0
    some = scored(known, made, tmp_path)
    gone, n = len(made["z"][::3]), len(made)
    for line in (f"{gone} magnitudes in r", f"{2 * gone} redshifts", f"{gone} e1"):
        assert any(note.startswith(f"{line} are no values") for note in some["notes"]), line
    assert some["completeness"]["all"]["completeness"] == 1.0
    assert all(abs(one["mean"]) < EXACT for one in numbers(some) if one["n"]) and numbers(some)[1]["n"] < n
    for axis in ("e1", "e2"):
        assert abs(some["shapes"][axis]["slope"] - 1) < EXACT
        assert 0 < some["shapes"][axis]["n"] <= whole["shapes"][axis]["n"]
    assert some["redshifts"]["nmad"] == 0.0 and 0 < some["redshifts"]["n"] < whole["redshifts"]["n"]


def test_axes_and_positions_without_a_value(tmp_path):
    known = field()
    made, n = table(known.objects), len(known.objects)
    for name in ("e1", "e2"):
        made.remove_column(name)
    made["a"], made["b"], made["pa"] = np.full(n, 2.0), np.full(n, 1.0), np.full(n, 30.0)
    made["a"][:10] = made["b"][:10] = -1.0
    made["a"][10:20] = made["b"][10:20] = 99.0
    made["pa"][20:25] = -999.0
    made["dec"][-3:] = made["ra"][-3:] = -99.0
    read = scored(known, made, tmp_path, {"a": "a", "b": "b"})
    notes = " ".join(read["notes"])
    assert "20 major axes" in notes and "20 minor axes" in notes and "5 position angles" in notes
    assert "3 rows have no position" in notes and read["sources"] == n - 3
    assert read["shapes"]["e1"]["n"] == int((known.objects["size"][25:-3] > 0).sum())


def test_values_at_the_edge_of_the_possible_are_values(tmp_path):
    known = field()
    made = table(known.objects)
    made["z"][0], made["e1"][0], made["mag_r"][0] = -0.99, -1.5, 89.0
    assert not any("no values" in note for note in scored(known, made, tmp_path)["notes"])


@pytest.mark.parametrize(("unit", "factors"), [
    ("ra_hour", (15.0, 1.0)), ("ra_rad", (180 / np.pi, 1.0)), ("ra_rad, dec_rad", (180 / np.pi,) * 2),
])  # fmt: skip
@pytest.mark.parametrize("number", [1, 4, 400])
def test_another_unit_near_zero_is_refused(tmp_path, unit, factors, number):
    """Right ascensions of some arcseconds, and declinations, lie in the field in any unit."""
    known = field(0.0, 0.0)
    made = table(known.objects)[::-1][:number]
    made["ra"] = ((np.asarray(made["ra"]) + 180) % 360 - 180) / factors[0]
    made["dec"] = np.asarray(made["dec"]) / factors[1]
    with pytest.raises(InputError, match=unit.split(",")[0]):
        scored(known, made, tmp_path)


def test_a_catalogue_of_other_objects_near_zero_is_scored(tmp_path):
    """Nothing matches, in no unit: no word of units."""
    known = field(0.0, 0.0)
    made = table(known.objects)
    ra, dec = moved(np.asarray(made["ra"]), np.asarray(made["dec"]), 2.0, 1.5)
    made["ra"], made["dec"] = ra, dec
    found = scored(known, made, tmp_path)
    assert found["completeness"]["all"]["completeness"] == 0.0 and found["purity"]["purity"] == 0.0


def test_missing_quantities_are_not_evaluated_and_reported(tmp_path):
    known = field()
    only = table(known.objects)["ra", "dec"]
    made = scored(known, only, tmp_path)
    assert made["band"] is None and not made["photometry"] and "shapes" not in made and "redshifts" not in made
    assert len([note for note in made["notes"] if "not evaluated" in note]) == 3
    assert made["completeness"]["all"]["completeness"] == 1.0


@pytest.mark.parametrize("name", ["c.csv", "c.fits", "c.parquet", "c.ecsv"])
def test_every_form_of_a_file(tmp_path, name):
    known = field()
    made = scored(known, table(known.objects), tmp_path, name=name)
    assert made["purity"]["purity"] == 1.0 and made["redshifts"]["nmad"] < EXACT


def test_source_extractors_own_forms(tmp_path):
    (tmp_path / "a.cat").write_text(
        "#   1 ALPHA_J2000     Right ascension      [deg]\n#   2 DELTA_J2000     Declination     [deg]\n"
        "#   3 MAG_AUTO        Kron-like    [mag]\n  150.0 2.0 20.5\n  150.001 2.0 21.5\n"
    )
    read = read_catalogue(tmp_path / "a.cat", {"ra": "ALPHA_J2000", "dec": "DELTA_J2000", "mag_r": "MAG_AUTO"}, ("r",))
    assert read["ra"].tolist() == [150.0, 150.001] and read["mag_r"].tolist() == [20.5, 21.5]
    for name, text in (("b.cat", "nothing of the kind\n"), ("b.csv", ""), ("b.fits", "no FITS"), ("b.txt", "x")):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError):
            read_table(tmp_path / name)
    assert json.dumps(read.notes)


def test_a_column_number_beyond_all_memory_is_refused(tmp_path):
    """astropy would make all columns up to the number."""
    file = tmp_path / "a.cat"
    file.write_text("# 1 ALPHA_J2000 Right ascension [deg]\n#1000000000000   MAG_AUTO  Magnitude [mag]\n 10.0 20.0\n")
    with pytest.raises(InputError, match=r"MAG_AUTO: too large a number of a column \(got 1000000000000\)") as refused:
        read_table(file)
    assert str(file) in str(refused.value) and "<= 10000" in str(refused.value)


def test_a_column_of_one_letter_is_nothing_unless_mapped(tmp_path):
    """Magnitudes in columns called as the bands: z is no redshift."""
    known = field()
    changed = table(known.objects)["ra", "dec", "mag_r", "z"]
    changed["z"] = 23.0
    changed.write(tmp_path / "c.ecsv")
    read = read_catalogue(tmp_path / "c.ecsv", {}, known.bands)
    assert "z" not in read and "columns not used: z" in read.notes


def test_of_a_magnitude_and_a_flux_the_mapped_one_counts(tmp_path):
    known = field()
    changed = table(known.objects, flux_r=np.full(len(known.objects), 1.0))
    assert all(abs(one["mean"]) < EXACT for one in numbers(scored(known, changed, tmp_path)))
    changed["flux_r"] = 10 ** (-0.4 * (known.objects["mag_r"] - 23.9 + 0.1))
    made = scored(known, changed, tmp_path, {"flux_r": "flux_r"})
    assert all(abs(one["mean"] - 0.1) < 1e-6 for one in numbers(made))
    with pytest.raises(InputError, match="a magnitude and a flux"):
        scored(known, changed, tmp_path, {"flux_r": "flux_r", "mag_r": "mag_r"})


def test_columns_that_are_used_are_named_and_the_others_counted(tmp_path):
    known = field()
    made = table(known.objects)["ra", "dec", "mag_r"]
    for k in range(12):
        made[f"other{k:02d}"] = 1.0
    made.write(tmp_path / "c.ecsv")
    notes = read_catalogue(tmp_path / "c.ecsv", {}, known.bands).notes
    assert "mag_r: from column mag_r" in notes and "ra: from column ra" in notes
    [line] = [line for line in notes if "not used" in line]
    assert "other09 and 2 more" in line and "other10" not in line


def test_a_folder_of_bricks_is_one_catalogue(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    for brick in (1, 2):
        (tmp_path / "dataset" / f"Dir={brick}").mkdir(parents=True)
        made = pa.table({"ra": [10.0 * brick], "dec": [0.0], "mag_r": [20.0]})
        pq.write_table(made, tmp_path / "dataset" / f"Dir={brick}" / f"Npix={brick}.parquet")
    assert read_catalogue(tmp_path, {}, ("r",))["ra"].tolist() == [10.0, 20.0]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no parquet file"):
        read_table(tmp_path / "empty")
    pq.write_table(pa.table({"ra": [1.0]}), tmp_path / "dataset" / "z.parquet")
    with pytest.raises(InputError, match="not bricks of one table"):
        read_table(tmp_path)


def test_half_are_found_where_the_fraction_crosses_a_half():
    """Bins of half a magnitude; the fraction is linear between their middles. None crosses: no magnitude."""
    bins = [
        {"low": 20 + 0.5 * k, "high": 20.5 + 0.5 * k, "n": 10, "found": found} for k, found in enumerate((10, 8, 3, 0))
    ]
    assert half_found_magnitude(bins) == pytest.approx(20.75 + 0.5 * (0.8 - 0.5) / (0.8 - 0.3))
    assert half_found_magnitude(bins[:2]) is None and half_found_magnitude([]) is None


def test_what_only_a_grating_sees_is_on_no_image():
    corners = {"images": [[9.0, -1.0], [11.0, -1.0], [11.0, 1.0], [9.0, 1.0]]}
    corners["spectra"] = [[ra + 10.0, dec] for ra, dec in corners["images"]]
    frames = [
        {"file": "a", "filter": "r", "kind": "imaging", "corners": corners["images"]},
        {"file": "b", "filter": "GI", "kind": "slitless", "corners": corners["spectra"]},
    ]
    field = Field("two", None, frames)
    ra, dec = np.array([10.0, 20.0, 10.0]), np.array([0.0, 0.0, 2.0])
    for band, seen in ((None, [True, False, False]), ("r", [True, False, False]), ("gi", [False, False, False])):
        assert field.covers(ra, dec, band).tolist() == seen
