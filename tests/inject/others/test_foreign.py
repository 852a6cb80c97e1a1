"""Injection into images of other telescopes: flux, position, shape, noise; a real image and source-extractor."""

import shutil
import subprocess
from pathlib import Path

import astropy
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from click.testing import CliRunner
from fuzz.seeds import stamps

from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.command_line.main import main
from csstsim.inject.inject import inject as run
from csstsim.inject.others.frame import read_foreign
from csstsim.inject.others.psf_models import Stamps, read_psf

SIDE, SCALE, TIME, GAIN, ZERO = 200, 0.2, 100.0, 2.0, 25.0
SIGMAS = 5.0
M13 = Path(astropy.__file__).parent / "io/fits/hdu/compressed/tests/data/m13.fits"  # Digitized Sky Survey, SkyView


def wcs_cards(angle=30.0):
    """Return cards of a rotated WCS with east to the right, so that its matrix is not symmetric."""
    c, s = np.cos(np.radians(angle)) * SCALE / 3600, np.sin(np.radians(angle)) * SCALE / 3600
    return {
        "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 359.9999, "CRVAL2": 60.0, "CRPIX1": SIDE / 2,
        "CRPIX2": SIDE / 2, "CD1_1": c, "CD1_2": -s, "CD2_1": s, "CD2_2": c,
    }  # fmt: skip


def write_image(folder, error=True, **cards):
    """Write an image of DN on a rotated WCS at RA 0, with ERR; a card of None is left out."""
    cards = wcs_cards() | {"BUNIT": "adu", "GAIN": GAIN, "EXPTIME": TIME, "FILTER": "F606W"} | cards
    header = fits.Header([(key, value) for key, value in cards.items() if value is not None])
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(np.full((SIDE, SIDE), 50, np.float32), header, "SCI")]
    hdus += [fits.ImageHDU(np.full((SIDE, SIDE), 5, np.float32), name="ERR")] if error else []
    path = folder / "image.fits"
    fits.HDUList(hdus).writeto(path, overwrite=True)
    return path


def write_stamp(folder, stamp, step):
    fits.PrimaryHDU(stamp, fits.Header({"PSFSAMP": step})).writeto(folder / "stamp.fits", overwrite=True)
    return folder / "stamp.fits"


def gaussian(sigma, side=33):
    """Return a Gaussian of sigma samples."""
    axis = np.arange(side) - side // 2
    return np.exp(-0.5 * (axis**2 + axis[:, None] ** 2) / sigma**2)


def in_pixel(stamp, cells):
    """Return a stamp convolved with a pixel of an odd number of cells."""
    for axis in (0, 1):
        stamp = np.apply_along_axis(np.convolve, axis, stamp, np.ones(cells), mode="same")
    return stamp


def write_psf(folder, sigma=1.5, step=0.5, side=61, **cards):
    """Write a Gaussian stamp, of cells of `step` px."""
    axis = (np.arange(side) - side // 2) * step
    stamp = np.exp(-0.5 * (axis**2 + axis[:, None] ** 2) / sigma**2)
    path = folder / "psf.fits"
    fits.PrimaryHDU(stamp.astype(np.float32), fits.Header({"PSFSAMP": step} | cards)).writeto(path, overwrite=True)
    return path


def inject(folder, image, table, psf, *more, code=0):
    table.write(folder / "new.csv", overwrite=True)
    shutil.rmtree(folder / "out", ignore_errors=True)
    call = ["inject", image, "--catalogue", folder / "new.csv", "--output", folder / "out", "--psf", psf, *more]
    result = CliRunner().invoke(main, [str(a) for a in call], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


def at(x, y, **columns):
    """Return a table of objects at pixels from 0."""
    ra, dec = WCS(fits.Header(wcs_cards())).all_pix2world(np.atleast_1d(x), np.atleast_1d(y), 0)
    return Table({"ra": ra, "dec": dec} | columns)


def moments(light):
    y, x = np.indices(light.shape)
    total = light.sum()
    mx, my = (light * x).sum() / total, (light * y).sum() / total
    dx, dy = x - mx, y - my
    return mx, my, (light * dx**2).sum() / total, (light * dy**2).sum() / total, (light * dx * dy).sum() / total


def test_flux_position_and_errors_of_a_star(tmp_path):
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    before = image.read_bytes()
    said = inject(tmp_path, image, at(90.3, 120.8, mag=[17.0]), psf, "--zeropoint", ZERO)
    assert "1 object injected" in said and image.read_bytes() == before
    with fits.open(tmp_path / "out/image.fits") as new:
        light = (new["SCI"].data.astype(float) - 50) * GAIN
        variance = (new["ERR"].data.astype(float) ** 2 - 25) * GAIN**2
        assert "injected 1 object of new.csv" in str(new[0].header["HISTORY"])
    wanted = TIME * 10 ** (0.4 * (ZERO - 17.0))
    assert light.sum() == pytest.approx(wanted, abs=SIGMAS * np.sqrt(wanted))
    x, y, xx, yy, xy = moments(light[100:141, 70:111])
    assert (x + 70, y + 100) == pytest.approx((90.3, 120.8), abs=SIGMAS * 1.5 / np.sqrt(wanted))
    assert (xx, yy, xy) == pytest.approx((2.25, 2.25, 0.0), abs=SIGMAS * 2.25 * np.sqrt(2 / wanted) + 0.01)
    bright = light > 100
    assert variance[bright] == pytest.approx(light[bright], rel=1e-2)  # of float32 errors


def test_the_shape_of_a_galaxy_follows_the_sky(tmp_path):
    """A galaxy long in declination lies along the WCS's north, and is as large as its half-light radius says."""
    image, psf = write_image(tmp_path), write_psf(tmp_path, sigma=0.8)
    table = at(100.0, 100.0, mag=[12.0], type=["galaxy"], size=[1.0], e1=[-0.5], e2=[0.0])
    inject(tmp_path, image, table, psf, "--zeropoint", ZERO)
    light = (fits.getdata(tmp_path / "out/image.fits", "SCI").astype(float) - 50) * GAIN
    sky = WCS(fits.Header(wcs_cards()))
    ra, dec = table["ra"][0], table["dec"][0]
    x, y = sky.all_world2pix([ra, ra], [dec, dec + 1 / 3600], 0)
    north = np.degrees(np.arctan2(y[1] - y[0], x[1] - x[0]))
    _, _, xx, yy, xy = moments(light)
    angle = np.degrees(0.5 * np.arctan2(2 * xy, xx - yy))
    assert (angle - north + 90) % 180 - 90 == pytest.approx(0.0, abs=1.0)
    along, across = (0.5 * (xx + yy) + k * np.hypot(0.5 * (xx - yy), xy) - 0.8**2 for k in (1, -1))
    assert np.sqrt(across / along) == pytest.approx(0.5 / 1.5, rel=0.03)  # e = (a - b) / (a + b)
    assert light.sum() == pytest.approx(TIME * 10 ** (0.4 * (ZERO - 12.0)), rel=0.01)


def test_each_object_has_its_own_noise(tmp_path):
    image, psf = write_image(tmp_path, error=False), write_psf(tmp_path)
    both = at([60.0, 140.0], [60.0, 140.0], mag=[18.0, 18.0], id=[7, 8])
    made = []
    for table, number in ((both, 1), (both[1:], 1), (both[1:], 2)):
        inject(tmp_path, image, table, psf, "--zeropoint", ZERO, "--realisation", number)
        made.append(fits.getdata(tmp_path / "out/image.fits", "SCI")[100:, 100:])
    assert np.array_equal(made[0], made[1]) and not np.array_equal(made[1], made[2])


def test_each_frame_has_noise_of_its_own(tmp_path):
    """Noise that two exposures share would not average out in their stack."""
    psf, table, made = write_psf(tmp_path), at(90.3, 120.8, mag=[18.0]), []
    for level in (50.0, 60.0):
        image = write_image(tmp_path, error=False)
        with fits.open(image, mode="update") as file:
            file["SCI"].data += np.float32(level)
        before = fits.getdata(image, "SCI")
        inject(tmp_path, image, table, psf, "--zeropoint", ZERO)
        made.append(np.rint((fits.getdata(tmp_path / "out/image.fits", "SCI") - before) * GAIN))
    assert made[0].sum() > 1000 and (made[0] != made[1]).any()


def test_objects_go_into_the_first_of_two_chips_and_the_message_states_it(tmp_path):
    image = write_image(tmp_path)
    with fits.open(image) as file:
        hdus = fits.HDUList([hdu.copy() for hdu in (*file, file["SCI"])])
    hdus.writeto(image, overwrite=True)
    said = inject(tmp_path, image, at(90.3, 120.8, mag=[18.0]), write_psf(tmp_path), "--zeropoint", ZERO)
    assert "1 more image of the file left unchanged" in " ".join(said.split())
    first, second = (fits.getdata(tmp_path / "out/image.fits", number) for number in (1, 3))
    assert first.sum() > second.sum() == 50 * SIDE**2


def test_a_magnitude_that_is_no_number_is_named_as_the_table_has_it(tmp_path):
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    said = inject(tmp_path, image, at(90.0, 90.0, mag=[np.nan]), psf, "--zeropoint", ZERO, code=2)
    assert "mag: row 1" in said and "mag_here" not in said and not (tmp_path / "out").exists()


def test_copies_of_a_frame_under_other_names_have_other_noise(tmp_path):
    """A folder of blanks is a usual start of a study; the same name gives the same bits again."""
    image, table = write_image(tmp_path), at(90.3, 120.8, mag=[18.0])
    (copy := tmp_path / "second.fits").write_bytes(image.read_bytes())
    table.write(tmp_path / "new.csv")
    made = {}
    for folder in ("one", "two"):
        call = ["inject", image, copy, "--catalogue", tmp_path / "new.csv", "--output", tmp_path / folder]
        call += ["--psf", write_psf(tmp_path), "--zeropoint", ZERO]
        assert CliRunner().invoke(main, [str(a) for a in call], catch_exceptions=False).exit_code == 0
        made[folder] = [fits.getdata(tmp_path / folder / path.name, "SCI") for path in (image, copy)]
    assert (made["one"][0] != made["one"][1]).any()
    assert all(np.array_equal(*pair) for pair in zip(made["one"], made["two"], strict=True))


def test_the_whole_stamp_of_the_psf_is_rendered(tmp_path):
    """Of a Moffat profile, whose wings GalSim's own size of a stamp would cut by 0.46%; to 2e-4, noise is 3e-5."""
    axis = (np.arange(121) - 60) * 0.5
    stamp = (1 + (axis**2 + axis[:, None] ** 2) / 4) ** -2.0
    fits.PrimaryHDU(stamp, fits.Header({"PSFSAMP": 0.5})).writeto(tmp_path / "moffat.fits")
    table = at(100.3, 99.8, mag=[7.0])
    said = inject(tmp_path, write_image(tmp_path), table, tmp_path / "moffat.fits", "--zeropoint", ZERO)
    drawn = float(said.split("the frame, ")[1].split()[0])
    assert drawn == pytest.approx(TIME * 10 ** (0.4 * (ZERO - 7.0)), rel=2e-4)


@pytest.mark.parametrize(("column", "columns"), [
    ("knots", {"knots": [10], "knots_frac": [0.5]}),
    ("image_file", {"image_file": ["galaxy.fits"], "image_scale": [0.05]}),
    ("rate_ra", {"rate_ra": [30.0], "rate_mjd": [61000.0]}),
    ("var_amplitude", {"var_amplitude": [0.3], "var_period": [1.0]}),
    ("light_curve", {"light_curve": ["sn"]}),
])  # fmt: skip
def test_what_is_not_rendered_is_refused(tmp_path, column, columns):
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    fits.writeto(tmp_path / "galaxy.fits", np.ones((9, 9), np.float32))
    table = at(100.0, 100.0, mag=[18.0], type=["galaxy"], size=[0.5], **columns)
    said = inject(tmp_path, image, table, psf, "--zeropoint", ZERO, code=2)
    assert column in said and "row 1" in said and not (tmp_path / "out").exists()


def test_stamps_between_their_positions():
    stamps = np.zeros((2, 5, 5))
    stamps[0, 2, 2], stamps[1, 2, 1:4] = 1.0, 1 / 3
    model = Stamps(stamps, np.array([0.0, 100.0]), np.array([0.0, 0.0]), 1.0)
    for x, share in ((0.0, 0.0), (50.0, 0.5), (100.0, 1.0), (25.0, 1 / 10)):  # weights 1 / 25^2 and 1 / 75^2
        drawn = model.at(x, 0.0).drawImage(nx=5, ny=5, scale=1.0, method="no_pixel").array
        assert drawn == pytest.approx((1 - share) * stamps[0] + share * stamps[1], abs=0.02)


def write_psfex(folder, planes, step=0.5):
    """Write a model of PSFEx, of 61 x 61 samples: constant and linear in x and y."""
    planes = np.stack(planes).astype(np.float32)
    mask = fits.Column("PSF_MASK", f"{planes.size}E", dim="(61,61,3)", array=planes[None])
    hdu = fits.BinTableHDU.from_columns([mask], name="PSF_DATA")
    hdu.header.update({
        "POLNAXIS": 2, "POLNGRP": 1, "POLGRP1": 1, "POLGRP2": 1, "POLNAME1": "X_IMAGE", "POLNAME2": "Y_IMAGE",
        "POLZERO1": 51.0, "POLSCAL1": 100.0, "POLZERO2": 41.0, "POLSCAL2": 100.0, "POLDEG1": 1, "PSF_SAMP": step,
        "PSFNAXIS": 3, "PSFAXIS1": 61, "PSFAXIS2": 61, "PSFAXIS3": 3, "LOADED": 9, "ACCEPTED": 9, "CHI2": 1.0,
        "PSF_FWHM": 4.7,
    })  # fmt: skip
    fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(folder / "a.psf", overwrite=True)


def test_a_model_of_psfex_has_its_size_its_change_and_unit_flux(tmp_path):
    """A Gaussian of sigma 2 at (51, 41) in FITS, which x adds 0.5 sigma^2 to in 100 px; sampled by 0.5 px."""
    axis = (np.arange(61) - 30) * 0.5
    plain = np.exp(-(axis**2 + axis[:, None] ** 2) / 8)
    wider = plain * (axis**2 / 4 - 1) / 2 * 0.5  # d ln sigma_x^2 / 2
    write_psfex(tmp_path, [plain, wider, 0 * plain])
    model = read_psf(tmp_path / "a.psf")
    for x, width2 in ((50.0, 4.0), (150.0, 6.0)):
        drawn = model.at(x, 40.0).drawImage(nx=61, ny=61, scale=0.5, method="no_pixel").array
        assert drawn.sum() == pytest.approx(1.0, abs=2e-3)
        assert (drawn * axis**2).sum() / drawn.sum() == pytest.approx(width2, rel=0.02)
        assert (drawn * axis[:, None] ** 2).sum() / drawn.sum() == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize(
    ("plane", "step", "words"),
    [
        (gaussian(2.0, 61), 0.1, "PSF_SAMP: the flux of a star would be wrong by 298%"),
        (gaussian(2.0, 61) * np.nan, 0.5, "a stamp has no flux, or values that are not numbers"),
        (gaussian(2.0, 61) - 0.001, 0.5, "too much flux in negative samples"),
    ],
)  # fmt: skip
def test_models_of_psfex_that_do_not_keep_the_flux_are_refused(tmp_path, plane, step, words):
    write_psfex(tmp_path, [plane, 0 * plane, 0 * plane], step)
    with pytest.raises(InputError, match=words):
        read_psf(tmp_path / "a.psf")


def test_units_and_zero_points(tmp_path):
    for cards, electrons in (
        ({"BUNIT": "ELECTRONS"}, 1.0), ({"BUNIT": "electron/s"}, TIME), ({"BUNIT": "DN / s"}, GAIN * TIME),
        ({"BUNIT": None}, GAIN), ({"GAIN": None, "CCDGAIN": 4}, 4.0),
    ):  # fmt: skip
        assert read_foreign(write_image(tmp_path, **cards)).electrons == electrons
    acs = {"BUNIT": "ELECTRONS", "PHOTFLAM": 7.9064521e-20, "PHOTPLAM": 5921.1}  # of ACS WFC F606W in 2004
    zeropoint = read_foreign(write_image(tmp_path, **acs)).zeropoint
    assert zeropoint == pytest.approx(26.49, abs=0.02)  # AB, ACS ISR 2007-02
    # The same camera in DN of 4 electrons: PHOTFLAM is of a DN a second
    in_dn = acs | {"BUNIT": "COUNTS", "GAIN": None, "CCDGAIN": 4, "PHOTFLAM": 4 * acs["PHOTFLAM"]}
    assert read_foreign(write_image(tmp_path, **in_dn)).zeropoint == pytest.approx(zeropoint, abs=1e-9)


FAULTS = {
    "no WCS": {"CTYPE1": None, "CTYPE2": None},
    "neither a gain nor a unit of electrons": {"GAIN": None},
    "no exposure time": {"EXPTIME": None},
    "a PSF of another filter": {"FILTER": "F814W"},
    "no zero point": {},
}


@pytest.mark.parametrize("message", FAULTS)
def test_bad_images_give_one_line_and_write_nothing(tmp_path, message):
    image, psf = write_image(tmp_path, **FAULTS[message]), write_psf(tmp_path, FILTER="F606W")
    more = () if message == "no zero point" else ("--zeropoint", ZERO)
    said = inject(tmp_path, image, at(50, 50, mag=[20.0]), psf, *more, code=2)
    assert message in said and len(said.strip().splitlines()) == 1 and not (tmp_path / "out").exists()


def test_bad_errors_and_sizes(tmp_path):
    psf = write_psf(tmp_path)
    for value, message in ((np.nan, "1 of the errors of good pixels"), (None, "not of the image's size")):
        image = write_image(tmp_path)
        with fits.open(image, mode="update") as file:
            if value is None:
                file["ERR"].data = file["ERR"].data[:-1]
            else:
                file["ERR"].data[3, 4] = value
        said = inject(tmp_path, image, at(50, 50, mag=[20.0]), psf, "--zeropoint", ZERO, code=2)
        assert message in said and not (tmp_path / "out").exists()


def test_the_edge_and_saturation(tmp_path):
    image, psf = write_image(tmp_path, SATURATE=1000.0), write_psf(tmp_path)
    said = inject(
        tmp_path, image, at([0.0, 100.0, 5000.0], [50.0, 100.0, 0.0], mag=[20.0, 12.0, 15.0]), psf, "--zeropoint", ZERO
    )
    light = fits.getdata(tmp_path / "out/image.fits", "SCI").astype(float) - 50
    whole = TIME * 10 ** (0.4 * (ZERO - 20.0)) / GAIN
    assert "2 objects injected" in said and light.max() == 950
    edge = light[30:71, :20].sum()
    assert edge == pytest.approx(0.6306 * whole, rel=0.05)  # Phi(0.5 px / 1.5 px): half of it, and half a column


@pytest.mark.skipif(
    not shutil.which("source-extractor") or not shutil.which("psfex"), reason="apt-get install source-extractor psfex"
)
@pytest.mark.skipif(
    not M13.is_file(), reason="astropy's test data are not installed: a real public image, not shipped here"
)
def test_a_real_image_takes_stars_that_source_extractor_finds(tmp_path):
    """M 13 from the Digitized Sky Survey, with the PSF that PSFEx measures in it. The plate's gain is not known: 5."""
    with fits.open(M13) as file:
        file[0].header["GAIN"], file[0].header["EXPTIME"] = 5.0, TIME
        file.writeto(tmp_path / "m13.fits", output_verify="silentfix+ignore")
        sky = WCS(file[0].header)
    (tmp_path / "all.param").write_text(
        "X_IMAGE\nY_IMAGE\nFLUX_RADIUS\nELONGATION\nFLAGS\nSNR_WIN\nFLUX_APER(1)\nFLUXERR_APER(1)\nVIGNET(25,25)\n"
    )
    (tmp_path / "all.conv").write_text("CONV NORM\n1 2 1\n2 4 2\n1 2 1\n")

    def found(image, name):
        settings = (
            "-CATALOG_TYPE FITS_LDAC -PARAMETERS_NAME all.param -FILTER_NAME all.conv -DETECT_THRESH 5 "
            "-PHOT_APERTURES 8 -SATUR_LEVEL 3000 -GAIN 5 -VERBOSE_TYPE QUIET"
        )
        subprocess.run(["source-extractor", image, "-CATALOG_NAME", name, *settings.split()], cwd=tmp_path, check=True)
        return fits.getdata(tmp_path / name, 2)

    before = found("m13.fits", "m13.cat")
    settings = (
        "-SAMPLE_FLAGMASK 0x00fe -PSF_SIZE 25,25 -CHECKPLOT_TYPE NONE -CHECKIMAGE_TYPE NONE -WRITE_XML N "
        "-VERBOSE_TYPE QUIET"
    )
    subprocess.run(["psfex", "m13.cat", *settings.split()], cwd=tmp_path, check=True)
    grid = np.linspace(15, 285, 16)
    x, y = (v.ravel() for v in np.meshgrid(grid, grid))
    free = np.hypot(x - 150, y - 150) > 100  # outside the core of the cluster
    free &= np.hypot(x[:, None] - before["X_IMAGE"] + 1, y[:, None] - before["Y_IMAGE"] + 1).min(axis=1) > 8
    ra, dec = sky.all_pix2world(x[free], y[free], 0)
    table = Table({"ra": ra, "dec": dec, "mag": np.full(free.sum(), 17.0)})
    assert len(table) > 30
    inject(tmp_path, tmp_path / "m13.fits", table, tmp_path / "m13.psf", "--zeropoint", 24.0)
    after = found("out/m13.fits", "new.cat")
    apart = np.hypot(x[free][:, None] - after["X_IMAGE"] + 1, y[free][:, None] - after["Y_IMAGE"] + 1)
    match = apart.argmin(axis=1)
    seen = apart.min(axis=1) < 1.0
    assert seen.mean() > 0.97
    off = np.column_stack([after["X_IMAGE"][match] - 1 - x[free], after["Y_IMAGE"][match] - 1 - y[free]])[seen]
    assert np.abs(np.median(off, axis=0)).max() < 0.1  # px: no shift of half a pixel or more
    share = np.median(after["FLUX_APER"][match[seen]]) * 5 / (TIME * 10 ** (0.4 * (24.0 - 17.0)))
    assert 0.8 < share < 1.05  # of an aperture of 8 px about a star of FWHM 3.3 px


@pytest.mark.parametrize("change", [("NAXIS2  =                    5", 0), ("NAXIS2  =                    2", 10**12)])
def test_stamps_whose_headers_lie(tmp_path, change):
    """The pixels begin where the next header should; a table announces 8 TB."""
    path, (card, value) = stamps(tmp_path), change
    content = path.read_bytes()
    assert content.count(card.encode()) == 1
    path.write_bytes(content.replace(card.encode(), f"NAXIS2  = {value:>20}".encode()))
    with pytest.raises(InputError):
        read_psf(path)


def test_a_column_of_words_is_named_with_its_file(tmp_path):
    table, image, psf = at(50, 50, mag=[20.0], obj_type=["star"]), write_image(tmp_path), write_psf(tmp_path)
    said = inject(tmp_path, image, table, psf, "--zeropoint", ZERO, code=2)
    assert f"{tmp_path / 'new.csv'}: obj_type, row 1: must be numbers" in said


@pytest.mark.parametrize("value", [1000.0, -0.1, 50.1, np.nan, np.inf, "text", 10**400])
def test_zero_points_that_no_telescope_has_are_refused(tmp_path, value):
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    said = inject(tmp_path, image, at(50, 50, mag=[20.0]), psf, f"--zeropoint={value}", code=2)
    assert "--zeropoint" in said
    with pytest.raises(InputError, match=r"image.fits: zeropoint: no zero point .*allowed: 0 to 50"):
        run([image], {"ra": [0.0], "dec": [60.0], "mag": [20.0]}, tmp_path / "out", psf=psf, zeropoint=value)
    assert not (tmp_path / "out").exists()


def test_a_zero_point_of_the_header_that_no_telescope_has_is_refused(tmp_path):
    image = write_image(tmp_path, PHOTFLAM=1e-60, PHOTPLAM=5921.1)
    said = inject(tmp_path, image, at(50, 50, mag=[20.0]), write_psf(tmp_path), code=2)
    assert "PHOTFLAM, PHOTPLAM: no zero point" in said


def test_more_electrons_than_noise_can_be_drawn_of_are_refused(tmp_path):
    """10^18 electrons, with the zero point 50 in 100 s: 10 mag."""
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    said = inject(tmp_path, image, at([50, 50], [50, 50], mag=[10.1, 9.9]), psf, "--zeropoint", 50, code=2)
    assert "new.csv: mag, row 2: more than 1e+18 electrons" in said and not (tmp_path / "out").exists()
    inject(tmp_path, image, at([50], [50], mag=[10.1]), psf, "--zeropoint", 50)


CD = "CD1_1", "CD1_2", "CD2_1", "CD2_2"


@pytest.mark.parametrize(
    ("cards", "key"),
    [
        (dict.fromkeys(CD[:3], 0.0), "CD"), (dict.fromkeys(CD[:3]), "CD"), (dict.fromkeys(CD, 0.0), "CD"),
        (dict.fromkeys(CD, 1e-5), "CD"), ({"CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 1e-300}, "CD"),
        (dict.fromkeys(CD) | {"CDELT1": 1e-12, "CDELT2": 1e-5}, "CDELT, PC"),
        (dict.fromkeys(CD) | {"CDELT1": 0.0, "CDELT2": 1e-5}, ""),
    ],
)  # fmt: skip
def test_a_wcs_that_maps_the_image_to_a_line_is_refused(tmp_path, cards, key):
    image, psf = write_image(tmp_path, **cards), write_psf(tmp_path)
    said = inject(tmp_path, image, at(50, 50, mag=[20.0]), psf, "--zeropoint", ZERO, code=2)
    wanted = f"image.fits: {key}: the WCS maps the image to a line" if key else "image.fits: the WCS cannot be used"
    assert wanted in said and not (tmp_path / "out").exists()


def test_a_wcs_by_cdelt_is_read(tmp_path):
    cards = dict.fromkeys(CD) | {"CDELT1": -1e-5, "CDELT2": 2e-5}
    assert read_foreign(write_image(tmp_path, **cards)).wcs.wcs.pixel_scale_matrix == pytest.approx(
        np.diag([-1e-5, 2e-5])
    )


@pytest.mark.parametrize(("kind", "zero"), [("int16", 0), ("uint16", 32768), ("int32", 0)])
def test_blank_pixels_of_an_image_of_integers_stay_blank(tmp_path, kind, zero):
    """A star on a hole: the copy is of integers, the hole is BLANK, and flux is next to it."""
    path, raw = write_image(tmp_path, error=False), np.dtype(kind.removeprefix("u"))
    blank = int(np.iinfo(raw).min)
    pixels = np.full((SIDE, SIDE), 100, kind)
    pixels[SIDE // 2 - 1 : SIDE // 2 + 2, SIDE // 2 - 1 : SIDE // 2 + 2] = blank + zero
    with fits.open(path) as file:
        header = file["SCI"].header
        fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(pixels, header, "SCI")]).writeto(path, overwrite=True)
    fits.setval(path, "BLANK", value=blank, ext=1)
    ra, dec = read_foreign(path).wcs.sky([SIDE // 2], [SIDE // 2])
    inject(tmp_path, path, Table({"ra": ra, "dec": dec, "mag": [18.0]}), write_psf(tmp_path), "--zeropoint", "25")
    before, after = (raw_pixels(p) for p in (path, tmp_path / "out" / path.name))
    hole = before == blank
    assert after.dtype == before.dtype and hole.sum() == 9 and np.array_equal(after == blank, hole)
    assert (after > before)[~hole].sum() > 20
    assert fits.getval(tmp_path / "out" / path.name, "BLANK", ext=1) == blank


def raw_pixels(path):
    with fits.open(path, do_not_scale_image_data=True) as file:
        return file["SCI"].data.copy()


def test_a_catalogue_may_have_any_name(tmp_path):
    """HISTORY holds it in the characters of FITS."""
    image, psf = write_image(tmp_path, error=False), write_psf(tmp_path)
    ra, dec = read_foreign(image).wcs.sky([SIDE // 2], [SIDE // 2])
    Table({"ra": ra, "dec": dec, "mag": [18.0]}).write(tmp_path / "\u00e9toiles \u2728.csv")
    call = [
        "inject",
        image,
        "--catalogue",
        tmp_path / "\u00e9toiles \u2728.csv",
        "--output",
        tmp_path / "out",
        "--psf",
        psf,
    ]
    result = CliRunner().invoke(main, [*map(str, call), "--zeropoint", "25"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert "\\xe9toiles" in "".join(fits.getheader(tmp_path / "out" / image.name)["HISTORY"])


@pytest.mark.parametrize("what", ["SCI", "ERR"])
@pytest.mark.parametrize(
    ("kind", "scale", "zero"),
    [("i2", 0.1, 0.0), ("i2", 0.5, 500.0), ("i4", 0.001, 0.0), ("i2", 2.0, 32768.0), ("i2", 1, 32768)],
)
def test_scaled_images_keep_their_values(tmp_path, what, kind, scale, zero):
    """Integers with BSCALE and BZERO, as others store floats: values far from the object are as they were."""
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    with fits.open(image) as file:
        stored = np.rint((file[what].data - zero) / scale).astype(kind)
        raw = fits.ImageHDU(stored, file[what].header, what)
        raw.header["BSCALE"], raw.header["BZERO"] = scale, zero
        file[what] = raw
        file.writeto(tmp_path / "scaled.fits")
    values = fits.getdata(tmp_path / "scaled.fits", what).astype(float)
    inject(tmp_path, tmp_path / "scaled.fits", at(90.3, 120.8, mag=[17.0]), psf, "--zeropoint", ZERO)
    new = fits.getdata(tmp_path / "out/scaled.fits", what).astype(float)
    assert np.array_equal(new[:50], values[:50]) and new[120, 90] > values[120, 90] + 1


def test_a_galaxy_too_large_to_be_rendered_is_refused(tmp_path):
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    table = at(100.0, 100.0, mag=[20.0], type=["galaxy"], size=[300.0], n=[4.0])
    said = inject(tmp_path, image, table, psf, "--zeropoint", ZERO, code=2)
    assert "too large to be rendered" in said and "(got 300.0)" in said and not list((tmp_path / "out").glob("*"))


@pytest.mark.parametrize(("kind", "factor"), [("quasar", 1), ("galaxy", 1), ("star", 0), ("asteroid", 0)])
def test_what_lies_behind_a_lens_is_magnified(tmp_path, kind, factor):
    """mu = 1 / ((1 - kappa)^2 - gamma^2); stars and asteroids are before the lens."""
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    shape = {"size": [0.3]} if kind == "galaxy" else {}
    table = at(100.0, 100.0, mag=[14.0], type=[kind], kappa=[0.3], gamma1=[0.1], gamma2=[0.0], **shape)
    inject(tmp_path, image, table, psf, "--zeropoint", ZERO)
    truth = ObjectTable.read(tmp_path / "out/image.truth.parquet")
    mu = 1 / (0.7**2 - 0.1**2) if factor else 1.0
    assert truth["electrons"][0] == pytest.approx(mu * TIME * 10 ** (0.4 * (ZERO - 14.0)), rel=1e-5)


@pytest.mark.parametrize("kind", ["quasar", "galaxy", "star"])
@pytest.mark.parametrize("field", [(1.0, 0.0, 0.0), (1.5, 0.0, 0.0), (0.2, 0.9, 0.0), (0.2, 0.0, -0.8)])
def test_strong_lenses_are_refused(tmp_path, kind, field):
    """kappa of 1 or more, or a shear of 1 - kappa or more. A star is before the lens, whatever it is."""
    image, psf = write_image(tmp_path), write_psf(tmp_path)
    shape = {"size": [0.3, 0.3]} if kind == "galaxy" else {}
    lens = {name: [0.0, value] for name, value in zip(("kappa", "gamma1", "gamma2"), field, strict=True)}
    table = at([50.0, 100.0], [50.0, 100.0], mag=[14.0, 14.0], type=[kind, kind], **lens, **shape)
    said = inject(tmp_path, image, table, psf, "--zeropoint", ZERO, code=0 if kind == "star" else 2)
    if kind == "star":
        assert "2 objects injected" in said
    else:
        assert "new.csv: kappa, gamma1, gamma2, row 2: strongly lensed" in said and not (tmp_path / "out").exists()
        assert "got '{:g}, {:g}, {:g}'".format(*field) in said


def test_blank_names_of_light_curves_are_none(tmp_path):
    table = at([50.0, 100.0], [50.0, 100.0], mag=[14.0, 14.0], light_curve=["", ""])
    path, columns = write_image(tmp_path, error=False), {name: np.array(table[name]) for name in table.colnames}
    with pytest.raises(InputError, match="light_curve, row 2: only rendered in frames of csstsim"):
        drawn_into(tmp_path, path, columns | {"light_curve": np.array(["", "sn"])}, write_psf(tmp_path))
    _, truth = drawn_into(tmp_path, path, columns, write_psf(tmp_path))
    assert len(truth) == 2


@pytest.mark.parametrize(
    ("cards", "band"),
    [
        ({"FILTER": None, "FILTER1": "CLEAR1L", "FILTER2": "F814W"}, "F814W"),
        ({"FILTER": "CLEAR", "PUPIL": "F606W"}, "F606W"), ({"FILTER": "F606W", "PUPIL": "CLEAR"}, "F606W"),
        ({"FILTER": "Clear"}, ""),
    ],
)  # fmt: skip
def test_empty_positions_of_a_wheel_are_no_filters(tmp_path, cards, band):
    assert read_foreign(write_image(tmp_path, **cards)).band == band


@pytest.mark.parametrize("unit", ["electron s-1", "electron/s", "e- s^-1", "electron.s-1", "electron s**-1"])
def test_electrons_a_second_however_they_are_written(tmp_path, unit):
    assert read_foreign(write_image(tmp_path, BUNIT=unit, GAIN=None)).electrons == TIME


def test_tiles_of_floats_are_refused(tmp_path):
    """They would be quantised again, and every pixel change."""
    with fits.open(write_image(tmp_path)) as file:
        tiled = fits.CompImageHDU(
            file["SCI"].data + np.random.default_rng(1).normal(size=(SIDE, SIDE)), file["SCI"].header
        )
        fits.HDUList([fits.PrimaryHDU(), tiled]).writeto(tmp_path / "tiled.fits")
    said = inject(
        tmp_path, tmp_path / "tiled.fits", at(90.0, 90.0, mag=[17.0]), write_psf(tmp_path), "--zeropoint", ZERO, code=2
    )
    assert "quantised again" in said


@pytest.mark.parametrize("step", [1.0, 0.5])
def test_stamps_lie_where_they_should_between_pixels(tmp_path, step):
    """Without noise: the centroid at tenths of a pixel, to a thousandth."""
    psf = read_psf(write_psf(tmp_path, sigma=1.5, step=step))
    for shift in (0.1, 0.2, 0.3, 0.4, 0.5):
        image = psf.at(50.0, 50.0).drawImage(nx=81, ny=81, scale=1.0, method="no_pixel", offset=(shift, 0.0)).array
        assert (image.sum(axis=0) @ np.arange(81)) / image.sum() - 40 == pytest.approx(shift, abs=1e-3)


def write_wide(folder, kind=np.float32, shape=(120, 260), level=50, name="wide.fits", **cards):
    """Write an image of other sides, wider than high."""
    header = fits.Header(list((wcs_cards() | {"BUNIT": "electron", "EXPTIME": TIME} | cards).items()))
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(np.full(shape, level, kind), header, "SCI")]).writeto(folder / name)
    return folder / name


def drawn_into(folder, path, columns, psf, **options):
    """Inject {name: values} into an image with the zero point ZERO; return (light as it is in it, truth)."""
    before = fits.getdata(path, "SCI").astype(float)
    run([path], columns, folder / "out", lambda text: None, psf=psf, zeropoint=ZERO, **options)
    truth = ObjectTable.read((folder / "out" / path.name).with_suffix(".truth.parquet"))
    return fits.getdata(folder / "out" / path.name, "SCI").astype(float) - before, truth


def test_the_truth_of_an_image_that_is_not_square(tmp_path):
    """A star at the far end of the long side and a galaxy near the top: each column as given or worked out."""
    psf, path = write_psf(tmp_path), write_wide(tmp_path)
    table = at(
        [250.3, 20.7, 131.0], [30.2, 110.4, 1500.0], mag=[15.0, 14.0, 12.0], id=[70, 80, 90], obj_type=[0, 1, 0],
        size_disk=[0.0, 0.3, 0.0], size_bulge=[0.0, 0.2, 0.0], bulge_frac=[0.0, 0.25, 0.0], e1=[0.0, 0.1, 0.0],
        e2=[0.0, -0.2, 0.0], kappa=[0.0, 0.05, 0.0],
    )  # fmt: skip
    light, truth = drawn_into(tmp_path, path, {name: np.array(table[name]) for name in table.colnames}, psf)
    assert truth["id"].tolist() == [70, 80] and truth["obj_type"].tolist() == [0, 1]
    assert truth["xImage"] == pytest.approx([251.3, 21.7], abs=1e-3)
    assert truth["yImage"] == pytest.approx([31.2, 111.4], abs=1e-3)
    assert truth["ra"] == pytest.approx(np.array(table["ra"][:2])) and truth["dec"] == pytest.approx(
        np.array(table["dec"][:2])
    )
    mag = np.array([15.0, 14.0 - 5 * np.log10(1 / 0.95)])
    assert truth["mag"] == pytest.approx(mag, abs=1e-6)
    assert truth["electrons"] == pytest.approx(TIME * 10 ** (0.4 * (ZERO - mag)), rel=1e-5)
    for name in ("size_disk", "size_bulge", "bulge_frac", "e1", "e2", "kappa"):
        assert truth[name] == pytest.approx(np.array(table[name][:2])), name
    assert light.sum() == pytest.approx(truth["drawn"].sum(), rel=1e-6)
    star = light[10:51, 230:]
    assert star.sum() == pytest.approx(truth["electrons"][0], rel=0.01)
    assert light[90:, :50].sum() > 0.5 * truth["electrons"][1]
    assert truth.meta["level0"] == "wide.fits" and truth.meta["realisation"] == "1"


@pytest.mark.parametrize("angle", [20.0, 115.0])
@pytest.mark.parametrize("names", [("e1", "e2"), ("gamma1", "gamma2")])
def test_shape_and_shear_lie_on_axes_of_the_sky(tmp_path, names, angle):
    """The second component is towards north-east, whatever way the image is turned; e = (a - b) / (a + b)."""
    e = 0.2 * np.exp(2j * np.radians(angle))
    table = at(100.0, 100.0, mag=[12.0], type=["galaxy"], size=[0.8], **{names[0]: [e.real], names[1]: [e.imag]})
    path = write_image(tmp_path, error=False)
    columns = {name: np.array(table[name]) for name in table.colnames}
    light, _ = drawn_into(tmp_path, path, columns, write_psf(tmp_path, sigma=0.6, step=0.3))
    matrix = np.array([[wcs_cards()[f"CD{i}_{j}"] for j in (1, 2)] for i in (1, 2)])  # deg east, north per px
    direction = np.linalg.inv(matrix) @ [np.cos(np.radians(angle)), np.sin(np.radians(angle))]
    _, _, xx, yy, xy = moments(light)
    found = np.degrees(0.5 * np.arctan2(2 * xy, xx - yy)) - np.degrees(np.arctan2(direction[1], direction[0]))
    assert (found + 90) % 180 - 90 == pytest.approx(0.0, abs=1.5)
    along, across = (0.5 * (xx + yy) + k * np.hypot(0.5 * (xx - yy), xy) - 0.6**2 for k in (1, -1))
    assert np.sqrt(across / along) == pytest.approx(0.8 / 1.2, rel=0.03)


def test_an_image_of_whole_numbers_is_rounded_and_ends_with_its_type(tmp_path):
    """Rounded, not cut: of nine units in a pixel half a unit would be 6%; photon noise is 0.2%."""
    psf = write_psf(tmp_path, sigma=12.0, step=2.0)
    path = write_wide(tmp_path, np.int16, level=32_000, BUNIT="adu", GAIN=7.0)
    table = at([70.0, 200.0], [60.0, 60.0], mag=[16.0, 9.0])
    light, truth = drawn_into(tmp_path, path, {name: np.array(table[name]) for name in table.colnames}, psf)
    faint = light[20:101, 30:111].sum() * 7.0
    inside = (1 - 2 * 0.000375) ** 2  # within 40.5 px of 12: 3.37 sigma
    assert faint == pytest.approx(truth["electrons"][0] * inside, rel=0.01)
    assert light.max() == 767 and (light == 767).sum() > 100


def test_light_is_added_in_the_units_of_the_image_and_to_its_errors(tmp_path):
    """Electrons a second of a gain that does not count; errors add in quadrature, in the same unit."""
    path, psf = write_image(tmp_path, BUNIT="electron/s", GAIN=3.0, EXPTIME=400.0), write_psf(tmp_path)
    table = at(60.0, 140.0, mag=[14.0])
    light, truth = drawn_into(tmp_path, path, {name: np.array(table[name]) for name in table.colnames}, psf)
    assert truth["electrons"][0] == pytest.approx(400 * 10 ** (0.4 * 11), rel=1e-6)
    assert light.sum() * 400 == pytest.approx(truth["drawn"][0], rel=1e-4)
    error = fits.getdata(tmp_path / "out/image.fits", "ERR").astype(float)
    bright = light > 5
    assert bright.sum() > 20 and error[bright] == pytest.approx(np.sqrt(25 + light[bright] / 400), rel=1e-5)
    assert (error[:100] == 5).all()


def test_pixels_that_are_full_already_stay(tmp_path):
    """At 70 of 60.25 a pixel keeps its value; one at 50 goes to 60.25, between whole electrons. Both count."""
    path = write_image(tmp_path, SATURATE=60.25, error=False)
    with fits.open(path, mode="update") as file:
        file["SCI"].data[120, 90] = 70.0
    table = at(90.0, 120.0, mag=[12.0])
    said = inject(tmp_path, path, table, write_psf(tmp_path), "--zeropoint", ZERO)
    new = fits.getdata(tmp_path / "out/image.fits", "SCI")
    assert new[120, 90] == 70.0 and new[120, 91] == 60.25
    full = int(" ".join(said.split()).split(" pixels are full")[0].split()[-1])
    assert full == np.count_nonzero(new >= 60.25) > 10


@pytest.mark.parametrize(
    ("names", "cards", "chosen"),
    [
        (("mag", "mag_f814w"), {}, "mag"), (("mag_f814w", "mag_f606w"), {}, "mag_f606w"),
        (("mag_f814w",), {}, "mag_f814w"), (("mag_f814w", "mag_g"), {}, None),
        (("mag_f814w", "mag_g"), {"FILTER": "G"}, "mag_g"),
    ],
)  # fmt: skip
def test_the_magnitude_is_the_images(tmp_path, names, cards, chosen):
    """17 mag of the wanted one, 20 of others."""
    path, psf = write_image(tmp_path, error=False, **cards), write_psf(tmp_path)
    table = at(90.0, 120.0)
    columns = {name: np.array(table[name]) for name in table.colnames}
    columns |= {name: np.array([17.0 if name == chosen else 20.0]) for name in names}
    if chosen is None:
        with pytest.raises(InputError, match=r"which magnitude is the image's.*mag_f814w, mag_g.*mag_f606w"):
            drawn_into(tmp_path, path, columns, psf)
    else:
        _, truth = drawn_into(tmp_path, path, columns, psf)
        assert truth["mag"].tolist() == [17.0]


def test_what_an_image_says_of_itself(tmp_path):
    """Each number from the first keyword that has one above 0, of the image before the primary."""
    path = write_image(tmp_path, EXPTIME=0.0, TEXPTIME="long", XPOSURE=30.0, EXPOSURE=40.0, GAIN=-1.0, EGAIN=1.5,
                       CCDGAIN=9.0, SATURATE=777.0)  # fmt: skip
    with fits.open(path) as file:
        file[0].header.update({"EXPTIME": 5.0, "FILTER2": "F1", "FILTER": "X"})
        cube = fits.ImageHDU(np.zeros((2, 3, 3), np.float32), name="SCI")
        first = fits.ImageHDU(np.zeros((2, 3), np.float32), name="ERR")
        file["SCI"].header["FILTER"] = "F606W"
        more = file["SCI"].copy()
        fits.HDUList([file[0], first, cube, file["SCI"], file["ERR"], more, more.copy()]).writeto(
            tmp_path / "many.fits"
        )
    found = read_foreign(tmp_path / "many.fits")
    assert (found.number, found.error_number, found.others) == (3, 4, 2)
    assert (found.exptime, found.electrons, found.full, found.band) == (30.0, 1.5, 777.0, "F606W")
    assert found.image.shape == (SIDE, SIDE) and found.error[0, 0] == 5 and found.zeropoint is None
    plain = write_wide(tmp_path, name="plain.fits")
    with fits.open(plain) as file:
        file["SCI"].name = "OTHER"
        file.writeto(tmp_path / "other.fits")
    other = read_foreign(tmp_path / "other.fits")
    assert (other.number, other.others, other.error, other.full, other.electrons) == (1, 0, None, np.inf, 1.0)
    for cards in ({"PHOTFLAM": 1e-19}, {"PHOTPLAM": 5000.0}):
        assert read_foreign(write_image(tmp_path, **cards)).zeropoint is None


def test_errors_of_pixels_without_a_value_may_be_anything(tmp_path):
    """Flagged ones by DQ, or NaN where there is none; an error of 0 is one."""
    path = write_image(tmp_path)
    with fits.open(path) as file:
        file["ERR"].data[3, 4], file["ERR"].data[5, 6] = np.nan, 0.0
        quality = np.zeros((SIDE, SIDE), np.int16)
        quality[3, 4] = 8
        fits.HDUList([*(hdu.copy() for hdu in file), fits.ImageHDU(quality, name="DQ")]).writeto(tmp_path / "dq.fits")
        file["SCI"].data[3, 4] = np.nan
        file.writeto(tmp_path / "nan.fits")
    for name in ("dq.fits", "nan.fits"):
        assert np.isnan(read_foreign(tmp_path / name).error[3, 4])
    for value in (-0.1, np.inf):
        with fits.open(tmp_path / "dq.fits", mode="update") as file:
            file["ERR"].data[7, 7] = value
        with pytest.raises(InputError, match="1 of the errors of good pixels"):
            read_foreign(tmp_path / "dq.fits")


def write_cube(folder, count, x, y, step=2.0, level=1.0, form="D"):
    """Write stamps of 5 x 5 with all flux in one pixel, each another, at FITS positions x, y."""
    cube = np.zeros((count, 5, 5), np.float32)
    cube[np.arange(count), np.arange(count) // 5, np.arange(count) % 5] = level
    places = fits.BinTableHDU.from_columns([fits.Column(n, form, array=np.array(v)) for n, v in (("X", x), ("Y", y))])
    fits.HDUList([fits.PrimaryHDU(cube, fits.Header({"PSFSAMP": step})), places]).writeto(
        folder / "cube.fits", overwrite=True
    )
    return folder / "cube.fits"


def test_stamps_are_mixed_of_the_four_nearest_by_the_square_of_their_distance(tmp_path):
    """FITS positions count from 1; of five stamps the farthest is not used; each has unit flux."""
    x, y = [11.0, 11.0, 31.0, 11.0, 200.0], [21.0, 61.0, 21.0, 121.0, 200.0]
    psf = read_psf(write_cube(tmp_path, 5, x, y, level=7.0))
    assert psf.step == 2.0 and psf.x.tolist() == [10.0, 10.0, 30.0, 10.0, 199.0]
    assert psf.stamps.sum(axis=(1, 2)) == pytest.approx(np.ones(5))
    mixed = psf.at(10.0, 30.0).image.array
    weight = 1 / np.array([10.0**2, 30.0**2, 20.0**2 + 10.0**2, 90.0**2])
    assert mixed[0, :4] == pytest.approx(weight / weight.sum(), rel=1e-6) and mixed[0, 4] == 0
    assert psf.at(10.0, 20.0).image.array[0, 0] == pytest.approx(1.0, abs=1e-9)
    assert psf.at(10.0, 30.0).flux == pytest.approx(1.0) and psf.at(10.0, 30.0).image.scale == 2.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"step": 0.0}, "PSFSAMP: not a sampling step"), ({"step": "half"}, "PSFSAMP: not a sampling step"),
        ({"x": [1.0], "y": [2.0]}, "X, Y: stamps without a position for each"), ({"level": 0.0}, "a stamp has no flux"),
        ({"level": np.nan}, "a stamp has no flux"),
        ({"x": [1.0, np.nan]}, r"cube.fits: X, Y, row 2: not a stamp's position \(got 'nan, 2.0'\)"),
        ({"y": [-np.inf, 2.0]}, r"cube.fits: X, Y, row 1: not a stamp's position \(got '1.0, -inf'\)"),
        ({"x": [1e200, 1e200]}, r"X, Y, row 1: not a stamp's position \(got '1e\+200, 1.0'\)"),
        ({"x": ["a", "b"], "y": ["1", "2"], "form": "4A"}, r"X, Y, row 1: not a stamp's position \(got 'a, 1'\)"),
    ],
)  # fmt: skip
def test_stamps_that_cannot_be_used_are_refused(tmp_path, change, words):
    given = {"x": [1.0, 2.0], "y": [1.0, 2.0]} | change
    with pytest.raises(InputError, match=words):
        read_psf(write_cube(tmp_path, 2, **given))


@pytest.mark.parametrize(
    ("stamp", "step"),
    [
        (gaussian(2.0), 0.1), (gaussian(2.0), 0.2), (gaussian(2.0, 9), 1e-6), (gaussian(2.0), 0.25),
        (np.ones((5, 5)), 0.3), (gaussian(9.0, 31), 0.3), (np.roll(gaussian(3.2, 41), (2, 2), (0, 1)), 0.125),
    ],
)  # fmt: skip
def test_stamps_that_do_not_keep_the_flux_are_refused(tmp_path, stamp, step):
    """The stated error is that of sums of drawn pixels, at nine places in a pixel. The last has none at the first."""
    model = Stamps(stamp[None] / stamp.sum(), np.zeros(1), np.zeros(1), step).at(0.0, 0.0)
    phases = 0.0, 1 / 3, 2 / 3
    drawn = [
        model.drawImage(nx=41, ny=41, scale=1.0, method="no_pixel", offset=(x, y), dtype=float).array.sum()
        for x in phases for y in phases
    ]  # fmt: skip
    error = 100 * np.abs(np.array(drawn) - 1).max()
    assert error > 2
    said = "PSFSAMP: the flux of a star would be wrong by ([^%]*)%: the stamps are narrower than a pixel, do not"
    with pytest.raises(InputError, match=said) as caught:
        read_psf(write_stamp(tmp_path, stamp, step))
    assert float(caught.value.message.split("by ")[1].split("%")[0]) == pytest.approx(error, rel=0.01)


@pytest.mark.parametrize(
    ("stamp", "step"),
    [
        (in_pixel(gaussian(2.0), 9), 1 / 9), (in_pixel(gaussian(0.3), 5), 0.2), (gaussian(3.0), 0.25),
        (gaussian(0.3), 1.0), (gaussian(1.0), 2.0), (gaussian(1.0), 1e9), (gaussian(4.0)[:, :30], 0.25),
    ],
)  # fmt: skip
def test_stamps_with_the_response_of_a_pixel_keep_the_flux(tmp_path, stamp, step):
    """However sharp the PSF is. So do wide stamps without it: a Gaussian of 0.75 px has 3e-5 at one cycle a pixel."""
    assert read_psf(write_stamp(tmp_path, stamp, step)).stamps.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("share", "refused"), [(0.04, False), (0.06, True), (0.97, True)])
def test_stamps_that_are_negative_are_refused(tmp_path, share, refused):
    stamp = gaussian(2.0, 61)
    stamp -= share * np.roll(stamp, 20, axis=0)
    path = write_stamp(tmp_path, stamp, 1.0)
    if refused:
        with pytest.raises(InputError, match=f"stamp.fits: --psf: too much flux in negative.*got '{share:.1%}"):
            read_psf(path)
    else:
        assert read_psf(path).stamps.min() < 0


def test_a_psf_file_states_its_filter_or_none(tmp_path):
    psf = write_psf(tmp_path, FILTER="F606W ")
    assert read_psf(psf, "f606w").step == 0.5 and read_psf(psf).x.tolist() == [0.0]
    fits.PrimaryHDU().writeto(tmp_path / "nothing.fits")
    with pytest.raises(InputError, match="neither a model of PSFEx nor stamps"):
        read_psf(tmp_path / "nothing.fits")
    plain = fits.PrimaryHDU(np.ones((5, 5), np.float32))
    plain.writeto(tmp_path / "plain.fits")
    assert read_psf(tmp_path / "plain.fits").step == 1.0
