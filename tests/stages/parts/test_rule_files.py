"""What the workflow's jobs read: of each kind of exposure, of variants, of exposures whose chips one process makes."""

from types import SimpleNamespace

import pytest
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import CsstsimError
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.running.one_by_one import one_by_one, start_workflow
from csstsim.stages.parts.rule_files import RuleFiles, by_exposure, of_exposure

DARK = POINTINGS[0].replace("SCIE", "DARK").replace("10100000001", "10100000009")
CHIPS = {"types": ["SCIE", "DARK"], "chips": [8, 9]}


def files_of(folder, rows, main=False, **changes):
    """The RuleFiles of a small campaign, whose mark of a date that decides nothing can be seen."""
    run = OpenCampaign(write_campaign(folder, rows, **({"select": CHIPS} | changes)))
    return RuleFiles(run, lambda file: f"old {file}", main=main)


def names(files, some):
    """Paths in the output folder."""
    return [file.replace(f"{files.run.paths.output}/", "") for file in some]


def of(obsid="10100000001", chip="09", pix="0"):
    return SimpleNamespace(obsid=obsid, chip=chip, pix=pix)


def test_an_exposure_of_the_sky_reads_truth_and_psf_and_a_dark_neither(tmp_path):
    files = files_of(tmp_path, [POINTINGS[0], DARK])
    bricks = files.run.truth_bricks(files.job(of()))
    assert bricks and files.truth(of()) == [str(files.run.paths.truth(pix)) for pix in bricks]
    psf = ["psf/chip_09.h5", "psf/chip_09_tables.h5"]
    assert names(files, files.psf(of())) == psf
    assert names(files, files.objects(of())) == ["chips/10100000001_09/select.parquet", *psf]
    assert names(files, files.rendered(of())) == ["chips/10100000001_09/drawn.parquet"]
    assert names(files, files.stage_before("render")(of())) == ["chips/10100000001_09/render.fits"]
    dark = of("10100000009", "08")
    assert files.truth(dark) == files.psf(dark) == files.objects(dark) == files.rendered(dark) == []
    assert files.library(of()) == files.stage_before("render")(dark) == []
    assert names(files, files.stage_before("readout")(dark)) == ["chips/10100000009_08/readout.fits"]


def test_level0_files_are_measured_with_the_psf_and_merged_on_their_brick(tmp_path):
    files = files_of(tmp_path, POINTINGS[:2], select={"types": ["SCIE"], "chips": [9]}, truth=["parquet", "cat"])
    product, *truth = files.of_job("level0")(of())
    assert files.level0(of()) == [product] and [file.rpartition(".")[2] for file in truth] == ["parquet", "cat"]
    assert names(files, files.measured_with(of())) == ["psf/chip_09.h5"]
    (pix,) = files.run.merge_bricks
    both = ["measure/10100000001_09.parquet", "measure/10100000002_09.parquet"]
    assert names(files, files.on_brick("measure")(of(pix=str(pix)))) == both == names(files, files.made("measure"))
    assert files.merged(of(pix=str(pix))) == [str(files.run.paths.merge(pix))]
    assert files.recipe("select")(of()) == files.run.recipe(files.job(of()), "select") != files.recipe("level0")(of())


def test_what_campaigns_share_has_a_date_that_decides_nothing(tmp_path):
    files = files_of(tmp_path, [POINTINGS[0]], share=str(tmp_path / "share"))
    psf = str(files.run.paths.psf(9))
    assert files.psf(of()) == [f"old {psf}", f"old {files.run.paths.psf_tables(9)}"]
    assert files.measured_with(of()) == [f"old {psf}"]
    assert files.truth(of()) and all(file.startswith("old ") for file in files.truth(of()))


def test_a_variant_reads_products_of_its_base_that_are_equal_and_light_that_it_adds_to(tmp_path):
    cases = {"rough": {"measurement": {"cti_passes": 1}}, "warm": {"instrument": {"detector.gain": 1.3}}}
    file = write_campaign(tmp_path, [POINTINGS[0]], keep="light", variants=cases)
    rough, warm = (RuleFiles(OpenCampaign(f"{file}@{name}"), str, main=True) for name in cases)
    base = RuleFiles(OpenCampaign(file), str, main=True)
    level0, measure = (files.unless_equal("level0", files.rendered, files.psf) for files in (rough, warm)), "measure"
    assert next(level0)(of()) == base.made("level0")
    assert next(level0)(of()) == [*warm.rendered(of()), *warm.psf(of())]
    assert rough.unless_equal(measure, rough.level0)(of()) == rough.level0(of())
    assert base.objects(of()) == rough.objects(of())[: len(base.objects(of()))]
    assert rough.objects(of())[len(base.objects(of())) :] == base.made("render")


def test_exposures_are_one_group_where_their_files_are_named_alike(tmp_path):
    rows = [*POINTINGS[:2], DARK]
    files = files_of(tmp_path, rows, select={"types": ["SCIE", "DARK"], "chips": [8, 9, 29]})
    jobs = [job for job in files.run.jobs if job.obsid != "10100000002" or job.chip.id != 29]
    whole, part, dark = files.groups(jobs, "level0")  # a dark has no spectra
    assert (whole.number, whole.obsids, whole.log) == (0, ["10100000001"], "")
    assert (dark.number, dark.obsids, len(dark.outputs)) == (2, ["10100000009"], len(whole.outputs) - 1)
    ends = {"08": ["fits", "truth.parquet"], "09": ["fits", "truth.parquet"]}
    assert {chip: [path.split(".", 1)[1] for path in paths] for chip, paths in part.files} == ends
    names_of = [f"level0/{{obsid}}/{{name}}_{{obsid}}_{chip}_L0_V01." for chip in ("08", "09")]
    assert names(files, part.outputs) == [f"{name}{end}" for name in names_of for end in ends["08"]]
    spectra = "level0/{obsid}/{name}_{obsid}_29_L0_V01."
    assert names(files, whole.outputs[4:]) == [f"{spectra}{end}" for end in (*ends["08"], "orders.parquet")]
    assert (part.number, part.obsids, part.options) == (1, ["10100000002"], "--chip 8 --chip 9")
    assert whole.chips_of == part.chips_of == dark.chips_of == by_exposure(jobs)
    found = of_exposure(files.psf, whole)(of())
    assert names(files, found) == [f"psf/chip_{n}{end}.h5" for n in ("08", "09", "29") for end in ("", "_tables")]
    assert files.recipes("select", whole)(of()) == [files.recipe("select")(of(chip=c)) for c in ("08", "09", "29")]
    once = of_exposure(lambda job: [{"camera": job.chip > "08"}], whole)(of())
    assert once == [{"camera": False}, {"camera": True}]


def test_a_chip_that_failed_among_others_is_a_group_of_its_own_from_the_next_start(tmp_path):
    files = files_of(tmp_path, [POINTINGS[0]])

    def fail(job):
        if job.chip.id == 8:
            raise CsstsimError("no")

    with pytest.raises(CsstsimError, match="chip 8: no"):
        one_by_one(files.run, "level0", files.run.jobs, fail, resume=True)
    (group,) = files.groups(files.run.jobs, "level0")  # of this run
    assert group.chips_of == {"10100000001": ["08", "09"]}
    main = RuleFiles(files.run, str, main=True)
    rest, alone = main.groups(files.run.jobs, "level0")
    assert (rest.chips_of, rest.log) == ({"10100000001": ["09"]}, "")
    assert (alone.number, alone.chips_of, alone.log) == (1, {"10100000001": ["08"]}, "_08")
    start_workflow(files.run)
    assert len(list(files.groups(files.run.jobs, "level0"))) == 2


def test_psfs_of_a_library_are_read_from_its_file_of_the_chip(tmp_path):
    files = RuleFiles.__new__(RuleFiles)
    files.run = SimpleNamespace(psf_library=tmp_path / "library")
    assert files.library(of(chip="09")) == [str(tmp_path / "library" / "psfCube_9.h5")]
    files.run.psf_library = None
    assert files.library(of()) == []


def test_limits_of_time_are_those_of_the_fidelity_and_of_a_catalogue_of_ones_own(tmp_path):
    """Minutes of config's record: 3 to select from the universe, 60 from a user's table; 700 for a reference."""
    universe = files_of(tmp_path / "universe", POINTINGS[:1])
    stars = {"kind": "support.mini_campaign:Stars", "options": {"ra": [60.15], "dec": [-40.0], "mag": [20.0]}}
    own = files_of(tmp_path / "own", POINTINGS[:1], catalog=stars, fidelity="reference")
    for files, minutes in ((universe, (3, 4, 2)), (own, (60, 700, 2))):
        assert tuple(map(files.minutes, ("select", "render", "readout"))) == minutes


def test_masters_are_made_of_a_chips_own_frames_and_read_where_frames_calibrate(tmp_path):
    kinds = ("BIAS", 0), ("DARK", 300), ("FLAT", 150)
    rows = [
        f"1020000000{3 * k + n},{kind},0,0,0,2027-11-20T{10 + k}:0{n}:00,{time}"
        for k, (kind, time) in enumerate(kinds) for n in range(3)
    ]  # fmt: skip
    select = {"types": ["SCIE", "BIAS", "DARK", "FLAT"], "chips": [8, 9]}
    files = files_of(tmp_path, [POINTINGS[0], *rows], select=select)
    assert names(files, files.measured_with(of())) == ["psf/chip_09.h5"]
    for chip in ("08", "09"):
        images = [file for file in names(files, files.calibration_frames(of(chip=chip))) if file.endswith(".fits")]
        assert len(images) == 9 and all(f"_{chip}_L0" in file for file in images)
    by_frames = SimpleNamespace(calibration="frames")
    files.run = SimpleNamespace(
        config=SimpleNamespace(measurement=by_frames, share=None), masters=lambda chip: tmp_path / f"masters of {chip}"
    )  # fmt: skip
    assert files.measured_with(of(chip="08"))[1:] == [str(tmp_path / "masters of 8")]


def test_the_light_of_a_base_that_is_not_kept_is_no_input(tmp_path):
    file = write_campaign(
        tmp_path, [POINTINGS[0]], variants={"other": {"catalog": {"mag_limit": 22.0}}}, catalog={"mag_limit": 23.0}
    )
    variant, base = (RuleFiles(OpenCampaign(name), str, main=True) for name in (f"{file}@other", file))
    psf_and_objects = len(base.objects(of()))
    assert len(variant.objects(of())) == psf_and_objects
