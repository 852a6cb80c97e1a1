"""The policy's choices and their results: methods, planes, truth, noise."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.canvases import blank
from test_reference import EXPTIME, objects

from csstsim.catalog.flags import BAD_VALUE, OFF_CHIP, SKIPPED_FAINT, TRUNCATED_STAMP
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered
from csstsim.render.drawing import Drawing
from csstsim.render.error_model import noise
from csstsim.render.imaging import reference
from csstsim.render.imaging.draw import draw_objects, object_keys_of
from csstsim.render.imaging.methods.photons import PHOTONS
from csstsim.render.imaging.methods.stamps import STAMPS
from csstsim.render.imaging.register import METHODS
from csstsim.render.method import Targets
from csstsim.render.policy import choose
from csstsim.render.scene import Scene

VARIANCE = 60.0  # e-^2
LIGHT = 1e-4  # of an object's light
WINDOW = Window(4000, 4200, 4000, 4180)


def scene_of(x, y, electrons):
    """Points of given light."""
    n = len(x)
    return Scene(
        np.arange(n), np.asarray(x, float), np.asarray(y, float),
        np.repeat(np.asarray(electrons, float)[:, None] / 4, 4, 1),
        np.tile([1.0, 0.0], (n, 1)), np.zeros((n, 2, 3)), np.tile(np.eye(2), (n, 1, 1)), np.zeros((n, 1), int),
        np.ones((n, 1)), np.zeros(n, bool),
    )  # fmt: skip


@pytest.fixture(scope="module")
def draw(camera, make_pointing, psf_r, psf_tables):
    wcs = ChipWCS(camera.chips[9], make_pointing())

    def made(x, y, fidelity="standard", key=1, window=WINDOW, response=None, maximum=1.0, scattered=None, **columns):
        table = objects(wcs, x, y, **columns)
        canvas = blank(window, response=response, maximum=maximum)
        how = scattered or Scattered(), fidelity, VARIANCE, np.uint64(key), psf_tables
        drawn = draw_objects(canvas, table, Drawing(wcs, psf_r, EXPTIME, *how))
        return canvas.expected, canvas.counted, drawn

    def expected(x, y, window=WINDOW, **columns):
        canvas = blank(window)
        drawn = reference.draw_objects(canvas, objects(wcs, x, y, **columns), Drawing(wcs, psf_r, EXPTIME))
        return canvas.expected, drawn

    made.reference = expected
    return made


def rate(electrons):
    """Electron / s of an object of so many electrons."""
    return electrons / EXPTIME


def test_faint_objects_are_photons_and_bright_ones_stamps(draw):
    image, counted, drawn = draw([4050.2, 4120.6], [4060.0, 4100.3], flux0=rate(np.array([1e3, 1e7])))
    assert list(drawn["method"]) == ["photons", "stamp"]
    assert counted.sum() == drawn["drawn"][0] and image.sum(dtype=float) == pytest.approx(drawn["drawn"][1], rel=1e-6)
    assert (drawn["ms"] > 0).all() and (drawn["error"] > 0).all() and drawn["stamp"][1] == 129


def test_a_noise_free_image_has_nothing_counted_and_is_the_reference(draw):
    """Within a thousandth of the peak of a star and a galaxy; the accuracy itself is measured by csstsim bench."""
    x, y, kinds = [4050.2, 4120.6], [4060.0, 4100.3], {"obj_type": np.array([0, GALAXY]), "size_disk": np.full(2, 0.3)}
    image, counted, drawn = draw(x, y, "noise_free", **kinds)
    wanted, truth = draw.reference(x, y, **kinds)
    assert counted is None and set(drawn["method"]) == {"stamp"}
    assert np.abs(image - wanted).max() < 1e-3 * wanted.max()
    assert drawn["drawn"] == pytest.approx(truth["drawn"], rel=1e-3)


def test_preview_spreads_what_nobody_would_see(draw, psf_r):
    dark = {f"flux{i}": np.zeros(2) for i in (1, 2, 3)}
    dark |= {"flux0": rate(np.array([5.0, 1e4])), "window": Window(3900, 4300, 3900, 4300)}
    image, _, drawn = draw([4100.0, 4120.0], [4090.0, 4100.0], "preview", **dark)
    assert list(drawn["method"]) == ["unresolved", "photons"]
    (nodes,), (weight,), _ = psf_r.weights([4100.0], [4090.0])
    box = weight @ psf_r.flux[nodes, 0]  # no wing was asked for
    assert drawn["flags"][0] == SKIPPED_FAINT and image.sum(dtype=float) == pytest.approx(5.0 * box, rel=1e-6)


@pytest.mark.parametrize("fidelity", ["preview", "standard", "noise_free"])
def test_nothing_to_draw(draw, fidelity):
    image, counted, drawn = draw([], [], fidelity)
    assert not image.any() and counted is None and len(drawn) == 0
    image, counted, drawn = draw(
        [4100.0] * 3, [4100.0] * 3, fidelity, flags=np.array([BAD_VALUE, 0, 0], np.int32), flux0=np.array([1.0, 0, 0]),
        flux1=np.zeros(3), flux2=np.zeros(3), flux3=np.zeros(3),
    )  # fmt: skip
    assert not image.any() and counted is None and set(drawn["method"]) == {"none"} and not drawn["drawn"].any()


def test_off_the_window_is_said(draw):
    _, _, drawn = draw([2000.0, 4100.0], [4100.0, 4100.0])
    assert drawn["flags"][0] & OFF_CHIP and not drawn["flags"][1] & OFF_CHIP


def test_a_wing_that_is_switched_off_is_flagged(draw):
    columns = {"rate": 1e7, "wing": np.full(1, 300.0)}
    _, _, drawn = draw([4100.0], [4100.0], **columns)
    assert drawn["flags"][0] & TRUNCATED_STAMP


def test_wings_are_in_the_expected_plane(draw, psf_r):
    columns = {"rate": 1e7, "wing": np.full(1, 150.0)}
    image, _, drawn = draw([4100.0], [4090.0], scattered=Scattered(read_scattered(psf_r).wing), **columns)
    assert image[90, 195] > 0 and drawn["flags"][0] == 0 and drawn["stamp"][0] == 301


@pytest.mark.thorough
def test_mean_is_variance_for_all_methods_together(draw):
    """400 exposures of star, galaxy and bright star, expected light made Poisson once: mean = variance to 5 sigma."""
    from csstsim.detector.noise import add_poisson

    window = Window(4080, 4120, 4080, 4120)
    columns = {"obj_type": np.array([0, GALAXY, 0]), "size_disk": np.full(3, 0.2)}
    columns |= {f"flux{i}": rate(np.array([2e3, 4e3, 1e6]) / 4) for i in range(4)}
    planes = []
    for k in range(400):
        image, counted, drawn = draw(
            [4090.3, 4110.0, 4100.0], [4090.0, 4108.5, 4100.0], key=k, window=window, **columns
        )
        add_poisson(image, np.uint64(k), dark=20.0, counted=counted)
        planes.append(image)
    assert set(drawn["method"]) == {"photons", "stamp"}
    mean, variance = np.mean(planes, axis=0), np.var(planes, axis=0, ddof=1)
    ratio = variance / mean
    error = np.sqrt(2 / 399 / ratio.size)
    assert ratio.mean() == pytest.approx(1.0, abs=5 * error)
    assert np.abs(ratio - 1).max() < 6 * np.sqrt(2 / 399)


def test_losses_thin_photons_and_scale_stamps(draw):
    """Half the light on the left, all on the right: counts to 5 sigma of Poisson, stamps to rounding."""
    response = np.ones(WINDOW.shape, np.float32)
    response[:, :100] = 0.5
    x, y = np.array([4050.0, 4150.0]), np.array([4090.0, 4090.0])
    columns = {f"flux{i}": rate(np.full(2, 3e3)) for i in range(4)}
    _, counted, drawn = draw(x, y, response=response, maximum=1.25, **columns)
    whole = draw.reference(x, y, **columns)[1]["drawn"]
    wanted = whole * [0.5, 1.0]
    assert (np.abs(drawn["drawn"] - wanted) < 5 * np.sqrt(wanted)).all() and counted.sum() == drawn["drawn"].sum()
    _, _, stamped = draw(x, y, "noise_free", response=response, maximum=1.25, **columns)
    assert stamped["drawn"] == pytest.approx(wanted, rel=2e-3)


def test_an_object_is_drawn_alike_whatever_else_there_is(draw):
    x, y = np.linspace(4020, 4180, 7), np.linspace(4030, 4150, 7)
    together = draw(x, y, rate=5.0)[1]
    one_by_one = sum(draw(x[i : i + 1], y[i : i + 1], rate=5.0, id=np.array([i]))[1] for i in reversed(range(7)))
    assert np.array_equal(together, one_by_one)


def test_twins_of_one_id_are_not_drawn_alike():
    keys = object_keys_of(np.uint64(7), np.array([5, 5, 6, 5, 6]))
    assert len(set(keys.tolist())) == 5 and keys[0] == object_keys_of(np.uint64(7), np.array([5]))[0]


def test_the_choice_is_by_cost_within_the_allowed_error():
    scene = scene_of(np.zeros(40), np.zeros(40), np.geomspace(1, 1e10, 40))
    scene, fidelity = scene.sized(32), {}
    convex, other = (SimpleNamespace(convex=flag, oversampling=4) for flag in (True, False))
    for name in ("standard", "noise_free"):
        drawing = Drawing(None, convex, EXPTIME, None, name, VARIANCE)
        fidelity[name] = choose(Targets(scene, drawing), METHODS)
    method = fidelity["standard"].method
    assert method[0] == PHOTONS.code and method[-1] == STAMPS.code and (np.diff(method) >= 0).all()
    assert (fidelity["noise_free"].method == STAMPS.code).all()
    stamps = choose(Targets(scene, Drawing(None, other, EXPTIME, None, "standard", VARIANCE)), METHODS)
    assert (stamps.method == STAMPS.code).all()  # a mixture with negative weights cannot be drawn from


def test_noise_of_a_star_and_of_a_blank_object():
    """A star's own noise is that of its light and of the pixels under a PSF of 1.2 px half-light radius."""
    scene = scene_of([0.0, 0.0], [0.0, 0.0], [0.0, 1e6])
    pixels = 4 * np.pi * 1.2**2 / (2 * np.log(2))
    assert noise(scene, np.array([0.0, 1e6]), VARIANCE) == pytest.approx(
        np.sqrt([pixels * VARIANCE, 1e6 + pixels * VARIANCE])
    )


def test_the_table_keeps_its_columns(draw):
    _, _, drawn = draw([4100.0], [4100.0])
    _, truth = draw.reference([4100.0], [4100.0])
    assert isinstance(drawn, ObjectTable) and set(truth.names) == set(drawn.names)
    for name in truth.names:
        assert truth[name].dtype.kind == drawn[name].dtype.kind, name


@pytest.mark.parametrize("columns", [{}, {"obj_type": GALAXY, "size_disk": 0.4}], ids=["stars", "galaxies"])
def test_faint_objects_shine_beyond_the_box_whatever_draws_them(draw, camera, make_pointing, psf_r, columns):
    """2e5 electrons on 1401 pixels a side: all but what is beyond the window, by each renderer; photons to 5 sigma."""
    window, scattered = Window(3400, 4801, 3400, 4801), Scattered(read_scattered(psf_r).wing)
    columns, position = columns | {"rate": rate(2e5), "reach": 60}, ([4100.3], [4100.1])
    angle = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    edge = 700.5 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))  # the square's, from its middle
    whole = 1 - scattered.wing.light_beyond(edge).mean()
    image, _, stamp = draw(*position, "noise_free", window=window, scattered=scattered, **columns)
    assert image.sum(dtype=float) == pytest.approx(stamp["drawn"][0], rel=1e-4)
    assert stamp["fraction"][0] == pytest.approx(whole, abs=LIGHT)
    wcs = ChipWCS(camera.chips[9], make_pointing())
    drawing = Drawing(wcs, psf_r, EXPTIME, scattered)
    truth = reference.draw_objects(blank(window), objects(wcs, *position, **columns), drawing)
    assert truth["fraction"][0] == pytest.approx(whole, abs=LIGHT)
    _, _, photons = draw(*position, "standard", window=window, scattered=scattered, **columns)
    assert photons["fraction"][0] == pytest.approx(whole, abs=5 / np.sqrt(2e5))
