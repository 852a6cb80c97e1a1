"""Several chips of an exposure, or several bricks, in one process: the same files as one by one, a line for each."""

import pytest
from support.commands import command, done
from support.mini_campaign import write_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.running.job_log import parts

POINTING = "10100000001,SCIE,60.0,-40.0,-113.4333,2027-11-20T01:08:00,150"  # where bricks meet
OBSID = POINTING.split(",")[0]
CHIPS = {"measure": (8, 9), "extract": (29, 30)}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Two imaging and two spectroscopic chips of one exposure, up to the Level-0 files."""
    chips = [chip for pair in CHIPS.values() for chip in pair]
    file = write_campaign(tmp_path_factory.mktemp("several"), [POINTING], select={"types": ["SCIE"], "chips": chips})
    logged = done("chip", file, "--obsid", OBSID, *options("--chip", chips))
    assert list(parts(logged)) == chips
    return file


def options(name, numbers):
    return [word for number in numbers for word in (name, number)]


def taken(folder):
    """Take all tables of a folder away; return their bytes."""
    found = {path.name: path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}
    for name in found:
        next(folder.rglob(name)).unlink()
    return found


@pytest.mark.parametrize(
    ("verb", "kind"), [("measure", "measure"), pytest.param("extract", "spectra", marks=pytest.mark.slow)]
)
def test_chips_in_one_process_give_the_same_tables(campaign, verb, kind):
    folder, chips = OpenCampaign(campaign).paths.output / kind, CHIPS[verb]
    for chip in chips:
        done(verb, campaign, "--obsid", OBSID, "--chip", chip)
    alone = taken(folder)
    assert len(alone) >= 2
    logged = done(verb, campaign, "--obsid", OBSID, *options("--chip", chips))
    assert list(parts(logged)) == list(chips) and f"exposure {OBSID} chip {chips[0]} {chips[1]}" in logged
    assert taken(folder) == alone


@pytest.mark.slow
def test_bricks_in_one_process_give_the_same_files(campaign):
    run = OpenCampaign(campaign)
    done("measure", campaign, "--obsid", OBSID, *options("--chip", CHIPS["measure"]))
    bricks = list(run.merge_bricks)
    assert len(bricks) >= 2
    for pix in bricks:
        done("merge", campaign, "--brick", pix)
        done("validate", campaign, "--brick", pix)
    verdicts = [run.paths.validate(pix).read_bytes() for pix in bricks]
    alone = taken(run.paths.merge_catalogue)
    for verb in ("merge", "validate"):
        assert list(parts(done(verb, campaign, *options("--brick", bricks)))) == bricks
    assert taken(run.paths.merge_catalogue) == alone
    assert [run.paths.validate(pix).read_bytes() for pix in bricks] == verdicts


def test_a_chip_that_cannot_be_measured_is_named(campaign):
    found = command("measure", campaign, "--obsid", OBSID, "--chip", 9, "--chip", 31)
    assert found.exit_code == 2 and "not a chip of this campaign" in found.output and not parts(found.output)
