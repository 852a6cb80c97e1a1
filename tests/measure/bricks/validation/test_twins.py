"""The twin study: differences of the same objects, their means and errors in closed form, and the page."""

import numpy as np
import pytest

from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame
from csstsim.measure.bricks.validation.trials import RESOLVED
from csstsim.measure.bricks.validation.twins import (
    MIN_OBJECTS,
    binned,
    differences,
    mean,
    measured_objects,
    spectral_differences,
    summary,
    summed_spectra,
    values,
)
from csstsim.measure.source_columns import SATURATED
from csstsim.report.twin_figure import twin_figure
from csstsim.report.variants_page import Study, write_variants

SIGMAS = 5.0
COUNT = 8


def frame_of(shift=0.0, rows=range(COUNT), **columns):
    """A frame of stars and galaxies in turn, 20 px apart, measured `shift` mag and px off."""
    rows = np.asarray(rows)
    place = 50.0 + 20.0 * rows
    given = {
        "x": place + shift, "y": place, "mag_psf": 20.0 + rows + shift, "mag_total": 21.0 + rows + 2 * shift,
        "hsm_sigma": np.full(len(rows), 2.0) * np.exp(shift), "hsm_e1": np.full(len(rows), 0.1 + shift),
        "hsm_e2": np.zeros(len(rows)), "g1": np.full(len(rows), 0.2 + shift), "g2": np.zeros(len(rows)),
        "resolution": np.full(len(rows), 0.9), "flags": np.zeros(len(rows), np.int32), "snr": np.full(len(rows), 50.0),
    }  # fmt: skip
    return MeasuredFrame(None, ObjectTable(given | columns, {"filter": "r"}), 4616, 0.074)


def truth_of(count=COUNT):
    rows = np.arange(count)
    kind = np.where(rows % 2, GALAXY, STAR).astype(np.int8)
    zero = np.zeros(count)
    return ObjectTable({
        "id": 100 + rows, "x": 50.0 + 20.0 * rows, "y": 50.0 + 20.0 * rows, "obj_type": kind, "mag_r": 20.0 + rows,
        "blended": zero.astype(bool), "half_light": zero, "size_disk": zero, "size_bulge": zero, "bulge_frac": zero,
    })  # fmt: skip


def test_differences_are_of_the_same_objects_whatever_their_rows():
    first, counts = measured_objects(frame_of(), truth_of())
    order = [6, 5, 4, 3, 2, 1]
    other, fewer = measured_objects(frame_of(0.01, order), truth_of())
    assert counts == {"sources": 8, "matched": 8, "other": 0} and fewer["sources"] == 6
    found = differences(first, other)
    assert sorted(found) == [100 + row for row in sorted(order)]
    for number, one in found.items():
        star = number % 2 == 0
        assert one["kind"] == ("star" if star else "galaxy")
        assert one["mag"] == pytest.approx(0.01 if star else 0.02) and one["x"] == pytest.approx(0.01)
        assert one["size"] == pytest.approx(0.01) and one["e1"] == pytest.approx(0.01) and one["y"] == 0
        assert np.isnan(one["g1"]) if star else one["g1"] == pytest.approx(0.01)


def test_flags_leave_values_out():
    count = COUNT
    flags, resolution = np.zeros(count, np.int32), np.full(count, 0.9)
    flags[0], resolution[1] = SATURATED, RESOLVED / 2
    snr = np.full(count, 50.0)
    snr[2] = 4.9
    found, counts = measured_objects(frame_of(flags=flags, resolution=resolution, snr=snr), truth_of())
    assert np.isnan([found[100][name] for name in ("mag", "x", "size", "e1")]).all()
    assert np.isnan(found[101]["g1"]) and np.isfinite(found[101]["e1"])
    assert counts == {"sources": 7, "matched": 7, "other": 0}
    _, counts = measured_objects(frame_of(), truth_of(5))
    assert counts == {"sources": 8, "matched": 5, "other": 3}
    assert (
        measured_objects(frame_of(), truth_of(0))[0] == {} and measured_objects(frame_of(rows=[]), truth_of())[0] == {}
    )


def test_means_have_the_errors_of_normal_differences():
    rng, runs, count = np.random.default_rng(8), 300, 60
    made = [mean(rng.normal(0.2, 1.5, count)) for _ in range(runs)]
    found, stated = np.array([one.mean for one in made]), np.mean([one.error for one in made])
    assert found.mean() == pytest.approx(0.2, abs=SIGMAS * stated / np.sqrt(runs))
    assert found.std() == pytest.approx(stated, rel=SIGMAS / np.sqrt(2 * runs))
    noise = rng.normal(0, 1, 100)
    one = mean([*noise, 40.0, np.nan])
    assert (one.n, one.outliers, one.changed) == (101, 1, 101) and one.mean == pytest.approx((noise.sum() + 40) / 101)
    assert one.clipped_mean == pytest.approx(noise.mean()) and one.clipped_error == pytest.approx(
        noise.std(ddof=1) / 10
    )
    assert np.isnan(mean([1.0] * (MIN_OBJECTS - 1)).mean) and mean([]).n == 0
    most_alike = mean([0.0] * 20 + [1.0])
    assert most_alike.mean == pytest.approx(1 / 21) and most_alike.changed == 1 and mean([0.0] * 9).error == 0


def test_a_local_effect_is_in_the_mean():
    """90 objects differ by rounding alone, 29 by 0.1 mag: the mean has the 29, the other mean is said to have none."""
    rounding = np.random.default_rng(4).normal(0, 1e-6, 90)
    one = mean([*rounding, *[0.1] * 29])
    assert one.n == 119 and one.outliers == 29 and abs(one.clipped_mean) < 1e-6
    share = 29 / 119
    assert one.mean == pytest.approx(0.1 * share, rel=1e-4)
    assert one.error == pytest.approx(0.1 * np.sqrt(share * (1 - share) / 118), rel=1e-4)


def spectrum(number, electrons, flags=0):
    n = len(electrons)
    return ObjectTable({
        "id": np.full(n, number), "order": np.ones(n, np.int8), "column": np.arange(n), "flags": np.full(n, flags),
        "electrons": np.asarray(electrons, float), "electrons_err": np.ones(n),
    })  # fmt: skip


def test_spectra_are_compared_over_common_columns():
    first, other = (
        summed_spectra(spectrum(7, [100.0, np.nan, 300.0])),
        summed_spectra(spectrum(7, [110.0, 50.0, 290.0, 9.0])),
    )
    found = spectral_differences(first, other)
    assert found[7]["spectrum"] == pytest.approx(0.0) and found[7]["true"] == pytest.approx(-2.5 * np.log10(400))
    other = summed_spectra(spectrum(7, [110.0, 50.0, 330.0]))
    assert spectral_differences(first, other)[7]["spectrum"] == pytest.approx(0.1)
    assert spectral_differences(first, summed_spectra(spectrum(7, [1.0], flags=1))) == {}
    assert spectral_differences(summed_spectra(spectrum(7, [-1.0])), summed_spectra(spectrum(7, [1.0]))) == {}


def many(count=40):
    rng = np.random.default_rng(3)
    return [
        {"kind": "star", "true": 20.0 + k % 4, "mag": rng.normal(0.01, 0.001), "x": 0.0, "size": np.nan}
        for k in range(count)
    ]


def test_bins_have_every_object_once():
    at, means = binned(many(), "star", "mag")
    assert list(at) == [20, 21, 22, 23] and sum(one.n for one in means) == 40
    assert len(binned(many(), "galaxy", "mag")[0]) == 0 and values(many(), "star", "size").shape == (2, 0)
    rows = {(kind, name): one for kind, name, one in summary(many())}
    assert rows["star", "mag"].mean == pytest.approx(0.01, abs=0.001) and ("galaxy", "mag") not in rows


def test_the_page_says_what_differs(tmp_path):
    gate = {"name": "completeness", "band": "r", "value": 0.97, "threshold": 0.9, "n": 50, "margin": 0.3, "brick": 5}
    verdicts = {
        "base": {"passed": True, "gates": [gate | {"passed": True}]},
        "worse": {
            "passed": False,
            "gates": [
                gate | {"passed": False, "value": value, "margin": 20 * (1 - value)} for value in (0.5, 0.7, 0.6)
            ],
        },
    }
    for verdict in verdicts.values():
        passed = verdict["passed"]
        verdict["counts"] = {"pass": int(passed), "fail": int(not passed), "not evaluated": 0}
    counts = {"base": {"sources": 9, "matched": 8, "other": 1}, "variant": {"sources": 7, "matched": 7, "other": 0}}
    none = {"base": {}, "variant": {}}
    studies = [Study("worse", {"psf.grid": 3}, many(), counts), Study("<odd>", {"seed": 3}, [], none)]
    write_variants(tmp_path / "variants.html", "mini", verdicts, studies)
    text = (tmp_path / "variants.html").read_text()
    shown = f"{summary(many())[0][2].mean:+.3g}"
    assert all(
        word in text
        for word in ("0.5 (10.00) FAIL", "0.97 (0.30)", "0 of 1 evaluated", "psf.grid", shown, "&lt;odd&gt;")
    )
    assert text.count("data:image/webp") == 1 and twin_figure([]) is None


def test_far_is_beyond_five_robust_sigmas_of_the_median():
    """Deviations from the median 0 have a median of 2: the limit is 5 x 1.4826 x 2 = 14.826."""
    some = [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]
    one = mean([*some, 14.8, -14.9])
    assert (
        (one.n, one.outliers) == (9, 1)
        and one.clipped_mean == pytest.approx(14.8 / 8)
        and one.mean == pytest.approx(-0.1 / 9)
    )
    assert one.scatter == pytest.approx(np.std([*some, 14.8, -14.9], ddof=1))
    assert one.clipped_error == pytest.approx(np.std([*some, 14.8], ddof=1) / 8**0.5)


def test_every_quantity_is_its_own_column():
    columns = {"y": 3.0, "hsm_e2": 0.4, "g2": 0.5, "hsm_sigma": np.e**2, "mag_psf": 19.5, "mag_total": 18.5}
    frame = frame_of(**{name: np.full(COUNT, value) for name, value in columns.items() if name != "y"})
    found, _ = measured_objects(frame, truth_of())
    for number, one in found.items():
        star = number % 2 == 0
        assert one["true"] == 20.0 + number - 100 and one["mag"] == (19.5 if star else 18.5)
        assert (one["x"], one["y"]) == (50.0 + 20 * (number - 100),) * 2 and one["size"] == pytest.approx(2.0)
        assert (one["e1"], one["e2"]) == (0.1, 0.4)
        assert np.isnan(one["g2"]) if star else (one["g1"], one["g2"]) == (0.2, 0.5)
    moved, _ = measured_objects(frame_of(y=50.0 + 20.0 * np.arange(COUNT) + 0.5), truth_of())
    assert differences(found, moved)[100]["y"] == 0.5 and differences(found, moved)[101]["g2"] == -0.5
    blended = truth_of().with_columns(blended=np.arange(COUNT) == 1)
    apart, _ = measured_objects(frame, blended)
    assert np.isnan([apart[101][name] for name in ("size", "e1", "e2", "g1", "g2")]).all() and apart[101]["mag"] == 18.5


def test_orders_of_a_spectrum_are_columns_of_their_own():
    first, other = spectrum(7, [100.0, 200.0]), spectrum(7, [130.0, 190.0])
    second = [table.with_columns(order=np.full(2, 2)) for table in (spectrum(7, [40.0, 60.0]), spectrum(7, [0.0, 0.0]))]
    both = [summed_spectra(ObjectTable.concat(pair)) for pair in zip((first, other), second, strict=True)]
    assert spectral_differences(*both)[7]["spectrum"] == pytest.approx((20.0 - 100.0) / 400.0)
    lost = first.with_columns(electrons_err=np.array([np.nan, 1.0]))
    assert summed_spectra(lost) == {7: {(1, 1): (200.0, 1.0)}}


def test_bins_are_of_whole_magnitudes():
    objects = [{"kind": "star", "true": 20.0 + 0.1 * k, "mag": float(k >= 10)} for k in range(20)]
    at, means = binned([*objects, {"kind": "star", "true": 25.0, "mag": 9.0}], "star", "mag")
    assert at == pytest.approx([20.45, 21.45]) and [one.mean for one in means] == [0.0, 1.0]
