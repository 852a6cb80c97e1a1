"""Sections and channel extensions as read by another program: right pixels and right sky positions in all channels.

The sections are read by a parser written here, and by ccdproc where it is installed.
"""

import re

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import angular_separation
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.wcs import WCS
from support.readout_state import OBSID, change_exposure, flat_state

from csstsim.base.shipped import SHIPPED
from csstsim.detector.channels import LAYOUTS, ReadoutFrame
from csstsim.instrument.camera import load_camera
from csstsim.io.level0 import read_level0
from csstsim.io.level0_writing import write_level0
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.wcs import ChipWCS

WINDOWS = [None, (100, 170, 10, 50), (0, 33, 31, 33), (254, 256, 62, 64)]
MAS = np.radians(1 / 3.6e6)


def numbered(camera, path, layout, window=None, header=(), distortion=None, **pointing):
    """Write a file whose active pixels hold their own number in the window, all others one of their own.

    Returns the state and the numbers, (ny, nx) of the window.
    """
    state = flat_state(camera, window=window, **pointing)
    frame = ReadoutFrame.of(state.chip.detector, state.window)
    number = np.arange(1, state.image.size + 1, dtype=np.uint16).reshape(state.image.shape)
    state.image = (20000 + np.arange(np.prod(frame.shape)) % 40000).astype(np.uint16).reshape(frame.shape)
    for block in frame.blocks:
        state.image[block.active] = number[block.image]
    state.header |= dict(header)
    change_exposure(state, wcs=ChipWCS(state.chip, state.pointing, distortion))
    write_level0(path, state, camera.keywords, {"obsid": OBSID}, layout)
    return state, number


def cut(image, section):
    """The pixels of a section; a span from high to low turns them."""
    x0, x1, y0, y1 = map(int, re.fullmatch(r"\[(\d+):(\d+),(\d+):(\d+)\]", section).groups())
    out = image[min(y0, y1) - 1 : max(y0, y1), min(x0, x1) - 1 : max(x0, x1)]
    return out[:: 1 if y1 >= y0 else -1, :: 1 if x1 >= x0 else -1]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("window", WINDOWS)
def test_sections_of_the_stored_array_cut_out_the_channels(small, tmp_path, layout, window):
    numbered(small, tmp_path / "x.fits", layout, window)
    with fits.open(tmp_path / "x.fits") as hdus:
        image, head = hdus["IMAGE"].data, hdus["IMAGE"].header
        file = read_level0(tmp_path / "x.fits")
        assert np.array_equal(cut(file.assembled(full=True), head["DETSIZE"]), file.assembled(full=True))
        read = [channel.number for channel in file.channels()]
        assert read == [n for n in range(1, 17) if f"DSEC{n:02d}" in head]
        together = np.zeros_like(file.assembled(full=True))
        for channel in file.channels():
            data, trim, bias, chip = (head.get(f"{letter}SEC{channel.number:02d}") for letter in "DTBC")
            assert data == trim
            cut(together, chip)[...] = cut(image, data)
            assert (bias is None) == (layout == "chip")
            if bias is None:
                continue
            # the same direction on the chip turns the overscan as well
            turn = [-1 if a > b else 1 for a, b in np.array(re.findall(r"(\d+):(\d+)", chip), int)[::-1]]
            assert np.array_equal(cut(image, bias)[:: turn[0], :: turn[1]], channel.serial_overscan)
        assert (
            np.array_equal(together, file.assembled(full=True))
            and (together > 0).sum() == file.window.nx * file.window.ny
        )


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("window", WINDOWS)
def test_extensions_lie_side_by_side_by_their_sections(small, tmp_path, layout, window):
    """As ds9 lays an IRAF mosaic: DATASEC of each goes to DETSEC of a detector of DETSIZE."""
    numbered(small, tmp_path / "x.fits", layout, window)
    file = read_level0(tmp_path / "x.fits")
    file.extensions().writeto(tmp_path / "y.fits", checksum=True)
    with fits.open(tmp_path / "y.fits", checksum=True) as hdus:
        together = np.zeros_like(file.assembled(full=True))
        assert hdus[0].header["NEXTEND"] == len(hdus) - 1 == len(list(file.channels()))
        assert hdus[0].header["OBSID"] == file.header0["OBSID"]
        for hdu, channel in zip(hdus[1:], file.channels(), strict=True):
            head, n = hdu.header, channel.number
            assert hdu.name == f"CHAN{n:02d}" and head["CHANNEL"] == n and hdu.data.dtype == np.uint16
            assert not {f"GAIN{n:02d}", f"DSEC{n:02d}", "CRPIX1A", "LAYOUT"} & set(head) and head["BUNIT"] == "ADU"
            assert np.array_equal(cut(file.assembled(full=True), head["CCDSEC"]), channel.active)
            cut(together, head["DETSEC"])[...] = cut(hdu.data, head["DATASEC"])
            assert ("BIASSEC" in head) == (layout != "chip")
            scan = cut(hdu.data, head["BIASSEC"]) if layout != "chip" else np.zeros(0)
            assert np.array_equal(np.sort(scan, None), np.sort(channel.serial_overscan, None))
            gained = [head.get(name) for name in ("GAIN", "RDNOISE", "DETBIA")]
            assert gained == [channel.gain, channel.read_noise, channel.bias]
        assert np.array_equal(together, file.assembled(full=True))


def off_the_sky(path, state, number):
    """Return the distance [mas] of each pixel's position by its extension's WCS from the true one."""
    off = []
    for hdu in read_level0(path).extensions()[1:]:
        y, x = np.nonzero((hdu.data > 0) & (hdu.data <= number.max()))
        at = np.divmod(hdu.data[y, x].astype(int) - 1, number.shape[1])
        position = [v + float(w) for v, w in zip(at[::-1], (state.window.x0, state.window.y0), strict=True)]
        found = WCS(hdu.header).all_pix2world(x, y, 0)
        off.append(angular_separation(*np.radians(found), *np.radians(state.wcs.pixel_to_world(*position))) / MAS)
    assert sum(map(len, off)) == number.size
    return np.concatenate(off)


@pytest.mark.parametrize("window", WINDOWS[:2])
@pytest.mark.parametrize("fields", [{}, {"chip": 30, "pa": 17.0}, {"dec": 89.9, "chip": 1}])
def test_a_star_is_where_each_extensions_sky_says(small, tmp_path, fields, window):
    """The stored pixel that holds a chip pixel has the chip pixel's sky; 0.1 mas."""
    made = numbered(small, tmp_path / "x.fits", "channels", window, **fields)
    assert off_the_sky(tmp_path / "x.fits", *made).max() < 0.1


@pytest.mark.parametrize("window", [(60, 100, 9190, 9220), (9150, 9190, 30, 60), (9150, 9190, 9190, 9220)])
def test_the_distortion_far_from_the_middle_is_mirrored_with_the_channel(tmp_path, window):
    """Its polynomials vanish in the middle of the chip: at three corners, of channels mirrored in x, y and both."""
    field, camera = load_distortion(SHIPPED / "instrument" / "distortion.fits"), load_camera(SHIPPED / "instrument")
    where = {"window": window, "chip": 30, "pa": 17.0}
    made = numbered(camera, tmp_path / "x.fits", "channels", header={"sip": True}, distortion=field, **where)
    assert off_the_sky(tmp_path / "x.fits", *made).max() < 0.2


@pytest.mark.parametrize("sip", [True, False])
def test_the_distortion_is_in_each_extensions_sky_if_it_is_in_the_files(tmp_path, sip):
    """In the middle of a real chip, where four channels meet: 0.2 mas by SIP, arcseconds without."""
    field, camera = load_distortion(SHIPPED / "instrument" / "distortion.fits"), load_camera(SHIPPED / "instrument")
    where = {"window": (4588, 4628, 4600, 4632), "chip": 30, "pa": 17.0}
    made = numbered(camera, tmp_path / "x.fits", "channels", header={"sip": sip}, distortion=field, **where)
    off = off_the_sky(tmp_path / "x.fits", *made)
    assert off.max() < 0.2 if sip else off.min() > 1000


@pytest.mark.parametrize("window", WINDOWS[:2])
def test_ccdproc_subtracts_and_trims_by_the_sections(small, tmp_path, window):
    ccdproc = pytest.importorskip("ccdproc")
    numbered(small, tmp_path / "x.fits", "channels", window)
    file = read_level0(tmp_path / "x.fits")
    for hdu, channel in zip(file.extensions()[1:], file.channels(), strict=True):
        raw = CCDData(hdu.data.astype(float), unit=u.adu, header=hdu.header)
        active = ccdproc.trim_image(raw, fits_section=hdu.header["TRIMSEC"])
        assert np.array_equal(np.sort(active.data, None), np.sort(channel.active, None))
        bias = ccdproc.trim_image(raw, fits_section=hdu.header["BIASSEC"])
        assert np.array_equal(np.sort(bias.data, None), np.sort(channel.serial_overscan, None))
        # its own way: the median of the overscan row by row, so the rows of both sections must be the same
        rows = np.sort(np.median(bias.data, axis=1))
        left = ccdproc.subtract_overscan(active, overscan=bias, median=True, overscan_axis=1)
        assert np.allclose(np.sort((active.data - left.data)[:, 0]), rows)


@pytest.mark.parametrize("number", [1, 9, 30])
@pytest.mark.parametrize("pa", [0.0, 90.0, -113.4333])
def test_x_is_east_when_y_is_north(make_pointing, number, pa):
    """At position angle 0; +y points to the position angle, north over east, +x 90 degrees further: docs/places.md.

    Within the tilt of the tangent plane against the chip's own north (declination 0: 1e-3) and the gratings' turn.
    """
    camera = load_camera(SHIPPED / "instrument")
    chip = camera.chips[number]
    header = ChipWCS(chip, make_pointing(ra=150.0, dec=0.0, pa=pa)).header()
    wcs = WCS(fits.Header(header))
    middle = np.array([4608.0, 4616.0])
    (ra0, dec0), *ends = (wcs.all_pix2world(*(middle + step), 0) for step in ([0, 0], [100.0, 0], [0, 100.0]))
    angle_x, angle_y = (np.degrees(np.arctan2((ra - ra0) * np.cos(np.radians(dec0)), dec - dec0)) for ra, dec in ends)
    turn = abs(chip.rotation) + 0.1
    assert abs((angle_y - pa + 180) % 360 - 180) < turn
    assert abs((angle_x - angle_y - 90 + 180) % 360 - 180) < 1e-2


def test_extensions_have_the_nonlinearity_of_their_channel(small, tmp_path):
    """Each coefficient has a number of its own."""
    terms = {"nonlinearity_quadratic": [-1e-7 * n for n in range(1, 17)]}
    terms["nonlinearity_cubic"] = [2e-13 * n for n in range(1, 17)]
    numbered(small, tmp_path / "x.fits", "channels", (30, 200, 10, 50), header=terms)
    file = read_level0(tmp_path / "x.fits")
    for hdu, channel in zip(file.extensions()[1:], file.channels(), strict=True):
        n = channel.number
        assert (hdu.header["NLQ"], hdu.header["NLC"]) == pytest.approx((-1e-7 * n, 2e-13 * n))
