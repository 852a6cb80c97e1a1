"""What the small stages give to the functions that do the work, and what they write about it; those are replaced."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.release import release
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.io.keywords import RECIPE as KEYWORDS
from csstsim.io.paths import Paths
from csstsim.measure.calibration.calibrate import Corrections, Electronics
from csstsim.measure.catalogue import FrameFacts
from csstsim.measure.detection.residual import Residual
from csstsim.stages import calibrate, level0, masters, measure, merge, psf, truth, validate, variants
from csstsim.stages.parts.residual_file import open_residual

RECIPE = {"campaign": "a", "camera": "b", "layers": "c", "exposure": "d", "csstsim": release()}


class Named(Paths):
    """Paths whose Level-0 files have short names."""

    def stem(self, job):
        return f"{job.obsid}_{job.chip.id}"


def job(obsid="1", number=9, kind="SCIE", exptime=150.0, chip="imaging"):
    pointing = SimpleNamespace(type=kind, exptime=exptime, mjd=61000.0)
    where = SimpleNamespace(id=number, kind=chip, filter="r", maps=SimpleNamespace(bias="MAP", record={"map": 1}))
    return SimpleNamespace(
        obsid=obsid, key=(obsid, number), chip=where, pointing=pointing, window=Window(10, 70, 5, 45), wcs="WCS",
        options=f"--obsid {obsid} --chip {number}", exposure=SimpleNamespace(),
    )  # fmt: skip


def opened(folder, **given):
    changes = {
        "file": Path("c.yaml"), "paths": Named(folder),
        "recipe": lambda job, stage="level0": RECIPE | {"layers": stage},
        "base_files": lambda job, rule: [], "brick_recipe": lambda pix: f"brick {pix}",
    }  # fmt: skip
    return SimpleNamespace(**(changes | given))


def test_a_frame_of_another_campaign_is_refused_by_what_differs(tmp_path, monkeypatch):
    run, one = opened(tmp_path), job()
    header = {keyword: (RECIPE | {"layers": "level0"})[name] for name, keyword in KEYWORDS.items()}
    file = SimpleNamespace(header0=header | {"SIMVER": release()})
    monkeypatch.setattr("csstsim.io.level0.read_level0", lambda path, verify: file if verify else None)
    with pytest.raises(InputError, match=r"1_9\.fits: not made yet; `csstsim chip c\.yaml --obsid 1 --chip 9` ma"):
        level0.own_level0(run, one)
    run.paths.level0(one).parent.mkdir(parents=True)
    run.paths.level0(one).touch()
    assert level0.own_level0(run, one) is file
    words = {"campaign": "another seed, catalogue or PSF", "camera": "another camera", "layers": "other layers",
             "exposure": "another row of the survey table"}  # fmt: skip
    assert KEYWORDS.keys() == words.keys()
    for name, keyword in KEYWORDS.items():
        file.header0 = header | {"SIMVER": release(), keyword: "z"}
        with pytest.raises(InputError, match=rf"{keyword}: made with {words[name]} than now: .* \(got 'z'\); allow"):
            level0.own_level0(run, one)
    file.header0 = header | {"SIMVER": "0.0.1"}
    with pytest.raises(InputError):
        level0.own_level0(run, one)


def test_a_truth_table_is_that_of_the_frame(tmp_path, monkeypatch):
    run, one = opened(tmp_path), job()
    table = ObjectTable({"id": np.arange(2)}, {"recipe": RECIPE | {"layers": "level0"}})
    monkeypatch.setattr("csstsim.io.truth.read_truth", lambda path: table if path.suffix == ".parquet" else None)
    with pytest.raises(InputError, match=r"`csstsim chip c\.yaml --obsid 1 --chip 9` makes it"):
        level0.truth_of(run, one)
    run.paths.level0_truth(one).parent.mkdir(parents=True)
    run.paths.level0_truth(one).touch()
    assert level0.truth_of(run, one) is table
    table.meta["recipe"] = RECIPE | {"layers": "other"}
    with pytest.raises(InputError):
        level0.truth_of(run, one)


@pytest.mark.parametrize("shutter", [True, False])
def test_what_a_level0_header_is_made_from(tmp_path, monkeypatch, capsys, shutter):
    state = SimpleNamespace(
        header={"clipped_low": 7, "clipped_high": 3, "truth_hash": "t", "psf_hash": "p",
        "stages": [["readout", 1, 1]], "timing": ["x"]},
        image=np.zeros((4, 5)), telescope="TELESCOPE",
    )  # fmt: skip
    steps = SimpleNamespace(
        run=lambda state, stage, streams: state if (stage, streams) == ("level0", "STREAMS") else None,
        losses=SimpleNamespace(shutter=shutter), describe=lambda: ["layers"],
    )  # fmt: skip
    config = SimpleNamespace(seed=3, name="mine", astrometry=SimpleNamespace(model_dump=lambda: {"planets": True}))
    camera = SimpleNamespace(files=SimpleNamespace(changes={"detector.gain": 2}))
    run = opened(tmp_path, steps={"SCIE": steps}, config=config, camera=camera, streams=lambda job: "STREAMS")
    moments = {"open": 1}
    monkeypatch.setattr("csstsim.optics.throughput.shutter.moments", lambda *given: moments | {"of": given})
    monkeypatch.setattr("csstsim.optics.sky.bodies.angles_at_ends", lambda pointing: {"sun": 50.0})
    monkeypatch.setattr("csstsim.detector.adc.clipping_fault", lambda clipped, size: f"{clipped} of {size}")
    monkeypatch.setattr("csstsim.detector.adc.full_fault", lambda clipped, size: f"{clipped} of {size} full")
    made, about = level0.digitised(run, job(), state, SimpleNamespace(entry=lambda: ["level0", 2, 2]))
    assert capsys.readouterr().out == "warning: 7 of 20\nwarning: 3 of 20 full\n" and made is state
    assert state.header == {"clipped_low": 7, "clipped_high": 3, "sun": 50.0} | (
        moments | {"of": (61000.0, 150.0, "TELESCOPE")} if shutter else {}
    )
    assert about == {
        "obsid": "1", "filename": "1_9", "recipe": RECIPE | {"layers": "level0"}, "seed": 3, "campaign_name": "mine",
        "planets": True, "layers": ["layers"], "truth_hash": "t", "psf_hash": "p", "timing": ["x"],
        "camera": {"detector.gain": 2, "map": 1}, "stages": [["readout", 1, 1], ["level0", 2, 2]],
    }  # fmt: skip


def calibrations(*exptimes):
    frames = [job(f"b{k}", kind="BIAS", exptime=0.0) for k in range(2)]
    frames += [job(f"d{k}", kind="DARK", exptime=seconds) for k, seconds in enumerate(exptimes)]
    return [*frames, job("f", kind="FLAT", exptime=30.0)]


def test_masters_are_made_of_each_kind_and_say_of_which_exposures(tmp_path, monkeypatch, capsys):
    seen, saved = [], []

    def make(exposures, seconds):
        seen.append(({kind: list(some) for kind, some in exposures.items()}, seconds))
        return SimpleNamespace(flat="FLAT", bad=np.array([[True, False], [False, False]]), dark=0.0123, offset={1: 2.0})

    monkeypatch.setattr("csstsim.measure.calibration.masters.make_masters", make)
    monkeypatch.setattr("csstsim.io.frames.save_frame", lambda path, planes, meta: saved.append((path, planes, meta)))
    monkeypatch.setattr(masters, "_raw", lambda run, job: job.obsid)
    chip = SimpleNamespace(id=9)
    camera = SimpleNamespace(digest_for=lambda stage, chip: f"{stage} {chip.id}", chips={9: chip})
    run = opened(tmp_path, calibration_jobs={9: calibrations(300.0, 300.0)}, camera=camera)
    run.config = SimpleNamespace(seed=3)
    masters.masters(run, 9)
    assert seen == [({"BIAS": ["b0", "b1"], "DARK": ["d0", "d1"], "FLAT": ["f"]}, 300.0)]
    [(path, planes, meta)] = saved
    assert path == run.paths.masters(9) and planes["flat"] == "FLAT" and planes["bad"].tolist() == [[1, 0], [0, 0]]
    assert planes["bad"].dtype == np.uint8
    assert meta["dark [e-/s]"] == 0.0123 and meta["offset"] == {1: 2.0} and len(meta["recipes"]) == 5
    assert meta["exposures"] == ["b0", "b1", "d0", "d1", "f"]
    assert (meta["camera"], meta["seed"], meta["chip"]) == ("level0 9", 3, 9)
    assert capsys.readouterr().out.endswith("chip_09.fits: 25.000% of the pixels are bad, dark 0.0123 e-/s\n")
    run.calibration_jobs[9] = calibrations(300.0, 200.0)
    with pytest.raises(InputError, match=r"exptime: dark exposures differ in time \(got \[200\.0, 300\.0\]\)"):
        masters.masters(run, 9)
    with pytest.raises(InputError, match=r"chip 8 has too few full-frame .*allowed: 3 of each BIAS, DARK, FLAT"):
        masters.masters(run, 8)


def test_measured_sources_are_those_of_the_calibrated_frame(tmp_path, monkeypatch, capsys):
    seen = []

    def measured(*given, **named):
        seen.append((given, named))
        return ObjectTable({"number": np.arange(3)}, {"depth_5sigma": 26.128})

    monkeypatch.setattr("csstsim.measure.catalogue.measure_frame", measured)
    monkeypatch.setattr(measure, "calibrated_frame", lambda run, job: (SimpleNamespace(observer="CRAFT"), "FRAME"))
    monkeypatch.setattr(measure, "open_psf", lambda run, chip: f"PSF {chip.id}")
    one = job()
    one.exposure = SimpleNamespace(filter="FILTER", telescope="TELESCOPE")
    measurement = SimpleNamespace(joint=False)
    run = opened(tmp_path, config=SimpleNamespace(measurement=measurement))
    measure.measure(run, one)
    assert capsys.readouterr().out == "3 sources, 5 sigma at 26.13 AB\n"
    facts = FrameFacts("1", one.chip, "FILTER", "TELESCOPE", one.pointing, one.window)
    assert seen == [(("FRAME", "PSF 9", "WCS", "CRAFT", facts), {"keep": None})]
    table = measure.measured_table(run, one)
    assert table["number"].tolist() == [0, 1, 2] and table.meta["recipe"]["layers"] == "measure"
    assert list(measure.measured_table(run, one, ["number"]).names) == ["number"]
    run.recipe = lambda job, stage: RECIPE | {"layers": "other"}
    with pytest.raises(InputError):
        measure.measured_table(run, one)
    with pytest.raises(InputError, match=r"`csstsim measure c\.yaml --obsid 2 --chip 9` makes it"):
        measure.measured_table(run, job("2"))
    monkeypatch.setattr(measure, "copied", lambda pairs: True)
    measure.measure(run, one)
    assert len(seen) == 1  # the base's file was taken
    monkeypatch.setattr(measure, "copied", lambda pairs: False)
    measurement.joint = True
    measure.measure(run, one)
    seen[1][1]["keep"](Residual(np.full((3, 4), 130, np.uint8), np.full((1, 1), 2.5, np.float32)))
    left = open_residual(run.paths.residual(*one.key), {"recipe": run.recipe(one, "measure")})
    assert (left.steps == 130).all() and left.steps.shape == (3, 4) and left.noise == 2.5
    with pytest.raises(InputError, match="another recipe"):
        open_residual(run.paths.residual(*one.key), {"recipe": {}})


def test_a_merged_brick_is_of_its_frames_and_says_so(tmp_path, monkeypatch, capsys):
    written = []

    def merged(pix, tables, bands, joint):
        return [[*tables, "new", *joint], [1] * 5] if (pix, bands) == (7, "BANDS") else None

    monkeypatch.setattr("csstsim.measure.bricks.merge.merge_brick", merged)
    monkeypatch.setattr("csstsim.measure.bricks.merge.write_merged", lambda *given: written.append(given))

    def measured_table(run, job, columns):
        facts = {"profiles": "Sersic"} if job.obsid == "1" else {}
        return ObjectTable({"number": np.arange(int(job.obsid))}, facts)

    monkeypatch.setattr(merge, "measured_table", measured_table)
    monkeypatch.setattr(merge, "_timed", lambda table, job: (f"table {len(table)}", job.obsid))
    monkeypatch.setattr(merge, "_joint_frame", lambda run, job: f"left of {job.obsid}")
    config = SimpleNamespace(name="mine", measurement=SimpleNamespace(joint=False))
    run = opened(tmp_path, merge_bricks={7: [job("1"), job("2")]}, camera=SimpleNamespace(bands="BANDS"), config=config)
    merge.merge(run, 7)
    [(path, sources, detections, meta)] = written
    assert path == run.paths.merge(7) and sources == [("table 1", "1"), ("table 2", "2"), "new"]
    assert len(detections) == 5
    assert {name: meta[name] for name in ("campaign", "brick", "recipe", "frames", "product", "profiles")} == {
        "campaign": "mine", "brick": 7, "recipe": "brick 7", "frames": 2, "product": "merged brick",
        "profiles": {"Sersic": 1, "not known": 1},
    }  # fmt: skip
    assert capsys.readouterr().out == "3 sources from 5 detections\n"
    config.measurement.joint = True
    merge.merge(run, 7)
    assert written[1][1][2:] == ["new", "left of 1", "left of 2"]


def test_a_brick_of_the_universe_is_made_with_the_campaigns_key(tmp_path, monkeypatch):
    seen, logged = [], []
    monkeypatch.setattr(
        "csstsim.catalog.truth_bricks.write_brick", lambda path, pix, **key: seen.append((path, pix, key))
    )
    monkeypatch.setattr("csstsim.catalog.truth_bricks.brick_meta", lambda pix, **key: ("META", pix, key))
    monkeypatch.setattr("csstsim.catalog.truth_bricks.read_brick", lambda path, expect: seen.append((path, expect)))
    opened_sky = []
    run = opened(
        tmp_path, embedded=True, open_truth=lambda: opened_sky.append(1), universe_key=lambda: {"seed": 3},
        in_share=lambda path: None,
    )  # fmt: skip
    truth.truth(run, 7, logged.append)
    assert seen == [(run.paths.truth(7), 7, {"seed": 3})] and logged == [run.paths.truth(7)] and opened_sky == [1]
    common = tmp_path / "common"
    common.touch()
    run.in_share = lambda path: common
    run.paths.truth(7).parent.mkdir(parents=True)
    truth.truth(run, 7, logged.append)
    assert seen[1] == (common, ("META", 7, {"seed": 3})) and len(seen) == 2
    own = opened(tmp_path, embedded=False, config=SimpleNamespace(catalog=SimpleNamespace(kind="a:B")))
    with pytest.raises(InputError, match=r"catalog\.kind: the campaign has a user's catalogue"):
        truth.truth(own, 7)
    truth.missing_bricks(own, [7], logged.append)


def psf_run(folder, **changes):
    config = {"library": None, "grid": 3, "oversampling": "auto", "interpolation": "idw", "beta": 2.5, "neighbours": 5,
              "library_sample": "point"}  # fmt: skip
    chip = SimpleNamespace(id=9, filter="r")
    camera = SimpleNamespace(
        chips={9: chip}, psf="NUMBERS", digest_for=lambda stage: f"camera {stage}", filters={"r": "FILTER"},
        telescope="TELESCOPE", folder=folder,
    )  # fmt: skip
    config = SimpleNamespace(psf=SimpleNamespace(**(config | changes)))
    return opened(
        folder,
        config=config,
        camera=camera,
        psf_library=changes.get("library") and "LIBRARY",
        in_share=lambda path: None,
    ), chip


@pytest.fixture
def sampled(monkeypatch):
    monkeypatch.setattr(
        "csstsim.optics.psf.sampling.oversampling_of", lambda name, numbers, asked: 4 if asked == "auto" else asked
    )


def test_a_psf_set_is_opened_as_the_campaign_says(tmp_path, monkeypatch, sampled):
    def set_of(path, **given):
        return SimpleNamespace(path=path, given=given, attributes={"version": release()})

    monkeypatch.setattr("csstsim.optics.psf.psf_file.PsfSet", set_of)
    run, chip = psf_run(tmp_path)
    found = psf.open_psf(run, chip)
    common = {"chip": 9, "filter": "r", "camera_digest": "camera psf"}
    how = {"method": "idw", "beta": 2.5, "neighbours": 5}
    assert found.path == run.paths.psf(9) and found.given == common | how | {"grid": 3, "oversampling": 4}
    run, chip = psf_run(tmp_path, library="lib")
    assert psf.open_psf(run, chip).given == common | how
    assert psf._open(run, chip, "elsewhere").path == "elsewhere" and psf._open(run, chip).given == common
    old = SimpleNamespace(path=run.paths.psf(9), attributes={"version": "0.0.1"})
    monkeypatch.setattr("csstsim.optics.psf.psf_file.PsfSet", lambda path, **given: old)
    with pytest.raises(InputError, match=r"chip_09\.h5"):
        psf.open_psf(run, chip)


def test_the_half_side_of_a_stored_psf(tmp_path, sampled):
    """256 cells of a quarter or half a pixel; a library's images are 64 px."""
    from csstsim.optics.psf.sampling import CELLS, LIBRARY_PX

    run, chip = psf_run(tmp_path)
    assert psf.psf_box(run, chip) == CELLS / 8
    run, chip = psf_run(tmp_path, oversampling=2)
    assert psf.psf_box(run, chip) == CELLS / 4
    run, chip = psf_run(tmp_path, library="lib")
    assert psf.psf_box(run, chip) == LIBRARY_PX / 2


def test_a_set_is_computed_or_taken_from_the_library(tmp_path, monkeypatch):
    from csstsim.optics.psf.psf_set import PsfSampling

    seen = []
    monkeypatch.setattr("csstsim.optics.psf.psf_c9.convert", lambda *given, **named: seen.append((given, named)))
    monkeypatch.setattr("csstsim.optics.psf.psf_set.make_psf", lambda *given, **named: seen.append((given, named)))
    monkeypatch.setattr("csstsim.optics.scatter.scattered_light.scattered_light", lambda camera, filter_: "SCATTERED")
    monkeypatch.setattr(psf, "_nodes_uv", lambda camera, chip, grid: ("NODES", grid))
    run, chip = psf_run(tmp_path)
    psf._make_set(run, chip)
    library, _ = psf_run(tmp_path, library="lib")
    psf._make_set(library, chip)
    path, digest = run.paths.psf(9), {"camera_digest": "camera psf"}
    assert seen == [
        ((path, chip, "FILTER", "NUMBERS", PsfSampling(3, "auto", nodes_uv=("NODES", 3))),
         {"scattered": "SCATTERED"} | digest),
        (("LIBRARY", path, chip, "FILTER"), {"sample": "point"} | digest),
    ]  # fmt: skip
    with pytest.raises(InputError, match=r"chip: not a chip of the camera \(got 8\); allowed: 9"):
        psf.psf(run, 8)


def verdict(folder, text):
    file = folder / "report" / "verdict.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)


def test_a_verdict_is_read_or_its_report_to_be_written(tmp_path):
    run = opened(tmp_path)
    with pytest.raises(InputError, match=r"`csstsim report c\.yaml` makes it"):
        variants._verdict(run)
    verdict(tmp_path, json.dumps({"passed": True}))
    assert variants._verdict(run) == {"passed": True}
    verdict(tmp_path, '{"passed":')
    with pytest.raises(InputError, match=r"verdict\.json: is damaged"):
        variants._verdict(run)
    with pytest.raises(InputError, match="variants: the campaign has no variants"):
        variants.variants(opened(tmp_path, variants=()))


def test_frames_that_both_have_are_compared_and_their_objects_counted(monkeypatch):
    """An image and a spectrum are in both; the third frame of the base is not, the fourth has no spectra there."""
    jobs = [job("1"), job("1", 21, chip="slitless"), job("2"), job("3", 21, chip="slitless")]
    base = SimpleNamespace(science_jobs=jobs, name="b", has_orders=lambda job: job.chip.id == 21)
    other = SimpleNamespace(
        science_jobs=[*jobs[:2], jobs[3], job("4")], name="v",
        has_orders=lambda job: job.chip.id == 21 and job.obsid == "1",
    )  # fmt: skip
    more = job("5")
    base.science_jobs, other.science_jobs = [*jobs, more], [*other.science_jobs, more]
    number = {"b": 10, "v": 20}
    monkeypatch.setattr(
        variants, "_seen", lambda run, job: (f"{run.name}{job.obsid}", {"stars": number[run.name] + int(job.obsid)})
    )
    monkeypatch.setattr(variants, "_spectra", lambda run, job: f"{run.name}{job.obsid}s")
    twins = "csstsim.measure.bricks.validation.twins"
    monkeypatch.setattr(f"{twins}.differences", lambda first, second: {0: (first, second)})
    monkeypatch.setattr(f"{twins}.spectral_differences", lambda first, second: {0: (first, second)})
    objects, counts = variants._Measured(base).compared(other)
    assert objects == [("b1", "v1"), ("b1s", "v1s"), ("b5", "v5")]
    assert counts == {"base": {"stars": 11 + 15}, "variant": {"stars": 21 + 25}}


def test_calibration_takes_masters_or_the_truth(tmp_path, monkeypatch):
    """Masters are of the whole chip: the window is cut out of them. Their pixel response replaces the true one."""
    flat, bad = np.arange(100.0 * 80).reshape(80, 100), np.zeros((80, 100), np.uint8)
    bad[20, 30] = 5
    meta = {"offset": {"1": 0.5, "16": -0.25}, "csstsim": release()}
    monkeypatch.setattr("csstsim.io.frames.load_frame", lambda path, recipe: ({"flat": flat, "bad": bad}, meta))
    monkeypatch.setattr(calibrate, "masters_recipe", lambda run, chip: {"chip": chip})
    monkeypatch.setattr(calibrate, "_response", lambda run, job, streams, **given: given)
    run, one = opened(tmp_path, masters=lambda chip: tmp_path / f"{chip}", streams=lambda job, word: word), job()
    run.config = SimpleNamespace(measurement=SimpleNamespace(calibration="frames"))
    known = calibrate.known_corrections(run, one)
    assert known.response["prnu"] is False and np.array_equal(known.response["master"], flat[5:45, 10:70])
    assert known.bad.shape == (40, 60) and np.argwhere(known.bad).tolist() == [[15, 20]]
    assert known.offset == {1: 0.5, 16: -0.25}
    meta["csstsim"] = "0.0.1"
    with pytest.raises(InputError, match=str(tmp_path / "9")):
        calibrate.known_corrections(run, one)
    run.config.measurement.calibration = "truth"
    layer = SimpleNamespace(param="PARAM")
    monkeypatch.setattr(
        "csstsim.measure.calibration.bad_pixels.known_defects",
        lambda chip, window, param, streams: (window, param, streams),
    )
    for step, wanted in ((layer, (one.window, "PARAM", "measure")), (None, None)):
        run.steps = {"SCIE": SimpleNamespace(step=lambda name, step=step: step if name == "detector_defects" else None)}
        assert calibrate.known_corrections(run, one) == Corrections({"prnu": True}, wanted)


@pytest.mark.parametrize(("flat", "shutter", "prnu", "asked", "master", "none"), [
    (False, False, False, True, None, True), (False, False, True, False, None, True),
    (False, False, True, True, None, False), (True, False, False, False, None, False),
    (False, True, False, False, None, False), (False, False, False, False, "M", False),
])  # fmt: skip
def test_a_response_that_is_1_everywhere_is_none(monkeypatch, flat, shutter, prnu, asked, master, none):
    monkeypatch.setattr("csstsim.optics.throughput.response.Response", lambda *given, **named: (given, named))
    one = job()
    one.exposure = SimpleNamespace(
        losses=SimpleNamespace(flat=flat, shutter=shutter, prnu=prnu), chip="CHIP", window="WINDOW", filter="FILTER",
        exptime=150.0,
    )  # fmt: skip
    streams = SimpleNamespace(chip_key=lambda name: f"key {name}", camera="SEEDS")
    run = SimpleNamespace(camera=SimpleNamespace(leds="LEDS"))
    found = calibrate._response(run, one, streams, prnu=asked, master=master)
    if none:
        assert found is None
        return
    key = "key prnu" if prnu and asked else None
    given, named = found
    field = named.pop("flat")
    assert given == ("CHIP", "WINDOW", "FILTER", 150.0)
    assert (field is not None) is flat and (field is None or (field.numbers, field.camera) == ("LEDS", "SEEDS"))
    assert named == {"shutter": shutter, "prnu": key, "master": master}


@pytest.mark.parametrize("from_frames", [True, False])
@pytest.mark.parametrize("layers", [("bias", "cte_effect", "brighter_fatter"), ()])
def test_electrons_are_made_with_what_the_campaign_knows(tmp_path, monkeypatch, from_frames, layers):
    """From frames: other traps (those of the chip's negative number), and the bias without its structure."""
    seen = []
    monkeypatch.setattr("csstsim.measure.calibration.calibrate.calibrate", lambda *given: seen.append(given))
    monkeypatch.setattr(calibrate, "known_corrections", lambda run, job: Corrections("R", "B", "O"))
    monkeypatch.setattr(calibrate, "frame_of", lambda bias, readout: (bias, readout))
    monkeypatch.setattr(calibrate, "Streams", lambda *given: given)
    steps = {"SCIE": SimpleNamespace(step=lambda name: SimpleNamespace(param=name) if name in layers else None)}
    detector = SimpleNamespace(adc_max=65535, full_well=9e4)
    measurement = SimpleNamespace(calibration="frames" if from_frames else "truth", cti_passes=2)
    run = opened(
        tmp_path, steps=steps, camera=SimpleNamespace(detector=detector), streams=lambda job, word: f"own {word}",
        config=SimpleNamespace(measurement=measurement, seed=3),
    )  # fmt: skip
    file = SimpleNamespace(frame=lambda: "RAW", readout="READOUT", gain="GAIN", nonlinearity="NL", levels="LEVELS")
    calibrate.calibrated_of(run, job(), file)
    [(raw, readout, electronics, corrections)] = seen
    assert (raw, readout) == ("RAW", "READOUT")
    assert electronics == Electronics("GAIN", nonlinearity="NL", adc_max=65535, full_well=9e4, levels="LEVELS")
    structure = ("MAP", "READOUT") if layers and not from_frames else None
    assert corrections == Corrections("R", "B", "O", structure, corrections.correct)
    assert corrections.correct.keywords == {
        "detector": detector, "window": job().window, "traps": "cte_effect" if layers else None, "passes": 2,
        "spread": bool(layers), "rng": (3, "1", -9, "measure") if from_frames else "own measure",
    }  # fmt: skip


def test_only_science_exposures_of_imaging_chips_are_calibrated(tmp_path):
    run = opened(tmp_path)
    for one, what in (
        (job(number=21, chip="slitless"), r"'21 \(r\) in SCIE'"),
        (job(kind="DARK"), r"'9 \(r\) in DARK'"),
    ):
        with pytest.raises(InputError, match=rf"chip: only science exposures .* \(got {what}\)"):
            calibrate.calibrate(run, one)


def test_a_validated_brick_has_the_truth_of_its_frames_and_says_by_which_limits(tmp_path, monkeypatch, capsys):
    given, written = [], []
    gate = {"name": "purity", "passed": True, "n": 12, "margin": 0.456}
    result = {"gates": [gate, gate | {"n": None, "margin": None}]}

    def judged(pix, merged, frames, bands, limits, laws):
        given.append((pix, len(merged), [*frames], bands, limits, laws))
        return dict(result), "ARRAYS"

    bricks = "csstsim.measure.bricks.validation"
    monkeypatch.setattr(f"{bricks}.measured_frame.MeasuredFrame", lambda *parts: parts)
    monkeypatch.setattr(f"{bricks}.validate.validate_brick", judged)
    monkeypatch.setattr(f"{bricks}.whole_objects.whole_objects", lambda table: f"whole {table}")
    monkeypatch.setattr(f"{bricks}.verdict.sentence", lambda gate: f"{gate['name']} of {gate['brick']}")
    monkeypatch.setattr(f"{bricks}.result_file.write_result", lambda path, result: written.append((path, result)))
    monkeypatch.setattr(
        "csstsim.report.figures.brick_figure", lambda *parts, **named: repr((*parts[1:], named)).encode()
    )
    monkeypatch.setattr("csstsim.report.style.band_styles", lambda filters: f"styles of {filters}")
    objects = SimpleNamespace(laws=lambda: "LAWS")
    monkeypatch.setattr(validate, "brick_objects", lambda run, pix: objects)
    monkeypatch.setattr(validate, "truth_of", lambda run, job: f"truth {job.obsid}")
    monkeypatch.setattr(validate, "measured_table", lambda run, job: f"measured {job.obsid}")
    monkeypatch.setattr(validate, "_depth", lambda run, job: f"depth {job.obsid}")
    monkeypatch.setattr(validate, "frame_facts", lambda run, job, some: f"facts {job.obsid} {some is objects}")
    limits = SimpleNamespace(completeness_min=0.9, snr_min=5.0, model_dump=lambda mode: {"mode": mode})
    camera = SimpleNamespace(
        detector=SimpleNamespace(channel_ny=64),
        telescope=SimpleNamespace(pixel_scale=0.074),
        filters="FILTERS",
        bands="BANDS",
    )
    run = opened(
        tmp_path, merge_bricks={7: [job("1"), job("2")]}, camera=camera, limits=limits,
        recipes=SimpleNamespace(validation={"camera": "digest"}),
    )  # fmt: skip
    run.paths.validate(7).parent.mkdir(parents=True)
    with pytest.raises(InputError, match=r"`csstsim merge c\.yaml --brick 7` makes it"):
        validate.validate(run, 7)
    run.paths.merge(7).parent.mkdir(parents=True)
    ObjectTable({"source_id": np.arange(4)}, {"recipe": "brick 7"}).write(run.paths.merge(7), {"recipe": "brick 7"})
    validate.validate(run, 7)
    frames = [(f"whole truth {k}", f"measured {k}", 64, 0.074, f"depth {k}", f"facts {k} True") for k in "12"]
    assert given == [(7, 4, frames, "BANDS", limits, "LAWS")]
    [(path, made)] = written
    assert path == run.paths.validate(7) and made["recipe"] == "brick 7" and made["camera"] == "digest"
    assert made["limits"] == {"mode": "json"} and made["gates"] == result["gates"]
    rendered = run.paths.validate(7).with_suffix(".png").read_text()
    assert rendered == repr(("ARRAYS", "styles of FILTERS", {"threshold": 0.9, "snr_min": 5.0}))
    first, second = capsys.readouterr().out.splitlines()
    assert first.endswith("purity of 7, 12 sources, 0.46 of the maximum allowed with chance") and second.endswith(
        "purity of 7"
    )
    ObjectTable({"source_id": np.arange(4)}).write(run.paths.merge(7), {"recipe": "brick 8"})
    with pytest.raises(InputError):
        validate.validate(run, 7)


def test_spectra_of_variants_are_those_of_the_campaign_of_now(tmp_path, monkeypatch):
    run, one = opened(tmp_path), job("1", 21)
    monkeypatch.setattr("csstsim.measure.bricks.validation.twins.summed_spectra", lambda table: table["id"].tolist())
    with pytest.raises(InputError, match=r"`csstsim extract c\.yaml --obsid 1 --chip 21` makes it"):
        variants._spectra(run, one)
    path = run.paths.spectra(*one.key)
    path.parent.mkdir(parents=True)
    table = ObjectTable({"id": np.arange(3)})
    table.write(path, {"recipe": RECIPE | {"layers": "measure"}})
    assert variants._spectra(run, one) == [0, 1, 2]
    table.write(path, {"recipe": RECIPE | {"layers": "other"}})
    with pytest.raises(InputError):
        variants._spectra(run, one)
