"""Recovered objects: matching, bins and their errors in closed form, and the command on files."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from astropy.io import fits
from astropy.table import Table
from click.testing import CliRunner
from inject.scene import CHIP, OBSID, objects, simulation
from scipy.stats import binom, binomtest, norm

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.command_line.main import main
from csstsim.inject.recovery.bins import AGAINST, OBJECTS_MIN, binned, fraction, number
from csstsim.inject.recovery.figure import _objects, draw
from csstsim.inject.recovery.recover import _of_image, left_out, lines
from csstsim.inject.recovery.recovered import COLUMNS, density, recovered
from csstsim.instrument.chip import Window
from csstsim.measure.source_columns import BAD_PIXELS, SATURATED, TRUNCATED

SIGMAS = 5.0
WINDOW, SCALE, ZERO = Window(100, 300, 50, 250), 0.074, 30.0


def truth_of(x, y, mag=20.0, kind=STAR, **columns):
    count = len(x)
    given = {"id": np.arange(count), "x": np.asarray(x, float), "y": np.asarray(y, float), "mag": np.full(count, mag)}
    given |= {name: np.zeros(count) for name in ("e1", "e2", "g1", "g2")}
    given |= {"size": np.full(count, 0.3), "obj_type": np.full(count, kind, np.int8), "drawn": np.ones(count)}
    return ObjectTable(given | {name: np.asarray(values) for name, values in columns.items()})


def sources_of(x, y, mag=20.0, **columns):
    count = len(x)
    flux = np.full(count, 10 ** (0.4 * (ZERO - mag)))
    given = {"x": np.asarray(x, float), "y": np.asarray(y, float), "zeropoint": np.full(count, ZERO)}
    for kind in ("psf", "total"):
        given |= {f"mag_{kind}": np.full(count, mag), f"flux_{kind}": flux, f"flux_{kind}_err": 0.01 * flux}
    given |= {"snr": np.full(count, 100.0), "pos_err": np.full(count, 0.1 * SCALE), "flags": np.zeros(count, np.int32)}
    given |= {"g1": np.zeros(count), "g2": np.zeros(count)}
    return ObjectTable(given | {name: np.asarray(values) for name, values in columns.items()})


def test_a_source_of_the_original_is_not_taken_for_an_injected_one():
    truth = truth_of([120.0, 150.0, 200.0, 280.0], [100.0] * 4)
    before = sources_of([151.0, 201.0], [100.0, 100.0])
    # The first is found; the second is hidden by the old source at 151, unchanged; the third is blended with the old
    # one at 201: the common source lies nearer to it; the fourth is not found
    sources = sources_of([120.4, 151.0, 200.3], [100.0, 100.0, 100.0])
    table = recovered(truth, sources, before, WINDOW, SCALE)
    assert list(table["found"]) == [True, False, True, False]
    assert table["d_x"][[0, 2]] == pytest.approx([0.4, 0.3]) and np.isnan(table["d_x"][1])
    assert table["x_pull"][0] == pytest.approx(4.0)


def test_values_are_measured_less_true():
    truth = truth_of(
        [120.0, 150.0], [100.0, 100.0], obj_type=[STAR, GALAXY], e1=[0.0, 0.2], g1=[0.0, 0.1], g2=[0.0, 0.05]
    )
    sources = sources_of([120.0, 150.0], [100.5, 100.0], mag=19.9, g1=[0.0, 0.3], flags=[0, SATURATED])
    table = recovered(truth, sources, sources_of([], []), WINDOW, SCALE)
    assert table["d_mag"] == pytest.approx([-0.1, -0.1]) and list(table["clean"]) == [True, False]
    assert table["flux_pull"] == pytest.approx(100 * (1 - 10**-0.04))
    lensed = (0.2 + 0.1 + 0.05j) / (1 + (0.1 - 0.05j) * 0.2)
    assert np.isnan(table["d_g1"][0])
    assert (table["d_g1"][1], table["d_g2"][1]) == pytest.approx((0.3 - lensed.real, -lensed.imag))
    assert list(table["size"]) == [0.0, 0.3]


def test_objects_outside_or_without_light_do_not_count():
    truth = truth_of([99.0, 120.0, 150.0, 310.0], [100.0] * 4, drawn=[1.0, 1.0, 0.0, 1.0])
    for sources in (sources_of([120.0], [100.0]), sources_of([], [])):
        table = recovered(truth, sources, sources_of([], []), WINDOW, SCALE)
        assert list(table["id"]) == [1] and table["found"][0] == (len(sources) > 0)
    nothing = recovered(truth_of([], []), sources_of([], []), sources_of([], []), WINDOW, SCALE)
    assert len(nothing) == 0 and binned(nothing, "mag") == []


def test_density_is_of_the_sources_within_fifteen_arcsec():
    inside, outside = 14.9 / SCALE, 15.1 / SCALE
    others = np.array([[inside, 0.0], [0.0, -inside], [outside, 0.0]])
    assert density(np.zeros((1, 2)), others, SCALE)[0] == pytest.approx(2 / (np.pi * 0.25**2))
    assert density(np.zeros((1, 2)), others[:0], SCALE)[0] == 0


def test_noise_is_no_neighbour():
    truth, before = truth_of([150.0], [100.0]), sources_of([160.0, 140.0], [100.0, 100.0], snr=[5.1, 4.9])
    one = 1 / (np.pi * 0.25**2)
    assert recovered(truth, before, before, WINDOW, SCALE)["density"][0] == pytest.approx(one)


def test_what_is_left_out_of_the_means_is_said():
    truth = truth_of([99.0, 120.0, 150.0, 170.0, 190.0, 210.0], [100.0] * 6, drawn=[1, 1, 0, 1, 1, 1], kind=GALAXY)
    nan = np.nan
    sources = sources_of(
        [120.0, 170.0, 190.0, 210.0], [100.0] * 4, flags=[SATURATED, BAD_PIXELS, 0, 0], g1=[0, 0, nan, 0],
        g2=[0, 0, nan, 0],
    )  # fmt: skip
    said = "\n".join(left_out(recovered(truth, sources, sources_of([], []), WINDOW, SCALE)))
    assert "1 injected object left out: they are outside" in said and "they have no flux" in said
    assert "1 found object left out of all means: saturated" in said and "on bad pixels" in said
    assert "1 found object left out of the means of shape g1: not measured" in said and "magnitude" not in said
    clean = recovered(truth_of([120.0], [100.0]), sources_of([120.0], [100.0]), sources_of([], []), WINDOW, SCALE)
    assert list(left_out(clean)) == []


def test_few_objects_are_plotted_one_by_one(tmp_path):
    count = OBJECTS_MIN + 2
    x = np.linspace(120.0, 280.0, count)
    truth = truth_of(x, [100.0] * count, mag=[20.1] * OBJECTS_MIN + [22.1, 23.1])
    table = recovered(truth, sources_of(x, [100.0] * count), sources_of([], []), WINDOW, SCALE)
    assert [one.numbers["d_mag"].n for one in binned(table, "mag")] == [OBJECTS_MIN, 1, 1]
    axes = SimpleNamespace(drawn=[], plot=lambda x, y, *_, **__: axes.drawn.append((list(x), list(y))))
    _objects(axes, table, "mag", "d_mag", binned(table, "mag"))
    assert axes.drawn == [([22.1, 23.1], pytest.approx([-2.1, -3.1]))]
    draw(table, tmp_path / "few.png")
    assert (tmp_path / "few.png").stat().st_size > 10_000


def test_numbers_have_the_errors_of_normal_values():
    rng, runs, count = np.random.default_rng(4), 400, 50
    made = [number(rng.normal(0.3, 2.0, count)) for _ in range(runs)]
    for name, value in (("mean", 0.3), ("scatter", 2.0)):
        found = np.array([getattr(one, name) for one in made])
        stated = np.mean([getattr(one, f"{name}_error") for one in made])
        assert found.mean() == pytest.approx(value, abs=SIGMAS * stated / np.sqrt(runs) + 0.01 * (name == "scatter"))
        assert found.std() == pytest.approx(stated, rel=SIGMAS / np.sqrt(2 * runs))
    outlier = number([*rng.normal(0, 1, 100), 50.0, np.nan])
    assert outlier.n == 100 and outlier.outliers == 1 and abs(outlier.mean) < 0.5
    assert np.isnan(number([1.0] * (OBJECTS_MIN - 1)).mean) and number([1.0] * 9).scatter == 0 and number([]).n == 0


def test_bounds_of_completeness_hold_the_truth_as_often_as_they_say():
    rng, truth = np.random.default_rng(5), 0.9
    found = rng.binomial(100, truth, 3000)
    inside = [low <= truth <= high for _, low, high in (fraction(int(k), 100) for k in found)]
    within = norm.cdf(1) - norm.cdf(-1)
    assert np.mean(inside) == pytest.approx(within, abs=0.5 * binom.pmf(90, 100, 0.9) + 0.05)  # of whole numbers
    for k, n in ((0, 7), (3, 10), (99, 100)):
        assert fraction(k, n)[1:] == pytest.approx(tuple(binomtest(k, n).proportion_ci(within, "wilson")), abs=1e-9)
    assert (
        fraction(5, 5)[::2] == (1.0, 1.0) and fraction(5, 5)[1] == pytest.approx(5 / 6) and np.isnan(fraction(0, 0)[0])
    )


def test_bins_have_every_object_once():
    count = 200
    rng = np.random.default_rng(6)
    x, y = rng.uniform(100, 299, count), rng.uniform(50, 249, count)
    kind = np.where(np.arange(count) % 2, GALAXY, STAR).astype(np.int8)
    truth = truth_of(x, y, obj_type=kind, size=rng.uniform(0.05, 5.0, count), mag=rng.uniform(18.0, 26.0, count))
    table = recovered(truth, sources_of(x[::2], y[::2]), sources_of([], []), WINDOW, SCALE)
    for against in ("mag", "size", "density"):
        bins = binned(table, against)
        assert sum(one.objects for one in bins) == count and sum(one.found for one in bins) == table["found"].sum()
        assert all(one.low <= one.centre < one.high for one in bins)
    assert binned(table, "size")[0].objects == count // 2  # the points


def command(*arguments, code=0):
    result = CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """(campaign, {kind: (injected, original)}) of a grid of bright stars, one galaxy and one star too faint."""
    folder = tmp_path_factory.mktemp("recover")
    sim = simulation(folder)
    objects(sim, 128, 128, 60.0, id=[10**9]).write(folder / "sky.csv")
    data = yaml.safe_load((folder / "campaign.yaml").read_text())
    data["catalog"] = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(folder / "sky.csv")}}
    campaign = folder / "campaign.yaml"
    campaign.write_text(yaml.safe_dump(data))
    for verb in ("chip", "calibrate"):
        command(verb, campaign, "--obsid", OBSID, "--chip", CHIP)
    run = OpenCampaign(campaign)
    job = run.job(OBSID, CHIP)
    kinds = {"type": ["star"] * 24 + ["galaxy"], "size": [0.0] * 24 + [0.3], "mag_r": [21.0] * 23 + [29.0, 20.5]}
    Table(kinds).write(folder / "kinds.csv")
    original = run.paths.level0(job), run.paths.calibrated(*job.key)
    command(
        "place", original[0], folder / "kinds.csv", "--output", folder / "new.csv", "--grid", 45, "--campaign", campaign
    )
    command("inject", *original, "--catalogue", folder / "new.csv", "--output", folder / "with", "--campaign", campaign)
    return campaign, [(folder / "with" / path.name, path) for path in original]


@pytest.mark.parametrize("kind", [0, 1], ids=["raw", "calibrated"])
def test_the_command(frames, kind, tmp_path):
    campaign, pairs = frames
    injected, original = pairs[kind]
    said = command("recover", injected, original, "--campaign", campaign, "--output", tmp_path / "out")
    assert "24 points: 23 found" in said and "1 galaxies: 1 found" in said
    table = ObjectTable.read(tmp_path / "out" / f"{injected.stem}.recovered.parquet")
    bright = table["mag"] < 25
    clean = table["clean"]
    assert bright.sum() == 24 and table["found"][bright].all() and not table["found"][~bright].any()
    stars = clean & table["point"]
    assert stars.sum() > 18
    for name in ("flux_pull", "x_pull", "y_pull"):
        assert abs(table[name][stars].mean()) < SIGMAS / np.sqrt(stars.sum())
    picture = (tmp_path / "out" / f"{injected.stem}.recovered.png").read_bytes()
    assert picture.startswith(b"\x89PNG") and len(picture) > 20_000


def test_frames_that_do_not_belong_together(frames, tmp_path):
    campaign, ((raw, old), (image, old_image)) = frames
    out = tmp_path / "out"
    order, truth = "no injected objects that the original lacks", raw.with_suffix(".truth.parquet")
    for pair, message, given in (
        ((raw, old_image), "both must be Level-0 files", []),
        ((raw, old), "none.truth.parquet", ["--truth", raw.parent / "none.truth.parquet"]),
        ((old, raw), order, ["--truth", truth]),
        ((raw, raw), order, []),
        ((old, old), order, ["--truth", truth]),
        ((old_image, image), order, ["--truth", truth]),
        ((raw, image), order, []),
    ):
        said = command("recover", *pair, "--campaign", campaign, "--output", out, *given, code=2)
        assert message in said and not out.exists()


def test_only_the_truth_of_the_injection_is_taken(frames, tmp_path):
    """Not that of the frame itself, nor of another realisation; a copy under another name is taken."""
    campaign, ((raw, old), _) = frames
    table = ObjectTable.read(raw.with_suffix(".truth.parquet"))
    assert table.meta["injected"] == "new.csv" and table.meta["realisation"] == "1"
    table.write(tmp_path / "other.parquet", table.meta | {"realisation": "2"})
    table.write(tmp_path / "same.parquet", table.meta)
    table.write(tmp_path / "none.parquet", {"realisation": "1"})
    given = "recover", raw, old, "--campaign", campaign, "--output", tmp_path / "out", "--truth"
    for truth, found in (
        (old.with_suffix(".truth.parquet"), "no injection"), (tmp_path / "none.parquet", "no injection"),
        (tmp_path / "other.parquet", "realisation 2"),
    ):  # fmt: skip
        said = command(*given, truth, code=2)
        assert f"{truth}: --truth: not the truth table of the injected objects (got '{found}')" in said
        assert "allowed: realisation 1: the table next to" in said and not (tmp_path / "out").exists()
    assert "24 points: 23 found" in command(*given, tmp_path / "same.parquet")


def test_frames_of_two_exposures_are_not_compared(frames, tmp_path):
    """As their headers state them, without a campaign."""
    campaign, ((raw, old), _) = frames
    other, out = tmp_path / old.name, tmp_path / "out"
    with fits.open(old) as file:
        assert file[0].header["OBSID"] == OBSID
        file[0].header["OBSID"] = OBSID[:-1] + "2"
        file.writeto(other)
    said = command("recover", raw, other, "--instrument", campaign.parent / "instrument", "--output", out, code=2)
    assert "not an imaging frame of the same exposure" in said and not out.exists()


def test_a_damaged_frame_is_not_measured(frames, tmp_path):
    """One bit of a pixel, which its checksum finds."""
    campaign, ((raw, old), _) = frames
    damaged, out = tmp_path / raw.name, tmp_path / "out"
    content = bytearray(raw.read_bytes())
    with fits.open(raw) as file:
        content[next(hdu.fileinfo()["datLoc"] for hdu in file if hdu.data is not None) + 40_001] ^= 1
    damaged.write_bytes(content)
    given = "--campaign", campaign, "--output", out, "--truth", raw.with_suffix(".truth.parquet")
    assert "damaged" in command("recover", damaged, old, *given, code=2) and not out.exists()


def test_every_column_is_of_its_own_object_and_kind():
    """A galaxy found second, a point found first, one star not found: values that no other column has."""
    truth = truth_of(
        [150.0, 120.0, 250.0], [100.0, 200.0, 60.0], id=[31, 32, 33], mag=[20.5, 21.5, 22.0],
        obj_type=[GALAXY, STAR, STAR], e1=[0.2, 0.0, 0.0], e2=[-0.1, 0.0, 0.0], size=[0.4, 0.9, 0.9],
    )  # fmt: skip
    sources = sources_of(
        [120.3, 150.1], [200.2, 99.6], mag_psf=[21.4, 1.0], mag_total=[2.0, 20.8], flux_psf=[900.0, 1.0],
        flux_psf_err=[30.0, 2.0], flux_total=[3.0, 5000.0], flux_total_err=[4.0, 50.0], zeropoint=[28.5, 29.0],
        snr=[17.0, 44.0], pos_err=[0.5 * SCALE, 0.2 * SCALE], flags=[0, BAD_PIXELS | 4096], g1=[9.0, 0.25],
        g2=[9.0, 0.07],
    )  # fmt: skip
    before = sources_of([151.0 + 190.0, 260.0], [100.0, 60.0])
    table = recovered(truth, sources, before, WINDOW, SCALE)
    one, nan = 1 / (np.pi * 0.25**2), np.nan
    light = 10 ** (0.4 * (29.0 - 20.5)), 10 ** (0.4 * (28.5 - 21.5))
    wanted = {
        "id": [31, 32, 33], "point": [False, True, True], "x": [150.0, 120.0, 250.0], "y": [100.0, 200.0, 60.0],
        "mag": [20.5, 21.5, 22.0], "size": [0.4, 0.0, 0.0], "density": [2 * one, one, 2 * one],
        "found": [True, True, False], "flags": [BAD_PIXELS | 4096, 0, 0], "clean": [False, True, False],
        "snr": [44.0, 17.0, nan], "d_mag": [0.3, -0.1, nan],
        "flux_pull": [(5000 - light[0]) / 50, (900 - light[1]) / 30, nan], "d_x": [0.1, 0.3, nan],
        "d_y": [-0.4, 0.2, nan], "x_pull": [0.5, 0.6, nan], "y_pull": [-2.0, 0.4, nan],
        "d_g1": [0.05, nan, nan], "d_g2": [0.17, nan, nan],
    }  # fmt: skip
    assert list(table) == list(COLUMNS) == list(wanted)
    assert {name: column.dtype for name, column in table.items()} == {name: kind for name, (kind, _) in COLUMNS.items()}
    for name, values in wanted.items():
        assert np.asarray(table[name], float) == pytest.approx(np.array(values, float), nan_ok=True, abs=1e-9), name


@pytest.mark.parametrize(("off", "found"), [((2.1, 2.1), True), ((2.2, 2.1), False), ((0.0, -3.01), False)])
def test_a_match_is_within_three_pixels(off, found):
    table = recovered(truth_of([150.0], [100.0]), sources_of([150.0 + off[0]], [100.0 + off[1]]), sources_of([], []),
                      WINDOW, SCALE)  # fmt: skip
    assert bool(table["found"][0]) is found


@pytest.mark.parametrize("flag", [SATURATED, TRUNCATED, BAD_PIXELS])
def test_means_are_of_clean_sources(flag):
    table = recovered(truth_of([150.0], [100.0]), sources_of([150.0], [100.0], flags=[flag]), sources_of([], []),
                      WINDOW, SCALE)  # fmt: skip
    assert table["found"][0] and not table["clean"][0]


def rows(**columns):
    """A recovered table of these columns, of points without light of others that were found clean."""
    count = len(next(iter(columns.values())))
    same = {name: np.zeros(count) for name in COLUMNS}
    same |= {name: np.ones(count, bool) for name in ("point", "found", "clean")} | {"flags": np.zeros(count, int)}
    return ObjectTable(same | {name: np.asarray(values) for name, values in columns.items()})


def test_bins_begin_with_their_lower_edge():
    mag = binned(rows(mag=[20.0, 20.49, 20.5, 21.2, 21.2], found=[True, False, True, True, True]), "mag")
    assert [(one.low, one.high, one.objects, one.found) for one in mag] == [
        (20.0, 20.5, 2, 1), (20.5, 21.0, 1, 1), (21.0, 21.5, 2, 2)
    ]  # fmt: skip
    assert [one.centre for one in mag] == pytest.approx([20.245, 20.5, 21.2])
    assert mag[0].completeness == fraction(1, 2)
    size = binned(rows(size=[0.0, 0.0999, 0.1, 0.79, 0.8, 1.3, 7.0]), "size")
    assert [(one.low, one.high) for one in size] == [
        (0.0, 1e-6), (1e-6, 0.1), (0.1, 0.2), (0.5, 0.8), (0.8, 1.3), (1.3, 2.0), (2.0, np.inf)
    ]  # fmt: skip
    density = binned(rows(density=[0.0, 19.9, 20.0, 401.0]), "density")
    assert [(one.low, one.high, one.objects) for one in density] == [
        (0.0, 20.0, 2), (20.0, 40.0, 1), (400.0, np.inf, 1)
    ]  # fmt: skip


def test_numbers_of_a_bin_are_of_its_clean_sources():
    values = np.array([1.0, 2.0, 3.0, 4.0, 10.0, 50.0])
    table = rows(mag=np.full(6, 20.1), d_mag=values, d_x=-values, clean=[True] * 5 + [False])
    [one] = binned(table, "mag")
    for name, sign in (("d_mag", 1), ("d_x", -1)):
        held = one.numbers[name]
        assert (held.n, held.mean, held.outliers) == (5, sign * 4.0, 0)
        assert held.scatter == pytest.approx(np.sqrt(50 / 4)) and held.mean_error == pytest.approx(np.sqrt(50 / 20))
        assert held.scatter_error == pytest.approx(np.sqrt(50 / 4 / 8))
    assert one.objects == one.found == 6


def test_values_beyond_five_robust_sigmas_are_outliers():
    near = [-2.0] * 4 + [0.0] + [2.0] * 4  # the median deviation is 2: five sigmas are 14.826
    held = number([*near, 14.8, -14.9])
    assert (held.n, held.outliers) == (10, 1) and held.mean == pytest.approx(1.48)
    assert number([1.0] * 9 + [2.0]).outliers == 1


def test_the_figure_shows_fractions_means_and_scatter():
    """Bars of completeness end at the bounds; means have their errors, the scatter lies behind; two axes of a pair."""
    from csstsim.inject.recovery import figure

    calls = []
    axes = SimpleNamespace(
        errorbar=lambda *given, **how: calls.append((given, how)), set_ylim=lambda *ends: calls.append(ends),
        axhline=lambda *given, **how: None,
    )  # fmt: skip
    mag = np.repeat([20.1, 21.1], [10, 6])
    table = rows(mag=mag, found=mag < 21, d_x=np.arange(16.0), d_y=-(np.arange(16.0) ** 2))
    bins = binned(table, "mag")
    at = np.array([one.centre for one in bins])
    figure._completeness(axes, at, bins)
    (x, share_of, bars), _ = calls[0]
    bounds = np.array([fraction(10, 10), fraction(0, 6)])
    assert x.tolist() == at.tolist() and share_of == pytest.approx([1.0, 0.0])
    assert np.array(bars) == pytest.approx(np.array([share_of - bounds[:, 1], bounds[:, 2] - share_of]))
    calls.clear()
    figure._values(axes, at, bins, "d_x")
    held = [[one.numbers[name] for one in bins] for name in ("d_x", "d_y")]
    drawn = [(given, how["label"]) for given, how in calls[:4]]
    assert [label for _, label in drawn] == ["scatter", "mean of x", "scatter", "mean of y"]
    for k, numbers in enumerate(held):
        (place, mean, scatter), (_, again, error) = drawn[2 * k][0], drawn[2 * k + 1][0]
        assert mean.tolist() == again.tolist() == [one.mean for one in numbers]
        assert scatter.tolist() == [one.scatter for one in numbers]
        assert error.tolist() == [one.mean_error for one in numbers] and place == pytest.approx(at + 0.012 * k)
    most = max(abs(one.mean) + one.scatter for numbers in held for one in numbers)
    assert calls[4] == pytest.approx((-1.2 * most, 1.2 * most))


def test_the_lines_have_the_numbers_of_all_objects_and_of_each_bin():
    count = 8
    odd = np.arange(count) % 2 == 1
    table = rows(
        mag=np.full(count, 20.2), size=np.where(odd, 0.25, 0.0), point=~odd, density=np.full(count, 30.0),
        found=[True] * 7 + [False], clean=[True] * 7 + [False], d_mag=np.full(count, 0.125),
        d_x=np.full(count, -0.5), d_g1=np.full(count, 0.75),
    )  # fmt: skip
    table.meta |= {"outside": 0, "dark": 0}
    said = list(lines(table))
    low, high = fraction(3, 4)[1:]
    assert said[0] == f"4 points: 4 found, 1.000 ({fraction(4, 4)[1]:.3f} to 1.000)"
    assert said[1] == f"4 galaxies: 3 found, 0.750 ({low:.3f} to {high:.3f})"  # too few for a mean
    cells = "+0.1250+-0.0000", "-0.5000+-0.0000", "+0.7500+-0.0000"
    heads = [k for k, line in enumerate(said) if "objects   found" in line]
    assert [said[k].split("  ")[0] for k in heads] == list(AGAINST.values())
    assert said[heads[0] + 1].split() == ["20", "to", "20.5", "8", "0.875", *_span(7, 8), *cells]
    assert said[heads[1] + 1].split() == ["points", "4", "1.000", *_span(4, 4), "-", "-", "-"]
    assert said[heads[1] + 2].split()[:5] == ["0.2", "to", "0.3", "4", "0.750"]
    assert said[heads[2] + 1].split()[:5] == ["20", "to", "40", "8", "0.875"]
    many = rows(mag=np.full(9, 20.2), flux_pull=np.linspace(-1, 1, 9), d_y=np.full(9, 0.25))
    many.meta |= {"outside": 0, "dark": 0}
    text = list(lines(many))
    scatter = np.linspace(-1, 1, 9).std(ddof=1)
    assert (
        text[0].startswith("9 points: 9 found")
        and (
            f"  pull of flux   bias +0.0000 +- {scatter / 3:.4f}, scatter {scatter:.4f} +- {scatter / 4:.4f}, of 9, "
            "outliers 0"
        )
        in text
    )
    assert not any("position y" in line for line in text[:8])  # of all objects: pulls alone


def _span(found, total):
    _, low, high = fraction(found, total)
    return [f"{low:.3f}-{high:.3f}"]


def test_a_calibrated_image_is_measured_with_its_background_and_noise(frames):
    """Electrons are the rate and the subtracted background, times the exposure time; the noise is the header's."""
    campaign, (_, (image, _)) = frames
    run = OpenCampaign(campaign)
    job = run.job(OBSID, CHIP)
    found = _of_image(run, job, image)
    with fits.open(image) as file:
        header, rate, dq = file["SCI"].header, file["SCI"].data, file["DQ"].data
        background, noise = header["BACKMED"], header["RDNOISE"]
    assert background > 0.1 and found.electrons == pytest.approx((rate + background) * 150.0, rel=1e-5, abs=1e-2)
    assert set(found.read_noise.values()) == {noise} and set(found.bias.values()) == {0.0}
    assert np.array_equal(found.marks, dq) and len(found.read_noise) == 16
