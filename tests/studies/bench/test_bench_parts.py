"""Parts of the benchmarks in closed form: costs and errors of a sweep, objects and spectra, profiles, pixels shared."""

from pathlib import Path
from types import SimpleNamespace

import galsim
import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.instrument.filter import GRID
from csstsim.studies.bench import setting as settings
from csstsim.studies.bench import sweep as sweeping
from csstsim.studies.bench.chart import ERROR_MIN, ON_NODES, Point, _colour, _groups, _join_names, points
from csstsim.studies.bench.imaging import cases, methods, truth
from csstsim.studies.bench.imaging.benchmark import case_errors, half_light_px
from csstsim.studies.bench.imaging.methods import Method, copies_of, drawing_of, standard
from csstsim.studies.bench.imaging.peers import fft, galaxy_of, paper, photons
from csstsim.studies.bench.imaging.shapes import KINDS, make_shapes
from csstsim.studies.bench.readout import layers
from csstsim.studies.bench.setting import make_setting
from csstsim.studies.bench.slitless import cases as spectra
from csstsim.studies.bench.slitless import peers
from csstsim.studies.bench.slitless import truth as spectrum_truth
from csstsim.studies.bench.sweep import measure_case, significance, sweep


class Star:
    """A case of some electrons, and those that were asked of it."""

    star = True

    def __init__(self, electrons, kind="star", number=0):
        self.electrons, self.kind, self.number = electrons, kind, number

    def about(self):
        """Return what describes it."""
        return {"object": self.number, "kind": self.kind}

    def brighter(self, electrons):
        """Return it with other electrons."""
        return Star(electrons, self.kind, self.number)


@pytest.fixture
def clock(monkeypatch):
    """A clock that goes on by what a draw costs; seconds of an object."""
    now = [0.0]
    monkeypatch.setattr(sweeping.time, "process_time", lambda: now[0])

    def method(cost, random=False, most=np.inf, kind=float, name="a"):
        def prepare(setting, case):
            def draw(copies):
                now[0] += cost * copies
                return (copies * case.electrons * np.array([[0.25, 0.75]])).astype(kind)

            return draw

        return Method(name, prepare, random=random, electrons_max=most)

    return method


def test_a_cost_is_measured_over_the_wanted_time(clock):
    """1 ms an object over at least 0.1 s: an image of unit flux; nothing is random."""
    image, cost, drawn = measure_case(clock(1e-3), None, Star(40.0), 0.1, 1e6)
    assert image.tolist() == [[0.25, 0.75]] and cost == pytest.approx(1e-3) and drawn == np.inf


@pytest.mark.parametrize("how", [{"random": True}, {"kind": np.int64}])
def test_random_electrons_are_drawn_until_there_are_enough(clock, how):
    """400 electrons an object, 1e5 in all: 250 objects; at 2 s an object, no more than 5 times the wanted time."""
    image, cost, drawn = measure_case(clock(1.1e-4, **how), None, Star(400.0), 0.01, 1e5)
    assert drawn == 1e5 and image.tolist() == [[0.25, 0.75]] and cost == pytest.approx(1.1e-4)
    assert measure_case(clock(0.011, **how), None, Star(400.0), 0.1, 1e5)[2] == 400 * 46
    assert measure_case(clock(2.0, **how), None, Star(400.0), 1.0, 1e5)[2] == 400 * 3


def test_what_is_too_bright_for_a_method_is_scaled(clock):
    """1e3 of 1e4 electrons are drawn at a time: ten times the cost, the image of unit flux."""
    image, cost, drawn = measure_case(clock(1e-3, random=True, most=1e3), None, Star(1e4), 1e-3, 5e3)
    assert cost == pytest.approx(1e-2) and drawn == 5e3 and image.sum() == pytest.approx(1.0)


def errors(setting, case, image, wanted, drawn):
    """A Bench's errors: the difference in flux and the electrons drawn."""
    return np.array([image.sum() - wanted.sum(), drawn]), np.array([0.5, 0.25])


def test_a_row_has_errors_against_both_standards(clock):
    bench = SimpleNamespace(names=("flux", "drawn"), errors=errors)
    setting, case = SimpleNamespace(variance=20.0), Star(100.0)
    direct, reference = np.array([[0.5, 0.4]]), np.array([[0.5, 0.2]])
    found = sweeping.row(bench, clock(1e-3, name="mine"), setting, case, direct, reference, 0.0, 0.0)
    snr = np.sqrt(50**2 / 70 + 40**2 / 60)
    assert found == {
        "method": "mine", "object": 0, "kind": "star", "snr": pytest.approx(snr), "cpu_s": pytest.approx(1e-3),
        "drawn": np.inf, "flux_standard": pytest.approx(0.3), "flux_direct": pytest.approx(0.1), "flux_chance": 0.5,
        "drawn_standard": np.inf, "drawn_direct": np.inf, "drawn_chance": 0.25,
    }  # fmt: skip
    assert significance(-direct, case, setting) == 0.0


def test_an_object_that_needs_too_much_memory_has_no_number():
    def prepare(setting, case):
        raise galsim.GalSimFFTSizeError("too large", 1 << 20)

    bench = SimpleNamespace(names=("flux", "drawn"), errors=errors)
    setting, one = SimpleNamespace(variance=1.0), np.ones((1, 1))
    found = sweeping.row(bench, Method("fft", prepare), setting, Star(1.0), one, one, 0.0, 0.0)
    assert found["drawn"] == 0 and np.isnan([v for k, v in found.items() if k.split("_")[0] in ("flux", "cpu")]).all()


def test_every_method_draws_every_case_against_its_own_truth(clock):
    bench = SimpleNamespace(
        names=("flux", "drawn"), errors=errors, truth=lambda setting: lambda case: np.array([[case.number, 0.0]]),
        standard=lambda setting, case: np.array([[2.0 * case.electrons]]),
    )  # fmt: skip
    some = [Star(10.0, number=1), Star(5.0, "galaxy", 2), Star(20.0, number=3)]
    methods = clock(1e-3, name="a"), clock(1e-3, name="b")
    rows = sweep(bench, SimpleNamespace(variance=1.0), some, methods, seconds=0.0, electrons=0.0)
    assert [(one["object"], one["method"], one["flux_direct"], one["flux_standard"]) for one in rows] == [
        (k, name, 1.0 - k, -1.0) for k in (1, 2, 3) for name in "ab"
    ]


def test_points_are_of_objects_on_nodes_of_one_kind():
    line = {"kind": "star", "against": ON_NODES, "cpu_us": 2e6, "visible_median": 0.3, "visible_95": 0.9, "limit": True}
    lines = [
        line | {"method": "a"}, line | {"method": "b", "kind": "galaxy"},
        line | {"method": "c", "against": "reference"},
        line | {"method": "d", "visible_median": 1e-9, "visible_95": 1e-8, "limit": False},
        line | {"method": "e", "visible_median": np.nan},
    ]  # fmt: skip
    assert points(lines, "star") == {"a": Point(2.0, 0.3, 0.9, True), "d": Point(2.0, ERROR_MIN, ERROR_MIN, False)}


def test_names_of_near_methods_of_a_colour_are_joined():
    """Within half a decade of cost and a third of error; ours, presets and peers have a colour each."""
    of = lambda cost, error: Point(cost, error, 1.0, False)  # noqa: E731
    found = {"slabs 1": of(1.0, 1.0), "slabs 2": of(1.9, 1.2), "photons": of(2.1, 1.0), "standard": of(1.2, 1.0),
             "slabs 4": of(1.5, 1.4), "UFig": of(1.0, 1.1)}  # fmt: skip
    groups = [group.names for group in _groups(found)]
    assert sorted(map(sorted, groups)) == [["UFig"], ["photons"], ["slabs 1", "slabs 2"], ["slabs 4"], ["standard"]]
    names = ["slabs 1", "photons", "slabs 2", "GalSim FFT", "slabs 4"]
    assert _join_names(names) == "slabs 1, photons, 2, GalSim FFT, 4"
    assert len({_colour(name) for name in ("stamps", "noise_free", "GalSim FFT")}) == 3
    assert _colour("slabs 4") == _colour("photons") == _colour("reference") and _colour("preview") == _colour(
        "standard"
    )


@pytest.fixture(scope="module")
def setting(bench_folder):
    return make_setting(bench_folder, "r")


def test_the_noise_of_a_setting_is_of_sky_dark_current_and_readout(setting):
    detector, sky = setting.camera.detector, setting.camera.filters["r"].sky
    assert setting.variance == pytest.approx((sky + detector.dark) * 150.0 + detector.read_noise**2)
    assert (setting.exptime, setting.chip.filter, setting.disperser) == (150.0, "r", None)


def test_an_unknown_filter_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"--filter: unknown filter .*got 'w'"):
        make_setting(tmp_path, "w")


def test_the_sample_has_what_it_says(setting):
    """Half are stars; fluxes, sizes and shapes in their ranges; every other near a node; its window about it."""
    made = cases.make_cases(setting, 24, seed=4, largest=0.6)
    assert [case.star for case in made] == [True] * 12 + [False] * 12
    assert [case.at_node for case in made] == [True, False] * 12 and [c.about()["object"] for c in made] == [*range(24)]
    flux = np.array([case.electrons for case in made])
    assert flux[:3] == pytest.approx([10.0, 100.0, 1000.0]) and flux.min() >= 10 and flux.max() <= 1e7
    nodes = setting.psf.nodes_xy
    for case in made:
        x, y = case.row["x"][0], case.row["y"][0]
        near = np.abs(nodes - (x, y)).max(axis=1).min()
        assert near <= 0.5 if case.at_node else True
        assert 300 - 0.5 <= x <= 9216 - 299.5 and 300 - 0.5 <= y <= 9232 - 299.5
        w, half = case.window, case.half
        assert w.nx == w.ny == 2 * half + 1 and 32 <= half <= 160
        assert half == np.clip(case.row["reach"][0] + 16, 32, 160)
        assert (w.x0 + half, w.y0 + half) == (round(x), round(y))
        rates = np.array([case.row[f"flux{k}"][0] for k in range(4)]) * 150.0 / case.electrons
        assert rates == pytest.approx([0.16, 0.3, 0.34, 0.2], rel=1e-5)
        assert case.scene.electrons.sum() == pytest.approx(case.electrons, rel=1e-5)
        about = case.about()
        assert about["e"] <= 0.8 + 1e-6 and about["half_light"] <= 0.6 + 1e-6 and about["kind"] in ("star", "galaxy")
        more = case.brighter(7.0)
        assert more.electrons == 7.0 and more.scene.electrons.sum() == pytest.approx(7.0, rel=1e-5)
        assert sum(more.row[f"flux{k}"][0] for k in range(4)) * 150 == pytest.approx(7.0, rel=1e-5)
    galaxies = [case.about() for case in made[12:]]
    assert any(one["bulge"] == 1.0 for one in galaxies) and len({one["half_light"] for one in galaxies}) > 5
    again = cases.make_cases(setting, 24, seed=5, largest=0.6)
    assert [c.electrons for c in again[3:12]] != [c.electrons for c in made[3:12]]


def galaxy(x=50.3, y=80.8, matrix=((12.0, 3.0), (-2.0, 9.0)), light=(0.7, 0.3), sizes=(0.5, 0.2), index=(1.0, 4.0)):
    """A Scene of one galaxy of two components."""
    sersic = [[[n, sersic_b(n), size] for n, size in zip(index, sizes, strict=True)]]
    return SimpleNamespace(
        x=np.array([x]),
        y=np.array([y]),
        component_fractions=np.array([light]),
        sersic=np.array(sersic),
        matrix=np.array([matrix]),
        spots=None,
        spot=None,
        fraction_of_parent=None,
    )


def by_galsim(scene):
    """The same profile by GalSim."""
    parts = [
        galsim.Sersic(n, half_light_radius=size, flux=light)
        for light, (n, _, size) in zip(scene.component_fractions[0], scene.sersic[0], strict=True) if light > 0
    ]  # fmt: skip
    return galsim.Sum(parts).transform(*scene.matrix[0].ravel()) / abs(np.linalg.det(scene.matrix[0]))


@pytest.mark.parametrize("scene", [galaxy(), galaxy(light=(0.0, 1.0))])
def test_the_transform_of_a_galaxy_is_galsims(scene):
    """Of a map that neither is symmetric nor keeps areas; k is in cycles a pixel."""
    kx, ky = np.array([0.0, 0.02, 0.05]), np.array([-0.03, 0.0, 0.01, 0.07])
    profile = by_galsim(scene)
    wanted = [[profile.kValue(2 * np.pi * a, 2 * np.pi * b).real for a in kx] for b in ky]
    assert truth.profile(scene, kx, ky) == pytest.approx(np.array(wanted), abs=5e-5)


def test_the_brightness_of_a_galaxy_and_of_its_repeats_is_galsims():
    scene = galaxy()
    profile, x, y, position = by_galsim(scene), np.array([40, 55, 61]), np.array([83, 90]), cases.Position(50.3, 80.8)
    wanted = [[profile.xValue(a - position.x, b - position.y) for a in x] for b in y]
    assert truth.brightness(scene, x, y, position) == pytest.approx(np.array(wanted), rel=1e-3)
    period, total = 40, np.zeros((2, 3))
    for i in range(-2, 3):
        for j in range(-2, 3):
            if (i, j) != (0, 0):
                total += truth.brightness(scene, x, y, cases.Position(position.x + i * period, position.y + j * period))
    assert truth.repeats(scene, x, y, position, period) == pytest.approx(total)
    part = SimpleNamespace(**(vars(scene) | {"fraction_of_parent": np.array([0.25])}))
    assert truth.repeats(part, x, y, position, period) == pytest.approx(0.25 * total)


def test_peers_draw_the_same_galaxy():
    """Its light is 1, its second moments those of the map: M M^T times those of the round profile."""
    scene = galaxy(light=(1.0, 0.0), matrix=((6.0, 1.5), (-1.0, 4.0)))
    image = galaxy_of(scene).drawImage(nx=201, ny=201, scale=1.0, method="no_pixel").array
    axis = np.arange(201) - 100
    assert image.sum() == pytest.approx(1.0, abs=0.02)
    xx, yy, xy = (image * axis**2).sum(), (image * axis[:, None] ** 2).sum(), (image * axis * axis[:, None]).sum()
    round_one = 3 * (0.5 / sersic_b(1.0)) ** 2  # <x^2> of an exponential disk is 3 scale lengths squared
    wanted = scene.matrix[0] @ scene.matrix[0].T * round_one
    assert (xx, yy, xy) == pytest.approx((wanted[0, 0], wanted[1, 1], wanted[0, 1]), rel=0.03)
    assert galaxy_of(galaxy(light=(1.0, 0.0), index=(0.0, 0.0))) is None


@pytest.fixture(scope="module")
def shapes(bench_folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings, "GRID", 3)
        known = make_setting(bench_folder, "r")
        return known, make_shapes(known, 12, largest=0.4)


def test_profiles_of_any_shape_are_galsims(shapes):
    """Any index, knots in a disk with a bulge, and images: one transform of two codes, to 1e-6; of splines to 2e-3.

    Each kind is of its columns: no two of them have the same transform.
    """
    _, made = shapes
    k = np.array([-0.1, 0.0, 0.04, 0.2])  # cycles a pixel
    kinds = {}
    for case in made:
        profile = galaxy_of(case.scene)
        wanted = np.array([[profile.kValue(2 * np.pi * a, 2 * np.pi * b) for a in k[1:]] for b in k])
        found = np.asarray(truth.profile(case.scene, k[1:], k))
        assert found == pytest.approx(wanted, abs=2e-3 if case.kind == "image" else 1e-6), case.kind
        assert found[1, 0] == pytest.approx(1.0, abs=1e-4)
        kinds.setdefault(case.kind, []).append(found)
    assert {kind: len(some) for kind, some in kinds.items()} == {"free n": 4, "knots": 4, "image": 4}
    assert all(np.abs(f.imag).max() > 1e-3 for f in kinds["knots"] + kinds["image"])  # neither is even


def test_shapes_have_the_columns_of_their_kind(shapes):
    """Indices from 1 to 6.2; 5 to 40 knots of 0.3 to 0.8 of the light, a bulge of a fifth; images alone have no shape.

    Every second one of a kind is near a node.
    """
    _, made = shapes
    of = {kind: [case for case in made if case.kind == kind] for kind in ("free n", "knots", "image")}
    rows = {kind: [case.row for case in some] for kind, some in of.items()}
    index = [row["n_disk"][0] for row in rows["free n"]]
    assert min(index) >= 1 and max(index) <= 6.2 and len(set(index)) == 4
    assert all(5 <= row["knots"][0] <= 40 and 0.3 <= row["knots_frac"][0] <= 0.8 for row in rows["knots"])
    assert [case.about()["bulge"] for case in made] == pytest.approx([0.0, 0.2, 0.0] * 4)
    assert all(case.scene.spots.image(int(case.scene.spot[0])) is not None for case in of["image"])
    assert [case.about()["e"] for case in of["image"]] == [0.0] * 4
    assert min(case.about()["e"] for case in of["free n"] + of["knots"]) > 0
    for some in of.values():
        assert [case.at_node for case in some] == [True, False] * 2


@pytest.mark.parametrize("copies", [1, 3])
def test_copies_of_an_object_each_have_all_its_parts(shapes, copies):
    for case in shapes[1][:3]:
        scene, some = case.scene, copies_of(case.scene, copies)
        assert len(some) == copies * len(scene)
        if scene.parent is None:
            continue
        for k in range(copies):
            own = np.flatnonzero(some.parent == k)
            assert some.spot[own].tolist() == scene.spot.tolist() and own[0] == k
            assert np.array_equal(some.fraction_of_parent[own], scene.fraction_of_parent)
            assert np.array_equal(some.matrix[own], scene.matrix)


def test_a_spot_of_an_image_is_a_quadratic_spline():
    """Its transform, by a sum over fine cells of the spline itself, mapped to the sky."""
    matrix = np.array([[3.0, 0.5], [-1.0, 2.0]])
    u, v, flux = np.array([0.0, 1.5]), np.array([-0.5, 1.0]), np.array([0.75, 0.25])
    spots = SimpleNamespace(group=lambda number: (u, v, flux), image=lambda number: "an image")
    fine = (np.arange(-300, 300) + 0.5) / 200
    spline = np.where(np.abs(fine) < 0.5, 0.75 - fine**2, 0.5 * (1.5 - np.abs(fine)) ** 2) / 200
    kx, ky = np.array([0.0, 0.05, 0.2]), np.array([-0.1, 0.15])
    found = truth._of_spots(spots, 0, matrix, kx, ky)
    for i, b in enumerate(ky):
        for j, a in enumerate(kx):
            f, g = matrix.T @ [a, b]  # along the image's own axes
            one = (spline * np.exp(-2j * np.pi * f * fine)).sum() * (spline * np.exp(-2j * np.pi * g * fine)).sum()
            assert found[i, j] == pytest.approx(one * (flux * np.exp(-2j * np.pi * (f * u + g * v))).sum(), abs=1e-5)


def test_presets_of_images_are_those_they_are_called(shapes, monkeypatch):
    known, (case, *_) = shapes
    asked = []
    monkeypatch.setattr(
        methods.engine, "draw_objects", lambda canvas, rows, drawing: asked.append((drawing.fidelity, len(rows)))
    )
    presets = [method for method in methods.METHODS if method.preset]
    for method in presets:
        method.prepare(known, case)(2)
    assert asked == [(method.name, 2) for method in presets] and len(presets) == 3


def test_the_half_light_radius_is_of_a_circle_of_equal_area():
    assert half_light_px(galaxy()) == pytest.approx(0.5 * np.sqrt(12 * 9 + 6))
    assert half_light_px(galaxy(light=(0.0, 1.0))) == pytest.approx(0.2 * np.sqrt(114))


def test_an_image_is_evaluated_with_the_settings_scale_and_the_objects_size():
    """A Gaussian shifted by 0.1 px is 7.4 mas off; its weight is as wide as the galaxy."""
    axis = np.arange(-60, 61)
    blob = lambda x, s: np.exp(-0.5 * ((axis - x) ** 2 + axis[:, None] ** 2) / s**2)  # noqa: E731
    camera = SimpleNamespace(telescope=SimpleNamespace(pixel_scale=0.074))
    psf = SimpleNamespace(image=np.zeros((1, 1, 1, 256)), oversampling=4)
    given = SimpleNamespace(camera=camera, psf=psf, variance=10.0)
    case = SimpleNamespace(scene=galaxy(sizes=(0.5, 0.2)), electrons=1e3)
    values, _ = case_errors(given, case, blob(0.1, 4.0), blob(0.0, 3.5), np.inf)
    inside = [1 / (1 / s**2 + 1 / half_light_px(case.scene) ** 2) for s in (4.0, 3.5)]
    assert values[1] == pytest.approx(7.4, rel=1e-4) and values[5] == pytest.approx(inside[0] / inside[1] - 1, abs=1e-4)


def test_codes_of_others_draw_the_reference_star(setting):
    """At a node, to 2% of the light in each pixel of the core: at the same position, of the same flux."""
    case = cases.make_case(setting, np.random.default_rng(2), 0, 1e5)
    wanted = standard(setting, case)
    for method in (paper, fft):
        image = method(setting, case)(2) / 2
        assert image.shape == wanted.shape and image.sum() == pytest.approx(wanted.sum(), rel=0.02)
        assert np.abs(image - wanted).max() < 0.02 * wanted.max()
    image = photons(setting, case)(20) / 20  # 2e6 electrons: 0.3% of the brightest pixel
    assert image.sum() == pytest.approx(wanted.sum(), rel=0.02)
    assert np.abs(image - wanted).max() < 0.03 * wanted.max()
    assert setting.camera.digest in Path(setting.psf.path).name


class Grating:
    """What density_of knows of a Disperser."""

    wavelengths = np.array([5000.0, 6000.0])


def test_spectra_are_what_their_names_say():
    rng = np.random.default_rng(3)
    wave = np.searchsorted(GRID, [4000.0, 8000.0])
    flat, none = spectra.density_of("flat", rng, Grating)
    hot, _ = spectra.density_of("hot", rng, Grating)
    cool, _ = spectra.density_of("cool", rng, Grating)
    assert set(flat) == {1.0} and len(none) == 0 and hot[wave[0]] / hot[wave[1]] == pytest.approx(8.0)
    x = 6.62607015e-34 * 2.99792458e8 / (1.380649e-23 * 3500.0) / np.array([4e-7, 8e-7])
    assert cool[wave[0]] / cool[wave[1]] == pytest.approx(16 * np.expm1(x[1]) / np.expm1(x[0]), rel=1e-6)
    lines, centres = spectra.density_of("lines", rng, Grating)
    away = np.abs(GRID[:, None] - centres).min(axis=1) > 20
    assert len(centres) == 3 and ((centres > 5000) & (centres < 6000)).all()
    assert lines[away] == pytest.approx(0.1 / 1000)
    extra = (lines - 1e-4) * 0.5
    for centre, share in zip(centres, (3 / 6, 2 / 6, 1 / 6), strict=True):
        near = np.abs(GRID - centre) < 15
        assert extra[near].sum() == pytest.approx(0.9 * share, rel=1e-3)
        width2 = (extra * (GRID - centre) ** 2)[near].sum() / extra[near].sum()
        assert width2 == pytest.approx(4.0, rel=1e-2)


def test_means_over_bins_are_of_the_density():
    """Of a straight line: its value in the middle of each bin, however wide."""
    edges = np.array([3000.0, 3002.0, 3010.5, 3100.0])
    assert spectra.means(5 + 2 * GRID, edges) == pytest.approx(5 + (edges[1:] + edges[:-1]))


def test_the_window_of_a_trace_is_about_its_first_order():
    boxes = np.array([[[0.0, 1.0, 2.0, 3.0], [100.4, 300.6, 40.2, 47.0]]])
    disperser = SimpleNamespace(boxes=lambda visits, x, y: boxes, orders=[0, 1])
    window = spectra.trace_window(disperser, None, SimpleNamespace(x=0, y=0), 20)
    assert (window.x0, window.x1, window.y0, window.y1) == (80, 322, 24, 65)


def test_flux_is_spread_along_the_trace_in_fractions_of_area():
    """A stamp of one pixel, shifted by (0.25, 0.5) and (-1.25, 2): four fractions, and two."""
    image, stamp = np.zeros((8, 9)), np.zeros((3, 3))
    stamp[1, 1] = 1.0
    bins = peers.Trace(np.array([0.25, -1.25]), np.array([0.5, 2.0]), np.array([8.0, 4.0]))
    peers._disperse(image, stamp, 2, 1, bins)
    wanted = np.zeros_like(image)
    wanted[2, 3], wanted[2, 4], wanted[3, 3], wanted[3, 4] = 3.0, 1.0, 3.0, 1.0
    wanted[4, 1], wanted[4, 2] = 1.0, 3.0
    assert image == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize(("x0", "y0"), [(2, 1), (-1, -2), (5, 3), (7, 0), (0, -3), (-3, 2), (0, 6)])
def test_a_stamp_is_added_where_it_is_on_the_image(x0, y0):
    image, stamp = np.zeros((6, 7)), 1.0 + np.arange(6).reshape(2, 3)
    peers.add(image, stamp, x0, y0)
    wanted = np.zeros((20, 20))
    wanted[y0 + 6 : y0 + 8, x0 + 6 : x0 + 9] = stamp
    assert np.array_equal(image, wanted[6:12, 6:13])


def test_cubics_go_through_four_nodes():
    """Exact for a cubic, at the ends and beyond the middle; a node has its own value."""
    nodes, places = np.linspace(4000, 7500, 8), np.array([4000.0, 4100.0, 5333.0, 6000.0, 7400.0, 7500.0])
    cubic = lambda v: 1 + 2 * (v / 5000) - 3 * (v / 5000) ** 2 + 0.7 * (v / 5000) ** 3  # noqa: E731
    weights = spectrum_truth._cubic(nodes, places)
    assert cubic(nodes) @ weights == pytest.approx(cubic(places), abs=1e-12)
    assert weights[:, 3] == pytest.approx(1.0 * (nodes == 6000.0), abs=1e-12) and (weights[:, 2] != 0).sum() == 4
    assert np.flatnonzero(weights[:, 2]).tolist() == [1, 2, 3, 4]


def test_light_far_from_its_wavelength_is_that_of_the_profile():
    """Of a large disk, with a PSF of one point: in the columns of the transform and beyond them, along the trace."""
    scene, period = galaxy(light=(1.0, 0.0), sizes=(1.5, 0.2)), 144
    k = spectrum_truth._Frequencies(np.arange(181) / period, np.arange(-180, 181) / period, period)
    part = spectrum_truth._Part(np.array([60.0, 63.0]), np.array([15.0, 15.5]), np.array([[2.0, 1.0]]))
    image, x, y = np.zeros((31, 200)), np.arange(200), np.arange(31)
    spectrum_truth._add(image, [truth.profile(scene, k.kx, k.ky) + 0j], part, scene, k)
    wanted = sum(
        light * truth.brightness(scene, x, y, cases.Position(at_x, at_y))
        for at_x, at_y, light in zip(part.x, part.y, part.weights[0], strict=True)
    )
    away = np.abs(x - 61.5) > 8  # the middle of a disk is a cusp, which no transform has
    assert image[:, away] == pytest.approx(wanted[:, away], rel=0.05)


def test_the_transform_of_cells_is_the_sum_over_them():
    """Of a lattice of 8 cells a pixel about its middle: at a few frequencies, by the sum itself."""
    cells, period, highest = np.random.default_rng(1).random((17, 17)), 5, 6
    found = spectrum_truth._transform(cells, period, highest)
    position = (np.arange(17) - 8) / 8
    for i, j in ((-6, 0), (3, 2), (0, 6), (5, 5)):
        wave = np.exp(-2j * np.pi * (i * position[:, None] + j * position) / period)
        assert found[i + highest, j] == pytest.approx((cells * wave).sum() / 64, abs=1e-5)


def test_the_readouts_table_has_the_cost_of_all_that_follows_the_light(monkeypatch, tmp_path):
    """The sum is of the readout and the file; PRNU has no row; peers stand in their layer's row."""
    took = {"sky_background": 4.0, "prnu_effect": 1.5, "bias": 2.0, layers.WRITE: 3.0}
    steps = [SimpleNamespace(name=n, module=SimpleNamespace(STAGE="render" if "_" in n else "readout")) for n in took]
    monkeypatch.setattr(layers, "_steps", lambda: steps)
    monkeypatch.setattr(layers, "_state", lambda camera, sky, window: sky)
    monkeypatch.setattr(layers, "_seconds", lambda state, *_: dict(took))
    monkeypatch.setattr(layers, "_peer_costs", lambda sky, camera: {"bias": {"numpy": sky}})
    [one, two] = layers.layer_costs(tmp_path / "out", (40.0, 4.0))
    wanted = {"sky_background": 4.0, "bias": 2.0, layers.WRITE: 3.0, layers.TOTAL: 5.0}
    assert one == (40.0, wanted, {"bias": {"numpy": 40.0}}) and two[0] == 4.0
    said = []
    monkeypatch.setattr(layers, "speed_accuracy", lambda file, log, mcti: said.append((file, mcti)))
    layers.readout(tmp_path, said.append, (40.0,))
    assert f"| bias | 2.00 | {2e9 / (9216 * 9232):.1f} | numpy 40.0 |" in said
    assert (tmp_path / "cti_speed_accuracy.png", None) in said


def test_no_shape_is_larger_than_asked(bench_folder, monkeypatch):
    monkeypatch.setattr(settings, "GRID", 3)
    made = make_shapes(make_setting(bench_folder, "r"), 24, largest=0.12)
    sizes = [case.row["size_disk"][0] for case in made if case.kind != "image"]
    assert len(sizes) == 16 and min(sizes) >= cases.SIZE[0] and 0.1 < max(sizes) <= 0.12
    assert {case.kind for case in made} == set(KINDS)
    again, other = (make_shapes(make_setting(bench_folder, "r"), 6, seed, largest=0.12) for seed in (1, 2))
    assert [case.electrons for case in again] == [case.electrons for case in made[:6]]
    assert not {case.electrons for case in other} & {case.electrons for case in made}
    assert [case.about()["kind"] for case in made] == [case.kind for case in made]


def test_a_preset_keeps_its_mixer_from_object_to_object():
    known = SimpleNamespace(wcs=None, mixer=SimpleNamespace(psf="psf"), exptime=1.0, variance=2.0, table="table")
    drawing = drawing_of(known, SimpleNamespace(id=4), "standard")
    assert drawing.cached_mixer is known.mixer and drawing.observer is None and drawing.key == 5
