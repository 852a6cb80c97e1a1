"""The predicted error: properties of any such bound, whatever its coefficients."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.render.error_model import half_light_px2, noise, psf_error, stamp_error
from csstsim.render.imaging import register
from csstsim.render.imaging.methods import photons, stamps
from csstsim.render.method import Targets, names_of
from csstsim.render.policy import choose, choose_dispersed
from csstsim.render.scene import Scene
from csstsim.render.settings import FILE, load_numbers
from csstsim.render.slitless import register as slitless

NUMBERS = load_numbers().error
PHOTONS, STAMP = photons.PHOTONS.code, stamps.STAMPS.code
PER_ARCSEC = 1 / 0.074  # px


def scene(index, radius, bulge=0.0):
    """n galaxies of a Sersic index and half-light radius [arcsec] and a fraction of n = 4; index 0: points."""
    index, radius = np.broadcast_arrays(np.atleast_1d(np.asarray(index, float)), np.asarray(radius, float))
    n = len(index)
    sersic = np.zeros((n, 2, 3))
    there = index > 0
    sersic[there, 0] = np.stack([index, sersic_b(np.maximum(index, 0.3)), radius], axis=1)[there]
    sersic[there, 1] = np.stack([np.full(n, 4.0), np.full(n, sersic_b(4.0)), radius], axis=1)[there]
    none, light = np.zeros(n), np.stack([np.full(n, 1 - bulge), np.full(n, bulge)], axis=1)
    matrix = np.broadcast_to(np.eye(2) * PER_ARCSEC, (n, 2, 2))
    return Scene(
        np.arange(n),
        none,
        none,
        np.ones((n, 4)),
        light,
        sersic,
        matrix,
        np.zeros((n, 1), int),
        np.ones((n, 1)),
        none > 0,
    )


def bound(method, objects, snr, reach=32, cells=4):
    n = len(objects)
    snr = np.broadcast_to(np.asarray(snr, float), n)
    if method == "photons":
        return psf_error(snr, NUMBERS, cells)
    return stamp_error(objects, np.full(n, reach), snr, NUMBERS, cells)


@pytest.mark.parametrize("method", ["photons", "stamp"])
@pytest.mark.parametrize("index", [0.0, 0.3, 1.0, 4.0, 6.2])
def test_rises_with_flux_from_nothing(method, index):
    snr = np.r_[0.0, np.geomspace(1e-3, 1e5, 50)]
    values = bound(method, scene(np.full(51, index), 0.3), snr)
    assert values[0] == 0
    assert (np.diff(values) > 0).all()


# Visible errors of stamps of bright galaxies against the reference renderer: `benchmarks/error_model.py --bright`
BRIGHT = [  # n, half-light radius [arcsec], S/N, smallest and largest of round and elongated
    (1.0, 0.1, 5477, 5.61, 6.50), (1.0, 0.1, 14142, 29.5, 31.8), (1.0, 0.3, 5476, 7.76, 7.80),
    (1.0, 0.3, 14142, 31.9, 32.0), (1.0, 0.6, 5474, 7.33, 10.9), (1.0, 0.6, 14141, 26.3, 34.7),
    (1.0, 1.0, 5468, 7.84, 11.6), (1.0, 1.0, 14139, 27.5, 38.5), (4.0, 0.1, 5477, 12.0, 14.5),
    (4.0, 0.1, 14142, 36.0, 45.4), (4.0, 0.3, 5476, 21.2, 31.2), (4.0, 0.3, 14142, 62.2, 85.3),
    (4.0, 0.6, 5474, 30.0, 32.7), (4.0, 0.6, 14141, 81.4, 88.8), (4.0, 1.0, 5468, 28.5, 30.8),
    (4.0, 1.0, 14139, 77.3, 83.3),
]  # fmt: skip


@pytest.mark.parametrize(("index", "radius", "snr", "smallest", "largest"), BRIGHT)
def test_bright_galaxies_bound_is_what_is_seen_within_a_factor_of_three(index, radius, snr, smallest, largest):
    value = bound("stamp", scene([index], radius), float(snr), reach=100)[0]
    assert largest < value < 3.0 * smallest


@pytest.mark.parametrize(("cells", "largest"), [(4, 2e4), (2, 7e3)])
@pytest.mark.parametrize("index", [1.0, 4.0])
def test_the_far_parts_end_decides_no_method(cells, largest, index):
    """Without it each galaxy finds stamps good or not as with it: choices, and pixels, stay."""
    snr, radius = (v.ravel() for v in np.meshgrid(np.geomspace(0.1, largest, 400), np.geomspace(0.01, 3.0, 60)))
    objects, reach = scene(np.full(snr.size, index), radius), np.full(snr.size, 64)
    smallest = psf_error(snr, NUMBERS, cells)
    good = [
        stamp_error(objects, reach, snr, numbers, cells) <= np.maximum(0.1, 3.0 * smallest)
        for numbers in (NUMBERS, NUMBERS.model_copy(update={"far": np.inf}))
    ]
    assert np.array_equal(*good) and (good[0].any() and (cells == 2 or not good[0].all()))


@pytest.mark.parametrize("method", ["photons", "stamp"])
def test_a_vanishing_galaxy_is_a_point_in_a_stamp_of_any_size(method):
    star = bound(method, scene([0.0], 0.0), 50.0, reach=10**9)
    assert bound(method, scene([1.0], 1e-9), 50.0) == pytest.approx(star, rel=1e-6)


def test_steeper_profiles_are_no_better():
    values = bound("stamp", scene([0.3, 1.0, 2.0, 3.0, 4.0, 5.0, 6.2], 1.0), 100.0)
    assert values[0] == values[1]
    assert (np.diff(values[1:]) > 0).all()


def test_components_count_by_their_light():
    disk, bulge, both = (bound("stamp", scene([1.0], 0.5, fraction), 80.0)[0] for fraction in (0.0, 1.0, 0.25))
    assert both == pytest.approx(0.75 * disk + 0.25 * bulge, rel=1e-12)


def test_smaller_stamps_of_points_are_worse_and_photons_have_none():
    points = scene([0.0], 0.0)
    assert bound("stamp", points, 10.0, reach=16) > bound("stamp", points, 10.0, reach=32)
    assert bound("photons", points, 10.0, reach=16) == bound("photons", points, 10.0, reach=32)


@pytest.mark.parametrize("method", ["photons", "stamp"])
def test_coarser_cells_are_worse(method):
    assert bound(method, scene([0.0], 0.0), 10.0, cells=2) > bound(method, scene([0.0], 0.0), 10.0, cells=4)


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.2])
def test_sizes_are_in_pixels_of_the_area(radius):
    """A lens that doubles lengths makes of a galaxy one twice as large, stretched or not: the same bound."""
    small, large = scene([1.0, 4.0], radius), scene([1.0, 4.0], 2 * radius)
    doubled = replace(small, matrix=2 * small.matrix)
    stretched = replace(small, matrix=small.matrix @ np.diag([8.0, 0.5]))
    wanted = bound("stamp", large, 50.0)
    assert (wanted != bound("stamp", small, 50.0)).all()
    assert bound("stamp", doubled, 50.0) == pytest.approx(wanted, rel=1e-12)
    assert bound("stamp", stretched, 50.0) == pytest.approx(wanted, rel=1e-12)


def test_the_bound_is_what_the_module_says():
    """Numbers of config/render.yaml by hand, for a star, a disk of 2 px and a bulge of 8 px in stamps of 40 px."""
    psf, cut, disk, bulge = 3.7e-4, 1.3e-2, 6.0e-4, 1.5e-3
    star, small, large = scene([0.0], 0.0), scene([1.0], 2 / PER_ARCSEC), scene([4.0], 8 / PER_ARCSEC)
    assert bound("stamp", star, 100.0, reach=40)[0] == pytest.approx(100 * (psf + cut / 40))
    assert bound("photons", star, 100.0, reach=40)[0] == pytest.approx(100 * psf)
    assert bound("photons", star, 100.0, cells=2)[0] == pytest.approx(100 * 6.5e-3)
    assert bound("stamp", star, 100.0, reach=0)[0] == pytest.approx(100 * (psf + cut))
    assert bound("stamp", small, 300.0, reach=40)[0] == pytest.approx(300 * (psf + disk * 0.5 * 2.0))
    assert bound("stamp", large, 300.0, reach=40)[0] == pytest.approx(300 * (psf + bulge * 2.0))
    assert bound("stamp", large, 1e6, reach=40)[0] == pytest.approx(1e6 * (psf + bulge * 4.5))
    between = scene([2.5], 8 / PER_ARCSEC)  # half of each
    assert bound("stamp", between, 300.0)[0] == pytest.approx(300 * (psf + 2.0 * (disk + bulge) / 2))


def test_the_cost_of_a_method_is_the_sum_of_its_parts(monkeypatch):
    """Costs that are powers of ten: a star, a galaxy, and a galaxy of spots, with stamps of 7, 9 and 11 px."""
    cost = SimpleNamespace(
        photon_object=1e1, photon_star=1e2, photon_galaxy=1e3, stamp_star=1e4, stamp_galaxy=1e5, stamp_pixel=1e-1,
        stamp_spots=1e6, wing_pixel=1e-6,
    )  # fmt: skip
    for module in (photons, stamps):
        monkeypatch.setattr(module, "load_cost", lambda _: cost)
    objects = scene([0.0, 1.0, 1.0], 0.3).sized(np.array([3, 4, 5]), np.array([0.0, 10.0, 500.0]))
    objects = replace(objects, electrons=np.array([2.0, 3.0, 5.0])[:, None] * [0.1, 0.2, 0.3, 0.4])
    shot, stamp = (method.cost(Targets(objects, None)) for method in (photons.PHOTONS, stamps.STAMPS))
    wing = 1e-6 * np.pi * np.array([0.0, 100.0, 192.0**2])
    assert shot == pytest.approx([10 + 200, 10 + 3000, 10 + 5000])
    assert photons.PHOTONS.cost(Targets(objects, None, 2.0)) == pytest.approx([10 + 400, 10 + 6000, 10 + 10000])
    assert stamp == pytest.approx(np.array([1e4, 1e5 + 8.1, 1e5 + 12.1]) + wing, rel=1e-12)
    spotted = replace(objects, spots=object(), spot=np.array([-1, -1, 0]))
    assert stamps.STAMPS.cost(Targets(spotted, None)) - stamp == pytest.approx([0, 0, 1e6])


def test_noise_is_of_the_light_and_of_the_pixels_under_the_object():
    """A star and a galaxy of two components, stretched; along a trace the pixels are its length by the width."""
    size = np.array([0.0, 0.3])
    objects = replace(scene([0.0, 1.0], size, bulge=0.25), matrix=np.stack([np.diag([20.0, 5.0])] * 2))
    objects.sersic[1, 1, 2] = 0.5
    square = np.array([0.0, (0.75 * 0.09 + 0.25 * 0.25) * 100.0])
    assert half_light_px2(objects) == pytest.approx(square)
    pixels = 4 * np.pi / (2 * np.log(2)) * (1.44 + square)
    electrons = np.array([400.0, 900.0])
    assert noise(objects, electrons, 60.0) == pytest.approx(np.sqrt(electrons + 60 * pixels))
    dispersed = noise(objects, electrons, 60.0, length=200.0)
    assert dispersed == pytest.approx(np.sqrt(electrons + 60 * (pixels + 200 * np.sqrt(pixels))))


def drawing_of(fidelity="standard", ghosts=None, convex=True, variance=60.0):
    psf = SimpleNamespace(convex=convex, oversampling=4)
    return SimpleNamespace(fidelity=fidelity, variance=variance, psf=psf, ghosts=ghosts)


def lit(objects, electrons, reach=30):
    light = np.broadcast_to(np.asarray(electrons, float), len(objects))
    return replace(objects, electrons=light[:, None] * [0.1, 0.2, 0.3, 0.4]).sized(reach)


def chosen(objects, drawing, maximum=1.0):
    """Return the Choice of an imaging chip's objects and the names of the methods."""
    choice = choose(Targets(objects, drawing, maximum), register.METHODS)
    return choice, names_of(choice.method, register.METHODS).tolist()


def test_what_is_faint_and_small_is_spread_and_what_is_faint_and_large_is_not():
    """S/N below 1 in a preview: a star, a galaxy of 31 and one of 33 px half-light radius; no light, no method."""
    objects = lit(
        scene([0.0, 1.0, 1.0, 0.0, 0.0], np.array([0, 31, 33, 0, 0]) / PER_ARCSEC), [5.0, 5.0, 5.0, 0.0, 300.0]
    )
    choice, named = chosen(objects, drawing_of("preview"))
    assert named == ["unresolved", "unresolved", "photons", "none", "photons"]
    electrons = objects.electrons.sum(axis=1)
    assert choice.snr == pytest.approx(electrons / noise(objects, electrons, 60.0))
    assert choice.error[:2] == pytest.approx(choice.snr[:2]) and choice.error[2] < 1e-2 * choice.snr[2]
    assert "unresolved" not in chosen(objects, drawing_of())[1]


def test_what_may_not_be_photons():
    """Stars with ghosts, of a PSF with negative weights, without noise; of others the cheaper."""
    ghosts = SimpleNamespace(visible=lambda electrons: electrons > 500)
    objects = lit(scene([0.0] * 3, 0.0), [400.0, 600.0, 2e4])
    assert chosen(objects, drawing_of())[1] == ["photons"] * 3
    assert chosen(objects, drawing_of(ghosts=ghosts))[1] == ["photons", "stamp", "stamp"]
    for drawing in (drawing_of(convex=False), drawing_of("noise_free")):
        assert chosen(objects, drawing)[1] == ["stamp"] * 3
    # 17 ns an electron against 550,000 of a stamp: the methods change at 32,176 electrons, times the response
    even = lit(scene([0.0] * 2, 0.0), [31_000.0, 33_000.0])
    assert chosen(even, drawing_of())[1] == ["photons", "stamp"]
    assert chosen(even, drawing_of(), 1.05)[1] == ["stamp", "stamp"]


def test_numbers_of_the_renderer_that_cannot_be(tmp_path):
    text = FILE.read_text(encoding="utf-8")
    numbers = load_numbers()
    assert {name: (p.eps, p.floor) for name, p in numbers.presets.items()} == {
        "preview": (1.0, 1.0), "standard": (0.1, 0.0), "noise_free": (0.1, 0.0),
    }  # fmt: skip
    assert numbers.error.slabs[2] == 8.5e-3 and numbers.error.slabs_flat[8] == 3.7e-6
    wrong = {
        "photon_star: 17.0": "photon_star: -17.0", "size: 4.0": "size: 0.0", ", 8: 3.9e-5": "", "eps: 1.0": "eps: -1.0",
        "disk: 6.0e-4": "disc: 6.0e-4", "bins: 0.26": "bins: 0",
    }  # fmt: skip
    for old, new in wrong.items():
        assert text.count(old) == 1, old
        (tmp_path / "render.yaml").write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(InputError, match=r"render\.yaml"):
            load_numbers(tmp_path / "render.yaml")


def test_spectra_are_photons_where_faint_and_slabs_where_bright(disperser):
    """S/N over the pixels of a trace; the error of slabs; bins of a pixel up to S/N 0.1 / 0.26; the costs' order."""
    electrons = np.array([0.0, 2.0, 60.0, 3e4, 1e8, 2e8])
    objects, drawing = lit(scene(np.zeros(6), 0.0), electrons), drawing_of()

    def dispersed(objects, drawing, maximum=1.0):
        return choose_dispersed(Targets(objects, drawing, maximum, disperser), slitless.METHODS)

    choice = dispersed(objects, drawing)
    named = names_of(choice.method, slitless.METHODS).tolist()
    assert named == ["none", "photons", "photons", "photons", "slabs", "slabs"]
    assert choice.method.tolist() == [0, 2, 2, 2, 3, 3]
    snr = electrons / noise(objects, electrons, 60.0, length=disperser.length)
    assert choice.snr == pytest.approx(snr) and disperser.length > 50
    assert choice.allowed == pytest.approx(np.maximum(0.1 / np.maximum(choice.snr, 1e-9), 7.4e-4))
    assert choice.coarse.tolist() == [False, *(choice.snr[1:4] <= 0.1 / 0.26), False, False]
    assert choice.coarse[1] and not choice.coarse[3]
    still = dispersed(objects, drawing_of("noise_free"))
    assert (still.method[1:] == STAMP).all() and not still.coarse.any()
    # An electron counted costs 41 ns in all orders, a spectrum of slabs 10 ms and its pixels: losses shift the balance
    even = lit(scene(np.zeros(400), 0.0), np.geomspace(1e3, 1e8, 400))
    first = [(dispersed(even, drawing, m).method == STAMP).argmax() for m in (1.0, 2.0)]
    assert np.geomspace(1e3, 1e8, 400)[first[0]] / np.geomspace(1e3, 1e8, 400)[first[1]] == pytest.approx(2.0, rel=0.05)
