"""Rows, links and refusals of the report's stage, and which frames and objects its pictures show."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.release import release
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.io.paths import Paths
from csstsim.report import sky_picture
from csstsim.stages import report
from csstsim.stages.parts import report_pictures
from csstsim.stages.parts.report_pictures import bright_objects, chosen, colour_frames, detail
from csstsim.stages.report import Budget

RECIPE = {"campaign": "a", "camera": "b", "layers": "c", "exposure": "d", "csstsim": release()}


class Named(Paths):
    """Paths whose Level-0 files have short names."""

    def stem(self, job):
        return f"{job.obsid}_{job.chip.id}"


def job(obsid="1", number=9, name="r", kind="SCIE", at=(0.0, 0.0)):
    """Return a job of 100 x 60 px whose first pixel is at a position of a flat sky."""
    pointing = SimpleNamespace(
        type=kind, ra=1.23456789, dec=-2.5, pa=-113.43333, time="2027-11-20T01:08:00", exptime=150.0, mjd=61000.0
    )
    x, y = at
    wcs = SimpleNamespace(
        world_to_pixel=lambda ra, dec: (ra - x, dec - y), pixel_to_world=lambda i, j: (np.add(i, x), np.add(j, y))
    )
    chip = SimpleNamespace(id=number, filter=name, label=f"{number:02d}")
    return SimpleNamespace(
        obsid=obsid, key=(obsid, number), chip=chip, pointing=pointing, window=Window(0, 100, 0, 60), wcs=wcs,
        observer=None, options=f"--obsid {obsid} --chip {number}",
    )  # fmt: skip


def opened(folder, **given):
    limits = SimpleNamespace(model_dump=lambda mode: {"snr_min": 5.0})
    changes = {
        "file": Path("c.yaml"), "paths": Named(folder), "recipe": lambda job, stage="level0": RECIPE, "limits": limits,
        "brick_recipe": lambda pix: f"brick {pix}", "recipes": SimpleNamespace(validation={"camera": "cam"}),
    }  # fmt: skip
    return SimpleNamespace(**(changes | given))


def test_verdicts_of_bricks_are_those_of_now(tmp_path, monkeypatch):
    good = {"recipe": "brick 7", "camera": "cam", "limits": {"snr_min": 5.0}, "gates": []}
    run, seen = opened(tmp_path), {}
    monkeypatch.setattr("csstsim.measure.bricks.validation.result_file.read_result", lambda path: seen[path])
    with pytest.raises(InputError, match=r"`csstsim validate c\.yaml --brick 7` makes it"):
        report._validation(run, 7)
    path = run.paths.validate(7)
    path.parent.mkdir(parents=True)
    path.touch()
    seen[path] = good
    assert report._validation(run, 7) == good
    for changes, message in (
        ({"recipe": "brick 8"}, r"validate/7\.json: "),
        ({"camera": "other"}, "camera: evaluated by other limits of the"),
        ({"limits": {"snr_min": 6.0}}, r"limits: .*by other thresholds; .*got \{'snr_min': 6.0\}.*'snr_min': 5.0"),
    ):
        seen[path] = good | changes
        with pytest.raises(InputError, match=message):
            report._validation(run, 7)


def test_merged_bricks_and_spectra_are_those_of_now(tmp_path, monkeypatch):
    run, one = opened(tmp_path), job(number=21, name="GI")
    path = run.paths.merge(7)
    path.parent.mkdir(parents=True)
    ObjectTable({"source_id": np.arange(2)}).write(path, {"recipe": "brick 7"})
    assert report._merged(run, 7) == path
    ObjectTable({"source_id": np.arange(2)}).write(path, {"recipe": "brick 9"})
    with pytest.raises(InputError):
        report._merged(run, 7)
    monkeypatch.setattr(
        "csstsim.measure.bricks.validation.gates.register.evaluate",
        lambda scope, checks, limits, band, **where: (scope, checks, limits, band, where),
    )
    spectra = run.paths.spectra(*one.key)
    spectra.parent.mkdir(parents=True)
    ObjectTable({"id": np.arange(2)}).write(spectra, {"recipe": RECIPE, "checks": {"sky": 1}})
    assert report._spectra_gates(run, one) == (
        "spectra", {"sky": 1}, run.limits, "gi", {"exposure": "1", "chip": 21},
    )  # fmt: skip
    ObjectTable({"id": np.arange(2)}).write(spectra, {"recipe": RECIPE})
    with pytest.raises(InputError, match="checks: spectra of an older version; extract them again"):
        report._spectra_gates(run, one)


@pytest.mark.parametrize(("lines", "more"), [
    ({"detected": 3, "lines": 4, "pull_width": 1.046, "isolated": 2},
     "3 of 4 lines detected at S/N above 3, 2 expected from the true fluxes; 2 isolated lines differ from the truth "
     "by 1.05 sigma (rms)"),
    ({"detected": 0, "lines": 1, "pull_width": None, "isolated": 0},
     "0 of 1 line detected at S/N above 3, 2 expected from the true fluxes"),
])  # fmt: skip
def test_a_spectroscopic_frame_has_a_title_a_figure_and_links(tmp_path, monkeypatch, lines, more):
    run, one = opened(tmp_path), job(number=21, name="GI")
    spectra, table = run.paths.spectra(*one.key), run.paths.lines(*one.key)
    spectra.parent.mkdir(parents=True)
    ObjectTable({"id": np.arange(2)}).write(spectra, {"recipe": RECIPE, "spectra": 5})
    true = np.array([3.0, 2.9, np.nan, 60.0])
    ObjectTable({"flux_true": true, "flux_err": np.array([1.0, 1.0, 1.0, 20.0])}).write(table, lines)
    monkeypatch.setattr(report, "_is_png", lambda data: True)
    monkeypatch.setattr("csstsim.report.pictures.chart", lambda png: png)
    spectra.with_suffix(".png").write_bytes(b"figure")
    title, figure, links = report._spectra(run, one, Budget(100))
    assert title == f"exposure 1, chip 21 (GI): 5 spectra extracted, {more}" and figure == b"figure"
    assert links == (
        report.Link("spectra", "../spectra/1_21.parquet"), report.Link("lines", "../spectra/1_21_lines.parquet"),
        report.Link("figure", "../spectra/1_21.png"),
    )  # fmt: skip


def test_the_summary_counts_and_names(tmp_path):
    jobs = [job("1", 9), job("1", 8, "g"), job("2", 9), job("3", 9, kind="BIAS")]
    config = SimpleNamespace(catalog=SimpleNamespace(mag_limit=24.5), fidelity="preview")
    run = opened(
        tmp_path, title="mine", jobs=jobs, imaging_jobs=tuple(jobs[:3]), slitless_jobs=(job("1", 21, "GI"),),
        camera=SimpleNamespace(filters=("g", "r", "i", "GI")), merge_bricks={7: [], 8: []}, config=config,
        declared_missing={("5", 9): "lost", ("5", 8): "late"}, variants=(),
    )  # fmt: skip
    assert report._summary(run) == {
        "name": "mine", "exposures": 3, "Level-0 files": 4, "filters": "g, r, GI", "bricks": 2,
        "faintest magnitude rendered": 24.5, "rendering": "preview",
        "declared missing": "5 chip 9: lost; 5 chip 8: late",
    }  # fmt: skip
    config.catalog.mag_limit, run.declared_missing, run.variants = None, {}, (1,)
    found = report._summary(run)
    assert found["faintest magnitude rendered"] == "the whole truth" and "declared missing" not in found
    assert found["variants"] == report._link(run, "side by side", run.paths.variants_page)


def test_exposures_have_a_row_with_their_chips(tmp_path):
    run = opened(tmp_path, jobs=[job("1", 9), job("2", 7, "i", "DARK"), job("1", 8, "g")])
    first, second = report._exposures(run)
    wanted = {
        "obsid": "1", "type": "SCIE", "ra [deg]": "1.234568", "dec [deg]": "-2.500000", "pa [deg]": "-113.4333",
        "start [UTC]": "2027-11-20T01:08:00", "exposure [s]": 150.0,
    }  # fmt: skip
    assert {name: first[name] for name in wanted} == wanted and (second["obsid"], second["type"]) == ("2", "DARK")
    assert first["Level-0 of chip"] == tuple(
        report._link(run, f"{one.chip.label} {one.chip.filter}", run.paths.level0(one))
        for one in (run.jobs[0], run.jobs[2])
    )


def test_links_begin_at_the_page(tmp_path):
    run = opened(tmp_path)
    link = report._link(run, "a b", run.paths.output / "x" / "a b#.fits")
    assert link == report.Link("a b", "../x/a%20b%23.fits")
    merged, checked, figure = report._brick_links(run, 7, run.paths.validate(7).with_suffix(".png"))
    assert merged == report.Link("merged catalogue", "../merge/dataset/Norder%3D8/Dir%3D0/Npix%3D7.parquet")
    assert (checked, figure) == (
        report.Link("validation", "../validate/7.json"), report.Link("figure", "../validate/7.png"),
    )  # fmt: skip


def test_products_are_counted_with_their_size(tmp_path, monkeypatch):
    """Of more than LINKED files, there is a link to their folder."""
    run = opened(tmp_path)

    def files(folder, count, size):
        paths = [tmp_path / folder / f"{k}.fits" for k in range(count)]
        (tmp_path / folder).mkdir()
        for path in paths:
            path.write_bytes(b"x" * size)
        return SimpleNamespace(name=folder, files=lambda: [*map(str, paths), str(tmp_path / folder / "absent")])

    page = run.paths.report
    kinds = {
        "few": files("few", 2, 600), "many": files("many", 4, 1000), "report": SimpleNamespace(files=lambda: [
            str(page), str(page.with_name("verdict.json"))]),
        "none": SimpleNamespace(name="none", files=lambda: [str(tmp_path / "nothing")]),
    }  # fmt: skip
    monkeypatch.setattr(report, "kinds", lambda run: dict(kinds))
    monkeypatch.setattr(report, "LINKED", 3)
    (tmp_path / "logs").mkdir()
    few, many, beside = report._products(run)
    assert few == ("few", 2, "1.2 kB", (
        report.Link("0.fits (600 bytes)", "../few/0.fits"), report.Link("1.fits (600 bytes)", "../few/1.fits"),
    ))  # fmt: skip
    assert many == ("many", 4, "4 kB", (report.Link("the folder many", "../many"),))
    assert beside == ("next to this page", 1, "and other folders of the workflow", (
        report.Link("verdict.json", "verdict.json"), report.Link("the folder logs", "../logs"),
    ))  # fmt: skip


def test_what_made_the_campaign_is_stated(tmp_path):
    def step(keyword, **param):
        return SimpleNamespace(keyword=keyword, param=SimpleNamespace(model_dump=lambda mode: param))

    steps = {"SCIE": SimpleNamespace(steps=[step("gain", b=1, a=2), step("bias")]), "DARK": SimpleNamespace(steps=[])}
    camera = SimpleNamespace(files=SimpleNamespace(changes={"detector.gain": 2.0}), digest="camera digest")
    config = SimpleNamespace(survey_table=Path("/a/t.csv"), digest=lambda: "campaign digest", seed=3)
    run = opened(tmp_path, steps=steps, camera=camera, config=config)
    found = report._provenance(run)
    wanted = {
        "campaign file": Path("c.yaml"), "survey table": "t.csv", "campaign digest": "campaign digest", "seed": 3,
        "camera digest": "camera digest", "camera changes": "detector.gain = 2.0", "layers of SCIE": "gain, bias",
        "layers of DARK": "",
    }  # fmt: skip
    assert {name: found[name] for name in wanted} == wanted
    assert report._layers(run) == [("SCIE", "gain", '{"a": 2, "b": 1}'), ("SCIE", "bias", "{}")]
    camera.files.changes = {}
    assert "camera changes" not in report._provenance(run)


@pytest.fixture
def flat_sky(monkeypatch):
    for name in ("apparent", "icrs"):
        monkeypatch.setattr(f"csstsim.catalog.astrometry.reduction.{name}", lambda ra, dec, craft: (ra, dec))


def test_the_picture_has_the_bands_and_frames_that_see_one_position(tmp_path, flat_sky):
    """The middle of the r frames is seen by g, r and i, that of z by no other; two frames a band are enough."""
    red = [job(str(k), 9, "r", at=(k, 0)) for k in range(3)]
    green, infrared, far = job("5", 8, "g", at=(10, -5)), job("6", 7, "i", at=(-20, 5)), job("7", 6, "z", at=(400, 0))
    camera = SimpleNamespace(filters=("u", "g", "r", "i", "z"))
    run = opened(tmp_path, camera=camera, merge_bricks={1: [far], 7: [far, *red, infrared, green]})
    anchor, bands = colour_frames(run)
    assert anchor is red[0] and list(bands) == ["g", "r", "i"]
    assert bands == {"g": [green], "r": red[:2], "i": [infrared]}
    near = job("8", 6, "z"), job("9", 5, "u")
    run.merge_bricks = {7: [*red, infrared, green, *near]}
    assert list(colour_frames(run)[1]) == ["g", "r", "i"]  # in the middle of five
    run.merge_bricks = {7: [green, red[0], far]}
    anchor, bands = colour_frames(run)
    assert (anchor, bands) == (green, {"g": [green]})


def test_cutouts_are_of_six_galaxies_and_two_stars_with_their_magnitude(tmp_path, monkeypatch):
    kinds = [GALAXY] * 7 + [STAR] * 3
    truth = {"obj_type": np.array(kinds), "mag": np.arange(20.0, 30.0)}
    monkeypatch.setattr(report_pictures, "truth_of", lambda run, job: truth)
    monkeypatch.setattr(
        report_pictures, "bright_objects",
        lambda run, truth, rows, window, file: ((row, f"at {row}") for row in np.flatnonzero(rows)),
    )  # fmt: skip
    found = list(chosen(opened(tmp_path), job(), None, None))
    assert found == [(f"galaxy, r {20 + k}.0", f"at {k}") for k in range(6)] + [
        (f"star, r {20 + k}.0", f"at {k}") for k in (7, 8)
    ]  # fmt: skip


def scene(monkeypatch, brightest=0.0):
    """A truth table of five objects, and the number that every pixel of the frame has."""
    monkeypatch.setattr("csstsim.report.thumbnail.binned", lambda file, cutout, step: np.full((4, 4), brightest))
    return ObjectTable({
        "x": np.array([300.0, 60.0, 340.0, 2.0, 150.0]), "y": np.array([200.0, 210.0, 240.0, 200.0, 120.0]),
        "electrons": np.array([50.0, 900.0, 70.0, 1e6, 10.0]),
        "obj_type": np.array([GALAXY, GALAXY, STAR, STAR, GALAXY]),
    })  # fmt: skip


def test_bright_objects_are_alone_inside_and_unsaturated(monkeypatch):
    """Cutouts of 96 px: the object at 340, 240 outshines that at 300, 200; that at 2 would be cut by the edge."""
    truth, window = scene(monkeypatch, 499.0), Window(0, 500, 0, 400)
    run = SimpleNamespace(camera=SimpleNamespace(detector=SimpleNamespace(full_well=1000.0)))
    found = list(bright_objects(run, truth, np.ones(5, bool), window, "FILE"))
    assert [row for row, _ in found] == [1, 2, 4]
    assert all(cutout.shape == (96, 96) for _, cutout in found)
    assert (
        found[0][1].contains(60.0, 210.0) and abs(found[0][1].x0 + 48 - 60) <= 1 and abs(found[0][1].y0 + 48 - 210) <= 1
    )
    galaxies = np.asarray(truth["obj_type"]) == GALAXY
    assert [row for row, _ in bright_objects(run, truth, galaxies, window, "FILE")] == [1, 4]
    scene(monkeypatch, 501.0)
    assert list(bright_objects(run, truth, np.ones(5, bool), window, "FILE")) == []


def test_a_frame_is_shown_in_full_about_its_galaxy_or_its_brightest_spectrum(tmp_path, monkeypatch):
    truth, one = scene(monkeypatch), job()
    one.window = Window(0, 500, 0, 400)
    camera = SimpleNamespace(detector=SimpleNamespace(full_well=1000.0))
    run = opened(tmp_path, camera=camera, has_orders=lambda job: False)
    monkeypatch.setattr(report_pictures, "truth_of", lambda run, job: truth)
    cutout = detail(run, one, "FILE", 40)
    assert cutout.shape == (40, 40) and abs(cutout.x0 + 20 - 60) <= 1 and abs(cutout.y0 + 20 - 210) <= 1
    assert detail(run, job(kind="DARK"), "FILE", 40) is None
    run.has_orders = lambda job: True
    orders = ObjectTable({
        "order": np.array([1, 0, 1, 1]), "x0": np.array([100, 0, 200, 9]), "x1": np.array([200, 99, 300, 9]),
        "y0": np.array([50, 0, 100, 9]), "y1": np.array([70, 9, 130, 9]), "drawn": np.array([5.0, 1e9, 7.0, 1e9]),
    })  # fmt: skip
    monkeypatch.setattr(report_pictures, "read_orders", lambda path: orders)
    cutout = detail(run, one, "FILE", 40)
    assert cutout.shape == (40, 40) and abs(cutout.x0 + 20 - 250) <= 1 and abs(cutout.y0 + 20 - 115) <= 1
    orders = orders.take(np.array([1, 3]))
    assert detail(run, one, "FILE", 40) is None


def test_the_focal_plane_has_science_first_then_the_most_chips_then_the_first_picture(tmp_path, monkeypatch):
    """Exposures of one chip and of several; no more frames than PICTURES, but one exposure at least."""
    one, two, bias = [job("1", 9)], [job("2", 8), job("2", 9)], [job("3", n, kind="BIAS") for n in (7, 8, 9)]
    again, alone = [job("4", 6), job("4", 7)], [job("5", 9)]
    first = SimpleNamespace(obsid="4"), SimpleNamespace(obsid="5")
    run = opened(
        tmp_path, jobs=[*bias, *one, *two, *again, *alone], first_frames=first, camera=SimpleNamespace(chips={9: "C"})
    )  # fmt: skip
    monkeypatch.setattr("csstsim.report.mosaic.take_exposure", lambda title, pa, files, choose_cutout: (title, pa))
    monkeypatch.setattr("csstsim.report.mosaic.mosaic", lambda chips, exposures, looks: (chips, exposures, looks))

    def shown(most):
        monkeypatch.setattr(report_pictures, "PICTURES", most)
        chips, exposures, looks = report_pictures.focal_plane(run, "LOOKS")
        assert (chips, looks) == (["C"], "LOOKS") and {pa for _, pa in exposures} == {-113.43333}
        return [title for title, _ in exposures]

    everything = [f"{k} (SCIE, 150 s, r)" for k in "4251"] + ["3 (BIAS, 150 s, r)"]
    assert shown(9) == everything
    assert shown(8) == everything[:4] and shown(3) == everything[:1] and shown(1) == everything[:1]


def test_bricks_of_the_truth_become_a_catalogue_where_all_are_left(tmp_path, monkeypatch):
    """Merged ones always; the verdict is written, and printed with the path of the page."""
    written, verdict = [], {"gates": [], "passed": True}
    truth = SimpleNamespace(made_for=[5, 7])
    run = opened(
        tmp_path, merge_bricks={7: []}, slitless_jobs=(), science_jobs=(), camera=SimpleNamespace(filters={}),
        config=SimpleNamespace(name="mine"),
    )  # fmt: skip
    for name in ("_summary", "_exposures", "_products", "_provenance", "_layers", "run_times", "sky_pictures"):
        monkeypatch.setattr(report, name, lambda run: [])
    monkeypatch.setattr(report, "_validation", lambda run, pix: {"brick": pix, "gates": []})
    monkeypatch.setattr(report, "_merged", lambda run, pix: f"merged {pix}")
    monkeypatch.setattr(report, "kinds", lambda run: {"truth": truth})
    monkeypatch.setattr(report, "focal_plane", lambda *given: None)
    monkeypatch.setattr(report, "sky_of_frames", lambda *given: None)
    monkeypatch.setattr(report.Budget, "read", lambda self, path: None)
    monkeypatch.setattr(report.verdicts, "verdict_of_results", lambda results, spectra: verdict)
    monkeypatch.setattr(report.verdicts, "count", lambda gates: {"fail": 0})
    monkeypatch.setattr(report.verdicts, "lines", lambda verdict: ["all good"])
    monkeypatch.setattr(
        report.verdicts, "write_verdict", lambda path, verdict, campaign, csstsim: written.append((path, campaign))
    )
    monkeypatch.setattr("csstsim.report.page.write_report", lambda page, *given, **named: written.append(page))
    monkeypatch.setattr("csstsim.measure.bricks.hats.write_catalogue", lambda *given: written.append(given))
    page, paths = run.paths.report, run.paths
    always = [page, (page.with_name("verdict.json"), "mine"), (paths.merge_catalogue, "mine", {7: "merged 7"})]
    assert report.report(run) is verdict and written == always
    for number, pix in enumerate(truth.made_for):
        paths.truth(pix).parent.mkdir(parents=True, exist_ok=True)
        paths.truth(pix).touch()
        written.clear()
        report.report(run)
        sky = (paths.truth_catalogue, "mine truth", {pix: paths.truth(pix) for pix in (5, 7)})
        assert written == always + [sky] * number


def test_the_picture_of_a_chip_and_its_cutouts_are_stretched_by_the_noise_of_their_own_pixels(tmp_path, monkeypatch):
    """A whole chip is shown by its middle 2400 px as means of 2 x 2: half the noise of the cutouts' single pixels."""
    sigma, drawn = {"g": 3.0, "r": 4.0, "i": 9.0}, []
    bands = {name: [job(str(k), k, name) for k in (1, 2)] for name in sigma}
    anchor = bands["r"][0]
    anchor.window = Window(0, 9216, 0, 9232)
    for one in (each for jobs in bands.values() for each in jobs):
        one.exposure = SimpleNamespace(band=one.chip.filter)
    rng = np.random.default_rng(7)

    def plane(grid, exposure, file):
        return rng.normal(0.0, sigma[exposure.band] / grid.step, grid.shape)

    monkeypatch.setattr(report_pictures, "colour_frames", lambda run: (anchor, bands))
    monkeypatch.setattr(report_pictures, "chosen", lambda run, job, window, file: [("star", Window(50, 146, 20, 116))])
    monkeypatch.setattr("csstsim.io.level0.read_level0", lambda path: path)
    picture = "csstsim.report.sky_picture"
    monkeypatch.setattr(f"{picture}.plane", plane)
    monkeypatch.setattr(f"{picture}.colours", lambda planes, noise: drawn.append((planes, noise)))
    monkeypatch.setattr("csstsim.report.pictures.photograph", lambda rgb, marks=(): b"webp")
    monkeypatch.setattr(f"{picture}.ruler", lambda grid: grid)
    grid = sky_picture.Grid

    def around(exposure, window, step=1):
        return grid((10.0, 20.0), 0.075 * step, (window.ny // step, window.nx // step), step)

    monkeypatch.setattr(f"{picture}.Grid.around", around)
    figure, gallery = report_pictures.sky_pictures(opened(tmp_path, imaging_jobs=[anchor]))
    (field, noise), (cutout, cutout_noise) = drawn
    assert [one.shape for one in field] == [(1200, 1200)] * 3 and [one.shape for one in cutout] == [(96, 96)] * 3
    assert noise == pytest.approx(np.median([one.std() for one in field]), rel=0.05) == pytest.approx(1.43, rel=0.05)
    assert cutout_noise == pytest.approx(2 * noise)
    assert figure.caption.startswith("g, r, i as blue, green and red: 6 exposures, 3.0' x 3.0'")
    assert [one.caption for one in gallery.figures] == ["star"]


def test_rays_remain_if_any_band_has_one_exposure():
    grid = SimpleNamespace(shape=(400, 800), scale=0.075)
    for bands, remain in (({"g": [1], "r": [1, 2], "i": [1, 2]}, True), ({"g": [1]}, True), ({"g": [1, 2]}, False)):
        said = report_pictures._caption(bands, grid)
        assert said.endswith(" Cosmic rays remain in bands of one exposure.") is remain
