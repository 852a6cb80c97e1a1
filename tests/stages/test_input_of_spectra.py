"""What extract hands to the extraction of a slitless frame, against spectra drawn with numpy; no chain is run."""

from functools import cached_property
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from astropy.io import fits
from measure.slitless import GaussianPsf, draw

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.sections import ContaminationConfig
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.light.colours import colour_spectra
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.measure.spectra.contamination import expected_orders
from csstsim.measure.spectra.extract import DispersedImage
from csstsim.stages import extract, select
from csstsim.stages.render import object_spectra

OBSID, CHIP = "10100000001", 2
WINDOW = Window(3100, 4300, 4100, 4220)
PLACES = np.array([2650.3, 4700.6]), np.array([4140.2, 4185.7])  # one in front of either grating


class Psf(GaussianPsf):
    """A Gaussian star that notes where it is asked for."""

    def __init__(self, wavelength):
        self.wavelength, self.asked = wavelength, []

    def at(self, x, y):
        self.asked.append((x, y))
        return super().at(x, y)


class Scene:
    """Two stars, 17 and 19 mag in i, in an exposure of the shipped camera; what a finished chip would leave."""

    def __init__(self, folder):
        content = {
            "schema_version": 1, "name": "spectra", "seed": 5, "output": str(folder / "out"),
            "survey_table": str(SHIPPED.parent / "survey_tables" / "demo.csv"), "psf": {"grid": 2},
            "window": dict(zip(("x0", "x1", "y0", "y1"), (3100, 4300, 4100, 4220), strict=True)),
            "select": {"types": ["SCIE"], "chips": [CHIP], "obsids": [OBSID]},
        }  # fmt: skip
        file = folder / "campaign.yaml"
        file.write_text(yaml.safe_dump(content))
        job = OpenCampaign(file).job(OBSID, CHIP)
        ra, dec = icrs(*job.wcs.pixel_to_world(*PLACES), job.observer)
        columns = {"ra": ra.tolist(), "dec": dec.tolist(), "mag_i": [17.0, 19.0]}
        catalog = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"columns": columns}}
        file.write_text(yaml.safe_dump(content | {"catalog": catalog}))
        self.run = OpenCampaign(file)
        self.job = self.run.job(OBSID, CHIP)
        self.psf = Psf(self.run.camera.filters[self.job.chip.filter].psf_wavelength)

    @cached_property
    def truth(self):
        return select.selected(self.run, self.job.exposure)

    @cached_property
    def orders(self):
        rows, (x, y) = np.arange(2), (np.asarray(self.truth[axis], float) for axis in "xy")
        spectra = object_spectra(self.run, self.job, self.truth)
        table = expected_orders(rows, x, y, spectra, self.run.disperser(self.job), self.job.pointing.exptime)
        return ObjectTable(table.with_columns(id=self.truth["id"][table["row"]]), {"recipe": self.run.recipe(self.job)})

    def drawn(self, rows=(0, 1)):
        """Return the electrons of all orders of some stars, (ny, nx)."""
        image, gratings = np.zeros(WINDOW.shape), self.run.camera.gratings[CHIP]
        mags = np.full((2, len(self.run.camera.bands)), np.nan)
        mags[:, list(self.run.camera.bands).index("i")] = 17.0, 19.0
        spectra = colour_spectra(mags, list(self.run.camera.bands.values()))
        for k in range(len(self.orders)):
            if self.orders["row"][k] in rows:
                draw(image, WINDOW, gratings, self.orders, spectra[self.orders["row"][k]], k)
        return image


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return Scene(tmp_path_factory.mktemp("spectra"))


@pytest.fixture
def given(scene, monkeypatch):
    """A function that returns the input of the extraction with a ContaminationConfig."""
    zeros = np.zeros(WINDOW.shape, np.float32)
    calibrated = SimpleNamespace(
        electrons=zeros, marks=zeros.astype(np.uint8), response="R", read_noise={1: 4.0, 2: 6.0}
    )
    file = SimpleNamespace(header0={"TRUTHASH": scene.truth.meta["truth_hash"]})
    monkeypatch.setattr(extract, "calibrated_frame", lambda run, job: (file, calibrated))
    monkeypatch.setattr(extract, "truth_of", lambda run, job: scene.truth)
    monkeypatch.setattr(extract, "open_psf", lambda run, chip: scene.psf)
    monkeypatch.setattr("csstsim.io.orders.read_orders", lambda path: scene.orders)
    monkeypatch.setattr("csstsim.optics.scatter.scattered_light.read_scattered", lambda psf: SimpleNamespace(wing=None))
    return lambda *settings: extract.spectra_of_frame(scene.run, scene.job, *settings)


def test_the_light_of_all_is_that_of_the_orders_drawn_one_by_one(scene, given):
    """Electrons of the whole exposure, 0.1% in all; the PSF is that of the middle of the window."""
    made = given()
    assert scene.psf.asked == [(3700.0, 4160.0)]
    assert (made.frame.read_noise, made.frame.response, made.wing) == (5.0, "R", None)
    assert made.frame.subtract is True and made.frame.image_of_one is None and made.psf is scene.psf
    found, wanted = made.frame.others(faintest=0.0), scene.drawn()
    assert wanted.sum() > 1e5 and found.sum() == pytest.approx(wanted.sum(), rel=1e-3)
    columns = [plane.sum(axis=0).reshape(12, 100).sum(axis=1) for plane in (found, wanted)]
    np.testing.assert_allclose(*columns, rtol=2e-3, atol=1e-4 * wanted.sum())


def test_the_light_of_a_catalogue_is_that_of_its_objects_and_of_each_alone(scene, given):
    """Of the brighter star alone, the other lies beyond the depth; what is asked for comes before the campaign's."""
    made = given(ContaminationConfig(known_from="catalogue", depth=18.0, subtract=False))
    assert made.frame.subtract is False
    bright = scene.drawn([0])
    assert made.frame.others(faintest=0.0).sum() == pytest.approx(bright.sum(), rel=1e-3)
    for row, known in ((0, True), (1, False)):
        first = (scene.orders["row"] == row) & (scene.orders["order"] == 1)
        alone = made.frame.image_of_one(scene.orders.take(first), WINDOW, 0.0)
        assert bool(alone.any()) is known
    assert len(made.orders) == len(scene.orders)  # all are extracted


def test_orders_of_another_frame_are_refused(scene, given, monkeypatch):
    other = ObjectTable(scene.orders, {"recipe": scene.run.recipe(scene.job) | {"layers": "z" * 16}})
    monkeypatch.setattr("csstsim.io.orders.read_orders", lambda path: other)
    with pytest.raises(InputError):
        given()


@pytest.mark.parametrize(("settings", "known"), [
    ({}, "truth"), ({"known_from": "catalogue"}, "bands of the truth"),
    ({"known_from": "catalogue", "table": "/there/a.csv"}, "/there/a.csv"),
])  # fmt: skip
def test_the_image_of_the_light_says_where_it_is_and_what_is_left_out(scene, tmp_path, settings, known):
    image = np.arange(WINDOW.ny * WINDOW.nx, dtype=np.float32).reshape(WINDOW.shape)
    asked = []
    sky = np.full(WINDOW.shape, 75.0, np.float32)
    frame = DispersedImage(
        WINDOW, sky, np.zeros(WINDOW.shape, np.uint8), None, 5.0, lambda faintest: asked.append(faintest) or image
    )
    path = tmp_path / "light.fits"
    extract._write_image(path, scene.run, scene.job, frame, ContaminationConfig(**settings))
    with fits.open(path, checksum=True) as file:
        assert (file[0].header["OBSID"], file[0].header["CHIP"], file[0].header["KNOWN"]) == (OBSID, CHIP, known)
        header = file["LIGHT"].header
        assert np.array_equal(file["LIGHT"].data, image)
    assert (header["X0"], header["Y0"], header["BUNIT"]) == (3100, 4100, "electron")
    assert asked == [frame.faintest] and header["FAINTEST"] == pytest.approx(0.1 * np.sqrt(75.0 + 25.0))
