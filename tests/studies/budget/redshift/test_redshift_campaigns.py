"""Campaigns whose spectra are added: each frame once, each id one object."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.measure.spectra import line_columns, spectrum_columns
from csstsim.studies.budget.redshift import frame_tables
from csstsim.studies.budget.redshift.frame_tables import (
    Positions,
    _campaign_tables,
    check_frames,
    read_frame_tables,
)


def run(name, *keys, seed=1):
    """A campaign of frames (obsid, chip)."""
    jobs = [SimpleNamespace(key=key) for key in keys]
    return SimpleNamespace(file=Path(name), slitless_jobs=jobs, recipe=lambda job: {"seed": seed, "exposure": job.key})


def test_a_frame_of_two_campaigns_is_refused():
    first = run("a.yaml", ("1", 1), ("2", 2))
    check_frames([first, run("b.yaml", ("1", 2), ("3", 1)), run("c.yaml", ("1", 1), seed=2)])
    for others in ([first], [run("b.yaml", ("9", 1)), run("c.yaml", ("2", 2))]):
        with pytest.raises(InputError, match=r"exposure [12], chip [12], which a\.yaml has, too"):
            check_frames([first, *others])


def truth(ids, ra, dec, kind=GALAXY):
    return ObjectTable({"id": ids, "ra_orig": ra, "dec_orig": dec, "obj_type": [kind] * len(ids)})


def test_one_id_has_one_position():
    """To 0.5 arcsec, at 60 deg of declination and across RA 0; moving objects have no position."""
    positions = Positions()
    positions.add(truth([1, 2, 3], [10.0, 0.0, 5.0], [60.0, 60.0, 0.0]), "a.yaml")
    near = 0.45 / 3600
    positions.add(truth([1, 2, 4], [10.0 + 2 * near, 360.0 - 2 * near, 7.0], [60.0, 60.0, 0.0]), "b.yaml")
    for ids, ra, dec in (([1], [10.0], [60.0 + 0.55 / 3600]), ([9, 2], [1.0, 360 - 1.1 / 3600], [1.0, 60.0])):
        with pytest.raises(InputError, match=f"id {ids[-1]} is of two objects.*a.yaml"):
            positions.add(truth(ids, ra, dec, STAR), "c.yaml")
    positions.add(truth([1], [50.0], [6.0], max(GALAXY, STAR) + 5), "c.yaml")


def test_a_campaign_without_tables_is_refused(tmp_path):
    """The file is named that is missing, and what makes it; the option only where it was given."""
    names = {name: lambda obsid, chip, name=name: tmp_path / f"{obsid}_{name}" for name in ("spectra", "lines")}
    (tmp_path / "1_spectra").write_text("")
    one = SimpleNamespace(**vars(run("a.yaml", ("1", 7))), paths=SimpleNamespace(**names, output=tmp_path))
    with pytest.raises(InputError) as caught:
        _campaign_tables(one, None, print)
    assert str(caught.value).startswith(f"{tmp_path / '1_lines'}: no such table of spectra")
    assert "csstsim extract a.yaml --obsid 1 --chip 7" in str(caught.value) and "--spectra" not in str(caught.value)
    with pytest.raises(InputError, match=r"nowhere: --spectra: no table of spectra .got 'nowhere'.*1_spectra"):
        _campaign_tables(one, "nowhere", print)
    with pytest.raises(InputError, match=r"b\.yaml: has no spectroscopic frame"):
        _campaign_tables(run("b.yaml"), None, print)


def table(kind):
    """A table of one row of spectra or lines."""
    columns = {"spectra": spectrum_columns, "lines": line_columns}[kind].COLUMNS
    return ObjectTable({name: np.zeros(1, "U1" if of[0] is str else of[0]) for name, of in columns.items()})


def test_frames_that_are_not_extracted_are_counted(tmp_path, monkeypatch):
    """Of two frames one has tables; a table of another recipe is refused."""
    monkeypatch.setattr(frame_tables, "truth_of", lambda run, job: truth([1], [1.0], [1.0]))
    names = {name: lambda obsid, chip, name=name: tmp_path / f"{obsid}_{name}" for name in ("spectra", "lines")}
    one = SimpleNamespace(file=Path("a.yaml"), paths=SimpleNamespace(**names, output=tmp_path))
    one.slitless_jobs, one.recipe = [SimpleNamespace(key=(k, 1)) for k in "12"], lambda *_: {"seed": 1}
    for name in names:
        table(name).write(tmp_path / f"1_{name}", {"recipe": {"seed": 1}})
    said = []
    assert len(_campaign_tables(one, None, said.append)) == 1
    assert said == ["left out: 1 of 2 frames of a.yaml, not extracted yet"]
    table("lines").write(tmp_path / "1_lines", {"recipe": {"seed": 2}})
    with pytest.raises(InputError, match="1_lines"):
        _campaign_tables(one, None, print)
    for wrong, other, lacks in (("lines", "spectra", "line, snr"), ("spectra", "lines", "y, electrons")):
        for name in names:
            table(other if name == wrong else name).write(tmp_path / f"1_{name}", {"recipe": {"seed": 1}})
        with pytest.raises(
            InputError, match=rf"1_{wrong}: {lacks.split(',')[0]}: the table lacks {lacks}.*`csstsim extract`"
        ):
            _campaign_tables(one, None, print)


def extracted(folder, name, *keys, recipe=lambda job, stage="level0": {"seed": 1, "stage": stage, "key": str(job.key)}):
    """A campaign in a folder of its own whose frames have tables, as `csstsim extract` records them."""
    folder.mkdir()
    paths = SimpleNamespace(
        spectra=lambda obsid, chip: folder / "out" / f"{obsid}_{chip}_spectra",
        lines=lambda obsid, chip: folder / "out" / f"{obsid}_{chip}_lines",
    )
    one = SimpleNamespace(file=folder / name, slitless_jobs=[SimpleNamespace(key=key) for key in keys], recipe=recipe,
                          paths=paths)  # fmt: skip
    for job in one.slitless_jobs:
        write_tables(one, job, folder / "out")
    return one


def write_tables(one, job, folder, stage="measure"):
    """Write the tables of a frame into a folder, made by the recipe of a stage."""
    folder.mkdir(exist_ok=True)
    for kind, path in (("spectra", one.paths.spectra(*job.key)), ("lines", one.paths.lines(*job.key))):
        table(kind).write(folder / path.name, {"recipe": one.recipe(job, stage)})


def test_the_frames_of_all_campaigns_are_read_in_order(tmp_path, monkeypatch):
    """Each with its own truth; an id is one object in all, and a frame is in one of them."""
    where = {
        "1": truth([7], [10.0], [5.0]),
        "2": truth([8], [10.1], [5.0]),
        "3": truth([9, 7], [10.2, 10.0], [5.0, 5.0]),
    }
    monkeypatch.setattr(frame_tables, "truth_of", lambda run, job: where[job.key[0]])
    first, second = (
        extracted(tmp_path / "a", "a.yaml", ("1", 1), ("2", 1)),
        extracted(tmp_path / "b", "b.yaml", ("3", 1)),
    )
    found = read_frame_tables([first, second], None, print)
    assert [frame.truth["id"].tolist() for frame in found] == [[7], [8], [9, 7]]
    where["3"] = truth([9, 7], [10.2, 10.1], [5.0, 5.0])
    with pytest.raises(InputError, match=r"the id 7 is of two objects.*a\.yaml"):
        read_frame_tables([first, second], None, print)
    same = extracted(tmp_path / "c", "c.yaml", ("2", 1))
    with pytest.raises(InputError, match=r"exposure 2, chip 1, which .*a\.yaml has, too"):
        read_frame_tables([first, same], None, print)


def test_tables_are_those_of_the_recipe_of_measure(tmp_path, monkeypatch):
    """One of Level-0's recipe is of another file."""
    monkeypatch.setattr(frame_tables, "truth_of", lambda run, job: truth([1], [1.0], [1.0]))
    one = extracted(tmp_path / "a", "a.yaml", ("1", 1))
    assert len(read_frame_tables([one], None, print)) == 1
    write_tables(one, one.slitless_jobs[0], tmp_path / "a" / "out", "level0")
    with pytest.raises(InputError, match="1_1_spectra"):
        read_frame_tables([one], None, print)


@pytest.mark.parametrize("folder", ["mine", "../elsewhere", None])
def test_a_folder_of_tables_is_relative_to_the_campaigns_file(tmp_path, monkeypatch, folder):
    """Wherever the command runs."""
    monkeypatch.setattr(frame_tables, "truth_of", lambda run, job: truth([1], [1.0], [1.0]))
    one = extracted(tmp_path / "a", "a.yaml", ("1", 1))
    if folder:
        write_tables(one, one.slitless_jobs[0], tmp_path / "a" / folder)
        for path in (tmp_path / "a" / "out").iterdir():
            path.unlink()
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    assert len(read_frame_tables([one], folder, print)) == 1
