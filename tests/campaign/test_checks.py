"""Each check of a campaign: what it lets pass, and file, key, value and advice of what it refuses."""

import errno
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import BlockedError, InputError
from csstsim.base.help_page import PAGES
from csstsim.campaign import checks
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.sections import PixelWindow, Select
from csstsim.instrument.orbit import OrbitState

FILE, TABLE = Path("c.yaml"), Path("t.csv")
ORBIT = SimpleNamespace(state=lambda time: OrbitState((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))


def campaign(**changes):
    """Return what check_selection reads of an OpenCampaign: exposures 1 to 3, chips 8 and 12, 100 x 200 px."""
    chips = {number: SimpleNamespace(id=number, filter=name) for number, name in ((8, "g"), (12, "r"))}
    camera = SimpleNamespace(chips=chips, filters={"g": 1, "r": 2}, detector=SimpleNamespace(nx=100, ny=200))
    select, window = changes.pop("select", {}), changes.pop("window", None)
    given = {"file": FILE, "table": TABLE, "camera": camera, "pointings": dict.fromkeys("123"), "psf_library": None}
    config = SimpleNamespace(select=Select(**select), window=window)
    return SimpleNamespace(**(given | {"config": config} | changes))


def told(check, *given):
    """Return the message of what a check refuses, and the page that it names."""
    with pytest.raises(InputError) as refused:
        check(*given)
    return str(refused.value), refused.value.page


@pytest.mark.parametrize(("key", "page"), [("survey_table", "survey table"), ("observations.SCIE", "observation")])
def test_files_that_are_named_must_be_files(tmp_path, key, page):
    (tmp_path / "good").touch()
    checks.check_file(campaign(), key, tmp_path / "good")
    for path, why in ((tmp_path, "it is a folder"), (tmp_path / "absent", "No such file or directory")):
        said = f"c.yaml: {key}: cannot read the file: {why} (got {str(path)!r}); allowed: a file; paths are relative"
        found, where = told(checks.check_file, campaign(), key, path)
        assert found.startswith(said) and where == PAGES[page]


def test_a_selection_that_is_there_passes():
    for select in ({}, {"obsids": ["3", "1"]}, {"chips": [12, 8]}, {"filters": ["r"]}, {"missing": {"2_08": "why"}}):
        checks.check_selection(campaign(select=select))
    checks.check_selection(campaign(window=PixelWindow(x0=0, x1=100, y0=0, y1=200)))
    checks.check_selection(campaign(window="region", psf_library=Path()))


@pytest.mark.parametrize(("changes", "said"), [
    ({"select": {"obsids": ["7", "1", "5"]}},
     "select.obsids: not in the survey table (got '5'); allowed: the 3 obsids of t.csv"),
    ({"select": {"chips": [8, 30, 13]}}, "select.chips: no such chip (got 13); allowed: 8, 12"),
    ({"select": {"filters": ["g", "z", "h"]}}, "select.filters: unknown filter (got 'h'); allowed: g, r"),
    ({"select": {"missing": {"4_08": "why"}}}, "select.missing: no pair of an exposure and a chip (got '4_08')"),
    ({"select": {"missing": {"1_09": "why"}}}, "select.missing: no pair of an exposure and a chip (got '1_09')"),
    ({"select": {"missing": {"1_x": "why"}}}, "select.missing: no pair of an exposure and a chip (got '1_x')"),
    ({"select": {"missing": {"1_08": "why", "2_12": " "}}}, "select.missing.2_12: the reason is missing (got ' ')"),
    ({"psf_library": Path("nowhere")}, "psf.library: no such folder (got"),
    ({"window": PixelWindow(x0=0, x1=101, y0=0, y1=9)}, "window: extends beyond the chip's edge (got {'x0': 0"),
    ({"window": PixelWindow(x0=0, x1=9, y0=0, y1=201)}, "'y1': 201}); allowed: x1 <= 100, y1 <= 200"),
])  # fmt: skip
def test_a_selection_of_what_is_not_there_is_refused(changes, said):
    found, page = told(checks.check_selection, campaign(**changes))
    assert found.startswith("c.yaml: ") and said in found and page == PAGES["campaign"], found


@pytest.mark.parametrize("key", ["", "output", "share", "scratch"])
def test_a_path_with_braces_is_refused(key):
    """Snakemake takes {word} in a path for a wildcard."""
    paths = {name: Path("/a", "b{c}" if name == key else "b", name) for name in ("", "output", "share", "scratch")}
    config = SimpleNamespace(share=paths["share"])
    run = SimpleNamespace(file=paths[""] / "c.yaml", config=config, paths=SimpleNamespace(output=paths["output"]))
    found, page = told(checks.check_braces, run, paths["scratch"])
    said = f"{run.file}: {key}: a path with braces" if key else f"{run.file}: a path with braces"
    assert found.startswith(said) and page == PAGES["campaign"]


def test_paths_without_braces_pass():
    run = SimpleNamespace(
        file=FILE, config=SimpleNamespace(share=None), paths=SimpleNamespace(output=Path("a b/[1]'é"))
    )
    checks.check_braces(run, None)


def shares(folder, share, output="out"):
    config = SimpleNamespace(share=share and folder / share)
    return SimpleNamespace(file=FILE, config=config, paths=SimpleNamespace(output=folder / output))


def test_a_folder_of_shared_products_is_not_in_the_output(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("nowhere")
    for share in (None, "common", "output", "a/b/c"):  # none of them there yet; `output` only begins like `out`
        checks.check_share(shares(tmp_path, share))
    checks.check_share(shares(tmp_path, "common", "common/out"))  # the other way round is allowed
    for share, why in (
        ("file", "not a folder"), ("out", "inside the"), ("out/a/b", "inside the"), ("x/../out", "in"),
        ("link", "a link to nothing"),
    ):  # fmt: skip
        found, page = told(checks.check_share, shares(tmp_path, share))
        assert f"c.yaml: share: {why}" in found and page == PAGES["campaign"]


def test_a_folder_of_shared_products_is_on_the_file_system_of_the_output():
    """A hard link cannot lead to another one."""
    run = SimpleNamespace(
        file=FILE, config=SimpleNamespace(share=Path("/proc/share")), paths=SimpleNamespace(output=Path("/tmp/x/out"))
    )
    assert "share: not on the file system of the output folder" in told(checks.check_share, run)[0]


def test_a_universe_is_a_folder(tmp_path):
    """Also in a campaign with another catalogue, which does not open it."""
    catalog = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"columns": {}}}
    path = write_campaign(tmp_path, POINTINGS[:1], catalog=catalog)
    OpenCampaign(path)
    path.write_text(path.read_text().replace(str(tmp_path / "universe"), str(tmp_path / "nowhere")))
    found, page = told(OpenCampaign, path)
    assert f"universe: no such folder (got '{tmp_path}/nowhere')" in found and page == PAGES["campaign"]


def kept_steps(*names, file="science.yaml"):
    return SimpleNamespace(step=lambda name: name if name in names else None, file=file)


@pytest.mark.parametrize(("fidelity", "layers", "good"), [
    ("standard", ("scie_obs",), False), ("preview", ("scie_obs",), False), ("noise_free", ("scie_obs",), True),
    ("reference", ("scie_obs",), True), ("standard", ("scie_obs", "poisson_and_dark"), True), ("standard", (), True),
])  # fmt: skip
def test_counted_photons_need_the_layer_that_adds_them(fidelity, layers, good):
    steps = {"BIAS": kept_steps("bias"), "SCIE": kept_steps(*layers)}
    run = SimpleNamespace(config=SimpleNamespace(fidelity=fidelity), steps=steps)
    if good:
        checks.check_photons(run)
        return
    found, _ = told(checks.check_photons, run)
    assert found.startswith(f"science.yaml: layers: fidelity {fidelity} samples photons")


def blocked(*names, where=(1.0, 2.0, 3.0)):
    """Return (run, exposures a to d), of which those named are blocked."""

    def check(camera, pointing):
        assert camera is run.camera
        if pointing.time in names:
            raise BlockedError(f"{pointing.time} looks at the Earth")

    steps = {"SCIE": SimpleNamespace(check=check, file="science.yaml")}
    run = SimpleNamespace(steps=steps, camera=SimpleNamespace(orbit=ORBIT), table=TABLE)
    return run, {f"10{k}": SimpleNamespace(type="SCIE", time=k, sat_position=where) for k in "abcd"}


def test_exposures_that_layers_cannot_have_are_counted():
    checks.check_layers(*blocked())
    found, page = told(checks.check_layers, *blocked("b"))
    assert found.startswith("t.csv: obsid 10b: b looks at the Earth; allowed: the spacecraft's states in the table")
    assert found.endswith("enable_straylight_model: false in science.yaml") and page == PAGES["survey table"]
    found, _ = told(checks.check_layers, *blocked("b", "c", "d", where=(1.0, 2.0, 3.5)))
    assert "obsid 10b: b looks at the Earth (2 more exposures of 4, too); allowed: a corrected state of the sp" in found


def test_the_shutter_limits_an_exposure_on_any_chip(monkeypatch):
    def check(chip, exptime):
        if exptime < chip:
            raise InputError(f"{exptime} s on {chip}")

    monkeypatch.setattr(checks.shutter, "check", check)
    steps = SimpleNamespace(losses=SimpleNamespace(shutter=True), file="science.yaml")
    checks.check_shutter(steps, 3.0, [1, 3])
    assert "science.yaml: 3.0 s on 5; or turn shutter_effect off" in told(checks.check_shutter, steps, 3.0, [1, 5])[0]
    steps.losses.shutter = False
    checks.check_shutter(steps, 3.0, [1, 5])


def test_masters_are_those_of_each_chip_and_only_if_frames_are_used(tmp_path):
    def run(calibration):
        config = SimpleNamespace(measurement=SimpleNamespace(calibration=calibration))
        return SimpleNamespace(file=FILE, config=config, masters=lambda chip: tmp_path / f"{chip}.fits")

    (tmp_path / "8.fits").touch()
    checks.check_masters(run("truth"), {8, 9})
    checks.check_masters(run("frames"), {8})
    checks.check_masters(run("frames"), ())
    said, _ = told(checks.check_masters, run("frames"), {12, 9, 8})
    assert f"c.yaml: measurement.masters: no {tmp_path}/9.fits; " in said


@pytest.mark.parametrize(("keep", "chips_as", "scratch", "good"), [
    ("light", "stages", None, True), ("light", "whole", None, False), ("light", "exposure", None, False),
    ("light", "stages", "/disk", False), ("nothing", "whole", "/disk", True),
])  # fmt: skip
def test_light_is_kept_by_the_four_stages_in_the_output_folder(keep, chips_as, scratch, good):
    run = SimpleNamespace(file=FILE, config=SimpleNamespace(keep=keep))
    if good:
        checks.check_keep(run, chips_as, scratch)
    else:
        assert "c.yaml: keep: needs chips in stages" in told(checks.check_keep, run, chips_as, scratch)[0]


def test_maps_are_read_only_if_asked():
    seen = []
    maps = SimpleNamespace(of=lambda stages: dict.fromkeys("ab", SimpleNamespace(check=lambda: seen.append(stages))))
    chips = [SimpleNamespace(maps=maps), SimpleNamespace(maps=maps)]
    checks.check_maps(chips)
    assert seen == []
    checks.check_maps(chips, read=True)
    assert len(seen) == 4
    checks.check_maps([], read=True)


def test_an_own_header_is_checked_in_both_units(tmp_path):
    file = write_campaign(tmp_path, POINTINGS[:1])
    table = OpenCampaign(file).camera.files.path("level0_keywords")
    text = table.read_text()
    first, *_, last = re.finditer(r"^ +- \{hdu.*from: (\w+)", text, re.MULTILINE)
    for found in (first, last):
        table.write_text(text[: found.start(1)] + "nothing_known" + text[found.end(1) :])
        with pytest.raises(InputError, match="unknown quantity"):
            OpenCampaign(file)


def test_errors_of_the_system_are_in_its_words(monkeypatch, tmp_path):
    def stat(path):
        raise OSError(errno.EACCES, "Permission denied")

    path = SimpleNamespace(stat=lambda: stat(None))
    assert "cannot read the file: Permission denied" in told(checks.check_file, campaign(), "survey_table", path)[0]
