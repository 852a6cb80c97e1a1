"""What the extract and select stages hand on, and where they write; the functions that do the work are replaced."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.release import release
from csstsim.catalog.selection.select import ChipView, Noise
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.io.paths import Paths
from csstsim.stages import extract, select

RECIPE = {"campaign": "a", "csstsim": release()}


def job():
    return SimpleNamespace(
        obsid="1",
        key=("1", 21),
        chip=SimpleNamespace(id=21, filter="GI"),
        window=Window(0, 9, 0, 5),
        options="--chip 21",
    )


@pytest.fixture
def frame(tmp_path, monkeypatch):
    """Return (an OpenCampaign of one slitless frame, what extract_spectra got, what lines got)."""
    seen, redshifts = [], []
    truth = ObjectTable({"obj_type": np.array([STAR, GALAXY]), "z": np.array([9.0, 0.5])})
    orders = {"id": np.array([3, 5, 5])}
    monkeypatch.setattr(
        extract, "spectra_of_frame",
        lambda run, job, contamination: extract.ExtractionInput(
            truth, "FRAME", orders, contamination, "MODEL", "PSF", "WING"
        ),
    )  # fmt: skip

    def spectra(*given, **named):
        seen.append((given, named))
        meta = {"spectra": 2, "cut": 1, "left_out": dict.fromkeys(LEFT_OUT, 0) | {next(iter(LEFT_OUT)): 4}}
        return ObjectTable({"row": np.arange(2)}, meta)

    from csstsim.measure.spectra.chosen_orders import LEFT_OUT

    lines = SimpleNamespace(table=lambda: ObjectTable({"line": np.arange(1)}))
    measure = "csstsim.measure.spectra"
    monkeypatch.setattr(f"{measure}.extract.extract_spectra", spectra)
    monkeypatch.setattr(f"{measure}.line_fluxes.LineFluxes", lambda z: redshifts.append(z) or lines)
    monkeypatch.setattr(f"{measure}.line_fluxes.compared_with_truth", lambda table: {"detected": 1})
    monkeypatch.setattr(f"{measure}.spectra_figures.spectra_figure", lambda *given: b"figure")
    monkeypatch.setattr(extract, "spectra_checks", lambda run, job, truth, table: {"sky": 1})
    monkeypatch.setattr(extract, "copied", bool)
    contamination = SimpleNamespace(known_from="truth", table=None)
    config = SimpleNamespace(measurement=SimpleNamespace(contamination=contamination))
    run = SimpleNamespace(
        paths=Paths(tmp_path), config=config, base_files=lambda job, rule: [], recipe=lambda job, stage: RECIPE,
        file="c.yaml",
    )  # fmt: skip
    return run, seen, redshifts


def written(run):
    return {path.relative_to(run.paths.output).as_posix() for path in run.paths.output.rglob("*") if path.is_file()}


def test_the_workflows_spectra_have_checks_and_lines_know_the_redshifts_of_galaxies(frame, capsys):
    run, seen, redshifts = frame
    extract.extract(run, job())
    assert written(run) == {f"spectra/1_21{end}" for end in (".parquet", ".png", "_lines.parquet")}
    [(given, named)] = seen
    assert given == ("FRAME", {"id": given[1]["id"]}, run.config.measurement.contamination, "MODEL", "PSF", "WING")
    assert (
        (named["choice"].snr_min, named["choice"].ids) == (5.0, None)
        and np.isnan(redshifts[0][0])
        and redshifts[0][1] == 0.5
    )
    table, lines = (ObjectTable.read(of(*job().key)) for of in (run.paths.spectra, run.paths.lines))
    assert table.meta["checks"] == {"sky": 1} and table.meta["recipe"] == lines.meta["recipe"] == RECIPE
    assert lines.meta["detected"] == 1
    first, cut, left, *rest = capsys.readouterr().out.splitlines()
    assert first.startswith("2 spectra of S/N 5 and more") and first.endswith("spectra/1_21.parquet")
    assert cut.startswith("warning: the window cuts 1 of them") and left.startswith("left out: 4, ") and not rest


@pytest.mark.parametrize("choice", [
    {"snr_min": 4.0}, {"ids": [5]}, {"contamination": SimpleNamespace(known_from="catalogue", table=None)},
    {"image": True},
])  # fmt: skip
def test_a_choice_of_ones_own_goes_to_files_of_its_own(frame, monkeypatch, choice):
    run, seen, _ = frame
    images = []
    monkeypatch.setattr(extract, "_write_image", lambda path, *given: images.append(path))
    run.base_files = lambda job, rule: ["the base's"]  # which is not taken
    extract.extract(run, job(), **choice)
    assert written(run) == {f"chosen/1_21{end}" for end in (".parquet", ".png", "_lines.parquet")}
    assert "checks" not in ObjectTable.read(run.paths.output / "chosen/1_21.parquet").meta
    assert images == ([run.paths.output / "chosen/1_21_contamination.fits"] if "image" in choice else [])
    [(given, named)] = seen
    assert (named["choice"].snr_min, named["choice"].ids) == (choice.get("snr_min", 5.0), choice.get("ids"))
    assert given[2] is choice.get("contamination", run.config.measurement.contamination)


def test_spectra_of_the_base_are_taken_and_unknown_objects_refused(frame):
    run, seen, _ = frame
    with pytest.raises(InputError, match=r"--ids: no object of this chip's table of orders \(got 2\)"):
        extract.extract(run, job(), ids=[5, 7, 2])
    run.base_files = lambda job, rule: [rule]
    extract.extract(run, job())
    assert seen == [] and written(run) == set()


def test_only_frames_with_orders_have_spectra():
    camera = SimpleNamespace(slitless_chips=[SimpleNamespace(id=1), SimpleNamespace(id=21)])
    run = SimpleNamespace(has_orders=lambda job: False, camera=camera, file="c.yaml")
    with pytest.raises(InputError, match=r"c\.yaml: chip: has no spectra \(got 21\); allowed: 1, 21, in SCIE"):
        extract.spectra_of_frame(run, job())


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize("own", [True, False])
def test_objects_are_selected_with_the_numbers_of_the_exposure(monkeypatch, embedded, own):
    """A catalogue that is given has all its objects, as they are: no limit, and none is turned."""
    seen, opened = [], []
    monkeypatch.setattr("csstsim.catalog.open.open_catalog", lambda *given: opened.append(given) or "CATALOG")
    monkeypatch.setattr("csstsim.catalog.selection.select.select_objects", lambda *given: seen.append(given))
    monkeypatch.setattr("csstsim.optics.scatter.scattered_light.scattered_light", lambda camera, filter_: "SCATTERED")
    monkeypatch.setattr(select, "psf_box", lambda run, chip: f"box of {chip}")
    filter_, detector = SimpleNamespace(sky=0.2), SimpleNamespace(dark=0.02, read_noise=5.5)
    exposure = SimpleNamespace(
        wcs="WCS", observer="CRAFT", window="WINDOW", filter=filter_, exptime=150.0, chip="CHIP", interval="INTERVAL"
    )
    catalog = SimpleNamespace(mag_limit=23.0, shapes="rotated90", changing=())
    run = SimpleNamespace(
        catalog=catalog, camera=SimpleNamespace(detector=detector, telescope="TELESCOPE"), embedded=embedded,
        universe_key=lambda: {"seed": 3}, region=lambda exposure: "REGION", paths=SimpleNamespace(truth="TRUTH"),
        disperser=lambda exposure: "DISPERSER", config=SimpleNamespace(catalog=catalog),
    )  # fmt: skip
    select.selected(run, exposure, "OWN" if own else None)
    view = ChipView(
        "WCS", "CRAFT", "WINDOW", filter_, "TELESCOPE", 150.0, Noise(0.2, 0.02, 5.5),
        scattered="SCATTERED", box="box of CHIP", disperser="DISPERSER", interval="INTERVAL",
    )  # fmt: skip
    assert seen == [("OWN", view, None, False) if own else ("CATALOG", view, 23.0, True)]
    key = {"seed": 3, "varying": ()} if embedded else {}
    assert opened == ([] if own else [(catalog, "REGION", "TRUTH", key)])
