"""A table with a galaxy of each kind through select, render, readout and level0, stage by stage, and its truth."""

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from support.commands import done
from support.mini_campaign import POINTINGS, SKY, write_campaign

import csstsim
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.open import TABLE_KIND
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth
from csstsim.measure.bricks.validation.whole_objects import whole_objects

pytestmark = pytest.mark.thorough

OBSID, CHIP = "10100000001", 9
SIGMA, EDGE = 5.0, 0.03  # the share of light that falls off so small a chip


def test_a_galaxy_of_each_kind_from_a_table_to_its_truth(tmp_path):
    """Electrons in the truth are those of the magnitudes; parts have their own rows, and together their object's light.

    By separate commands, so the select table has passed through a file; `chip` then makes the same bits in memory.
    """
    job = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1])).job(OBSID, CHIP)
    x, y = np.array([40.0, 90.0, 40.0, 90.0]), np.array([35.0, 35.0, 95.0, 95.0])
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    axis = np.arange(41) - 20
    fits.writeto(tmp_path / "blob.fits", np.exp(-0.5 * (axis**2 + axis[:, None] ** 2) / 16.0))
    Table({"WAVELENGTH": [3000.0, 10000.0], "FLUX": [1.0, 2.0]}).write(tmp_path / "red.csv")
    blank = np.nan
    Table({
        "id": [1, 2, 3, 4, 5], "ra": [*ra, blank], "dec": [*dec, blank], "type": ["galaxy"] * 5,
        "mag_r": [19.0, 19.0, 19.0, 19.0, blank], "size": [0.2, 0.3, blank, 0.3, 0.1], "n": [2.5, 1.0, 1.0, 1.0, 3.3],
        "knots": [0, 8, 0, 0, 0], "knots_frac": [0.0, 0.5, 0.0, 0.0, 0.0], "part_of": [blank] * 4 + [4],
        "image_file": ["", "", "blob.fits", "", ""], "image_scale": [blank, blank, 0.05, blank, blank],
        "part_share": [blank] * 4 + [0.25], "offset_ra": [blank] * 4 + [0.2], "gamma1": [0.02] * 4 + [blank],
        "spectrum_file": ["red.csv", "", "", "", ""],
    }).write(tmp_path / "objects.ecsv")  # fmt: skip
    catalog = {"kind": TABLE_KIND, "options": {"file": str(tmp_path / "objects.ecsv")}}
    file = write_campaign(tmp_path, POINTINGS[:1], catalog=catalog)
    done("psf", file, "--chip", CHIP)
    for stage in ("select", "render", "readout", "level0"):
        done(stage, file, "--obsid", OBSID, "--chip", CHIP)
    run = OpenCampaign(file)
    job = run.job(OBSID, CHIP)
    truth, image = read_truth(run.paths.level0_truth(job)), read_level0(run.paths.level0(job)).assembled()
    assert truth["image_file"].tolist() == ["", "", "blob.fits", "", ""]
    assert truth["part_of"].tolist() == [-1, -1, -1, -1, 4] and set(truth["method"]) <= {"photons", "stamp"}
    whole = whole_objects(truth)
    wanted = whole["electrons"]
    assert wanted == pytest.approx(np.full(4, wanted[1]), rel=2e-3)  # by their magnitude in r, whatever the spectrum
    assert whole["drawn"] == pytest.approx(wanted, abs=EDGE * wanted[0] + SIGMA * np.sqrt(wanted[0]))
    assert truth["electrons"][4] == pytest.approx(0.25 * wanted[3], rel=1e-4)
    shift = np.hypot(truth["x"][4] - truth["x"][3], truth["y"][4] - truth["y"][3])
    assert shift == pytest.approx(0.2 * 1.02 / 0.074, rel=0.01)  # moved by the lens, too
    for path in (run.paths.level0(job), run.paths.level0_truth(job)):
        path.unlink()
    done("chip", file, "--obsid", OBSID, "--chip", CHIP)
    assert np.array_equal(read_level0(run.paths.level0(job)).assembled(), image)


def test_the_embedded_sky_with_all_components_has_the_same_light(tmp_path):
    """The same objects and electrons as with simple ones, from the same truth bricks; other profiles, and knots."""
    geometry, sims = {"nx": 512, "ny": 512, "channel_nx": 64, "channel_ny": 256}, {}
    for kind in ("simple", "full"):
        file = write_campaign(tmp_path, POINTINGS[:1], geometry, catalog=SKY | {"components": kind})
        truth = csstsim.Simulation(file).light(OBSID, CHIP).truth
        # Off the chip, an object may reach it with one profile and not with the other
        on = (np.abs(truth["xImage"] - 256.5) < 255) & (np.abs(truth["yImage"] - 256.5) < 255)
        sims[kind] = truth[on]
    simple, full = sims["simple"], sims["full"]
    assert len(simple) > 5 and simple["obj_ID"].tolist() == full["obj_ID"].tolist()
    assert np.asarray(simple["electrons"]) == pytest.approx(np.asarray(full["electrons"]), rel=1e-6)
    assert simple["flags"].tolist() == full["flags"].tolist()
    assert "n_bulge" not in simple.colnames
    forming = np.asarray((full["knots"] > 0) & (simple["bulge_frac"] > 0.02))
    assert forming.any() and (full["bulge_frac"][forming] != simple["bulge_frac"][forming]).all()  # in their band
    quiet = np.asarray(full["knots"] == 0)
    assert np.asarray(full["bulge_frac"])[quiet] == pytest.approx(np.asarray(simple["bulge_frac"])[quiet], abs=1e-6)
    assert len(np.unique(full["n_bulge"])) > 3 and (full["knots"] > 0).any()
