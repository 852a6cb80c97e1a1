"""Moments and visible errors against closed forms for Gaussians, and their statistics against random images."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.studies.bench.imaging.measures import NAMES, errors, moments, visible
from csstsim.studies.bench.slitless import measures as slitless
from csstsim.studies.bench.summary import read, summarise, text, write

SIGMA = 3.0  # px, of the weight
ROUNDING = 1e-8
HALF = 40


def gaussian(xx, yy, xy=0.0, x=0.0, y=0.0, light=1.0):
    """A Gaussian of this covariance [px^2] about (x, y), sampled at pixel centres."""
    axis = np.arange(-HALF, HALF + 1)
    dx, dy = axis - x, (axis - y)[:, None]
    determinant = xx * yy - xy * xy
    form = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant
    return light * np.exp(-0.5 * form) / (2 * np.pi * np.sqrt(determinant))


def named(values):
    return dict(zip(NAMES, values, strict=True))


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.31, -0.47)])
def test_moments_of_a_gaussian(offset):
    """The product of two Gaussians is one: 1/variance = 1/4 + 1/9 along x, 1/6.25 + 1/9 along y."""
    got = moments(gaussian(4.0, 6.25, x=offset[0], y=offset[1], light=0.7), SIGMA).value
    xx, yy = 1 / (1 / 4.0 + 1 / 9), 1 / (1 / 6.25 + 1 / 9)
    assert got == pytest.approx([0.7, *offset, (xx - yy) / (xx + yy), 0.0, xx + yy], abs=ROUNDING)


def test_diagonal_ellipticity():
    got = moments(gaussian(5.0, 5.0, 2.0), SIGMA).value
    inside = np.linalg.inv(np.linalg.inv([[5.0, 2.0], [2.0, 5.0]]) + np.eye(2) / 9)
    assert got[3:5] == pytest.approx([0.0, 2 * inside[0, 1] / np.trace(inside)], abs=ROUNDING)


def test_errors_are_differences():
    truth = gaussian(4.0, 4.0)
    values = named(errors(1.01 * gaussian(4.0, 4.0, x=0.1), truth, 50.0, 1000.0, mas_per_px=74.0)[0])
    assert values["flux"] == pytest.approx(0.01, abs=ROUNDING)
    assert values["x_mas"] == pytest.approx(7.4, abs=1e-5)
    assert [values[name] for name in ("y_mas", "e1", "e2", "size2")] == pytest.approx(np.zeros(4), abs=ROUNDING)


def test_visible_error_of_too_much_light():
    """Under a sky far above the object, a relative error d is seen at d F / sqrt(4 pi s^2 variance)."""
    truth, electrons, variance, wrong = gaussian(4.0, 4.0), 10.0, 1e4, 0.05
    values = named(errors((1 + wrong) * truth, truth, variance, electrons)[0])
    assert values["visible"] == pytest.approx(wrong * electrons / np.sqrt(4 * np.pi * 4 * variance), rel=1e-4)
    assert values["pixel"] == pytest.approx(wrong, rel=1e-9)


def test_the_edge_of_the_box_is_not_evaluated():
    truth = gaussian(4.0, 4.0)
    image = truth.copy()
    image[HALF + 20, HALF] += 1.0
    assert named(errors(image, truth, 50.0, 1e3, box=20.0)[0])["visible"] == 0
    assert named(errors(image, truth, 50.0, 1e3, box=25.0)[0])["visible"] > 1


@pytest.fixture(scope="module")
def drawn():
    """Errors and chances of 400 images of 20,000 random electrons each, 1% too wide."""
    rng, truth, number = np.random.default_rng(3), gaussian(4.0, 5.0, 0.5), 20_000
    image = gaussian(1.01 * 4.0, 1.01 * 5.0, 1.01 * 0.5)
    some = [errors(rng.poisson(number * image) / number, truth, 50.0, 5e5, number) for _ in range(400)]
    return np.array(some), errors(image, truth, 50.0, 5e5)[0]


def test_chance_is_the_scatter(drawn):
    """Of 400 standard deviations, each known to 3.5%: within 5 of that."""
    scatter, chance = drawn[0][:, 0].std(axis=0), drawn[0][:, 1].mean(axis=0)
    assert scatter[:6] == pytest.approx(chance[:6], rel=0.18)


def test_moments_are_not_biased_by_chance(drawn):
    values, chance = drawn[0][:, 0], drawn[0][:, 1].mean(axis=0)
    assert np.abs(values.mean(axis=0) - drawn[1])[:6] == pytest.approx(np.zeros(6), abs=4 * chance[:6].max() / 20)
    assert (np.abs(values.mean(axis=0) - drawn[1])[:6] < 4 * chance[:6] / 20).all()


def test_random_electrons_are_taken_off_the_visible_error(drawn):
    """25 times as bright as what is drawn, chance alone would show at some 30 sigma; on average it is subtracted."""
    seen, chance = drawn[0][:, 0, 7], drawn[0][:, 1, 7]
    seen2 = np.sign(seen) * seen**2
    assert drawn[1][7] < 10 < np.median(chance)
    assert abs(seen2.mean() - drawn[1][7] ** 2) < 4 * (chance**2).mean() / 20
    assert seen2.std() == pytest.approx((chance**2).mean(), rel=0.25)  # and the scatter of it is as stated


@pytest.mark.parametrize("light", [1.0, 9.0, 1e4])
def test_the_spread_of_light_is_its_root(light):
    """Of so many electrons: that of their number; those of the centre and the shape fall with the root."""
    one, many = moments(gaussian(4.0, 5.0), SIGMA), moments(gaussian(4.0, 5.0, light=light), SIGMA)
    assert many.spread[0] == pytest.approx(np.sqrt(light))
    assert many.spread[1:] == pytest.approx(one.spread[1:] / np.sqrt(light))


def test_a_mean_over_objects_has_the_error_of_a_mean():
    """Sixteen objects whose biases scatter by 3e-3: the mean's error is a quarter of that; weighted by electrons."""

    class Goals:
        goals, shown = {"flux": 1e-3}, ("flux",)

    values = 0.01 + 3e-3 * np.resize([-1.0, 1.0], 16)
    row = {"method": "a", "kind": "star", "drawn": 100.0, "at_node": True, "cpu_s": 1e-3, "flux_chance": 0.0}
    rows = [
        row | {f"{name}_{which}": value for which in ("standard", "direct") for name in ("flux", "visible", "pixel")}
        | {"visible_chance": 0.1}
        for value in values
    ]  # fmt: skip
    line = summarise(rows, Goals, "r")[0]
    assert line["flux"] == pytest.approx(0.01) and line["flux_error"] == pytest.approx(3e-3 / 4)
    rows[0]["drawn"] = 1e9  # one that has nearly all electrons: the mean is its own
    assert summarise(rows, Goals, "r")[0]["flux"] == pytest.approx(values[0], rel=1e-5)


def test_every_error_of_a_moved_widened_and_turned_image():
    """Up, not along x; e2, not e1; each against the closed form of Gaussians under the weight."""
    truth = gaussian(4.0, 5.0, 0.5)
    found = named(errors(0.9 * gaussian(4.4, 5.2, -0.3, x=0.02, y=-0.05), truth, 50.0, 1e3, mas_per_px=100.0)[0])

    def inside(xx, yy, xy):
        return np.linalg.inv(np.linalg.inv([[xx, xy], [xy, yy]]) + np.eye(2) / 9)

    one, other = inside(4.0, 5.0, 0.5), inside(4.4, 5.2, -0.3)
    e = [np.array([m[0, 0] - m[1, 1], 2 * m[0, 1]]) / np.trace(m) for m in (one, other)]
    assert found["flux"] == pytest.approx(-0.1, abs=ROUNDING)
    assert (found["x_mas"], found["y_mas"]) == pytest.approx((2.0, -5.0), abs=1e-4)
    assert (found["e1"], found["e2"]) == pytest.approx(tuple(e[1] - e[0]), abs=ROUNDING)
    assert found["size2"] == pytest.approx(np.trace(other) / np.trace(one) - 1, abs=ROUNDING)


def test_the_weight_is_as_wide_as_it_is_told():
    found = named(errors(gaussian(16.0, 16.0), gaussian(9.0, 9.0), 50.0, 1e3, sigma=6.0)[0])
    assert found["size2"] == pytest.approx((1 / (1 / 16 + 1 / 36)) / (1 / (1 / 9 + 1 / 36)) - 1, abs=1e-6)


def test_visible_error_and_chance_by_hand():
    """Two pixels of light 0.2 and 0.3 of 100 electrons on a variance of 10, one too bright by 0.1; 400 drawn."""
    truth, image = np.array([[0.2, 0.3]]), np.array([[0.2, 0.4]])
    noise2 = np.array([30.0, 40.0])
    off = 100**2 * 0.1**2 / 40 - (100**2 / 400 * image / noise2).sum()
    chance = (2 * ((100**2 / 400 * truth / noise2) ** 2).sum()) ** 0.25
    assert visible(image, truth, 10.0, 100.0, 400.0) == pytest.approx((np.sqrt(off), chance))
    off, chance = visible(truth, truth, 10.0, 100.0, 400.0)
    assert off == pytest.approx(-np.sqrt((25 * truth / noise2).sum()))
    assert visible(image, truth, 10.0, 100.0, 400.0, np.array([[True, False]]))[0] < 0


@pytest.fixture(scope="module")
def trace():
    """(setting, case, truth): a Gaussian line and a flat spectrum along a row, 41 x 90 px, 500 e- on a variance of 20.

    Its line lies at column 50; the PSF's box ends far beyond the rows.
    """
    rows, columns = np.arange(41) - 20.0, np.arange(90) - 50.0
    along = 0.4 * np.exp(-0.5 * (columns / 2.5) ** 2) / 2.5 + np.exp(-0.5 * ((columns + 5) / 12) ** 4) / 20
    truth = np.outer(np.exp(-0.5 * ((rows - 0.5) / 2.2) ** 2), along)
    truth /= truth.sum()
    disperser = SimpleNamespace(
        orders=[0, 1], lines=lambda visits, x, y: np.array([[[0, 0, 0, 0], [-30.0, 0.01, 0, 0]]])
    )
    psf = SimpleNamespace(image=np.zeros((1, 1, 1, 400)), oversampling=4)
    scene = SimpleNamespace(x=np.array([1080.0]), y=np.array([5.0]))
    case = SimpleNamespace(electrons=500.0, lines=np.array([10_000.0, 9000.0]), visits=None, scene=scene,
                           window=SimpleNamespace(x0=1100))  # fmt: skip
    return SimpleNamespace(disperser=disperser, psf=psf, variance=20.0), case, truth


def of_trace(trace, image, drawn=np.inf):
    setting, case, truth = trace
    return [dict(zip(slitless.NAMES, v, strict=True)) for v in slitless.errors(setting, case, image, truth, drawn)]


def shifted(truth, dx=0.0, dy=0.0):
    """The truth moved by a fraction of a pixel, by Fourier transform."""
    ky, kx = (np.fft.fftfreq(n) for n in truth.shape)
    wave = np.exp(-2j * np.pi * (ky[:, None] * dy + kx * dx))
    return np.fft.ifft2(np.fft.fft2(truth) * wave).real


@pytest.mark.parametrize(("name", "steps"), [("along_px", {"dx": 0.01}), ("across_px", {"dy": -0.02})])
def test_a_moved_spectrum_is_found_where_it_went(trace, name, steps):
    found, _ = of_trace(trace, shifted(trace[2], **steps))
    step = next(iter(steps.values()))
    other = "across_px" if name == "along_px" else "along_px"
    assert found[name] == pytest.approx(step, rel=0.01) and abs(found[other]) < 1e-4
    assert found["line_px"] == pytest.approx(steps.get("dx", 0.0), abs=2e-4) and abs(found["flux"]) < 1e-9


def test_a_wider_spectrum_is_found_as_much_wider(trace):
    """A Gaussian's second derivative over 2 is what its variance adds: 0.05 px^2, of sigma^2 in the 3 px window."""
    _, _, truth = trace
    across, along = (0.5 * (shifted(truth, **{k: 1}) - 2 * truth + shifted(truth, **{k: -1})) for k in ("dy", "dx"))
    inside = 1 / (1 / 2.2**2 + 1 / 9)
    found, _ = of_trace(trace, truth + 0.05 * across)
    assert found["size2"] == pytest.approx(0.05 / inside, rel=0.1)
    found, _ = of_trace(trace, truth + 0.05 * along)
    assert found["line_width2"] == pytest.approx(0.05, rel=0.1)


def test_light_and_the_worst_pixel_of_a_spectrum(trace):
    truth = trace[2]
    image = 1.01 * truth
    image[3, 80] += 0.2 * truth.max()
    found, chance = of_trace(trace, image, 1e4)
    assert found["flux"] == pytest.approx(0.01 + 0.2 * truth.max())
    assert found["pixel"] == pytest.approx(0.2, rel=1e-3)
    assert chance["flux"] == pytest.approx(0.01) and chance["pixel"] == pytest.approx(
        np.sqrt(truth[3, 80] / 1e4) / truth.max()
    )
    assert (found["visible"], chance["visible"]) == pytest.approx(visible(image, truth, 20.0, 500.0, 1e4))


def test_a_line_is_looked_for_within_twelve_pixels_of_the_brightest(trace):
    setting, case, truth = trace
    mask = slitless._near_line(setting, case, truth)
    assert mask.all(axis=0).tolist() == mask.any(axis=0).tolist() == [38 <= x <= 62 for x in range(90)]
    edge = SimpleNamespace(**(vars(case) | {"lines": np.array([5500.0])}))
    assert np.flatnonzero(slitless._near_line(setting, edge, truth)[0]).tolist() == list(range(18))


def test_the_width_of_a_spectrum_is_about_its_own_middle():
    rows = np.arange(81) - 40.0
    truth = np.outer(np.exp(-0.5 * ((rows - 0.7) / 2.0) ** 2), np.ones(5))
    assert slitless._width2(truth) == pytest.approx(1 / (1 / 4 + 1 / 9), rel=1e-6)


def test_the_derivative_of_a_wave():
    y, x = np.mgrid[:32, :48]
    wave = np.sin(2 * np.pi * (3 * x / 48 + 2 * y / 32))
    slope = 2 * np.pi * np.cos(2 * np.pi * (3 * x / 48 + 2 * y / 32))
    assert slitless.derivative(wave, 1) == pytest.approx(slope * 3 / 48, abs=1e-12)
    assert slitless.derivative(wave, 0) == pytest.approx(slope * 2 / 32, abs=1e-12)


class Two:
    """What summarise knows of a Bench of two measures."""

    goals, shown = {"flux": 1e-3, "line": 0.1}, ("flux", "line")


def measured_row(method, kind, node, visible, **more):
    """A row of a sweep; values against direct optics are those against the reference, and 0.5 more."""
    row = {"method": method, "kind": kind, "drawn": np.inf, "at_node": node, "cpu_s": 1e-3, "visible_chance": 0.2,
           "flux_chance": 1e-4, "line_chance": 0.01, "flux_standard": 0.0, "line_standard": 0.0,
           "visible_standard": visible, "pixel_standard": 0.05} | more  # fmt: skip
    return row | {f"{name}_direct": row[f"{name}_standard"] + 0.5 for name in ("flux", "line", "visible", "pixel")}


def test_a_summary_has_a_line_for_each_method_kind_and_standard():
    rows = [
        measured_row("b", "galaxy", True, 0.1, cpu_s=4e-3), measured_row("b", "star", True, 3.0),
        measured_row("b", "star", False, 5.0, cpu_s=5e-3), measured_row("a", "star", False, 1.0, drawn=0.0),
        measured_row("a", "star", True, 0.1, pixel_standard=0.07),
    ]  # fmt: skip
    lines = summarise(rows, Two, "i")
    node, rest = "direct optics, on nodes", "direct optics, between nodes"
    assert [(x["method"], x["kind"], x["against"], x["objects"]) for x in lines] == [
        ("b", "star", "reference", 2), ("b", "star", node, 1), ("b", "star", rest, 1), ("b", "galaxy", "reference", 1),
        ("b", "galaxy", node, 1), ("a", "star", "reference", 1), ("a", "star", node, 1),
    ]  # fmt: skip
    first, second, third = lines[:3]
    assert {x["filter"] for x in lines} == {"i"} and (first["visible_median"], first["cpu_us"]) == (4.0, 3000.0)
    assert first["visible_95"] == pytest.approx(4.9) and not first["limit"]
    assert (second["visible_median"], third["visible_median"], third["flux"]) == (3.5, 5.5, 0.5)
    assert (lines[3]["visible_median"], lines[3]["limit"]) == (0.2, True)  # what chance alone would show is more
    assert (lines[4]["visible_median"], lines[4]["limit"]) == (0.6, False)
    assert (lines[5]["pixel_median"], lines[6]["pixel_median"]) == (0.07, pytest.approx(0.57))


def test_means_are_weighted_by_electrons_and_of_objects_that_have_lines():
    """300 and 100 electrons; the third has no line. Errors are the larger of scatter and chance."""
    rows = [
        measured_row("a", "star", True, 1.0, drawn=300.0, flux_standard=0.01, line_standard=0.2),
        measured_row("a", "star", True, 1.0, drawn=100.0, flux_standard=0.03, line_standard=0.6),
        measured_row("a", "star", True, 1.0, drawn=100.0, flux_standard=0.02, line_standard=np.nan, line_chance=0.3),
    ]  # fmt: skip
    line = summarise(rows, Two, "i")[0]
    assert line["flux"] == pytest.approx((3 + 3 + 2) / 500) and line["line"] == pytest.approx(0.3)
    mean = 8 / 500
    spread = np.sqrt((300 * (0.01 - mean)) ** 2 + (100 * (0.03 - mean)) ** 2 + (100 * (0.02 - mean)) ** 2)
    assert line["flux_error"] == pytest.approx(spread / 500)
    assert line["line_error"] == pytest.approx(np.hypot(300 * 0.1, 100 * 0.3) / 400)
    alike = summarise([row | {"flux_standard": 0.01, "line_standard": np.nan} for row in rows], Two, "i")[0]
    assert alike["flux_error"] == pytest.approx(1e-4 * np.sqrt(9 + 1 + 1) / 5) and np.isnan(alike["line"])
    assert np.isnan(alike["line_error"])


def test_a_table_is_read_as_it_was_written(tmp_path):
    rows = [
        {"a": "x, y", "limit": True, "n": 7, "value": 1.23456e-7},
        {"a": "z", "limit": False, "n": 0, "value": np.nan},
    ]
    write(tmp_path / "a.csv", rows)
    first, second = read(tmp_path / "a.csv")
    assert first == {"a": "x, y", "limit": True, "n": 7.0, "value": 1.235e-7}
    assert second["limit"] is False and np.isnan(second["value"])


def test_a_bias_beyond_its_goal_by_two_errors_is_marked():
    line = {
        "method": "a", "kind": "star", "against": "reference", "objects": 9, "cpu_us": 12.0, "visible_median": 0.2,
        "visible_95": 3.0, "limit": True, "flux": -1.3e-3, "flux_error": 1e-4, "line": 0.15, "line_error": 0.03,
    }  # fmt: skip
    other = line | {"limit": False, "flux_error": 2e-4, "line_error": 0.02}
    lines = [line, other, line | {"against": "direct, between"}]
    said = text(lines, Two)
    heads = ["method", "kind", "against", "n", "CPU", "us", "visible", "95%", "flux", "line"]
    assert len(said) == 5 and said[2].split() == heads
    assert said[3].split() == ["a", "star", "reference", "9", "12", "<", "0.2", "3", "-1.3e-03+-1.0e-04!",
                               "+1.5e-01+-3.0e-02"]  # fmt: skip
    assert said[4].split() == [
        "a",
        "star",
        "reference",
        "9",
        "12",
        "0.2",
        "3",
        "-1.3e-03+-2.0e-04",
        "+1.5e-01+-2.0e-02!",
    ]
