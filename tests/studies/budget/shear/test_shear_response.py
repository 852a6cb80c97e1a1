"""Estimators and solutions of the budget of shear, against closed forms."""

from types import SimpleNamespace

import galsim
import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.studies.budget.shear import run as running
from csstsim.studies.budget.shear.estimators import PACKAGES, Shapes, Stamps, check_installed, estimator, psf_shapes
from csstsim.studies.budget.shear.plan import Setting
from csstsim.studies.budget.shear.response import NAMES, Arms, SharedColumns, Term, combined, estimates, scatter, sums
from csstsim.studies.budget.shear.run import to_sky

SCALE, SIDE = 0.074, 48
G = 0.02
GAUSSIAN_M = 2e-4  # of moments of a noiseless Gaussian galaxy behind a Gaussian PSF, exact but for pixels and the stamp


def rendered(shapes, psf_shape=0.0, sigma=0.35):
    """Return stamps of Gaussian galaxies of complex ellipticity (a - b) / (a + b), and of their PSF."""
    star = galsim.Gaussian(sigma=0.12).shear(g1=psf_shape)

    def stamp(profile):
        return profile.shift(SCALE / 2, SCALE / 2).drawImage(nx=SIDE, ny=SIDE, scale=SCALE).array.astype(float)

    galaxies = [galsim.Gaussian(sigma=sigma, flux=1e4).shear(g1=e.real, g2=e.imag) for e in shapes]
    psf = stamp(star)
    return np.array([stamp(galsim.Convolve(galaxy, star)) for galaxy in galaxies]), np.array([psf] * len(shapes))


def sheared(e, g):
    """Return ellipticities after a shear (Seitz & Schneider 1997, equation 3.2)."""
    return (e + g) / (1 + np.conj(g) * e)


def ring(e=0.3):
    return e * np.exp(2j * np.pi * np.arange(4) / 4 + 0.3j)


def arms(kind, psf_shape=0.0):
    """Return the Arms of a noiseless ring under +-G in both components, and its Frame."""
    found = []
    for sign in (1, -1):
        images, psf = rendered(sheared(ring(), sign * G * (1 + 1j)), psf_shape)
        found.append(estimator(kind)(Stamps(images, psf, 0.0, SCALE), np.random.default_rng(1)))
    made = Arms(
        np.array([v.e for v in found]), np.array([v.response for v in found]), np.ones((2, 4), bool)
    )  # fmt: skip
    return made, SharedColumns(np.ones(4), psf_shapes(psf), np.arange(4))


@pytest.mark.parametrize("kind", ["hsm", "own"])
@pytest.mark.parametrize("psf_shape", [0.0, 0.05])
def test_moments_of_gaussians_respond_exactly(kind, psf_shape):
    made, frame = arms(kind, psf_shape)
    value = estimates(sums(made, frame, made.used).sum(axis=0), G)
    assert np.abs(value[:2]).max() < GAUSSIAN_M
    assert np.abs(value[2:4]).max() < 1e-4


@pytest.mark.parametrize("kind", sorted(PACKAGES))
def test_public_estimators_calibrate_themselves(kind):
    pytest.importorskip(PACKAGES[kind])
    made, frame = arms(kind, 0.03)
    value = estimates(sums(made, frame, made.used).sum(axis=0), G)
    assert np.abs(value[:2]).max() < 2e-3  # of the order g^2 = 8e-4
    assert np.abs(value[2:4]).max() < 5e-4


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr("csstsim.studies.budget.shear.estimators.find_spec", lambda name: None)
    check_installed(("hsm", "own"), "plan.yaml")
    with pytest.raises(InputError, match="anacal"):
        check_installed(("hsm", "fpfs"), "plan.yaml")


def test_shape_of_a_psf():
    assert psf_shapes(rendered([0j], 0.05)[1])[0] == pytest.approx(0.05 * 0.0144 / (0.0144 + SCALE**2), abs=0.01)
    assert np.isnan(psf_shapes(np.zeros((1, SIDE, SIDE)))).all()


def biased(n=4000, m=(0.01, -0.02), c=(1e-3, -2e-3), alpha=0.1, noise=0.0, seed=1, psf_mean=0.0):
    """Return Arms and Frame of shapes with known biases; noise: of each shape, the same in both arms."""
    rng = np.random.default_rng(seed)
    psf = 0.05 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    psf += psf_mean - psf.mean()
    sign = np.where(np.arange(n) % 2, 1.0, -1.0)
    shared = noise * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    e = [
        arm * G * ((1 + m[0]) + 1j * sign * (1 + m[1])) + complex(*c) + alpha * psf + shared for arm in (1, -1)
    ]  # fmt: skip
    return Arms(np.array(e), np.ones((2, n, 2)), np.ones((2, n), bool)), SharedColumns(sign, psf, np.arange(n) // 4)


def test_known_biases_are_returned():
    made, frame = biased()
    value, error = combined([Term({"a": sums(made, frame, made.used)}, {"a": 1.0})], G)
    assert dict(zip(NAMES, value, strict=True)) == pytest.approx(
        {"m1": 0.01, "m2": -0.02, "c1": 1e-3, "c2": -2e-3, "alpha": 0.1}, abs=1e-12
    )
    assert error[:2] == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize("mean", [0.02 + 0.05j, -0.3])
def test_alpha_is_of_the_changes_of_the_psf(mean):
    """A PSF that is the same everywhere adds to c; the mean of one that changes counts there, too."""
    made, frame = biased(psf_mean=mean)
    value = dict(zip(NAMES, estimates(sums(made, frame, made.used).sum(axis=0), G), strict=True))
    c = complex(1e-3, -2e-3) + 0.1 * mean
    assert value == pytest.approx({"m1": 0.01, "m2": -0.02, "c1": c.real, "c2": c.imag, "alpha": 0.1}, abs=1e-12)


def test_responses_divide_shapes():
    made, frame = biased()
    scaled = Arms(0.4 * made.e, 0.4 * made.response, made.used)
    assert estimates(sums(scaled, frame, made.used).sum(axis=0), G) == pytest.approx(
        estimates(sums(made, frame, made.used).sum(axis=0), G), rel=1e-12
    )


def test_noise_of_both_arms_cancels_in_m_and_its_error_is_right_in_c():
    made, frame = biased(noise=0.25)
    value, error = combined([Term({"a": sums(made, frame, made.used)}, {"a": 1.0})], G)
    assert value[:2] == pytest.approx([0.01, -0.02], abs=1e-12)
    assert error[2:4] == pytest.approx(0.25 / np.sqrt(4000), rel=0.1)  # a jackknife of 1000 blocks: 2%, 4 sigma
    assert np.abs(value[2:4] - [1e-3, -2e-3]).max() < 5 * 0.25 / np.sqrt(4000)


def test_jackknife_of_a_mean_is_its_standard_error():
    rng = np.random.default_rng(2)
    made, frame = biased(n=400)
    noisy = Arms(made.e + 0.1 * rng.standard_normal((2, 400)), made.response, made.used)
    each = SharedColumns(frame.sign, frame.psf, np.arange(400))
    _, error = combined([Term({"a": sums(noisy, each, made.used)}, {"a": 1.0})], G)
    half = (noisy.e[0] - noisy.e[1]).real / (2 * G)
    assert error[0] == pytest.approx(half.std(ddof=1) / 20, rel=1e-9)


def test_a_setting_less_itself_is_nothing_and_bars_add_up():
    blocks = {}
    for number, m in enumerate([(0.0, 0.0), (0.01, 0.0), (0.0, 0.02), (0.01, 0.02)]):
        made, frame = biased(m=m, noise=0.1)
        blocks[number] = sums(made, frame, made.used)
    value, error = combined([Term(blocks, {3: 1.0, 0: 1.0, 1: -1.0, 2: -1.0})], G)
    assert value == pytest.approx(np.zeros(5), abs=1e-12) and error == pytest.approx(np.zeros(5), abs=1e-12)
    value, error = combined([Term({0: blocks[0], 1: blocks[0]}, {0: 1.0, 1: -1.0})], G)
    assert not value.any() and not error.any()


def test_terms_of_few_and_of_many_blocks_share_their_noise():
    """Of two means of the same numbers, over all n blocks and over the first k, the difference has 1 / k - 1 / n."""
    rng, n, k = np.random.default_rng(6), 4000, 1000
    made, frame = biased(n=n, m=(0.0, 0.0))
    noisy = Arms(made.e + 0.1 * rng.standard_normal((2, n)), made.response, made.used)
    total = sums(noisy, SharedColumns(frame.sign, frame.psf, np.arange(n)), made.used)
    every, first = {"a": total}, {"a": total[:k]}
    value, error = combined([Term(first, {"a": 1.0}), Term(every, {"a": -1.0})], G)
    sigma = 0.1 / np.sqrt(2) / G  # of m of one galaxy
    assert error[0] == pytest.approx(sigma * np.sqrt(1 / k - 1 / n), rel=0.12)  # of k numbers: 2.2%, 5 sigma
    assert value[0] == pytest.approx((estimates(total[:k].sum(0), G) - estimates(total.sum(0), G))[0], abs=1e-15)
    once, twice = combined([Term(first, {"a": 1.0})], G), combined([Term(first, {"a": 1.0})] * 2, G)
    assert twice[1] == pytest.approx(2 * once[1], rel=1e-12)  # all of the noise is common
    assert np.isnan(combined([Term(every, {"a": 1.0}), Term({"a": total[:1]}, {"a": 1.0})], G)[1]).all()


def test_those_found_in_one_arm_alone_count_there():
    made, frame = biased(n=4, m=(0.0, 0.0), c=(0.0, 0.0), alpha=0.0)
    counted = np.array([[True, True, True, False], [True, True, True, True]])
    total = sums(made, frame, counted).sum(axis=0)
    assert total[3] == 3 and total[8] == 4 and total[10] == 3
    assert estimates(total, G)[:2] == pytest.approx([0, 0], abs=1e-12)


def test_no_galaxy_and_one_block():
    made, frame = biased(n=4)
    assert np.isnan(estimates(sums(made, frame, np.zeros((2, 4), bool)).sum(axis=0), G)).all()
    value, error = combined([Term({"a": sums(made, frame, made.used)}, {"a": 1.0})], G)
    assert np.isfinite(value[:4]).all() and np.isnan(error).all()


def test_scatter_of_half_the_difference():
    rng = np.random.default_rng(3)
    one, two = (rng.standard_normal(20_000) + 1j * rng.standard_normal(20_000) for _ in range(2))
    one[0] = np.nan
    assert scatter(one, two) == pytest.approx(np.sqrt(0.5), rel=0.03)  # of 40,000 numbers, MAD: 0.6%, 5 sigma
    assert scatter(one, one) == 0.0


@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize("shear", [0.0, 0.05j])
def test_shapes_go_to_the_sky_as_galaxies_do(angle, shear):
    e = np.array([0.2 + 0.1j, -0.1j])
    stretch = np.array([[1 + shear.real, shear.imag], [shear.imag, 1 - shear.real]]) if shear else np.eye(2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    jacobian = np.array([stretch @ turn] * 2)  # from the sky to pixels
    seen = sheared(e * np.exp(2j * angle), shear)
    found = to_sky(Shapes(seen, np.ones((2, 2))), jacobian, True).e
    assert found == pytest.approx(e, abs=1e-9)
    small = to_sky(Shapes(0.4 * sheared(1e-3 * e * np.exp(2j * angle), shear), np.full((2, 2), 0.4)), jacobian, False).e
    assert small == pytest.approx(0.4e-3 * e, abs=2e-5)


def test_sums_are_by_block_and_estimates_of_them_by_hand():
    """Three galaxies in two blocks, one of them without a shape in the second arm; responses by component differ."""
    e = np.array([[0.3 + 0.1j, -0.2 + 0.4j, 0.1 - 0.1j], [0.2 - 0.1j, -0.3 + 0.2j, np.nan]])
    response = np.array([[[0.9, 0.8], [1.1, 0.7], [1.0, 1.2]], [[0.5, 0.6], [0.7, 0.9], [np.nan, np.nan]]])
    psf, sign = np.array([0.02 + 0.01j, -0.03j, 0.05 + 0j]), np.array([1.0, -1.0, -1.0])
    made = Arms(e, response, np.ones((2, 3), bool))
    assert made.finite.tolist() == [True, True, False]
    counted = np.array([[True, True, True], [True, True, False]])
    total = sums(made, SharedColumns(sign, psf, np.array([1, 1, 0])), counted)
    assert total[0] == pytest.approx([0.1, -0.1, 0.1, 1.0, 1.2, *[0.0] * 13])
    mean = (e[0, :2] + e[1, :2]) / 2
    r = (response[0, :2] + response[1, :2]).mean(axis=1) / 2
    wanted = [0.1, 0.5, 0.1 - 0.4, 2.0, 1.5, -0.1, 0.1, -0.1 - 0.2, 1.2, 1.5, 2, 0.02, -0.02,
              (np.conj(psf[:2]) * mean).real.sum(), (np.abs(psf[:2]) ** 2).sum(), mean.real.sum(), mean.imag.sum(),
              r.sum()]  # fmt: skip
    assert total[1] == pytest.approx(wanted)
    found = estimates(total[1], G)
    plus, minus = wanted[:5], wanted[5:10]
    m = [(plus[k] / plus[j] - minus[k] / minus[j]) / (2 * G) - 1 for k, j in ((0, 3), (2, 4))]
    c = [(plus[k] / plus[j] + minus[k] / minus[j]) / 2 for k, j in ((0, 3), (1, 4))]
    away, shape = psf[:2] - psf[:2].mean(), mean - mean.mean()
    alpha = (np.conj(away) * shape).real.sum() / (np.abs(away) ** 2).sum() / r.mean()
    assert found == pytest.approx([*m, *c, alpha])
    assert estimates(total, G).shape == (2, 5)


@pytest.mark.parametrize("kind", ["hsm", "own"])
def test_each_galaxy_has_its_own_shape_in_both_components(kind):
    """Behind a PSF that is a Gaussian, to 5e-4; an empty stamp has none."""
    e = np.array([0.3 + 0.1j, -0.2j, -0.15 + 0.05j, 0.0])
    images, psf = rendered(e, 0.03)
    images[3] = 0
    found = estimator(kind)(Stamps(images, psf, 1.0, SCALE), np.random.default_rng(1))
    assert found.e[:3] == pytest.approx(e[:3], abs=5e-4) and np.isnan(found.e[3])
    assert found.response.tolist() == [[1.0, 1.0]] * 4


def test_the_scatter_is_robust_and_of_both_components():
    """Half the difference: 1 in the first, 3 in the second component, each about its own median."""
    n = 1001
    step = np.linspace(-1, 1, n)
    plus = 10 + 2 * step + 5j + 2j * step[::-1]
    assert scatter(plus, np.zeros(n, complex)) == pytest.approx(1.4826 * 0.5, rel=1e-2)
    plus[:3] = 1e6
    assert scatter(plus, np.zeros(n, complex)) == pytest.approx(1.4826 * 0.5, rel=2e-2)


def test_weak_shapes_lose_the_maps_shear_by_component():
    """Of a map that stretches by 0.02 along x and 0.03 along y = x, and does not turn: r1 0.02, r2 0.03."""
    g = 0.02 + 0.03j
    jacobian = np.array([[[1 + g.real, g.imag], [g.imag, 1 - g.real]]])
    found = to_sky(Shapes(np.array([0.1 - 0.2j]), np.array([[0.4, 0.7]])), jacobian, False)
    assert found.e[0] == pytest.approx(0.1 - 0.4 * 0.02 + 1j * (-0.2 - 0.7 * 0.03), abs=2e-4)
    assert found.response.tolist() == [[0.4, 0.7]]


class Three:
    """Three galaxies of three rings."""

    ring = np.arange(3)

    def __len__(self):
        return 3


class Window3:
    """A field of three galaxies that draws its shear, its seed and its Setting into the pixels."""

    sample, shear = "one", 0.02 - 0.02j

    def __init__(self, plan, number=0):
        self.plan, self.number, self.sign, self.rendered = plan, number, -1.0, []
        self.galaxies = Three()
        self.simulation = SimpleNamespace(
            _run=SimpleNamespace(camera=SimpleNamespace(telescope=SimpleNamespace(pixel_scale=0.5)))
        )

    def arm(self, setting, g, seed=None):
        self.rendered.append((setting.profile, g, seed))
        return np.array([g.real, g.imag, 0.0 if setting.profile == "disk" else 0.1, 0.0 if seed is None else 0.001])

    def stamps(self, image):
        return np.tile(image, (3, 1))

    def psf(self, setting):
        self.rendered.append(("psf", setting.psf))
        return np.full((3, 4), 0.25)

    def jacobian(self, setting):
        return np.tile(np.array([[0.0, -1.0], [1.0, 0.0]]) if setting.wcs == "known" else np.eye(2), (3, 1, 1))

    def detected(self, image):
        return np.array([True, image[0] > 0, False])

    def rng(self, kind):
        return kind


def test_shapes_of_a_field_are_of_both_arms_settings_and_seeds(monkeypatch):
    """An estimator of the pixels themselves; maps that differ by a quarter turn change the sign of a shape.

    A frame is drawn once for Settings that differ in the analysis, and shapes are measured once for those of one frame.
    """
    given = []

    def shapes(stamps, rng):
        galaxies = stamps.galaxies
        given.append((len(galaxies), stamps.sigma, stamps.scale, rng))
        e = galaxies[:, 0] + 1j * galaxies[:, 1] + galaxies[:, 2] + galaxies[:, 3]
        return Shapes(e, np.tile([0.5, 0.75], (len(galaxies), 1)))

    settings = {
        "base": Setting(), "linear": Setting(wcs="linear"), "found": Setting(detection=True),
        "full": Setting(profile="full"), "quiet": Setting(noise=False),
    }  # fmt: skip
    plan = SimpleNamespace(setting=settings.get, estimators=("metacal",), seed=7)
    monkeypatch.setattr(running, "estimator", lambda kind: shapes)
    monkeypatch.setattr(running, "setting_names", lambda plan, number: list(settings))
    monkeypatch.setattr(running, "noise_of", lambda image: 3.5)
    monkeypatch.setattr(running, "psf_shapes", lambda psf: psf.sum(axis=1) + 0j)
    field = Window3(plan)
    found = running.measure_field(field)
    g = 0.02 - 0.02j
    for name, turned, more in (
        ("base", -1, 0),
        ("linear", 1, 0),
        ("found", -1, 0),
        ("full", -1, 0.1),
        ("quiet", -1, 0),
    ):
        wanted = turned * np.array([[g + more] * 3, [-g + more] * 3])
        assert found[f"{name}|metacal|e"] == pytest.approx(wanted), name
        assert found[f"{name}|metacal|response"].tolist() == [[[0.5, 0.75]] * 3] * 2
        assert found[f"{name}|metacal|other"] == pytest.approx(turned * np.full(3, -g + more + 0.001)), name
        used = [[True, True, False], [True, False, False]] if name == "found" else [[True] * 3] * 2
        assert found[f"{name}|used"].tolist() == used and found[f"{name}|seconds"] >= 0
    assert found["psf"].tolist() == [1, 1, 1] and found["sign"] == -1 and found["ring"].tolist() == [0, 1, 2]
    arms = [one for one in field.rendered if one[0] != "psf" and one[2] is None]
    assert arms == [("disk", g, None), ("disk", -g, None), ("full", g, None), ("full", -g, None), ("disk", g, None),
                    ("disk", -g, None)]  # fmt: skip
    assert {one[2] for one in field.rendered if one[0] != "psf"} == {None, 7 + 1_000_003}
    assert field.rendered.count(("psf", "truth")) == 1
    assert [one[1] for one in given if one[3] == "metacal"] == [3.5] * 4 + [0.0] * 2
    assert [one[1] for one in given if one[3] == "metacal other"] == [3.5] * 4 + [0.0] and given[0][2] == 0.5
    assert not any("other" in name for name in running.measure_field(Window3(plan, 1)))


def test_the_arrays_that_a_window_must_have(monkeypatch):
    """Of 9 cells a side 80 galaxies in rings of four; the arm with another seed in the first window alone."""
    plan = SimpleNamespace(cells=9, estimators=("own",))
    monkeypatch.setattr(running, "setting_names", lambda plan, number: ["base"])
    wanted = {
        "psf": "complex numbers (80,)", "ring": "integers (80,)", "sign": "floats ()", "base|used": "booleans (2, 80)",
        "base|seconds": "floats ()", "base|own|e": "complex numbers (2, 80)", "base|own|response": "floats (2, 80, 2)",
    }  # fmt: skip
    assert running.expected_arrays(plan, 1) == wanted
    assert running.expected_arrays(plan, 0) == wanted | {"base|own|other": "complex numbers (80,)"}


def test_shapes_are_those_of_their_settings_own_psf(monkeypatch):
    """Settings of one frame with other PSFs have other shapes; stars for a PSF are of their own Setting's frame."""

    class Stars(Window3):
        def psf(self, setting):
            level = {"truth": 1.0, "middle": 2.0, "stars": 3.0 + setting.distortion + 0.5 * (setting.wcs == "linear")}
            return np.full((3, 4), level[setting.psf])

    settings = {
        "base": Setting(), "middle": Setting(psf="middle"), "again": Setting(), "stars": Setting(psf="stars"),
        "distorted": Setting(psf="stars", distortion=True), "linear": Setting(psf="stars", wcs="linear"),
        "found": Setting(psf="middle", detection=True),
    }  # fmt: skip
    plan = SimpleNamespace(setting=settings.get, estimators=("metacal",), seed=7)

    def shapes(stamps, rng):
        return Shapes(stamps.psf[:, 0] + 0j, np.ones((len(stamps.psf), 2)))

    monkeypatch.setattr(running, "estimator", lambda kind: shapes)
    monkeypatch.setattr(running, "setting_names", lambda plan, number: list(settings))
    monkeypatch.setattr(running, "noise_of", lambda image: 3.5)
    monkeypatch.setattr(running, "psf_shapes", lambda psf: psf[:, 0] + 0j)
    found = running.measure_field(Stars(plan))
    levels = {name: abs(found[f"{name}|metacal|e"][0, 0]) for name in settings}
    assert levels == pytest.approx(
        {"base": 1, "middle": 2, "again": 1, "stars": 3, "distorted": 4, "linear": 3, "found": 2}
    )  # a map of the analysis alone does not change the stars
