"""The twin campaign of rotated shapes: ellipticities are turned by 90 degrees, all else is the same."""

import numpy as np
import pytest
from astropy.io import fits
from support.csst import BANDS, MARGIN
from support.embedded_sky import embedded_catalog

from csstsim.base.errors import InputError
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.galaxy_shapes.knots import knots_of
from csstsim.catalog.own_table import TableCatalog
from csstsim.catalog.selection.bricks import region_for
from csstsim.catalog.selection.select import ChipView, Noise, select_objects
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS

WINDOW = Window(4000, 4600, 3000, 3500)


def test_only_the_intrinsic_ellipticities_change_sign(camera, make_pointing, observe, tmp_path):
    pointing = make_pointing()
    wcs, craft = ChipWCS(camera.chips[9], pointing), observe(pointing)
    catalog = embedded_catalog(tmp_path, region_for(*icrs(*wcs.footprint(WINDOW), craft), MARGIN, BANDS))
    view = ChipView(wcs, craft, WINDOW, camera.filters["r"], camera.telescope, 150.0, Noise(0.2, 0.02, 5.0))
    normal = select_objects(catalog, view, 26.0)
    twin = select_objects(catalog, view, 26.0, rotated=True)
    assert np.abs(normal["e1"]).max() > 0.3
    assert (twin["e1"] == -normal["e1"]).all() and (twin["e2"] == -normal["e2"]).all()
    assert twin.with_columns(e1=normal["e1"], e2=normal["e2"]) == normal


def selected_twice(camera, pointing, craft, columns):
    """Return the objects of a table around the middle of WINDOW as selected, and as turned."""
    wcs = ChipWCS(camera.chips[9], pointing)
    ra, dec = icrs(*wcs.pixel_to_world(np.array([4300.0, 4310.0]), np.array([3250.0, 3260.0])), craft)
    region = region_for(*icrs(*wcs.footprint(WINDOW), craft), MARGIN, BANDS)
    catalog = TableCatalog({"columns": {"ra": ra, "dec": dec, **columns}}, region)
    view = ChipView(wcs, craft, WINDOW, camera.filters["r"], camera.telescope, 150.0, Noise(0.2, 0.02, 5.0))
    return [select_objects(catalog, view, rotated=turned) for turned in (False, True)]


def test_knots_and_images_turn_with_their_galaxy(camera, make_pointing, observe, tmp_path):
    """As places in the sky: the matrix of the shape times the knots' places in the circle, turned by 90 degrees."""
    fits.writeto(tmp_path / "g.fits", np.eye(9) + 0.1)
    pointing = make_pointing()
    columns = {
        "type": ["galaxy", "galaxy"], "mag_r": [20.0, 20.0], "size": [0.5, 0.5], "e1": [0.3, 0.0], "e2": [0.1, 0.0],
        "knots": [12, 0], "knots_frac": [0.5, 0.0], "image_file": ["", str(tmp_path / "g.fits")],
        "image_scale": [0.1, 0.1], "image_pa": [0.0, 20.0],
    }  # fmt: skip
    both = selected_twice(camera, pointing, observe(pointing), columns)
    places = []
    for table in both:
        knots = knots_of(table)
        e1, e2 = (float(table[name][knots.rows[0]]) for name in ("e1", "e2"))
        places.append(np.array([[1 + e1, e2], [e2, 1 - e1]]) @ [knots.u, knots.v])
    np.testing.assert_allclose(places[1], np.array([[0, -1], [1, 0]]) @ places[0], atol=1e-6)
    pictured = [table["image_pa"][table["image_file"] != ""][0] for table in both]
    assert pictured == [20.0, 110.0]


def test_parts_cannot_be_turned(camera, make_pointing, observe):
    pointing = make_pointing()
    columns = {
        "type": ["galaxy", "galaxy"], "id": [1, 2], "mag_r": [20.0, 21.0], "size": [0.5, 0.5], "part_of": [-1, 1],
    }  # fmt: skip
    with pytest.raises(InputError, match="cannot turn parts"):
        selected_twice(camera, pointing, observe(pointing), columns)
