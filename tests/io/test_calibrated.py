"""The WCS of a calibrated image of a window, read by astropy: each plane's pixels lie where the chip's do, in ICRS."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from csstsim.catalog.astrometry.reduction import icrs
from csstsim.instrument.chip import Window
from csstsim.io.calibrated import COPIED, CalibratedPlanes, write_calibrated
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.wcs import ChipWCS

WINDOW = Window(3000, 3040, 5000, 5030)


@pytest.mark.filterwarnings("ignore::astropy.wcs.FITSFixedWarning")
@pytest.mark.parametrize("distorted", [False, True])
def test_a_windows_pixels_are_where_the_chips_are(tmp_path, camera, make_pointing, observe, distorted):
    distortion = load_distortion(camera.folder / "distortion.fits") if distorted else None
    pointing = make_pointing()
    wcs, observer = ChipWCS(camera.chips[9], pointing, distortion), observe(pointing)
    planes = CalibratedPlanes(
        np.zeros(WINDOW.shape, np.float32), np.ones(WINDOW.shape, np.float32), np.zeros(WINDOW.shape, np.uint8)
    )
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


@pytest.mark.filterwarnings("ignore::astropy.wcs.FITSFixedWarning")
def test_planes_and_keywords_are_those_given(tmp_path, camera, make_pointing, observe):
    """Each plane under its name, the exposure's own keywords, numbers of the calibration under theirs."""
    pointing = make_pointing()
    wcs, observer = ChipWCS(camera.chips[9], pointing, None), observe(pointing)
    rng = np.random.default_rng(3)
    science, error = (rng.normal(size=WINDOW.shape).astype(np.float32) for _ in range(2))
    quality = rng.integers(0, 8, WINDOW.shape, dtype=np.uint8)
    header0 = {name: f"value of {name}" for name in COPIED} | {"NEXTEND": 2, "CHECKSUM": "x"}
    file = SimpleNamespace(header0=header0, path=Path("there/level0.fits"), window=WINDOW, observer=observer)
    write_calibrated(
        tmp_path / "c.fits", file, wcs, CalibratedPlanes(science, error, quality), background=0.25, zeropoint=26.5,
        read_noise=5.75, settings={"sky": 3},
    )  # fmt: skip
    with fits.open(tmp_path / "c.fits", checksum=True) as found:
        assert [hdu.name for hdu in found] == ["PRIMARY", "SCI", "ERR", "DQ"]
        for name, plane in (("SCI", science), ("ERR", error), ("DQ", quality)):
            assert np.array_equal(found[name].data, plane) and found[name].data.dtype.kind == plane.dtype.kind
            assert found[name].header.get("BUNIT") == (None if name == "DQ" else "electron/s")
        primary, head = found[0].header, found["SCI"].header
        assert {name: primary[name] for name in COPIED} == {name: f"value of {name}" for name in COPIED}
        assert {"OBSID", "EXPSTART", "VELO0_Z", "EPHEM", "EXPHASH", "FILTER"} <= set(
            COPIED
        ) and "NEXTEND" not in primary
        assert [str(line).strip() for line in primary["HISTORY"]] == ["calibrated from level0.fits", "{'sky': 3}"]
        assert (head["BACKMED"], head["MAGZERO"], head["RDNOISE"]) == (0.25, 26.5, 5.75)
        bits = {found["DQ"].header[f"BIT{k}"]: found["DQ"].header.comments[f"BIT{k}"] for k in range(3)}
        assert list(bits.items()) == [
            ("saturated", "value 1"), ("defect, known from calibration", "value 2"), ("cosmic ray", "value 4"),
        ]  # fmt: skip
