"""The fitted field distortion against the optics it was fitted to, scipy's splines, finite differences and astropy."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.wcs import WCS
from build_distortion import build, fit, fit_spline, write_distortion
from scipy.interpolate import NdBSpline
from support.csst import MARGIN

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.job_lists import EDGE_PX
from csstsim.catalog.selection.bricks import DISTORTION_PX
from csstsim.catalog.selection.reach import REACH_MAX
from csstsim.optics.geometry import spline
from csstsim.optics.geometry.distortion import FieldDistortion, load_distortion
from csstsim.optics.geometry.focal_plane import FocalPlane, Placement, load_focal_plane, samples
from csstsim.optics.geometry.wcs import ChipWCS, chip_plane

FOLDER = SHIPPED / "instrument"
NX, NY = 9216, 9232
FIT_PX = 1e-4  # model - optics on the chip; the goal is 0.01
CHIPS = [1, 6, 13, 21, 30]  # corners, centre, and turned both ways


@pytest.fixture(scope="module")
def field():
    return load_distortion(FOLDER / "distortion.fits")


@pytest.fixture(scope="module")
def plane():
    return load_focal_plane(FOLDER / "distortion.yaml")


def pixels(seed, n=300, beyond=0.0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.5 - beyond, NX - 0.5 + beyond, n), rng.uniform(-0.5 - beyond, NY - 0.5 + beyond, n)


def distance(one, other):
    return np.hypot(*np.subtract(one, other))


def test_model_is_the_optics_at_places_it_was_not_fitted_to(camera, field, plane):
    """Held-out points of all 30 chips: 1e-4 px on the chip, 1e-3 px to 1300 px beyond its edge."""
    for number, chip in camera.chips.items():
        for beyond, limit in ((0.0, FIT_PX), (1300.0, 1e-3)):
            x, y = pixels(number, beyond=beyond)
            assert distance(field.on(chip).forward(x, y), plane.forward(chip, x, y)).max() < limit


def test_offset_grows_from_nothing_to_over_200_px(camera, field):
    """The paper's figure at the edge of the focal plane; what the ring's mean offset is falls inwards."""
    offsets, radii = [], []
    for chip in camera.chips.values():
        x, y = pixels(chip.id, 2000)
        there, (rotation, origin) = field.on(chip).forward(x, y), chip_plane(chip)
        offsets.append(distance(there, (x, y)))
        radii.append(np.hypot(*(rotation @ (np.stack([x, y]) - origin[:, None]))))
    offset, radius = np.concatenate(offsets), np.concatenate(radii)
    assert 200 < offset.max() < 230
    ring = [offset[(radius >= low) & (radius < low + 5000)].mean() for low in range(0, 35000, 5000)]
    assert (np.diff(ring) > 0).all() and ring[0] < 3  # px; near the boresight only the CCDs' places count


def test_optics_leave_the_boresight_and_the_scale_there(camera, plane):
    """An aligned mosaic: no offset at the boresight, and a scale error of 1e-6 at most 30 px around it."""
    aligned = FocalPlane(plane.radius, plane.optics, plane.exit_pupil, dict.fromkeys(camera.chips, Placement()))
    chip = camera.chips[13]
    _, origin = chip_plane(chip)
    x, y = origin[0] + np.array([0.0, 30.0, 0.0]), origin[1] + np.array([0.0, 0.0, 30.0])
    moved = distance(aligned.forward(chip, x, y), (x, y))
    assert moved[0] < 1e-9 and moved.max() < 30 * 1e-6


def test_neighbouring_chips_jump_but_the_optics_do_not(camera, plane, field):
    """What the residual splines are for: the offset changes by over 0.1 px from chip to chip, not so when aligned."""
    aligned = FocalPlane(plane.radius, plane.optics, plane.exit_pupil, dict.fromkeys(camera.chips, Placement()))
    left, right = camera.chips[18], camera.chips[13]
    gap = chip_plane(left)[1][0] - chip_plane(right)[1][0]  # the same place of the mosaic on both
    y = np.linspace(0, NY, 20)
    for forward, jumps in (
        (lambda c, x: aligned.forward(c, x, y), False), (lambda c, x: field.on(c).forward(x, y), True),
    ):  # fmt: skip
        one = np.subtract(forward(right, np.full(20, -200.0)), [np.full(20, -200.0), y])
        other = np.subtract(forward(left, np.full(20, gap - 200.0)), [np.full(20, gap - 200.0), y])
        assert (np.hypot(*(one - other)).mean() > 0.1) == jumps


@pytest.mark.parametrize("number", CHIPS)
def test_inverse(camera, field, number):
    """To 1e-9 px on the chip and wherever else an object may lie; the goal is 1e-4."""
    chip = field.on(camera.chips[number])
    for beyond in (0.0, 2048.0, 1e5):
        x, y = pixels(number, beyond=beyond)
        assert distance(chip.forward(*chip.inverse(x, y)), (x, y)).max() < 1e-9
        assert distance(chip.inverse(*chip.forward(x, y)), (x, y)).max() < 1e-9


def test_shapes_and_places_that_are_none(camera, field):
    chip = field.on(camera.chips[6])
    assert chip.forward(1.0, 2.0)[0].shape == () and chip.jacobian(1.0, 2.0).shape == (2, 2)
    assert chip.inverse(np.empty(0), np.empty(0))[1].shape == (0,)
    assert chip.inverse(np.zeros((3, 1)), np.zeros(4))[0].shape == (3, 4)
    for call in (chip.forward, chip.inverse):
        x, y = call(np.array([np.nan, 5.0, np.inf, 5.0]), np.array([5.0, np.nan, 5.0, 5.0]))
        assert np.isnan(x[:3]).all() and np.isnan(y[:3]).all() and np.isfinite([x[3], y[3]]).all()


@pytest.mark.parametrize("number", CHIPS)
def test_beyond_the_chip_the_map_goes_on(camera, field, number):
    """From 30,000 px on one side to 30,000 on the other: continuous, rising, never far from the ideal place.

    The slope stays within 2.5% of 1, also where the model ends.
    """
    chip = field.on(camera.chips[number])
    line, fixed = np.arange(-30000.0, 40000.0, 7.0), np.full(10000, 1234.5)
    x, y = chip.forward(line, fixed), chip.forward(fixed, line)
    for along, across in ((x[0], x[1]), (y[1], y[0])):
        assert np.abs(np.diff(along) / 7.0 - 1).max() < 0.025 and np.abs(np.diff(across) / 7.0).max() < 0.025
        assert max(np.abs(along - line).max(), np.abs(across - fixed).max()) < 270


def test_margins_of_the_selection_hold(camera, field):
    """The largest stamp, seen from the chip's edge on the ideal plane, is within the margin of the bricks."""
    outer, edge = np.array([-0.5 - REACH_MAX, NX - 0.5 + REACH_MAX]), np.array([-0.5, NX - 0.5])
    for chip in camera.chips.values():
        for y in (0.0, NY / 2, NY - 1.0):
            inverse = field.on(chip).inverse
            stretch = distance(inverse(outer, y), inverse(edge, y))
            assert stretch.max() * 0.074 / 3600 < MARGIN
            assert np.abs(stretch - REACH_MAX).max() < DISTORTION_PX / 2


def test_edges_bend_by_less_than_the_merge_allows(camera, field):
    """A footprint is a polygon of the corners: how far a chip's edges leave their chords, on the ideal plane."""
    line = np.linspace(0.0, 1.0, 41)
    for chip in camera.chips.values():
        for x, y in (
            (line * NX, 0 * line),
            (line * NX, 0 * line + NY),
            (0 * line, line * NY),
            (0 * line + NX, line * NY),
        ):
            x0, y0 = field.on(chip).inverse(x - 0.5, y - 0.5)
            along = np.array([x0[-1] - x0[0], y0[-1] - y0[0]]) / np.hypot(x0[-1] - x0[0], y0[-1] - y0[0])
            assert np.abs((x0 - x0[0]) * along[1] - (y0 - y0[0]) * along[0]).max() < EDGE_PX


@pytest.mark.parametrize("number", CHIPS)
def test_jacobian_is_the_slope_of_the_optics(camera, field, plane, number):
    """Central differences of 2 px of the optics themselves (not of the model): 1e-6, a hundredth of the shape goal."""
    chip = camera.chips[number]
    x, y = pixels(number, 100)
    got = field.on(chip).jacobian(x, y)
    for column, (dx, dy) in enumerate(((1.0, 0.0), (0.0, 1.0))):
        slope = np.subtract(plane.forward(chip, x + dx, y + dy), plane.forward(chip, x - dx, y - dy)) / 2
        assert np.abs(got[:, :, column].T - slope).max() < 1e-6


def test_jacobian_is_the_slope_of_the_model_beyond_its_end(camera, field):
    chip = field.on(camera.chips[1])
    x, y = np.array([-2900.0, 5000.0, 13000.0]), np.array([4000.0, -4000.0, 15000.0])
    got = chip.jacobian(x, y)
    for column, (dx, dy) in enumerate(((0.5, 0.0), (0.0, 0.5))):
        slope = np.subtract(chip.forward(x + dx, y + dy), chip.forward(x - dx, y - dy))
        assert got[:, :, column] == pytest.approx(slope.T, abs=1e-8)


def test_spline_against_scipy():
    """Values and slopes of scipy's tensor product of order 4 with the same coefficients; a fit gives back a quartic."""
    rng, box, cells = np.random.default_rng(3), np.array([-10.0, 50.0, 7.0, 29.0]), (3, 2)
    coefficients = rng.normal(size=(cells[1] + 4, cells[0] + 4, 2))
    knots = [
        low + (high - low) / n * np.arange(-4, n + 5)
        for (low, high), n in zip((box[2:], box[:2]), cells[::-1], strict=True)
    ]
    theirs = NdBSpline(tuple(knots), coefficients, k=4)
    x, y = rng.uniform(*box[:2], 50), rng.uniform(*box[2:], 50)
    at = np.stack([y, x], axis=1)
    work = np.empty((4, 5))
    ours = np.array([spline.value(box, coefficients, a, b, work) for a, b in zip(x, y, strict=True)])
    expected = [theirs(at)] + [theirs(at, nu=nu) for nu in ((0, 1), (1, 0))]
    assert ours == pytest.approx(
        np.stack([e[:, i] for i in (0, 1) for e in expected], axis=1)[:, [0, 3, 1, 2, 4, 5]], abs=1e-10
    )
    quartic = np.stack([x**4 * y - 3 * x, x**2 * y**4 + 1], axis=1)
    again = fit_spline(x, y, quartic, box, (1, 1))
    assert spline.values(box, again, x, y) == pytest.approx(quartic, rel=1e-8)
    with pytest.raises(ValueError, match="24 samples are too few for a spline of 25"):
        fit_spline(x[:24], y[:24], quartic[:24], box, (1, 1))


@pytest.mark.parametrize("boresight", [(60.0, -40.0, 0.0), (0.001, 30.0, 77.0), (10.0, 90.0, -113.4333)])
@pytest.mark.parametrize("number", [1, 9, 30])
def test_sample_to_pixel_through_the_sky(camera, make_pointing, field, plane, number, boresight):
    """u, v of the samples, turned by the position angle and deprojected by astropy, come to the samples' pixels.

    With equation 4 as printed (rows exchanged) they would be thousands of pixels off.
    """
    ra, dec, pa = boresight
    chip = camera.chips[number]
    u, v, x, y = samples(plane, chip, 6).T
    sky = WCS(naxis=2)
    sky.wcs.ctype, sky.wcs.crval, sky.wcs.lonpole = ["RA---TAN", "DEC--TAN"], [ra, dec], 180.0
    c, s = np.cos(np.radians(pa)), np.sin(np.radians(pa))
    # North through east: what was north (v) is at position angle pa.
    positions = sky.wcs_pix2world(np.stack([c * u + s * v, c * v - s * u], axis=1), 1).T
    wcs = ChipWCS(chip, make_pointing(ra=ra, dec=dec, pa=pa), field)
    assert distance(wcs.world_to_pixel(*positions), (x, y)).max() < FIT_PX
    assert distance(wcs.world_to_pixel(*wcs.pixel_to_world(x, y)), (x, y)).max() < 1e-7


def test_shipped_coefficients_are_those_of_the_shipped_numbers(camera, field, plane):
    """distortion.fits is what the builder makes of distortion.yaml: 1e-7 px."""
    again = fit({n: samples(plane, camera.chips[n]) for n in camera.chips}, camera.chips)
    for chip in camera.chips.values():
        x, y = pixels(chip.id, 50, beyond=1000.0)
        assert distance(again.on(chip).forward(x, y), field.on(chip).forward(x, y)).max() < 1e-7


def test_file_and_its_faults(camera, field, tmp_path):
    path = tmp_path / "distortion.fits"
    write_distortion(path, field, ["a line"])
    again = load_distortion(path)
    x, y = pixels(1)
    for number in (3, 30):
        assert np.array_equal(
            again.on(camera.chips[number]).forward(x, y), field.on(camera.chips[number]).forward(x, y)
        )
    box, coefficients = field.whole
    nan = coefficients.copy()
    nan[0, 0, 0] = np.nan
    for whole, message in (
        ((box, nan), "not finite"), ((box[[1, 0, 2, 3]], coefficients), "empty"), ((box, nan[:4]), "shape"),
        ((box[[0, 1, 3, 2]], coefficients), "empty"), ((box[[0, 1, 2, 2]], coefficients), "empty"),
    ):  # fmt: skip
        write_distortion(path, FieldDistortion(whole, field.chips, field.layout))
        with pytest.raises(InputError, match=message):
            load_distortion(path)
    for content in (b"", (FOLDER / "distortion.fits").read_bytes()[:3000], b"no FITS at all"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="cannot read the field distortion"):
            load_distortion(path)
    with pytest.raises(InputError, match="cannot read the field distortion"):
        load_distortion(tmp_path / "none.fits")


def test_another_layout_of_the_chips_is_refused(camera, field, tmp_path):
    moved = replace(camera.chips[9], xc=14000.0)
    with pytest.raises(InputError, match="another layout"):
        field.on(moved)
    fewer = FieldDistortion(field.whole, {}, {})
    with pytest.raises(InputError, match="another layout"):
        ChipWCS(camera.chips[9], None, fewer)


def test_faults_of_the_description(tmp_path):
    text = (FOLDER / "distortion.yaml").read_text()
    for old, new in (("cubic: 200.0", "cubic: wide"), ("  astigmatic: [3.0, 1.5]", ""), ("exit_pupil:", "pupil:")):
        assert old in text
        (tmp_path / "distortion.yaml").write_text(text.replace(old, new))
        with pytest.raises(InputError, match="not a description of the focal plane"):
            load_focal_plane(tmp_path / "distortion.yaml")


def test_builder_is_deterministic(tmp_path):
    from support.mini import mini_camera

    files = []
    for name in "ab":
        folder = mini_camera(tmp_path / name)
        build(folder, nodes=6, margin=300.0)
        files.append((folder / "distortion.fits").read_bytes())
    assert files[0] == files[1]


def test_a_tilted_detector_of_larger_pixels_leaves_the_focal_plane_further(camera):
    """A slope of pixels of 20 um is one of twice as much of pixels of 10 um; the turn is about the middle."""
    optics = {"cubic": 0.0, "quintic": 0.0, "decentring": (0.0, 0.0), "astigmatic": (0.0, 0.0)}
    chip = camera.chips[9]
    chips = [replace(chip, detector=replace(chip.detector, nx=2000, ny=4000, pixel_um=um)) for um in (20.0, 10.0)]
    found = []
    for one, slope in zip(chips, (1e-3, 2e-3), strict=True):
        plane = FocalPlane(3e4, optics, 2000.0, {9: Placement(turn=1e-3, slope_x=slope, slope_y=-slope)})
        found.append(np.array(plane.forward(one, np.array([0.0, 999.5, 1999.0]), np.array([3999.0, 1999.5, 50.0]))))
        assert found[-1][:, 1] == pytest.approx((999.5, 1999.5), abs=1e-9)
    assert found[0] == pytest.approx(found[1], abs=1e-9) and np.abs(found[0][:, 0] - (0.0, 3999.0)).max() > 1
