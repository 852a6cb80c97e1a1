"""A face-on galaxy behind a grating: its knots have an emission line, its bulge has none; and images dispersed."""

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from scipy.special import ndtr
from support.canvases import blank
from support.dispersed_sky import EVERYWHERE, EXPTIME, NOISE, Sky

from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.light.object_spectra import catalog_spectra
from csstsim.catalog.own_table import TableCatalog
from csstsim.instrument.chip import Window
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.drawing import Drawing
from csstsim.render.scene import make_scene
from csstsim.render.slitless import draw_dispersed, reference_dispersed

LINE, X, Y = 5300.0, 2500.3, 4600.7
PLACE_PX, FLUX, PIXEL = 0.03, 1e-3, 2e-3
SIGMA = 5.0


@pytest.fixture
def sky(camera, make_pointing, observe, psf, tmp_path):
    """A Sky whose catalogue is that of a table, given as columns."""
    flat, line = np.array([2000.0, 11000.0]), np.array([LINE - 2, LINE, LINE + 2])
    Table({"WAVELENGTH": flat, "FLUX": [1.0, 1.0]}).write(tmp_path / "flat.csv")
    Table({"WAVELENGTH": line, "FLUX": [0.0, 1.0, 0.0]}).write(tmp_path / "line.csv")
    made = Sky(camera, make_pointing(), observe(make_pointing()), psf, [])
    ra, dec = icrs(*made.wcs.pixel_to_world(X, Y), made.observer)
    made.region = made.catalog.region

    def of(**columns):
        count = len(next(iter(columns.values())))
        columns = {"ra": [float(ra)] * count, "dec": [float(dec)] * count, "type": ["galaxy"] * count} | columns
        for name in ("spectrum_file", "image_file"):
            if name in columns:
                columns[name] = [str(tmp_path / text) if text else "" for text in columns[name]]
        made.catalog = TableCatalog({"columns": columns}, made.region)
        return made

    of.folder = tmp_path
    return of


def around(sky, half=60):
    """Return a window about where light of LINE falls, and the shift (x, y) there."""
    p, q, r, s = sky.disperser.gratings.left.orders[1].lines(np.array([X]), np.array([Y]))[0]
    shift = p + q * LINE, r + s * LINE
    x, y = round(X + shift[0]), round(Y + shift[1])
    return Window(x - half, x + half + 1, y - half, y + half + 1), shift


def draw(sky, window, fidelity="noise_free", tables=None, key=1):
    """Return (light, table of objects, table of orders, the objects)."""
    selected = sky.select(EVERYWHERE)
    canvas, how = blank(window, float), (fidelity, NOISE.variance(EXPTIME), np.uint64(key), tables)
    drawing = Drawing(sky.wcs, sky.psf, EXPTIME, Scattered(), *how)
    spectra = catalog_spectra(selected, sky.catalog)
    if fidelity == "reference":
        made = reference_dispersed.draw_objects(canvas, selected, spectra, sky.disperser, drawing)
    else:
        made = draw_dispersed.draw_dispersed(canvas, selected, spectra, sky.disperser, drawing)
    light = canvas.expected if canvas.counted is None else canvas.expected + canvas.counted
    return light, *made, selected


GALAXY = {
    "id": [1, 2], "mag_g": [20.0, 20.0], "size": [0.15, 1.6], "n": [3.0, 1.0], "knots": [0, 6],
    "part_of": [np.nan, 1], "spectrum_file": ["flat.csv", "line.csv"],
}  # fmt: skip


def gaussians(places, sigma, window):
    """Return the mean of round Gaussians at positions (n, 2) integrated over pixels."""
    x, y = (np.arange(a, b + 1) - 0.5 for a, b in ((window.x0, window.x1), (window.y0, window.y1)))
    return np.mean(
        [np.outer(*(np.diff(ndtr((e - c) / sigma)) for e, c in ((y, v), (x, u)))) for u, v in places], axis=0
    )


@pytest.mark.parametrize("fidelity", ["noise_free", pytest.param("reference", marks=pytest.mark.slow)])
def test_the_line_is_seen_at_the_knots_and_not_in_the_bulge(sky, fidelity):
    """Places of the six images within PLACE_PX of sums of Gaussians; the bulge alone is as smooth as its spectrum."""
    both = sky(**GALAXY)
    window, shift = around(both)
    light, table, orders, selected = draw(both, window, fidelity)
    scene = make_scene(selected, both.wcs, both.psf, EXPTIME)
    u, v, _ = scene.spots.group(0)
    positions = (scene.matrix[1] @ np.stack([u, v])).T + np.array([X + shift[0], Y + shift[1]])
    alone, *_ = draw(sky(**{name: values[:1] for name, values in GALAXY.items()}), window, fidelity)
    lines = light - alone
    sigma = np.interp(LINE, both.disperser.wavelengths, [0.8, 1.0, 1.2, 1.5])
    wanted = gaussians(positions, sigma, window)
    seen = lines / lines.sum()
    wanted /= wanted.sum()
    axis = np.arange(len(seen))
    for x, y in positions - [window.x0, window.y0]:
        weight = np.exp(-0.5 * ((axis[:, None] - y) ** 2 + (axis - x) ** 2) / 1.5**2)
        got, model = (
            np.array([(image * weight * axis).sum(), (image * weight * axis[:, None]).sum()]) / (image * weight).sum()
            for image in (seen, wanted)
        )
        assert np.abs(got - model).max() < PLACE_PX
        assert (seen * weight).sum() == pytest.approx((wanted * weight).sum(), rel=0.02)  # a line of 2 angstrom is long
    across = alone.sum(axis=0)  # through the position of the line
    assert np.abs(np.diff(across, 2)).max() < 1e-3 * across.max()
    assert lines.max() > 20 * np.abs(np.diff(across, 2)).max()
    assert table["drawn"].sum() == pytest.approx(light.sum(), rel=1e-6)
    assert sorted(set(orders["row"].tolist())) == [0, 1] and len(table) == 2


MIXED = {
    "id": [1], "mag_g": [18.5], "size": [0.4], "n": [1.0], "knots": [12], "knots_frac": [0.6],
    "spectrum_file": ["line.csv"],
}  # fmt: skip


def same(sky, tables, columns, electrons=2e5):
    """Hold slabs to the reference and photons to slabs; return the reference's tables."""
    made = sky(**columns)
    window, _ = around(made, 50)
    wanted, *found = draw(made, window, "reference")
    slabs, table, orders, _ = draw(made, window)
    assert np.abs(slabs - wanted).max() < PIXEL * wanted.max()
    assert slabs.sum() == pytest.approx(wanted.sum(), rel=FLUX)
    total, times = 0.0, 0
    while times < 6:
        times += 1
        photons, drawn, *_ = draw(made, window, "standard", tables, key=times)
        assert (drawn["method"] == "photons").all()
        total = total + photons
    filled = wanted * times > 20
    chi2 = ((total - wanted * times)[filled] ** 2 / (wanted * times)[filled]).mean()
    assert filled.sum() > 50 and chi2 == pytest.approx(1.0, abs=SIGMA * np.sqrt(2 / filled.sum()) + 0.02)
    return table, orders, found


def test_a_disk_with_knots_is_one_object_in_every_fidelity(sky, tables):
    """One row of objects and one of each order; electrons of the parts add up."""
    table, orders, (theirs, their_orders, _) = same(sky, tables, MIXED)
    assert len(table) == 1 and len(set(zip(orders["order"], orders["grating"], strict=True))) == len(orders)
    assert table["electrons"] == pytest.approx(theirs["electrons"], rel=1e-9)
    assert orders["electrons"] == pytest.approx(their_orders["electrons"], rel=1e-9)
    assert orders["drawn"].sum() == pytest.approx(table["drawn"].sum(), abs=1)
    only = sky(**{name: values for name, values in MIXED.items() if "knots" not in name})
    _, plain, plain_orders, _ = draw(only, around(only)[0])
    assert table["electrons"] == pytest.approx(plain["electrons"], rel=1e-6)
    assert orders["electrons"] == pytest.approx(plain_orders["electrons"], rel=1e-6)


def test_an_image_is_dispersed(sky, tables):
    """Two blobs of different light, off the middle: every fidelity, and the positions of the blobs."""
    axis = np.arange(81) - 40.0
    blobs = sum(
        a * np.exp(-0.5 * ((axis - x) ** 2 + (axis[:, None] - y) ** 2) / 3.0**2)
        for a, x, y in ((1, 15, 5), (2, -12, -18))
    )
    fits.writeto(sky.folder / "blobs.fits", blobs)
    columns = {
        "id": [1], "mag_g": [18.5], "image_file": ["blobs.fits"], "image_scale": [0.05], "spectrum_file": ["line.csv"],
    }  # fmt: skip
    same(sky, tables, columns)
