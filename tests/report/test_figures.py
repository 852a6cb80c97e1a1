"""The projection of the sky map against that of astropy; points, error bars and titles of a brick's figure."""

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS
from matplotlib.figure import Figure
from support.csst import LOOKS

from csstsim.base.healpix import brick_corners
from csstsim.measure.bricks.validation.trials import COLUMNS
from csstsim.report import figures
from csstsim.report.figures import _offsets


@pytest.mark.parametrize("centre", [(150.0, 2.0), (0.0, -60.0), (359.99, 45.0), (30.0, 90.0), (200.0, -89.9)])
def test_the_sky_map_is_lamberts_equal_area_projection(centre):
    """Over the whole sky but for the point opposite the centre, to 1e-9 deg."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval, wcs.wcs.crpix, wcs.wcs.cdelt = ["RA---ZEA", "DEC--ZEA"], centre, [1, 1], [1, 1]
    wcs.wcs.lonpole = 180.0  # north is up at the pole, too
    rng = np.random.default_rng(5)
    ra, dec = rng.uniform(0, 360, 500), np.degrees(np.arcsin(rng.uniform(-1, 1, 500)))
    ra[:3], dec[:3] = (0.0, 360.0, centre[0]), (10.0, 10.0, 0.9 * centre[1])
    np.testing.assert_allclose(_offsets(ra, dec, centre), wcs.all_world2pix(ra, dec, 0), atol=1e-9)


@pytest.fixture
def drawn(monkeypatch):
    """Functions return the figure in place of its PNG."""
    monkeypatch.setattr(figures, "png", lambda figure: figure)


def axes_of():
    return Figure().add_subplot()


def window(ra, dec, half=0.05):
    return ra + half * np.array([-1, 1, 1, -1]), dec + half * np.array([-1, -1, 1, 1])


def test_the_sky_map_has_windows_bricks_and_boresights_where_they_are(drawn):
    """Offsets within a degree are those of astropy's tangent offsets, 1e-4 deg; east is to the left."""
    footprints = [("g", *window(150.0, 2.0)), ("gu", *window(150.4, 2.3)), ("g", *window(150.2, 2.1))]
    bricks, pointings = [100, 200_000], [(150.1, 2.2), (150.0, 1.9), (150.3, 2.6)]
    figure = figures.sky_map(footprints, bricks, LOOKS, pointings)
    near, far = figure.axes
    corners = [brick_corners(pix) for pix in bricks]
    polygons = [(ra, dec) for _, ra, dec in footprints] + corners
    ra, dec = (np.concatenate(part) for part in zip(*polygons, strict=True))
    mean = SkyCoord(ra, dec, unit="deg").cartesian.mean().xyz.value
    centre = SkyCoord(*mean, representation_type="cartesian").spherical
    centre = centre.lon.deg, centre.lat.deg
    for axes in (near, far):
        assert axes.xaxis_inverted() and not axes.yaxis_inverted()
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("offset east [deg]", "offset north [deg]")
        for patch, (ra, dec) in zip(axes.patches, [*corners, *((ra, dec) for _, ra, dec in footprints)], strict=True):
            np.testing.assert_allclose(patch.get_xy()[:4], np.transpose(_offsets(ra, dec, centre)), atol=1e-9)
        assert [patch.get_linestyle() for patch in axes.patches[2:]] == ["-", LOOKS["gu"].line, "-"]
    assert near.get_title() == f"Windows and bricks around RA {centre[0]:.4f}, Dec {centre[1]:+.4f} deg (ICRS)"
    assert [text.get_text() for text in near.texts] == ["100", "200000"] and not far.texts
    for text, (ra, dec) in zip(near.texts, corners, strict=True):
        np.testing.assert_allclose(text.xy, np.mean(_offsets(ra, dec, centre), axis=1), atol=1e-9)
    (plus,) = far.lines
    np.testing.assert_allclose(plus.get_data(), _offsets(*np.transpose(pointings), centre), atol=1e-9)
    assert far.get_title() == "Boresights (+): 3" and not near.lines
    assert [text.get_text() for text in far.get_legend().get_texts()] == ["g", "GU"] and not near.get_legend()


def test_the_sky_map_of_many_bricks_has_no_numbers_and_without_pointings_one_panel(drawn):
    (axes,) = figures.sky_map([("r", *window(10.0, 0.0))], range(41), LOOKS).axes
    assert not axes.texts and len(axes.patches) == 42 and axes.get_legend()
    (axes,) = figures.sky_map([], range(40), LOOKS).axes
    assert len(axes.texts) == 40 and not axes.get_legend()


def stat(n, median, error):
    return {"n": n, "median": median, "error": error}


def test_residuals_of_a_band_are_points_medians_and_two_lines_of_numbers():
    """Running medians need ten sources in a half magnitude, and two such bins."""
    mag = np.r_[np.full(10, 20.1), np.full(11, 21.9), np.full(9, 24.0)]
    off = np.r_[np.arange(10) / 100, np.full(11, 0.3), np.full(9, 0.5)]
    arrays = {"galaxy": (mag, off), "star": (np.array([18.0]), np.array([-0.02]))}
    numbers = {"galaxy": stat(30, 0.0312, 0.0044), "star": stat(1, -0.02, None), "depth_5sigma": 26.25}
    axes = axes_of()
    assert figures._residuals(axes, LOOKS["nuv"], arrays, numbers)
    _, galaxy, median, star, depth = axes.lines
    np.testing.assert_allclose(galaxy.get_data(), [mag, off])
    np.testing.assert_allclose(median.get_data(), [[20.25, 21.75], [0.045, 0.3]])
    np.testing.assert_allclose(star.get_data(), [[18.0], [-0.02]])
    assert set(depth.get_xdata()) == {26.25}
    assert axes.texts[0].get_text() == "galaxy: +31 ± 4 mmag (30)\nstar: -20 mmag (1)"
    assert axes.get_xlabel() == "NUV true [AB mag]" and axes.get_title() == "NUV"
    many = np.full(6001, 20.0)
    axes, none = axes_of(), (np.zeros(0), np.zeros(0))
    empty = numbers | {"star": stat(0, None, None)}
    assert figures._residuals(axes, LOOKS["g"], {"galaxy": (many, many), "star": none}, empty)
    assert len(axes.lines[1].get_xdata()) == 2001 and len(axes.lines) == 4  # each third; one bin makes no median
    assert "star" not in axes.texts[0].get_text()
    assert not figures._residuals(axes_of(), LOOKS["g"], {"galaxy": none, "star": none}, empty)


@pytest.mark.parametrize("purity, said", [(None, "3 merged sources, "), (0.954, "3 merged sources (95 % match a true")])
def test_the_title_of_a_brick_counts_and_its_bands_are_in_order(drawn, purity, said):
    mags = np.array([20.0]), np.array([0.01])
    bands = {band: {"star": stat(1, 0.01, None), "galaxy": stat(0, None, None), "depth_5sigma": 26.0} for band in "ru"}
    for numbers in bands.values():
        numbers |= {"counts": {"edges": [20, 21], "in": [0], "out": [0]}, "transfer": []}
    none = {"bands": (), "input": np.zeros((2, 0)), "output": np.zeros((2, 0)), "galaxy": np.zeros(0, bool)}
    no_trials = {name: np.zeros(0) for name in COLUMNS}
    arrays = {
        "colour": none, "locus": none, "trials": dict.fromkeys("ru", no_trials),
        "completeness": dict.fromkeys("ru", (np.zeros(13, int), np.zeros(13, int))),
        "residual": {band: {"star": mags, "galaxy": (np.zeros(0), np.zeros(0))} for band in "ru"},
    }  # fmt: skip
    empty = {key: [0, 0] for key in ("objects", "found", "sources", "real")}
    result = {
        "brick": 12345, "sources": 3, "truth": 1, "frames": 2, "purity": purity, "bands": bands,
        "density": {"edges": [0, 1]} | empty,
    }  # fmt: skip
    figure = figures.brick_figure(result, arrays, LOOKS)
    assert [axes.get_title() for axes in figure.axes] == ["u", "r", ""]  # and the legend of kinds
    title = figure.get_suptitle()
    assert title.startswith("Brick 12345 (NSIDE 256, nested): ") and said in title
    assert title.endswith("1 true object, 2 frames")
