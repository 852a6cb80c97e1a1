"""Twenty exposures of a field in which a star varies, a star moves and an asteroid passes: pixels to merged sources."""

import csv

import healpy
import numpy as np
import pytest
from support.all_products import BRICK
from support.mini_campaign import write_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import apparent, icrs
from csstsim.catalog.table import ObjectTable
from csstsim.io.truth import read_truth
from csstsim.measure.bricks.motion import SOLAR, STAR
from csstsim.stages import chip as chip_stage
from csstsim.stages import measure as measure_stage
from csstsim.stages import merge as merge_stage

pytestmark = pytest.mark.thorough

CHIP, EXPTIME = 9, 150.0
MINUTES = np.r_[0.0, 3.0, 6.0, 1440 * np.linspace(20, 360, 17)]  # from the first exposure: an asteroid passes in three
PERIOD, AMPLITUDE, PHASE = 0.377, 0.4, 0.13
RATE, ANGLE = 30.0, np.radians(35.0)  # arcsec / hour, north through east
MOTION = np.array([700.0, -500.0])  # mas / yr
START = np.datetime64("2027-06-20T01:08:00")


def rows(scale, first):
    """The catalogue: places in arcsec (east, north) from the middle, magnitudes, and what changes."""
    years = (first - 51544.5) / 365.25
    rest = [(x * scale, y * scale) for x, y in ((-3.4, -3.4), (3.4, -3.4), (-3.4, 3.4), (3.4, 3.4), (0.2, -3.3))]
    made = [{"east": e, "north": n, "mag_r": 20.0} for e, n in rest]
    made.append({
        "east": -2.6 * scale, "north": 0.4 * scale, "mag_r": 20.0, "var_period": PERIOD, "var_amplitude": AMPLITUDE,
        "var_phase": PHASE,
    })  # fmt: skip
    made.append({
        "east": 0.5 * scale - MOTION[0] / 1000 * years, "north": -1.2 * scale - MOTION[1] / 1000 * years, "mag_r": 20.0,
        "pmra": MOTION[0], "pmdec": MOTION[1],
    })  # fmt: skip
    made.append({
        "east": 0.8 * scale, "north": 1.2 * scale, "mag_r": 20.5, "rate_ra": RATE * np.sin(ANGLE),
        "rate_dec": RATE * np.cos(ANGLE), "rate_mjd": first + (3.0 + EXPTIME / 120) / 1440,
    })  # fmt: skip
    return made


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """The campaign after merge: (run, its jobs, middle)."""
    folder = tmp_path_factory.mktemp("changing")
    ra, dec = healpy.pix2ang(256, BRICK, nest=True, lonlat=True)
    names = ["scie_obs", "sky_background", "poisson_and_dark", "prescan_overscan", "bias", "readout_noise", "gain"]
    (folder / "science.yaml").write_text(str({"layers": [*({n: {}} for n in names), {"quantization_and_output": {}}]}))
    times = [str(START + np.timedelta64(round(60 * m), "s")) for m in MINUTES]
    obsids = [f"1010000{i:04d}" for i in range(1, len(times) + 1)]
    catalog = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": "objects.csv"}}
    how = {"observations": {"SCIE": str(folder / "science.yaml")}, "catalog": catalog, "select": {"chips": [CHIP]}}

    def opened(places):
        rows = [
            f"{o},SCIE,{a:.8f},{d:.8f},20.0,{t},{EXPTIME:g}" for o, t, (a, d) in zip(obsids, times, places, strict=True)
        ]
        return OpenCampaign(write_campaign(folder, rows, **how))

    (folder / "objects.csv").write_text("ra,dec,mag_r\n0,0,20\n")
    run = opened([(ra, dec)] * len(times))
    crafts = [run.maps(run.pointings[obsid], run.camera.chips[CHIP])[1] for obsid in obsids]
    run = opened([apparent(ra, dec, craft) for craft in crafts])
    job = run.job(obsids[0], CHIP)
    middle = icrs(*job.wcs.pixel_to_world(63.5, 63.5), job.observer)
    table = rows(1.0, job.pointing.mjd)
    names = list(dict.fromkeys(name for row in table for name in row if name not in ("east", "north")))
    with open(folder / "objects.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["ra", "dec", *names])
        for row in table:
            place = middle[0] + row["east"] / 3600 / np.cos(np.radians(middle[1])), middle[1] + row["north"] / 3600
            writer.writerow([*(f"{v:.10f}" for v in place), *(row.get(name, "") for name in names)])
    run = opened([apparent(ra, dec, craft) for craft in crafts])
    jobs = [run.job(obsid, CHIP) for obsid in obsids]
    for job in jobs:
        chip_stage.chip(run, job, log=str)
        measure_stage.measure(run, job)
    for pix in run.merge_bricks:
        merge_stage.merge(run, pix)
    return run, jobs, middle


def nearest(table, ra, dec, within=0.3):
    """The row of a measured table nearest to a place; None beyond `within` arcsec."""
    off = 3600 * np.hypot((table["ra"] - ra) * np.cos(np.radians(dec)), table["dec"] - dec)
    row = int(np.argmin(off))
    return row if off[row] < within else None


def test_a_variable_star_follows_its_light_curve(field):
    """20 epochs: measured magnitudes less the sine, in units of their errors; the truth says the sine itself."""
    run, jobs, _ = field
    pulls, told, constant, sines = [], [], [], []
    for job in jobs:
        truth = read_truth(run.paths.level0_truth(job))
        measured = measure_stage.measured_table(run, job)
        middle = job.pointing.mjd + 0.5 * EXPTIME / 86400
        sine = AMPLITUDE * np.sin(2 * np.pi * (middle / PERIOD + PHASE))
        sines.append(sine)
        row = int(np.flatnonzero(truth["id"] == 6)[0])
        told.append(truth["mag"][row] - 20.0 - sine)
        assert truth["dmag"][row] == pytest.approx(sine, abs=1e-4)
        at = nearest(measured, truth["ra_epoch"][row], truth["dec_epoch"][row])
        pulls.append((measured["mag_psf"][at] - 20.0 - sine) / measured["mag_psf_err"][at])
        other = int(np.flatnonzero(truth["id"] == 1)[0])
        at = nearest(measured, truth["ra_epoch"][other], truth["dec_epoch"][other])
        constant.append(measured["mag_psf"][at])
    assert np.abs(told).max() < 1e-3
    pulls = np.array(pulls)
    assert len(pulls) == 20 and np.abs(pulls).max() < 5 and 0.4 < pulls.std() < 1.8, pulls
    assert np.std(constant) < 0.02 < np.std(sines)


def test_each_is_one_source(field):
    """Five stars at rest, the variable one, the moving one with its motion, the asteroid with its rate."""
    run, jobs, _ = field
    (pix,) = run.merge_bricks
    sources = ObjectTable.read(run.paths.merge(pix))
    assert len(sources) == 8
    assert np.bincount(sources["motion"], minlength=3).tolist() == [6, 1, 1]
    seen = [
        len(set(obsids)) for obsids in ObjectTable.read(run.paths.merge(pix), ["detection_obsid"])["detection_obsid"]
    ]
    assert sorted(seen) == [3, *[20] * 7]
    star = int(np.flatnonzero(sources["motion"] == STAR)[0])
    assert np.hypot(sources["pmra"][star] - MOTION[0], sources["pmdec"][star] - MOTION[1]) < 30.0  # mas / yr
    rock = int(np.flatnonzero(sources["motion"] == SOLAR)[0])
    rate = np.array([sources["pmra"][rock], sources["pmdec"][rock]]) / 1000 / 365.25 / 24  # arcsec / hour
    assert rate == pytest.approx(RATE * np.array([np.sin(ANGLE), np.cos(ANGLE)]), abs=1.0)
    trails = [read_truth(run.paths.level0_truth(job)) for job in jobs[:3]]
    for truth in trails:
        row = int(np.flatnonzero(truth["id"] == 8)[0])
        assert truth["trail_length"][row] == pytest.approx(
            RATE * EXPTIME / 3600, rel=0.02
        )  # the shutter takes up to 2 %
        assert truth["trail_angle"][row] == pytest.approx(35.0, abs=0.01)
