"""Stacks, scores and biases of lines against closed forms."""

import numpy as np
import pytest
from scipy.special import erf

from csstsim.base.errors import InputError
from csstsim.base.units import C_A_S, H_J_S
from csstsim.budget.redshift.figure import figure
from csstsim.budget.redshift.line_biases import SIDE, by_contamination, line_biases, mean
from csstsim.budget.redshift.report import _check_band, read_answer
from csstsim.budget.redshift.scores import RIGHT, score, scores
from csstsim.budget.redshift.stack import STEP, stacked
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.measure.spectra.line_columns import BLIND, PART
from csstsim.measure.spectra.spectrum_columns import DIM, LOST


def spectrum(object_id, first, per, columns, flux, error, contamination=0.0, flags=0):
    """A table of one spectrum of constant flux [photon / s / m2 / A]; sensitivity 10 electrons a unit."""
    n = len(columns)
    full = lambda value, kind=float: np.full(n, value, kind)  # noqa: E731
    return ObjectTable({
        "id": full(object_id, np.int64), "order": full(1, np.int8), "column": np.asarray(columns, np.int32),
        "wavelength": first + per * np.arange(n), "flux": full(flux), "flux_err": full(error),
        "sensitivity": full(10.0), "contamination": full(contamination), "flags": full(flags, np.int16),
    })  # fmt: skip


def test_a_flat_spectrum_of_two_frames_stays_flat_and_its_error_falls():
    """2 A columns in 4 A bins: two columns a bin, the weights' mean, and errors as of independent columns."""
    one = spectrum(7, 5001.0, 2.0, np.arange(100), 3.0, 0.2)
    other = spectrum(7, 5199.0, -2.0, np.arange(100), 5.0, 0.4)  # dispersed the other way
    found = stacked([one, other])
    inner = found.take((found["wavelength"] > 5002) & (found["wavelength"] < 5198))
    weights = np.array([1 / 0.2**2, 1 / 0.4**2])
    erg = H_J_S * C_A_S / inner["wavelength"] * 1e3
    assert set(np.diff(inner["wavelength"])) == {STEP} and set(inner["frames"]) == {2}
    assert inner["flux"] == pytest.approx((weights * [3.0, 5.0]).sum() / weights.sum() * erg, rel=1e-3)
    assert inner["flux_err"] == pytest.approx(erg / np.sqrt(2 * weights.sum()), rel=1e-3)


def test_a_stack_keeps_the_light_of_a_line():
    """A Gaussian of 3 px rms in 3.4 A columns, in bins of 4 A: sum of flux times width, to 1e-6."""
    columns = np.arange(200)
    table = spectrum(1, 6000.0, 3.4, columns, 0.0, 1.0)
    edges = np.arange(201) - 0.5
    line = np.diff(0.5 * (1 + erf((edges - 100.3) / 3 / np.sqrt(2))))
    erg = H_J_S * C_A_S / table["wavelength"] * 1e3
    found = stacked([table.with_columns(flux=line / 3.4 / erg, flux_err=1.0 / erg)])
    assert (found["flux"] * STEP).sum() == pytest.approx(1.0, abs=1e-3)
    middle = (found["flux"] * found["wavelength"]).sum() / found["flux"].sum()
    assert middle == pytest.approx(6000.0 + 3.4 * 100.3, abs=0.05)


def test_what_cannot_be_used_is_left_out():
    lost = spectrum(1, 5000.0, 2.0, np.arange(50), 3.0, 0.2, flags=LOST)
    dim = spectrum(2, 5000.0, 2.0, np.arange(50), np.nan, 0.2, flags=DIM)
    assert len(stacked([lost, dim])) == 0
    good = spectrum(3, 5000.0, 2.0, np.arange(1), 3.0, 0.2, contamination=5.0)
    found = stacked([lost, good])
    assert set(found["id"].tolist()) == {3}
    assert found["contamination"] == pytest.approx(0.5 * H_J_S * C_A_S / 5000.0 * 1e3, rel=1e-6)


def test_scores_of_answers_known_by_hand():
    """Ten galaxies: six right and sure, one sure and wrong, one right and not sure, two without an answer."""
    true = np.linspace(0.1, 1.0, 10)
    z, good = true.copy(), np.array([1, 1, 1, 1, 1, 1, 1, 0, 0, 0], bool)
    z[:6] += 0.001 * (1 + true[:6]) * np.array([1, -1, 1, -1, 1, -1])
    z[6] += 2 * RIGHT * (1 + true[6])
    one = score(z, good, true)
    assert (one["completeness"], one["purity"], one["good"]) == (0.6, 6 / 7, 7)
    assert one["sigma"] == pytest.approx(1.4826 * 0.002, rel=1e-6) and one["bias"] == pytest.approx(0.001, rel=1e-6)
    answer = {k: (z[k], bool(good[k])) for k in range(8)}
    objects = {"id": np.arange(10), "z": true, "magnitude": np.full(10, 21.2), "size": np.full(10, 0.3),
               "contamination": np.linspace(0, 2, 10)}  # fmt: skip
    found = scores(answer, objects)
    assert found["all"] == one and [part["objects"] for part in found["magnitude"]] == [10]
    assert sum(part["objects"] for part in found["contamination"]) == 10
    assert sum(part["good"] for part in found["redshift"]) == 7


def test_scores_of_nothing():
    empty = score(np.zeros(0), np.zeros(0, bool), np.zeros(0))
    assert empty["objects"] == 0 and np.isnan([empty[name] for name in ("completeness", "purity", "sigma")]).all()
    assert np.isnan(mean(np.zeros(0), np.zeros(0))).all()


def line(contamination=0.0, flags=0):
    """Columns about a line: a table of one spectrum, 100 electrons each, and the line's column."""
    x = np.arange(200, 200 + 2 * SIDE + 1)
    full = lambda value, kind=float: np.full(len(x), value, kind)  # noqa: E731
    columns = {"column": x.astype(np.int32), "model": full(100.0), "contamination": full(contamination)}
    return ObjectTable(columns | {"id": full(3, int), "order": full(1, np.int8), "flags": full(flags, np.int16)}), 230.0


def lines_of(middle, count=1, flux=1.0, flags=0, ratio=1.0, shift=0.0, error=0.1, off=0.02):
    """Lines 4 columns apart of the same true flux; ratio, shift and their errors as measured."""
    full = lambda value: np.full(count, value)  # noqa: E731
    return ObjectTable({
        "id": np.full(count, 3), "order": np.ones(count, np.int8), "line": np.array(["Ha", "[NII]"][:count]),
        "column": middle + 4.0 * np.arange(count), "flux_true": np.full(count, flux), "flux_err": full(error),
        "flags": np.full(count, flags, np.int16), "flux": full(ratio * flux), "shift": full(shift),
        "shift_err": full(off),
    })  # fmt: skip


def test_lines_are_sorted_by_contamination_and_blends_count_once():
    table, middle = line(contamination=20.0)
    found = line_biases([table], [lines_of(middle, 2, ratio=0.95, shift=0.05)])
    assert len(found) == 1 and found[0]["contamination"] == pytest.approx(0.2)
    classes = [one for one in by_contamination(found) if one["lines"]]
    assert [one["low"] for one in classes] == [0.1] and classes[0]["ratio"] == pytest.approx(0.95)
    assert classes[0]["shift"] == pytest.approx(0.05 * 0.95) and classes[0]["shift_err"] == pytest.approx(0.02 * 0.95)
    for lines in (lines_of(middle, flags=PART), lines_of(middle, flags=BLIND), lines_of(middle, flux=0.05)):
        assert line_biases([table], [lines]) == []
    [lost] = line_biases([line(flags=LOST)[0]], [lines_of(middle)])
    assert np.isinf(lost["contamination"]) and by_contamination([lost])[-1]["lines"] == 0


def test_means_of_noisy_lines_are_not_biased():
    """4000 lines of S/N 4: flux and s F are Gaussian, and the mean is right to 5 sigma, 0.02 and 0.008 px."""
    rng, (table, middle) = np.random.default_rng(7), line()
    found = []
    for _ in range(4000):
        flux, k = 1 + 0.25 * rng.normal(), 0.05 + 0.1 * rng.normal()
        more = {"ratio": flux, "shift": k / flux, "off": 0.1 / abs(flux), "error": 0.25}
        found += line_biases([table], [lines_of(middle, **more)])
    row = by_contamination(found)[0]
    assert row["lines"] == 4000 and row["ratio"] == pytest.approx(1.0, abs=5 * 0.25 / np.sqrt(4000))
    assert row["shift"] == pytest.approx(0.05, abs=5 * 0.1 / np.sqrt(4000))
    assert row["shift_err"] == pytest.approx(0.1 / np.sqrt(4000), rel=0.1)


def test_a_galaxy_without_a_line_does_not_count_beside_one_that_has_it():
    """True fluxes of 5 and 0.1 errors, below 0, and of no error: one line counts."""
    table, middle = line()
    tables = [table, table, table, table]
    lines = [lines_of(middle, ratio=0.9, flux=0.5), lines_of(middle, flux=0.01), lines_of(middle, flux=-3.0),
             lines_of(middle, flux=0.0, error=0.0)]  # fmt: skip
    row = by_contamination(line_biases(tables, lines))[0]
    assert row["lines"] == 1 and row["ratio"] == pytest.approx(0.9)


@pytest.mark.parametrize("n", [0, 1, 2, 5])
def test_points_of_the_figure_stand_at_their_labels(n, monkeypatch):
    from csstsim.budget.redshift import figure as module

    drawn = []
    monkeypatch.setattr(module, "png", drawn.append)
    objects = {"id": np.arange(n), "z": np.linspace(0.1, 1.4, n), "magnitude": np.linspace(18.5, 22.2, n),
               "size": np.linspace(0.1, 0.7, n), "contamination": np.linspace(0.0, 2.0, n)}  # fmt: skip
    found = scores({k: (0.1, True) for k in range(n)}, objects)
    some = [{"low": 0.1 * k, "high": 0.1 * k + 0.1, "lines": 3, "ratio": 1.0, "ratio_err": 0.1, "shift": 0.2,
             "shift_err": 0.1} for k in range(n)]  # fmt: skip
    figure({"right": RIGHT, "band": "i", "lines": some} | found, {k: (0.1, True) for k in range(n)}, objects)
    axes = drawn[0].axes
    for ax in axes[1:]:  # the last is the other axis of the lines
        places = [x for x in ax.get_xticks() if 0 <= x <= max(n - 1, 0)]
        assert ax.get_xlim() == (-0.5, max(len(places) - 0.5, 0.5))
        for bars in ax.containers:
            assert bars[0].get_xdata() == pytest.approx(places, abs=0.16)


def test_a_band_without_magnitudes_is_refused_with_those_that_there_are():
    truth = ObjectTable({"obj_type": np.full(2, GALAXY), "mag_i": np.full(2, np.nan), "mag_r": np.array([18.3, 18.7])})
    objects = ObjectTable({"id": np.arange(2), "magnitude": np.full(2, np.nan)})
    with pytest.raises(InputError, match=r"--band.*got 'i'.*allowed: r$"):
        _check_band([(None, None, truth)], objects, ("r", "i"), "i")
    _check_band([(None, None, truth)], objects.with_columns(magnitude=np.array([np.nan, 18.0])), ("r", "i"), "i")


@pytest.mark.parametrize("text", [b"", b"id,z,good\n", b"\xef\xbb\xbfid,z,good\r\n", b"\n\n"])
def test_an_answer_without_a_row_is_refused(tmp_path, text):
    (tmp_path / "a.csv").write_bytes(text)
    with pytest.raises(InputError, match=r"a\.csv: not an answer: no row; allowed: id, z, good"):
        read_answer(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("heads", "lacks"), [("id,z", "good"), ("ID,z,good", "id"), ("number,redshift", "id, z, good")]
)
def test_an_answer_without_a_column_names_it_and_those_that_it_has(tmp_path, heads, lacks):
    (tmp_path / "a.csv").write_text(f"{heads}\n1,0.5,1\n")
    with pytest.raises(InputError, match=rf"a\.csv: columns: not an answer: it lacks {lacks} \(got '{heads[:2]}"):
        read_answer(tmp_path / "a.csv")


def test_an_answer_says_good_or_not_and_nothing_else(tmp_path):
    (tmp_path / "a.csv").write_text("id,z,good\n1,0.5,1\n90071992547409930,-0.1,0\n")
    assert read_answer(tmp_path / "a.csv") == {1: (0.5, True), 90071992547409930: (-0.1, False)}
    for value in ("2", "-1", "0.5", "nan", "", "yes"):
        (tmp_path / "a.csv").write_text(f"id,z,good\n1,0.5,{value}\n")
        with pytest.raises(InputError, match=r"line 2, good.*0 or 1"):
            read_answer(tmp_path / "a.csv")


def test_an_answer_with_a_byte_order_mark_is_read(tmp_path):
    (tmp_path / "a.csv").write_text("id,z,good\n1,0.5,1\n", encoding="utf-8-sig")
    assert read_answer(tmp_path / "a.csv") == {1: (0.5, True)}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("id,z,good,z\n1,0.5,1,0.7\n", r"a\.csv: z: the column is given twice; allowed: one column of each name"),
        ("id,z,good,note,note\n1,0.5,1,a,b\n", r"a\.csv: note: the column is given twice"),
        ("id,z,good\n1,0.5,1\n2,0,5,1\n", r"a\.csv: line 3: more cells than the heading \(got 4\); allowed: 3"),
    ],
)
def test_an_answer_has_each_column_once_and_no_cell_beyond_them(tmp_path, text, said):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_answer(tmp_path / "a.csv")
