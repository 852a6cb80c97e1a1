"""What options of a stage's command come to be: arguments of the stage."""

import pytest
from support.commands import command, done
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.stages import extract

OBSID = POINTINGS[0].split(",")[0]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("rules"), POINTINGS[:1], select={"types": ["SCIE"], "chips": [29]})


@pytest.mark.parametrize(("options", "snr", "ids", "image"), [
    (["--snr", "0"], 0.0, None, False), (["--snr", "7.5"], 7.5, None, False), (["--all"], 0.0, None, False),
    (["--ids", "3,1"], extract.SNR_MIN, [3, 1], False), (["--ids", "0", "--snr", "2"], 2.0, [0], False),
    (["--image"], extract.SNR_MIN, None, True),
])  # fmt: skip
def test_chosen_spectra(campaign, monkeypatch, options, snr, ids, image):
    seen = []
    monkeypatch.setattr(extract, "extract", lambda run, job, *given: seen.append((job.key, *given)))
    done("extract", campaign, "--obsid", OBSID, "--chip", 29, *options)
    assert seen == [((OBSID, 29), snr, ids, None, image)]


def test_spectra_are_chosen_of_every_chip_that_is_named(tmp_path, monkeypatch):
    """Each by the same choice; a fault is told with the chip at which it happens."""
    file = write_campaign(tmp_path, POINTINGS[:1], select={"types": ["SCIE"], "chips": [1, 2, 29]})
    seen = []
    monkeypatch.setattr(extract, "extract", lambda run, job, *given: seen.append((job.chip.id, *given)))
    words = "extract", file, "--obsid", OBSID, "--chip", 29, "--chip", 1
    done(*words, "--ids", "3", "--snr", "2", "--image")
    assert seen == [(number, 2.0, [3], None, True) for number in (29, 1)]

    def fails(run, job, *given):
        if job.chip.id == 1:
            raise ZeroDivisionError

    monkeypatch.setattr(extract, "extract", fails)
    assert command(*words, "--all").exception.__notes__ == [f"in obsid {OBSID}, chip 1"]


@pytest.mark.parametrize(("name", "known_from", "subtract"), [
    ("truth", "truth", True), ("catalogue", "catalogue", True), ("kept", "truth", False),
])  # fmt: skip
def test_chosen_contamination(campaign, monkeypatch, name, known_from, subtract):
    seen = []
    monkeypatch.setattr(extract, "extract", lambda run, job, *given: seen.append(given))
    done("extract", campaign, "--obsid", OBSID, "--chip", 29, "--contamination", name)
    [(snr, ids, contamination, image)] = seen
    assert (contamination.known_from, contamination.subtract) == (known_from, subtract)
    assert (snr, ids, image) == (extract.SNR_MIN, None, False)


@pytest.mark.parametrize("options", [
    ["--all", "--snr", "0"], ["--all", "--ids", "1"], ["--all", "--ids", "1", "--snr", "5"], ["--ids", "one"],
    ["--ids", "1,,2"], ["--snr", "-1"], ["--snr", "nan"], ["--contamination", "none"],
])  # fmt: skip
def test_what_does_not_go_together(campaign, monkeypatch, options):
    seen = []
    monkeypatch.setattr(extract, "extract", lambda *given: seen.append(given))
    assert command("extract", campaign, "--obsid", OBSID, "--chip", 29, *options).exit_code == 2
    assert seen == []


def test_true_spectra_of_neighbours_need_no_table(tmp_path, monkeypatch):
    """Of a campaign that knows neighbours by a table and subtracts nothing."""
    (tmp_path / "known.csv").write_text("id,ra,dec\n")
    known = {"known_from": "catalogue", "table": str(tmp_path / "known.csv"), "subtract": False}
    file = write_campaign(tmp_path, POINTINGS[:1], select={"types": ["SCIE"], "chips": [29]},
                          measurement={"contamination": known})  # fmt: skip
    seen = []
    monkeypatch.setattr(extract, "extract", lambda *given: seen.append(given[4]))
    for name in ("truth", "catalogue", "kept"):
        done("extract", file, "--obsid", OBSID, "--chip", 29, "--contamination", name)
    table = tmp_path / "known.csv"
    assert [(one.known_from, one.table and tmp_path / one.table, one.subtract) for one in seen] == [
        ("truth", None, True), ("catalogue", table, True), ("catalogue", table, False),
    ]  # fmt: skip


@pytest.fixture
def handed(campaign, monkeypatch):
    """Return a function that runs a stage's command and returns what the stage got."""

    def run(rule, *words, module=None, result=None):
        seen = []
        monkeypatch.setattr(f"csstsim.stages.{module or rule}.{rule}", lambda *given: seen.append(given) or result)
        done(rule, campaign, *words)
        assert all(given[0].file == campaign for given in seen)
        return [given[1:] for given in seen]

    return run


JOB = "--obsid", OBSID, "--chip", 29


@pytest.mark.parametrize("rule", ["select", "render", "readout", "level0", "calibrate"])
def test_a_stage_of_a_chip_gets_its_job(handed, rule):
    [(job,)] = handed(rule, *JOB)
    assert job.key == (OBSID, 29)


@pytest.mark.parametrize("rule", ["psf", "masters"])
def test_a_stage_of_a_detector_gets_its_number(handed, rule):
    assert handed(rule, "--chip", 12) == [(12,)]


def test_stages_of_bricks_get_one_at_a_time(handed):
    assert handed("truth", "--brick", 5) == [(5,)]
    for rule in ("merge", "validate"):
        assert handed(rule, "--brick", 7, "--brick", 5) == [(7,), (5,)]
    assert handed("report", result={"passed": True}) == handed("variants") == [()]


@pytest.mark.parametrize("resume", [True, False])
@pytest.mark.parametrize(("verb", "module"), [("measure", "measure"), ("extract", "extract"), ("chip", "chip")])
def test_chips_of_an_exposure_are_made_one_by_one(campaign, monkeypatch, verb, module, resume):
    """The rule under which what is finished is kept is level0 for whole chips, else the command's."""
    seen = []
    monkeypatch.setattr(
        "csstsim.campaign.running.one_by_one.one_by_one",
        lambda run, rule, jobs, make, resume: seen.append((rule, [job.key for job in jobs], resume)) or make(jobs[0]),
    )
    monkeypatch.setattr(f"csstsim.stages.{module}.{verb}", lambda run, job, **named: seen.append((job.key, named)))
    done(verb, campaign, *JOB, *(["--resume"] if resume else []))
    named = {"log": print} if verb == "chip" else {}
    assert seen == [("level0" if verb == "chip" else verb, [(OBSID, 29)], resume), ((OBSID, 29), named)]


def test_a_chip_whose_psf_cannot_be_made_is_set_apart(campaign, monkeypatch):
    seen, error = [], ZeroDivisionError("no wavefront")

    def fails(run, chip_id):
        raise error

    monkeypatch.setattr("csstsim.stages.psf.psf", fails)
    monkeypatch.setattr(
        "csstsim.campaign.running.one_by_one.record_missing_psf", lambda run, *given: seen.append(given)
    )
    assert command("psf", campaign, "--chip", 29).exception is error and seen == [(29, error)]


@pytest.mark.parametrize(
    ("passed", "strict", "code"), [(True, True, 0), (False, False, 0), (False, True, 1), (None, True, 0)]
)
def test_a_report_ends_with_1_only_if_it_is_strict(campaign, monkeypatch, passed, strict, code):
    monkeypatch.setattr("csstsim.stages.report.report", lambda run: {"passed": passed})
    assert command("report", campaign, *(["--strict"] if strict else [])).exit_code == code
