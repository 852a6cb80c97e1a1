"""The twin campaign of rotated shapes: ellipticities are turned by 90 degrees, all else is the same."""

import numpy as np
from csst import BANDS, MARGIN
from embedded_sky import embedded_catalog

from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.selection.select import Noise, region_for, select_objects
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS

WINDOW = Window(4000, 4600, 3000, 3500)


def test_only_the_intrinsic_ellipticities_change_sign(camera, make_pointing, observe, tmp_path):
    pointing = make_pointing()
    wcs, craft = ChipWCS(camera.chips[9], pointing), observe(pointing)
    catalog = embedded_catalog(tmp_path, region_for(*icrs(*wcs.footprint(WINDOW), craft), MARGIN, BANDS))
    options = (catalog, wcs, craft, WINDOW, camera.filters["r"], camera.telescope, 150.0, Noise(0.2, 0.02, 5.0), 26.0)
    normal, twin = (select_objects(*options, rotated=turned) for turned in (False, True))
    assert np.abs(normal["e1"]).max() > 0.3
    assert (twin["e1"] == -normal["e1"]).all() and (twin["e2"] == -normal["e2"]).all()
    assert twin.with_columns(e1=normal["e1"], e2=normal["e2"]) == normal
