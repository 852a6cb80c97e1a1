"""Stacks, scores and biases of lines against closed forms."""

import json

import numpy as np
import pytest
from scipy.special import erf

from csstsim.base.errors import InputError
from csstsim.base.units import C_A_S, H_J_S
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.measure.spectra.line_columns import BLIND, PART
from csstsim.measure.spectra.spectrum_columns import BESIDE, CUT, DIM, LOST, SATURATED
from csstsim.studies.budget.redshift import report
from csstsim.studies.budget.redshift.figure import figure
from csstsim.studies.budget.redshift.frame_tables import FrameTables
from csstsim.studies.budget.redshift.line_biases import HALF_WIDTH, by_contamination, line_biases, mean
from csstsim.studies.budget.redshift.report import _check_band, _check_ids, _json_value, objects_of, read_answer, text
from csstsim.studies.budget.redshift.scores import CLASSES, RIGHT, score, scores
from csstsim.studies.budget.redshift.stack import STEP, UNUSED, stack_spectra, usable


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
    found = stack_spectra([one, other])
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
    found = stack_spectra([table.with_columns(flux=line / 3.4 / erg, flux_err=1.0 / erg)])
    assert (found["flux"] * STEP).sum() == pytest.approx(1.0, abs=1e-3)
    middle = (found["flux"] * found["wavelength"]).sum() / found["flux"].sum()
    assert middle == pytest.approx(6000.0 + 3.4 * 100.3, abs=0.05)


def test_what_cannot_be_used_is_left_out():
    lost = spectrum(1, 5000.0, 2.0, np.arange(50), 3.0, 0.2, flags=LOST)
    dim = spectrum(2, 5000.0, 2.0, np.arange(50), np.nan, 0.2, flags=DIM)
    assert len(stack_spectra([lost, dim])) == 0
    good = spectrum(3, 5000.0, 2.0, np.arange(1), 3.0, 0.2, contamination=5.0)
    found = stack_spectra([lost, good])
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
    x = np.arange(200, 200 + 2 * HALF_WIDTH + 1)
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


def test_only_galaxies_with_a_line_count():
    """True fluxes of 5 and 0.1 errors, below 0, and of no error: one line counts."""
    table, middle = line()
    tables = [table, table, table, table]
    lines = [lines_of(middle, ratio=0.9, flux=0.5), lines_of(middle, flux=0.01), lines_of(middle, flux=-3.0),
             lines_of(middle, flux=0.0, error=0.0)]  # fmt: skip
    row = by_contamination(line_biases(tables, lines))[0]
    assert row["lines"] == 1 and row["ratio"] == pytest.approx(0.9)


@pytest.mark.parametrize("n", [0, 1, 2, 5])
def test_points_of_the_figure_stand_at_their_labels(n, monkeypatch):
    from csstsim.studies.budget.redshift import figure as module

    saved = []
    monkeypatch.setattr(module, "png", saved.append)
    objects = {"id": np.arange(n), "z": np.linspace(0.1, 1.4, n), "magnitude": np.linspace(18.5, 22.2, n),
               "size": np.linspace(0.1, 0.7, n), "contamination": np.linspace(0.0, 2.0, n)}  # fmt: skip
    found = scores({k: (0.1, True) for k in range(n)}, objects)
    some = [{"low": 0.1 * k, "high": 0.1 * k + 0.1, "lines": 3, "ratio": 1.0, "ratio_err": 0.1, "shift": 0.2,
             "shift_err": 0.1} for k in range(n)]  # fmt: skip
    figure({"right": RIGHT, "band": "i", "lines": some} | found, {k: (0.1, True) for k in range(n)}, objects)
    axes = saved[0].axes
    for ax in axes[1:]:  # the last is the other axis of the lines
        ticks = [x for x in ax.get_xticks() if 0 <= x <= max(n - 1, 0)]
        assert ax.get_xlim() == (-0.5, max(len(ticks) - 0.5, 0.5))
        for bars in ax.containers:
            assert bars[0].get_xdata() == pytest.approx(ticks, abs=0.16)


def test_a_band_without_magnitudes_is_refused_with_those_that_there_are():
    truth = ObjectTable({"obj_type": np.full(2, GALAXY), "mag_i": np.full(2, np.nan), "mag_r": np.array([18.3, 18.7])})
    objects = ObjectTable({"id": np.arange(2), "magnitude": np.full(2, np.nan)})
    with pytest.raises(InputError, match=r"--band.*got 'i'.*allowed: r$"):
        _check_band([FrameTables(None, None, truth)], objects, ("r", "i"), "i")
    _check_band(
        [FrameTables(None, None, truth)], objects.with_columns(magnitude=np.array([np.nan, 18.0])), ("r", "i"), "i"
    )


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


def test_a_stack_has_each_object_of_each_frame_in_its_own_bins():
    """Two objects, in two frames of other steps and weights; second orders, columns without error and NaN do not count.

    Columns of 2 A at 5001, 5003, 5005, 5007: two to a bin of 4 A. The second frame has one column over two bins.
    """
    one = spectrum(7, 5001.0, 2.0, np.arange(4), 1.0, 0.5).with_columns(
        flux=np.array([1.0, 3.0, 5.0, np.nan]), flux_err=np.array([0.5, 1.0, 0.5, 0.5]),
        contamination=np.array([10.0, 20.0, 40.0, 7.0]),
    )  # fmt: skip
    second = spectrum(7, 5001.0, 2.0, np.arange(4), 99.0, 0.1).with_columns(order=np.full(4, 2, np.int8))
    bad = spectrum(7, 5001.0, 2.0, np.arange(4), 99.0, 0.0)
    other = spectrum(3, 5004.0, 4.0, np.arange(2), 8.0, 2.0)
    joined = ObjectTable({name: np.concatenate([t[name] for t in (one, second, bad, other)]) for name in one})
    more = spectrum(7, 5004.0, 4.0, np.arange(1), 9.0, 1.0)  # a column of unknown width is one step wide
    found = stack_spectra([joined, more])
    erg = H_J_S * C_A_S * 1e3
    assert found["id"].tolist() == [3, 3, 3, 7, 7] and found["frames"].tolist() == [1, 1, 1, 2, 2]
    assert found["wavelength"].tolist() == [5002.0, 5006.0, 5010.0, 5002.0, 5006.0]
    for k, (columns, other_share) in enumerate((([0, 1], 2.0), ([2], 2.0))):
        wave = np.array([5001.0, 5003.0, 5005.0])[columns]
        flux, error, width = (np.array(v)[columns] for v in ([1.0, 3.0, 5.0], [0.5, 1.0, 0.5], [2.0, 2.0, 2.0]))
        light = np.append(flux / wave, 9.0 / 5004) * erg
        sigma = np.append(error / wave, 1.0 / 5004) * erg
        weight = np.append(width, other_share) / STEP / sigma**2
        row = found.take([3 + k])
        assert row["flux"][0] == pytest.approx((weight * light).sum() / weight.sum(), rel=1e-6)
        wanted = np.sqrt((weight**2 * sigma**2).sum()) / weight.sum()
        assert row["flux_err"][0] == pytest.approx(wanted, rel=1e-6)
        others = np.append(np.array([1.0, 2.0, 4.0])[columns] / wave, 0.0) * erg
        assert row["contamination"][0] == pytest.approx((weight * others).sum() / weight.sum(), rel=1e-6)


def test_a_bin_of_two_columns_has_their_mean():
    """Columns of 4 A at 5004 and 5008 fill bins from 5000 on by a half, a whole and a half."""
    table = spectrum(1, 5004.0, 4.0, np.arange(2), 1.0, 1.0).with_columns(flux=np.array([2.0, 6.0]))
    found = stack_spectra([table])
    erg = H_J_S * C_A_S * 1e3 / np.array([5004.0, 5008.0])
    w = 1 / erg**2
    flux = np.array([2.0, 6.0]) * erg
    middle = (w * flux).sum() / w.sum()
    assert found["flux"] == pytest.approx([flux[0], middle, flux[1]])
    assert found["flux_err"] == pytest.approx([erg[0], np.sqrt((w**2 * erg**2).sum()) / w.sum(), erg[1]])


def test_which_columns_can_be_used():
    """Any of the five flags, no flux, and no error leave a column out; another flag does not."""
    flags = [0, DIM, LOST, SATURATED, BESIDE, CUT, UNUSED + 1 if UNUSED % 2 == 0 else 0, ~UNUSED & 0x3FFF]
    table = spectrum(1, 5000.0, 2.0, np.arange(8), 1.0, 1.0).with_columns(flags=np.array(flags, np.int16))
    assert usable(table).tolist() == [True, False, False, False, False, False, flags[6] & UNUSED == 0, True]
    bad = table.with_columns(flags=np.zeros(8, np.int16), flux=np.array([np.nan, np.inf, -1.0] + [1.0] * 5),
                             flux_err=np.array([1.0] * 3 + [0.0, -1.0, np.nan, 1.0, 1.0]))  # fmt: skip
    assert usable(bad).tolist() == [False, False, True, False, False, False, True, True]


def test_scores_by_class_have_the_objects_of_the_class():
    """Edges belong to the class above; what lies beyond the last class is in `all` alone; an answer of NaN is none."""
    objects = {
        "id": np.arange(1, 7), "z": np.array([0.2, 0.19, 0.6, 1.0, 2.9, 3.0]),
        "magnitude": np.array([18.0, 19.9, 20.0, 23.99, 24.0, np.nan]),
        "size": np.array([0.15, 0.1, 0.5, 0.8, 3.0, 0.2]),
        "contamination": np.array([0.0, 0.01, 0.1, 0.3, 1.0, np.inf]),
    }  # fmt: skip
    answer = {k: (z, True) for k, z in zip(range(1, 7), objects["z"], strict=True)} | {
        3: (np.nan, True),
        2: (0.5, False),
    }
    found = scores(answer, objects)
    count = {name: [(one["low"], one["high"], one["objects"], one["good"]) for one in found[name]] for name in CLASSES}
    assert count["magnitude"] == [(18.0, 20.0, 2, 1), (20.0, 21.0, 1, 0), (23.0, 24.0, 1, 1)]
    assert count["redshift"] == [
        (0.0, 0.2, 1, 0),
        (0.2, 0.4, 1, 1),
        (0.6, 0.8, 1, 0),
        (1.0, 1.5, 1, 1),
        (1.5, 3.0, 1, 1),
    ]
    assert count["size"] == [(0.0, 0.15, 1, 0), (0.15, 0.25, 2, 2), (0.5, 0.8, 1, 0), (0.8, 3.0, 1, 1)]
    assert count["contamination"] == [(0.0, 0.01, 1, 1), (0.01, 0.1, 1, 0), (0.1, 0.3, 1, 0), (0.3, 1.0, 1, 1),
                                      (1.0, np.inf, 1, 1)]  # fmt: skip
    assert (found["all"]["objects"], found["all"]["good"], found["all"]["completeness"]) == (6, 4, 4 / 6)


def test_a_fraction_has_the_error_of_the_rule_of_succession():
    """Three of four: Beta(4, 2) has the variance 4 * 2 / (6^2 * 7). A redshift at RIGHT is wrong, at FAR an outlier."""
    true = np.zeros(4)
    one = score(np.array([0.0, 0.0049, -0.0049, RIGHT]), np.ones(4, bool), true)
    assert (one["completeness"], one["purity"]) == (0.75, 0.75)
    assert one["completeness_err"] == pytest.approx(np.sqrt(8 / (36 * 7))) == one["purity_err"]
    far = score(np.array([0.0, 0.001, 0.002, 0.05]), np.array([1, 1, 1, 1], bool), true)
    assert far["bias"] == 0.001 and far["sigma"] == pytest.approx(1.4826e-3)
    none = score(np.array([0.3]), np.ones(1, bool), np.zeros(1))
    assert np.isnan([none["sigma"], none["bias"]]).all() and none["purity"] == 0


def test_lines_further_apart_than_the_window_count_each():
    """The strongest first; contamination is of usable columns of the first order of the line's own spectrum."""
    x = np.arange(100, 300)
    full = lambda value, kind=float: np.full(len(x), value, kind)  # noqa: E731
    own = {"column": x.astype(np.int32), "model": full(10.0), "contamination": full(1.0), "id": full(3, int),
           "order": full(1, np.int8), "flags": full(0, np.int16)}  # fmt: skip
    near = np.abs(x - 150) <= HALF_WIDTH
    own["contamination"] = np.where(near, 2.0, 5.0)
    own["flags"] = np.where(x == 150, LOST, 0).astype(np.int16)
    own["contamination"][x == 150], own["model"][x == 151], own["contamination"][x == 151] = 1e6, np.nan, 1e6
    other = own | {"order": full(2, np.int8), "contamination": full(1e5)}
    of_others = own | {"id": full(4, int), "contamination": full(1e5)}
    table = ObjectTable({name: np.concatenate([own[name], other[name], of_others[name]]) for name in own})
    one = lines_of(150.0, ratio=0.9, shift=-0.2, error=0.2, off=0.03, flux=2.0)
    weak = lines_of(150.0 + HALF_WIDTH, flux=1.5, error=0.2)
    far = lines_of(150.0 + HALF_WIDTH + 1, flux=1.0, error=0.2)
    second = lines_of(250.0, flux=9.0).with_columns(order=np.array([2], np.int8))
    none = lines_of(200.0, flux=9.0).with_columns(line=np.array([""]))
    some = ObjectTable({name: np.concatenate([t[name] for t in (weak, far, one, second, none)]) for name in one})
    found = line_biases([table], [some])
    assert [(one["id"], one["line"]) for one in found] == [(3, "Ha"), (3, "Ha")]
    assert found[0] == {
        "id": 3, "line": "Ha", "contamination": pytest.approx(0.2), "ratio": pytest.approx(0.9),
        "ratio_err": pytest.approx(0.1), "shift": pytest.approx(-0.18), "shift_err": pytest.approx(0.027),
    }  # fmt: skip
    assert found[1]["contamination"] == pytest.approx((29 * 2 + 31 * 5) / 600) and found[1][
        "ratio_err"
    ] == pytest.approx(0.2)


def test_means_of_lines_have_weights_and_the_larger_error():
    value, error = mean(np.array([1.0, 2.0]), np.array([0.1, 0.2]))
    assert value == pytest.approx((100 + 50) / 125) and error == pytest.approx(
        np.sqrt((0.2 * 100) ** 2 + (0.8 * 25) ** 2) / 125
    )
    assert mean(np.array([1.0, 1.0]), np.array([0.1, 0.2]))[1] == pytest.approx(1 / np.sqrt(125))
    classes = by_contamination([
        {"contamination": c, "ratio": k, "ratio_err": 0.1, "shift": -k, "shift_err": 0.2}
        for k, c in enumerate((0.0, -0.05, 0.3, 1.0, 40.0))
    ])  # fmt: skip
    assert [(one["low"], one["high"], one["lines"]) for one in classes] == [
        (0.0, 0.01, 1), (0.01, 0.1, 1), (0.1, 0.3, 0), (0.3, 1.0, 1), (1.0, np.inf, 2)
    ]  # fmt: skip
    assert classes[4]["ratio"] == pytest.approx(3.5) and classes[4]["shift"] == pytest.approx(-3.5)


def truth_of(ids, kinds, **columns):
    return ObjectTable(
        {"id": np.array(ids), "obj_type": np.array(kinds), **{k: np.array(v) for k, v in columns.items()}}
    )


def test_objects_of_a_budget_are_galaxies_with_the_light_of_all_their_frames():
    """Contamination is a ratio of sums, not a mean of ratios; ids without a truth, stars and second orders are out."""

    def frame(model, others, flags=0, order=1, ids=7):
        table = spectrum(ids, 5000.0, 2.0, np.arange(2), 1.0, 1.0, flags=flags)
        return table.with_columns(model=np.array(model), contamination=np.array(others, float),
                                  order=np.full(2, order, np.int8))  # fmt: skip

    def joined(*tables):
        return ObjectTable({name: np.concatenate([t[name] for t in tables]) for name in tables[0]})

    truth = truth_of([9, 7, 5], [GALAXY, GALAXY, STAR], z=[0.9, 0.7, 0.0], mag_r=[21.0, 20.0, 19.0],
                     mag_i=[20.5, 19.5, 18.5], size=[0.3, 0.2, 0.0])  # fmt: skip
    first = joined(
        frame([10.0, 30.0], [4.0, np.nan]), frame([0.0, 0.0], [4.0, 4.0], ids=9), frame([5.0, 5.0], [1.0, 1.0], ids=5),
        frame([5.0, 5.0], [1.0, 1.0], ids=8), frame([99.0, 99.0], [99.0, 99.0], order=2),
    )  # fmt: skip
    second = joined(frame([60.0, np.nan], [12.0, 50.0]), frame([99.0, 99.0], [99.0, 99.0], flags=LOST, ids=9))
    found = objects_of([FrameTables(first, None, truth), FrameTables(second, None, truth)], "mag_i")
    assert found["id"].tolist() == [7, 9] and found["z"].tolist() == [0.7, 0.9]
    assert found["magnitude"].tolist() == [19.5, 20.5] and found["size"].tolist() == [0.2, 0.3]
    assert found["contamination"][0] == pytest.approx(16 / 100) and np.isinf(found["contamination"][1])
    assert found["frames"].tolist() == [2, 1]
    assert len(objects_of([FrameTables(first.take([]), None, truth)], "mag_i")) == 0


def test_the_printed_lines_have_all_numbers():
    one = {"objects": 12, "good": 10, "completeness": 0.75, "completeness_err": 0.11, "purity": 0.9, "purity_err": 0.08,
           "sigma": 0.00123, "bias": -0.0004}  # fmt: skip
    lines = [{"low": 0.1, "high": 0.3, "lines": 7, "ratio": 0.98, "ratio_err": 0.01, "shift": -0.02, "shift_err": 0.03}]
    classes = {name: [{"low": 1.0, "high": 2.5} | one | {"objects": k}]
               for k, name in enumerate(("magnitude", "redshift", "size", "contamination"))}  # fmt: skip
    said = text({"right": RIGHT, "all": one, "lines": lines} | classes)
    assert said[0] == "right: |dz| / (1 + z) < 0.005"
    assert " ".join(said[1].split()) == (
        "all 12 galaxies, 10 good: complete 0.750 +- 0.110, pure 0.900 +- 0.080, sigma 0.00123, bias -0.00040"
    )
    assert [line.split()[:5] for line in said[2:6]] == [
        [name, "1", "to", "2.5", str(k)] for k, name in enumerate(classes)
    ]
    assert " ".join(said[-1].split()) == "0.1 to 0.3: 7 +0.9800 +- 0.0100 -0.0200 +- 0.0300"


def test_numbers_that_are_not_finite_are_null():
    given = {"a": [1.5, float("nan"), {"b": float("inf"), "c": 3}], "d": "x", "e": True}
    assert _json_value(given) == {"a": [1.5, None, {"b": None, "c": 3}], "d": "x", "e": True}


def test_an_id_that_no_spectrum_has_is_named():
    tables = [{"id": np.array([3, 4])}, {"id": np.array([9])}]
    _check_ids({3: 0, 9: 0}, tables, "a.csv")
    with pytest.raises(InputError, match=r"a\.csv: id: no spectrum has this id .*got 8"):
        _check_ids({9: 0, 8: 0}, tables, "a.csv")


@pytest.mark.parametrize("z", ["-1", "-1.5", "inf"])
def test_a_redshift_is_above_minus_one(tmp_path, z):
    (tmp_path / "a.csv").write_text(f"id,z,good\n1,{z},1\n")
    with pytest.raises(InputError, match=r"line 2, z.*above -1"):
        read_answer(tmp_path / "a.csv")
    for rows, said in (("x,0.5,1", "line 2, id"), ("1.0,0.5,1", "line 2, id"), ("1,0.5,1\n1,0.6,1", "line 3, id")):
        (tmp_path / "a.csv").write_text(f"id,z,good\n{rows}\n")
        with pytest.raises(InputError, match=said):
            read_answer(tmp_path / "a.csv")


def test_the_budget_writes_its_tables_and_scores(tmp_path, monkeypatch):
    """One frame of two galaxies, with an answer for one: what is written, logged and returned."""
    spectra = ObjectTable({
        name: np.concatenate([a, b]) for (name, a), b in zip(
            spectrum(7, 5000.0, 2.0, np.arange(8), 3.0, 0.2).items(),
            spectrum(8, 5000.0, 2.0, np.arange(8), 3.0, 0.2).values(), strict=True,
        )
    })  # fmt: skip
    spectra = spectra.with_columns(model=np.full(16, 5.0))
    truth = truth_of([7, 8], [GALAXY, GALAXY], z=[0.7, 0.8], mag_i=[20.5, 21.2], mag_r=[21.0, 22.0], size=[0.3, 0.2])
    frames = [FrameTables(spectra, lines_of(230.0), truth)]
    monkeypatch.setattr(report, "read_frame_tables", lambda runs, folder, log: frames)
    from types import SimpleNamespace

    run = SimpleNamespace(camera=SimpleNamespace(bands=("r", "i")))
    (tmp_path / "a.csv").write_text("id,z,good\n7,0.7001,1\n")
    said = []
    assert report.budget([run], tmp_path / "plain", log=said.append) is None
    assert sorted(path.name for path in (tmp_path / "plain").iterdir()) == ["objects.parquet", "stack.parquet"]
    found = report.budget([run], tmp_path / "out", answer=tmp_path / "a.csv", band="r", log=said.append)
    objects = ObjectTable.read(tmp_path / "out" / "objects.parquet")
    assert objects["magnitude"].tolist() == [21.0, 22.0] and objects.meta["band"] == "r"
    assert ObjectTable.read(tmp_path / "plain" / "objects.parquet")["magnitude"].tolist() == [20.5, 21.2]
    assert set(ObjectTable.read(tmp_path / "out" / "stack.parquet")["id"].tolist()) == {7, 8}
    assert (found["band"], found["frames"], found["right"]) == ("r", 1, RIGHT)
    assert (found["all"]["completeness"], found["all"]["purity"]) == (0.5, 1.0)
    assert json.loads((tmp_path / "out" / "redshift.json").read_text())["all"]["completeness"] == 0.5
    assert (tmp_path / "out" / "redshift.png").read_bytes().startswith(b"\x89PNG")
    assert said[0].startswith("2 galaxies in 1 frames") and any(line.startswith("right:") for line in said)
    with pytest.raises(InputError, match="--band: no such band"):
        report.budget([run], tmp_path / "no", band="z")


def test_the_figure_shows_what_was_answered():
    """Good and other redshifts against the true ones; fractions with their errors; lines in percent and px."""
    from matplotlib.figure import Figure

    from csstsim.studies.budget.redshift.figure import _fractions, _label, _lines, _measured

    axes = Figure().subplots(1, 3)
    objects = {"id": np.array([1, 2, 3]), "z": np.array([0.5, 0.6, 0.7])}
    _measured(axes[0], {1: (0.51, True), 2: (0.9, False), 3: (0.72, True), 4: (5.0, True)}, objects, RIGHT)
    bad, good = (dots.get_offsets().tolist() for dots in axes[0].collections)
    assert bad == [[0.6, 0.9]] and good == [[0.5, 0.51], [0.7, 0.72]] and axes[0].get_ylim()[1] == pytest.approx(0.99)
    labels = [words.get_text() for words in axes[0].get_legend().get_texts()]
    assert labels == ["not good: 1", "good: 2"]
    classes = [{"low": 0.0, "high": 0.5, "objects": 4, "completeness": 0.5, "completeness_err": 0.2, "purity": 0.9,
                "purity_err": 0.1}, {"low": 0.5, "high": np.inf, "objects": 6, "completeness": 0.6,
                "completeness_err": 0.3, "purity": 0.8, "purity_err": 0.15}]  # fmt: skip
    _fractions(axes[1], classes, "z")
    bars = [[[list(end) for end in part] for part in bar[2][0].get_segments()] for bar in axes[1].containers]
    assert np.array(bars)[:, :, :, 1] == pytest.approx(np.array([[[0.3, 0.7], [0.3, 0.9]], [[0.8, 1.0], [0.65, 0.95]]]))
    assert [words.get_text() for words in axes[1].texts] == ["4", "6"]
    assert [_label(one) for one in classes] == ["0 to\n0.5", "> 0.5"]
    none = {"lines": 0, "low": 1.0, "high": 2.0}
    _lines(axes[2], [{"low": 0.0, "high": 0.01, "lines": 3, "ratio": 0.97, "ratio_err": 0.01, "shift": 0.05,
                      "shift_err": 0.02}, none])  # fmt: skip
    [ratio], [shift] = axes[2].containers, axes[2].figure.axes[-1].containers
    assert np.array(ratio[2][0].get_segments())[0, :, 1] == pytest.approx([-4.0, -2.0])
    assert np.array(shift[2][0].get_segments())[0, :, 1] == pytest.approx([0.03, 0.07])
    assert axes[2].get_ylim() == pytest.approx((-4.8, 4.8)) and axes[2].figure.axes[-1].get_ylim()[1] == pytest.approx(
        0.084
    )


def test_a_column_is_as_wide_as_the_step_to_the_next_of_its_object():
    """Across a gap of three columns, to shorter wavelengths, and for ids that differ in their 62nd bit alone.

    Columns of 2 A that do not touch: the light of each lies in the bins that it covers, and in no other.
    """
    columns = np.array([10, 11, 15, 16])
    for sign in (1.0, -1.0):
        one = spectrum(5, 0.0, 1.0, columns, 1.0, 1.0).with_columns(wavelength=5001.0 + sign * 2.0 * (columns - 10))
        width = stacked_width(one)
        assert width == pytest.approx(np.full(4, 2.0)), sign
    last = spectrum(2**62, 5001.0, 2.0, np.arange(3), 1.0, 1.0)
    first = spectrum(2**62 + 1, 7001.0, 3.0, np.arange(7, 9), 1.0, 1.0)
    both = ObjectTable({name: np.concatenate([last[name], first[name]]) for name in last})
    assert stacked_width(both) == pytest.approx([2.0, 2.0, 2.0, 3.0, 3.0])


def stacked_width(table):
    """Return the width [angstrom] of each column: the weight of its light, alone, over all bins, times its variance."""
    from csstsim.studies.budget.redshift.stack import _columns

    found = _columns(table, 0)
    assert (found.high + found.low) / 2 == pytest.approx(table["wavelength"])
    return found.high - found.low


def test_lines_of_every_frame_are_scored(tmp_path, monkeypatch):
    """Three frames of one line each; their mean is of all, with the spectrum of their own frame."""
    from types import SimpleNamespace

    ratios, frames = (0.9, 1.0, 1.4), []
    for k, ratio in enumerate(ratios):
        one = spectrum(3, 5000.0, 2.0, np.arange(200, 261), 3.0, 0.2, contamination=2.0 * (k + 1))
        truth = truth_of([3], [GALAXY], z=[0.7], mag_i=[20.5], size=[0.3])
        frames.append(FrameTables(one.with_columns(model=np.full(61, 100.0)), lines_of(230.0, ratio=ratio), truth))
    monkeypatch.setattr(report, "read_frame_tables", lambda runs, folder, log: frames)
    (tmp_path / "a.csv").write_text("id,z,good\n3,0.7,1\n")
    run = SimpleNamespace(camera=SimpleNamespace(bands=("i",)))
    found = report.budget([run], tmp_path / "out", answer=tmp_path / "a.csv", log=lambda line: None)
    assert [one["lines"] for one in found["lines"]] == [0, 3, 0, 0, 0]
    assert found["lines"][1]["ratio"] == pytest.approx(np.mean(ratios)) and found["frames"] == 3
    assert ObjectTable.read(tmp_path / "out" / "objects.parquet")["contamination"][0] == pytest.approx(0.04)
