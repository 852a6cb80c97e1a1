"""Fields of the budget of shear: arms that share their noise, the run, its bars, figures and blind test."""

import base64
import json
import re
import shutil

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from support.mini_campaign import write_campaign

import csstsim
from csstsim.command_line.main import main
from csstsim.studies.budget.shear import blind as blinded
from csstsim.studies.budget.shear import command as commanded
from csstsim.studies.budget.shear import figures
from csstsim.studies.budget.shear import run as running
from csstsim.studies.budget.shear.bars import bars
from csstsim.studies.budget.shear.command import _command
from csstsim.studies.budget.shear.estimators import Stamps
from csstsim.studies.budget.shear.frames import Field, level_of, noise_of, start_simulation
from csstsim.studies.budget.shear.plan import DEFAULT, Setting, load_plan
from csstsim.studies.budget.shear.printed import hours, pair
from csstsim.studies.budget.shear.response import scatter
from csstsim.studies.budget.shear.volume import report, sigma_m, volume

KEYS = {"fields": 2, "whole": 1, "chips": [9], "size": 232, "spacing": 50, "estimators": ["own"]}
SAMPLE = {"magnitude": [19, 19.5], "size": [0.3, 0.4], "ellipticity": 0.2}
EFFECTS = {
    "nonlinearity": {"about": "nonlinearity", "change": {"layers": {"nonlinearity": {}}}, "sum": True},
    "nothing": {"about": "the same frames again", "change": {"background": "known"}, "sum": True},
    "linear": {"about": "another map", "change": {"wcs": "linear"}, "sum": True, "times": 2},
    "undone": {
        "about": "all that is undone", "change": {
            "layers": {"cosmic_rays": {}, "detector_defects": {}, "brighter_fatter": {}}, "calibrated": True,
            "masking": True, "background": "mesh",
        },
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    folder = tmp_path_factory.mktemp("budget")
    file = write_campaign(folder, geometry={"nx": 480, "ny": 480, "channel_nx": 60, "channel_ny": 240})
    return csstsim.Simulation(file, cache=folder / "cache").replace(seed=5)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "plan.yaml"
    data = yaml.safe_load(DEFAULT.read_text()) | KEYS | {"samples": {"one": SAMPLE}, "effects": EFFECTS}
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def field(sim, file):
    return Field(sim, load_plan(file), "r", "one", 0)


@pytest.fixture(scope="module")
def arms(field):
    return [field.arm(Setting(), sign * field.shear) for sign in (1, -1)]


def test_arms_differ_at_the_galaxies_alone(field):
    faint = field.plan.samples["one"].model_copy(update={"magnitude": (23.0, 23.5)})
    field = Field(field.simulation, field.plan.model_copy(update={"samples": {"one": faint}}), "r", "one", 0)
    plus, minus = (field.arm(Setting(), sign * field.shear) for sign in (1, -1))
    window = field.job(False).window
    y, x = np.mgrid[window.y0 : window.y1, window.x0 : window.x1]
    away = np.min(np.hypot(x[..., None] - field.galaxies.x, y[..., None] - field.galaxies.y), axis=-1) > 22
    assert away.mean() > 0.1 and np.mean(plus[away] != minus[away]) < 0.05  # a few photons go so far
    assert np.mean(plus[away] != field.arm(Setting(), -field.shear, seed=6)[away]) > 0.9
    assert plus[away].mean() == pytest.approx(0.0, abs=0.5)  # e-: half a DN; the error of the mean is 0.05


def test_an_arm_is_the_same_when_made_again(field, arms):
    assert np.array_equal(field.arm(Setting(), field.shear), arms[0])


def test_noise_free_frames_have_no_noise(field, arms):
    clean = field.arm(Setting(noise=False), field.shear)
    assert noise_of(clean) < 0.3 * noise_of(arms[0])
    assert len(np.unique(clean)) > 0.5 * clean.size  # not rounded to DN: wings without noise would end
    light = np.abs(clean) > 50
    assert clean[light].sum() == pytest.approx(arms[0][light].sum(), rel=0.003)  # photon noise is 0.1%


def test_psf_is_that_of_stars_on_pixels(field):
    stamps = field.psf(Setting())
    assert stamps.sum(axis=(1, 2)) == pytest.approx(1.0)
    assert {np.unravel_index(s.argmax(), s.shape) for s in stamps} == {(24, 24)}
    middle = field.psf(Setting(psf="middle"))
    assert np.ptp(middle, axis=0).max() == 0 and np.abs(middle[0] - stamps).max() < 0.01
    few = field.plan.model_copy(update={"stars": field.plan.stars.model_copy(update={"every": 1, "magnitude": 18.0})})
    fitted = Field(field.simulation, few, "r", "one", 0).psf(Setting(psf="stars"))
    assert np.abs(fitted - stamps).max() < 0.02


def test_true_psf_is_that_of_a_rendered_star(field):
    simulation = field.simulation_of(Setting(), field._stars(Setting(), slice(1), 12.0), stars=True)
    rendered = field.stamps(simulation.light(field.obsid, field.chip).image, slice(1))[0]
    assert np.abs(rendered / rendered.sum() - field.true_psf[0]).max() < 1e-3 * field.true_psf[0].max()


def test_a_psf_from_stars_is_linear_along_both_axes(field):
    """Painted stars, one at every second galaxy, that change along x and y: at all galaxies the same line."""

    class Painted(Field):
        def _image(self, setting, columns, seed=None):
            window = self.job(False).window
            image = np.zeros(window.shape)
            for k in range(0, len(self.galaxies), 2):
                row, column = (int(np.rint(v[k])) - low for v, low in (
                    (self.galaxies.y, window.y0), (self.galaxies.x, window.x0)
                ))  # fmt: skip
                image[row - 24 : row + 24, column - 24 : column + 24] = (3.0 + k) * self.star(k)
            return image

        def star(self, k):
            x, y = ((v - v.mean())[k] / 100 for v in (self.galaxies.x, self.galaxies.y))
            mean, *others = (pixels / pixels.sum() for pixels in np.random.default_rng(1).random((3, 48, 48)))
            return mean + 0.2 * x * (others[0] - mean) - 0.3 * y * (others[1] - mean)

    plan = field.plan.model_copy(update={"stars": field.plan.stars.model_copy(update={"every": 2})})
    painted = Painted(field.simulation, plan, "r", "one", 0)
    fitted = painted.psf(Setting(psf="stars"))
    wanted = np.array([painted.star(k) for k in range(len(painted.galaxies))])
    assert fitted == pytest.approx(wanted, abs=1e-9) and np.ptp(wanted, axis=0).max() > 1e-4


def test_the_psf_of_the_middle_is_that_of_the_galaxy_next_to_it(field):
    class Numbered(Field):
        true_psf = np.arange(16.0)[:, None, None] * np.ones((1, 2, 2))

    one = Numbered(field.simulation, field.plan, "r", "one", 0)
    galaxies = one.galaxies
    distance = np.hypot(galaxies.x - galaxies.x.mean(), galaxies.y - galaxies.y.mean())
    [number] = set(one.psf(Setting(psf="middle")).ravel().tolist())
    assert distance[int(number)] == distance.min() and one.psf(Setting()) is Numbered.true_psf


def test_objects_lie_on_their_pixels_with_distortion_too(field):
    """The middle of a galaxy's light is its position, and stars for the PSF are in the middle of their stamps."""
    stamps = field.stamps(field.arm(Setting(distortion=True), 0j))
    y, x = np.mgrid[-24:24, -24:24]
    for axis, positions in ((x, field.galaxies.x), (y, field.galaxies.y)):
        middle = [(axis * stamp)[x**2 + y**2 < 64].sum() / stamp[x**2 + y**2 < 64].sum() for stamp in stamps]
        assert middle == pytest.approx(positions - np.rint(positions), abs=0.5)  # distortion moves them by 1.4 px
    plan = field.plan.model_copy(update={"stars": field.plan.stars.model_copy(update={"every": 3, "magnitude": 18.0})})
    fitted = Field(field.simulation, plan, "r", "one", 0).psf(Setting(psf="stars", distortion=True))
    assert {np.unravel_index(stamp.argmax(), stamp.shape) for stamp in fitted} == {(24, 24)}


def test_a_constant_background_is_the_level_of_the_frame_itself(field, arms):
    electrons = arms[0] + np.float32(field.level(True))
    constant = field.arm(Setting(background="constant"), field.shear)
    assert constant == pytest.approx(electrons - level_of(electrons), abs=1e-3)
    assert abs(level_of(electrons) - field.level(True)) > 5e-3  # not by chance the known one


def test_a_frame_that_is_calibrated_without_a_mask_has_all_its_pixels(field, arms):
    """Its background is subtracted, its light is that of the frame that needs no calibration, to 1%."""
    how = {"background": "mesh", "layers": {"nonlinearity": {}}}
    found, plain = (field.arm(Setting(calibrated=undone, **how), field.shear) for undone in (True, False))
    assert 0 < np.abs(found - plain).max() < 5  # e-: levels and gains are measured, not known
    light = arms[0] > 200
    assert found[light].sum() == pytest.approx(arms[0][light].sum(), rel=0.01)
    assert abs(np.median(found)) < 4 and noise_of(found) == pytest.approx(noise_of(arms[0]), rel=0.1)


def test_noise_that_estimators_add_is_of_its_field_sample_estimator_and_seed(field):
    """The same again in another arm or Setting, and in nothing else."""
    samples = {"one": field.plan.samples["one"], "two": field.plan.samples["one"]}
    plans = [field.plan.model_copy(update={"samples": samples, "seed": seed}) for seed in (1, 2)]
    drawn = [
        Field(field.simulation, plan, "r", sample, number).rng(kind).random()
        for _ in range(2) for plan in plans for sample in samples for number in (0, 1) for kind in ("fpfs", "other")
    ]  # fmt: skip
    assert drawn[:16] == drawn[16:] and len(set(drawn)) == 16


@pytest.mark.parametrize(("seed", "chip"), [(3, 9), (2**40, 8)])
def test_all_frames_are_made_with_the_seed_and_the_band_of_the_plan(seed, chip):
    simulation, band = start_simulation(load_plan().model_copy(update={"seed": seed, "chips": (chip,)}))
    assert simulation._run.config.seed == seed and band == simulation._run.camera.chips[chip].filter


def test_level_is_finer_than_a_dn():
    rng = np.random.default_rng(4)
    for true in (35.2, 35.5, 35.9):
        image = 1.1 * np.rint((rng.poisson(true, (400, 400)) + rng.normal(0, 5, (400, 400))) / 1.1)
        image[:8] += 1000
        assert level_of(image) == pytest.approx(true, abs=0.15)  # the cut of a skewed distribution: 0.1


def test_all_are_detected_at_their_positions(field, arms):
    assert field.detected(arms[0]).all()
    assert not field.detected(np.random.default_rng(1).normal(0, 9, arms[0].shape).astype(np.float32)).any()


def test_the_true_map_tells_of_the_distortion(field):
    known = field.jacobian(Setting(distortion=True))
    linear = field.jacobian(Setting(distortion=True, wcs="linear"))
    assert np.array_equal(linear, field.jacobian(Setting())) and np.abs(known - linear).max() > 1e-4


def test_a_position_angle_turns_the_pixels(field):
    turned = Field(field.simulation, field.plan.model_copy(update={"pa": 45.0}), "r", "one", 0)
    ratio = turned.jacobian(Setting())[0] @ np.linalg.inv(field.jacobian(Setting())[0])
    angle = np.degrees(np.arctan2(ratio[1, 0] - ratio[0, 1], ratio[0, 0] + ratio[1, 1]))
    assert abs(angle) == pytest.approx(45.0, abs=0.1) and np.linalg.det(ratio) == pytest.approx(1.0, abs=1e-3)


def test_stamps_that_were_seen_are_measured_once(field, arms, monkeypatch):
    stamps, calls = Stamps(field.stamps(arms[0]), field.true_psf, 9.0, 0.074), []
    other = stamps._replace(galaxies=stamps.galaxies.copy())
    other.galaxies[3] = field.stamps(arms[1])[3]
    whole = running.estimator("own")

    def counted(kind):
        return lambda stamps, rng: calls.append(len(stamps.galaxies)) or whole(stamps, rng)

    monkeypatch.setattr(running, "estimator", counted)
    seen = {}
    first, second = (running._measure_new(seen, "own", images, None) for images in (stamps, other))
    again = running._measure_new(seen, "own", other, None)
    assert calls == [16, 1]
    for found, images in ((first, stamps), (second, other), (again, other)):
        assert np.array_equal(found.e, whole(images, None).e) and found.response.shape == (16, 2)
    assert first.e[3] != second.e[3]
    running._measure_new(seen, "own", stamps._replace(psf=np.roll(stamps.psf, 1, axis=0) + 1e-9), None)
    assert calls[2:] == [16]  # another PSF


@pytest.fixture(scope="module")
def done(sim, file, tmp_path_factory):
    folder, said = tmp_path_factory.mktemp("out"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "start_simulation", lambda plan: (sim, "r"))
        patch.setattr(blinded, "start_simulation", lambda plan: (sim, "r"))
        result = CliRunner().invoke(main, ["budget", "shear", str(file), "--output", str(folder)])
        assert result.exit_code == 0, result.output
        stamps = {path: path.stat().st_mtime_ns for path in (folder / "fields").iterdir()}
        again = CliRunner().invoke(main, ["budget", "shear", str(file), "--plan", "--output", str(folder)])
        assert "effects: nonlinearity, nothing, linear, undone" in again.output.split("now one window")[0]
        assert "  one, linear: " in result.output and "  one, linear: " not in again.output
        assert again.exit_code == 0 and stamps == {p: p.stat().st_mtime_ns for p in (folder / "fields").iterdir()}
        plan = load_plan(file)
        hide = ["budget", "shear", str(file), "--blind", str(folder / "key.json"), "--output", str(folder / "blind")]
        assert CliRunner().invoke(main, hide).exit_code == 0
        assert CliRunner().invoke(main, hide).exit_code == 2  # the key exists
        said = running.run_fields(plan, folder, said.append)
    return folder, plan, said


@pytest.mark.thorough
def test_bars_sum_and_cost(done):
    _, plan, paths = done
    rows = {row["effect"]: row | {"sample": "one"} for row in bars(plan, paths["one"])}
    base, nonlinearity, nothing = (rows[name] for name in ("base", "nonlinearity", "nothing"))
    counts = {name: (row["windows"], row["galaxies"]) for name, row in rows.items()}
    assert counts["base"] == counts["linear"] == (4, 64)  # the base is made wherever a bar needs it
    assert {*counts.values()} == {(4, 64), (2, 32)} and counts["sum of the bars"] == counts["nonlinearity"] == (2, 32)
    assert abs(base["m1"]) < 0.2 and base["gain"] > 1.1
    assert nothing["m1"] == nothing["c2"] == nothing["m1_err"] == 0.0
    assert 0 < abs(nonlinearity["m1"]) < 0.05 and 0 < nonlinearity["m1_err"] < base["m1_err"]
    added = [rows[name]["m1"] for name in ("nonlinearity", "nothing", "linear")]
    assert rows["sum of the bars"]["m1"] == pytest.approx(sum(added), abs=1e-12)
    rest = rows["all at once"]["m1"] if "all at once" in rows else rows["all"]["m1"]
    assert rows["all at once less the sum"]["m1"] == pytest.approx(rest - sum(added), abs=1e-12)
    galaxies, hours = volume(base, sigma_m(base) / 10)
    assert galaxies == pytest.approx(6400) and hours == pytest.approx(6400 * base["seconds"] / 3600)
    fields = [np.load(path) for path in paths["one"]]
    spent = sum(float(field["base|seconds"]) for field in fields) / sum(len(field["ring"]) for field in fields)
    assert base["seconds"] == pytest.approx(spent) and spent > 0
    lines = report(list(rows.values()))
    assert lines[0].split()[3:5] == ["windows", "galaxies"] and lines[1].split()[3:5] == ["4", "64"]
    assert len(lines) == 1 + 5 + 2 + 2 and lines[-1].startswith("all bars by own to 1e-04")
    unknown = [row | {"m1_err": float("nan")} if row["effect"] == "linear" else row for row in rows.values()]
    assert report(unknown)[-1].endswith("own, and 1 that measured too few galaxies")
    none = [row | {"m1_err": float("nan"), "m2_err": float("nan")} for row in rows.values()]
    assert "to 1e-04: unknown CPU-hours" in report(none)[-1]
    assert bars(plan, []) == []


def test_windows_hold_what_their_bars_need(done):
    _, plan, paths = done
    made = [{key.split("|")[0] for key in np.load(path) if "|" in key} for path in paths["one"]]
    assert made[0] == made[1] == {"base", "nonlinearity", "linear", "undone", "all"}
    assert made[2] == made[3] == {"base", "linear"}
    fewer = {row["effect"]: row for row in bars(plan, paths["one"][:3])}  # of a run that goes on
    assert fewer["linear"]["windows"] == 3 and fewer["undone"]["windows"] == 2


def test_table_figures_and_page(done, file):
    folder, plan, _ = done
    from astropy.table import Table

    table = Table.read(folder / "budget.ecsv")
    assert list(table["effect"][:2]) == ["base", "nonlinearity"] and table.meta["plan"]["shear"] == plan.shear
    page = (folder / "index.html").read_text()
    assert page.count("data:image/png;base64,") == 2 and "nonlinearity" in page
    assert f"{file} --output {folder}</code>" in page and "c1 [1e-04]" in page and "<th>windows</th>" in page
    for name in ("waterfall_one.png", "chart_one.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("value", "error", "said"),
    [(1e-4, 2e-2, "+0.000 +- 0.020"), (-42.2, 19.5, "-42 +- 20"), (0.0, 0.0, "+0 +- 0"), (1.0, np.nan, "+1 +- nan"),
     (0.5, 0.0099, "+0.5000 +- 0.0099"), (1234.0, 150.0, "+1234 +- 150")],
)  # fmt: skip
def test_numbers_have_the_digits_of_their_errors(value, error, said):
    assert pair(value, error) == said


def test_hours_have_two_digits():
    assert [hours(value) for value in (0.0, 0.001234, 213.7, np.nan)] == ["0", "0.0012", "210", "nan"]


def test_the_page_has_the_whole_command():
    words = _command("my plan.yaml", "out", fields=2, effects=["a", "b"])
    assert words == "csstsim budget shear 'my plan.yaml' --output out --fields 2 --effects a,b"


def answer(folder, rows, heads="field,g1,g2,g1_err,g2_err"):
    path = folder / "answer.csv"
    path.write_text("\n".join([heads, *rows]) + "\n", encoding="utf-8-sig")  # as Excel writes it
    return path


def test_blind_frames_hide_the_shear_and_score_an_answer(done):
    from astropy.io import fits

    folder, _, _ = done
    key = json.loads((folder / "key.json").read_text())
    with fits.open(folder / "blind" / "field_000.fits") as hdus:
        assert hdus["IMAGE"].data.shape == (232, 232) and len(hdus["PSF"].data) == len(hdus["GALAXIES"].data) == 16
        header, columns = hdus["IMAGE"].header, hdus["GALAXIES"].columns
        assert header["BUNIT"] == "electron" and header["EXPTIME"] == 150.0 and columns["x"].unit == "pixel"
    text = b"".join(path.read_bytes() for path in (folder / "blind").iterdir())
    assert str(key["seed"]).encode() not in text and key["salt"].encode() not in text
    lines = [f"{i},{1.1 * g1 + 0.001},{g2},0.01,0.01" for i, (g1, g2) in enumerate(key["shears"])]
    said = []
    score = blinded.reveal(folder / "key.json", answer(folder, lines), said.append, folder / "blind")
    assert score["m1"] == pytest.approx(0.1) and score["c1"] == pytest.approx(0.001)
    assert score["m2"] == pytest.approx(0.0, abs=1e-12) and any(
        line.startswith("m1 = +0") and " +- " in line for line in said
    )


def test_blind_frames_are_those_of_the_keys_shear_and_seed(done, sim):
    """The second frame, drawn again from the key, bit by bit: image, PSF, positions in it, and the map to the sky."""
    from astropy.io import fits

    folder, plan, _ = done
    key = json.loads((folder / "key.json").read_text())
    field = Field(sim, plan.model_copy(update={"seed": key["seed"]}), "r", "one", 1)
    setting, window = plan.setting("base"), field.job(False).window
    with fits.open(folder / "blind" / "field_001.fits") as hdus:
        image = field.arm(setting, complex(*key["shears"][1])).astype(np.float32)
        assert np.array_equal(hdus["IMAGE"].data, image)
        assert np.array_equal(hdus["PSF"].data, field.psf(setting).astype(np.float32))
        galaxies = hdus["GALAXIES"].data
        assert galaxies["x"] == pytest.approx(field.galaxies.x - window.x0)
        assert galaxies["y"] == pytest.approx(field.galaxies.y - window.y0)
        assert galaxies["jacobian"] == pytest.approx(field.jacobian(setting))
    middle = plan.size / 2
    assert abs(galaxies["x"].mean() - middle) < plan.spacing / 2 > abs(galaxies["y"].mean() - middle)


@pytest.mark.parametrize("whole", [False, True])
def test_shears_of_a_blind_run_are_even_in_both_components(file, sim, tmp_path, monkeypatch, whole):
    """To five sigma of 400 fields: from -2 to 2 of the plan's shear, the components independent; the seed is the key's.

    All effects of the sum are in the frames of a whole run, none in others.
    """
    asked, written = [], []
    monkeypatch.setattr(blinded, "start_simulation", lambda plan: asked.append(plan.seed) or (sim, "r"))
    monkeypatch.setattr(blinded, "_write", lambda path, *rest: written.append((path.name, *rest)))
    blinded.blind(file, tmp_path / "key.json", tmp_path / "out", print, count=400, whole=whole)
    key, plan = json.loads((tmp_path / "key.json").read_text()), load_plan(file)
    g = np.array(key["shears"])
    assert g.shape == (400, 2) and len(np.unique(g)) > 700 and np.abs(g).max() <= 2 * plan.shear
    text = (tmp_path / "out" / "README.md").read_text()
    low, high = (float(number) for number in re.search(r"between (-\S+) and (\S+)\.", text).groups())
    assert (low, high) == pytest.approx((-2 * plan.shear, 2 * plan.shear))
    unit = g / (2 * plan.shear)
    assert np.abs(unit.mean(axis=0)).max() < 5 / np.sqrt(3 * 400) and abs((unit[:, 0] * unit[:, 1]).mean()) < 5 / 60
    assert (unit**2).mean() == pytest.approx(1 / 3, abs=5 * np.sqrt(4 / 45 / 800))
    assert asked == [key["seed"]] != [plan.seed] and {field.plan.seed for _, field, *_ in written} == {key["seed"]}
    assert [(name, field.number, drawn) for name, field, _, drawn in written] == [
        (f"field_{k:03d}.fits", k, complex(*g[k])) for k in range(400)
    ]
    assert {setting == plan.setting("all" if whole else "base") for _, _, setting, _ in written} == {True}


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["0,0,0,1,1"], "each field once"), (["0,0,0,1,1", "0,0,0,1,1"], "each field once"), ([], "not an answer"),
        (["0,x,0,1,1", "1,0,0,1,1"], "line 2, g1: not an answer (got 'x'); allowed: a shear, between -1 and 1"),
        (["0,1e200,0,1,1", "1,0,0,1,1"], "a shear, between -1 and 1"), (["0,0,0,1", "1,0,0,1,1"], "1e-9 to 1e9"),
        (["0,nan,0,1,1", "1,0,0,1,1"], "a shear"), (["", "0,0,0,0,1", "1,0,0,1,1"], "line 3, g1_err"),
        (["0,0,0,1,1", "1,0,0,1,1e-200"], "line 3, g2_err"), (["0,0,0,1,1", "2,0,0,1,1"], "line 3, field"),
        (["0,0,0,1,1", f"1,0,0,1,{'1' * 200_000}"], "not a CSV table"),
    ],
)  # fmt: skip
def test_a_wrong_answer_is_refused_in_one_line(done, rows, said):
    folder, _, _ = done
    words = ["budget", "shear", "--reveal", str(folder / "key.json"), str(answer(folder, rows))]
    result = CliRunner().invoke(main, [*words, "--output", str(folder / "blind")])
    assert result.exit_code == 2 and said in result.stderr and "Traceback" not in result.output


def test_an_answer_without_a_column_names_it(done):
    folder, _, _ = done
    path = answer(folder, ["0,0,0"], heads="field,g1,g2")
    words = ["budget", "shear", "--reveal", str(folder / "key.json"), str(path), "--output", str(folder / "blind")]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2 and "it lacks g1_err, g2_err" in result.stderr


def test_the_blind_folder_explains_itself(done):
    """The zero point of the README gives the electrons of the magnitudes: 16 galaxies of 19 to 19.5, to 25%."""
    from astropy.io import fits

    folder, _, _ = done
    text = (folder / "blind" / "README.md").read_text()
    with fits.open(folder / "blind" / "field_000.fits") as hdus:
        zero, image, galaxies = hdus["IMAGE"].header["ZP_AB"], hdus["IMAGE"].data, hdus["GALAXIES"].data
    assert f"{zero:.4f} - 2.5 log10" in text and "field_000.fits to field_001.fits" in text
    assert all(name in text for name in ("jacobian", "g1_err", "--reveal", "150 s in band r"))
    mean = image.sum() / len(galaxies)
    assert 10 ** (0.4 * (zero - 19.5)) / 1.25 < mean < 1.25 * 10 ** (0.4 * (zero - 19.0))


def test_another_key_is_not_the_sealed_one(done, tmp_path):
    folder, _, _ = done
    key = json.loads((folder / "key.json").read_text())
    (tmp_path / "key.json").write_text(json.dumps(key | {"shears": [[0, 0]] * 2}))
    words = ["budget", "shear", "--reveal", str(tmp_path / "key.json"), str(answer(folder, ["0,0,0,1,1", "1,0,0,1,1"]))]
    result = CliRunner().invoke(main, [*words, "--output", str(folder / "blind")])
    assert result.exit_code == 2 and "sealed" in result.stderr


@pytest.mark.parametrize(
    "shears", [["a", "b"], [["x", 0], [0, 0]], [[0, 0], [0]], [0.1, 0.2], [[float("nan"), 0]] * 2, [], 3, {"a": 1},
               [[True, 0]], [[0, 1e400]]],
)  # fmt: skip
def test_a_key_whose_shears_are_no_pairs_of_numbers_is_refused(tmp_path, shears):
    key = tmp_path / "key.json"
    key.write_text(json.dumps({"shears": shears, "seed": 1, "salt": "a"}))
    result = CliRunner().invoke(main, ["budget", "shear", "--reveal", str(key), str(answer(tmp_path, ["0,0,0,1,1"]))])
    assert result.exit_code == 2, result.output
    assert "shears.0: not a shear" in result.stderr or "shears.1: not a shear" in result.stderr


def test_a_damaged_file_of_shapes_is_made_again(tmp_path):
    path, wanted = tmp_path / "one.npz", {"psf": "floats (1000,)"}
    assert not running.is_complete(path, wanted)
    np.savez(path, psf=np.arange(1000.0), e=np.arange(1000.0))
    content = path.read_bytes()
    assert running.is_complete(path, wanted)
    flipped = bytearray(content)
    flipped[3000] ^= 255
    for damaged in (b"", b"abc", content[:-30], content[:5000], bytes(flipped)):
        path.write_bytes(damaged)
        assert not running.is_complete(path, wanted), damaged[:20]


@pytest.mark.parametrize(
    "change",
    [lambda arrays: arrays.pop("psf"), lambda arrays: arrays.pop("linear|own|e"), lambda arrays: arrays.clear(),
     lambda arrays: arrays.update(ring=arrays["ring"][1:]), lambda arrays: arrays.update(ring=arrays["ring"] + 0.5),
     lambda arrays: arrays.update(psf=np.array([{}]))],
)  # fmt: skip
def test_a_sound_file_of_other_arrays_is_named_before_any_work(done, file, sim, tmp_path, monkeypatch, change):
    """The last window's file among the kept ones; the first window's is missing, and stays so."""
    _, plan, paths = done
    shutil.copytree(paths["one"][0].parent, tmp_path / "fields")
    first, *_, last = (tmp_path / "fields" / path.name for path in paths["one"])
    arrays = dict(np.load(last))
    change(arrays)
    np.savez(last, **arrays)
    first.unlink()
    monkeypatch.setattr(running, "start_simulation", lambda plan: (sim, "r"))
    result = CliRunner().invoke(main, ["budget", "shear", str(file), "--output", str(tmp_path)])
    assert result.exit_code == 2 and not first.exists(), result.output
    assert str(last) in result.stderr and "remove the file, and they are measured again" in result.stderr
    last.unlink()
    assert running.is_complete(paths["one"][0], running.expected_arrays(plan, 0)) and not running.is_complete(last, {})


@pytest.mark.parametrize("fault", [KeyboardInterrupt, OSError, csstsim.base.errors.InputError])
def test_a_blind_run_that_fails_leaves_nothing(file, sim, tmp_path, monkeypatch, fault):
    """It fails at the second frame; in a folder that was there, what others wrote stays."""
    write = blinded._write

    def failing(path, *rest):
        if path.name == "field_001.fits":
            raise fault("at the second frame")
        write(path, *rest)

    monkeypatch.setattr(blinded, "start_simulation", lambda plan: (sim, "r"))
    monkeypatch.setattr(blinded, "_write", failing)
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "notes.txt").write_text("mine")
    for folder in ("old", "new"):
        with pytest.raises(fault):
            blinded.blind(file, tmp_path / "keys" / "key.json", tmp_path / folder, print)
        assert [path.name for path in tmp_path.rglob("*")] == ["old", "notes.txt"]


@pytest.mark.parametrize("name", ["field_001.fits", "README.md", "seal.json"])
def test_a_blind_run_writes_over_nothing(file, tmp_path, name):
    (out := tmp_path / "out").mkdir()
    (out / name).write_text("mine")
    words = ["budget", "shear", str(file), "--blind", str(tmp_path / "key.json"), "--output", str(out)]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2 and name in result.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["out", name]


@pytest.mark.parametrize("key", ["out/key.json", "out/deeper/key.json", "link/key.json", "out/../out/key.json", "out"])
def test_a_key_lies_outside_the_folder_that_is_given_away(file, tmp_path, key):
    (tmp_path / "link").symlink_to(tmp_path / "out")
    for folder in ("out", "out/frames") if key == "out" else ("out",):
        words = ["budget", "shear", str(file), "--blind", str(tmp_path / key), "--output", str(tmp_path / folder)]
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 2 and "--blind: the key would lie in the folder that is given away" in result.stderr
        assert [path.name for path in tmp_path.iterdir()] == ["link"]


def row(kind, m1, error=1e-5, alpha=0.01):
    """One bar of the waterfall, the base by an estimator."""
    same = {"sample": "one", "effect": "base", "kind": "base", "about": "the base", "estimator": kind}
    values = dict.fromkeys(("m2", "c1", "c2"), 1e-4) | {"m1": m1, "alpha": alpha}
    return same | values | {f"{name}_err": error for name in values}


def test_the_waterfall_cuts_no_value_and_marks_errors_that_it_cuts(monkeypatch):
    """The second of three estimators has the largest value; the third none of alpha, and a long error."""
    saved = []
    monkeypatch.setattr(figures, "_save", lambda figure, path: saved.append(figure))
    figures.waterfall("x.png", [row("hsm", -2e-3), row("own", -0.04), row("fpfs", 4e-3, alpha=np.nan)], "one", ())
    figures.waterfall("x.png", [row("hsm", -2e-3), row("own", -0.04), row("fpfs", 4e-3, error=1.0)], "one", ())
    for figure, arrows in zip(saved, ([], ["<", ">"]), strict=True):
        m1 = figure.axes[0]
        low, high = m1.get_xlim()
        assert low < -40 * 1.1 and high > 4 * 1.1
        assert [line.get_marker() for line in m1.lines if line.get_marker() in ("<", ">")] == arrows
        for ax in figure.axes:
            markers = np.concatenate([line.get_xdata() for line in ax.lines if line.get_marker() in ("s", "D")])
            assert np.nanmin(markers) > ax.get_xlim()[0] and np.nanmax(markers) < ax.get_xlim()[1]
    assert saved[1].axes[0].lines[-1].get_xdata() == [high]


def test_fields_of_another_release_are_not_used(file, monkeypatch):
    plan = load_plan(file)
    now = running._digest(plan, "one", 0)
    monkeypatch.setattr(running, "release", lambda: "0.0")
    assert running._digest(plan, "one", 0) != now


def test_a_field_is_made_again_for_whatever_changes_its_shapes(file):
    """Each key of the plan, of its sample and of its Settings; not how many fields there are, nor words."""
    data = yaml.safe_load(file.read_text())
    plan = load_plan(file)
    now = running._digest(plan, "one", 0)

    def other(change):
        given = {**data, **change}
        (file.parent / "other.yaml").write_text(yaml.safe_dump(given, sort_keys=False))
        return running._digest(load_plan(file.parent / "other.yaml"), "one", 0)

    known = data["neighbours"]
    changes = [
        {"shear": 0.01}, {"seed": 77}, {"chips": [22]}, {"pa": 3.0}, {"size": 300}, {"spacing": 48}, {"stamp": 40},
        {"estimators": ["hsm"]}, {"stars": data["stars"] | {"every": 9}}, {"samples": {"one": SAMPLE | {"slope": 0.1}}},
        {"neighbours": known | {"undetected": known["undetected"] | {"number": 9.5}}},
        {"lens": {"redshift": 0.2, "galaxies": 0.7}}, {"base": {"noise": False}},
        {"effects": EFFECTS | {"linear": EFFECTS["linear"] | {"change": {"psf": "middle"}}}},
    ]  # fmt: skip
    digests = [other(change) for change in changes]
    assert len({now, *digests}) == len(changes) + 1
    same = [
        {"fields": 5}, {"samples": {"one": SAMPLE, "two": SAMPLE | {"slope": 0.3}}},
        {"effects": EFFECTS | {"linear": EFFECTS["linear"] | {"about": "other words"}}},
    ]  # fmt: skip
    assert {other(change) for change in same} == {now} and running._digest(plan, "one", 3) != now


def test_each_sample_has_its_own_rows_and_figures(file, tmp_path, monkeypatch):
    """The plan is as the options say; a table, a page and two figures of each sample."""
    data = yaml.safe_load(file.read_text())
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump(data | {"samples": {"one": SAMPLE, "two": SAMPLE}}))
    asked = []

    def fields(plan, folder, log, first):
        asked.append((plan.fields, plan.estimators, folder, first))
        return {name: [f"of {name}"] for name in plan.samples}

    monkeypatch.setattr(commanded, "run_fields", fields)
    monkeypatch.setattr(commanded, "bars", lambda plan, paths: [{"effect": paths[0]}])
    for name in ("report", "write_rows", "waterfall", "chart", "write_page"):
        monkeypatch.setattr(commanded, name, lambda *given, name=name: asked.append((name, *given)) or [])
    how = {"fields": 3, "estimators": ["hsm"]}
    rows = commanded.budget(tmp_path / "plan.yaml", tmp_path / "out", lambda line: None, **how)
    assert rows == [{"sample": name, "effect": f"of {name}"} for name in ("one", "two")]
    assert asked[0] == (3, ("hsm",), tmp_path / "out", None)
    drawn = [(kind, path.name, sample) for kind, path, given, sample, *_ in asked[3:7] if given == rows]
    assert drawn == [(kind, f"{kind}_{name}.png", name) for name in ("one", "two") for kind in ("waterfall", "chart")]
    assert [one[0] for one in asked[1:3]] == ["report", "write_rows"] and asked[7][:2] == (
        "write_page", tmp_path / "out" / "index.html",
    )  # fmt: skip
    asked.clear()
    assert commanded.budget(tmp_path / "plan.yaml", tmp_path / "out", lambda line: None, only_plan=True) == rows
    assert asked[0][3] == 1 and [one[0] for one in asked[1:]] == ["report"]


def test_options_that_do_not_go_together():
    for words in (["--blind", "a", "--plan"], ["--whole"], ["--reveal", "a", "b", "--effects", "noise"]):
        assert CliRunner().invoke(main, ["budget", "shear", *words]).exit_code == 2


def test_fields_have_the_signs_of_the_second_component_in_turn(field):
    """All chips have one sign, then all the other: what one component adds to the other cancels."""
    plan = field.plan.model_copy(update={"chips": [8, 9]})
    signs = [Field(field.simulation, plan, "r", "one", number).sign for number in range(6)]
    assert signs == [1.0, 1.0, -1.0, -1.0, 1.0, 1.0]


def test_an_answer_in_any_order_has_the_weights_of_its_errors(tmp_path):
    """Against a weighted fit by numpy, of each component; chi2 is that of the answer against the key."""
    rng = np.random.default_rng(3)
    shears, errors = rng.uniform(-0.03, 0.03, (7, 2)), rng.uniform(0.001, 0.02, (7, 2))
    answers = shears * [1.1, 0.8] + [0.002, -0.003] + errors * rng.standard_normal((7, 2))
    key = tmp_path / "key.json"
    key.write_text(json.dumps({"shears": shears.tolist(), "seed": 1, "salt": "a"}))
    rows = [f"{k},{answers[k, 0]!r},{answers[k, 1]!r},{errors[k, 0]!r},{errors[k, 1]!r}".replace("np.float64", "")
            .replace("(", "").replace(")", "") for k in (3, 0, 6, 1, 5, 2, 4)]  # fmt: skip
    said = []
    score = blinded.reveal(key, answer(tmp_path, rows), said.append)
    for axis in range(2):
        line, covariance = np.polyfit(shears[:, axis], answers[:, axis], 1, w=1 / errors[:, axis], cov="unscaled")
        assert (score[f"m{axis + 1}"], score[f"c{axis + 1}"]) == pytest.approx((line[0] - 1, line[1]))
        wanted = np.sqrt(np.diag(covariance))
        assert (score[f"m{axis + 1}_err"], score[f"c{axis + 1}_err"]) == pytest.approx(tuple(wanted))
    chi2 = (((answers - shears) / errors) ** 2).sum()
    assert score["chi2"] == pytest.approx(chi2) and score["fields"] == 7
    m = pair(score["m1"], score["m1_err"])
    c = pair(score["c2"] * 1e4, score["c2_err"] * 1e4)
    assert said == [f"m1 = {m}", said[1], said[2], f"c2 = ({c}) 1e-4", f"chi2 = {chi2:.1f} of 14 numbers"]
    assert [line[:2] for line in said[:4]] == ["m1", "m2", "c1", "c2"]


def test_one_field_and_shears_that_are_all_the_same_have_a_chi2_alone(tmp_path):
    key = tmp_path / "key.json"
    rows = ["0,0.03,0.02,0.01,1", "1,0.01,0.02,1,1"]
    for count in (1, 2):
        shears = [[0.01, 0.02]] * count
        key.write_text(json.dumps({"shears": shears, "seed": 1, "salt": "a"}))
        score = blinded.reveal(key, answer(tmp_path, rows[:count]), lambda line: None)
        assert score == {"fields": count, "chi2": pytest.approx(4.0)}


def test_the_table_of_volumes_has_each_bars_numbers():
    """Errors of 4e-4 with 1000 galaxies of 7.2 s: 2 h; a third of the error needs nine times as much."""
    rows = [
        {"sample": "one", "estimator": kind, "effect": effect, "kind": what, "windows": 3, "galaxies": 1000,
         "seconds": 7.2, "m1": 12e-4, "m2": -5e-4, "m1_err": 2e-4, "m2_err": 4e-4, "gain": 3.25}
        for kind in ("own", "hsm")
        for effect, what in (("base", "base"), ("cti", "bar"), ("flat", "bar"), ("all", "sum"))
    ]  # fmt: skip
    assert sigma_m(rows[0]) == 4e-4 and volume(rows[0], 1e-4) == pytest.approx((16_000, 32.0))
    said = report(rows)
    assert said[2].split() == ["one", "own", "cti", "3", "1000", "+12.0", "+-", "2.0", "-5.0", "+-", "4.0", "4.0e-04",
                               "2", "3.6", "32", "3.2"]  # fmt: skip
    assert len([line for line in said if line.startswith("one")]) == 6
    assert said[-2].startswith("all bars by own to 3e-04: 7.1 CPU-hours: the 2 rows of effects")
    assert said[-1].startswith("all bars by own to 1e-04: 64 CPU-hours")


def test_the_chart_shows_what_each_error_costs(monkeypatch):
    """Points where they were measured, on lines that fall with the root of the hours; by the first estimator alone."""
    saved = []
    monkeypatch.setattr(figures, "_save", lambda figure, path: saved.append(figure))
    same = {"galaxies": 1000, "seconds": 7.2, "sample": "one", "kind": "bar"}
    rows = [row("own", 1e-3) | same | {"m1_err": 2e-4, "m2_err": 4e-4, "about": "first"},
            row("own", 1e-3) | same | {"m1_err": 9e-4, "m2_err": 1e-4, "about": "second", "seconds": 0.72},
            row("own", 1e-3) | same | {"kind": "sum"}, row("hsm", 1e-3) | same,
            row("own", 1e-3) | same | {"sample": "other"}]  # fmt: skip
    figures.chart("x.png", rows, "one")
    [axes] = saved[0].axes
    curves = {len(line.get_xdata()): line for line in axes.lines if len(line.get_xdata()) > 2}
    points = {line.get_label(): (line.get_xdata()[0], line.get_ydata()[0]) for line in axes.lines
              if len(line.get_xdata()) == 1}  # fmt: skip
    assert points == {"first": (pytest.approx(2.0), 4e-4), "second": (pytest.approx(0.2), 9e-4)}
    of_first = [line for line in axes.lines if len(line.get_xdata()) == 7][-1]
    assert of_first.get_ydata() == pytest.approx(4e-4 * np.sqrt(2.0 / of_first.get_xdata())) and curves
    assert axes.get_xlabel() == "CPU-hours" and (axes.get_xscale(), axes.get_yscale()) == ("log", "log")


def test_the_waterfall_has_a_bar_of_each_effect(monkeypatch):
    """m in 1e-3, c in 1e-4, alpha in 1e-2; the first row on top; effects of the sum are marked."""
    saved = []
    monkeypatch.setattr(figures, "_save", lambda figure, path: saved.append(figure))
    values = {"m1": 2e-3, "m2": -3e-3, "c1": 4e-4, "c2": -5e-4, "alpha": 0.06}
    bar = row("own", 0.0) | values | {"effect": "cti", "kind": "bar", "about": "traps"}
    figures.waterfall("x.png", [row("own", 1e-3), bar, bar | {"sample": "other"}], "one", ("cti",))
    axes = saved[0].axes
    for ax, wanted in zip(axes, (2.0, -3.0, 4.0, -5.0, 6.0), strict=True):
        first, second = ax.patches
        assert second.get_width() == pytest.approx(wanted) and second.get_y() < first.get_y()
    labels = {round(at): text.get_text() for at, text in zip(axes[0].get_yticks(), axes[0].get_yticklabels(),
                                                             strict=True)}  # fmt: skip
    assert labels == {1: "the base", 0: "+ traps"}
    assert [ax.get_title() for ax in axes][::2] == [
        "$m_1$  [$10^{-3}$]", "$c_1$  [$10^{-4}$]", "PSF leakage $\\alpha$  [$10^{-2}$]"
    ]  # fmt: skip


def test_the_page_has_a_row_of_each_bar(tmp_path):
    from csstsim.studies.budget.shear.page import write_page, write_rows

    plan = load_plan()
    plan = plan.model_copy(update={"samples": {"one": plan.samples["bright"], "none": plan.samples["bright"]}})
    more = {"windows": 4, "galaxies": 640, "seconds": 1.0, "gain": 2.0}
    rows = [row("own", -2e-3) | more | {"about": "a < b & c", "alpha": 0.031, "alpha_err": 0.012}]
    for kind in ("waterfall", "chart"):
        (tmp_path / f"{kind}_one.png").write_bytes(kind.encode())
    write_page(tmp_path / "index.html", rows, plan, "csstsim budget <plan>")
    text = (tmp_path / "index.html").read_text()
    cells = ["own", "base", "a &lt; b &amp; c", "-20.00 &plusmn; 0.10", "+1.00 &plusmn; 0.10", "+1.00 &plusmn; 0.10",
             "+1.00 &plusmn; 0.10", "+3.1 &plusmn; 1.2", "4", "640"]  # fmt: skip
    assert "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>" in text
    heads = "estimator", "effect", "what", "m1 [1e-04]", "m2 [1e-04]", "c1 [1e-04]", "c2 [1e-04]", "alpha [1e-02]"
    assert re.findall("<th>(.+?)</th>", text) == [*heads, "windows", "galaxies"]
    assert "<h2>Sample one</h2>" in text and "Sample none" not in text and "<code>csstsim budget &lt;plan&gt;" in text
    assert f"&plusmn;{plan.shear:g} in each component" in text
    assert "d2F0ZXJmYWxs" in text.split('alt="waterfall of one"')[1][:80]  # the figure, in base 64
    assert "Y2hhcnQ=" in text.split('alt="chart of one"')[1][:80] and "all bars by own" in text
    write_rows(tmp_path / "rows.ecsv", rows, plan)
    from astropy.table import Table

    table = Table.read(tmp_path / "rows.ecsv")
    assert table["m1"][0] == -2e-3 and table["about"][0] == "a < b & c" and table.meta["plan"]["seed"] == plan.seed


def test_each_sample_of_the_page_has_its_own_rows_and_figures(tmp_path):
    from csstsim.studies.budget.shear.page import write_page

    plan = load_plan()
    plan = plan.model_copy(update={"samples": dict.fromkeys(("one", "two"), plan.samples["bright"])})
    more = {"windows": 4, "seconds": 1.0, "gain": 2.0, "kind": "bar"}
    rows = [row("own", 1e-3) | more | {"sample": sample, "effect": f"{sample} {k}", "about": "", "galaxies": galaxies}
            for sample, galaxies in (("two", 720), ("one", 640)) for k in range(2)]  # fmt: skip
    for kind in ("waterfall", "chart"):
        for sample in plan.samples:
            (tmp_path / f"{kind}_{sample}.png").write_bytes(f"{kind} {sample}".encode())
    write_page(tmp_path / "index.html", rows, plan, "csstsim budget")
    _, *parts = (tmp_path / "index.html").read_text().split("<h2>Sample ")
    for part, sample, galaxies in zip(parts, ("one", "two"), (640, 720), strict=True):
        assert part.startswith(f"{sample}</h2>")
        table, volumes = part.split("<pre>")
        assert re.findall(r"<tr><td>own</td><td>(.+?)</td>", table) == [f"{sample} 0", f"{sample} 1"]
        assert re.findall(r"<td>(\d+)</td></tr>", table) == [str(galaxies)] * 2
        assert [line.split()[:4] for line in volumes.splitlines()[1:3]] == [
            [sample, "own", sample, str(k)] for k in (0, 1)
        ]
        assert "the 2 rows of effects" in volumes
        pictures = [base64.b64decode(data).decode() for data in re.findall(r'base64,([^"]+)"', part)]
        assert pictures == [f"waterfall {sample}", f"chart {sample}"]


def test_settings_change_what_they_name(field):
    """Noise layers are off without noise, losses with it; stars have no sky; further layers are added."""
    layers = lambda *given, **how: {k: v for one in field.simulation_of(*given, **how).layers for k, v in one.items()}  # noqa: E731
    base = layers(Setting())
    assert {"poisson_and_dark", "readout_noise"} <= set(base) and not {"cosmic_rays", "nonlinearity"} & set(base)
    quiet = layers(Setting(noise=False))
    assert not {"poisson_and_dark", "readout_noise"} & set(quiet) and "bias" in quiet
    assert "sky_background" in base and "sky_background" not in layers(Setting(), stars=True)
    for flat in (False, True):
        found = layers(Setting(flat=flat, background="mesh", distortion=not flat, straylight=flat))
        assert (found["scie_obs"]["flat_fielding"], found["scie_obs"]["shutter_effect"]) == (flat, flat)
        assert found["scie_obs"]["field_dist"] is not flat and found["sky_background"]["flat_fielding"] is flat
        assert found["sky_background"]["enable_straylight_model"] is flat
    more = layers(Setting(layers={"nonlinearity": {}, "CTE_effect": {"density_scale": 0.5}}))
    assert more["CTE_effect"]["density_scale"] == 0.5 and "nonlinearity" in more


def test_fields_lie_on_other_chips_and_parts_of_them(field):
    """Each has an exposure of its own; windows are in turn in the middle and the corners, after all chips had one."""
    plan = field.plan.model_copy(update={"chips": [8, 9], "size": 232})
    some = [Field(field.simulation, plan, "r", "one", number) for number in range(10)]
    assert [one.chip for one in some] == [8, 9] * 5
    assert [one.obsid for one in some] == [str(10100000001 + k) for k in range(10)]
    assert [one.shear for one in some[1:3]] == [plan.shear * (1 + 1j), plan.shear * (1 - 1j)]
    detector = field.simulation._run.camera.detector
    room = detector.nx - 232, detector.ny - 232
    corners = [(0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)]
    windows = [one.aimed._run.config.window for one in some[::2]]
    assert [(w.x0, w.x1, w.y0, w.y1) for w in windows] == [
        (round(a * room[0]), round(a * room[0]) + 232, round(b * room[1]), round(b * room[1]) + 232) for a, b in corners
    ]


def test_stamps_are_cut_about_the_pixels_of_galaxies(field):
    window = field.job(False).window
    y, x = np.mgrid[window.y0 : window.y1, window.x0 : window.x1]
    half = field.plan.stamp // 2
    for plane, galaxies in ((x, field.galaxies.x), (y, field.galaxies.y)):
        stamps = field.stamps(plane.astype(np.float32))
        assert stamps.shape == (16, 2 * half, 2 * half) and stamps[:, half, half].tolist() == np.rint(galaxies).tolist()
        assert field.stamps(plane, slice(3, 5))[:, half, half].tolist() == np.rint(galaxies[3:5]).tolist()


def test_the_level_is_of_sky_and_dark_current(field):
    run = field.simulation._run
    sky, dark = run.camera.filters["r"].sky * 150.0, run.camera.detector.dark * 150.0
    assert (field.level(False), field.level(True)) == pytest.approx((sky, sky + dark)) and dark > 0


def test_a_galaxy_is_found_within_four_pixels_at_ten_sigma(field):
    """Blobs of known S/N near the galaxies' positions, on noise of 5 e-."""
    window = field.job(False).window
    y, x = np.mgrid[window.y0 : window.y1, window.x0 : window.x1]
    image = np.random.default_rng(2).normal(0, 5, x.shape)
    off, light = np.full(16, 0.0), np.full(16, 3000.0)
    off[1], off[2], light[3], light[4] = 3.0, 5.5, 60.0, 1000.0
    for k in range(16):
        r2 = (x - field.galaxies.x[k] - off[k]) ** 2 + (y - field.galaxies.y[k]) ** 2
        image += light[k] / (2 * np.pi * 4) * np.exp(-r2 / 8)
    wanted = np.ones(16, bool)
    wanted[2:4] = False
    assert np.array_equal(field.detected(image.astype(np.float32)), wanted)


def test_the_noise_of_an_image_is_robust_and_without_its_edge():
    image = np.random.default_rng(1).normal(100, 7, (200, 260))
    image[:10], image[-10:], image[:, :10], image[:, -10:] = 1e6, 1e6, 1e6, -1e6
    image[40:80, 40:80] += 1e4
    assert noise_of(image) == pytest.approx(7, rel=0.12)


def test_rows_are_in_order_and_the_rest_is_the_difference(done):
    """Of all NAMES, and the scatter of half the arms' difference; errors of few windows are those of rings."""
    _, plan, paths = done
    common = plan.effects["nonlinearity"].model_copy(update={"common": True})
    other = plan.model_copy(update={"effects": plan.effects | {"nonlinearity": common}})
    one, two = (bars(which, paths["one"]) for which in (plan, other))
    assert one[1]["m1_err"] == two[1]["m1_err"] > 0
    assert [row["kind"] for row in one] == ["base", "bar", "bar", "bar", "bar", "sum", "all", "rest"]
    added, whole, rest = one[5:]
    for name in ("m1", "m2", "c1", "c2", "alpha"):
        assert rest[name] == pytest.approx(whole[name] - added[name], abs=1e-12)
    first = np.load(paths["one"][0])
    for row, setting in zip(one[:5], ("base", "nonlinearity", "base", "linear", "undone"), strict=True):
        assert row["scatter"] == scatter(*first[f"{setting}|own|e"]), row["effect"]
    assert np.isnan(added["scatter"]) and one[0]["gain"] == pytest.approx(one[0]["scatter_two"] / one[0]["scatter"])


@pytest.mark.parametrize("windows", [7, 8])
@pytest.mark.parametrize("common", [True, False])
def test_an_error_that_is_common_to_a_window_is_of_windows(file, tmp_path, windows, common):
    """m of the effect is another in each window: of n windows its error is their scatter over the root of n.

    With fewer than eight, or if it is not common, rings count as if each had its own. One galaxy has no shape.
    """
    plan = load_plan(file, fields=windows, effects=["nonlinearity"])
    effect = plan.effects["nonlinearity"].model_copy(update={"common": common, "sum": False})
    plan = plan.model_copy(update={"effects": {"nonlinearity": effect}})
    m, g, paths = np.random.default_rng(5).normal(0.01, 0.005, windows), plan.shear, []
    for k in range(windows):
        sign = 1.0 if k % 2 == 0 else -1.0
        shear = np.outer([1, -1], np.full(16, g * (1 + 1j * sign)))
        arrays = {"ring": np.repeat(np.arange(4), 4), "sign": np.array(sign), "psf": 0.01 * np.exp(1j * np.arange(16))}
        for name, change in (("base", 0.0), ("nonlinearity", m[k])):
            arrays |= {f"{name}|own|e": (1 + change) * shear, f"{name}|own|response": np.ones((2, 16, 2)),
                       f"{name}|used": np.ones((2, 16), bool), f"{name}|seconds": np.array(3.2),
                       f"{name}|own|other": (1 + change) * shear[1]}  # fmt: skip
        if k == 0:
            arrays["nonlinearity|own|e"][1, 3] = np.nan
        paths.append(tmp_path / f"{k}.npz")
        np.savez(paths[-1], **arrays)
    base, bar = bars(plan, paths)
    weight = np.array([15, *[16] * (windows - 1)])
    assert bar["m1"] == pytest.approx((weight * m).sum() / weight.sum()) == pytest.approx(bar["m2"])
    assert base["m1"] == pytest.approx(0.0, abs=1e-12) and bar["c1"] == pytest.approx(0.0, abs=1e-12)
    assert (bar["windows"], bar["galaxies"], base["galaxies"]) == (windows, 16 * windows - 1, 16 * windows)
    assert bar["seconds"] == pytest.approx(0.4) and base["seconds"] == pytest.approx(0.2)
    blocks = m if common and windows == 8 else np.repeat(m, 4)
    assert bar["m1_err"] == pytest.approx(blocks.std(ddof=1) / np.sqrt(len(blocks)), rel=0.02)


@pytest.mark.parametrize("common", [(True, False), (False, True), (True, True), (False, False)])
def test_errors_of_sums_are_common_to_a_window_if_those_of_any_effect_are(file, tmp_path, common):
    """Two effects whose m is another in each of eight windows, and all at once with a change of its own.

    An error common to a window is the scatter of windows over the root of 8, one that is not that of 32 rings.
    """
    names, windows = ("nonlinearity", "linear"), 8
    plan = load_plan(file, fields=windows, effects=names)
    effects = {
        name: plan.effects[name].model_copy(update={"common": of, "sum": True, "times": 1})
        for name, of in zip(names, common, strict=True)
    }
    plan = plan.model_copy(update={"effects": effects})
    first, second, more = np.random.default_rng(6).normal(0.01, 0.005, (3, windows))
    m, paths = {"base": 0 * first, names[0]: first, names[1]: second, "all": first + second + more}, []
    for k in range(windows):
        sign = 1.0 if k % 2 == 0 else -1.0
        shear = np.outer([1, -1], np.full(16, plan.shear * (1 + 1j * sign)))
        arrays = {"ring": np.repeat(np.arange(4), 4), "sign": np.array(sign), "psf": 0.01 * np.exp(1j * np.arange(16))}
        for name, changes in m.items():
            arrays |= {f"{name}|own|e": (1 + changes[k]) * shear, f"{name}|own|response": np.ones((2, 16, 2)),
                       f"{name}|used": np.ones((2, 16), bool), f"{name}|seconds": np.array(3.2),
                       f"{name}|own|other": (1 + changes[k]) * shear[1]}  # fmt: skip
        paths.append(tmp_path / f"{k}.npz")
        np.savez(paths[-1], **arrays)
    rows = {row["effect"] if row["kind"] == "bar" else row["kind"]: row for row in bars(plan, paths)}
    any_common = common != (False, False)
    wanted = {names[0]: (first, common[0]), names[1]: (second, common[1]), "sum": (first + second, any_common),
              "all": (m["all"], any_common), "rest": (more, any_common)}  # fmt: skip
    assert set(rows) == {"base", *wanted}
    for name, (values, of_windows) in wanted.items():
        blocks = values if of_windows else np.repeat(values, 4)
        assert rows[name]["m1"] == pytest.approx(values.mean()), name
        assert rows[name]["m1_err"] == pytest.approx(blocks.std(ddof=1) / np.sqrt(len(blocks)), rel=1e-6), name
    seconds = {name: row["seconds"] for name, row in rows.items()}  # 0.2 of each Setting of each bar
    wanted = {"base": 0.2, names[0]: 0.4, names[1]: 0.4, "sum": 0.8, "all": 0.4, "rest": 1.2}
    assert seconds == pytest.approx(wanted)


CHANGES = {
    "noise": False, "layers": {"nonlinearity": {}}, "distortion": True, "flat": True, "straylight": True,
    "profile": "full", "blended": True, "undetected": True, "neighbour_shear": "none", "calibrated": True,
    "masking": True, "background": "mesh",
}  # fmt: skip


@pytest.mark.parametrize("name", Setting.model_fields)
def test_an_image_is_shared_by_settings_that_render_and_calibrate_it_alike(name):
    """Only the map, the PSF and the detection of the analysis leave the image as it is."""
    rendered = []

    class Arms:
        def arm(self, setting, g):
            rendered.append(setting)
            return np.zeros(1)

    uneven = {"background": "constant"}
    base = {"masking": {"calibrated": True}, "flat": uneven, "straylight": uneven}.get(name, {})
    analysis = {"wcs": "linear", "psf": "stars", "detection": True}
    settings = [Setting(**base), Setting(**base | {name: (CHANGES | analysis)[name]})]
    cache = running._Cache({}, {}, {}, {})
    for setting in settings:
        running._image(Arms(), setting, 0.02, cache)
    assert len(rendered) == (1 if name in analysis else 2)
