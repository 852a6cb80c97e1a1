"""The Cycle-9 tables that are spread over a year, and their campaigns: what the exposures meet, by astropy."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from astropy import units as u
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord, get_body, get_sun
from astropy.time import Time

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.base.units import EARTH_RADIUS_KM
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.sky_ranges import angle_lines, much_earthshine, sky_ranges, sky_table
from csstsim.campaign.survey_table import load_survey_table
from csstsim.instrument.camera import load_camera
from csstsim.layers import sky_background
from csstsim.sky.bodies import exposure_angles

TABLES = SHIPPED.parent / "survey_tables"
FIELDS = ("w1", "w2", "w3", "w4", "w5")


def table(name):
    return list(load_survey_table(TABLES / f"{name}_straylight.csv").values())


def by_astropy(pointings):
    """Return {angle: deg} of exposures' starts: the spacecraft's own frame, the limb as the edge of a sphere."""
    position, velocity = (
        np.array([getattr(p, name) for p in pointings]).T for name in ("sat_position", "sat_velocity")
    )
    times = Time([p.time for p in pointings], scale="utc")
    here = GCRS(
        obstime=times, obsgeoloc=CartesianRepresentation(position * u.km),
        obsgeovel=CartesianRepresentation(velocity * u.km / u.s),
    )  # fmt: skip
    boresight = SkyCoord([p.ra for p in pointings], [p.dec for p in pointings], unit="deg").cartesian.xyz.value
    bodies = {"sun": get_sun(times).transform_to(here), "moon": get_body("moon", times).transform_to(here)}
    found = {name: _between(body.cartesian.xyz.value, boresight) for name, body in bodies.items()}
    radius = np.degrees(np.arcsin(EARTH_RADIUS_KM / np.linalg.norm(position, axis=0)))
    return found | {"limb": _between(-position, boresight) - radius}


def _between(a, b):
    across, along = np.linalg.norm(np.cross(a, b, axis=0), axis=0), np.einsum("in,in->n", a, b)
    return np.degrees(np.arctan2(across, along))


@pytest.mark.parametrize("name", FIELDS)
def test_angles_are_those_of_astropy(name):
    """Limb, Moon and Sun within 0.01 deg."""
    pointings = table(name)
    own = [exposure_angles(p.ra, p.dec, p.mjd, p.sat_position, p.sat_velocity) for p in pointings]
    for angle, expected in by_astropy(pointings).items():
        assert np.abs([one[angle] for one in own] - expected).max() < 0.01, angle


@pytest.mark.parametrize("name", FIELDS)
def test_the_exposures_span_what_a_low_orbit_meets(name):
    """Limb from 20 to 90 deg, by day and night, nine tenths of the Sun's range in a year; states of the orbit."""
    pointings = table(name)
    angles = by_astropy(pointings)
    assert 20.0 <= angles["limb"].min() < 22.0 and angles["limb"].max() > 90.0
    assert angles["sun"].min() > 49.9 and angles["moon"].min() > 19.9
    lit = np.array([
        exposure_angles(p.ra, p.dec, p.mjd, p.sat_position, p.sat_velocity)["limb_sun"] for p in pointings
    ])  # fmt: skip
    assert 0.2 < np.mean(lit > 0) < 0.8
    sun = get_sun(Time("2027-06-01") + np.arange(0, 365, 5) * u.day).cartesian.xyz.value
    field = SkyCoord(pointings[0].ra, pointings[0].dec, unit="deg").cartesian.xyz.value
    year = _between(sun, np.broadcast_to(field[:, None], sun.shape))
    assert np.ptp(angles["sun"]) > 0.9 * (year.max() - max(year.min(), 50.0))
    orbit = load_camera().orbit
    for p in pointings[::50]:
        assert p.sat_position == pytest.approx(orbit.state(p.time)[0], abs=1e-3)
        assert p.sat_velocity == pytest.approx(orbit.state(p.time)[1], abs=1e-6)


def test_the_five_fields_together_meet_the_moon_near_and_far():
    moon = np.concatenate([by_astropy(table(name))["moon"] for name in FIELDS])
    assert moon.min() < 22.0 and moon.max() > 155.0


@pytest.mark.parametrize("name", FIELDS)
def test_a_rotated_campaign_differs_by_one_key(name):
    """And by the names of itself and its folder; both share truth and PSF, and have the model on."""
    plain, turned = (yaml.safe_load((SHIPPED / f"c9_{name}{end}.yaml").read_text()) for end in ("", "_rotated"))
    assert "shapes" not in plain["catalog"]
    assert turned.pop("catalog") == plain.pop("catalog") | {"shapes": "rotated90"}
    for key in ("name", "output"):
        assert turned.pop(key) == f"{plain.pop(key)}_rotated"
    assert turned == plain and plain["share"] and plain["survey_table"] == f"../survey_tables/{name}_straylight.csv"
    layers = yaml.safe_load((SHIPPED / plain["observations"]["SCIE"]).read_text())["layers"]
    assert next(layer for layer in layers if "sky_background" in layer)["sky_background"]["enable_straylight_model"]


def test_the_straylight_layers_are_the_science_layers_otherwise():
    plain, stray = (
        yaml.safe_load((SHIPPED / "observations" / f"{name}.yaml").read_text())
        for name in ("science", "science_straylight")
    )
    for layers in (plain, stray):
        next(layer for layer in layers["layers"] if "sky_background" in layer)["sky_background"].pop(
            "enable_straylight_model"
        )
    assert plain == stray


def opened(folder, **changes):
    """Return W1's campaign with a few exposures and chips, and other changes, opened."""
    campaign = yaml.safe_load((SHIPPED / "c9_w1.yaml").read_text())
    campaign |= {
        "survey_table": str(TABLES / "w1_straylight.csv"), "output": str(folder / "out"), "share": None,
        "select": {"types": ["SCIE"], "obsids": ["10101000006", "10101000013"], "chips": [9, 22, 1]},
        "window": {"x0": 4000, "x1": 4400, "y0": 4000, "y1": 4400},
        "observations": {"SCIE": str(SHIPPED / "observations" / "science_straylight.yaml")},
    }  # fmt: skip
    (folder / "campaign.yaml").write_text(yaml.safe_dump(campaign | changes))
    return OpenCampaign(folder / "campaign.yaml")


def test_the_plan_has_the_levels_of_the_frames(tmp_path):
    """One chip a band (chips 9 and 22 are r): the layer's mean over window and exposure; 5%, as the limb moves."""
    run = opened(tmp_path)
    levels, angles = sky_ranges(run)
    assert list(levels) == ["r", "GI"] and all(len(values) == 2 for values in angles.values())
    for band, chip in (("r", 9), ("GI", 1)):
        for k, obsid in enumerate(("10101000006", "10101000013")):
            param = run.steps["SCIE"].step("sky_background").param
            frame = sky_background.mean_rate(run.job(obsid, chip).exposure, param)
            assert sum(parts[k] for parts in levels[band].values()) == pytest.approx(frame, rel=0.05)
    printed = sky_table(levels)
    assert printed.row_count == 2 and len(printed.columns) == 8
    assert len(angle_lines(angles)) == 4 and "limb" in angle_lines(angles)[0]


def test_no_ranges_without_the_model(tmp_path):
    assert sky_ranges(opened(tmp_path, observations={})) == ({}, {})


def test_an_exposure_of_the_earth_is_named(tmp_path):
    run = opened(tmp_path, observations={"SCIE": str(SHIPPED / "observations" / "science_straylight.yaml")})
    job = run.jobs[0]
    down = replace(job.pointing, sat_position=tuple(-x for x in job.pointing.sat_position))
    exposure = replace(job.exposure, pointing=down)
    run.__dict__["science_jobs"] = (replace(job, exposure=exposure),)
    with pytest.raises(InputError, match="looks at the Earth") as caught:
        sky_ranges(run)
    assert f"in obsid {job.obsid}" in caught.value.__notes__


def test_much_earthshine():
    assert much_earthshine({"earth": np.array([0.0, 0.09, 0.11, 3.0]), "zodiacal": np.ones(4)}) == 0.5
