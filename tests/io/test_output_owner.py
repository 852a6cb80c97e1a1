"""An output folder belongs to one campaign: refused to others, and still its own after both have moved."""

import json
import threading
from types import SimpleNamespace

import pytest

from csstsim.base.errors import InputError
from csstsim.io.output_owner import OWNER_FILE, check_owner, claim_output


def run_of(folder, name="one", file="campaign.yaml"):
    return SimpleNamespace(
        paths=SimpleNamespace(output=folder / "out"), config=SimpleNamespace(name=name), file=folder / file
    )


def test_a_folder_is_claimed_once_and_refused_to_others(tmp_path):
    run = run_of(tmp_path)
    check_owner(run)  # nobody's yet
    claim_output(run)
    claim_output(run)
    for other in (run_of(tmp_path, name="two"), run_of(tmp_path, file="other.yaml")):
        for ask in (check_owner, claim_output):
            with pytest.raises(InputError, match="another campaign"):
                ask(other)
    check_owner(run)


def test_campaign_and_folder_may_move_together(tmp_path):
    (tmp_path / "here").mkdir()
    claim_output(run_of(tmp_path / "here"))
    (tmp_path / "here").rename(tmp_path / "there")
    check_owner(run_of(tmp_path / "there"))


def test_a_record_that_cannot_be_read_is_refused(tmp_path):
    claim_output(run_of(tmp_path))
    (tmp_path / "out" / OWNER_FILE).write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        check_owner(run_of(tmp_path))


def test_a_record_that_another_process_is_writing_is_waited_for(tmp_path):
    run = run_of(tmp_path)
    claim_output(run)
    record = tmp_path / "out" / OWNER_FILE
    text = record.read_text()
    record.write_text("")
    later = threading.Timer(0.1, record.write_text, [text])
    later.start()
    check_owner(run)
    later.join()


def test_what_the_record_says(tmp_path):
    """The campaign's name, and its file as seen from the folder."""
    (tmp_path / "deep").mkdir()
    claim_output(run_of(tmp_path, name="mine", file="deep/a.yaml"))
    assert json.loads((tmp_path / "out" / OWNER_FILE).read_text()) == {"name": "mine", "file": "../deep/a.yaml"}
    with pytest.raises(InputError, match=r"got .*'\.\./deep/a\.yaml'.*allowed: .*'\.\./b\.yaml'"):
        check_owner(run_of(tmp_path, name="mine", file="b.yaml"))


def test_a_folder_below_a_file_is_none(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match="output: is not a folder, or is below a file"):
        check_owner(run_of(tmp_path))
    with pytest.raises(InputError, match=r"cannot be written|is not a folder"):
        claim_output(run_of(tmp_path))


def test_a_folder_of_products_that_cannot_be_written_is_told(tmp_path, monkeypatch):
    run = run_of(tmp_path)
    claim_output(run)
    (tmp_path / "out" / "level0").mkdir()
    (tmp_path / "out" / "file").write_text("")
    asked = []
    monkeypatch.setattr("os.access", lambda path, mode: asked.append(path.name) or path.name != "level0")
    with pytest.raises(InputError, match="level0: cannot be written"):
        claim_output(run)
    assert asked == ["out", "level0"]
