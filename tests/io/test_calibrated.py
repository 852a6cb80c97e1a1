"""The WCS of a calibrated image of a window, read by astropy: each plane's pixels lie where the chip's do, in ICRS."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from csstsim.catalog.astrometry.reduction import icrs
from csstsim.instrument.chip import Window
from csstsim.io.calibrated import write_calibrated
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.wcs import ChipWCS

WINDOW = Window(3000, 3040, 5000, 5030)


@pytest.mark.filterwarnings("ignore::astropy.wcs.FITSFixedWarning")
@pytest.mark.parametrize("distorted", [False, True])
def test_a_windows_pixels_are_where_the_chips_are(tmp_path, camera, make_pointing, observe, distorted):
    distortion = load_distortion(camera.folder / "distortion.fits") if distorted else None
    pointing = make_pointing()
    wcs, observer = ChipWCS(camera.chips[9], pointing, distortion), observe(pointing)
    planes = np.zeros(WINDOW.shape, np.float32), np.ones(WINDOW.shape, np.float32), np.zeros(WINDOW.shape, np.uint8)
    file = SimpleNamespace(header0={}, path=Path("level0.fits"), window=WINDOW, observer=observer)
    write_calibrated(
        tmp_path / "c.fits", file, wcs, planes, background=0.2, zeropoint=26.0, read_noise=5.0, settings={}
    )
    x, y = np.array([0.0, 39.0, 12.0]), np.array([0.0, 29.0, 17.5])
    ra, dec = icrs(*wcs.pixel_to_world(x + WINDOW.x0, y + WINDOW.y0), observer)
    with fits.open(tmp_path / "c.fits") as found:
        for name in ("SCI", "ERR", "DQ"):
            header = found[name].header
            seen = WCS(header).all_pix2world(x, y, 0)
            assert header["RADESYS"] == "ICRS" and "POSKIND" not in header
            assert np.abs(seen[0] - ra).max() * 3600 < 1e-4 and np.abs(seen[1] - dec).max() * 3600 < 1e-4
            assert [header[f"READ{k}"] for k in ("X0", "X1", "Y0", "Y1")] == [3001, 3040, 5001, 5030]
