"""A variant of any key: it takes from its base all that is equal and made there, and has the bits of a run alone."""

import shutil

import numpy as np
import pytest
import yaml
from faults.small_run import pixels_and_columns, steady
from support.commands import done
from support.mini_campaign import HEADER, POINTINGS, write_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.io.paths import RENDER_PRODUCTS

OBSID, CHIP = "10100000001", 9
FURTHER = "10100000003,SCIE,61.9,-38.0,0.0,2027-11-20T01:16:00,150"
TABLE = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": "objects.csv"}}
# Of a base on the embedded sky: what decides which bricks, PSF sets and pairs there are, and what is in them
SHARED = {
    "seed": {"seed": 4},
    "fewer": {"select": {"obsids": [OBSID]}},
    "more_chips": {"select": {"chips": [8, 9]}},
    "other_chip": {"select": {"chips": [24]}},
    "window": {"window": {"x0": 0, "x1": 40, "y0": 0, "y1": 30}},
    "other_table": {"survey_table": "other.csv"},
    "table_of_more": {"survey_table": "more.csv"},
    "calibrations": {"select": {"types": ["SCIE", "BIAS"]}},
    "constant_lensing": {"catalog": {"lensing": {"field": "constant", "kappa": 0.1}}},
    "own_table": {"catalog": TABLE | {"lensing": {"field": "cosmic"}, "structure": "haloes"}},
    "faint_limit": {"catalog": {"mag_limit": 24.0}},
    "turned": {"catalog": {"shapes": "rotated90"}},
    "no_bright_stars": {"catalog": {"bright_stars": False}},
    "planets": {"astrometry": {"planets": True}},
    "jitter": {"instrument": {"psf.jitter": 0.02}},
    "full_well": {"instrument": {"detector.full_well": 60_000}},
    "larger_pixels": {"instrument": {"telescope.focal_length_m": 29.0}},
    "preview": {"fidelity": "preview"},
    "measured_otherwise": {"measurement": {"cti_passes": 1}},
}
# Of a base on a table of objects of which some saturate a shallow well; each is run from nothing, too
RUN = {
    "seed": {"seed": 4},
    "window": {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 90}},
    "one_more": {"catalog": {"options": {"file": "one_more.csv"}}},
    "without_the_saturated": {"catalog": {"options": {"file": "faint.csv"}}},
    "without_the_neighbour": {"catalog": {"options": {"file": "alone.csv"}}},
    "limit": {"catalog": {"mag_limit": 22.0}},
    "full_well": {"instrument": {"detector.full_well": 90_000}},
    "shallow_well": {"instrument": {"detector.full_well": 400}},
    "more_and_deep": {"catalog": {"options": {"file": "one_more.csv"}}, "instrument": {"detector.full_well": 90_000}},
    "more_and_shallow": {"catalog": {"options": {"file": "one_more.csv"}}, "instrument": {"detector.full_well": 400}},
    "gain": {"instrument": {"detector.gain": 2.0}},
    "jitter": {"instrument": {"psf.jitter": 0.02}},
    "planets": {"astrometry": {"planets": True}},
    "preview": {"fidelity": "preview"},
    "noise_free": {"fidelity": "noise_free"},
    "names": {"level0_names": "C5.2"},
    "truth_as_text": {"truth": ["parquet", "cat"]},
    "measured_otherwise": {"measurement": {"cti_passes": 1}},
}


def _with(data, keys):
    both = {key for key in keys if isinstance(keys[key], dict) and isinstance(data.get(key), dict)}
    return data | keys | {key: _with(data[key], keys[key]) for key in both}


def _base(folder, variants, well=90_000, **changes):
    file = write_campaign(folder, POINTINGS, keep="light", **changes)
    data = yaml.safe_load(file.read_text())
    data["instrument"] = {"folder": data["instrument"], "detector.full_well": well}
    file.write_text(yaml.safe_dump(data | {"variants": variants}))
    return file


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shared")
    (folder / "other.csv").write_text("\n".join([HEADER, POINTINGS[0].replace("60.15,-40.0", "75.0,10.0")]) + "\n")
    (folder / "more.csv").write_text("\n".join([HEADER, *POINTINGS, FURTHER]) + "\n")
    (folder / "objects.csv").write_text("ra,dec,mag_r\n60.15,-40.0,20\n")
    return _base(folder, SHARED, select={"types": ["SCIE"], "chips": [9, 24]})


@pytest.mark.parametrize("name", SHARED)
def test_a_variant_takes_from_its_base_what_the_base_makes_and_all_that_is_equal(shared, name):
    run = OpenCampaign(f"{shared}@{name}")
    base, own = run.base, run.paths.output
    for number, path, theirs, recipe in (
        *((pix, run.paths.truth(pix), base.sky_bricks, "truth") for pix in run.sky_bricks),
        *((chip, run.paths.psf(chip), base.sky_chips, "psf") for chip in run.sky_chips),
    ):
        equal = getattr(run.recipes, recipe) == getattr(base.recipes, recipe)
        assert (not path.is_relative_to(own)) == (number in theirs and equal), (recipe, number)
    jobs = {job.key: job for job in base.jobs}
    for job in run.jobs:
        for file, stage in (("select.parquet", "select"), *((file, "render") for file in RENDER_PRODUCTS)):
            equal = job.key in jobs and base.recipe(jobs[job.key], stage) == run.recipe(job, stage)
            assert (not run.paths.stage(*job.key, file).is_relative_to(own)) == equal, (job.key, file)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A campaign of objects that saturate, to the number that its full well says, and what it makes."""
    folder = tmp_path_factory.mktemp("table")
    job, rng, count = OpenCampaign(write_campaign(folder)).job(OBSID, CHIP), np.random.default_rng(5), 24
    x, y = (rng.uniform(low + 10, high - 10, count) for low, high in ((job.window.x0, 118), (job.window.y0, 118)))
    x[2], y[2] = x[4] + 1.0, y[4]  # in the saturated pixels of a star drawn as photons
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    mag, size = np.array([15.0, *rng.uniform(21, 25, count - 1)]), np.where(np.arange(count) % 2, 0.3, np.nan)
    mag[[2, 4]] = 25.0, 20.5
    rows = [
        f"{k},{ra[k]:.8f},{dec[k]:.8f},{mag[k]:.3f},{'galaxy' if k % 2 else 'star'},{size[k] if k % 2 else ''}"
        for k in range(count)
    ]
    lists = {"objects": rows[:-1], "one_more": rows, "faint": rows[1:-1], "alone": rows[:4] + rows[5:-1]}
    for name, some in lists.items():
        (folder / f"{name}.csv").write_text("\n".join(["id,ra,dec,mag_r,type,size", *some]) + "\n")
    file = _base(folder, RUN, well=1500, catalog=TABLE)
    _make(file)
    return file


def _make(file):
    done("psf", file, "--chip", CHIP)
    for verb in ("select", "render", "readout", "level0"):
        done(verb, file, "--obsid", OBSID, "--chip", CHIP)


@pytest.mark.thorough
@pytest.mark.parametrize("name", RUN)
def test_a_variant_has_the_bits_of_a_campaign_from_nothing(table, tmp_path, name):
    variant = f"{table}@{name}"
    _make(variant)
    data = yaml.safe_load(table.read_text())
    keys = data.pop("variants")[name]
    alone = tmp_path / "alone.yaml"
    alone.write_text(yaml.safe_dump(_with(data, keys) | {"output": str(tmp_path / "out")}, sort_keys=False))
    for one in table.parent.glob("*.csv"):
        shutil.copy(one, tmp_path)
    _make(alone)
    one, other = (OpenCampaign(run) for run in (variant, alone))
    for name in RENDER_PRODUCTS[:2]:  # no orders of an imaging chip
        ours, theirs = (run.paths.stage(OBSID, CHIP, name) for run in (one, other))
        assert pixels_and_columns(ours) == pixels_and_columns(theirs), name
    ours, theirs = (run.paths.level0(run.job(OBSID, CHIP)) for run in (one, other))
    names = sorted(path.name for path in ours.parent.iterdir())
    assert names == sorted(path.name for path in theirs.parent.iterdir())
    for name in names:
        assert steady(ours.with_name(name)) == steady(theirs.with_name(name)), name
