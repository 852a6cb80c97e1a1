"""What decides pixels, and what does not: each key of a campaign file is declared here, and the recipes must agree.

A key that moves pixels and is not in the recipe lets a changed campaign keep its old pixels; one in it that does not
has everything made again for nothing. A key that is new is not in the table, and the test says so.
"""

import functools
import shutil
from dataclasses import fields, replace

import pytest
import yaml
from mini_campaign import POINTINGS, write_campaign
from pydantic import BaseModel

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign import opened as campaigns
from csstsim.campaign.config import Campaign, make_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.places.astrometry import icrs
from csstsim.instrument.pointing import Pointing
from csstsim.simulation.sim_steps import SimSteps

OBSID, CHIP = "10100000001", 9
# What a change of a key makes again. PIXELS: of a chip, hence all after it; MEASURED: what is measured on the pixels
# there are; NOT: neither (which jobs there are, where files lie, what is judged: rules and their inputs see to it)
PIXELS, MEASURED, NOT = "pixels", "measured", "not"
POINTING = Pointing(
    OBSID, "SCIE", 60.0, -40.0, -113.4333, "2027-11-20T01:08:00", 150.0, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0)
)
REGION = {"ra": 60.0, "dec": -40.0, "radius": 30.0}
CONSTANT = {"field": "constant", "kappa": 0.01, "gamma1": 0.01, "gamma2": 0.01}
STARS = {"kind": "mini_campaign:Stars", "options": {"ra": [60.0], "dec": [-40.0], "mag": [20.0]}}
# key: (what it makes again, another value, what else the campaign says before and after: {section: value})
KEYS = {
    "name": (NOT, "other", {}),
    "output": (NOT, "elsewhere", {}),
    "seed": (PIXELS, 4, {}),
    "select.types": (NOT, ["SCIE", "BIAS"], {}),
    "select.obsids": (NOT, [OBSID], {}),
    "select.chips": (NOT, "imaging", {}),
    "select.filters": (NOT, ["r"], {}),
    "select.region.ra": (NOT, 60.001, {"select": {"chips": [CHIP], "region": REGION}}),
    "select.region.dec": (NOT, -40.001, {"select": {"chips": [CHIP], "region": REGION}}),
    "select.region.radius": (NOT, 31.0, {"select": {"chips": [CHIP], "region": REGION}}),
    "window.x0": (PIXELS, 1, {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 100}}),
    "window.x1": (PIXELS, 101, {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 100}}),
    "window.y0": (PIXELS, 1, {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 100}}),
    "window.y1": (PIXELS, 101, {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 100}}),
    "catalog.kind": (PIXELS, "mini_campaign:Movers", {"catalog": STARS}),
    "catalog.mag_limit": (PIXELS, 22.0, {}),
    "catalog.lensing.field": (PIXELS, "none", {}),
    "catalog.lensing.kappa": (PIXELS, 0.02, {"catalog": {"lensing": CONSTANT}}),
    "catalog.lensing.gamma1": (PIXELS, 0.02, {"catalog": {"lensing": CONSTANT}}),
    "catalog.lensing.gamma2": (PIXELS, 0.02, {"catalog": {"lensing": CONSTANT}}),
    "catalog.shapes": (PIXELS, "rotated90", {}),
    "catalog.options": (PIXELS, STARS["options"] | {"mag": [21.0]}, {"catalog": STARS}),
    "astrometry.ephemeris": (PIXELS, "de440", {}),
    "astrometry.planets": (PIXELS, True, {}),
    "psf.grid": (PIXELS, 3, {}),
    "psf.oversampling": (PIXELS, 2, {}),
    "psf.library": (PIXELS, "library", {}),
    "psf.library_sample": (PIXELS, "point", {}),
    "psf.interpolation": (PIXELS, "idw", {}),
    "psf.beta": (PIXELS, 3.0, {}),
    "psf.neighbours": (PIXELS, 3, {}),
    "fidelity": (PIXELS, "preview", {}),
    "measurement.calibration": (MEASURED, "frames", {}),
    "measurement.masters": (
        MEASURED,
        "other masters",
        {"measurement": {"calibration": "frames", "masters": "masters"}},
    ),
    "measurement.cti_passes": (MEASURED, 1, {}),
    "measurement.keep_calibrated": (NOT, True, {}),
    "validation.completeness_min": (NOT, 0.9, {}),
    "validation.galaxy_completeness_min": (NOT, 0.81, {}),
    "validation.galaxy_snr_min": (NOT, 30.0, {}),
    "validation.saturated_min": (NOT, 0.81, {}),
    "validation.snr_min": (NOT, 6.0, {}),
    "validation.purity_min": (NOT, 0.7, {}),
    "validation.mag_bias_max": (NOT, 0.03, {}),
    "validation.pull_width": (NOT, [0.8, 1.3], {}),
    "validation.zeropoint_max": (NOT, 0.015, {}),
    "validation.place_max": (NOT, 4.5, {}),
    "validation.wcs_max": (NOT, 0.075, {}),
    "validation.astrometry_max": (NOT, 6.0, {}),
    "validation.position_bias_max": (NOT, 2.0, {}),
    "validation.depth_off_max": (NOT, 0.4, {}),
    "validation.noise_off_max": (NOT, 0.15, {}),
    "validation.level_off_max": (NOT, 0.03, {}),
    "validation.read_noise_max": (NOT, 0.075, {}),
    "validation.bias_max": (NOT, 0.75, {}),
    "validation.header_max": (NOT, 0.00015, {}),
    "validation.counts_max": (NOT, 0.2, {}),
    "validation.lost_max": (NOT, 0.03, {}),
    "validation.twice_max": (NOT, 0.03, {}),
    "validation.psf_size_max": (NOT, 0.006, {}),
    "validation.psf_e_max": (NOT, 0.006, {}),
    "validation.shape_max": (NOT, 0.375, {}),
    "validation.shear_m_max": (NOT, 0.06, {}),
    "validation.shear_c_max": (NOT, 0.003, {}),
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
    job = run.job(OBSID, CHIP)
    return run.recipe(job), run.measure_recipe(job)


def test_every_key_of_a_campaign_is_declared():
    """A new key belongs into KEYS, with what a change of it makes again; one that is gone does not."""
    assert sorted(keys()) == sorted([*KEYS, *FILES, *FIXED])


@pytest.mark.parametrize("key", KEYS)
def test_a_key_moves_what_it_is_declared_to_move(opened, key):
    moves, value, context = KEYS[key]
    context = {"select": {"chips": [CHIP]}} | context
    before, other = opened(context), changed(context, key, value)
    for also, its in TOGETHER.get(key, {}).items():
        other = changed(other, also, its)
    after = opened(other)
    assert before.config != after.config
    (pixels, measured), (other_pixels, other_measured) = recipes(before), recipes(after)
    assert (pixels != other_pixels) == (moves == PIXELS)
    assert (measured != other_measured) == (moves in (PIXELS, MEASURED))
    # Level-0 files, masters and the report quote the campaign's own digest: what moves all pixels is in it
    if moves == PIXELS and not key.startswith("window"):
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
    assert recipes(before)[0] != recipes(after)[0]


@pytest.mark.parametrize(("key", "file"), [("instrument", "psf.yaml"), ("universe", "stars.yaml")])
def test_what_is_in_a_folder_decides_and_not_its_name(opened, folder, tmp_path, key, file):
    copy = shutil.copytree(folder / key, tmp_path / "copy")
    sections = {"select": {"chips": [CHIP]}}
    before, same = opened(sections), opened(sections | {key: str(copy)})
    assert recipes(before) == recipes(same)
    shutil.move(copy, tmp_path / "changed")  # the camera of a folder is read once
    with open(tmp_path / "changed" / file, "a") as data:
        data.write("# a word\n")
    assert recipes(before)[0] != recipes(opened(sections | {key: str(tmp_path / "changed")}))[0]


@pytest.mark.parametrize("column", [field.name for field in fields(Pointing) if field.name not in ("obsid", "type")])
def test_every_value_of_a_pointing_moves_its_pixels_and_no_others(opened, column):
    """Of the survey table; obsid and type are what the job is."""

    def run(value):
        pointings = {OBSID: {}, "10100000002": {}}
        pointings[OBSID] = {} if value is None else {column: value}
        made = [replace(POINTING, obsid=obsid, **change) for obsid, change in pointings.items()]
        return opened({"select": {"chips": [CHIP]}}, pointings=made)

    value = getattr(POINTING, column)
    other = {str: "2027-11-20T01:09:00", tuple: (1.0, 7.0, 3.0), float: 60.01}[type(value)]
    before, after = run(None), run(other)
    assert recipes(before)[0] != recipes(after)[0]
    untouched = [run.recipe(run.job("10100000002", CHIP)) for run in (before, after)]
    assert untouched[0] == untouched[1]


@pytest.mark.parametrize("kind", ["science", "science_paper", "bias", "dark", "led_flat"])
def test_every_parameter_of_every_layer_moves_pixels(kind):
    """Those that a list leaves out, too, and the order of the layers."""
    file = SHIPPED / "observations" / f"{kind}.yaml"
    layers = SimSteps(file).steps
    digests = {"as it is": _digest_of(file, layers), "turned": _digest_of(file, layers[::-1])}
    for i, step in enumerate(layers):
        for name, value in step.param:
            param = step.param.model_copy(update={name: _other(value)})  # unchecked: alone it may not fit the list
            digests[step.name, name] = _digest_of(file, [*layers[:i], replace(step, param=param), *layers[i + 1 :]])
    assert len(set(digests.values())) == len(digests) > 2


def _digest_of(file, layers):
    steps = SimSteps(file)
    steps.steps = layers
    return steps.digest


def _other(value):
    if isinstance(value, bool):
        return not value
    return {type(None): 0.5, float: 0.125, str: "another", list: []}[type(value)]


def test_a_layout_that_is_not_known_is_refused(opened):
    """The one key without another value: else it would have to be declared."""
    for key in FIXED:
        with pytest.raises(InputError, match=key):
            opened({key: 0})
