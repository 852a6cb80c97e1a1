"""GalSim objects of a catalogue's class: images of them, what the truth says of these, and what is refused."""

from pathlib import Path

import galsim
import numpy as np
import pytest
from astropy.io import fits
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.galaxy_shapes.galsim_images import BLUR, SCALE, SIDE, image_of
from csstsim.catalog.mock_object import MockObject

REGION = Region((10.0, 11.0, 11.0, 10.0), (0.0, 0.0, 1.0, 1.0), (0,), BANDS)
LIGHT, SIZE = 2e-3, 3e-3


class Shapes(CatalogBase):
    """Galaxies drawn as the GalSim objects of the option `shapes`; None: as a disk."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        for k, _ in enumerate(self.options["shapes"]):
            self.objs.append(MockObject(id=k, type=self.options.get("type", "galaxy"), ra=10.5, dec=0.5, size_disk=0.3))

    def load_sed(self, obj):
        raise NotImplementedError

    def galsim_object(self, obj):
        return self.options["shapes"][obj.id]


def table(folder, *shapes, **more):
    return Shapes({"shapes": shapes, "images": str(folder)} | more, REGION).table


def moments(name, scale):
    """Return (light, east, north, mean square radius [arcsec]) of an image, north up and east left."""
    pixels = fits.getdata(name).astype(float)
    rows, columns = np.mgrid[: pixels.shape[0], : pixels.shape[1]]
    north, east = (rows - (pixels.shape[0] - 1) / 2) * scale, -(columns - (pixels.shape[1] - 1) / 2) * scale
    light = pixels.sum()
    x, y = (east * pixels).sum() / light, (north * pixels).sum() / light
    return light, x, y, (((east - x) ** 2 + (north - y) ** 2) * pixels).sum() / light


def test_light_place_and_size_of_an_image(tmp_path):
    """Of a Gaussian, whose mean square radius is 2 sigma^2; x is to the east; a pixel adds a sixth of its square."""
    made = table(tmp_path, galsim.Gaussian(sigma=0.3, flux=7.0).shift(0.2, -0.1), None, galsim.DeltaFunction())
    light, east, north, size = moments(made["image_file"][0], made["image_scale"][0])
    assert light == pytest.approx(1.0, abs=LIGHT) and [east, north] == pytest.approx([0.2, -0.1], abs=LIGHT)
    assert size == pytest.approx(2 * 0.3**2 + SCALE**2 / 6, rel=2 * SIZE)
    assert made["user_galsim_lost"][0] == pytest.approx(1 - light, abs=1e-6)
    assert made["user_galsim_blur"][0] == 0
    assert (
        made["image_file"][1] == ""
        and np.isnan(made["user_galsim_lost"][1])
        and made["size_disk"][1] == np.float32(0.3)
    )
    point = moments(made["image_file"][2], made["image_scale"][2])
    assert made["user_galsim_blur"][2] == pytest.approx(BLUR)
    assert point[3] == pytest.approx(2 * BLUR**2 + SCALE**2 / 6, rel=0.2)  # of 49 pixels


def test_an_object_of_far_wings_says_what_is_lost(tmp_path):
    made = table(tmp_path, galsim.DeVaucouleurs(half_light_radius=1.0))
    pixels = fits.getdata(made["image_file"][0])
    assert max(pixels.shape) <= SIDE and made["image_scale"][0] >= np.float32(SCALE)
    aperture = galsim.DeVaucouleurs(half_light_radius=1.0)
    half = pixels.shape[0] * made["image_scale"][0] / 2
    beyond = 1 - (2 * np.pi * np.trapezoid(
        [r * aperture.xValue(r, 0) for r in np.linspace(1e-6, half, 200_000)], np.linspace(1e-6, half, 200_000)
    ))  # of a circle in the square  # fmt: skip
    assert 0 < made["user_galsim_lost"][0] < beyond + 2e-3 and beyond < 0.02


def test_an_image_is_drawn_once(tmp_path):
    shape = galsim.Sersic(1.5, half_light_radius=0.3)
    one = table(tmp_path, shape)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    again = table(tmp_path, galsim.Sersic(1.5, half_light_radius=0.3), shape.withFlux(9.0))
    assert set(again["image_file"].tolist()) == set(one["image_file"].tolist())
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before
    table(tmp_path, shape.shear(g1=0.1, g2=0.0))
    assert len(list(tmp_path.iterdir())) == 2


def test_a_row_without_an_object_keeps_its_own_image(tmp_path):
    """Beside a row with an object, whose image replaces what the row has."""
    own = np.zeros((5, 5), np.float32)
    own[2, 2] = 1.0
    fits.PrimaryHDU(own).writeto(tmp_path / "own.fits")

    class Mixed(Shapes):
        def _load(self):
            super()._load()
            self.objs = [
                MockObject(**obj.values, image_file=str(tmp_path / "own.fits"), image_scale=0.25) for obj in self.objs
            ]

    made = Mixed({"shapes": [galsim.Gaussian(sigma=0.3), None], "images": str(tmp_path / "made")}, REGION).table
    assert made["image_file"][1] == str(tmp_path / "own.fits") and made["image_scale"].tolist() == [
        np.float32(SCALE), 0.25
    ]  # fmt: skip
    assert np.isnan(made["user_galsim_lost"][1]) and made["image_file"][0].startswith(str(tmp_path / "made"))


def test_an_image_that_was_not_written_to_its_end_is_no_image(tmp_path, monkeypatch):
    """A disk that is full after 100 bytes: the folder has no file that a later run would take."""

    def full(hdu, name, **options):
        Path(name).write_bytes(b"SIMPLE  =" + 91 * b" ")
        raise OSError("No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(fits.PrimaryHDU, "writeto", full)
        with pytest.raises(OSError, match="No space left"):
            image_of(galsim.Gaussian(sigma=0.3), tmp_path, "here")
    assert not list(tmp_path.glob("*.fits"))
    made = image_of(galsim.Gaussian(sigma=0.3), tmp_path, "here")
    assert fits.getdata(made["image_file"]).sum() == pytest.approx(1.0, abs=LIGHT)


@pytest.mark.parametrize("shape, message", [
    (3.0, "Shapes.galsim_object, object 0: returned an object that cannot be rendered .*float"),
    (galsim.Gaussian(sigma=1.0, flux=-1.0), "object 0: returned an object that cannot be rendered"),
    (galsim.Kolmogorov(fwhm=3000.0), None),
])  # fmt: skip
def test_what_cannot_be_drawn_is_refused(tmp_path, shape, message):
    if message is None:
        assert image_of(shape, tmp_path, "here")["image_scale"] > SCALE
        return
    with pytest.raises(InputError, match=message):
        table(tmp_path, shape)
    assert not list(tmp_path.iterdir())


def test_only_galaxies_have_shapes_and_faults_of_the_class_are_named(tmp_path):
    with pytest.raises(InputError, match="Shapes: type: row 1: only a galaxy has an image"):
        table(tmp_path, galsim.Gaussian(sigma=0.3), type="star")

    class Faulty(Shapes):
        def galsim_object(self, obj):
            return 1 / 0

    with pytest.raises(InputError, match=r"Faulty\.galsim_object, object 0: ZeroDivisionError"):
        _ = Faulty({"shapes": [None], "images": str(tmp_path)}, REGION).table
