"""Each key of a campaign file is declared here as changing pixels or not, and the recipes must agree.

If a key that changes pixels is missing in the recipe, a changed campaign keeps its old pixels. If a key that does not
is in it, all is made again for nothing. The test fails for a new key that is not in the table.
"""

import functools
import shutil
from dataclasses import fields, replace

import pytest
import yaml
from pydantic import BaseModel
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign import opened as campaigns
from csstsim.campaign.config import Campaign, make_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.instrument.pointing import Pointing
from csstsim.simulation.sim_steps import SimSteps

OBSID, CHIP = "10100000001", 9
# The stages of a chip in their order, beside them what chips share; a change is seen from one on, by all that follow
CHAIN = "select", "render", "readout", "level0", "measure", "validate"
SEEN = {stage: {*CHAIN[i:]} for i, stage in enumerate(CHAIN)}
SEEN |= {"truth": {"truth", *CHAIN}, "psf": {"psf", *CHAIN[1:]}}
NOT = ()  # neither (which jobs there are, where files lie, what is kept: rules and their inputs see to it)
TRUTH, PSF, BOTH, SELECT, RENDER, MEASURE, VALIDATE = (
    ("truth",), ("psf",), ("psf", "select"), ("select",), ("render",), ("measure",), ("validate",)
)  # fmt: skip
POINTING = Pointing("SCIE", 60.0, -40.0, -113.4333, "2027-11-20T01:08:00", 150.0, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))
REGION = {"ra": 60.0, "dec": -40.0, "radius": 30.0}
CONSTANT = {"field": "constant", "kappa": 0.01, "gamma1": 0.01, "gamma2": 0.01}
STARS = {"kind": "support.mini_campaign:Stars", "options": {"ra": [60.0], "dec": [-40.0], "mag": [20.0]}}
CATALOGUE = {"known_from": "catalogue"}
# key: (the stages that see it first, another value, what else the campaign says before and after: {section: value})
KEYS = {
    "name": (NOT, "other", {}),
    "output": (NOT, "elsewhere", {}),
    "seed": (TRUTH, 4, {}),
    "select.types": (NOT, ["SCIE", "BIAS"], {}),
    "select.obsids": (NOT, [OBSID], {}),
    "select.chips": (NOT, "imaging", {}),
    "select.filters": (NOT, ["r"], {}),
    "select.missing": (NOT, {"10300000001_09": "its amplifier is dead"}, {}),
    "select.region.ra": (NOT, 60.001, {"select": {"chips": [CHIP], "region": REGION}}),
    "select.region.dec": (NOT, -40.001, {"select": {"chips": [CHIP], "region": REGION}}),
    "select.region.radius": (NOT, 31.0, {"select": {"chips": [CHIP], "region": REGION}}),
    "window.x0": (SELECT, 1, {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 100}}),
    "window.x1": (SELECT, 101, {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 100}}),
    "window.y0": (SELECT, 1, {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 100}}),
    "window.y1": (SELECT, 101, {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 100}}),
    "catalog.kind": (SELECT, "support.mini_campaign:Movers", {"catalog": STARS}),
    "catalog.mag_limit": (SELECT, 22.0, {}),
    "catalog.lensing.field": (TRUTH, "none", {}),
    "catalog.lensing.kappa": (TRUTH, 0.02, {"catalog": {"lensing": CONSTANT}}),
    "catalog.lensing.gamma1": (TRUTH, 0.02, {"catalog": {"lensing": CONSTANT}}),
    "catalog.lensing.gamma2": (TRUTH, 0.02, {"catalog": {"lensing": CONSTANT}}),
    "catalog.structure": (TRUTH, "none", {}),
    "catalog.bright_stars": (TRUTH, False, {}),
    "catalog.components": (SELECT, "full", {}),
    "catalog.variable_stars": (SELECT, True, {}),
    "catalog.variable_quasars": (SELECT, True, {}),
    "catalog.asteroids": (SELECT, True, {}),
    "catalog.satellites": (SELECT, True, {}),
    "catalog.shapes": (SELECT, "rotated90", {}),
    "catalog.options": (SELECT, STARS["options"] | {"mag": [21.0]}, {"catalog": STARS}),
    "astrometry.ephemeris": (SELECT, "de440", {}),
    "astrometry.planets": (SELECT, True, {}),
    "psf.grid": (PSF, 3, {"psf": {"grid": 2}}),
    "psf.oversampling": (BOTH, 2, {"psf": {"grid": 2}}),
    "psf.library": (BOTH, "library", {"psf": {"grid": 2}}),
    "psf.library_sample": (PSF, "point", {"psf": {"grid": 2}}),
    "psf.interpolation": (RENDER, "idw", {"psf": {"grid": 2}}),
    "psf.beta": (RENDER, 3.0, {"psf": {"grid": 2}}),
    "psf.neighbours": (RENDER, 3, {"psf": {"grid": 2}}),
    "fidelity": (RENDER, "preview", {}),
    "keep": (NOT, "light", {}),
    "variants": (NOT, {"other": {"seed": 5}}, {}),
    "share": (NOT, "common", {}),
    "level0_names": (NOT, "C5.2", {}),
    "truth": (NOT, ["parquet", "cat"], {}),
    "measurement.calibration": (MEASURE, "frames", {}),
    "measurement.masters": (
        MEASURE,
        "other masters",
        {"measurement": {"calibration": "frames", "masters": "masters"}},
    ),
    "measurement.cti_passes": (MEASURE, 1, {}),
    "measurement.keep_calibrated": (NOT, True, {}),
    "measurement.joint": (NOT, True, {}),
    "measurement.contamination.known_from": (MEASURE, "catalogue", {}),
    "measurement.contamination.table": (MEASURE, "objects.csv", {"measurement": {"contamination": CATALOGUE}}),
    "measurement.contamination.depth": (MEASURE, 25.0, {"measurement": {"contamination": CATALOGUE}}),
    "measurement.contamination.subtract": (MEASURE, False, {}),
    "validation.completeness_min": (VALIDATE, 0.9, {}),
    "validation.galaxy_completeness_min": (VALIDATE, 0.81, {}),
    "validation.galaxy_snr_min": (VALIDATE, 30.0, {}),
    "validation.saturated_min": (VALIDATE, 0.81, {}),
    "validation.snr_min": (VALIDATE, 6.0, {}),
    "validation.purity_min": (VALIDATE, 0.7, {}),
    "validation.galaxy_mag_max": (VALIDATE, [0.2, 0.15, 0.1], {}),
    "validation.galaxy_colour_max": (VALIDATE, 0.2, {}),
    "validation.pair_completeness_min": (VALIDATE, 0.1, {}),
    "validation.frame_counts_max": (VALIDATE, 0.2, {}),
    "validation.laws_max": (VALIDATE, 0.5, {}),
    "validation.mag_bias_max": (VALIDATE, 0.03, {}),
    "validation.pull_width": (VALIDATE, [0.8, 1.3], {}),
    "validation.zeropoint_max": (VALIDATE, 0.015, {}),
    "validation.place_max": (VALIDATE, 4.5, {}),
    "validation.wcs_max": (VALIDATE, 0.075, {}),
    "validation.astrometry_max": (VALIDATE, 6.0, {}),
    "validation.position_bias_max": (VALIDATE, 2.0, {}),
    "validation.depth_off_max": (VALIDATE, 0.4, {}),
    "validation.noise_off_max": (VALIDATE, 0.15, {}),
    "validation.level_off_max": (VALIDATE, 0.03, {}),
    "validation.uneven_max": (VALIDATE, 0.03, {}),
    "validation.spectra_flux_max": (VALIDATE, 0.015, {}),
    "validation.spectra_sky_max": (VALIDATE, 0.045, {}),
    "validation.pointing_max": (VALIDATE, 0.3, {}),
    "validation.read_noise_max": (VALIDATE, 0.075, {}),
    "validation.bias_max": (VALIDATE, 0.75, {}),
    "validation.header_max": (VALIDATE, 0.00015, {}),
    "validation.counts_max": (VALIDATE, 0.2, {}),
    "validation.lost_max": (VALIDATE, 0.03, {}),
    "validation.twice_max": (VALIDATE, 0.03, {}),
    "validation.psf_size_max": (VALIDATE, 0.006, {}),
    "validation.psf_e_max": (VALIDATE, 0.006, {}),
    "validation.shape_max": (VALIDATE, 0.375, {}),
    "validation.shear_m_max": (VALIDATE, 0.06, {}),
    "validation.shear_c_max": (VALIDATE, 0.003, {}),
}
# Keys that name a file or a folder: what is in it decides, not what it is called (tests below)
FILES = {"survey_table", "observations", "instrument", "universe"}
FIXED = {"schema_version"}  # has one value only
TOGETHER = {"measurement.calibration": {"measurement.masters": "masters"}}  # keys that cannot change alone


def keys(model=Campaign, above=""):
    """Yield the keys of a model and of those within it, as "section.key"."""
    for name, field in model.model_fields.items():
        inner = [kind for kind in (field.annotation, *getattr(field.annotation, "__args__", ())) if _is_model(kind)]
        for kind in inner:
            yield from keys(kind, f"{above}{name}.")
        if not inner:
            yield above + name


def _is_model(kind):
    return isinstance(kind, type) and issubclass(kind, BaseModel)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("recipe")
    write_campaign(made, POINTINGS[:1] + POINTINGS[2:])
    (made / "library").mkdir()
    for name in ("masters", "other masters"):
        (made / name / "masters").mkdir(parents=True)
        (made / name / "masters" / f"chip_{CHIP:02d}.fits").touch()
    (made / "objects.csv").write_text("ra,dec,mag_r\n60,-40,20\n")
    return made


@pytest.fixture
def opened(folder, monkeypatch):
    """Return a function: the campaign opened with some sections changed. The camera is read once."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(campaigns, "load_camera", _camera)
    seen = campaigns.observer  # JPL's ephemeris need not be installed
    monkeypatch.setattr(campaigns, "observer", lambda *given, ephemeris, planets: seen(*given, planets=planets))
    data = yaml.safe_load((folder / "campaign.yaml").read_text())
    data["select"] = {"chips": [CHIP]}
    del data["catalog"]  # as by default

    def open_(changes, **more):
        config = make_campaign(data | changes, "campaign.yaml")
        return OpenCampaign(folder / "campaign.yaml", copied=True, config=config, **more)

    return open_


_camera = functools.cache(campaigns.load_camera)


def changed(sections, key, value):
    """Return the sections with one key (dotted) set."""
    first, *rest = key.split(".")
    return sections | {first: changed(sections.get(first) or {}, ".".join(rest), value) if rest else value}


def recipes(run):
    """Return {stage: its recipe} of a job, with what chips share."""
    job = run.job(OBSID, CHIP)
    found = {stage: run.recipe(job, stage) for stage in CHAIN[:-1]}
    shared = run.recipes
    return found | {"validate": [found["measure"], shared.validation], "truth": shared.truth, "psf": shared.psf}


def differ(before, after):
    """Return the stages whose recipes differ."""
    return {stage for stage in before if before[stage] != after[stage]}


def test_every_key_of_a_campaign_is_declared():
    """A new key belongs into KEYS, with what a change of it makes again; one that is gone does not."""
    assert sorted(keys()) == sorted([*KEYS, *FILES, *FIXED])


@pytest.mark.parametrize("key", KEYS)
def test_a_key_is_seen_by_the_stages_it_is_declared_for(opened, key):
    first, value, context = KEYS[key]
    context = {"select": {"chips": [CHIP]}} | context
    before, other = opened(context), changed(context, key, value)
    for also, its in TOGETHER.get(key, {}).items():
        other = changed(other, also, its)
    after = opened(other)
    assert before.config != after.config
    seen = set().union(*(SEEN[stage] for stage in first))
    if not before.embedded:
        seen.discard("truth")
    assert differ(recipes(before), recipes(after)) == seen
    # Level-0 files, masters and the report quote the campaign's own digest: what moves all pixels is in it
    if "level0" in seen and not key.startswith("window"):
        assert before.config.digest() != after.config.digest()


def test_the_region_as_a_window_moves_pixels(opened):
    """Elsewhere it only chooses jobs; with window: region its place and radius are the window's."""
    job = opened({}).job(OBSID, CHIP)
    ra, dec = icrs(*job.wcs.pixel_to_world(64.0, 64.0), job.observer)
    region = {"ra": float(ra), "dec": float(dec)}
    before, after = (
        opened({"window": "region", "select": {"chips": [CHIP], "region": region | {"radius": radius}}})
        for radius in (0.05, 0.06)  # arcmin
    )
    assert before.job(OBSID, CHIP).window != after.job(OBSID, CHIP).window
    assert differ(recipes(before), recipes(after)) == SEEN["select"]


FILES_OF = {
    ("instrument", "psf.yaml"): ("\n", "\n# a word\n", BOTH),
    ("instrument", "detector.yaml"): ("\n", "\n# a word\n", NOT),  # its numbers count, one by one
    ("instrument", "cti.yaml"): ("\n", "\n# a word\n", ("readout",)),
    ("instrument", "leds.yaml"): ("\n", "\n# a word\n", RENDER),
    ("instrument", "sky.yaml"): (" -1.46 ", " -1.45 ", TRUTH),  # Sirius is one of the objects
    ("universe", "stars.yaml"): ("\n", "\n# a word\n", TRUTH),
}


@pytest.mark.parametrize(("key", "file"), FILES_OF)
def test_what_is_in_a_folder_decides_and_not_its_name(opened, folder, tmp_path, key, file):
    old, new, first = FILES_OF[key, file]
    copy = shutil.copytree(folder / key, tmp_path / "copy")
    sections = {"select": {"chips": [CHIP]}}
    before, same = opened(sections), opened(sections | {key: str(copy)})
    assert recipes(before) == recipes(same)
    shutil.move(copy, tmp_path / "changed")  # the camera of a folder is read once
    path = tmp_path / "changed" / file
    text = path.read_text()
    path.write_text(text.replace(old, new, 1))
    assert old in text
    after = recipes(opened(sections | {key: str(tmp_path / "changed")}))
    assert differ(recipes(before), after) == set().union(*(SEEN[stage] for stage in first))


@pytest.mark.parametrize("column", [field.name for field in fields(Pointing) if field.name != "type"])
def test_every_value_of_a_pointing_moves_its_pixels_and_no_others(opened, column):
    """Of the survey table; the type is what the job is."""

    def run(value):
        pointings = {OBSID: {}, "10100000002": {}}
        pointings[OBSID] = {} if value is None else {column: value}
        made = {obsid: replace(POINTING, **change) for obsid, change in pointings.items()}
        return opened({"select": {"chips": [CHIP]}}, pointings=made)

    value = getattr(POINTING, column)
    other = {str: "2027-11-20T01:09:00", tuple: (1.0, 7.0, 3.0), float: 60.01}[type(value)]
    before, after = run(None), run(other)
    assert differ(recipes(before), recipes(after)) == SEEN["select"]
    untouched = [run.recipe(run.job("10100000002", CHIP)) for run in (before, after)]
    assert untouched[0] == untouched[1]


@pytest.mark.parametrize("kind", ["science", "science_paper", "bias", "dark", "led_flat"])
def test_every_parameter_of_every_layer_is_seen_by_its_stage_and_no_earlier_one(kind):
    """Those that a list leaves out, too, and the order of the layers."""
    file = SHIPPED / "observations" / f"{kind}.yaml"
    layers = SimSteps(file).steps
    digests = {"as it is": _digests(file, layers), "turned": _digests(file, layers[::-1])}
    for i, step in enumerate(layers):
        for name, value in step.param:
            param = step.param.model_copy(update={name: _other(value)})  # unchecked: alone it may not fit the list
            found = _digests(file, [*layers[:i], replace(step, param=param), *layers[i + 1 :]])
            first = {"field_dist": "select", "mask": "readout"}.get(name, step.module.STAGE)  # the WCS's; rays mark it
            assert differ(digests["as it is"], found) == SEEN[first] - {"validate"}, (step.name, name)
            digests[step.name, name] = found
    assert len({found["level0"] for found in digests.values()}) == len(digests) > 2


def _digests(file, layers):
    steps = SimSteps(file)
    steps.steps, steps.field_dist = layers, any(getattr(step.param, "field_dist", False) for step in layers)
    return {stage: steps.digest(stage) for stage in CHAIN[:-1]}


def _other(value):
    if isinstance(value, bool):
        return not value
    return {type(None): 0.5, float: 0.125, str: "another", list: []}[type(value)]


def test_a_layout_that_is_not_known_is_refused(opened):
    """The one key without another value: else it would have to be declared."""
    for key in FIXED:
        with pytest.raises(InputError, match=key):
            opened({key: 0})


def test_a_threshold_given_as_it_is_by_default_counts_for_an_own_catalogue(tmp_path):
    """Left out it is not evaluated there, given it is: the validation is made again."""
    own = {"kind": "support.mini_campaign:Stars"}
    file = write_campaign(tmp_path, catalog=own)
    before = OpenCampaign(file).recipes.validation
    given = {"purity_min": ValidateConfig().purity_min}
    assert OpenCampaign(write_campaign(tmp_path, catalog=own, validation=given)).recipes.validation != before


def test_a_table_of_neighbours_counts_by_its_content(tmp_path):
    """For what is measured alone; under another name it is the same."""

    def of(name, text):
        (tmp_path / name).write_text(text)
        known = {"contamination": {"known_from": "catalogue", "table": name}}
        run = OpenCampaign(write_campaign(tmp_path, [POINTINGS[0]], select={"chips": [CHIP]}, measurement=known))
        return recipes(run)

    before, same, other = of("a.csv", "id,ra\n1,2\n"), of("b.csv", "id,ra\n1,2\n"), of("a.csv", "id,ra\n1,3\n")
    assert before == same and differ(before, other) == SEEN["measure"]


def test_a_library_of_psfs_counts_by_its_content(tmp_path):
    """The same folder with other files, and another folder with the same ones."""
    for name, byte in (("one", b"a"), ("two", b"a"), ("three", b"b")):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"psfCube_{CHIP}.h5").write_bytes(
            byte * 100_000_000 if byte == b"a" else b"a" * 99_999_999 + byte
        )

    def of(folder):
        path = write_campaign(tmp_path / folder, [POINTINGS[0]], select={"chips": [CHIP]}, psf={"library": "."})
        return OpenCampaign(path).recipes.psf

    assert of("one") == of("two") != of("three")
