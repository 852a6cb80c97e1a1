"""Objects that move while the shutter is open: length, direction and light of trails, in every method, and tracks."""

from types import SimpleNamespace

import astropy.units as u
import galsim
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS
from scipy.integrate import quad
from support.canvases import blank
from support.dispersed_sky import EXPTIME, NOISE, Flat, Sky
from support.grating_scene import SIGMA_PX

from csstsim.catalog.astrometry.reduction import apparent, icrs
from csstsim.catalog.changing.motion import Interval
from csstsim.catalog.flags import OFF_CHIP
from csstsim.catalog.light.object_spectra import catalog_spectra
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.selection.select import ChipView, select_objects
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered
from csstsim.render.drawing import Drawing
from csstsim.render.imaging import draw, reference
from csstsim.render.parts import tracks, trails
from csstsim.render.slitless import draw_dispersed, reference_dispersed
from csstsim.render.wings import core_fraction

WINDOW = Window(4000, 4200, 4000, 4180)
SCALE = 0.074  # arcsec / px
LENGTH_PX, ANGLE_DEG, LIGHT = 0.03, 0.2, 1e-3  # errors allowed: of a trail's length, its direction, its light
MIDDLE = 61582.0


@pytest.fixture(scope="module")
def moving(camera, make_pointing, observe, psf_r, psf_tables):
    """Return a function: (expected, counted, table) of one object that moves over chip 9, and its frame's wcs."""

    def made(
        rate_ra=0.0, rate_dec=0.0, fidelity="noise_free", pa=-113.4333, lost=None, window=WINDOW, wing=None,
        response=None, shown=None, psf=psf_r, **values
    ):  # fmt: skip
        pointing = make_pointing(pa=pa)
        wcs, craft = ChipWCS(camera.chips[9], pointing), observe(pointing)
        ra, dec = icrs(*wcs.pixel_to_world(4100.3, 4090.2), craft)
        interval = Interval(MIDDLE - 0.5 * EXPTIME / 86400, EXPTIME, lost)
        motion = {"rate_ra": rate_ra, "rate_dec": rate_dec, "rate_mjd": MIDDLE} if rate_ra or rate_dec else {}
        kind = {"id": 1, "type": "star", "ra": float(ra), "dec": float(dec), "ab": 19.0}
        catalog = Flat({"objects": [MockObject(**kind | motion | values)]})
        view = ChipView(wcs, craft, window, camera.filters["r"], camera.telescope, EXPTIME, NOISE, interval=interval)
        table = select_objects(catalog, view)
        canvas = blank(shown or window, np.float64, response=response)
        drawing = Drawing(
            wcs, psf, EXPTIME, Scattered(wing), fidelity, 60.0, np.uint64(7), psf_tables, craft, interval
        )  # fmt: skip
        how = reference.draw_objects if fidelity == "reference" else draw.draw_objects
        (drawn,) = trails.draw_trailed(how, canvas, table, drawing)
        return canvas.expected, canvas.counted, drawn, (wcs, craft)

    return made


def extent(image, still):
    """Return (length [px], angle [rad] from x to y) of a uniform line, from its second moments beyond a point's."""
    more = moments(image) - moments(still)
    values, vectors = np.linalg.eigh(more)
    return np.sqrt(12 * values[1]), np.arctan2(vectors[1, 1], vectors[0, 1])


def moments(image):
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    light = image.sum()
    off = np.stack([x - (x * image).sum() / light, y - (y * image).sum() / light])
    return np.einsum("iyx,jyx,yx->ij", off, off, image) / light


@pytest.mark.parametrize("pa", [-113.4333, 20.0])
@pytest.mark.parametrize("angle", [0.0, 60.0, 200.0])
def test_an_asteroid_is_trailed_as_far_as_astropy_says(moving, pa, angle):
    """30 arcsec / hour for 150 s: the ends on the sky by astropy, on the chip by astropy's WCS of the header."""
    rate = 30.0 * np.sin(np.radians(angle)), 30.0 * np.cos(np.radians(angle))
    image, _, table, (wcs, craft) = moving(*rate, pa=pa)
    still, *_ = moving(pa=pa)
    length, direction = extent(image, still)
    start = SkyCoord(table["ra_epoch"][0] * u.deg, table["dec_epoch"][0] * u.deg)
    half = 30.0 * EXPTIME / 3600 / 2 * u.arcsec
    ends = [start.directional_offset_by((angle + turn) * u.deg, half) for turn in (180.0, 0.0)]
    seen = [apparent(end.ra.deg, end.dec.deg, craft) for end in ends]
    (x0, x1), (y0, y1) = WCS(wcs.header()).all_world2pix(*np.transpose(seen), 0)
    assert length == pytest.approx(np.hypot(x1 - x0, y1 - y0), abs=LENGTH_PX)
    assert length == pytest.approx(30.0 * EXPTIME / 3600 / SCALE, rel=2e-3)  # 1.25 arcsec
    turn = np.degrees(direction - np.arctan2(y1 - y0, x1 - x0))
    assert (turn + 90) % 180 - 90 == pytest.approx(0.0, abs=ANGLE_DEG)
    assert table["trail_length"][0] == pytest.approx(1.25) and (
        (table["trail_angle"][0] - angle + 180) % 360 - 180 == pytest.approx(0.0, abs=1e-3)
    )
    assert image.sum() == pytest.approx(still.sum(), rel=LIGHT)
    assert len(table) == 1 and table["drawn"][0] == pytest.approx(image.sum(), rel=1e-9)


def test_a_trail_is_the_convolution_with_a_line(moving, psf_r):
    """Against GalSim's box, and whatever the number of points: half a pixel to 20 pixels."""
    for speed in (1.0, 5.0, 36.0):
        image, _, table, _ = moving(speed * 0.6, speed * 0.8)
        dx, dy = (table[f"trail_{axis}1"][0] - table[f"trail_{axis}0"][0] for axis in "xy")
        line = galsim.Box(np.hypot(dx, dy), 1e-3).rotate(np.arctan2(dy, dx) * galsim.radians)
        x, y = table["x"], table["y"]
        node, weight, _ = psf_r.weights(x, y)
        flux = np.array([table[f"flux{i}"][0] for i in range(4)]) * EXPTIME
        cells = sum(w * np.tensordot(flux, psf_r.node(n), axes=1) for n, w in zip(node[0], weight[0], strict=True))
        made = galsim.ImageD(galsim.BoundsI(WINDOW.x0, WINDOW.x1 - 1, WINDOW.y0, WINDOW.y1 - 1))
        star = galsim.Convolve([reference.point(cells, psf_r.oversampling), line])
        star.drawImage(made, scale=1.0, method="no_pixel", center=galsim.PositionD(x[0], y[0]))
        assert np.abs(image - made.array).max() < 1e-3 * image.max(), speed


def test_the_shutter_shortens_a_trail_but_not_its_light(moving):
    """The response, not the renderer, takes the light of a column's lost time."""
    image, _, table, _ = moving(30.0, 0.0)
    short, _, other, _ = moving(30.0, 0.0, lost=lambda x: np.full(np.shape(x), 30.0))
    assert other["trail_length"][0] == pytest.approx(30.0 * (EXPTIME - 30.0) / 3600, rel=1e-9)
    assert other["trail_start"][0] == 15.0 and table["trail_start"][0] == 0.0
    assert short.sum() == pytest.approx(image.sum(), rel=1e-6)


def test_every_fidelity_draws_the_same_trail(moving):
    galaxy = {"type": "galaxy", "size_disk": 0.3, "e1": 0.3, "ab": 18.0}
    for values in ({"ab": 18.0}, galaxy):
        truth, _, table, _ = moving(20.0, 20.0, "noise_free", **values)
        close, *_ = moving(20.0, 20.0, "reference", **values)
        assert np.abs(truth - close).max() < 3e-3 * close.max()
        for fidelity in ("standard", "preview"):
            image, counted, drawn, _ = moving(20.0, 20.0, fidelity, **values)
            assert drawn["method"][0] == "photons"
            off = counted + image - truth
            assert abs(off.sum()) < 4 * np.sqrt(truth.sum())
            some = truth > 20
            assert (off[some] ** 2 / truth[some]).mean() == pytest.approx(1.0, abs=5 * np.sqrt(2 / some.sum()))
            assert drawn["snr"][0] == pytest.approx(table["snr"][0])


def test_a_faint_trail_is_not_smeared_piece_by_piece(moving):
    """S/N 5 in preview, whose floor is 1: the pieces are fainter, the object is not."""
    _, counted, drawn, _ = moving(30.0, 0.0, "preview", ab=26.0)
    assert drawn["snr"][0] > 1 and drawn["method"][0] == "photons" and counted.sum() > 0


def test_points_and_line_are_the_same_track(moving, monkeypatch):
    """An object of 250 px: drawn by 500 points, and as a line; its light and its profile across."""
    wide = Window(3950, 4250, 3950, 4230)
    speed = 250 * SCALE / EXPTIME * 3600
    for angle in (10.0, 70.0):
        rate = speed * np.sin(np.radians(angle)), speed * np.cos(np.radians(angle))
        monkeypatch.setattr(trails, "LINE_PX", 1000.0)
        points, _, pieces, _ = moving(*rate, window=wide, ab=17.0)
        monkeypatch.setattr(trails, "LINE_PX", 10.0)
        line, _, table, _ = moving(*rate, window=wide, ab=17.0)
        assert table["method"][0] == "track"
        assert table["electrons"][0] == pytest.approx(
            pieces["electrons"][0], rel=1e-3
        )  # the shutter takes 1% of the time
        assert line.sum() == pytest.approx(points.sum(), rel=1.5 * LIGHT)
        assert np.abs(line - points).max() < 0.08 * points.max()  # at its ends, which are not quite as round
        inner = (slice(100, 180), slice(120, 180))
        assert line[inner].sum() == pytest.approx(points[inner].sum(), rel=2e-3)
        assert np.abs(line - points)[inner].max() < 0.01 * points.max()


def test_a_satellite_crosses_the_window_in_its_time(moving):
    """Light for each pixel of length is rate over speed; a track of width w has that width."""
    speed = 0.5 * 3600 * 3600  # arcsec / hour
    angle = np.radians(25.0)
    _, _, star, _ = moving()
    fraction = star["fraction"][0]  # of the light in the PSF's box
    for width in (0.0, 2.0):
        image, _, table, _ = moving(
            speed * np.sin(angle), speed * np.cos(angle), ab=8.0, type="satellite", trail_width=width
        )
        rate = sum(table[f"flux{i}"][0] for i in range(4))
        density = rate / (speed / 3600 / SCALE)  # electrons / px
        dx, dy = (table[f"trail_{axis}1"][0] - table[f"trail_{axis}0"][0] for axis in "xy")
        turn = np.hypot(dx, dy) / max(abs(dx), abs(dy))  # px of length in a row or column
        axis = 0 if abs(dx) > abs(dy) else 1
        across = image.sum(axis=axis)[60:120]
        assert across == pytest.approx(density * turn * fraction, rel=2e-3)
        assert across.std() < 2e-3 * across.mean()
        y = np.arange(image.shape[axis])
        line = image[:, 90] if axis == 0 else image[90]
        spread = np.sqrt((line * (y - (y * line).sum() / line.sum()) ** 2).sum() / line.sum()) / turn
        if width == 0:
            thin = spread
        else:  # the variance of a disc's chord is w^2 / 16
            assert np.sqrt(spread**2 - thin**2) == pytest.approx(width / SCALE / 4, rel=0.02)
    other, *_ = moving(speed, 0.0, ab=8.0, rate_mjd=MIDDLE + 0.01)  # it has passed before
    assert other.sum() == 0


SPEED, ANGLE = 250_000.0, np.radians(25.0)  # arcsec / hour; position angle
SATELLITE = {"type": "satellite", "rate_ra": SPEED * np.sin(ANGLE), "rate_dec": SPEED * np.cos(ANGLE), "ab": 8.0}


@pytest.fixture
def track(moving, psf):
    """Return a function: as `moving`, of a satellite behind Gaussian PSFs in a box of 32 px."""
    return lambda **values: moving(**SATELLITE, psf=psf, **values)


def from_line(table, window):
    """Return the signed distances [px] of a window's pixels from the line through a track's ends."""
    x0, y0, x1, y1 = (table[f"trail_{name}"][0] for name in ("x0", "y0", "x1", "y1"))
    x, y = np.arange(window.x0, window.x1), np.arange(window.y0, window.y1)[:, None]
    return ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / np.hypot(x1 - x0, y1 - y0)


def densities(table):
    """Return the electrons of each sub-band for each px of the track."""
    return np.array([table[f"flux{i}"][0] for i in range(4)]) / (SPEED / 3600 / SCALE)


def test_a_track_is_the_psf_across(track, psf):
    """Pixel by pixel the sub-bands' Gaussians at the distance from the line, to 1% of the top; box, losses, columns."""
    image, _, table, _ = track()
    across = from_line(table, WINDOW)
    wanted = sum(
        light * np.exp(-0.5 * across**2 / (s**2 + 1 / 12)) / np.sqrt(2 * np.pi * (s**2 + 1 / 12))
        for light, s in zip(densities(table), SIGMA_PX, strict=True)
    )
    assert np.abs(image - wanted).max() < 0.01 * wanted.max()
    rows, columns = np.nonzero(image)
    box = [table[name][0] for name in ("x0", "x1", "y0", "y1")]
    assert box == [*(columns.min() + 4000, columns.max() + 4001), *(rows.min() + 4000, rows.max() + 4001)]
    length = np.hypot(*(table[f"trail_{axis}1"][0] - table[f"trail_{axis}0"][0] for axis in "xy"))
    assert table["electrons"][0] == pytest.approx(length * densities(table).sum(), rel=2e-3)
    assert table["drawn"][0] == pytest.approx(image.sum(), rel=1e-9)
    assert table["fraction"][0] == pytest.approx(image.sum() / table["electrons"][0])
    assert table["method"][0] == "track" and table["flags"][0] & OFF_CHIP == 0
    assert table["snr"][0] == table["stamp"][0] == 0 and table["ms"][0] > 0
    response = np.linspace(0.4, 1.0, image.size, dtype=np.float32).reshape(image.shape)
    seen, _, table, _ = track(response=response)
    assert seen == pytest.approx(image * response, rel=1e-6)
    assert table["drawn"][0] == pytest.approx(seen.sum(), rel=1e-9)


@pytest.mark.parametrize(("angle", "axis", "sign"), [(0.0, 2, 1), (np.pi / 2, 1, -1)])
def test_the_light_across_a_line_is_the_psf_summed_along_it(psf_r, angle, axis, sign):
    """Along x: rows of the pixels' response; along y: columns, to the left first. With a wing, what the box keeps."""
    cells, per_pixel = psf_r.at(4100.0, 4090.0), psf_r.oversampling
    for wing in (None, read_scattered(psf_r).wing):
        kept = cells if wing is None else cells * core_fraction(cells.shape[-1], per_pixel)
        rows = pixel_response(kept, per_pixel).sum(axis=axis) / per_pixel
        position = sign * (np.arange(rows.shape[1]) - (rows.shape[1] - 1) / 2) / per_pixel
        d, bands = tracks._box_spread(Drawing(None, psf_r, EXPTIME, Scattered(wing)), (4100.0, 4090.0), angle)
        assert bands.shape == (4, len(d)) and d == pytest.approx(-d[::-1])
        inner = np.abs(position) < d[-1] - 1
        for band, row in zip(bands, rows, strict=True):
            assert np.abs(np.interp(position, d, band) - row)[inner].max() < 2e-3 * row.max()
        assert bands.sum(axis=1) * np.diff(d[:2]) == pytest.approx(rows.sum(axis=1) / per_pixel, rel=1e-3)


def test_a_track_does_not_depend_on_the_blocks_it_is_drawn_in(track, monkeypatch):
    """Sixteen blocks of 300 px, of which two meet on the window: each ends as the next begins."""
    whole, *_ = track()
    monkeypatch.setattr(tracks, "_BLOCK", 300.0)
    parts, *_ = track()
    assert np.abs(parts - whole).max() < 5e-3 * whole.max()
    assert parts.sum() == pytest.approx(whole.sum(), rel=1e-4)


def test_a_track_that_misses_the_window_is_said_to(track):
    image, _, table, _ = track(shown=Window(2000, 2100, 7000, 7080))
    assert not image.any() and table["drawn"][0] == 0 and table["flags"][0] & OFF_CHIP
    assert table["method"][0] == "none" and table["electrons"][0] > 0
    assert [table[name][0] for name in ("x0", "x1", "y0", "y1")] == [0, 0, 0, 0]


def test_a_wide_track_is_the_chord_of_a_disc_about_the_line(track):
    """Centroid of rows within 0.02 px, and the level in the middle; an odd and an even number of steps."""
    for width in (1.0, 2.3):
        image, _, table, _ = track(trail_width=width)
        across = from_line(table, WINDOW)
        half = 0.5 * width / SCALE
        wanted = densities(table).sum() * 2 * np.sqrt(np.maximum(1 - (across / half) ** 2, 0)) / np.pi / half
        inner = np.abs(across) < half - 5
        assert image[inner] == pytest.approx(wanted[inner], rel=0.03)
        assert not image[np.abs(across) > half + 25].any()
        for row in (70, 90, 110):
            assert (image[row] * across[row]).sum() / image[row].sum() == pytest.approx(0.0, abs=0.02), width


def test_the_wing_of_a_track_is_the_wing_summed_along_it(track, psf_r):
    """25 to 90 px from the line, and on windows next to it; electrons for each px of length, integrated, 1%."""
    wing = read_scattered(psf_r).wing
    image, _, table, _ = track(wing=wing)

    def wanted(distance):
        return 2 * quad(lambda s: densities(table) @ wing.profile(np.hypot(distance, s)), 0, 4000, limit=400)[0]

    across = from_line(table, WINDOW)
    for off in (-80, -45, 25, 60, 90):
        at = np.unravel_index(np.abs(across - off).argmin(), across.shape)
        assert image[at] == pytest.approx(wanted(across[at]), rel=0.01), off
    assert image[np.abs(across) < 60].sum() > 0.95 * track()[0].sum()  # the box keeps the rest
    for shift in (400, -400):
        window = Window(WINDOW.x0 + shift, WINDOW.x0 + shift + 30, WINDOW.y0, WINDOW.y0 + 30)
        across_there = from_line(table, window)
        beside, *_ = track(wing=wing, shown=window)
        assert np.abs(across_there).min() > 100
        assert beside[10, 20] == pytest.approx(wanted(across_there[10, 20]), rel=0.02)


def test_a_shutter_that_moves_along_a_track_ends_it_as_its_points_end(moving, psf, monkeypatch):
    """Columns lose 37 to 43 s: the line's light and where it lies are those of its points."""
    wide = Window(3950, 4250, 3950, 4230)
    speed = 250 * SCALE / EXPTIME * 3600

    def lost(x):
        return np.interp(np.asarray(x, float), [3950, 4250], [37.0, 43.0])

    images = []
    for limit in (1000.0, 10.0):
        monkeypatch.setattr(trails, "LINE_PX", limit)
        image, _, table, _ = moving(0.6 * speed, 0.8 * speed, window=wide, ab=17.0, lost=lost, psf=psf)
        images.append((image, table["electrons"][0]))
    (points, a), (line, b) = images
    assert b == pytest.approx(a, rel=0.02)
    assert line.sum() == pytest.approx(points.sum(), rel=0.02)
    assert np.abs(line - points).sum() < 0.05 * points.sum()


@pytest.mark.thorough
def test_a_trail_through_a_grating(camera, make_pointing, observe, psf, tables):
    """The light of all orders is that of the star at rest, in one row each; all fidelities."""
    pointing = make_pointing()
    star = {"id": 1, "ab": 19.0}
    far = {"rate_ra": 8.0, "rate_dec": -8.0, "rate_mjd": pointing.mjd + 0.5 * EXPTIME / 86400}
    window = Window(2700, 3400, 4700, 4860)
    found = {}
    for name, motion in (("rest", {}), ("moves", far)):
        sky = Sky(camera, pointing, observe(pointing), psf, [(3000.0, 4780.0, star | motion)])
        interval = Interval(pointing.mjd, EXPTIME)
        objects = sky.select(window, interval=interval)
        for fidelity in ("noise_free", "standard", "reference")[: 3 if motion else 2]:
            canvas = blank(window, np.float64)
            drawing = Drawing(
                sky.wcs, psf, EXPTIME, Scattered(), fidelity, NOISE.variance(EXPTIME), np.uint64(5), tables,
                sky.observer, interval,
            )  # fmt: skip
            how = reference_dispersed.draw_objects if fidelity == "reference" else draw_dispersed.draw_dispersed
            spectra = catalog_spectra(objects, sky.catalog)
            table, orders = trails.draw_trailed(how, canvas, objects, drawing, spectra, sky.disperser)
            total = canvas.expected + (0 if canvas.counted is None else canvas.counted)
            found[name, fidelity] = total, table, orders
            assert len(table) == 1 and (np.diff(orders["order"]) > 0).all()
            assert np.bincount(orders["row"], orders["drawn"]) == pytest.approx(table["drawn"], abs=1.0)
    for fidelity in ("noise_free", "standard", "reference"):
        one, rest, a = found["rest", "standard" if fidelity == "standard" else "noise_free"]
        other, moves, b = found["moves", fidelity]
        noise = 6 * np.sqrt(one.sum()) if fidelity == "standard" else 0.0
        assert other.sum() == pytest.approx(one.sum(), rel=2e-3, abs=noise)
        assert moves["electrons"][0] == pytest.approx(rest["electrons"][0], rel=1e-6)
        assert a["order"].tolist() == b["order"].tolist()
    first = found["moves", "noise_free"][0]
    assert np.abs(first - found["moves", "reference"][0]).max() < 0.02 * first.max()
    assert first.max() < 0.5 * found["rest", "noise_free"][0].max()


LAID = 0.06  # of a track's light may lie elsewhere than that of its points: the ends, and photons' noise


def test_a_track_through_a_grating_is_as_bright_as_its_points(camera, make_pointing, observe, psf, tables, monkeypatch):
    pointing = make_pointing()
    speed = 250 * SCALE / EXPTIME * 3600
    window = Window(2600, 3300, 4500, 5000)
    for angle in (30.0, 120.0):
        motion = {
            "rate_ra": speed * np.sin(np.radians(angle)), "rate_dec": speed * np.cos(np.radians(angle)),
            "rate_mjd": pointing.mjd + 0.5 * EXPTIME / 86400,
        }  # fmt: skip
        sky = Sky(camera, pointing, observe(pointing), psf, [(2900.0, 4750.0, {"id": 1, "ab": 17.0} | motion)])
        interval = Interval(pointing.mjd, EXPTIME)
        objects = sky.select(window, interval=interval)
        images, bright = {}, {}
        for limit in (1000.0, 10.0):
            monkeypatch.setattr(trails, "LINE_PX", limit)
            canvas = blank(window, np.float64)
            drawing = Drawing(
                sky.wcs, psf, EXPTIME, Scattered(), "standard", NOISE.variance(EXPTIME), np.uint64(5), tables,
                sky.observer, interval,
            )  # fmt: skip
            spectra = catalog_spectra(objects, sky.catalog)
            table, orders = trails.draw_trailed(
                draw_dispersed.draw_dispersed, canvas, objects, drawing, spectra, sky.disperser
            )
            images[limit] = canvas.expected + (0 if canvas.counted is None else canvas.counted)
            bright[limit] = table["electrons"][0]
        assert table["method"][0] == "track" and len(orders) == 0
        points, line = images[1000.0], images[10.0]
        assert line.sum() == pytest.approx(points.sum(), rel=0.03)
        # in squares of 20 px: where the light lies, along and across
        some, other = (v.reshape(25, 20, 35, 20).sum(axis=(1, 3)) for v in (points, line))
        assert np.abs(some - other).sum() < LAID * points.sum()
        assert table["electrons"][0] == pytest.approx(bright[1000.0], rel=1e-3)
        rows, columns = np.nonzero(line)
        box = [table[name][0] for name in ("x0", "x1", "y0", "y1")]
        assert box == [*(columns.min() + 2600, columns.max() + 2601), *(rows.min() + 4500, rows.max() + 4501)]
        assert table["drawn"][0] == pytest.approx(line.sum())


@pytest.mark.parametrize("width", [0.0, 1.5])
def test_a_disc_out_of_focus_is_as_wide_in_arcsec_whatever_the_plate_scale(psf_r, width):
    """3 arcsec on pixels of 0.148 arcsec are 1.5 arcsec on pixels of 0.074: across the line and at its ends."""
    found = []
    for scale in (SCALE, 2 * SCALE):
        wcs = SimpleNamespace(chip=SimpleNamespace(telescope=SimpleNamespace(pixel_scale=scale)))
        drawing, disc = Drawing(wcs, psf_r, EXPTIME), width * scale / SCALE
        profile = tracks._profile(np.ones(4), None, (4100.0, 4090.0), 0.3, drawing, disc, None)
        end = tracks._end(np.ones(4), (4100.0, 4090.0), 0.3, drawing, disc)
        found.append((profile.d, profile.spread, end.before, end.rise))
    for one, other in zip(*found, strict=True):
        assert one == pytest.approx(other, rel=1e-9)
