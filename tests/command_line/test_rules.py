"""What options of a stage's command come to be: arguments of the stage."""

import pytest
from commands import command, done
from mini_campaign import POINTINGS, write_campaign

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


@pytest.mark.parametrize(
    "options", [["--all", "--snr", "0"], ["--all", "--ids", "1"], ["--ids", "one"], ["--snr", "-1"]]
)
def test_what_does_not_go_together(campaign, options):
    assert command("extract", campaign, "--obsid", OBSID, "--chip", 29, *options).exit_code == 2
