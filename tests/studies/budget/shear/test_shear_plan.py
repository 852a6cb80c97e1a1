"""Plans and samples of the budget of shear."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from csstsim.base.errors import InputError
from csstsim.command_line.main import main
from csstsim.instrument.chip import Window
from csstsim.studies.budget.shear import sample
from csstsim.studies.budget.shear.command import summary
from csstsim.studies.budget.shear.plan import ALL, BASE, DEFAULT, Lens, Neighbours, load_plan
from csstsim.studies.budget.shear.run import setting_names, setting_of
from csstsim.studies.budget.shear.sample import FIRST_NEIGHBOUR_ID, RING, efficiency, make_galaxies, sheared_offset

WINDOW = Window(1000, 2000, 3000, 4000)
NEIGHBOURS = DEFAULT.with_name("shear_neighbours.yaml")


@pytest.fixture
def changed(tmp_path):
    """Return a function that writes the shipped plan with keys changed."""

    def write(**keys):
        path = tmp_path / "plan.yaml"
        path.write_text(yaml.safe_dump(yaml.safe_load(DEFAULT.read_text()) | keys))
        return path

    return write


def test_the_shipped_plan_has_the_effects_of_a_stage_iv_survey():
    plan = load_plan()
    listed = """psf_field psf_stars distortion brighter_fatter charge_transfer charge_transfer_undone nonlinearity
    cosmic_rays defects sky_gradient blending undetected other_shear morphology masking detection"""
    wanted = listed.split()
    assert set(wanted) <= set(plan.bars)
    whole = plan.setting(ALL)
    assert whole.calibrated and whole.masking and whole.undetected and whole.psf == "stars" and whole.distortion
    assert set(whole.layers) >= {"brighter_fatter", "CTE_effect", "nonlinearity", "cosmic_rays", "detector_defects"}
    assert plan.setting(BASE) == plan.base and setting_of(plan, "noise") == BASE and "noise" not in setting_names(plan)


def test_effects_bring_those_that_they_stand_against():
    plan = load_plan(effects=["other_shear"], fields=2, estimators=["own"])
    assert plan.bars == ("other_shear",) and set(plan.effects) == {"other_shear", "undetected"}
    assert plan.summed == () and plan.fields == 2 and plan.estimators == ("own",)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"shear": 0.2}, "shear"), ({"stamp": 47}, "stamp"), ({"stamp": 64}, "stamp.*at most 48"),
        ({"estimators": ["ksb"]}, "estimators"), ({"size": 200, "spacing": 100}, "size: no room"),
        ({"effects": {"base": {"about": "x"}}}, "effects.base"), ({"colour": 1}, "colour"), ({"chips": []}, "chips"),
        ({"effects": {"a": {"about": "x", "against": "b"}}}, "effects.a.against: no such effect"),
        ({"effects": {"a": {"about": "x", "against": "a"}}}, "effects.a.against: a circle: a against a"),
        (
            {"effects": {k: {"about": "x", "against": v} for k, v in ("ab", "bc", "cb")}},
            "effects.c.against: a circle: b against c against b",
        ),
        ({"effects": {"a": {"about": "x", "change": {"masking": True}}}}, "effects.a.change: masking needs calibrated"),
        ({"effects": {"a": {"about": "x", "change": {"psf": 3}}}}, "effects.a.change.psf"),
        ({"effects": {"a": {"about": "x", "change": {"layers": []}}}}, "effects.a.change.layers"),
        (
            {"effects": {"a": {"about": "x", "change": {"layers": {"bloom": {}}}}}},
            "effects.a.change.layers.bloom: not a layer",
        ),
        (
            {"effects": {"a": {"about": "x", "change": {"layers": {"CTE_effect": {"density": 1}}}}}},
            "effects.a.change.layers.CTE_effect.density: unknown key",
        ),
        (
            {"effects": {"a": {"about": "x", "change": {"undetected": True}}}, "neighbours": {}},
            "effects.a.change.undetected: needs neighbours.undetected",
        ),
        ({"effects": {k: {"about": k, "sum": True, "change": {"psf": k}} for k in ("middle", "stars")}}, "differs"),
        (
            {"effects": {
                k: {"about": k, "sum": True, "change": {"layers": {name: {"density_scale": v}}}}
                for k, name, v in (("a", "CTE_effect", 0.02), ("b", "cte_effect", 0.1))
            }}, "effects.b.change.layers.cte_effect: differs",
        ),
        (
            {"effects": {
                "a": {"about": "x", "sum": True, "change": {"straylight": True, "background": "mesh"}},
                "b": {"about": "x", "sum": True, "change": {"background": "known"}},
            }}, "effects.b.change.background: differs",
        ),
        ({"samples": {"a": {"magnitude": [22, 20], "size": [0.1, 0.2], "ellipticity": 0.2}}}, "magnitude"),
        ({"samples": {"a": {"magnitude": [20, 22], "size": [0, 0.3], "ellipticity": 0.2}}}, "size: must be above 0"),
        ({"chips": [8, 9]}, "chips: .*of one band"), ({"chips": [29]}, "chips"), ({"chips": [9, 99]}, "chips"),
        ({"size": 9001}, "size"), ({"seed": 2**63 - 5}, "seed"), ({"seed": -1}, "seed"),
        ({"samples": {"a": {"magnitude": [20, 91], "size": [1, 2], "ellipticity": 0.2}}}, "samples.a.magnitude.*90"),
        (
            {"neighbours": {"blended": {"number": 1, "magnitude": [91, 92], "distance": [1, 2], "size": [1, 2]}}},
            "neighbours.blended.magnitude",
        ),
        ({"stars": {"magnitude": 99, "every": 10}}, "stars.magnitude"),
        ({"stars": {"magnitude": -9.99, "every": 10}}, "stars.magnitude"),
        ({"samples": {}}, "samples"), ({"fields": 0}, "fields"), ({"whole": 0}, "whole"),
        ({"effects": {"a": {"about": "x", "times": 0}}}, "effects.a.times"),
        ({"lens": {"redshift": 0.6, "galaxies": 0.6}}, "lens: galaxies must lie behind the lens"),
        (
            {"effects": {"a": {"about": "x", "change": {"blended": True, "neighbour_shear": "by_redshift"}}}},
            "effects.a.change.neighbour_shear: by_redshift needs lens and neighbours.blended.redshift",
        ),
    ],
)  # fmt: skip
def test_a_fault_of_the_plan_is_named(changed, keys, said):
    with pytest.raises(InputError, match=said):
        load_plan(changed(**keys), effects=["a"] if "circle" in said else None)


def test_an_unknown_effect_or_sample_is_named():
    with pytest.raises(InputError, match=r"no such effect.*blooming"):
        load_plan(effects=["blooming"])
    with pytest.raises(InputError, match=r"no such sample.*dim.*bright, faint"):
        load_plan(samples=["dim"])
    assert list(load_plan(samples=["faint"]).samples) == ["faint"]


def test_settings_have_the_windows_that_bars_need():
    plan = load_plan(fields=2, effects=["noise", "cosmic_rays", "other_shear"])
    assert plan.windows("cosmic_rays") == plan.windows(BASE) == 16 and plan.windows("noise") == 8
    assert setting_names(plan, 0) == ["base", "cosmic_rays", "undetected", "other_shear", "noiseless", "all"]
    assert setting_names(plan, 7) == ["base", "cosmic_rays", "noiseless", "all"]
    assert setting_names(plan, 8) == setting_names(plan, 15) == ["base", "cosmic_rays"]
    whole = load_plan(fields=2)
    assert whole.windows(ALL) == 8 and ALL in setting_names(whole, 7) and ALL not in setting_names(whole, 8)
    assert whole.windows(BASE) == 20


def test_rings_cancel_shapes_and_responses():
    plan = load_plan()
    made = make_galaxies(plan, "bright", 3, WINDOW)
    rings = made.e.reshape(-1, RING)
    assert len(made) == len(rings) * RING == 400
    assert np.abs(rings.sum(axis=1)).max() < 1e-12 and np.abs((rings**2).sum(axis=1)).max() < 1e-12
    g = 0.02 * (1 + 1j)
    mean = ((rings + g) / (1 + np.conj(g) * rings)).mean(axis=1)  # Seitz & Schneider 1997
    assert np.abs(mean - g).max() < abs(g) ** 3  # what is left is of the order e^4 g^3
    assert np.sqrt(np.mean(made.e.real**2)) == pytest.approx(0.25, rel=0.3)  # 200 numbers: 5%, five sigma


def test_galaxies_depend_on_sample_and_field_alone():
    plan = load_plan()
    made, again = make_galaxies(plan, "bright", 3, WINDOW), make_galaxies(load_plan(fields=1), "bright", 3, WINDOW)
    assert np.array_equal(made.x, again.x) and np.array_equal(made.columns["mag"], again.columns["mag"])
    assert not np.array_equal(made.e, make_galaxies(plan, "bright", 4, WINDOW).e)
    assert made.x.min() > WINDOW.x0 + plan.stamp / 2 and made.x.max() < WINDOW.x1 - plan.stamp / 2
    assert made.y.min() > WINDOW.y0 + plan.stamp / 2 and made.y.max() < WINDOW.y1 - plan.stamp / 2
    assert len(made) < FIRST_NEIGHBOUR_ID


def test_magnitudes_follow_the_slope():
    plan = load_plan()
    mag = np.concatenate([make_galaxies(plan, "faint", f, WINDOW).columns["mag"][::RING] for f in range(8)])
    low, high = plan.samples["faint"].magnitude
    assert low <= mag.min() and mag.max() <= high
    brighter = (10**0.3 - 1) / (10**0.6 - 1)  # fraction of the brighter of the two magnitudes, slope 0.3
    assert np.mean(mag < low + 1) == pytest.approx(brighter, abs=5 * np.sqrt(0.25 / len(mag)))


def test_neighbours_turn_with_their_ring():
    plan = load_plan()
    other = make_galaxies(plan, "bright", 0, WINDOW).neighbours["undetected"]
    for k in range(0, len(other.galaxy), RING):
        offset, e = other.offset[k : k + RING], other.e[k : k + RING]
        assert other.galaxy[k : k + RING].tolist() == [other.galaxy[k] + j for j in range(RING)]
        assert np.abs((offset**2).sum()) < 1e-12 and np.abs(e.sum()) < 1e-12
        low, high = plan.neighbours["undetected"].distance
        assert np.all((np.abs(offset) >= low - 1e-9) & (np.abs(offset) <= high + 1e-9))
    mean = len(other.galaxy) / len(make_galaxies(plan, "bright", 0, WINDOW))
    assert mean == pytest.approx(1.4, abs=5 * np.sqrt(1.4 / 100))


def test_neighbours_are_sheared_as_at_their_redshift():
    """As D_ls / D_s = 1 - chi_l / chi_s, of distances by astropy."""
    from astropy.cosmology import FlatLambdaCDM

    lens, z = Lens(redshift=0.3, galaxies=0.6), np.array([0.0, 0.2, 0.3, 0.31, 0.6, 3.0])
    peer = FlatLambdaCDM(H0=67.66, Om0=0.3111, Tcmb0=0)
    ratio = [float(1 - peer.comoving_distance(0.3) / peer.comoving_distance(v)) for v in z[2:]]
    wanted = np.array([0, 0, *(r / ratio[2] for r in ratio)])
    assert efficiency(z, lens) == pytest.approx(wanted, abs=1e-6)
    plan = load_plan(NEIGHBOURS)
    made = make_galaxies(plan, "bright", 0, WINDOW).neighbours
    strength = made["undetected"].efficiency.reshape(-1, RING)
    assert np.ptp(strength, axis=1).max() == 0 and strength.min() >= 0 and np.ptp(strength) > 1
    assert made["blended"].efficiency.min() == 0.0  # some lie before the lens
    without = make_galaxies(plan.model_copy(update={"lens": None}), "bright", 0, WINDOW).neighbours
    assert np.isnan(without["blended"].efficiency).all()
    assert np.array_equal(without["blended"].offset, made["blended"].offset)


@pytest.mark.parametrize("said", ["same", "none", "by_redshift"])
def test_the_table_has_the_shear_of_each_neighbour(said):
    plan = load_plan(NEIGHBOURS)
    made = make_galaxies(plan, "bright", 0, WINDOW)
    job = SimpleNamespace(wcs=Flat, observer=None)
    g = 0.02 - 0.01j
    setting = plan.base.model_copy(update={"undetected": True, "neighbour_shear": said})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sample, "icrs", lambda ra, dec, observer: (ra, dec))
        columns = sample.catalogue_columns(made, setting, plan, job, 0, g, "r")
    n, other = len(made), made.neighbours["undetected"]
    strength = {"same": 1.0, "none": 0.0, "by_redshift": other.efficiency}[said] * np.ones(len(other.galaxy))
    assert columns["gamma1"][:n] == pytest.approx(0.02) and columns["gamma2"][n:] == pytest.approx(-0.01 * strength)
    seen = (columns["ra"][n:] - made.x[other.galaxy]) + 1j * (columns["dec"][n:] - made.y[other.galaxy])
    assert seen == pytest.approx([sheared_offset(z, g * s) for z, s in zip(other.offset, strength, strict=True)])


class Flat:
    """A map whose sky is its pixels."""

    def pixel_to_world(x, y):
        """Return the position."""
        return x, y

    def jacobian(x, y):
        """Return (n, 2, 2) of no change."""
        return np.tile(np.eye(2), (len(x), 1, 1))


def test_offsets_are_sheared_by_the_inverse_of_the_lens_map():
    g, z = 0.03 - 0.02j, 1.0 + 0.5j
    seen = sheared_offset(z, g)
    lens = np.array([[1 - g.real, -g.imag], [-g.imag, 1 + g.real]])  # A, from image to source
    assert lens @ [seen.real, seen.imag] == pytest.approx([z.real, z.imag], abs=1e-15)
    assert sheared_offset(z, 0j) == z


@pytest.mark.parametrize(
    ("keys", "said"),
    [({"estimators": ["hsm", "hsm"]}, "estimators: an estimator is named twice"),
     ({"samples": {"a/b": {"magnitude": [20.5, 21.5], "slope": 0.0, "size": [0.3, 0.6], "ellipticity": 0.25}}}, "a/b")],
)  # fmt: skip
def test_names_that_cannot_be(changed, keys, said):
    with pytest.raises(InputError, match=said):
        load_plan(changed(**keys))


@pytest.mark.parametrize(
    ("effects", "more", "said"),
    [({"a": {"about": "x", "bar": False}}, [], "effects: no effect is a bar (got ['a'])"),
     ({"a": {"about": "x", "bar": False}, "b": {"about": "x"}}, ["--effects", "a"], "effects: no effect is a bar"),
     ({"a": {"about": "x", "bar": False, "sum": True}, "b": {"about": "x"}}, [], "effects.a.bar: an effect of")],
)  # fmt: skip
def test_a_budget_needs_bars(changed, tmp_path, effects, more, said):
    """A blind run does not: it stops at its key, which is there."""
    path, out = str(changed(effects=effects)), tmp_path / "out"
    for plan in ([], ["--plan"]):
        result = CliRunner().invoke(main, ["budget", "shear", path, *more, *plan, "--output", str(out)])
        assert result.exit_code == 2 and f"{path}: {said}" in result.stderr and not out.exists()
    (tmp_path / "key.json").write_text("mine")
    result = CliRunner().invoke(
        main, ["budget", "shear", path, "--blind", str(tmp_path / "key.json"), "--output", str(out)]
    )
    assert result.exit_code == 2 and "exists already" in result.stderr


@pytest.mark.parametrize("full", [False, True])
def test_every_column_of_the_table_is_that_of_its_galaxy(full):
    """Galaxies first, then both kinds of neighbours, with ids of their own; disks where the profile is plain."""
    plan = load_plan(NEIGHBOURS)
    made = make_galaxies(plan, "bright", 0, WINDOW)
    setting = plan.base.model_copy(
        update={"undetected": True, "blended": True, "profile": "full" if full else "disk", "neighbour_shear": "same"}
    )
    turn = SimpleNamespace(pixel_to_world=lambda x, y: (x / 100, -y / 100), jacobian=lambda x, y: np.tile(
        np.array([[3.0, 1.0], [-2.0, 5.0]]), (len(x), 1, 1)))  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sample, "icrs", lambda ra, dec, observer: (ra, dec))
        job = SimpleNamespace(wcs=turn, observer=None)
        columns = sample.catalogue_columns(made, setting, plan, job, 3, 0.02 - 0.01j, "r")
    n, kinds = len(made), [made.neighbours[name] for name in ("blended", "undetected")]
    counts = [len(other.galaxy) for other in kinds]
    assert columns["id"].tolist() == [*range(3_000_001, 3_000_001 + n), *range(3_500_000, 3_500_000 + sum(counts))]
    for name in ("bulge_frac", "n_disk", "n_bulge", "knots", "knots_frac"):
        plain = {"bulge_frac": 0, "n_disk": 1, "n_bulge": 4, "knots": 0, "knots_frac": 0}[name]
        assert columns[name][:n] == pytest.approx(made.columns[name] if full else np.full(n, plain)), name
        assert set(columns[name][n:]) == {plain}, name
    assert columns["size_disk"][:n] == pytest.approx(made.columns["size_disk"])
    assert columns["size_bulge"][:n] == pytest.approx(made.columns["size_bulge" if full else "size_disk"])
    assert columns["mag_r"][:n] == pytest.approx(made.columns["mag"]) and set(columns["type"]) == {"galaxy"}
    e = np.concatenate([made.e, *(other.e for other in kinds)])
    assert columns["e1"] == pytest.approx(e.real) and columns["e2"] == pytest.approx(e.imag)
    assert columns["gamma1"] == pytest.approx(0.02) and columns["gamma2"] == pytest.approx(-0.01)
    assert columns["ra"][:n] == pytest.approx(made.x / 100) and columns["dec"][:n] == pytest.approx(-made.y / 100)
    at = n
    for other, count in zip(kinds, counts, strict=True):
        some = slice(at, at + count)
        z = sheared_offset(other.offset, 0.02 - 0.01j)
        x, y = made.x[other.galaxy], made.y[other.galaxy]
        assert columns["ra"][some] == pytest.approx((x + 3 * z.real + z.imag) / 100)
        assert columns["dec"][some] == pytest.approx(-(y - 2 * z.real + 5 * z.imag) / 100)
        assert columns["mag_r"][some] == pytest.approx(other.mag)
        assert columns["size_disk"][some] == pytest.approx(other.size)
        assert columns["size_bulge"][some] == pytest.approx(other.size)
        at += count


def test_galaxies_lie_on_a_grid_of_rings_with_profiles_of_their_ring():
    """Half a pixel from the positions of the grid; all columns are common to a ring, in the ranges of the module."""
    plan = load_plan()
    made = make_galaxies(plan, "bright", 1, WINDOW)
    cells, k = plan.cells, np.arange(len(made))
    for values, start, cell in ((made.x, 1000, k % cells), (made.y, 3000, k // cells)):
        off = values - (start + 10 + plan.spacing * (cell + 0.5))
        assert np.abs(off).max() <= 0.5 and abs(off.mean()) < 5 / np.sqrt(12 * len(off)) and np.ptp(off) > 0.9
    assert made.ring.tolist() == np.repeat(np.arange(len(made) // 4), 4).tolist()
    columns = {name: values.reshape(-1, RING) for name, values in made.columns.items()}
    assert all(np.ptp(values, axis=1).max() == 0 for values in columns.values())
    of = {name: values[:, 0] for name, values in columns.items()}
    low, high = plan.samples["bright"].size
    assert low <= of["size_disk"].min() and of["size_disk"].max() <= high
    bulge_fraction, n = of["bulge_frac"], len(of["mag"])
    assert (bulge_fraction > 0).mean() == pytest.approx(1 / 3, abs=5 * np.sqrt(2 / 9 / n))
    assert ((bulge_fraction == 0) | ((bulge_fraction >= 0.1) & (bulge_fraction <= 0.6))).all()
    assert set(of["n_disk"]) == {0.75, 1.0, 1.25, 1.5} and set(of["n_bulge"]) == {2, 3, 4}
    knots = of["knots"]
    assert ((knots == 0) | ((knots >= 5) & (knots < 30))).all() and 0.2 < (knots > 0).mean() < 0.8
    assert ((of["knots_frac"] > 0) == (knots > 0)).all() and of["knots_frac"].max() <= 0.3
    ratio = of["size_bulge"] / of["size_disk"]
    assert ratio.min() >= 0.3 and ratio.max() <= 0.7
    e = made.e.reshape(-1, RING)
    assert e[:, 1:] / e[:, :1] == pytest.approx(np.tile([1j, -1, -1j], (len(e), 1)))


def test_magnitudes_and_shapes_have_the_stated_distributions():
    """To five sigma: even without a slope, in any direction, and cut at 0.7."""
    rng, n = np.random.default_rng(2), 20_000
    mag = sample._magnitudes(rng, (20.0, 22.0), 0.0, n)
    assert mag.min() >= 20 and mag.max() <= 22 and mag.mean() == pytest.approx(21, abs=5 * 2 / np.sqrt(12 * n))
    falling = sample._magnitudes(rng, (20.0, 22.0), -0.5, n)
    assert (falling < 21).mean() == pytest.approx((1 - 10**-0.5) / (1 - 0.1), abs=5 * 0.5 / np.sqrt(n))
    e = sample._shapes(rng, 0.25, n)
    assert np.abs(e).max() <= 0.7
    cut = (0.7 / 0.25) ** 2 / 2
    mean2 = 2 * 0.25**2 * (1 - (1 + cut) * np.exp(-cut)) / (1 - np.exp(-cut))  # of a Rayleigh number, cut
    assert (np.abs(e) ** 2).mean() == pytest.approx(mean2, rel=5 / np.sqrt(n))
    for part in (e.real, e.imag, (e**2).real, (e**2).imag):
        assert part.mean() == pytest.approx(0, abs=5 * part.std() / np.sqrt(n))
    assert not sample._shapes(rng, 0.0, 5).any()


def test_neighbours_are_even_in_area():
    """The mean square distance is that of a ring between its radii; sizes and magnitudes in their ranges."""
    of = Neighbours(number=20.0, magnitude=(22.0, 24.0), distance=(1.0, 3.0), size=(0.1, 0.4))
    found = sample._neighbours(np.random.default_rng(1), of, np.tile(np.arange(4) * np.pi / 4, 100), 100)
    one = found.offset[::RING]
    assert (np.abs(one) ** 2).mean() == pytest.approx(5.0, abs=5 * 8 / np.sqrt(12 * len(one)))
    assert abs((one / np.abs(one)).mean()) < 5 / np.sqrt(len(one))
    assert found.mag.min() >= 22 and found.mag.max() <= 24 and found.mag.mean() == pytest.approx(23, abs=0.06)
    assert found.size.min() >= 0.1 and found.size.max() <= 0.4
    assert np.bincount(found.galaxy, minlength=400).mean() == pytest.approx(20, abs=5 * np.sqrt(20 / 100))


def test_changes_of_layers_are_added_to_those_of_the_base(changed):
    """Of one effect, and of all of the sum; the base's own stay."""
    effects = {
        "a": {"about": "x", "sum": True, "change": {"layers": {"nonlinearity": {}}, "wcs": "linear"}},
        "b": {"about": "y", "sum": True, "change": {"layers": {"CTE_effect": {"density_scale": 0.1}}, "psf": "stars"}},
        "c": {"about": "z", "change": {"profile": "full"}},
        "none": {"about": "w", "change": {"layers": None}},
    }
    plan = load_plan(changed(effects=effects, base={"layers": {"cosmic_rays": {}}}))
    assert plan.setting("a").layers == {"cosmic_rays": {}, "nonlinearity": {}} and plan.setting("a").psf == "truth"
    whole = plan.setting(ALL)
    assert whole.layers == {"cosmic_rays": {}, "nonlinearity": {}, "CTE_effect": {"density_scale": 0.1}}
    assert (whole.wcs, whole.psf, whole.profile) == ("linear", "stars", "disk")
    assert plan.setting("none").layers == {"cosmic_rays": {}} and plan.summed == ("a", "b")
    assert plan.bars == ("a", "b", "c", "none")


def test_the_plan_is_summed_up(changed):
    effects = {"a": {"about": "x", "sum": True, "times": 3, "change": {"profile": "full"}}, "b": {"about": "y"}}
    plan = load_plan(changed(effects=effects, fields=2, whole=2, chips=[9], shear=0.01, estimators=["own", "hsm"]))
    bright = plan.samples["bright"].magnitude
    said = summary(plan, None, False)
    assert said[0] == "plan: config/budget/shear.yaml; shear 0.01; estimators own, hsm"
    assert said[1].startswith(f"samples: bright, {bright[0]:g} to {bright[1]:g} mag; faint, ")
    assert said[2] == "effects: a, b" and said[3].startswith(
        f"windows: 2 of each sample, {plan.size} px wide, a galaxy"
    )
    assert said[3].endswith("chips 9; 6 of a, 4 of all") and "now 12 windows" in said[4] and "3 settings" in said[4]
    assert "one window of each sample" in summary(plan, "my.yaml", True)[4]
