"""One field half a year apart: aberration moves the stars to other pixels, but their sky positions agree."""

import json

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, ICRS, CartesianRepresentation, SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS
from support.commands import done
from support.mini_campaign import HEADER, write_scene

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.camera import load_camera
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth

pytestmark = pytest.mark.thorough

CHIP, SIDE = 9, 1024
OBSIDS = ("10100000001", "10100000002")
SEASONS = [
    f"{o},SCIE,60.0,-40.0,20.0,{t},150"
    for o, t in zip(OBSIDS, ("2027-02-10T01:08:00", "2027-08-08T13:20:00"), strict=True)
]
SHIFT_PX = (-340.0, 284.0)  # roughly, so that the stars are on the chip in both seasons
PLACE_PX, SCALE = 0.02, 0.074


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Sixteen stars measured in both seasons, merged and validated; every other one moves."""
    folder = tmp_path_factory.mktemp("seasons")
    geometry = {"nx": SIDE, "ny": SIDE, "channel_nx": SIDE // 8, "channel_ny": SIDE // 2}
    rng, line = np.random.default_rng(4), np.linspace(-120, 120, 4)
    x, y = (
        v.ravel() + rng.uniform(-0.5, 0.5, 16) + (SIDE - shift) / 2
        for v, shift in zip(np.meshgrid(line, line), SHIFT_PX, strict=True)
    )
    camera = load_camera(SHIPPED / "instrument")
    mag = camera.filters["r"].zeropoint(camera.telescope) - 2.5 * np.log10(2.2e5 / 150)
    shipped = (SHIPPED / "observations" / "science.yaml").read_text()
    (folder / "science.yaml").write_text(shipped.replace("sip: false", "sip: true"))  # a header that astropy can trust
    observations = {"SCIE": str(folder / "science.yaml")}
    path = write_scene(folder, "Movers", x, y, mag, CHIP, SEASONS[0], geometry=geometry, observations=observations)
    (folder / "table.csv").write_text("\n".join([HEADER, *SEASONS]) + "\n")
    opened = OpenCampaign(path)
    for obsid in OBSIDS:
        for verb in ("chip", "measure"):
            done(verb, path, "--obsid", obsid, "--chip", CHIP)
    for pix in opened.merge_bricks:
        for verb in ("merge", "validate"):
            done(verb, path, "--brick", pix)
    return opened


def products(campaign, obsid):
    """(truth, measured table, Level0 file) of a season; the measured rows in the order of the truth."""
    job = campaign.job(obsid, CHIP)
    truth = read_truth(campaign.paths.level0_truth(job))
    truth = truth.take(np.argsort(truth["id"]))
    found = ObjectTable.read(campaign.paths.measure(obsid, CHIP))
    row = [np.hypot(found["x"] - x, found["y"] - y).argmin() for x, y in zip(truth["x"], truth["y"], strict=True)]
    return truth, found.take(row), read_level0(campaign.paths.level0(job))


def astropy_pixels(file, truth):
    """Pixels in which astropy, with nothing but the file's headers, expects the catalogue's places."""
    first = file.header0
    state = [[first[f"{name}0_{axis}"] for axis in "XYZ"] for name in ("POSI", "VELO")]
    frame = GCRS(
        obstime=Time(first["DATE-OBS"], scale="utc"),
        obsgeoloc=CartesianRepresentation(state[0], unit=u.km),
        obsgeovel=CartesianRepresentation(state[1], unit=u.km / u.s),
    )
    seen = SkyCoord(ICRS(truth["ra_orig"] * u.deg, truth["dec_orig"] * u.deg)).transform_to(frame)
    return WCS(fits.getheader(file.path, "IMAGE"), key=" ").all_world2pix(seen.ra.deg, seen.dec.deg, 0)


def test_pixels_differ_by_the_aberration(campaign):
    """Stars at rest are where astropy says in both seasons; that is 440 px apart for one CRVAL."""
    pixels = []
    for obsid in OBSIDS:
        truth, found, file = products(campaign, obsid)
        assert len(truth) == 16
        rest = truth["id"] % 2 == 0
        x, y = astropy_pixels(file, truth)
        assert np.hypot(found["x"] - x, found["y"] - y)[rest].max() < PLACE_PX
        pixels.append((found["x"], found["y"]))
    assert np.hypot(*np.subtract(*pixels)).min() > 400


def test_places_agree_between_the_seasons_but_for_what_moved(campaign):
    """Measured ICRS at the epoch: equal for stars at rest, and moved by proper motion and parallax for the others."""
    (truth, one, _), (later, other, _) = (products(campaign, obsid) for obsid in OBSIDS)
    assert (truth["id"] == later["id"]).all() and (truth["ra_orig"] == later["ra_orig"]).all()
    cos_dec = np.cos(np.radians(truth["dec"]))
    measured, expected = (
        np.stack([(b[f"ra{e}"] - a[f"ra{e}"]) * cos_dec, b[f"dec{e}"] - a[f"dec{e}"]]) * 3600 / SCALE
        for a, b, e in ((one, other, ""), (truth, later, "_epoch"))
    )
    assert np.abs(measured - expected).max() < PLACE_PX
    rest = truth["id"] % 2 == 0
    assert np.abs(expected[:, rest]).max() < 1e-6
    # Half a year at (250, -150) mas / yr, and up to 24 mas of parallax.
    moved = expected[:, ~rest] * SCALE * 1000
    assert np.abs(moved - np.array([[124.0], [-74.0]])).max() < 25.0 and np.abs(moved).min() > 40.0


def test_a_star_is_one_merged_source_at_rest_and_in_motion(campaign):
    """The fast ones are 0.15 arcsec away after half a year, which merging follows; parallax adds to the motion."""
    merged = [ObjectTable.read(campaign.paths.merge(pix)) for pix in campaign.merge_bricks]
    names = "ra", "dec", "n_detections", "motion", "pmra", "pmdec"
    ra, dec, seen, motion, *speed = (np.concatenate([table[name] for table in merged]) for name in names)
    truth, *_ = products(campaign, OBSIDS[0])
    for star in range(16):
        off = np.hypot((ra - truth["ra_epoch"][star]) * np.cos(np.radians(dec)), dec - truth["dec_epoch"][star]) * 3600
        near = off < 0.3
        moves = truth["id"][star] % 2 == 1
        assert seen[near].tolist() == [2] and motion[near] == moves
        if moves:  # its place is that of the mean time, three months of motion away
            assert off[near] < 0.1
            assert (
                np.abs([v[near][0] - w for v, w in zip(speed, (250.0, -150.0), strict=True)]).max() < 60.0
            )  # mas / yr
        else:
            assert off[near] / SCALE < PLACE_PX


def test_validation_compares_places_at_the_epoch(campaign):
    """No offset in spite of 26 arcsec of aberration and 8 arcsec of proper motion since J2000; 0.02 px are 1.5 mas."""
    results = [json.loads(campaign.paths.validate(pix).read_text())["astrometry_mas"] for pix in campaign.merge_bricks]
    found = [part for result in results for part in result.values() if part["n"]]
    assert sum(part["n"] for part in found) >= 2 * 12  # nearly saturated ones are not evaluated
    assert all(abs(part["median"]) < 1000 * PLACE_PX * SCALE for part in found)


def test_the_header_alone_gives_the_state_back(campaign):
    for obsid in OBSIDS:
        *_, file = products(campaign, obsid)
        ours, theirs = campaign.job(obsid, CHIP).observer.astrom, file.observer.astrom
        for name in ("pmt", "eb", "eh", "em", "v", "bm1"):
            assert np.array_equal(ours[name], theirs[name])
        assert file.header0["POSKIND"] == "APPARENT" and file.header["RADESYS"] == "ICRS"
