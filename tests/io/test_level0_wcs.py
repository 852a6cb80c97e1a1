"""The world coordinates in a Level-0 header against astropy and GalSim: 1e-6 arcsec."""

import galsim
import numpy as np
import pytest
from astropy.coordinates import angular_separation
from astropy.io import fits
from astropy.wcs import WCS
from support.readout_state import flat_state, plain_layers, run

from csstsim.detector.channels import LAYOUTS, ReadoutFrame
from csstsim.io.level0_writing import write_level0

ARCSEC = np.radians(1 / 3600)
POINTINGS = [
    {}, {"chip": 30, "pa": 17.0}, {"chip": 1, "ra": 359.999, "dec": 0.0}, {"chip": 12, "dec": 90.0, "ra": 10.0},
    {"chip": 17, "dec": -89.99, "pa": 180.0}, {"window": (30, 70, 31, 33)},
]  # fmt: skip


def separation(one, other):
    """Angle [arcsec] between two (ra, dec) in degrees, good at small angles."""
    return angular_separation(*np.radians(one), *np.radians(other)) / ARCSEC


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("fields", POINTINGS, ids=range(len(POINTINGS)))
def test_every_channel(small, tmp_path, layout, fields):
    """Each stored active pixel has, by its channel's WCS, the sky of the chip pixel whose value it holds."""
    state = run(flat_state(small, **fields), plain_layers())
    write_level0(tmp_path / "x.fits", state, small.keywords, {}, layout)
    header = fits.getheader(tmp_path / "x.fits", "IMAGE")
    detector = state.chip.detector
    whole = ReadoutFrame.of(detector, None).of_file(layout)
    number = np.arange(1, detector.nx * detector.ny + 1, dtype=np.int32).reshape(detector.ny, detector.nx)
    stored = whole.to_stored(whole.embed(number), layout)
    y, x = np.nonzero(stored)
    chip_y, chip_x = np.divmod(stored[y, x] - 1, detector.nx)
    sky = state.wcs.pixel_to_world(chip_x.astype(float), chip_y.astype(float))
    for block in whole.blocks:
        here = (chip_x // detector.channel_nx == block.slot) & (chip_y // detector.channel_ny == block.half)
        assert here.sum() == detector.channel_nx * detector.channel_ny
        letter = "ABCDEFGHIJKLMNOP"[block.channel - 1] if layout != "chip" else " "
        # the whole header once; then the channel's own cards, which astropy parses twenty times faster
        seen = (
            header
            if not fields
            else fits.Header([card for card in header.cards if card.keyword.endswith(letter.strip())])
        )
        wcs = WCS(seen, key=letter)
        found = wcs.all_pix2world(x[here], y[here], 0)
        assert separation(found, [c[here] for c in sky]).max() < 1e-6


@pytest.mark.parametrize("fields", POINTINGS, ids=range(len(POINTINGS)))
def test_assembled_frame(small, tmp_path, fields):
    state = run(flat_state(small, **fields), plain_layers())
    path = tmp_path / "x.fits"
    write_level0(path, state, small.keywords, {})
    header = fits.getheader(path, "IMAGE")
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-3, 260, 12), np.linspace(-3, 70, 9)))
    sky = state.wcs.pixel_to_world(x, y)
    assert separation(WCS(header).all_pix2world(x, y, 0), sky).max() < 1e-6
    radec = galsim.FitsWCS(header=galsim.FitsHeader(str(path), hdu=1)).xyToradec(x + 1, y + 1, units="degrees")
    # GalSim takes the declination from its sine, which holds 1e-5 arcsec at best within 20 arcsec of a pole
    assert separation(radec, sky).max() < (1e-5 if fields.get("dec") == 90.0 else 1e-6)
