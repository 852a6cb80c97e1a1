"""The Cycle-9 tables that are spread over a year, and their campaigns: what the exposures meet, by astropy."""

import io
from dataclasses import replace

import numpy as np
import pytest
import yaml
from astropy import units as u
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord, get_body, get_sun
from astropy.table import Table
from astropy.time import Time
from click.testing import CliRunner
from rich.console import Console

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.base.units import EARTH_RADIUS_KM
from csstsim.campaign import sky_ranges
from csstsim.campaign.aiming import aimed_exposures, survey_table_text
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.sky_ranges import ANGLES, faint, much_earthshine, skies, sky_lines, sky_table, totals
from csstsim.campaign.survey_table import load_survey_table
from csstsim.command_line.main import main
from csstsim.instrument.camera import load_camera
from csstsim.layers import sky_background
from csstsim.optics.sky.bodies import exposure_angles

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
    """One chip a band (chips 9 and 22 are r): the layer's mean over window and exposure; 0.1%, as both are means."""
    run = opened(tmp_path)
    levels, angles = skies(run)
    assert list(levels) == ["r", "GI"] and list(angles) == ["10101000006", "10101000013"]
    for band, chip in (("r", 9), ("GI", 1)):
        for obsid in angles:
            param = run.steps["SCIE"].step("sky_background").param
            frame = sky_background.mean_rate(run.job(obsid, chip).exposure, param)
            assert totals(levels[band])[obsid] == pytest.approx(frame, rel=1e-3)
    for angle, expected in by_astropy([run.pointings[obsid] for obsid in angles]).items():
        found = [own[angle] for own in angles.values()]
        assert found == pytest.approx(expected.tolist(), abs=0.01) and abs(found[0] - found[1]) > 0.1


def test_a_star_on_one_chip_is_sky_of_the_others_alone(tmp_path, camera):
    """Canopus on chip 9 is rendered there; the grating's chip has the light that it scatters, as the frame has it."""
    exposures = aimed_exposures(camera, 95.9879, -52.6958, [camera.chips[9]])
    (tmp_path / "table.csv").write_text(survey_table_text(exposures))
    select = {"types": ["SCIE"], "chips": [9, 1]}
    run = opened(tmp_path, survey_table=str(tmp_path / "table.csv"), select=select)
    levels, [obsid] = skies(run)
    for band, chip in (("r", 9), ("GI", 1)):
        frame = sky_background.mean_rate(run.job(obsid, chip).exposure, run.steps["SCIE"].step("sky_background").param)
        assert totals(levels[band])[obsid] == pytest.approx(frame, rel=1e-4)


BRIGHT = {"zodiacal": 0.1, "earth": 0.0, "sun": 0.0, "moon": 9e-7, "planets": 0.0, "stars": 1e-4}
LEVELS = {
    "r": {"1": BRIGHT, "2": BRIGHT | {"earth": 0.5}, "3": BRIGHT | {"earth": 0.02}},
    "i": {"1": BRIGHT, "2": BRIGHT | {"earth": 0.4}, "3": BRIGHT | {"earth": 0.005}},
    "NUV": {"1": BRIGHT | {"zodiacal": 0.2}, "2": BRIGHT | {"earth": 0.3}, "3": BRIGHT},
}
OWN = {name: 10.0 * k for k, name in enumerate(ANGLES)}


def printed(*things):
    text = io.StringIO()
    for one in things:
        Console(file=text, width=80).print(one, highlight=False)
    return text.getvalue()


def test_the_table_fits_80_columns_and_leaves_out_what_is_faint():
    """A row for each band and component, three numbers; none is cut or broken."""
    assert faint(LEVELS) == ["sun", "moon", "planets"]
    text = printed(sky_table(LEVELS))
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in text.splitlines() if line.startswith("│")]
    assert rows[:4] == [
        ["r", "zodiacal", "0.1", "0.1", "0.1"], ["", "earth", "0", "0.02", "0.5"],
        ["", "stars", "0.0001", "0.0001", "0.0001"], ["", "all", "0.1", "0.12", "0.6"],
    ]  # fmt: skip
    assert len(rows) == 12 and {len(row) for row in rows} == {5}


def test_lines_name_the_exposures_of_least_and_most_sky():
    lines = sky_lines(LEVELS, dict.fromkeys("123", OWN))
    assert lines[0] == "Left out, because below 1e-06 e-/s/px in every exposure: sun, moon, planets."
    assert lines[1:3] == [
        "Minimum sky: obsid 1; maximum: obsid 2 (r, i).", "Minimum sky: obsid 3; maximum: obsid 2 (NUV).",
    ]  # fmt: skip
    assert lines[3].endswith("r 67%, i 33%, NUV 33%.")
    assert lines[4] == "boresight to the Earth's limb: 0.0 0.0 0.0 deg (minimum, median, maximum)" and len(lines) == 8


def test_the_range_of_an_angle_is_its_least_middle_and_most():
    """Of three exposures in any order; the mean would be 30."""
    angles = {
        obsid: dict.fromkeys(ANGLES, 0.0) | {"sun": value} for obsid, value in zip("123", (20, 60, 10), strict=True)
    }
    lines = sky_lines(LEVELS, angles)
    assert "boresight to the Sun: 10.0 20.0 60.0 deg (minimum, median, maximum)" in lines


def test_one_exposure_has_one_number():
    single = {"r": {"2": LEVELS["r"]["2"]}}
    assert "│ r    │ zodiacal  │    0.1 │" in printed(sky_table(single)) and "median" not in printed(sky_table(single))
    lines = sky_lines(single, {"2": OWN})
    assert lines[-1] == "boresight to the Moon: 30.0 deg" and not any("xposures " in line for line in lines)


def test_the_sky_by_exposure_is_written(tmp_path):
    """One row for each exposure and band, as `skies` has them; an old file and a campaign without the model refused."""
    run, path = opened(tmp_path), tmp_path / "sky.csv"
    command = ["plan", str(run.file), "--sky", str(path)]
    result = CliRunner().invoke(main, command, catch_exceptions=False)
    assert result.exit_code == 0 and "sky.csv: the sky of each exposure and band" in result.output.replace("\n", "")
    levels, angles = skies(run)
    read = Table.read(path, format="ascii.csv")
    assert read.colnames == [
        "obsid", "band", "zodiacal [e-/s/px]", "earth [e-/s/px]", "sun [e-/s/px]", "moon [e-/s/px]",
        "planets [e-/s/px]", "stars [e-/s/px]", "limb [deg]", "limb_sun [deg]", "sun_angle [deg]", "moon_angle [deg]",
    ]  # fmt: skip
    assert [(str(row["obsid"]), row["band"]) for row in read] == [(o, b) for o in angles for b in ("r", "GI")]
    for row in read:
        parts, own = levels[row["band"]][str(row["obsid"])], angles[str(row["obsid"])]
        assert [row[f"{name} [e-/s/px]"] for name in parts] == pytest.approx(list(parts.values()), rel=1e-3)
        assert row["sun_angle [deg]"] == pytest.approx(own["sun"], abs=0.01)
        assert row["limb [deg]"] == pytest.approx(own["limb"], abs=0.01)
    before = path.read_bytes()
    refused = CliRunner().invoke(main, command)
    assert refused.exit_code == 2 and "exists already" in refused.stderr and path.read_bytes() == before
    dark = opened(tmp_path, observations={})
    refused = CliRunner().invoke(main, ["plan", str(dark.file), "--sky", str(tmp_path / "none.csv")])
    assert refused.exit_code == 2 and "no exposure uses the stray-light model" in refused.stderr
    assert not refused.stdout and not (tmp_path / "none.csv").exists()


def test_no_sky_without_the_model(tmp_path):
    assert skies(opened(tmp_path, observations={})) == ({}, {})


def test_an_exposure_of_the_earth_is_named(tmp_path):
    run = opened(tmp_path, observations={"SCIE": str(SHIPPED / "observations" / "science_straylight.yaml")})
    job = run.jobs[0]
    down = replace(job.pointing, sat_position=tuple(-x for x in job.pointing.sat_position))
    exposure = replace(job.exposure, pointing=down)
    run.__dict__["science_jobs"] = (replace(job, exposure=exposure),)
    with pytest.raises(InputError, match="looks at the Earth") as caught:
        skies(run)
    assert f"in obsid {job.obsid}" in caught.value.__notes__


def test_much_earthshine():
    assert much_earthshine({"earth": np.array([0.0, 0.09, 0.11, 3.0]), "zodiacal": np.ones(4)}) == 0.5


def test_sums_and_shares_of_the_sky():
    def sky(**parts):
        return dict.fromkeys(sky_ranges.COMPONENTS, 0.0) | parts

    levels = {
        "g": {"1": sky(zodiacal=0.5, earth=0.05), "2": sky(zodiacal=0.2, earth=0.021), "3": sky(zodiacal=0.3)},
        "r": {"1": sky(zodiacal=0.1, moon=2e-6), "2": sky(zodiacal=0.2), "3": sky(zodiacal=0.4)},
    }
    assert sky_ranges.totals(levels["g"]) == pytest.approx({"1": 0.55, "2": 0.221, "3": 0.3})
    assert set(sky_ranges.faint(levels)) == set(sky_ranges.COMPONENTS) - {"zodiacal", "earth", "moon"}
    assert sky_ranges._extremes(levels) == [
        "Minimum sky: obsid 2; maximum: obsid 1 (g).", "Minimum sky: obsid 1; maximum: obsid 3 (r).",
    ]  # fmt: skip
    shares = sky_ranges._arrays(levels["g"])
    assert sky_ranges.much_earthshine(shares) == pytest.approx(1 / 3)  # exactly a tenth is not more
